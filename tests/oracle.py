"""A short dense NumPy version of each Euler step: the check on the compiled core.

Written from equations (4.1) to (4.5) of docs/theory.md with nothing in common with the kernel: dense matrices, the
coordinate maps by their defining series, their tangents by the complex step, Newton's matrix by central differences.
"""

from __future__ import annotations

import dataclasses
import functools

import numpy as np


def hat(a):
    return np.array([[0, -a[2], a[1]], [a[2], 0, -a[0]], [-a[1], a[0], 0]])


def exp_series(theta):
    """exp(hat(theta)) by its power series, for |theta| < 0.3; complex arguments are fine."""
    X, term, total = hat(theta), np.eye(3), np.eye(3)
    for k in range(1, 17):
        term = term @ X / k
        total = total + term
    return total


def cayley(theta):
    X = hat(theta) / 2
    return np.linalg.solve(np.eye(3) - X, np.eye(3) + X)


def ccsk(theta):
    return exp_series(theta * [1, 0, 0]) @ exp_series(theta * [0, 1, 0]) @ exp_series(theta * [0, 0, 1])


MAPS = {"exp": exp_series, "cayley": cayley, "ccsk": ccsk}


def right_tangent(coordinate_map, theta):
    """D with d map(theta) map(theta)^T = hat(D dtheta), by the complex step."""
    E, D = coordinate_map(theta), np.empty((3, 3))
    for j in range(3):
        W = coordinate_map(theta + 1e-30j * np.eye(3)[j]).imag / 1e-30 @ E.T
        D[:, j] = W[2, 1], W[0, 2], W[1, 0]
    return D


class Bodies:
    """Bodies under gravity (masses, inertias, gravity); a state is q = (x, R) and u = (v, w) of every body in turn.

    `slips` tells for each row whether it constrains velocities alone. Rotors, of which there are none here, have rates,
    accelerations and, from changes of their rates, a reaction on the bodies (tests/geared_oracle.py).
    """

    slips = False

    def rotor_rates(self, q, u):
        return 0

    def rotor_accelerations(self, q, u, a):
        return 0

    def rotor_reaction(self, q, change):
        return 0

    @property
    def n(self):
        return len(self.masses)

    @functools.cached_property
    def M(self):
        M = np.zeros((6 * self.n, 6 * self.n), dtype=np.result_type(*self.masses, *self.inertias))
        for b, (mass, J) in enumerate(zip(self.masses, self.inertias, strict=True)):
            M[6 * b:6 * b + 3, 6 * b:6 * b + 3], M[6 * b + 3:6 * b + 6, 6 * b + 3:6 * b + 6] = mass * np.eye(3), J
        return M

    def applied(self):
        return np.concatenate([np.r_[mass * self.gravity, 0, 0, 0] for mass in self.masses])

    def force(self, u):
        f = self.applied() + 0 * u  # which may be complex, as everything here
        for b, J in enumerate(self.inertias):
            w = u[6 * b + 3:6 * b + 6]
            f[6 * b + 3:6 * b + 6] -= hat(w) @ J @ w
        return f

    def move(self, q, h, xi, coordinate_map=exp_series):
        x = np.array([q[0][b] + h * xi[6 * b:6 * b + 3] for b in range(self.n)])
        R = np.array([q[1][b] @ coordinate_map(h * xi[6 * b + 3:6 * b + 6]) for b in range(self.n)])
        return x, R

    def momenta(self, h, xi, coordinate_map):
        """Momenta of a symplectic Euler step: at its start, without its forces, and at its end."""
        before = self.M @ xi
        after = before.copy()
        for b in range(self.n):
            turn = slice(6 * b + 3, 6 * b + 6)
            theta = h * xi[turn]
            before[turn] = np.linalg.solve(right_tangent(coordinate_map, theta).T, before[turn])
            after[turn] = coordinate_map(theta).T @ before[turn]
        return before, after


