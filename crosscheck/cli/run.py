"""`crosscheck run`: one scene with one method of one engine."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Annotated, Any

import typer

from crosscheck.cli.console import say
from crosscheck.cli.options import (
    Alpha,
    Beta,
    Conserve,
    Control,
    CoordinateMap,
    Correction,
    Drop,
    Duration,
    Keyframe,
    Limits,
    Node,
    Reduce,
    SceneName,
    Softness,
    SpectralRadius,
    loaded,
)
from crosscheck.cli.states_csv import write_csv
from crosscheck.document import PASSING, Record, Way, extended
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
    csv_file: Annotated[str | None, typer.Option("--csv", help="file for the trajectory; - for the terminal")] = None,
    form: Annotated[str | None, typer.Option(help="tree, maximal or pivot; default: the best for the scene")] = None,
    coordinate_map: CoordinateMap = None,
    softness: Softness = None,
    node: Node = None,
    alpha: Alpha = None,
    beta: Beta = None,
    spectral_radius: SpectralRadius = None,
    correction: Correction = None,
    conserve: Conserve = None,
    reduce: Reduce = None,
    samples: Annotated[int | None, typer.Option(help="number of output times; default: the scene's")] = None,
    duration: Duration = None,
    drop: Drop = False,
    keyframe: Keyframe = None,
    control: Control = None,
    limits: Limits = "monitor",
) -> None:
    """Run one scene with one method of one engine; print its figures and verdict, or write its trajectory as CSV.

    Exit code 0: the verdict passes; 1: it fails.
    """
    from crosscheck import adapters
    from crosscheck.running.run import run as run_scene

    if method is None:
        if engine != "lieeuler":
            raise ArgumentError(f"--method: {engine} has {', '.join(adapters.get(engine).methods)}: name one of them")
        method = "taylor"
        rtol = 1e-9 if step is None and rtol is None else rtol
    given = {"form": form, "coordinate_map": coordinate_map, "softness": softness, "node": node, "alpha": alpha,
             "beta": beta, "spectral_radius": spectral_radius, "correction": correction,
             "conserve": conserve, "reduce": reduce, "samples": samples, "duration": duration}
    options = {key: value for key, value in given.items() if value is not None}
    prepared = loaded(scene, drop, keyframe, control, limits)
    traj = run_scene(prepared, engine, method, step=step, rtol=rtol, **options)
    if csv_file is not None:
        write_csv(prepared, traj, csv_file)
    if csv_file != "-":
        judged = _judged(str(scene), traj, engine, step, rtol, options)
        _print_run(traj.scene, traj, csv_file, step)
        _print_verdict(judged, traj)
        raise typer.Exit(int(judged is not None and judged.outcome not in PASSING))


def _judged(name: str, traj: Trajectory, engine: str, step: float | None, rtol: float | None,
            options: Mapping[str, Any]) -> Record | None:
    """The verdict; None if there is neither a step nor a tolerance by which to judge."""
    from crosscheck import adapters
    from crosscheck.adapters.base import RunSpec
    from crosscheck.running.provenance import engine_version
    from crosscheck.verification.cell import judge_run

    adapter, used = adapters.get(engine), step or traj.stats.get("step")
    spec = RunSpec(traj.method, step=used if rtol is None else None, rtol=rtol, form=options.get("form"))
    order = adapter.documented_order(traj.scene, spec)
    if rtol is None and (order is None or used is None):
        return None
    more = {key: value for key, value in options.items() if key not in ("samples", "duration")}
    way = Way.of(engine, traj.method, used if rtol is None else None, rtol, **(more | {"form": traj.form}))
    asked = extended(Record, way, scene=name, version=engine_version(engine),
                     documented_order=order if rtol is None else None)
    return judge_run(asked, traj.scene, traj, adapter.held_levels(traj.scene, spec))


def _print_verdict(judged: Record | None, traj: Trajectory) -> None:
    from crosscheck.judge.verdict import word, worst

    if judged is None:
        say("verdict: none, because bounds follow from --step or --rtol and neither was given")
        return
    for name, error in judged.errors.items():
        bound = "no bound at this step" if error.bound is None else f"bound {error.bound:.1e} {error.unit}"
        until = "" if error.judged is None or error.judged == error.max else (
            f"; as far as truth reaches {error.judged:.1e} {error.unit}")
        say(f"{name} error against truth {error.max:.1e} {error.unit}, at t = {error.time:.4g} s{until}, {bound}")
    if judged.energy_error is not None and math.isfinite(judged.energy_error):
        where = "minus the work done, at the output times" if traj.scene.worked_on else "every step"
        start = ("" if judged.energy_error_by_start is None else
                 f" ({judged.energy_error_by_start:.1e} of |E(0)|)")
        say(f"energy error {judged.energy_error:.1e} of the largest kinetic energy{start}, {where}")
    first = worst(judged.findings)
    reason = judged.message or ("" if first is None or judged.outcome in ("pass", "partly") else
                                f"{first.kind} {first.value or 0.0:.1e} {first.unit}, bound {first.bound or 0.0:.1e} "
                                f"({first.why})")
    for finding in judged.findings:
        if finding.kind == "arithmetic":
            say(finding.why)
    say(f"verdict: {word(judged)}" + (f": {reason}" if reason else ""))


def _print_run(scene: Scene, traj: Trajectory, csv_file: str | None, asked: float | None) -> None:
    used = traj.stats.get("step")
    say(f"{traj.engine} {traj.method}{f' ({traj.form})' if traj.form else ''}: {traj.steps} steps"
               + (f" of {used:.6g} s" if used else "") + f", {traj.wall_time:.3g} s of stepping, "
               f"{1e6 * traj.wall_time / max(1, traj.steps):.3g} us per step")
    if asked and used and used < asked * (1 - 1e-9):
        say(f"the step {asked:g} s does not divide the {traj.t[1] - traj.t[0]:g} s between two output times, and was "
            "shortened to the next one that does")
    for body, position in zip(scene.bodies, traj.x[-1], strict=True):
        say(f"{body.name}: x({traj.t[-1]:g} s) = ({', '.join(f'{value:.12g}' for value in position)}) m")
    levels = [(name, getattr(traj, f"constraint_{name}"), unit)
              for name, unit in (("position", "m"), ("velocity", "m/s"), ("acceleration", "m/s^2"))]
    shown = ", ".join(f"{name} {abs(series).max():.1e} {unit}" for name, series, unit in levels if series is not None)
    say(f"constraints, at the samples: {shown}; orthogonality {traj.orthogonality.max():.1e}")
    if redundant := traj.stats.get("redundant_rows"):
        say(f"{redundant} constraint rows depend on the others; the multipliers have least norm")
    if csv_file is not None:
        typer.echo(f"written: {csv_file}")
