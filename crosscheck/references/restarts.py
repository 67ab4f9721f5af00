"""The true motion of a scene with force laws over short intervals, each started at a state that something else reached.

A state alone does not say how it goes on: a sampled servo gives what it computed before, an angle counts whole turns,
and a joint at rest may be one that a stop holds. What a state lacks is the memory of the interval before.
"""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Iterable

import numpy as np

from crosscheck.errors import Unsupported
from crosscheck.references.base import End, Piece
from crosscheck.references.modes import Mode
from crosscheck.references.pieces import Label
from crosscheck.references.tree_laws import Change, LawfulTaylor
from crosscheck.scene.model import Scene
from crosscheck.scene.states import States

NUDGE = 1e-6
"""Of coordinates and speeds, of a piece's length: steps of differences."""


@dataclasses.dataclass(frozen=True)
class Event:
    """A surface that is crossed: what jumps there, and how an error of the state moves its time."""

    after: float  # s, since the interval began
    velocity: float  # largest jump of v over the length and of w of a body, 1/s
    acceleration: float  # of a over the length and of alpha, 1/s^2
    by_pose: float  # s by which an error of one in coordinates, angles or slides over the length, moves it
    by_rate: float  # s^2, one of 1 rad/s


@dataclasses.dataclass(frozen=True)
class Interval:
    """One interval."""

    end: States  # one row
    derivatives: np.ndarray  # (ORDERS + 1,) the largest of x over the length and of R over sqrt 2
    fast: float  # rad/s, the largest angular speed of a body
    stiff: float  # 1/s, the rate of the fastest servo or stop that acts in it
    changes: tuple[float, ...]  # s, since it began: of modes, of sampled values and of pieces of functions
    events: tuple[Event, ...]  # those shortly after its end, too


@dataclasses.dataclass(frozen=True)
class Begin:
    """Where an interval begins."""

    t: float  # s
    scene: Scene  # the scene from the state there
    mode: Mode | None = None  # that comes there, if it is not that of the interval before


