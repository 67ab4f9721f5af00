"""`crosscheck study work-precision`: what every engine, form and method pays for its error."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from crosscheck.cli import options
from crosscheck.cli.console import console, progress_bar
from crosscheck.cli.options import Engines, chosen, figure, figures

SHOWN = (1, 4, 7)
"""Levels of the table of all methods, among those of `crosscheck.studies.frontier.LEVELS`."""


def work_precision(
    scene: Annotated[list[str] | None, options.scenes("single_pendulum double_pendulum heavy_top")] = None,
    engine: Engines = None,
    method: Annotated[list[str] | None, options.methods("all")] = None,
    repeats: Annotated[int, typer.Option(min=1, help="interleaved rounds; their medians count")] = 5,
    time_limit: Annotated[float, options.time_limit("stepping only; longer rungs are left out")] = 1.0,
    bound: Annotated[bool, typer.Option(help="also heyoka's Taylor series, which bounds what is possible")] = True,
    out: Annotated[Path, typer.Option(help="folder of the page, JSON and CSV")] = Path("reports/work-precision"),
) -> None:
    """Errors against stepping time and force evaluations, and who leads at 1e-2 ... 1e-11."""
    from crosscheck.studies.study import conduct
    from crosscheck.studies.work_precision import WorkPrecision, WorkPrecisionAsk

    ask = WorkPrecisionAsk(chosen(scene), chosen(engine), chosen(method), time_limit, repeats, bound)
    with progress_bar() as progress:
        document = conduct(WorkPrecision(), ask, out, progress)
    _print(document)
    typer.echo(f"page: {out / 'index.html'}")


def _print(document: dict[str, Any]) -> None:
    from rich.table import Table

    terminal = console(180)
    for scene in document["scenes"]:
        if scene["failure"]:
            terminal.print(f"{scene['name']}: no truth: {scene['failure']}", markup=False)
            continue
        table = Table("end error, m", "fastest", "best of lieeuler", "ms", "best of the others", "ms", "factor",
                      "heyoka, ms", "to heyoka", box=None, title=f"{scene['name']}, {scene['duration']:g} s",
                      title_justify="left")
        for front in scene["frontier"]["end position"]:
            own, other, factor, bound, to_bound = figures(
                (front[key] for key in ("own_cost", "other_cost", "factor", "bound_cost", "to_bound")), "-")
            table.add_row(f"{front['level']:.0e}", front["winner"] or "-", front["own"] or "-", own,
                          front["other"] or "-", other, factor, bound, to_bound)
        terminal.print(table)
        terminal.print(_by_method(scene))
        counts = {status: sum(rung["status"] == status for rung in scene["rungs"])
                  for status in ("success", "error", "skipped")}
        terminal.print(f"{counts['success']} runs, {counts['error']} failed, {counts['skipped']} left out; medians of "
                      f"{document['meta']['repeats']}\n")


def _by_method(scene: dict[str, Any]) -> Any:
    from rich.table import Table

    fronts = scene["frontier"]["end position"]
    table = Table("ms to an end error of", *(f"{fronts[index]['level']:.0e}" for index in SHOWN), box=None)
    labels = dict.fromkeys(label for index in reversed(SHOWN) for label in fronts[index]["costs"])
    for label in labels:
        table.add_row(label, *(figure(fronts[index]["costs"].get(label), "-") for index in SHOWN))
    return table
