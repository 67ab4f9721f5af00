"""`crosscheck.sweep`: many runs, whose results are rows of the table and never computed twice.

A folder of results gets them as Parquet in `parts` at the end. What is there already, from an earlier sweep, another
machine or a release that streamed its results there, is put into the table first.
"""

from __future__ import annotations

import contextlib
import dataclasses
import functools
import hashlib
import itertools
import json
import operator
import os
import shlex
import tempfile
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import msgspec
import numpy as np

from crosscheck import adapters
from crosscheck.document import Origin
from crosscheck.errors import ArgumentError, CrosscheckError, needing
from crosscheck.files import digest, plain, put, replacing
from crosscheck.jobs.drive import Crash, Limits, Place, drive
from crosscheck.jobs.table import Session, Table
from crosscheck.report import installed
from crosscheck.report.standalone import page_of
from crosscheck.running import cluster, provenance
from crosscheck.running.attempt import attempt
from crosscheck.scene.model import Scene
from crosscheck.sweeps import cells, members, plan, summary
from crosscheck.sweeps.cells import COLUMNS

if TYPE_CHECKING:
    import pandas as pd

CELLS_PER_TASK = 24
"""Cells in one task, but at least one member. If a worker is lost, so many cells must run again."""

CELLS_PER_LOOK = 960
"""Cells that are looked up in the table at once, of whole members but at least one."""

LIMITS = Limits(time=3600.0, memory=4 * 2**30)

STAGE = "sweep"

CHECKED = 0.02
"""Share of the members of a start whose truth is compared with a second formulation, but at least one member."""

PER_TASK = 0.05
"""Time (s) for truth and overhead that an estimate adds for every task."""

Progress = Callable[[int, int | None, str], object]


def sweep(source: Mapping[str, object] | str | os.PathLike[str], workers: int = 2, scheduler: str | None = None,
          out: str | os.PathLike[str] | None = None, progress: Progress | None = None, fresh: bool | None = None
          ) -> pd.DataFrame:
    """Run every scene with every engine, method, step, parameter and member. Each such run is one row, a cell.

    Parameters
    ----------
    source : dict or path of a TOML file
        The request with the keys scenes, engines, steps and/or rtols, samples, duration, parameters, perturb and
        timing; see docs/sweeps.md.
    workers : int
        Number of worker processes on this machine.
    scheduler : str, optional
        Where to run instead: "tcp://host:port" of a Dask scheduler, or "module:factory" of another executor.
    out : path, optional
        Folder of the results, with the cells as Parquet in `parts`. Cells in it already are not computed again.
    fresh : bool, optional
        Compute again what other commands have put into the table of rows. Default: where CI is set. Times of runs are
        measured anew in any case, unless this sweep was killed, or nothing of it has to be computed.

    Returns
    -------
    pandas.DataFrame
        The columns are cell, scene, engine, version, method, form, step, rtol, member, the parameters by their paths,
        status, errors against truth and constraint levels (largest over the run, SI units), steps, and wall_time (s,
        only if the request asks for timing). Missing values are NaN. Failed runs have rows, too.
        `frame.attrs["report"]` says what was computed and how long it took.

    Raises
    ------
    ArgumentError, SceneError
        The request is wrong. This is checked before anything runs.
    CrosscheckError
        The scheduler was lost, or a worker has other versions. Finished cells are kept in the table.
    """
    needed()
    adapters.renew()
    asked = plan.read(source)
    if isinstance(workers, bool) or not isinstance(workers, int) or not 1 <= workers <= 1024:
        raise ArgumentError(f"workers: a whole number from 1 to 1024 is wanted, not {workers!r}")
    fresh = "CI" in os.environ if fresh is None else fresh
    with contextlib.ExitStack() as stack:
        folder = Path(out if out is not None else stack.enter_context(tempfile.TemporaryDirectory()))
        return _run(asked, workers, scheduler, folder, progress or (lambda *_: None), fresh)


def needed() -> None:
    """Raise `ArgumentError` if the packages that store the results are missing."""
    with needing("a sweep keeps its results in tables"):
        import pandas  # noqa: F401
        import pyarrow  # noqa: F401


