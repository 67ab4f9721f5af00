"""Inverse dynamics: all sources, and forward dynamics as its inverse."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from typer.testing import CliRunner

import crosscheck
from crosscheck.cli.app import app
from crosscheck.jointspace.motion import placed
from tests.jointspace.arms import arm
from tests.jointspace.test_derivatives import accelerations

SCENES = {"seven hinges": lambda: arm(7, armature=0.2, stiffness=1.0, seed=3), "arm": arm,
          **{name: (lambda name=name: crosscheck.load_scene(name)) for name in (
              "double_pendulum", "universal_pendulum", "cylindrical_pendulum", "branching_tree", "planar_slider")}}


@pytest.mark.parametrize("name", SCENES)
def test_all_sources_agree_and_forward_dynamics_gives_the_motion_back(name):
    scene = SCENES[name]()
    n = len(scene.coordinates)
    q, v, a = np.random.default_rng(5).normal(size=(3, 3, n))
    exact = crosscheck.inverse_dynamics(scene, q, v, a)
    assert exact.shape == (3, n)
    np.testing.assert_array_equal(crosscheck.inverse_dynamics(scene, q[1], v[1], a[1]), exact[1])
    for engine in ("pinocchio", "mujoco"):
        np.testing.assert_allclose(crosscheck.inverse_dynamics(scene, q, v, a, engine=engine), exact, rtol=0,
                                   atol=1e-10 * max(1.0, np.abs(exact).max()))
    if all(joint.type == "revolute" for joint in scene.joints):  # the torques, given, have the accelerations
        motors = [next(force for force in arm().forces if force.type == "joint_torque")] * n
        springs = tuple(force for force in scene.forces if not force.type.startswith("joint_"))
        given = placed(scene.replace(forces=springs + tuple(
            dataclasses.replace(motor, joint=joint.name, parameters={"torque": float(torque)})
            for motor, joint, torque in zip(motors, scene.joints, exact[0], strict=True))), q[0], v[0])
        np.testing.assert_allclose(accelerations(given), a[0], atol=1e-10)


def test_dry_friction_is_to_be_overcome():
    rough = arm()
    rough = rough.replace(joints=tuple(dataclasses.replace(joint, dry_friction=crosscheck_friction(0.5 + k))
                                       for k, joint in enumerate(rough.joints)))
    motion = [0.2, 0.1], [1.0, -2.0], [0.3, 0.4]
    for engine in ("truth", "pinocchio", "mujoco"):
        more = crosscheck.inverse_dynamics(rough, *motion, engine=engine)
        np.testing.assert_allclose(more - crosscheck.inverse_dynamics(arm(), *motion, engine=engine), [0.5, -1.5],
                                   atol=1e-12)


def crosscheck_friction(size):
    from crosscheck.scene.laws import DryFriction

    return (DryFriction(size, size),)


@pytest.mark.parametrize(("call", "kind", "said"), [
    (lambda: crosscheck.inverse_dynamics("four_bar", [0.0] * 4, [0.0] * 4, [0.0] * 4), crosscheck.Unsupported,
     "closes a loop"),
    (lambda: crosscheck.inverse_dynamics(arm(), [0.0], [0.0], [0.0]), crosscheck.ArgumentError, "j0, j1"),
    (lambda: crosscheck.inverse_dynamics(arm(), [0.0] * 2, [0.0] * 2, ["a", "b"]), crosscheck.ArgumentError, "finite"),
    (lambda: crosscheck.inverse_dynamics(arm(), [0.0] * 2, [0.0] * 2, [0.0] * 2, engine="exudyn"),
     crosscheck.ArgumentError, "truth"),
    (lambda: crosscheck.inverse_dynamics("coupled_arm", *np.zeros((3, 4))), crosscheck.Unsupported, "is not free"),
])
def test_what_cannot_be_asked(call, kind, said):
    with pytest.raises(kind, match=said):
        call()


@pytest.mark.parametrize(("scene", "code", "said"), [
    ("geared_arm", 0, ["shoulder: truth 14.8976389235, pinocchio 14.8976389235, mujoco 14.8976389235",
                       "the start and 3 random states, with accelerations: sources differ from truth by at most"]),
    ("model.urdf", 0, ["shoulder: truth -1.962, pinocchio -1.962, mujoco -1.962"]),
    ("four_bar", 2, ["closes a loop; then drives give the same motion by several sets of forces"]),
    ("driven_slider_crank", 2, ["is driven; then drives"]),
])
def test_torques_of_the_command_line(scene, code, said, tmp_path, monkeypatch):
    (tmp_path / "model.urdf").write_text(
        '<robot name="arm"><link name="base"/><link name="upper"><inertial><origin xyz="0.1 0 -.2"/><mass value="2"/>'
        '<inertia ixx=".1" iyy=".2" izz=".15" ixy="0" ixz="0" iyz="0"/></inertial></link>'
        '<joint name="shoulder" type="continuous"><parent link="base"/><child link="upper"/><axis xyz="0 1 0"/></joint>'
        "</robot>")
    monkeypatch.chdir(tmp_path)
    result = CliRunner().invoke(app, ["inspect", scene, "--torques"])
    assert result.exit_code == code or (code == 2 and isinstance(result.exception, crosscheck.Unsupported))
    told = " ".join((result.output + str(result.exception or "")).split())
    assert all(" ".join(each.split()) in told for each in said)
