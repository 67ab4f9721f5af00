"""A law of friction and limits that an engine documents, integrated without the engine on a tree of hinges and slides.

A row is a friction or a limit on one coordinate. Its force along its direction is f = clip(p - D a, low, high), a the
acceleration in that direction, which the forces of all rows cause: D > 0 is what an engine has whose constraints are
soft, 0 is a force of the state alone.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable

import numpy as np

from crosscheck.adapters.common import tree
from crosscheck.adapters.common.held import Held
from crosscheck.errors import Unsupported
from crosscheck.scene import mechanics
from crosscheck.scene.coordinates import at_start
from crosscheck.scene.laws import DryFriction, Limits
from crosscheck.scene.model import Scene
from crosscheck.scene.states import States

Row = tuple[float, float, float, float, float]
"""Sign of the direction along the coordinate, p, D, least and greatest force."""

Law = Callable[[DryFriction | Limits, float, float, float], Row | None]
"""(friction or limits, inverse inertia of the coordinate in the initial position, coordinate, rate) -> row, None for a
limit that is not exceeded."""

TOLERANCE = 1e-13
"""Relative tolerance of DOP853, with a tenth of it absolutely; the error is measured with one ten times as large."""

SWEEPS = 400
"""Most sweeps over the rows; rows of one joint need one, and coupled ones converge linearly."""


class OwnLaw:
    """The motion of a tree of hinges and slides under such a law; `name` is that of the engine."""

    def __init__(self, scene: Scene, law: Law, name: str) -> None:
        self.scene, self._law = scene, law
        if not tree.is_open_tree(scene) or any(
                (joint.kind.motion and not joint.kind.has_one) or joint.drive or joint.mimic
                for joint in scene.joints):
            raise Unsupported(f"the own law of {name} is integrated here for open trees of hinges and slides alone")
        self._tree_links, self._bare = tree.links(scene), scene.lawless
        moving = [link for link in self._tree_links if link.dofs]
        start = at_start(scene)
        self._names = [link.joint for link in moving]
        self._sign, self._zero = np.array([tree.coordinate(scene, link)[1:] for link in moving]).T
        self._rows = [(k, law) for k, name in enumerate(self._names)
                      for law in (*scene.joint(name).dry_friction, *scene.joint(name).limits) if law is not None]
        self._mass = mechanics.mass_matrix(scene)
        self._rotors = np.array([sum(scene.joint(name).armature) for name in self._names])
        self._start = np.concatenate([[float(start[name][part][0]) for name in self._names] for part in (0, 1)])
        q, v = np.split(self._start, 2)
        self._weights = np.diag(np.linalg.inv(self._equations(0.0, q, v, {})[0]))

    def states(self, tolerance: float = TOLERANCE) -> States:
        """The states at the scene's output times."""
        q, v = np.split(self.coordinates(tolerance), 2, axis=1)
        moved = self.motion(q, v, np.zeros_like(v))
        return States(self.scene.t, moved.x, moved.R, moved.v, moved.w)

    def coordinates(self, tolerance: float = TOLERANCE) -> np.ndarray:
        """The coordinates and their rates, (T, 2 n), in the order of the joints from the ground outwards."""
        from scipy.integrate import solve_ivp

        scene, y = self.scene, self._start
        periods = [servo.period for _, servo in scene.servos.values() if servo.period is not None]
        h = min(periods, default=scene.duration)
        held = Held(scene, h)
        if any(abs(period / h - round(period / h)) > 1e-9 for period in periods):
            raise Unsupported("the shortest period of the servos does not divide the others")
        samples = np.arange(round(scene.duration / h) + 1) * h if periods else np.array([])
        stops = np.unique([0.0, *scene.breaks, *samples[(samples > 0) & (samples < scene.duration)], scene.duration])
        rows = [y[None]]
        for begin, end in itertools.pairwise(stops):
            if periods:
                state = dict(zip(self._names, zip(*np.split(y, 2), strict=True), strict=True))
                held.update(round(begin / h), state.__getitem__)
            inside = scene.t[(scene.t > begin * (1 + 1e-12)) & (scene.t <= end * (1 + 1e-12))]
            times = np.union1d(np.minimum(inside, end), [end])
            solved = solve_ivp(self._rates, (begin, end), y, method="DOP853", rtol=tolerance, atol=0.1 * tolerance,
                               t_eval=times, args=(dict(held.efforts),))
            rows.append(solved.y.T[:len(inside)])
            y = solved.y[:, -1]
        return np.concatenate(rows)

    def _rates(self, t: float, y: np.ndarray, efforts: dict[int, float]) -> np.ndarray:
        q, v = np.split(y, 2)
        return np.concatenate([v, self.accelerations(t, q, v, efforts)])

    def accelerations(self, t: float, q: np.ndarray, v: np.ndarray, efforts: dict[int, float]) -> np.ndarray:
        """The accelerations of the coordinates; `efforts` of sampled servos by their indices among the forces."""
        M, f = self._equations(t, q, v, efforts)
        inverse = np.linalg.inv(M)
        a0: np.ndarray = inverse @ f
        active = [(k, *row) for k, law in self._rows
                  if (row := self._law(law, self._weights[k], q[k], v[k])) is not None]
        if not active:
            return a0
        at, signs, p, D, low, high = (np.array(column) for column in zip(*active, strict=True))
        W = signs[:, None] * inverse[np.ix_(at, at)] * signs
        free, push = signs * a0[at], np.zeros(len(at))
        for _ in range(SWEEPS):
            before = push.copy()
            for k in range(len(at)):
                base = free[k] + W[k] @ push - W[k, k] * push[k]
                push[k] = np.clip((p[k] - D[k] * base) / (1.0 + D[k] * W[k, k]), low[k], high[k])
            if np.abs(push - before).max() <= 1e-16 * np.abs(push).max():
                break
        return np.asarray(a0 + inverse[:, at] @ (signs * push))

    def motion(self, q: np.ndarray, v: np.ndarray, a: np.ndarray) -> States:
        """States and accelerations of the bodies at coordinates, rates and accelerations of the scene, (T, n) each."""
        q, v, a = self._sign * (q - self._zero), self._sign * v, self._sign * a
        slots = np.cumsum([0, *(link.dofs for link in self._tree_links)])
        return tree.forward(self._tree_links, [
            tree.motion(link, *(part[:, first:last] for part in (q, v, a)))
            for link, first, last in zip(self._tree_links, slots[:-1], slots[1:], strict=True)], np.zeros(len(q)), True)

    def _equations(self, t: float, q: np.ndarray, v: np.ndarray, efforts: dict[int, float]
                   ) -> tuple[np.ndarray, np.ndarray]:
        """M (n, n) and f (n,) of M q'' = f without friction and limits."""
        n = len(q)
        still = np.zeros((1, n))
        # the first row at these rates and without accelerations, the others at rest with one acceleration each
        rows = self.motion(np.tile(q, (n + 1, 1)), np.vstack([v, np.zeros((n, n))]), np.vstack([still, np.eye(n)]))
        drift, *columns = np.concatenate([np.asarray(rows.a), np.asarray(rows.alpha)], axis=2).reshape(n + 1, -1)
        J = np.transpose(columns)
        x, R, speed, spin = (part[:1] for part in (rows.x, rows.R, rows.v, rows.w))
        angles = {joint.name: np.array([q[k] + joint.zero_angle]) for k, joint in enumerate(
            map(self.scene.joint, self._names)) if joint.kind.has_angle}
        f = J.T @ (mechanics.applied_forces(self._bare, x, R, speed, spin, angles, t)[0] - self._mass @ drift)
        for index, (name, servo) in self.scene.servos.items():
            k = self._names.index(name)
            f[k] += efforts.get(index, 0.0) if servo.period is not None else servo.effort(t, q[k], v[k])
        return J.T @ self._mass @ J + np.diag(self._rotors), f
