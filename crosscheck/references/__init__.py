"""Independent truth: two formulations that share no equation, compared with each other before either is believed.

Nothing here imports `lieeuler` or an adapter. A free body and a Lagrange top: elliptic functions against Taylor series;
everything else, trees and loops of all joints under all forces: Taylor series in minimal coordinates against DOP853 in
maximal ones.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from crosscheck.errors import Unsupported
from crosscheck.references.base import Reference, TruthError
from crosscheck.scene.model import Scene
from crosscheck.scene.states import States

__all__ = ["Reference", "TruthError", "truth"]

FLOOR = 1e-12  # relative; what two formulations reach on a well-conditioned scene
ROUNDOFF = 1e-14  # perturbation that the rounding of a whole run amounts to, before the scene amplifies it


def truth(scene: Scene) -> Reference:
    """Reference trajectory of a scene, from the cache where it is there.

    Raises
    ------
    TruthError
        The two formulations disagree beyond what the scene's conditioning explains, or one of them ends early, as it
        does at a position where a loop that is no parallelogram loses rank.
    """
    from crosscheck.references import cache

    stored = cache.load(scene)
    if stored is not None:
        return stored
    reference = compute(scene)
    cache.store(scene, reference)
    return reference


def compute(scene: Scene) -> Reference:
    """As `truth`, without the cache."""
    from crosscheck.references import closed_form, conditioning, taylor

    integrator = taylor.Taylor(scene)
    coefficients: list[Any] = []
    series = integrator.states(integrator.run(coefficients=coefficients))
    conditions = conditioning.measure(integrator)
    compared = _compared(scene, conditions.horizon)
    try:
        first, second, sources = closed_form.solve(scene), series, (closed_form.SOURCE, taylor.SOURCE)
    except Unsupported:
        from crosscheck.references import maximal

        other = maximal.Maximal(scene)
        first, second, sources = series, other.run(scene.t[:compared]), (taylor.SOURCE, other.source)
    allowed = max(FLOOR, ROUNDOFF * conditions.within_horizon)
    disagreement = compare(scene, first, second, compared, sources, allowed)
    position, attitude = integrator.derivative_maxima(coefficients)
    return Reference(first, *sources, disagreement, allowed, conditions.amplification, conditions.horizon, position,
                     attitude)


def _compared(scene: Scene, horizon: float) -> int:
    """Number of output times up to the horizon: past it no two integrations agree, so those are not compared."""
    count = int(np.count_nonzero(scene.t <= horizon * (1 + 1e-12)))  # the ends of both grids agree up to rounding
    if count < 2:
        raise TruthError(f"{scene.name!r}: a perturbation of 1e-15 grows to 1e-10 soon after {horizon:.3g} s, before "
                         "the first output time; ask for a shorter duration or more samples")
    return count


def compare(scene: Scene, first: States, second: States, count: int, sources: tuple[str, str], allowed: float) -> float:
    """Largest |dx| / length and |dR|_F of two trajectories at the first `count` output times.

    Raises
    ------
    TruthError
        It is above `allowed`; the message names both sources, the time and the body.
    """
    from crosscheck.references.tree import scene_length

    x = np.linalg.norm(first.x[:count] - second.x[:count], axis=-1) / scene_length(scene)
    R = np.linalg.norm(first.R[:count] - second.R[:count], axis=(-2, -1))
    differences = np.maximum(x, R)
    sample, body = np.unravel_index(np.argmax(differences), differences.shape)
    worst = float(differences[sample, body])
    if not worst <= allowed:  # also when it is not a number
        raise TruthError(f"{scene.name!r}: {sources[0]} and {sources[1]} disagree by {worst:.2e} at "
                         f"t = {scene.t[sample]:.6g} s in body {scene.bodies[body].name!r}; the scene's conditioning "
                         f"explains {allowed:.2e}")
    return worst
