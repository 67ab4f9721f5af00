"""Work against precision: what every way to integrate a scene pays for its error.

A way is an engine, a method and a form. Each walks down a ladder of steps or tolerances; the errors come from a first
pass with samples, the times from rounds in which all rungs of all ways take turns, with two samples and no monitor.
"""

from __future__ import annotations

import contextlib
import dataclasses
import math
import statistics
import time
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import numpy as np

from crosscheck.errors import ArgumentError
from crosscheck.judge.plan import natural_time
from crosscheck.references.base import Reference
from crosscheck.scene.model import Scene
from crosscheck.scene.states import States

INTERVALS = 64
"""Of the samples for the largest errors. A power of two, as the step counts of ladders are up to a factor 3."""

RTOLS = tuple(10.0**-power for power in range(1, 15))
"""Relative tolerances of the adaptive methods."""

GOOD, LEAST_GAIN = 1e-9, 1.3
"""Below the error `GOOD`, two finer rungs in a row that gain less than this factor end a ladder: round-off rules."""

WAITED = 0.03
"""A try that waited for the processor a larger share of its time was disturbed."""

CLEAN, TRIES, PATIENCE = 3, 6, 0.1
"""A turn is the fastest of so many undisturbed tries, out of so many at most, in about so many seconds: the first finds
the caches full of another engine's data, which for runs of 50 us doubles the time."""

Progress = Callable[[int, int | None, str], Any]


@dataclasses.dataclass(frozen=True)
class Way:
    """One way to integrate a scene."""

    engine: str
    method: str
    form: str | None
    adaptive: bool
    order: int | None

    @property
    def label(self) -> str:
        """Engine, method and form."""
        return f"{self.engine} {self.method}" + (f" ({self.form})" if self.form else "")


@dataclasses.dataclass
class Rung:
    """One run of a way. Lengths in m, angles in rad, largest over the bodies; times are of stepping alone.

    `setup_ms` is everything else: the engine's model and the conversion of its two samples.
    """

    scene: str
    engine: str
    method: str
    form: str | None
    label: str
    step: float | None  # s
    rtol: float | None
    status: str = "success"  # or "error", "skipped"
    reason: str = ""
    steps: int | None = None
    rejected_steps: int | None = None
    force_evaluations: int | None = None  # where the engine counts them
    end_position: float | None = None
    end_attitude: float | None = None
    max_position: float | None = None  # over the samples that the steps meet
    max_attitude: float | None = None
    samples: int | None = None  # those of the largest errors
    wall_ms: float | None = None  # median over the repeats
    wall_deviation_ms: float | None = None  # their median absolute deviation
    setup_ms: float | None = None
    repeats: int = 0
    times: list[tuple[float, float]] = dataclasses.field(default_factory=list, repr=False)  # s, stepping and set-up

    def plain(self) -> dict[str, Any]:
        """As a row of a table."""
        return {field.name: getattr(self, field.name) for field in dataclasses.fields(self) if field.name != "times"}


def ways(scene: Scene, engines: Sequence[str], methods: Sequence[str] | None = None) -> tuple[list[Way], list[Rung]]:
    """Every way to integrate the scene, and a skipped rung with the reason for each combination that does not exist.

    Parameters
    ----------
    engines : names as `crosscheck.adapters.get` takes them, none in an environment of its own
    methods : only these; None for all
    """
    from crosscheck.adapters import get
    from crosscheck.adapters.base import RunSpec

    found, missing = [], []
    for name in engines:
        adapter = get(name)
        adaptive = tuple(getattr(adapter, "adaptive_methods", None) or ())
        for form in tuple(getattr(adapter, "forms", ())) or (None,):
            for method in adapter.methods:
                if methods is not None and method not in methods:
                    continue
                varies = method in adaptive
                spec = RunSpec(method, None if varies else scene.duration / 64, RTOLS[0] if varies else None, form=form)
                reason = adapter.unsupported(scene, spec)
                way = Way(name, method, form, varies, None if reason else adapter.documented_order(scene, spec))
                if reason is None:
                    found.append(way)
                else:
                    missing.append(dataclasses.replace(_rung(scene, way, None), status="skipped", reason=reason))
    return found, missing