class Restarts:
    """Intervals of a scene, on its series of minimal coordinates; `length` (m) is that of the scene."""

    def __init__(self, series: LawfulTaylor, length: float) -> None:
        self.series, self.length = series, length

    def follow(self, begins: Iterable[Begin], lengths: Iterable[float], ahead: float
               ) -> tuple[list[Interval], list[Mode | None]]:
        """Intervals in order, and the modes that come to their begins and, last, to the end of the last one.

        An event counts up to `ahead` (s) beyond the end of an interval.
        """
        made, modes = list[Interval](), list[Mode | None]()
        before: Mode | None = None
        for begin, length in zip(begins, lengths, strict=True):
            before = begin.mode or before
            modes.append(before)
            interval, before = self._over(self._begun(begin, before), length, ahead)
            made.append(interval)
        return made, [*modes, before]

    def efforts(self, begins: Iterable[Begin]) -> np.ndarray:
        """(B, L) what all laws give, what holds coordinates included."""
        return np.array([self._efforts(self._begun(begin, begin.mode)) for begin in begins])

    def _efforts(self, begin: End) -> np.ndarray:
        series, t = self.series, np.array([begin.time])
        q, rate = (each[:, 0] for each in series.moving(t, begin.state[None]))
        efforts = series.efforts(begin.mode, begin.time, q, rate)
        held = np.array([part.held for part in begin.mode])
        return efforts + np.where(held, series.holding(begin.mode, t, begin.state[None])[:, 0], 0.0) if held.any() \
            else efforts

    def _begun(self, begin: Begin, mode: Mode | None) -> End:
        return self.series.begun(self.series.state_of(begin.scene), begin.t, mode)

    def _over(self, begin: End, length: float, ahead: float) -> tuple[Interval, Mode]:
        series, t = self.series, begin.time
        changes = list[Change]()
        pieces, end = series.advance(begin, t + length, changes)
        later = list[Change]()
        if ahead > 0.0:
            series.advance(end, t + length + ahead, later)
        last = series.table(end.mode).reshape(1, -1)
        states = series.dense_states(np.array([end.time]), lambda _: end.state[None], last)
        sizes = series.derivative_maxima(pieces).max(axis=0) / np.array([[self.length], [np.sqrt(2.0)]])
        spins = [self._rows(piece, np.array([0.0, 0.5, 1.0])).w for piece in pieces]
        modes = [begin.mode, *(change.settled.mode for change in changes)]
        return Interval(
            states, sizes.max(axis=0), float(max(np.linalg.norm(w, axis=-1).max() for w in spins)),
            max(self._stiffness(begin, mode) for mode in modes),
            tuple(change.time - t for change in [*changes, *later]),
            tuple(self._event(change, t) for change in [*changes, *later] if change.crossing is not None)), end.mode

    def _rows(self, piece: Piece, places: np.ndarray) -> States:
        assert piece.mode is not None
        tau = places * piece.length
        values = _values(piece, tau)
        return self.series.dense_states(piece.start + tau, lambda _: values, np.tile(piece.mode, (len(tau), 1)))

    def _stiffness(self, begin: End, mode: Mode) -> float:
        """The rate of the oscillation that the stiffest servo or soft stop of a mode would make."""
        rates = [0.0]
        _, S = self.series.response(begin.time, begin.state)
        for i, (law, part) in enumerate(zip(self.series.laws, mode, strict=True)):
            springs = [law.limits.stiffness] if part.pushing else []
            if law.servo is not None and not part.cut and not part.held:
                springs.append(law.servo.proportional)
            for stiffness in springs:
                rates.append(float(np.sqrt(stiffness * S[i, i])))
        return max(rates)

    @functools.cached_property
    def decay(self) -> float:
        """1/s, the fastest that dampers of servos and soft stops are at the start."""
        begin = self.series.begin
        S = np.diag(self.series.response(0.0, begin.state)[1])
        sizes = [max(0.0 if law.limits is None else law.limits.damping, 0.0 if law.servo is None else
                     law.servo.derivative) for law in self.series.laws]
        return float(np.max(S * np.array(sizes)))

    def _event(self, change: Change, t: float) -> Event:
        series = self.series
        before, after = (series.dense_states(np.array([change.time]), lambda _, y=y: y[None],  # type: ignore[misc]
                                             series.table(mode).reshape(1, -1))
                         for y, mode in ((change.state, change.mode), (change.settled.state, change.settled.mode)))
        jumps = [max(np.abs(np.linalg.norm(x, axis=-1)).max() / self.length, np.linalg.norm(turn, axis=-1).max())
                 for x, turn in ((after.v - before.v, after.w - before.w),
                                 (after.a - before.a, after.alpha - before.alpha))]  # type: ignore[operator]
        leads = [self._leads(change, label) for label in change.crossing.labels] if change.crossing else []
        pose, rate = np.max(leads, axis=0)
        return Event(change.time - t, float(jumps[0]), float(jumps[1]), float(pose), float(rate))

    def _leads(self, change: Change, label: Label) -> tuple[float, float]:
        """By how much (s) errors of one in coordinates and in rates move the time at which a surface is crossed."""
        series, state, t = self.series, change.state, change.time
        places = [place[:2] for place in series.places]
        steps = []
        for coordinate, speed in places:
            for at in (coordinate, speed):
                nudge = np.zeros(len(state))
                nudge[at] = NUDGE
                steps += [nudge, -nudge]
        values = series.machine.surfaces(change.mode, np.full(len(steps), t), state + np.array(steps))[label]
        slopes = np.abs(values[::2] - values[1::2]).reshape(-1, 2) / (2 * NUDGE)
        back = NUDGE * max(change.length, 1e-3)
        earlier = back * np.array([0.0, 1.0])
        states = _values(change.piece, change.length - earlier)
        values = series.machine.surfaces(change.mode, t - earlier, states)[label]
        falls = abs(float(values[1] - values[0])) / back
        units = [1.0 if law.turns else self.length for law in series.laws]
        if falls == 0.0:
            return 0.0, 0.0
        return (float(np.dot(slopes[:, 0], units)) / falls, float(np.dot(slopes[:, 1], units)) / falls)


def restarts_of(scene: Scene, length: float) -> Restarts:
    """The series of a scene with laws, started again anywhere."""
    from crosscheck.references import dense

    series = dense(scene).series
    if not isinstance(series, LawfulTaylor):
        raise Unsupported("its truth does not know the laws of joints")
    return Restarts(series, length)


def _values(piece: Piece, tau: np.ndarray) -> np.ndarray:
    """(T, dimension) values of a piece at times after its start."""
    values: np.ndarray = tau[:, None] ** np.arange(piece.coefficients.shape[1]) @ piece.coefficients.T
    return values
