"""Findings on a whole run: every sample interval, noise between them, and the start."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence

import numpy as np

from crosscheck.compare.apart import turn
from crosscheck.document import QUANTITIES, Finding
from crosscheck.judge.claim import Trace
from crosscheck.judge.defects import DOUBT, Defects, with_slack
from crosscheck.judge.metrics import PLATEAU
from crosscheck.judge.tolerances import CONSTANTS, ENDED
from crosscheck.judge.vanishing import finest_first, following, limits, shares, soft_joints, started
from crosscheck.scene.model import Scene

STEEPEST = 3.0
"""Largest exponent of the growth of an error within an interval. Beyond it the bound of the interval says nothing."""

DIFFERENCES = 8
"""Degree of the differences between neighbouring intervals in which noise stands out from a smooth error."""


@dataclasses.dataclass(frozen=True)
class Judged:
    """Which intervals of a run were judged, and why others were not."""

    seen: np.ndarray  # (T - 1,)
    why: str = ""

    def over(self, t: np.ndarray, until: float) -> float:
        """The share of the run's time that was judged, by its intervals or by bounds of its states `until` then (s)."""
        lengths = np.diff(t)
        return float(lengths[self.seen | (t[1:] <= until * (1 + 1e-12))].sum() / lengths.sum())


NOTHING = "the motion, or a spring, is too fast for the output times, or closed loops are next to a singular position"


def judge_intervals(scene: Scene, traj: Trace, runs: Sequence[Defects], apart: Sequence[Defects] = ()
                    ) -> tuple[list[Finding], Judged]:
    """One finding per quantity, of the interval whose error is largest over its bound; at t = 0 that of the start.

    The bound of an interval tau is exp(W tau) tau h^p |y^(p+1)| there, and what opening or closing constraints moves.
    If there are runs at other steps, the limit of vanishing steps is judged as well, by the next term of the error.
    `apart`: runs of all steps whose parts begin at the run's own states, of an engine that prefers axes.
    An interval is judged if its bound is less than what the motion covers in it.
    """
    own = runs[0]
    steep = own.flow.rate * own.flow.tau > STEEPEST
    seen = ~steep & own.flow.regular
    if not seen.any():
        return unresolved(NOTHING), Judged(np.zeros(len(traj.t) - 1, bool), NOTHING)
    sizes = {name: [np.linalg.norm(run.vectors[name], axis=-1).max(axis=1) for run in runs] for name in QUANTITIES}
    options = [("", {name: (sizes[name][0], bound * following(sizes[name], runs, own.claim.order or 1))
                     for name, bound in own.bounds.items()})]
    if len(runs) > 1:
        options += [("extrapolated to vanishing steps, ", limits(runs))]
    if len(apart) > 1:
        options += [("from states of its own, extrapolated to vanishing steps, ", limits(apart))]
    told = _telling(own) & seen
    share = float(told.sum() / (len(traj.t) - 1))
    judged = "" if share == 1.0 else f"; {100 * share:.3g} % of the intervals"
    start = _start(scene, traj, own)
    findings = []
    for name, unit in QUANTITIES.items():
        candidates = [start[name]]
        for word, bounds in options:
            values, limit = (part[seen] for part in bounds[name])
            values = np.where(np.isfinite(values), values, np.inf)
            at = int(np.argmax(values / limit))
            sample = own.flow.index[seen][at]
            candidates.append((float(values[at]), float(limit[at]),
                               f"{word}between t = {traj.t[sample]:.4g} and {traj.t[sample + 1]:.4g} s"))
        value, bound, where = max(candidates, key=lambda bounds: bounds[0] / bounds[1])
        findings.append(Finding(
            f"interval {name}", "ok" if value <= bound else "fail", value, bound, unit,
            f"against the true motion from the run's own state over one sample interval of {own.flow.tau[0]:.3g} s: "
            f"what {own.claim.said} may miss there, and what open constraints move{judged}", where))
    every = np.zeros(len(traj.t) - 1, bool)
    every[own.flow.index] = told
    why = "; ".join(text for text, some in (
        ("errors grow more than twentyfold between two output times", steep.any()),
        ("truth ends before", own.flow.ended.any()),
        ("closed loops pass next to a singular position", not (own.flow.regular | own.flow.ended).all()),
        ("at this step a bound exceeds what the motion covers between two output times", (seen & ~told).any()),
        (f"of so many bodies only {len(told)} intervals are judged", len(told) < len(every))) if some)
    return findings, Judged(every, why)


