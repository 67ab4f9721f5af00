"""The history of runs in a database: an SQLite file by default, or a PostgreSQL server.

`connection` opens a store and updates its schema, `figures` turns a record into rows, `runs` writes and reads runs.
Changes between runs are found by `crosscheck.history.changes`, not here.
"""

from crosscheck.history.store.connection import DEFAULT, open_store
from crosscheck.history.store.runs import (
    EMPTY,
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

__all__ = ["DEFAULT", "EMPTY", "StoredResult", "StoredRun", "Usual", "baseline", "figure_names", "find", "load",
           "open_store", "outcomes", "recent", "run_from_document", "save", "series", "set_good", "usual"]
