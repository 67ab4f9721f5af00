"""`crosscheck judge`: a run that some other program made, by its file."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from crosscheck.cli.console import progress_bar, say
from crosscheck.cli.options import AsJson, Drop, Keyframe, SceneName, loaded, named_number, print_json


def judge(
    scene: SceneName,
    files: Annotated[list[Path], typer.Argument(help=".csv, .npz or .parquet files of one run, each at another step")],
    columns: Annotated[Path | None, typer.Option(help="TOML file with names and units of the columns")] = None,
    suggest: Annotated[bool, typer.Option("--suggest", help="print such a file, of the names recognised")] = False,
    start: Annotated[str, typer.Option(help="scene, or recorded: truth starts from the first row")] = "scene",
    tol: Annotated[list[str] | None, typer.Option(help="allowed error as quantity=value (SI); may be repeated")] = None,
    step: Annotated[list[float] | None, typer.Option(help="s; once for each file, in their order")] = None,
    order: Annotated[int | None, typer.Option(help="the order that is claimed")] = None,
    as_json: AsJson = False,
    out: Annotated[Path | None, typer.Option("-o", "--out", help="folder of a page")] = None,
    drop: Drop = False,
    keyframe: Keyframe = None,
) -> None:
    """Judge a recorded run: how far it is from the scene's true motion, since when, and why.

    Exit code 0: within the tolerances; 1: not; 2: a file cannot be read; 3: no verdict was asked for, or none is
    possible.
    """
    from crosscheck import recordings

    described = loaded(scene, drop, keyframe)
    if suggest:
        typer.echo(recordings.suggest(files[0], described), nl=False)
        return
    allowed = dict(named_number("--tol", each, "position=1e-3") for each in tol or ())
    given = files[0] if len(files) == 1 else list(files)
    with progress_bar() as progress:
        verdict = recordings.judge_recording(described, given, columns, start, allowed or None, step or None, order,
                                             progress)
    if out is not None:
        page = recordings.write_page(verdict, out)
    if as_json:
        print_json(verdict.plain())
    else:
        for line in verdict.lines:
            say(line)
    if out is not None and not as_json:
        print(f"page: {page}")
    raise typer.Exit(verdict.exit_code)
