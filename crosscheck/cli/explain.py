"""`crosscheck explain`: why an engine's motion differs from a scene's true one."""

from __future__ import annotations

from typing import Annotated, Any

import typer

from crosscheck.cli.console import say
from crosscheck.cli.options import (
    Alpha,
    AsJson,
    Beta,
    CoordinateMap,
    Drop,
    Keyframe,
    Node,
    Reduce,
    SceneName,
    Softness,
    SpectralRadius,
    figure,
    loaded,
    print_json,
)


def explain(
    scene: SceneName,
    engine: Annotated[str, typer.Option(help="a name, or a class of your own as module:Class")],
    method: Annotated[str | None, typer.Option(help="default: the engine's best")] = None,
    form: Annotated[str | None, typer.Option(help="tree, maximal or pivot; default: the engine's choice")] = None,
    step: Annotated[float | None, typer.Option(help="s, of the whole run; default: one that suits the scene")] = None,
    coordinate_map: CoordinateMap = None,
    softness: Softness = None,
    node: Node = None,
    alpha: Alpha = None,
    beta: Beta = None,
    spectral_radius: SpectralRadius = None,
    reduce: Reduce = None,
    as_json: AsJson = False,
    drop: Drop = False,
    keyframe: Keyframe = None,
) -> None:
    """Name the likely cause of an engine's difference from truth, with the evidence.

    Exit code 0: no difference; 1: a cause is named; 2: it differs, and the cause is unknown.
    """
    from crosscheck.diagnosis import explain as find

    answer = find(loaded(scene, drop, keyframe), engine, method, form, step, coordinate_map=coordinate_map,
                  softness=softness, node=node, alpha=alpha, beta=beta, spectral_radius=spectral_radius, reduce=reduce)
    if as_json:
        print_json(answer.plain())
    else:
        _print(answer)
    raise typer.Exit(answer.exit_code)


def _print(answer: Any) -> None:
    """Print the verdict, the measured difference, the evidence, and what to change."""
    mark = {"agrees": "✓", "named": "✗", "unknown": "?"}[answer.outcome]
    say(f"{mark} {answer.sentence}")
    say(f"difference from truth as steps vanish: {answer.deviation:.1e}, which is known to {answer.noise:.1e} (the "
        f"largest of |dx|/L, |dR|, |dv|/(L W) and |dw|/W in the first {answer.window:.3g} s, where L is the longest "
        "lever and W the fastest rate of the scene)")
    if answer.explained is not None:
        say(f"left of it once truth has the cause too: {answer.explained:.1e}")
    if answer.documented_order is not None:
        observed = "at rounding" if answer.observed_order is None else f"{answer.observed_order:.2f}"
        say(f"observed order: {observed}, documented {answer.documented_order}")
    if answer.evidence:
        say(f"evidence; hypotheses tried: {answer.tried} (✓ explains, · does not)")
    for each in answer.evidence:
        told = [f"{each.quantity}: {figure(each.before, '–')} without, {figure(each.after, '–')} with it",
                each.magnitude, each.note]
        say(f"{'✓' if each.holds else '·'} {each.hypothesis}; {'; '.join(filter(None, told))}", indent=2)
    for cause in answer.causes:
        say(f"what to change: {cause.mend} ({cause.name})")
