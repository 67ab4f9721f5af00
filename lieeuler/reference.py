"""The steps of the implicit methods in dense NumPy, each as it stands in docs/theory.md: to read, and to check against.

Nothing here comes from the compiled core: matrices are dense, rows are differentiated by the product rule of their two
vectors, coordinate maps are their defining series with tangents by the complex step, and Newton's matrix is by central
differences. A step costs some milliseconds.

A state is q = (x, R), (n, 3) and (n, 3, 3), and u = (v, w) of every body in turn, (6 n,), in the conventions of
`lieeuler.types`.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

from lieeuler.errors import ArgumentError
from lieeuler.joints import Joint
from lieeuler.methods import GeneralizedAlpha, Implicit, Method, Rattle
from lieeuler.problem import Problem
from lieeuler.types import GROUND

Place = tuple[np.ndarray, np.ndarray]
"""x, R"""
Map = Callable[[np.ndarray], np.ndarray]


def hat(a: np.ndarray) -> np.ndarray:
    """The matrix of the cross product by a vector."""
    return np.array([[0, -a[2], a[1]], [a[2], 0, -a[0]], [-a[1], a[0], 0]])


def exp_series(theta: np.ndarray) -> np.ndarray:
    """exp(hat(theta)) by its power series, for |theta| < 0.3; complex arguments are fine."""
    X, term, total = hat(theta), np.eye(3), np.eye(3)
    for k in range(1, 17):
        term = term @ X / k
        total = total + term
    return total


def cayley(theta: np.ndarray) -> np.ndarray:
    """(I - hat(theta) / 2)^-1 (I + hat(theta) / 2)"""
    X = hat(theta) / 2
    return np.linalg.solve(np.eye(3) - X, np.eye(3) + X)


def ccsk(theta: np.ndarray) -> np.ndarray:
    """Canonical coordinates of the second kind: a product of three rotations."""
    return np.asarray(exp_series(theta * [1, 0, 0]) @ exp_series(theta * [0, 1, 0]) @ exp_series(theta * [0, 0, 1]))


MAPS: dict[str, Map] = {"exp": exp_series, "cayley": cayley, "ccsk": ccsk}


def right_tangent(coordinate_map: Map, theta: np.ndarray) -> np.ndarray:
    """D with d map(theta) map(theta)^T = hat(D dtheta), by the complex step."""
    E, D = coordinate_map(theta), np.empty((3, 3))
    for j in range(3):
        W = coordinate_map(theta + 1e-30j * np.eye(3)[j]).imag / 1e-30 @ E.T
        D[:, j] = W[2, 1], W[0, 2], W[1, 0]
    return D


class Bodies:
    """Bodies under gravity, with `masses`, `inertias`, `gravity` and m rows, which a subclass gives: phi, G and gamma.

    `slips` tells for each row whether it constrains velocities alone. Rotors, of which there are none here, have rates,
    accelerations and, from changes of their rates, a reaction on the bodies.
    """

    masses: Any
    inertias: Any
    gravity: np.ndarray
    m: int
    slips: Any = False

    def phi(self, q: Place) -> np.ndarray:
        """(m,) the position level."""
        raise NotImplementedError

    def G(self, q: Place) -> np.ndarray:
        """(m, 6 n) the rows: dphi/dt = G u."""
        raise NotImplementedError

    def gamma(self, q: Place, u: np.ndarray) -> np.ndarray:
        """(m,) dG/dt u: the second derivative of phi is G du/dt + gamma."""
        raise NotImplementedError

    def rotor_rates(self, q: Place, u: np.ndarray) -> Any:
        """The rates of the rotors."""
        return 0

    def rotor_accelerations(self, q: Place, u: np.ndarray, a: np.ndarray) -> Any:
        """Their derivatives."""
        return 0

    def rotor_reaction(self, q: Place, change: Any) -> Any:
        """(6 n,) the impulse that changes their rates, on the bodies."""
        return 0

    @property
    def n(self) -> int:
        """Number of bodies."""
        return len(self.masses)

    @functools.cached_property
    def M(self) -> np.ndarray:
        """(6 n, 6 n) masses and inertias, equation (1.1)."""
        M = np.zeros((6 * self.n, 6 * self.n))
        for b, (mass, J) in enumerate(zip(self.masses, self.inertias, strict=True)):
            M[6 * b:6 * b + 3, 6 * b:6 * b + 3], M[6 * b + 3:6 * b + 6, 6 * b + 3:6 * b + 6] = mass * np.eye(3), J
        return M

    def applied(self) -> np.ndarray:
        """(6 n,) weights."""
        return np.concatenate([np.r_[mass * self.gravity, 0, 0, 0] for mass in self.masses])

    def force(self, u: np.ndarray) -> np.ndarray:
        """(6 n,) f of equation (1.2): weights, and -w x J w.

        The latter as -w x (J - s I) w with s the middle entry on the diagonal: equal moments cancel exactly, where
        rounding of their products would spin up a thin body.
        """
        f = self.applied()
        for b, J in enumerate(self.inertias):
            w = u[6 * b + 3:6 * b + 6]
            f[6 * b + 3:6 * b + 6] -= hat(w) @ (J - np.median(np.diagonal(J)) * np.eye(3)) @ w
        return f

    def index1(self, q: Place, u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Accelerations and multipliers, equation (1.4)."""
        G = self.G(q)
        A = np.block([[self.M, G.T], [G, np.zeros((self.m, self.m))]])
        z = np.linalg.solve(A, np.r_[self.force(u), -self.gamma(q, u)])
        return z[:6 * self.n], z[6 * self.n:]

    def move(self, q: Place, h: float, xi: np.ndarray, coordinate_map: Map = exp_series) -> Place:
        """q * (h xi)"""
        x = np.array([q[0][b] + h * xi[6 * b:6 * b + 3] for b in range(self.n)])
        R = np.array([q[1][b] @ coordinate_map(h * xi[6 * b + 3:6 * b + 6]) for b in range(self.n)])
        return x, R

    def momenta(self, h: float, xi: np.ndarray, coordinate_map: Map) -> tuple[np.ndarray, np.ndarray]:
        """Of a symplectic Euler step, equation (4.4): at its start, without its forces, and at its end."""
        before = self.M @ xi
        after = before.copy()
        for b in range(self.n):
            turn = slice(6 * b + 3, 6 * b + 6)
            theta = h * xi[turn]
            before[turn] = np.linalg.solve(right_tangent(coordinate_map, theta).T, before[turn])
            after[turn] = coordinate_map(theta).T @ before[turn]
        return before, after

    def project(self, q: Place, u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """u with G u = 0 by the least kinetic energy, and the multipliers of its change."""
        G = self.G(q)
        mu = np.linalg.solve(G @ np.linalg.solve(self.M, G.T), G @ u)
        return u - np.linalg.solve(self.M, G.T @ mu), mu


class System(Bodies):
    """A problem under gravity, with its joints but those that are driven, follow others, have rotors or roll.

    Every row is a product of two vectors, or the difference of two anchors, as `lieeuler.joints` says.

    Raises
    ------
    ArgumentError
        The problem has something else.
    """

    def __init__(self, problem: Problem) -> None:
        if not isinstance(problem, Problem):
            raise ArgumentError(f"problem must be a lieeuler.Problem, not {problem!r}")
        for k, joint in enumerate(problem.joints):
            if joint.drive or joint.mimic or joint.rotors or joint.contact:
                raise ArgumentError(f"joints[{k}]: lieeuler.reference has no drives, mimics, rotors and contacts")
        if problem.forces or problem.laws or problem.custom:
            raise ArgumentError("lieeuler.reference has gravity, but no forces and laws")
        self.masses, self.inertias = ([getattr(body, name) for body in problem.bodies] for name in ("mass", "inertia"))
        self.joints, self.gravity, self.m = problem.joints, problem.gravity, problem.rows
        self.q: Place = problem.x, problem.R
        self.u = np.hstack([problem.v, problem.w]).ravel()

    @staticmethod
    def _vector(q: Place, u: np.ndarray, joint: Joint, carrier: str, axis: np.ndarray) -> np.ndarray:
        """(3, 3) a vector that moves with bodies, and its derivatives at constant u; the difference of two anchors."""
        def fixed(b: int, s: np.ndarray) -> np.ndarray:
            if b == GROUND:
                return np.array([s, np.zeros(3), np.zeros(3)])
            W = hat(u[6 * b + 3:6 * b + 6])
            return np.array([q[1][b] @ s, q[1][b] @ W @ s, q[1][b] @ W @ W @ s])

        def point(b: int, s: np.ndarray) -> np.ndarray:
            return fixed(b, s) + (0 if b == GROUND else np.array([q[0][b], u[6 * b:6 * b + 3], np.zeros(3)]))

        if carrier == "difference":
            return np.asarray(point(joint.child, joint.child_anchor) - point(joint.parent, joint.parent_anchor))
        return fixed(getattr(joint, carrier), axis)

    def _levels(self, joint: Joint, q: Place, u: np.ndarray) -> np.ndarray:
        """(3, rows) phi, G u and gamma of a joint."""
        rows = [self._vector(q, u, joint, "difference", np.zeros(3))] if joint.spherical else []
        for dot in joint.dots:
            A, B = (self._vector(q, u, joint, *each) for each in ((dot.a, dot.a_axis), (dot.b, dot.b_axis)))
            rows.append(np.array([[dot.scale * (A[0] @ B[0]) - dot.constant],
                                  [dot.scale * (A[1] @ B[0] + A[0] @ B[1])],
                                  [dot.scale * (A[2] @ B[0] + 2 * A[1] @ B[1] + A[0] @ B[2])]]))
        return np.hstack(rows)

    def _all(self, q: Place, u: np.ndarray) -> np.ndarray:
        return np.hstack([np.zeros((3, 0)), *(self._levels(joint, q, u) for joint in self.joints)])

    def phi(self, q: Place) -> np.ndarray:
        """As in `Bodies`."""
        return np.asarray(self._all(q, np.zeros(6 * self.n))[0])

    def G(self, q: Place) -> np.ndarray:
        """As in `Bodies`: the rates of phi by unit velocities."""
        G, at, units = np.zeros((self.m, 6 * self.n)), 0, np.eye(6 * self.n)
        for joint in self.joints:
            for b in {joint.parent, joint.child} - {GROUND}:
                for k in range(6 * b, 6 * b + 6):
                    G[at:at + joint.rows, k] = self._levels(joint, q, units[k])[1]
            at += joint.rows
        return G

    def gamma(self, q: Place, u: np.ndarray) -> np.ndarray:
        """As in `Bodies`."""
        return np.asarray(self._all(q, u)[2])


def newton(residual: Callable[[np.ndarray], np.ndarray], z: np.ndarray) -> np.ndarray:
    """Chord iteration with a central-difference matrix at the guess, refreshed once."""
    for _ in range(2):
        scale = 1e-6 * np.maximum(1, np.abs(z))
        A = np.column_stack([(residual(z + d) - residual(z - d)) / (2 * e)
                             for d, e in zip(np.diag(scale), scale, strict=True)])
        for _ in range(8):
            dz = np.linalg.solve(A, residual(z))
            z = z - dz
            if np.abs(dz).max() < 1e-13 * max(1, np.abs(z).max()):
                return z
    return z


def _corrected(system: Bodies, method: Any, G0: np.ndarray, mu: np.ndarray) -> np.ndarray:
    """What closes the positions, of a step that starts with G0: the multipliers' velocities, weighted or plain."""
    return np.linalg.solve(system.M, G0.T @ mu) if method.correction == "mass" else G0.T @ mu


def lagrange_step(system: Bodies, method: Any, q0: Place, u0: np.ndarray, guess: np.ndarray) -> tuple[Any, ...]:
    """An implicit Euler step, equations (4.1), (4.2) and (4.5); returns q, u, lam and the solution, the next guess."""
    nu, m, h, level = 6 * system.n, system.m, method.step, method.level
    G0, rates0, stabilised = system.G(q0), system.rotor_rates(q0, u0), level == "stabilised"
    alpha, beta = getattr(method, "alpha", 0.0), getattr(method, "beta", 0.0)

    def unpack(z: np.ndarray) -> tuple[Place, np.ndarray, np.ndarray]:
        u, lam = z[:nu], z[nu:nu + m]
        xi = u - _corrected(system, method, G0, z[nu + m:]) if stabilised else u
        return system.move(q0, h, xi, MAPS[method.map]), u, lam

    def residual(z: np.ndarray) -> np.ndarray:
        q, u, lam = unpack(z)
        G, phi, a = system.G(q), system.phi(q), (u - u0) / h
        rows = {"position": [np.where(system.slips, G @ u, phi / h)], "velocity": [G @ u],
                "stabilised": [G @ u, np.where(system.slips, z[nu + m:] if stabilised else 0, phi / h)],
                "acceleration": [h * (G @ a + system.gamma(q, u) + 2 * alpha * G @ u + beta**2 * phi)]}[level]
        change = (h * system.rotor_accelerations(q, u, a) if level == "acceleration"
                  else system.rotor_rates(q, u) - rates0)
        return np.concatenate([system.M @ (u - u0) + system.rotor_reaction(q, change) - h * system.force(u)
                               + h * G.T @ lam, *rows])

    z = newton(residual, guess)
    return (*unpack(z), z)


def hamilton_step(system: Bodies, method: Any, q0: Place, u0: np.ndarray, guess: np.ndarray) -> tuple[Any, ...]:
    """A symplectic Euler step, equation (4.4); returns q, u, lam and the solution, the next guess."""
    nu, G0, h = 6 * system.n, system.G(q0), method.step

    def unpack(z: np.ndarray) -> tuple[Place, np.ndarray, np.ndarray, np.ndarray]:
        xi, lam = z[:nu], z[nu:]
        y, p = system.momenta(h, xi, MAPS[method.map])
        return system.move(q0, h, xi, MAPS[method.map]), np.linalg.solve(system.M, p), lam, y

    def residual(z: np.ndarray) -> np.ndarray:
        q, u, lam, y = unpack(z)
        rates = system.G(q) @ u
        rows = rates if method.level == "velocity" else np.where(system.slips, rates, system.phi(q) / h)
        return np.concatenate([y - system.M @ u0 - h * (system.applied() - G0.T @ lam), rows])

    z = newton(residual, guess)
    q, u, lam, _ = unpack(z)
    if method.level == "stabilised":
        u, mu = system.project(q, u)
        lam = lam + mu / h
    return q, u, lam, z


def rattle_step(system: Bodies, q0: Place, u0: np.ndarray, h: float, guess: np.ndarray,
                coordinate_map: Map = exp_series) -> tuple[Place, np.ndarray, np.ndarray]:
    """A step of RATTLE, equation (9.1); returns q, u and the solution, the next guess.

    Rows of slip hold the velocity of the step in the mean of its two configurations.
    """
    nu, G0 = 6 * system.n, system.G(q0)

    def residual(z: np.ndarray) -> np.ndarray:
        xi, lam = z[:nu], z[nu:]
        q = system.move(q0, h, xi, coordinate_map)
        rows = np.where(system.slips, (G0 + system.G(q)) @ xi / 2, system.phi(q) / h)
        impulse = h / 2 * (system.applied() - G0.T @ lam)
        return np.concatenate([system.momenta(h, xi, coordinate_map)[0] - system.M @ u0 - impulse, rows])

    z = newton(residual, guess)
    q, p = system.move(q0, h, z[:nu], coordinate_map), system.momenta(h, z[:nu], coordinate_map)[1]
    return q, system.project(q, np.linalg.solve(system.M, p + h / 2 * system.applied()))[0], z


def alpha_steps(system: Bodies, method: GeneralizedAlpha, q: Place, u: np.ndarray) -> Iterator[tuple[Any, ...]]:
    """q, u, lam after every step of generalized-alpha, equation (4.3) of docs/theory.md."""
    nu, m, h, radius = 6 * system.n, system.m, method.step, method.spectral_radius
    alpha_m, alpha_f = (2 * radius - 1) / (radius + 1), radius / (radius + 1)
    gamma = 0.5 + alpha_f - alpha_m
    beta, chart = (gamma + 0.5)**2 / 4, MAPS[method.map]
    a, lam = system.index1(q, u)
    ahead = (alpha_m - alpha_f) * h
    A, _ = system.index1(system.move(q, ahead, u + ahead / 2 * a, chart), u + ahead * a)
    z = np.r_[a, lam, np.zeros(m)]
    while True:
        G0, q0, u0, a0, A0 = system.G(q), q, u, a, A

        def unpack(z: np.ndarray, G0: Any = G0, q0: Any = q0, u0: Any = u0, a0: Any = a0, A0: Any = A0) -> Any:
            a, lam, eta = z[:nu], z[nu:nu + m], z[nu + m:]
            A = ((1 - alpha_f) * a + alpha_f * a0 - alpha_m * A0) / (1 - alpha_m)
            xi = u0 + h * ((0.5 - beta) * A0 + beta * A) - _corrected(system, method, G0, eta)
            return system.move(q0, h, xi, chart), u0 + h * ((1 - gamma) * A0 + gamma * A), a, A, lam

        def residual(z: np.ndarray, unpack: Any = unpack) -> np.ndarray:
            q, u, a, _, lam = unpack(z)
            G = system.G(q)
            closing = np.where(system.slips, z[nu + m:], system.phi(q) / h)
            reaction = system.rotor_reaction(q, system.rotor_accelerations(q, u, a))
            return np.concatenate([h * (system.M @ a + reaction - system.force(u) + G.T @ lam), G @ u, closing])

        z = newton(residual, z)
        q, u, a, A, lam = unpack(z)
        yield q, u, lam


def steps(system: Bodies, method: Method, q: Place, u: np.ndarray) -> Iterator[tuple[Any, ...]]:
    """(q, u, a, lam) after every step, as the method gives them, without end.

    `System(problem)` has the problem's own start, q and u. For methods with a step but the explicit ones.

    Raises
    ------
    ArgumentError
        It is another method.
    """
    if not isinstance(method, Implicit):
        raise ArgumentError(f"lieeuler.reference has the implicit methods with a step, as objects, not {method!r}")
    options: Any = method
    lam = system.index1(q, u)[1]
    doubled = method.formulation == "lagrange" and method.level == "stabilised"
    guess = np.r_[u, lam, np.zeros(system.m * doubled)]
    alpha = alpha_steps(system, method, q, u) if isinstance(method, GeneralizedAlpha) else None
    while True:
        if alpha is not None:
            q, u, lam = next(alpha)
        elif isinstance(method, Rattle):
            for weight in method.composition:
                q, u, guess = rattle_step(system, q, u, weight * method.step, guess, MAPS[method.map])
        else:
            step = lagrange_step if method.formulation == "lagrange" else hamilton_step
            q, u, lam, guess = step(system, options, q, u, guess)
        a = np.linalg.solve(system.M, system.force(u) - system.G(q).T @ lam)
        yield (q, u, *(system.index1(q, u) if method.index1_output else (a, lam)))
