"""`crosscheck derivatives` and `crosscheck modes`: linearised equations of a scene, of truth and of engines."""

from __future__ import annotations

from typing import Annotated, Any

import typer

from crosscheck.cli.console import say
from crosscheck.cli.options import AsJson, Drop, Keyframe, SceneName, loaded, print_json

STEPS = ("1e-2", "1e-3", "1e-4", "1e-5", "1e-6", "1e-7", "1e-8", "1e-9")
"""Of MuJoCo's differences, for the curve of their error."""

SOURCES = ("pinocchio:aba", *(f"mujoco:inverseFD@{step}" for step in STEPS), "mujoco:transitionFD",
           "exudyn:linearised", *(f"{engine}:differences" for engine in ("mujoco", "pinocchio", "exudyn", "lieeuler")))
"""What is asked by default."""


def derivatives(
    scene: SceneName,
    source: Annotated[list[str] | None, typer.Option("--source", help="an engine, engine:way (aba, inverseFD@1e-6, "
                                                     "transitionFD, differences) or a class of your own as "
                                                     "module:Class; may be repeated")] = None,
    as_json: AsJson = False,
    drop: Drop = False,
    keyframe: Keyframe = None,
) -> None:
    """Derivatives of the acceleration at a scene's start: truth, and each source with a verdict.

    Exit code 0: all are right; 1: one is wrong; 2: it could not be done.
    """
    from crosscheck.errors import ArgumentError, EngineError, Unsupported
    from crosscheck.jointspace.derivatives import truth
    from crosscheck.jointspace.laws import smooth
    from crosscheck.jointspace.verdicts import Verdict, judge

    asked = smooth(loaded(scene, drop, keyframe))
    exact = truth(asked)
    verdicts: list[Verdict] = []
    skipped: dict[str, str] = {}
    for each in source or SOURCES if exact.da_dq is not None else ():
        try:
            verdicts.append(judge(asked, each, exact))
        except (Unsupported, EngineError) as error:
            skipped[each] = str(error)
    if source and exact.da_dq is None:
        raise ArgumentError(f"--source: {asked.name!r} has no joint coordinates in which sources give derivatives")
    if as_json:
        print_json({
            "scene": asked.name, "coordinates": exact.coordinates, "error": exact.error,
            **{name: values.tolist() for name, values in exact.blocks.items()},
            "verdicts": [{"source": each.source, "errors": each.errors, "bound": each.bound, "right": each.right,
                          "cause": each.cause} for each in verdicts], "skipped": skipped})
    else:
        _print(exact, verdicts, skipped)
    if source and not verdicts:
        raise ArgumentError(next(iter(skipped.values())))
    raise typer.Exit(0 if all(each.right for each in verdicts) else 1)


def _print(exact: Any, verdicts: Any, skipped: dict[str, str]) -> None:
    say(f"{exact.scene}: {', '.join(exact.coordinates) or 'no joint coordinates'}")
    for name, values in exact.blocks.items():
        if name != "matrix" or exact.da_dq is None:
            say(f"{name}, known to {exact.error:.0e} of its largest entry")
            for row in values:
                say("  ".join(f"{value: .10g}" for value in row), indent=2)
    for each in verdicts:
        told = "  ".join(f"{name} {error:.1e}" for name, error in each.errors.items())
        say(f"{'✓' if each.right else '✗'} {each.source}: {told}; allowed {each.bound:.1e}"
            + ("" if each.right else f"; {each.cause or 'the cause is unknown'}"))
    curve = [each for each in verdicts if "inverseFD" in each.source]
    if len(curve) > 2:
        best = min(curve, key=lambda each: max(each.errors["da_dq"], each.errors["da_dv"]))
        say(f"of MuJoCo's steps {best.source.partition('@')[2]} is the best; larger ones have the error of order one, "
            "smaller ones that of rounding")
    for name, reason in skipped.items():
        say(f"{name} is left out: {reason}")


def modes(
    scene: SceneName,
    over: Annotated[str | None, typer.Option(help="a number of the scene and its range, bodies.bob.mass=1:2 or "
                                             "speed=0:10")] = None,
    points: Annotated[int, typer.Option(help="values of that number", min=2, max=1001)] = 11,
    as_json: AsJson = False,
    drop: Drop = False,
    keyframe: Keyframe = None,
) -> None:
    """Eigenvalues of small motions about a scene's start, an equilibrium or a steady motion."""
    import numpy as np

    from crosscheck.errors import ArgumentError
    from crosscheck.jointspace.modes import modes as find
    from crosscheck.jointspace.parameters import altered

    asked = loaded(scene, drop, keyframe)
    eigenvalues = {"": find(asked).eigenvalues}
    path = ""
    if over is not None:
        path, _, span = over.partition("=")
        try:
            low, high = (float(each) for each in span.split(":"))
        except ValueError:
            raise ArgumentError(f"--over: {over!r} is not understood; write PATH=FROM:TO, such as speed=0:10") from None
        eigenvalues = {f"{value:.10g}": find(altered(asked, path, float(value))).eigenvalues
                       for value in np.linspace(low, high, points)}
    if as_json:
        print_json({"scene": asked.name, "over": path, "eigenvalues": {
            key: [[value.real, value.imag] for value in values] for key, values in eigenvalues.items()}})
        return
    for key, values in eigenvalues.items():
        zeros = int(np.count_nonzero(values == 0))
        text = "  ".join(f"{value.real:.14g}" if value.imag == 0 else f"{value.real:.14g} {value.imag:+.14g}i"
                         for value in values if value != 0)
        say(f"{asked.name}{f', {path} = {key}' if key else ''}: {text or 'none'}"
            + (f"; {zeros} of zero" if zeros else "") + " (1/s)")
