"""Whether a run with a fixed step took more steps than it was asked for.

Its own count may say so. Else the states may: up to the first output time plain methods are stepped with the step asked
for and with parts of it. Errors that are as small as those of shorter steps may be a method's own; a run that comes out
where a plain method does in k parts of a step, and not in one, is that method.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

from crosscheck.document import Finding
from crosscheck.judge.defects import turn
from crosscheck.judge.flow import State, index1_rates
from crosscheck.judge.tolerances import scales
from crosscheck.references.base import Reference
from crosscheck.scene.model import Scene
from crosscheck.scene.vectors import exponential, inverse_tangent

TABLEAUX: dict[int, tuple[tuple[tuple[tuple[float, ...], ...], tuple[float, ...]], ...]] = {
    1: ((((),), (1.0,)),),
    2: ((((), (0.5,)), (0.0, 1.0)), (((), (1.0,)), (0.5, 0.5))),
    4: ((((), (0.5,), (0.0, 0.5), (0.0, 0.0, 1.0)), (1 / 6, 1 / 3, 1 / 3, 1 / 6)),),
}
"""Stages and weights of plain methods by order."""

MORE = 1.01
"""Times the steps asked for that a count may be: some engines count the first step twice."""

NEAR, FEWEST, MOST = 1.2, 1.5, 40.0
"""Parts of a step: from the first number to the last one plain methods are tried, from the second on it is said."""

ALIKE = 5e-3
"""Of its error by which a run may differ from the plain method that it is: roundings, and maps to the rotations. A
method that has the leading term of k parts in common, as one with the weights 0.45 and 0.55 has that of ten parts of
Euler's, differs by the next, a share h W."""

ASKEW, DEAREST = 0.3, 4000
"""Of its error, by which a run may point elsewhere than the plain method to be compared with it in parts; and the plain
steps up to which it is, since they are taken in Python."""

SEEN = 1e-10
"""Errors of y below it are not compared."""

Stepper = Callable[[Scene, np.ndarray, State, np.ndarray], State]


def judge_substeps(scene: Scene, traj: Any, truth: Reference, order: int, asked: int) -> list[Finding]:
    """The finding on a run of `asked` steps; nothing where it is not finite.

    A count that says less than the states is not believed.
    """
    if not np.isfinite(traj.x).all():
        return []
    step = traj.stats.get("step")
    counted = max(traj.steps, scene.duration / step if step else 0.0) / asked
    value, like, what = counted, 0.0, "as many as were asked for"
    if counted > MORE:
        what = "its own count"
    else:
        like, alike = _like(scene, traj, truth, order, asked // (len(traj.t) - 1))
        if alike:
            value, what = like, f"it comes out where a plain method of order {order} does with {like:g} steps for each"
        elif like >= FEWEST:
            what += f"; errors as small as those of a plain method with {like:.2g} steps for each"
    return [Finding("sub-steps", "ok" if value <= MORE else "fail", float(value), MORE, "1",
                    "steps taken for each that was asked for", what)]


def _like(scene: Scene, traj: Any, truth: Reference, order: int, per: int) -> tuple[float, bool]:
    """In how many parts of a step a plain method has errors of the run's size, and whether it comes out there."""
    scale, tau = scales(scene, truth), traj.t[1:2] - traj.t[:1]
    start: State = [scene.x0[None], scene.R0[None], scene.v0[None], scene.w0[None]]
    own, true = ([part[1:2] for part in (states.x, states.R, states.v, states.w)] for states in (traj, truth.states))

    def gap(one: State, other: State) -> np.ndarray:
        parts = (one[0] - other[0]) / scale.length, turn(other[1], one[1]), *(
            (one[k] - other[k]) / size for k, size in ((2, scale.length * scale.rate), (3, scale.rate)))
        return np.concatenate(parts, axis=-1)

    error = gap(own, true)
    size = float(np.linalg.norm(error))
    if not SEEN < size < 1.0:
        return 0.0, False
    likest = 0.0
    for stepper in _plain(order):  # the first one tells whether it is worth while
        def at(parts: int, stepper: Stepper = stepper) -> np.ndarray:
            h, state = tau / (per * parts), start
            for k in range(per * parts):
                state = stepper(scene, k * h, state, h)
            return gap(state, true)

        plain = at(1)
        guess = (float(np.linalg.norm(plain)) / size) ** (1 / order)
        likest = max(likest, guess) if math.isfinite(guess) else likest
        if not NEAR <= guess <= MOST:
            break
        # Parts of a step leave an error of the same direction, but for the next term.
        along = plain * (float(np.vdot(plain, error)) / float(np.vdot(plain, plain)))
        if float(np.linalg.norm(error - along)) > ASKEW * size or per * guess > DEAREST:
            continue
        tried = max(2, round(guess))
        found = at(tried)
        again = round(tried * (float(np.linalg.norm(found)) / size) ** (1 / order))
        if again != tried and 1 < again <= MOST:
            tried, found = again, at(again)
        if float(np.linalg.norm(found - error)) <= ALIKE * size:
            return float(tried), True
    return likest, False


def _plain(order: int) -> Iterator[Stepper]:
    """Plain methods of an order, attitudes by exponentials and as matrices that are made rotations after every step."""
    for stages, weights in TABLEAUX.get(order, ()):
        for turned in (_exponential, _additive):
            def step(scene: Scene, t: np.ndarray, state: State, h: np.ndarray,
                     stages: Any = stages, weights: Any = weights, turned: Any = turned) -> State:
                found: State = turned(scene, t, state, h.reshape(-1, 1, 1), stages, weights)
                return found
            yield step
    if order == 1:
        yield _semi_implicit


def _semi_implicit(scene: Scene, t: np.ndarray, state: State, h: np.ndarray) -> State:
    x, R, v, w = state
    h = h.reshape(-1, 1, 1)
    a, alpha = index1_rates(scene, t, *state)[2:]
    v, w = v + h * a, w + h * alpha
    return [x + h * v, R @ exponential(h * w), v, w]


def _exponential(scene: Scene, t: np.ndarray, state: State, h: np.ndarray, stages: Any, weights: Any) -> State:
    """Runge-Kutta-Munthe-Kaas: rotation vectors from the start of the step, whose rate is dexp^-1 of w."""
    x, R, v, w = state
    found: list[State] = []

    def moved(row: Any) -> tuple[State, np.ndarray]:
        dx, turned, dv, dw = (sum((c * rate[k] for c, rate in zip(row, found, strict=True)), np.zeros_like(x)) * h
                              for k in range(4))
        return [x + dx, R @ exponential(turned), v + dv, w + dw], turned

    for row in stages:
        here, turned = moved(row)
        a, alpha = index1_rates(scene, t + sum(row) * h[:, 0, 0], *here)[2:]
        found.append([here[2], inverse_tangent(turned, here[3]), a, alpha])
    return moved(weights)[0]


def _additive(scene: Scene, t: np.ndarray, state: State, h: np.ndarray, stages: Any, weights: Any) -> State:
    found: list[State] = []

    def moved(row: Any) -> State:
        return [part + sum((c * rate[k] for c, rate in zip(row, found, strict=True)), np.zeros_like(part))
                * h.reshape((-1,) + (1,) * (part.ndim - 1)) for k, part in enumerate(state)]

    for row in stages:
        found.append(index1_rates(scene, t + sum(row) * h[:, 0, 0], *moved(row)))
    x, R, v, w = moved(weights)
    U, _, V = np.linalg.svd(R)
    return [x, U @ V, v, w]
