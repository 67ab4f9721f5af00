"""The speed study: time per step of every run relative to a calibration kernel, so that nights and machines compare.

A run's time is divided by the time of a fixed piece of work just before and after it, because a busy or slow machine
slows down both. Both are short, and a try is repeated if the process had to wait for the processor. The runs of a scene
take turns, every round is a new process, and the result is the median of all turns.
"""

from __future__ import annotations

import dataclasses
import statistics
import time
from collections.abc import Callable, Sequence
from typing import Any

from msgspec.structs import replace

from crosscheck.document import Calibration, Record, Speed
from crosscheck.errors import CrosscheckError
from crosscheck.jobs.grid import Crash, Limits
from crosscheck.jobs.stages import Stages
from crosscheck.jobs.table import digest

CALIBRATION = "40 times the LU solutions of 20 dense systems of 6 equations (numpy.linalg.solve)"
"""The calibration kernel: compiled loops over small matrices, as in a multibody step, without any engine's code. The
few matrices stay in the innermost cache, as the data of a step does. With 800 matrices at once, the ratio of a method
varied twice as much between processes on a loaded machine."""

REPEATS = 3
"""Number of turns of each run in one round."""

STEPS, FEWEST = 100, 8
"""Steps of a timed run of one body, and least steps of a run of many bodies. They take 0.1 to 10 ms."""

TRIES, PATIENCE = 3, 12
"""A turn is the fastest of TRIES undisturbed tries, out of at most PATIENCE tries."""

LONG = 0.01
"""After this time (s, with the building of models) one undisturbed try is enough, as long runs average noise out."""

ONCE = 0.1
"""Runs that take longer (s, with the building of models) have only one turn per round and no turn to warm up."""

WAITED = 0.03
"""Largest share of waiting in an undisturbed try."""


@dataclasses.dataclass(frozen=True)
class Burst:
    """A run to be timed."""

    engine: str
    method: str
    form: str | None
    step: float | None  # s
    rtol: float | None
    duration: float | None = None  # s, of an adaptive run: the time of about `STEPS` steps; None: the whole scene
    coordinate_map: str | None = None

    @classmethod
    def of(cls, record: Record) -> Burst:
        """A short version of the main run of a record."""
        share = None if record.rtol is None or not record.steps else STEPS / record.steps
        return cls(record.engine, record.method, None if record.default_form else record.form, record.step, record.rtol,
                   None if share is None or record.duration is None else share * record.duration,
                   record.coordinate_map)


@dataclasses.dataclass(frozen=True)
class Round:
    """The runs of one scene (a name or a path) that take turns, and the number of turns."""

    scene: str
    bursts: tuple[Burst, ...]
    repeats: int = REPEATS


def time_round(task: Round) -> list[list[tuple[float, float]]]:
    """For each burst, pairs (s per step, s of the calibration kernel). The list is empty for a run that fails."""
    from crosscheck.jobs.workers import output
    from crosscheck.scene.file import load_scene

    scene = load_scene(task.scene)
    kernel = calibration_kernel()
    kernel()
    samples: list[list[tuple[float, float]]] = [[] for _ in task.bursts]
    done: set[int] = set()
    for turn in range(task.repeats + 1):
        before = kernel()
        for index, burst in enumerate(task.bursts):
            if index in done:
                continue
            output.at(str(index))
            began = time.perf_counter()
            seconds = _seconds_per_step(scene, burst, warming=not turn)
            long = time.perf_counter() - began > ONCE
            after = kernel()
            if seconds is None or long:
                done.add(index)
            if seconds is not None and (turn or long):  # the first turn loads libraries and fills caches
                samples[index].append((seconds, 0.5 * (before + after)))
            before = after
    return samples


