"""The history of runs in a database: an SQLite file by default, a PostgreSQL server by its URL.

`connection` opens a store and brings its schema up to date, `figures` turns a run's document into rows, `runs` writes
and reads them. What a change is, is decided in `crosscheck.history`; nothing here judges.
"""

from crosscheck.history.store.connection import DEFAULT, open_store
from crosscheck.history.store.runs import (
    StoredResult,
    StoredRun,
    Usual,
    baseline,
    figure_names,
    find,
    load,
    outcomes,
    recent,
    run_from_document,
    save,
    series,
    set_good,
    usual,
)

__all__ = ["DEFAULT", "StoredResult", "StoredRun", "Usual", "baseline", "figure_names", "find", "load", "open_store",
           "outcomes", "recent", "run_from_document", "save", "series", "set_good", "usual"]
