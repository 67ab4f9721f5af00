"""Force laws and loads on a tree, as columns of wrenches on its bodies, over any number type.

What acts along a measure is minus the slopes of its potential and of its dissipation.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from crosscheck.references.generic import (
    Number,
    add,
    apply,
    apply_transposed,
    cross,
    dot,
    scale,
    square_root,
)
from crosscheck.references.joint_motion import ZERO, Frame, Tree
from crosscheck.scene.functions import TimeFunction, Value
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
        """Add a force of the scene, or of a joint; `angle` is that of its joint, if it has one."""
        law, p = force.law, {key: self.value(value) if isinstance(value, TimeFunction) else value
                             for key, value in force.parameters.items()}
        if law.potential is None:
            self._load(force, p)
        elif law.measure == "length":
            self._between(force, p)
        else:
            self._along(force, p, angle)

    def _load(self, force: Force, p: dict[str, Any]) -> None:
        """A force or torque on a body."""
        body, vector = force.child, scale(p.get("factor", 1.0), p[force.law.measure])
        if p["frame"] == "world":
            vector = apply_transposed(self.placed[body][0], vector)
        if force.law.measure == "torque":
            self.push(body, ZERO, vector)
        else:
            self.push(body, vector, cross([*p["child_point"]], vector))

    def _along(self, force: Force, p: dict[str, Any], angle: Number) -> None:
        """A torque about a joint's axis or a force along it, at the child's anchor, and its opposite on the parent."""
        joint = self.tree.scene.joint(force.joint)
        axis = apply(self.placed[joint.parent][0], joint.parent_axis.tolist())
        place, speed = self.point(joint.child, joint.child_anchor.tolist())
        if turns := force.law.measure == "angle":
            value, rate = angle, angle_rate(joint, self.frames, self.placed)
        else:  # both anchors lie on the axis
            start, start_speed = self.point(joint.parent, joint.parent_anchor.tolist())
            value, rate = (dot(axis, add(end, scale(-1.0, other))) for end, other in (
                (place, start), (speed, start_speed)))
        u = value - p[force.law.rest] if force.law.rest else value
        size = -1.0 * (slope(force.law.potential(p), u) + slope(force.law.dissipation(p), rate))
        along = scale(size, axis)
        for body, vector in ((joint.child, along), (joint.parent, scale(-1.0, along))):
            self.push_at(body, place, *((ZERO, vector) if turns else (vector, ZERO)))

    def _between(self, force: Force, p: dict[str, Any]) -> None:
        """A force between two points, along d from the parent's to the child's."""
        law = force.law
        (start, start_rate), (end, end_rate) = (self.point(body, [*p[point]]) for body, point in (
            (force.parent, "parent_point"), (force.child, "child_point")))
        d, rate = add(end, scale(-1.0, start)), add(end_rate, scale(-1.0, start_rate))
        square, factor, pull = dot(d, d), 0.0, [0.0]
        for k, coefficient in reversed([*enumerate(law.potential(p))][1:]):  # its slope in powers of the length
            pull = [high - p[law.rest] * low for high, low in zip([0.0, *pull], [*pull, 0.0], strict=True)]
            pull[0] += k * coefficient
        for k, coefficient in enumerate(pull):  # over the length: odd powers need no root, and it may shrink to zero
            if coefficient and k % 2:
                factor = factor + coefficient * square ** (k // 2)
            elif coefficient:
                factor = factor + coefficient * square ** (k // 2) / square_root(square)
        for k, loss in enumerate(law.dissipation(p)):
            if k and loss:
                factor = factor + k * loss * dot(d, rate) ** (k - 1) / square ** (0.5 * k)
        self.push_at(force.parent, start, scale(factor, d), ZERO)
        self.push_at(force.child, end, scale(-1.0 * factor, d), ZERO)


def slope(coefficients: Sequence[Number], u: Number) -> Number:
    """The derivative of the sum of coefficients[k] u^k."""
    if len(coefficients) < 2:
        return 0.0
    *lower, total = (k * coefficient for k, coefficient in enumerate(coefficients) if k)
    for coefficient in reversed(lower):
        total = total * u + coefficient
    return total


def angle_rate(joint: Joint, frames: dict[int, Frame], placed: dict[int, tuple[Number, Number, Number]],
               second: bool = False) -> Number:
    """Rate of the angle of a joint's child relative to its parent; `second`: of that about the axis in the child."""
    axis = joint.parent_axis.tolist()
    if second:
        carried = apply_transposed(placed[joint.child][0], apply(placed[joint.parent][0], frames[joint.parent].w))
        return dot(joint.child_axis.tolist(), add(frames[joint.child].w, scale(-1.0, carried)))
    relative = apply_transposed(placed[joint.parent][0], apply(placed[joint.child][0], frames[joint.child].w))
    return dot(axis, add(relative, scale(-1.0, frames[joint.parent].w)))
