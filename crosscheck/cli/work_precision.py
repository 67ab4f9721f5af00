"""`crosscheck study work-precision`: what every engine, form and method pays for its error."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from crosscheck.cli import options
from crosscheck.cli.console import console, progress_bar
from crosscheck.cli.options import Engines, chosen, figure
from crosscheck.cli.options import figures as shown
from crosscheck.cli.tables import figures, key, print_table, words

if TYPE_CHECKING:
    from rich.console import Console

SHOWN = (1, 4, 7)
"""Levels of the table of all methods, among those of `crosscheck.studies.frontier.LEVELS`."""


def work_precision(
    scene: Annotated[list[str] | None, options.scenes("single_pendulum double_pendulum heavy_top")] = None,
    engine: Engines = None,
    method: Annotated[list[str] | None, options.methods("all")] = None,
    repeats: Annotated[int, typer.Option(min=1, help="interleaved rounds; their medians count")] = 5,
    time_limit: Annotated[float, options.time_limit("stepping only; longer rungs are left out")] = 1.0,
    bound: Annotated[bool, typer.Option(help="also heyoka's Taylor series, which bounds what is possible")] = True,
    coordinate_map: options.CoordinateMap = None,
    duration: options.Duration = None,
    out: Annotated[Path, typer.Option(help="folder of the page, JSON and CSV")] = Path("reports/work-precision"),
) -> None:
    """Errors against stepping time and force evaluations, and who leads at 1e-2 ... 1e-11."""
    from crosscheck.studies.study import conduct
    from crosscheck.studies.work_precision import WorkPrecision, WorkPrecisionAsk

    ask = WorkPrecisionAsk(chosen(scene), chosen(engine), chosen(method), time_limit, repeats, bound, duration,
                           coordinate_map=coordinate_map)
    with progress_bar() as progress:
        document = conduct(WorkPrecision(), ask, out, progress)
    _print(document)
    typer.echo(f"page: {out / 'index.html'}")


def _print(document: dict[str, Any]) -> None:
    terminal = console(180)
    columns = [*figures("end error, m"), words("fastest"), words("best of lieeuler"), *figures("ms"),
               words("best of the others"), *figures("ms", "factor", "heyoka, ms", "to heyoka")]
    for scene in document["scenes"]:
        if scene["failure"]:
            terminal.print(f"{scene['name']}: no truth: {scene['failure']}", markup=False)
            continue
        rows = []
        for front in scene["frontier"]["end position"]:
            own, other, factor, bound, to_bound = shown(
                (front[name] for name in ("own_cost", "other_cost", "factor", "bound_cost", "to_bound")), "-")
            winner, best, rival = (front[name] or "-" for name in ("winner", "own", "other"))
            rows.append((f"{front['level']:.0e}", winner, best, own, rival, other, factor, bound, to_bound))
        print_table(terminal, columns, rows, f"{scene['name']}, {scene['duration']:g} s")
        _print_methods(terminal, scene)
        counts = {status: sum(rung["status"] == status for rung in scene["rungs"])
                  for status in ("success", "error", "skipped")}
        terminal.print(f"{counts['success']} runs, {counts['error']} failed, {counts['skipped']} left out; medians of "
                      f"{document['meta']['repeats']}\n")


def _print_methods(terminal: Console, scene: dict[str, Any]) -> None:
    fronts = [scene["frontier"]["end position"][index] for index in SHOWN]
    labels = dict.fromkeys(label for front in reversed(fronts) for label in front["costs"])
    print_table(terminal, [key("ms to an end error of"), *figures(*(f"{front['level']:.0e}" for front in fronts))],
                [(label, *(figure(front["costs"].get(label), "-") for front in fronts)) for label in labels])
