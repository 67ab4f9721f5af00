"""Coordinates of joints: what they are along a motion, and a problem that starts from them.

==========================  ==========================================================================================
joint                       coordinates: angles (rad), then slides (m)
==========================  ==========================================================================================
revolute                    angle about the parent's axis; zero where the shortest rotation takes child_axis to it
universal                   angle about the parent's axis, angle about the child's; zero where child_axis is the first
                            normal of the parent's axis (`lieeuler.checks.normals`), by the shortest rotation
spherical                   rotation vector of R_parent^T R_child; its rates are the components of the relative angular
                            velocity in the child's axes
cylindrical, prismatic      (angle as above and) slide along the parent's axis
planar                      angle, slides along the two normals of the parent's axis
point_on_line, _on_plane    rotation vector, slides along the line, or the two normals
fixed                       none
==========================  ==========================================================================================

Joints with another row between them, as a distance or a contact, have no coordinates here.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any

import numpy as np

from lieeuler.checks import array, normals
from lieeuler.errors import ArgumentError
from lieeuler.forces import shortest_rotation
from lieeuler.joints import Joint
from lieeuler.problem import Body, Problem
from lieeuler.solution import Solution
from lieeuler.types import GROUND, ArrayLike


@dataclasses.dataclass(frozen=True)
class Coordinates:
    """Coordinates of one joint along a motion: position and rate, (T, k)."""

    position: np.ndarray
    rate: np.ndarray


class _Freedom:
    """What a joint leaves free: the attitude C = R_parent^T R_child by 0, 1, 2 or 3 angles, and slides."""

    def __init__(self, joint: Joint) -> None:
        across, turns = joint.basic_rows or ([], [])
        if not across or len(turns) > 3:
            raise ArgumentError(f"no coordinates are known of a joint with these rows: {joint}")
        self.angles = 3 - len(turns)
        self.slides = np.zeros((0, 3)) if len(across) > 2 else np.array(
            [np.cross(across[0], across[1])] if len(across) == 2 else normals(across[0]))
        if self.angles == 2:
            self.axis, self.child_axis = turns[0].a_axis, turns[0].b_axis
        elif self.angles < 2:
            self.axis, self.child_axis = np.cross(turns[0].a_axis, turns[1].a_axis), turns[0].b_axis
        else:
            self.axis = self.child_axis = np.eye(3)[2]
        self.n1, self.n2 = normals(self.axis)
        self.zero = shortest_rotation(self.child_axis, self.n1 if self.angles == 2 else self.axis)
        if self.angles == 0 and np.array_equal(turns[0].b_axis, turns[1].b_axis):  # of a slide
            b = turns[2].b_axis
            self.zero = np.array([np.cross(self.n2, self.axis), self.n2, self.axis]).T @ np.array(
                [np.cross(b, self.child_axis), b, self.child_axis])
        elif self.angles == 0:
            self.zero = np.array([turns[2].b_axis, turns[0].b_axis, turns[1].b_axis])
        self.size = self.angles + len(self.slides)

    def attitude(self, q: np.ndarray, rate: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """C (3, 3), and the relative angular velocity (3,) in the child's axes."""
        if self.angles == 3:
            return _turn(q[:3]), rate[:3]
        if self.angles == 0:
            return self.zero, np.zeros(3)
        C = _turn(q[0] * self.axis) @ self.zero
        if self.angles == 1:
            return C, rate[0] * self.child_axis
        C = C @ _turn(q[1] * self.child_axis)
        return C, rate[0] * (C.T @ self.axis) + rate[1] * self.child_axis

    def measured(self, C: np.ndarray, spin: np.ndarray) -> tuple[list[np.ndarray], list[np.ndarray]]:
        """The angles and their rates, (T,) each, of C (T, 3, 3) and the relative angular velocity (T, 3)."""
        if self.angles == 3:
            vectors = np.array([_vector(each) for each in C])
            return list(vectors.T), list(spin.T)
        if self.angles == 0:
            return [], []
        pointer = C @ (self.child_axis if self.angles == 2 else self.zero.T @ self.n1)
        first = np.unwrap(np.arctan2(pointer @ self.n2, pointer @ self.n1))
        if self.angles == 1:
            return [first], [spin @ self.child_axis]
        axis, begin = np.swapaxes(C, 1, 2) @ self.axis, self.zero.T @ self.axis
        second = np.unwrap(np.arctan2(np.cross(axis, begin) @ self.child_axis, axis @ begin))
        return [first, second], [np.sum(axis * spin, axis=1), spin @ self.child_axis]


def _turn(vector: np.ndarray) -> np.ndarray:
    """exp(hat(vector))"""
    angle = float(np.linalg.norm(vector))
    hat = np.cross(vector, np.eye(3)).T
    turn: np.ndarray = np.eye(3) + np.sinc(angle / np.pi) * hat + 0.5 * np.sinc(0.5 * angle / np.pi)**2 * hat @ hat
    return turn


def _vector(C: np.ndarray) -> np.ndarray:
    """The rotation vector (3,) of a rotation, by its quaternion."""
    K = np.array([[C[0, 0] - C[1, 1] - C[2, 2], 0, 0, 0], [C[0, 1] + C[1, 0], C[1, 1] - C[0, 0] - C[2, 2], 0, 0],
                  [C[0, 2] + C[2, 0], C[1, 2] + C[2, 1], C[2, 2] - C[0, 0] - C[1, 1], 0],
                  [C[2, 1] - C[1, 2], C[0, 2] - C[2, 0], C[1, 0] - C[0, 1], np.trace(C)]])
    q = np.linalg.eigh(K)[1][:, 3]  # the lower half is read
    q = q if q[3] >= 0 else -q
    size = np.linalg.norm(q[:3])
    vector: np.ndarray = (2 * np.arctan2(size, q[3]) / size if size > 0 else 2.0) * q[:3]
    return vector


