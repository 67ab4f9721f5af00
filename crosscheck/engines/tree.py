"""Open kinematic trees: relative joint motion and the common convention, both ways, for the joint-coordinate engines.

A link is a joint seen from the ground outwards: it carries its body relative to its parent. Relative attitudes map
body axes to the parent's axes; relative angular velocities are in body axes.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Sequence

import numpy as np

from crosscheck.scene import GROUND, Joint, Scene, rotation_from_quaternion
from crosscheck.states import States

IDENTITY = np.array([1.0, 0.0, 0.0, 0.0])
LEVELS = frozenset({"position", "velocity", "acceleration"})
"""Joint coordinates hold every constraint level by construction."""


@dataclasses.dataclass(frozen=True)
class Link:
    """A body and the joint that hangs it on its parent (body index, or -1 for the ground)."""

    body: int
    parent: int
    type: str
    parent_anchor: np.ndarray  # (3,) parent's frame, from its centre of mass; world for the ground
    child_anchor: np.ndarray  # (3,) body frame, from the centre of mass
    axis: np.ndarray  # (3,) unit, body frame; zero for a joint without an axis
    zero: np.ndarray  # (4,) quaternion w, x, y, z of the relative attitude at zero joint coordinate

    @property
    def dofs(self) -> int:
        """Degrees of freedom of the joint."""
        return {"spherical": 3, "revolute": 1, "prismatic": 1, "fixed": 0}[self.type]


@dataclasses.dataclass
class Motion:
    """Relative motion of one link over T times: rotation, and travel along the axis where the joint slides."""

    R: np.ndarray  # (T, 3, 3)
    w: np.ndarray  # (T, 3)
    alpha: np.ndarray | None = None  # (T, 3) derivative of the components w
    travel: tuple[np.ndarray, np.ndarray, np.ndarray | None] | None = None  # m, m/s, m/s^2, each (T,)


def obstacle(scene: Scene, types: Iterable[str]) -> str | None:
    """Why `scene` is no force-free open tree of joints of these `types`, or None where it is one."""
    types = tuple(types)
    if scene.forces:
        return f"forces of type {scene.forces[0].type} are not built into this adapter; only gravity is"
    for joint in scene.joints:
        if joint.type not in types:
            return f"joint {joint.name!r}: type {joint.type} is not built; this form has {', '.join(types)}"
    if len(scene.joints) > scene.n or _order(scene) is None:
        return "the joints do not form an open tree rooted in the ground (a loop, or a body that hangs on no joint)"
    return None


def links(scene: Scene) -> tuple[Link, ...]:
    """The links of a scene without `obstacle`, parents before children."""
    ordered = _order(scene)
    if ordered is None:
        raise ValueError(f"scene {scene.name!r} is no open tree")
    return tuple(_link(scene, joint, outward) for joint, outward in ordered)


def _order(scene: Scene) -> list[tuple[Joint, bool]] | None:
    """Joints from the ground outwards, each with whether its child is the outer body; None if that is no tree."""
    reached, left, ordered = {GROUND}, list(scene.joints), []
    while left:
        joint = next((joint for joint in left if (joint.parent in reached) != (joint.child in reached)), None)
        if joint is None:
            return None
        ordered.append((joint, joint.parent in reached))
        left.remove(joint)
        reached |= {joint.parent, joint.child}
    return ordered if len(reached) == scene.n + 1 else None


def _link(scene: Scene, joint: Joint, outward: bool) -> Link:
    axes = [np.zeros(3) if axis is None else axis for axis in (joint.parent_axis, joint.child_axis)]
    ends = [(joint.parent, joint.parent_anchor, axes[0]), (joint.child, joint.child_anchor, axes[1])]
    (parent, parent_anchor, parent_axis), (body, child_anchor, axis) = ends if outward else ends[::-1]
    zero = IDENTITY
    if joint.type == "revolute":
        zero = _shortest_rotation(axis, parent_axis)
    elif joint.type in ("prismatic", "fixed"):
        zero = relative_attitude(scene, parent, body)
    return Link(body, parent, joint.type, parent_anchor, child_anchor, axis, zero)


def _shortest_rotation(start: np.ndarray, end: np.ndarray) -> np.ndarray:
    """Unit quaternion of the shortest rotation that takes the unit vector `start` to `end`."""
    quaternion = np.concatenate([[1.0 + start @ end], np.cross(start, end)])
    if np.linalg.norm(quaternion) < 1e-8:  # opposite vectors: half a turn about any axis across them
        across = np.eye(3)[np.argmin(np.abs(start))]
        quaternion = np.concatenate([[0.0], np.cross(start, across)])
    return quaternion / np.linalg.norm(quaternion)


def multiply(p: np.ndarray, q: np.ndarray) -> np.ndarray:
    """Quaternion product of p and q, (4,), w first."""
    return np.concatenate([[p[0] * q[0] - p[1:] @ q[1:]], p[0] * q[1:] + q[0] * p[1:] + np.cross(p[1:], q[1:])])


def relative_attitude(scene: Scene, parent: int, body: int) -> np.ndarray:
    """Initial attitude of `body` relative to `parent` as a quaternion w, x, y, z."""
    attitude = scene.bodies[body].attitude
    if parent == GROUND:
        return attitude
    return multiply(scene.bodies[parent].attitude * np.array([1.0, -1.0, -1.0, -1.0]), attitude)


def initial_coordinates(scene: Scene, link: Link) -> tuple[np.ndarray, np.ndarray]:
    """(joint position, joint velocity) at t = 0.

    Spherical: quaternion w, x, y, z and relative angular velocity in body axes. Revolute: angle (rad) about `axis`
    and its rate. Prismatic: travel (m) along the axis and its rate. Fixed: nothing.
    """
    attitude = relative_attitude(scene, link.parent, link.body)
    rotation = rotation_from_quaternion(attitude)
    grounded = link.parent == GROUND
    w_parent = np.zeros(3) if grounded else scene.w0[link.parent]
    w = scene.w0[link.body] - rotation.T @ w_parent
    if link.type == "spherical":
        return attitude, w
    if link.type == "revolute":
        turn = multiply(link.zero * np.array([1.0, -1.0, -1.0, -1.0]), attitude)
        angle = 2.0 * np.arctan2(turn[1:] @ link.axis, turn[0])
        return np.array([np.remainder(angle + np.pi, 2 * np.pi) - np.pi]), np.array([w @ link.axis])
    if link.type == "prismatic":
        return _initial_travel(scene, link)
    return np.zeros(0), np.zeros(0)


def _initial_travel(scene: Scene, link: Link) -> tuple[np.ndarray, np.ndarray]:
    """Travel and its rate: the gap between the anchors and its velocity relative to the parent, along the axis."""
    axis = scene.R0[link.body] @ link.axis
    arm = scene.R0[link.body] @ link.child_anchor
    end, speed = scene.x0[link.body] + arm, scene.v0[link.body] + scene.R0[link.body] @ np.cross(
        scene.w0[link.body], link.child_anchor)
    if link.parent == GROUND:
        return np.array([axis @ (end - link.parent_anchor)]), np.array([axis @ speed])
    R, w = scene.R0[link.parent], scene.w0[link.parent]
    gap = end - scene.x0[link.parent] - R @ link.parent_anchor
    carried = scene.v0[link.parent] + R @ np.cross(w, link.parent_anchor + R.T @ gap)
    return np.array([axis @ gap]), np.array([axis @ (speed - carried)])


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
        # what the inner rotation carries turns backwards as seen from the outer frame
        alpha = _turn_back(outer.R, inner.alpha) + outer.alpha - np.cross(outer.w, carried)
    return Motion(inner.R @ outer.R, carried + outer.w, alpha)


def motion(link: Link, q: np.ndarray, v: np.ndarray, a: np.ndarray | None) -> Motion:
    """Relative motion from joint coordinates as in `initial_coordinates`, batched: q (T, nq), v and a (T, nv)."""
    times = len(q)
    zero = rotation_from_quaternion(link.zero)
    if link.type == "spherical":
        return Motion(rotation_from_quaternion(q / np.linalg.norm(q, axis=1, keepdims=True)), v, a)
    still = np.zeros((times, 3))
    if link.type == "revolute":
        turn = turning(link.axis, q[:, 0], v[:, 0], None if a is None else a[:, 0])
        return dataclasses.replace(turn, R=zero @ turn.R)
    constant = np.broadcast_to(zero, (times, 3, 3))
    travel = (q[:, 0], v[:, 0], None if a is None else a[:, 0]) if link.type == "prismatic" else None
    return Motion(constant, still, still, travel)


def forward(chain: Sequence[Link], motions: Sequence[Motion], t: np.ndarray, accelerations: bool) -> States:
    """Kinematics of the tree: relative motions of the links to `States` of the bodies."""
    times, n = len(t), len(chain)
    states = States(t, np.empty((times, n, 3)), np.empty((times, n, 3, 3)), np.empty((times, n, 3)),
                    np.empty((times, n, 3)))
    a, alpha = np.empty((times, n, 3)), np.empty((times, n, 3))
    for link, relative in zip(chain, motions, strict=True):
        _place(states, link, relative)
        if accelerations:
            a[:, link.body], alpha[:, link.body] = _accelerations(states, a, alpha, link, relative)
    if accelerations:
        states.a, states.alpha = a, alpha
    return states


def _turn(R: np.ndarray, vector: np.ndarray) -> np.ndarray:
    return np.einsum("tij,tj->ti", R, vector)


def _turn_back(R: np.ndarray, vector: np.ndarray) -> np.ndarray:
    return np.einsum("tji,tj->ti", R, vector)


def _parent(states: States, link: Link) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """x, R, v, w of the parent; the resting ground has the world's frame."""
    if link.parent == GROUND:
        rest = np.zeros((len(states.t), 3))
        return rest, np.broadcast_to(np.eye(3), (len(rest), 3, 3)), rest, rest
    k = link.parent
    return states.x[:, k], states.R[:, k], states.v[:, k], states.w[:, k]


