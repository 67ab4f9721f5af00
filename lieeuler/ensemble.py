"""`integrate_ensemble`: one problem from many initial states, with many parameters, in one call on several threads."""

from __future__ import annotations

import dataclasses
import functools
import logging
import numbers
import os
from collections.abc import Mapping
from typing import Any

import numpy as np

from lieeuler import _kernel
from lieeuler.checks import real
from lieeuler.errors import ArgumentError
from lieeuler.integrate import PreparedRun, chosen, output_times
from lieeuler.methods import Method
from lieeuler.paths import along, changed
from lieeuler.problem import Problem, raise_own
from lieeuler.solution import STATUSES, Status
from lieeuler.types import ArrayLike

log = logging.getLogger("lieeuler")

GROUPS = ("bodies", "joints", "forces")
MOST_MEMBERS = 10_000_000


@dataclasses.dataclass(frozen=True)
class EnsembleSolution:
    """Trajectories of N members at T output times, in the conventions of `lieeuler.types`.

    Attributes
    ----------
    t : (T,)
        s
    x, v, w : (N, T, n, 3)
    R : (N, T, n, 3, 3)
        A member that failed is NaN from there on, in all four arrays.
    status : (N,) of lieeuler.Status
        CONSTRAINTS_OPEN if the method is meant to hold positions or velocities on the constraints and they are off
        them at the end.
    t_end : (N,)
        The time that each member reached, s.
    steps, rejected_steps : (N,)
    wall_time : float
        For all members together, s.
    method : str
    """

    t: np.ndarray
    x: np.ndarray
    R: np.ndarray
    v: np.ndarray
    w: np.ndarray
    status: np.ndarray
    t_end: np.ndarray
    steps: np.ndarray
    rejected_steps: np.ndarray
    wall_time: float
    method: str

    @property
    def success(self) -> np.ndarray:
        """(N,) whether each member reached the last output time with its constraints closed."""
        return np.asarray(self.status == Status.SUCCESS, dtype=bool)

    def __repr__(self) -> str:
        ended = int(self.success.sum())
        return (f"EnsembleSolution({self.method}: {ended} of {len(self.status)} members reached {self.t[-1]:.6g} s, "
                f"{self.steps.sum()} steps, {self.wall_time:.3g} s of computing)")


def integrate_ensemble(problem: Problem, method: Method | str, step: Any = None, t_eval: ArrayLike | None = None, *,
                       x: ArrayLike | None = None, R: ArrayLike | None = None, v: ArrayLike | None = None,
                       w: ArrayLike | None = None, parameters: Mapping[str, ArrayLike] | None = None,
                       spin_free: bool | None = None, threads: int = 0, **options: Any) -> EnsembleSolution:
    """Integrate many members of one problem: each has its own state, parameters, steps and status.

    Each trajectory is that of `lieeuler.integrate` with reduce="off" to the last bit, whatever the other members,
    threads and processor. Parameters, and symmetric bodies unless `spin_free` is False, cost 0.3 ms a member.

    Parameters
    ----------
    problem : Problem
        What all members share; it also supplies whichever of x, R, v, w is not given.
    method, step, t_eval, spin_free, options
        As `lieeuler.integrate` takes them.
    x, R, v, w : (N, n, 3), (N, n, 3, 3), (N, n, 3), (N, n, 3), optional
        Initial states in the conventions of `lieeuler.types`. Each must satisfy the joints to rounding level, those of
        drives at t_eval[0].
    parameters : mapping of paths to arrays (N, ...), optional
        Such as "bodies.0.inertia" (N, 3, 3), "joints.1.child_anchor" (N, 3), "forces.0.stiffness" (N,), "gravity"
        (N, 3); a last index names one component, as in "gravity.2" (N,). All are set together: several components of
        one axis before it is made a unit vector, and an entry of an inertia with the one that equals it.
    threads : int
        0: one thread for each processor that the process may use.

    Raises
    ------
    ArgumentError
        An argument is wrong, or an initial state violates the joints. A member that fails later raises nothing.
    KeyboardInterrupt
        Ctrl-C.
    """
    method, t_eval = chosen(method, step, t_eval, options)
    t = output_times(t_eval)
    if problem.laws:
        raise ArgumentError("ensembles take no laws; integrate the members one by one, or leave laws out")
    if isinstance(threads, bool) or not isinstance(threads, numbers.Integral) or not 0 <= threads <= 1024:
        raise ArgumentError(f"threads must be a whole number from 0 (all processors) to 1024, not {threads!r}")
    if t[0] != problem.time:
        problem = Problem.unchecked(problem, time=float(t[0]))
    allowed = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    values = _parameters(problem, parameters or {})
    states, N = _states(problem, {"x": x, "R": R, "v": v, "w": w}, values)
    runs = [PreparedRun(problem, method, t, spin_free, "off", monitor=False)]
    starts = [states[name] for name in "xRvw"]
    if values or runs[0].state_decides:
        runs = [PreparedRun(_member(problem, k, states, values), method, t, spin_free, "off", monitor=False)
                for k in range(N)]
        starts = [np.stack(each) for each in zip(*(run.start for run in runs), strict=True)]
    vectors, R = np.full((N, 5, len(t), problem.n, 3), np.nan), np.full((N, len(t), problem.n, 3, 3), np.nan)
    statuses, t_end, steps, rejected, refused, interrupted, wall_time = _kernel.integrate_ensemble(
        [run.kernels[0] for run in runs], [run.kernels[1] for run in runs], [run.compiled for run in runs], *starts,
        min(int(threads) or allowed or 1, N), vectors, R)
    raise_own(problem)
    if interrupted:
        raise KeyboardInterrupt("interrupted during an ensemble")
    if refused < N:
        _member(problem, refused, states, {})
    status = np.array([STATUSES[word] for word in statuses], dtype=object)
    solution = EnsembleSolution(t, vectors[:, 0], R, vectors[:, 1], vectors[:, 2], status, np.array(t_end),
                                np.array(steps), np.array(rejected), wall_time, method.name)
    log.info("%r", solution)
    return solution


