"""A scene as links: every body with the joint that connects it to its parent, as a chain of elementary motions.

A link is a joint taken from the ground outwards. Starting from the inner body's axes at its anchor, the chain is the
constant rotation `zero`, then the parts in order, each after its `offset` and in the axes reached so far; it ends in
the outer body's axes at its own anchor. Relative attitudes map outer to inner axes.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Sequence

import numpy as np

from crosscheck.scene.model import (
    GROUND,
    Joint,
    Scene,
    quaternion_from_rotation,
    quaternion_product,
    rotation_from_quaternion,
)
from crosscheck.scene.spanning import spanning_tree
from crosscheck.scene.vectors import normal_references, shortest_rotation, slide_direction

IDENTITY = np.array([1.0, 0.0, 0.0, 0.0])
_ZERO = np.zeros(3)
CUT_LAST = {"fixed": 1, "revolute": 2, "spherical": 3}
"""Joint types that engines can use to close loops, the most suitable last; the others stay in the tree if possible."""


@dataclasses.dataclass(frozen=True)
class Part:
    """An elementary motion: a turn about or a slide along `axis`, unit, or a ball."""

    kind: str  # "turn" | "slide" | "ball"
    axis: np.ndarray = dataclasses.field(default_factory=lambda: _ZERO)
    offset: np.ndarray = dataclasses.field(default_factory=lambda: _ZERO)  # m, before the motion

    @property
    def dofs(self) -> int:
        """Number of degrees of freedom."""
        return 3 if self.kind == "ball" else 1

    @property
    def coordinates(self) -> int:
        """Number of position coordinates; a ball has four, its quaternion w, x, y, z."""
        return 4 if self.kind == "ball" else 1


@dataclasses.dataclass(frozen=True)
class Link:
    """A body and the joint to its parent (body index, or -1 for the ground); the type is "free" without a joint."""

    body: int
    parent: int
    type: str
    parent_anchor: np.ndarray  # (3,) parent's frame, from its centre of mass; world for the ground
    child_anchor: np.ndarray  # (3,) body frame, from the centre of mass
    axis: np.ndarray  # (3,) unit, body frame; zero for a joint without an axis
    zero: np.ndarray  # (4,) quaternion w, x, y, z of the relative attitude at zero joint coordinate
    parts: tuple[Part, ...] = ()
    joint: str = ""  # the joint's name
    outward: bool = True  # whether this body is the joint's child

    @property
    def dofs(self) -> int:
        """Degrees of freedom of the joint."""
        return sum(part.dofs for part in self.parts)


def obstacle(scene: Scene, types: Iterable[str], forces: Iterable[str] = (), floating: bool = False) -> str | None:
    """Why `scene` is not an open tree of joints and forces of these types, or None if it is one.

    If `floating`, bodies may hang on no joint.
    """
    types, forces = tuple(types), tuple(forces)
    for force in scene.loads:
        if force.law.measure == "slide" and force.is_spring:
            return f"the spring or damper along joint {force.joint!r} is not built into this adapter"
        if force.type not in forces:
            known = f"it has gravity and {', '.join(forces)}" if forces else "only gravity is"
            return f"forces of type {force.type} are not built into this adapter; {known}"
    for joint in scene.joints:
        if joint.type not in types:
            return f"joint {joint.name!r}: type {joint.type} is not built; this form has {', '.join(types)}"
    if floating and not spanning_tree(scene)[1]:
        return None
    if not is_open_tree(scene):
        return "the joints do not form an open tree rooted in the ground (a loop, or a body that hangs on no joint)"
    return None


def is_open_tree(scene: Scene) -> bool:
    """Whether joints connect every body to the ground and none closes a loop."""
    branches, closing = spanning_tree(scene)
    return not closing and all(branch.joint is not None for branch in branches)


def links(scene: Scene) -> tuple[Link, ...]:
    """The links of an open tree, parents before children; bodies without a joint have free ones."""
    branches, closing = spanning_tree(scene)
    if closing:
        raise ValueError(f"scene {scene.name!r} is no open tree")
    return tuple(link(scene, branch.joint, branch.outward) if branch.joint else free(branch.body)
                 for branch in branches)


def unfold(scene: Scene, always_cut: tuple[str, ...] = ()) -> tuple[tuple[Link, ...], tuple[Joint, ...]]:
    """(links of a spanning tree, parents before children; the remaining joints, which are cut) of any scene.

    A group of bodies that no joints connect to the ground forms a tree on a free link. Joints of the types `always_cut`
    are never in the tree.
    """
    branches, cut = spanning_tree(
        scene, lambda joint: -1 if joint.type in always_cut else len(CUT_LAST) - CUT_LAST.get(joint.type, 0))
    tree_links = [free(branch.body) if branch.joint is None else link(scene, branch.joint, branch.outward)
             for branch in branches]
    return depth_first(tree_links), tuple(cut)


def depth_first(tree_links: Sequence[Link]) -> tuple[Link, ...]:
    """The links subtree by subtree: with any other order Pinocchio's crba and constraintDynamics are silently wrong."""
    ordered: list[Link] = []
    stack = [link for link in reversed(tree_links) if link.parent == GROUND]
    while stack:
        ordered.append(stack.pop())
        stack += [link for link in reversed(tree_links) if link.parent == ordered[-1].body]
    return tuple(ordered)


