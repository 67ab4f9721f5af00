"""Plain steps of a model that gives its accelerations."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from crosscheck.scene.batch import State
from crosscheck.scene.vectors import exponential, inverse_tangent

Rates = Callable[[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray], State]
"""(t, x, R, v, w) -> [dx/dt, ., dv/dt, dw/dt]."""

STAGES, WEIGHTS = ((), (0.5,), (0.0, 0.5), (0.0, 0.0, 1.0)), (1 / 6, 1 / 3, 1 / 3, 1 / 6)
"""Of the classical Runge-Kutta method of order 4."""


def semi_implicit(rates: Rates, t: np.ndarray, state: State, h: np.ndarray) -> State:
    """Semi-implicit Euler."""
    x, R, v, w = state
    h = h.reshape(-1, 1, 1)
    a, alpha = rates(t, *state)[2:]
    v, w = v + h * a, w + h * alpha
    return [x + h * v, R @ exponential(h * w), v, w]


def munthe_kaas(rates: Rates, t: np.ndarray, state: State, h: np.ndarray) -> State:
    """Order 4: integrates the rotation vector since the start of the step, with the rate dexp^-1 w."""
    x, R, v, w = state
    h = h.reshape(-1, 1, 1)
    slopes: list[State] = []

    def moved(row: tuple[float, ...]) -> tuple[State, np.ndarray]:
        dx, turned, dv, dw = (sum((c * rate[k] for c, rate in zip(row, slopes, strict=True)), np.zeros_like(x)) * h
                              for k in range(4))
        return [x + dx, R @ exponential(turned), v + dv, w + dw], turned

    for row in STAGES:
        here, turned = moved(row)
        a, alpha = rates(t + sum(row) * h[:, 0, 0], *here)[2:]
        slopes.append([here[2], inverse_tangent(turned, here[3]), a, alpha])
    return moved(WEIGHTS)[0]