def _run(asked: plan.Plan, workers: int, scheduler: str | None, out: Path, progress: Progress, fresh: bool
         ) -> pd.DataFrame:
    engines = tuple(sorted({way.engine for way in asked.ways}))
    own = cells.Code(asked.engines, tuple(provenance.versions(()).items()))
    ask = digest(STAGE, asked.source, own, str(out.resolve()))
    before = _exported(out)
    with contextlib.ExitStack() as stack:
        table = stack.enter_context(contextlib.closing(Table.opened()))
        session = stack.enter_context(table.session(ask, shlex.join(["crosscheck", STAGE, "-o", str(out)]), {
            STAGE: cells.Row}, fresh))
        place = stack.enter_context(Place(1 if asked.timing else workers) if scheduler is None else
                                    cluster.place(scheduler, engines))
        place.workers = 1 if asked.timing else place.workers
        known = _Known(session, before, asked.timing)
        run = _Sweep(asked, own, known.missing, progress, place.workers)
        work = functools.partial(cluster.carrying, {} if scheduler is None else adapters.sources(engines), cells.run)
        try:
            for tasks in (run.tasks(), run.alone()):
                for _, task, result in drive(work, tasks, place, LIMITS, retry=True):
                    known.add(run.rows(task, result))
        except CrosscheckError as error:
            raise type(error)(f"{error}; {run.computed} of {asked.cells} cells were computed and are kept: the same "
                              "command goes on from there") from None
        report = run.report()
        rows = _table(known.rows.values())
    frame = _frame(rows, run.wanted, asked)
    frame.attrs["report"] = plain(report)
    _export(out, rows, before)
    _write(out, asked, frame, report, msgspec.convert(provenance.describe(engines), Origin))
    return frame


class _Known:
    """The rows of a sweep: those of the table, of a folder of results what the table lacks, and what is computed."""

    def __init__(self, session: Session, before: pd.DataFrame, timing: bool) -> None:
        self._session, self._timing, self.rows = session, timing, dict[str, cells.Row]()
        # Times are samples, which no other sweep takes over.
        lasting = before[before["status"] != "crashed"].iloc[:0 if timing else None]
        self._before = {row["cell"]: row for row in lasting.to_dict("records")}

    def missing(self, keys: list[str]) -> set[str]:
        """Those of these cells that have to be computed."""
        kept = self._session.kept(STAGE, keys, "samples" if self._timing else "rows")
        if self._timing and not self._session.left and kept.keys() != set(keys):  # times of one sweep belong together
            kept = {}
        if own := {key: _row(self._before[key]) for key in self._before.keys() & set(keys) - kept.keys()}:
            self._session.put_all(STAGE, own)
        self.rows |= kept | own
        return set(keys) - self.rows.keys()

    def add(self, rows: list[cells.Row]) -> None:
        """Keep the rows of a task; what crashed is not stored, because a busy machine may have been the cause."""
        self.rows |= {row.cell: row for row in rows}
        if lasting := {row.cell: row for row in rows if row.status != "crashed"}:
            self._session.put_all(STAGE, lasting)


def _row(exported: dict[str, Any]) -> cells.Row:
    """A row from its line in a folder of results, where numbers that are missing are NaN."""
    return cells.Row(**exported | {name: None if np.isnan(exported[name]) else exported[name] for name in (
        "step", "rtol")} | {"form": exported["form"] or None})


def _exported(out: Path) -> pd.DataFrame:
    """The cells in a folder of results, which is made if it does not exist."""
    import pandas as pd

    frames = []
    try:
        (out / "parts").mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ArgumentError(f"{out}: cannot be made ({error.strerror or error}); name another folder") from None
    for path in sorted((out / "parts").glob("*.parquet")):
        try:
            frames.append(pd.read_parquet(path, columns=list(COLUMNS)))
        except (OSError, ValueError, KeyError) as error:  # those of pyarrow are ValueErrors
            raise ArgumentError(f"{path}: not a part of a sweep ({error}); remove it") from None
    return pd.concat(frames, ignore_index=True).drop_duplicates("cell") if frames else pd.DataFrame(columns=[*COLUMNS])


def _export(out: Path, rows: pd.DataFrame, before: pd.DataFrame) -> None:
    """Write all cells of the folder into one file, and remove the files of earlier sweeps."""
    import pandas as pd

    others = before[~before["cell"].isin(rows["cell"])]
    frame = pd.concat([each for each in (rows, others) if len(each)], ignore_index=True)
    file = out / "parts" / "cells.parquet"
    try:
        with replacing(file) as aside:
            frame.to_parquet(aside, index=False)
        for path in set(file.parent.glob("*.parquet")) - {file}:
            path.unlink()
    except OSError as error:
        raise ArgumentError(f"{file}: {error.strerror or error}; mend this and start the sweep again, "
                            "nothing has to be computed again") from None


