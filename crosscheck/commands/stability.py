"""`crosscheck study stability`: the largest step at which every method is still usable, on the hard scenes."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated, Any

import typer


def stability(
    scene: Annotated[list[str] | None, typer.Argument(help='names or paths; default: the scenes tagged "hard"')] = None,
    engine: Annotated[list[str] | None, typer.Option("--engine", help="may be repeated; default: all")] = None,
    method: Annotated[list[str] | None, typer.Option("--method", help="may be repeated; default: all with a fixed step")
                      ] = None,
    time_limit: Annotated[float, typer.Option(min=1e-3, help="s of one run; longer ones are not tried")] = 2.0,
    out: Annotated[Path, typer.Option(help="folder of the JSON and CSV")] = Path("reports/stability"),
) -> None:
    """Largest usable step (end error below 10 %), the error at a common step, and how runs fail beyond."""
    from crosscheck.cli import progress_bar
    from crosscheck.studies import stability_job as job

    request = job.Request(tuple(scene) if scene else None, tuple(engine) if engine else None,
                          tuple(method) if method else None, time_limit)
    with progress_bar() as progress:
        document = job.study(request, out, progress)
    _print(document)
    typer.echo(f"table: {out / 'stability.csv'}")


def _print(document: dict[str, Any]) -> None:
    from rich.console import Console
    from rich.table import Table

    console = Console(width=None if sys.stdout.isatty() else 200, highlight=False)
    table = Table("scene", "run", "h_max, s", "steps", "error there", "ms", "common step, s", "error there", "unusable",
                  box=None)
    for row in document["rows"]:
        label = f"{row['engine']} {row['method']}"
        if row["outcome"] == "unsupported":
            continue
        largest = _figure(row["h_max"]) if row["h_max"] is not None else row["outcome"]
        common = _figure(row["common_error"]) if row["common_outcome"] in ("usable", "inaccurate") else (
            row["common_outcome"])
        table.add_row(row["scene"], label, largest, "" if row["steps"] is None else str(row["steps"]),
                      _figure(row["error"]), _figure(row["milliseconds"]), _figure(row["common_step"]), common,
                      row["failures"] or row["reason"])
    console.print(table)
    best = Table("scene", "largest in-house step, s", "", "largest of the stock engines", "", "ratio",
                 "of all others, with steppers added here", "", "ratio", box=None)
    for line in document["scenes"]:
        best.add_row(line["scene"], _figure(line["own_h_max"]), line["own"], _figure(line["stock_h_max"]),
                     line["stock"], _figure(line["ratio"]), _figure(line["any_h_max"]), line["any"],
                     _figure(line["ratio_any"]))
    console.print(best)
    left = sum(row["outcome"] == "unsupported" for row in document["rows"])
    console.print(f"{len(document['rows'])} ways, {left} of them unsupported by their engine (reasons in the table)")


def _figure(value: float | None) -> str:
    return "" if value is None else f"{value:.3g}"
