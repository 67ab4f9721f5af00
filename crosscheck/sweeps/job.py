"""`crosscheck.sweep`: many runs, kept as they come, never computed twice."""

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

import numpy as np

from crosscheck.errors import ArgumentError, CrosscheckError, missing
from crosscheck.files import finite, put
from crosscheck.jobs.workers.process import Crash
from crosscheck.running import cluster, provenance, versions
from crosscheck.scene.model import Scene
from crosscheck.sweeps import cells, execution, members, plan
from crosscheck.sweeps.parts import COLUMNS, Parts

if TYPE_CHECKING:
    import pandas as pd

CELLS_PER_TASK = 24
"""Cells that a worker is sent at once, at least one member: what the loss of a worker costs."""

CHECKED = 0.02
"""Share of the members of a structure whose truth is compared with a second formulation; one at least."""

PER_TASK = 0.05
"""s of truth and overhead that an estimate counts for every task."""

Progress = Callable[[int, int | None, str], Any]


@dataclasses.dataclass
class Report:
    """What a sweep did."""

    cells: int
    workers: int
    computed: int = 0
    seconds: float = 0.0
    truth_seconds: float = 0.0  # of all workers together
    run_seconds: float = 0.0
    disagreements: list[float] = dataclasses.field(default_factory=list)
    trouble: list[str] = dataclasses.field(default_factory=list)

    @property
    def overhead(self) -> float:
        """s per computed cell that were neither truth nor runs, on one worker."""
        busy = self.truth_seconds + self.run_seconds
        return max(0.0, self.seconds * self.workers - busy) / max(1, self.computed)


def sweep(source: Mapping[str, Any] | str | os.PathLike[str], workers: int = 2, scheduler: str | None = None,
          out: str | os.PathLike[str] | None = None, progress: Progress | None = None) -> pd.DataFrame:
    """Run every scene with every engine, method, step, parameter and member; one row a cell.

    Parameters
    ----------
    source : dict or path of a TOML file
        scenes, engines, steps and/or rtols, samples, duration, parameters, perturb, timing; see docs/sweeps.md.
    workers : int
        Processes of this machine.
    scheduler : str, optional
        In their place: tcp://host:port of a Dask scheduler, or module:factory of another executor.
    out : path, optional
        Folder of the results. Cells that any sweep has finished there are not computed again; a sweep that was
        interrupted goes on. Default: a folder that is removed in the end.

    Returns
    -------
    pandas.DataFrame
        Columns cell, scene, engine, version, method, form, step, rtol, member, the parameters by their paths, status,
        errors against truth and constraint levels (largest over the run, SI; NaN where there is no truth), steps,
        wall_time (s, NaN unless the sweep asks for timing). Failed runs are rows. `frame.attrs["report"]` says what was
        computed and how long it took.

    Raises
    ------
    ArgumentError, SceneError
        What is wrong in the sweep, before anything runs.
    CrosscheckError
        The scheduler was lost, or a worker has other versions; what was finished is kept in `out`.
    """
    needed()
    asked = plan.read(source)
    if isinstance(workers, bool) or not isinstance(workers, int) or not 1 <= workers <= 1024:
        raise ArgumentError(f"workers: a whole number from 1 to 1024 is wanted, not {workers!r}")
    if out is not None:
        return _run(asked, workers, scheduler, Path(out), progress or _silent)
    with tempfile.TemporaryDirectory() as folder:
        return _run(asked, workers, scheduler, Path(folder), progress or _silent)


def needed() -> None:
    """Refuse to start without what keeps the results."""
    try:
        import pandas  # noqa: F401
        import pyarrow  # noqa: F401
    except ImportError as error:
        raise ArgumentError(f"a sweep keeps its results in tables: {missing(error)}") from None


def _silent(done: int, total: int | None, label: str) -> None:
    return None


def _run(asked: plan.Plan, workers: int, scheduler: str | None, out: Path, progress: Progress) -> pd.DataFrame:
    engines = tuple(sorted({way.engine for way in asked.ways}))
    place = execution.Local(workers) if scheduler is None else execution.Foreign(cluster.connect(scheduler, engines))
    if asked.timing:
        place.workers = 1
    at_once = True
    try:
        parts = Parts(out)
        run = _Sweep(asked, tuple(versions.of(()).items()), parts.finished(), parts, progress,
                     Report(asked.cells, place.workers))
        try:
            execution.run(run.tasks(), place, run.handle)
            at_once = False
        except CrosscheckError as error:
            raise type(error)(f"{error}; {run.report.computed} of {asked.cells} cells were computed and are kept in "
                              f"{out}: the same command goes on from there") from None
        finally:
            parts.flush()
    finally:
        place.close(at_once)
    run.report.seconds = time.perf_counter() - run.began
    frame = _frame(parts.frame(), run.wanted, asked)
    frame.attrs["report"] = dataclasses.asdict(run.report) | {"overhead": run.report.overhead}
    _write(out, asked, frame, provenance.describe(engines))
    return frame


def _write(out: Path, asked: plan.Plan, frame: pd.DataFrame, meta: provenance.Provenance) -> None:
    """request.json, sweep.json and, where the extra `report` is there, the page."""
    from crosscheck.sweeps import summary

    names = [name for name, _ in asked.parameters]
    report = frame.attrs["report"]
    put(out / "request.json", json.dumps(asked.source, indent=1))
    put(out / "sweep.json", json.dumps({"meta": meta, "report": report, "parameters": names}, indent=1))
    try:
        import jinja2  # noqa: F401
        import plotly  # noqa: F401
    except ImportError:
        return
    from crosscheck.report.standalone import write_page

    document = finite(summary.document(frame, names, report, meta, str(out)))
    write_page(out, "sweep.html.j2", document=document, meta=meta)