def _table(rows: Iterable[cells.Row]) -> pd.DataFrame:
    """Rows as a table of their fields."""
    import pandas as pd

    named = operator.attrgetter(*COLUMNS)
    return pd.DataFrame(map(named, rows), columns=[*COLUMNS]).fillna({"form": ""}).astype(
        dict.fromkeys(("step", "rtol", *cells.FIGURES, "wall_time"), "float64"))


def _write(out: Path, asked: plan.Plan, frame: pd.DataFrame, report: summary.Report, meta: Origin) -> None:
    """Write request.json, sweep.json and, if the extra `report` is installed, the page."""
    names = [name for name, _ in asked.parameters]
    put(out / "request.json", json.dumps(asked.source, indent=1))
    put(out / "sweep.json", json.dumps(plain({"meta": meta, "report": report, "parameters": names}), indent=1))
    if installed("jinja2", "plotly"):
        document = plain(summary.document(frame, names, report, meta, str(out)))
        page_of(out, "sweep.html.j2", document=document, meta=document["meta"])


def one(source: Mapping[str, object] | str | os.PathLike[str], cell: str) -> cells.Row:
    """Run one cell of a sweep again, even if its result is stored, and return its row.

    Raises
    ------
    ArgumentError
        The sweep has no such cell with the installed versions.
    """
    asked = plan.read(source)
    own = cells.Code(asked.engines, tuple(provenance.versions(()).items()))
    for start in members.starts(asked):
        for index, scene in enumerate(members.of_start(start, asked.perturbation)):
            for key, way in zip(cells.keys(scene, asked.ways, own, asked.timing), asked.ways, strict=True):
                if key == cell:
                    member = cells.Member(scene, scene, start.origin.name, index, tuple(start.parameters.items()),
                                          (way,), True)
                    return cells.run(cells.Task((member,), own, asked.timing)).rows[0]
    raise ArgumentError(f"--cell {cell}: the sweep has no such cell with the versions of today; keys are in the column "
                        "cell of its parts")


def estimate(source: Mapping[str, object] | str | os.PathLike[str], out: str | os.PathLike[str] | None,
             workers: int) -> tuple[int, int, float]:
    """Number of cells, number of those without a result in `out`, and the time (s) that these would take.

    For the time, one run is made for every scene and method at its coarsest step, and scaled by the number of steps.
    """
    asked = plan.read(source)
    own = cells.Code(asked.engines, tuple(provenance.versions(()).items()))
    before = set() if out is None or not (Path(out) / "parts").is_dir() else set(_exported(Path(out))["cell"])
    with contextlib.closing(Table.opened()) as table:
        waiting = list(_Sweep(asked, own, lambda keys: {*keys} - table.holds(STAGE, keys) - before,
                              lambda *_: None, workers).tasks())
    runs = [(member, way) for task in waiting for member in task.members for way in member.ways]
    total, costs = PER_TASK * len(waiting), dict[tuple[str, str, str], tuple[float, float]]()
    for member, way in runs:
        key = (member.name, way.engine, way.method)
        if key not in costs:
            coarse = max((other.step or 1.0 for other in asked.ways if other.method == way.method), default=1.0)
            began = time.perf_counter()
            attempt(member.scene, way, step=coarse if way.step else None)
            costs[key] = time.perf_counter() - began, coarse
        seconds, coarse = costs[key]
        total += seconds * (coarse / way.step if way.step else 1.0)
    return asked.cells, len(runs), total / workers


