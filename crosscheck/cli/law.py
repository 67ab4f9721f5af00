"""`crosscheck law`: to which law of friction, stops and servos an engine converges."""

from __future__ import annotations

from typing import Annotated

import typer

from crosscheck.cli.console import say
from crosscheck.cli.options import Drop, Keyframe, SceneName, Softness, loaded


def law(
    scene: SceneName,
    engine: Annotated[str, typer.Option(help="a name")],
    method: Annotated[str | None, typer.Option(help="default: the engine's last one that takes a step")] = None,
    step: Annotated[float | None, typer.Option(help="s, the largest of four; default: a thousandth of the run")] = None,
    softness: Softness = None,
    drop: Drop = False,
    keyframe: Keyframe = None,
) -> None:
    """Three answers about friction, stops and servos: does the engine converge, to which law, how far apart.

    Exit code 0: to the scene's law; 1: to another one, or not at all; 2: it could not be done, or truth is missing.
    """
    from crosscheck.diagnosis.laws import which_law

    answers = which_law(loaded(scene, drop, keyframe), engine, method, step, softness)
    say(str(answers))
    raise typer.Exit(2 if answers.without else 0 if answers.way.limit() in ("the scene's", "both") else 1)