FINER, FALL = 100.0, 0.7
"""How much finer a tolerance is at which errors between steps have to be smaller, and by which power of that at least.
An interpolation of a method's own order follows the tolerance (powers .84 to 1.18 were seen of Dormand and Prince's
pairs, .75 of a cubic one of order 5); straight lines follow .17 to .54 and a cubic one of order 8 .39 to .62."""


def judge_between(own: Defects, ended: Defects, finer: Defects) -> tuple[list[Finding], float]:
    """The finding that an adaptive method errs between its steps, where it interpolates; the largest error there, in y.

    None, and zero, if it errs as well when it is asked to end at each sample (`ended`), or if its errors do not follow
    the tolerance (`finer`).
    """
    seen = own.flow.regular & (own.flow.rate * own.flow.tau <= STEEPEST)
    off = {}
    for name, unit in own.scale.units.items():
        missed, at_ends, less = (np.linalg.norm(run.vectors[name], axis=-1).max(axis=1)[seen]
                                 for run in (own, ended, finer))
        if np.any(at_ends > ended.bounds[name][seen]):
            return [], 0.0
        if np.any(missed > own.bounds[name][seen]) and less.max() > max(
                missed.max() * FINER**-FALL, finer.bounds[name][seen].max()):
            return [], 0.0
        off[name] = float(missed.max()) / unit
    name = max(off, key=lambda each: off[each])
    return [Finding("interpolation", "ok", off[name] * own.scale.units[name], None, QUANTITIES[name],
                    "states between steps are interpolated, with larger errors than the tolerance, which they follow; "
                    "where a run ends, it keeps the tolerance", name)], off[name]


def _telling(own: Defects) -> np.ndarray:
    """(I,) whether the bound of every quantity is less than what the motion covers in the interval."""
    flow, bounds, told = own.flow, own.bounds, np.ones(len(own.flow.tau), bool)
    moved = flow.rate * flow.tau
    covered = {"position": moved, "attitude": moved}
    for name, unit in own.scale.units.items():
        change = covered.get(name, np.maximum(moved, flow.sizes[2] * flow.tau / own.scale.rate))
        told &= bounds[name] < np.minimum(1.0, change) * unit
    return told


def unresolved(why: str) -> list[Finding]:
    """An unresolved finding for every quantity, with one reason."""
    return [Finding(f"interval {name}", "unresolved", None, None, unit, why) for name, unit in QUANTITIES.items()]


def _start(scene: Scene, traj: Trace, own: Defects) -> dict[str, tuple[float, float, str]]:
    """Per quantity (distance of the first output from the scene's start, bound by rounding and conversion, where)."""
    gaps = {"position": traj.x[0] - scene.x0, "attitude": turn(scene.R0, traj.R[0]),
            "velocity": traj.v[0] - scene.v0, "angular velocity": traj.w[0] - scene.w0}
    least, scale = 10 * DOUBT + 10 * own.claim.eps, own.scale
    return {name: (float(np.linalg.norm(gap, axis=-1).max()), least * max(scale.of(name), scale.units[name]),
                   "at t = 0, from the scene's start") for name, gap in gaps.items()}


ROUNDINGS = 8.0
"""Times the rounding floor of an interval that noise may reach: methods of index 3 divide positions by the step."""


