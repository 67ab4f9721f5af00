"""`crosscheck study drift`: what energy, momentum, constraints and attitudes do over a million steps."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from crosscheck.cli import options
from crosscheck.cli.console import console, progress_bar
from crosscheck.cli.options import Engines, chosen
from crosscheck.cli.tables import figures, key, print_table, words


def drift(
    scene: Annotated[list[str] | None, options.scenes("single_pendulum double_pendulum")] = None,
    engine: Engines = None,
    method: Annotated[list[str] | None, options.methods("rattle2 rattle4 DAE1L_LSE DAE1H_LSE RK4 RK44 RKMK4")] = None,
    step: Annotated[float, typer.Option(min=1e-9, help="s; clocks that add it up stay exact where it is a power of 2, "
                                         "as the default is")] = 2.0**-10,
    steps: Annotated[int, typer.Option(min=2, help="of each run")] = 1_000_000,
    time_limit: Annotated[float, options.time_limit("longer ones are left out")] = 120.0,
    coordinate_map: options.CoordinateMap = None,
    out: Annotated[Path, typer.Option(help="folder of the page, JSON and CSV")] = Path("reports/drift"),
) -> None:
    """Long runs: is the energy error a band, does the momentum hold, do constraints and attitudes?"""
    from crosscheck.studies.drift import DriftAsk, DriftStudy
    from crosscheck.studies.study import conduct

    ask = DriftAsk(chosen(scene), chosen(engine), chosen(method), time_limit, step, steps,
                   coordinate_map=coordinate_map)
    with progress_bar() as progress:
        document = conduct(DriftStudy(), ask, out, progress)
    _print(document)
    typer.echo(f"page: {out / 'index.html'}")


def _print(document: dict[str, Any]) -> None:
    columns = [key("scene"), key("run"), *figures("steps", "s"), words("energy"),
               *figures("energy band", "slope, 1/s", "slope T / band", "growth", "momentum band"), words("momentum"),
               *figures("position, m", "velocity, m/s", "acceleration, m/s2", "orthogonality")]
    rows = []
    for run in document["runs"]:
        if run["status"] == "success":
            energy = (f"{run[f'energy_{name}']:.2g}" for name in ("band", "slope", "trend", "growth"))
            held = ("" if run[name] is None else f"{run[name]:.1e}" for name in (
                "constraint_position", "constraint_velocity", "constraint_acceleration", "orthogonality"))
            rows.append((run["scene"], run["label"], f"{run['steps']:,}", f"{run['wall_time']:.3g}",
                         run["energy_verdict"], *energy, f"{run['momentum_band']:.1e}", run["momentum_verdict"], *held))
        else:
            rows.append((run["scene"], run["label"], f"{run['steps']:,}", "", f"{run['status']}: {run['reason']}",
                         *[""] * 10))
    print_table(console(220), columns, rows)
