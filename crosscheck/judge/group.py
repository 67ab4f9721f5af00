"""Judge whether attitudes stay rotation matrices."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from crosscheck.document import Finding
from crosscheck.judge import tolerances


def judge_orthogonality(trajectories: Sequence[Any], on_group: bool, eps: float, order: int | None) -> Finding:
    """Judge max |R^T R - I| of the first run against rounding.

    If an engine integrates matrices or quaternions and does not make rotations of them, they drift off the group. Such
    a drift passes if it falls with the step by the order of the method, which another run shows. A wrong factor in
    the attitudes does not fall.
    """
    traj, *others = trajectories
    tol = tolerances.orthogonality(on_group, traj.steps, eps)
    drift = max(float(traj.orthogonality.max()), traj.maxima.get("orthogonality", 0.0))
    other = float(others[0].orthogonality.max()) if others else 0.0
    if tol.value < drift < math.inf and other > 0.0 and not on_group and order is not None:
        observed = math.log(other / drift) / math.log(others[0].stats["step"] / traj.stats["step"])
        if observed >= order - tolerances.CONSTANTS["order_margin_coarse"]:
            return Finding("orthogonality", "ok", drift, None, "1", "attitudes that nothing keeps on SO(3), and whose "
                           f"drift falls with the step, by order {observed:.2g}", "every step")
    return Finding("orthogonality", "ok" if drift <= tol.value else "fail", drift, tol.value, "1", tol.why,
                   "every step")
