"""Monitors, which end the claim of a scene: when the first of them fires on the series in minimal coordinates.

They change no motion, so that one formulation is enough.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

from crosscheck.references.modes import Law, Mode
from crosscheck.references.pieces import NODE_PLACES, first_crossing
from crosscheck.references.tree_loads import slope
from crosscheck.scene.touching import Touching

STEEPER = 4.0
"""How many times as steep as from the nodes around them distances may fall between two nodes."""


@dataclasses.dataclass(frozen=True)
class Fired:
    """A monitor: after how long (s) in a step it fires, its name, and what happened."""

    after: float
    name: str
    what: str
    touches: bool = False


class Monitors:
    """The monitors of a scene on the steps of its `LawfulTaylor`."""

    def __init__(self, series: Any) -> None:
        self.series, scene = series, series.scene
        self.watched = [each for each in scene.monitors if each.joint is not None]
        joints = [scene.joint(each.joint) for each in self.watched]
        self.places = [series.place(Law(joint, joint.type == "revolute", None, None, None)) for joint in joints]
        self.touching = Touching(scene) if len(self.watched) < len(scene.monitors) else None

    def first(self, mode: Mode, length: float, states: Callable[[np.ndarray], np.ndarray],
              times: Callable[[np.ndarray], np.ndarray], instant: float) -> Fired | None:
        """The first monitor that fires within a step, from states and times at times after its start.

        With an `instant` (s) the motion may begin at the end of a range and turn inside.
        """
        fired = []
        if self.watched:
            crossing = first_crossing(lambda tau: self._values(mode, times(tau), states(tau)), length, instant)
            if crossing is not None:
                monitor = self.watched[crossing.labels[0][0]]
                whose = monitor.joint if monitor.type == "range" else monitor.name
                fired.append(Fired(crossing.after, monitor.name, f"{whose} leaves its range"))
        if self.touching is not None:
            for after, index in self._touches(self.touching, length, states):
                monitor = self.series.scene.monitors[index]
                fired.append(Fired(after, monitor.name, f"{monitor.shapes[0]} touches {monitor.shapes[1]}", True))
        return min(fired, key=lambda each: each.after, default=None)

    def _values(self, mode: Mode, t: np.ndarray, Y: np.ndarray) -> dict[tuple[int, str], np.ndarray]:
        gaps = {}
        for k, (monitor, (coordinate, speed, sign, start)) in enumerate(zip(self.watched, self.places, strict=True)):
            q, rate = start + sign * Y[:, coordinate], sign * Y[:, speed]
            value = {"range": q, "speed": rate}.get(monitor.type)
            if value is None:
                value = self._effort(monitor.joint, mode, t, q, rate)
            for name, room, end in (("lower", value - monitor.lower, monitor.lower),
                                    ("upper", monitor.upper - value, monitor.upper)):
                if np.isfinite(end):
                    gaps[k, name] = room
        return gaps

    def _effort(self, joint: str, mode: Mode, t: np.ndarray, q: np.ndarray, rate: np.ndarray) -> np.ndarray:
        """What the actuators of a joint give."""
        total = np.zeros(len(t))
        for force in self.series.scene.forces:
            if force.joint == joint and force.is_motor and not force.law.has_modes:
                total = total - slope(force.law.potential(force.at(t)), q)
        for i, (law, part) in enumerate(zip(self.series.laws, mode, strict=True)):
            if law.joint.name == joint and law.servo is not None:
                if law.servo.period is not None:
                    total = total + part.acting
                else:
                    total = total + (self.series.bound(i, part, part.cut, rate) if part.cut
                                     else self.series.wanted(i, t, q, rate))
        return total

    def _touches(self, touching: Touching, length: float,
                 states: Callable[[np.ndarray], np.ndarray]) -> Iterator[tuple[float, int]]:
        """(when, index of the monitor) of shapes that come closer than their margin."""
        places = length * NODE_PLACES
        x, R = self.series.pose(states(places))
        low = touching.below(x, R)
        falls = np.abs(np.diff(np.nan_to_num(low), axis=0)).max(axis=0)
        for row in np.flatnonzero(~(low.min(axis=0) > STEEPER * falls)).tolist():
            def gap(tau: float, row: int = row) -> float:
                x, R = self.series.pose(states(np.array([tau])))
                return touching.gap(row, x[0], R[0])

            gaps = np.array([touching.gap(row, *pose) for pose in zip(x, R, strict=True)])
            after = _first_below(gap, places, gaps, length)
            if after is not None:
                yield after, touching.monitors[row]


def _first_below(gap: Callable[[float], float], places: np.ndarray, gaps: np.ndarray, length: float) -> float | None:
    """When a distance, known at these places of a step, falls to 0; it may have corners, so it is only bracketed."""
    from scipy.optimize import brentq, minimize_scalar

    if gaps[0] <= 0.0:
        return 0.0
    for k in range(1, len(places)):
        if gaps[k] <= 0.0:
            return float(brentq(gap, places[k - 1], places[k], xtol=1e-15 * max(1.0, length), rtol=1e-15))
        if k + 1 < len(places) and gaps[k] <= min(gaps[k - 1], gaps[k + 1]):  # nearest between two nodes
            before, after = np.diff(places[k - 1:k + 2])
            falls = (gaps[k - 1] - gaps[k]) * after / before, (gaps[k + 1] - gaps[k]) * before / after
            if gaps[k] > STEEPER * max(falls):
                continue
            lowest = minimize_scalar(gap, bounds=(places[k - 1], places[k + 1]), method="bounded",
                                     options={"xatol": 1e-9 * length})
            if lowest.fun <= 0.0:
                return float(brentq(gap, places[k - 1], lowest.x, xtol=1e-15 * max(1.0, length), rtol=1e-15))
    return None
