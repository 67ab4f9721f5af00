"""The joints of a scene as a spanning tree that grows from the ground, and those that close its loops."""

from __future__ import annotations

import dataclasses
import heapq
from collections.abc import Callable, Iterable

from crosscheck.scene.model import GROUND, Joint, Scene


@dataclasses.dataclass(frozen=True)
class Branch:
    """A body and what it hangs on; without a joint it moves freely, relative to the ground."""

    body: int
    parent: int
    joint: Joint | None = None

    @property
    def outward(self) -> bool:
        """Whether the joint calls the inner body its parent, as the branch does."""
        return self.joint is None or self.joint.child == self.body


def spanning_tree(scene: Scene, preference: Callable[[Joint], int] = lambda joint: 0,
                  roots: Iterable[int] = ()) -> tuple[list[Branch], list[Joint]]:
    """Branches, parents before children, and the joints left over, in file order.

    Joints of a higher `preference` enter the tree first, of equal ones the earlier in the file; those with a negative
    one never do. The ground and the bodies in `roots` are where it grows from. A group of bodies that no chosen joint
    ties to these hangs on its first body, which is free.
    """
    touching: dict[int, list[tuple[int, int]]] = {body: [] for body in range(GROUND, scene.n)}
    for index, joint in enumerate(scene.joints):
        if preference(joint) >= 0:
            for body in (joint.parent, joint.child):
                touching[body].append((-preference(joint), index))
    branches, used, reached = [], set(), {GROUND, *roots}
    frontier = [choice for body in reached for choice in touching[body]]
    for first in range(scene.n + 1):
        heapq.heapify(frontier)
        while frontier:
            _, index = heapq.heappop(frontier)
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
