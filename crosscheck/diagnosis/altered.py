"""Plain steppers and a precise integration of a model with altered parameters. They need its accelerations only."""

from __future__ import annotations

import numpy as np

from crosscheck.diagnosis import misreadings
from crosscheck.diagnosis.stepping import munthe_kaas, semi_implicit
from crosscheck.scene import mechanics
from crosscheck.scene.altered import Accelerations, Model, Points
from crosscheck.scene.batch import State
from crosscheck.scene.coordinates import followed, hinge_angles, starting
from crosscheck.scene.model import GROUND, Scene
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

    def flow(self, t: np.ndarray, x: np.ndarray, R: np.ndarray, v: np.ndarray, w: np.ndarray) -> State:
        """Rates of x, R, v, w at one state (1, n, ...) at a time (1,), as the steps of `stepping` take them."""
        a = self.rates(x[0], R[0], v[0], w[0], float(t[0]))[None]
        return [v, R, a[..., :3], a[..., 3:]]


def predict(model: Model, R: np.ndarray, w: np.ndarray) -> States:
    """States at the output times of a model, by DOP853, from these attitudes and angular velocities at the start."""
    from scipy.integrate import solve_ivp

    scene, n, flow = model.scene, model.scene.n, Flow(model)
    x, v = misreadings.positions(scene, R, w) or (scene.x0, scene.v0)

    def unpack(y: np.ndarray) -> list[np.ndarray]:
        parts = np.split(y, [3 * n, 12 * n, 15 * n])
        return [parts[0].reshape(n, 3), parts[1].reshape(n, 3, 3), parts[2].reshape(n, 3), parts[3].reshape(n, 3)]

    def derivative(t: float, y: np.ndarray) -> np.ndarray:
        x, R, v, w = unpack(y)
        a = flow.rates(x, R, v, w, t)
        return np.concatenate([v.ravel(), np.cross(R, w[:, None, :]).ravel(), a[:, :3].ravel(), a[:, 3:].ravel()])

    start = np.concatenate([x.ravel(), R.ravel(), v.ravel(), w.ravel()])
    solved = solve_ivp(derivative, (0.0, scene.duration), start, "DOP853", t_eval=scene.t, rtol=PRECISE,
                       atol=1e-3 * PRECISE)
    columns = zip(*(unpack(row) for row in solved.y.T), strict=True)
    return States(solved.t, *(np.array(column) for column in columns))


class Joints:
    """Joint coordinates of a tree of ball joints and hinges: relative attitudes and relative angular velocities."""

    def __init__(self, flow: Flow) -> None:
        self.flow, self.scene = flow, flow.scene
        scene = flow.scene
        self.order = misreadings.parents_first(scene)
        self.by_child = {joint.child: joint for joint in scene.joints}

    @staticmethod
    def fit(scene: Scene) -> bool:
        """Whether the scene is such a tree."""
        children = [joint.child for joint in scene.joints]
        return (sorted(children) == list(range(scene.n))
                and all(joint.type in ("spherical", "revolute") for joint in scene.joints))

    def start(self, R: np.ndarray, w: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(relative attitudes (n, 3, 3), relative angular velocities (n, 3) in the child's axes) of a state."""
        Q, s = np.empty_like(R), np.empty_like(w)
        for body in self.order:
            parent = self.by_child[body].parent
            Q[body] = R[body] if parent == GROUND else R[parent].T @ R[body]
            s[body] = w[body] if parent == GROUND else w[body] - Q[body].T @ w[parent]
        return Q, s

    def state(self, Q: np.ndarray, s: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """x, R, v, w that follow from joint coordinates."""
        R, w = np.empty_like(Q), np.empty_like(s)
        for body in self.order:
            parent = self.by_child[body].parent
            R[body] = Q[body] if parent == GROUND else R[parent] @ Q[body]
            w[body] = s[body] if parent == GROUND else s[body] + Q[body].T @ w[parent]
        x, v = misreadings.positions(self.scene, R, w) or (self.scene.x0, self.scene.v0)
        return x, R, v, w

    def rates(self, Q: np.ndarray, s: np.ndarray) -> np.ndarray:
        """Derivative of s, (n, 3)."""
        x, R, v, w = self.state(Q, s)
        alpha = self.flow.rates(x, R, v, w)[:, 3:]
        turned = alpha.copy()
        for body in self.order:
            parent = self.by_child[body].parent
            if parent != GROUND:
                carried = Q[body].T @ w[parent]
                turned[body] += np.cross(s[body], carried) - Q[body].T @ alpha[parent]
        return turned


def stepped(model: Model, R: np.ndarray, w: np.ndarray, order: int, steps: int, of_joints: bool) -> States:
    """The end of a motion by plain steps of order 1 (semi-implicit) or 4, in coordinates of bodies or of joints."""
    scene, flow = model.scene, Flow(model)
    joints = Joints(flow)

    def of_coordinates(_: np.ndarray, x: np.ndarray, R: np.ndarray, v: np.ndarray, w: np.ndarray) -> State:
        return [v, R, v, joints.rates(R[0], w[0])[None]]

    x, v = misreadings.positions(scene, R, w) or (scene.x0, scene.v0)
    first = (0.0 * x, *joints.start(R, w)) if of_joints else (x, R, w)
    state: State = [first[0][None], first[1][None], 0.0 * v[None] if of_joints else v[None], first[2][None]]
    h = np.array([scene.duration / steps])
    step = semi_implicit if order == 1 else munthe_kaas
    for k in range(steps):
        state = step(of_coordinates if of_joints else flow.flow, k * h, state, h)
    x, R, v, w = joints.state(state[1][0], state[3][0]) if of_joints else (part[0] for part in state)
    return States(scene.t[-1:], x[None], R[None], v[None], w[None])
