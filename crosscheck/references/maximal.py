"""Second formulation of the truth: the index-1 equations of `crosscheck.scene.mechanics`, in maximal coordinates.

A motion in pieces solves them if its defects, (14.1) of docs/theory.md, vanish: on a piece from t to t + h, with the
nodes c_i and the coefficients a_ji of Gauss' collocation method,

    defect_j = y(t + c_j h) - y(t) - h sum of a_ji f(t + c_i h, y(t + c_i h)),    y = (x, R, v, w, angles of hinges).

The right sides f of all pieces are evaluated at once, each at the states of the motion itself, so that no error grows.
Laws of joints are evaluated from the state, without the modes of the motion, but for what is held at rest: that is a
row more, whose multiplier has to be one that friction or the stop can give. Sources: E. Hairer, C. Lubich, G. Wanner,
Geometric Numerical Integration, II.1.3; A. Dutt, L. Greengard, V. Rokhlin, BIT 40 (2000) 241, for the residual.

`Maximal.run` solves defect = 0 by fixed-point iteration instead, piece by piece. It has no laws.
"""

from __future__ import annotations

import functools
import math

import numpy as np
from numpy.polynomial import legendre

from crosscheck.errors import Unsupported, check_time
from crosscheck.references.base import LONGEST, End, Piece, Series, TruthError, scene_length
from crosscheck.references.modes import Law, laws_of
from crosscheck.scene import mechanics
from crosscheck.scene.armature import rate_row
from crosscheck.scene.coordinates import hinge_angles, history, rates, starting
from crosscheck.scene.model import Scene
from crosscheck.scene.states import States
from crosscheck.scene.vectors import hat

NODES = 14
"""Of Gauss' method: a piece of a Taylor series is e^-2 of its radius of convergence, so that they leave 1e-16."""
AT_ONCE = 10_000_000
"""Entries of dense matrices that are made at once; more need memory and save no time."""
SETTLED, SWEEPS = 4e-16, 40
"""Relative change at which the fixed-point iteration ends, and the most iterations before the piece is halved."""
TAIL = 1e-14
"""Share of a state by which the last polynomials of its slope change it over a piece: the ends are far better."""
DIFFERENCE = 1e-6
"""Step of the central differences of the rates, relative to entries of order one."""


