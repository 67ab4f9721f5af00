"""Truth of a system at any time: a series in pieces, prolonged on demand, and what the second formulation says of it.

One computation serves every duration and every choice of output times. Growth of perturbations is measured at
GROWTH_POINTS points of a piece. Every piece has a defect in the second formulation; the error at a time is the sum of
those before it, or the root of the sum of their squares where that is larger, each grown as a perturbation of the start
does from there on (the formula of variation of constants: E. Hairer, S. P. Norsett, G. Wanner, Solving
Ordinary Differential Equations I, I.14).
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable

import numpy as np

from crosscheck.errors import Unsupported
from crosscheck.references.base import (
    GROWN,
    Chaotic,
    End,
    Piece,
    Reference,
    Series,
    TruthError,
    rounding,
)
from crosscheck.references.conditioning import HORIZON_GROWTH, growth_over
from crosscheck.references.defects import Sizes, defects
from crosscheck.references.maximal import NODES, Maximal
from crosscheck.references.taylor import Taylor
from crosscheck.scene.model import Scene
from crosscheck.scene.states import States

GROWTH_POINTS = 8  # of a piece; growth oscillates as the motion does
LOCATED = 1e-9
"""To how much of a second a monitor is located: one that fires before fires at the start."""
FLOOR = 1e-12
"""Relative error of a truth of a well-conditioned scene."""
ROUNDOFF = 1e-14
"""The rounding errors of a whole run as a perturbation of its start, before the scene amplifies it."""
USABLE = 1e-6
"""Relative error beyond which a motion is no truth: a hundredth of the loosest bound of a verdict."""


class Truth:
    """Truth of a system; made by `crosscheck.references.dense`.

    Parameters
    ----------
    scene : the system; its duration and samples do not count
    portable : use the formulations that need no heyoka

    Attributes
    ----------
    pieces : steps of the series
    growth : growth of the worst perturbation of the start at `times`, until the series ends
    sizes : (pieces,) relative defect of each in the second formulation
    defects : (pieces, 18n + h) defect at its end
    """

    def __init__(self, scene: Scene, portable: bool = False) -> None:
        self.scene, self.portable = scene, portable
        self.pieces: list[Piece] = []
        self.growth, self.sizes = np.zeros(0), np.zeros(0)
        self.defects = np.zeros((0, 18 * scene.n + len(scene.hinges)))
        self.end: End | None = None

    @functools.cached_property
    def series(self) -> Taylor | Maximal:
        """The formulation whose series are kept."""
        if self.scene.has_laws or self.scene.monitors:
            from crosscheck.references.tree_laws import LawfulTaylor

            if self.portable:
                raise Unsupported(f"truth of {self.scene.name!r}: dry friction, limits, servos and monitors need "
                                  "heyoka, which is not installed")
            return LawfulTaylor(self.scene)
        return Maximal(self.scene) if self.portable else Taylor(self.scene)

    @functools.cached_property
    def _values(self) -> Series:
        """Its state vectors and modes."""
        return Series(self.pieces)

    @functools.cached_property
    def _sums(self) -> np.ndarray:
        """(pieces,) the relative size of the sum of the defects up to each."""
        return Sizes(self.scene, self._values.lengths).of(np.cumsum(self.defects, axis=0))

    @property
    def reach(self) -> float:
        """The time (s) up to which it is computed."""
        return self.pieces[-1].start + self.pieces[-1].length if self.pieces else 0.0

    @functools.cached_property
    def times(self) -> np.ndarray:
        """0, and GROWTH_POINTS times of each piece."""
        shares = np.arange(1, GROWTH_POINTS + 1) / GROWTH_POINTS
        inner = self._values.starts[:, None] + self._values.lengths[:, None] * shares
        return np.concatenate([[0.0], inner.ravel()])

    @functools.cached_property
    def horizon(self) -> float:
        """The time (s) at which the truth ends, at most `reach`: until then the claim of the scene holds and a
        perturbation of 1e-15 stays below 1e-10."""
        over = np.flatnonzero(self.growth >= HORIZON_GROWTH)
        chaos = float(self.times[max(over[0] - 1, 0)]) if len(over) else self.reach
        return min(chaos, self.reach if self.end is None else self.end.horizon)

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
        return max(self.checked(self.reach))

    def prolong(self, until: float) -> bool:
        """Compute it up to a time (s); whether that was needed.

        Raises
        ------
        TruthError
            A formulation ends early.
        """
        modes = bool(self.pieces) and self._values.modes is not None  # what acts from `until` on has to be known
        if self.pieces and (until + rounding(until) < self.reach if modes else until <= self.reach):
            return False
        pieces, end = self.series.advance(self.end or self.series.begin, until)
        longer = Truth(self.scene, self.portable)
        longer.__dict__ |= {"series": self.series, "second": self.second, "end": end, "keep": self.keep,
                            "pieces": [*self.pieces, *pieces]}
        series = self.series
        count = max(int(np.searchsorted(longer.times, end.horizon)), GROWTH_POINTS) + 1  # beyond it there is no claim
        known = longer.times[:count]
        growth = (growth_over(series, known) if isinstance(series, Taylor)
                  else growth_over(Taylor(self.scene), known, series))
        longer.growth = np.pad(growth, (0, len(longer.times) - len(known)), mode="edge")
        sizes, left = defects(self.second, self.series, longer.pieces, len(self.pieces))
        longer.sizes, longer.defects = np.concatenate([self.sizes, sizes]), np.concatenate([self.defects, left])
        self.__dict__ = longer.__dict__  # only now: an error leaves a shorter truth as it is
        return True

    @functools.cached_property
    def second(self) -> Maximal:
        """The formulation in which the defects are; without heyoka the one of the motion, with other nodes."""
        return Maximal(self.scene, 5 * NODES // 4 if self.portable else NODES)

    @property
    def second_source(self) -> str:
        """What it is compared with."""
        return f"{self.second.source}{', which is one formulation, at other nodes' if self.portable else ''}"

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
        self.checked(self.reach)
        return self.on_series(t).until(self.horizon)

    keep: Callable[[Truth], None] | None = None
    """What stores it after it was prolonged."""

    def _keep(self) -> None:
        if self.keep is not None:
            self.keep(self)

    def on_series(self, t: np.ndarray) -> States:
        """States at times within its reach from the series, whether it is right or not."""
        return self.series.dense_states(t, self._values(t), self._values.modes_at(t))

    def checked(self, until: float) -> tuple[float, float]:
        """What the conditioning explains of an error up to a time, and the error that the defects there make.

        Raises
        ------
        TruthError
            They leave no usable digits.
        """
        end = min(until, self.horizon)
        starts = self._values.starts
        began = np.maximum(np.maximum.accumulate(self.growth)[:-1:GROWTH_POINTS], 1e-300)
        grown = np.where(starts < end, np.maximum(self._growth_until(end) / began, 1.0), 0.0)
        left = np.maximum(self.sizes, self._sums) * grown
        error = float(max(left.max(), math.sqrt(float(np.sum((self.sizes * grown) ** 2)))))
        allowed = max(FLOOR, ROUNDOFF * self._growth_until(end))
        if not error <= max(USABLE, allowed):
            worst = int(np.argmax(left))
            raise TruthError(f"{self.scene.name!r}: {self.series.source}, and {self.second_source} disagree by "
                             f"{error:.2e}, most at t = {starts[worst]:.6g} s; the scene's conditioning explains "
                             f"{allowed:.2e}")
        return allowed, error

    def reference(self, scene: Scene) -> Reference:
        """The truth at the output times of a scene of this system.

        Raises
        ------
        TruthError, Chaotic, Unsupported
            As `crosscheck.references.truth`.
        """
        if self.prolong(scene.duration):
            self._keep()
        horizon = min(self.horizon, scene.duration)
        cause = self.horizon_cause if horizon < scene.duration else ""
        refuse_early(scene, horizon, cause or GROWN)
        allowed, error = self.checked(scene.duration)
        return Reference(self.on_series(scene.t), self.series.source, self.second_source, error, allowed,
                         self._growth_until(scene.duration), horizon, cause,
                         tuple(event for event in self.events if event[0] <= horizon))

    def _growth_until(self, t: float) -> float:
        """The largest growth from the start to a time."""
        return max(float(self.growth[self.times <= t].max()), float(np.interp(t, self.times, self.growth)))


def refuse_early(scene: Scene, horizon: float, cause: str) -> None:
    """Raise an error if the truth ends before the first output time after the start."""
    if np.count_nonzero(scene.t <= horizon * (1 + 1e-12)) >= 2:  # the ends of both grids agree to rounding
        return
    if horizon > LOCATED:
        raise Chaotic(f"{scene.name!r}: its truth ends at {horizon:.3g} s, where {cause}, and the first output time is "
                      f"{scene.t[1]:.3g} s; ask for a shorter duration or more samples: "
                      f"{math.ceil(scene.duration / horizon) + 1} over {scene.duration:g} s, or a duration of "
                      f"{horizon:.2g} s", horizon)
    why = f"already {cause}; start elsewhere" if cause != GROWN else "perturbations of 1e-15 are 1e-10"
    raise TruthError(f"{scene.name!r} has no truth: at its start {why}")
