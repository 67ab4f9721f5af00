"""Second formulation of the truth: maximal coordinates, DOP853 (SciPy).

Newton-Euler equations of every body in world axes, M du = f - G^T lam with u = (v, omega), omega the WORLD angular
velocity and M = diag(m, R J R^T); lam from the constraints at acceleration level (index 1), damped towards their
position and velocity levels after Baumgarte, which moves nothing on the constraint manifold. Attitudes are
quaternions. Each kind of constraint is a record in KINDS: its rows, their Jacobian and the acceleration they show at
du = 0. The ground is one more body at the end of every array, with no columns in the Jacobian.
"""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Callable

import numpy as np
from scipy.integrate import DOP853

from crosscheck.errors import Unsupported
from crosscheck.references.base import TruthError
from crosscheck.scene import Joint, Scene
from crosscheck.states import States

SOURCE = "DOP853 (SciPy), maximal coordinates"
RTOL = 3e-15  # a thousand steps of this stay near 1e-12; looser runs cost 15 % less and are off by several times more
ATOL = 1e-15  # components that pass through zero are O(1) elsewhere
DAMPING = 5.0  # 1/s; Baumgarte, far slower than a step, far faster than the growth of drift from round-off

# Constant tensors keep the count of NumPy calls low, which is what a right-hand side of a few bodies costs.
_EPSILON = np.zeros((3, 3, 3))
for _i, _j, _k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
    _EPSILON[_i, _k, _j], _EPSILON[_i, _j, _k] = 1.0, -1.0
_FORM = np.zeros((4, 4, 3, 3))  # R = q q : _FORM = (w^2 - p.p) I + 2 p p^T + 2 w p^ for a unit q = (w, p)
_FORM[0, 0] = np.eye(3)
for _i in range(3):
    _FORM[_i + 1, _i + 1] = -np.eye(3)
    _FORM[0, _i + 1] += 2.0 * _EPSILON[_i]
    for _j in range(3):
        _FORM[_i + 1, _j + 1, _i, _j] += 2.0
HAT, QUADRATIC = _EPSILON.reshape(3, 9), _FORM.reshape(16, 9)  # a @ HAT is the matrix of a x (.)


def cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """a x b of arrays (k, 3); several times faster than numpy.cross for a few vectors."""
    return np.matmul((a @ HAT).reshape(-1, 3, 3), b[:, :, None])[:, :, 0]


def rotation(q: np.ndarray) -> np.ndarray:
    """Attitudes (n, 3, 3) of quaternions (n, 4) of any length but zero."""
    products = (q[:, :, None] * q[:, None, :]).reshape(-1, 16)
    return ((products @ QUADRATIC) / products[:, ::5].sum(axis=1)[:, None]).reshape(-1, 3, 3)


def gyroscopic(inertia: np.ndarray, omega: np.ndarray) -> np.ndarray:
    """omega x (I omega), world axes; inertia (n, 3, 3) world."""
    return cross(omega, np.matmul(inertia, omega[:, :, None])[:, :, 0])


def weight(masses: np.ndarray, gravity: np.ndarray) -> np.ndarray:
    """Weights (n, 3)."""
    return masses[:, None] * gravity


def centripetal(omega: np.ndarray, lever: np.ndarray) -> np.ndarray:
    """omega x (omega x lever), world axes."""
    return cross(omega, cross(omega, lever))


@dataclasses.dataclass(frozen=True)
class Motion:
    """World state with the ground appended: x, v, omega (n + 1, 3), R (n + 1, 3, 3)."""

    x: np.ndarray
    R: np.ndarray
    v: np.ndarray
    omega: np.ndarray


