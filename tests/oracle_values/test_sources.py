"""What sources make of starts and sums, and the readings of an engine itself, against values by hand."""

from __future__ import annotations

import json

import numpy as np
import pytest

import crosscheck
from tests.oracle_values.cases import close, content, loaded, scene
from tests.oracle_values.mechanics import Mechanism

RECORDER = """
import json, pathlib
import numpy as np
from crosscheck.scene.states import States

class Recorder:
    name, methods = "recorder", ("rest",)

    def unsupported(self, scene, spec):
        return None

    def run(self, scene, spec):
        with pathlib.Path({path!r}).open("a") as file:
            rows = [np.asarray(part).tolist() for part in (scene.x0, scene.R0, scene.v0, scene.w0)]
            file.write(json.dumps(rows) + "\\n")
        T = len(scene.t)
        return States(scene.t, *(np.repeat(np.asarray(part)[None], T, axis=0)
                                 for part in (scene.x0, scene.R0, scene.v0, scene.w0)))
"""


def rates(mech, R, w):
    """Rates of hinges and crosses from attitudes and angular velocities of bodies."""
    R, w = np.concatenate([R, np.eye(3)[None]]), np.concatenate([np.einsum("nij,nj->ni", R, w), np.zeros((1, 3))])
    out = {}
    for link in mech.links:
        ends = R[link.parent], R[link.child]
        lines = [ends[0] @ link.axis] if link.kind == "revolute" else [ends[0] @ link.axis, ends[1] @ link.second]
        out[link.name] = np.linalg.lstsq(np.array(lines).T, w[link.child] - w[link.parent], rcond=None)[0]
    return out


@pytest.mark.parametrize("name", ["whirling_cross", "base_last"])
def test_members_with_other_positions_keep_their_rates(tmp_path, name):
    path, log = tmp_path / "recorder.py", tmp_path / "starts.jsonl"
    path.write_text(RECORDER.format(path=str(log)))
    (tmp_path / "scene.json").write_text(json.dumps(content(name)))
    crosscheck.sweep({"scenes": [str(tmp_path / "scene.json")], "engines": {f"{path}:Recorder": ["rest"]},
                      "steps": [0.1], "samples": 2, "duration": 0.1,
                      "perturb": {"joint_position": 0.05, "count": 2, "seed": 1}}, workers=1)
    mech = Mechanism(content(name))
    given = scene(name)
    wanted = rates(mech, given.R0, given.w0)
    starts = [[np.array(part) for part in json.loads(line)] for line in log.read_text().splitlines()]
    assert len(starts) == 2
    for _, R, _, w in starts:
        assert np.abs(R - given.R0).max() > 1e-3
        for joint, rate in rates(mech, R, w).items():
            close(rate, wanted[joint], joint)


@pytest.mark.parametrize("name", ["held_torque", "wound_wheel", "pushed_slide"])
def test_energy_error_of_a_sweep_is_that_of_the_run(tmp_path, name):
    """Energy less the work of dampers and loads; against the energy of a motion that is right to 1e-11."""
    path = tmp_path / "scene.json"
    path.write_text(json.dumps(content(name)))
    frame = crosscheck.sweep({"scenes": [str(path)], "engines": {"lieeuler": ["rkmk853"]}, "rtols": [1e-11]}, workers=1)
    assert frame["energy_error"][0] < 1e-7, frame["energy_error"][0]


PLAIN = """
<mujoco><option gravity="0 0 -9.81" timestep="1e-3" integrator="RK4"><flag contact="disable"/></option>
<worldbody><body name="arm" pos="0 0 0">
  <joint name="pin" type="hinge" axis="0 1 0" damping="0.1" armature="0.2"/>
  <inertial pos="0 0 -0.4" mass="1.2" diaginertia="0.1 0.12 0.05"/>
  <body name="cart" pos="0 0 -0.6">
    <joint name="rail" type="slide" axis="1 0 0" stiffness="40" springref="0.1" damping="0.6"/>
    <inertial pos="0.05 0 -0.1" mass="0.7" diaginertia="0.02 0.03 0.025"/>
    <site name="cell" pos="0 0 0"/></body></body></worldbody>
<actuator><motor name="drive" joint="pin" ctrlrange="-9 9" ctrllimited="true"/></actuator>
<sensor><jointpos joint="pin"/><jointpos joint="rail"/><actuatorfrc actuator="drive"/>
  <force site="cell"/><torque site="cell"/></sensor>
</mujoco>
"""


READ = [{"name": "pin", "type": "joint_position", "joint": "pin"},
        {"name": "rail", "type": "joint_position", "joint": "rail"},
        {"name": "drive", "type": "joint_effort", "joint": "pin"},
        {"name": "force", "type": "force", "joint": "rail", "site": "cell"},
        {"name": "torque", "type": "torque", "joint": "rail", "site": "cell"}]
"""What MuJoCo's sensors of both arms read, in their order."""


