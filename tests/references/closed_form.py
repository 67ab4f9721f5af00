"""Oracle of truth: exact motion of a Lagrange top and of a free body by Jacobi elliptic functions and integrals.

The top. A body turns about a fixed point (spherical joint to the ground), with the inertia of a body of revolution
about the axis e from the joint to its centre of mass. With u = e . z (z up), A the inertia across the axis at the
joint, C the one about it, w3 the spin (constant), Lz the angular momentum about z (constant), du/dt^2 is a cubic in u
with roots u1 <= u <= u2 <= u3, hence

    u = u1 + (u2 - u1) sn^2(nu (t - t0), k),   nu^2 = m g l (u3 - u1) / (2 A),   k^2 = (u2 - u1) / (u3 - u1),

and the precession and spin angles are elliptic integrals of the third kind in the amplitude of sn (E. T. Whittaker, A
Treatise on the Analytical Dynamics of Particles and Rigid Bodies, sections 71-73).

All is evaluated in multiprecision: the Bruels-Cardona top comes within 7e-7 rad of the vertical. At a turning point the
phase of sn has only half the digits, and near a pole of Euler angles precession and spin are large numbers of opposite
sign. With DIGITS digits, sixteen are correct there too.

The free body. With moments I1, I2, I3 in ascending or descending order, such that the body circulates about its third
axis (L^2 > 2 E I2 if ascending, < if descending), the angular velocities along them are

    w1 = a1 cn tau,  w2 = a2 sn tau,  w3 = a3 dn tau,  tau = nu t + tau0

(L. D. Landau, E. M. Lifshitz, Mechanics, section 37). The angular momentum L is constant in the world. Euler angles
about it follow: theta and psi from the components of L along the body's axes, and phi from

    dphi/dt = L (I1 w1^2 + I2 w2^2) / (I1^2 w1^2 + I2^2 w2^2) = L / I3 + L (1 / I1 - 1 / I3) / (1 - n sn^2 tau),
    n = -m (I3 a3)^2 / (I1 a1)^2,

an elliptic integral of the third kind. The centre of mass falls on a parabola.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any

import numpy as np
from mpmath.ctx_mp import MPContext

from crosscheck.errors import Unsupported
from crosscheck.scene.model import GROUND, Scene
from crosscheck.scene.states import States

DIGITS = 50

Context = Any  # of mpmath
Precise = Any  # a number, a vector or a matrix of it


def context() -> Context:
    """A separate mpmath context with numbers of `DIGITS` digits."""
    mp = MPContext()
    mp.dps = DIGITS
    return mp


def frame(mp: Context, along: Sequence[Precise]) -> Precise:
    """A right-handed orthonormal frame (columns) whose third vector points along the given one."""
    norm = mp.norm(mp.matrix(list(along)))
    third = mp.matrix(list(along)) / norm
    least = int(np.argmin([abs(entry) for entry in third]))
    second = crossed(mp, third) * mp.matrix([float(k == least) for k in range(3)])
    second /= mp.norm(second)
    first = crossed(mp, second) * third
    return mp.matrix([list(first), list(second), list(third)]).T


def crossed(mp: Context, p: Precise) -> Precise:
    """The matrix of p x (.)."""
    return mp.matrix([[0, -p[2], p[1]], [p[2], 0, -p[0]], [-p[1], p[0], 0]])


def attitude(mp: Context, quaternion: np.ndarray) -> Precise:
    """The rotation of a quaternion to all digits: an error of 1e-16 here would cause one of 1e-8 in a phase."""
    q = mp.matrix(quaternion.tolist())
    hat = crossed(mp, (q / mp.norm(q))[1:4])
    return mp.eye(3) + 2 * (q[0] / mp.norm(q)) * hat + 2 * hat * hat


def euler(mp: Context, theta: Precise, phi: Precise, psi: Precise) -> Precise:
    """Rz(phi) Rx(theta) Rz(psi)."""
    (st, ct), (sf, cf), (sp, cp) = ((mp.sin(angle), mp.cos(angle)) for angle in (theta, phi, psi))
    return mp.matrix([[cf * cp - sf * ct * sp, -cf * sp - sf * ct * cp, sf * st],
                      [sf * cp + cf * ct * sp, -sf * sp + cf * ct * cp, -cf * st],
                      [st * sp, st * cp, ct]])


def pose_in_doubles(world: Precise, E: Precise, axes: Precise, w: Precise) -> tuple[np.ndarray, np.ndarray]:
    """world E axes^T (3, 3) and axes w (3,), rounded to doubles."""
    return (np.array((world * E * axes.T).tolist(), dtype=float), np.array((axes * w).T.tolist()[0], dtype=float))


class Jacobi:
    """sn, cn, dn of parameter m, and the integral of 1 / (1 - n sn^2) from an argument `start` on."""

    def __init__(self, mp: Context, m: Precise, start: Precise, characteristics: Sequence[Precise]) -> None:
        self.mp, self.m, self.start = mp, m, start
        self.quarter = mp.ellipk(m)
        self._complete = {n: mp.ellippi(n, m) for n in characteristics}
        self._at_start = {n: self._from_zero(n, start) for n in characteristics}

    def functions(self, tau: Precise) -> tuple[Precise, ...]:
        """sn, cn, dn."""
        return tuple(self.mp.ellipfun(kind, tau, m=self.m) for kind in ("sn", "cn", "dn"))

    def third_kind(self, n: Precise, tau: Precise) -> Precise:
        """Integral of 1 / (1 - n sn^2) from the start to tau."""
        return self._from_zero(n, tau) - self._at_start[n]

    def _from_zero(self, n: Precise, tau: Precise) -> Precise:
        """The same integral from 0, continued over any number of half periods of sn^2."""
        mp = self.mp
        turns = mp.nint(tau / (2 * self.quarter))
        within = tau - 2 * self.quarter * turns
        return 2 * turns * self._complete[n] + mp.ellippi(n, mp.asin(mp.ellipfun("sn", within, m=self.m)), self.m)


class Rotation:
    """Attitude and angular velocity of a free body at any time."""

    def __init__(self, inertia: np.ndarray, quaternion: np.ndarray, angular_velocity: np.ndarray) -> None:
        self.mp = mp = context()
        moments, axes = mp.eigsy(mp.matrix(inertia.tolist()))
        w = axes.T * mp.matrix(angular_velocity.tolist())
        energy, momentum = (sum(moments[k]**power * w[k]**2 for k in range(3)) for power in (1, 2))
        if momentum == energy * moments[1]:
            raise Unsupported("closed form: a steady rotation, or one that ends in one")
        order = [0, 1, 2] if momentum > energy * moments[1] else [2, 1, 0]
        axes = mp.matrix([[axes[row, k] for k in order] for row in range(3)])
        axes[:, 0] *= mp.sign(mp.det(axes))
        self.axes, self.I = axes, [moments[k] for k in order]
        self.L = mp.sqrt(momentum)
        self._amplitudes(axes.T * mp.matrix(angular_velocity.tolist()), energy)
        R0 = attitude(mp, quaternion)
        along = R0 * axes * mp.matrix([self.I[k] * self.w0[k] for k in range(3)])
        self.world = frame(mp, list(along))
        E = self.world.T * R0 * axes
        self.phi0 = mp.atan2(E[0, 2], -E[1, 2])

    def _amplitudes(self, w: Precise, energy: Precise) -> None:
        """a1, a2, a3 with their signs, nu, and Jacobi's functions from the phase at the start; energy is 2 E."""
        mp, (I1, I2, I3) = self.mp, self.I
        self.w0, less, more = w, energy * I3 - self.L**2, self.L**2 - energy * I1
        if less == 0:
            raise Unsupported("closed form: a steady rotation about a principal axis")
        a1, a2 = mp.sqrt(less / (I1 * (I3 - I1))), mp.sqrt(less / (I2 * (I3 - I2)))
        a3 = mp.sqrt(more / (I3 * (I3 - I1))) * mp.sign(w[2])
        a2 *= mp.sign(a3) * mp.sign(I3 - I2)  # the sign in Euler's equations
        self.a, self.nu = (a1, a2, a3), mp.sqrt((I3 - I2) * more / (I1 * I2 * I3))
        m = (I2 - I1) * less / ((I3 - I2) * more)
        self.n = -m * (I3 * a3)**2 / (I1 * a1)**2
        start = mp.ellipf(mp.atan2(w[1] / a2, w[0] / a1), m)
        self.jacobi = Jacobi(mp, m, start, [self.n])

    def pose(self, t: float) -> tuple[np.ndarray, np.ndarray]:
        """R (3, 3) and the angular velocity in body axes (3,), rounded to doubles."""
        mp, (I1, _, I3) = self.mp, self.I
        tau = self.jacobi.start + self.nu * mp.mpf(t)
        sn, cn, dn = self.jacobi.functions(tau)
        w = mp.matrix([self.a[0] * cn, self.a[1] * sn, self.a[2] * dn])
        l = [self.I[k] * w[k] / self.L for k in range(3)]
        phi = (self.phi0 + self.L * mp.mpf(t) / I3
               + self.L * (1 / I1 - 1 / I3) * self.jacobi.third_kind(self.n, tau) / self.nu)
        E = euler(mp, mp.atan2(mp.hypot(l[0], l[1]), l[2]), phi, mp.atan2(l[0], l[1]))
        return pose_in_doubles(self.world, E, self.axes, w)


