"""The current tables, for queries, and the steps that make them or update old ones, in place and under a lock.

A released step is never edited, because the next step starts from its result. Therefore a step has its own statements
and does not use `tables`, which change.
"""

from __future__ import annotations

import dataclasses
import datetime
import functools
from typing import TYPE_CHECKING, Any

from crosscheck.errors import ArgumentError

if TYPE_CHECKING:
    from sqlalchemy import Column, Connection, Engine, MetaData, Table


@dataclasses.dataclass(frozen=True)
class Tables:
    """The tables: runs, their environments and versions, their results, and the values (metrics) of each result."""

    metadata: MetaData
    schema_version: Table
    runs: Table
    environments: Table
    versions: Table
    results: Table
    metrics: Table


@functools.cache
def tables() -> Tables:
    """The tables of the newest schema version."""
    from sqlalchemy import Boolean, Column, Float, ForeignKey, Integer, MetaData, Table, Text, UniqueConstraint

    def needed(name: str, kind: Any = Text, **more: Any) -> Column[Any]:
        return Column(name, kind, nullable=False, **more)

    def owner(name: str, of: str, **more: Any) -> Column[Any]:
        return Column(name, Integer, ForeignKey(f"{of}.id", ondelete="CASCADE"), **more)

    metadata = MetaData()
    return Tables(
        metadata,
        Table("schema_version", metadata, Column("version", Integer, primary_key=True), needed("applied")),
        Table("runs", metadata,
              Column("id", Integer, primary_key=True),
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
              Column("id", Integer, primary_key=True),
              owner("run_id", "runs", nullable=False, index=True),
              needed("scene"), needed("scene_hash"), needed("engine"), needed("method"),
              needed("form"),  # empty if the engine chose it
              needed("practical", Boolean), needed("label"), Column("step", Float), Column("rtol", Float),
              needed("outcome"), needed("message"),
              UniqueConstraint("run_id", "scene", "engine", "method", "form", "practical", name="one_result_a_cell")),
        Table("metrics", metadata,
              owner("result_id", "results", primary_key=True),
              Column("name", Text, primary_key=True), needed("unit"), needed("value", Float),
              Column("deviation", Float),  # as of `crosscheck.document.Speed`
              Column("repeats", Integer),
              Column("rounding", Float)))  # changes up to this may be rounding; null: no change is a finding


_LOCK = 0x63726F73
"""Key of the advisory lock on PostgreSQL."""


def migrate(engine: Engine) -> int:
    """Update the store to the newest version and return the version. Waits for other processes that do the same.

    All steps are one transaction, so that a kill leaves the old schema. Raises `ArgumentError` for a store that a
    newer release has written.
    """
    from sqlalchemy import text

    with engine.connect() as connection:
        if _version(connection) == VERSION:
            return VERSION
    # On SQLite, a writing transaction is the lock.
    with engine.execution_options(writes=True).begin() as connection:
        if connection.dialect.name == "postgresql":
            connection.execute(text("SELECT pg_advisory_xact_lock(:key)"), {"key": _LOCK})
        version = _version(connection)  # read again, because another process may have updated the store
        if version > VERSION:
            raise ArgumentError(f"--store: its schema has version {version}, this crosscheck knows {VERSION}; "
                                "install the newer crosscheck that wrote it")
        for number in range(version + 1, VERSION + 1):
            step(connection, number)
            connection.execute(text("INSERT INTO schema_version (version, applied) VALUES (:version, :applied)"),
                               {"version": number, "applied": datetime.datetime.now(datetime.UTC).isoformat()})
    return VERSION


def step(connection: Connection, number: int) -> None:
    """Execute the statements of one step."""
    from sqlalchemy import text

    types = {"sqlite": {"serial": "INTEGER PRIMARY KEY", "float": "FLOAT"},
             "postgresql": {"serial": "SERIAL PRIMARY KEY", "float": "DOUBLE PRECISION"}}[connection.dialect.name]
    for statement in STEPS[number]:
        connection.execute(text(statement.format(**types)))


def _version(connection: Connection) -> int:
    """Version of the schema in the store; 0 if it has none."""
    import sqlalchemy

    if not sqlalchemy.inspect(connection).has_table("schema_version"):
        return 0
    return int(connection.execute(sqlalchemy.text("SELECT max(version) FROM schema_version")).scalar() or 0)


RUNS = (
    "CREATE TABLE schema_version (version INTEGER PRIMARY KEY, applied TEXT NOT NULL)",
    "CREATE TABLE runs (id {serial}, name TEXT NOT NULL UNIQUE, started TEXT NOT NULL, profile TEXT NOT NULL, "
    "selection TEXT NOT NULL, command TEXT NOT NULL, seconds {float}, exit_code INTEGER NOT NULL)",
    "CREATE TABLE environments (run_id INTEGER PRIMARY KEY REFERENCES runs (id) ON DELETE CASCADE, system TEXT, "
    "processor TEXT, cores INTEGER, python TEXT, commit_name TEXT)",
    "CREATE TABLE versions (run_id INTEGER NOT NULL REFERENCES runs (id) ON DELETE CASCADE, kind TEXT NOT NULL, "
    "name TEXT NOT NULL, version TEXT NOT NULL, PRIMARY KEY (run_id, kind, name))",
    "CREATE TABLE results (id {serial}, run_id INTEGER NOT NULL REFERENCES runs (id) ON DELETE CASCADE, "
    "scene TEXT NOT NULL, scene_hash TEXT NOT NULL, engine TEXT NOT NULL, method TEXT NOT NULL, form TEXT NOT NULL, "
    "practical BOOLEAN NOT NULL, label TEXT NOT NULL, step {float}, rtol {float}, outcome TEXT NOT NULL, "
    "message TEXT NOT NULL, CONSTRAINT one_result_a_cell UNIQUE (run_id, scene, engine, method, form, practical))",
    "CREATE INDEX ix_results_run_id ON results (run_id)",
    "CREATE TABLE metrics (result_id INTEGER NOT NULL REFERENCES results (id) ON DELETE CASCADE, name TEXT NOT NULL, "
    "unit TEXT NOT NULL, value {float} NOT NULL, PRIMARY KEY (result_id, name))",
)

SPEEDS = (
    "ALTER TABLE metrics ADD COLUMN deviation {float}",
    "ALTER TABLE metrics ADD COLUMN repeats INTEGER",
    "ALTER TABLE metrics ADD COLUMN rounding {float}",
    "ALTER TABLE runs ADD COLUMN good BOOLEAN NOT NULL DEFAULT false",
    "ALTER TABLE runs ADD COLUMN calibration {float}",
    # What passed then is what later runs are compared with.
    "UPDATE runs SET good = (exit_code = 0)",
)

STEPS = {1: RUNS, 2: SPEEDS}
"""Statements of each step. Step 1: runs, environments, results and values. Step 2: spread of repeats, rounding,
calibration, and the runs that others are compared with."""

VERSION = max(STEPS)