def one(source: Mapping[str, Any] | str | os.PathLike[str], cell: str) -> dict[str, Any]:
    """Run one cell of a sweep again, whatever is stored, and return its row.

    Raises
    ------
    ArgumentError
        The sweep has no such cell, with these versions.
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
    """Number of cells, of those not yet computed in `out`, and seconds that they would take.

    The time is that of one run for every scene and way, the coarsest of its steps, scaled by the number of steps.
    """
    from crosscheck.running.run import run

    asked = plan.read(source)
    folder = None if out is None else Path(out)
    parts = Parts(folder) if folder is not None and (folder / "parts").is_dir() else None
    own = tuple(versions.of(()).items())
    report = Report(asked.cells, workers)
    waiting = _Sweep(asked, own, parts.finished() if parts else set(), None, _silent, report)
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
                    with contextlib.suppress(Exception):  # a run that fails costs something too
                        run(member.scene, way.engine, way.method, step=coarse if way.step else None, rtol=way.rtol,
                            **dict(way.options))
                    costs[key] = time.perf_counter() - began, coarse
                seconds, coarse = costs[key]
                per_task += seconds * (coarse / way.step if way.step else 1.0)
    return asked.cells, missing, per_task / workers


class _Sweep:
    """A sweep under way: hands out what is missing and keeps what comes back."""

    def __init__(self, asked: plan.Plan, own: tuple[tuple[str, str], ...], finished: set[str], parts: Parts | None,
                 progress: Progress, report: Report) -> None:
        self.asked, self.own, self.parts, self.progress, self.report = asked, own, parts, progress, report
        self.began = time.perf_counter()
        self.wanted: list[str] = []  # keys of all cells, in order
        self._taken = finished
        self._missing = 0

    def tasks(self) -> Iterator[cells.Task]:
        """The missing cells, made as they are asked for."""
        size = max(1, CELLS_PER_TASK // len(self.asked.ways))
        for start in members.starts(self.asked):
            checked = _sample(start.scene.hash, self.asked.members)
            shared = structure_of(start.scene)
            ready: list[cells.Member] = []
            for index, scene in enumerate(members.of_start(start, self.asked.perturbation)):
                ways = self._missing_ways(scene)
                if ways:
                    structure = start.scene if structure_of(scene) == shared else scene
                    ready.append(cells.Member(scene, structure, start.origin.name, index,
                                              tuple(start.parameters.items()), ways, index in checked))
                if len(ready) == size:
                    yield cells.Task(tuple(ready), self.own, self.asked.timing)
                    ready = []
            if ready:
                yield cells.Task(tuple(ready), self.own, self.asked.timing)

    def _missing_ways(self, scene: Scene) -> tuple[plan.Way, ...]:
        """The ways of a member that no sweep has run in this folder."""
        missing = []
        for way in self.asked.ways:
            key = cells.key(scene, way, self.own, self.asked.timing)
            self.wanted.append(key)
            if key not in self._taken:
                self._taken.add(key)
                missing.append(way)
        self._missing += len(missing)
        return tuple(missing)

    def handle(self, task: cells.Task, result: Any) -> list[cells.Task]:
        """Keep the rows of a task. One that took its worker with it is run again, each of its runs alone."""
        report = self.report
        assert self.parts is not None  # only an estimate has none
        if isinstance(result, Crash):
            if isinstance(result.error, CrosscheckError):
                raise result.error
            if task.cells > 1:
                return task.split()
            self.parts.add(_crashed(task, result))
        else:
            self.parts.add(result.rows)
            report.truth_seconds += result.truth_seconds
            report.run_seconds += result.run_seconds
            report.disagreements += result.checked
            report.trouble += [text for text in result.trouble if text not in report.trouble]
        report.computed += task.cells
        kept = len(self.wanted) - self._missing
        left = report.cells - kept - report.computed
        spent = time.perf_counter() - self.began
        self.progress(kept + report.computed, report.cells, f"about {spent / report.computed * left:.0f} s left")
        return []


def structure_of(scene: Scene) -> str:
    """Digest of all of a scene but its initial state."""
    zero = np.zeros(3)
    fixed = scene.replace(bodies=tuple(
        dataclasses.replace(body, attitude=np.eye(4)[0], angular_velocity=zero, position=zero, velocity=zero)
        for body in scene.bodies))
    return str(fixed.hash)


def _sample(seed: str, count: int) -> set[int]:
    """The members whose truth is checked: drawn by the content of the start, so that every run checks the same."""
    number = max(1, round(CHECKED * count))
    ranked = sorted(range(count), key=lambda index: hashlib.sha256(f"{seed} {index}".encode()).digest())
    return set(ranked[:number])


def _crashed(task: cells.Task, crash: Crash) -> list[dict[str, Any]]:
    """The row of a run that took its worker with it."""
    member, way = task.members[0], task.members[0].ways[0]
    return [cells.empty_row(member, way, task) | {"status": "crashed", "message": crash.message}]


def _frame(rows: pd.DataFrame, wanted: list[str], asked: plan.Plan) -> pd.DataFrame:
    """The cells of this sweep in its own order, parameters as columns."""
    names = [name for name, _ in asked.parameters]
    frame = rows.set_index("cell").reindex(wanted).reset_index()
    values = [json.loads(text) for text in frame["parameters"]]
    for name in names:
        frame[name] = [value.get(name) for value in values]
    split = COLUMNS.index("parameters")
    return frame[[*COLUMNS[:split], *names, *COLUMNS[split + 1:-1]]]