def _free_body(scene: Scene, times: np.ndarray) -> States:
    """`solve` for a free body."""
    if scene.n != 1 or scene.joints or scene.forces:
        raise Unsupported(f"closed form for {scene.name!r}: not a single free body")
    body = scene.bodies[0]
    rotation = Rotation(body.inertia, body.attitude, body.angular_velocity)
    R, w = (np.array(column) for column in zip(*[rotation.pose(t) for t in times], strict=True))
    # w x (J - s) w equals w x J w, and two equal moments cancel exactly
    spread = body.inertia - np.sort(np.diag(body.inertia))[1] * np.eye(3)
    alpha = np.linalg.solve(body.inertia, -np.cross(w, w @ spread).T).T
    t = times[:, None]
    x = body.position + t * body.velocity + t**2 / 2 * scene.gravity
    v, a = body.velocity + t * scene.gravity, np.broadcast_to(scene.gravity, x.shape)
    return States(times, *(array[:, None] for array in (x, R, v, w, a, alpha)))


SYMMETRY = 4 * np.finfo(float).eps  # a body of revolution up to rounding of its inertia, relative
POLE = 1e-20  # near the vertical the angles lose this factor in precision, and then jump by pi


@dataclasses.dataclass(frozen=True)
class Top:
    """A Lagrange top: its parameters, its axis e in body axes, the vertical in world axes, and its initial state."""

    mass: float
    across: float  # inertia across the axis, at the centre of mass
    along: float  # inertia along the axis
    axis: np.ndarray  # (3,) from the joint to the centre of mass, body axes
    gravity: np.ndarray  # (3,) world
    attitude: np.ndarray  # (4,) quaternion
    angular_velocity: np.ndarray  # (3,) body axes


