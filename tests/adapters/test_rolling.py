"""Engines on bodies that roll: Exudyn's disks at their order, and the reasons of the others."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import crosscheck
from crosscheck import adapters
from crosscheck.adapters.base import RunSpec
from crosscheck.references.maximal import Maximal

STEPS = (4e-3, 2e-3)


def elsewhere(scene):
    """The scene with its centre of mass off the disk's, on a plane that leans."""
    body, joint, R = scene.bodies[0], scene.joints[0], scene.R0[0]
    anchor, turn, origin = np.array([0.03, -0.02, 0.05]), Rotation.from_euler("xyz", [0.3, -0.2, 0.5]).as_matrix(), 0.2
    x, v = body.position - R @ anchor, body.velocity - np.cross(R @ body.angular_velocity, R @ anchor)
    attitude = Rotation.from_matrix(turn @ R).as_quat(scalar_first=True)
    return scene.replace(
        bodies=(dataclasses.replace(body, position=origin + turn @ x, velocity=turn @ v, attitude=attitude),),
        joints=(dataclasses.replace(joint, child_anchor=anchor, parent_anchor=np.full(3, origin),
                                    parent_axis=turn @ joint.parent_axis),))


@pytest.mark.parametrize("method", ["GeneralizedAlpha", "TrapezoidalIndex2"])
@pytest.mark.parametrize("change", [lambda scene: scene, elsewhere])
def test_exudyn_rolls_disks_at_its_order(change, method):
    scene = change(crosscheck.load_scene("wobbling_disk")).replace(duration=0.5, samples=6)
    truth = Maximal(scene).run()
    errors = []
    for step in STEPS:
        run = crosscheck.run(scene, engine="exudyn", method=method, step=step)
        errors.append([np.abs(getattr(run, key) - getattr(truth, key)).max() for key in ("x", "R", "v", "w")])
    orders = np.log2(np.divide(*errors))
    assert np.abs(orders[:2] - 2).max() < 0.1
    assert orders.min() > 1.9  # velocities may gain more, as two terms share the error
    assert run.constraint_velocity.max() < 1e-12  # of some 5 m/s
    assert run.constraint_position.max() > 1e-9  # Exudyn takes its rows at velocity level, the height's too


@pytest.mark.parametrize(("engine", "method"), [
    ("mujoco", "RK4"), ("pinocchio", "RK4"), ("exudyn", "GeneralizedAlpha"), ("exudyn", "RK44")])
@pytest.mark.parametrize("name", ["chaplygin_sleigh", "wobbling_disk", "rolling_ball"])
def test_who_cannot_says_why(engine, method, name):
    scene = crosscheck.load_scene(name)
    reason = adapters.get(engine).unsupported(scene, RunSpec(method, step=1e-3))
    if (engine, method, name) == ("exudyn", "GeneralizedAlpha", "wobbling_disk"):
        assert reason is None
    elif engine == "exudyn":
        assert "disks" in reason
    else:
        assert "velocities alone" in reason
