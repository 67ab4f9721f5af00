"""The motion of a model that no scene may have, from its accelerations alone."""

from __future__ import annotations

import numpy as np

from crosscheck.diagnosis import misreadings
from crosscheck.diagnosis.misreadings import Pose
from crosscheck.scene import mechanics
from crosscheck.scene.altered import Accelerations, Model, Points
from crosscheck.scene.coordinates import followed, hinge_angles, starting
from crosscheck.scene.states import States

PRECISE = 1e-11
"""rtol of `predict`. A window of one radian takes about ten steps, whose errors add up."""


class Flow:
    """Accelerations of a model at single states. It keeps the turns of hinges from one call to the next."""

    def __init__(self, model: Model) -> None:
        self.model, self.scene = model, model.scene
        self.last = starting(self.scene)
        self.last.hinges = hinge_angles(self.scene, self.last)
        self.index1 = mechanics.Index1(self.scene)

    def rates(self, x: np.ndarray, R: np.ndarray, v: np.ndarray, w: np.ndarray, t: float = 0.0) -> np.ndarray:
        """Accelerations (n, 6) of the state (n, ...) at time t (s): linear in world axes, angular in body axes."""
        now = States(self.last.t, x[None], R[None], v[None], w[None])
        if self.scene.hinges:
            now.hinges = followed(self.scene, now, self.last)
        angles, self.last = mechanics.torsion_angles(self.scene, now), now
        points = Points(x[None], R[None], v[None], w[None], np.zeros((1, self.scene.n, 6)), angles, np.array([t]))
        rates: np.ndarray = Accelerations(points, self.index1)(self.model)[0]
        return rates


def predict(model: Model, t: np.ndarray, start: Pose | None = None, step: float | None = None) -> States:
    """States of a model at increasing times t (s), by DOP853 to `PRECISE`, or at a fixed step (s).

    `start`: attitudes and angular velocities, from which positions follow; default: the state of its scene. Raises
    `ValueError` where the motion cannot be followed.
    """
    from scipy.integrate import solve_ivp

    scene, n, flow = model.scene, model.scene.n, Flow(model)
    R, w = start or (scene.R0, scene.w0)
    x, v = (misreadings.positions(scene, R, w) if start else None) or (scene.x0, scene.v0)

    def unpack(y: np.ndarray) -> list[np.ndarray]:
        x, R, v, w = np.split(y, [3 * n, 12 * n, 15 * n])
        return [x.reshape(n, 3), R.reshape(n, 3, 3), v.reshape(n, 3), w.reshape(n, 3)]

    def derivative(t: float, y: np.ndarray) -> np.ndarray:
        x, R, v, w = unpack(y)
        a = flow.rates(x, R, v, w, t)
        return np.concatenate([v.ravel(), np.cross(R, w[:, None, :]).ravel(), a[:, :3].ravel(), a[:, 3:].ravel()])

    begin = np.concatenate([x.ravel(), R.ravel(), v.ravel(), w.ravel()])
    # With tolerances that no error exceeds every step is the longest allowed.
    how: dict[str, float] = {"rtol": PRECISE, "atol": 1e-3 * PRECISE} if step is None else {
        "rtol": 1.0, "atol": 1e300, "max_step": step, "first_step": min(step, float(t[-1]))}
    solved = solve_ivp(derivative, (0.0, float(t[-1])), begin, "DOP853", t_eval=t, **how)
    if not solved.success:
        raise ValueError(solved.message)
    columns = zip(*(unpack(row) for row in solved.y.T), strict=True)
    return States(solved.t, *(np.array(column) for column in columns))
