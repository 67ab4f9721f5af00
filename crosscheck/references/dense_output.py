"""Truth of a system at any time: a series in pieces, prolonged on demand, and what confirms it.

One computation serves every duration and every choice of output times. Three grids belong to the pieces, and so to the
system alone. Growth of perturbations is measured at GROWTH_POINTS points of a piece. The second formulation stops at
the middle and the end of each piece. Derivatives are maxima over each piece.

Why two points of a piece are enough for the times between. A step is at most e^-2 of the radius of convergence, and the
remainder of its series, which grows with the power of its order, is largest at the end of the piece. The difference of
two formulations is analytic over the same radius: its k-th term is at most e^-2k of its largest value there, and a
piece begins, too, at a point of comparison. The cubic term, the first that three points leave open, adds at most
e^-6, a quarter of a percent, to the largest difference found. `tests/references/test_dense.py` looks at random times.
"""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable
from math import ceil
from typing import Any

import numpy as np

from crosscheck.errors import Unsupported
from crosscheck.references.agreement import (
    FLOOR,
    ROUNDOFF,
    USABLE,
    Agreement,
    Solved,
    agree,
    difference,
    natural_coordinates,
)
from crosscheck.references.base import (
    GROWN,
    ORDERS,
    Chaotic,
    End,
    Piece,
    Reference,
    TruthError,
    piece_of,
    rounding,
    values_at,
)
from crosscheck.references.conditioning import HORIZON_GROWTH, growth_over, sampled_growth
from crosscheck.references.natural import Natural
from crosscheck.references.pieces import disagreement
from crosscheck.references.taylor import Taylor
from crosscheck.references.tree import scene_length
from crosscheck.scene.model import Scene
from crosscheck.scene.states import States

