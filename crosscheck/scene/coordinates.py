"""Joint coordinates, the motions that a joint leaves free, and the states of the child for given coordinates.

Q0 is the attitude of the child in the parent at zero coordinates, d the vector from the parent's anchor to the child's
in the parent's axes, a_p and a_c are the two axes, n1 and n2 the reference vectors of a_p:

- revolute, the angle: R_rel = exp(angle a_p) Q0; cylindrical, [angle, slide], and planar, [x, y, angle], likewise;
- prismatic: R_rel = Q0, slide = a_p . d; planar: x = n1 . d, y = n2 . d;
- universal, [first, second]: R_rel = exp(first a_p) Q0 exp(second a_c);
- spherical, a quaternion w, x, y, z: R_rel = Q0 R(quaternion), its velocity the relative angular velocity in
  the child's axes.

Angles start in (-pi, pi], or at the value that the scene gives, and are continuous from then on. Attitudes do not say
how often a hinge has turned: `States.hinges` does, filled by who makes the states.
"""

from __future__ import annotations

import dataclasses
import math

import numpy as np

from crosscheck.scene.model import GROUND, Joint, Scene, quaternion_from_rotation, rotation_from_quaternion
from crosscheck.scene.states import Motion, States
from crosscheck.scene.vectors import cross, normal_references, shortest_rotation, slide_direction


@dataclasses.dataclass(frozen=True)
class JointHistory:
    """Coordinates of one joint over T times; a joint with one coordinate has arrays (T,), others (T, count)."""

    position: np.ndarray
    velocity: np.ndarray


def zero_attitude(joint: Joint) -> np.ndarray:
    """Q0, (3, 3): the joint's reference attitude, or the default of its type."""
    if joint.reference is not None:
        return rotation_from_quaternion(joint.reference)
    axes = joint.kind.axes
    if axes == "parallel":
        return shortest_rotation(joint.child_axis, joint.parent_axis)
    if axes == "perpendicular":
        across = joint.child_axis - (joint.child_axis @ joint.parent_axis) * joint.parent_axis
        size = float(np.linalg.norm(across))
        return shortest_rotation(joint.child_axis, across / size if size > 1e-6 else
                                 normal_references(joint.parent_axis)[0])
    return np.eye(3)


def angle_from(zero: np.ndarray, axis: np.ndarray, relative: np.ndarray) -> np.ndarray:
    """The angle in (-pi, pi] of relative = exp(angle hat(axis)) zero, (...,); `relative` (..., 3, 3), `zero` (3, 3)."""
    n1, n2 = normal_references(axis)
    pointer = relative @ (zero.T @ n1)
    return np.asarray(np.arctan2(pointer @ n2, pointer @ n1))


def turned(axis: np.ndarray, angle: float) -> np.ndarray:
    """The rotation (3, 3) by `angle` (rad) about the unit vector `axis`."""
    hat = cross(axis, np.eye(3)).T
    return np.asarray(np.eye(3) + np.sin(angle) * hat + 2.0 * np.sin(angle / 2) ** 2 * hat @ hat)


