"""The tables as they are now, for queries; `crosscheck.history.store.migrations` makes them and upgrades old ones."""

from __future__ import annotations

import dataclasses
import functools
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from sqlalchemy import MetaData, Table


@dataclasses.dataclass(frozen=True)
class Tables:
    """Runs; where each was made (one row a run, and its versions); its results; the figures of each result."""

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
    from sqlalchemy import MetaData

    metadata = MetaData()
    return Tables(metadata, _schema_version(metadata), _runs(metadata), *_environment(metadata), _results(metadata),
                  _metrics(metadata))


def _schema_version(metadata: MetaData) -> Table:
    from sqlalchemy import Column, Integer, Table, Text

    return Table("schema_version", metadata, Column("version", Integer, primary_key=True),
                 Column("applied", Text, nullable=False))


def _runs(metadata: MetaData) -> Table:
    from sqlalchemy import Boolean, Column, Float, Integer, Table, Text

    return Table(
        "runs", metadata,
        Column("id", Integer, primary_key=True),
        Column("name", Text, nullable=False, unique=True),  # also the name of its folder
        Column("started", Text, nullable=False),  # UTC, ISO 8601, so that text sorts as time does
        Column("profile", Text, nullable=False),
        Column("selection", Text, nullable=False),  # scenes, engines and what else was asked for, JSON
        Column("command", Text, nullable=False),
        Column("seconds", Float),
        Column("exit_code", Integer, nullable=False),
        Column("good", Boolean, nullable=False),  # others are compared with the last of these
        Column("calibration", Float))  # us, median; null where speed was not measured


def _environment(metadata: MetaData) -> tuple[Table, Table]:
    from sqlalchemy import Column, ForeignKey, Integer, Table, Text

    run = functools.partial(Column, "run_id", Integer)
    return (
        Table("environments", metadata,
              run(ForeignKey("runs.id", ondelete="CASCADE"), primary_key=True),
              Column("system", Text), Column("processor", Text), Column("cores", Integer), Column("python", Text),
              Column("commit_name", Text)),
        Table("versions", metadata,
              run(ForeignKey("runs.id", ondelete="CASCADE"), primary_key=True),
              Column("kind", Text, primary_key=True),  # "engine" or "package"
              Column("name", Text, primary_key=True), Column("version", Text, nullable=False)))


def _results(metadata: MetaData) -> Table:
    from sqlalchemy import Boolean, Column, Float, ForeignKey, Integer, Table, Text, UniqueConstraint

    return Table(
        "results", metadata,
        Column("id", Integer, primary_key=True),
        Column("run_id", Integer, ForeignKey("runs.id", ondelete="CASCADE"), nullable=False, index=True),
        Column("scene", Text, nullable=False), Column("scene_hash", Text, nullable=False),
        Column("engine", Text, nullable=False), Column("method", Text, nullable=False),
        Column("form", Text, nullable=False),  # empty: the engine's own choice
        Column("practical", Boolean, nullable=False),
        Column("label", Text, nullable=False), Column("step", Float), Column("rtol", Float),
        Column("outcome", Text, nullable=False), Column("message", Text, nullable=False),
        UniqueConstraint("run_id", "scene", "engine", "method", "form", "practical", name="one_result_a_cell"))


def _metrics(metadata: MetaData) -> Table:
    from sqlalchemy import Column, Float, ForeignKey, Integer, Table, Text

    return Table(
        "metrics", metadata,
        Column("result_id", Integer, ForeignKey("results.id", ondelete="CASCADE"), primary_key=True),
        Column("name", Text, primary_key=True),
        Column("unit", Text, nullable=False),
        Column("value", Float, nullable=False),
        Column("deviation", Float),  # median absolute deviation over the repeats
        Column("repeats", Integer),
        Column("rounding", Float))  # changes up to this are rounding; null: no change of it is a finding
