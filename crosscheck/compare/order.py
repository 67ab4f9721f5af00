"""Where answers at a few steps go, and how surely: solution verification.

Answers A(h) = A(0) + c h^p + d h^(p+1) + ... of a method of order p, less the truth. T2 cancels h^p from the two finest
and T3 also h^(p+1) from three; the uncertainty of T3 is 3 |T3 - T2|, and what rounding and noise leave:
equations (21.1) and (21.2) of docs/theory.md.

Sources: P. J. Roache, J. Fluids Eng. 116 (1994) 405; ASME V&V 20; L. Eca, M. Hoekstra, J. Comput. Phys. 262 (2014) 104;
E. Hairer, S. P. Norsett, G. Wanner, Solving Ordinary Differential Equations I, II.9.
"""

from __future__ import annotations

import dataclasses
import functools
import itertools
import math
from collections.abc import Mapping, Sequence

import numpy as np

from crosscheck.compare.apart import largest, spread

SAFETY = 3.0
"""Safety factor of an uncertainty (Roache 1994 for two grids, kept for three as a run has some sixty figures)."""
MARGIN = 0.5
"""An observed order counts as the whole number that it is nearest to (Roache)."""


ORDERS = (-4.0, 14.0, 720)
"""From where to where an observed order is sought, and at how many places, zero not among them: that of Gragg's code of
order 12 and a divergent one are within."""


@dataclasses.dataclass(frozen=True)
class Limit:
    """Where a sequence of answers goes, less truth; its uncertainty is the sum of `parts`."""

    value: np.ndarray  # (T, n, k)
    parts: Mapping[str, float]  # of U, by what it comes from
    by: str  # "order", "rounding", "no order", "index", "tolerance": which rule gave it

    @property
    def size(self) -> float:
        """|value|: the largest Euclidean norm."""
        return largest(self.value)

    @property
    def uncertainty(self) -> float:
        """U."""
        return float(sum(self.parts.values()))


def cancelling(h: np.ndarray, order: float) -> np.ndarray:
    """Weights, of sum one, of the values at steps h whose sum is without h^order, h^(order + 1), ...: one fewer."""
    return _weights(tuple(h.tolist()), order)


@functools.lru_cache
def _weights(h: tuple[float, ...], order: float) -> np.ndarray:
    """Of `cancelling`, for the steps that all segments of a run share."""
    steps, powers = np.array(h), np.array([0, *(order + np.arange(len(h) - 1))])
    return np.asarray(np.linalg.solve((steps[None] / steps[0]) ** powers[:, None], np.eye(len(h))[0]))


def observed_order(h: Sequence[float], answers: Sequence[np.ndarray]) -> float:
    """q with (h3^q - h2^q) / (h2^q - h1^q) = rms(A3 - A2) / rms(A2 - A1) for steps h1 < h2 < h3.

    Infinite if the two finest are equal, minus infinite if anything is not finite.
    """
    near, far = (float(np.sqrt(np.mean((b - a) ** 2))) for a, b in itertools.pairwise(answers))
    if not (math.isfinite(near) and math.isfinite(far)):
        return -math.inf
    if near == 0.0:
        return math.inf
    return float(np.interp(far / near, *_ratios(*h)))


@functools.lru_cache
def _ratios(*h: float) -> tuple[np.ndarray, np.ndarray]:
    """The right side of `observed_order` at these steps, and the orders at which it is."""
    powers = np.linspace(*ORDERS)  # without zero, where both sides are 0
    return (h[2] ** powers - h[1] ** powers) / (h[1] ** powers - h[0] ** powers), powers


def floor_of(rounding: Sequence[float], noise: float, weights: Sequence[float] | np.ndarray | None = None) -> float:
    """Sum of |w| (u_round + 3 u_noise) of answers with these weights, by default the finest alone."""
    weights = [1.0, *[0.0] * (len(rounding) - 1)] if weights is None else weights
    return float(sum(abs(w) * (u + SAFETY * noise) for w, u in zip(weights, rounding, strict=True)))


