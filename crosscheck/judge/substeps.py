"""Judge whether a run with a fixed step took more steps than it was asked for.

The engine's own count may show it, or else the states. Up to the first output time at which errors can be seen, plain
methods are run with the wanted step and with parts of it. Small errors alone prove nothing, because the method may just
be better. But a run whose states are those of a plain method with k parts of a step is that method with hidden
sub-steps.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np

from crosscheck.compare.apart import turn
from crosscheck.document import Finding
from crosscheck.judge.claim import Trace
from crosscheck.judge.tolerances import scales
from crosscheck.references.base import Reference
from crosscheck.scene.batch import State, rates_of
from crosscheck.scene.model import Scene
from crosscheck.scene.vectors import exponential, inverse_tangent

TABLEAUX: dict[int, tuple[tuple[tuple[tuple[float, ...], ...], tuple[float, ...]], ...]] = {
    1: ((((),), (1.0,)),),
    2: ((((), (0.5,)), (0.0, 1.0)), (((), (1.0,)), (0.5, 0.5))),
    4: ((((), (0.5,), (0.0, 0.5), (0.0, 0.0, 1.0)), (1 / 6, 1 / 3, 1 / 3, 1 / 6)),),
}
"""Coefficients and weights of the stages of plain methods by order."""

MORE = 1.01
"""Largest allowed ratio of counted to wanted steps. Some engines count the first step twice."""

NEAR, FEWEST, MOST = 1.2, 1.5, 40.0
"""Numbers of parts of a step. Plain methods are tried from NEAR to MOST parts, and reported from FEWEST on, below
which an engine is left alone that finds events and counts what it takes in vain, too."""

ALIKE = 5e-3
"""A run and a plain method are the same if they differ by less than this share of the error. Rounding and maps to the
rotations cause small differences. A method with the same leading term (weights 0.45 and 0.55 have that of ten parts of
an Euler step) differs in the next term, by a share h W."""

ASKEW, DEAREST = 0.3, 4000
"""A plain method is run with parts of a step only if the direction of its error differs by less than the share ASKEW or
h W, which the next term of the error has, and if it takes less than DEAREST steps, which are made in Python."""

SEEN = 1e-10
"""Errors of y below this are not compared."""

Rates = Callable[[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray], State]
"""(t, x, R, v, w) -> [dx/dt, ., dv/dt, dw/dt]."""
Stepper = Callable[[Rates, np.ndarray, State, np.ndarray], State]


def judge_substeps(scene: Scene, traj: Trace, truth: Reference, order: int, asked: int,
                   finest: tuple[Trace, int] | None = None) -> list[Finding]:
    """The finding about a run of which `asked` steps were wanted; none if the run is not finite.

    If the states show more steps than the engine counts, the states decide. Where forces jump, to find an event takes
    steps, as many at each step: there the count is that of more steps, up to those of the `finest` run, of which as
    many were wanted as stands beside it.
    """
    if not np.isfinite(traj.x).all():
        return []
    counted = _counted(scene, traj) / asked
    most, value, like, what = MORE, counted, 0.0, "as many as were asked for"
    if truth.events and finest is not None and finest[1] > asked and (
            more := (_counted(scene, finest[0]) - _counted(scene, traj)) / (finest[1] - asked)) * FEWEST > 1.0:
        most, value, what = FEWEST, more, "its own count, without what events take at any step"
    elif counted > MORE:
        what = "its own count"
    elif scene.has_laws:
        what += ", by its own count: where forces jump, no plain method stands beside it"
    else:
        with np.errstate(over="ignore", invalid="ignore"):
            like, alike = _like(scene, traj, truth, order, asked // (len(traj.t) - 1))
        if alike:
            value, what = like, f"it comes out where a plain method of order {order} does with {like:g} steps for each"
        elif like >= FEWEST:
            what += f"; errors as small as those of a plain method with {like:.2g} steps for each"
    return [Finding("sub-steps", "ok" if value <= most else "fail", float(value), most, "1",
                    "steps taken for each that was asked for", what)]


def _counted(scene: Scene, traj: Trace) -> float:
    """The steps of a run by what it says of their number and of their size."""
    step = traj.stats.get("step")
    return float(max(traj.steps, scene.duration / step if step else 0.0))


def _like(scene: Scene, traj: Trace, truth: Reference, order: int, per: int) -> tuple[float, bool]:
    """The number of parts of a step with which a plain method has errors of the run's size, and whether it is the same.
    """
    scale = scales(scene, truth)
    owns, trues = ([states.x, states.R, states.v, states.w] for states in (traj, truth.states))

    def gap(one: State, other: State) -> np.ndarray:
        parts = (one[0] - other[0]) / scale.length, turn(other[1], one[1]), *(
            (one[k] - other[k]) / size for k, size in ((2, scale.length * scale.rate), (3, scale.rate)))
        return np.concatenate(parts, axis=-1)

    errors = gap(owns, trues)
    # An error in the initial state, as of numbers of 32 bits, is none of a step.
    until = 1 + np.flatnonzero(np.linalg.norm(errors[1:], axis=(1, 2)) > SEEN)[:1]
    error = errors[until]
    size = float(np.linalg.norm(error))
    if not SEEN < size < 1.0:
        return 0.0, False
    true, tau, per = [part[until] for part in trues], float((traj.t[until] - traj.t[:1])[0]), per * int(until[0])
    askew, likest = max(ASKEW, tau / per * scale.rate), 0.0
    for stepper in PLAIN.get(order, ()):  # ends at the first one if the sizes of errors do not fit
        def at(parts: int, stepper: Stepper = stepper) -> np.ndarray:
            reached = _reached(scene, stepper, tau, per * parts)
            return np.full_like(error, math.inf) if reached is None else gap(reached, true)

        plain = at(1)
        guess = (float(np.linalg.norm(plain)) / size) ** (1 / order)
        likest = max(likest, guess) if math.isfinite(guess) else likest
        if not NEAR <= guess <= MOST:
            break
        # With parts of a step, the error has the same direction except for the next term.
        along = plain * (float(np.vdot(plain, error)) / float(np.vdot(plain, plain)))
        if float(np.linalg.norm(error - along)) > askew * size or per * guess > DEAREST:
            continue
        tried = max(2, round(guess))
        distance = at(tried)
        if not np.isfinite(distance).all():
            continue
        again = round(tried * (float(np.linalg.norm(distance)) / size) ** (1 / order))
        if again != tried and 1 < again <= MOST:
            tried, distance = again, at(again)
        if float(np.linalg.norm(distance - error)) <= ALIKE * size:
            return float(tried), True
    return likest, False


def _reached(scene: Scene, stepper: Stepper, tau: float, count: int) -> State | None:
    """The state after `tau` s in `count` steps of a plain method, once for all engines; None if it has diverged."""
    key = scene.hash, stepper, tau, count
    if key not in _kept:
        h, state, rates = np.array([tau]) / count, [each[None] for each in (
            scene.x0, scene.R0, scene.v0, scene.w0)], rates_of(scene)
        try:
            for k in range(count):
                state = stepper(rates, k * h, state, h)
            _kept[key] = state
        except np.linalg.LinAlgError:
            _kept[key] = None
    return _kept[key]


_kept: dict[tuple[str, Stepper, float, int], State | None] = {}  # kilobytes each, a few for a scene and order


def semi_implicit(rates: Rates, t: np.ndarray, state: State, h: np.ndarray) -> State:
    """Semi-implicit Euler."""
    x, R, v, w = state
    h = h.reshape(-1, 1, 1)
    a, alpha = rates(t, *state)[2:]
    v, w = v + h * a, w + h * alpha
    return [x + h * v, R @ exponential(h * w), v, w]


def exponential_step(rates: Rates, t: np.ndarray, state: State, h: np.ndarray, stages: Any, weights: Any) -> State:
    """Runge-Kutta-Munthe-Kaas: integrates the rotation vector since the start of the step, with the rate dexp^-1 w."""
    x, R, v, w = state
    h = h.reshape(-1, 1, 1)
    slopes: list[State] = []

    def moved(row: Any) -> tuple[State, np.ndarray]:
        dx, turned, dv, dw = (sum((c * rate[k] for c, rate in zip(row, slopes, strict=True)), np.zeros_like(x)) * h
                              for k in range(4))
        return [x + dx, R @ exponential(turned), v + dv, w + dw], turned

    for row in stages:
        here, turned = moved(row)
        a, alpha = rates(t + sum(row) * h[:, 0, 0], *here)[2:]
        slopes.append([here[2], inverse_tangent(turned, here[3]), a, alpha])
    return moved(weights)[0]


def _additive(rates: Rates, t: np.ndarray, state: State, h: np.ndarray, stages: Any, weights: Any) -> State:
    h = h.reshape(-1, 1, 1)
    slopes: list[State] = []

    def moved(row: Any) -> State:
        return [part + sum((c * rate[k] for c, rate in zip(row, slopes, strict=True)), np.zeros_like(part))
                * h.reshape((-1,) + (1,) * (part.ndim - 1)) for k, part in enumerate(state)]

    for row in stages:
        slopes.append(rates(t + sum(row) * h[:, 0, 0], *moved(row)))
    x, R, v, w = moved(weights)
    U, _, V = np.linalg.svd(R)
    return [x, U @ V, v, w]


PLAIN: dict[int, tuple[Stepper, ...]] = {order: tuple(
    partial(turned, stages=stages, weights=weights) for stages, weights in tableaux for turned in (
        exponential_step, _additive)) for order, tableaux in TABLEAUX.items()}
"""Plain methods by order: with exponentials, and with matrices that are made rotations after every step."""
PLAIN[1] = (*PLAIN[1], semi_implicit)