def lagrange_top(scene: Scene) -> Top:
    """The top that a scene is.

    Raises
    ------
    Unsupported
        The scene is not a Lagrange top; the message says why.
    """
    def refuse(reason: str) -> Unsupported:
        return Unsupported(f"closed form for {scene.name!r}: {reason}")

    if scene.n != 1 or scene.forces or len(scene.joints) != 1 or scene.joints[0].type != "spherical":
        raise refuse("not a single body on one spherical joint, under gravity alone")
    joint, body = scene.joints[0], scene.bodies[0]
    if joint.parent != GROUND:
        raise refuse("the joint's parent is not the ground")
    length = np.linalg.norm(joint.child_anchor)
    if length == 0.0 or not np.any(scene.gravity):
        raise refuse("gravity has no moment about the joint")
    e, trace = -joint.child_anchor / length, np.trace(body.inertia)
    along = e @ body.inertia @ e
    across = (trace - along) / 2
    defect = body.inertia - across * np.eye(3) - (along - across) * np.outer(e, e)
    if np.max(np.abs(defect)) > SYMMETRY * trace:
        raise refuse("the inertia is not symmetric about the axis through joint and centre of mass")
    return Top(float(body.mass), float(across), float(along), -joint.child_anchor, scene.gravity, body.attitude,
               body.angular_velocity)


