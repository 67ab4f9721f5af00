"""The speed-against-error frontier: the cost of each method for a given error, and the cheapest method.

Between neighbouring rungs of a ladder the cost is interpolated log-log. Nothing is extrapolated beyond the ends.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence

from crosscheck.document import Way, extended
from crosscheck.scene.model import Scene
from crosscheck.verification.ladder import GradedWay

LEVELS = tuple(10.0**-power for power in range(2, 12))
"""The errors at which costs are compared."""

IN_HOUSE, BOUND = "lieeuler", "heyoka"
"""The engine that is compared with all others, and the one that only shows what is possible."""


class Rung(Way, frozen=True, kw_only=True):
    """One run of a way. Errors are in m and rad, the largest over the bodies. Times are of stepping alone.

    `setup_ms` is the other time of a run: building the engine's model and converting its two samples.
    """

    scene: str
    label: str
    status: str = "success"  # or "skipped", "unsupported", or how it failed
    reason: str = ""
    steps: int | None = None
    rejected_steps: int | None = None
    force_evaluations: int | None = None  # if the engine counts them
    end_position: float | None = None
    end_attitude: float | None = None
    max_position: float | None = None  # over the samples that lie on steps
    max_attitude: float | None = None
    samples: int | None = None  # number of the samples for max_position and max_attitude
    wall_ms: float | None = None  # median over the repeats
    wall_deviation_ms: float | None = None  # median absolute deviation of the repeats
    setup_ms: float | None = None
    repeats: int = 0


def rung_of(scene: Scene, way: GradedWay, value: float | None, status: str = "success", reason: str = "") -> Rung:
    """The rung of a way at `value`: a step (s), or a tolerance if the way is adaptive."""
    return extended(Rung, way, scene=scene.name, label=way.label, status=status, reason=reason, **{
        "rtol" if way.adaptive else "step": value})


@dataclasses.dataclass(frozen=True)
class Curve:
    """Errors and costs of one engine, method and form, coarse rungs first. Failed rungs are left out."""

    engine: str
    label: str
    errors: tuple[float, ...]
    costs: tuple[float, ...]  # ms of stepping, or evaluations of the forces


@dataclasses.dataclass(frozen=True)
class Front:
    """The frontier at one error. Values are None if no method of that kind reaches the error."""

    level: float
    winner: str | None  # of all but the bound
    own: str | None
    own_cost: float | None
    other: str | None
    other_cost: float | None
    factor: float | None  # other_cost / own_cost: above 1 if the in-house method is cheaper
    bound_cost: float | None
    to_bound: float | None  # own_cost / bound_cost
    costs: dict[str, float]  # of all that reach the level, by label, the cheapest first


def confirmed(errors: Sequence[float]) -> list[float]:
    """The errors of a ladder. An error smaller than that of the next finer rung is replaced by the latter.

    At some steps the end error passes through zero by coincidence. No method should win by that.
    """
    return [max(errors[k:k + 2]) for k in range(len(errors))]


def cost_at(errors: Sequence[float], costs: Sequence[float], level: float) -> float | None:
    """The lowest cost for an error of at most `level`; None if no rung reaches it.

    Parameters
    ----------
    errors, costs : finite values of the rungs of one ladder, coarse to fine
    level : the wanted error
    """
    sure = confirmed(errors)
    found = [cost for error, cost in zip(sure, costs, strict=True) if error <= level]
    for coarse, fine in zip(range(len(sure)), range(1, len(sure)), strict=False):
        if sure[coarse] > level >= sure[fine] > 0 and costs[coarse] > 0 and costs[fine] > 0:
            share = math.log(sure[coarse] / level) / math.log(sure[coarse] / sure[fine])
            found.append(costs[coarse] ** (1 - share) * costs[fine] ** share)
    return min(found, default=None)


def frontier(curves: Sequence[Curve], levels: Sequence[float] = LEVELS) -> list[Front]:
    """The cheapest methods at each level, and the factors between their costs."""
    found = []
    for level in levels:
        reached = sorted(((cost, curve) for curve in curves
                          if (cost := cost_at(curve.errors, curve.costs, level)) is not None), key=lambda pair: pair[0])
        own, own_cost = next(((curve.label, cost) for cost, curve in reached if curve.engine == IN_HOUSE), (None, None))
        other, other_cost = next(((curve.label, cost) for cost, curve in reached
                                  if curve.engine not in (IN_HOUSE, BOUND)), (None, None))
        bound = next((cost for cost, curve in reached if curve.engine == BOUND), None)
        found.append(Front(
            level, next((curve.label for _, curve in reached if curve.engine != BOUND), None), own, own_cost, other,
            other_cost, other_cost / own_cost if other_cost is not None and own_cost else None, bound,
            own_cost / bound if own_cost is not None and bound else None,
            {curve.label: cost for cost, curve in reached}))
    return found


def curves(rungs: Sequence[Rung], error: str = "end_position", cost: str = "wall_ms") -> list[Curve]:
    """The curves of these rungs, in their order. Rungs without error or cost are left out."""
    found: dict[str, tuple[str, list[float], list[float]]] = {}
    for rung in rungs:
        e, c = getattr(rung, error), getattr(rung, cost)
        if e is not None and c is not None and math.isfinite(e):
            _, es, cs = found.setdefault(rung.label, (rung.engine, [], []))
            es.append(float(e))
            cs.append(float(c))
    return [Curve(engine, label, tuple(es), tuple(cs)) for label, (engine, es, cs) in found.items()]
