"""Models and their equations: `crosscheck convert`, `linearise`, `bisect`."""

from __future__ import annotations

import inspect
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from crosscheck.cli import options
from crosscheck.cli.console import at_work, progress_bar, say
from crosscheck.errors import ArgumentError, EngineError, Unsupported, counted
from crosscheck.files import put

if TYPE_CHECKING:
    from crosscheck.jointspace.verdicts import Verdict
    from crosscheck.scene.model import Scene

FARTHEST = 1e12
"""Sum of the sizes of the ends of a range beyond which no mode can be computed in doubles."""


@options.reads_models
def convert(
    model: options.SceneName,
    out: Annotated[Path, typer.Option("--out", "-o", help="of a model a scene, .toml; of both .xml (MJCF), .urdf, or "
                                      ".py, which runs Exudyn")],
    reading: options.Reading = options.AS_IT_IS,
    base: Annotated[str, typer.Option(help="fixed or free: the body or link that everything hangs on")] = "fixed",
    balance: Annotated[bool, typer.Option("--balance", help="replace inertias that no body can have, as MuJoCo's "
                                          "balanceinertia does")] = False,
    root: Annotated[str | None, typer.Option(help="take only this link or body and what hangs on it")] = None,
    actuators: Annotated[str, typer.Option(help="keep those of hinges and slides, or drop them")] = "keep",
    contacts: Annotated[str, typer.Option(help="monitor: the scene ends when two bodies touch; or drop")] = "monitor",
    friction: Annotated[str, typer.Option(help="keep dry friction, or drop it")] = "keep",
    start: Annotated[str, typer.Option(help="model, random, or the seed of a random start")] = "model",
    within: Annotated[Path | None, typer.Option(help="a folder above the model in which its files are read")] = None,
    duration: Annotated[float, typer.Option(help="s, of the scene")] = 2.0,
    samples: Annotated[int, typer.Option(help="number of output times of the scene")] = 101,
) -> None:
    """Convert a model, MJCF or URDF, to a scene, or a scene to a model; what does not fit is refused.

    Exit code 0: written; 2: refused, and nothing is written.
    """
    from crosscheck.adapters.export import export_model
    from crosscheck.scene.models import import_model, is_model
    from crosscheck.scene.models.writing import toml
    from crosscheck.scene.paths import content_of

    given: dict[str, Any] = {
        "base": base, "balance": balance, "root": root, "actuators": actuators, "contacts": contacts,
        "friction": friction, "start": int(start) if start.isdigit() else start, "within": within,
        "duration": duration, "samples": samples, **reading.given}
    scene: Scene | str = model
    if is_model(model):
        with progress_bar(f"reading {model}"):
            scene = import_model(model, **given)
        if out.suffix == ".toml":
            put(out, toml(content_of(scene)))
        _print_imported(scene)
    else:
        usual = inspect.signature(import_model).parameters
        if changed := [name for name, value in given.items() if value != usual[name].default]:
            raise ArgumentError(f"{', '.join(changed)}: options of a model file, .xml or .urdf, not of {model}")
        if out.suffix == ".toml":
            raise ArgumentError(f"{model} is a scene already; --out ends in .xml (MJCF), .urdf or .py")
    left_out = () if out.suffix == ".toml" else export_model(scene, out)
    typer.echo(f"written: {out}")
    for words in left_out:
        say(f"left out: {words}")


def _print_imported(scene: Scene) -> None:
    """Print what a scene of a model has, holds until and leaves out, and whether lieeuler can run it."""
    from crosscheck import adapters
    from crosscheck.adapters.base import RunSpec
    from crosscheck.scene.models.words import shortened

    say(f"{scene.name}: {counted(scene.n, 'body', 'bodies')}, {counted(len(scene.joints), 'joint')}, "
        f"{counted(len(scene.forces), 'force')}")
    if scene.monitors:
        say(f"it ends at the first of {counted(len(scene.monitors), 'monitor')}: a joint leaves its range, "
            "or two bodies touch")
    for words in shortened(scene.left_out):
        say(f"left out: {words}")
    if (reason := adapters.get("lieeuler").unsupported(scene, RunSpec("taylor", rtol=1e-9))) is not None:
        say(f"lieeuler cannot run it: {reason}")


STEPS = ("1e-2", "1e-3", "1e-4", "1e-5", "1e-6", "1e-7", "1e-8", "1e-9")
"""Of MuJoCo's differences, for the curve of their error."""

