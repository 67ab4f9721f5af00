"""`crosscheck verify`: runs every method and engine over the scenes, judges the runs, and writes the report."""

from __future__ import annotations

import contextlib
import dataclasses
import json
import os
import shlex
import sys
from pathlib import Path
from typing import Annotated

import typer

from crosscheck.cli import options
from crosscheck.cli.console import complain, progress_bar
from crosscheck.cli.options import Drop, EngineNames, Keyframe, SceneNames, scene_files
from crosscheck.errors import ArgumentError, install


def verify(
    scene: SceneNames = None,
    engine: EngineNames = None,
    method: Annotated[list[str] | None, typer.Option(help="a name; may be repeated; default: all")] = None,
    profile: Annotated[str, typer.Option(help="default; smoke: first seconds, three steps, no timing; full: every "
                                         "scene, within a budget of steps")] = "default",
    coordinate_map: options.CoordinateMap = None,
    step: options.Step = None,
    duration: options.Duration = None,
    jobs: Annotated[int, typer.Option(help="worker processes")] = 2,
    scheduler: options.Scheduler = None,
    time_limit: Annotated[float, typer.Option(help="s for one run and its order study")] = 1800.0,
    memory_limit: Annotated[float, typer.Option(help="GB resident of one worker process")] = 4.0,
    tolerance_file: Annotated[Path | None, typer.Option("--tolerances", help="TOML file with your own bounds")] = None,
    tol: Annotated[list[str] | None, typer.Option(help="your own bound, as quantity=value; may be repeated")] = None,
    out: Annotated[Path, typer.Option(help="folder of the report")] = Path("reports/latest"),
    as_json: Annotated[bool, typer.Option("--json", help="print the results as JSON instead of the table")] = False,
    fresh: options.Fresh = "CI" in os.environ,
    drop: Drop = False,
    keyframe: Keyframe = None,
) -> None:
    """Run every method and engine over the scenes, judge the runs, and write the report.

    Results that were computed before, by this code and these versions, are taken from the table of rows, also after a
    kill; times are measured anew. Exit code 0: all within tolerance; 1: a verdict
    failed; 2: the run itself failed.
    """
    from crosscheck.cli.verdicts import print_verdicts
    from crosscheck.document import Asked
    from crosscheck.jobs.table import Table
    from crosscheck.judge import overrides
    from crosscheck.report import folder, schema
    from crosscheck.verification import job
    from crosscheck.verification.guarded import limits

    if jobs < 1:
        raise ArgumentError(f"--jobs: at least 1 is wanted, not {jobs}")
    own = overrides.read(tolerance_file, tol or ())
    folder.check_out(out)
    scene = scene_files(scene, drop, keyframe)
    within = limits(time_limit, memory_limit)
    asked = Asked(coordinate_map=coordinate_map, step=step, duration=duration)
    identity = job.fingerprint(profile, scene, engine, dataclasses.astuple(within), own, method, asked.words)
    job.check_methods(method, job.select_engines(engine))
    with contextlib.closing(Table.opened()) as table, table.session(
            identity, shlex.join(["crosscheck", *sys.argv[1:]]), job.ROW_TYPES, fresh) as session:
        if table.trouble:
            complain(table.trouble)
        if session.continued:
            typer.echo(f"going on with a run that was killed: {session.left} results are kept", err=True)
        with progress_bar() as progress:
            results = job.verify(profile, scene, engine, jobs, progress, session, within, own, methods=method,
                                 asked=asked, scheduler=scheduler)
        page = folder.write(results, out)
    if page.suffix == ".json":
        complain(f"no pages: {install('jinja2')}, then crosscheck report {out}")
    if as_json:
        typer.echo(json.dumps(schema.plain(results) | {"report": str(page)}, indent=1))
    else:
        print_verdicts(results, page)
    raise typer.Exit(results.exit_code)
