"""Joint coordinates: what a joint leaves free, as numbers, and the states of the child that belong to them.

Q0 is the attitude of the child in the parent where the coordinates are zero, d the vector from the parent's anchor to
the child's in the parent's axes, a_p and a_c the two axes, n1 and n2 the reference vectors of a_p:

- revolute, the angle: R_rel = exp(angle a_p) Q0; cylindrical, [angle, slide], and planar, [x, y, angle], likewise;
- prismatic: R_rel = Q0, slide = a_p . d; planar: x = n1 . d, y = n2 . d;
- universal, [first, second]: R_rel = exp(first a_p) Q0 exp(second a_c);
- spherical, a quaternion w, x, y, z: R_rel = Q0 R(quaternion), its velocity the relative angular velocity in
  the child's axes.

Angles start in (-pi, pi], or at the turn the scene gives, and are continuous from then on.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from crosscheck.scene.constraints import cross, normal_references
from crosscheck.scene.mechanics import shortest_rotation
from crosscheck.scene.model import GROUND, Joint, Scene, quaternion_from_rotation, rotation_from_quaternion
from crosscheck.scene.states import Motion

COUNTS = {"revolute": 1, "prismatic": 1, "cylindrical": 2, "universal": 2, "planar": 3, "spherical": 4}
"""Types of joints with coordinates, and how many positions each has; a spherical joint has three velocities."""


@dataclasses.dataclass(frozen=True)
class JointHistory:
    """Coordinates of one joint over T times; a joint with one coordinate has arrays (T,), others (T, count)."""

    position: np.ndarray
    velocity: np.ndarray


def zero_attitude(joint: Joint) -> np.ndarray:
    """Q0, (3, 3): the joint's reference attitude, or the default of its type."""
    if joint.reference is not None:
        return rotation_from_quaternion(joint.reference)
    if joint.type in ("revolute", "cylindrical", "planar", "prismatic"):
        return shortest_rotation(joint.child_axis, joint.parent_axis)
    if joint.type == "universal":
        across = joint.child_axis - (joint.child_axis @ joint.parent_axis) * joint.parent_axis
        size = float(np.linalg.norm(across))
        return shortest_rotation(joint.child_axis, across / size if size > 1e-6 else
                                 normal_references(joint.parent_axis)[0])
    return np.eye(3)


def turned(axis: np.ndarray, angle: float) -> np.ndarray:
    """The rotation (3, 3) by `angle` (rad) about the unit vector `axis`."""
    hat = cross(axis, np.eye(3)).T
    found: np.ndarray = np.eye(3) + np.sin(angle) * hat + 2.0 * np.sin(angle / 2) ** 2 * hat @ hat
    return found


