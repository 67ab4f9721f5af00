"""A spanning tree of the joints of a scene from the ground, and the joints that close its loops."""

from __future__ import annotations

import dataclasses
import heapq
from collections.abc import Callable, Iterable

import numpy as np

from crosscheck.scene.model import GROUND, Joint, Scene


@dataclasses.dataclass(frozen=True)
class Branch:
    """A body and the joint that connects it to its parent; without a joint it moves freely relative to the ground."""

    body: int
    parent: int
    joint: Joint | None = None

    @property
    def outward(self) -> bool:
        """Whether the joint's parent is the inner body of the branch."""
        return self.joint is None or self.joint.child == self.body


def hung(scene: Scene, closes: Callable[[Joint], object]) -> tuple[list[tuple[int, Joint | None]], list[Joint]]:
    """((body, the joint whose child it is or None), parents first; the remaining joints).

    Those that `closes` names never carry a body. The first body of a circle of joints hangs on none.
    """
    joints: dict[int, Joint] = {}
    loops: list[Joint] = []
    for joint in scene.joints:
        if joint.child in joints or closes(joint):
            loops.append(joint)
        else:
            joints[joint.child] = joint
    order: dict[int, Joint | None] = {}
    while left := [body for body in range(scene.n) if body not in order]:
        reached = {GROUND, *order}
        ready = [body for body in left if body not in joints or joints[body].parent in reached]
        if not ready:
            loops.append(joints.pop(left[0]))
        order |= {body: joints.get(body) for body in ready}
    return list(order.items()), loops


def spanning_tree(scene: Scene, preference: Callable[[Joint], int] = lambda joint: 0,
                  roots: Iterable[int] = ()) -> tuple[list[Branch], list[Joint]]:
    """Branches, parents before children, and the remaining joints in file order.

    The tree grows from the ground and the bodies in `roots`. Joints of higher `preference` enter it first, among equal
    ones in file order; joints with a negative preference never enter it. Those of frames come before all others. A
    group of bodies that no such joint connects to the roots hangs on its first body with mass, which is free.
    """
    touching: dict[int, list[tuple[bool, int, int]]] = {body: [] for body in range(GROUND, scene.n)}
    for index, joint in enumerate(scene.joints):
        if preference(joint) >= 0:
            for body in (joint.parent, joint.child):
                touching[body].append((not scene.on_frame(joint), -preference(joint), index))
    branches, used, reached = [], set(), {GROUND, *roots}
    frontier = [choice for body in reached for choice in touching[body]]
    for first in (*np.argsort(scene.frames, kind="stable").tolist(), scene.n):
        heapq.heapify(frontier)
        while frontier:
            *_, index = heapq.heappop(frontier)
            joint = scene.joints[index]
            if (joint.parent in reached) != (joint.child in reached):
                inner, outer = (joint.parent, joint.child) if joint.parent in reached else (joint.child, joint.parent)
                branches.append(Branch(outer, inner, joint))
                used.add(index)
                reached.add(outer)
                for choice in touching[outer]:
                    heapq.heappush(frontier, choice)
        if first < scene.n and first not in reached:
            branches.append(Branch(first, GROUND))
            reached.add(first)
            frontier = list(touching[first])
    return branches, [joint for index, joint in enumerate(scene.joints) if index not in used]
