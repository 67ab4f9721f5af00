"""The tables of the history, which are made where there are none."""

from __future__ import annotations

import dataclasses
import functools
from typing import TYPE_CHECKING, Any

from crosscheck.errors import ArgumentError

if TYPE_CHECKING:
    from sqlalchemy import Column, Connection, Engine, MetaData, Table


@dataclasses.dataclass(frozen=True)
class Tables:
    """The tables: runs, their environments and versions, their results, and the values (metrics) of each result."""

    metadata: MetaData
    runs: Table
    environments: Table
    versions: Table
    results: Table
    metrics: Table


@functools.cache
def _kinds() -> dict[str, Any]:
    """Types of columns that refuse a value of another type: SQLite keeps any in any column, as a damaged file has."""
    import sqlalchemy

    def kind(name: str, *allowed: type) -> Any:
        class Kept(sqlalchemy.TypeDecorator[Any]):
            impl, cache_ok = getattr(sqlalchemy, name), True

            def process_result_value(self, value: Any, dialect: Any) -> Any:
                if value is not None and not isinstance(value, allowed):
                    raise ArgumentError(f"--store: it is damaged, with {value!r:.40} in place of {name.lower()}; name "
                                        "another store, or a copy of this one")
                return value

        return Kept

    return {"Text": kind("Text", str), "Float": kind("Float", int, float), "Integer": kind("Integer", int)}


@functools.cache
def tables() -> Tables:
    """The tables, for queries."""
    from sqlalchemy import Boolean, Column, ForeignKey, MetaData, Table, UniqueConstraint
    from sqlalchemy import Integer as Whole

    Text, Float, Integer = (_kinds()[name] for name in ("Text", "Float", "Integer"))

    def needed(name: str, kind: Any = Text, **more: Any) -> Column[Any]:
        return Column(name, kind, nullable=False, **more)

    def owner(name: str, of: str, **more: Any) -> Column[Any]:
        return Column(name, Whole, ForeignKey(f"{of}.id", ondelete="CASCADE"), **more)

    metadata = MetaData()
    return Tables(
        metadata,
        Table("runs", metadata,
              Column("id", Whole, primary_key=True),
              needed("name", unique=True),  # also the name of its folder
              needed("started"),  # UTC, ISO 8601, which sorts by time
              needed("profile"),
              needed("selection"),  # scenes, engines and other options, JSON
              needed("command"), Column("seconds", Float), needed("exit_code", Integer),
              needed("good", Boolean),  # later runs are compared with the last good one
              Column("calibration", Float)),  # us, median; null if speed was not measured
        Table("environments", metadata,
              owner("run_id", "runs", primary_key=True),
              Column("system", Text), Column("processor", Text), Column("cores", Integer), Column("python", Text),
              Column("commit_name", Text)),
        Table("versions", metadata,
              owner("run_id", "runs", primary_key=True),
              Column("kind", Text, primary_key=True),  # "engine" or "package"
              Column("name", Text, primary_key=True), needed("version")),
        Table("results", metadata,
              Column("id", Whole, primary_key=True),
              owner("run_id", "runs", nullable=False, index=True),
              needed("scene"), needed("scene_hash"), needed("engine"), needed("method"),
              needed("form"),  # empty if the engine chose it
              needed("label"), Column("step", Float), Column("rtol", Float),
              needed("outcome"), needed("message"),
              UniqueConstraint("run_id", "scene", "engine", "method", "form", name="one_result_a_cell")),
        Table("metrics", metadata,
              owner("result_id", "results", primary_key=True),
              Column("name", Text, primary_key=True), needed("unit"), needed("value", Float),
              Column("deviation", Float),  # as of `crosscheck.document.Speed`
              Column("repeats", Integer),
              Column("rounding", Float)))  # changes up to this may be rounding; null: no change is a finding


_LOCK = 0x63726F73
"""Key of the advisory lock on PostgreSQL."""


def prepare(engine: Engine) -> None:
    """Make the tables where there are none, in one transaction, while other processes that do the same wait.

    Raises `ArgumentError` where they have other columns.
    """
    import sqlalchemy

    def unlike(connection: Connection) -> str | None:
        found = sqlalchemy.inspect(connection)
        return next((name for name, table in tables().metadata.tables.items() if not found.has_table(name)
                     or {each["name"] for each in found.get_columns(name)} != set(table.columns.keys())), None)

    with engine.connect() as connection:
        if unlike(connection) is None:
            return
    # On SQLite, a writing transaction is the lock.
    with engine.execution_options(writes=True).begin() as connection:
        if connection.dialect.name == "postgresql":
            connection.execute(sqlalchemy.text("SELECT pg_advisory_xact_lock(:key)"), {"key": _LOCK})
        tables().metadata.create_all(connection)
        if (name := unlike(connection)) is not None:
            raise ArgumentError(f"--store: its table {name} is not that of this crosscheck; name another store")
