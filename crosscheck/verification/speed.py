"""The speed study: time per step of every run relative to a calibration kernel, so that nights and machines compare.

A run's time is divided by the time of a fixed piece of work just before and after it, because a busy or slow machine
slows down both. Both are short, and a try is repeated if the process had to wait for the processor. The runs of a scene
take turns, every round is a new process, and the result is the median of all turns.
"""

from __future__ import annotations

import dataclasses
import statistics
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import TypeVar

from msgspec.structs import replace

from crosscheck import references
from crosscheck.adapters import built_in
from crosscheck.adapters.base import RawRun
from crosscheck.compare.errors import errors
from crosscheck.document import Calibration, Finding, Point, Record, Speed, Way, extended, grouped
from crosscheck.errors import CrosscheckError
from crosscheck.files import digest
from crosscheck.jobs.drive import Crash, Limits, Place, Stages, run_tasks
from crosscheck.jobs.workers import child
from crosscheck.judge.verdict import beyond
from crosscheck.running.attempt import Ran, attempt, lasting
from crosscheck.scene.file import load_scene
from crosscheck.scene.model import Scene
from crosscheck.scene.states import States
from crosscheck.verification.plan import RTOLS, profile
from crosscheck.verification.task import Cell
from crosscheck.verification.trust import NOISE_DEVIATIONS

CALIBRATION = "40 times the LU solutions of 20 dense systems of 6 equations (numpy.linalg.solve)"
"""The calibration kernel: compiled loops over small matrices, as in a multibody step, without any engine's code. The
few matrices stay in the innermost cache, as the data of a step does. With 800 matrices at once, the ratio of a method
varied twice as much between processes on a loaded machine."""

Pair = tuple[float, float]
"""Time per step (s) of a run, and that of the calibration kernel."""
Made = TypeVar("Made")

REPEATS = 3
"""Number of turns of each run in one round."""

STEPS, FEWEST = 100, 8
"""Steps of a timed run of one body, and least steps of a run of many bodies. They take 0.1 to 10 ms."""

SHARE, STEPPING, LEAST = 8, 4.0, 1.5
"""For an engine of the user the clock is around the whole call. What a run takes beyond one of a SHARE of its steps is
stepping; it is doubled until it takes STEPPING times as long as that one, or is as long as the scene. Where it then
takes less than LEAST times as long, the difference is noise, and the whole call counts."""

TRIES, PATIENCE = 3, 12
"""A turn is the fastest of TRIES undisturbed tries, out of at most PATIENCE tries."""

LONG = 0.01
"""After this time (s, with the building of models) one undisturbed try is enough, as long runs average noise out."""

ONCE = 0.1
"""Runs that take more processor time (s, with the building of models) have one turn per round and none to warm up."""

WAITED = 0.03
"""Largest share of waiting in an undisturbed try."""


@dataclasses.dataclass(frozen=True)
class Burst:
    """A run to be timed."""

    way: Way
    duration: float | None = None  # s, of an adaptive run: the time of about `STEPS` steps; None: the whole scene

    @classmethod
    def of(cls, record: Record) -> Burst:
        """A short version of the main run of a record."""
        share = None if record.rtol is None or not record.steps else STEPS / record.steps
        return cls(replace(extended(Way, record), form=None if record.default_form else record.form),
                   None if share is None or record.duration is None else share * record.duration)


@dataclasses.dataclass(frozen=True)
class Round:
    """The runs of one scene (a name or a path) that take turns, and the number of turns."""

    scene: str
    bursts: tuple[Burst, ...]
    repeats: int = REPEATS