class Coincidence:
    """Points fixed in two bodies that coincide: d = x_j + R_j s_j - x_i - R_i s_i = 0, three rows a joint."""

    def __init__(self, joints: list[Joint], n: int) -> None:
        k = len(joints)
        self.i = np.array([joint.parent for joint in joints])  # the ground, -1, is the last entry
        self.j = np.array([joint.child for joint in joints])
        self.both = np.concatenate([self.i, self.j])
        self.s = np.array([joint.parent_anchor for joint in joints] + [joint.child_anchor for joint in joints])
        self.rows = 3 * k
        self.template = np.zeros((3 * k, n + 1, 6))
        # -d(R s) along omega is s x (.), so an entry of lever s sits at (row, column) with a sign, twice
        self.row, self.column = np.array([[1, 0, 2, 1, 0, 2], [0, 1, 1, 2, 2, 0]])
        self.entry, self.sign = np.array([2, 2, 0, 0, 1, 1]), np.array([1.0, -1.0, 1.0, -1.0, 1.0, -1.0])
        joint_rows = 3 * np.arange(k)[:, None]
        for body, direction in ((self.i, -1.0), (self.j, 1.0)):
            self.template[joint_rows + np.arange(3), body[:, None], np.arange(3)] = direction
        self.at_i = joint_rows + self.row, self.i[:, None], 3 + self.column
        self.at_j = joint_rows + self.row, self.j[:, None], 3 + self.column

    def levers(self, motion: Motion) -> np.ndarray:
        """R_i s_i of all joints, then R_j s_j, (2 k, 3)."""
        return np.matmul(motion.R[self.both], self.s[:, :, None])[:, :, 0]

    def position(self, motion: Motion, levers: np.ndarray) -> np.ndarray:
        """Gaps d, (3 k)."""
        return self._difference(motion.x[self.both] + levers)

    def jacobian(self, levers: np.ndarray) -> np.ndarray:
        """(3 k, n + 1, 6): columns v and omega of each body."""
        G = self.template.copy()
        entries = self.sign * levers[:, self.entry]
        G[self.at_i] = entries[:len(self.i)]
        G[self.at_j] = -entries[len(self.i):]
        return G

    def drift(self, motion: Motion, levers: np.ndarray) -> np.ndarray:
        """Second derivative of d at zero accelerations, (3 k)."""
        return self._difference(centripetal(motion.omega[self.both], levers))

    def _difference(self, points: np.ndarray) -> np.ndarray:
        return (points[len(self.i):] - points[:len(self.i)]).ravel()


KINDS: dict[str, Callable] = {"spherical": Coincidence}