def _seconds_per_step(scene: Any, burst: Burst, warming: bool) -> float | None:
    """Seconds per step of an undisturbed run, or with `warming` of any run; None if the run fails."""
    from crosscheck.running.run import run

    wanted = burst.duration if burst.step is None else burst.step * max(FEWEST, STEPS // scene.n)
    brief = scene.replace(duration=min(scene.duration, wanted or scene.duration), samples=2)
    steps = 1

    def once() -> float:
        nonlocal steps
        traj = run(brief, burst.engine, burst.method, step=burst.step, rtol=burst.rtol, form=burst.form, monitor=False,
                   coordinate_map=burst.coordinate_map)
        steps = traj.steps
        return traj.wall_time

    try:
        return (once() if warming else undisturbed(once)[0]) / steps
    except CrosscheckError:  # failures are recorded by the main run of the same cell
        return None


def undisturbed(once: Callable[[], float], most: int = PATIENCE, long: float = LONG) -> tuple[float, float]:
    """The seconds that `once` returns and the other seconds that it took, in the fastest undisturbed try.

    Ends after TRIES undisturbed tries, after `most` tries in all, or after an undisturbed one when `long` (s) is over.
    """
    clean: list[tuple[float, float]] = []
    others: list[tuple[float, float]] = []
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


def summarise(samples: list[tuple[float, float]]) -> Speed | None:
    """Medians and deviations of the pairs of all rounds; None if there are no pairs."""
    if not samples:
        return None
    times = [1e6 * seconds for seconds, _ in samples]
    ratios = [seconds / kernel for seconds, kernel in samples]
    return Speed(us_per_step=statistics.median(times), us_deviation=spread(times), ratio=statistics.median(ratios),
                 deviation=spread(ratios), repeats=len(samples),
                 calibration=1e6 * statistics.median(kernel for _, kernel in samples))


def spread(values: list[float]) -> float:
    """Median absolute deviation."""
    middle = statistics.median(values)
    return statistics.median(abs(value - middle) for value in values)


def measure_speed(records: Sequence[Record], rounds: int, stages: Stages, within: Limits | None = None,
                  name: str = "round") -> tuple[list[Record], Calibration]:
    """The records with the times of their main runs relative to the calibration kernel, and the kernel's time.

    Parameters
    ----------
    records : of any scenes; records of failed runs and of engines in their own environments are not changed
    rounds : number of processes, one after the other; every run has several turns in each
    stages : with one job, so that nothing else runs
    within : limits of one run
    name : of these rounds, which are measured once a session
    """
    chosen: dict[str, list[int]] = {}
    for index, record in enumerate(records):
        if record.us_per_step is not None:
            chosen.setdefault(record.scene, []).append(index)
    tasks = [Round(scene, tuple(Burst.of(records[index]) for index in own)) for scene, own in chosen.items()]
    samples: list[list[tuple[float, float]]] = [[] for _ in records]
    for turn in range(1, rounds + 1):
        for own, found in zip(chosen.values(), _round(stages, tasks, f"{name} {turn}", within), strict=True):
            for index, pairs in zip(own, found, strict=True):
                samples[index] += pairs
    kernels = [kernel for pairs in samples for _, kernel in pairs]
    calibration = Calibration(what=CALIBRATION, us=1e6 * statistics.median(kernels) if kernels else None,
                              deviation=1e6 * spread(kernels) if kernels else None)
    return [_filled_in(record, summarise(pairs)) for record, pairs in zip(records, samples, strict=True)], calibration


def _round(stages: Stages, tasks: list[Round], name: str, within: Limits | None) -> list[Any]:
    """The pairs of each burst of each task. If a run crashes its process, the task is tried once more without it."""
    whole = None if within is None or within.time is None else dataclasses.replace(
        within, time=within.time * max((len(task.bursts) for task in tasks), default=1))
    keys = [digest("speed", name, task) for task in tasks]
    found = stages.run("speed", time_round, tasks, keys, [f"speed of {task.scene}, {name}" for task in tasks],
                       whole, reuse="samples")
    for position, task in enumerate(tasks):
        crash = found[position]
        if isinstance(crash, Crash):
            left = [index for index in range(len(task.bursts)) if str(index) != crash.at]
            found[position] = [[] for _ in task.bursts]
            again = dataclasses.replace(task, bursts=tuple(task.bursts[index] for index in left))
            result = stages.run("speed", time_round, [again], [digest("speed", name, again)],
                                [f"speed of {task.scene}, {name}, again"], whole, reuse="samples")[0]
            for index, pairs in zip(left, [] if isinstance(result, Crash) else result, strict=False):
                found[position][index] = pairs
    return found


def _filled_in(record: Record, measured: Speed | None) -> Record:
    if measured is None:
        return record
    record = replace(record, speed=measured, us_per_step=measured.us_per_step)
    if not record.steps or not record.duration:
        return record
    per_second = 1e-6 * record.steps / record.duration
    return replace(record, seconds_per_second=per_second * measured.us_per_step,
                   seconds_deviation=per_second * measured.us_deviation)
