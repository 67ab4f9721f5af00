"""Times per step of every run relative to a calibration kernel, so that nights and machines compare.

A run's time is divided by the time of a fixed piece of work just before and after it, because a busy or slow machine
slows down both. Both are short, and a try is repeated if the process had to wait for the processor. The runs of a scene
take turns, each of several rounds is a new process, and the result is the median of all turns.
"""

from __future__ import annotations

import dataclasses
import functools
import statistics
import time
from collections.abc import Sequence
from pathlib import Path

from msgspec.structs import replace

from crosscheck.adapters import built_in
from crosscheck.adapters.base import RawRun
from crosscheck.compare.timing import (
    CALIBRATION,
    PATIENCE,
    TRIES,
    calibration_kernel,
    take_turns,
    undisturbed,
)
from crosscheck.document import Calibration, Finding, Record, Speed, Way, extended, grouped
from crosscheck.errors import EngineDied
from crosscheck.files import digest
from crosscheck.jobs.drive import Crash, Limits, Stages
from crosscheck.jobs.workers import child
from crosscheck.judge.verdict import beyond
from crosscheck.running.attempt import Ran, attempt
from crosscheck.scene.file import load_scene
from crosscheck.scene.model import Scene
from crosscheck.verification.plan import profile
from crosscheck.verification.trust import NOISE_DEVIATIONS

Pair = tuple[float, float]
"""Time per step (s) of a run, and that of the calibration kernel."""

REPEATS = 3
"""Number of turns of each run in one round."""

STEPS, FEWEST = 100, 8
"""Steps of a timed run of one body, and least steps of a run of many bodies. They take 0.1 to 10 ms."""

SHARE, STEPPING, LEAST = 8, 4.0, 1.5
"""For an engine of the user the clock is around the whole call. What a run takes beyond one of a SHARE of its steps is
stepping; it is doubled until it takes STEPPING times as long as that one, or is as long as the scene. Where it then
takes less than LEAST times as long, the difference is noise, and the whole call counts."""

ONCE = 0.1
"""Runs that take more processor time (s, with the building of models) have one turn per round."""


@dataclasses.dataclass(frozen=True)
class Burst:
    """A run to be timed."""

    way: Way
    duration: float | None = None  # s, of an adaptive run: the time of about `STEPS` steps; None: the whole scene

    @classmethod
    def of(cls, record: Record) -> Burst:
        """A short version of the main run of a record."""
        way = replace(extended(Way, record), form=None if record.default_form else record.form)
        if record.rtol is None or not record.steps or record.duration is None:
            return cls(way)
        return cls(way, STEPS / record.steps * record.duration)


@dataclasses.dataclass(frozen=True)
class Round:
    """The runs of one scene (a name or a path) that take turns."""

    scene: str
    bursts: tuple[Burst, ...]


