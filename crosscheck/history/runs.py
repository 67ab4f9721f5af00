"""The history of runs in a database, an SQLite file by default, or a PostgreSQL server: write runs and read them.

It keeps every run for good, in tables that users query (docs/nightly.md); rows of `crosscheck.jobs.table` are a cache.
"""

from __future__ import annotations

import dataclasses
import json
import os
import statistics
from collections.abc import Iterable
from pathlib import Path
from typing import Any, NamedTuple

import sqlalchemy as sql

from crosscheck.document import Document
from crosscheck.errors import ArgumentError, unknown
from crosscheck.history.figures import Figure, figures
from crosscheck.history.schema import ENVIRONMENTS, METADATA, METRICS, RESULTS, RUNS, VERSIONS
from crosscheck.jobs.database import database
from crosscheck.verification.speed import spread

CellKey = tuple[str, str, str, str]
"""Scene, engine, method, form ("" if the engine chose it)."""

EMPTY = ("the store has no run yet: `crosscheck nightly` makes one, `crosscheck history add reports/latest` takes in "
         "one of `crosscheck verify`")

DEFAULT = Path("reports/history.sqlite")
"""The store if none is named, relative to the current folder."""

KEY = ("scene", "engine", "method", "form")
"""Columns of a `CellKey`."""

HEADING = [column.name for column in RUNS.c if column.name != "id"]
NEWEST = RUNS.c.started.desc(), RUNS.c.id.desc()


@dataclasses.dataclass(frozen=True)
class StoredResult:
    """One cell of one run."""

    key: CellKey
    scene_hash: str
    label: str
    step: float | None  # s
    rtol: float | None
    outcome: str
    message: str
    figures: dict[str, Figure]


OF_RESULT = [field.name for field in dataclasses.fields(StoredResult)][1:-1]


@dataclasses.dataclass(frozen=True)
class Environment:
    """Where a run was made. Unknown values are None."""

    system: str | None = None
    processor: str | None = None
    cores: int | None = None
    python: str | None = None
    commit: str | None = None


@dataclasses.dataclass(frozen=True)
class StoredRun:
    """One run. `results` is empty if only the heading was read."""

    name: str
    started: str  # UTC, ISO 8601
    profile: str
    selection: str
    command: str
    seconds: float | None
    exit_code: int
    good: bool
    calibration: float | None  # us
    environment: Environment
    versions: dict[str, dict[str, str]]  # "engine" and "package": version by name
    results: dict[CellKey, StoredResult] = dataclasses.field(default_factory=dict)


def open_store(where: str | Path | None = None) -> sql.Engine:
    """Open the store at `where`. If needed, it is made.

    `where` is as in `crosscheck.jobs.database.database`; None: the environment variable CROSSCHECK_STORE, or else
    `DEFAULT`. Raises `ArgumentError` if it cannot be used or is not a store of crosscheck.
    """
    return database(where or os.environ.get("CROSSCHECK_STORE") or DEFAULT, "--store", METADATA)


def run_from_document(name: str, document: Document, good: bool = False) -> StoredRun:
    """The run of a document."""
    meta = document.meta
    machine = meta.machine
    scenes = {scene.name: scene for scene in document.scenes}
    results = {}
    for record in document.records:
        form = "" if record.default_form else record.form or ""
        key = (record.scene, record.engine, record.method, form)
        scene = scenes[record.scene]
        results[key] = StoredResult(key, scene.hash, record.label, record.step, record.rtol,
                                    record.outcome, record.message,
                                    {figure.name: figure for figure in figures(record, scene)})
    environment = Environment(machine.system, machine.processor, machine.cores, meta.python, meta.commit)
    # meta.time, "2026-11-21 02:00 UTC", as ISO 8601
    started = meta.started or meta.time.removesuffix(" UTC").replace(" ", "T") + ":00+00:00"
    selection = json.dumps([sorted(scenes), sorted(meta.engines), *meta.asked.words])
    return StoredRun(name, started, meta.profile, selection, meta.command,
                     meta.seconds, document.exit_code, good, meta.calibration.us if meta.calibration else None,
                     environment, {"engine": dict(meta.engines), "package": dict(meta.packages)}, results)


def save(store: sql.Engine, run: StoredRun) -> bool:
    """Write a run in one transaction. Returns False, and changes nothing, if the store has a run of this name."""
    try:
        with store.execution_options(writes=True).begin() as connection:
            if _id(connection, run.name) is not None:
                return False
            _insert(connection, run)
    except sql.exc.IntegrityError:
        with store.connect() as connection:
            if _id(connection, run.name) is not None:  # another process wrote it meanwhile
                return False
        raise
    return True


