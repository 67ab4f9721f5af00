"""Kinematics of trees: conversion between joint coordinates and the common convention, in both directions.

Relative attitudes map body axes to the parent's axes; relative angular velocities are in body axes. Links are described
in `crosscheck.adapters.common.links`.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterable, Sequence

import numpy as np

from crosscheck.adapters.common.links import (
    CONJUGATE,
    IDENTITY,
    relative_attitude,
    relative_velocity,
    separation,
)
from crosscheck.adapters.common.links import Link as Link
from crosscheck.adapters.common.links import is_open_tree as is_open_tree
from crosscheck.adapters.common.links import links as links
from crosscheck.adapters.common.links import obstacle as obstacle
from crosscheck.scene.coordinates import at_start
from crosscheck.scene.joints import JOINT_TYPES
from crosscheck.scene.laws import Limits
from crosscheck.scene.model import Scene, quaternion_from_turn, quaternion_product, rotation_from_quaternion
from crosscheck.scene.states import States
from crosscheck.scene.vectors import cross

LEVELS = frozenset({"position", "velocity", "acceleration"})
"""Joint coordinates satisfy every constraint level by construction."""

Shift = tuple[np.ndarray, np.ndarray, np.ndarray | None]


@dataclasses.dataclass
class Motion:
    """Relative motion of one link over T times: its rotation, and its shift on the parent if there is one."""

    R: np.ndarray  # (T, 3, 3)
    w: np.ndarray  # (T, 3)
    alpha: np.ndarray | None = None  # (T, 3) derivative of the components w
    shift: Shift | None = None  # m, m/s, m/s^2 relative to the parent, in its axes, each (T, 3)


def initial_coordinates(scene: Scene, link: Link) -> tuple[np.ndarray, np.ndarray]:
    """(joint position, joint velocity) at t = 0, part by part.

    Ball: quaternion w, x, y, z and relative angular velocity in the outer body's axes. Turn: angle in (-pi, pi] (rad)
    about its axis and its rate. Slide: displacement (m) along its axis and its rate. A fixed link has none.
    """
    attitude = relative_attitude(scene, link.parent, link.body)
    gap, rate = separation(scene, link.parent, link.body, link.parent_anchor, link.child_anchor)
    q = _coordinates(link, attitude, gap)
    w = relative_velocity(scene, link.parent, link.body)
    unit = motion(link, np.tile(q, (link.dofs, 1)), np.eye(link.dofs), None)  # velocities are linear in the rates
    shifting = np.zeros((link.dofs, 3)) if unit.shift is None else unit.shift[1]
    columns = np.concatenate([unit.w, shifting], axis=1).T
    return q, np.linalg.lstsq(columns, np.concatenate([w, rate]), rcond=None)[0]


def coordinate(scene: Scene, link: Link, k: int = 0) -> tuple[int, float, float]:
    """(index among the parts, sign, the scene's value at its zero) of coordinate k of a hinge, slide or cross.

    The scene's coordinate is sign times that of the part, plus the value.
    """
    word, sign = JOINT_TYPES[link.type].coordinates[k], 1.0 if link.outward else -1.0
    if word in ("turn parent", "turn child"):  # the outer body's axis comes last
        part = k if link.outward else 1 - k
    else:
        part = [part.kind for part in link.parts].index(word)
    return part, sign, float(at_start(scene)[link.joint][0][k] - sign * initial_coordinates(scene, link)[0][part])


def hinges(scene: Scene, tree_links: Sequence[Link], firsts: Iterable[int], q: np.ndarray) -> np.ndarray | None:
    """(T, h) rad: the angles of `scene.hinges` with their turns, from joint positions q (T, nq).

    `firsts` are the first columns of the links. None where a hinge is no link, so that it has to be followed.
    """
    at, columns = {link.joint: (link, first) for link, first in zip(tree_links, firsts, strict=True)}, []
    for name, k in scene.hinges:
        if name not in at:
            return None
        part, sign, zero = coordinate(scene, at[name][0], k)
        columns.append(sign * q[:, at[name][1] + part] + zero)
    return np.array(columns).reshape(-1, len(q)).T


def ends(limits: Limits, sign: float, zero: float, far: float = math.inf) -> tuple[float, float]:
    """The range of limits in a coordinate of which the scene's is sign times it, plus zero; `far`, an open end."""
    low, high = sorted(min(max(sign * (end - zero), -far), far) for end in (limits.lower, limits.upper))
    return low, high


def _coordinates(link: Link, attitude: np.ndarray, gap: np.ndarray) -> np.ndarray:
    """Joint position from the relative attitude and the vector between the anchors in the parent's axes."""
    turned = quaternion_product(link.zero * CONJUGATE, attitude)
    kinds = [part.kind for part in link.parts]
    if kinds == ["turn", "turn"]:  # of a universal joint: exp(first) exp(second) = turned, the axes at right angles
        T, first, second = rotation_from_quaternion(turned), link.parts[0].axis, link.parts[1].axis
        third = cross(first, second)
        return np.array([np.arctan2(third @ T @ second, second @ T @ second),
                         np.arctan2(first @ T @ third, first @ T @ first)])
    if kinds == ["turn", "turn", "ball"]:  # of a rod
        first, rod = link.parts[0].axis, link.parts[2].offset
        along, normal = rod / np.linalg.norm(rod), cross(first, rod / np.linalg.norm(rod))
        angles = np.array([np.arctan2(gap @ normal, gap @ along),
                           np.arctan2(gap @ first, np.hypot(gap @ normal, gap @ along))])
        turned = IDENTITY
        for part, angle in zip(link.parts, angles, strict=False):
            turned = quaternion_product(turned, quaternion_from_turn(angle * part.axis))
        return np.concatenate([angles, quaternion_product(turned * CONJUGATE, attitude)])
    outer_slides = kinds[:1] == ["ball"]  # slides after a ball are along the outer body's axes
    reach = rotation_from_quaternion(attitude if outer_slides else link.zero).T @ gap
    values: list[np.ndarray] = []
    for part in link.parts:
        if part.kind == "ball":
            values.append(turned)
        elif part.kind == "slide":
            values.append(np.array([part.axis @ reach]))
        else:
            angle = 2.0 * np.arctan2(turned[1:] @ part.axis, turned[0])
            values.append(np.array([np.remainder(angle + np.pi, 2 * np.pi) - np.pi]))
    return np.concatenate(values) if values else np.zeros(0)


def turning(axis: np.ndarray, angle: np.ndarray, rate: np.ndarray, second: np.ndarray | None) -> Motion:
    """Rotation about a fixed unit `axis`, (3,): angle (rad), rate and its derivative, each (T,)."""
    half = 0.5 * angle[:, None]
    R = rotation_from_quaternion(np.concatenate([np.cos(half), np.sin(half) * axis], axis=1))
    return Motion(R, np.outer(rate, axis), None if second is None else np.outer(second, axis))


def compose(inner: Motion, outer: Motion) -> Motion:
    """The rotation `inner` followed, in its turned frame, by `outer`."""
    carried = _turn_back(outer.R, inner.w)
    alpha = None
    if inner.alpha is not None and outer.alpha is not None:
        # in the outer frame the inner angular velocity rotates with -w of the outer motion
        alpha = _turn_back(outer.R, inner.alpha) + outer.alpha - cross(outer.w, carried)
    return Motion(inner.R @ outer.R, carried + outer.w, alpha)


def motion(link: Link, q: np.ndarray, v: np.ndarray, a: np.ndarray | None) -> Motion:
    """Relative motion from joint coordinates as in `initial_coordinates`, batched: q (T, nq), v and a (T, nv)."""
    still = np.zeros((len(q), 3))
    turned = Motion(np.broadcast_to(rotation_from_quaternion(link.zero), (len(q), 3, 3)), still,
                    None if a is None else still)
    shift: Shift | None = None
    at_q = at_v = 0
    for part in link.parts:
        own = q[:, at_q:at_q + part.coordinates]
        rate, second = v[:, at_v:at_v + part.dofs], None if a is None else a[:, at_v:at_v + part.dofs]
        at_q, at_v = at_q + part.coordinates, at_v + part.dofs
        if np.any(part.offset):
            shift = _shifted(shift, turned, still + part.offset, still, still)
        if part.kind == "slide":
            shift = _shifted(shift, turned, *(still if values is None else values * part.axis
                                              for values in (own, rate, second)))
        elif part.kind == "turn":
            turn = turning(part.axis, own[:, 0], rate[:, 0], None if second is None else second[:, 0])
            turned = compose(turned, turn)
        else:
            R = rotation_from_quaternion(own / np.linalg.norm(own, axis=1, keepdims=True))
            turned = compose(turned, Motion(R, rate, second))
    return dataclasses.replace(turned, shift=shift)


def _shifted(shift: Shift | None, turned: Motion, d: np.ndarray, rate: np.ndarray, second: np.ndarray) -> Shift:
    """`shift` plus a displacement d (T, 3) with its rates, given in axes that move with `turned`."""
    w = turned.w
    speed = rate + cross(w, d)
    added = _turn(turned.R, d), _turn(turned.R, speed)
    acceleration = None
    if turned.alpha is not None:
        acceleration = _turn(turned.R, second + cross(turned.alpha, d) + cross(w, rate + speed))
    if shift is None:
        return (*added, acceleration)
    last = None if acceleration is None or shift[2] is None else shift[2] + acceleration
    return shift[0] + added[0], shift[1] + added[1], last


def forward(tree_links: Sequence[Link], motions: Sequence[Motion], t: np.ndarray, accelerations: bool) -> States:
    """Kinematics of the tree: from relative motions of the links to `States` of the bodies."""
    times, n = len(t), len(tree_links)
    still = np.zeros((times, 3))
    x, v, w, a, alpha = np.zeros((5, times, n + 1, 3))  # the ground is the last, at rest in the world frame
    R = np.broadcast_to(np.eye(3), (times, n + 1, 3, 3)).copy()
    for link, relative in zip(tree_links, motions, strict=True):
        inner, k, hung = link.parent, link.body, link.child_anchor
        d, rate, second = relative.shift or (still, still, still)
        arm, spin = link.parent_anchor + d, w[:, inner]
        turned = compose(Motion(R[:, inner], spin, alpha[:, inner] if accelerations else None), relative)
        R[:, k], w[:, k] = turned.R, turned.w
        x[:, k] = x[:, inner] + _turn(R[:, inner], arm) - turned.R @ hung
        v[:, k] = v[:, inner] + _turn(R[:, inner], cross(spin, arm) + rate) - _turn(turned.R, cross(turned.w, hung))
        if not accelerations:
            continue
        if turned.alpha is None:
            raise ValueError(f"body {k}: the relative motion has no accelerations")
        alpha[:, k] = turned.alpha
        joint = cross(alpha[:, inner], arm) + cross(spin, cross(spin, arm) + 2 * rate) + (
            still if second is None else second)
        hang = cross(turned.alpha, hung) + cross(turned.w, cross(turned.w, hung))
        a[:, k] = a[:, inner] + _turn(R[:, inner], joint) - _turn(turned.R, hang)
    x, R, v, w, a, alpha = (values[:, :n] for values in (x, R, v, w, a, alpha))
    return States(t, x, R, v, w, *((a, alpha) if accelerations else ()))


def _turn(R: np.ndarray, vector: np.ndarray) -> np.ndarray:
    turned: np.ndarray = np.einsum("tij,tj->ti", R, vector)
    return turned


def _turn_back(R: np.ndarray, vector: np.ndarray) -> np.ndarray:
    turned: np.ndarray = np.einsum("tji,tj->ti", R, vector)
    return turned