GROWTH_POINTS = 8  # of a piece; growth oscillates as the motion does
LOCATED = 1e-9
"""To how much of a second a monitor is located: one that fires before fires at the start."""
COMPARED = np.arange(GROWTH_POINTS // 2, GROWTH_POINTS + 1, GROWTH_POINTS // 2)
"""Those of a piece at which two formulations are compared."""
STATES = ("x", "R", "v", "w", "a", "alpha")
CHUNK = 500
"""Pieces whose derivatives are computed at once: a hundred arrays of such a size take 100 MB."""


class Truth:
    """Truth of a system; made by `crosscheck.references.dense`.

    Parameters
    ----------
    scene : the system; its duration and samples do not count
    portable : use the formulations that need no heyoka

    Attributes
    ----------
    pieces : steps of the series
    maxima : (pieces, 2, ORDERS + 1) largest |d^k x/dt^k| and |d^k R/dt^k|_F of all bodies in each
    growth : growth of the worst perturbation of the start at `times`, until the series ends
    event_error : times of events by which two formulations differ, times jumps, in |dx| / length and |dR|_F
    second : positions (k, n, 3) and attitudes (k, n, 3, 3) of the second formulation at `compared`
    """

    def __init__(self, scene: Scene, portable: bool = False) -> None:
        self.scene, self.portable = scene, portable
        self.pieces: list[Piece] = []
        self.maxima = np.zeros((0, 2, ORDERS + 1))
        self.growth = np.zeros(0)
        self.second = np.zeros((0, scene.n, 3)), np.zeros((0, scene.n, 3, 3))
        self.third = np.zeros((0, scene.n, 3)), np.zeros((0, scene.n, 3, 3))
        self.second_source = ""
        self.end: End | None = None
        self.second_end: End | None = None
        self.event_error = 0.0  # times of events apart, times jumps

    @functools.cached_property
    def series(self) -> Taylor | Natural:
        """The formulation whose series are kept."""
        if self.scene.has_laws or self.scene.monitors:
            from crosscheck.references.tree_laws import LawfulTaylor

            if self.portable:
                raise Unsupported(f"truth of {self.scene.name!r}: dry friction, limits, servos and monitors need "
                                  "heyoka, which is not installed")
            return LawfulTaylor(self.scene)
        return Natural(self.scene) if self.portable else Taylor(self.scene)

    @functools.cached_property
    def _stacked(self) -> tuple[np.ndarray, ...]:
        """Starts, their rests and coefficients of all pieces."""
        return (np.array([piece.start for piece in self.pieces]), np.array([piece.rest for piece in self.pieces]),
                np.array([piece.coefficients for piece in self.pieces]))

    @functools.cached_property
    def _modes(self) -> np.ndarray | None:
        """Modes of all pieces, if they have any."""
        return None if self.pieces[0].mode is None else np.array([piece.mode for piece in self.pieces])

    @property
    def reach(self) -> float:
        """The time (s) up to which it is computed."""
        return self.pieces[-1].start + self.pieces[-1].length if self.pieces else 0.0

    @functools.cached_property
    def times(self) -> np.ndarray:
        """0, and GROWTH_POINTS times of each piece."""
        starts, lengths = self._stacked[0], np.array([piece.length for piece in self.pieces])
        inner = starts[:, None] + lengths[:, None] * np.arange(1, GROWTH_POINTS + 1) / GROWTH_POINTS
        return np.concatenate([[0.0], inner.ravel()])

    @functools.cached_property
    def compared(self) -> np.ndarray:
        """0, and the times at which the formulations are compared, up to where perturbations grow too much."""
        inner = self.times[1:].reshape(-1, GROWTH_POINTS)[:, COMPARED - 1].ravel()
        return np.concatenate([[0.0], inner[inner <= self._known_until]])

    @functools.cached_property
    def _known_until(self) -> float:
        """The time until which the claim of the scene holds and a perturbation of 1e-15 stays below 1e-10."""
        over = np.flatnonzero(self.growth >= HORIZON_GROWTH)
        chaos = float(self.times[max(over[0] - 1, 0)]) if len(over) else self.reach
        return min(chaos, self.reach if self.end is None else self.end.horizon)

    @property
    def horizon(self) -> float:
        """The time (s) at which the truth ends, at most `reach`."""
        return self._known_until

    @property
    def horizon_cause(self) -> str:
        """Why it ends at its horizon; empty if it does not."""
        if self.horizon >= self.reach or self.end is None:
            return ""
        return self.end.cause if self.horizon == self.end.horizon else GROWN

    @property
    def events(self) -> tuple[tuple[float, str, str], ...]:
        """(time, joint or monitor, what happened), up to the horizon."""
        return () if self.end is None else tuple(event for event in self.end.events if event[0] <= self.horizon)

    @property
    def error(self) -> float:
        """Bound on the error in |dx| / length and |dR|_F up to the horizon."""
        allowed, agreed = self._agreed(self.reach)
        return max(allowed, agreed.difference)

    def prolong(self, until: float) -> bool:
        """Compute it up to a time (s); whether that was needed.

        Raises
        ------
        TruthError
            A formulation ends early.
        """
        if self.pieces and (until <= self.reach if self._modes is None else until + rounding(until) < self.reach):
            return False  # with modes, what acts from `until` on has to be known
        pieces, end = self.series.advance(self.end or self.series.begin, until)
        maxima = [self.series.derivative_maxima(pieces[k:k + CHUNK]) for k in range(0, len(pieces), CHUNK)]
        longer = Truth(self.scene, self.portable)
        longer.__dict__ |= {"series": self.series, "end": end, "keep": self.keep, "pieces": [*self.pieces, *pieces],
                            "maxima": np.concatenate([self.maxima, *maxima])}
        series = self.series
        longer.growth = (growth_over(series, longer.times) if isinstance(series, Taylor)
                         else sampled_growth(series, longer.times))
        longer._confirm(self)
        self.__dict__ = longer.__dict__  # only now: an error leaves a shorter truth as it is
        return True

    def _confirm(self, before: Truth) -> None:
        """Solve the second formulation at the times of comparison that a shorter truth does not have."""
        other = self._other
        states, self.second_end = other.advance(before.second_end or other.begin,
                                                self.compared[max(len(before.second[0]) - 1, 0):])
        known = len(before.second[0]) - 1 if before.second_end else 0
        self.second = (np.concatenate([before.second[0][:known], states.x]),
                       np.concatenate([before.second[1][:known], states.R]))
        self.second_source = other.source
        self._compare_events()

    def _compare_events(self) -> None:
        """Raise an error if the two formulations find other events; those beyond the horizon do not count."""
        one, other = (() if end is None else end.events for end in (self.end, self.second_end))
        where, apart = disagreement(one, other, self.compared[-1])
        if where:
            raise TruthError(f"{self.scene.name!r}: {self.series.source} and {self.second_source} find other events: "
                             f"{where}")
        fastest = np.max(self.maxima[:, :, 1], axis=0)  # |dx/dt| and |dR/dt|: no jump of a velocity is twice as large
        self.event_error = 2.0 * apart * float(max(fastest[0] / scene_length(self.scene), fastest[1]))

    @functools.cached_property
    def _other(self) -> Any:
        """The formulation in maximal coordinates."""
        if self.scene.has_laws:
            from crosscheck.references.world_laws import LawfulMaximal

            return LawfulMaximal(self.scene)
        from crosscheck.references.maximal import Maximal

        return Maximal(self.scene)

    def at(self, t: object) -> States:
        """States at increasing times (s), with accelerations; it is prolonged if it has to be.

        After the horizon they are NaN.

        Raises
        ------
        TruthError
            As `crosscheck.references.truth`.
        """
        t = np.atleast_1d(np.asarray(t, dtype=float))
        if len(t) and (not np.isfinite(t).all() or t[0] < 0.0 or np.any(np.diff(t) < 0.0)):
            raise ValueError("times of a truth have to increase from 0 on")
        if len(t) and self.prolong(float(t[-1])):
            self._keep()
        return self._motion(self._agreed(self.reach)[1].chosen, t).until(self.horizon)

    keep: Callable[[Truth], None] | None = None
    """What stores it after it was prolonged."""

    def _keep(self) -> None:
        if self.keep is not None:
            self.keep(self)

    def on_series(self, t: np.ndarray) -> States:
        """States at times within its reach from the series, whether it is right or not."""
        modes = None if self._modes is None else self._modes[piece_of(self._stacked[0], t)]
        return self.series.dense_states(t, functools.partial(values_at, self._stacked, t), modes)

    def _motion(self, solved: Solved, t: np.ndarray) -> States:
        """States at times t of the formulation of that name."""
        if solved.source == self.series.source:
            return self.on_series(t)
        states: States = self._other.run(np.union1d([0.0], t))
        states = states.at(np.searchsorted(states.t, t))
        states.hinges = self.on_series(t).hinges  # both turn alike
        return states

    def _agreed(self, until: float) -> tuple[float, Agreement]:
        """What the conditioning explains of a difference up to a time, and the agreement there."""
        end = min(until, self._known_until)
        count = min(int(np.searchsorted(self.compared, end)) + 1, len(self.compared))
        allowed = max(FLOOR, ROUNDOFF * self._growth_until(end), self.event_error)
        if (count, allowed) not in self._agreements:
            self._agreements[count, allowed] = self._agree(count, allowed)
        return allowed, self._agreements[count, allowed]

    @functools.cached_property
    def _agreements(self) -> dict[tuple[int, float], Agreement]:
        return {}

    @functools.cached_property
    def _maxima(self) -> dict[float, np.ndarray]:
        return {}

    @functools.cached_property
    def _series_compared(self) -> Solved:
        return Solved(self.on_series(self.compared), self.series.source)

    def _agree(self, count: int, allowed: float) -> Agreement:
        series, t = self._series_compared, self.compared
        other = Solved(_posed(t, self.second), self.second_source)
        if self.portable:
            apart = difference(self.scene, series.states, other.states, count)
            if apart.size > max(allowed, USABLE):
                raise TruthError(f"{self.scene.name!r}: {series.source} and {other.source} disagree by "
                                 f"{apart.size:.2e} at t = {t[apart.sample]:.6g} s in body "
                                 f"{self.scene.bodies[apart.body].name!r}; the scene's conditioning explains "
                                 f"{allowed:.2e}")
            return Agreement(series, other, apart.size)
        agreed = agree(self.scene, series, other, count, allowed, self._solved_thirdly)
        if series not in (agreed.chosen, agreed.second) and (
                difference(self.scene, series.states, agreed.second.states, count).size > USABLE):
            raise TruthError(f"{self.scene.name!r}: {agreed.outvoted}, by {agreed.chosen.source} and "
                             f"{agreed.second.source}, which differ by {agreed.difference:.1e}; they disagree so far "
                             "that nothing measured with it holds")
        return agreed

    def _solved_thirdly(self, scene: Scene, t: np.ndarray) -> Solved | None:
        """The third formulation, which is kept, too."""
        if len(self.third[0]) < len(t):
            solved = natural_coordinates(scene, t)
            if solved is None:
                return None
            self.third = solved.states.x, solved.states.R
        return Solved(_posed(t, self.third), Natural.source)

    def reference(self, scene: Scene) -> Reference:
        """The truth at the output times of a scene of this system.

        Raises
        ------
        TruthError, Chaotic, Unsupported
            As `crosscheck.references.truth`.
        """
        if self.prolong(scene.duration):
            self._keep()
        horizon = min(self._known_until, scene.duration)
        cause = self.horizon_cause if horizon < scene.duration else ""
        refuse_early(scene, horizon, cause or GROWN)
        third = len(self.third[0])
        allowed, agreed = self._agreed(scene.duration)
        if len(self.third[0]) > third:
            self._keep()
        amplification = self._growth_until(scene.duration)
        if scene.duration not in self._maxima:
            self._maxima[scene.duration] = self._maxima_until(scene.duration)
        position, attitude = self._maxima[scene.duration]
        return Reference(self._motion(agreed.chosen, scene.t), agreed.chosen.source, agreed.second.source,
                         agreed.difference, allowed, amplification, horizon, position, attitude, agreed.outvoted,
                         cause, tuple(event for event in self.events if event[0] <= horizon))

    def _growth_until(self, t: float) -> float:
        """The largest growth from the start to a time."""
        return max(float(self.growth[self.times <= t].max()), float(np.interp(t, self.times, self.growth)))

    def _maxima_until(self, until: float) -> np.ndarray:
        """(2, ORDERS + 1) largest derivatives from the start to a time."""
        whole = sum(piece.start + piece.length <= until for piece in self.pieces)
        largest = list(self.maxima[:whole])
        if whole < len(self.pieces) and until > self.pieces[whole].start:
            last = self.pieces[whole]
            largest += list(self.series.derivative_maxima([dataclasses.replace(last, length=until - last.start)]))
        largest_of_all: np.ndarray = np.max(largest, axis=0)
        return largest_of_all


def _posed(t: np.ndarray, pose: tuple[np.ndarray, np.ndarray]) -> States:
    """States of which only positions and attitudes are known, the first ones of `pose`."""
    x, R = (part[:len(t)] for part in pose)
    unknown = np.full_like(x, np.nan)
    return States(t, x, R, unknown, unknown, unknown, unknown)


def refuse_early(scene: Scene, horizon: float, cause: str) -> None:
    """Raise an error if the truth ends before the first output time after the start."""
    if np.count_nonzero(scene.t <= horizon * (1 + 1e-12)) >= 2:  # the ends of both grids agree to rounding
        return
    if horizon > LOCATED:
        raise Chaotic(f"{scene.name!r}: its truth ends at {horizon:.3g} s, where {cause}, and the first output time is "
                      f"{scene.t[1]:.3g} s; ask for a shorter duration or more samples: "
                      f"{ceil(scene.duration / horizon) + 1} over {scene.duration:g} s, or a duration of "
                      f"{horizon:.2g} s", horizon)
    why = f"already {cause}; start elsewhere" if cause != GROWN else "perturbations of 1e-15 are 1e-10"
    raise TruthError(f"{scene.name!r} has no truth: at its start {why}")
