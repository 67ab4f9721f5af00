"""`crosscheck import` and `crosscheck export`: from model files to scene files, and back."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from crosscheck.cli.console import counted, waiting
from crosscheck.cli.options import Control, Drop, Keyframe, Limits, SceneName, controls


def import_(
    model: Annotated[Path, typer.Argument(help="an MJCF (.xml) or URDF (.urdf) file")],
    out: Annotated[Path, typer.Option("--out", "-o", help="the scene file, .toml")],
    drop: Drop = False,
    keyframe: Keyframe = None,
    base: Annotated[str, typer.Option(help="fixed or free: the body or link that everything hangs on")] = "fixed",
    balance: Annotated[bool, typer.Option("--balance", help="replace inertias that no body can have, as MuJoCo's "
                                          "balanceinertia does")] = False,
    root: Annotated[str | None, typer.Option(help="take only this link or body and what hangs on it")] = None,
    actuators: Annotated[str, typer.Option(help="keep those of hinges and slides, or drop them")] = "keep",
    control: Control = None,
    limits: Limits = "monitor",
    contacts: Annotated[str, typer.Option(help="monitor: the scene holds until two bodies touch; or drop")] = "monitor",
    friction: Annotated[str, typer.Option(help="keep dry friction, or drop it")] = "keep",
    start: Annotated[str, typer.Option(help="model, random, or the seed of a random start")] = "model",
    duration: Annotated[float, typer.Option(help="s, of the scene")] = 2.0,
    samples: Annotated[int, typer.Option(help="number of output times of the scene")] = 101,
) -> None:
    """Convert an MJCF or URDF model to a scene file; refuse what a scene cannot hold, or drop and list it.

    Exit code 0: written; 2: refused, and nothing is written.
    """
    from crosscheck import adapters
    from crosscheck.adapters.base import RunSpec
    from crosscheck.scene.models import import_file
    from crosscheck.scene.models.words import quoted, together

    with waiting(f"reading {model.name}"):
        scene = import_file(model, out, drop=drop, keyframe=keyframe, base=base, duration=duration, samples=samples,
                            balance=balance, root=root, actuators=actuators, limits=limits, contacts=contacts,
                            friction=friction, start=int(start) if start.isdigit() else start,
                            controls=controls(control))
    typer.echo(f"{scene.name}: {counted(scene.n, 'body', 'bodies')}, {counted(len(scene.joints), 'joint')}, "
               f"{counted(len(scene.forces), 'force')}")
    if scene.monitors:
        typer.echo(f"it holds until the first of {counted(len(scene.monitors), 'monitor')}: a joint leaves its range, "
                   "or two bodies touch")
    typer.echo(f"written: {out}")
    for words in together(map(quoted, scene.left_out)):
        typer.echo(f"left out: {words}")
    if (reason := adapters.get("lieeuler").unsupported(scene, RunSpec("taylor", rtol=1e-9))) is not None:
        typer.echo(f"lieeuler cannot run it: {reason}")


def export(
    scene: SceneName,
    out: Annotated[Path, typer.Option("--out", "-o", help="the file: .xml (MJCF), .urdf, or .py, which runs Exudyn")],
) -> None:
    """Convert a scene to MJCF, URDF or a script for Exudyn; refuse, by name, what the format cannot hold."""
    from crosscheck.adapters.export import export_model

    export_model(scene, out)
    typer.echo(f"written: {out}")
