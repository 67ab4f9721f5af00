"""Arms of hinges, for tests of what is in joint coordinates."""

from __future__ import annotations

import numpy as np

from crosscheck.scene.building import scene_from


def arm(count=2, *, damping=0.3, armature=0.0, stiffness=0.0, seed=0, **changes):
    """A chain of hinges; with a seed other than 0 its axes and inertias are random."""
    rng = np.random.default_rng(seed)
    bodies, joints = [], []
    for k in range(count):
        inertia, axis = np.diag([0.1, 0.12, 0.05]), np.array([0.0, 1.0, 0.0])
        if seed:
            root = rng.normal(size=(3, 3))
            inertia, axis = root @ root.T * 0.05 + 0.1 * np.eye(3), rng.normal(size=3)
            inertia = 0.5 * (inertia + inertia.T) + np.trace(inertia) * np.eye(3)
        bodies.append({"name": f"b{k}", "mass": 1.0 + 0.2 * k, "inertia": inertia.tolist()})
        joints.append({"name": f"j{k}", "type": "revolute", "parent": f"b{k - 1}" if k else "ground", "child": f"b{k}",
                       "parent_anchor": [0.0, 0.0, -0.4 if k else 0.0], "child_anchor": [0.05, 0.0, 0.4],
                       "parent_axis": axis.tolist(), "child_axis": axis.tolist(), "damping": damping,
                       "armature": armature, "stiffness": stiffness, "rest_position": 0.1,
                       "position": 0.3 + 0.2 * k, "velocity": (-1.0) ** k * (1.0 + 0.3 * k)})
    forces = [{"type": "joint_torque", "joint": f"j{k}", "torque": 0.7 - 0.6 * k} for k in range(count)]
    return scene_from({"schema": 3, "name": "arm", "gravity": [0.0, 0.0, -9.81], "duration": 0.5, "samples": 6,
                       "bodies": bodies, "joints": joints, "forces": forces} | changes, "arm")
