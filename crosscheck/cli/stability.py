"""`crosscheck study stability`: the largest step at which every method is still usable, on the hard scenes."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from crosscheck.cli import options
from crosscheck.cli.console import console, progress_bar
from crosscheck.cli.options import Engines, chosen, figure
from crosscheck.cli.options import figures as shown
from crosscheck.cli.tables import figures, key, print_table, words


def stability(
    scene: Annotated[list[str] | None, options.scenes('the scenes tagged "hard", both pendulums and the heavy top')
                     ] = None,
    engine: Engines = None,
    method: Annotated[list[str] | None, options.methods("all with a fixed step")] = None,
    time_limit: Annotated[float, options.time_limit("longer ones are not tried")] = 2.0,
    jobs: Annotated[int, typer.Option(min=1, help="worker processes")] = 2,
    coordinate_map: options.CoordinateMap = None,
    step: Annotated[float | None, typer.Option(min=1e-9, help="s, the common step; default: one that suits each scene")
                    ] = None,
    duration: options.Duration = None,
    out: Annotated[Path, typer.Option(help="folder of the page, JSON and CSV")] = Path("reports/stability"),
) -> None:
    """Largest usable step (end error below 10 %), the error at a common step, and how runs fail beyond.

    A study that was killed goes on where it was when it is started again with the same arguments.
    """
    from crosscheck.studies.stability import Stability, StabilityAsk
    from crosscheck.studies.study import conduct

    ask = StabilityAsk(chosen(scene), chosen(engine), chosen(method), time_limit, jobs, step, duration,
                       coordinate_map=coordinate_map)
    with progress_bar() as progress:
        document = conduct(Stability(), ask, out, progress)
    _print(document)
    typer.echo(f"page: {out / 'index.html'}")


def _print(document: dict[str, Any]) -> None:
    terminal = console(200)
    columns = [key("scene"), key("run"), *figures("h_max, s", "steps", "error there", "ms", "common step, s"),
               words("error there"), words("unusable")]
    rows = [(row["scene"], f"{row['engine']} {row['method']}", figure(row["h_max"], row["outcome"]),
             "" if row["steps"] is None else str(row["steps"]), figure(row["error"]), figure(row["milliseconds"]),
             figure(row["common_step"]), figure(row["common_error"], row["common_outcome"]),
             row["failures"] or row["reason"])
            for row in document["rows"] if row["outcome"] != "unsupported"]
    print_table(terminal, columns, rows)
    best = [key("scene"), *figures("largest in-house step, s"), words("by"), *figures("largest of the stock engines"),
            words("by"), *figures("ratio", "of all others, with steppers added here"), words("by"), *figures("ratio")]
    lines = []
    for line in document["scenes"]:
        own, stock, ratio, other, ratio_any = shown(
            line[name] for name in ("own_h_max", "stock_h_max", "ratio", "any_h_max", "ratio_any"))
        lines.append((line["scene"], own, line["own"], stock, line["stock"], ratio, other, line["any"], ratio_any))
    print_table(terminal, best, lines)
    left = sum(row["outcome"] == "unsupported" for row in document["rows"])
    terminal.print(f"{len(document['rows'])} ways, {left} of them unsupported by their engine (reasons in the table), "
                  f"{document['meta']['seconds']:.0f} s with {document['meta']['jobs']} worker processes")
