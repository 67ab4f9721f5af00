"""`crosscheck study work-precision`: what every engine, form and method pays for its error."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated, Any

import typer

SHOWN = (1, 4, 7)
"""Levels of the table of all methods, among those of `crosscheck.studies.frontier.LEVELS`."""


def work_precision(
    scene: Annotated[list[str] | None, typer.Argument(help="names or paths; default: single_pendulum double_pendulum "
                                                      "heavy_top")] = None,
    engine: Annotated[list[str] | None, typer.Option("--engine", help="may be repeated; default: all")] = None,
    method: Annotated[list[str] | None, typer.Option("--method", help="may be repeated; default: all")] = None,
    repeats: Annotated[int, typer.Option(min=1, help="interleaved rounds; their medians count")] = 5,
    time_limit: Annotated[float, typer.Option(min=1e-3, help="s of stepping of one run; longer rungs are left out")
                          ] = 1.0,
    bound: Annotated[bool, typer.Option(help="also heyoka's Taylor series, which bounds what is possible")] = True,
    out: Annotated[Path, typer.Option(help="folder of the page, JSON and CSV")] = Path("reports/work-precision"),
) -> None:
    """Errors against stepping time and force evaluations, and who leads at 1e-2 ... 1e-11."""
    from crosscheck.cli import progress_bar
    from crosscheck.studies import work_precision_job as job

    request = job.Request(tuple(scene or job.SCENES), tuple(engine) if engine else None,
                          tuple(method) if method else None, repeats, time_limit, bound)
    with progress_bar() as progress:
        document = job.study(request, out, progress)
    _print(document)
    typer.echo(f"page: {out / 'index.html'}")


def _print(document: dict[str, Any]) -> None:
    from rich.console import Console
    from rich.table import Table

    console = Console(width=None if sys.stdout.isatty() else 180, highlight=False)
    for scene in document["scenes"]:
        if scene["failure"]:
            console.print(f"{scene['name']}: no truth: {scene['failure']}", markup=False)
            continue
        table = Table("end error, m", "fastest", "best of lieeuler", "ms", "best of the others", "ms", "factor",
                      "heyoka, ms", "to heyoka", box=None, title=f"{scene['name']}, {scene['duration']:g} s",
                      title_justify="left")
        for front in scene["frontier"]["end position"]:
            table.add_row(f"{front['level']:.0e}", front["winner"] or "-", front["own"] or "-",
                          _figure(front["own_cost"]), front["other"] or "-", _figure(front["other_cost"]),
                          _figure(front["factor"]), _figure(front["bound_cost"]), _figure(front["to_bound"]))
        console.print(table)
        console.print(_by_method(scene))
        counts = {status: sum(rung["status"] == status for rung in scene["rungs"])
                  for status in ("success", "error", "skipped")}
        console.print(f"{counts['success']} runs, {counts['error']} failed, {counts['skipped']} left out; medians of "
                      f"{document['meta']['repeats']}\n")


def _by_method(scene: dict[str, Any]) -> Any:
    from rich.table import Table

    fronts = scene["frontier"]["end position"]
    table = Table("ms to an end error of", *(f"{fronts[index]['level']:.0e}" for index in SHOWN), box=None)
    labels = dict.fromkeys(label for index in reversed(SHOWN) for label in fronts[index]["costs"])
    for label in labels:
        table.add_row(label, *(_figure(fronts[index]["costs"].get(label)) for index in SHOWN))
    return table


def _figure(value: float | None) -> str:
    return "-" if value is None else f"{value:.3g}"