def differ(answers: Sequence[np.ndarray], rounding: Sequence[float], noise: float) -> bool:
    """Whether answers differ by more than rounding and noise, so that an order may be asked."""
    return any(largest(b - a) > 2 * floor_of((max(u, v),), noise)
               for (a, b), (u, v) in zip(itertools.pairwise(answers), itertools.pairwise(rounding), strict=True))


def limit(h: Sequence[float], answers: Sequence[np.ndarray], order: int, rounding: Sequence[float], noise: float = 0.0,
          observed: float = math.inf, far: tuple[float, np.ndarray] | None = None) -> Limit:
    """The limit of answers less truth, (T, n, k) each, at steps h1 < h2 < h3 of a method of documented `order`.

    A fourth answer, from before a refinement, has no part in the value: what T2 was then shows how far T3 may be
    trusted, as T2 does. So does T2 of the finest answer and `far`, one at a far smaller step: where a method damps a
    fast oscillation away at all three steps, these agree on a limit that is not that of vanishing steps.

    Parameters
    ----------
    rounding : u_round of each answer
    noise : u_noise, by how much answers to one question scatter beyond rounding
    observed : the observed order of the sequence; below `order` - 1/2 nothing is extrapolated
    far : step and answer less truth
    """
    finest, steps = answers[:3], np.array(h)
    most = spread(finest)
    if not math.isfinite(most):
        return Limit(answers[0], {"extrapolation": math.inf}, "no order")
    T2, beyond = _sum(cancelling(steps[:2], order), answers), 0.0
    if far is not None:
        finer = _sum(cancelling(np.array([far[0], h[0]]), order), [far[1], answers[0]])
        beyond = largest(T2 - finer)
    rounds = not differ(finest, rounding[:3], noise)
    if rounds or observed < order - MARGIN:
        return Limit(answers[0], {"extrapolation": SAFETY * max(most, beyond), "rounding": floor_of(rounding[:3], 0.0),
                                  "noise": SAFETY * noise}, "rounding" if rounds else "no order")
    three = cancelling(steps[:3], order)
    T3, before = _sum(three, finest), _sum(cancelling(steps[1:4], order), answers[1:4]) if len(h[3:]) else T2
    return Limit(T3, {"extrapolation": SAFETY * max(largest(T3 - T2), largest(T3 - before), beyond),
                      "rounding": floor_of(rounding[:3], 0.0, three),
                      "noise": float(np.abs(three).sum()) * SAFETY * noise}, "order")


def _sum(weights: np.ndarray, answers: Sequence[np.ndarray]) -> np.ndarray:
    return sum((w * each for w, each in zip(weights, answers, strict=False)), np.zeros_like(answers[0]))


def index(h: Sequence[float], answers: Sequence[np.ndarray], order: int, rounding: float, noise: float = 0.0,
          jump: float = 0.0) -> Limit:
    """The finest answer of a sequence without an expansion in h, with the grid index of an order (Eca, Hoekstra).

    Every convergent method has errors up to C h, and one that finds events C h^order; C is from the two answers that
    differ most for their steps. `jump`: by how much an event that is a step late may change the row.
    """
    pairs = itertools.combinations(range(len(answers)), 2)
    most = max(largest(answers[i] - answers[j]) / ((h[j] / h[0])**order - (h[i] / h[0])**order) for i, j in pairs)
    return Limit(answers[0], {"extrapolation": max(SAFETY * most, jump), "rounding": rounding, "noise": SAFETY * noise},
                 "index")


def spread_of_tolerances(answers: Sequence[np.ndarray], rounding: float, noise: float = 0.0, kept: float = 0.0
                         ) -> Limit:
    """The answer at the finest tolerance of an adaptive method, which has no expansion: U is three times the spread.

    Where the two finest do not differ, as where outputs make the steps, the spread shows nothing: U is then what the
    tolerance allows, `kept`.
    """
    blind = not differ(answers[:2], [rounding] * 2, noise)
    return Limit(answers[0], {"extrapolation": SAFETY * spread(answers), "tolerance": kept if blind else 0.0,
                              "rounding": rounding, "noise": SAFETY * noise}, "tolerance")
