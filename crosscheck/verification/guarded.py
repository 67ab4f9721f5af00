"""Cells as worker processes run them: what an engine prints, and how its process ends, enter the record."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

from msgspec.structs import replace

from crosscheck import adapters
from crosscheck.document import Finding, Judged
from crosscheck.errors import ArgumentError, EngineError
from crosscheck.jobs.grid import Crash, Limits, run_tasks
from crosscheck.jobs.workers import output
from crosscheck.jobs.workers.process import GIGABYTE
from crosscheck.judge.verdict import beyond
from crosscheck.running import versions
from crosscheck.verification.cell import run_cell
from crosscheck.verification.task import Cell

TIME_LIMIT = 1800.0
"""s of one cell (a main run and its order study); those of the built-in engines take seconds to minutes."""

MEMORY_LIMIT = 4.0
"""GB resident of one worker process; with every built-in engine loaded and run it has 0.2."""

LOADING = 60.0
"""s that importing an engine of the user's own may take at least, however short a run has to be."""

_LOADED: set[str] = set()
"""Engines of the user's own that a worker process could load."""

SHOWN = 200
"""Characters of printed text that a record quotes."""


def limits(time_limit: float | None = TIME_LIMIT, memory_limit: float | None = MEMORY_LIMIT) -> Limits:
    """Limits of a cell from the options of the command line: s and GB, None for no limit."""
    for name, value in (("time-limit", time_limit), ("memory-limit", memory_limit)):
        if value is not None and not value > 0:
            raise ArgumentError(f"{name}: a positive number is wanted, not {value:g}")
    return Limits(time_limit, None if memory_limit is None else memory_limit * GIGABYTE)


def check_engines(names: Sequence[str], within: Limits | None = None) -> None:
    """Raise `ArgumentError` or `EngineError` for a name that stands for no engine that is installed and can be loaded.

    A class of the user's own is loaded in a worker process first, once: its module may crash or hang.
    """
    risky = [name for name in names if isinstance(name, str) and adapters.is_own(name) and name not in _LOADED]
    patient = within
    if within is not None and within.time is not None:
        patient = dataclasses.replace(within, time=max(LOADING, within.time))
    for name, found in zip(risky, run_tasks(adapters.methods, risky, 1, limits=patient), strict=True):
        if isinstance(found, Crash):
            raise found.error if isinstance(found.error, ArgumentError) else EngineError(
                f"engine {name} cannot be loaded: {found.message}")
        _LOADED.add(name)
    versions.need(names)


def guarded_cell(cell: Cell) -> Judged:
    """`run_cell`; text that the engine printed fails the run, because its user would miss a warning in it."""
    judged = run_cell(cell)
    if adapters.has_own_environment(cell.engine):
        judged = replace(judged, own_environment=True, us_per_step=None, seconds_per_second=None,
                         ladder=[replace(rung, wall_time=None) for rung in judged.ladder])
    lines = [line for line in output.heard().splitlines() if line.strip()]
    if not lines:
        return judged
    shown = "".join(letter if letter.isprintable() else "?" for letter in lines[0].strip()[:SHOWN])
    shown = f"it printed {len(lines)} lines, first: {shown}"
    return beyond(judged, Finding("run", "fail", None, None, "", "an engine answers by what it returns; what it prints "
                                  "is lost on its user", shown), shown)
