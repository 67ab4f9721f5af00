"""What a motion in pieces leaves in the equations of the second formulation, on every piece and at every event.

On a piece it is the defect of `crosscheck.references.maximal`. At an event positions do not jump, velocities jump by
the impulses that the stops give and not otherwise, and the event is where its surface is: a coordinate comes to rest at
rest, lets go where more than what can hold it would be needed, and meets a stop at the end of its range.
"""

from __future__ import annotations

import dataclasses
import functools
import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.polynomial import legendre

from crosscheck.references.base import Piece, TruthError, polynomial, rounding, scene_length
from crosscheck.references.maximal import Maximal, tableau
from crosscheck.references.modes import RESTING, Law
from crosscheck.scene.model import Scene
from crosscheck.scene.states import States, joined

RESOLVED, HALVINGS = 1e-13, 8
"""Share of a state that the last two polynomials at the nodes of a piece may have, and how often it may be halved."""
RADIUS = math.e**2
"""A piece is this part of the radius of convergence of its series: over that an error of a rate acts on the pose."""
HOLDS = 1e-9
"""Relative: by how much more than what can hold it a coordinate may be held, or less than that let go."""
SLACK = 1e-11
"""N m or N: what stands for rounding of what holds a coordinate that needs nothing."""
BEYOND = 1e-9
"""Relative: how far beyond a rigid stop a coordinate may be."""
AT_STOP = 1e-6
"""Relative: how far from a rigid stop a coordinate is at it."""
SMOOTH = 1e-13
"""m/s and rad/s: a smaller jump of velocities is rounding."""


@dataclasses.dataclass(frozen=True)
class NodalMotion:
    """A motion at the ends and at the inner nodes of its pieces, (P, s + 2) times as rows; long ones are in parts.

    Parts are rows of their own. `held` (P, L): the coordinates that are held at rest.
    """

    pieces: np.ndarray  # (P,) the number of the piece of each row
    lengths: np.ndarray  # (P,) s
    states: States
    modes: np.ndarray  # (P, 5 L) the numbers of the laws

    @functools.cached_property
    def held(self) -> np.ndarray:
        return self.modes[:, ::5] > 0.5

    def at(self, column: int | slice) -> States:
        """The states at one place of all rows, or at a range of places, row after row."""
        index = np.arange(len(self.states.t)).reshape(len(self.lengths), -1)[:, column]
        return self.states.at(index.ravel())


