"""Truth by Taylor series (heyoka) in minimal coordinates: unit quaternions and body angular velocities of a tree.

Derivation. A spherical joint passes a force and no torque, so the part of the tree outboard of it acts on its parent
as F = M A + b, with A the acceleration of the joint, M a 3x3 matrix and b a bias: block LDL^T elimination of the
mass matrix in the angular velocities, leaves first. With levers r to the centre of mass and l_c to the outboard
joints, everything in body axes, the balance of moments about the inboard joint gives

    I alpha + K A + tau = 0,    I = J - m r^ r^ - sum l_c^ M_c l_c^,    K = m r^ + sum l_c^ M_c,
    tau = w x J w + r x f_0 + sum l_c x f_c,  f_0 = m (w x (w x r) - g),  f_c = M_c (w x (w x l_c)) + b_c,

and the balance of forces M = m + sum M_c - K^T I^-1 K, b = f_0 + sum f_c - K^T I^-1 tau.
"""

from __future__ import annotations

import dataclasses
import functools
import math

import numpy as np

from crosscheck.references.base import TruthError
from crosscheck.references.generic import (
    add,
    apply,
    apply_transposed,
    combine,
    congruent,
    conjugate,
    cross,
    factor_symmetric,
    hat,
    multiply,
    quaternion_product,
    rotation,
    scale,
    solve_factored,
    transpose,
)
from crosscheck.references.tree import Link, spherical_tree
from crosscheck.scene import GROUND, Scene, rotation_from_quaternion
from crosscheck.states import States

SOURCE = "Taylor series (heyoka), minimal coordinates"
ORDERS = 10  # highest derivative whose maximum is recorded
SUBPOINTS = 4  # derivatives are scanned this many times a step: k-th ones vary over 1/k of the convergence radius
DRIFT = 1e-13  # quaternion norms stay within a few hundred roundings; more means a defect, not round-off


def gyroscopic(inertia, w):
    """w x J w, body axes."""
    return cross(w, apply(inertia, w))


def centripetal(w, lever):
    """w x (w x lever), body axes."""
    return cross(w, cross(w, lever))


def weight(mass, gravity):
    """m g in the axes of `gravity`."""
    return scale(mass, gravity)


@dataclasses.dataclass
class _Reduced:
    """A body with all that hangs on it: F = mass A + bias at its reference point, alpha = -(rest + coupling A)."""

    rest: list
    coupling: list
    mass: list
    bias: list


def _reduce(link: Link, w, gravity, children: list[tuple]) -> _Reduced:
    """Eliminate the angular acceleration of a body; children are (lever, mass, bias) in its axes."""
    r = hat(link.lever)
    mass = [[link.mass if i == j else 0.0 for j in range(3)] for i in range(3)]
    coupling = [[link.mass * entry for entry in row] for row in r]
    inertia = combine(link.inertia, -link.mass, multiply(r, r))
    bias = add(scale(link.mass, centripetal(w, link.lever)), scale(-1.0, weight(link.mass, gravity)))
    torque = add(gyroscopic(link.inertia, w), cross(link.lever, bias))
    for lever, outer_mass, outer_bias in children:
        force = add(apply(outer_mass, centripetal(w, lever)), outer_bias)
        torque, bias = add(torque, cross(lever, force)), add(bias, force)
        moved = multiply(hat(lever), outer_mass)
        coupling, mass = combine(coupling, 1.0, moved), combine(mass, 1.0, outer_mass)
        inertia = combine(inertia, -1.0, multiply(moved, hat(lever)))
    factors = factor_symmetric(inertia)
    rest = solve_factored(factors, torque)
    solved = transpose([solve_factored(factors, column) for column in transpose(coupling)])
    return _Reduced(rest, solved, combine(mass, -1.0, multiply(transpose(coupling), solved)),
                    add(bias, scale(-1.0, apply_transposed(coupling, rest))))


def accelerations(links: tuple[Link, ...], gravity, q: dict, w: dict) -> tuple[dict, dict]:
    """Angular accelerations and accelerations of the reference points, by body, both in body axes.

    `q` and `w` map bodies to quaternions and body angular velocities over any number type.
    """
    reduced: dict[int, _Reduced] = {}
    relative = {}
    hanging: dict[int, list] = {link.body: [] for link in links}
    for link in reversed(links):
        body = link.body
        reduced[body] = _reduce(link, w[body], apply_transposed(rotation(q[body]), gravity), hanging[body])
        if link.parent not in (None, GROUND):
            turn = rotation(quaternion_product(conjugate(q[link.parent]), q[body]))
            hanging[link.parent].append((link.inboard, congruent(turn, reduced[body].mass),
                                         apply(turn, reduced[body].bias)))
            relative[body] = turn
    alpha: dict[int, list] = {}
    reference: dict[int, list] = {}
    for link in links:
        body, part = link.body, reduced[link.body]
        if link.parent is None:  # no force at the reference point of a free root
            reference[body] = scale(-1.0, solve_factored(factor_symmetric(part.mass), part.bias))
        elif link.parent == GROUND:
            reference[body] = [0.0, 0.0, 0.0]
        else:
            at_joint = add(reference[link.parent], cross(alpha[link.parent], link.inboard),
                           centripetal(w[link.parent], link.inboard))
            reference[body] = apply_transposed(relative[body], at_joint)
        alpha[body] = scale(-1.0, add(part.rest, apply(part.coupling, reference[body])))
    return alpha, reference


