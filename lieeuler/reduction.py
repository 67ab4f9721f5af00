"""What a run leaves out of a problem: welds, what a plane keeps, and the constraints of open trees."""

from __future__ import annotations

import numpy as np

from lieeuler import _kernel
from lieeuler.errors import ArgumentError
from lieeuler.joint_tree import Node, joint_tree
from lieeuler.methods import Method
from lieeuler.planar import Plane, plane_for
from lieeuler.problem import Problem
from lieeuler.solution import Solution, Status
from lieeuler.welded import Welded, welded_for

WORDS = ("welded", "planar", "axis", "joints", "off")
"""Those of `integrate(reduce=...)`."""

MOST_NODES = 2
"""Joint coordinates pay up to so many nodes a body: measured on bodies in a plane, which have three."""


def reductions(problem: Problem, method: Method, wanted: str | None) -> list[Welded | Plane]:
    """What a method leaves out of a problem, the first step first; by default what applies of `Method.reduced`.

    Raises
    ------
    ArgumentError
        The wanted word is not known, or does not apply.
    """
    if not (wanted is None or (isinstance(wanted, str) and wanted in WORDS)):
        raise ArgumentError(f"reduce must be one of {', '.join(WORDS)}, not {wanted!r}")
    words = {wanted} if wanted else {*method.reduced}
    steps: list[Welded | Plane] = []
    if words & {"welded", "joints"} and (welded := welded_for(problem)):
        steps.append(welded)
    if wanted == "welded" and not steps:
        raise ArgumentError("reduce='welded' does not apply: no two bodies are welded, joints are open at the start, "
                            "or a weld, joint or force ties a body to one that it is welded to")
    if words & {"planar", "axis"} and (plane := plane_for(steps[-1].problem if steps else problem, method, wanted)):
        steps.append(plane)
    return steps


def nodes(problem: Problem, steps: list[Welded | Plane], wanted: str | None, able: bool) -> tuple[Node, ...]:
    """The tree of joints that is integrated: by default one with few nodes, where no plane serves.

    able: whether the run can take joint coordinates.

    Raises
    ------
    ArgumentError
        The tree is wanted, but there is none.
    """
    if wanted not in (None, "joints") or any(isinstance(step, Plane) for step in steps):
        return ()
    tree = joint_tree(problem) if able else ()
    if wanted is None and len(tree) > MOST_NODES * problem.n:
        return ()
    if wanted and not tree:
        raise ArgumentError("reduce='joints' does not apply: it is for explicit Runge-Kutta methods on open trees that "
                            "hang on the ground, of joints that are not driven, do not roll and follow no other")
    return tree


def take_multipliers(problem: Problem, solution: Solution, angles: np.ndarray) -> None:
    """Give the solution, in place, the multipliers of the index-1 system of the problem, whose states it has.

    They have least norm if rows are redundant. At a singular position, where the system has no accurate multipliers,
    the solution ends as an integration of this problem would. `angles` (T, forces of the compiled system) of torsional
    springs are unwrapped, rad.
    """
    x, R, v, w = (np.ascontiguousarray(array) for array in (solution.x, solution.R, solution.v, solution.w))
    *_, solution.lam, _, solution.stats.redundant_rows, end = _kernel.index1(problem.kernel, solution.t, x, R, v, w,
                                                                             angles)
    if end < len(solution.t):
        solution.status, solution.t_end = Status.SINGULAR_MATRIX, float(solution.t[end])
        for name in ("t", "x", "R", "v", "w", "a", "alpha", "lam"):
            setattr(solution, name, getattr(solution, name)[:end])
