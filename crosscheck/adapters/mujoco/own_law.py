"""MuJoCo's documented laws of dry friction and limits, integrated without MuJoCo.

Friction and limits are soft constraints there (Computation, "Constraint model", in its documentation). The acceleration
a minimises 1/2 (a - a0)^T M (a - a0) plus one cost a row, which makes the force of a row

    f = clip(D (aref - a_row), -c, c)    for friction c, with aref = -b v,
    f = max(D (aref - a_row), 0)         for a limit that is exceeded by r > 0, with aref = -b v + k d r,

D = d / ((1 - d) w), w the inverse inertia of the coordinate in the initial position, b = 2 / (dmax T), k = 1 / (dmax T
z)^2. `solref` is T and z; `solimp` is d at the surface, dmax, and the depth, midpoint and power of the way between.
"""

from __future__ import annotations

import dataclasses
import itertools
import math

import numpy as np

from crosscheck.adapters.common.held import Held
from crosscheck.errors import Unsupported
from crosscheck.scene import mechanics
from crosscheck.scene.coordinates import at_start, relative_pose
from crosscheck.scene.laws import DryFriction, Limits
from crosscheck.scene.model import GROUND, Joint, Scene
from crosscheck.scene.spanning import spanning_tree
from crosscheck.scene.states import States
from crosscheck.scene.vectors import cross

SOLREF, SOLIMP = (0.02, 1.0), (0.9, 0.95, 0.001, 0.5, 2.0)
"""MuJoCo's defaults."""

TOLERANCE = 1e-13
"""Relative tolerance of DOP853, with a tenth of it absolutely; the error is measured with one ten times as large."""

SWEEPS = 400
"""Most sweeps over the rows; rows of one joint need one, and coupled ones converge linearly."""


@dataclasses.dataclass(frozen=True)
class _Row:
    """A friction or a limit on coordinate `joint`."""

    joint: int
    law: DryFriction | Limits


