"""Springs, dampers and constant loads on a tree, as columns of wrenches on its bodies, over any number type."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from crosscheck.references.generic import (
    Number,
    add,
    apply,
    apply_transposed,
    conjugate,
    cross,
    dot,
    quaternion_product,
    scale,
    square_root,
)
from crosscheck.references.joint_motion import ZERO, Frame, Tree, zero_turn
from crosscheck.scene.functions import Value
from crosscheck.scene.model import Force, Joint


class Loads:
    """Wrenches (force, torque about the centre of mass), own axes, of every body and the ground."""

    def __init__(self, tree: Tree, frames: dict[int, Frame], placed: dict[int, tuple[Number, Number, Number]],
                 value: Callable[[Value], Number] = lambda value: value) -> None:
        self.tree, self.frames, self.placed = tree, frames, placed
        self.value = value  # evaluates a number or a function of time in the number type of the state
        self.wrenches = dict.fromkeys(frames, (ZERO, ZERO))

    def lever(self, body: int, anchor: list[Number]) -> list[Number]:
        """From the reference point of a body to a point given from its centre of mass, own axes."""
        return add(self.frames[body].lever, anchor)

    def point(self, body: int, anchor: list[Number]) -> tuple[list[Number], list[Number]]:
        """A body's point and its velocity, world."""
        R, reference, velocity = self.placed[body]
        lever = self.lever(body, anchor)
        return add(reference, apply(R, lever)), add(velocity, apply(R, cross(self.frames[body].w, lever)))

    def push(self, body: int, force: list[Number], torque: list[Number]) -> None:
        """Add a wrench, own axes."""
        old_force, old_torque = self.wrenches[body]
        self.wrenches[body] = add(old_force, force), add(old_torque, torque)

    def push_at(self, body: int, place: list[Number], force: list[Number], torque: list[Number]) -> None:
        """Add a force at a point of space, and a torque; all in world axes."""
        R, reference, _ = self.placed[body]
        arm = add(apply_transposed(R, add(place, scale(-1.0, reference))), scale(-1.0, self.frames[body].lever))
        force = apply_transposed(R, force)
        self.push(body, force, add(cross(arm, force), apply_transposed(R, torque)))

    def add(self, force: Force, angle: Number) -> None:
        """Add a force of the scene, or of a joint; `angle` is that of a torsional spring's joint."""
        p = force.parameters
        if force.type == "linear_spring":
            self._linear_spring(force)
        elif force.type == "torsional_spring":
            joint = next(joint for joint in self.tree.scene.joints if joint.name == force.joint)
            size = torsion(p["stiffness"], angle - self.value(p["rest_angle"]), p["damping"],
                           angle_rate(joint, self.frames, self.placed))
            axis = apply(self.placed[joint.parent][0], joint.parent_axis.tolist())
            for body, sign in ((joint.child, 1.0), (joint.parent, -1.0)):
                self.push(body, ZERO, apply_transposed(self.placed[body][0], scale(sign * size, axis)))
        elif force.type in ("joint_torque", "joint_force", "slide_spring"):
            self._along_joint(force)
        else:
            turns = force.type == "constant_torque"
            vector = [*p["torque" if turns else "force"]]
            if "factor" in p:
                vector = scale(self.value(p["factor"]), vector)
            if p["frame"] == "world":
                vector = apply_transposed(self.placed[force.child][0], vector)
            if turns:
                self.push(force.child, ZERO, vector)
            else:
                self.push(force.child, vector, cross([*p["child_point"]], vector))

    def _along_joint(self, force: Force) -> None:
        """A torque about a joint's axis or a force along it, at the child's anchor, and its opposite on the parent."""
        joint = next(joint for joint in self.tree.scene.joints if joint.name == force.joint)
        turns, p = force.type == "joint_torque", force.parameters
        axis = apply(self.placed[joint.parent][0], joint.parent_axis.tolist())
        place, rate = self.point(joint.child, joint.child_anchor.tolist())
        if force.type == "slide_spring":  # both anchors lie on the axis
            start, start_rate = self.point(joint.parent, joint.parent_anchor.tolist())
            slide, speed = (dot(axis, add(end, scale(-1.0, other))) for end, other in (
                (place, start), (rate, start_rate)))
            size = -1.0 * (p["stiffness"] * (slide - p["rest_position"]) + p["damping"] * speed)
        else:
            size = self.value(p["torque" if turns else "force"])
        along = scale(size, axis)
        for body, vector in ((joint.child, along), (joint.parent, scale(-1.0, along))):
            self.push_at(body, place, *((ZERO, vector) if turns else (vector, ZERO)))

    def _linear_spring(self, force: Force) -> None:
        p = force.parameters
        start, start_rate = self.point(force.parent, [*p["parent_point"]])
        end, end_rate = self.point(force.child, [*p["child_point"]])
        d, rate = add(end, scale(-1.0, start)), add(end_rate, scale(-1.0, start_rate))
        square = dot(d, d)
        factor = p["stiffness"]
        if p["free_length"]:  # a spring of free length 0 needs no root and may shrink to length zero
            factor = factor - p["stiffness"] * p["free_length"] / square_root(square)
        if p["damping"]:
            factor = factor + p["damping"] * dot(d, rate) / square
        pull = spring_pull(factor, d)
        self.push_at(force.parent, start, pull, ZERO)
        self.push_at(force.child, end, scale(-1.0, pull), ZERO)


