"""Derivatives of a run by its start and by numbers of its problem.

The discrete map of a method is smooth: a run gives its values to rounding, and its derivative is the central difference
of order eight of whole runs, at a step that balances truncation with the rounding that the runs themselves show. It is
not forward mode; a direction costs eight runs for each step that is tried, mostly eight or sixteen.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from lieeuler import _kernel
from lieeuler.errors import ArgumentError, IntegrationError, LieEulerError
from lieeuler.paths import along, changed
from lieeuler.solution import Sensitivity, Solution, Status

if TYPE_CHECKING:
    from lieeuler.problem import Problem

WEIGHTS = (8 / 5, -2 / 5, 8 / 105, -1 / 140), (3 / 2, -3 / 10, 1 / 30), (4 / 3, -1 / 6)
"""Of (f(kh) - f(-kh)) / 2h in central differences of orders eight, six and four, k = 1, 2, ..."""

EVEN = np.array([15.0, -6.0, 1.0]) / np.sqrt(924.0), np.array([-56.0, 28.0, -8.0, 1.0]) / np.sqrt(12870.0)
"""Of the pairs f(kh) + f(-kh) - 2 f(0) in the sixth and eighth difference, which have the size of the noise of f."""

FIRST, LEAST, MOST = 0.01, 1e-6, 0.16
"""First, smallest and largest step, as part of a number, or in rad and in lengths of the system."""

AMPLIFIED = 1e6
"""How many roundings the noise of a run may have."""

SETTLED = 1e-12
"""Estimated error, relative to the largest entry, below which no other step is tried."""

RTOL = 1e-13
"""Tolerance of the runs of a method that chooses its steps: the choice is no smooth function of the start. What comes
out is the derivative of the motion, not of the steps."""

Changed = Callable[[float], "Problem"]
Solve = Callable[["Problem", bool], Solution]
"""Integrates a problem whose state is closed, and does not judge the solution; True: with nothing left out."""


def differentiated(problem: Problem, wanted: Sequence[str] | Mapping[str, Changed], solve: Solve
                   ) -> dict[str, Sensitivity]:
    """The derivatives of the solution by name; see `lieeuler.integrate`."""
    if isinstance(wanted, str) or not isinstance(wanted, Sequence | Mapping):
        raise ArgumentError("sensitivities must be a tuple of paths such as ('bodies.0.mass', 'start'), or map names "
                            f"to functions of a change that return the problem, not {wanted!r}")
    plans: dict[str, tuple[list[Changed], float]] = {}
    for name in wanted:
        if isinstance(wanted, Mapping):
            plans[name] = [wanted[name]], 1.0
        elif name == "start":
            plans[name] = _starts(problem), 1.0
        else:
            plans[name] = [functools.partial(_with, problem, name)], _scale(problem, name)
    base, made = functools.cache(functools.partial(solve, problem)), {}
    for name, (changes, scale) in plans.items():
        columns = [_derivative(name, base, solve, change, scale) for change in changes]
        slopes = np.stack([column for column, _, _ in columns], axis=-1)
        x, turn, v, w = slopes if name == "start" else slopes[..., 0]
        made[name] = Sensitivity(x, turn, v, w, max(error for _, error, _ in columns),
                                 sum(runs for _, _, runs in columns))
    return made


def _derivative(name: str, start: Callable[[bool], Solution], solve: Solve, change: Changed,
                scale: float) -> tuple[np.ndarray, float, int]:
    """Derivatives of (x, turn, v, w), (4, T, n, 3), by s at 0, their estimated error, and the number of runs."""
    h, direction, runs, best, error, whole = FIRST, 0, 0, None, np.inf, False
    base = start(whole)
    _require_complete(base)
    floor = 2.0**-52 * max(float(np.abs(part).max()) for part in (1.0, base.x, base.v, base.w))
    reason: LieEulerError | None = None
    while LEAST <= h <= MOST:
        noisy = False
        try:
            runs += 8
            ends = [[solve(change(sign * k * h * scale), whole) for sign in (1, -1)] for k in range(1, 5)]
            if not whole and any((end.stats.reduce, end.stats.spin_free) != (base.stats.reduce, base.stats.spin_free)
                                 for pair in ends for end in pair):  # it leaves the plane, or symmetry
                whole, base = True, start(True)
                continue
            values = [[_change(base, end) for end in pair] for pair in ends]
        except LieEulerError as failure:  # too far, or beyond an event
            reason = failure
        else:
            odd = [(up - down) / (2 * h * scale) for up, down in values]
            eighth, sixth, fourth = (sum(w * each for w, each in zip(weights, odd, strict=False))
                                     for weights in WEIGHTS)
            before, last = (np.abs(sum(w * (up + down) for w, (up, down) in zip(weights, values, strict=False))).max()
                            for weights in EVEN)
            # differences that fall with their order see the function, and not its noise
            noisy = last > 0.3 * before and last < AMPLIFIED * floor
            truncation = _next(np.abs(sixth - fourth).max(), np.abs(eighth - sixth).max())
            rounding = max(_next(before, last), floor) / (h * scale)
            if truncation + rounding < error:
                best, error = eighth, float(truncation + rounding)
            elif noisy:
                break
            if error <= SETTLED * np.abs(eighth).max():
                break
        turn = 1 if noisy else -1
        if turn == -direction:
            break
        direction, h = turn, h * 4.0**turn
    if best is None:
        raise ArgumentError(f"sensitivities: no derivative by {name!r}: {reason}")
    return np.asarray(best), error, runs


def _next(before: float, last: float) -> float:
    """The next of two terms, if they fall; else the last one."""
    return last * min(1.0, last / before) if before else last


def _change(base: Solution, other: Solution) -> np.ndarray:
    """(x, turn, v, w) of a run minus those of the base, (4, T, n, 3), the turn in body axes, to first order in it."""
    _require_complete(other)
    here, there = ([(*event[1:], np.searchsorted(base.t, event[0])) for event in each.events] for each in (base, other))
    if here != there:
        raise ArgumentError("the events of its laws change, or pass an output time")
    turned = np.swapaxes(base.R, 2, 3) @ other.R
    skew = (turned - np.swapaxes(turned, 2, 3)) / 2
    turn = np.stack([skew[..., 2, 1], skew[..., 0, 2], skew[..., 1, 0]], axis=-1)
    return np.stack([other.x - base.x, turn, other.v - base.v, other.w - base.w])


def _require_complete(solution: Solution) -> None:
    if solution.status not in (Status.SUCCESS, Status.CONSTRAINTS_OPEN):
        raise IntegrationError(solution.status, solution.status.advice, solution)


def closed(problem: Problem) -> Problem:
    """The problem with its state projected on joints and velocity constraints, by the least change in mass."""
    made = {"x": problem.x, "R": problem.R, "v": problem.v, "w": problem.w}
    for _ in range(2):  # the first ends near the joints, with a matrix from where it began; the second to rounding
        made = _kernel.project(problem.kernel, problem.x, problem.R, *(made[name] for name in "xRvw"))
        if made["status"] != Status.SUCCESS:
            raise ArgumentError(f"its joints do not close at the start: {made['status']}")
    projected = type(problem).unchecked(problem, **{name: made[name] for name in "xRvw"})
    vars(projected)["kernel"] = problem.kernel
    return projected


def _with(problem: Problem, path: str, change: float) -> Problem:
    made: Problem = changed(problem, {tuple(path.split(".")): lambda number: number + change})
    return closed(made) if path.startswith("joints.") else made


def _starts(problem: Problem) -> list[Changed]:
    """Changes of the start along a basis of those that joints admit: first of poses, then of velocities alone."""
    n, L = problem.n, problem.kernel.length
    size = np.tile(np.repeat([L, 1.0], 3), 2 * n)

    def moved(row: np.ndarray, s: float) -> Problem:
        step = (s * row).reshape(2, n, 6)
        angle = np.linalg.norm(step[0, :, 3:], axis=1)[:, None, None]
        hat = np.cross(step[0, :, None, 3:], np.eye(3)).swapaxes(1, 2)
        turn = np.eye(3) + np.sinc(angle / np.pi) * hat + np.sinc(angle / 2 / np.pi) ** 2 / 2 * hat @ hat
        return closed(type(problem).unchecked(problem, x=problem.x + step[0, :, :3], R=problem.R @ turn,
                                              v=problem.v + step[1, :, :3], w=problem.w + step[1, :, 3:]))

    rows, eps = [], 1e-4
    for part in range(2):
        columns = []
        for k in range(6 * n):
            row = np.eye(12 * n)[6 * n * part + k] * size
            up, down = (moved(row, sign * eps) for sign in (1, -1))
            turned = np.swapaxes(down.R, 1, 2) @ up.R
            turn = np.stack([turned[:, 2, 1] - turned[:, 1, 2], turned[:, 0, 2] - turned[:, 2, 0],
                             turned[:, 1, 0] - turned[:, 0, 1]], axis=1) / 2
            pose, speed = (up.x - down.x, turn), (up.v - down.v, up.w - down.w)
            columns.append(np.concatenate((pose, speed)[part], axis=1).ravel() / (2 * eps) / size[:6 * n])
        U, sizes, _ = np.linalg.svd(np.array(columns).T)
        for direction in U[:, sizes > 1e-6].T:
            row = np.zeros(12 * n)
            row[6 * n * part:6 * n * (part + 1)] = direction * size[:6 * n]
            rows.append(row)
    return [functools.partial(moved, row) for row in rows]


def _scale(problem: Problem, path: str) -> float:
    """The size of a number, by which steps are measured: its own, that of its array, or 1."""
    last, node = along(problem, path, "sensitivities")[-2:]
    if isinstance(node, bool) or not isinstance(node, int | float):
        raise ArgumentError(f"sensitivities: {path!r} is no number; name one, such as 'gravity.2' or 'bodies.0.mass'")
    size = float(np.linalg.norm(last)) if isinstance(last, np.ndarray) else abs(float(node))
    return size if 0 < size < np.inf else 1.0