class Solution:
    """Euler angles and their rates of a top at any time, as multiprecision numbers.

    theta is the angle of the axis from the vertical, phi the precession about it, psi the spin:
    world^T R axes = Rz(phi) Rx(theta) Rz(psi) with `axes` = (b1, b2, e) of the body, `world` = (n1, n2, z).
    """

    def __init__(self, top: Top) -> None:
        self.mp = mp = context()
        self.top = top
        self.length = mp.norm(mp.matrix(top.axis.tolist()))
        self.g = mp.norm(mp.matrix(top.gravity.tolist()))
        self.axes, self.world = (frame(mp, along.tolist()) for along in (top.axis, -top.gravity))
        E = self.world.T * attitude(mp, top.attitude) * self.axes
        w = self.axes.T * mp.matrix(top.angular_velocity.tolist())
        self.A = mp.mpf(top.across) + mp.mpf(top.mass) * self.length**2
        self.C, self.w3, u0 = mp.mpf(top.along), w[2], E[2, 2]
        self.Lz = self.A * (E[2, 0] * w[0] + E[2, 1] * w[1]) + self.C * self.w3 * u0
        if 1 - abs(u0) < POLE:
            raise Unsupported("closed form: the axis starts along the vertical")
        self.phi0, self.psi0 = mp.atan2(E[0, 2], -E[1, 2]), mp.atan2(E[2, 0], E[2, 1])
        self._roots(u0, w[0] ** 2 + w[1] ** 2)
        self._phase(u0, E[2, 0] * w[1] - E[2, 1] * w[0])  # du/dt = z . R (w x e)

    def _roots(self, u0: Precise, transverse: Precise) -> None:
        """u1, u2, u3 of du/dt^2 = (1 - u^2)(h - b u) - (l - c u)^2, by Viete's formula: all three are real."""
        mp = self.mp
        b = 2 * mp.mpf(self.top.mass) * self.g * self.length / self.A
        h = transverse + b * u0
        l, c = self.Lz / self.A, self.C * self.w3 / self.A
        a2, a1, a0 = -(h + c * c) / b, 2 * l * c / b - 1, (h - l * l) / b  # monic: u^3 + a2 u^2 + a1 u + a0
        p, q = a1 - a2**2 / 3, 2 * a2**3 / 27 - a2 * a1 / 3 + a0
        radius = 2 * mp.sqrt(-p / 3)
        angle = mp.acos(max(mp.mpf(-1), min(mp.mpf(1), 3 * q / (p * radius)))) / 3
        self.u1, self.u2, self.u3 = sorted(radius * mp.cos(angle - 2 * mp.pi * k / 3) - a2 / 3 for k in range(3))
        if min(1 + self.u1, 1 - self.u2) < POLE:
            raise Unsupported("closed form: the axis passes through the vertical")
        self.nu = mp.sqrt(b * (self.u3 - self.u1)) / 2
        self.m = (self.u2 - self.u1) / (self.u3 - self.u1)

    def _phase(self, u0: Precise, rate: Precise) -> None:
        """Argument of sn at t = 0, on the branch with the initial direction of du/dt."""
        mp = self.mp
        span = self.u2 - self.u1
        square = (u0 - self.u1) / span if span > 0 else mp.mpf(0)
        amplitude = mp.asin(mp.sqrt(max(mp.mpf(0), min(mp.mpf(1), square))))
        start = mp.ellipf(amplitude, self.m)
        self.n_minus, self.n_plus = span / (1 - self.u1), -span / (1 + self.u1)
        self.jacobi = Jacobi(mp, self.m, start if rate >= 0 else -start, [self.n_minus, self.n_plus])

    def angles(self, t: float) -> tuple[Precise, ...]:
        """theta, phi, psi and dtheta/dt, dphi/dt at t; dpsi/dt follows from the constant spin."""
        mp = self.mp
        tau = self.jacobi.start + self.nu * mp.mpf(t)
        sn, cn, dn = self.jacobi.functions(tau)
        u = self.u1 + (self.u2 - self.u1) * sn**2
        minus, plus = (self.jacobi.third_kind(n, tau) / (scale * self.nu)
                       for n, scale in ((self.n_minus, 1 - self.u1), (self.n_plus, 1 + self.u1)))
        spin = self.C * self.w3
        phi = self.phi0 + ((self.Lz - spin) * minus + (self.Lz + spin) * plus) / (2 * self.A)
        psi = (self.psi0 + self.w3 * (1 - self.C / self.A) * mp.mpf(t)
               + ((spin - self.Lz) * minus + (spin + self.Lz) * plus) / (2 * self.A))
        sine = mp.sqrt(1 - u * u)
        theta_rate = -2 * (self.u2 - self.u1) * self.nu * sn * cn * dn / sine
        return mp.acos(u), phi, psi, theta_rate, (self.Lz - spin * u) / (self.A * sine**2)

    def pose(self, t: float) -> tuple[np.ndarray, np.ndarray]:
        """R (3, 3) and the angular velocity in body axes (3,), rounded to doubles."""
        mp = self.mp
        theta, phi, psi, theta_rate, phi_rate = self.angles(t)
        (st, _), (sp, cp) = ((mp.sin(angle), mp.cos(angle)) for angle in (theta, psi))
        E = euler(mp, theta, phi, psi)
        w = mp.matrix([theta_rate * cp + phi_rate * st * sp, -theta_rate * sp + phi_rate * st * cp, self.w3])
        return pose_in_doubles(self.world, E, self.axes, w)


