"""Whether attitudes stay rotations."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from crosscheck.document import Finding
from crosscheck.judge import tolerances


def judge_orthogonality(trajectories: Sequence[Any], on_group: bool, eps: float, order: int | None) -> Finding:
    """max |R^T R - I| of the first of the runs against rounding, or, off the group, against its method's order.

    Attitudes that an engine integrates as matrices or quaternions without making rotations of them are as wrong as its
    steps are long. Such a drift falls with the step, as one other run shows; a factor that was forgotten does not.
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
