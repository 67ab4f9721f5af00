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
from crosscheck.references.base import End, polynomial
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


class Interval:
    """The true motion in one interval, on the series of minimal coordinates; `length` (m) is that of the scene."""

    def __init__(self, series: LawfulTaylor, length: float, begin: End, until: float) -> None:
        self.series, self.length, self.t, self.changes = series, length, begin.time, list[Change]()
        self.pieces, self.reached = series.advance(begin, until, self.changes)

    @property
    def crossings(self) -> list[Change]:
        """Changes of modes that no clock makes."""
        return [change for change in self.changes if change.crossing is not None]

    @functools.cached_property
    def end(self) -> States:
        """The state at its end, one row."""
        return self.series.dense_states(np.array([self.reached.time]), self.reached.state[None],
                                        self.series.table(self.reached.mode).reshape(1, -1))

    @property
    def acceleration(self) -> float:
        """The largest |a| over the length, or |alpha| + |w|^2, 1/s^2, at the ends and in the middle of its pieces."""
        y = np.array([polynomial(piece.coefficients, piece.length * np.array([0.0, 0.5, 1.0]))
                      for piece in self.pieces])
        modes = np.repeat(np.array([piece.mode for piece in self.pieces]), 3, axis=0)
        states = self.series.dense_states(np.zeros(len(modes)) + self.t, y.reshape(len(modes), -1), modes)
        assert states.a is not None
        assert states.alpha is not None
        turning = np.linalg.norm(states.alpha, axis=-1) + np.linalg.norm(states.w, axis=-1) ** 2
        return max(float(np.linalg.norm(states.a, axis=-1).max()) / self.length, float(turning.max()))

    @property
    def events(self) -> tuple[Event, ...]:
        """What jumps in it, and when."""
        return tuple(self._event(change) for change in self.crossings)

    def _event(self, change: Change) -> Event:
        series = self.series
        before, after = (series.dense_states(np.array([change.time]), y[None], series.table(mode).reshape(1, -1))
                         for y, mode in ((change.state, change.mode), (change.resumed.state, change.resumed.mode)))
        jumps = [max(np.abs(np.linalg.norm(x, axis=-1)).max() / self.length, np.linalg.norm(turn, axis=-1).max())
                 for x, turn in ((after.v - before.v, after.w - before.w),
                                 (after.a - before.a, after.alpha - before.alpha))]  # type: ignore[operator]
        leads = [self._leads(change, label) for label in change.crossing.labels] if change.crossing else []
        pose, rate = np.max(leads, axis=0)
        return Event(change.time - self.t, float(jumps[0]), float(jumps[1]), float(pose), float(rate))

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
        states = polynomial(change.piece.coefficients, change.length - earlier)
        values = series.machine.surfaces(change.mode, t - earlier, states)[label]
        falls = abs(float(values[1] - values[0])) / back
        units = [1.0 if law.turns else self.length for law in series.laws]
        if falls == 0.0:
            return 0.0, 0.0
        return (float(np.dot(slopes[:, 0], units)) / falls, float(np.dot(slopes[:, 1], units)) / falls)


def follow(scene: Scene, length: float, begins: Iterable[tuple[float, Scene]], lengths: Iterable[float]
           ) -> tuple[list[Interval], list[Mode | None]]:
    """Intervals of a scene with laws in order, and the modes that come to their begins and to the last one's end.

    `begins`: times (s) and the scene from the state there; `lengths`: s.

    Raises
    ------
    Unsupported
        The truth of the scene does not know the laws of joints, as without heyoka.
    """
    from crosscheck.references import dense

    series, made, modes = dense(scene).series, list[Interval](), list[Mode | None]([None])
    if not isinstance(series, LawfulTaylor):
        raise Unsupported("its truth does not know the laws of joints")
    for (t, start), duration in zip(begins, lengths, strict=True):
        made.append(Interval(series, length, series.begun(series.state_of(start), t, modes[-1]), t + duration))
        modes.append(made[-1].reached.mode)
    return made, modes
