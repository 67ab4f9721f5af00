"""Jumps a motion cannot make: findings about a trajectory as such, whatever its accuracy.

Engines have been seen to reset a diverged state silently to the initial one and go on.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from crosscheck.document import Finding
from crosscheck.judge import tolerances
from crosscheck.judge.metrics import attitude_angle
from crosscheck.references.base import Reference
from crosscheck.scene import mechanics
from crosscheck.scene.model import Scene

SAME = 1e-9
"""Normalised distance from the initial state within which a state is that state: no engine comes back so exactly, and a
conversion of coordinates loses some 1e-15."""

ELSEWHERE = 1e-3
"""Normalised distance of truth from the initial state that is no return."""


CALM = 1e-6
"""What moves so much more slowly than the scene's fastest body does not jump, whatever it does between two samples."""


WOBBLE = 0.01
"""Share by which a run's own speed may exceed between two output times what it is at both: errors oscillate."""


def judge_continuity(scene: Scene, traj: Any, truth: Reference) -> list[Finding]:
    """Whether positions and attitudes move no faster than the run's own speeds allow, and the run was not reset; up to
    the horizon of the scene."""
    return [_continuity(scene, traj, truth), _reset(scene, traj, truth)]


def _continuity(scene: Scene, traj: Any, truth: Reference) -> Finding:
    """The step between output times farthest beyond, or nearest to, what speeds allow.

    In a time dt a body moves by no more than dt times its speed, which between two output times exceeds the larger one
    at the ends by dt / 2 times the largest acceleration at most: that of the true motion, times the excess of the
    run's kinetic energy, since accelerations grow as the square of speeds; and by the shares `WOBBLE` of itself and
    `CALM` of the fastest.
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
            (attitude_angle(R[:-1], R[1:]), np.linalg.norm(w, axis=-1), scale.rate,
             float(truth.attitude_derivatives[2] / np.sqrt(2.0)), "rad")):
        speed = (1 + WOBBLE) * np.maximum(speeds[1:], speeds[:-1]) + CALM * fastest
        allowed = dt * (speed + 0.5 * dt * second * excess) + 1e3 * tolerances.EPS
        ratio = moved / allowed
        sample, body = np.unravel_index(int(np.argmax(ratio)), ratio.shape)
        where = f"body {scene.bodies[body].name}, between t = {traj.t[sample]:.4g} and {traj.t[sample + 1]:.4g} s"
        candidates.append((ratio[sample, body], float(moved[sample, body]), float(allowed[sample, body]), unit, where))
    _, value, bound, unit, where = max(candidates)
    why = "dt (larger speed of the two output times + dt/2 x largest true acceleration x excess of kinetic energy)"
    return Finding("continuity", "ok" if value <= bound else "fail", value, bound, unit, why, where)


def _judged_times(truth: Reference) -> int:
    """Number of output times up to the horizon, two at least."""
    return max(2, int(np.count_nonzero(truth.t <= truth.horizon * (1 + 1e-12))))


def _reset(scene: Scene, traj: Any, truth: Reference) -> Finding:
    """How many output times show the initial state where truth is elsewhere."""
    scale = tolerances.scales(scene, truth)

    def distance(states: Any) -> np.ndarray:
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