def _id(connection: sql.Connection, name: str) -> int | None:
    return connection.execute(sql.select(RUNS.c.id).where(RUNS.c.name == name)).scalar()


def _insert(connection: sql.Connection, run: StoredRun) -> None:
    done = connection.execute(RUNS.insert().values(_named(run, HEADING)))
    (number,) = done.inserted_primary_key or (None,)
    place = dataclasses.asdict(run.environment)
    connection.execute(ENVIRONMENTS.insert(), {"run_id": number, "commit_name": place.pop("commit"), **place})
    versions = [{"run_id": number, "kind": kind, "name": name, "version": version}
                for kind, each in run.versions.items() for name, version in each.items()]
    if versions:
        connection.execute(VERSIONS.insert(), versions)
    rows = [{"run_id": number, **dict(zip(KEY, result.key, strict=True)),
             **_named(result, OF_RESULT)} for result in run.results.values()]
    if not rows:
        return
    own = connection.execute(RESULTS.insert().returning(RESULTS.c.id, sort_by_parameter_order=True), rows)
    metrics = [{"result_id": own_id, **figure._asdict()}
               for own_id, result in zip(own.scalars(), run.results.values(), strict=True)
               for figure in result.figures.values()]
    if metrics:
        connection.execute(METRICS.insert(), metrics)


def recent(store: sql.Engine, limit: int = 20) -> list[StoredRun]:
    """The headings of the last runs, the newest first."""
    with store.connect() as connection:
        rows = connection.execute(sql.select(RUNS).order_by(*NEWEST).limit(limit)).all()
        return [_heading(connection, row) for row in rows]


def find(store: sql.Engine, name: str) -> str:
    """The full name of a run, given by its name, by an unambiguous beginning of it, or as "latest".

    Raises `ArgumentError` if no run or several runs fit.
    """
    with store.connect() as connection:
        names: list[str] = list(connection.execute(sql.select(RUNS.c.name).order_by(*NEWEST)).scalars())
    if name == "latest" and names:
        return names[0]
    fitting = [each for each in names if each == name] or [each for each in names if each.startswith(name)]
    if len(fitting) != 1:
        few = names[:10]
        raise ArgumentError(f"run {name!r}: several begin so: {', '.join(fitting[:10])}" if fitting else
                            unknown("run", name, ["latest", *few]) if few else EMPTY)
    return fitting[0]


def load(store: sql.Engine, name: str) -> StoredRun:
    """A run with all its results. Raises `ArgumentError` if there is none of this name."""
    with store.connect() as connection:
        row = connection.execute(sql.select(RUNS).where(RUNS.c.name == name)).first()
        if row is None:
            raise ArgumentError(f"run {name!r} is not in the store")
        results, kept = {}, {}
        for each in connection.execute(sql.select(RESULTS).where(RESULTS.c.run_id == row.id).order_by(RESULTS.c.id)):
            key = cell_of(each)
            kept[each.id] = results[key] = StoredResult(key, figures={}, **_named(each, OF_RESULT))
        for each in connection.execute(sql.select(METRICS).join(RESULTS).where(RESULTS.c.run_id == row.id)):
            kept[each.result_id].figures[each.name] = figure_of(each)
        return dataclasses.replace(_heading(connection, row), results=results)


def cell_of(row: sql.Row[Any]) -> CellKey:
    """The cell of a row of results."""
    return row.scene, row.engine, row.method, row.form


def figure_of(row: sql.Row[Any]) -> Figure:
    """The figure in a row of metrics."""
    return Figure(**_named(row, Figure._fields))


def _named(whole: object, names: Iterable[str]) -> dict[str, Any]:
    return {name: getattr(whole, name) for name in names}


def _heading(connection: sql.Connection, row: sql.Row[Any]) -> StoredRun:
    place = connection.execute(sql.select(ENVIRONMENTS).where(ENVIRONMENTS.c.run_id == row.id)).first()
    environment = Environment() if place is None else Environment(place.system, place.processor, place.cores,
                                                                  place.python, place.commit_name)
    versions: dict[str, dict[str, str]] = {"engine": {}, "package": {}}
    for each in connection.execute(sql.select(VERSIONS).where(VERSIONS.c.run_id == row.id)):
        versions.setdefault(each.kind, {})[each.name] = each.version
    return StoredRun(environment=environment, versions=versions, **_named(row, HEADING))


