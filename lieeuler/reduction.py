"""What a run leaves out of a problem: welds, what a plane keeps, and the constraints of open trees."""

from __future__ import annotations

from lieeuler.errors import ArgumentError
from lieeuler.joint_tree import Node, joint_tree
from lieeuler.methods import Method
from lieeuler.planar import Plane, plane_of
from lieeuler.problem import Problem
from lieeuler.reduced import Reduced
from lieeuler.welded import welded_for

WORDS = ("welded", "planar", "axis", "joints", "off")
"""Those of `integrate(reduce=...)`."""

MOST_NODES = 2
"""Joint coordinates pay up to so many nodes a body: measured on bodies in a plane, which have three."""


def reductions(problem: Problem, method: Method, wanted: str | None) -> list[Reduced]:
    """What a method leaves out of a problem, the first step first; by default what applies of `Method.reduced`.

    Raises
    ------
    ArgumentError
        The wanted word is not known, or does not apply.
    """
    if not (wanted is None or (isinstance(wanted, str) and wanted in WORDS)):
        raise ArgumentError(f"reduce must be one of {', '.join(WORDS)}, not {wanted!r}")
    words = {wanted} if wanted else {*method.reduced}
    welded = welded_for(problem) if words & {"welded", "joints"} else None
    steps: list[Reduced] = [welded] if welded else []
    if wanted == "welded" and not steps:
        raise ArgumentError("reduce='welded' does not apply: no two bodies are welded, joints are open at the start, "
                            "or a weld, joint or force ties a body to one that it is welded to")
    if words & {"planar", "axis"}:
        plane = plane_of(steps[-1].problem if steps else problem, method.name == "taylor")
        if isinstance(plane, Plane) and wanted == "axis" != plane.word:
            plane = "its bodies do not all turn about axes fixed in the ground"
        if isinstance(plane, Plane):
            steps.append(plane)
        elif wanted:
            raise ArgumentError(f"reduce={wanted!r} does not apply: {plane}")
    return steps


def nodes(problem: Problem, steps: list[Reduced], wanted: str | None, able: bool) -> tuple[Node, ...]:
    """The tree of joints that is integrated: by default one with few nodes, where no plane serves.

    able: whether the run can take joint coordinates.

    Raises
    ------
    ArgumentError
        The tree is wanted, but there is none.
    """
    if wanted not in (None, "joints") or any(step.word != "welded" for step in steps):
        return ()
    tree = joint_tree(problem) if able else ()
    if wanted is None and len(tree) > MOST_NODES * problem.n:
        return ()
    if wanted and not tree:
        raise ArgumentError("reduce='joints' does not apply: it is for explicit Runge-Kutta methods on open trees that "
                            "hang on the ground, of joints that are not driven, do not roll and follow no other")
    return tree
