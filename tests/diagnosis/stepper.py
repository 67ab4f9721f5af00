"""A small engine of our own that can be built wrongly on purpose: fourth-order Runge-Kutta-Munthe-Kaas on the index-1
equations in maximal coordinates, with accelerations from the references, which `explain` does not use for fitting."""

from __future__ import annotations

import dataclasses
import time

import numpy as np

from crosscheck.adapters.base import RawRun, steps_per_sample
from crosscheck.errors import EngineError
from crosscheck.references.maximal import Maximal, gyroscopic
from crosscheck.references.world import Motion, turned
from crosscheck.scene import mechanics
from crosscheck.scene.constraints import Constraints
from crosscheck.scene.coordinates import followed, hinge_angles, starting
from crosscheck.scene.mechanics import torsion_angles
from crosscheck.scene.states import States

A, B = ((), (0.5,), (0.0, 0.5), (0.0, 0.0, 1.0)), (1 / 6, 1 / 3, 1 / 3, 1 / 6)


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


def cross(p, q):
    """p x q over the last axis."""
    return np.cross(p, q)


def exponential(theta):
    """exp(hat(theta)), (n, 3) -> (n, 3, 3)."""
    from scipy.spatial.transform import Rotation

    return Rotation.from_rotvec(theta).as_matrix()


def inverse_tangent(theta, w):
    """dexp^-1 up to the order that fourth-order methods need."""
    once = cross(theta, w)
    return w + 0.5 * once + cross(theta, once) / 12.0


class Equations(Maximal):
    """The accelerations, with flaws."""

    def __init__(self, scene, flaws):
        self.flaws, self.angles, self.last = flaws, None, starting(scene)
        self.last.hinges = hinge_angles(scene, self.last)
        super().__init__(scene)

    def _constraint_terms(self, motion):
        u = np.concatenate([motion.v, motion.w], axis=1).ravel()
        alpha, beta = self.flaws.gain
        jacobians, targets = [], []
        for kind in self.constraints:
            gap, G, drift = kind.terms(motion)
            jacobians.append(G[:, :-1])
            targets.append(self.flaws.centripetal * drift + 2 * alpha * (G.reshape(len(G), -1) @ u) + beta**2 * gap)
        return np.concatenate(jacobians), np.concatenate(targets)

    def _applied(self, motion, angles):
        force, torque = (part.copy() for part in super()._applied(motion, angles))
        flaws, R = self.flaws, motion.R
        spin = turned(self.scene.inertias, motion.w[:-1])
        v = motion.v[:-1] - np.array(flaws.wind)
        if not flaws.moments:
            for spring in self.springs:
                own, turning = np.zeros((2, self.scene.n + 1, 3))
                spring.add(motion, own, turning)
                torque -= turning[:-1]
        slowing = flaws.drag + flaws.linear_drag + flaws.quadratic * np.linalg.norm(v, axis=1, keepdims=True)
        force -= slowing * self.scene.masses[:, None] * v
        torque -= (flaws.drag + flaws.spin_drag) * spin
        torque += (1 - np.asarray(flaws.gyroscopic).reshape(-1, 1)) * np.cross(motion.w[:-1], spin)
        for joint in self.scene.joints if flaws.joint_damping or flaws.coulomb else ():
            relative = motion.omega[joint.child] - motion.omega[joint.parent]
            relative = (flaws.joint_damping + flaws.coulomb / np.linalg.norm(relative)) * relative
            torque[joint.child] -= relative @ R[joint.child]
            if joint.parent >= 0:
                torque[joint.parent] += relative @ R[joint.parent]
        return force, torque

    def accelerations(self, motion, angles):
        if self.flaws.softness is None:
            return super().accelerations(motion, angles)
        stiffness, damping = self.flaws.softness
        force, torque = (part.copy() for part in self._applied(motion, angles))
        torque -= gyroscopic(self.scene.inertias, motion.w[:-1])
        u = np.concatenate([motion.v, motion.w], axis=1).ravel()
        for kind in self.constraints:
            gap, G, _ = kind.terms(motion)
            pull = stiffness * gap + damping * (G.reshape(len(G), -1) @ u)
            push = np.einsum("mnk,m->nk", G[:, :-1], pull)
            force -= push[:, :3]
            torque -= push[:, 3:]
        return force / self.scene.masses[:, None], turned(self.inverse_inertia, torque)


