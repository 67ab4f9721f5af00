"""Defects: by how much a run misses the true motion in one sample interval, started from the run's own state.

What the run did before does not count. An error therefore meets the bound of a single interval whenever it begins, also
past the horizon of a chaotic scene.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence

import numpy as np

from crosscheck.compare.apart import turn
from crosscheck.document import QUANTITIES, Scales
from crosscheck.judge import tolerances
from crosscheck.judge.claim import Claim, Trace
from crosscheck.judge.crossings import across
from crosscheck.judge.flow import Answer, Flow, flows
from crosscheck.references.base import Reference
from crosscheck.scene.model import Scene

MOST_BODIES = 16
"""Bodies of a scene in which every interval is judged: dense algebra costs the cube of their number."""

FEW = 8
"""Intervals that are judged in scenes of more bodies."""

DOUBT = 1e-12
"""Error of the integration and of converting an engine's coordinates, in units of the quantity."""

CHAIN = 8
"""Bodies of a chain up to which rounding stays below what a step is allowed; it grows with their number."""

NORMS, RATES = 8.0, 32.0
"""Times rtol that one step of an adaptive method may be wrong by, in positions and in velocities: each method measures
its error in a norm of its own. In lieeuler rkmk54 reaches 0.2, rkmk853 0.6, seulex 2.6 and, with springs, 21."""

TERMS = 2.0
"""Times the derivative that bounds the error of a step: that error is a sum of the same terms with other weights."""

SHARE = 1e-3
"""Share of the scene's size up to which open constraints are an error of the method; beyond it a joint is open."""

AHEAD = 0.25
"""Share of an interval beyond its end in which an event counts that the run may have had before."""

Parts = dict[str, np.ndarray]