def plain(q, rate, torque):
    """The arm of PLAIN as a scene, by hand."""
    y, x = [0.0, 1.0, 0.0], [1.0, 0.0, 0.0]
    return {"schema": 3, "name": "plain", "gravity": [0.0, 0.0, -9.81], "duration": 0.01, "samples": 2, "bodies": [
        {"name": "arm", "mass": 1.2, "inertia": np.diag([0.1, 0.12, 0.05]).tolist()},
        {"name": "cart", "mass": 0.7, "inertia": np.diag([0.02, 0.03, 0.025]).tolist()}], "joints": [
        {"name": "pin", "type": "revolute", "parent": "ground", "child": "arm", "parent_anchor": [0.0, 0.0, 0.0],
         "child_anchor": [0.0, 0.0, 0.4], "parent_axis": y, "child_axis": y, "position": q[0], "velocity": rate[0],
         "damping": 0.1, "armature": 0.2},
        {"name": "rail", "type": "prismatic", "parent": "arm", "child": "cart", "parent_anchor": [0.0, 0.0, -0.2],
         "child_anchor": [-0.05, 0.0, 0.1], "parent_axis": x, "child_axis": x, "position": q[1], "velocity": rate[1],
         "stiffness": 40.0, "rest_position": 0.1, "damping": 0.6}],
        "forces": [{"type": "joint_torque", "joint": "pin", "torque": torque}],
        "sites": [{"name": "cell", "body": "cart", "position": [-0.05, 0.0, 0.1]}],
        "sensors": READ}


SERVED = """
<mujoco><option gravity="0 0 -9.81" timestep="1e-3" integrator="RK4"><flag contact="disable"/></option>
<worldbody><body name="arm" pos="0 0 0">
  <joint name="pin" type="hinge" axis="0 0 1" stiffness="3" springref="20" armature="0.05"/>
  <inertial pos="0.3 0 0" mass="1.5" diaginertia="0.03 0.1 0.11"/>
  <body name="hand" pos="0.6 0 0">
    <joint name="rail" type="hinge" axis="1 0 0" damping="0.2"/>
    <inertial pos="0 0.1 -0.25" mass="0.6" diaginertia="0.02 0.015 0.01"/>
    <site name="cell" pos="0 0 0"/></body></body></worldbody>
<actuator><position name="drive" joint="pin" kp="30" kv="2"/></actuator>
<sensor><jointpos joint="pin"/><jointpos joint="rail"/><actuatorfrc actuator="drive"/>
  <force site="cell"/><torque site="cell"/></sensor>
</mujoco>
"""


def served(q, rate, target):
    """The arm of SERVED as a scene, by hand: two crossed hinges, a spring of one, and a servo that holds it."""
    z, x = [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]
    return {"schema": 3, "name": "served", "gravity": [0.0, 0.0, -9.81], "duration": 0.01, "samples": 2, "bodies": [
        {"name": "arm", "mass": 1.5, "inertia": np.diag([0.03, 0.1, 0.11]).tolist()},
        {"name": "hand", "mass": 0.6, "inertia": np.diag([0.02, 0.015, 0.01]).tolist()}], "joints": [
        {"name": "pin", "type": "revolute", "parent": "ground", "child": "arm", "parent_anchor": [0.0, 0.0, 0.0],
         "child_anchor": [-0.3, 0.0, 0.0], "parent_axis": z, "child_axis": z, "position": q[0], "velocity": rate[0],
         "stiffness": 3.0, "rest_position": float(np.deg2rad(20)), "armature": 0.05},
        {"name": "rail", "type": "revolute", "parent": "arm", "child": "hand", "parent_anchor": [0.3, 0.0, 0.0],
         "child_anchor": [0.0, -0.1, 0.25], "parent_axis": x, "child_axis": x, "position": q[1], "velocity": rate[1],
         "damping": 0.2}],
        "forces": [{"type": "servo", "joint": "pin", "proportional": 30.0, "derivative": 2.0, "target": target}],
        "sites": [{"name": "cell", "body": "hand", "position": [0.0, -0.1, 0.25]}],
        "sensors": READ}


@pytest.mark.parametrize(("q", "rate", "control"), [
    ((4.7, 0.25), (2.0, -0.8), 1.5), ((0.3, -0.1), (-5.0, 0.4), -3.0), ((-17.2, 0.6), (0.0, 2.5), 0.0),
    ((31.0, -0.4), (12.0, 1.0), 6.0)])
@pytest.mark.parametrize(("text", "scene"), [(PLAIN, plain), (SERVED, served)], ids=["slide", "servo"])
def test_sensors_of_mujoco_itself(text, scene, q, rate, control):
    """MuJoCo reads itself at the state where it starts, also many turns on: jointpos, actuatorfrc, force, torque."""
    mujoco = pytest.importorskip("mujoco")
    model = mujoco.MjModel.from_xml_string(text)
    state = mujoco.MjData(model)
    state.qpos[:], state.qvel[:], state.ctrl[:] = q, rate, control
    mujoco.mj_forward(model, state)
    run = crosscheck.run(loaded(scene(q, rate, control)), engine="lieeuler", method="rkmk853", rtol=1e-11)
    ours = np.concatenate([np.atleast_1d(run.sensors[key][0]) for key in ("pin", "rail", "drive", "force", "torque")])
    close(ours, state.sensordata, "pin, rail, drive, force, torque")
