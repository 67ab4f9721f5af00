"""The stability map: the largest step at which each method of each engine still gives a usable answer on a scene.

Every search runs in a worker process, and its result is a row. Its runs have two samples, so that any whole number of
steps is possible. A run is usable if it reaches the end with an error against truth below `USABLE`. Because the error
of one run may be small by accident, a step counts only if slightly shorter steps are usable, too.
"""

from __future__ import annotations

import collections
import dataclasses
import math
import operator
import time
from collections.abc import Callable, Sequence

import numpy as np
from msgspec.structs import replace

from crosscheck import adapters, references
from crosscheck.adapters.base import RunSpec
from crosscheck.document import Part, Way, extended
from crosscheck.errors import ArgumentError, Unsupported
from crosscheck.jobs.drive import Crash, Limits, run_tasks
from crosscheck.jobs.workers.process import GIGABYTE
from crosscheck.judge import tolerances
from crosscheck.judge.metrics import attitude_angle, up_to
from crosscheck.judge.plan import natural_time
from crosscheck.references.base import Reference
from crosscheck.running.attempt import Failed, Refused, attempt, lasting
from crosscheck.scene.file import load_scene, scene_names
from crosscheck.scene.model import Scene
from crosscheck.studies.study import STAGE, Ask, StudyDocument, StudyMeta, Work

TAG = "hard"
ALSO = ("single_pendulum", "double_pendulum", "heavy_top")
"""Ordinary scenes, for comparison with the hard ones."""

OWN = "lieeuler"

ADDED = ("pinocchio",)
"""Engines without integrators of their own. Their methods are steppers of this package that use the engine's dynamics.
"""

WAYS = 60
"""Time limit of one search, in time limits of one run. A search makes about forty runs, most of them short."""

PATIENCE = 900.0
"""Shortest time limit (s) of one search. On a busy machine, loading an engine alone takes a minute."""

TRUTH_LIMIT = 1800.0
"""Time limit (s) for the truth of one scene. That of stiff_damped takes about 100 s on an idle machine."""

MEMORY = 4.0 * GIGABYTE

SHADES = (0.95, 0.5, 0.1, 0.01)
"""Bounds of the shades of the map, as shares of the largest step on the scene. The first shade is as good as the best.
"""


USABLE = 0.1
"""Largest end error of a usable run: as a share of the distance that the bodies move, or in rad."""

CLOSE = 1.05
"""The bisection ends when the usable and the unusable step differ by less than this factor, or by one step."""

FINER = (1.15, 1.35)
"""A step counts as usable only if runs with these multiples of its number of steps are usable, too."""

COMMON = 5
"""The common step is the time in which the scene turns or falls by about a radian, divided by this."""


@dataclasses.dataclass(frozen=True)
class Attempt:
    """One run. `outcome` is "usable", "inaccurate", or the name of its failure."""

    steps: int
    outcome: str
    error: float | None  # share of the motion, or rad
    wall_time: float  # s, of stepping; of the whole run if it failed
    message: str = ""


@dataclasses.dataclass(frozen=True)
class Target:
    """The true end of one scene, with which its runs are compared, and the size of its motion."""

    scene: Scene  # two samples
    x: np.ndarray  # (n, 3) true positions at the end
    R: np.ndarray  # (n, 3, 3) true attitudes at the end
    moved: float  # m, largest distance of a body from its start; position errors are divided by it
    attitudes: bool  # whether positions do not depend on attitudes, so that attitude errors count, too


@dataclasses.dataclass(frozen=True)
class Task:
    """One engine and method, in the engine's preferred form, on one scene (a name or a path)."""

    scene: str
    way: Way
    time_limit: float  # s of one run
    step: float | None = None  # s, the common one; None: one that suits the scene
    duration: float | None = None  # s; None: the scene's

    def scene_asked(self) -> Scene:
        """The scene with the wanted duration."""
        scene = load_scene(self.scene)
        return scene.replace(duration=self.duration or scene.duration)

    @property
    def key(self) -> str:
        """The name of the task in its row and in the progress bar."""
        return f"{self.scene} {self.way.engine} {self.way.method}"


