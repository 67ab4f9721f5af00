"""`crosscheck study drift`: what energy, momentum, constraints and attitudes do over a million steps."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from crosscheck.cli import options
from crosscheck.cli.console import console, progress_bar
from crosscheck.cli.options import Engines, chosen


def drift(
    scene: Annotated[list[str] | None, options.scenes("single_pendulum double_pendulum")] = None,
    engine: Engines = None,
    method: Annotated[list[str] | None, options.methods("rattle2 rattle4 DAE1H_LSE RK4 RK44 RKMK4")] = None,
    step: Annotated[float, typer.Option(min=1e-9, help="s; clocks that add it up stay exact where it is a power of 2, "
                                         "as the default is")] = 2.0**-10,
    steps: Annotated[int, typer.Option(min=2, help="of each run")] = 1_000_000,
    time_limit: Annotated[float, options.time_limit("longer ones are left out")] = 120.0,
    out: Annotated[Path, typer.Option(help="folder of the page, JSON and CSV")] = Path("reports/drift"),
) -> None:
    """Long runs: is the energy error a band, does the momentum hold, do constraints and attitudes?"""
    from crosscheck.studies.drift import DriftAsk, DriftStudy
    from crosscheck.studies.study import conduct

    ask = DriftAsk(chosen(scene), chosen(engine), chosen(method), time_limit, step, steps)
    with progress_bar() as progress:
        document = conduct(DriftStudy(), ask, out, progress)
    _print(document)
    typer.echo(f"page: {out / 'index.html'}")


def _print(document: dict[str, Any]) -> None:
    from rich.table import Table

    terminal = console(220)
    table = Table("scene", "run", "steps", "s", "energy band", "slope, 1/s", "slope T / band", "growth", "energy",
                  "momentum band", "momentum", "position, m", "velocity, m/s", "orthogonality", box=None)
    for run in document["runs"]:
        if run["status"] != "success":
            table.add_row(run["scene"], run["label"], f"{run['steps']:,}", "", "", "", "", "",
                          f"{run['status']}: {run['reason']}")
            continue
        table.add_row(run["scene"], run["label"], f"{run['steps']:,}", f"{run['wall_time']:.3g}",
                      *(f"{run[key]:.2g}" for key in ("energy_band", "energy_slope", "energy_trend", "energy_growth")),
                      run["energy_verdict"], f"{run['momentum_band']:.1e}", run["momentum_verdict"],
                      *(f"{run[key]:.1e}" for key in ("constraint_position", "constraint_velocity", "orthogonality")))
    terminal.print(table)
