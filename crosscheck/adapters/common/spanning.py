"""The joints of a scene as a spanning tree that grows from the ground, and those that close its loops."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import numpy as np

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


def spanning_tree(scene: Scene, preference: Callable[[Joint], int]) -> tuple[list[Branch], list[Joint]]:
    """Branches, parents before children, and the joints left over, in file order.

    Joints of a higher `preference` enter the tree first, of equal ones the earlier in the file; those with a negative
    one never do. A group of bodies that no chosen joint ties to the ground hangs on its first body, which is free.
    """
    groups = list(range(scene.n + 1))  # of bodies tied together; the ground, -1, is the last

    def group(body: int) -> int:
        while groups[body] != body:
            body = groups[body]
        return body

    chosen: list[Joint] = []
    for joint in sorted(scene.joints, key=lambda joint: -preference(joint)):
        ends = group(joint.parent % len(groups)), group(joint.child % len(groups))
        if preference(joint) >= 0 and ends[0] != ends[1]:
            groups[ends[0]] = ends[1]
            chosen.append(joint)
    kept = {joint.name for joint in chosen}
    return _grown(scene, chosen), [joint for joint in scene.joints if joint.name not in kept]


def _grown(scene: Scene, chosen: list[Joint]) -> list[Branch]:
    reached, branches, left = {GROUND}, [], list(chosen)
    while len(reached) <= scene.n:
        joint = next((joint for joint in left if (joint.parent in reached) != (joint.child in reached)), None)
        if joint is None:
            branch = Branch(min(set(range(scene.n)) - reached), GROUND)
        else:
            left.remove(joint)
            inner, outer = joint.parent, joint.child
            branch = Branch(outer, inner, joint) if inner in reached else Branch(inner, outer, joint)
        branches.append(branch)
        reached.add(branch.body)
    return branches


def pose(scene: Scene, body: int) -> tuple[np.ndarray, np.ndarray]:
    """Initial position (3,) and attitude (3, 3) of a body or the ground, world axes."""
    return (np.zeros(3), np.eye(3)) if body == GROUND else (scene.x0[body], scene.R0[body])


def relative_pose(scene: Scene, parent: int, body: int) -> tuple[np.ndarray, np.ndarray]:
    """Initial position (3,) and attitude (3, 3) of `body` in the frame of `parent`."""
    (x, R), (at, turn) = pose(scene, parent), pose(scene, body)
    return R.T @ (at - x), R.T @ turn


def in_body(scene: Scene, start: int, end: int, vector: np.ndarray) -> np.ndarray:
    """Components in the frame of `end` of a vector given in that of `start`, at t = 0."""
    found: np.ndarray = pose(scene, end)[1].T @ pose(scene, start)[1] @ vector
    return found


def redundant_rows(scene: Scene) -> int:
    """Number of constraint rows of the scene that depend on the others in the initial position."""
    from crosscheck.scene import mechanics
    from crosscheck.scene.constraints import Constraints

    constraints = Constraints(scene)
    if constraints.m == 0:
        return 0
    scaled = constraints.jacobian(scene.x0[None], scene.R0[None])[0] @ np.linalg.cholesky(mechanics.inverse_mass(scene))
    sizes = np.linalg.svd(scaled, compute_uv=False)
    return constraints.m - int(np.count_nonzero(sizes > mechanics.RANK_TOLERANCE * sizes[0]))
