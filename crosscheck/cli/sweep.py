"""`crosscheck sweep`: runs over many scenes, parameters, members, engines and steps, on one machine or a cluster."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Annotated

import typer

from crosscheck.cli import options
from crosscheck.cli.console import console, counted, progress_bar, say
from crosscheck.cli.tables import figures, key, print_table


def sweep(
    file: Annotated[Path, typer.Argument(help="TOML file: scenes, engines, steps and/or rtols, parameters, perturb")],
    out: Annotated[Path | None, typer.Option("-o", "--out", help="folder of results and page; finished cells are kept")
                   ] = None,
    workers: Annotated[int, typer.Option(min=1, help="processes of this machine")] = 2,
    scheduler: options.Scheduler = None,
    dry_run: Annotated[bool, typer.Option("--dry-run", help="only print the number of cells and the time")] = False,
    fresh: options.Fresh = "CI" in os.environ,
    cell: Annotated[str | None, typer.Option(help="run only this cell again, and print its row")] = None,
) -> None:
    """Run a sweep. Finished cells are not computed again, so the same command continues an interrupted sweep."""
    import msgspec

    from crosscheck.sweeps import job

    target = out or Path("reports") / f"sweep-{file.stem}"
    if dry_run:
        count, missing, seconds = job.estimate(file, target, workers)
        spoken = (f"{seconds:.0f} s" if seconds < 120 else f"{seconds / 60:.0f} min" if seconds < 7200 else
                  f"{seconds / 3600:.1f} h")
        say(f"{counted(count, 'cell')}, of which {count - missing} finished and {missing} to be computed, about "
            f"{spoken} with {counted(workers, 'worker')}")
        return
    if cell is not None:
        for name, value in msgspec.structs.asdict(job.one(file, cell)).items():
            typer.echo(f"{name}: {value}")
        return
    with progress_bar() as progress:
        frame = job.sweep(file, workers, scheduler, target, progress, fresh)
    report = frame.attrs["report"]
    counts = frame.groupby(["scene", "engine", "method"], dropna=False)
    print_table(console(160), [key("scene"), key("engine"), key("method"), *figures(
        "cells", "failed", "median position error, m", "largest, m")], [
        (scene, engine, method, str(len(rows)), str(int((rows["status"] != "success").sum())),
         f"{rows['position_error'].median():.3g}", f"{rows['position_error'].max():.3g}")
        for (scene, engine, method), rows in counts])
    say(f"{counted(len(frame), 'cell')}, {report['computed']} computed in {report['seconds']:.1f} s with "
        f"{counted(report['workers'], 'worker')}: truth {report['truth_seconds']:.1f} s, runs "
        f"{report['run_seconds']:.1f} s, overhead {1e3 * report['overhead']:.1f} ms a cell")
    for text in report["trouble"]:
        say(f"without truth: {text}")
    page = target / "index.html"
    typer.echo(f"page: {page}" if page.exists() else f"results: {target / 'parts'} (no page: pip install "
               "'lieeuler-crosscheck[report]')")