class OwnLaw:
    """The motion of a tree of hinges and slides under MuJoCo's laws."""

    def __init__(self, scene: Scene, solref: tuple[float, float] = SOLREF,
                 solimp: tuple[float, float, float, float, float] = SOLIMP) -> None:
        self.scene, self.solref, self.solimp = scene, solref, solimp
        self._order = _outward(scene)
        self._bare = scene.lawless
        self._rows = [_Row(k, law) for k, joint in enumerate(self._order)
                      for law in (*joint.dry_friction, *joint.limits) if law is not None]
        self._mass = np.linalg.inv(mechanics.inverse_mass(scene))
        self._rotors = np.array([joint.armature[0] if joint.armature else 0.0 for joint in self._order])
        start = at_start(scene)
        self._start = np.concatenate([[float(start[joint.name][part][0]) for joint in self._order] for part in (0, 1)])
        q, v = np.split(self._start, 2)
        M, _ = self._equations(0.0, q, v, {})
        self._weights = np.diag(np.linalg.inv(M))

    def states(self, tolerance: float = TOLERANCE) -> States:
        """The states at the scene's output times."""
        y = self.coordinates(tolerance)
        motions = [self._motion(*np.split(row, 2)) for row in y]
        x, R, v, w = (np.array([motion[part] for motion in motions]) for part in range(4))
        return States(self.scene.t, x, R, v, w)

    def coordinates(self, tolerance: float = TOLERANCE) -> np.ndarray:
        """The coordinates and their rates, (T, 2 n), in the order of the joints from the ground outwards."""
        from scipy.integrate import solve_ivp

        scene, y, found = self.scene, self._start, []
        periods = [servo.period for _, servo in scene.servos.values() if servo.period is not None]
        h = min(periods, default=scene.duration)
        held, names = Held(scene, h), [joint.name for joint in self._order]
        if any(abs(period / h - round(period / h)) > 1e-9 for period in periods):
            raise Unsupported("the shortest period of the servos does not divide the others")
        samples = np.arange(round(scene.duration / h) + 1) * h if periods else np.array([])
        stops = np.unique([0.0, *scene.breaks, *samples[(samples > 0) & (samples < scene.duration)], scene.duration])
        found.append(y[None])
        for begin, end in itertools.pairwise(stops):
            if periods:
                state = dict(zip(names, zip(*np.split(y, 2), strict=True), strict=True))
                held.update(round(begin / h), state.__getitem__)
            inside = scene.t[(scene.t > begin * (1 + 1e-12)) & (scene.t <= end * (1 + 1e-12))]
            times = np.union1d(np.minimum(inside, end), [end])
            solved = solve_ivp(self._rates, (begin, end), y, method="DOP853", rtol=tolerance, atol=0.1 * tolerance,
                               t_eval=times, args=(dict(held.efforts),))
            found.append(solved.y.T[:len(inside)])
            y = solved.y[:, -1]
        return np.concatenate(found)

    def _rates(self, t: float, y: np.ndarray, efforts: dict[int, float]) -> np.ndarray:
        q, v = np.split(y, 2)
        return np.concatenate([v, self.accelerations(t, q, v, efforts)])

    def accelerations(self, t: float, q: np.ndarray, v: np.ndarray, efforts: dict[int, float]) -> np.ndarray:
        """The accelerations of the coordinates; `efforts` of sampled servos by their indices among the forces."""
        M, f = self._equations(t, q, v, efforts)
        inverse = np.linalg.inv(M)
        a0: np.ndarray = inverse @ f
        active = [each for row in self._rows if (each := self._active(row, q, v)) is not None]
        if not active:
            return a0
        at = [row[0] for row in active]
        signs, aref, D, low, high = (np.array([row[part] for row in active]) for part in range(1, 6))
        W = signs[:, None] * inverse[np.ix_(at, at)] * signs
        free, push = signs * a0[at], np.zeros(len(at))
        for _ in range(SWEEPS):
            before = push.copy()
            for k in range(len(at)):
                base = free[k] + W[k] @ push - W[k, k] * push[k]
                push[k] = np.clip(D[k] * (aref[k] - base) / (1.0 + D[k] * W[k, k]), low[k], high[k])
            if np.abs(push - before).max() <= 1e-16 * np.abs(push).max():
                break
        for k, joint in enumerate(at):
            a0 = a0 + inverse[:, joint] * signs[k] * push[k]
        return a0

    def _active(self, row: _Row, q: np.ndarray, v: np.ndarray) -> tuple[int, float, float, float, float, float] | None:
        """(coordinate, sign, aref, D, least and greatest force) of a row, None for a limit that is not exceeded."""
        (T, z), (d0, dmax, width, midpoint, power) = self.solref, self.solimp
        b, weight = 2.0 / (dmax * T), self._weights[row.joint]
        if isinstance(row.law, DryFriction):
            size = row.law.sliding
            return row.joint, 1.0, -b * v[row.joint], d0 / (1.0 - d0) / weight, -size, size
        depth = float(row.law.depth(q[row.joint]))
        if depth == 0.0:
            return None
        sign, part = -math.copysign(1.0, depth), min(abs(depth) / width, 1.0)
        part = (part**power / midpoint ** (power - 1.0) if part <= midpoint else
                1.0 - (1.0 - part) ** power / (1.0 - midpoint) ** (power - 1.0))
        d = d0 + part * (dmax - d0)
        aref = -b * sign * v[row.joint] + d * abs(depth) / (dmax * T * z) ** 2
        return row.joint, sign, aref, d / (1.0 - d) / weight, 0.0, np.inf

    def _motion(self, q: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, ...]:
        """x, R, v, w (body axes), and accelerations at q'' = 0 and derivatives by q', both (6n, ...), of the bodies."""
        scene, count = self.scene, len(q)
        x, R = np.zeros((scene.n, 3)), np.zeros((scene.n, 3, 3))
        J, drift = np.zeros((scene.n, 2, 3, count)), np.zeros((scene.n, 2, 3))  # angular parts in world axes
        for k, joint in enumerate(self._order):
            p, c = joint.parent, joint.child
            xp, Rp, Jp, bias = ((np.zeros(3), np.eye(3), np.zeros((2, 3, count)), np.zeros((2, 3))) if p == GROUND else
                                (x[p], R[p], J[p], drift[p]))
            turn, shift = relative_pose(joint, q[k:k + 1])
            R[c] = Rp @ turn
            axis, lever = Rp @ joint.parent_axis, Rp @ (joint.parent_anchor + shift)
            arm = -R[c] @ joint.child_anchor
            x[c] = xp + lever + arm
            whole, spin = lever + arm, Jp[1] @ v
            J[c, 1] = Jp[1]
            J[c, 0] = Jp[0] + cross(Jp[1].T, whole).T
            inner = np.zeros(3)
            if joint.type == "revolute":
                J[c, 1, :, k] += axis
                J[c, 0, :, k] += cross(axis, arm)
                inner = axis * v[k]
                drift[c, 1] = bias[1] + cross(spin, inner)
            else:
                J[c, 0, :, k] += axis
                drift[c, 1] = bias[1]
            outer = spin + inner
            drift[c, 0] = (bias[0] + cross(bias[1], lever) + cross(spin, cross(spin, lever))
                           + cross(drift[c, 1], arm) + cross(outer, cross(outer, arm)))
            if joint.type == "prismatic":
                drift[c, 0] += 2.0 * cross(spin, axis * v[k])
        J[:, 1], drift[:, 1] = np.swapaxes(R, 1, 2) @ J[:, 1], np.einsum("nji,nj->ni", R, drift[:, 1])
        return x, R, J[:, 0] @ v, J[:, 1] @ v, drift.reshape(-1), J.reshape(-1, count)

    def _equations(self, t: float, q: np.ndarray, v: np.ndarray, efforts: dict[int, float]
                   ) -> tuple[np.ndarray, np.ndarray]:
        """M (n, n) and f (n,) of M q'' = f without friction and limits."""
        x, R, speed, spin, drift, J = self._motion(q, v)
        names = [joint.name for joint in self._order]
        angles = {joint.name: mechanics.torsion_angles(self._bare, R[None])[joint.name] for joint in self._order
                  if any(force.type == "torsional_spring" and force.joint == joint.name for force in self._bare.forces)}
        applied = mechanics.applied_forces(self._bare, x[None], R[None], speed[None], spin[None], angles, t)[0]
        f = J.T @ (applied - self._mass @ drift)
        for index, (name, servo) in self.scene.servos.items():
            k = names.index(name)
            f[k] += efforts.get(index, 0.0) if servo.period is not None else servo.effort(t, q[k], v[k])
        return J.T @ self._mass @ J + np.diag(self._rotors), f


def _outward(scene: Scene) -> list[Joint]:
    """The joints from the ground outwards; raises `Unsupported` unless the scene is a tree of hinges and slides."""
    branches, closing = spanning_tree(scene)
    joints = [branch.joint for branch in branches]
    for joint in (*joints, *closing):
        if (joint is None or joint in closing or joint.type not in ("revolute", "prismatic") or joint.drive
                or joint.mimic):
            what = "a free body" if joint is None else f"joint {joint.name!r}"
            raise Unsupported(f"MuJoCo's own law is integrated here for trees of hinges and slides: {what} is none")
    if any(not branch.outward for branch in branches):
        raise Unsupported("MuJoCo's own law is integrated here where parents lead to the ground")
    return joints  # type: ignore[return-value]
