"""The true flow of a system: its series are compiled once and started anywhere, with their error and their growth."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping, Sequence

import numpy as np

from crosscheck.compare.apart import ROUNDED, STATE, apart, largest
from crosscheck.judge.rules import RESOLVED
from crosscheck.references import dense
from crosscheck.references.base import End, Reference, Series, rounding
from crosscheck.references.modes import Mode
from crosscheck.references.taylor import Taylor
from crosscheck.references.tree_laws import Change, LawfulTaylor
from crosscheck.scene.assembly import closed
from crosscheck.scene.model import Scene, quaternion_from_rotation
from crosscheck.scene.spanning import spanning_tree
from crosscheck.scene.starts import Configuration, bodies_at
from crosscheck.scene.states import States
from crosscheck.scene.vectors import exponential

MOVED = (1e-6, 1e-7)
"""Shares of the state's sizes by which a start is moved: far above rounding, far below 1. Where both do not grow
alike the motion is not linear in its start, as that of a loop near a singular position: without loops one is enough."""
ALIKE = 2.0
"""Factor within which they have to agree."""


@dataclasses.dataclass(frozen=True)
class Jump:
    """A time at which the true motion is not smooth, s since the start, and by how much its rates jump there."""

    after: float
    due: bool  # a function of time or a sample of a servo, at a known time
    rates: Mapping[str, float]  # by quantity, of dy/dt: 0 where that is continuous

    @property
    def impact(self) -> bool:
        """Whether velocities jump."""
        return bool(self.rates["position"] or self.rates["attitude"])


@dataclasses.dataclass(frozen=True)
class Flowed:
    """The true motion from one state."""

    states: States  # at the times asked for, s since the start, with accelerations
    jumps: tuple[Jump, ...]
    error: float  # of it, over the sizes
    growth: float  # factor by which an error of the start in a random direction, as rounding is, grows; 1 at least
    worst: float  # the same in the worst direction
    linear: bool  # whether that is so for errors of any small size


def moved(start: Scene, sizes: Mapping[str, float], share: float, seed: int = 0, closing: bool = True) -> Scene | None:
    """The scene from a start that differs by about this share of the sizes; None if its joints cannot be closed."""
    rng = np.random.default_rng([seed, start.n])
    kicks = share * rng.standard_normal((len(STATE), *start.x0.shape)) / np.sqrt(start.x0.size)
    x, turn, v, w = (sizes[name] * kick for name, kick in zip(STATE, kicks, strict=True))
    made = start.replace(bodies=bodies_at(start, Configuration(
        start.x0 + x, quaternion_from_rotation(start.R0 @ exponential(turn)), start.v0 + v, start.w0 + w)))
    return closed(made, start) if closing else made


def grown(perturbed: States, states: States, sizes: Mapping[str, float], size: float, keep: np.ndarray) -> float:
    """The growth of the distance of two motions, which began about `size` apart, up to the times `keep`; 1 at least."""
    gaps = {name: rows / sizes[name] for name, rows in apart(perturbed, states).items() if name in STATE}
    begun = max(largest(rows[:1]) for rows in gaps.values()) or size
    return max(1.0, max(largest(rows[keep]) for rows in gaps.values()) / begun)


class SystemFlow:
    """The flow of the system of a scene.

    Parameters
    ----------
    sizes : of quantities, by which starts are moved
    truth : of the scene; how far its formulations differ is the error of each

    Raises
    ------
    TruthError, Unsupported
        The scene has no truth, or its laws need heyoka and it is not installed.
    """

    def __init__(self, scene: Scene, sizes: Mapping[str, float], truth: Reference) -> None:
        self.scene, self.sizes, self.series = scene, sizes, dense(scene).series
        self.minimal = isinstance(self.series, Taylor)
        self.looped = bool(spanning_tree(scene)[1])
        self.error = truth.disagreement / max(1.0, truth.amplification) + float(np.finfo(float).eps)

    def from_(self, start: Scene, since: float, times: np.ndarray, mode: Mode | None = None) -> Flowed:
        """The motion from the start of a scene of this system at the time `since` (s), at times after that, (T,).

        `mode`: what the state of a scene with laws of joints lacks, see `crosscheck.references.restarts`.
        """
        states, jumps = self._followed(start, since, times, mode)
        keep = np.all([np.abs(times - jump.after) > RESOLVED * times[-1] / len(times) for jump in jumps], axis=0) & (
            times >= 0.0)
        growth = []
        for size in MOVED if self.looped else MOVED[:1]:
            other = moved(start, self.sizes, size, closing=self.looped or not self.minimal)
            if other is None:
                growth.append(np.inf)
                continue
            perturbed, _ = self._followed(other, since, times, mode, near=start)
            growth.append(grown(perturbed, states, self.sizes, size, keep))
        linear = max(growth) <= ALIKE * min(growth)
        # A random direction has on average a share of the worst one, one over the root of the number of directions.
        directions = len(self.series.initial) if isinstance(self.series, Taylor) else len(STATE) * start.x0.size
        return Flowed(states, jumps, self.error * max(growth), max(growth), max(growth) * math.sqrt(directions), linear)

    def _followed(self, start: Scene, since: float, times: np.ndarray, mode: Mode | None, near: Scene | None = None
                  ) -> tuple[States, tuple[Jump, ...]]:
        """The motion, and where it jumps; what rests at the start `near` this one rests here, too."""
        series, until, changes = self.series, since + float(times[-1]), list[Change]()
        due = [t for t in self.scene.knots if since < t <= until + rounding(until)]
        state = series.state_of(start)
        if isinstance(series, LawfulTaylor):
            if near is not None:
                state = series.kept(state, series.begun(series.state_of(near), since, mode))
            pieces, end = series.advance(series.begun(state, since, mode), until, changes)
            last = series.machine.next_time(until - rounding(until), end.mode)
            due = [last] if last <= until + rounding(until) else []  # has not happened yet
        else:
            pieces, _ = series.advance(End(state, since), until)
        values = Series(pieces)
        found = series.dense_states(since + times, values(since + times), values.modes_at(since + times))
        found.t = times
        return found, tuple(self._jump(change, since) for change in changes) + _due(due, since)

    def _jump(self, change: Change, since: float) -> Jump:
        series = self.series
        assert isinstance(series, LawfulTaylor)
        before, after = (series.dense_states(np.array([change.time]), y[None], series.table(mode).reshape(1, -1))
                         for y, mode in ((change.state, change.mode), (change.resumed.state, change.resumed.mode)))
        rates = {"position": after.v - before.v, "attitude": after.w - before.w,
                 "velocity": after.a - before.a, "angular velocity": after.alpha - before.alpha}  # type: ignore[operator]
        small = {name: self.sizes["velocity" if name == "position" else "angular velocity"] * ROUNDED
                 for name in ("position", "attitude")}
        jumped = {name: largest(each) for name, each in rates.items()}
        return Jump(change.time - since, change.crossing is None,
                    {name: size if size > small.get(name, 0.0) else 0.0 for name, size in jumped.items()})


def _due(times: Sequence[float], since: float) -> tuple[Jump, ...]:
    """Jumps at known times (s), of accelerations alone."""
    return tuple(Jump(t - since, True, dict.fromkeys(STATE, 0.0)) for t in times)
