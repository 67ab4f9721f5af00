"""Long runs, one after the other, for the studies of drift and of chaos."""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from typing import Any, TypeVar

import msgspec

from crosscheck.document import Part
from crosscheck.errors import ArgumentError, CrosscheckError, said
from crosscheck.running.run import run
from crosscheck.scene.model import Scene
from crosscheck.studies.study import Ask, Work
from crosscheck.verification.ladder import GradedWay, ways

METHODS = ("rattle2", "rattle4", "DAE1L_LSE", "DAE1H_LSE", "RK4", "RK44", "RKMK4")
"""The default methods: symmetric ones, the two Euler methods that satisfy all levels, and Runge-Kutta of order 4."""

PROBE = 2000
"""Steps of a short run, from which the time of the long run is estimated."""


class LongRun(Part, frozen=True, kw_only=True):
    """One long run of an engine and method."""

    scene: str
    engine: str
    method: str
    form: str | None
    label: str
    step: float  # s
    duration: float  # s
    status: str = "success"  # or "error", "skipped"
    reason: str = ""
    coordinate_map: str | None = None  # None: the default of the method
    wall_time: float | None = None  # s


Row = TypeVar("Row", bound=LongRun)


class TooLong(ArgumentError):
    """A run would take longer than the limit."""


def long_ways(scene: Scene, engines: Sequence[str], ask: Ask) -> list[GradedWay]:
    """The ways for long runs: every method with a fixed step, in the first form that can model the scene."""
    found: dict[tuple[str, str], GradedWay] = {}
    for way in ways(scene, engines, ask.methods or METHODS, asked_map=ask.coordinate_map)[0]:
        if not way.adaptive:
            found.setdefault((way.engine, way.method), way)
    return list(found.values())


def begun(kind: type[Row], scene: Scene, way: GradedWay, step: float, **more: Any) -> Row:
    """The row of a run over the whole scene, before the run is made."""
    return kind(scene=scene.name, engine=way.engine, method=way.method, form=way.form, label=way.label, step=step,
                duration=scene.duration, coordinate_map=way.coordinate_map, **more)


def run_all(work: Work[Any, Row], scene: Scene, rows: Sequence[Row], before: Sequence[Row],
            measured: Callable[[Row], Row]) -> list[Row]:
    """Measure the rows of a scene one by one. After each, all finished rows are given to `work.keep`.

    Parameters
    ----------
    before : finished rows of earlier scenes
    measured : returns a row with its values; if it raises, the row gets the reason, and is tried again after a kill
    """
    done: list[Row] = []
    for index, start in enumerate(rows):
        work.progress(index, len(rows), f"{start.scene}: {start.label}")
        try:
            done.append(work.once(scene, start.engine, start, functools.partial(measured, start)))
        except TooLong as limit:
            done.append(msgspec.structs.replace(start, status="skipped", reason=str(limit)))
        except CrosscheckError as error:
            done.append(msgspec.structs.replace(start, status="error", reason=said(error)))
        work.keep([*before, *done])
    return done


def long_run(row: LongRun, scene: Scene, time_limit: float) -> Any:
    """The trajectory of a row. Raises `TooLong` if a short run predicts more than `time_limit` (s) of stepping."""
    def over(scene: Scene) -> Any:
        return run(scene, row.engine, row.method, step=row.step, form=row.form, coordinate_map=row.coordinate_map,
                   monitor=False)

    steps = round(row.duration / row.step)
    if steps > 2 * PROBE:
        expected = over(scene.replace(duration=PROBE * row.step, samples=2)).wall_time / PROBE * steps
        if expected > time_limit:
            raise TooLong(f"it would take about {expected:.0f} s, the limit is {time_limit:g} s")
    return over(scene)
