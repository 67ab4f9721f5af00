"""`crosscheck.sweep`: many runs, whose results are stored at once and never computed twice."""

from __future__ import annotations

import contextlib
import dataclasses
import hashlib
import json
import os
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import msgspec
import numpy as np

from crosscheck.document import Origin
from crosscheck.errors import ArgumentError, CrosscheckError, missing
from crosscheck.files import plain, put
from crosscheck.jobs.workers.process import Crash
from crosscheck.running import cluster, provenance, versions
from crosscheck.scene.model import Scene
from crosscheck.sweeps import cells, execution, members, plan, summary
from crosscheck.sweeps.parts import COLUMNS, Parts

if TYPE_CHECKING:
    import pandas as pd

CELLS_PER_TASK = 24
"""Cells in one task, but at least one member. If a worker is lost, so many cells must run again."""

CHECKED = 0.02
"""Share of the members of a start whose truth is compared with a second formulation, but at least one member."""

PER_TASK = 0.05
"""Time (s) for truth and overhead that an estimate adds for every task."""

Progress = Callable[[int, int | None, str], Any]


def sweep(source: Mapping[str, Any] | str | os.PathLike[str], workers: int = 2, scheduler: str | None = None,
          out: str | os.PathLike[str] | None = None, progress: Progress | None = None) -> pd.DataFrame:
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
        Folder of the results. Cells that are in it already are not computed again, so that an interrupted sweep
        continues. Default: a temporary folder.

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
        The scheduler was lost, or a worker has other versions. Finished cells are kept in `out`.
    """
    needed()
    asked = plan.read(source)
    if isinstance(workers, bool) or not isinstance(workers, int) or not 1 <= workers <= 1024:
        raise ArgumentError(f"workers: a whole number from 1 to 1024 is wanted, not {workers!r}")
    if out is not None:
        return _run(asked, workers, scheduler, Path(out), progress or (lambda *_: None))
    with tempfile.TemporaryDirectory() as folder:
        return _run(asked, workers, scheduler, Path(folder), progress or (lambda *_: None))


def needed() -> None:
    """Raise `ArgumentError` if the packages that store the results are missing."""
    try:
        import pandas  # noqa: F401
        import pyarrow  # noqa: F401
    except ImportError as error:
        raise ArgumentError(f"a sweep keeps its results in tables: {missing(error)}") from None


def _run(asked: plan.Plan, workers: int, scheduler: str | None, out: Path, progress: Progress) -> pd.DataFrame:
    engines = tuple(sorted({way.engine for way in asked.ways}))
    place = execution.Local(workers) if scheduler is None else execution.Foreign(cluster.connect(scheduler, engines))
    if asked.timing:
        place.workers = 1
    at_once = True
    try:
        parts = Parts(out)
        run = _Sweep(asked, tuple(versions.of(()).items()), parts.finished(), parts, progress, place.workers)
        try:
            execution.run(run.tasks(), place, run.handle)
            at_once = False
        except CrosscheckError as error:
            raise type(error)(f"{error}; {run.computed} of {asked.cells} cells were computed and are kept in "
                              f"{out}: the same command goes on from there") from None
        finally:
            parts.flush()
    finally:
        place.close(at_once)
    report = run.report()
    frame = _frame(parts.frame(), run.wanted, asked)
    frame.attrs["report"] = plain(report)
    _write(out, asked, frame, report, msgspec.convert(provenance.describe(engines), Origin))
    return frame


def _write(out: Path, asked: plan.Plan, frame: pd.DataFrame, report: summary.Report, meta: Origin) -> None:
    """Write request.json, sweep.json and, if the extra `report` is installed, the page."""
    names = [name for name, _ in asked.parameters]
    put(out / "request.json", json.dumps(asked.source, indent=1))
    put(out / "sweep.json", json.dumps(plain({"meta": meta, "report": report, "parameters": names}), indent=1))
    try:
        import jinja2  # noqa: F401
        import plotly  # noqa: F401
    except ImportError:
        return
    from crosscheck.report.standalone import write_page

    document = plain(summary.document(frame, names, report, meta, str(out)))
    write_page(out, "sweep.html.j2", document=document, meta=document["meta"])


def one(source: Mapping[str, Any] | str | os.PathLike[str], cell: str) -> cells.Row:
    """Run one cell of a sweep again, even if its result is stored, and return its row.

    Raises
    ------
    ArgumentError
        The sweep has no such cell with the installed versions.
    """
    asked = plan.read(source)
    own = tuple(versions.of(()).items())
    for start in members.starts(asked):
        for index, scene in enumerate(members.of_start(start, asked.perturbation)):
            for way in asked.ways:
                if cells.key(scene, way, own, asked.timing) == cell:
                    member = cells.Member(scene, scene, start.origin.name, index, tuple(start.parameters.items()),
                                          (way,), True)
                    return cells.run(cells.Task((member,), own, asked.timing)).rows[0]
    raise ArgumentError(f"--cell {cell}: the sweep has no such cell with the versions of today; keys are in the column "
                        "cell of its parts")


def estimate(source: Mapping[str, Any] | str | os.PathLike[str], out: str | os.PathLike[str] | None,
             workers: int) -> tuple[int, int, float]:
    """Number of cells, number of those without a result in `out`, and the time (s) that these would take.

    For the time, one run is made for every scene and method at its coarsest step, and scaled by the number of steps.
    """
    from crosscheck.running.run import run

    asked = plan.read(source)
    folder = None if out is None else Path(out)
    parts = Parts(folder) if folder is not None and (folder / "parts").is_dir() else None
    own = tuple(versions.of(()).items())
    waiting = _Sweep(asked, own, parts.finished() if parts else set(), None, lambda *_: None, workers)
    per_task = 0.0
    costs: dict[tuple[str, str, str], tuple[float, float]] = {}
    missing = 0
    for task in waiting.tasks():
        per_task += PER_TASK
        for member in task.members:
            for way in member.ways:
                missing += 1
                key = (member.name, way.engine, way.method)
                if key not in costs:
                    coarse = max((other.step or 1.0 for other in asked.ways if other.method == way.method), default=1.0)
                    began = time.perf_counter()
                    with contextlib.suppress(CrosscheckError):  # a failing run takes time, too
                        run(member.scene, way.engine, way.method, step=coarse if way.step else None, rtol=way.rtol,
                            **dict(way.options))
                    costs[key] = time.perf_counter() - began, coarse
                seconds, coarse = costs[key]
                per_task += seconds * (coarse / way.step if way.step else 1.0)
    return asked.cells, missing, per_task / workers


class _Sweep:
    """A running sweep: it makes tasks of the missing cells and stores their results."""

    def __init__(self, asked: plan.Plan, own: tuple[tuple[str, str], ...], finished: set[str], parts: Parts | None,
                 progress: Progress, workers: int) -> None:
        self.asked, self.own, self.parts, self.progress, self.workers = asked, own, parts, progress, workers
        self.wanted: list[str] = []  # keys of all cells, in order
        self.computed = 0
        self._began = time.perf_counter()
        self._truth_seconds = self._run_seconds = 0.0
        self._checked: list[float] = []
        self._trouble: dict[str, None] = {}
        self._taken = finished
        self._missing = 0

    def tasks(self) -> Iterator[cells.Task]:
        """Tasks with the missing cells. Each is made when it is needed."""
        size = max(1, CELLS_PER_TASK // len(self.asked.ways))
        for start in members.starts(self.asked):
            # Drawn by a hash of the start, so that every run of a sweep checks the same members.
            drawn = sorted((hashlib.sha256(f"{start.scene.hash} {index}".encode()).digest(), index)
                           for index in range(self.asked.members))
            checked = {index for _, index in drawn[:max(1, round(CHECKED * len(drawn)))]}
            shared = structure_of(start.scene)
            ready: list[cells.Member] = []
            for index, scene in enumerate(members.of_start(start, self.asked.perturbation)):
                ways = []
                for way in self.asked.ways:  # take those without a result in this folder
                    key = cells.key(scene, way, self.own, self.asked.timing)
                    self.wanted.append(key)
                    if key not in self._taken:
                        self._taken.add(key)
                        ways.append(way)
                self._missing += len(ways)
                if ways:
                    structure = start.scene if structure_of(scene) == shared else scene
                    ready.append(cells.Member(scene, structure, start.origin.name, index,
                                              tuple(start.parameters.items()), tuple(ways), index in checked))
                if len(ready) == size:
                    yield cells.Task(tuple(ready), self.own, self.asked.timing)
                    ready = []
            if ready:
                yield cells.Task(tuple(ready), self.own, self.asked.timing)

    def handle(self, task: cells.Task, result: Any) -> list[cells.Task]:
        """Store the rows of a task. If the task crashed its worker, return its runs as separate tasks."""
        assert self.parts is not None  # None only in an estimate
        if isinstance(result, Crash):
            if isinstance(result.error, CrosscheckError):
                raise result.error
            if task.cells > 1:
                return task.split()
            row = cells.empty_row(task.members[0], task.members[0].ways[0], task)
            self.parts.add([msgspec.structs.replace(row, status="crashed", message=result.message)])
        else:
            self.parts.add(result.rows)
            self._truth_seconds += result.truth_seconds
            self._run_seconds += result.run_seconds
            self._checked += result.checked
            self._trouble |= dict.fromkeys(result.trouble)
        self.computed += task.cells
        kept = len(self.wanted) - self._missing
        left = self.asked.cells - kept - self.computed
        spent = time.perf_counter() - self._began
        self.progress(kept + self.computed, self.asked.cells, f"about {spent / self.computed * left:.0f} s left")
        return []

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