class Maximal:
    """The equations of a scene; `run` integrates them.

    Raises
    ------
    Unsupported
        A joint type that is not in KINDS, or a force other than gravity.
    """

    def __init__(self, scene: Scene) -> None:
        if scene.forces:
            raise Unsupported(f"truth for {scene.name!r}: force {scene.forces[0].type!r} is not in these equations")
        for joint in scene.joints:
            if joint.type not in KINDS:
                raise Unsupported(f"truth for {scene.name!r}: joint {joint.name!r} is {joint.type}, not in these "
                                  "equations")
        self.scene = scene
        self.constraints = [kind([joint for joint in scene.joints if joint.type == name], scene.n)
                            for name, kind in KINDS.items() if any(joint.type == name for joint in scene.joints)]
        self.inverse_inertia = np.linalg.inv(scene.inertias)
        self.force = weight(scene.masses, scene.gravity)

    def motion(self, y: np.ndarray) -> Motion:
        """Unpack x (n, 3), q (n, 4), v (n, 3), omega (n, 3)."""
        n = self.scene.n
        x, v, omega = (np.zeros((n + 1, 3)) for _ in range(3))
        R = np.empty((n + 1, 3, 3))
        x[:n], v[:n], omega[:n] = y[:3 * n].reshape(n, 3), y[7 * n:10 * n].reshape(n, 3), y[10 * n:].reshape(n, 3)
        q = y[3 * n:7 * n].reshape(n, 4)
        R[:n] = rotation(q)
        R[n] = np.eye(3)
        return Motion(x, R, v, omega)

    def accelerations(self, motion: Motion) -> tuple[np.ndarray, np.ndarray]:
        """Accelerations of the centres of mass and angular accelerations, (n, 3) each, world."""
        n, R = self.scene.n, motion.R[:-1]
        turned = R.transpose(0, 2, 1)
        torque = -gyroscopic(R @ self.scene.inertias @ turned, motion.omega[:-1])
        inverse = R @ self.inverse_inertia @ turned
        free = np.empty((n, 6))
        free[:, :3] = self.force / self.scene.masses[:, None]
        free[:, 3:] = np.matmul(inverse, torque[:, :, None])[:, :, 0]
        if not self.constraints:
            return free[:, :3], free[:, 3:]
        G, target = self._constraint_terms(motion)
        W = np.empty_like(G)  # G M^-1; the two blocks of M are scaled apart
        W[:, :, :3] = G[:, :, :3] / self.scene.masses[:, None]
        W[:, :, 3:] = np.matmul(G[:, :, 3:].transpose(1, 0, 2), inverse).transpose(1, 0, 2)
        flat, W = G.reshape(len(G), -1), W.reshape(len(G), -1)
        lam = np.linalg.solve(W @ flat.T, flat @ free.ravel() + target)
        free -= (W.T @ lam).reshape(n, 6)
        return free[:, :3], free[:, 3:]

    def _constraint_terms(self, motion: Motion) -> tuple[np.ndarray, np.ndarray]:
        """Jacobian (m, n, 6) and drift plus Baumgarte terms (m)."""
        u = np.concatenate([motion.v, motion.omega], axis=1).ravel()
        jacobians, targets = [], []
        for kind in self.constraints:
            levers = kind.levers(motion)
            G = kind.jacobian(levers)
            jacobians.append(G[:, :-1])
            targets.append(kind.drift(motion, levers) + 2.0 * DAMPING * (G.reshape(len(G), -1) @ u)
                           + DAMPING**2 * kind.position(motion, levers))
        return np.concatenate(jacobians), np.concatenate(targets)

    def rates(self, t: float, y: np.ndarray) -> np.ndarray:
        """dy/dt; t is not used, the scene is autonomous."""
        n = self.scene.n
        motion = self.motion(y)
        a, alpha = self.accelerations(motion)
        q, omega = y[3 * n:7 * n].reshape(n, 4), motion.omega[:-1]
        rate = np.empty((n, 4))  # dq/dt = (0, omega) q / 2 for the world angular velocity
        rate[:, 0] = -0.5 * np.sum(omega * q[:, 1:], axis=1)
        rate[:, 1:] = 0.5 * (omega * q[:, :1] + cross(omega, q[:, 1:]))
        return np.concatenate([y[7 * n:10 * n], rate.ravel(), a.ravel(), alpha.ravel()])

    def initial(self) -> np.ndarray:
        """State vector of the scene's start."""
        bodies, scene = self.scene.bodies, self.scene
        q = np.array([body.attitude / np.linalg.norm(body.attitude) for body in bodies])
        omega = np.matmul(scene.R0, scene.w0[:, :, None])[:, :, 0]
        return np.concatenate([scene.x0.ravel(), q.ravel(), scene.v0.ravel(), omega.ravel()])

    def run(self, times: np.ndarray | None = None) -> States:
        """States at `times`, by default the scene's output times, from the scene's start.

        Steps end on them, since dense output is less accurate than a step.
        """
        y, rows = self.initial(), []
        step: float | None = None
        times = self.scene.t if times is None else times
        for start, end in itertools.pairwise(times):
            rows.append(self._row(y))
            first = None if step is None else min(step, end - start)
            solver = DOP853(self.rates, start, y, end, first_step=first, rtol=1e-13, atol=ATOL)
            solver.rtol = RTOL  # the constructor refuses less than 100 roundings, the error estimate resolves it
            proposals = []
            while solver.status == "running":
                message = solver.step()
                if solver.status == "failed":
                    raise TruthError(f"{SOURCE}: {self.scene.name!r} at t = {solver.t:.6g} s: {message}")
                proposals.append(solver.h_abs)
            y, step = solver.y, max(proposals)  # the last proposal follows a step that the interval's end cut short
        rows.append(self._row(y))
        return States(times, *(np.array(column) for column in zip(*rows, strict=True)))

    def _row(self, y: np.ndarray) -> tuple[np.ndarray, ...]:
        """x, R, v, w, a, alpha at one instant, in the common convention."""
        motion = self.motion(y)
        a, alpha = self.accelerations(motion)
        R = motion.R[:-1]
        w, alpha = (np.matmul(R.transpose(0, 2, 1), vector[:, :, None])[:, :, 0]
                    for vector in (motion.omega[:-1], alpha))
        return motion.x[:-1], R, motion.v[:-1], w, a, alpha