def _parameters(problem: Problem, given: Mapping[str, ArrayLike]) -> dict[str, np.ndarray]:
    """Arrays (N, ...) by path, each of the shape of what it replaces."""
    if not isinstance(given, Mapping):
        raise ArgumentError(f"parameters must map paths such as 'bodies.0.mass' to arrays, not {given!r}")
    found = {}
    for path, values in given.items():
        value = np.asarray(along(problem, path, "parameters", (*GROUPS, "gravity"))[-1])
        if value.dtype.kind != "f":
            raise ArgumentError(f"parameters: {path!r} is no number and no array of numbers")
        array, shape = real(values), value.shape
        if array is None or array.shape[1:] != shape or array.ndim == 0 or not np.isfinite(array).all():
            raise ArgumentError(f"parameters[{path!r}] must be finite numbers of shape {('N', *shape)}")
        found[path] = array
    return found


def _states(problem: Problem, given: Mapping[str, ArrayLike | None],
            values: Mapping[str, np.ndarray]) -> tuple[dict[str, np.ndarray], int]:
    """Contiguous arrays (N, n, ...) of all states, and N."""
    arrays, counts = {}, {f"parameters[{path!r}]": len(array) for path, array in values.items()}
    for name, value in given.items():
        if value is None:
            continue
        shape = getattr(problem, name).shape
        array = real(value)
        if array is None or array.shape[1:] != shape or array.ndim == 0:
            raise ArgumentError(f"{name} must be numbers of shape {('N', *shape)}")
        arrays[name], counts[name] = array, len(array)
    if not counts:
        raise ArgumentError("an ensemble needs x, R, v, w or parameters: arrays with one entry a member")
    N = next(iter(counts.values()))
    if set(counts.values()) != {N} or not 0 < N <= MOST_MEMBERS:
        sizes = ", ".join(f"{name} {count}" for name, count in counts.items())
        raise ArgumentError(f"all arrays must have as many members, from 1 to {MOST_MEMBERS}; here: {sizes}")
    for name in ("x", "R", "v", "w"):
        if name not in arrays:
            arrays[name] = np.repeat(getattr(problem, name)[None], N, axis=0)
    return arrays, N


def _new(value: Any, _: Any) -> Any:
    return value if np.ndim(value) else float(value)


def _member(problem: Problem, k: int, states: Mapping[str, np.ndarray], values: Mapping[str, np.ndarray]) -> Problem:
    """The problem of one member; its state and parameters are checked as those of any problem are."""
    try:
        member: Problem = changed(
            Problem.unchecked(problem, **{name: states[name][k] for name in "xRvw"}),
            {tuple(path.split(".")): functools.partial(_new, array[k]) for path, array in values.items()})
        return dataclasses.replace(member)
    except ArgumentError as error:
        raise ArgumentError(f"member {k}: {error}") from None