def time_round(task: Round) -> list[list[Pair]]:
    """For each burst, pairs (s per step, s of the calibration kernel), none for a run that fails.

    What fails is recorded by the main run of the same cell. Raises `EngineDied`.
    """
    scene, kernel = load_scene(task.scene), calibration_kernel()
    samples: list[list[Pair]] = [[] for _ in task.bursts]
    short: dict[int, tuple[float, ...]] = {}

    def first(index: int) -> float | None:
        """Seconds per step of a run that is so long that one turn is enough; it fills caches."""
        child.at(str(index))
        spans = _spans(scene, task.bursts[index])
        began = time.process_time()  # a run that had to wait for the processor is not a long one
        seconds = _seconds_per_step(scene, task.bursts[index], spans, 1)
        if time.process_time() - began > ONCE:
            return seconds
        short[index] = spans
        return None

    def further(index: int) -> float:
        child.at(str(index))
        return _seconds_per_step(scene, task.bursts[index], short[index], PATIENCE // len(short[index]))

    before = kernel()
    for function, runs, rounds in ((first, range(len(task.bursts)), 1), (further, short, REPEATS)):
        for index, seconds in take_turns({index: functools.partial(function, index) for index in runs}, rounds):
            if isinstance(seconds, EngineDied):
                raise seconds
            after = kernel()
            if isinstance(seconds, float):
                samples[index].append((seconds, 0.5 * (before + after)))
            before = after
    return samples


def _spans(scene: Scene, burst: Burst) -> tuple[float, ...]:
    """Simulated times (s) of the runs to be timed: of one, or of a short and a long one that differ by stepping."""
    step, count = burst.way.step, max(FEWEST, STEPS // scene.n)
    whole = min(scene.duration, burst.duration or scene.duration if step is None else step * count)
    short = whole / SHARE if step is None else min(whole, step * max(1, count // SHARE))
    _fastest(scene, burst, short, 1)  # loads libraries
    if burst.way.engine in built_in.ENTRIES:
        return (whole,)
    call, took = (_fastest(scene, burst, span, TRIES)[0] for span in (short, whole))
    while took < STEPPING * call and call < ONCE and whole < scene.duration:
        whole = min(scene.duration, 2 * whole)
        took = _fastest(scene, burst, whole, TRIES)[0]
    return (short, whole) if took > LEAST * call else (whole,)


def _fastest(scene: Scene, burst: Burst, span: float, most: int) -> tuple[float, int]:
    """Stepping time (s) of a run of this length (s), undisturbed within `most` tries, and its steps."""
    brief, ran = scene.replace(duration=span, samples=2), list[RawRun]()

    def once() -> float:
        ran.append(stepped(brief, burst.way))
        return ran[-1].wall_time

    return undisturbed(once, most)[0], ran[-1].steps


def _seconds_per_step(scene: Scene, burst: Burst, spans: tuple[float, ...], most: int) -> float:
    """Seconds per step of the long run, without what the short one takes."""
    seconds, steps = _fastest(scene, burst, spans[-1], most)
    call, few = _fastest(scene, burst, spans[0], most) if len(spans) > 1 else (0.0, 0)
    return (seconds - call) / (steps - few) if call < seconds and few < steps else seconds / steps


def stepped(scene: Scene, way: Way, samples: int | None = None) -> RawRun:
    """A run of which only states and stepping time count. Raises its error if it fails."""
    outcome = attempt(scene, way, monitor=False, derived=False, samples=samples or scene.samples)
    if not isinstance(outcome, Ran):
        raise outcome.error
    return outcome.raw


def stepping_time(scene: Scene, way: Way, samples: int | None = None) -> float:
    """Stepping time (s) of a run. Raises its error if it fails."""
    return stepped(scene, way, samples).wall_time


def summarise(samples: list[Pair]) -> Speed | None:
    """Medians and deviations of the pairs of all rounds; None if there are no pairs."""
    if not samples:
        return None
    times = [1e6 * seconds for seconds, _ in samples]
    ratios = [seconds / kernel for seconds, kernel in samples]
    middle = statistics.median(ratios)
    # What delays a run adds time: it is slower beyond noise only if its fastest repeat is, too.
    deviation = max(spread(ratios), (middle - min(ratios)) / NOISE_DEVIATIONS)
    return Speed(us_per_step=statistics.median(times), us_deviation=spread(times), ratio=middle, deviation=deviation,
                 repeats=len(samples),
                 calibration=1e6 * statistics.median(kernel for _, kernel in samples))


def spread(values: list[float]) -> float:
    """Median absolute deviation."""
    middle = statistics.median(values)
    return statistics.median(abs(value - middle) for value in values)


def measure_speed(records: Sequence[Record], called: str, stages: Stages, within: Limits | None = None,
                  name: str = "round") -> tuple[list[Record], Calibration]:
    """The records with the times of their main runs relative to the calibration kernel, and the kernel's time.

    Parameters
    ----------
    records : of any scenes; records of failed runs and of engines in their own environments are not changed
    called : the profile, which says how many processes take turns; every run has several turns in each
    stages : with one job, so that nothing else runs
    within : limits of one run
    name : of these rounds, which are measured once a session
    """
    made, kernels = list(records), list[float]()
    chosen = grouped((index for index, record in enumerate(records) if record.us_per_step is not None),
                     lambda index: records[index].scene)
    for scene, own in chosen.items():
        task = Round(scene, tuple(Burst.of(records[index]) for index in own))
        samples: list[list[Pair]] = [[] for _ in own]
        crashed: dict[int, str] = {}
        for turn in range(1, profile(called).speed + 1):
            crashed |= _round(stages, task, f"{name} {turn}", within, samples)
        for number, (index, pairs) in enumerate(zip(own, samples, strict=True)):
            kernels += [kernel for _, kernel in pairs]
            made[index] = _filled_in(records[index], summarise(pairs))
            if number in crashed:
                made[index] = beyond(made[index], Finding.ended_early(f"when it was timed: {crashed[number]}"))
    return made, Calibration(what=CALIBRATION, us=1e6 * statistics.median(kernels) if kernels else None,
                             deviation=1e6 * spread(kernels) if kernels else None)


def _round(stages: Stages, task: Round, name: str, within: Limits | None, samples: list[list[Pair]]) -> dict[int, str]:
    """Adds what `time_round` gives for each burst to `samples`; why some give nothing.

    If one of them crashes the process or exceeds the limits, all others are done again without it.
    """
    left, reasons = list(range(len(task.bursts))), dict[int, str]()
    while left:
        whole = None if within is None or within.time is None else dataclasses.replace(
            within, time=within.time * len(left))
        part = dataclasses.replace(task, bursts=tuple(task.bursts[number] for number in left))
        which = f"{name}{', again' if reasons else ''}"
        made, = stages.run("speed", time_round, [part], [digest("speed", which, part)],
                           [f"speed of {Path(task.scene).name}, {which}"], whole, reuse="samples")
        if not isinstance(made, Crash):
            for number, pairs in zip(left, made, strict=True):
                samples[number] += pairs
            break
        # If none was at work, none is the cause, and another attempt would fail, too.
        culprits = [left[int(made.at)]] if made.at else left
        reasons |= dict.fromkeys(culprits, made.message)
        left = [number for number in left if number not in culprits]
    return reasons


def _filled_in(record: Record, measured: Speed | None) -> Record:
    if measured is None:
        return record
    record = replace(record, speed=measured, us_per_step=measured.us_per_step)
    if not record.steps or not record.duration:
        return record
    per_second = 1e-6 * record.steps / record.duration
    return replace(record, seconds_per_second=per_second * measured.us_per_step,
                   seconds_deviation=per_second * measured.us_deviation)
