"""`crosscheck truth`: the independent truth of a scene."""

from __future__ import annotations

from typing import Annotated

import typer

from crosscheck.cli.console import say
from crosscheck.cli.options import Drop, Keyframe, SceneName, loaded
from crosscheck.cli.states_csv import write_csv


def truth(
    scene: SceneName,
    csv_file: Annotated[str | None, typer.Option("--csv", help="file for the states; - for the terminal")] = None,
    drop: Drop = False,
    keyframe: Keyframe = None,
    floor: Annotated[bool, typer.Option("--floor", help="say what rounding leaves in double precision")] = False,
) -> None:
    """Print the independent truth of a scene: its sources, its error, the end state."""
    from crosscheck.references import Chaotic
    from crosscheck.running.run import truth as truth_of

    shown = loaded(scene, drop, keyframe)
    try:
        reference = truth_of(shown)
    except Chaotic as error:
        typer.echo(f"{error}. The following is the truth up to that time.", err=True)
        shown = shown.replace(duration=float(f"{error.horizon:.2e}") * 0.99, samples=min(shown.samples, 51))
        reference = truth_of(shown)
    if csv_file is not None:
        write_csv(shown, reference.states, csv_file)
    if csv_file == "-":
        return
    say(f"{shown.name}: {reference.source}")
    say(f"checked against: {reference.second_source}")
    say(f"error of this truth: at most {reference.error:.1e} of the scene's length; the two differ by "
        f"{reference.disagreement:.1e} (rounding explains up to {reference.allowed:.1e})")
    if reference.outvoted:
        say(f"outvoted: {reference.outvoted}")
    say(f"a perturbation grows {reference.amplification:.3g}-fold over {shown.duration:g} s; "
        f"runs are compared with truth up to {reference.horizon:g} s")
    if floor:
        from crosscheck.references import conditioning

        left, when = conditioning.floor(shown)
        say(f"floor of double precision: {left:.1e} of the length, radians; a rounding at {when:g} s grows most")
    for body, position in zip(shown.bodies, reference.states.x[-1], strict=True):
        say(f"{body.name}: x({shown.duration:g} s) = ({', '.join(f'{value:.15g}' for value in position)}) m")
