"""Long runs, one after the other, for the studies of drift and of chaos."""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from typing import Any, TypeVar

import msgspec

from crosscheck.document import Way, extended
from crosscheck.errors import ArgumentError, CrosscheckError, Unsupported, said
from crosscheck.running.attempt import Ran, attempt
from crosscheck.running.trajectory import Trajectory
from crosscheck.scene.model import Scene
from crosscheck.studies.study import Ask, Work
from crosscheck.verification.ladder import GradedWay, ways

METHODS = ("rattle2", "rattle4", "DAE1L_LSE", "DAE1H_LSE", "RK4", "RK44", "RKMK4")
"""The default methods: symmetric ones, the two Euler methods that satisfy all levels, and Runge-Kutta of order 4."""

PROBE = 2000
"""Steps of a short run, from which the time of the long run is estimated."""


class LongRun(Way, frozen=True, kw_only=True):
    """One long run of an engine and method."""

    scene: str
    label: str
    duration: float  # s
    status: str = "success"  # or "skipped", "unsupported", "failed"
    reason: str = ""
    wall_time: float | None = None  # s


Row = TypeVar("Row", bound=LongRun)


class TooLong(ArgumentError):
    """A run would take longer than the limit."""


def long_ways(scene: Scene, engines: Sequence[str], ask: Ask) -> list[GradedWay]:
    """The ways for long runs: every method with a fixed step, in the first form that can model the scene."""
    first: dict[tuple[str, str], GradedWay] = {}
    for way in ways(scene, engines, ask.methods or METHODS, asked_map=ask.coordinate_map)[0]:
        if not way.adaptive:
            first.setdefault((way.engine, way.method), way)
    return list(first.values())


def begun(kind: type[Row], scene: Scene, way: GradedWay, step: float, **more: object) -> Row:
    """The row of a run over the whole scene, before the run is made."""
    return extended(kind, way, scene=scene.name, label=way.label, duration=scene.duration, **more | {"step": step})


def run_all(work: Work[Any, Row], scene: Scene, rows: Sequence[Row], done: list[Row],
            measured: Callable[[Row], Row]) -> None:
    """Add the measured rows of a scene to `done`, one by one. After each, all are given to `work.keep`.

    If `measured` raises, the row gets the reason, and is tried again after a kill.
    """
    for index, start in enumerate(rows):
        work.progress(index, len(rows), f"{start.scene}: {start.label}")
        try:
            done.append(work.once(scene, start.engine, start, functools.partial(measured, start)))
        except TooLong as limit:
            done.append(msgspec.structs.replace(start, status="skipped", reason=str(limit)))
        except CrosscheckError as error:
            status = "unsupported" if isinstance(error, Unsupported) else "failed"
            done.append(msgspec.structs.replace(start, status=status, reason=said(error)))
        work.keep(done)


def long_run(row: LongRun, scene: Scene, time_limit: float) -> Trajectory:
    """The trajectory of a row. Raises `TooLong` if a short run predicts more than `time_limit` (s) of stepping."""
    def over(scene: Scene) -> Trajectory:
        outcome = attempt(scene, row, monitor=False)
        if isinstance(outcome, Ran):
            return outcome.trajectory
        raise outcome.error

    step = row.step or row.duration
    steps = round(row.duration / step)
    if steps > 2 * PROBE:
        expected = over(scene.replace(duration=PROBE * step, samples=2)).wall_time / PROBE * steps
        if expected > time_limit:
            raise TooLong(f"it would take about {expected:.0f} s, the limit is {time_limit:g} s")
    return over(scene)
