"""The history of runs in a database: an SQLite file by default, or a PostgreSQL server.

`migrations` make and update its schema, `figures` turns a record into rows, `runs` writes and reads runs.
Changes between runs are found by `crosscheck.history.changes`, not here.
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING

from crosscheck.history.store.migrations import migrate
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
from crosscheck.jobs.database import database

if TYPE_CHECKING:
    from sqlalchemy import Engine

DEFAULT = Path("reports/history.sqlite")
"""The store if none is named, relative to the current folder."""

__all__ = ["DEFAULT", "EMPTY", "StoredResult", "StoredRun", "Usual", "baseline", "figure_names", "find", "load",
           "open_store", "outcomes", "recent", "run_from_document", "save", "series", "set_good", "usual"]


def open_store(where: str | Path | None = None) -> Engine:
    """Open the store at `where`. If needed, it is made, or updated to the newest schema.

    `where` is as in `crosscheck.jobs.database.database`; None: the environment variable CROSSCHECK_STORE, or else
    `DEFAULT`. Raises `ArgumentError` if it cannot be used or is not a store of crosscheck.
    """
    return database(where or os.environ.get("CROSSCHECK_STORE") or DEFAULT, "--store", migrate)