SOURCES = (*(f"pinocchio:{way}" for way in ("aba", "rnea", "constrained")),
           *(f"mujoco:inverseFD@{step}" for step in STEPS), "mujoco:transitionFD", "exudyn:linearised",
           *(f"{engine}:differences" for engine in ("mujoco", "pinocchio", "exudyn", "lieeuler")))
"""What is asked by default."""


@options.reads_models
def linearise(
    scene: options.SceneName,
    source: Annotated[list[str] | None, typer.Option("--source", help="an engine, engine:way (aba, rnea, constrained, "
                                                     "inverseFD@1e-6, transitionFD, differences) or a class of "
                                                     "your own as module:Class; may be repeated")] = None,
    modes: Annotated[bool, typer.Option("--modes", help="instead, the eigenvalues of small motions about the start, an "
                                        "equilibrium or a steady motion")] = False,
    over: Annotated[str | None, typer.Option(help="modes over a number of the scene and its range, "
                                             "bodies.bob.mass=1:2 or speed=0:10")] = None,
    points: Annotated[int, typer.Option(help="values of that number", min=2, max=1001)] = 11,
    as_json: options.AsJson = False,
    out: options.Page = None,
    reading: options.Reading = options.AS_IT_IS,
) -> None:
    """Compare derivatives of the acceleration at a scene's start with truth; or print its modes (--modes).

    Exit code 0: all are right; 1: one is wrong; 2: it could not be done.
    """
    asked = options.loaded(scene, reading)
    if modes or over is not None:
        if source:
            raise ArgumentError("--source: derivatives have sources, modes are those of truth; leave one out")
        _modes(asked, over, points, as_json, out)
    else:
        _derivatives(asked, source, as_json, out)


def _derivatives(scene: Scene, source: list[str] | None, as_json: bool, out: Path | None) -> None:
    from crosscheck.cli.linear_pages import write_derivatives
    from crosscheck.jointspace.derivatives import truth
    from crosscheck.jointspace.laws import smooth
    from crosscheck.jointspace.verdicts import judge

    asked = smooth(scene)
    exact = truth(asked)
    verdicts: list[Verdict] = []
    skipped: dict[str, str] = {}
    for each in source or SOURCES:
        try:
            verdicts.append(judge(asked, each, exact))
        except (Unsupported, EngineError) as error:
            skipped[each] = str(error)
    if as_json:
        options.print_json({
            "scene": asked.name, "coordinates": exact.coordinates, "error": exact.error,
            **{name: values.tolist() for name, values in exact.blocks.items()},
            "verdicts": [{"source": each.source, "errors": each.errors, "bound": each.bound, "right": each.right,
                          "cause": each.cause} for each in verdicts], "skipped": skipped})
    else:
        _print_derivatives(exact, verdicts, skipped)
    if source and not verdicts:
        raise ArgumentError(next(iter(skipped.values())))
    if out is not None:
        print(f"page: {write_derivatives(out, asked, exact, verdicts, skipped)}", file=sys.stderr)
    raise typer.Exit(0 if all(each.right for each in verdicts) else 1)


def _print_derivatives(exact: Any, verdicts: Any, skipped: dict[str, str]) -> None:
    import numpy as np

    say(f"{exact.scene}: {', '.join(exact.coordinates) or 'no joint coordinates'}")
    for name, values in exact.blocks.items():
        if name != "matrix" or exact.da_dq is None:
            say(f"{name}, known to {exact.error:.0e} of its largest entry")
            for row in np.where(np.abs(values) > exact.error * np.abs(values).max(initial=0.0), values, 0.0):
                say("  ".join(f"{value: .10g}" for value in row), indent=2)
    for each in verdicts:
        listed = "  ".join(f"{name} {error:.1e}" for name, error in each.errors.items())
        say(f"{'✓' if each.right else '✗'} {each.source}: {listed}; allowed {each.bound:.1e}"
            + ("" if each.right else f"; {each.cause or 'the cause is unknown'}"))
    curve = [each for each in verdicts if "inverseFD" in each.source]
    if len(curve) > 2:
        best = min(curve, key=lambda each: max(error for name, error in each.errors.items() if name != "da_dtau"))
        say(f"of MuJoCo's steps {best.source.partition('@')[2]} is the best; larger ones have the error of "
            "differences, smaller ones that of rounding")
    for reason in dict.fromkeys(skipped.values()):
        names = [name for name, other in skipped.items() if other == reason]
        say(f"left out: {', '.join(names)}: {reason}")


