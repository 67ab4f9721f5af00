"""Dense index-1 equations of one state in NumPy, of our own, and what can be wrong in them.

They share the table of joints with the judge, and the forces of loads; nothing with lieeuler and the references.
"""

from __future__ import annotations

import dataclasses

import numpy as np
from scipy.spatial.transform import Rotation

from crosscheck.errors import EngineError
from crosscheck.scene import mechanics
from crosscheck.scene.basics import BodyVector, basics
from crosscheck.scene.coordinates import followed, hinge_angles, starting
from crosscheck.scene.spanning import spanning_tree
from crosscheck.scene.states import States


@dataclasses.dataclass(frozen=True)
class Flaws:
    """What the stepper does wrongly; the default is nothing."""

    joint_damping: float = 0.0
    drag: float = 0.0
    spin_drag: float = 0.0  # 1/s, of angular velocities alone
    linear_drag: float = 0.0  # 1/s, of the centres of mass alone
    quadratic: float = 0.0  # 1/m
    wind: tuple = (0.0, 0.0, 0.0)  # m/s, of the air that slows
    coulomb: float = 0.0  # N m
    gyroscopic: object = 1.0  # one factor, or one a body
    centripetal: float = 1.0
    moments: bool = True  # of springs about the centres of mass
    softness: tuple | None = None  # stiffness, damping of joints that are springs
    gain: tuple = (0.0, 0.0)  # Baumgarte's alpha, beta
    naive: bool = False  # velocities of the stages summed, attitudes moved once
    substeps: int = 1
    euler: bool = False  # a first-order step under the name of a fourth-order one
    single: bool = False  # the state is kept in single precision
    projected: str = ""  # "positions": these are moved back onto the constraints, velocities are not; "both": they too
    wrapped: bool = False  # angles of torsional springs are taken between -pi and pi
    stuck: float = 0.0  # rad/s, components of angular velocities are clamped to this size; 0: not


RIGHT = Flaws()


def exponential(theta):
    """exp(hat(theta)), (n, 3) -> (n, 3, 3)."""
    return Rotation.from_rotvec(theta).as_matrix()


