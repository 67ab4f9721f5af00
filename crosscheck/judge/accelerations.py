"""Reported accelerations and multipliers against the index-1 system at the run's own states.

Whatever the states are worth, accelerations and multipliers have to belong to them: a method takes them from somewhere
in the step, so that they may differ by what they change within one step.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from crosscheck.document import Finding
from crosscheck.judge import tolerances
from crosscheck.judge.defects import RATES, SHARE, Defects
from crosscheck.judge.vanishing import extrapolation, shares
from crosscheck.scene import mechanics
from crosscheck.scene.constraints import Constraints
from crosscheck.scene.model import Scene

WITHIN = 16.0
"""Steps whose changes a reported acceleration may show: methods of index 3, and those that start an acceleration of
their own (generalised alpha), miss it by up to nine."""

SETTLED = 200
"""Steps after which what an acceleration of its own brought from the start has gone: 0.9 a step is 1e-9 by then."""

UNITS = {"acceleration": "m/s^2", "angular acceleration": "rad/s^2", "reaction": "m/s^2",
         "reaction torque": "rad/s^2"}
"""Reactions are compared by the accelerations that they give each body, M^-1 G^T lam: rows may be redundant."""


def judge_accelerations(scene: Scene, trajectories: Sequence[Any], runs: Sequence[Defects]) -> list[Finding]:
    """Findings for what the engine reports of a, alpha and lam; none for what it does not report.

    The first of the runs is judged; the others are at other steps, and an error that does not vanish with them is that
    of another model.
    """
    traj, claim = trajectories[0], runs[0].claim
    if traj.a is None and traj.lam is None:
        return []
    pairs = sorted(zip(runs, trajectories, strict=True), key=lambda pair: pair[0].claim.step or 0.0)
    try:
        with np.errstate(over="ignore", invalid="ignore"):
            gaps = {id(run): _gaps(scene, each, run.flow.index + 1) for run, each in pairs}
    except np.linalg.LinAlgError:
        return [Finding("acceleration", "fail", np.inf, None, "m/s^2",
                        "the equations of motion have no solution at the run's own states")]
    power = min(claim.order or 1, 2)  # of higher order, accelerations are either those of the state or of second order
    ordered = [run for run, _ in pairs]
    options = [("", {name: np.linalg.norm(gap, axis=-1) for name, gap in gaps[id(runs[0])].items()},
                _bound(scene, runs[0], power))]
    if len(ordered) > 1:
        weights, left = extrapolation(ordered, power)
        bound = _bound(scene, ordered[0], power, len(ordered) - 1, left)
        for run, weight, share in zip(ordered, weights, shares(ordered, power), strict=True):
            # Forces of soft constraints follow their opening over h^2, and no power of h.
            soft = np.minimum(run.opening["position"], run.allowed[0]["position"])[run.flow.index + 1]
            bound[run.flow.end.t < SETTLED * (run.claim.step or 0.0)] = np.inf
            bound = bound + abs(weight) * (share * _bound(scene, run, power) + soft / (run.claim.step or 1.0) ** 2)
        options.append(("extrapolated to vanishing steps, ",
                        {name: np.linalg.norm(sum(weight * gaps[id(run)][name] for run, weight in
                                                  zip(ordered, weights, strict=True)), axis=-1)
                         for name in set.intersection(*map(set, gaps.values()))}, bound))
    findings = []
    for name, unit in UNITS.items():
        found = []
        for word, values, bound in options:
            if name in values:
                allowed = bound if unit == "m/s^2" else bound / runs[0].scale.length
                sizes = np.where(np.isfinite(values[name]), values[name], np.inf).max(axis=1)
                at = int(np.argmax(sizes / allowed))
                found.append((float(sizes[at]), float(allowed[at]),
                              f"{word}t = {traj.t[runs[0].flow.index[at] + 1]:.4g} s"))
        if found:
            value, most, where = max(found, key=lambda each: each[0] / each[1])
            findings.append(Finding(
                name, "ok" if value <= most else "fail", value, most, unit, "reported, against the index-1 system at "
                "the run's own state: what changes within one step, and what open constraints add", where))
    return findings


def _gaps(scene: Scene, traj: Any, at: np.ndarray) -> dict[str, np.ndarray]:
    """(I, n, 3) by what is reported: its difference from the index-1 system at the output times `at`."""
    angles = {name: values[at] for name, values in mechanics.torsion_angles(scene, traj.R, traj.w, traj.t).items()}
    a, alpha, lam = mechanics.index1(scene, traj.x[at], traj.R[at], traj.v[at], traj.w[at], angles, traj.t[at])
    found = {}
    if traj.a is not None:
        found["acceleration"] = traj.a[at] - a
    if traj.alpha is not None:
        found["angular acceleration"] = traj.alpha[at] - alpha
    if traj.lam is not None and lam.shape[1]:
        G = Constraints(scene).jacobian(traj.x[at], traj.R[at])
        given = np.einsum("tmk,tm->tk", G, traj.lam[at] - lam) @ mechanics.inverse_mass(scene)
        rates = given.reshape(len(lam), scene.n, 6)
        found |= {"reaction": rates[..., :3], "reaction torque": rates[..., 3:]}
    return found


def _bound(scene: Scene, run: Defects, power: int, more: int = 0, times: float = 1.0) -> np.ndarray:
    """Bound (I,) of accelerations (m/s^2) and, over the length, of angular ones, at the ends of the intervals.

    What changes in `WITHIN` steps: its leading term, or, `times`, the one `more` orders up.
    """
    scale, found = run.scale, run.flow
    if run.claim.step and run.claim.fixed:
        degree = power + more
        steps = WITHIN if not more else WITHIN**degree / math.factorial(degree)
        # The largest of the run: accelerations of their own remember where they came from.
        changed = times * steps * run.claim.step**degree * scale.length * float(found.jerks[degree].max())
    else:
        share = RATES * run.claim.steps * len(found.tau) * (run.claim.rtol or 0.0)
        changed = share * scale.length * (found.jerks[0] + scale.rate**2)
    size = scale.length * scale.rate**2 + scale.speed**2 / scale.length
    floor = 16 * tolerances.grading(scene) * run.claim.eps * size
    x, v = (np.minimum(np.minimum(run.opening[level], run.allowed[0][level]), most)[found.index + 1] for level, most in
            (("position", SHARE * scale.length), ("velocity", SHARE * scale.length * scale.rate)))
    return np.asarray(changed + 2 * scale.rate * (v + scale.rate * x) + floor)