def _modes(scene: Scene, over: str | None, points: int, as_json: bool, out: Path | None) -> None:
    import numpy as np

    from crosscheck.cli.linear_pages import write_modes
    from crosscheck.jointspace.modes import at_speed
    from crosscheck.jointspace.modes import modes as find
    from crosscheck.scene.paths import changed, unit

    small, path, over_numbers = find(scene), "", {}
    if over is not None:
        path, _, span = over.partition("=")
        try:
            low, high = (float(each) for each in span.split(":"))
            if not abs(high) + abs(low) < FARTHEST:
                raise ValueError
        except ValueError:
            raise ArgumentError(f"--over: {over!r} is not understood; write PATH=FROM:TO, such as speed=0:10, each "
                                f"below {FARTHEST:g}") from None
        over_numbers = {value: find(at_speed(scene, value) if path == "speed" else changed(scene, {path: value})
                                    ).eigenvalues for value in np.linspace(low, high, points).tolist()}
    listed = {f"{value:.10g}": values for value, values in over_numbers.items()} or {"": small.eigenvalues}
    if out is not None:
        print(f"page: {write_modes(out, scene, small, path, over_numbers)}", file=sys.stderr)
    if as_json:
        options.print_json({"scene": scene.name, "over": path, "unit": unit(path), "eigenvalues": {
            key: [[value.real, value.imag] for value in values] for key, values in listed.items()}})
        return
    for key, values in listed.items():
        zeros = int(np.count_nonzero(values == 0))
        text = "  ".join(f"{value.real:.14g}" if value.imag == 0 else f"{value.real:.14g} {value.imag:+.14g}i"
                         for value in values if value != 0)
        say(f"{scene.name}{f', {path} = {key} {unit(path)}'.rstrip() if key else ''}: {text or 'none'}"
            + (f"; {zeros} of zero" if zeros else "") + " (1/s)")


def write_script(scene: str, engine: str, method: str, step: float | None, given: Mapping[str, Any],
                 reading: options.Reading, out: Path | None, issue: Path | None) -> None:
    """Write the script of `crosscheck run --script` to a file or the terminal, and a text ready to file.

    Of the other options given a script holds the duration alone.
    """
    from crosscheck.inspection.bisect import issue as filed
    from crosscheck.inspection.reproduce import reproduce

    if others := [name for name, value in given.items() if value and name != "duration"]:
        raise ArgumentError(f"--script: a script does not hold {', '.join(others)}; leave it out")
    if step is None:
        raise ArgumentError("--script: give --step, s")
    script = reproduce(scene, engine, method, step, given.get("duration"), **reading.only_start())
    for words in script.left_out:
        typer.echo(f"left out of the script and of what it expects: {words}", err=True)
    for path, text in ((out, script.text), (issue, filed(script, engine))):
        if path is not None:
            put(path, text)
            typer.echo(f"written: {path}", err=True)
    if out is None:
        typer.echo(script.text, nl=False)


@options.reads_models
def bisect(
    scene: options.SceneName,
    versions: Annotated[str, typer.Option(help="the first and the last release, as 3.1.0..4.0.0")],
    engine: Annotated[str, typer.Option(help="mujoco; no other is known")] = "mujoco",
    method: Annotated[str, typer.Option(help="an integrator of the engine")] = "RK4",
    step: Annotated[float, typer.Option(help="fixed step, s")] = 1e-3,
    issue: options.Issue = None,
    duration: options.Duration = None,
    reading: options.Reading = options.AS_IT_IS,
) -> None:
    """Find the releases of an engine that changed its answer to a scene, and by how much beyond rounding.

    An environment is made for each release that is run, by uv or pip, and kept. Exit code 0: nothing changed; 1: a
    release changed the answer; 2: it could not be done.
    """
    from crosscheck.inspection import bisect as releases
    from crosscheck.inspection.reproduce import reproduce as written

    with at_work(f"the script and truth of {Path(scene).name}"):
        script = written(scene, engine, method, step, duration, **reading.only_start())
    with progress_bar(f"releases of {engine}") as progress:
        result = releases.bisect(script, engine, versions, say, progress)
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
