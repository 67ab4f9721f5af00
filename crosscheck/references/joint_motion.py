"""Minimal coordinates of a tree: poses and velocities of its bodies, over any number type.

Coordinates and speeds of a link, turn before shift:

    turn free      unit quaternion of the body in the world; its angular velocity, body axes
    turn 0, 1, 2   angles from the start about the link's axes; their rates
    shift on line, plane    displacements along the link's directions; their rates
    shift free              centre of mass and its velocity, world

With these no position of a joint is singular, except a universal joint with parallel arms, which its row excludes.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from crosscheck.references.generic import (
    ByBody,
    Number,
    Vector,
    add,
    apply,
    apply_transposed,
    conjugate,
    cross,
    multiply,
    quaternion_product,
    rotation,
    scale,
    turn_about,
)
from crosscheck.references.tree import FREE, Link
from crosscheck.scene.model import GROUND, Joint, Scene, rotation_from_quaternion

ZERO = [0.0, 0.0, 0.0]
IDENTITY = [1.0, 0.0, 0.0, 0.0]
COORDINATES = {"none": 0, "line": 1, "plane": 2, "free": 3}  # of shifts; as many speeds


@dataclasses.dataclass
class Frame:
    """Pose and motion of a body; vectors in its own axes unless stated otherwise.

    `q`: attitude in the world. `turn`: matrix from own to inner axes. `lever`: from the reference point to the centre
    of mass. `arm`: from the inner body's reference point to the joint's point (inner axes). With speeds: `w`, the
    angular velocity; `shifting`, the rate of the shift, in inner axes or, if outward, in own axes; `columns`, the
    (angular, linear) velocities for unit speeds of the joint; `spin_bias`, `shift_bias`, their accelerations at
    constant speeds.
    """

    q: list[Number]
    turn: list[Number]
    lever: list[Number]
    arm: list[Number]
    w: list[Number] = dataclasses.field(default_factory=lambda: ZERO)
    shifting: list[Number] = dataclasses.field(default_factory=lambda: ZERO)
    columns: list[Number] = dataclasses.field(default_factory=list)
    spin_bias: list[Number] = dataclasses.field(default_factory=lambda: ZERO)
    shift_bias: list[Number] = dataclasses.field(default_factory=lambda: ZERO)


STILL = Frame(IDENTITY, [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]], ZERO, ZERO)  # the ground


class Tree:
    """The links of a scene with the relative attitudes at the start, and the layout of the state vector.

    State vector: coordinates of all links in the order of bodies, then their speeds.
    """

    def __init__(self, scene: Scene, links: tuple[Link, ...]) -> None:
        self.scene, self.links = scene, links
        self.by_body = sorted(links, key=lambda link: link.body)
        self.coordinates: dict[int, slice] = {}
        self.speeds: dict[int, slice] = {}
        end = 0
        for table, quaternion in ((self.coordinates, 4), (self.speeds, 3)):
            for link in self.by_body:
                size = (quaternion if link.turn == FREE else link.turn) + COORDINATES[link.shift]
                table[link.body] = slice(end, end + size)
                end += size
        self.size = end
        q = {body: (record.attitude / np.linalg.norm(record.attitude)).tolist()
             for body, record in enumerate(scene.bodies)} | {GROUND: IDENTITY}
        self.start = q
        self.kept = {link.body: quaternion_product(conjugate(q[link.parent]), q[link.body]) for link in links}

    def coordinates_of(self, member: Scene) -> tuple[np.ndarray, Tree]:
        """The state vector of the start of a scene of the same structure, with the turns of hinges; and its tree."""
        own = Tree(member, self.links)
        state = own.initial()
        for link in self.links:
            if link.turn in (1, 2) and link.joint is not None:
                first = self.coordinates[link.body].start
                state[first:first + link.turn] = own.start_angles(
                    link, member.joint(link.joint.name)) - self.start_angles(link)
        return state, own

    def start_angles(self, link: Link, joint: Joint | None = None) -> np.ndarray:
        """The angles of a link's joint at the start, as the scene counts them, in the order of the link's axes.

        They lie in (-pi, pi], or have the turns of the joint's start; `joint`: in place of the link's own.
        """
        joint = joint or link.joint
        assert joint is not None
        angles = joint_angles(joint, self.start)
        return angles if link.body == joint.child else angles[::-1]

    def split(self, link: Link, state: Sequence[Number], table: dict[int, slice]) -> tuple[list[Number], list[Number]]:
        """The entries of a link for its turn and for its shift."""
        entries = [*state[table[link.body]]]
        cut = len(entries) - COORDINATES[link.shift]
        return entries[:cut], entries[cut:]

    def frames(self, state: Sequence[Number], moving: bool = True) -> dict[int, Frame]:
        """Frames of all bodies and the ground; with `moving` False, from coordinates alone, without velocities."""
        frames = {GROUND: STILL}
        for link in self.links:
            frame = frames[link.body] = self._placed(link, state, frames[link.parent])
            if moving:
                self._set_in_motion(link, state, frame, frames[link.parent])
        return frames

    def _placed(self, link: Link, state: Sequence[Number], inner: Frame) -> Frame:
        turn, shift = self.split(link, state, self.coordinates)
        kept = self.kept[link.body]
        if link.turn == FREE:
            q, relative = turn, quaternion_product(conjugate(inner.q), turn)
        else:
            relative = kept if link.turn < 2 else quaternion_product(turn_about(link.axes[0], turn[0]), kept)
            if link.turn:
                relative = quaternion_product(relative, turn_about(link.axes[-1], turn[-1]))
            q = quaternion_product(inner.q, relative)
        moved = shift if link.shift == "free" else add(ZERO, *(
            scale(s, direction) for s, direction in zip(shift, link.directions, strict=True)))
        arm, point = add(inner.lever, link.inner_anchor), link.outer_anchor
        if link.outward:
            point = add(point, moved)
        else:
            arm = add(arm, moved)
        return Frame(q, rotation(relative), scale(-1.0, point), arm)

    def _set_in_motion(self, link: Link, state: Sequence[Number], frame: Frame, inner: Frame) -> None:
        turning, shifting = self.split(link, state, self.speeds)
        carried = apply_transposed(frame.turn, inner.w)
        axes = [*link.axes]
        if link.turn == FREE:
            frame.w = turning
        else:
            if link.turn == 2:  # the first axis is fixed in the inner body, so it turns relative to the second
                axes[0] = apply_transposed(frame.turn, axes[0])
                frame.spin_bias = scale(-turning[0] * turning[1], cross(axes[1], axes[0]))
            spin = add(ZERO, *(scale(rate, axis) for rate, axis in zip(turning, axes, strict=True)))
            frame.w = add(carried, spin)
            frame.spin_bias = add(frame.spin_bias, cross(carried, spin))
            frame.columns = [(axis, ZERO) for axis in axes]
        if link.shift == "free":
            frame.shifting = shifting
        elif link.shift != "none":
            frame.shifting = add(*(scale(s, direction)
                                   for s, direction in zip(shifting, link.directions, strict=True)))
            if link.outward:  # the reference point is this body's point at the joint
                frame.columns += [(ZERO, scale(-1.0, direction)) for direction in link.directions]
                frame.shift_bias = scale(-2.0, cross(frame.w, frame.shifting))
            else:
                frame.columns += [(ZERO, apply_transposed(frame.turn, direction)) for direction in link.directions]

    def initial(self) -> np.ndarray:
        """The state vector at the scene's start."""
        state = np.zeros(self.size)
        for link in self.links:
            coordinates, speeds = self._start(link)
            state[self.coordinates[link.body]], state[self.speeds[link.body]] = coordinates, speeds
        return state

    def _start(self, link: Link) -> tuple[np.ndarray, np.ndarray]:
        """Coordinates and speeds of a link from the states of its two bodies."""
        scene, body = self.scene, link.body
        w = scene.w0[body]
        x_in, R_in, v_in, w_in = np.zeros(3), np.eye(3), np.zeros(3), np.zeros(3)
        if link.parent != GROUND:
            x_in, R_in, v_in, w_in = (values[link.parent] for values in (scene.x0, scene.R0, scene.v0, scene.w0))
        R = scene.R0[body]
        turn, turning = np.array(self.start[body]), w
        if link.turn != FREE:
            axes = [np.array(axis) for axis in link.axes]
            if link.turn == 2:
                axes[0] = R.T @ R_in @ axes[0]
            turn = np.zeros(link.turn)
            turning = np.linalg.pinv(np.array(axes).reshape(-1, 3).T) @ (w - R.T @ R_in @ w_in)
        if link.shift == "free":
            return np.concatenate([turn, scene.x0[body]]), np.concatenate([turning, scene.v0[body]])
        inner, outer = np.array(link.inner_anchor), np.array(link.outer_anchor)
        gap = scene.x0[body] + R @ outer - x_in - R_in @ inner
        rate = scene.v0[body] + R @ np.cross(w, outer) - v_in - R_in @ np.cross(w_in, inner)
        if link.outward:
            gap, own = -R.T @ gap, w
            rate = -R.T @ rate - np.cross(own, gap)
        else:
            gap = R_in.T @ gap
            rate = R_in.T @ rate - np.cross(w_in, gap)
        shift, shifting = (np.array(link.directions).reshape(-1, 3) @ value for value in (gap, rate))
        return np.concatenate([turn, shift]), np.concatenate([turning, shifting])

    def world(self, frames: dict[int, Frame], moving: bool = True) -> dict[int, tuple[Number, Number, Number]]:
        """Attitude, reference point and its velocity, world axes, of every body and the ground."""
        placed = {GROUND: (STILL.turn, ZERO, ZERO)}
        for link in self.links:
            frame, (R_in, point, velocity) = frames[link.body], placed[link.parent]
            R = rotation(frame.q) if link.turn == FREE or link.parent == GROUND else multiply(R_in, frame.turn)
            point = add(point, apply(R_in, frame.arm))
            if moving:
                own, across = ZERO, cross(frames[link.parent].w, frame.arm)
                if link.outward:
                    own = scale(-1.0, frame.shifting)
                else:
                    across = add(across, frame.shifting)
                velocity = add(velocity, apply(R_in, across), apply(R, own))
            placed[link.body] = R, point, velocity
        return placed

    def rates(self, state: Sequence[Number], frames: dict[int, Frame], accelerations: ByBody) -> Vector:
        """d state / dt; `accelerations` are the derivatives of each link's speeds."""
        result: list[Number] = [0.0] * self.size
        for link in self.links:
            turn, _ = self.split(link, state, self.coordinates)
            turning, shifting = self.split(link, state, self.speeds)
            if link.turn == FREE:
                turning = scale(0.5, quaternion_product(turn, [0.0, *frames[link.body].w]))
            result[self.coordinates[link.body]] = [*turning, *shifting]
            result[self.speeds[link.body]] = accelerations[link.body]
        return result


