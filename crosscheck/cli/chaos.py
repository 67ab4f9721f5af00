"""`crosscheck study chaos`: past the horizon, distributions in place of trajectories."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from crosscheck.cli import options
from crosscheck.cli.console import console, progress_bar
from crosscheck.cli.options import Engines, chosen
from crosscheck.cli.options import figures as shown
from crosscheck.cli.tables import figures, key, print_table, words


def chaos(
    scene: Annotated[list[str] | None, options.scenes("thrown_double thrown_triple")] = None,
    engine: Engines = None,
    method: Annotated[list[str] | None, options.methods("rattle2 rattle4 DAE1H_LSE RK4 RK44 RKMK4")] = None,
    duration: Annotated[float, typer.Option(min=1.0, help="s, of each run")] = 2000.0,
    step: Annotated[float, typer.Option(min=1e-9, help="s; a power of 2 keeps clocks that add it up exact")] = 2.0**-8,
    time_limit: Annotated[float, options.time_limit("longer ones are left out")] = 120.0,
    coordinate_map: options.CoordinateMap = None,
    out: Annotated[Path, typer.Option(help="folder of the page, JSON and CSV")] = Path("reports/chaos"),
) -> None:
    """Do methods and engines agree on energies and heights of chaotic scenes, past the time where trajectories can?

    Exit code 0: no distribution differs; 1: one does.
    """
    from crosscheck.studies.chaos import ChaosAsk, ChaosStudy
    from crosscheck.studies.study import conduct

    ask = ChaosAsk(chosen(scene), chosen(engine), chosen(method), time_limit, duration, step,
                   coordinate_map=coordinate_map)
    with progress_bar() as progress:
        document = conduct(ChaosStudy(), ask, out, progress)
    _print(document)
    typer.echo(f"page: {out / 'index.html'}")
    raise typer.Exit(int(any(run["verdict"] == "differs" for run in document["runs"])))


def _print(document: dict[str, Any]) -> None:
    terminal = console(200)
    columns = [key("scene"), key("run"), *figures("horizon, s", "until, s", "energy error", "momentum error"),
               words("worst"), *figures("distance", "effective samples", "p"), words("verdict")]
    rows = []
    for run in document["runs"]:
        begin = shown(run[name] for name in ("horizon", "duration", "energy_error", "momentum_error"))
        rows.append((run["scene"], run["label"], *begin, run["worst"],
                     *shown(run[name] for name in ("distance", "effective", "p")),
                     run["verdict"] or f"{run['status']}: {run['reason']}"))
    print_table(terminal, columns, rows)
    terminal.print(f"One false alarm in {1 / document['false_alarm']:.0f} studies: the smallest p of a way counts "
                  "against that over the number of all comparisons.")
