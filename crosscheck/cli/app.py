"""The command `crosscheck`: verify, run, list, truth."""

from __future__ import annotations

import contextlib
import csv
import json
import os
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any

import typer

from crosscheck.cli.explain import explain
from crosscheck.cli.history import app as history
from crosscheck.cli.inspect import inspect
from crosscheck.cli.nightly import nightly
from crosscheck.cli.report import report
from crosscheck.cli.study import app as study
from crosscheck.cli.support import support
from crosscheck.errors import ArgumentError, EngineError, SceneError, Unsupported

app = typer.Typer(name="crosscheck", add_completion=False, no_args_is_help=True, pretty_exceptions_enable=False,
                  help="One multibody scene, many engines, every result measured against independent truth. Begin with "
                       "`crosscheck list` and `crosscheck verify --scene double_pendulum --profile smoke`.")

SceneNames = Annotated[list[str] | None, typer.Option("--scene", help="a built-in name or a path; may be repeated")]
EngineNames = Annotated[list[str] | None, typer.Option("--engine", help=(
    "a name, name==version, or a class of your own as module:Class or path/file.py:Class; may be repeated; "
    "default: all"))]


@app.command()
def verify(
    scene: SceneNames = None,
    engine: EngineNames = None,
    profile: Annotated[str, typer.Option(help="default; smoke: first seconds, three steps, no timing; full: every "
                                         "scene, within a budget of steps")] = "default",
    jobs: Annotated[int, typer.Option(help="worker processes")] = 2,
    time_limit: Annotated[float, typer.Option(help="s for one run and its order study")] = 1800.0,
    memory_limit: Annotated[float, typer.Option(help="GB resident of one worker process")] = 4.0,
    tolerance_file: Annotated[Path | None, typer.Option("--tolerances", help="TOML file of your own bounds")] = None,
    tol: Annotated[list[str] | None, typer.Option(help="a bound of your own, quantity=value; may be repeated")] = None,
    out: Annotated[Path, typer.Option(help="folder of the report")] = Path("reports/latest"),
    as_json: Annotated[bool, typer.Option("--json", help="print the results as JSON instead of the table")] = False,
) -> None:
    """Run every method and engine over the scenes, judge them, write the report.

    Exit code 0: all within tolerance; 1: a verdict failed; 2: the run itself failed.
    """
    from crosscheck.cli.verdicts import print_verdicts
    from crosscheck.judge import overrides
    from crosscheck.verification import job
    from crosscheck.verification.guarded import limits

    own = overrides.read(tolerance_file, tol or ())
    job.check_out(out)
    within = limits(time_limit, memory_limit)
    with progress_bar() as progress:
        results = job.verify(profile, scene, engine, jobs, progress, limits=within, overrides=own)
        page = job.write(results, out)
    if as_json:
        typer.echo(json.dumps(_brief(results.plain(), page), indent=1))
    else:
        print_verdicts(results, page)
    raise typer.Exit(results.exit_code)


@app.command()
def run(
    scene: Annotated[str, typer.Argument(help="a built-in name or a path to .toml or .json")],
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
    samples: Annotated[int | None, typer.Option(help="number of output times; default: the scene's")] = None,
    duration: Annotated[float | None, typer.Option(help="s; default: the scene's")] = None,
) -> None:
    """Run one scene with one method of one engine; print its figures, or write its trajectory as CSV."""
    from crosscheck import adapters
    from crosscheck.running.run import run as run_scene
    from crosscheck.scene.file import load_scene

    if method is None:
        if engine != "lieeuler":
            raise ArgumentError(f"--method: {engine} has {', '.join(adapters.get(engine).methods)}: name one of them")
        method = "taylor"
        rtol = 1e-9 if step is None and rtol is None else rtol
    given = {"form": form, "coordinate_map": coordinate_map, "softness": softness, "node": node, "alpha": alpha,
             "beta": beta, "samples": samples, "duration": duration}
    options = {key: value for key, value in given.items() if value is not None}
    loaded = load_scene(scene)
    traj = run_scene(loaded, engine, method, step=step, rtol=rtol, **options)
    if csv_file is not None:
        _write_csv(loaded, traj, csv_file)
    if csv_file != "-":
        _print_run(loaded, traj, csv_file)


@app.command("list")
def list_(engine: EngineNames = None) -> None:
    """The scenes, the engines with their versions, and their methods."""
    from rich.table import Table

    from crosscheck import adapters
    from crosscheck.running.provenance import NOT_INSTALLED, engine_version
    from crosscheck.scene.file import load_scene, scene_names

    scenes = Table("scene", "bodies", "duration", "what it is", box=None, title="scenes", title_justify="left")
    for name in scene_names():
        loaded = load_scene(name)
        scenes.add_row(name, str(loaded.n), f"{loaded.duration:g} s", loaded.description)
    table = Table("engine", "version", "methods", box=None, title="engines", title_justify="left")
    for name in engine or adapters.names():
        version = engine_version(name)
        methods = "" if version == NOT_INSTALLED and not _importable(name) else " ".join(adapters.methods(name))
        table.add_row(name, version, methods)
    console = _console()
    console.print(scenes)
    console.print()
    console.print(table)


