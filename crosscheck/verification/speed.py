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
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, TypeVar

from msgspec.structs import replace

from crosscheck import references
from crosscheck.adapters import built_in
from crosscheck.adapters.base import RawRun
from crosscheck.compare.errors import errors
from crosscheck.compare.timing import (
    CALIBRATION,
    PATIENCE,
    TRIES,
    calibration_kernel,
    take_turns,
    undisturbed,
)
from crosscheck.document import Calibration, Finding, Point, Record, Speed, Way, extended, grouped
from crosscheck.errors import CrosscheckError, EngineDied
from crosscheck.files import digest
from crosscheck.jobs.drive import Crash, Limits, Stages
from crosscheck.jobs.workers import child
from crosscheck.judge.verdict import beyond
from crosscheck.running.attempt import Ran, attempt
from crosscheck.scene.file import load_scene
from crosscheck.scene.model import Scene
from crosscheck.verification.plan import RTOLS, profile
from crosscheck.verification.trust import NOISE_DEVIATIONS

Pair = tuple[float, float]
"""Time per step (s) of a run, and that of the calibration kernel."""
Timed = tuple[list[Pair], Point | None]
"""Times of a run of its own, and what a run at another step or tolerance shows of time against error."""

Found = TypeVar("Found")

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

COARSER = (8, 4, 2)
"""Steps at which time is shown against error, over that of the main run."""

SHOWN, SAMPLES = 1.0, 6
"""Simulated time (s) of these errors, and the output times of its truth."""


@dataclasses.dataclass(frozen=True)
class Burst:
    """A run to be timed; `until` (s) is the time at which its error is wanted, too."""

    way: Way
    duration: float | None = None  # s, of an adaptive run: the time of about `STEPS` steps; None: the whole scene
    until: float | None = None

    @classmethod
    def all_of(cls, record: Record, points: bool) -> tuple[Burst, ...]:
        """A short version of the main run of a record, and runs at coarser steps or other tolerances."""
        way = replace(extended(Way, record), form=None if record.default_form else record.form)
        share = None if record.rtol is None or not record.steps else STEPS / record.steps
        main = cls(way, None if share is None or record.duration is None else share * record.duration)
        if not points or not record.errors:
            return (main,)
        sizes = ({"step": record.step * times} for times in COARSER) if record.step else (
            {"rtol": rtol} for rtol in RTOLS)
        until = min(record.duration or SHOWN, SHOWN)
        return (main, *(cls(replace(way, **size), main.duration, until) for size in sizes))


@dataclasses.dataclass(frozen=True)
class Round:
    """The runs of one scene (a name or a path) that take turns, and the number of turns."""

    scene: str
    bursts: tuple[Burst, ...]
    repeats: int = REPEATS


def time_round(task: Round) -> list[Timed]:
    """For each burst, pairs (s per step, s of the calibration kernel), none for a run that fails, and its point.

    What fails is recorded by the main run of the same cell. Raises `EngineDied`.
    """
    scene, kernel = load_scene(task.scene), calibration_kernel()

    def turns(function: Callable[..., Found], given: Mapping[int, tuple[Any, ...]], rounds: int = 1
              ) -> Iterator[tuple[int, Found]]:
        def run(index: int) -> Found:
            child.at(str(index))
            return function(scene, task.bursts[index], *given[index])

        for index, found in take_turns({index: functools.partial(run, index) for index in given}, rounds):
            if isinstance(found, EngineDied):
                raise found
            if not isinstance(found, CrosscheckError):
                yield index, found

    def calibrated(found: Iterable[tuple[int, Found]]) -> Iterator[tuple[int, Found, float]]:
        before = kernel()
        for index, each in found:
            after = kernel()
            yield index, each, 0.5 * (before + after)
            before = after

    samples: list[list[Pair]] = [[] for _ in task.bursts]
    short: dict[int, tuple[tuple[float, ...], int]] = {}
    main = [index for index, burst in enumerate(task.bursts) if burst.until is None]
    for index, (spans, seconds), beside in calibrated(turns(_begun, dict.fromkeys(main, ()))):
        if seconds is None:
            short[index] = spans, PATIENCE // len(spans)
        else:
            samples[index].append((seconds, beside))
    for index, seconds, beside in calibrated(turns(_seconds_per_step, short, task.repeats)):
        samples[index].append((seconds, beside))
    points = dict(turns(_point, {index: () for index in range(len(task.bursts)) if index not in main}))
    return [(pairs, points.get(index)) for index, pairs in enumerate(samples)]