def _slide(link: Link, relative: Motion) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Joint point in the parent's frame, its velocity and acceleration relative to that frame, each (T, 3)."""
    still = np.zeros((len(relative.R), 3))
    if relative.travel is None:
        return still + link.parent_anchor, still, still
    axis = rotation_from_quaternion(link.zero) @ link.axis
    d, rate, second = (still[:, 0] if part is None else part for part in relative.travel)
    return link.parent_anchor + np.outer(d, axis), np.outer(rate, axis), np.outer(second, axis)


def _place(states: States, link: Link, relative: Motion) -> None:
    x, R, v, w = _parent(states, link)
    arm, slide, _ = _slide(link, relative)
    body = link.body
    turned = compose(Motion(R, w), relative)
    states.R[:, body], states.w[:, body] = turned.R, turned.w
    states.x[:, body] = x + _turn(R, arm) - states.R[:, body] @ link.child_anchor
    states.v[:, body] = v + _turn(R, np.cross(w, arm) + slide) - _turn(
        states.R[:, body], np.cross(states.w[:, body], link.child_anchor))


def _accelerations(states: States, a: np.ndarray, alpha: np.ndarray, link: Link,
                   relative: Motion) -> tuple[np.ndarray, np.ndarray]:
    """(a, alpha) of the link's body, (T, 3) each, from those of its parent in `a` and `alpha`, (T, n, 3)."""
    _, R, _, w = _parent(states, link)
    arm, slide, second = _slide(link, relative)
    still = np.zeros_like(w)
    a_parent, alpha_parent = (still, still) if link.parent == GROUND else (a[:, link.parent], alpha[:, link.parent])
    turned = compose(Motion(R, w, alpha_parent), relative)
    if turned.alpha is None:
        raise ValueError(f"body {link.body}: the relative motion has no accelerations")
    joint = np.cross(alpha_parent, arm) + np.cross(w, np.cross(w, arm) + 2 * slide) + second
    hang = np.cross(turned.alpha, link.child_anchor) + np.cross(turned.w, np.cross(turned.w, link.child_anchor))
    return a_parent + _turn(R, joint) - _turn(turned.R, hang), turned.alpha
