"""The current tables, for queries. `crosscheck.history.store.migrations` makes them and updates old ones."""

from __future__ import annotations

import dataclasses
import functools
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from sqlalchemy import Column, MetaData, Table


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
              Column("deviation", Float),  # median absolute deviation over the repeats
              Column("repeats", Integer),
              Column("rounding", Float)))  # changes up to this may be rounding; null: no change is a finding