def _begun(scene: Scene, burst: Burst) -> tuple[tuple[float, ...], float | None]:
    """The spans of a burst, and its seconds per step if one turn is enough; the run fills caches."""
    spans = _spans(scene, burst)
    began = time.process_time()  # a run that had to wait for the processor is not a long one
    seconds = _seconds_per_step(scene, burst, spans, 1)
    return spans, seconds if time.process_time() - began > ONCE else None


def _point(scene: Scene, burst: Burst) -> Point:
    """A run of the length that a burst asks for: its time, and its largest error of position at the end."""
    short, ran = scene.lasting(burst.until or scene.duration).replace(samples=SAMPLES), list[RawRun]()

    def once() -> float:
        ran.append(stepped(short, burst.way, 2))
        return ran[-1].wall_time

    seconds = undisturbed(once, TRIES)[0]
    error = errors(short, ran[-1].states, references.truth(short).states.at([0, -1]))["position"].end
    return Point(step=burst.way.step, rtol=burst.way.rtol, steps=ran[-1].steps, error=error, wall_time=seconds)


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


def _fastest(scene: Scene, burst: Burst, span: float, most: int) -> Pair:
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
    called : the profile, which says how many processes take turns, every run has several turns in each, and whether
        coarser runs are timed, too
    stages : with one job, so that nothing else runs
    within : limits of one run
    name : of these rounds, which are measured once a session
    """
    settings, made = profile(called), list(records)
    chosen = grouped((index for index, record in enumerate(records) if record.us_per_step is not None),
                     lambda index: records[index].scene)
    kernels: list[float] = []
    for scene, own in chosen.items():
        bursts = [(index, burst) for index in own for burst in Burst.all_of(records[index], settings.points)]
        task = Round(scene, tuple(burst for _, burst in bursts))
        samples: list[Timed] = [([], None) for _ in bursts]
        crashed: dict[int, str] = {}
        for turn in range(1, settings.speed + 1):
            results, reasons = _round(stages, task, f"{name} {turn}", within)
            samples = [(before + pairs, known or point) for (before, known), (pairs, point) in zip(
                samples, results, strict=True)]
            crashed |= {bursts[number][0]: reason for number, reason in reasons.items()}
        kernels += [kernel for pairs, _ in samples for _, kernel in pairs]
        for index in own:
            (main, _), *coarser = (each for (place, _), each in zip(bursts, samples, strict=True) if place == index)
            timing = [point for _, point in coarser if point is not None]
            if main and records[index].engine not in built_in.ENTRIES:  # the clock is around the whole call
                timing = [replace(each, wall_time=each.steps * main[0][0]) for each in timing]
            made[index] = replace(_filled_in(records[index], summarise(main)), timing=timing)
            if index in crashed:
                made[index] = beyond(made[index], Finding.ended_early(f"when it was timed: {crashed[index]}"))
    return made, Calibration(what=CALIBRATION, us=1e6 * statistics.median(kernels) if kernels else None,
                             deviation=1e6 * spread(kernels) if kernels else None)


def _round(stages: Stages, task: Round, name: str, within: Limits | None) -> tuple[list[Timed], dict[int, str]]:
    """What `time_round` gives for each burst, and of some the reason why they give nothing.

    If one of them crashes the process or exceeds the limits, all others are done again without it.
    """
    results: list[Timed] = [([], None) for _ in task.bursts]
    left, reasons = list(range(len(task.bursts))), dict[int, str]()
    while left:
        whole = None if within is None or within.time is None else dataclasses.replace(
            within, time=within.time * len(left))
        part = dataclasses.replace(task, bursts=tuple(task.bursts[number] for number in left))
        which = f"{name}{', again' if reasons else ''}"
        made, = stages.run("speed", time_round, [part], [digest("speed", which, part)],
                           [f"speed of {Path(task.scene).name}, {which}"], whole, reuse="samples")
        if not isinstance(made, Crash):
            for number, each in zip(left, made, strict=True):
                results[number] = each
            break
        # If none was at work, none is the cause, and another attempt would fail, too.
        culprits = [left[int(made.at)]] if made.at else left
        reasons |= dict.fromkeys(culprits, made.message)
        left = [number for number in left if number not in culprits]
    return results, reasons


def _filled_in(record: Record, measured: Speed | None) -> Record:
    if measured is None:
        return record
    record = replace(record, speed=measured, us_per_step=measured.us_per_step)
    if not record.steps or not record.duration:
        return record
    per_second = 1e-6 * record.steps / record.duration
    return replace(record, seconds_per_second=per_second * measured.us_per_step,
                   seconds_deviation=per_second * measured.us_deviation)