def ladder(scene: Scene, way: Way) -> Iterator[tuple[int | None, float]]:
    """(steps, step in s) of a fixed-step way, coarse to fine without end, or (None, rtol) of an adaptive one.

    The first step is about four natural times of the scene, for methods up to order 2 one; it then shrinks by 3/2 and
    4/3 in turn, for these by 2: errors of low order differ less from step to step.
    """
    if way.adaptive:
        yield from ((None, rtol) for rtol in RTOLS)
        return
    low = way.order is not None and way.order <= 2
    natural = scene.duration / natural_time(scene) / (1 if low else 4)
    count = 2 ** max(1, math.floor(math.log2(max(natural, 1.0))))
    while True:
        yield count, scene.duration / count
        if not low:
            yield count * 3 // 2, scene.duration / (count * 3 // 2)
        count *= 2


def measure(scene: Scene, chosen: Sequence[Way], truth: Reference, repeats: int, time_limit: float,
            progress: Progress, keep: Callable[[list[Rung]], None], bound: bool = True) -> list[Rung]:
    """All rungs of all ways, then their times in interleaved rounds.

    Parameters
    ----------
    truth : with `INTERVALS` intervals over the scene
    repeats : rounds; the medians count
    time_limit : s of stepping; a rung that would take longer is left out, with a row that says so
    keep : called with all rungs after each round, so that a kill loses no more than one
    bound : also the Taylor series of heyoka
    """
    from crosscheck.studies.bound import TOLERANCES, Bound

    rungs: list[Rung] = []
    runs: list[tuple[Rung, Callable[[], float]]] = []
    total = len(chosen) + (len(TOLERANCES) if bound else 0)
    for done, way in enumerate(chosen):
        progress(done, total, f"{scene.name}: errors of {way.label}")
        walked = _walk(scene, way, truth, time_limit)
        rungs += walked
        runs += [(rung, _timer(scene, rung)) for rung in walked if rung.status == "success"]
    if bound:
        series = Bound(scene, truth)
        for done, rtol in enumerate(TOLERANCES):
            progress(len(chosen) + done, total, f"{scene.name}: building the Taylor series of heyoka")
            rung = series.rung(rtol)
            rungs.append(rung)
            runs += [(rung, series.timer(rung))] if rung.status == "success" else []
    keep(rungs)
    for turn in range(repeats):
        for done, (rung, once) in enumerate(runs):
            progress(turn * len(runs) + done, repeats * len(runs), f"{scene.name}: time of {rung.label}")
            if rung.status == "success":
                _take(rung, once)
        keep(rungs)
    return rungs


def _walk(scene: Scene, way: Way, truth: Reference, time_limit: float) -> list[Rung]:
    """Down the ladder of a way, errors only, until round-off rules or the next rung would take too long."""
    rungs: list[Rung] = []
    last, pace = None, 0.0  # the last rung that ran, and what it says about the next: s per step, or s of a run
    best, stale = math.inf, 0  # least error, and the rungs in a row without gain
    for count, value in ladder(scene, way):
        rung = _rung(scene, way, value)
        rungs.append(rung)
        if last and pace * (count or 1) > time_limit:
            # one busy moment of the machine must not end a ladder; should it fail now, so will the timed rounds
            with contextlib.suppress(Exception):
                pace = min(pace, _undisturbed(_timer(scene, last))[0] * _share(last))
            if pace * (count or 1) > time_limit:
                rung.status, rung.reason = "skipped", f"it would take longer than the limit of {time_limit:g} s"
                break
        wall = _explore(scene, rung, count, truth)
        if rung.status == "error":
            if count is not None and count > MOST_FAILING * scene.duration / natural_time(scene):
                break
            continue
        last, pace = rung, wall * _share(rung)
        error = rung.end_position or 0.0
        stale = stale + 1 if error < GOOD and error * LEAST_GAIN > best else 0
        best = min(best, error)
        if stale >= 2:
            break
    return rungs


def _share(rung: Rung) -> float:
    """What a rung's seconds are to be multiplied with for those of a step, or for those of the next tolerance."""
    return GROWTH if rung.step is None else 1.0 / (rung.steps or 1)


MOST_FAILING = 1000.0
"""A ladder whose rungs still fail at so many steps per natural time of the scene ends."""

GROWTH = 1.5
"""An adaptive run at a tenth of the tolerance takes about this much longer at least, by the order of the methods."""


def _rung(scene: Scene, way: Way, value: float | None) -> Rung:
    return Rung(scene.name, way.engine, way.method, way.form, way.label, None if way.adaptive else value,
                value if way.adaptive else None)


