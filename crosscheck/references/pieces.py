"""Motion in smooth pieces: roots of surfaces on dense output.

Nothing here knows physics. A surface is a function of the state that is positive inside a mode; where it falls to zero,
the piece ends. On one step of a series every surface is an analytic function whose radius of convergence is several
steps, so that its values at NODES Chebyshev points give it to rounding, with all its roots and extrema.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from numpy.polynomial import chebyshev

Label = tuple[Any, Any]
"""Of a surface: whose, and which."""

Values = Mapping[Label, np.ndarray]
"""Values of surfaces by their labels, at several times."""

Event = tuple[float, str, str]
"""(time, joint or monitor, what happened)."""

NODES = 16
GRAZE = 1e-10
"""An extremum below this part of a surface's size is a graze: a crossing beside it would be sqrt(GRAZE) in slope, and
rounding of 1e-14 would move it by 1e-9 of a step."""
ZERO = 1e-12
"""A surface whose value is below this part of its size where a piece begins is one on which it begins."""
TOGETHER = 1e-10
"""Surfaces that are reached within this part of a step are reached together."""
LATE = 1e-9
"""Events nearer than this part of the time, or of a second, are one."""

EARLY = np.array([1e-3, 2e-3])
"""Places in a step that show how a surface leaves zero."""

NODE_PLACES = 0.5 * (1.0 - np.cos(np.pi * np.arange(NODES + 1) / NODES))
_FIT = np.linalg.inv(chebyshev.chebvander(2.0 * NODE_PLACES - 1.0, NODES))


@dataclasses.dataclass(frozen=True)
class Crossing:
    """The first event of a step: after how long (s), which surfaces, and why the truth ends there if it does."""

    after: float
    labels: tuple[Label, ...]
    graze: bool = False


def first_crossing(surfaces: Callable[[np.ndarray], Values], length: float, instant: float = 0.0) -> Crossing | None:
    """Where the first surfaces fall to zero within a step of this length; None if none does.

    `surfaces` gives values at times (s) after the start of the step. With an `instant` (s) the step begins at an event,
    so that some surfaces may begin at zero; they are divided by the power of the time with which they leave it. What a
    surface leaves in less than an instant is rounding: in a short step it may be more than ZERO of the surface's size.
    """
    at_nodes = surfaces(length * NODE_PLACES)
    early = surfaces(length * EARLY) if instant else {}
    roots: list[tuple[float, Label, bool]] = []
    for label, values in at_nodes.items():
        size = float(np.abs(values).max())
        if size == 0.0:
            continue
        if instant:
            left = abs(early[label][0] - values[0]) * instant / (EARLY[0] * length)
            if abs(values[0]) <= max(ZERO * size, left):
                values = _left_zero(values, early[label])
        if values[0] < 0.0:
            roots.append((0.0, label, False))
            continue
        nearest = _first_root(values, size)
        if nearest is not None:
            roots.append((nearest[0], label, nearest[1]))
    if not roots:
        return None
    first = min(roots, key=lambda root: root[0])
    together = tuple(label for at, label, _ in roots if at <= first[0] + TOGETHER)
    if first[0] == 0.0 or first[2]:
        return Crossing(first[0] * length, together, first[2])
    after = _polished(lambda tau: float(surfaces(np.array([tau]))[first[1]][0]), first[0] * length, length)
    return Crossing(after, together)


def _left_zero(values: np.ndarray, early: np.ndarray) -> np.ndarray:
    """Values of a surface over the power of the time with which it leaves zero; `early` has those at EARLY."""
    ratio = early[1] / early[0] if early[0] else 2.0
    power = round(np.log2(ratio)) if ratio > 1.0 else 1
    divided = np.empty_like(values)
    divided[1:] = values[1:] / NODE_PLACES[1:] ** power
    divided[0] = early[0] / EARLY[0] ** power
    return divided


def _first_root(values: np.ndarray, size: float) -> tuple[float, bool] | None:
    """(place in 0 ... 1, whether it is a graze) of a surface's first root or graze, from its values at the nodes."""
    if values.min() > 0.5 * size:
        return None
    series = _FIT @ values
    roots = [(at, False) for at in _real_roots(series) if at > 0.0 or values[0] <= 0.0]
    turns = [at for at in _real_roots(chebyshev.chebder(series)) if 0.0 < at < 1.0]
    roots += [(at, True) for at in turns if abs(chebyshev.chebval(2 * at - 1, series)) <= GRAZE * size]
    if not roots and values[-1] <= 0.0:
        roots = [(1.0, False)]
    first = min(roots, default=None)
    if first is not None and any(graze and abs(at - first[0]) < 1e-3 for at, graze in roots):
        return first[0], True
    return first


def _real_roots(series: np.ndarray) -> list[float]:
    """Real roots in 0 ... 1 of a Chebyshev series over that interval, without what is below its rounding."""
    small = np.abs(series) > 1e-15 * np.abs(series).max(initial=1e-300)
    count = int(np.flatnonzero(small)[-1]) + 1 if small.any() else 0
    if count < 2:
        return []
    roots = chebyshev.chebroots(series[:count])
    real = 0.5 * (1.0 + roots.real[np.abs(roots.imag) < 1e-9])
    return sorted(float(at) for at in real if -1e-14 <= at <= 1.0 + 1e-14)


def _polished(surface: Callable[[float], float], guess: float, length: float) -> float:
    """The root near a guess, to rounding."""
    width = 1e-7 * length
    one, other = max(guess - width, 0.0), min(guess + width, length)
    at_one, at_other = surface(one), surface(other)
    best = guess
    for _ in range(6):
        if at_other == at_one:
            break
        best = min(max(other - at_other * (other - one) / (at_other - at_one), 0.0), length)
        if abs(best - other) <= 1e-16 * max(length, best):
            break
        one, at_one, other, at_other = other, at_other, best, surface(best)
    return best
