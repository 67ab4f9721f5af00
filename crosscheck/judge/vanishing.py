"""Runs at a few steps, extrapolated to vanishing steps in every sample interval.

This removes the leading term of a method's error. Errors of the model, and noise, remain.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from crosscheck.compare.apart import turn
from crosscheck.compare.order import cancelling
from crosscheck.document import QUANTITIES
from crosscheck.judge.defects import Defects, with_slack
from crosscheck.judge.flow import around
from crosscheck.judge.tolerances import CONSTANTS, USUAL

Limit = dict[str, tuple[np.ndarray, np.ndarray]]
"""By quantity the size (I,) of what remains, and its bound."""

FOLLOWING = 1000.0
"""Methods of one order differ in the constants of their errors, most of all in accelerations of thin bodies. If errors
follow the documented order from step to step, they come from the method. They may then be this many times what the
derivatives of the motion give, and more if light bodies carry heavy ones. Errors of the model do not fall; they are
judged in the limit of vanishing steps."""

FALLS = 4.0
"""The next term of an error may be this many times larger than the ratio of the two terms before it predicts."""

NEAR = 9
"""Number of neighbouring intervals over which the largest value of a term is taken."""

BEGUN = 50
"""Steps after which the start has no more effect. Soft constraints decay by a factor of e in two steps."""

SOFT = 1.5
"""Openings that fall with this order or more come from soft constraints (order 2), others from drift (order 1)."""

APART = 0.5
"""If the states of two runs differ by this share, the runs have no error terms in common."""


def following(values: Sequence[np.ndarray], runs: Sequence[Defects], order: int) -> np.ndarray:
    """(I,) the factor of bounds of errors (I,) of some runs: `FOLLOWING` where errors fall with the step, else one."""
    if len(runs) < 2:
        return np.ones(len(values[0]))
    pairs = sorted(zip(runs, values, strict=True), key=lambda pair: pair[0].claim.step or 0.0)
    (fine, some), (coarse, more) = pairs[:2]
    return np.where(falls(some, more, [fine, coarse], order), FOLLOWING * fine.grading / USUAL, 1.0)


def falls(some: np.ndarray, more: np.ndarray, runs: Sequence[Defects], order: int) -> np.ndarray:
    """(I,) whether errors (I,) follow an order: `some` of the first run and `more` of the second, coarser one."""
    fine, coarse = runs
    ratio = (coarse.claim.step or 1.0) / (fine.claim.step or 1.0)
    close = shares(runs, fine.claim.order or 1)[1] < APART
    return np.asarray(close & (some * ratio ** (order - CONSTANTS["order_margin_coarse"]) <= more))


def limits(runs: Sequence[Defects]) -> Limit:
    """The defects of some runs extrapolated to vanishing steps.

    Weights of sum one that cancel h^p, and with a third run h^(p+1), leave the next term. The runs are in states that
    differ by a share of y, and p + 2 factors of the leading term by as much each; a third run cancels what is linear
    in that as well.
    """
    runs = finest_first(runs)
    fine, order, more = runs[0], runs[0].claim.order or 1, len(runs) - 1
    (weights, left), apart = extrapolation(runs, order), shares(runs, order)
    pose, rate = (left * part for part in fine.local(more))
    gap = {level: left * fine.at_ends(values) for level, values in fine.allowed[more].items()}
    for run, weight, share in zip(runs, weights, apart, strict=True):
        known = run.local()
        pose, rate = pose + abs(weight) * share * known[0], rate + abs(weight) * share * known[1]
        gap = {level: gap[level] + abs(weight) * np.maximum.accumulate(share) * run.at_ends(run.allowed[0][level])
               for level in gap}
    for level in gap:
        rest = np.abs(sum(weight * run.opening[level] for weight, run in zip(weights, runs, strict=True)))
        gap[level] = np.minimum(gap[level], fine.at_ends(rest))
    bounds = with_slack(pose, rate, gap, fine.flow.tau, fine.scale)
    usable = np.all([within(run) & run.flow.regular for run in runs[1:]], axis=0)
    usable &= np.max(apart, axis=0) < APART
    # An event is early or late by parts of a step, and a start for what an engine remembers.
    usable &= ~np.any([run.flow.eventful | run.flow.after_event(BEGUN * (run.claim.step or 0.0)) for run in runs],
                      axis=0)
    usable &= ~started(runs)
    pairs = {}
    for name in QUANTITIES:
        floor = np.sum([abs(weight) * run.floor[name] for weight, run in zip(weights, runs, strict=True)], axis=0)
        bound = np.maximum(bounds[name], _next(runs, name, order)) + floor
        pairs[name] = _left(runs, name, weights), np.where(usable, bound, np.inf)
    return pairs


def _left(runs: Sequence[Defects], name: str, weights: np.ndarray) -> np.ndarray:
    """(I,) size of the weighted sum of the defects of the runs."""
    total = np.sum([weight * run.vectors[name] for weight, run in zip(weights, runs, strict=True)], axis=0)
    return np.asarray(np.linalg.norm(total, axis=-1).max(axis=1))


def _next(runs: Sequence[Defects], name: str, order: int) -> np.ndarray:
    """(I,) the term that three runs leave, predicted from the two terms before it; zero for fewer runs.

    The ratio of terms that fall as documented predicts the next one. On stiff scenes it is more than derivatives tell.
    """
    if len(runs) < 3:
        return np.zeros(len(runs[0].flow.tau))
    # Terms pass through zero, each at times of its own.
    leading, one, two = (around(values, NEAR) for values in (
        np.linalg.norm(runs[0].vectors[name], axis=-1).max(axis=1),
        *(_left(pair, name, extrapolation(pair, order)[0]) for pair in (runs[:2], runs[1:]))))
    with np.errstate(divide="ignore", invalid="ignore"):
        share = np.where(falls(one, two, runs[:2], order + 1), np.minimum(1.0, one / leading), 0.0)
    return np.asarray(FALLS * share * one)


def within(run: Defects) -> np.ndarray:
    """(I,) where a run is within its own bounds. Beyond them a coarse step may be unstable, without terms to cancel."""
    bounds = run.bounds
    return np.asarray(np.all([np.linalg.norm(run.vectors[name], axis=-1).max(axis=1) <= bounds[name]
                              for name in QUANTITIES], axis=0))


def soft_joints(runs: Sequence[Defects]) -> bool:
    """Whether openings of runs, the finest first, fall faster than drift, as those of soft constraints do.

    The forces of soft constraints are proportional to opening / h^2, which is about the same at any step. Half of the
    output times tell: a part begins with joints as open as at the run's own step, until its springs have settled.
    """
    opened = [float(np.median(run.opening["position"])) for run in runs[:2]]
    return bool(opened[1] > opened[0] * ((runs[1].claim.step or 1.0) / (runs[0].claim.step or 1.0)) ** SOFT)


def started(runs: Sequence[Defects]) -> np.ndarray:
    """(I,) whether an engine was started so shortly before that its errors follow no power of h."""
    return np.asarray(np.any([(run.flow.since == 0.0) | (run.flow.since < BEGUN * (run.claim.step or 0.0))
                              for run in runs], axis=0))


def finest_first(runs: Sequence[Defects]) -> list[Defects]:
    """The runs, sorted by their steps."""
    return sorted(runs, key=lambda run: run.claim.step or 0.0)


def extrapolation(runs: Sequence[Defects], order: int) -> tuple[np.ndarray, float]:
    """Weights of runs, the finest first, that cancel the leading terms of their errors; the factor of the next term.

    That factor is relative to the next term of the finest run.
    """
    h = np.array([run.claim.step or 1.0 for run in runs])
    weights = cancelling(h, order)
    return weights, float(abs(weights @ (h / h[0]) ** (order + len(h) - 1)))


def shares(runs: Sequence[Defects], order: int) -> list[np.ndarray]:
    """(I,) per run: the share by which its leading term may differ, because of its state, from what the weights cancel.

    It is at most 1.
    """
    fine = runs[0].flow
    apart = [[run.flow.begin.x - fine.begin.x, turn(fine.begin.R, run.flow.begin.R), run.flow.begin.v - fine.begin.v,
              run.flow.begin.w - fine.begin.w] for run in runs]  # where the intervals begin
    length, rate = runs[0].scale.length, fine.rate[:, None]

    # A stiff spring that hardly swings has a small leading term, which changes by itself with what it swings.
    with np.errstate(divide="ignore", invalid="ignore"):
        stiff = np.fmax(1.0, fine.spring ** (order + 1) / fine.sizes[order + 1])

    def size(parts: list[np.ndarray]) -> np.ndarray:
        with np.errstate(divide="ignore", invalid="ignore"):  # of what is at rest, all of this is zero
            sizes = np.max([np.linalg.norm(part, axis=-1) / unit for part, unit in
                            zip(parts, (length, 1.0, length * rate, rate), strict=True)], axis=(0, 2))
            return np.asarray(np.nan_to_num((order + 2) * stiff * sizes, nan=0.0))

    first = [size(parts) for parts in apart]
    if len(runs) == 2:
        return [np.minimum(1.0, share) for share in first]
    h = [run.claim.step or 1.0 for run in runs]
    ratio = (h[2] - h[0]) / (h[1] - h[0])
    bent = size([coarse - ratio * middle for middle, coarse in zip(*apart[1:], strict=True)])
    return [np.minimum(1.0, share**2 + (bent if share.any() else 0.0)) for share in first]
