"""Trees of joints whose coordinates the explicit methods integrate in place of their bodies'.

Every joint becomes a chain of nodes: slides along axes of its parent, then hinges or a ball. A universal joint is two
hinges, a planar one two slides and a hinge, a point on a line a slide and a ball. Links between the nodes of a joint
have no mass. The kernel computes all bodies by (16.5) and (16.6) of docs/theory.md; their multipliers are restored at
the samples.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from lieeuler import _kernel
from lieeuler.joints import Joint
from lieeuler.problem import DEPENDENT, ROUNDING, Problem, once
from lieeuler.types import GROUND

Node = tuple[_kernel.JointNodeKind, int, int, bool, np.ndarray, np.ndarray, float]
"""As a compiled run takes it: its kind; the parent among the nodes, -1 is the ground; the joint that it belongs to, and
whether it carries the child of the joint; (3, 3) attitude of its link relative to the parent's at the start, where the
angle is zero; (3,) axis, of a hinge in its own link, of a slide in the parent's; the inertia of rotors on this
coordinate, kg m^2 or kg."""


@once
def joint_tree(problem: Problem) -> tuple[Node, ...]:
    """The nodes, parents first; none if the problem is no tree of joints on the ground, or has ball joints only, which
    the methods know better."""
    outward = _outward(problem)
    if len(outward) != problem.n or all(joint.spherical and not joint.dots for joint in problem.joints):
        return ()
    if not problem.opening <= ROUNDING:
        return ()
    nodes: list[Node] = []
    carrying = {GROUND: -1}
    for index in outward:
        joint = problem.joints[index]
        free = _freedoms(problem, joint)
        if not free:
            return ()
        Q = problem.attitude(joint.parent).T @ problem.R[joint.child]
        parent, kinds = carrying[joint.parent], [kind for kind, _ in free]
        for k, (kind, axis) in enumerate(free):
            last = k == len(free) - 1
            rotors = [rotor.inertia for rotor in joint.rotors if rotor.turns == (kind == "hinge")]
            if rotors and (kind == "ball" or kinds.count("hinge") > 1):
                return ()
            turn = Q if last else np.eye(3)
            nodes.append((_kernel.JointNodeKind[kind], parent, index, last, turn, axis, sum(rotors)))
            parent = len(nodes) - 1
        carrying[joint.child] = parent
    return tuple(nodes)


def _outward(problem: Problem) -> list[int]:
    """The joints in an order in which every parent hangs before its child; none if one closes a loop, points inwards,
    or hangs on nothing."""
    below: dict[int, list[int]] = {}
    for index, joint in enumerate(problem.joints):
        below.setdefault(joint.parent, []).append(index)
    order, queue = list[int](), [GROUND]
    for body in queue:
        order += below.get(body, [])
        queue += [problem.joints[index].child for index in below.get(body, [])]
        if len(queue) > problem.n + 1:
            return []
    return order if len(set(queue)) == len(queue) == len(problem.joints) + 1 else []


def _freedoms(problem: Problem, joint: Joint) -> list[tuple[str, np.ndarray]]:
    """Slides, hinges or a ball, with their axes; none if the joint is rigid or is not made of these."""
    rows = joint.basic_rows
    if rows is None or joint.drive is not None or joint.mimic is not None:
        return []
    across, turns = rows
    slides = _normal_to(across)
    rotors_slide = any(not rotor.turns for rotor in joint.rotors)
    if rotors_slide and len(slides) != 1:
        return []
    free = [("slide", axis) for axis in slides]
    if not turns:
        return [*free, ("ball", np.zeros(3))]
    if len(turns) == 1:
        return [] if slides else [("hinge", turns[0].a_axis), ("hinge", turns[0].b_axis)]
    left = [problem.R[joint.child].T @ axis for axis in _normal_to(problem.held_turns(joint, turns))]
    if not left:
        return free
    if len(left) > 1 or any(np.abs(np.cross(dot.b_axis, left[0])).max() > ROUNDING for dot in turns):
        return []
    return [*free, ("hinge", left[0])]


def _normal_to(directions: Sequence[np.ndarray] | np.ndarray) -> list[np.ndarray]:
    """Unit vectors normal to all these directions and to each other."""
    if not len(directions):
        return list(np.eye(3))
    _, sizes, rows = np.linalg.svd(np.reshape(directions, (-1, 3)))
    return list(rows[int((sizes > DEPENDENT).sum()):])