def relative_pose(joint: Joint, position: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(R_rel (3, 3), d (3,) in the parent's axes) at the joint's coordinates."""
    zero, none = zero_attitude(joint), np.zeros(3)
    match joint.type:
        case "revolute":
            return turned(joint.parent_axis, position[0]) @ zero, none
        case "cylindrical":
            return turned(joint.parent_axis, position[0]) @ zero, position[1] * joint.parent_axis
        case "prismatic":
            return zero, position[0] * joint.parent_axis
        case "planar":
            n1, n2 = normal_references(joint.parent_axis)
            return turned(joint.parent_axis, position[2]) @ zero, position[0] * n1 + position[1] * n2
        case "universal":
            return turned(joint.parent_axis, position[0]) @ zero @ turned(joint.child_axis, position[1]), none
        case "spherical":
            return zero @ rotation_from_quaternion(position / np.linalg.norm(position)), none
    return zero, none


def relative_rates(joint: Joint, position: np.ndarray, velocity: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(relative angular velocity, d' as seen from the parent), (3,) each, in the parent's axes."""
    axis, none = joint.parent_axis, np.zeros(3)
    match joint.type:
        case "revolute":
            return velocity[0] * axis, none
        case "cylindrical":
            return velocity[0] * axis, velocity[1] * axis
        case "prismatic":
            return none, velocity[0] * axis
        case "planar":
            n1, n2 = normal_references(axis)
            return velocity[2] * axis, velocity[0] * n1 + velocity[1] * n2
        case "universal":
            second = turned(axis, position[0]) @ zero_attitude(joint) @ joint.child_axis
            return velocity[0] * axis + velocity[1] * second, none
        case "spherical":
            return relative_pose(joint, position)[0] @ velocity, none
    return none, none


def histories(scene: Scene, states: Motion) -> dict[str, JointHistory]:
    """Coordinates of every joint that has them, over the times of `states`."""
    return {joint.name: _history(joint, states) for joint in scene.joints if joint.type in COUNTS}


def _history(joint: Joint, states: Motion) -> JointHistory:
    still, ground = np.zeros((len(states.t), 3)), np.broadcast_to(np.eye(3), (len(states.t), 3, 3))
    parent, child = joint.parent, joint.child
    Rp = ground if parent == GROUND else states.R[:, parent]
    xp, vp, wp = (still if parent == GROUND else values[:, parent] for values in (states.x, states.v, states.w))
    Rc, xc, vc, wc = (values[:, child] for values in (states.R, states.x, states.v, states.w))
    arm = Rc @ joint.child_anchor
    spin = np.einsum("tij,tj->ti", Rp, wp)
    outer = np.einsum("tij,tj->ti", Rc, wc)
    reach = xc + arm - xp
    d = np.einsum("tji,tj->ti", Rp, reach) - joint.parent_anchor
    rate = np.einsum("tji,tj->ti", Rp, vc + cross(outer, arm) - vp - cross(spin, reach))
    relative = np.swapaxes(Rp, 1, 2) @ Rc
    w = np.einsum("tji,tj->ti", Rp, outer - spin)
    position, velocity = _read(joint, relative, w, d, rate)
    for column, kind in enumerate(_kinds(joint)):
        if kind == "angle":
            position[:, column] = _continuous(position[:, column], velocity[:, column], states.t,
                                              None if joint.start is None else joint.start[column])
    if joint.type == "spherical":
        flips = np.cumprod(np.where(np.einsum("tk,tk->t", position[1:], position[:-1]) < 0, -1.0, 1.0))
        position[1:] *= flips[:, None]
    return JointHistory(*(values[:, 0] if values.shape[1] == 1 else values for values in (position, velocity)))


def _kinds(joint: Joint) -> tuple[str, ...]:
    return {"revolute": ("angle",), "prismatic": ("slide",), "cylindrical": ("angle", "slide"),
            "planar": ("slide", "slide", "angle"), "universal": ("angle", "angle")}.get(joint.type, ())


def _read(joint: Joint, relative: np.ndarray, w: np.ndarray, d: np.ndarray,
          rate: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Positions and velocities, angles in (-pi, pi]; `w`, `d`, `rate` (T, 3) in the parent's axes."""
    zero = zero_attitude(joint)
    if joint.type == "spherical":
        return quaternion_from_rotation(zero.T @ relative), np.einsum("tji,tj->ti", relative, w)
    axis = joint.parent_axis
    n1, n2 = normal_references(axis)
    slide, slide_rate = d @ axis, rate @ axis
    if joint.type == "prismatic":
        return slide[:, None], slide_rate[:, None]
    if joint.type == "universal":
        return _universal(joint, zero, relative, w)
    pointer = relative @ (zero.T @ n1)
    angle, turn = np.arctan2(pointer @ n2, pointer @ n1), w @ axis
    if joint.type == "revolute":
        return angle[:, None], turn[:, None]
    if joint.type == "cylindrical":
        return np.stack([angle, slide], axis=1), np.stack([turn, slide_rate], axis=1)
    return np.stack([d @ n1, d @ n2, angle], axis=1), np.stack([rate @ n1, rate @ n2, turn], axis=1)


def _universal(joint: Joint, zero: np.ndarray, relative: np.ndarray,
               w: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    axis, second = joint.parent_axis, relative @ joint.child_axis
    start = zero @ joint.child_axis
    first_angle = np.arctan2(second @ cross(axis, start), second @ start)
    inner = zero.T @ axis  # the first axis in the child's frame at zero, normal to the second
    back = np.einsum("tji,j->ti", relative, axis)
    second_angle = -np.arctan2(back @ cross(joint.child_axis, inner), back @ inner)
    velocity = np.stack([w @ axis, np.einsum("tk,tk->t", w, second)], axis=1)  # the axes are at right angles
    return np.stack([first_angle, second_angle], axis=1), velocity


def _continuous(wrapped: np.ndarray, rate: np.ndarray, t: np.ndarray, start: float | None) -> np.ndarray:
    """Angles without jumps: each is the one nearest to what the rates predict from the one before."""
    steps = np.zeros(len(wrapped))
    steps[1:] = 0.5 * (rate[1:] + rate[:-1]) * np.diff(t)
    first = wrapped[0] if start is None else start
    gaps = np.diff(wrapped, prepend=first) - steps
    found: np.ndarray = wrapped - 2 * np.pi * np.cumsum(np.round(gaps / (2 * np.pi)))
    return found
