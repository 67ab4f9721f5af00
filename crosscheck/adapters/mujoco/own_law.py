"""MuJoCo's documented laws of dry friction and limits.

Friction and limits are soft constraints there (Computation, "Constraint model", in its documentation). The acceleration
a minimises 1/2 (a - a0)^T M (a - a0) plus one cost a row, which makes the force of a row

    f = clip(D (aref - a_row), -c, c)    for friction c, with aref = -b v,
    f = max(D (aref - a_row), 0)         for a limit that is exceeded by r > 0, with aref = -b v + k d r,

D = d / ((1 - d) w), w the inverse inertia of the coordinate in the initial position, b = 2 / (dmax T), k = 1 / (dmax T
z)^2. `solref` is T and z; `solimp` is d at the surface, dmax, and the depth, midpoint and power of the way between.
"""

from __future__ import annotations

import math

from crosscheck.adapters.common.own_law import Row
from crosscheck.scene.laws import DryFriction, Limits

SOLREF, SOLIMP = (0.02, 1.0), (0.9, 0.95, 0.001, 0.5, 2.0)
"""MuJoCo's defaults."""


def default(law: DryFriction | Limits, weight: float, q: float, rate: float) -> Row | None:
    """The row of a friction or a limit at MuJoCo's default softness, see `crosscheck.adapters.common.own_law.Law`."""
    (T, z), (d0, dmax, width, midpoint, power) = SOLREF, SOLIMP
    b = 2.0 / (dmax * T)
    if isinstance(law, DryFriction):
        D = d0 / (1.0 - d0) / weight
        return 1.0, -D * b * rate, D, -law.sliding, law.sliding
    depth = float(law.depth(q))
    if depth == 0.0:
        return None
    sign, part = -math.copysign(1.0, depth), min(abs(depth) / width, 1.0)
    part = (part**power / midpoint ** (power - 1.0) if part <= midpoint else
            1.0 - (1.0 - part) ** power / (1.0 - midpoint) ** (power - 1.0))
    d = d0 + part * (dmax - d0)
    aref = -b * sign * rate + d * abs(depth) / (dmax * T * z) ** 2
    D = d / (1.0 - d) / weight
    return sign, D * aref, D, 0.0, math.inf