@dataclasses.dataclass
class Chain(Bodies):
    """Bodies and spherical joints (parent, child, parent anchor, child anchor); parent -1 is the ground."""

    masses: list
    inertias: list
    joints: list
    gravity: np.ndarray

    def __post_init__(self):
        self.m = 3 * len(self.joints)

    def _ends(self, joint):
        return [(body, sign, s) for body, sign, s in ((joint[0], -1, joint[2]), (joint[1], 1, joint[3])) if body >= 0]

    def phi(self, q):
        x, R = q
        rows = [sum(sign * (x[b] + R[b] @ s) for b, sign, s in self._ends(joint))
                - (joint[2] if joint[0] < 0 else 0) for joint in self.joints]
        return np.concatenate(rows) if rows else np.zeros(0)

    def G(self, q):
        G = np.zeros((self.m, 6 * self.n), dtype=q[1].dtype)
        for k, joint in enumerate(self.joints):
            for b, sign, s in self._ends(joint):
                G[3 * k:3 * k + 3, 6 * b:6 * b + 3] = sign * np.eye(3)
                G[3 * k:3 * k + 3, 6 * b + 3:6 * b + 6] = -sign * q[1][b] @ hat(s)
        return G

    def gamma(self, q, u):
        gamma = np.zeros(self.m, dtype=q[1].dtype)
        for k, joint in enumerate(self.joints):
            for b, sign, s in self._ends(joint):
                w = u[6 * b + 3:6 * b + 6]
                gamma[3 * k:3 * k + 3] += sign * q[1][b] @ hat(w) @ hat(w) @ s
        return gamma

    def index1(self, q, u):
        G = self.G(q)
        A = np.block([[self.M, G.T], [G, np.zeros((self.m, self.m))]])
        z = np.linalg.solve(A, np.r_[self.force(u), -self.gamma(q, u)])
        return z[:6 * self.n], z[6 * self.n:]


def newton(residual, z):
    """Chord iteration with a central-difference matrix at the guess, refreshed once."""
    for _ in range(2):
        scale = 1e-6 * np.maximum(1, np.abs(z))
        A = np.column_stack([(residual(z + d) - residual(z - d)) / (2 * e)
                             for d, e in zip(np.diag(scale), scale, strict=True)])
        for _ in range(8):
            dz = np.linalg.solve(A, residual(z))
            z = z - dz
            if np.abs(dz.real).max() < 1e-13 * max(1, np.abs(z.real).max()) and (
                    np.abs(dz.imag).max() <= 1e-12 * np.abs(z.imag).max()):
                return z
    return z


def corrected(system, G0, mu, correction):
    """What closes the positions, of a step that starts with G0: the multipliers' velocities, weighted or plain."""
    return np.linalg.solve(system.M, G0.T @ mu) if correction == "mass" else G0.T @ mu


def lagrange_step(system, level, q0, u0, h, coordinate_map, guess, gains=(0.0, 0.0), correction="mass"):
    """One implicit Euler step; returns q, u, lam and the solution as the next guess."""
    nu, m, G0, rates0 = 6 * system.n, system.m, system.G(q0), system.rotor_rates(q0, u0)

    def unpack(z):
        u, lam, mu = z[:nu], z[nu:nu + m], z[nu + m:]
        xi = u - corrected(system, G0, mu, correction) if level == "stabilised" else u
        return system.move(q0, h, xi, coordinate_map), u, lam

    def residual(z):
        q, u, lam = unpack(z)
        G, phi = system.G(q), system.phi(q)
        a = (u - u0) / h
        rows = {"position": [np.where(system.slips, G @ u, phi / h)], "velocity": [G @ u],
                "stabilised": [G @ u, np.where(system.slips, z[nu + m:] if level == "stabilised" else 0, phi / h)],
                "acceleration": [h * (G @ a + system.gamma(q, u) + 2 * gains[0] * G @ u + gains[1]**2 * phi)]}[level]
        change = (h * system.rotor_accelerations(q, u, a) if level == "acceleration"
                  else system.rotor_rates(q, u) - rates0)
        return np.concatenate([system.M @ (u - u0) + system.rotor_reaction(q, change) - h * system.force(u)
                               + h * G.T @ lam, *rows])

    z = newton(residual, guess)
    return (*unpack(z), z)


