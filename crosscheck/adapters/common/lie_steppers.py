"""Integrators on a tree's joint coordinates for any forward dynamics, because Pinocchio has no integrators.

One step maps (t, q, v) to (q, v); `integrate(q, tangent)` moves q along the group, `dynamics(q, v, t)` is the joint
acceleration. The code is written for clarity, not for speed.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Sequence

import numpy as np

Step = Callable[[float, np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]]
Integrate = Callable[[np.ndarray, np.ndarray], np.ndarray]
Dynamics = Callable[[np.ndarray, np.ndarray, float], np.ndarray]

SERIES = (1 / 12, 1 / 720, 1 / 30240, 1 / 1209600, 1 / 47900160, 691 / 1307674368000)
"""|B_2k| / (2k)! for k = 1 ..: the coefficient of hat(theta)^2 in the inverse tangent, in powers of |theta|^2."""

CLASSIC_4 = ([[], [0.5], [0.0, 0.5], [0.0, 0.0, 1.0]], [1 / 6, 1 / 3, 1 / 3, 1 / 6])
"""Kutta's method of order 4: rows of A, weights b."""


@functools.cache
def dop853() -> tuple[list[list[float]], list[float]]:
    """Rows of A and weights b of the 12-stage order-8 method in DOP853.

    Source: Hairer, Norsett & Wanner, Solving Ordinary Differential Equations I, 2nd ed., section II.5; coefficients
    as SciPy carries them.
    """
    from scipy.integrate import DOP853

    stages = DOP853.n_stages
    return [DOP853.A[row, :row].tolist() for row in range(stages)], DOP853.B[:stages].tolist()


def inverse_tangent(theta: Sequence[float], w: Sequence[float]) -> tuple[float, float, float]:
    """d theta/dt for R = R_0 exp(hat(theta)) with the body angular velocity w, rad/s: the exact dexp^-1.

    w + theta x w / 2 + c theta x (theta x w), c = 1/|theta|^2 - cot(|theta|/2) / (2 |theta|); Iserles, Munthe-Kaas,
    Norsett & Zanna, Acta Numerica 2000, doi:10.1017/S0962492900002154. For three numbers plain floats are faster than
    NumPy.
    """
    a, b, c = theta
    x, y, z = w
    square = a * a + b * b + c * c
    if square < 0.01:  # the closed form cancels here; six terms of the series have an error below 1e-20
        factor = 0.0
        for coefficient in reversed(SERIES):
            factor = factor * square + coefficient
    else:
        angle = math.sqrt(square)
        tangent = math.tan(0.5 * angle) if angle < math.inf else math.nan  # a diverging run
        factor = 1.0 / square - 0.5 / (angle * tangent)
    p, q, r = b * z - c * y, c * x - a * z, a * y - b * x
    return (x + 0.5 * p + factor * (b * r - c * q), y + 0.5 * q + factor * (c * p - a * r),
            z + 0.5 * r + factor * (a * q - b * p))


def symplectic_euler(h: float, integrate: Integrate, dynamics: Dynamics, push: Integrate | None = None) -> Step:
    """Velocity first, then the position with the new velocity; order 1. `push` maps (q, v) to v after impulses."""
    def step(t: float, q: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        v = v + h * dynamics(q, v, t)
        v = v if push is None else push(q, v)
        return integrate(q, h * v), v

    return step


def naive_rk4(h: float, integrate: Integrate, dynamics: Dynamics) -> Step:
    """Kutta's weighted mean of the stage velocities, integrated once: order 2 on SO(3), where these do not add."""
    def step(t: float, q: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        a1 = dynamics(q, v, t)
        v2 = v + 0.5 * h * a1
        a2 = dynamics(integrate(q, 0.5 * h * v), v2, t + 0.5 * h)
        v3 = v + 0.5 * h * a2
        a3 = dynamics(integrate(q, 0.5 * h * v2), v3, t + 0.5 * h)
        v4 = v + h * a3
        a4 = dynamics(integrate(q, h * v3), v4, t + h)
        return integrate(q, h / 6 * (v + 2 * v2 + 2 * v3 + v4)), v + h / 6 * (a1 + 2 * a2 + 2 * a3 + a4)

    return step


def munthe_kaas(h: float, integrate: Integrate, dynamics: Dynamics, balls: Sequence[slice],
                tableau: tuple[list[list[float]], list[float]]) -> Step:
    """Runge-Kutta-Munthe-Kaas: the tableau's own order on the group.

    `balls` are the slices of v that are body angular velocities of spherical joints; all other joints are flat.
    """
    rows, weights = [h * np.array(row) for row in tableau[0]], h * np.array(tableau[1])
    stages, nodes = len(weights), [float(row.sum()) for row in rows]

    def step(t: float, q: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        size = len(v)
        slopes = np.empty((stages, 2 * size))  # of (theta, v)
        for stage in range(stages):
            change = rows[stage] @ slopes[:stage]
            theta, stage_v = change[:size], v + change[size:]
            slopes[stage, :size] = stage_v
            for ball in balls:
                slopes[stage, ball] = inverse_tangent(theta[ball].tolist(), stage_v[ball].tolist())
            slopes[stage, size:] = dynamics(integrate(q, theta), stage_v, t + nodes[stage])
        change = weights @ slopes
        return integrate(q, change[:size]), v + change[size:]

    return step