def defects(equations: Maximal, series: Any, pieces: Sequence[Piece], since: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """The defects of pieces from number `since` on, each with that of the event at its start.

    Returns
    -------
    sizes (P,) : the largest of each, relative as by `Sizes`
    defects (P, 18n + h) : those at the ends

    Raises
    ------
    TruthError
        The motion breaks a law: it passes a stop, or what holds it is more than can.
    """
    first, inner = max(since - 1, 0), equations.nodes
    motion = _motion(equations, series, pieces, first)
    sampled = _sampled(equations, series, pieces)[motion.pieces]
    slopes, holding = equations.slopes(motion.at(slice(1, -1)), np.repeat(motion.held, inner, axis=0),
                                       np.repeat(sampled, inner, axis=0))
    y = equations.packed(motion.states).reshape(len(motion.lengths), inner + 2, -1)
    steps = np.einsum("ji,kid->kjd", tableau(inner)[1], slopes.reshape(len(y), inner, -1))
    found = y[:, 1:] - y[:, :1] - motion.lengths[:, None, None] * steps
    size = Sizes(equations.scene, motion.lengths)
    sizes, ends, jumps = size.of(found), found[:, -1].copy(), y[1:, 0] - y[:-1, -1]
    if equations.laws:
        events = _Events(equations, motion, sampled)
        _held_by_what_can(equations, motion, holding, events)
        sizes += _cut_elsewhere(equations, motion, size)
        missed, changes = events.gaps(jumps)
        jumps[:, 12 * equations.scene.n:18 * equations.scene.n] -= changes
        sizes[1:] += missed
    ends[1:] += jumps
    sizes[1:] += size.of(jumps, slice(1, None))
    if not since:  # it begins where the scene does
        begun = y[:1, 0] - equations.begin.state
        ends[:1] += begun
        sizes[:1] += size.of(begun, slice(1))
    starts = np.flatnonzero(np.diff(motion.pieces, prepend=first - 1))
    return (np.maximum.reduceat(sizes, starts)[since - first:], np.add.reduceat(ends, starts)[since - first:])


class Sizes:
    """Relative sizes of differences of states, of pieces of these lengths (s).

    Those of positions are over the scene's length, of attitudes as |dR|_F, of angles of hinges in rad; those of
    velocities are over the same and the larger of the scene's rate and one over the radius of convergence.
    """

    def __init__(self, scene: Scene, lengths: np.ndarray) -> None:
        self.n, self.length = scene.n, scene_length(scene)
        own = max(float(np.linalg.norm(scene.w0, axis=1).max(initial=0.0)),
                  math.sqrt(float(np.linalg.norm(scene.gravity)) / self.length))
        self.rate = np.maximum(own, 1.0 / (RADIUS * lengths))

    def of(self, gaps: np.ndarray, which: slice = slice(None)) -> np.ndarray:
        """(P,) of differences (P, 18n + h), or (P, s, 18n + h), of the pieces `which`: the largest of all."""
        rate, n = self.rate[which], self.n
        rows = gaps[:, None] if gaps.ndim == 2 else gaps
        x, R, v, w, hinges = np.split(rows, np.cumsum([3 * n, 9 * n, 3 * n, 3 * n]), axis=-1)
        sizes = [np.linalg.norm(part.reshape(*rows.shape[:2], n, part.shape[-1] // n), axis=-1).max(axis=(1, 2))
                 for part in (x, R, v, w)]
        found = np.max([sizes[0] / self.length, sizes[1], sizes[2] / self.length / rate, sizes[3] / rate,
                        np.abs(hinges).max(axis=(1, 2), initial=0.0)], axis=0)
        return np.where(np.isnan(found), np.inf, found)


def _motion(equations: Maximal, series: Any, pieces: Sequence[Piece], first: int) -> NodalMotion:
    """The motion in the pieces from number `first` on, halved until polynomials at the nodes resolve it."""
    c, coefficients = tableau(equations.nodes)[0], tableau(equations.nodes)[2]
    places = np.concatenate([[0.0], c, [1.0]])
    parts = np.array([(k, 0.0, piece.length) for k, piece in enumerate(pieces) if k >= first])
    modes = np.array([() if piece.mode is None else piece.mode for piece in pieces])
    resolved: list[tuple[np.ndarray, States]] = []
    for halvings in reversed(range(HALVINGS)):
        number = parts[:, 0].astype(int)
        tau = parts[:, 1:2] + parts[:, 2:] * places
        y = polynomial(np.array([pieces[k].coefficients for k in number])[:, None], tau)
        t = np.array([pieces[k].start for k in number])[:, None] + tau
        t[:, -1] -= rounding(t[:, -1])  # before what happens at the end: a function of time may jump there
        states = series.dense_states(t.ravel(), y.reshape(t.size, -1), np.repeat(
            modes[number], len(places), axis=0) if pieces[0].mode is not None else None)
        packed = equations.packed(states).reshape(len(parts), len(places), -1)
        tail = np.abs(coefficients[-2:] @ packed[:, 1:-1]).max(axis=1)
        fine = (tail <= RESOLVED * equations.sizes(packed.reshape(-1, packed.shape[-1]))).all(axis=1) | (not halvings)
        resolved.append((parts[fine], states.at(np.flatnonzero(np.repeat(fine, len(places))))))
        if fine.all():
            break
        number, start, length = parts[~fine].T
        parts = np.concatenate([np.stack([number, start + k * length / 2, length / 2], axis=1) for k in (0, 1)])
    parts = np.concatenate([each for each, _ in resolved])
    order = np.lexsort((parts[:, 1], parts[:, 0]))
    index = np.arange(len(parts) * len(places)).reshape(len(parts), -1)[order].ravel()
    states = joined([each for _, each in resolved]).at(index)
    number = parts[order, 0].astype(int)
    return NodalMotion(number, parts[order, 2], states, modes[number].reshape(len(parts), -1))


def _sampled(equations: Maximal, series: Any, pieces: Sequence[Piece]) -> np.ndarray:
    """(P, L) what sampled servos give in each piece, from the states at their samples."""
    given = np.zeros((len(pieces), len(equations.laws)))
    if not any(law.servo is not None and law.servo.period is not None for law in equations.laws):
        return given
    modes = np.array([piece.mode for piece in pieces])
    starts = np.array([piece.start for piece in pieces])
    states = series.dense_states(starts, np.array([piece.coefficients[:, 0] for piece in pieces]), modes)
    for i, law in enumerate(equations.laws):
        servo = law.servo
        if servo is None or servo.period is None:
            continue
        values = servo.effort(starts, *equations.moving(law, states))
        number = np.floor((starts - servo.phase + rounding(starts)) / servo.period).astype(int)
        first = {k: p for p, k in reversed(list(enumerate(number.tolist())))}
        held = servo.held or (0.0,) * (servo.delay + 1)
        given[:, i] = [values[first[k - servo.delay]] if k >= servo.delay else held[k + 1] for k in number.tolist()]
    return given


def _boxes(law: Law, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Least and greatest effort (T,) that friction and a stop can give where the coordinate is q and at rest."""
    static = law.friction.static if law.friction else 0.0
    lower, upper = np.full(len(q), -static), np.full(len(q), static)
    if law.rigid:
        near = AT_STOP * max(1.0, float(np.abs(q).max(initial=0.0)))
        lower[q >= law.limits.upper - near] = -np.inf
        upper[q <= law.limits.lower + near] = np.inf
    return lower, upper


def _held_by_what_can(equations: Maximal, motion: NodalMotion, holding: np.ndarray, events: _Events) -> None:
    """Raise `TruthError` where a coordinate is held by more than can, or is beyond its rigid stop."""
    ends = motion.at(-1)
    states, holding = joined([motion.at(slice(1, -1)), ends]), np.concatenate(
        [holding, equations.accelerations(ends, motion.held, events.sampled, events.before[:, 1].T)[2]])
    for i, law in enumerate(equations.laws):
        q, _ = equations.moving(law, states)
        held = np.concatenate([np.repeat(motion.held[:, i], equations.nodes), motion.held[:, i]])
        lower, upper = _boxes(law, q)
        room = HOLDS * (np.abs(holding[:, i]) + (law.friction.static if law.friction else 0.0)) + SLACK * max(
            1.0, float(np.abs(holding[:, i]).max(initial=0.0)))
        broken = held & ~((holding[:, i] >= lower - room) & (holding[:, i] <= upper + room))
        if law.rigid:
            broken |= np.abs(law.limits.depth(q)) > BEYOND * np.maximum(1.0, np.abs(q))
        if broken.any():
            at = int(np.flatnonzero(broken)[0])
            raise TruthError(f"{equations.scene.name!r}: joint {law.joint.name!r} breaks its laws at t = "
                             f"{states.t[at]:.6g} s: it is at {q[at]:.9g} and held by {holding[at, i]:.6g}")


def _cut_elsewhere(equations: Maximal, motion: NodalMotion, size: Sizes) -> np.ndarray:
    """(P,) what servos may have given beyond their limits between the last nodes and the ends.

    Their efforts are continuous: what those at the ends differ by from the polynomial at the nodes acted no longer.
    """
    c, _, coefficients = tableau(equations.nodes)
    left, n = np.zeros(len(motion.lengths)), equations.scene.n
    ends = legendre.legvander(np.array([-1.0, 1.0]), equations.nodes - 1) @ coefficients
    for i, law in enumerate(equations.laws):
        if not law.bounded:
            continue
        efforts = law.servo.effort(motion.states.t, *equations.moving(law, motion.states)).reshape(len(left), -1)
        beside = np.abs(efforts[:, [0, -1]] - efforts[:, 1:-1] @ ends.T).max(axis=1)
        impulses = np.zeros((len(left), len(equations.laws)))
        impulses[:, i] = beside * c[0] * motion.lengths
        change = equations.kicked(motion.at(0), impulses).reshape(len(left), n, 2, 3).swapaxes(1, 2)
        left += size.of(np.pad(change.reshape(len(left), -1), ((0, 0), (12 * n, len(equations.scene.hinges)))))
    return left


class _Events:
    """The events of a motion, between its pieces k and k + 1."""

    def __init__(self, equations: Maximal, motion: NodalMotion, sampled: np.ndarray) -> None:
        self.equations, self.motion, self.sampled = equations, motion, sampled
        self.first, self.last = motion.at(0), motion.at(-1)
        at = [[equations.moving(law, motion.at(place)) for law in equations.laws] for place in (-1, -2, 0, 1)]
        self.end, self.before, self.start, self.after = (np.array(each) for each in at)  # (L, 2, P): q and rate
        self.length = scene_length(equations.scene)

    def gaps(self, jumps: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """By how much (1 or rad) events miss their surfaces (P - 1,), and the changes (P - 1, 6n) of v and w of their
        impulses, from what the states jump by, (P - 1, 18n + h)."""
        n = self.equations.scene.n
        missed, changes = np.zeros(len(jumps)), np.zeros((len(jumps), 6 * n))
        switched = (self.motion.modes[1:] != self.motion.modes[:-1]).any(axis=1)
        for k in np.flatnonzero(switched | (np.abs(jumps[:, 12 * n:18 * n]).max(axis=1) > SMOOTH)).tolist():
            missed[k], changes[k] = self._gap(k)
        return missed, changes

    def _gap(self, k: int) -> tuple[float, np.ndarray]:
        """By how much (1 or rad) the event misses its surfaces, and the change (6n,) of v and w of its impulses."""
        change = self._impact(k)
        missed = 0.0
        for i, law in enumerate(self.equations.laws):
            held, stays = self.motion.held[k, i], self.motion.held[k + 1, i]
            if held and not stays and change is None:
                self._let_go(k, i)
            if stays and not held:
                missed += abs(self.start[i, 1, k + 1]) / self._unit(law)
            reverses = self.before[i, 1, k] * self.after[i, 1, k + 1] < 0.0 and change is None
            if law.friction and reverses and not (held or stays):
                missed += abs(self.end[i, 1, k]) / self._unit(law)
            if law.limits is not None and not law.rigid and law.limits.damping:
                forces = [float(law.limits.force(*each)) for each in (self.before[i, :, k], self.after[i, :, k + 1])]
                if forces[1] and not forces[0]:
                    q = self.end[i, 0, k]
                    missed += min(abs(q - law.limits.lower), abs(q - law.limits.upper)) / self._unit(law)
        n = self.equations.scene.n
        return missed, np.zeros(6 * n) if change is None else change.reshape(n, 2, 3).swapaxes(0, 1).ravel()

    def _unit(self, law: Law) -> float:
        return 1.0 if law.turns else self.length

    def _impact(self, k: int) -> np.ndarray | None:
        """The change (6n,) of u by the stops that are hit, None without one: Newton's law of impact, all at once."""
        laws, members, wanted, lower, upper = self.equations.laws, [], [], [], []
        hit = False
        for i, law in enumerate(laws):
            q, rate = self.end[i, :, k]
            side = 0 if not law.rigid else int(q >= law.limits.upper - BEYOND * max(1.0, abs(q))) - int(
                q <= law.limits.lower + BEYOND * max(1.0, abs(q)))
            hits = side * rate > RESTING * max(1.0, float(np.abs(self.end[:, 1, k]).max()))
            if side and (hits or self.motion.held[k, i]):
                members.append(i)
                wanted.append(rate * (1.0 + law.limits.restitution) if hits else rate)
                lower.append(-np.inf if side > 0 else 0.0)
                upper.append(0.0 if side > 0 else np.inf)
            hit = hit or bool(side and hits)
        if not hit:
            return None
        from scipy.optimize import lsq_linear

        state = self.last.at(np.full(len(members), k))
        columns = self.equations.kicked(state, np.eye(len(laws))[members])
        S = np.array([self.equations.rate_row(i, state)[0][0] for i in members]) @ columns.T
        root = np.linalg.cholesky(0.5 * (S + S.T)).T
        impulses = lsq_linear(root, -np.linalg.solve(root.T, np.array(wanted)), (lower, upper), method="bvls",
                              tol=1e-15).x
        return np.asarray(impulses @ columns)

    def _let_go(self, k: int, i: int) -> None:
        """Raise `TruthError` unless what could hold coordinate i on would be more than friction and stop give."""
        law, state = self.equations.laws[i], self.first.at(np.array([k + 1]))
        lower, upper = (float(each[0]) for each in _boxes(law, self.start[i, :1, k + 1]))
        for others in (self.motion.held[k + 1], self.motion.held[k]):
            held = others.copy()
            held[i] = True
            effort = float(self.equations.accelerations(state, held[None], self.sampled[k + 1:k + 2],
                                                        self.after[:, 1, k + 1][None])[2][0, i])
            room = HOLDS * abs(effort) + SLACK * max(1.0, abs(effort))
            against = abs(effort) <= room or effort * self.after[i, 1, k + 1] <= 0.0
            if against and (effort >= upper - room or effort <= lower + room):
                return
        raise TruthError(f"{self.equations.scene.name!r}: joint {law.joint.name!r} lets go at t = "
                         f"{self.first.t[k + 1]:.6g} s, where {effort:.6g} holds it")
