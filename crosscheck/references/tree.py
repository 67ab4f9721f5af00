"""A scene as a tree of bodies and joints, separate from the joints that close loops.

Every joint is a product of two motions of its outer body, the one farther from the ground: a turn (none, about one
axis, about two, free) and a shift of the joint's point relative to the inner body (none, along directions of the inner
body, along directions of the outer body, free).
"""

from __future__ import annotations

import dataclasses

import numpy as np

from crosscheck.scene.model import GROUND, Joint, Scene

TURNS = {"prismatic": 0, "fixed": 0, "revolute": 1, "cylindrical": 1, "planar": 1, "universal": 2}  # else free
SHIFTS = {"cylindrical": "line", "prismatic": "line", "point_on_line": "line", "planar": "plane",
          "point_on_plane": "plane"}  # else none
FREE = 3
ROWS = ("distance", "knife_edge", "rolling_disk", "rolling_sphere")  # which no coordinates stand for


@dataclasses.dataclass(frozen=True)
class Link:
    """A body with the joint on its inner side.

    A shift along directions of the outer body moves the joint's point in the outer body, every other one moves it in
    the inner body; the body's reference point is the joint's point, or the centre of mass of a free body.
    """

    body: int
    parent: int  # the inner body, GROUND at a root
    mass: float
    inertia: list[list[float]]
    inner_anchor: list[float]  # from the inner body's centre of mass, its axes
    outer_anchor: list[float]  # from this body's centre of mass, its axes
    turn: int  # degrees of freedom
    axes: tuple[list[float], ...]  # of the turn: the last in this body's axes; of two, the first in the inner body's
    shift: str  # none, line, plane, free
    outward: bool  # the directions of the shift are fixed in this body
    directions: tuple[list[float], ...]  # of a shift on a line or plane
    joint: Joint | None

    @property
    def scalars(self) -> int:
        """Number of angles and displacements."""
        return (0 if self.turn == FREE else self.turn) + len(self.directions)


def unfold(scene: Scene) -> tuple[tuple[Link, ...], tuple[Joint, ...]]:
    """The links of a scene, inner bodies before outer ones, and the joints that close loops."""
    links: dict[int, Link] = {}
    unused = [joint for joint in scene.joints if joint.type not in ROWS]
    _grow(scene, GROUND, links, unused)
    for body in np.flatnonzero(~scene.frames).tolist():  # a frame moves with bodies: it is no root
        if body not in links:
            record = scene.bodies[body]
            links[body] = Link(body, GROUND, float(record.mass), record.inertia.tolist(), [0.0] * 3, [0.0] * 3, FREE,
                               (), "free", False, (), None)
            _grow(scene, body, links, unused)
    return tuple(links.values()), (*unused, *(joint for joint in scene.joints if joint.type in ROWS))


def bound(scene: Scene, joint: Joint) -> bool:
    """Whether the joint has to be in the tree: its coordinate has inertia or laws, follows another one or leads it.

    So do those on both sides of a frame, which could not end a branch.
    """
    return (scene.on_frame(joint) or any(joint.armature) or any(joint.dry_friction) or any(joint.limits)
            or joint.mimic is not None or any(name == joint.name for name, _ in scene.servos.values())
            or any(each.mimic is not None and each.mimic.joint == joint.name for each in scene.joints))


def _grow(scene: Scene, start: int, links: dict[int, Link], unused: list[Joint]) -> None:
    """Attach everything that hangs on `start`, nearest first; a joint may name its bodies in either order."""
    if any(bound(scene, joint) for joint in unused):
        return _grow_geared(scene, start, links, unused)
    front = [start]
    while front:
        body = front.pop(0)
        for joint in [joint for joint in unused if body in (joint.parent, joint.child)]:
            other = joint.child if joint.parent == body else joint.parent
            if other in links or other == GROUND:
                continue
            links[other] = _link(scene, joint, body, other)
            unused.remove(joint)
            front.append(other)


def _grow_geared(scene: Scene, start: int, links: dict[int, Link], unused: list[Joint]) -> None:
    """The same with joints first that cannot close a loop here."""
    reached = {start}
    while joints := [joint for joint in unused if (joint.parent in reached) != (joint.child in reached)]:
        joint = max(joints, key=lambda joint: bound(scene, joint))  # the first in the file among equals
        inner, outer = (joint.parent, joint.child) if joint.parent in reached else (joint.child, joint.parent)
        links[outer] = _link(scene, joint, inner, outer)
        unused.remove(joint)
        reached.add(outer)


def _link(scene: Scene, joint: Joint, inner: int, outer: int) -> Link:
    record = scene.bodies[outer]
    reverse = joint.child == inner
    anchors = [joint.parent_anchor.tolist(), joint.child_anchor.tolist()]
    axes = [joint.parent_axis, joint.child_axis]
    shift, turn = SHIFTS.get(joint.type, "none"), TURNS.get(joint.type, FREE)
    outward = reverse and joint.type.startswith("point_on")  # their axis is the parent's alone
    guide = axes[0] if outward or not reverse else axes[1]
    if reverse:  # the angle of the parent from the child is minus the angle of the child from the parent
        anchors.reverse()
        axes = [None if axis is None else -axis for axis in reversed(axes)]
    turn_axes = {1: axes[1:], 2: axes}.get(turn, [])
    directions = []
    if shift in ("line", "plane"):
        directions = [guide] if shift == "line" else [*np.linalg.svd(guide[None])[2][1:]]
    return Link(outer, inner, float(record.mass), record.inertia.tolist(), anchors[0], anchors[1], turn,
                tuple(axis.tolist() for axis in turn_axes), shift, outward,
                tuple(direction.tolist() for direction in directions), joint)
