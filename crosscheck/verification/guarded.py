"""Cells in worker processes: limits, loading of the user's own engines, and text that engines print."""

from __future__ import annotations

from collections.abc import Sequence

from msgspec.structs import replace

from crosscheck import adapters
from crosscheck.document import Finding, Judged
from crosscheck.errors import ArgumentError
from crosscheck.jobs.grid import Limits
from crosscheck.jobs.workers import output
from crosscheck.jobs.workers.process import GIGABYTE
from crosscheck.judge.verdict import beyond
from crosscheck.running import versions
from crosscheck.verification.cell import run_cell
from crosscheck.verification.task import Cell

TIME_LIMIT = 1800.0
"""Time limit (s) of one cell: a main run and its order study. With built-in engines it takes seconds to minutes."""

MEMORY_LIMIT = 4.0
"""Limit of resident memory (GB) of one worker process. With all built-in engines loaded it needs 0.2 GB."""

SHOWN = 200
"""Most characters of printed text that a record quotes."""


def limits(time_limit: float | None = TIME_LIMIT, memory_limit: float | None = MEMORY_LIMIT) -> Limits:
    """Limits of a cell from the options of the command line, in s and GB. None means no limit."""
    for name, value in (("time-limit", time_limit), ("memory-limit", memory_limit)):
        if value is not None and not value > 0:
            raise ArgumentError(f"{name}: a positive number is wanted, not {value:g}")
    return Limits(time_limit, None if memory_limit is None else memory_limit * GIGABYTE)


def check_engines(names: Sequence[str]) -> None:
    """Raise `ArgumentError` or `EngineError` for an engine that is unknown, not installed or cannot be loaded."""
    for name in names:
        if isinstance(name, str) and adapters.is_own(name):
            adapters.get(name)
    versions.need(names)


def guarded_cell(cell: Cell) -> Judged:
    """`run_cell`, but a run fails if its engine printed text, because a user would miss a warning in it."""
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