@dataclasses.dataclass(frozen=True)
class Defects:
    """What one run misses in I intervals, and what it may miss."""

    flow: Flow
    claim: Claim
    scale: Scales
    grading: float  # roundings per step, see `tolerances.grading`
    most_growth: float  # largest exponent by which an error may grow over the run
    vectors: Parts  # (I, n, 3) by quantity; attitudes as rotation vectors
    floor: Parts  # (I,) by quantity: rounding
    opening: Parts  # (T,) by level: the largest violation of a constraint
    allowed: tuple[Parts, ...]  # (T,) by level: the violation that a method of order p, of p + 1, ... may leave
    forgets: bool = False  # whether the engine was seen to remember nothing but the state

    @property
    def bounds(self) -> Parts:
        """Largest error per interval, (I,) by quantity, in the unit of the quantity."""
        open_ = {level: self.at_ends(np.minimum(self.opening[level], self.allowed[0][level])) for level in self.opening}
        wide = with_slack(*self.local(), open_, self.flow.tau, self.scale)
        return {name: wide[name] + self.floor[name] for name in QUANTITIES}

    def at_ends(self, series: np.ndarray) -> np.ndarray:
        """The larger of the values at both ends of each interval, (I,), of a series (T,)."""
        index = self.flow.index
        return np.asarray(np.maximum(series[index], series[index + 1]))

    def local(self, more: int = 0) -> tuple[np.ndarray, np.ndarray]:
        """Bounds (I,) of the errors of y and dy/dt that an interval adds, for a method of order p + `more`."""
        flow, claim = self.flow, self.claim
        if claim.fixed is None:
            pose = NORMS * flow.growth * (claim.steps + 1.0) * (claim.rtol or 0.0)
            return self._across(pose, RATES / NORMS * pose * np.maximum(flow.rate, self.scale.rate))
        order, step = claim.fixed
        order, Y = order + more, flow.sizes
        scaled = TERMS * flow.growth * flow.tau * step**order
        return self._across(scaled * (Y[order + 1] + flow.tau * Y[order + 2]),
                            scaled * (Y[order + 2] + flow.rate * Y[order + 1]))

    def _across(self, pose: np.ndarray, rate: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The bounds (I,) of y and dy/dt where surfaces of laws are crossed."""
        return crossed(self.flow, pose, rate, self.claim.fixed)


def crossed(flow: Flow, pose: np.ndarray, rate: np.ndarray, claim: tuple[int, float] | None
            ) -> tuple[np.ndarray, np.ndarray]:
    """Errors (I,) of y and dy/dt after the events of intervals, see `crosscheck.judge.crossings.across`."""
    if flow.crossed is None:
        return pose, rate
    pose, rate = pose.copy(), rate.copy()
    for k, interval in enumerate(flow.crossed.intervals):
        if interval.events:
            pose[k], rate[k] = across(interval.events, pose[k], rate[k], flow.tau[k], flow.sizes[:, k], claim)
    return pose, rate


def measured(scene: Scene, traj: Trace, others: Sequence[Answer], truth: Reference, claim: Claim,
             own: Defects | None = None) -> list[Defects]:
    """The defects of a run and of `others`, its parts at other steps; with `own`, those of the run, of the others only.

    All states have to be finite.

    Raises `numpy.linalg.LinAlgError` if the equations of motion have no solution at a state of a run.
    """
    count = len(traj.t) - 1
    index = np.arange(count) if scene.n <= MOST_BODIES else np.unique(np.linspace(0, count - 1, FEW).astype(int))
    scale, order = tolerances.scales(scene, truth), claim.order or 0
    runs: list[tuple[Trace, Claim, Answer | None]] = [] if own is not None else [(
        traj, dataclasses.replace(claim, steps=traj.steps / count), None)]
    runs += [(
        each.traj, dataclasses.replace(claim, step=each.traj.stats["step"], steps=each.traj.steps / count), each)
             for each in others]
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        flowed = flows(scene, [(each, answer, min(4 * (said.step or math.inf), AHEAD * float(traj.t[1] - traj.t[0])))
                              for each, said, answer in runs], truth, scale,
                      max(5, order + 3) if claim.fixed else 3, index) if runs else []
        return [_measure(scene, each, truth, said, scale, flow) for (each, said, _), flow in
                zip(runs, flowed, strict=True)]


def _measure(scene: Scene, traj: Trace, truth: Reference, claim: Claim, scale: Scales, flow: Flow) -> Defects:
    order = claim.order or 0
    end, after = flow.end, flow.index + 1
    vectors = {"position": traj.x[after] - end.x, "velocity": traj.v[after] - end.v,
               "attitude": turn(end.R, traj.R[after]), "angular velocity": traj.w[after] - end.w}
    vectors = {name: np.where(flow.regular[:, None, None], vector, 0.0) for name, vector in vectors.items()}
    # In joint coordinates the roundings of all bodies down to the ground add up.
    least = (DOUBT + 4 * tolerances.grading(scene) * claim.eps) * max(1.0, scene.n / CHAIN)
    steps = max(1.0, claim.steps) ** 0.6
    floor = {name: least * max(scale.of(name), scale.units[name]) * flow.growth * steps for name in QUANTITIES}
    if flow.crossed is not None:
        for pose, rate in (("position", "velocity"), ("attitude", "angular velocity")):
            units = scale.units[pose], scale.units[rate] / scale.rate
            grown = crossed(flow, floor[pose] / units[0], floor[rate] / units[1], None)
            floor[pose], floor[rate] = (part * unit for part, unit in zip(grown, units, strict=True))
    if claim.step:
        for name, spacing in tolerances.differenced(scale.length, claim.eps).items():
            floor[name] = floor[name] + 4 * spacing / claim.step
    opening = {level: getattr(traj, f"constraint_{level}") for level in ("position", "velocity")}
    growth = math.log(10.0 * max(1.0, truth.amplification))
    run = Defects(flow, claim, scale, tolerances.grading(scene), growth, vectors, floor, opening, ())
    orders = 3 if order == 1 else 2 if claim.fixed else 1
    return dataclasses.replace(run, allowed=tuple(_drift(run, traj.t, more) for more in range(orders)))


def _drift(run: Defects, t: np.ndarray, more: int) -> Parts:
    """The violation that a method of order p + `more` may leave at the output times, (T,) by level.

    The index-1 equations do not magnify violations of velocity constraints: they add up, and positions follow them.
    """
    flow, (pose, rate) = run.flow, run.local(more)
    lever = max(1.0, run.scale.length)
    scattered = (len(t) - 1) / len(flow.tau)  # in scenes of many bodies only a few intervals are measured
    pose = pose + run.floor["position"] / run.scale.length
    rate = rate + run.floor["velocity"] / run.scale.length
    at_once = 0.0
    if run.claim.fixed:
        order, step = run.claim.fixed
        at_once = TERMS * step**(order + more) * float(flow.sizes[order + more + 1].max())
    opened = scattered * np.concatenate([[0.0], np.cumsum(rate)]) + at_once
    moved = scattered * np.concatenate([[0.0], np.cumsum(pose + flow.tau * opened[1:])])
    at = np.append(flow.begin.t, t[flow.index[-1] + 1])
    size, speed = max(lever, run.scale.reach), max(lever * run.scale.rate, run.scale.speed)
    return {"position": 2 * lever * np.interp(t, at, moved) + DOUBT * lever + 10 * run.claim.eps * size,
            "velocity": 2 * lever * np.interp(t, at, opened) + DOUBT * lever * run.scale.rate
            + 10 * run.claim.eps * speed}


def with_slack(pose: np.ndarray, rate: np.ndarray, opening: Parts, tau: np.ndarray, scale: Scales) -> Parts:
    """Bounds (I,) by quantity: those of y and dy/dt, and what opening or closing constraints moves."""
    x = np.minimum(opening["position"], SHARE * scale.length)
    v = np.minimum(opening["velocity"], SHARE * scale.length * scale.rate)
    moved, pushed = 2 * x + tau * v, 2 * v + 2 * scale.rate * x
    return {"position": pose * scale.length + moved, "attitude": pose + moved / scale.length,
            "velocity": rate * scale.length + pushed, "angular velocity": rate + pushed / scale.length}