class _Sweep:
    """A running sweep: it makes tasks of the missing cells and counts what they give."""

    def __init__(self, asked: plan.Plan, own: cells.Code, missing: Callable[[list[str]], set[str]],
                 progress: Progress, workers: int) -> None:
        self.asked, self.own, self.progress, self.workers = asked, own, progress, workers
        self.wanted: list[str] = []  # keys of all cells, in order
        self.computed = 0
        self._began = time.perf_counter()
        self._truth_seconds = self._run_seconds = 0.0
        self._checked: list[float] = []
        self._trouble: dict[str, None] = {}
        self._missing = missing
        self._taken: set[str] = set()  # of the wanted cells, those to be computed
        self._split: list[cells.Task] = []

    def tasks(self) -> Iterator[cells.Task]:
        """Tasks with the missing cells. Each is made when it is needed and has members of one start."""
        size = max(1, CELLS_PER_TASK // len(self.asked.ways))
        for members_ in self._looked_up():
            for position in range(0, len(members_), size):
                yield cells.Task(tuple(members_[position:position + size]), self.own, self.asked.timing)

    def alone(self) -> Iterator[cells.Task]:
        """The runs of those tasks that crashed their workers, each as a task of its own."""
        yield from self._split

    def _looked_up(self) -> Iterator[list[cells.Member]]:
        """Members of one start with the ways that have no row. All cells of a sweep with times are looked up at once,
        because the times of one sweep belong together.
        """
        most = None if self.asked.timing else max(1, CELLS_PER_LOOK // len(self.asked.ways))
        drawn = self._members()
        while look := list(itertools.islice(drawn, most)):
            keys = [cells.keys(member.scene, self.asked.ways, self.own, self.asked.timing) for _, member in look]
            self.wanted += (every := list(itertools.chain(*keys)))
            missing = self._missing(every)
            for _, group in itertools.groupby(zip(look, keys, strict=True), key=lambda pair: pair[0][0]):
                ready = []
                for (_, member), own in group:
                    lacking = {key: way for key, way in zip(own, self.asked.ways, strict=True)
                               if key in missing and key not in self._taken}
                    self._taken |= lacking.keys()
                    if lacking:
                        ready.append(dataclasses.replace(member, ways=tuple(lacking.values())))
                yield ready

    def _members(self) -> Iterator[tuple[int, cells.Member]]:
        """(number of the start, member with all ways) of the whole sweep."""
        for number, start in enumerate(members.starts(self.asked)):
            # Drawn by a hash of the start, so that every run of a sweep checks the same members.
            own = start.scene.hash
            drawn = sorted((hashlib.sha256(f"{own} {index}".encode()).digest(), index)
                           for index in range(self.asked.members))
            checked = {index for _, index in drawn[:max(1, round(CHECKED * len(drawn)))]}
            shared = structure_of(start.scene)
            for index, scene in enumerate(members.of_start(start, self.asked.perturbation)):
                structure = start.scene if structure_of(scene) == shared else scene
                yield number, cells.Member(scene, structure, start.origin.name, index, tuple(start.parameters.items()),
                                           self.asked.ways, index in checked)

    def rows(self, task: cells.Task, result: cells.Done | Crash) -> list[cells.Row]:
        """The rows that a task gave. There are none if it crashed its worker and its runs are to be tried `alone`."""
        if isinstance(result, Crash):
            if isinstance(error := result.error(), CrosscheckError):
                raise error
            if task.cells > 1:
                self._split += task.split()
                return []
            row, = cells.empty_rows(task.members[0], task)
            rows = [msgspec.structs.replace(row, status="crashed", message=result.message)]
        else:
            rows = result.rows
            self._truth_seconds += result.truth_seconds
            self._run_seconds += result.run_seconds
            self._checked += result.checked
            self._trouble |= dict.fromkeys(result.trouble)
        self.computed += task.cells
        kept = len(self.wanted) - len(self._taken)
        left = self.asked.cells - kept - self.computed
        spent = time.perf_counter() - self._began
        self.progress(kept + self.computed, self.asked.cells, f"about {spent / self.computed * left:.0f} s left")
        return rows

    def report(self) -> summary.Report:
        """What has been done so far."""
        seconds = time.perf_counter() - self._began
        idle = max(0.0, seconds * self.workers - self._truth_seconds - self._run_seconds)
        return summary.Report(
            cells=self.asked.cells, workers=self.workers, computed=self.computed, seconds=seconds,
            truth_seconds=self._truth_seconds, run_seconds=self._run_seconds, disagreements=tuple(self._checked),
            trouble=tuple(self._trouble), overhead=idle / max(1, self.computed))


def structure_of(scene: Scene) -> str:
    """Digest of a scene without its initial state."""
    zero = np.zeros(3)
    fixed = scene.replace(bodies=tuple(
        dataclasses.replace(body, attitude=np.eye(4)[0], angular_velocity=zero, position=zero, velocity=zero)
        for body in scene.bodies))
    return str(fixed.hash)


def _frame(rows: pd.DataFrame, wanted: list[str], asked: plan.Plan) -> pd.DataFrame:
    """The cells of this sweep in its order, with the parameters as columns."""
    names = [name for name, _ in asked.parameters]
    frame = rows.set_index("cell").reindex(wanted).reset_index()
    values = [json.loads(text) for text in frame["parameters"]]
    for name in names:
        frame[name] = [value.get(name) for value in values]
    split = COLUMNS.index("parameters")
    return frame[[*COLUMNS[:split], *names, *COLUMNS[split + 1:-1]]]
