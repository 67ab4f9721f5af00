"""Whether a run held the constraint levels that its method holds by construction."""

from __future__ import annotations

import numpy as np

from lieeuler import _kernel
from lieeuler.problem import CLOSED, Problem
from lieeuler.solution import Solution

LEVELS = ("position", "velocity", "acceleration")


def opened(problem: Problem, solution: Solution) -> tuple[bool, bool, bool]:
    """Which levels a solution leaves open beyond their bounds (`lieeuler/_core/python/levels.hpp`): of all steps, or of
    the last state if the run was not monitored."""
    if not problem.joints:
        return False, False, False
    duration, maxima = float(solution.t[-1] - solution.t[0]), solution.stats.maxima
    if maxima:
        return _kernel.open_levels(
            problem.kernel, solution.x, solution.v, solution.w, solution.a, solution.alpha, solution.lam,
            maxima["constraint_position"], maxima["constraint_velocity"], maxima["constraint_acceleration"],
            maxima["kinetic"], duration)
    end = slice(len(solution.t) - 1, None)
    levels = _kernel.constraint_levels(problem.kernel, solution.x[end], solution.R[end], solution.v[end],
                                       solution.w[end], float(solution.t[-1]), duration)[0]
    return not levels[0] <= CLOSED, not levels[1] <= CLOSED, False


def open_at(problem: Problem, levels: tuple[str, ...], x: np.ndarray, R: np.ndarray, v: np.ndarray, w: np.ndarray,
            t: float, duration: float) -> np.ndarray:
    """(N,) whether each of N states at time t, after a duration, violates these levels of positions or velocities, by
    the measure and the bound that a problem's initial state must pass."""
    held = [level in levels for level in LEVELS[:2]]
    if not problem.joints or not any(held):
        return np.zeros(len(x), dtype=bool)
    x, R, v, w = (np.ascontiguousarray(array) for array in (x, R, v, w))
    found = _kernel.constraint_levels(problem.kernel, x, R, v, w, t, duration)
    return np.asarray(~(found[:, held] <= CLOSED).all(axis=1))
