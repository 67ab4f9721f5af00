"""Contacts with a plane of the ground as rows of a tree: the velocity where a body touches it vanishes.

Let r lead from the point of a blade, or the centre of a disk or sphere, to the point of contact, and u be the velocity
of where it starts. All rows follow from

    d/dt (u + w x r) = u' + w' x r + w x r'

along the normal of the plane, whose row is also that of the height, and along the directions of slip.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from crosscheck.references.generic import add, apply, cross, dot, scale, square_root
from crosscheck.references.joint_motion import ZERO
from crosscheck.references.tree_loads import Loads
from crosscheck.scene.model import Joint

ROLLING = ("knife_edge", "rolling_disk", "rolling_sphere")


def directions(joint: Joint) -> list[np.ndarray | None]:
    """Directions of the rows, world: the normal first; None stands for the one across the blade."""
    normal = joint.parent_axis
    if joint.type == "knife_edge":
        return [normal, None]
    first = np.cross(normal, np.eye(3)[np.argmin(np.abs(normal))])
    first /= np.linalg.norm(first)
    return [normal, first, np.cross(normal, first)]


def terms(joint: Joint, direction: list[Any] | None, is_height: bool, loads: Loads
          ) -> tuple[list[Any], list[Any], list[Any], Any, Any, Any]:
    """(place, n, t, rest, value, rate) of a row, as `crosscheck.references.loops.Row` has them."""
    normal = joint.parent_axis.tolist()
    place, velocity = loads.point(joint.child, joint.child_anchor.tolist())
    R = loads.placed[joint.child][0]
    w = apply(R, loads.frames[joint.child].w)
    reach, moving, height = ZERO, ZERO, 0.0
    if joint.type == "rolling_sphere":
        reach, height = scale(-joint.radius, normal), joint.radius
    if joint.type == "rolling_disk":  # r = -radius h / |h|, h = a x (n x a)
        a = apply(R, joint.child_axis.tolist())
        turning = cross(w, a)
        h = cross(a, cross(normal, a))
        rising = add(cross(turning, cross(normal, a)), cross(a, cross(normal, turning)))
        inverse = 1.0 / square_root(dot(h, h))
        e = scale(inverse, h)
        reach = scale(-joint.radius, e)
        moving = scale(-joint.radius * inverse, add(rising, scale(-1.0 * dot(e, rising), e)))
        height = joint.radius * dot(normal, e)
    carried = add(velocity, cross(w, reach))
    if direction is None:  # across the blade, which turns
        a = apply(R, joint.child_axis.tolist())
        n, rest = cross(normal, a), dot(cross(normal, cross(w, a)), carried)
    else:
        n, rest = direction, dot(direction, cross(w, moving))
    gap = dot(normal, add(place, (-joint.parent_anchor).tolist())) - height if is_height else 0.0
    return place, n, cross(reach, n), rest, gap, dot(n, carried)
