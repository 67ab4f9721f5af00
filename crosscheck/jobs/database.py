"""Databases: an SQLite file or a PostgreSQL server, opened by a path or a URL that a user gives."""

from __future__ import annotations

import functools
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import sqlalchemy as sql

from crosscheck.errors import ArgumentError

POSTGRESQL_OPTIONS = frozenset({"application_name", "connect_timeout", "host", "sslcert", "sslkey", "sslmode",
                                "sslrootcert", "target_session_attrs"})
"""Options that may follow the ? of a URL. None of them is secret."""

_LOCK = 0x63726F73
"""Key of the advisory lock on PostgreSQL."""

PATIENCE = 60.0
"""Seconds to wait for another process that writes to the same SQLite file."""


def database(where: str | Path, option: str, tables: sql.MetaData,
             prepare: Callable[[sql.Engine], object] = lambda engine: None) -> sql.Engine:
    """Connect to the database at `where`, and make the tables that it lacks.

    Parameters
    ----------
    where : path of an SQLite file, or a URL: sqlite:///path, postgresql://user:password@host/database
    option : what the user gave it by, for messages
    prepare : called before the first connection

    Raises
    ------
    ArgumentError
        The URL is wrong, the server does not answer, or tables of these names have other columns.
    """
    url = _url(str(where), option)
    shown = url.set(drivername=url.get_backend_name(), query={}).render_as_string(hide_password=True)
    if url.get_backend_name() == "sqlite":
        engine = _sqlite(url, option)
    else:
        engine = sql.create_engine(url, poolclass=sql.pool.NullPool, connect_args={"connect_timeout": 10})
    try:
        prepare(engine)
        _make(engine, tables, option)
    except (sql.exc.SQLAlchemyError, UnicodeDecodeError) as error:  # the latter: SQLite quotes damaged bytes
        engine.dispose()
        raise ArgumentError(f"{option} {shown}: cannot be used ({_reason(error)}); give the path of an SQLite file or "
                            "the URL of a PostgreSQL database that answers") from None

    @sql.event.listens_for(engine, "handle_error")
    def lost(context: Any) -> None:
        error = context.sqlalchemy_exception or context.original_exception
        if isinstance(error, sql.exc.OperationalError | sql.exc.InterfaceError | UnicodeDecodeError) or (
                type(error) is sql.exc.DatabaseError):  # a file that the disk has changed
            raise ArgumentError(f"{option} {shown}: cannot be used any more ({_reason(error)}); mend this and give the "
                                "same command again, it goes on where it was") from None

    return engine


def _make(engine: sql.Engine, tables: sql.MetaData, option: str) -> None:
    """Make what is missing of the tables in one transaction, while other processes that do the same wait."""
    def unlike(connection: sql.Connection) -> str | None:
        found = sql.inspect(connection)
        return next((name for name, table in tables.tables.items() if not found.has_table(name)
                     or {each["name"] for each in found.get_columns(name)} != set(table.columns.keys())), None)

    with engine.connect() as connection:
        if unlike(connection) is None:
            return
    with engine.execution_options(writes=True).begin() as connection:  # on SQLite, such a transaction is the lock
        if connection.dialect.name == "postgresql":
            connection.execute(sql.text("SELECT pg_advisory_xact_lock(:key)"), {"key": _LOCK})
        tables.create_all(connection)
        if (name := unlike(connection)) is not None:
            raise ArgumentError(f"{option}: its table {name} is not that of this crosscheck; name another store")


def _reason(error: Exception) -> str:
    first, *_ = str(getattr(error, "orig", None) or error).strip().splitlines() or [type(error).__name__]
    return first.strip()  # the other lines only repeat the statement or give general advice


def _url(given: str, option: str) -> sql.URL:
    # The messages do not quote the given URL, because it may contain a password.
    if "://" not in given:
        if re.search(r":[^@]*@|^//", given):
            raise ArgumentError(f"{option}: this looks like a URL without its beginning; write postgresql://user:password"
                                "@host:port/database, or the path of an SQLite file")
        return sql.URL.create("sqlite", database=given)
    try:
        url = sql.make_url(given)
    except (sql.exc.ArgumentError, ValueError):  # ValueError: the port is not a number
        raise ArgumentError(f"{option}: this URL cannot be read; write postgresql://user:password@host:port/database "
                            "or sqlite:///path") from None
    backend = "postgresql" if url.get_backend_name() == "postgres" else url.get_backend_name()  # libpq allows both
    if backend not in ("sqlite", "postgresql"):
        raise ArgumentError(f"{option}: {backend} is not supported; allowed: sqlite, postgresql")
    if unknown := set(url.query) - (POSTGRESQL_OPTIONS if backend == "postgresql" else set()):
        raise ArgumentError(f"{option}: ?{min(unknown)}= is not taken in the URL; "
                            + (f"allowed: {', '.join(sorted(POSTGRESQL_OPTIONS))}; a password stands before the host, "
                               "in PGPASSWORD or in ~/.pgpass" if backend == "postgresql" else "leave it out"))
    if backend == "sqlite" and url.host:
        raise ArgumentError(f"{option}: {url.host} is read as a host; write sqlite:///path, with three strokes")
    if backend == "postgresql" and "@" in f"{url.host}{url.database}":
        raise ArgumentError(f"{option}: more than one @ in the URL; write %40 for one in the user's name or password")
    if url.port is not None and not 0 < url.port < 65536:
        raise ArgumentError(f"{option}: {url.port} is no port; write a number from 1 to 65535")
    return url.set(drivername="postgresql+psycopg" if backend == "postgresql" else "sqlite")


def _sqlite(url: sql.URL, option: str) -> sql.Engine:
    if url.database and url.database != ":memory:":
        try:
            Path(url.database).parent.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise ArgumentError(f"{option} {url.database}: {error.strerror or error}") from None
    engine = sql.create_engine(url, connect_args={"timeout": PATIENCE})

    @sql.event.listens_for(engine, "connect")
    def settings(connection: Any, _: object) -> None:
        # Otherwise the driver begins transactions itself, and so late that two writers may fail instead of waiting.
        connection.isolation_level = None
        connection.text_factory = functools.partial(str, encoding="utf-8", errors="backslashreplace")  # damaged bytes
        connection.execute("PRAGMA foreign_keys = ON")

    @sql.event.listens_for(engine, "begin")
    def begin(connection: Any) -> None:
        writes = connection.get_execution_options().get("writes")
        connection.exec_driver_sql("BEGIN IMMEDIATE" if writes else "BEGIN")

    return engine