class Equations:
    """Accelerations and multipliers of a scene at one state (x, R, v, w), with flaws.

    Every row is L . D: L turns with the parent or stands still; D is a vector of the child, or goes from a point of the
    parent to one of the child. Of a rod, L is D over its length.
    """

    def __init__(self, scene, flaws=RIGHT):
        self.scene, self.flaws, self.n = scene, flaws, scene.n
        if any(joint.drive or joint.mimic or joint.kind.slips or any(joint.armature) for joint in scene.joints):
            raise EngineError("drives, mimics, rotors and contacts are not known here")
        self.inverse = mechanics.inverse_mass(scene)
        self.masses, self.J = np.asarray(scene.masses)[:, None], np.asarray(scene.inertias)
        self.spread = self.J - np.sort(np.diagonal(self.J, axis1=1, axis2=2))[:, 1, None, None] * np.eye(3)
        self.push = np.concatenate([self.masses * scene.gravity, np.zeros((self.n, 3))], axis=1)
        self.factors = np.asarray(flaws.gyroscopic, float).reshape(-1, 1)
        rows, self.rods = self.listed()
        self.m = len(rows)
        if rows:
            left, L, child, s, parent, q, reach = (np.array(each) for each in zip(*rows, strict=True))
            self.bodies, fixed = np.concatenate([child, parent, left]), np.concatenate([s, q, L])
            self.child, self.parent, self.reach = child, parent, reach[:, None, None]
            self.at = np.arange(self.m)[:, None], np.stack([child, parent], axis=1)
            self.hats = np.cross(np.eye(3), fixed[:, None])  # fixed x as matrices
            self.lean = self.hats.copy()
            self.lean[2 * self.m:][left < 0] = 0.0  # what stands still does not lean
            self.vectors = np.stack([fixed, fixed, fixed], axis=1)
        self.R, self.w = np.concatenate([scene.R0, np.eye(3)[None]]), np.zeros((self.n + 1, 3))
        self.xv = np.zeros((self.n + 1, 2, 3))
        self.closing = bool(spanning_tree(scene)[1])
        self.torsions = any(force.type == "torsional_spring" for force in scene.loads)
        if self.torsions:
            self.last = starting(scene)
            self.last.hinges = hinge_angles(scene, self.last)

    def listed(self):
        """Body and vector L, child and its point or vector, parent and its point, and whether these points count, of
        every row; and (row, length) of rods."""
        rows, rods, none = [], [], np.zeros(3)
        attitudes = np.concatenate([self.scene.R0, np.eye(3)[None]])
        for joint in self.scene.joints:
            for basic in basics(joint, attitudes[joint.parent], attitudes[joint.child]):
                left, right = basic.left, basic.right
                if isinstance(right, BodyVector):
                    rows.append((left.body, left.s, right.body, right.s, left.body, none, 0.0))
                    continue
                if left is not None and not isinstance(left, BodyVector):
                    rods.append((len(rows), joint.length))
                fixed = [(left.body, left.s)] if isinstance(left, BodyVector) else [
                    (-1, axis) for axis in (np.eye(3) if left is None else [none])]
                rows += [(*each, right.child.body, right.child.s, right.parent.body, right.parent.s, 1.0)
                         for each in fixed]
        return rows, rods

    def rows(self, x, R, v, w):
        """The rows at a state: their values, their rates, the Jacobian (m, 6n), and gamma of G du/dt + gamma = 0."""
        m, n, vectors = self.m, self.n, self.vectors
        self.R[:n], self.w[:n], self.xv[:n, 0], self.xv[:n, 1] = R, w, x, v
        R, w, s = self.R[self.bodies], self.w[self.bodies], vectors[:, 0]
        vectors[:, 1] = -(self.hats @ w[:, :, None])[:, :, 0]
        vectors[:, 2] = w * (w * s).sum(1, keepdims=True) - s * (w * w).sum(1, keepdims=True)
        there = vectors @ R.swapaxes(1, 2)  # with their rates and what is quadratic in w of their second ones
        L, D = there[2 * m:], there[:m] - there[m:2 * m]
        D[:, :2] += self.reach * (self.xv[self.child] - self.xv[self.parent])
        for k, length in self.rods:
            L[k, 0], L[k, 1] = D[k, 0] / length, D[k, 1] / (2 * length)
        products = L @ D.swapaxes(1, 2)
        value, speed = products[:, 0, 0], products[:, 0, 1] + products[:, 1, 0]
        gamma = products[:, 2, 0] + 2 * products[:, 1, 1] + products[:, 0, 2]
        L, D = L[:, 0], D[:, 0]
        angular = (self.lean @ (np.concatenate([L, -L, D])[:, None] @ R).swapaxes(1, 2))[:, :, 0]
        blocks, G = np.empty((m, 2, 6)), np.zeros((m, n + 1, 6))
        blocks[:, 0, :3] = self.reach[:, 0] * L
        blocks[:, 1, :3] = -blocks[:, 0, :3]
        blocks[:, 0, 3:] = angular[:m]
        blocks[:, 1, 3:] = angular[m:2 * m] + angular[2 * m:]
        G[self.at] = blocks
        for k, length in self.rods:
            value[k], speed[k] = (value[k] - length) / 2, products[k, 0, 1]
        return value, speed, G[:, :n].reshape(m, -1), gamma

    def forces(self, t, x, R, v, w):
        """Forces in the world and torques in body axes, (n, 6), without gyroscopic ones."""
        flaws, push = self.flaws, self.push.copy()
        if self.scene.loads:
            now = States(np.array([t]), x[None], R[None], v[None], w[None])
            angles = self.angles(now) if self.torsions else {}
            for load in self.scene.loads:
                more = mechanics.force_on_bodies(self.scene, load, now, angles)[0]
                push += more if flaws.moments or load.type != "linear_spring" else more * [1, 1, 1, 0, 0, 0]
        if flaws is not RIGHT:
            air = v - np.array(flaws.wind)
            slowing = flaws.drag + flaws.linear_drag + flaws.quadratic * np.linalg.norm(air, axis=1, keepdims=True)
            push[:, :3] -= slowing * self.masses * air
            push[:, 3:] -= (flaws.drag + flaws.spin_drag) * (self.J @ w[:, :, None])[:, :, 0]
            for joint in self.scene.joints if flaws.joint_damping or flaws.coulomb else ():
                child, inner = joint.child, joint.parent
                relative = R[child] @ w[child] - (R[inner] @ w[inner] if inner >= 0 else 0.0)
                relative = (flaws.joint_damping + flaws.coulomb / np.linalg.norm(relative)) * relative
                push[child, 3:] -= relative @ R[child]
                if inner >= 0:
                    push[inner, 3:] += relative @ R[inner]
        return push

    def angles(self, now):
        """Angles of torsional springs, with the turns since the last call."""
        now.hinges = followed(self.scene, now, self.last)
        self.last, found = now, mechanics.torsion_angles(self.scene, now)
        return {joint: (angle + np.pi) % (2 * np.pi) - np.pi if self.flaws.wrapped else angle
                for joint, angle in found.items()}

    def __call__(self, t, x, R, v, w):
        """a (n, 3) in the world, alpha (n, 3) in body axes, lam (m,)."""
        flaws, push, lam = self.flaws, self.forces(t, x, R, v, w), np.zeros(self.m)
        spin = (self.spread @ w[:, :, None])[:, :, 0]
        push[:, 3:] -= self.factors * (w[:, [1, 2, 0]] * spin[:, [2, 0, 1]] - w[:, [2, 0, 1]] * spin[:, [1, 2, 0]])
        push = push.ravel()
        if self.m:
            value, speed, G, gamma = self.rows(x, R, v, w)
            if flaws.softness is not None:
                push -= (flaws.softness[0] * value + flaws.softness[1] * speed) @ G
            else:
                GW, (alpha, beta) = G @ self.inverse, flaws.gain
                rest, A = GW @ push + flaws.centripetal * gamma, GW @ G.T
                if alpha or beta:
                    rest += 2 * alpha * speed + beta**2 * value
                lam = np.linalg.lstsq(A, rest, rcond=1e-10)[0] if self.closing else np.linalg.solve(A, rest)
                push -= lam @ G
        rates = (self.inverse @ push).reshape(-1, 6)
        return rates[:, :3], rates[:, 3:], lam

    def closed(self, x, R, v, w, speeds=True):
        """Positions, and velocities too, moved back onto the constraints in the metric of the mass matrix."""
        if not self.m:
            return [x, R, v, w]

        def closing(which):
            found = self.rows(x, R, v, w)
            G = found[2]
            return (-self.inverse @ G.T @ np.linalg.lstsq(G @ self.inverse @ G.T, found[which], rcond=1e-12)[0]
                    ).reshape(-1, 6)
        for _ in range(3):
            move = closing(0)
            x, R = x + move[:, :3], R @ exponential(move[:, 3:])
        push = closing(1) if speeds else np.zeros((self.n, 6))
        return [x, R, v + push[:, :3], w + push[:, 3:]]