def quaternion_rate(q, w):
    """dq/dt = q (0, w) / 2."""
    return scale(0.5, quaternion_product(q, [0.0, *w]))


class Taylor:
    """The compiled Taylor integrator of a scene; `run` may be called with any initial state.

    State vector: quaternions (n, 4), body angular velocities (n, 3), then position and velocity (world) of each free
    root, in the order of bodies.
    """

    def __init__(self, scene: Scene) -> None:
        import heyoka

        self.scene = scene
        self.links = spherical_tree(scene)
        self.free = sorted(link.body for link in self.links if link.parent is None)
        n = scene.n
        names = [f"q{i}_{k}" for i in range(n) for k in range(4)] + [f"w{i}_{k}" for i in range(n) for k in range(3)]
        names += [f"{kind}{i}_{k}" for i in self.free for kind in "xv" for k in range(3)]
        symbols = list(heyoka.make_vars(*names))
        q, w, velocities = self._split(symbols)
        alpha, reference = accelerations(self.links, scene.gravity.tolist(), q, w)
        rates = [rate for i in range(n) for rate in quaternion_rate(q[i], w[i])]
        rates += [rate for i in range(n) for rate in alpha[i]]
        for i in self.free:
            rates += [*velocities[i], *apply(rotation(q[i]), reference[i])]
        rates = [heyoka.expression(rate) if isinstance(rate, float) else rate for rate in rates]
        self.initial = self._initial()
        self._integrator = heyoka.taylor_adaptive(list(zip(symbols, rates, strict=True)), self.initial.tolist(),
                                                  compact_mode=True, high_accuracy=True)
        self._success = heyoka.taylor_outcome.time_limit

    def _split(self, state) -> tuple[dict, dict, dict]:
        """Quaternions, angular velocities, and velocities of free roots, by body, of a state sequence."""
        n = self.scene.n
        q = {i: [*state[4 * i:4 * i + 4]] for i in range(n)}
        w = {i: [*state[4 * n + 3 * i:4 * n + 3 * i + 3]] for i in range(n)}
        return q, w, {i: [*state[7 * n + 6 * k + 3:7 * n + 6 * k + 6]] for k, i in enumerate(self.free)}

    def _initial(self) -> np.ndarray:
        bodies = self.scene.bodies
        parts = [body.attitude / np.linalg.norm(body.attitude) for body in bodies]
        parts += [body.angular_velocity for body in bodies]
        for i in self.free:
            parts += [bodies[i].position, bodies[i].velocity]
        return np.concatenate(parts)

    def run(self, initial: np.ndarray | None = None, times: np.ndarray | None = None,
            coefficients: list | None = None) -> np.ndarray:
        """State vectors (T, dimension) at `times`, by default the scene's output times, from the scene's start.

        `coefficients` collects, for each step, (step length, Taylor coefficients (dimension, order + 1)).
        """
        integrator = self._integrator
        integrator.time = 0.0
        integrator.state[:] = self.initial if initial is None else initial

        def keep(after):
            coefficients.append((after.last_h, after.tc.copy()))
            return True

        options = {} if coefficients is None else {"callback": keep}
        outcome, *_, states = integrator.propagate_grid(self.scene.t if times is None else times, **options)
        if outcome != self._success:
            raise TruthError(f"{SOURCE}: integration of {self.scene.name!r} ended with {outcome}")
        return states

    def positions(self, attitudes: np.ndarray, roots: np.ndarray) -> np.ndarray:
        """Centres of mass (..., n, 3), world, from attitudes (..., n, 3, 3) and free roots (..., number free, 3)."""
        points, x = {}, np.empty(attitudes.shape[:-1])
        for link in self.links:
            if link.parent is None:
                points[link.body] = roots[..., self.free.index(link.body), :]
            elif link.parent == GROUND:
                points[link.body] = np.array(link.inboard)
            else:
                points[link.body] = points[link.parent] + attitudes[..., link.parent, :, :] @ np.array(link.inboard)
            x[..., link.body, :] = points[link.body] + attitudes[..., link.body, :, :] @ np.array(link.lever)
        return x

    def pose(self, states: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Positions (T, n, 3) and attitudes (T, n, 3, 3) of state vectors; quaternions are normalised here only."""
        n = self.scene.n
        q = states[:, :4 * n].reshape(-1, n, 4)
        norms = np.linalg.norm(q, axis=-1, keepdims=True)
        if np.max(np.abs(norms - 1.0)) > DRIFT:
            raise TruthError(f"{SOURCE}: quaternions of {self.scene.name!r} drift by {np.max(np.abs(norms - 1.0)):.1e}")
        attitudes = rotation_from_quaternion(q / norms)
        return self.positions(attitudes, states[:, 7 * n:].reshape(len(states), -1, 6)[:, :, :3]), attitudes

    def states(self, states: np.ndarray) -> States:
        """Everything at the output times, with accelerations from these equations."""
        x, attitudes = self.pose(states)
        q, w, velocities = self._split(states.T)
        alpha, reference = accelerations(self.links, self.scene.gravity.tolist(), q, w)
        v, a = np.empty_like(x), np.empty_like(x)
        flat = {kind: {i: _stack(values[i], len(x)) for i in range(self.scene.n)}
                for kind, values in (("w", w), ("alpha", alpha), ("A", reference))}
        joint_v = {}
        for link in self.links:
            i, parent = link.body, link.parent
            turn = attitudes[:, i]
            if parent is None:
                joint_v[i] = _stack(velocities[i], len(x))
            elif parent == GROUND:
                joint_v[i] = np.zeros((len(x), 3))
            else:
                joint_v[i] = joint_v[parent] + _turned(attitudes[:, parent], np.cross(flat["w"][parent], link.inboard))
            spin = np.cross(flat["w"][i], link.lever)
            v[:, i] = joint_v[i] + _turned(turn, spin)
            a[:, i] = _turned(turn, flat["A"][i] + np.cross(flat["alpha"][i], link.lever)
                              + np.cross(flat["w"][i], spin))
        w_all, alpha_all = (np.stack([flat[kind][i] for i in range(self.scene.n)], axis=1) for kind in ("w", "alpha"))
        return States(self.scene.t, x, attitudes, v, w_all, a, alpha_all)

    def derivative_maxima(self, coefficients: list) -> tuple[np.ndarray, np.ndarray]:
        """Largest |d^k x/dt^k| and |d^k R/dt^k|_F over the run and the bodies, k = 0 ... ORDERS.

        Each step's Taylor polynomials are expanded anew at SUBPOINTS points of the step; R is a product of two
        series. The maximum over this grid of points misses the true one by a few percent at the highest orders.
        """
        n = self.scene.n
        series = np.concatenate([shifted(tc, h * k / SUBPOINTS) for h, tc in coefficients
                                 for k in range(SUBPOINTS)]).reshape(-1, len(self.initial), ORDERS + 1)
        q = np.moveaxis(series[:, :4 * n].reshape(-1, n, 4, ORDERS + 1), 2, 0)
        entries = rotation([_Series(component) for component in q])
        attitudes = np.stack([np.stack([entry.c for entry in row], axis=2) for row in entries], axis=2)
        attitudes = np.moveaxis(attitudes, -1, 1)  # (points, order, n, 3, 3)
        roots = np.moveaxis(series[:, 7 * n:], -1, 1)
        x = self.positions(attitudes, roots.reshape(*roots.shape[:2], -1, 6)[..., :3])
        x[:, 1:] -= self.positions(np.zeros((n, 3, 3)), np.zeros((len(self.free), 3)))  # anchors on the ground stand
        factorials = np.array([float(math.factorial(k)) for k in range(ORDERS + 1)])
        return (factorials * np.linalg.norm(x, axis=-1).max(axis=(0, 2)),
                factorials * np.linalg.norm(attitudes, axis=(-2, -1)).max(axis=(0, 2)))


@dataclasses.dataclass
class _Series:
    """Truncated power series, coefficients along the last axis, with the operations that `rotation` needs."""

    c: np.ndarray

    def __add__(self, other):
        return _Series(self.c + other.c)

    def __sub__(self, other):
        return _Series(self.c - other.c)

    def __mul__(self, other):
        product = np.zeros_like(self.c)
        for k in range(product.shape[-1]):
            product[..., k] = np.sum(self.c[..., :k + 1] * other.c[..., k::-1], axis=-1)
        return _Series(product)

    def __rmul__(self, factor):
        return _Series(factor * self.c)


@functools.cache
def _binomials(size: int) -> np.ndarray:
    return np.array([[math.comb(j, k) for k in range(ORDERS + 1)] for j in range(size)], dtype=float)


def shifted(tc: np.ndarray, tau: float) -> np.ndarray:
    """Coefficients 0 ... ORDERS about t0 + tau of polynomials (dimension, order + 1) about t0."""
    size = tc.shape[-1]
    powers = np.subtract.outer(np.arange(size), np.arange(ORDERS + 1))
    return tc @ (_binomials(size) * np.where(powers >= 0, float(tau) ** np.maximum(powers, 0), 0.0))


def _stack(entries, length: int) -> np.ndarray:
    """Columns of a vector whose entries are arrays over time or constants, (length, 3)."""
    return np.stack([np.broadcast_to(entry, (length,)) for entry in entries], axis=-1)


def _turned(attitudes: np.ndarray, vectors: np.ndarray) -> np.ndarray:
    return np.einsum("tij,tj->ti", attitudes, vectors)
