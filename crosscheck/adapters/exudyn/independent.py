"""Finds axes of joints that Exudyn need not constrain because others already do; its solvers need independent rows."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from crosscheck.adapters.exudyn.items import free_axes, joint_frames
from crosscheck.scene.mechanics import redundant_rows
from crosscheck.scene.model import GROUND, Joint, Scene

DEPENDENT = 1e-6
"""If less than this of a row of unit length is independent of the earlier rows, it depends on them."""


def dropped_axes(scene: Scene, closing: Sequence[Joint]) -> dict[str, set[int]]:
    """Axes of ObjectJointGeneric to be left free, by joint name; chosen in the initial position.

    For each joint, the row that is most independent of the rows taken so far is taken next.
    """
    if not redundant_rows(scene):
        return {}
    length = max(1e-300, max(float(np.abs(joint.child_anchor).max()) for joint in scene.joints))
    basis = np.zeros((0, 6 * scene.n))
    dropped = {}
    last = {joint.name for joint in closing if not joint.kind.length}
    for joint in sorted(scene.joints, key=lambda joint: joint.name in last):
        rows = _rows(scene, joint, length)
        dropped[joint.name] = set(rows)
        while rows:
            left = {axis: row - basis.T @ (basis @ row) for axis, row in rows.items()}
            axis = max(left, key=lambda axis: float(np.linalg.norm(left[axis])))
            size = np.linalg.norm(left[axis])
            if size < DEPENDENT and joint.name in last:
                break
            basis = np.vstack([basis, left[axis] / size])
            del rows[axis]
            dropped[joint.name].remove(axis)
    return {name: axes for name, axes in dropped.items() if axes}


def _rows(scene: Scene, joint: Joint, length: float) -> dict[int, np.ndarray]:
    """Unit rows (6 n,) of a joint's constrained axes: velocities over `length` and angular velocities, world axes."""
    ends = (joint.child, joint.child_anchor, 1.0), (joint.parent, joint.parent_anchor, -1.0)
    if joint.kind.length:
        gap = sum(sign * (anchor if body == GROUND else scene.x0[body] + scene.R0[body] @ anchor)
                  for body, anchor, sign in ends)
        frame, constrained = np.outer(gap, (1.0, 0.0, 0.0)), {0}
    else:
        frame = (np.eye(3) if joint.parent == GROUND else scene.R0[joint.parent]) @ joint_frames(scene, joint)[0]
        constrained = {*range(6)} - free_axes(joint)
    rows = {}
    for axis in constrained:
        row = np.zeros((scene.n, 2, 3))
        direction = frame[:, axis % 3]
        for body, anchor, sign in ends:
            if body == GROUND:
                continue
            if axis < 3:
                row[body] = sign * np.array([length * direction, np.cross(scene.R0[body] @ anchor, direction)])
            else:
                row[body, 1] = sign * length * direction
        rows[axis] = row.ravel() / np.linalg.norm(row)
    return rows