class Row(Way, frozen=True, kw_only=True):
    """The result of one task. `outcome` is "usable", "none within the limit", "unsupported" or "failed"."""

    scene: str
    outcome: str = ""
    h_max: float | None = None  # s
    steps: int | None = None
    error: float | None = None  # at h_max
    milliseconds: float | None = None  # of stepping, at h_max
    common_step: float | None = None  # s
    common_outcome: str = ""
    common_error: float | None = None
    failures: str = ""  # outcomes of the unusable runs, and the number of each
    reason: str = ""
    runs: tuple[Attempt, ...] = ()


def target(scene: Scene, truth: Reference) -> Target:
    """The true state at the last sample of a scene that is not past the horizon of its truth."""
    last = int(np.count_nonzero(up_to(truth.t, truth.horizon))) - 1
    if last < 1:
        raise ArgumentError(f"scene {scene.name!r}: chaotic from its first sample on; give it more samples")
    moved = float(np.linalg.norm(truth.states.x[:last + 1] - truth.states.x[0], axis=-1).max())
    moved = moved or tolerances.scales(scene, truth).of("position")  # if nothing moves, use the size of the scene
    tied = scene.joints or any(force.type in ("linear_spring", "constant_force") for force in scene.forces)
    short = scene.replace(duration=float(truth.t[last]), samples=2)
    return Target(short, truth.states.x[last], truth.states.R[last], moved, not tied)


def tried(goal: Target, way: Way, steps: int) -> Attempt:
    """Run with `steps` equal steps. A failure of the run is an outcome, too.

    Raises `Unsupported` if the engine cannot run the scene with this method.
    """
    began = time.perf_counter()
    outcome = lasting(attempt(goal.scene, way, step=goal.scene.duration / steps, monitor=False, derived=False))
    if isinstance(outcome, Refused) or (isinstance(outcome, Failed) and isinstance(outcome.error, ArgumentError)):
        raise outcome.error
    if isinstance(outcome, Failed):
        word = "diverged" if "diverged" in outcome.why else "engine_error"
        return Attempt(steps, word if outcome.status == "failed" else outcome.status, None,
                       time.perf_counter() - began, outcome.why)
    error = end_error(goal, outcome.raw.states.x[-1], outcome.raw.states.R[-1])
    return Attempt(steps, "usable" if error <= USABLE else "inaccurate", error if math.isfinite(error) else None,
                   outcome.raw.wall_time)


def end_error(goal: Target, x: np.ndarray, R: np.ndarray) -> float:
    """Largest position error over `moved`, or attitude error (rad) where positions do not depend on attitudes."""
    error = float(np.linalg.norm(x - goal.x, axis=-1).max()) / goal.moved
    if goal.attitudes:
        error = max(error, float(attitude_angle(R, goal.R).max()))
    return error if math.isfinite(error) else math.inf


class Search:
    """The bisection for one way. It keeps every run."""

    def __init__(self, goal: Target, way: Way, time_limit: float) -> None:
        self._goal, self._way, self._time_limit = goal, way, time_limit
        self.runs: dict[int, Attempt] = {}

    def run(self, steps: int) -> Attempt:
        """The run with this number of steps. It is made only once."""
        if steps not in self.runs:
            self.runs[steps] = tried(self._goal, self._way, steps)
        return self.runs[steps]

    def usable(self, steps: int) -> bool:
        """Whether runs with this number of steps and with the larger numbers of `FINER` are usable."""
        return all(self.run(math.ceil(factor * steps)).outcome == "usable" for factor in (1.0, *FINER))

    def fewest(self) -> int | None:
        """The smallest usable number of steps; None if runs reach the time limit before one is usable."""
        steps = 1
        while not self.usable(steps):
            # Would twice as many steps take longer than the limit? Timed twice, as the machine may have been busy.
            if 2 * self.runs[steps].wall_time > self._time_limit:
                again = tried(self._goal, self._way, steps)
                if 2 * min(again.wall_time, self.runs[steps].wall_time) > self._time_limit:
                    return None
            steps *= 2
        low, high = steps // 2, steps  # unusable (or no step at all), usable
        while high - low > 1 and high > CLOSE * low:
            middle = max(low + 1, min(high - 1, round(math.sqrt(max(low, 1) * high))))
            low, high = (low, middle) if self.usable(middle) else (middle, high)
        return high


