"""Rotor inertia of joints in maximal coordinates: the rate of a joint as a row, and the drift in its derivative.

The rate of a hinge is the difference of the two angular velocities along its axis, which is fixed in both bodies. A
slide s along e has d2s/dt2 = e . d" + s (|w|^2 - (e . w)^2), with d" the acceleration of the child's anchor minus that
of the parent's, and w the angular velocity of the parent; the child's differs from it only along e.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from crosscheck.references.world import Motion
from crosscheck.scene.model import Joint, Scene

TURNS = {"revolute": (True,), "prismatic": (False,), "cylindrical": (True, False)}


@dataclasses.dataclass(frozen=True)
class Rotor:
    """One coordinate of a joint with rotor inertia, kg m^2 or kg."""

    joint: Joint
    inertia: float
    turns: bool

    def row(self, motion: Motion) -> tuple[np.ndarray, float]:
        """(row (n + 1, 6), drift) with d(rate)/dt = row . du/dt + drift; v in world, w in body axes."""
        joint, x, R = self.joint, motion.x, motion.R
        row = np.zeros((len(x), 6))
        if self.turns:
            row[joint.child, 3:] += joint.child_axis
            row[joint.parent, 3:] -= joint.parent_axis
            return row, 0.0
        e = R[joint.parent] @ joint.parent_axis
        ends = []
        for body, anchor, sign in ((joint.child, joint.child_anchor, 1.0), (joint.parent, joint.parent_anchor, -1.0)):
            row[body, :3] += sign * e
            row[body, 3:] += sign * np.cross(anchor, R[body].T @ e)
            centripetal = R[body] @ np.cross(motion.w[body], np.cross(motion.w[body], anchor))
            ends.append((x[body] + R[body] @ anchor, centripetal))
        spin = R[joint.parent] @ motion.w[joint.parent]
        slide = float(e @ (ends[0][0] - ends[1][0]))
        turning = float(spin @ spin - (e @ spin) ** 2)
        return row, float(e @ (ends[0][1] - ends[1][1])) + slide * turning


def rotors(scene: Scene) -> list[Rotor]:
    """All coordinates of a scene with rotor inertia."""
    return [Rotor(joint, value, turns) for joint in scene.joints
            for value, turns in zip(joint.armature, TURNS.get(joint.type, ()), strict=False) if value]
