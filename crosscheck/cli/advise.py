"""`crosscheck advise`: the method of an engine, and its step, for a wanted error."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

import typer

from crosscheck.cli.console import say, waiting
from crosscheck.cli.options import AsJson, figure, print_json

if TYPE_CHECKING:
    from crosscheck.document import Advice


def advise(
    scene: Annotated[str, typer.Argument(help="a built-in name or a path to .toml or .json")],
    engine: Annotated[str, typer.Option(help="a name, name==version, or a class of your own as module:Class")],
    error: Annotated[float, typer.Option(help="m; largest |component of x - truth| over bodies and output times")],
    as_json: AsJson = False,
) -> None:
    """Find the cheapest method of an engine for an error, its largest step, and the step at which it fails.

    The first call for a scene and engine compares runs with truth, for at most half a minute of processor time; later
    calls read the results. Exit code 0: a method reaches the error; 1: none does.
    """
    import msgspec

    from crosscheck.verification.advice import advise as find

    with waiting(f"runs of {engine} at a ladder of steps, against truth"):
        advice = find(scene, engine=engine, error=error)
    if as_json:
        print_json(msgspec.to_builtins(advice))
    else:
        tell(advice)
    raise typer.Exit(int(advice.method is None))


def tell(each: Advice) -> None:
    """Print an advice; the line of the command is not folded, so that it can be copied."""
    for line in words(each):
        if line.startswith("command "):
            print(line)
        else:
            say(line, hang=9)


def words(each: Advice) -> list[str]:
    """The lines of an advice."""
    asked = f"{each.scene} with {each.engine}, position error at most {each.wanted:g} m up to {each.until:g} s"
    if each.method is None:
        least = "no run ended" if each.least is None else f"the least error found is {each.least:.1e} m"
        return [f"{asked}: no method reaches it, {least}"]
    size = f"step     {figure(each.step)} s" if each.step else f"rtol     {figure(each.rtol)}"
    breaks = "at no step tried; the longest is the time between two outputs" if each.breaks_at is None else (
        f"at {'step' if each.step else 'rtol'} {figure(each.breaks_at)}{' s' if each.step else ''}: there it fails, "
        "or is wrong by a tenth of the scene's size")
    return [asked, f"method   {each.method}{f', form {each.form}' if each.form else ''}", size,
            f"error    {each.error:.1e} m", f"cost     {each.cost or 0.0:.3g} s of stepping",
            f"breaks   {breaks}", f"command  {each.command}"]
