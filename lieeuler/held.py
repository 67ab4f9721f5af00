"""Whether a run held the constraint levels that its method holds by construction."""

from __future__ import annotations

import numpy as np

from lieeuler import _kernel
from lieeuler.methods import METHODS
from lieeuler.problem import Problem
from lieeuler.solution import Solution, Status
from lieeuler.types import GROUND

OPEN = 1e-8
"""How far a level may be open, as a part of the lengths, speeds and accelerations of the system; the same as at the
start of a problem. Runs that hold a level stay below 1e-12; constraints opened by rounding, redundant rows or very
different masses are far above 1e-8."""
CANCELLED = 1e-13
"""How far the acceleration level may be open as a part of the accelerations that the multipliers alone would give:
what rounding leaves where they cancel. With very different masses these exceed the accelerations of the motion by so
much that a bound of `OPEN` times them would accept anything."""


def open_levels(problem: Problem, solution: Solution) -> tuple[str, ...]:
    """The levels that the method should hold but that are open beyond their bounds; none without monitoring."""
    maxima = solution.stats.maxima
    if not maxima or not problem.joints:
        return ()
    bounds = _bounds(problem, solution)
    return tuple(level for level in METHODS[solution.method].held
                 if not maxima[f"constraint_{level}"] <= bounds[level])


def open_at(problem: Problem, method: str, x: np.ndarray, R: np.ndarray, v: np.ndarray, w: np.ndarray,
            t: float = 0.0) -> np.ndarray:
    """(N,) whether each of N states at time t violates the positions or velocities that the method holds.

    The measure and the bound are those that a problem's initial state must pass.
    """
    held = [level in METHODS[method].held for level in ("position", "velocity")]
    if not problem.joints or not any(held):
        return np.zeros(len(x), dtype=bool)
    x, R, v, w = (np.ascontiguousarray(array) for array in (x, R, v, w))
    levels = _kernel.constraint_levels(problem.kernel, x, R, v, w, t)
    return np.asarray(~(levels[:, held] <= OPEN).all(axis=1))


def judge(problem: Problem, solution: Solution) -> None:
    """Set the status CONSTRAINTS_OPEN on a solution that reached its end with an open level.

    In a run without monitoring only the last state is checked.
    """
    if solution.status is not Status.SUCCESS:
        return
    end = slice(len(solution.t) - 1, None)
    if open_levels(problem, solution) or (not solution.stats.maxima and open_at(
            problem, solution.method, solution.x[end], solution.R[end], solution.v[end], solution.w[end],
            float(solution.t[-1])).any()):
        solution.status = Status.CONSTRAINTS_OPEN


def _bounds(problem: Problem, solution: Solution) -> dict[str, float]:
    """How far each level may be open (m, m/s, m/s^2), from the samples of the run and its maxima."""
    anchors = [np.abs(anchor).max() for joint in problem.joints for body, anchor in (
        (joint.parent, joint.parent_anchor), (joint.child, joint.child_anchor)) if body != GROUND]
    length = max(float(np.abs(solution.x).max()), *anchors) or 1.0
    masses = [body.mass for body in problem.bodies]
    # Bodies may be faster between two samples than at them, so the kinetic energy of every step counts too. A system at
    # rest counts with the speed that its weight and loads would give it, as in the check of a problem's initial state.
    speed = max(float(np.abs(solution.v).max() + length * np.abs(solution.w).max()),
                float(np.sqrt(2 * solution.stats.maxima["kinetic"] / max(masses))))
    acceleration = float(np.abs(solution.a).max() + length * np.abs(solution.alpha).max() + speed**2 / length
                         + np.abs(problem.gravity).max())
    carried = float(np.abs(solution.lam).max(initial=0.0)) / min(masses)
    natural = length * problem.kernel.natural_rate(length)
    return {"position": OPEN * length, "velocity": OPEN * max(speed, natural),
            "acceleration": OPEN * acceleration + CANCELLED * carried}
