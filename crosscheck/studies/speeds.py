"""The speed study seen from the parent: which runs are timed, in rounds of a process each, and what they come to."""

from __future__ import annotations

import dataclasses
import statistics
from collections.abc import Sequence
from typing import Any

from crosscheck.jobs.grid import Crash, Limits
from crosscheck.judge.verdict import Record
from crosscheck.stages import Stages
from crosscheck.verification import speed


def measure_speed(records: Sequence[Record], rounds: int, stages: Stages, within: Limits | None = None,
                  name: str = "round") -> dict[str, Any]:
    """Time the main runs of these records beside the calibration kernel; the records are filled in.

    Parameters
    ----------
    records : of any scenes; those that did not run, or in an environment of their own, are left out
    rounds : processes one after the other, in each of which every run has several turns
    stages : with one job, so that nothing else runs
    within : limits of one run
    name : of these rounds in the journal

    Returns
    -------
    dict
        The calibration kernel: what it is, and its time "us" with its "deviation".
    """
    chosen: dict[str, list[int]] = {}
    for index, record in enumerate(records):
        if record.us_per_step is not None:
            chosen.setdefault(record.scene, []).append(index)
    tasks = [speed.Round(scene, tuple(_burst(records[index]) for index in own)) for scene, own in chosen.items()]
    samples: list[list[tuple[float, float]]] = [[] for _ in records]
    for turn in range(1, rounds + 1):
        for own, found in zip(chosen.values(), _round(stages, tasks, f"{name} {turn}", within), strict=True):
            for index, pairs in zip(own, found, strict=True):
                samples[index] += pairs
    for record, pairs in zip(records, samples, strict=True):
        _fill_in(record, speed.summarise(pairs))
    kernels = [kernel for pairs in samples for _, kernel in pairs]
    return {"what": speed.CALIBRATION, "us": 1e6 * statistics.median(kernels) if kernels else None,
            "deviation": 1e6 * speed.spread(kernels) if kernels else None}


def _burst(record: Record) -> speed.Burst:
    form = None if record.default_form else record.form
    share = None if record.rtol is None or not record.steps else speed.STEPS / record.steps
    return speed.Burst(record.engine, record.method, form, record.step, record.rtol,
                       None if share is None or record.duration is None else share * record.duration)


def _round(stages: Stages, tasks: list[speed.Round], name: str, within: Limits | None) -> list[Any]:
    """Per task and burst its pairs; a run that ends its process is left out of a second attempt, once a scene."""
    whole = None if within is None or within.time is None else dataclasses.replace(
        within, time=within.time * max((len(task.bursts) for task in tasks), default=1))
    keys = [f"{name} {task.scene}" for task in tasks]
    found = stages.run("speed", speed.time_round, tasks, keys, [f"speed of {task.scene}, {name}" for task in tasks],
                       whole)
    for position, task in enumerate(tasks):
        crash = found[position]
        if isinstance(crash, Crash):
            left = [index for index in range(len(task.bursts)) if str(index) != crash.at]
            found[position] = [[] for _ in task.bursts]
            again = dataclasses.replace(task, bursts=tuple(task.bursts[index] for index in left))
            result = stages.run("speed", speed.time_round, [again], [f"{keys[position]}, without {crash.at}"],
                                [f"speed of {task.scene}, {name}, again"], whole)[0]
            for index, pairs in zip(left, [] if isinstance(result, Crash) else result, strict=False):
                found[position][index] = pairs
    return found


def _fill_in(record: Record, measured: speed.Speed | None) -> None:
    if measured is None:
        return
    record.speed = dataclasses.asdict(measured)
    record.us_per_step = measured.us_per_step
    if record.steps and record.duration:
        per_second = 1e-6 * record.steps / record.duration
        record.seconds_per_second = per_second * measured.us_per_step
        record.seconds_deviation = per_second * measured.us_deviation
