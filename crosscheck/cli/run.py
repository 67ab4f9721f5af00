"""`crosscheck run`: one scene with one method of one engine."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

import typer

from crosscheck.cli.options import Drop, Keyframe, SceneName, loaded
from crosscheck.cli.states_csv import write_csv
from crosscheck.errors import ArgumentError

if TYPE_CHECKING:
    from crosscheck.running.trajectory import Trajectory
    from crosscheck.scene.model import Scene


def run(
    scene: SceneName,
    engine: Annotated[str, typer.Option(help="see `crosscheck list`")] = "lieeuler",
    method: Annotated[str | None, typer.Option(help="see `crosscheck list`; default: lieeuler's taylor, at rtol 1e-9")
                      ] = None,
    step: Annotated[float | None, typer.Option(help="fixed step, s")] = None,
    rtol: Annotated[float | None, typer.Option(help="relative tolerance of an adaptive method")] = None,
    csv_file: Annotated[str | None, typer.Option("--csv", help="write the trajectory here; - for the terminal")] = None,
    form: Annotated[str | None, typer.Option(help="tree, maximal or pivot; default: the best that fits")] = None,
    coordinate_map: Annotated[str | None, typer.Option("--map", help="exp, cayley or ccsk (lieeuler)")] = None,
    softness: Annotated[str | None, typer.Option(help="tight or default: MuJoCo's equality constraints")] = None,
    node: Annotated[str | None, typer.Option(help="lie or euler_parameters: Exudyn's rigid bodies")] = None,
    alpha: Annotated[float | None, typer.Option(help="1/s; Baumgarte's gain of velocities")] = None,
    beta: Annotated[float | None, typer.Option(help="1/s; Baumgarte's gain of positions, not squared")] = None,
    spectral_radius: Annotated[float | None, typer.Option(help="0 to 1, of generalized_alpha; default 0.8")] = None,
    samples: Annotated[int | None, typer.Option(help="number of output times; default: the scene's")] = None,
    duration: Annotated[float | None, typer.Option(help="s; default: the scene's")] = None,
    drop: Drop = False,
    keyframe: Keyframe = None,
) -> None:
    """Run one scene with one method of one engine; print its figures, or write its trajectory as CSV."""
    from crosscheck import adapters
    from crosscheck.running.run import run as run_scene

    if method is None:
        if engine != "lieeuler":
            raise ArgumentError(f"--method: {engine} has {', '.join(adapters.get(engine).methods)}: name one of them")
        method = "taylor"
        rtol = 1e-9 if step is None and rtol is None else rtol
    given = {"form": form, "coordinate_map": coordinate_map, "softness": softness, "node": node, "alpha": alpha,
             "beta": beta, "spectral_radius": spectral_radius, "samples": samples, "duration": duration}
    options = {key: value for key, value in given.items() if value is not None}
    found = loaded(scene, drop, keyframe)
    traj = run_scene(found, engine, method, step=step, rtol=rtol, **options)
    if csv_file is not None:
        write_csv(found, traj, csv_file)
    if csv_file != "-":
        _print_run(found, traj, csv_file, step)


def _print_run(scene: Scene, traj: Trajectory, csv_file: str | None, asked: float | None) -> None:
    used = traj.stats.get("step")
    typer.echo(f"{traj.engine} {traj.method}{f' ({traj.form})' if traj.form else ''}: {traj.status}, {traj.steps} steps"
               + (f" of {used:.6g} s" if used else "") + f", {1e3 * traj.wall_time:.3g} ms of stepping, "
               f"{1e6 * traj.wall_time / max(1, traj.steps):.3g} us per step")
    if asked and used and used < asked * (1 - 1e-9):
        typer.echo(f"the step asked for, {asked:g} s, does not divide the {traj.t[1] - traj.t[0]:g} s between two "
                   "output times: it was shortened to the next that does")
    for body, position in zip(scene.bodies, traj.x[-1], strict=True):
        typer.echo(f"{body.name}: x({traj.t[-1]:g} s) = ({', '.join(f'{value:.12g}' for value in position)}) m")
    levels = [(name, getattr(traj, f"constraint_{name}"), unit)
              for name, unit in (("position", "m"), ("velocity", "m/s"), ("acceleration", "m/s^2"))]
    shown = ", ".join(f"{name} {abs(series).max():.1e} {unit}" for name, series, unit in levels if series is not None)
    typer.echo(f"constraints, at the samples: {shown}; orthogonality {traj.orthogonality.max():.1e}")
    if redundant := traj.stats.get("redundant_rows"):
        typer.echo(f"{redundant} constraint rows depend on the others; multipliers are those of least norm")
    if csv_file is not None:
        typer.echo(f"written: {csv_file}")
