"""Opening a store: its URL, its locks, its schema."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from crosscheck.errors import ArgumentError
from crosscheck.history.store.migrations import migrate

if TYPE_CHECKING:
    from sqlalchemy import URL, Engine

DEFAULT = Path("reports/history.sqlite")
"""The store where none is named, below the current folder: beside the reports of the runs it tells about."""

PATIENCE = 60.0
"""Seconds to wait for another process that writes to the same SQLite file."""


def open_store(where: str | Path | None = None) -> Engine:
    """The store at `where`, made or migrated to the newest schema where that is needed.

    Parameters
    ----------
    where : path of an SQLite file, or a URL: sqlite:///path, postgresql://user:password@host/database.
        None: the environment variable CROSSCHECK_STORE, else `DEFAULT`.

    Raises
    ------
    ArgumentError
        The URL is of another kind, the server does not answer, the file is no store of ours.
    """
    import sqlalchemy

    url = _url(where)
    shown = url.render_as_string(hide_password=True)
    if url.get_backend_name() == "sqlite":
        engine = _sqlite(url)
    else:
        engine = sqlalchemy.create_engine(url, poolclass=sqlalchemy.pool.NullPool, connect_args={"connect_timeout": 10})
    try:
        migrate(engine)
    except sqlalchemy.exc.SQLAlchemyError as error:
        engine.dispose()
        reason = " ".join(str(getattr(error, "orig", None) or error).split())
        raise ArgumentError(f"--store {shown}: cannot be used ({reason}); give the path of an SQLite file or the URL "
                            "of a PostgreSQL database that answers") from None
    return engine


def _url(where: str | Path | None) -> URL:
    import os

    import sqlalchemy

    given = str(where or os.environ.get("CROSSCHECK_STORE") or DEFAULT)
    if "://" not in given:
        return sqlalchemy.URL.create("sqlite", database=given)
    try:
        url = sqlalchemy.make_url(given)
    except sqlalchemy.exc.ArgumentError:
        raise ArgumentError("--store: this URL cannot be read; write postgresql://user:password@host:port/database or "
                            "sqlite:///path") from None
    if url.get_backend_name() == "postgres":  # what libpq and many hosts write
        url = url.set(drivername="postgresql")
    if url.get_backend_name() not in ("sqlite", "postgresql"):
        raise ArgumentError(f"--store: {url.get_backend_name()} is not supported; allowed: sqlite, postgresql")
    return url.set(drivername="postgresql+psycopg") if url.get_backend_name() == "postgresql" else url


def _sqlite(url: URL) -> Engine:
    import sqlalchemy

    if url.database and url.database != ":memory:":
        try:
            Path(url.database).parent.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise ArgumentError(f"--store {url.database}: {error.strerror or error}") from None
    engine = sqlalchemy.create_engine(url, connect_args={"timeout": PATIENCE})

    @sqlalchemy.event.listens_for(engine, "connect")
    def _settings(connection: Any, _: Any) -> None:
        # The driver would begin transactions by itself, and too late to keep a second writer waiting from the start.
        connection.isolation_level = None
        connection.execute("PRAGMA foreign_keys = ON")

    @sqlalchemy.event.listens_for(engine, "begin")
    def _begin(connection: Any) -> None:
        writes = connection.get_execution_options().get("writes")
        connection.exec_driver_sql("BEGIN IMMEDIATE" if writes else "BEGIN")

    return engine