@app.command()
def truth(
    scene: Annotated[str, typer.Argument(help="a built-in name or a path to .toml or .json")],
    csv_file: Annotated[str | None, typer.Option("--csv", help="write the states here; - for the terminal")] = None,
) -> None:
    """The independent truth of a scene: where it comes from, how far to trust it, the end state."""
    from crosscheck.references import truth as truth_of
    from crosscheck.scene.file import load_scene

    loaded = load_scene(scene)
    reference = truth_of(loaded)
    if csv_file is not None:
        _write_csv(loaded, reference.states, csv_file)
    if csv_file == "-":
        return
    typer.echo(f"{loaded.name}: {reference.source}")
    typer.echo(f"checked against: {reference.second_source}")
    typer.echo(f"they differ by {reference.disagreement:.1e}, allowed {reference.allowed:.1e}")
    typer.echo(f"a perturbation grows {reference.amplification:.3g}-fold over {loaded.duration:g} s; "
               f"comparable up to {reference.horizon:g} s")
    for body, position in zip(loaded.bodies, reference.states.x[-1], strict=True):
        typer.echo(f"{body.name}: x({loaded.duration:g} s) = ({', '.join(f'{value:.15g}' for value in position)}) m")


app.command()(explain)
app.command()(inspect)
app.command()(support)
app.command()(report)
app.command()(nightly)
app.add_typer(history)
app.add_typer(study)


def main() -> None:
    """Entry point: whatever goes wrong ends in one clear line, exit code 2; 1 is left to verdicts that fail."""
    try:
        app()
    except SystemExit as end:
        if isinstance(end.__context__, BrokenPipeError):
            raise SystemExit(2) from None  # the reader, `head` say, has seen enough
        if end.code == INTERRUPTED:
            _complain(_interrupted())
        raise
    except KeyboardInterrupt:
        _complain(_interrupted())
        raise SystemExit(INTERRUPTED) from None
    except Exception as error:
        if os.environ.get("CROSSCHECK_TRACEBACK"):
            raise
        _complain(str(error) if _is_ours(error) else
                  f"{type(error).__name__}: {error} (CROSSCHECK_TRACEBACK=1 in the environment shows where)")
        raise SystemExit(2) from None


def _interrupted() -> str:
    kept = {"nightly": "the same command goes on from here", "study": "what was finished is in the folder of --out"}
    return f"interrupted; {kept.get(' '.join(sys.argv[1:2]), 'nothing was written')}"


INTERRUPTED = 130
"""Exit code after Ctrl-C, as shells have it: 128 and the number of the signal."""


def _complain(message: str) -> None:
    print(f"crosscheck: {' '.join(message.split())}", file=sys.stderr)


def _is_ours(error: Exception) -> bool:
    """Whether the message of this error is written for the user. `lieeuler` is not imported only to ask."""
    ours = (SceneError, Unsupported, EngineError, ArgumentError)
    return isinstance(error, ours) or type(error).__name__ == "TruthError" or type(error).__module__.startswith(
        "lieeuler")


def _importable(engine: str) -> bool:
    from crosscheck import adapters

    try:
        adapters.get(engine)
    except ImportError:
        return False
    return True


def _console() -> Any:
    from rich.console import Console

    # Without a terminal Rich would fold tables at 80 columns, which no log needs.
    return Console(width=None if sys.stdout.isatty() else 160, highlight=False)


@contextlib.contextmanager
def progress_bar() -> Iterator[Any]:
    """A progress bar on the error stream; its callback takes (done, total, label)."""
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

    columns = (BarColumn(bar_width=30), MofNCompleteColumn(), TimeElapsedColumn(), TextColumn("{task.description}"))
    with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task("starting", total=None)
        yield lambda done, total, label: bar.update(task, completed=done, total=total, description=label)


def _brief(document: dict[str, Any], page: Path) -> dict[str, Any]:
    """The document without its curves, which only the report needs."""
    scenes = [{key: value for key, value in scene.items() if key != "curves"} for scene in document["scenes"]]
    records = [{key: value for key, value in record.items() if key != "curves"} for record in document["records"]]
    return {**document, "scenes": scenes, "records": records, "report": str(page)}


def _print_run(scene: Any, traj: Any, csv_file: str | None) -> None:
    used = traj.stats.get("step")
    typer.echo(f"{traj.engine} {traj.method}{f' ({traj.form})' if traj.form else ''}: {traj.status}, {traj.steps} steps"
               + (f" of {used:.6g} s" if used else "") + f", {1e3 * traj.wall_time:.3g} ms of stepping, "
               f"{1e6 * traj.wall_time / max(1, traj.steps):.3g} us per step")
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


def _write_csv(scene: Any, states: Any, target: str) -> None:
    """States as CSV, one line per output time, full precision."""
    header = ["t [s]"]
    for body in scene.bodies:
        header += [f"{body.name} x_{axis} [m]" for axis in "xyz"]
        header += [f"{body.name} R_{row}{column}" for row in "123" for column in "123"]
        header += [f"{body.name} v_{axis} [m/s]" for axis in "xyz"]
        header += [f"{body.name} w_{axis} [rad/s]" for axis in "xyz"]
    extra = {"energy": "energy [J]", "constraint_position": "constraint position",
             "constraint_velocity": "constraint velocity", "constraint_acceleration": "constraint acceleration",
             "orthogonality": "orthogonality"}
    series = {title: getattr(states, name) for name, title in extra.items() if getattr(states, name, None) is not None}
    with contextlib.ExitStack() as stack:
        try:
            stream = sys.stdout if target == "-" else stack.enter_context(open(target, "w", newline="",
                                                                               encoding="utf-8"))
        except OSError as error:
            raise ArgumentError(f"--csv {target}: cannot be written ({error.strerror})") from None
        writer = csv.writer(stream)
        writer.writerow(header + list(series))
        for k, time in enumerate(states.t):
            row = [time]
            for i in range(scene.n):
                row += [*states.x[k, i], *states.R[k, i].ravel(), *states.v[k, i], *states.w[k, i]]
            writer.writerow([repr(float(value)) for value in [*row, *(values[k] for values in series.values())]])


if __name__ == "__main__":
    main()
