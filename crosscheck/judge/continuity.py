"""What no motion does: jumps, and attitudes that are no rotations. These findings do not depend on accuracy.

Some engines silently reset a diverged state to the initial one and go on.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from crosscheck.compare.apart import turn
from crosscheck.document import Finding
from crosscheck.judge import tolerances
from crosscheck.judge.claim import Trace
from crosscheck.judge.metrics import up_to
from crosscheck.references.base import Reference
from crosscheck.scene import mechanics
from crosscheck.scene.model import Scene

SAME = 1e-9
"""A state within this normalised distance from the initial state counts as the same. A motion does not return so
exactly, and a conversion of coordinates changes about 1e-15."""

ELSEWHERE = 1e-3
"""The true motion is not at its initial state if its normalised distance from it is larger than this."""

CALM = 1e-6
"""Speeds below this share of the scene's largest speed do not count as jumps."""

WOBBLE = 0.01
"""Between two output times, oscillating errors may raise the speed by this share above the speeds at both times."""


def judge_continuity(scene: Scene, traj: Trace, truth: Reference, eps: float = tolerances.EPS) -> list[Finding]:
    """Judge, up to the horizon, whether poses move no faster than the run's own speeds, and whether it was reset."""
    return [_continuity(scene, traj, truth, eps), _reset(scene, traj, truth)]


def _continuity(scene: Scene, traj: Trace, truth: Reference, eps: float) -> Finding:
    """The pair of neighbouring output times whose motion exceeds what speeds allow the most, or comes closest to it.

    In a time dt a body moves by at most dt times its largest speed. Between two output times this speed exceeds the
    larger one at the ends by at most dt / 2 times the largest acceleration, plus the shares `WOBBLE` of itself and
    `CALM` of the fastest. The acceleration is the largest of the true motion, times the excess of the run's kinetic
    energy, because accelerations grow with the square of speeds.
    """
    count = _judged_times(truth)
    x, R, v, w = (getattr(traj, name)[:count] for name in "xRvw")
    dt = np.diff(traj.t[:count])[:, None]
    kinetic = mechanics.kinetic_energy(scene, traj)[:count]
    scale = tolerances.scales(scene, truth)
    largest = scale.kinetic
    excess = np.maximum(1.0, np.maximum(kinetic[1:], kinetic[:-1]) / largest)[:, None]
    candidates = []
    for moved, speeds, fastest, second, unit in (
            (np.linalg.norm(np.diff(x, axis=0), axis=-1), np.linalg.norm(v, axis=-1), scale.speed,
             float(truth.position_derivatives[2]), "m"),
            (np.linalg.norm(turn(R[:-1], R[1:]), axis=-1), np.linalg.norm(w, axis=-1), scale.rate,
             float(truth.attitude_derivatives[2] / np.sqrt(2.0)), "rad")):
        speed = (1 + WOBBLE) * np.maximum(speeds[1:], speeds[:-1]) + CALM * fastest
        allowed = dt * (speed + 0.5 * dt * second * excess) + 1e3 * eps
        ratio = moved / allowed
        sample, body = np.unravel_index(int(np.argmax(ratio)), ratio.shape)
        where = f"body {scene.bodies[body].name}, between t = {traj.t[sample]:.4g} and {traj.t[sample + 1]:.4g} s"
        candidates.append((ratio[sample, body], float(moved[sample, body]), float(allowed[sample, body]), unit, where))
    _, value, bound, unit, where = max(candidates)
    why = "dt (larger speed of the two output times + dt/2 x largest true acceleration x excess of kinetic energy)"
    return Finding("continuity", "ok" if value <= bound else "fail", value, bound, unit, why, where)


def _judged_times(truth: Reference) -> int:
    """Number of output times up to the horizon, at least two."""
    return max(2, int(np.count_nonzero(up_to(truth.t, truth.horizon))))


def _reset(scene: Scene, traj: Trace, truth: Reference) -> Finding:
    """Count the output times at which the run is at its initial state but truth is not."""
    scale = tolerances.scales(scene, truth)

    def distance(states: Trace) -> np.ndarray:
        parts = [np.abs(states.x - states.x[0]).max(axis=(1, 2)) / scale.length,
                 np.abs(states.R - states.R[0]).max(axis=(1, 2, 3)),
                 np.abs(states.v - states.v[0]).max(axis=(1, 2)) / (scale.length * scale.rate),
                 np.abs(states.w - states.w[0]).max(axis=(1, 2)) / scale.rate]
        return np.asarray(np.max(parts, axis=0))

    count = _judged_times(truth)
    back = ((distance(traj) <= SAME) & (distance(truth.states) > ELSEWHERE))[:count]
    detail = f"first at t = {traj.t[int(np.argmax(back))]:.4g} s" if back.any() else ""
    return Finding("reset", "fail" if back.any() else "ok", float(np.count_nonzero(back)), 0.0, "1",
                   "output times at which the run is back in its initial state and truth is not", detail)


def judge_orthogonality(trajectories: Sequence[Trace], on_group: bool, eps: float, order: int | None,
                        starts: Sequence[int] = (0,)) -> Finding:
    """Judge max |R^T R - I| of the first run against rounding.

    If an engine integrates matrices or quaternions and does not make rotations of them, they drift off the group. Such
    a drift passes if it falls with the step by the order of the method, which another run shows that begins with
    rotations at the samples `starts`. A wrong factor in the attitudes does not fall in the first part, nor does it add
    up. In later parts the run goes on from attitudes off the group, whose R^T R turns with the body.
    """
    traj, *others = trajectories
    tol = tolerances.orthogonality(on_group, traj.steps, eps)
    drift = max(float(traj.orthogonality.max()), traj.maxima.get("orthogonality", 0.0))
    if tol.value < drift < math.inf and others and not on_group and order is not None:
        own, other = _drifts(traj.R, starts, True), _drifts(others[0].R, starts, False)
        fine, coarse = (each.stats.get("step") for each in (traj, others[0]))
        ratio = coarse / fine if fine and coarse else 1.0
        if ratio != 1.0 and own.sum() > drift / 2 and other.min() > 0.0:
            first = other[0] / own[0] if own[0] > tol.value else math.inf
            observed = math.log(min(float(first), float(other.sum()) / drift)) / math.log(ratio)
            if observed >= order - tolerances.CONSTANTS["order_margin_coarse"]:
                return Finding("orthogonality", "ok", drift, None, "1", "attitudes that nothing keeps on SO(3), and "
                               f"whose drift falls with the step, by order {observed:.2g}", "every step")
    return Finding("orthogonality", "ok" if drift <= tol.value else "fail", drift, tol.value, "1", tol.why,
                   "every step")


def _drifts(R: np.ndarray, starts: Sequence[int], running: bool) -> np.ndarray:
    """The largest change of R^T R in each part of a run; `running`: parts go on from the attitudes before."""
    gram, ends = np.swapaxes(R, -1, -2) @ R, [*starts[1:], len(R) - 1]
    return np.array([np.abs(gram[a + 1:b + 1] - (gram[a] if running else np.eye(3))).max()
                     for a, b in zip(starts, ends, strict=True)])