def baseline(store: sql.Engine, run: StoredRun) -> StoredRun | None:
    """The run to compare with: the last good run before `run` with the same profile, scenes and engines.

    If none of these is good, it is the last one. None if there is none at all.
    """
    wanted = (sql.select(RUNS.c.name)
              .where(RUNS.c.profile == run.profile, RUNS.c.selection == run.selection, RUNS.c.name != run.name,
                     RUNS.c.started <= run.started)
              .order_by(RUNS.c.good.desc(), *NEWEST).limit(1))
    with store.connect() as connection:
        name = connection.execute(wanted).scalar()
    return None if name is None else load(store, name)


def set_good(store: sql.Engine, name: str, good: bool = True) -> None:
    """Mark a run as good, so that later runs are compared with it, or as not good."""
    with store.execution_options(writes=True).begin() as connection:
        connection.execute(RUNS.update().where(RUNS.c.name == name).values(good=good))


def _is_cell(key: CellKey) -> list[sql.ColumnElement[bool]]:
    """The conditions for rows of results of this cell."""
    return [RESULTS.c[name] == value for name, value in zip(KEY, key, strict=True)]


def series(store: sql.Engine, metric: str, key: CellKey, limit: int = 200) -> list[tuple[StoredRun, Figure]]:
    """One value of one cell in the last runs, the oldest first."""
    wanted = (sql.select(METRICS, RUNS.c.id).select_from(METRICS.join(RESULTS).join(RUNS))
              .where(*_is_cell(key), METRICS.c.name == metric).order_by(*NEWEST).limit(limit))
    with store.connect() as connection:
        found = [(row.id, figure_of(row)) for row in connection.execute(wanted)][::-1]
        runs = {row.id: row for row in connection.execute(sql.select(RUNS).where(RUNS.c.id.in_(n for n, _ in found)))}
        return [(_heading(connection, runs[number]), figure) for number, figure in found]


class Usual(NamedTuple):
    """The usual value of a cell in earlier good runs, and its deviation between runs."""

    level: float
    deviation: float  # median absolute deviation


LEVEL_RUNS = 5
"""The level is the median of this many of the newest runs. One odd night changes it little; three nights move it."""


def usual(store: sql.Engine, run: StoredRun, metric: str, limit: int = 10, fewest: int = 4) -> dict[CellKey, Usual]:
    """Level and spread of one value of every cell over the last good runs that are comparable with `run`.

    Comparable runs have the same profile, scenes and engines; comparable cells have the same scene file, step and
    tolerance. Cells with fewer than `fewest` values are left out. A run with findings that was marked as good begins a
    new level: older runs do not count.
    """
    with store.connect() as connection:
        last = connection.execute(
            sql.select(RUNS.c.id, RUNS.c.exit_code)
            .where(RUNS.c.profile == run.profile, RUNS.c.selection == run.selection, RUNS.c.good,
                   RUNS.c.name != run.name, RUNS.c.started <= run.started)
            .order_by(*NEWEST).limit(limit)).all()
        accepted = next((index for index, each in enumerate(last) if each.exit_code == 1), limit)
        numbers = [each.id for each in last[:accepted + 1]]
        rows = connection.execute(sql.select(RESULTS, METRICS.c.value).join(METRICS).where(
            RESULTS.c.run_id.in_(numbers), METRICS.c.name == metric)).all()
    values: dict[CellKey, list[float]] = {}  # the newest first
    for row in sorted(rows, key=lambda row: numbers.index(row.run_id)):
        key = cell_of(row)
        now = run.results.get(key)
        if now is not None and (row.scene_hash, row.step, row.rtol) == (now.scene_hash, now.step, now.rtol):
            values.setdefault(key, []).append(row.value)
    return {key: Usual(statistics.median(each[:LEVEL_RUNS]), spread(each))
            for key, each in values.items() if len(each) >= fewest}


def figure_names(store: sql.Engine, key: CellKey) -> list[str]:
    """Names of the values that the store has of a cell."""
    wanted = (sql.select(METRICS.c.name).distinct().join(RESULTS).order_by(METRICS.c.name)
              .where(*_is_cell(key)))
    with store.connect() as connection:
        return list(connection.execute(wanted).scalars())


def outcomes(store: sql.Engine, key: CellKey, limit: int = 200) -> list[tuple[str, str]]:
    """(name of the run, outcome) of one cell in the last runs, the oldest first."""
    wanted = (sql.select(RUNS.c.name, RESULTS.c.outcome).join(RESULTS, RESULTS.c.run_id == RUNS.c.id)
              .where(*_is_cell(key)).order_by(*NEWEST).limit(limit))
    with store.connect() as connection:
        return [(name, outcome) for name, outcome in connection.execute(wanted)][::-1]
