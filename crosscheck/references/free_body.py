"""Exact motion of a free rigid body by Jacobi elliptic functions and an elliptic integral.

With moments I1, I2, I3 in ascending or descending order, such that the body circulates about its third axis
(L^2 > 2 E I2 if ascending, < if descending), the angular velocities along them are

    w1 = a1 cn tau,  w2 = a2 sn tau,  w3 = a3 dn tau,  tau = nu t + tau0

(L. D. Landau, E. M. Lifshitz, Mechanics, section 37). The angular momentum L is constant in the world. Euler angles
about it follow: theta and psi from the components of L along the body's axes, and phi from

    dphi/dt = L (I1 w1^2 + I2 w2^2) / (I1^2 w1^2 + I2^2 w2^2) = L / I3 + L (1 / I1 - 1 / I3) / (1 - n sn^2 tau),
    n = -m (I3 a3)^2 / (I1 a1)^2,

an elliptic integral of the third kind. The centre of mass falls on a parabola.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from crosscheck.errors import Unsupported
from crosscheck.references import elliptic
from crosscheck.scene.model import Scene
from crosscheck.scene.states import States


class Rotation:
    """Attitude and angular velocity of a free body at any time."""

    def __init__(self, inertia: np.ndarray, quaternion: np.ndarray, angular_velocity: np.ndarray) -> None:
        self.mp = mp = elliptic.context()
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
        R0 = elliptic.attitude(mp, quaternion)
        along = R0 * axes * mp.matrix([self.I[k] * self.w0[k] for k in range(3)])
        self.world = elliptic.frame(mp, list(along))
        E = self.world.T * R0 * axes
        self.phi0 = mp.atan2(E[0, 2], -E[1, 2])

    def _amplitudes(self, w: Any, energy: Any) -> None:
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
        self.jacobi = elliptic.Jacobi(mp, m, start, [self.n])

    def pose(self, t: float) -> tuple[np.ndarray, np.ndarray]:
        """R (3, 3) and the angular velocity in body axes (3,), rounded to doubles."""
        mp, (I1, _, I3) = self.mp, self.I
        tau = self.jacobi.start + self.nu * mp.mpf(t)
        sn, cn, dn = self.jacobi.functions(tau)
        w = mp.matrix([self.a[0] * cn, self.a[1] * sn, self.a[2] * dn])
        l = [self.I[k] * w[k] / self.L for k in range(3)]
        phi = (self.phi0 + self.L * mp.mpf(t) / I3
               + self.L * (1 / I1 - 1 / I3) * self.jacobi.third_kind(self.n, tau) / self.nu)
        E = elliptic.euler(mp, mp.atan2(mp.hypot(l[0], l[1]), l[2]), phi, mp.atan2(l[0], l[1]))
        return elliptic.pose_in_doubles(self.world, E, self.axes, w)


def solve(scene: Scene) -> States:
    """Exact states of a free body at the scene's output times, to rounding.

    Raises
    ------
    Unsupported
        There is more than one body, a joint or a force, or the rotation is steady.
    """
    if scene.n != 1 or scene.joints or scene.forces:
        raise Unsupported(f"closed form for {scene.name!r}: not a single free body")
    body = scene.bodies[0]
    rotation = Rotation(body.inertia, body.attitude, body.angular_velocity)
    R, w = (np.array(column) for column in zip(*[rotation.pose(t) for t in scene.t], strict=True))
    # w x (J - s) w equals w x J w, and two equal moments cancel exactly
    spread = body.inertia - np.sort(np.diag(body.inertia))[1] * np.eye(3)
    alpha = np.linalg.solve(body.inertia, -np.cross(w, w @ spread).T).T
    t = scene.t[:, None]
    x = body.position + t * body.velocity + t**2 / 2 * scene.gravity
    v, a = body.velocity + t * scene.gravity, np.broadcast_to(scene.gravity, x.shape)
    return States(scene.t, *(array[:, None] for array in (x, R, v, w, a, alpha)))