def free(body: int) -> Link:
    """The link of a free body: three slides of its centre of mass along the world axes, and a ball."""
    parts = (*(Part("slide", axis) for axis in np.eye(3)), Part("ball"))
    return Link(body, GROUND, "free", _ZERO, _ZERO, _ZERO, IDENTITY, parts)


def link(scene: Scene, joint: Joint, outward: bool = True) -> Link:
    """A joint as the link of its child or, if not `outward`, of its parent."""
    axes = [np.zeros(3) if axis is None else axis for axis in (joint.parent_axis, joint.child_axis)]
    ends = [(joint.parent, joint.parent_anchor, axes[0]), (joint.child, joint.child_anchor, axes[1])]
    (parent, parent_anchor, parent_axis), (body, child_anchor, axis) = ends if outward else ends[::-1]
    zero, kind = IDENTITY, joint.kind
    if kind.zero == "axes":
        zero = quaternion_from_rotation(shortest_rotation(joint.child_axis, joint.parent_axis))
        zero = zero if outward else zero * CONJUGATE
    elif kind.zero == "start":
        zero = relative_attitude(scene, parent, body)
    parts = _rod(scene, joint, parent, body, outward) if "rod" in kind.motion else tuple(
        _part(motion, joint, axis, rotation_from_quaternion(zero).T @ parent_axis) for motion in kind.motion)
    if not outward and kind.axes == "parent":  # the axis is fixed in the joint's parent, here the outer body
        parts = parts[::-1]
    return Link(body, parent, joint.type, parent_anchor, child_anchor, axis, zero, parts, joint.name, outward)


def _part(motion: str, joint: Joint, axis: np.ndarray, inner_axis: np.ndarray) -> Part:
    """The part for a word of `JointType.motion`; both axes are in the outer body's frame."""
    guided = joint.kind.axes == "parent"  # the only axis is fixed in the joint's parent
    along = joint.parent_axis if guided else axis
    match motion:
        case "ball":
            return Part("ball")
        case "turn parent":
            return Part("turn", inner_axis)
        case "turn" | "turn child":
            return Part("turn", along)
    return Part("slide", slide_direction(motion, along))


def _rod(scene: Scene, joint: Joint, parent: int, body: int, outward: bool) -> tuple[Part, ...]:
    """Two turns of the rod's direction and a ball at its end; singular if the rod is along the first axis.

    That axis is normal to the rod and to its velocity at the start, so that a motion in a plane stays away from it.
    """
    anchors = (joint.parent_anchor, joint.child_anchor) if outward else (joint.child_anchor, joint.parent_anchor)
    gap, rate = separation(scene, parent, body, *anchors)
    rod = gap / np.linalg.norm(gap)
    across = np.cross(rod, rate)
    if np.linalg.norm(across) < 1e-6 * joint.length:  # at rest: take the velocity that gravity will give it
        inner = np.eye(3) if parent == GROUND else scene.R0[parent]
        across = np.cross(rod, inner.T @ scene.gravity)
    if np.linalg.norm(across) < 1e-6:
        across = normal_references(rod)[0]
    first = across - (across @ rod) * rod
    first /= np.linalg.norm(first)
    return Part("turn", first), Part("turn", np.cross(rod, first)), Part("ball", offset=joint.length * rod)


CONJUGATE = np.array([1.0, -1.0, -1.0, -1.0])
"""The product with a unit quaternion, entry by entry, is its inverse."""


def relative_attitude(scene: Scene, parent: int, body: int) -> np.ndarray:
    """Initial attitude of `body` relative to `parent` as a quaternion w, x, y, z."""
    attitude = scene.bodies[body].attitude
    if parent == GROUND:
        return attitude
    return quaternion_product(scene.bodies[parent].attitude * CONJUGATE, attitude)


def relative_velocity(scene: Scene, parent: int, body: int) -> np.ndarray:
    """Initial angular velocity of `body` relative to `parent`, rad/s, in the body's axes."""
    w: np.ndarray = scene.w0[body]
    if parent != GROUND:
        w = w - scene.R0[body].T @ scene.R0[parent] @ scene.w0[parent]
    return w


def separation(scene: Scene, parent: int, body: int, parent_anchor: np.ndarray,
               child_anchor: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Initial vector from the parent's anchor to the body's, and its rate in the parent's frame, parent's axes."""
    R = scene.R0[body]
    end = scene.x0[body] + R @ child_anchor
    speed = scene.v0[body] + R @ np.cross(scene.w0[body], child_anchor)
    if parent == GROUND:
        return end - parent_anchor, speed
    inner, w = scene.R0[parent], scene.w0[parent]
    reach = inner.T @ (end - scene.x0[parent])
    return reach - parent_anchor, inner.T @ (speed - scene.v0[parent]) - np.cross(w, reach)
