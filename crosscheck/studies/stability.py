"""The stability map: the largest usable step of every engine and method on every scene.

Every search (`crosscheck.studies.bisection`) runs in a worker process, and its result is a row.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from typing import Any

import msgspec

from crosscheck import adapters as all_engines
from crosscheck import references
from crosscheck.document import Part, Way, extended
from crosscheck.jobs.drive import Crash, Limits, run_tasks
from crosscheck.jobs.table import Session
from crosscheck.jobs.workers.process import GIGABYTE
from crosscheck.scene.file import load_scene, scene_names
from crosscheck.studies.bisection import COMMON, USABLE, Row, Task, search
from crosscheck.studies.study import STAGE, Ask, Progress, StudyDocument, StudyMeta, Work

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

    usable: float  # see `bisection.USABLE`
    common: int  # see `bisection.COMMON`
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

    def scenes(self) -> tuple[str, ...]:
        """Ordinary scenes, then the hard ones."""
        return (*ALSO, *hard_scenes())

    def measure(self, work: Work[StabilityAsk, Row]) -> None:
        """Measure in worker processes."""
        ask = work.ask
        tasks = [Task(scene, Way.of(engine, method, coordinate_map=chart), ask.time_limit, ask.step, ask.duration)
                for scene in ask.scenes or self.scenes() for engine in work.engines
                for adapter in [all_engines.get(engine)] for chart in [adapter.takes_map(ask.coordinate_map)]
                for method in adapter.fixed_step_methods if ask.methods is None or method in ask.methods]
        keys = [work.key(load_scene(task.scene), task.way.engine, task) for task in tasks]
        found: list[Row | None] = [None] * len(tasks)

        def kept(index: int, row: Row) -> None:
            found[index] = row
            rows = [each for each in found if each is not None]
            work.keep(rows)
            work.progress(len(rows), len(tasks), tasks[index].key)

        _search_all(tasks, keys, ask, work.session, kept, work.progress)

    def document(self, ask: StabilityAsk, meta: StudyMeta, results: list[Row]) -> StabilityDocument:
        """The document with the map, the largest steps on each scene, and every run."""
        return StabilityDocument(study=self.name, meta=msgspec.structs.replace(meta, jobs=ask.jobs), usable=USABLE,
                                 common=COMMON, scenes=summary(results), map=shaded(results), rows=results)

    def rows(self, document: StabilityDocument) -> list[Row]:
        """One line per search."""
        return document.rows


def _search_all(tasks: list[Task], keys: list[str], ask: StabilityAsk, session: Session,
                keep: Callable[[int, Row], None], progress: Progress) -> None:
    """Give the row of every task to `keep`. Those in the table are not computed again."""
    open_tasks = []
    for index in range(len(tasks)):
        row = session.get(STAGE, keys[index])
        if row is None:
            open_tasks.append(index)
        else:
            keep(index, row)
    one_each = {tasks[index].scene: tasks[index] for index in open_tasks}
    untrue = _without_truth(list(one_each.values()), ask.jobs, progress)
    for index in open_tasks:
        if (reason := untrue.get(tasks[index].scene)) is not None:
            keep(index, _failed(tasks[index], reason))
    open_tasks = [index for index in open_tasks if tasks[index].scene not in untrue]

    def done(place: int, row: Any) -> None:
        task = tasks[open_tasks[place]]
        if isinstance(row, Crash):  # not kept, because the cause may have been a busy machine
            keep(open_tasks[place], _failed(task, row.message))
        else:
            keep(open_tasks[place], session.put(STAGE, keys[open_tasks[place]], row))

    run_tasks(search, [tasks[index] for index in open_tasks], ask.jobs, done,
              Limits(max(PATIENCE, WAYS * ask.time_limit), MEMORY))


def _failed(task: Task, reason: str) -> Row:
    return extended(Row, task.way, scene=load_scene(task.scene).name, outcome="failed", reason=reason)


def _without_truth(tasks: list[Task], jobs: int, progress: Progress) -> dict[str, str]:
    """Compute the truth of every scene, so that it is in the cache. Returns the scenes without truth, and why.

    `tasks` has one task per scene.
    """
    untrue: dict[str, str] = {}

    def done(place: int, result: Any) -> None:
        if isinstance(result, Crash):
            untrue[tasks[place].scene] = result.message
        progress(place + 1, len(tasks), f"truth of {tasks[place].scene}")

    run_tasks(prepare, tasks, jobs, done, Limits(TRUTH_LIMIT, MEMORY))
    return untrue


def prepare(task: Task) -> None:
    """Put the truth of a task's scene into the cache. Raises the errors of `crosscheck.truth`."""
    references.truth(task.scene_asked())


def hard_scenes() -> tuple[str, ...]:
    """Names of the built-in scenes with the tag "hard"."""
    return tuple(name for name in scene_names() if TAG in load_scene(name).tags)


def summary(rows: Sequence[Row]) -> list[Best]:
    """For every scene, the largest steps in-house, among engines with their own integrators, and among all others."""
    found = []
    for scene in dict.fromkeys(row.scene for row in rows):
        usable = [(row.h_max, row) for row in rows if row.scene == scene and row.h_max is not None]

        def best(theirs: Callable[[str], bool], usable: list[tuple[float, Row]] = usable) -> tuple[str, float | None]:
            step, row = max((pair for pair in usable if theirs(pair[1].engine)), key=lambda pair: pair[0],
                            default=(None, None))
            return "" if row is None else f"{row.engine} {row.method}", step

        own, own_step = best(lambda engine: engine == OWN)
        stock, stock_step = best(lambda engine: engine not in (OWN, *ADDED))
        other, other_step = best(lambda engine: engine != OWN)
        found.append(Best(
            scene=scene, own=own, own_h_max=own_step, stock=stock, stock_h_max=stock_step, any=other,
            any_h_max=other_step, ratio=own_step / stock_step if own_step and stock_step else None,
            ratio_any=own_step / other_step if own_step and other_step else None))
    return found


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
