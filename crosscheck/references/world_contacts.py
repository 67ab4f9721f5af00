"""Rows of contacts with a plane of the ground in the maximal formulation, body by body.

The velocity of a body's point p (body axes) at the contact is v + R (w x p). Rows are its components along directions
d, in body axes too: (R d) . v + (p x d) . w.
"""

from __future__ import annotations

import numpy as np

from crosscheck.references.world import Motion
from crosscheck.scene.model import Joint

ROLLING = ("knife_edge", "rolling_disk", "rolling_sphere")


class Contacts:
    """Rows of all joints that roll or slide on a blade: height, and slip, whose values are zero."""

    def __init__(self, joints: list[Joint], n: int) -> None:
        self.joints, self.n = joints, n
        self.planes = [np.linalg.svd(joint.parent_axis[None])[2][1:] for joint in joints]

    def terms(self, motion: Motion) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Values (k), Jacobian (k, n + 1, 6), second derivatives at zero accelerations (k)."""
        values, rows, drifts = [], [], []
        for joint, plane in zip(self.joints, self.planes, strict=True):
            R, v, w = motion.R[joint.child], motion.v[joint.child], motion.w[joint.child]
            up = R.T @ joint.parent_axis  # a vector fixed in the world turns with -w in body axes
            sinking = -np.cross(w, up)
            point, moving, height = joint.child_anchor, np.zeros(3), 0.0
            if joint.type == "rolling_sphere":
                point, moving, height = point - joint.radius * up, -joint.radius * sinking, joint.radius
            elif joint.type == "rolling_disk":
                axis = joint.child_axis
                flat, change = up - (axis @ up) * axis, sinking - (axis @ sinking) * axis
                size = np.linalg.norm(flat)
                point = point - joint.radius * flat / size
                moving = -joint.radius * (change / size - flat * (flat @ change) / size**3)
                height = joint.radius * size
            along = [joint.parent_axis, *plane]
            seen = [(R.T @ direction, -np.cross(w, R.T @ direction)) for direction in along]
            if joint.type == "knife_edge":
                seen[1:] = [(np.cross(up, joint.child_axis), np.cross(sinking, joint.child_axis))]
            own = R.T @ v
            for d, turning in seen:
                row = np.zeros((self.n + 1, 6))
                row[joint.child] = [*R @ d, *np.cross(point, d)]
                rows.append(row)
                # d/dt of d . R^T v at v' = 0, and of (p x d) . w at w' = 0
                drifts.append(turning @ own - d @ np.cross(w, own)
                              + (np.cross(moving, d) + np.cross(point, turning)) @ w)
                values.append(0.0)
            centre = motion.x[joint.child] + R @ joint.child_anchor
            values[len(values) - len(seen)] = joint.parent_axis @ (centre - joint.parent_anchor) - height
        return np.array(values), np.array(rows), np.array(drifts)
