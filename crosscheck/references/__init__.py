"""Independent truth: two formulations that share no equation, compared with each other before either is used.

Nothing here imports `lieeuler` or an adapter. For a free body and a Lagrange top, elliptic functions are compared with
Taylor series; for everything else, trees and loops of all joints under all forces, Taylor series in minimal coordinates
with DOP853 in maximal ones. If these differ by more than the scene's conditioning explains, a third formulation, in
natural coordinates and extended precision, decides which of them is wrong.
"""

from __future__ import annotations

import dataclasses
from math import ceil
from typing import TYPE_CHECKING, Any

import numpy as np

from crosscheck.errors import Unsupported
from crosscheck.references.base import Chaotic, Reference, TruthError
from crosscheck.scene.model import SMOOTH, Scene

if TYPE_CHECKING:
    from crosscheck.references.agreement import Agreement, Solved

__all__ = ["Chaotic", "Reference", "TruthError", "truth"]

FLOOR = 1e-12  # relative difference of two formulations on a well-conditioned scene
ROUNDOFF = 1e-14  # the rounding errors of a whole run as a perturbation of its start, before the scene amplifies it


def truth(scene: Scene) -> Reference:
    """Reference trajectory of a scene, from the cache if it is stored there.

    Raises
    ------
    TruthError
        The formulations differ so much that no usable digits are left, or one of them ends early, as it does where the
        rows of a loop lose rank, except in parallelograms. The error is `Chaotic`, with the `horizon` of the truth, if
        that is before the first output time.
    Unsupported
        The scene has elements that the references do not model.
    """
    from crosscheck.references import cache
    from crosscheck.references.tree import bound, unfold

    if reason := scene.beyond(SMOOTH) or ("monitors are not built here" if scene.monitors else None):
        raise Unsupported(f"truth of {scene.name!r}: {reason}")
    refused = [joint for joint in scene.joints if bound(scene, joint)]
    if refused and (closing := [joint.name for joint in unfold(scene)[1] if joint in refused]):
        raise Unsupported(f"truth of {scene.name!r}: armature and mimics of joint {closing[0]!r} are not built where "
                          "every joint of a loop has some")
    stored = cache.load(scene)
    if stored is not None:
        return stored
    reference = compute(scene)
    cache.store(scene, reference)
    return reference


def compute(scene: Scene) -> Reference:
    """As `truth`, without the cache; if heyoka is not installed, from the formulations that do not need it."""
    try:
        import heyoka  # noqa: F401
    except ImportError:
        from crosscheck.references import portable

        return portable.compute(scene, FLOOR, ROUNDOFF)
    from crosscheck.references import closed_form, conditioning, taylor
    from crosscheck.references.agreement import Solved, agree

    integrator = taylor.Taylor(scene)
    coefficients: list[Any] = []
    series = Solved(integrator.states(integrator.run(coefficients=coefficients)), taylor.SOURCE)
    conditions = conditioning.measure(integrator)
    compared = _compared(scene, conditions.horizon)
    try:
        first, second = Solved(closed_form.solve(scene), closed_form.SOURCE), series
    except Unsupported:
        from crosscheck.references import maximal

        other = maximal.Maximal(scene)
        first, second = series, Solved(other.run(scene.t[:compared]), other.source)
    allowed = max(FLOOR, ROUNDOFF * conditions.within_horizon)
    found = agree(scene, first, second, compared, allowed)
    if series not in (found.chosen, found.second):
        found = _without_series(scene, found, series, compared)
    position, attitude = integrator.derivative_maxima(coefficients)
    return Reference(found.chosen.states, found.chosen.source, found.second.source, found.difference, allowed,
                     conditions.amplification, conditions.horizon, position, attitude, found.outvoted)


def _without_series(scene: Scene, found: Agreement, series: Solved, compared: int) -> Agreement:
    """The agreement of the other two formulations, at all output times, after the Taylor series were outvoted.

    Raises
    ------
    TruthError
        The series are so far off that the growth of perturbations measured with them belongs to another motion.
    """
    from crosscheck.references.agreement import USABLE, Solved, difference

    if difference(scene, series.states, found.second.states, compared).size > USABLE:
        raise TruthError(f"{scene.name!r}: {found.outvoted}, by {found.chosen.source} and {found.second.source}, which "
                         f"differ by {found.difference:.1e}; they disagree so far that nothing measured with it holds")
    if len(found.chosen.states.t) == scene.samples:
        return found
    from crosscheck.references.maximal import Maximal

    return dataclasses.replace(found, chosen=Solved(Maximal(scene).run(), found.chosen.source))


def _compared(scene: Scene, horizon: float) -> int:
    """Number of output times up to the horizon, beyond which no two integrations agree."""
    count = int(np.count_nonzero(scene.t <= horizon * (1 + 1e-12)))  # the ends of both grids agree to rounding
    if count < 2 and horizon > 0.0:
        raise Chaotic(f"{scene.name!r}: its truth ends at {horizon:.3g} s, where a perturbation of 1e-15 has grown to "
                      f"1e-10, and the first output time is {scene.t[1]:.3g} s; ask for a shorter duration or more "
                      f"samples: {ceil(scene.duration / horizon) + 1} over {scene.duration:g} s, or a duration of "
                      f"{horizon:.2g} s", horizon)
    if count < 2:
        raise TruthError(f"{scene.name!r}: perturbations of 1e-15 are 1e-10 at the start: it has no truth")
    return count