def search(task: Task) -> Row:
    """The row of one task, also if the scene is not supported or no step is usable within the time limit."""
    scene = task.scene_asked()
    row = extended(Row, task.way, scene=scene.name)
    common = max(1, math.ceil(scene.duration / (task.step or natural_time(scene) / COMMON)))
    goal = target(scene, references.truth(scene))
    common = max(1, round(common * goal.scene.duration / scene.duration))
    adapter = adapters.get(task.way.engine)
    reason = adapter.unsupported(goal.scene, RunSpec(task.way.method, step=goal.scene.duration / common,
                                                       coordinate_map=task.way.coordinate_map))
    if reason is not None:
        return replace(row, outcome="unsupported", reason=reason)
    hunt = Search(goal, task.way, task.time_limit)
    try:
        shared = hunt.run(common)  # first, because it also loads the engine, which must not count in a search
        fewest = hunt.fewest()
    except Unsupported as error:  # some adapters notice it only when they build the model
        return replace(row, outcome="unsupported", reason=str(error))
    failures = collections.Counter(run.outcome for run in hunt.runs.values() if run.outcome != "usable")
    worst = next((run.message for run in hunt.runs.values() if run.message), "")
    row = replace(
        row, common_step=goal.scene.duration / common, common_outcome=shared.outcome, common_error=shared.error,
        failures=", ".join(f"{name} {count}" for name, count in sorted(failures.items())), reason=worst,
        runs=tuple(hunt.runs[steps] for steps in sorted(hunt.runs)))
    if fewest is None:
        return replace(row, outcome="none within the limit", reason=(
            f"finer runs would take more than {task.time_limit:g} s; {worst}".rstrip("; ")))
    best = hunt.runs[fewest]
    return replace(row, outcome="usable", h_max=goal.scene.duration / fewest, steps=fewest,
                               error=best.error, milliseconds=1e3 * best.wall_time)


class Best(Part, frozen=True, kw_only=True):
    """The largest usable steps (s) on a scene, with engine and method."""

    scene: str
    own: str  # in-house
    own_h_max: float | None
    stock: str  # among other engines with their own integrators
    stock_h_max: float | None
    ratio: float | None  # own_h_max / stock_h_max
    any: str  # among all other engines
    any_h_max: float | None
    ratio_any: float | None  # own_h_max / any_h_max


class Cell(Part, frozen=True, kw_only=True):
    """A cell of the map: an engine and method on a scene. `outcome` is "" if it was not measured."""

    scene: str
    h_max: float | None = None  # s
    shade: int | None = None  # from 0 (as good as the scene's largest step) to len(SHADES)
    common_error: float | None = None
    outcome: str = ""
    reason: str = ""


class MapLine(Way, frozen=True, kw_only=True, omit_defaults=True):
    """A way, with a cell for each scene."""

    cells: list[Cell]


class StabilityDocument(StudyDocument, frozen=True, kw_only=True):
    """stability.json."""

    usable: float  # see `USABLE`
    common: int  # see `COMMON`
    scenes: list[Best]
    map: list[MapLine]
    rows: list[Row]


@dataclasses.dataclass(frozen=True)
class StabilityAsk(Ask):
    """Also the number of worker processes. The default scenes are the hard ones and `ALSO`."""

    time_limit: float = 2.0  # s of one run
    jobs: int = 2
    step: float | None = None  # s, the common step; None: one that suits each scene
    duration: float | None = None  # s; None: the scene's