def solve(scene: Scene, times: np.ndarray | None = None) -> States:
    """Exact states of a free body or a Lagrange top at `times`, by default the scene's output times, to rounding.

    Raises
    ------
    Unsupported
        The scene is neither, or the rotation is steady, or the axis of a top passes through the vertical, where Euler
        angles jump.
    """
    times = scene.t if times is None else times
    if not scene.joints:
        return _free_body(scene, times)
    top = lagrange_top(scene)
    body, joint = scene.bodies[0], scene.joints[0]
    solution = Solution(top)
    R, w = (np.array(column) for column in zip(*[solution.pose(t) for t in times], strict=True))
    lever = -joint.child_anchor
    J = body.inertia + body.mass * (lever @ lever * np.eye(3) - np.outer(lever, lever))
    moment = body.mass * np.cross(lever, scene.gravity @ R) - np.cross(w, w @ J)
    alpha = np.linalg.solve(J, moment.T).T  # Euler's equation about the joint
    spin = np.cross(w, lever)

    def turned(vectors: np.ndarray) -> np.ndarray:
        carried: np.ndarray = np.einsum("tij,tj->ti", R, np.broadcast_to(vectors, (len(R), 3)))
        return carried

    x, v = joint.parent_anchor + turned(lever), turned(spin)
    a = turned(np.cross(alpha, lever) + np.cross(w, spin))
    return States(times, *(array[:, None] for array in (x, R, v, w, a, alpha)))
