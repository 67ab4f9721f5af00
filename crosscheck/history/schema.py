"""The tables of the history: runs, their environments and versions, their results, and the values of each result."""

from __future__ import annotations

from typing import Any

import sqlalchemy as sql
from sqlalchemy import Boolean, Column, ForeignKey, Table, UniqueConstraint
from sqlalchemy import Integer as Whole

from crosscheck.errors import ArgumentError


def _kind(name: str, *allowed: type) -> Any:
    """A type of columns that refuses other values: SQLite keeps any in any column, as a damaged file has."""
    class Kept(sql.TypeDecorator[Any]):
        impl, cache_ok = getattr(sql, name), True

        def process_result_value(self, value: Any, dialect: Any) -> Any:
            if value is not None and not isinstance(value, allowed):
                raise ArgumentError(f"--store: it is damaged, with {value!r:.40} in place of {name.lower()}; name "
                                    "another store, or a copy of this one")
            return value

    return Kept


Text, Float, Integer = _kind("Text", str), _kind("Float", int, float), _kind("Integer", int)


def _needed(name: str, kind: Any = Text, **more: Any) -> Column[Any]:
    return Column(name, kind, nullable=False, **more)


def _owner(name: str, of: str, **more: Any) -> Column[Any]:
    return Column(name, Whole, ForeignKey(f"{of}.id", ondelete="CASCADE"), **more)


METADATA = sql.MetaData()
RUNS = Table(
    "runs", METADATA,
    Column("id", Whole, primary_key=True),
    _needed("name", unique=True),  # also the name of its folder
    _needed("started"),  # UTC, ISO 8601, which sorts by time
    _needed("profile"),
    _needed("selection"),  # scenes, engines and other options, JSON
    _needed("command"), Column("seconds", Float), _needed("exit_code", Integer),
    _needed("good", Boolean),  # later runs are compared with the last good one
    Column("calibration", Float))  # us, median; null if speed was not measured
ENVIRONMENTS = Table(
    "environments", METADATA,
    _owner("run_id", "runs", primary_key=True),
    Column("system", Text), Column("processor", Text), Column("cores", Integer), Column("python", Text),
    Column("commit_name", Text))
VERSIONS = Table(
    "versions", METADATA,
    _owner("run_id", "runs", primary_key=True),
    Column("kind", Text, primary_key=True),  # "engine" or "package"
    Column("name", Text, primary_key=True), _needed("version"))
RESULTS = Table(
    "results", METADATA,
    Column("id", Whole, primary_key=True),
    _owner("run_id", "runs", nullable=False, index=True),
    _needed("scene"), _needed("scene_hash"), _needed("engine"), _needed("method"),
    _needed("form"),  # empty if the engine chose it
    _needed("label"), Column("step", Float), Column("rtol", Float),
    _needed("outcome"), _needed("message"),
    UniqueConstraint("run_id", "scene", "engine", "method", "form", name="one_result_a_cell"))
METRICS = Table(
    "metrics", METADATA,
    _owner("result_id", "results", primary_key=True),
    Column("name", Text, primary_key=True), _needed("unit"), _needed("value", Float),
    Column("deviation", Float),  # as of `crosscheck.document.Speed`
    Column("repeats", Integer),
    Column("rounding", Float))  # changes up to this may be rounding; null: no change is a finding