def _explore(scene: Scene, rung: Rung, count: int | None, truth: Reference) -> float:
    """Fill in the errors of a rung; returns the seconds of its stepping. A failure is written into the rung."""
    intervals = INTERVALS if count is None else min(INTERVALS, count & -count)
    try:
        traj = _run(scene, rung, intervals + 1)
    except Exception as error:  # whatever an engine raises is a row of the study
        rung.status, rung.reason = "error", " ".join(str(error).split()) or type(error).__name__
        return 0.0
    rung.steps = traj.steps
    errors_into(rung, scene, traj, truth, intervals)
    return traj.wall_time


def errors_into(rung: Rung, scene: Scene, run: Any, truth: Reference, intervals: int) -> None:
    """Fill in the errors of a run at `intervals` + 1 even times against the truth at more of them."""
    from crosscheck.judge.metrics import errors

    found = errors(scene, run, _thinned(truth.states, intervals))
    rung.samples = intervals + 1
    for quantity in ("position", "attitude"):
        setattr(rung, f"end_{quantity}", found[quantity].end)
        setattr(rung, f"max_{quantity}", found[quantity].max)


def _thinned(states: States, intervals: int) -> States:
    every = (len(states.t) - 1) // intervals
    return States(states.t[::every], states.x[::every], states.R[::every], states.v[::every], states.w[::every])


def _run(scene: Scene, rung: Rung, samples: int) -> Any:
    from crosscheck.running.run import run

    return run(scene, rung.engine, rung.method, step=rung.step, rtol=rung.rtol, form=rung.form, samples=samples,
               monitor=False)


def _timer(scene: Scene, rung: Rung) -> Callable[[], float]:
    """A function that runs the rung with two samples, notes its counters and returns its stepping time, s."""

    def once() -> float:
        traj = _run(scene, rung, 2)
        rung.steps = traj.steps
        rung.rejected_steps = traj.stats.get("rejected_steps")
        rung.force_evaluations = traj.stats.get("force_evaluations")
        return traj.wall_time

    return once


def _undisturbed(once: Callable[[], float]) -> tuple[float, float]:
    """Seconds of stepping and of set-up of one turn."""
    clean: list[tuple[float, float]] = []
    others: list[tuple[float, float]] = []
    began = time.perf_counter()
    while len(clean) < CLEAN and len(clean) + len(others) < TRIES:
        start, worked = time.perf_counter(), time.process_time()
        wall = once()
        end = time.perf_counter()
        waited = (end - start - (time.process_time() - worked)) / (end - start)
        (clean if waited <= WAITED else others).append((wall, end - start - wall))
        if clean and end - began > PATIENCE:
            break
    return min(clean or others)


def _take(rung: Rung, once: Callable[[], float]) -> None:
    """One turn of a rung."""
    try:
        wall, setup = _undisturbed(once)
    except Exception as error:  # it ran in the first pass, and now does not: that is a finding, too
        rung.status, rung.reason = "error", f"when timed: {' '.join(str(error).split())}"
        return
    rung.times.append((wall, setup))
    walls = [pair[0] for pair in rung.times]
    middle = statistics.median(walls)
    rung.repeats = len(walls)
    rung.wall_ms = 1e3 * middle
    rung.wall_deviation_ms = 1e3 * statistics.median(abs(wall - middle) for wall in walls)
    rung.setup_ms = 1e3 * statistics.median(pair[1] for pair in rung.times)


def reference(scene: Scene) -> tuple[Scene, Reference]:
    """The scene, ended where its truth stops being comparable, and its truth at `INTERVALS` + 1 times.

    Raises `crosscheck.references.TruthError` or `Unsupported` for a scene without truth.
    """
    from crosscheck.references import truth

    sampled = scene.replace(samples=INTERVALS + 1)
    found = truth(sampled)
    if found.horizon < scene.duration * (1 - 1e-12):
        sampled = sampled.replace(duration=float(np.floor(10 * found.horizon) / 10) or found.horizon)
        found = truth(sampled)
    return sampled, found


def check_names(engines: Sequence[str], methods: Sequence[str] | None) -> None:
    """Raise `ArgumentError` for an engine whose times compare with no other, or a method that none of them has."""
    from crosscheck.adapters import has_own_environment
    from crosscheck.adapters import methods as methods_of
    from crosscheck.errors import unknown

    known: list[str] = []
    for name in engines:
        if has_own_environment(name):
            raise ArgumentError(f"engine: {name} runs in an environment of its own, so that its times compare with no "
                                f"other; name the installed version, {name.partition('==')[0]}")
        known += methods_of(name)
    for method in methods or ():
        if method not in known:
            raise ArgumentError(unknown("method", method, tuple(dict.fromkeys(known))))
