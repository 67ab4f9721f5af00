"""An engine of your own: the classical Runge-Kutta method for a body that turns about a fixed point.

crosscheck verify --engine examples/my_engine.py:PivotRK4 --engine mujoco --scene single_pendulum
"""

import numpy as np

from crosscheck.adapters.base import steps_per_sample
from crosscheck.scene.model import GROUND, rotation_from_quaternion
from crosscheck.scene.states import States


class PivotRK4:
    """State: attitude as a quaternion (w, x, y, z) from body to world, angular velocity in body axes (rad/s)."""

    name = "pivot"
    methods = ("RK4",)
    orders = {"RK4": 4}  # noqa: RUF012  what theory claims, not what was measured

    def unsupported(self, scene, spec):
        """Why this engine cannot run the scene; None if it can."""
        if [(joint.type, joint.parent, joint.child) for joint in scene.joints] != [("spherical", GROUND, 0)]:
            return "it knows one body on a ball joint with the ground"
        return "it knows no force but gravity" if scene.forces else None

    def run(self, scene, spec):
        """States of the body at the times `scene.t`, by fixed steps of `spec.step` s or a little less."""
        joint, mass = scene.joints[0], scene.masses[0]
        c = -joint.child_anchor  # from the pivot to the centre of mass, body axes, m
        inertia = scene.inertias[0] + mass * (c @ c * np.eye(3) - np.outer(c, c))  # about the pivot

        def rate(y):
            q, w = y[:4], y[4:]
            weight = rotation_from_quaternion(q).T @ (mass * scene.gravity)
            turn = [-q[1:] @ w, *(q[0] * w + np.cross(q[1:], w))]
            return np.append(np.multiply(0.5, turn),
                             np.linalg.solve(inertia, np.cross(c, weight) - np.cross(w, inertia @ w)))

        steps, h = steps_per_sample(scene, spec.step)  # per output interval
        y = np.append(scene.bodies[0].attitude, scene.w0[0])
        kept = [y]
        for _ in scene.t[1:]:
            for _ in range(steps):
                k1 = rate(y)
                k2 = rate(y + 0.5 * h * k1)
                k3 = rate(y + 0.5 * h * k2)
                y = y + h / 6 * (k1 + 2 * k2 + 2 * k3 + rate(y + h * k3))
                y[:4] /= np.linalg.norm(y[:4])
            kept.append(y)
        R, w = rotation_from_quaternion(np.array(kept)[:, :4]), np.array(kept)[:, 4:]
        x, v = joint.parent_anchor + R @ c, np.einsum("tij,tj->ti", R, np.cross(w, c))
        return States(scene.t, x[:, None], R[:, None], v[:, None], w[:, None])  # one body: the axis after time