def joint_coordinates(problem: Problem, motion: Solution | Problem) -> tuple[Coordinates | None, ...]:
    """Coordinates of each joint of a problem along a solution, or of a problem's own state (T = 1); None of joints that
    have none (see `lieeuler.coordinates`). Angles are in (-pi, pi] at the first sample, and continuous where samples
    are less than half a turn apart."""
    if not isinstance(problem, Problem) or not isinstance(motion, Problem | Solution):
        raise ArgumentError("joint_coordinates takes a lieeuler.Problem, and a Solution or a Problem")
    x, R, v, w = (np.asarray(getattr(motion, name)) for name in "xRvw")
    if x.shape[-2] != problem.n:
        raise ArgumentError(f"the motion is one of {x.shape[-2]} bodies, the problem has {problem.n}")
    if isinstance(motion, Problem):
        x, R, v, w = x[None], R[None], v[None], w[None]
    found: list[Coordinates | None] = []
    for joint in problem.joints:
        try:
            free = _Freedom(joint)
        except ArgumentError:
            found.append(None)
            continue
        still, p, c = np.zeros_like(x[:, 0]), joint.parent, joint.child
        xp, Rp, vp, wp = ((still, np.broadcast_to(np.eye(3), R[:, 0].shape), still, still) if p == GROUND else
                          (x[:, p], R[:, p], v[:, p], w[:, p]))
        back = np.swapaxes(Rp, 1, 2)
        C = back @ R[:, c]
        position, rate = free.measured(C, w[:, c] - np.einsum("tji,tj->ti", C, wp))
        arm = np.einsum("tij,tj->ti", back, x[:, c] + R[:, c] @ joint.child_anchor - xp)
        speed = v[:, c] + np.einsum("tij,tj->ti", R[:, c], np.cross(w[:, c], joint.child_anchor)) - vp
        d, moved = arm - joint.parent_anchor, np.einsum("tij,tj->ti", back, speed) - np.cross(wp, arm)
        found.append(Coordinates(np.column_stack([np.zeros((len(x), 0)), *position, d @ free.slides.T]),
                                 np.column_stack([np.zeros((len(x), 0)), *rate, moved @ free.slides.T])))
    return tuple(found)


def from_joints(bodies: Sequence[Body], joints: Sequence[Joint], gravity: ArrayLike,
                positions: Sequence[ArrayLike | None], rates: Sequence[ArrayLike | None] | None = None,
                **fields: Any) -> Problem:
    """A problem that starts from coordinates of its joints.

    Parameters
    ----------
    bodies, joints, gravity, fields
        As `Problem` takes them.
    positions, rates : a sequence (k,) for each joint, or None
        Coordinates as `joint_coordinates` gives them, and their rates, by default zero. A None stands for zeros; joints
        whose bodies hang on the ground by earlier ones close loops and have None: the state has to close them.

    Raises
    ------
    ArgumentError
        A body does not hang on the ground by joints with coordinates, a number of coordinates is wrong, or the state
        does not close the other joints; `lieeuler.project` closes them from nearby.
    """
    for name, values in (("bodies", bodies), ("joints", joints), ("positions", positions),
                         ("rates", () if rates is None else rates)):
        if not isinstance(values, Sequence | np.ndarray):
            raise ArgumentError(f"{name} must be a sequence, not {values!r}")
    if not all(isinstance(joint, Joint) and joint.child < len(bodies) for joint in joints):
        raise ArgumentError(f"joints must be lieeuler.Joint, of the bodies 0 .. {len(bodies) - 1}")
    n, given = len(bodies), rates if rates is not None else [None] * len(joints)
    if len(positions) != len(joints) or len(given) != len(joints):
        raise ArgumentError(f"positions and rates need an entry for each of the {len(joints)} joints")
    x, v, w = np.zeros((3, n, 3))
    R, placed, left = np.tile(np.eye(3), (n, 1, 1)), {GROUND}, list(range(len(joints)))
    while ready := [k for k in left if joints[k].parent in placed and joints[k].child not in placed]:
        k = ready[0]
        left.remove(k)
        joint, free = joints[k], _Freedom(joints[k])
        p, c = joint.parent, joint.child
        q, rate = (np.zeros(free.size) if value is None else array(f"{name}[{k}]", value, (free.size,))
                   for name, value in (("positions", positions[k]), ("rates", given[k])))
        xp, Rp, vp, wp = (np.zeros(3), np.eye(3), np.zeros(3), np.zeros(3)) if p == GROUND else (x[p], R[p], v[p], w[p])
        C, spin = free.attitude(q, rate)
        arm = joint.parent_anchor + q[free.angles:] @ free.slides
        R[c], w[c] = Rp @ C, C.T @ wp + spin
        x[c] = xp + Rp @ arm - R[c] @ joint.child_anchor
        v[c] = vp + Rp @ (np.cross(wp, arm) + rate[free.angles:] @ free.slides) - R[c] @ np.cross(w[c],
                                                                                                joint.child_anchor)
        placed.add(c)
    if len(placed) <= n:
        raise ArgumentError(f"bodies {sorted(set(range(n)) - placed)} do not hang on the ground by joints")
    if any(positions[k] is not None or given[k] is not None for k in left):
        raise ArgumentError(f"joints {left} close loops: their coordinates follow from the others', leave them None")
    return Problem(tuple(bodies), tuple(joints), np.asarray(gravity), x, R, v, w, **fields)
