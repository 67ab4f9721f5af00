"""Cells and timings as worker processes run them: what an engine prints, and how its process ends, enter the record."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any

from crosscheck import adapters
from crosscheck.errors import ArgumentError, EngineError
from crosscheck.jobs.grid import Crash, Limits, run_tasks
from crosscheck.jobs.workers import output
from crosscheck.jobs.workers.process import GIGABYTE
from crosscheck.judge.verdict import Finding, Record
from crosscheck.verification.cell import Cell, Timing, run_cell, time_cells

TIME_LIMIT = 1800.0
"""s of one cell (a main run and its order study); those of the built-in engines take seconds to minutes."""

MEMORY_LIMIT = 4.0
"""GB resident of one worker process; with every built-in engine loaded and run it has 0.2."""

LOADING = 60.0
"""s that importing an engine of the user's own may take at least, however short a run has to be."""

SHOWN = 200
"""Characters of printed text that a record quotes."""


def limits(time_limit: float | None = TIME_LIMIT, memory_limit: float | None = MEMORY_LIMIT) -> Limits:
    """Limits of a cell from the options of the command line: s and GB, None for no limit."""
    for name, value in (("time-limit", time_limit), ("memory-limit", memory_limit)):
        if value is not None and not value > 0:
            raise ArgumentError(f"{name}: a positive number is wanted, not {value:g}")
    return Limits(time_limit, None if memory_limit is None else memory_limit * GIGABYTE)


def check_engines(names: Sequence[str], within: Limits | None = None) -> None:
    """Raise `ArgumentError` or `EngineError` for a name that stands for no engine that can be loaded.

    A class of the user's own is loaded in a worker process first: its module may crash or hang.
    """
    risky = [name for name in names if isinstance(name, str) and adapters.is_own(name)]
    patient = within
    if within is not None and within.time is not None:
        patient = dataclasses.replace(within, time=max(LOADING, within.time))
    for name, found in zip(risky, run_tasks(adapters.methods, risky, 1, limits=patient), strict=True):
        if isinstance(found, Crash):
            raise found.error if isinstance(found.error, ArgumentError) else EngineError(
                f"engine {name} cannot be loaded: {found.message}")
    for name in names:
        adapters.get(name)


def guarded_cell(cell: Cell) -> Record:
    """`run_cell`, and what its engine printed: nobody reads that, so that a warning in it would be lost."""
    record = run_cell(cell)
    record.own_environment = adapters.has_own_environment(cell.engine)
    if record.own_environment:
        record.us_per_step = record.seconds_per_second = None
        for rung in record.ladder:
            rung["wall_time"] = None
    lines = [line for line in output.heard().splitlines() if line.strip()]
    if lines:
        shown = "".join(letter if letter.isprintable() else "?" for letter in lines[0].strip()[:SHOWN])
        shown = f"it printed {len(lines)} lines, first: {shown}"
        record.findings.append(Finding("run", "fail", None, None, "", "an engine answers by what it returns; what it "
                                       "prints is lost on its user", shown))
        record.outcome = "fail"
        record.message = "; ".join(filter(None, (record.message, shown)))
    return record


def guarded_timing(task: Timing, within: Limits | None = None) -> tuple[list[list[dict[str, Any]]], dict[int, str]]:
    """The timings of `time_cells`, all of them in one worker process, and why there is none of some cells.

    A cell that ends the process or does not come to an end is left out of a second attempt, and so on; the limit of
    time is that of all cells together.
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
        # Without a culprit it was none of the engines: another attempt would end alike.
        for index in left if culprit is None else [left[culprit]]:
            reasons[index] = found.message
        left = [] if culprit is None else left[:culprit] + left[culprit + 1:]
    return [[] for _ in task.cells], reasons