def zero_turn(joint: Joint) -> list[float]:
    """Quaternion of the child in the parent at zero angles: the shortest turn of its axis to the parent's.

    The axis of a cross is turned to the plane across the parent's. For opposite axes, or an axis of a cross along the
    parent's, the coordinate direction nearest to normal to the parent's axis, made normal to it, decides.
    """
    a, c = joint.parent_axis, joint.child_axis
    normal = np.eye(3)[np.argmin(np.abs(a))]
    normal = (normal - (normal @ a) * a) / np.linalg.norm(normal - (normal @ a) * a)
    if joint.type == "universal":
        across = c - (c @ a) * a
        size = float(np.linalg.norm(across))
        a = across / size if size > 1e-6 else normal
    turn = np.array([1.0 + a @ c, *np.cross(c, a)])
    if np.linalg.norm(a + c) < 1e-6:
        turn = np.array([0.0, *normal])
    return [float(entry) for entry in turn / np.linalg.norm(turn)]


def joint_angles(joint: Joint, q: dict[int, list[Number]]) -> np.ndarray:
    """The angle of a hinge, or both of a cross, at attitudes q of bodies, as the scene counts them.

    They lie in (-pi, pi], or have the turns of the joint's start.
    """
    relative = quaternion_product(conjugate(q[joint.parent]), q[joint.child])
    zero = zero_turn(joint) if joint.reference is None else joint.reference.tolist()
    if joint.type == "universal":
        axes = [joint.parent_axis.tolist(), joint.child_axis.tolist()]
    else:  # zero turn(a) = turn(R a) zero: the axis in the child's frame
        axes = [(rotation_from_quaternion(np.array(zero)).T @ joint.parent_axis).tolist()]
    angles = np.array(_angles(axes, zero, relative))
    if joint.start is not None:
        given = np.array(joint.start)[[2] if joint.type == "planar" else [*range(len(axes))]]
        angles += 2 * np.pi * np.round((given - angles) / (2 * np.pi))
    return angles