@functools.cache
def tableau(nodes: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Nodes c (s,) in 0 ... 1, a (s + 1, s), its last row the weights, and the Legendre coefficients (s, s) of values
    at the nodes."""
    c = 0.5 * (1.0 + legendre.leggauss(nodes)[0])
    coefficients = np.linalg.inv(legendre.legvander(2 * c - 1, nodes - 1))
    integrals = [legendre.legint(row, lbnd=-1) for row in np.eye(nodes)]
    ends = np.append(c, 1.0)
    a = np.stack([0.5 * legendre.legval(2 * ends - 1, each) for each in integrals], axis=1) @ coefficients
    return c, a, coefficients


class Maximal:
    """The equations of a scene; states have a leading time axis."""

    source = "index-1 equations (NumPy), maximal coordinates"

    def __init__(self, scene: Scene, nodes: int = NODES) -> None:
        self.scene, self.laws, self.index1 = scene, laws_of(scene), mechanics.Index1(scene)
        self.nodes, self.chunk = nodes, max(nodes, AT_ONCE // (36 * scene.n**2))

    def moving(self, law: Law, states: States) -> tuple[np.ndarray, np.ndarray]:
        """Coordinate of a law and its rate, (T,)."""
        both = history(self.scene, law.joint, states)
        if both.position.ndim == 1:
            return both.position, both.velocity
        return both.position[:, law.number], both.velocity[:, law.number]

    def efforts(self, states: States, held: np.ndarray, sampled: np.ndarray, ways: np.ndarray | None = None
                ) -> np.ndarray:
        """What the laws give, (T, L) N m or N; the arguments are those of `accelerations`."""
        efforts = np.zeros((len(states.t), len(self.laws)))
        for i, law in enumerate(self.laws):
            q, rate = self.moving(law, states)
            if law.friction:
                efforts[:, i] += np.where(held[:, i], 0.0, law.friction.force(rate if ways is None else ways[:, i]))
            if law.limits is not None and not law.rigid:
                efforts[:, i] += law.limits.force(q, rate)
            if law.servo is not None:
                efforts[:, i] += sampled[:, i] if law.servo.period is not None else law.servo.effort(states.t, q, rate)
        return efforts

    def accelerations(self, states: States, held: np.ndarray | None = None, sampled: np.ndarray | None = None,
                      ways: np.ndarray | None = None) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """a (T, n, 3) world, alpha (T, n, 3) body axes, and the efforts (T, L) that hold, at states.

        held : (T, L) which coordinates are held at rest; by default none
        sampled : (T, L) what sampled servos give
        ways : (T, L) in which direction each moves, for its friction; by default that of its rate
        """
        T, L = len(states.t), len(self.laws)
        held = np.zeros((T, L), bool) if held is None else held
        sampled = np.zeros((T, L)) if sampled is None else sampled
        a, alpha, holding = np.zeros((T, self.scene.n, 3)), np.zeros((T, self.scene.n, 3)), np.zeros((T, L))
        patterns, which = np.unique(held, axis=0, return_inverse=True) if L else (held[:1], np.zeros(T, int))
        for k, pattern in enumerate(patterns):
            rows = np.flatnonzero(which.ravel() == k)
            for part in np.array_split(rows, math.ceil(len(rows) / self.chunk)):
                some = states.at(part)
                a[part], alpha[part], holding[np.ix_(part, np.flatnonzero(pattern))] = self._accelerations(
                    some, held[part], sampled[part], None if ways is None else ways[part], np.flatnonzero(pattern))
        return a, alpha, holding

    def _accelerations(self, states: States, held: np.ndarray, sampled: np.ndarray, ways: np.ndarray | None,
                       rest: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """As `accelerations`, of states at which the coordinates `rest` are held."""
        angles = mechanics.torsion_angles(self.scene, states)
        efforts = [(law.joint, not law.turns, effort) for law, effort in zip(
            self.laws, self.efforts(states, held, sampled, ways).T, strict=True)] if self.laws else None
        state = states.x, states.R, states.v, states.w
        if not len(rest):
            return (*self.index1(*state, angles, states.t, efforts)[:2], np.zeros((len(states.t), 0)))
        forces = mechanics.applied_forces(self.scene, *state, angles, states.t, efforts)
        G, gamma = self._rows(states, rest)
        found, lam = self.index1.solver(G, independent=not self.index1.closing)(forces, gamma)
        a, alpha = np.split(found.reshape(len(found), -1, 6), 2, axis=-1)
        return a, alpha, -lam[:, lam.shape[1] - len(rest):]

    def _rows(self, states: States, rest: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Rows (T, m, .) of joints, of rotors and of the rates of the laws `rest`, and their drifts (T, m)."""
        state = states.x, states.R, states.v, states.w
        G, bias = self.index1.rows(*state)
        gamma = np.concatenate([self.index1.constraints.gamma(*state, states.t), bias], axis=1)
        for i in rest:
            row, drift = self.rate_row(i, states)
            row = np.pad(row, ((0, 0), (0, G.shape[2] - row.shape[1])))
            G, gamma = np.concatenate([G, row[:, None]], axis=1), np.concatenate([gamma, drift[:, None]], axis=1)
        return G, gamma

    def rate_row(self, i: int, states: States) -> tuple[np.ndarray, np.ndarray]:
        """S (T, 6n) and s (T,) of the coordinate of law i: its rate is S u, its acceleration S du/dt + s."""
        law = self.laws[i]
        return rate_row(law.joint, "turn" if law.turns else "slide", self.scene, *(
            getattr(states, name) for name in "xRvw"))

    def kicked(self, states: States, impulses: np.ndarray) -> np.ndarray:
        """Changes (T, 6n) of u by impulses (T, L) along the coordinates of laws; joints stay closed."""
        push = sum((self.rate_row(i, states)[0] * impulses[:, i, None] for i in range(len(self.laws))),
                   np.zeros((len(states.t), 6 * self.scene.n)))
        G, gamma = self._rows(states, np.zeros(0, int))
        return self.index1.solver(G, independent=not self.index1.closing)(push, np.zeros_like(gamma))[0]

    # States as vectors y: x, R, v, w of all bodies and the angles of hinges.

    def packed(self, states: States) -> np.ndarray:
        """(T, 18n + h)"""
        assert states.hinges is not None
        return np.concatenate([getattr(states, name).reshape(len(states.t), -1) for name in ("x", "R", "v", "w")]
                              + [states.hinges], axis=1)

    def unpacked(self, t: np.ndarray, y: np.ndarray) -> States:
        """The states of vectors (T, 18n + h)."""
        n, T = self.scene.n, len(y)
        x, R, v, w, hinges = np.split(y, np.cumsum([3 * n, 9 * n, 3 * n, 3 * n]), axis=1)
        return States(t, x.reshape(T, n, 3), R.reshape(T, n, 3, 3), v.reshape(T, n, 3), w.reshape(T, n, 3),
                      hinges=hinges)

    def slopes(self, states: States, held: np.ndarray | None = None, sampled: np.ndarray | None = None
               ) -> tuple[np.ndarray, np.ndarray]:
        """dy/dt (T, 18n + h), and the efforts that hold, (T, L)."""
        a, alpha, holding = self.accelerations(states, held, sampled)
        angles = {name for name, _ in self.scene.hinges}
        turning = {joint.name: rates(joint, states).reshape(len(states.t), -1) for joint in self.scene.joints
                   if joint.name in angles}
        hinges = np.array([turning[name][:, k] for name, k in self.scene.hinges]).reshape(-1, len(states.t)).T
        return self.packed(States(states.t, states.v, states.R @ hat(states.w), a, alpha, hinges=hinges)), holding

    def sizes(self, y: np.ndarray) -> np.ndarray:
        """(18n + h,) the largest entries of each kind of rows y: the scene's length and 1 of turns at least.

        A rate is at least that of the other kind over the length, since one of two kinds may be rounding alone, as
        where bodies slide and do not turn, and what gravity gives over the length, for a scene at rest.
        """
        n, length = self.scene.n, scene_length(self.scene)
        counts = [3 * n, 9 * n, 3 * n, 3 * n, len(self.scene.hinges)]
        x, R, v, w, hinges = (float(part.max(initial=0.0)) for part in np.split(
            np.abs(y).max(axis=0), np.cumsum(counts[:-1])))
        speed = max(v, w * length, math.sqrt(float(np.linalg.norm(self.scene.gravity)) * length), 1e-300)
        return np.repeat([max(x, length), max(R, 1.0), speed, speed / length, max(hinges, 1.0)], counts)

    # Runs.

    @property
    def begin(self) -> End:
        """The start of the scene."""
        return End(self.state_of(self.scene))

    def state_of(self, start: Scene) -> np.ndarray:
        """(18n + h,) the start of a scene of this system, with the whole turns of its hinges."""
        begun = starting(start)
        begun.hinges = hinge_angles(start, begun)
        state: np.ndarray = self.packed(begun)[0]
        return state

    def advance(self, end: End, until: float) -> tuple[list[Piece], End]:
        """The pieces from an end to `until` or beyond, and their end.

        Raises
        ------
        Unsupported
            The scene has laws of joints.
        TruthError
            The iteration does not settle, as where the rows of a loop lose rank.
        """
        if self.laws:
            raise Unsupported(f"truth of {self.scene.name!r}: dry friction, limits and servos need heyoka, which is "
                              "not installed")
        _, a, coefficients = tableau(self.nodes)
        pieces, t, y, h = list[Piece](), end.time, end.state, end.rest or 0.1
        knots, guess, powers = self.scene.knots, None, np.arange(self.nodes)
        while t < until:
            check_time()
            stop = min([t + LONGEST, *(knot for knot in knots if knot > t)])
            length = min(h, stop - t)
            slopes, tail = self._solved(t, y, length, guess)
            if slopes is None or tail > 10 * TAIL:
                if length < 1e-9 * max(1.0, t):
                    raise TruthError(f"{self.source}: {self.scene.name!r} at t = {t:.6g} s: no step is short enough")
                h, guess = 0.5 * length, None
                continue
            series = (_powers(self.nodes) @ (coefficients @ slopes)).T / (powers + 1) / length**powers
            pieces.append(Piece(t, 0.0, length, np.concatenate([y[:, None], series], axis=1)))
            y = self._orthogonal(y + length * a[-1] @ slopes)
            t = stop if length == stop - t else t + length
            h = length * float(np.clip(0.9 * (TAIL / max(tail, 1e-300)) ** (1 / self.nodes), 0.3, 1.5))
            guess = slopes[-1]
        return pieces, End(y, t, h)

    def _solved(self, t: float, y: np.ndarray, h: float, slope: np.ndarray | None
                 ) -> tuple[np.ndarray | None, float]:
        """Slopes (s, dimension) at the nodes where the defects vanish, None if they do not, and the share of their last
        polynomials in the state."""
        c, a, coefficients = tableau(self.nodes)
        times = t + c * h
        slopes = np.tile(self.slopes(self.unpacked(times[:1], y[None]))[0] if slope is None else slope, (len(c), 1))
        last = math.inf
        for _ in range(SWEEPS):
            with np.errstate(over="ignore", invalid="ignore"):
                stages = y + h * a[:-1] @ slopes
                found, size = self.slopes(self.unpacked(times, stages))[0], self.sizes(stages)
            change = float(np.abs(h * (found - slopes) / size).max())
            slopes = found
            if not np.isfinite(change) or change > 1e3:
                return None, math.inf
            if change <= SETTLED or (change >= last and last < 1e3 * SETTLED):
                return slopes, float(np.abs(h * (coefficients @ slopes)[-2:] / size).max())
            last = change
        return None, math.inf

    def _orthogonal(self, y: np.ndarray) -> np.ndarray:
        """The state with attitudes orthogonal to rounding, by one step of Newton's method for the polar factor."""
        n = self.scene.n
        R = y[..., 3 * n:12 * n].reshape(*y.shape[:-1], n, 3, 3)
        y = y.copy()
        y[..., 3 * n:12 * n] = (0.5 * R @ (3 * np.eye(3) - np.swapaxes(R, -1, -2) @ R)).reshape(*y.shape[:-1], -1)
        return y

    def dense_states(self, t: np.ndarray, y: np.ndarray, modes: np.ndarray | None = None) -> States:
        """States with accelerations at times t from state vectors (T, 18n + h)."""
        states = self.unpacked(t, self._orthogonal(y))
        states.a, states.alpha, _ = self.accelerations(states)
        return states

    def run(self, times: np.ndarray | None = None, begin: States | None = None) -> States:
        """States at `times`, by default the output times, from the start of the scene, or one row, at the first."""
        times = self.scene.t if times is None else times
        start = self.state_of(self.scene) if begin is None else self.packed(begin)[0]
        pieces, _ = self.advance(End(start, float(times[0])), float(times[-1]))
        return self.dense_states(times, Series(pieces)(times) if pieces else np.tile(start, (len(times), 1)))


@functools.cache
def _powers(nodes: int) -> np.ndarray:
    """(s, s) coefficients of powers of tau in 0 ... 1 of the Legendre polynomials of 2 tau - 1."""
    shift = np.polynomial.Polynomial([-1.0, 2.0])
    columns = [np.polynomial.Polynomial(legendre.leg2poly(row))(shift).coef for row in np.eye(nodes)]
    return np.stack([np.pad(column, (0, nodes - len(column))) for column in columns], axis=1)


def fastest(scene: Scene) -> float:
    """Rate (1/s) of the fastest decay or oscillation of a scene with springs, at its start; 0 without springs."""
    if not any(force.is_spring for force in scene.loads):
        return 0.0
    equations = Maximal(scene.lawless)
    y = equations.begin.state
    moved = np.concatenate([y + sign * DIFFERENCE * np.eye(len(y)) for sign in (1.0, -1.0)])
    slopes = equations.slopes(equations.unpacked(np.zeros(len(moved)), moved))[0]
    return float(np.abs(np.linalg.eigvals((slopes[:len(y)] - slopes[len(y):]).T / (2 * DIFFERENCE))).max())
