"""What an integration returns."""

from __future__ import annotations

import dataclasses
import enum
from collections.abc import Callable
from typing import Any

import numpy as np

from lieeuler.checks import real
from lieeuler.errors import ArgumentError, LieEulerError
from lieeuler.types import ArrayLike


class Status(enum.StrEnum):
    """How an integration ended. Each status equals its text, as in `status == "success"`."""

    advice: str
    """What the user can change; empty for a success."""

    SUCCESS = "success", ""
    NEWTON_FAILED = "newton_failed", "Newton's iteration did not converge within a step; take a smaller step"
    SINGULAR_MATRIX = "singular_matrix", (
        "the constraints became dependent, or all but so: the mechanism is at or near a singular position; start "
        "elsewhere, or pass it with another step, a larger rtol, or a method of fixed steps that holds all levels "
        "(DAE1H_LSE, rattle2)")
    MAP_DOMAIN = "map_domain", (
        "a body turned beyond the coordinate map's domain within one step; take a smaller step")
    NON_FINITE = "non_finite", "the state became infinite or not a number; take a smaller step"
    STEP_TOO_SMALL = "step_too_small", (
        "step control asks for steps too small to end the run; take a larger rtol, or a method for stiff forces; a "
        "mechanism near a singular position asks for it too")
    NOT_UNIQUE = "not_unique", (
        "the motion has no unique continuation: stops that act on each other are hit at one instant, or one while "
        "another carries, and one of them bounces; end the run there")
    INTERRUPTED = "interrupted", "interrupted by the user"
    CONSTRAINTS_OPEN = "constraints_open", (
        "the run reached its end, and a constraint level that the method holds opened beyond 1e-8 of the system's size "
        "(stats.maxima); take a smaller step, a method that holds all levels (DAE1H_LSE, rattle2), or masses and "
        "inertias nearer to each other")

    def __new__(cls, word: str, advice: str) -> Status:
        """A member that equals its word."""
        status = str.__new__(cls, word)
        status._value_, status.advice = word, advice
        return status


STATUSES = {status.value: status for status in Status}
"""By their texts; quicker than `Status(text)`."""


@dataclasses.dataclass(slots=True)
class Stats:
    """Counters of a run, and the largest values over all of its steps.

    Attributes
    ----------
    steps, rejected_steps : int
        Accepted and rejected steps.
    force_evaluations : int
        Evaluations of the forces, those for samples included.
    newton_iterations, most_iterations, factorizations : int
        Over the whole run; most_iterations is the largest number in one step.
    redundant_rows : int
        How many constraint rows depend on the others. If any do, the multipliers are not unique and those of least
        norm are given; the motion does not depend on the choice.
    step : float or None
        The step used, s; None if the method chose its steps.
    wall_time : float
        s.
    maxima : dict
        energy_error (``|E - E(0)|`` over the largest kinetic energy), kinetic (J), constraint_position,
        constraint_velocity, constraint_acceleration (max norms, SI), orthogonality (max norm of R^T R - I). Empty
        without monitoring. Rows that were left out (see `reduce`) do not count.
    spin_free : tuple of int
        The bodies integrated in a frame that does not spin with them (`lieeuler.spin_free`).
    reduce : str
        What was left out: "off", "planar" or "axis" (`lieeuler.planar`), "welded" (`lieeuler.welded`), "joints"
        (`lieeuler.joint_tree`), or "welded" and one of the others, with a comma between.
    """

    steps: int
    rejected_steps: int
    force_evaluations: int
    newton_iterations: int
    factorizations: int
    most_iterations: int
    redundant_rows: int
    step: float | None
    wall_time: float
    maxima: dict[str, float]
    spin_free: tuple[int, ...] = ()
    reduce: str = "off"


@dataclasses.dataclass
class Solution:
    """A trajectory at the output times, in the conventions of `lieeuler.types`.

    a and alpha are M^-1 (f - G^T lam) with the multipliers of the method; at the start, with those of the index-1
    system. `events` are those of laws: the time, s, the index of the joint, and what happened: sticks, slips, reverses,
    hits_lower, hits_upper, leaves_lower, leaves_upper, saturates, unsaturates.
    """

    t: np.ndarray
    x: np.ndarray
    R: np.ndarray
    v: np.ndarray
    w: np.ndarray
    a: np.ndarray
    alpha: np.ndarray
    lam: np.ndarray
    status: Status
    stats: Stats
    method: str
    t_end: float
    events: tuple[tuple[float, int, str], ...] = ()
    resample: Callable[[np.ndarray], Solution] | None = dataclasses.field(default=None, repr=False, compare=False)

    def __getstate__(self) -> dict[str, Any]:
        return {**vars(self), "resample": None}

    def at(self, times: ArrayLike) -> Solution:
        """The solution at any times (K,) within the run, s: dense output of methods that choose their steps.

        The steps are those of the run, whatever times are asked for; between their ends the values are those of the
        method's continuous extension. They are computed anew, in the time of the run, for all these times at once.

        Raises
        ------
        ArgumentError
            A time lies outside of the run, or the run has fixed steps or laws, or is a copy from another process.
        """
        if self.resample is None:
            raise ArgumentError("states between samples are those of methods that choose their steps (rtol), of runs "
                                "without laws in this process; otherwise give more output times")
        t = real(times)
        if t is None or t.ndim != 1 or not (
                len(t) and t[0] >= self.t[0] and t[-1] <= self.t[-1] and (np.diff(t) > 0).all()):
            raise ArgumentError(f"times must increase between {self.t[0]:g} and {self.t[-1]:g} s, not {times!r}")
        return self.resample(t)

    @property
    def success(self) -> bool:
        """Whether the run reached its last output time with every level closed that its method holds."""
        return self.status is Status.SUCCESS

    def __repr__(self) -> str:
        return f"Solution({self})"

    def __str__(self) -> str:
        """One line: how the run ended, its steps and iterations, redundant constraint rows."""
        stats = self.stats
        words = [f"{self.method}: {self.status.value} at {self.t_end:.6g} s", f"{stats.steps} steps"
                 + (f" of {stats.step:.6g} s" if stats.step else f", {stats.rejected_steps} rejected")]
        if stats.newton_iterations:
            words.append(f"{stats.newton_iterations / max(1, stats.steps):.2f} Newton iterations a step")
        if stats.redundant_rows:
            words.append(f"{stats.redundant_rows} of {self.lam.shape[1]} constraint rows redundant")
        return ", ".join([*words, f"{stats.wall_time:.3g} s of computing"])


class IntegrationError(LieEulerError, RuntimeError):
    """An integration ended early. Carries `status`, `advice` and the trajectory so far in `solution`."""

    def __init__(self, status: Status, advice: str, solution: Solution) -> None:
        super().__init__(f"{status.value} at t = {solution.t_end:.6g} s: {advice}")
        self.status, self.advice, self.solution = status, advice, solution

    def __reduce__(self) -> tuple[type, tuple[Status, str, Solution]]:
        """Copies and pickles are made from the arguments of `__init__`; `args` holds only the message."""
        return type(self), (self.status, self.advice, self.solution)


class Interrupted(KeyboardInterrupt):
    """Ctrl-C during an integration; `solution` holds the trajectory so far."""

    def __init__(self, solution: Solution) -> None:
        super().__init__(f"interrupted at t = {solution.t_end:.6g} s")
        self.solution = solution

    def __reduce__(self) -> tuple[type, tuple[Solution]]:
        """As for `IntegrationError`."""
        return type(self), (self.solution,)