def spring_pull(factor: Number, separation: list[Number]) -> list[Number]:
    """Force on the parent's end of a spring."""
    return scale(factor, separation)


def torsion(stiffness: float, twist: Number, damping: float, rate: Number) -> Number:
    """Torque of a torsional spring-damper on the child."""
    return -1.0 * (stiffness * twist + damping * rate)


def angle_rate(joint: Joint, frames: dict[int, Frame], placed: dict[int, tuple[Number, Number, Number]],
               second: bool = False) -> Number:
    """Rate of the angle of a joint's child relative to its parent; `second`: of that about the axis in the child."""
    axis = joint.parent_axis.tolist()
    if second:
        carried = apply_transposed(placed[joint.child][0], apply(placed[joint.parent][0], frames[joint.parent].w))
        return dot(joint.child_axis.tolist(), add(frames[joint.child].w, scale(-1.0, carried)))
    relative = apply_transposed(placed[joint.parent][0], apply(placed[joint.child][0], frames[joint.child].w))
    return dot(axis, add(relative, scale(-1.0, frames[joint.parent].w)))


def start_angle(joint: Joint, q: dict[int, list[Number]], zero: list[float] | None = None) -> float:
    """Angle of a joint's child from its attitude `zero` in the parent, by default the shortest turn.

    It lies in (-pi, pi], or has the turns that the joint's start has.
    `q`: the quaternions of the bodies. The rotation relative zero^T is about the parent axis: its quaternion is (cos,
    axis sin) of half the angle.
    """
    relative = quaternion_product(conjugate(q[joint.parent]), q[joint.child])
    turn = quaternion_product(relative, conjugate(zero or zero_turn(joint)))
    angle = 2 * np.arctan2(np.dot(joint.parent_axis, turn[1:]), turn[0])
    if joint.start is None:
        return float(angle - 2 * np.pi * np.ceil((angle - np.pi) / (2 * np.pi)))
    begin = joint.start[2 if joint.type == "planar" else 0] + (0.0 if zero else joint.zero_angle)
    return float(angle + 2 * np.pi * np.round((begin - angle) / (2 * np.pi)))


def coordinate_angle(joint: Joint, q: dict[int, list[Number]]) -> float:
    """The angle of a hinge at the start, from its reference attitude; `q`: the quaternions of the bodies."""
    zero = None if joint.reference is None else joint.reference.tolist()
    return start_angle(joint, q, zero or zero_turn(joint))


def tree_angle(joint: Joint, tree: Tree, state: Number) -> Number | None:
    """Angle of a joint of the tree, from its coordinate; None for one that closes a loop."""
    for link in tree.links:
        if link.joint is joint:
            return tree.split(link, state, tree.coordinates)[0][0] + start_angle(joint, tree.start)
    return None
