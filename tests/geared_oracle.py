"""Bodies with rotor inertia for the steps of lieeuler.reference, and the Hamiltonian ones with their momenta, dense.

Here the rate of a rotor is no row: M + s^T I s takes the place of M, and the methods that carry momenta carry those of
the rotors beside the bodies'. G, gamma, s and ds/dt u are those of `crosscheck.scene`. Equations (17.1) of
docs/theory.md.
"""

from __future__ import annotations

import numpy as np

from crosscheck.scene.armature import rotors
from crosscheck.scene.constraints import Constraints
from crosscheck.scene.coordinates import histories
from crosscheck.scene.states import States
from lieeuler.reference import MAPS, Bodies, newton


class Geared(Bodies):
    """A scene under gravity whose joints have armature."""

    def __init__(self, scene):
        self.scene, self.rows = scene, Constraints(scene)
        self.masses, self.inertias, self.gravity, self.m = scene.masses, scene.inertias, scene.gravity, self.rows.m
        self.I = np.array([value for joint in scene.joints for value in joint.armature if value])

    def state(self, q, u=None):
        u = np.zeros((self.n, 6)) if u is None else u.reshape(-1, 6)
        return q[0][None], q[1][None], u[None, :, :3], u[None, :, 3:]

    def phi(self, q):
        return self.rows.position(*self.state(q)[:2])[0]

    def G(self, q):
        return self.rows.jacobian(*self.state(q)[:2])[0]

    def gamma(self, q, u):
        return self.rows.gamma(*self.state(q, u))[0]

    def s(self, q):
        """Rates of the rotors, one row each."""
        return np.array([S[0] for _, S, _ in rotors(self.scene, *self.state(q))]).reshape(-1, 6 * self.n)

    def drift(self, q, u):
        """ds/dt u"""
        return np.array([bias[0] for _, _, bias in rotors(self.scene, *self.state(q, u))]).reshape(-1)

    def rotor_rates(self, q, u):
        return self.s(q) @ u

    def rotor_accelerations(self, q, u, a):
        return self.s(q) @ a + self.drift(q, u)

    def rotor_reaction(self, q, change):
        return self.s(q).T @ (self.I * change)

    def mass(self, q):
        s = self.s(q)
        return self.M + s.T * self.I @ s

    def way(self, q0, q, guess):
        """How far the coordinates of the rotors moved; angles to the turn nearest to the guess."""
        both = (np.stack(pair) for pair in zip(q0, q, strict=True))
        moved = histories(self.scene, States(np.arange(2.0), *both, *np.zeros((4, 2, self.n, 3))))
        ways = []
        for joint in self.scene.joints:
            if any(joint.armature):
                change = np.diff(moved[joint.name].position.reshape(2, -1), axis=0)[0]
                ways += [c for c, inertia in zip(change, joint.armature, strict=True) if inertia]
        return guess + np.remainder(np.array(ways) - guess + np.pi, 2 * np.pi) - np.pi

    def solve(self, q, force, rows):
        """y and lam of mass(q) y + G^T lam = force, G y = rows."""
        G = self.G(q)
        A = np.block([[self.mass(q), G.T], [G, np.zeros((self.m, self.m))]])
        z = np.linalg.solve(A, np.r_[force, rows])
        return z[:6 * self.n], z[6 * self.n:]

    def index1(self, q, u):
        return self.solve(q, self.force(u) - self.rotor_reaction(q, self.drift(q, u)), -self.gamma(q, u))


def hamilton_step(system, level, q0, p0, r0, h, share, coordinate_map, guess):
    """A symplectic Euler step before its projection; p and r are the momenta of bodies and rotors.

    r gains m, whose reaction on the bodies is -s_n^T m; `share` of h is what the forces act for. Returns q, p, r, lam
    and the solution as the next guess.
    """
    nu, G0, s0 = 6 * system.n, system.G(q0), system.s(q0)

    def unpack(z):
        xi, lam = z[:nu], z[nu:]
        y, p = system.momenta(h, xi, coordinate_map)
        q = system.move(q0, h, xi, coordinate_map)
        rates = (system.s(q) @ np.linalg.solve(system.M, p) if level == "velocity"
                 else system.way(q0, q, h * s0 @ xi) / h)
        return q, p, system.I * rates, lam, y

    def residual(z):
        q, p, r, lam, y = unpack(z)
        rows = system.G(q) @ np.linalg.solve(system.M, p) if level == "velocity" else system.phi(q) / h
        return np.r_[y - p0 - share * h * (system.applied() - G0.T @ lam) + s0.T @ (r - r0), rows]

    z = newton(residual, guess)
    return (*unpack(z)[:4], z)


def projected(system, q, p, r):
    """u with G u = 0, and the momenta of bodies and rotors then."""
    u, _ = system.solve(q, p + system.s(q).T @ r, np.zeros(system.m))
    return u, system.M @ u, system.I * (system.s(q) @ u)


def integrate(system, method, q, u, h, steps, map="exp"):
    """(q, u) after `steps` steps of a Hamiltonian `lieeuler.Method` of order one, or of rattle2."""
    _, lam = system.index1(q, u)
    p, r, rattle = system.M @ u, system.I * system.rotor_rates(q, u), method.name == "rattle2"
    guess = np.r_[u, lam]
    for _ in range(steps):
        share = 0.5 if rattle else 1.0
        q, p, r, lam, guess = hamilton_step(system, method.level, q, p, r, h, share, MAPS[map], guess)
        if rattle:
            p = p + 0.5 * h * system.applied()
        u = np.linalg.solve(system.M, p)
        if rattle or method.level == "stabilised":
            u, p, r = projected(system, q, p, r)
    return q, u