def hamilton_step(system, level, q0, u0, h, coordinate_map, guess):
    """One symplectic Euler step; returns q, u, lam and the solution as the next guess."""
    nu, G0 = 6 * system.n, system.G(q0)

    def unpack(z):
        xi, lam = z[:nu], z[nu:]
        y, p = system.momenta(h, xi, coordinate_map)
        return system.move(q0, h, xi, coordinate_map), np.linalg.solve(system.M, p), lam, y

    def residual(z):
        q, u, lam, y = unpack(z)
        rates = system.G(q) @ u
        rows = rates if level == "velocity" else np.where(system.slips, rates, system.phi(q) / h)
        return np.r_[y - system.M @ u0 - h * (system.applied() - G0.T @ lam), rows]

    z = newton(residual, guess)
    q, u, lam, _ = unpack(z)
    if level == "stabilised":
        G = system.G(q)
        mu = np.linalg.solve(G @ np.linalg.solve(system.M, G.T), G @ u)
        u, lam = u - np.linalg.solve(system.M, G.T @ mu), lam + mu / h
    return q, u, lam, z


def integrate(system, method, q, u, h, steps, coordinate_map="exp", gains=(0.0, 0.0), correction="mass"):
    """States (q, u, a, lam) after `steps` steps of a `lieeuler.Method`."""
    a, lam = system.index1(q, u)
    extra = system.m if method.formulation == "lagrange" and method.level == "stabilised" else 0
    guess = np.r_[u, lam, np.zeros(extra)]
    for _ in range(steps):
        arguments = (system, method.level, q, u, h, MAPS[coordinate_map], guess)
        if method.formulation == "lagrange":
            q, u, lam, guess = lagrange_step(*arguments, gains, correction)
        else:
            q, u, lam, guess = hamilton_step(*arguments)
    if method.index1_output:
        a, lam = system.index1(q, u)
    else:
        a = np.linalg.solve(system.M, system.force(u) - system.G(q).T @ lam)
    return q, u, a, lam


def rattle_step(system, q0, u0, h, guess):
    """One step of RATTLE; returns q, u and the solution as the next guess.

    Rows of slip hold the velocity of the step in the mean of its two configurations.
    """
    nu, G0 = 6 * system.n, system.G(q0)

    def residual(z):
        xi, lam = z[:nu], z[nu:]
        q = system.move(q0, h, xi)
        rows = np.where(system.slips, (G0 + system.G(q)) @ xi / 2, system.phi(q) / h)
        impulse = h / 2 * (system.applied() - G0.T @ lam)
        return np.r_[system.momenta(h, xi, exp_series)[0] - system.M @ u0 - impulse, rows]

    z = newton(residual, guess)
    xi = z[:nu]
    q = system.move(q0, h, xi)
    u = np.linalg.solve(system.M, system.momenta(h, xi, exp_series)[1] + h / 2 * system.applied())
    G = system.G(q)
    return q, u - np.linalg.solve(system.M, G.T @ np.linalg.solve(G @ np.linalg.solve(system.M, G.T), G @ u)), z


def additive_steps(system, q, u, h):
    """Comparator: adds to the rotation matrix, R + h R hat(w), as if it were a vector; no group, no polish.

    Explicit in the accelerations of the index-1 system, so that a step is cheap. The centres of mass follow from the
    attitudes and the velocities are projected, so that both constraint levels hold and only the update differs. Joints
    are listed from the ground outwards. Yields q and u after every step.
    """
    inverse, G = np.linalg.inv(system.M), system.G(q)
    while True:
        free = inverse @ system.force(u)
        MG = inverse @ G.T
        u = u + h * (free - MG @ np.linalg.solve(G @ MG, G @ free + system.gamma(q, u)))
        R = np.array([q[1][b] @ (np.eye(3) + h * hat(u[6 * b + 3:6 * b + 6])) for b in range(system.n)])
        x = np.zeros((system.n, 3))
        for parent, child, above, below in system.joints:
            x[child] = (above if parent < 0 else x[parent] + R[parent] @ above) - R[child] @ below
        q = x, R
        G = system.G(q)
        MG = inverse @ G.T
        u = u - MG @ np.linalg.solve(G @ MG, G @ u)
        yield q, u