class Stepper:
    """The engine; method RK4 of documented order 4."""

    name, methods, forms, adaptive_methods, options = "stepper", ("RK4",), ("maximal",), (), frozenset({"form"})

    def __init__(self, flaws=None, held=frozenset({"acceleration"})):
        self.flaws, self.held = flaws or Flaws(), held

    def version(self):
        """Version."""
        return "1"

    def documented_order(self, scene, spec):
        """What it claims."""
        return 4

    def held_levels(self, scene, spec):
        """Index 1: the accelerations satisfy the constraints."""
        return self.held

    def unsupported(self, scene, spec):
        """Everything the references can do."""
        return "a fixed step is needed" if spec.step is None else None

    def run(self, scene, spec):
        """Fixed steps; dense and slow."""
        equations = Equations(scene, self.flaws)
        per, h = steps_per_sample(scene, spec.step)
        state = [scene.x0.copy(), scene.R0.copy(), scene.v0.copy(), scene.w0.copy()]
        rows = [(*state[:4], *_rates(equations, state))]
        begin = time.perf_counter()
        for _ in range(scene.samples - 1):
            for _ in range(per * self.flaws.substeps):
                state = _spoilt(scene, _step(equations, state, h / self.flaws.substeps, self.flaws), self.flaws)
            if not all(np.isfinite(part).all() for part in state):
                raise EngineError("the state is not finite")
            rows.append((*state[:4], *_rates(equations, state)))
        x, R, v, w, a, alpha = (np.array(column) for column in zip(*rows, strict=True))
        steps = per * (scene.samples - 1)
        return RawRun(States(scene.t, x, R, v, w, a, alpha), time.perf_counter() - begin, steps, h, form="maximal")


def _spoilt(scene, state, flaws):
    """What is done to the state after a step."""
    if flaws.projected:
        state = projected(scene, state, flaws.projected == "both")
    if flaws.stuck:
        state = [*state[:3], np.clip(state[3], -flaws.stuck, flaws.stuck)]
    return [part.astype(np.float32).astype(float) for part in state] if flaws.single else state


def projected(scene, state, speeds):
    """Positions, and velocities too, moved back onto the constraints in the metric of the mass matrix."""
    constraints, (x, R, v, w) = Constraints(scene), state
    weights = mechanics.inverse_mass(scene)
    for _ in range(3):
        G = constraints.jacobian(x[None], R[None])[0]
        gap = constraints.position(x[None], R[None])[0]
        move = -(weights @ G.T @ np.linalg.solve(G @ weights @ G.T, gap)).reshape(-1, 6)
        x, R = x + move[:, :3], R @ exponential(move[:, 3:])
    if speeds:
        G = constraints.jacobian(x[None], R[None])[0]
        u = np.concatenate([v, w], axis=1)
        u = u - (weights @ G.T @ np.linalg.solve(G @ weights @ G.T, G @ u.ravel())).reshape(-1, 6)
        v, w = u[:, :3], u[:, 3:]
    return [x, R, v, w]


def _rates(equations, state):
    """a world, alpha body axes."""
    x, R, v, w = state
    zero = np.zeros((1, 3))
    motion = Motion(np.concatenate([x, zero]), np.concatenate([R, np.eye(3)[None]]), np.concatenate([v, zero]),
                    np.concatenate([w, zero]), np.zeros(0))
    angles = np.zeros(0)
    if equations.torsions:
        now = States(np.zeros(1), x[None], R[None], v[None], w[None])
        now.hinges = followed(equations.scene, now, equations.last)
        equations.last, found = now, torsion_angles(equations.scene, now)
        equations.angles = {joint: float(value[0]) for joint, value in found.items()}
        wrap = (lambda angle: (angle + np.pi) % (2 * np.pi) - np.pi) if equations.flaws.wrapped else float
        angles = np.array([wrap(equations.angles[force.joint]) for force in equations.scene.forces
                           if force.type == "torsional_spring"])
    return equations.accelerations(motion, angles)


def _step(equations, state, h, flaws):
    x, R, v, w = state
    if flaws.euler:
        a, alpha = _rates(equations, state)
        v, w = v + h * a, w + h * alpha
        return [x + h * v, R @ exponential(h * w), v, w]
    slopes = []
    for row in A:
        change = [h * sum((c * slope[part] for c, slope in zip(row, slopes, strict=True)), 0.0 * start)
                  for part, start in enumerate((x, w, v, w))]
        spin = w + change[3]
        stage = [x + change[0], R @ exponential(change[1]), v + change[2], spin]
        a, alpha = _rates(equations, stage)
        theta = spin if flaws.naive else inverse_tangent(change[1], spin)
        slopes.append((stage[2], theta, a, alpha))
    x, theta, v, w = (start + h * sum(c * slope[part] for c, slope in zip(B, slopes, strict=True))
                      for part, start in enumerate((x, 0.0 * w, v, w)))
    return [x, R @ exponential(theta), v, w]
