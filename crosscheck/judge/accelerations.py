"""Reported accelerations and multipliers against the index-1 system at the run's own states.

Whatever the states are worth, accelerations and multipliers have to belong to them: a method takes them from somewhere
in the step, so that they may differ by what they change within one step.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from crosscheck.document import Finding, Scales
from crosscheck.judge import tolerances
from crosscheck.judge.defects import MOST_BODIES, NORMS, SHARE, UNKNOWN
from crosscheck.references.base import Reference
from crosscheck.scene import mechanics
from crosscheck.scene.constraints import Constraints
from crosscheck.scene.model import Scene

WITHIN = 16.0
"""Steps whose changes a reported acceleration may show: methods of index 3, and those that start an acceleration of
their own (generalised alpha), miss it by up to nine."""

UNITS = {"acceleration": "m/s^2", "angular acceleration": "rad/s^2", "reaction": "m/s^2",
         "reaction torque": "rad/s^2"}
"""Reactions are compared by the accelerations that they give each body, M^-1 G^T lam: rows may be redundant."""


def judge_accelerations(scene: Scene, traj: Any, truth: Reference, order: int | None, step: float | None,
                        rtol: float | None) -> list[Finding]:
    """Findings for what the engine reports of a, alpha and lam; none for what it does not report."""
    if scene.n > MOST_BODIES or not np.isfinite(traj.x).all() or (traj.a is None and traj.lam is None):
        return []
    with np.errstate(over="ignore", invalid="ignore"):
        try:
            a, alpha, lam = mechanics.index1(scene, traj.x, traj.R, traj.v, traj.w,
                                             mechanics.torsion_angles(scene, traj.R, traj.w, traj.t), traj.t)
        except np.linalg.LinAlgError:
            return [Finding("acceleration", "fail", np.inf, None, "m/s^2",
                            "the equations of motion have no solution at the run's own states")]
        found = {}
        if traj.a is not None:
            found["acceleration"] = np.linalg.norm(traj.a - a, axis=-1)
        if traj.alpha is not None:
            found["angular acceleration"] = np.linalg.norm(traj.alpha - alpha, axis=-1)
        if traj.lam is not None and lam.shape[1]:
            given = _by_reactions(scene, traj, traj.lam - lam)
            found |= {"reaction": given[0], "reaction torque": given[1]}
    bounds = _bounds(scene, traj, truth, order, step, rtol)
    findings = []
    for name, values in found.items():
        worst_of = np.where(np.isfinite(values), values, np.inf).max(axis=1)
        allowed = bounds[0 if UNITS[name] == "m/s^2" else 1]
        at = int(np.argmax(worst_of / allowed))
        findings.append(Finding(
            name, "ok" if worst_of[at] <= allowed[at] else "fail", float(worst_of[at]), float(allowed[at]), UNITS[name],
            "reported, against the index-1 system at the run's own state: what changes within one step, and what open "
            "constraints add", f"t = {traj.t[at]:.4g} s"))
    return findings


def _by_reactions(scene: Scene, traj: Any, lam: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Norms (T, n) of the accelerations and angular accelerations that multipliers give the bodies."""
    G = Constraints(scene).jacobian(traj.x, traj.R)
    rates = (np.einsum("tmk,tm->tk", G, lam) @ mechanics.inverse_mass(scene)).reshape(len(lam), scene.n, 6)
    return np.linalg.norm(rates[..., :3], axis=-1), np.linalg.norm(rates[..., 3:], axis=-1)


def _bounds(scene: Scene, traj: Any, truth: Reference, order: int | None, step: float | None, rtol: float | None
            ) -> tuple[np.ndarray, np.ndarray]:
    """Bounds (T,) of accelerations and of angular accelerations."""
    scale = tolerances.scales(scene, truth)
    later = np.where(traj.t > truth.horizon * (1 + 1e-12), UNKNOWN**3, 1.0)
    x, R = truth.position_derivatives, truth.attitude_derivatives / np.sqrt(2.0)
    # In joints, the jerk of one body is that of another over a lever.
    if order is not None and step is not None:
        power = min(order, 2)  # of higher order, accelerations are either those of the state or of second order
        turned = WITHIN * step**power * max(float(R[2 + power]), float(x[2 + power]) / scale.length)
        moved = WITHIN * step**power * max(float(x[2 + power]), scale.length * float(R[2 + power]))
    else:
        share = NORMS * traj.steps * (rtol or 0.0)
        turned = share * (float(R[2]) + scale.rate**2)
        moved = share * (float(x[2]) + scale.length * scale.rate**2)
    size = scale.length * scale.rate**2 + scale.speed**2 / scale.length
    floor = 16 * tolerances.grading(scene) * tolerances.EPS * size
    slack = _slack(traj, scale)
    return later * moved + slack + floor, later * turned + (slack + floor) / scale.length


def _slack(traj: Any, scale: Scales) -> np.ndarray:
    """m/s^2: what open constraints add, up to `SHARE` of the scene, see `crosscheck.judge.defects`."""
    x = np.minimum(traj.constraint_position, SHARE * scale.length)
    v = np.minimum(traj.constraint_velocity, SHARE * scale.length * scale.rate)
    return np.asarray(2 * scale.rate * (v + scale.rate * x))
