"""Trees of spherical joints: which scenes minimal coordinates reach, and the levers between their joints."""

from __future__ import annotations

import dataclasses

import numpy as np

from crosscheck.errors import Unsupported
from crosscheck.scene import GROUND, Joint, Scene


@dataclasses.dataclass(frozen=True)
class Link:
    """A body in the tree. Its reference point is its inboard joint, or its centre of mass where it has none.

    `inboard` goes from the parent's reference point to this one (parent's axes; world axes for the ground), `lever`
    from this reference point to the centre of mass (own axes). A free root has parent None and no use for `inboard`.
    """

    body: int
    parent: int | None
    inboard: list[float]
    lever: list[float]
    mass: float
    inertia: list[list[float]]


def spherical_tree(scene: Scene) -> tuple[Link, ...]:
    """The links of a scene, parents before children.

    Raises
    ------
    Unsupported
        The scene has forces other than gravity, joints other than spherical ones, or closed loops.
    """
    if scene.forces:
        raise Unsupported(f"truth for {scene.name!r}: force {scene.forces[0].type!r} is not in the reference equations")
    for joint in scene.joints:
        if joint.type != "spherical":
            raise Unsupported(f"truth for {scene.name!r}: joint {joint.name!r} is {joint.type}; "
                              "the reference equations know spherical joints only")
    links: dict[int, Link] = {}
    unused = list(scene.joints)
    _grow(scene, GROUND, links, unused)
    for body in range(scene.n):
        if body not in links:
            links[body] = _link(scene, body, None, np.zeros(3), np.zeros(3))
            _grow(scene, body, links, unused)
    if unused:
        raise Unsupported(f"truth for {scene.name!r}: joint {unused[0].name!r} closes a loop; "
                          "the reference equations are those of a tree")
    return tuple(links.values())


def _grow(scene: Scene, start: int, links: dict[int, Link], unused: list[Joint]) -> None:
    """Attach everything that hangs on `start`, nearest first; a joint may name its bodies in either order."""
    front = [start]
    while front:
        body = front.pop(0)
        for joint in [joint for joint in unused if body in (joint.parent, joint.child)]:
            towards_child = joint.parent == body
            other = joint.child if towards_child else joint.parent
            if other in links or other == GROUND:
                continue
            here, there = joint.parent_anchor, joint.child_anchor
            if not towards_child:
                here, there = there, here
            reference = np.zeros(3) if body == GROUND else -np.array(links[body].lever)
            links[other] = _link(scene, other, body, here - reference, -there)
            unused.remove(joint)
            front.append(other)


def _link(scene: Scene, body: int, parent: int | None, inboard: np.ndarray, lever: np.ndarray) -> Link:
    record = scene.bodies[body]
    return Link(body, parent, inboard.tolist(), lever.tolist(), float(record.mass),
                record.inertia.tolist())


def scene_length(scene: Scene) -> float:
    """Largest lever from a centre of mass to a joint, m; the largest radius of gyration where all levers vanish."""
    levers = [np.linalg.norm(joint.child_anchor) for joint in scene.joints if joint.child != GROUND]
    levers += [np.linalg.norm(joint.parent_anchor) for joint in scene.joints if joint.parent != GROUND]
    if max(levers, default=0.0) > 0.0:
        return float(max(levers))
    return float(max(np.sqrt(np.trace(body.inertia) / body.mass) for body in scene.bodies))
