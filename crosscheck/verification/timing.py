"""The timing study: stepping time against end error of all cells of a scene, in one worker process."""

from __future__ import annotations

import dataclasses
import statistics
from collections.abc import Sequence

from msgspec.structs import replace

from crosscheck.document import Finding, Point, Record
from crosscheck.jobs.grid import Crash, Limits, run_tasks
from crosscheck.jobs.stages import Stages
from crosscheck.jobs.table import digest
from crosscheck.jobs.workers import output
from crosscheck.judge.metrics import errors
from crosscheck.judge.plan import RTOLS
from crosscheck.judge.verdict import beyond
from crosscheck.running.attempt import Ran, attempt, lasting
from crosscheck.running.trajectory import Trajectory
from crosscheck.scene.model import Scene
from crosscheck.scene.states import States
from crosscheck.verification.task import Cell, Timing, windowed

ENOUGH = 0.1
"""If two runs take more stepping time (s) than this, there is no third: long runs average noise out."""

MAIN_STEPS = 2000
"""Most steps of the runs at the step of the main run. They are enough to measure the time per step."""


def timed(cells: Sequence[Cell], records: Sequence[Record], repeats: int, stages: Stages,
          within: Limits) -> list[Record]:
    """The records with stepping times, one scene after the other in a single worker, with nothing else running.

    Engines in their own environments are left out, because their times are not comparable with others.
    """
    found = list(records)
    for scene in dict.fromkeys(cell.scene for cell in cells):
        chosen = [index for index, (cell, record) in enumerate(zip(cells, records, strict=True))
                  if cell.scene == scene and record.ladder and not record.own_environment]
        if chosen:
            task = Timing(tuple(cells[index] for index in chosen),
                          tuple(records[index].documented_order for index in chosen), repeats,
                          tuple(records[index].step or records[index].rtol or 0.0 for index in chosen))
            key = digest("timing", task)
            made = stages.kept("timing", key, "samples")
            if made is None:
                made = guarded_timing(task, within)
                if stages.session is not None:
                    made = stages.session.put("timing", key, made)
            points, reasons = made
            for position, index in enumerate(chosen):
                found[index] = _filled_in(records[index], points[position], reasons.get(position))
        stages.count(f"timing of {scene}")
    return found


def _filled_in(record: Record, points: list[Point], reason: str | None) -> Record:
    if reason is not None:
        record = beyond(record, Finding("run", "fail", None, None, "", "a run has to reach its end",
                                        f"in the timing study: {reason}"))
    for point in points:
        if point.main:
            record = replace(record, us_per_step=point.us_per_step, seconds_per_second=point.seconds_per_second,
                             seconds_deviation=point.seconds_deviation)
    return replace(record, timing=[point for point in points if not point.main])


def guarded_timing(task: Timing, within: Limits | None = None) -> tuple[list[list[Point]], dict[int, str]]:
    """The points of `time_cells`, made in one worker process, and for some cells the reason why they have none.

    If a cell crashes the process or exceeds the limits, all others are timed again without it. The time limit is that
    of all cells together.
    """
    left = list(range(len(task.cells)))
    reasons: dict[int, str] = {}
    while left:
        part = dataclasses.replace(task, cells=tuple(task.cells[index] for index in left),
                                   orders=tuple(task.orders[index] for index in left),
                                   main=tuple(task.main[index] for index in left if index < len(task.main)))
        each = within or Limits()
        whole = Limits(None if each.time is None else each.time * len(left), each.memory)
        found = run_tasks(time_cells, [part], 1, limits=whole)[0]
        if not isinstance(found, Crash):
            points = dict(zip(left, found, strict=True))
            return [points.get(index, []) for index in range(len(task.cells))], reasons
        culprit = int(found.at) if found.at else None
        # If no cell was running, no engine is the cause, and another attempt would fail, too.
        for index in left if culprit is None else [left[culprit]]:
            reasons[index] = found.message
        left = [] if culprit is None else left[:culprit] + left[culprit + 1:]
    return [[] for _ in task.cells], reasons


def time_cells(timing: Timing) -> list[list[Point]]:
    """Stepping time against end error of every cell. The runs of all cells take turns in this process.

    Runs have two samples only, so that no engine spends time on output. Times are medians over the repeats. A failing
    run gives no point. The last point of a cell ("main") is at the step of its main run. Its runs stop after
    `MAIN_STEPS`, and it has no error.
    """
    from crosscheck.references import truth
    from crosscheck.scene.file import load_scene

    first = timing.cells[0]
    scene = load_scene(first.scene)
    brief = windowed(scene, first.plan.window).replace(samples=2)
    exact = truth(windowed(scene, first.plan.window)).states
    end = dataclasses.replace(exact, **{name: getattr(exact, name)[[0, -1]] for name in ("t", "x", "R", "v", "w")},
                              a=None, alpha=None, lam=None)
    runs: list[dict[tuple[int, float], list[Trajectory]]] = [{} for _ in timing.cells]
    for _ in range(timing.repeats):
        for index, (cell, order) in enumerate(zip(timing.cells, timing.orders, strict=True)):
            output.at(str(index))
            sizes = cell.plan.ladder(order) if order is not None else RTOLS
            for rung, size in enumerate((*sizes, *timing.main[index:index + 1])):
                before = runs[index].get((rung, size), [])
                main = rung == len(sizes)
                if not main and len(before) > 1 and sum(traj.wall_time for traj in before) > ENOUGH:
                    continue
                step, rtol = (size, None) if order is not None else (None, size)
                shorter = brief
                if main and step is not None:
                    shorter = brief.replace(duration=min(brief.duration, MAIN_STEPS * step))
                outcome = lasting(attempt(shorter, cell.engine, cell.method, step, rtol, form=cell.form, monitor=False,
                                  coordinate_map=cell.coordinate_map))
                if isinstance(outcome, Ran):
                    runs[index].setdefault((rung, size), []).append(outcome.trajectory)
    result = []
    for cell, each, order in zip(timing.cells, runs, timing.orders, strict=True):
        rungs = len(cell.plan.ladder(order) if order is not None else RTOLS)
        result.append([_point(brief, size, order, trajs, None if rung == rungs else end)
                       for (rung, size), trajs in sorted(each.items())])
    return result


def _point(scene: Scene, size: float, order: int | None, trajs: list[Trajectory], end: States | None) -> Point:
    """One point. Without `end`, the truth at the end of the runs, it is the point of the main run."""
    walls = [traj.wall_time for traj in trajs]
    wall, simulated = statistics.median(walls), float(trajs[0].t[-1])
    return Point(step=size if order is not None else None, rtol=size if order is None else None, wall_time=wall,
                 steps=int(trajs[0].steps), us_per_step=1e6 * wall / max(1, trajs[0].steps),
                 seconds_per_second=wall / simulated,
                 seconds_deviation=statistics.median(abs(each - wall) for each in walls) / simulated,
                 error=None if end is None else errors(scene, trajs[0], end)["position"].end, main=end is None)
