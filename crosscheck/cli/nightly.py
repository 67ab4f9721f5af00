"""`crosscheck nightly`: runs everything, compares with the last good run, and prints a summary for a chat message."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from crosscheck.cli import options
from crosscheck.cli.console import progress_bar, say


def nightly(
    scene: options.SceneNames = None,
    engine: options.Engines = None,
    profile: Annotated[str, typer.Option(help="as in `crosscheck verify`")] = "full",
    coordinate_map: options.CoordinateMap = None,
    step: options.Step = None,
    duration: options.Duration = None,
    jobs: options.Jobs = 2,
    scheduler: options.Scheduler = None,
    time_limit: options.TimeLimit = 1800.0,
    memory_limit: options.MemoryLimit = 4.0,
    out: Annotated[Path, typer.Option("--out", "-o", help="folder with a subfolder per run, and the link latest")
                   ] = Path("reports/nightly"),
    store: Annotated[str | None, typer.Option(help="history: an SQLite file or postgresql://...; default: "
                                              "CROSSCHECK_STORE, else history.sqlite beside the folder --out"
                                              )] = None,
    fresh: Annotated[bool, typer.Option(help="compute everything anew")] = True,
    keep: Annotated[int, typer.Option(help="number of reports to keep; the history keeps all runs")] = 14,
) -> None:
    """Run everything, compare with the last good run, store the result and write the report.

    A run that was killed continues when the command is repeated.

    Exit code 0: all within tolerance and no finding; 1: a verdict failed or something became worse; 2: the run failed.
    """
    from crosscheck.document import Asked
    from crosscheck.history import nightly as job
    from crosscheck.verification.job import limits_of

    wanted = job.Wanted(profile, scene, engine, jobs, limits_of(time_limit, memory_limit),
                        Asked(coordinate_map=coordinate_map, step=step, duration=duration), scheduler, fresh)
    with progress_bar() as progress:
        night = job.nightly(out, wanted, store, keep, progress)
    for line in night.summary.splitlines():
        say(line, hang=2)
    raise typer.Exit(night.exit_code)