def _angles(axes: Sequence[list[float]], kept: list[float], other: list[float]) -> list[float]:
    """Angles t with other = kept turn(a0, t0), or turn(a0, t0) kept turn(a1, t1), of unit quaternions."""
    K, A = (rotation_from_quaternion(np.array(q) / np.linalg.norm(q)) for q in (kept, other))
    if len(axes) == 1:
        q = np.array(quaternion_product(conjugate(kept), other))
        angle = 2.0 * np.arctan2(q[1:] @ np.array(axes[0]), q[0])
        return [float(angle - 2 * np.pi * np.round(angle / (2 * np.pi)))]
    first, second = (np.array(axis) for axis in axes)
    before, after = K @ second, A @ second
    turn = np.arctan2(np.cross(before, after) @ first, before @ after - (before @ first) * (after @ first))
    hat = np.array([[0, -first[2], first[1]], [first[2], 0, -first[0]], [-first[1], first[0], 0]])
    rest = K.T @ (np.eye(3) + np.sin(turn) * hat + (1 - np.cos(turn)) * hat @ hat).T @ A
    spin = np.array([rest[2, 1] - rest[1, 2], rest[0, 2] - rest[2, 0], rest[1, 0] - rest[0, 1]])
    return [turn, np.arctan2(spin @ second, np.trace(rest) - 1.0)]