def relative_pose(joint: Joint, position: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(R_rel (3, 3), d (3,) in the parent's axes) at the joint's coordinates."""
    attitude, d = zero_attitude(joint), np.zeros(3)
    words = joint.kind.coordinates
    if words == ("ball",):
        return attitude @ rotation_from_quaternion(position / np.linalg.norm(position)), d
    for word, value in zip(words, position, strict=False):
        if word.startswith("slide"):
            d = d + value * slide_direction(word, joint.parent_axis)
        elif word == "turn child":
            attitude = attitude @ turned(joint.child_axis, value)
        else:
            attitude = turned(joint.parent_axis, value) @ attitude
    return attitude, d


def relative_rates(joint: Joint, position: np.ndarray, velocity: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(relative angular velocity, d' as seen from the parent), (3,) each, in the parent's axes."""
    w, speed = np.zeros(3), np.zeros(3)
    words = joint.kind.coordinates
    if words == ("ball",):
        return relative_pose(joint, position)[0] @ velocity, speed
    for k, (word, rate) in enumerate(zip(words, velocity, strict=False)):
        if word.startswith("slide"):
            speed = speed + rate * slide_direction(word, joint.parent_axis)
        elif word == "turn child":  # about an axis that the earlier coordinates have turned
            w = w + rate * (relative_pose(joint, position[:k])[0] @ joint.child_axis)
        else:
            w = w + rate * joint.parent_axis
    return w, speed


def histories(scene: Scene, states: Motion) -> dict[str, JointHistory]:
    """Coordinates of every joint that has them, over the times of `states`."""
    return {joint.name: history(scene, joint, states) for joint in scene.joints
            if joint.kind.coordinates}


def starting(scene: Scene) -> States:
    """The start as the states of one time."""
    return States(np.zeros(1), scene.x0[None], scene.R0[None], scene.v0[None], scene.w0[None])


def hinge_angles(scene: Scene, states: Motion) -> np.ndarray:
    """(T, h) rad: the angles of `scene.hinges` with their whole turns; NaN where these are not known."""
    found = {joint.name: history(scene, joint, states).position.reshape(len(states.t), -1) for joint in scene.joints
             if any(word.startswith("turn") for word in joint.kind.coordinates)}
    return np.array([found[name][:, k] for name, k in scene.hinges]).reshape(-1, len(states.t)).T


def followed(scene: Scene, states: States, before: States) -> np.ndarray:
    """(T, h) rad: the angles of `scene.hinges` after every step of a source, from the last of those `before` on.

    The mean of the rates at both ends of a step tells how far a hinge turns, to less than half a turn.
    """
    assert before.hinges is not None
    both = States(*(np.concatenate([getattr(before, key)[-1:], getattr(states, key)]) for key in "txRvw"))
    wrapped, rates = np.zeros((2, len(both.t), len(scene.hinges)))
    joints = {joint.name: (joint, relative(joint, both)) for joint in scene.joints}
    for i, (name, k) in enumerate(scene.hinges):
        (joint, moved), word = joints[name], joints[name][0].kind.coordinates[k]
        wrapped[:, i] = _value(word, joint, moved.turn, moved.d)
        rates[:, i] = _rate(word, joint, moved.turn, moved.w, moved.rate)
    steps = 0.5 * (rates[1:] + rates[:-1]) * np.diff(both.t)[:, None]
    gaps = np.diff(wrapped, axis=0) - steps
    turned = wrapped[1:] - wrapped[:1] - 2 * np.pi * np.cumsum(np.round(gaps / (2 * np.pi)), axis=0)
    return np.asarray(before.hinges[-1:] + turned)


def offset_from_half_turn(scene: Scene, joint: Joint) -> float:
    """Offset of the joint's mimic where the angle of the other joint counts from (-pi, pi] at the start."""
    assert joint.mimic is not None
    position, _ = at_start(scene)[joint.mimic.joint]
    leader = scene.joint(joint.mimic.joint)
    turns = round(float(position[0]) / math.tau) if not leader.kind.slides else 0
    return joint.mimic.offset + joint.mimic.ratio * math.tau * turns


def at_start(scene: Scene) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Coordinates and their rates, (count,) each, of every joint that has them, in the initial state."""
    return {name: (np.atleast_1d(each.position[0]), np.atleast_1d(each.velocity[0]))
            for name, each in histories(scene, starting(scene)).items()}


@dataclasses.dataclass(frozen=True)
class Relative:
    """The motion of a joint's child as its parent sees it, (T, 3) each, in the parent's axes."""

    turn: np.ndarray  # (T, 3, 3) from child to parent axes
    w: np.ndarray  # relative angular velocity
    d: np.ndarray  # from the parent's anchor to the child's
    rate: np.ndarray  # d' as seen from the parent
    spinning: np.ndarray | None = None  # w' and d'', where the states have accelerations
    speeding: np.ndarray | None = None


def relative(joint: Joint, states: Motion, accelerated: bool = False) -> Relative:
    """The relative motion over the times of `states`; with `accelerated`, they have to be `States` with a and alpha."""
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
    speed = vc + cross(outer, arm) - vp - cross(spin, reach)
    rate, w = (np.einsum("tji,tj->ti", Rp, vector) for vector in (speed, outer - spin))
    turn = np.swapaxes(Rp, 1, 2) @ Rc
    if not accelerated:
        return Relative(turn, w, d, rate)
    assert isinstance(states, States)
    assert states.a is not None
    assert states.alpha is not None
    ap, bp = (still if parent == GROUND else values[:, parent] for values in (states.a, states.alpha))
    sweep, swing = np.einsum("tij,tj->ti", Rp, bp), np.einsum("tij,tj->ti", Rc, states.alpha[:, child])
    beyond = (states.a[:, child] + cross(swing, arm) + cross(outer, cross(outer, arm)) - ap - cross(sweep, reach)
              - cross(spin, cross(spin, reach)) - 2.0 * cross(spin, speed))
    return Relative(turn, w, d, rate, np.einsum("tji,tj->ti", Rp, swing - sweep) - cross(wp, w),
                    np.einsum("tji,tj->ti", Rp, beyond))


def rates(joint: Joint, states: Motion, accelerated: bool = False) -> np.ndarray:
    """The rates of a joint, (T,) or (T, count), or their derivatives, from states with accelerations."""
    moved = relative(joint, states, accelerated)
    w, rate = (moved.spinning, moved.speeding) if accelerated else (moved.w, moved.rate)
    assert w is not None
    assert rate is not None
    if joint.kind.is_ball:
        return np.asarray(np.einsum("tji,tj->ti", moved.turn, w))
    columns = [_rate(word, joint, moved.turn, w, rate) for word in joint.kind.coordinates]
    return np.stack(columns, axis=1) if len(columns) > 1 else columns[0]


def history(scene: Scene, joint: Joint, states: Motion) -> JointHistory:
    """Coordinates of one joint that has them, over the times of `states`; NaN are angles whose turns are not known."""
    moved = relative(joint, states)
    words = joint.kind.coordinates
    if words == ("ball",):
        position, velocity = quaternion_from_rotation(zero_attitude(joint).T @ moved.turn), np.einsum(
            "tji,tj->ti", moved.turn, moved.w)
        flips = np.cumprod(np.where(np.einsum("tk,tk->t", position[1:], position[:-1]) < 0, -1.0, 1.0))
        position[1:] *= flips[:, None]
        return JointHistory(position, velocity)
    columns = []
    for k, word in enumerate(words):
        values, rates = _value(word, joint, moved.turn, moved.d), _rate(word, joint, moved.turn, moved.w, moved.rate)
        if word.startswith("turn"):
            known = (resolved(values, None if joint.start is None else joint.start[k], rates, states.t)
                     if states.hinges is None else states.hinges[:, scene.hinges.index((joint.name, k))])
            values = values + 2 * np.pi * np.round((known - values) / (2 * np.pi))
        columns.append((values, rates))
    return JointHistory(*(np.stack(part, axis=1) if len(words) > 1 else part[0]
                          for part in zip(*columns, strict=True)))


REACH, MISSED = 1.5, 0.3
"""How far, rad, a hinge may turn between two times, by the larger of its rates, and how far it may miss what the mean
of the two predicts: beyond them these times do not tell how often it has turned."""


def resolved(wrapped: np.ndarray, start: float | None, rate: np.ndarray, t: np.ndarray) -> np.ndarray:
    """Angles (T,) with their turns, of a source that has not followed them, from `start` or from the first one on.

    NaN from the first interval on that is too long to tell them.
    """
    begin = wrapped[:1] if start is None else np.array([start])
    first = wrapped[:1] + 2 * np.pi * np.round((begin - wrapped[:1]) / (2 * np.pi))
    steps = 0.5 * (rate[1:] + rate[:-1]) * np.diff(t)
    left = np.diff(wrapped) - steps
    left -= 2 * np.pi * np.round(left / (2 * np.pi))
    far = np.maximum(np.abs(rate[1:]), np.abs(rate[:-1])) * np.diff(t)
    unknown = np.logical_or.accumulate((far > REACH) | (np.abs(left) > MISSED))
    return np.concatenate([first, np.where(unknown, np.nan, first + np.cumsum(steps + left))])


def _value(word: str, joint: Joint, relative: np.ndarray, d: np.ndarray) -> np.ndarray:
    """A coordinate, (T,), angles in (-pi, pi]; d (T, 3) in the parent's axes."""
    axis = joint.parent_axis
    if word.startswith("slide"):
        return np.asarray(d @ slide_direction(word, axis))
    zero = zero_attitude(joint)
    if word == "turn parent":
        second, start = relative @ joint.child_axis, zero @ joint.child_axis
        return np.asarray(np.arctan2(second @ cross(axis, start), second @ start))
    if word == "turn child":
        inner = zero.T @ axis  # the parent's axis in the child's frame at zero, normal to the child's
        back = np.einsum("tji,j->ti", relative, axis)
        return np.asarray(-np.arctan2(back @ cross(joint.child_axis, inner), back @ inner))
    return angle_from(zero, axis, relative)


def _rate(word: str, joint: Joint, relative: np.ndarray, w: np.ndarray, rate: np.ndarray) -> np.ndarray:
    """The rate of a coordinate, or its derivative from w' and d'', (T,); `w`, `rate` (T, 3) in the parent's axes."""
    if word.startswith("slide"):
        return np.asarray(rate @ slide_direction(word, joint.parent_axis))
    if word == "turn child":
        return np.asarray(np.einsum("tk,tk->t", w, relative @ joint.child_axis))  # the axes are at right angles
    return np.asarray(w @ joint.parent_axis)