def time_round(task: Round) -> list[list[Pair]]:
    """For each burst, pairs (s per step, s of the calibration kernel). The list is empty for a run that fails."""
    scene = load_scene(task.scene)
    kernel = calibration_kernel()
    kernel()
    samples: list[list[Pair]] = [[] for _ in task.bursts]
    spans: list[tuple[float, ...] | None] = [()] * len(task.bursts)  # of runs, s; None: no more turns
    for turn in range(task.repeats + 1):
        before = kernel()
        for index, burst in enumerate(task.bursts):
            if (span := spans[index]) is None:
                continue
            child.at(str(index))
            try:  # the first turn fills caches
                spans[index] = span = span or _spans(scene, burst)
                began = time.process_time()  # a run that had to wait for the processor is not a long one
                seconds = _seconds_per_step(scene, burst, span, most=PATIENCE // len(span) if turn else 1)
            except CrosscheckError:  # failures are recorded by the main run of the same cell
                spans[index] = None
                continue
            long = time.process_time() - began > ONCE
            after = kernel()
            if long:
                spans[index] = None
            if turn or long:
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


def _fastest(scene: Scene, burst: Burst, span: float, most: int) -> Pair:
    """Stepping time (s) of a run of this length (s), undisturbed within `most` tries, and its steps."""
    brief, steps = scene.replace(duration=span, samples=2), 1

    def once() -> float:
        nonlocal steps
        outcome = attempt(brief, burst.way, monitor=False, derived=False)
        if not isinstance(outcome, Ran):
            raise outcome.error
        steps = outcome.raw.steps
        return outcome.raw.wall_time

    return undisturbed(once, most)[0], steps


def _seconds_per_step(scene: Scene, burst: Burst, spans: tuple[float, ...], most: int) -> float:
    """Seconds per step of the long run, without what the short one takes."""
    seconds, steps = _fastest(scene, burst, spans[-1], most)
    call, few = _fastest(scene, burst, spans[0], most) if len(spans) > 1 else (0.0, 0)
    return (seconds - call) / (steps - few) if call < seconds and few < steps else seconds / steps


def undisturbed(once: Callable[[], float], most: int = PATIENCE, long: float = LONG) -> tuple[float, float]:
    """The seconds that `once` returns and the other seconds that it took, in the fastest undisturbed try.

    Ends after TRIES undisturbed tries, after `most` tries in all, or after an undisturbed one when `long` (s) is over.
    """
    clean: list[Pair] = []
    others: list[Pair] = []
    began = time.perf_counter()
    while len(clean) < TRIES and len(clean) + len(others) < most:
        if clean and time.perf_counter() - began > long:
            break
        start, worked = time.perf_counter(), time.process_time()
        seconds = once()
        took = time.perf_counter() - start
        waited = took - (time.process_time() - worked)
        (clean if waited <= WAITED * seconds + 1e-5 else others).append((seconds, took - seconds))
    return min(clean or others)


def stepping_time(scene: Scene, way: Way, samples: int | None = None) -> float:
    """Stepping time (s) of a run. Raises its error if it fails."""
    outcome = attempt(scene, way, monitor=False, derived=False, samples=samples or scene.samples)
    if not isinstance(outcome, Ran):
        raise outcome.error
    return outcome.raw.wall_time


def take_turns(runs: Sequence[Callable[[], float]], rounds: int, most: int, long: float
               ) -> Iterator[tuple[int, Pair | CrosscheckError]]:
    """The number of a run, and what `undisturbed` gives for it, in turns; one that fails gives its error once."""
    left = dict(enumerate(runs))
    for _ in range(rounds):
        for number, once in list(left.items()):
            try:
                yield number, undisturbed(once, most, long)
            except CrosscheckError as error:
                del left[number]
                yield number, error


def calibration_kernel() -> Callable[[], float]:
    """A function that does the fixed work and returns its time (s) in an undisturbed try."""
    import numpy as np

    generator = np.random.default_rng(6)
    # Diagonally dominant matrices, so that pivoting is the same on all machines.
    matrices = generator.uniform(-1.0, 1.0, (20, 6, 6)) + 6.0 * np.eye(6)
    right = generator.uniform(-1.0, 1.0, (20, 6, 1))

    def once() -> float:
        start = time.perf_counter()
        for _ in range(40):
            np.linalg.solve(matrices, right)
        return time.perf_counter() - start

    return lambda: undisturbed(once)[0]


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
    chosen = grouped((index for index, record in enumerate(records) if record.us_per_step is not None),
                     lambda index: records[index].scene)
    tasks = [Round(scene, tuple(Burst.of(records[index]) for index in own)) for scene, own in chosen.items()]
    samples: list[list[Pair]] = [[] for _ in records]
    for turn in range(1, profile(called).speed + 1):
        for own, made in zip(chosen.values(), _round(stages, tasks, f"{name} {turn}", within), strict=True):
            for index, pairs in zip(own, made, strict=True):
                samples[index] += pairs
    kernels = [kernel for pairs in samples for _, kernel in pairs]
    calibration = Calibration(what=CALIBRATION, us=1e6 * statistics.median(kernels) if kernels else None,
                              deviation=1e6 * spread(kernels) if kernels else None)
    return [_filled_in(record, summarise(pairs)) for record, pairs in zip(records, samples, strict=True)], calibration


def _round(stages: Stages, tasks: list[Round], name: str, within: Limits | None) -> list[list[list[Pair]]]:
    """The pairs of each burst of each task. Runs that crash their process have none."""
    whole = None if within is None or within.time is None else dataclasses.replace(
        within, time=within.time * max((len(task.bursts) for task in tasks), default=1))

    def measured(tasks: list[Round], which: str) -> list[list[list[Pair]] | Crash]:
        return stages.run("speed", time_round, tasks, [digest("speed", name, task) for task in tasks],
                          [f"speed of {task.scene}, {which}" for task in tasks], whole, reuse="samples")

    def without(task: Round, first: list[list[Pair]] | Crash) -> list[list[Pair]]:
        def repeat(left: list[int]) -> list[list[Pair]] | Crash:
            part = dataclasses.replace(task, bursts=tuple(task.bursts[index] for index in left))
            return measured([part], f"{name}, again")[0]

        return without_culprits(repeat, len(task.bursts), first)[0]

    return [without(task, first) for task, first in zip(tasks, measured(tasks, name), strict=True)]


def without_culprits(run: Callable[[list[int]], list[list[Made]] | Crash], count: int,
                     first: list[list[Made]] | Crash | None = None) -> tuple[list[list[Made]], dict[int, str]]:
    """What pieces of work give that one process does in turns, and of some the reason why they give nothing.

    `run` does those with the given numbers. If one of them crashes the process or exceeds the limits, all others are
    done again without it. `first`: what `run` gave for all, if it was called before.
    """
    left = list(range(count))
    reasons: dict[int, str] = {}
    while left:
        made, first = run(left) if first is None else first, None
        if not isinstance(made, Crash):
            by_number = dict(zip(left, made, strict=True))
            return [by_number.get(index, []) for index in range(count)], reasons
        # If none was at work, none is the cause, and another attempt would fail, too.
        culprits = [left[int(made.at)]] if made.at else left
        reasons |= dict.fromkeys(culprits, made.message)
        left = [index for index in left if index not in culprits]
    return [[] for _ in range(count)], reasons


def _filled_in(record: Record, measured: Speed | None) -> Record:
    if measured is None:
        return record
    record = replace(record, speed=measured, us_per_step=measured.us_per_step)
    if not record.steps or not record.duration:
        return record
    per_second = 1e-6 * record.steps / record.duration
    return replace(record, seconds_per_second=per_second * measured.us_per_step,
                   seconds_deviation=per_second * measured.us_deviation)


ENOUGH, ALIKE = 0.1, 1.05
"""Two runs have no third if they take more stepping time (s) than this, as long runs average noise out, or if their
times differ by less than this factor."""

TIMED, SAMPLES = 1.0, 6
"""Simulated time (s) of the timing study, and the output times of its truth."""

COARSER = (8, 4, 2, 1)
"""Steps of the timing study over that of the main run."""

MOST_TIMED = 1000
"""Most steps of repeats, and of all runs at the step of the main run. They are enough to measure the time per step."""


@dataclasses.dataclass(frozen=True)
class Timing:
    """The runs of one scene in a timing study, and the largest number of repeats.

    Of each run its cell, its documented order, and step (s) or rtol of the main run, which is timed, too; None: not.
    """

    runs: tuple[tuple[Cell, int | None, float | None], ...]
    repeats: int


def timed(cells: Sequence[Cell], records: Sequence[Record], repeats: int, stages: Stages,
          within: Limits, place: Place) -> list[Record]:
    """The records with stepping times, one scene after the other in one worker of `place`, with nothing else running.

    Engines in their own environments are left out, because their times are not comparable with others.
    """
    timed_records = list(records)
    for scene, own in grouped(range(len(cells)), lambda index: cells[index].scene).items():
        chosen = [index for index in own if records[index].duration and not records[index].own_environment]
        if chosen:
            task = Timing(tuple((cells[index], records[index].documented_order,
                                 records[index].step or records[index].rtol) for index in chosen), repeats)
            key = digest("timing", task)
            made = stages.kept("timing", key, "samples")
            if made is None:
                made = guarded_timing(task, within, place)
                if stages.session is not None:
                    made = stages.session.put("timing", key, made)
            for position, index in enumerate(chosen):
                timed_records[index] = _with_points(records[index], made[0][position], made[1].get(position))
        stages.count(f"timing of {Path(scene).name}")
    return timed_records


def _with_points(record: Record, points: list[Point], reason: str | None) -> Record:
    if reason is not None:
        record = beyond(record, Finding.ended_early(f"in the timing study: {reason}"))
    for point in points:
        if point.main:
            record = replace(record, us_per_step=point.us_per_step, seconds_per_second=point.seconds_per_second,
                             seconds_deviation=point.seconds_deviation)
    return replace(record, timing=[point for point in points if not point.main])


def guarded_timing(task: Timing, within: Limits | None = None, place: Place | None = None
                   ) -> tuple[list[list[Point]], dict[int, str]]:
    """The points of `time_cells`, made in one worker process, and for some cells the reason why they have none.

    The time limit is that of all cells together. `place`: of a worker that stays.
    """
    each = within or Limits()

    def run(left: list[int]) -> list[list[Point]] | Crash:
        whole = Limits(None if each.time is None else each.time * len(left), each.memory)
        part = dataclasses.replace(task, runs=tuple(task.runs[index] for index in left))
        return run_tasks(time_cells, [part], 1, limits=whole, place=place)[0]

    return without_culprits(run, len(task.runs))


def time_cells(timing: Timing) -> list[list[Point]]:
    """Stepping time against end error of every cell. The runs of all cells take turns in this process.

    Runs have two samples only, so that no engine spends time on output. The first of each makes the whole window and
    has its error; others stop after `MOST_TIMED`, if steps are fixed, as does the last point of a cell ("main"), which
    is at the step of its main run and has no error. Times are medians over the repeats. A failing run gives no point.
    """
    first = timing.runs[0][0]
    scene = load_scene(first.scene)
    short = scene.lasting(min(first.plan.duration or scene.duration, TIMED)).replace(samples=SAMPLES)
    brief, exact = short.replace(samples=2), references.truth(short).states
    end = dataclasses.replace(exact, **{name: getattr(exact, name)[[0, -1]] for name in ("t", "x", "R", "v", "w")},
                              a=None, alpha=None, lam=None)
    ladders = [[cell.plan.step(order) * times for times in COARSER] if order is not None else RTOLS
               for cell, order, _ in timing.runs]
    made: dict[tuple[int, int], list[RawRun]] = {}  # by the number of the run and of its rung
    for _ in range(timing.repeats):
        for index, ((cell, order, main), sizes) in enumerate(zip(timing.runs, ladders, strict=True)):
            child.at(str(index))
            for rung, size in enumerate((*sizes, *(() if main is None else (main,)))):
                before = made.setdefault((index, rung), [])
                if len(before) > 1 and (sum(raw.wall_time for raw in before) > ENOUGH
                                        or max(map(_second, before)) <= ALIKE * min(map(_second, before))):
                    continue
                step, rtol = (size, None) if order is not None else (None, size)
                shorter = brief if step is None or not (before or rung == len(sizes)) else brief.replace(
                    duration=min(brief.duration, MOST_TIMED * step))
                outcome = lasting(attempt(shorter, cell.way, step=step, rtol=rtol, monitor=False, derived=False))
                if isinstance(outcome, Ran):
                    before.append(outcome.raw)
    return [[_point(brief, [*sizes, main or 0.0][rung], order, made[index, rung], end if rung < len(sizes) else None)
             for rung in range(len(sizes) + 1) if made.get((index, rung))]
            for index, ((_, order, main), sizes) in enumerate(zip(timing.runs, ladders, strict=True))]


def _second(raw: RawRun) -> float:
    return raw.wall_time / max(1, raw.steps)


def _point(scene: Scene, size: float, order: int | None, raws: list[RawRun], end: States | None) -> Point:
    """One point. Without `end`, the truth at the end of the runs, it is the point of the main run."""
    whole, each = raws[0], [_second(raw) for raw in raws]
    second, simulated = statistics.median(each), float(whole.states.t[-1]) / max(1, whole.steps)
    return Point(step=size if order is not None else None, rtol=size if order is None else None,
                 wall_time=second * max(1, whole.steps), steps=int(whole.steps), us_per_step=1e6 * second,
                 seconds_per_second=second / simulated, seconds_deviation=spread(each) / simulated,
                 error=None if end is None else errors(scene, whole.states, end)["position"].end, main=end is None)