class Stability:
    """How large can steps be? A killed study continues."""

    name = "stability"
    row_type = Row

    rows = staticmethod(operator.attrgetter("rows"))

    @property
    def scenes(self) -> tuple[str, ...]:
        """Ordinary scenes, then the hard ones."""
        return (*ALSO, *(name for name in scene_names() if TAG in load_scene(name).tags))

    def measure(self, work: Work[StabilityAsk, Row]) -> None:
        """Measure in worker processes: the truth of every scene, so that it is in the cache, then all searches."""
        ask = work.ask
        tasks = [Task(scene, Way.of(engine, method, coordinate_map=chart), ask.time_limit, ask.step, ask.duration)
                 for scene in ask.scenes or self.scenes for engine in work.engines
                 for adapter in [adapters.get(engine)] for chart in [adapter.takes_map(ask.coordinate_map)]
                 for method in adapter.fixed_step_methods if ask.methods is None or method in ask.methods]
        keys = [work.key(load_scene(task.scene), task.way.engine, task) for task in tasks]
        rows: dict[int, Row] = {}

        def kept(index: int, row: Row) -> None:
            rows[index] = row
            work.keep([rows[place] for place in sorted(rows)])
            work.progress(len(rows), len(tasks), tasks[index].key)

        def ended(index: int, result: Row | Crash) -> None:
            if isinstance(result, Crash):  # not put, because the cause may have been a busy machine
                kept(index, extended(Row, tasks[index].way, scene=load_scene(tasks[index].scene).name,
                                     outcome="failed", reason=result.message))
            else:
                kept(index, work.session.put(STAGE, keys[index], result))

        for index, key in enumerate(keys):
            if (row := work.session.get(STAGE, key)) is not None:
                kept(index, row)
        left = [index for index in range(len(tasks)) if index not in rows]
        one_each = list({tasks[index].scene: tasks[index] for index in left}.values())
        lost = run_tasks(prepare, one_each, ask.jobs, lambda place, _: work.progress(
            place + 1, len(one_each), f"truth of {one_each[place].scene}"), Limits(TRUTH_LIMIT, MEMORY))
        for task, crash in zip(one_each, lost, strict=True):
            for index in left:
                if crash is not None and tasks[index].scene == task.scene:
                    ended(index, crash)
        left = [index for index in left if index not in rows]
        run_tasks(search, [tasks[index] for index in left], ask.jobs, lambda place, row: ended(left[place], row),
                  Limits(max(PATIENCE, WAYS * ask.time_limit), MEMORY))

    def document(self, ask: StabilityAsk, meta: StudyMeta, results: list[Row]) -> StabilityDocument:
        """The document with the map, the largest steps on each scene, and every run."""
        return StabilityDocument(study=self.name, meta=replace(meta, jobs=ask.jobs), usable=USABLE, common=COMMON,
                                 scenes=summary(results), map=shaded(results), rows=results)


def prepare(task: Task) -> None:
    """Put the truth of a task's scene into the cache. Raises the errors of `crosscheck.truth`."""
    references.truth(task.scene_asked())


def summary(rows: Sequence[Row]) -> list[Best]:
    """For every scene, the largest steps in-house, among engines with their own integrators, and among all others."""
    lines = []
    for scene in dict.fromkeys(row.scene for row in rows):
        usable = [(row.h_max, row) for row in rows if row.scene == scene and row.h_max is not None]

        def best(theirs: Callable[[str], bool], usable: list[tuple[float, Row]] = usable) -> tuple[str, float | None]:
            step, row = max((pair for pair in usable if theirs(pair[1].engine)), key=lambda pair: pair[0],
                            default=(None, None))
            return "" if row is None else f"{row.engine} {row.method}", step

        own, own_step = best(lambda engine: engine == OWN)
        stock, stock_step = best(lambda engine: engine not in (OWN, *ADDED))
        other, other_step = best(lambda engine: engine != OWN)
        lines.append(Best(
            scene=scene, own=own, own_h_max=own_step, stock=stock, stock_h_max=stock_step, any=other,
            any_h_max=other_step, ratio=own_step / stock_step if own_step and stock_step else None,
            ratio_any=own_step / other_step if own_step and other_step else None))
    return lines


def shaded(rows: Sequence[Row]) -> list[MapLine]:
    """The map: one line per engine and method, with one cell per scene."""
    scenes = list(dict.fromkeys(row.scene for row in rows))
    largest = {scene: max((row.h_max for row in rows if row.scene == scene and row.h_max), default=0.0)
               for scene in scenes}
    lines = {(row.engine, row.method): {scene: Cell(scene=scene) for scene in scenes} for row in rows}
    for row in rows:
        step = row.h_max
        lines[row.engine, row.method][row.scene] = Cell(
            scene=row.scene, h_max=step, common_error=row.common_error, outcome=row.outcome,
            shade=None if step is None else sum(step < share * largest[row.scene] for share in SHADES),
            reason=row.failures or row.reason)
    return [MapLine(engine, method, cells=list(cells.values())) for (engine, method), cells in lines.items()]