def judge_noise(runs: Sequence[Defects], left: float = 0.0) -> list[Finding]:
    """Whether errors change smoothly from interval to interval, as those of every method with a fixed step do.

    The k-th difference of a smooth error is about tau^k times its k-th derivative. That of any error is at most 2^k
    times the error, and that of noise the root of (2k over k) times the noise. In at least half of the intervals the
    difference has to be no larger than that of a smooth error and of rounding. There is no finding for adaptive
    methods, whose errors are rough, nor if more than half of the intervals are beyond their bounds: they have a finding
    of their own. A constraint that Newton's iteration leaves open by `left` is an error left / h of velocities.
    """
    own, count = runs[0], DIFFERENCES
    if own.claim.fixed is None or len(own.flow.tau) < 3 * count or not np.isfinite(own.flow.sizes).all():
        return []
    # Next to a singular position, or to an event, nothing is measured: a difference across it is not one of errors.
    calm = own.flow.regular & ~own.flow.unsettled(math.inf)
    measured = np.lib.stride_tricks.sliding_window_view(calm, count + 1).all(axis=1)
    if not measured.any():
        return []
    sizes, top = own.flow.sizes, len(own.flow.sizes) - 1
    # From one degree to the next, derivatives of waves grow by a constant factor, and those near a pole by one that
    # rises with the degree. Beyond the highest known derivative the mean of both is taken.
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = np.nan_to_num(sizes[top] / sizes[top - 1])
    smooth = math.sqrt(math.prod((top + 1 + k) / top for k in range(count))) * (ratio * own.flow.tau) ** count
    root = math.sqrt(math.comb(2 * count, count))
    bounds, compared = own.bounds, []
    for name, unit in QUANTITIES.items():
        beyond = np.linalg.norm(own.vectors[name], axis=-1).max(axis=1) > bounds[name]
        if 2 * np.count_nonzero(beyond) > len(beyond):
            return []
        values = np.linalg.norm(np.diff(own.vectors[name], count, axis=0), axis=-1).max(axis=1)[measured] / root
        ended = ENDED * left / (own.claim.fixed[1] if name.endswith("velocity") else 1.0)
        whole = np.minimum(2.0**count, smooth) * (bounds[name] - own.floor[name]) / root + ROUNDINGS * own.floor[name]
        whole += ended
        allowed = np.max(np.lib.stride_tricks.sliding_window_view(whole, count + 1), axis=1)[measured]
        middle = int(np.argsort(values / allowed)[len(values) // 2])
        compared.append((float(values[middle]), float(allowed[middle]), name, unit))
    value, bound, name, unit = max(compared, key=lambda each: each[0] / each[1])
    return [Finding("noise", "ok" if value <= bound else "fail", value, bound, unit,
                    f"{count}-th differences of neighbouring intervals, over {root:.3g}: those of a smooth error and "
                    "of rounding", f"{name}, median of the intervals")]


WINDOWS = 3
"""Equal parts of a run in which its order is measured."""

WORTH = 0.1
"""Share of its bound below which the order of an error decides nothing: stiff scenes may not show the leading term."""

ALIKE = 0.1
"""Relative difference of states below which two runs have the same leading term, up to about this share."""


def judge_windows(runs: Sequence[Defects]) -> list[Finding]:
    """The order of the errors of intervals in each third of the run, from the runs at the two finest steps.

    The order study sees the first seconds only. Here every interval restarts from the run's own state, so that each
    third is a window of its own. It counts if the two runs are close to each other, their errors are above rounding,
    one of them comes near its bound, and that bound is more than rounding.
    """
    if len(runs) < 2 or len(runs[0].flow.tau) < WINDOWS:
        return []
    fine, coarse = finest_first(runs)[:2]
    order = fine.claim.order or 1
    ratio = math.log((coarse.claim.step or 1.0) / (fine.claim.step or 1.0))
    close = (shares([fine, coarse], order)[1] < ALIKE) & fine.flow.regular & coarse.flow.regular
    close &= ~(fine.flow.eventful | coarse.flow.eventful)
    # The error of a multistep method's start follows another power of h, and soft joints settle for longer.
    pair = [fine, coarse]
    close &= ~started(pair) if soft_joints(pair) else (fine.flow.since > 0.0) & (coarse.flow.since > 0.0)
    closed = {level: np.zeros(len(close)) for level in fine.opening}
    own = with_slack(*fine.local(), closed, fine.flow.tau, fine.scale)
    decades = []
    for part in np.array_split(np.arange(len(close)), WINDOWS):
        part = part[close[part]]
        for name in QUANTITIES if len(part) else ():
            errors = [np.linalg.norm(run.vectors[name][part], axis=-1).max(axis=1) for run in (coarse, fine)]
            most = [float(each.max()) for each in errors]
            if (most[1] > PLATEAU * float(max(run.floor[name][part].max() for run in (coarse, fine)))
                    and np.any((errors[1] > WORTH * fine.bounds[name][part]) & (own[name] > fine.floor[name])[part])):
                begin, end = fine.flow.begin.t[part[0]], fine.flow.end.t[part[-1]]
                decades.append((math.log(most[0] / most[1]) / ratio,
                              f"{name}, intervals from t = {begin:.4g} to {end:.4g} s"))
    if not decades:
        return []
    value, where = min(decades)
    bound = order - CONSTANTS["order_margin_coarse"]
    why = (f"documented order {order}, to the nearest whole number: of the errors of intervals at two steps, in each "
           "third of the run")
    return [Finding("order intervals", "ok" if value >= bound else "fail", value, bound, "1", why, where)]
