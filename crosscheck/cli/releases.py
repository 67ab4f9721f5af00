"""`crosscheck reproduce` and `crosscheck bisect`: a number of an engine without this project, and who changed it."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from crosscheck.cli.console import say
from crosscheck.cli.options import Duration, Keyframe, SceneName

Method = Annotated[str, typer.Option(help="an integrator of the engine")]
Step = Annotated[float, typer.Option(help="fixed step, s")]
Issue = Annotated[Path | None, typer.Option(help="write a text ready to file: versions, script, expected, observed")]


def reproduce(
    scene: SceneName,
    engine: Annotated[str, typer.Option(help="mujoco")] = "mujoco",
    method: Method = "RK4",
    step: Step = 1e-3,
    out: Annotated[Path | None, typer.Option("--out", "-o", help="file for the script; default: the terminal")] = None,
    issue: Issue = None,
    duration: Duration = None,
    keyframe: Keyframe = None,
) -> None:
    """Print a script that imports the engine and NumPy alone and prints the engine's error against truth.

    Exit code 0: written; 2: no script can hold it.
    """
    from crosscheck.files import put
    from crosscheck.inspection.bisect import issue as filed
    from crosscheck.inspection.reproduce import reproduce as written

    script = written(scene, engine, method, step, duration, keyframe)
    for path, text in ((out, script.text), (issue, filed(script, engine))):
        if path is not None:
            put(path, text)
            typer.echo(f"written: {path}", err=True)
    if out is None:
        typer.echo(script.text, nl=False)


def bisect(
    scene: SceneName,
    versions: Annotated[str, typer.Option(help="the first and the last release, as 3.1.0..4.0.0")],
    engine: Annotated[str, typer.Option(help="mujoco")] = "mujoco",
    method: Method = "RK4",
    step: Step = 1e-3,
    issue: Issue = None,
    duration: Duration = None,
    keyframe: Keyframe = None,
) -> None:
    """Find the releases of an engine that changed its answer to a scene, and by how much beyond rounding.

    An environment is made for each release that is run, by uv or pip, and kept. Exit code 0: nothing changed; 1: a
    release changed the answer; 2: it could not be done.
    """
    from crosscheck.files import put
    from crosscheck.inspection import bisect as releases
    from crosscheck.inspection.reproduce import reproduce as written

    script = written(scene, engine, method, step, duration, keyframe)
    result = releases.bisect(script, engine, versions, say)
    for change in result.changes:
        say(str(change))
    if not result.changes:
        say("no release changed the answer beyond rounding")
    say(f"{len(result.tried)} of {result.count} releases were run in {result.seconds / 60:.1f} min"
        + (f", {len(result.failed)} could not be run" if result.failed else ""))
    if issue is not None:
        put(issue, releases.issue(script, engine, result))
        typer.echo(f"written: {issue}", err=True)
    raise typer.Exit(1 if result.changes else 0)
