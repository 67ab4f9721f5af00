"""`crosscheck study stability`: the largest step at which every method is still usable, on the hard scenes."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from crosscheck.cli import options
from crosscheck.cli.console import console, progress_bar
from crosscheck.cli.options import Engines, chosen, figure, figures


def stability(
    scene: Annotated[list[str] | None, options.scenes('the scenes tagged "hard", both pendulums and the heavy top')
                     ] = None,
    engine: Engines = None,
    method: Annotated[list[str] | None, options.methods("all with a fixed step")] = None,
    time_limit: Annotated[float, options.time_limit("longer ones are not tried")] = 2.0,
    jobs: Annotated[int, typer.Option(min=1, help="worker processes")] = 2,
    out: Annotated[Path, typer.Option(help="folder of the page, JSON and CSV")] = Path("reports/stability"),
) -> None:
    """Largest usable step (end error below 10 %), the error at a common step, and how runs fail beyond.

    A study that was killed goes on where it was when it is started again with the same arguments.
    """
    from crosscheck.studies.stability import Stability, StabilityAsk
    from crosscheck.studies.study import conduct

    ask = StabilityAsk(chosen(scene), chosen(engine), chosen(method), time_limit, jobs)
    with progress_bar() as progress:
        document = conduct(Stability(), ask, out, progress)
    _print(document)
    typer.echo(f"page: {out / 'index.html'}")


def _print(document: dict[str, Any]) -> None:
    from rich.table import Table

    terminal = console(200)
    table = Table("scene", "run", "h_max, s", "steps", "error there", "ms", "common step, s", "error there", "unusable",
                  box=None)
    for row in document["rows"]:
        if row["outcome"] == "unsupported":
            continue
        largest = figure(row["h_max"], row["outcome"])
        common = figure(row["common_error"], row["common_outcome"])
        table.add_row(row["scene"], f"{row['engine']} {row['method']}", largest,
                      "" if row["steps"] is None else str(row["steps"]), figure(row["error"]),
                      figure(row["milliseconds"]), figure(row["common_step"]), common, row["failures"] or row["reason"])
    terminal.print(table)
    best = Table("scene", "largest in-house step, s", "", "largest of the stock engines", "", "ratio",
                 "of all others, with steppers added here", "", "ratio", box=None)
    for line in document["scenes"]:
        own, stock, ratio, other, ratio_any = figures(
            line[key] for key in ("own_h_max", "stock_h_max", "ratio", "any_h_max", "ratio_any"))
        best.add_row(line["scene"], own, line["own"], stock, line["stock"], ratio, other, line["any"], ratio_any)
    terminal.print(best)
    left = sum(row["outcome"] == "unsupported" for row in document["rows"])
    terminal.print(f"{len(document['rows'])} ways, {left} of them unsupported by their engine (reasons in the table), "
                  f"{document['meta']['seconds']:.0f} s with {document['meta']['jobs']} worker processes")