def alpha_coefficients(radius):
    """(alpha_m, alpha_f, gamma, beta) of generalized-alpha."""
    alpha_m, alpha_f = (2 * radius - 1) / (radius + 1), radius / (radius + 1)
    gamma = 0.5 + alpha_f - alpha_m
    return alpha_m, alpha_f, gamma, (gamma + 0.5)**2 / 4


def alpha_step(system, radius, q0, u0, a0, A0, h, guess, correction="mass"):
    """One step of generalized-alpha, stabilised index 2; returns q, u, a, A, lam and the solution as the next guess."""
    alpha_m, alpha_f, gamma, beta = alpha_coefficients(radius)
    nu, m, G0 = 6 * system.n, system.m, system.G(q0)

    def unpack(z):
        a, lam, eta = z[:nu], z[nu:nu + m], z[nu + m:]
        A = ((1 - alpha_f) * a + alpha_f * a0 - alpha_m * A0) / (1 - alpha_m)
        xi = u0 + h * ((0.5 - beta) * A0 + beta * A) - corrected(system, G0, eta, correction)
        u = u0 + h * ((1 - gamma) * A0 + gamma * A)
        return system.move(q0, h, xi, exp_series), u, a, A, lam

    def residual(z):
        q, u, a, _, lam = unpack(z)
        G = system.G(q)
        closing = np.where(system.slips, z[nu + m:], system.phi(q) / h)
        reaction = system.rotor_reaction(q, system.rotor_accelerations(q, u, a))
        return np.concatenate([h * (system.M @ a + reaction - system.force(u) + G.T @ lam), G @ u, closing])

    z = newton(residual, guess)
    return (*unpack(z), z)


def integrate_alpha(system, radius, q, u, h, steps, correction="mass"):
    """States (q, u, lam) after every step, and the multipliers of the index-1 system there."""
    a, lam = system.index1(q, u)
    alpha_m, alpha_f, *_ = alpha_coefficients(radius)
    ahead = (alpha_m - alpha_f) * h
    A, _ = system.index1(system.move(q, ahead, u + ahead / 2 * a, exp_series), u + ahead * a)
    guess = np.r_[a, lam, np.zeros(system.m)]
    for _ in range(steps):
        q, u, a, A, lam, guess = alpha_step(system, radius, q, u, a, A, h, guess, correction)
        yield q, u, lam, system.index1(q, u)[1]


def start_gradient_step(system, q0, u0, h, coordinate_map, guess):
    """DAE1L_LSE in another reading: the velocity correction acts along G of the start of the step, as that of q does.

    M (u - u_n) = h (f - G^T lam) - h G_n^T nu with (a, lam) of the index-1 system at the new state, Phi = 0, G u = 0,
    q = q_n * (h (u - M^-1 G_n^T mu)). With G^T nu in place of G_n^T nu this is (4.2), which is DAE2L_LSE in (q, u).
    Returns q, u, lam and the solution as the next guess.
    """
    nu, m, G0 = 6 * system.n, system.m, system.G(q0)

    def unpack(z):
        u, correction, mu = z[:nu], z[nu:nu + m], z[nu + m:]
        q = system.move(q0, h, u - np.linalg.solve(system.M, G0.T @ mu), coordinate_map)
        return q, u, correction

    def residual(z):
        q, u, correction = unpack(z)
        a, _ = system.index1(q, u)
        return np.concatenate([system.M @ (u - u0 - h * a) + h * G0.T @ correction, system.G(q) @ u, system.phi(q) / h])

    z = newton(residual, guess)
    q, u, _ = unpack(z)
    return q, u, system.index1(q, u)[1], z
