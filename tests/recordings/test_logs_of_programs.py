"""Logs with inputs in the formats of other programs: each is made here, by hand or by the format's own library, from
the same motion, and the same columns have to come out of it."""

from __future__ import annotations

import json
import sys

import numpy as np
import pytest

import crosscheck
from crosscheck.errors import ArgumentError
from crosscheck.recordings.reading import read

pytest.importorskip("mujoco")
pytest.importorskip("pandas")

JOINTS = ("shoulder", "elbow")
EPOCH = 1_700_000_000
T = 0.005 * np.arange(60)
Q, V, TAU = (np.stack([np.sin(w * T + k) for w in (2.0, 3.0)], axis=1) for k in (0.0, 0.4, 0.9))

MODEL = """<mujoco><worldbody><body><joint name="shoulder" axis="0 1 0"/><geom size=".1"/>
<body pos="0 0 -.3"><joint name="elbow" axis="0 1 0"/><geom size=".1"/></body></body></worldbody>
<actuator><motor name="M1" joint="shoulder" gear="20"/><motor name="drive_two" joint="elbow" gear="-5"/></actuator>
</mujoco>"""


@pytest.fixture(scope="module")
def scene(tmp_path_factory):
    path = tmp_path_factory.mktemp("models") / "arm.xml"
    path.write_text(MODEL)
    return crosscheck.import_model(path)


def plotjuggler(folder):
    """PlotJuggler writes a column a curve, and leaves cells of topics that have no value at a time empty."""
    names = [f"/joint_states/{joint}/{word}" for word in ("position", "velocity", "effort") for joint in JOINTS]
    lines = [",".join(["__time", *names])]
    for t, *row in np.column_stack([T, Q, V, TAU]):
        lines.append(",".join([f"{EPOCH + t:.6f}", *map(repr, map(float, row))]))
    (folder / "plot.csv").write_text("\n".join(lines) + "\n")
    return folder / "plot.csv"


def echoed(folder):
    """`ros2 topic echo --csv /joint_states` prints no header: stamp, frame, names, positions, rates, efforts."""
    rows = [",".join([str(EPOCH + int(t)), str(round(t % 1 * 1e9)), "", *JOINTS, *map(repr, map(float, row))])
            for t, *row in np.column_stack([T, Q, V, TAU])]
    (folder / "echo.csv").write_text("\n".join(rows) + "\n")
    return folder / "echo.csv"


def bag_table(folder):
    """A bag as a data frame: the stamp in two columns."""
    names = [f"{joint}_{word}" for word in ("pos", "vel", "torque") for joint in JOINTS]
    rows = [",".join([str(EPOCH + int(t)), str(round(t % 1 * 1e9)), *map(repr, map(float, row))])
            for t, *row in np.column_stack([T, Q, V, TAU])]
    (folder / "bag.csv").write_text("\n".join([",".join(["header.stamp.sec", "header.stamp.nanosec", *names]), *rows]))
    return folder / "bag.csv"


def isaac_lab(folder):
    """Isaac Lab's arrays have a dimension of environments, names of the joints in its own order, and a rate."""
    turn = [1, 0]
    np.savez(folder / "isaac.npz", joint_names=np.array(JOINTS)[turn], fps=np.array([200]),
             joint_pos=Q[:, None, turn], joint_vel=V[:, None, turn], applied_torque=TAU[:, None, turn],
             computed_torque=TAU[:, None, turn])
    return folder / "isaac.npz"


def motion_file(folder):
    """Its motion files call them degrees of freedom."""
    np.savez(folder / "motion.npz", dof_names=np.array(JOINTS), fps=200, dof_positions=Q, dof_velocities=V,
             dof_torques=TAU)
    return folder / "motion.npz"


def of_mujoco(folder):
    """MuJoCo's own arrays: controls are those of the actuators, in their order, before gain and gear."""
    np.savez(folder / "mujoco.npz", time=T, qpos=Q, qvel=V, ctrl=TAU / [20.0, -5.0], qfrc_bias=7 * TAU)
    return folder / "mujoco.npz"


def opensim(folder):
    """States with the moments of Inverse Dynamics, in radians."""
    names = [f"{joint}_{word}" for word in ("value", "speed", "moment") for joint in JOINTS]
    rows = ["\t".join(map(repr, map(float, row))) for row in np.column_stack([T, Q, V, TAU])]
    (folder / "id.sto").write_text("\n".join(["Inverse", "version=1", "inDegrees=no", "endheader",
                                              "\t".join(["time", *names]), *rows]))
    return folder / "id.sto"


def simulink(folder):
    """To Workspace as a structure with time, of a single output."""
    from scipy.io import savemat

    signals = [{"values": values, "label": label, "dimensions": 2.0} for values, label in (
        (Q, "q"), (V, "qd"), (TAU, "tau"))]
    savemat(folder / "out.mat", {"out": {"logged": {"time": T, "signals": signals}, "SimulationMetadata": "model"}})
    return folder / "out.mat"


JOINT_STATE = """std_msgs/Header header
string[] name
float64[] position
float64[] velocity
float64[] effort
================================================================================
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
================================================================================
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec
"""


def mcap(folder):
    """A bag of ROS 2, written by the library of the format."""
    pytest.importorskip("mcap")
    from mcap_ros2.writer import Writer

    with open(folder / "bag.mcap", "wb") as stream:
        writer = Writer(stream)
        schema = writer.register_msgdef("sensor_msgs/msg/JointState", JOINT_STATE)
        for t, q, v, tau in zip(T, Q, V, TAU, strict=True):
            stamp = {"sec": EPOCH + int(t), "nanosec": round(t % 1 * 1e9)}
            writer.write_message("/joint_states", schema, {
                "header": {"stamp": stamp, "frame_id": ""}, "name": list(JOINTS), "position": q.tolist(),
                "velocity": v.tolist(), "effort": tau.tolist()}, log_time=round((EPOCH + t + 0.01) * 1e9))
        writer.finish()
    return folder / "bag.mcap"


def mcap_of_json(folder):
    """The same format with messages in JSON."""
    pytest.importorskip("mcap")
    from mcap.writer import Writer

    with open(folder / "json.mcap", "wb") as stream:
        writer = Writer(stream)
        writer.start()
        schema = writer.register_schema("robot", "jsonschema", b"{}")
        channel = writer.register_channel("state", "json", schema)
        for t, q, v, tau in zip(T, Q, V, TAU, strict=True):
            message = {f"{joint}_{word}": value for word, values in (("pos", q), ("vel", v), ("torque", tau))
                       for joint, value in zip(JOINTS, values.tolist(), strict=True)}
            at = round((EPOCH + t) * 1e9)
            writer.add_message(channel, at, json.dumps(message).encode(), at)
        writer.finish()
    return folder / "json.mcap"


@pytest.mark.parametrize("make", [plotjuggler, echoed, bag_table, isaac_lab, motion_file, of_mujoco, opensim, simulink,
                                  mcap, mcap_of_json])
def test_the_same_motion_comes_out(scene, make, tmp_path):
    recording = read(make(tmp_path), scene)
    assert np.allclose(recording.t, T, atol=1e-6)
    groups = {(g.key, g.owner): g.values[:, 0] for g in recording.groups}
    given = {g.owner: g.values[:, 0] for g in recording.inputs if not (
        make is isaac_lab and g.key == "effort_commanded")}
    for k, joint in enumerate(JOINTS):
        assert np.allclose(groups["joint_position", joint], Q[:, k])
        assert np.allclose(groups["joint_velocity", joint], V[:, k])
        factor = (20.0, -5.0)[k] if make is of_mujoco else 1.0
        row = next(g.row for g in recording.inputs if g.owner == joint)
        assert row.scale == factor
        assert np.allclose(given[joint], TAU[:, k])
    assert len(recording.groups) == 4


@pytest.mark.parametrize("columns", [("M1", "drive_two"), ("ctrl_M1", "drive_two_cmd"), ("u1", "u2"),
                                     ("M1 torque", "drive two effort")])
def test_motors_by_their_names(scene, columns):
    recording = read({"t": T, "q1": Q[:, 0], "q2": Q[:, 1], **{
        name: TAU[:, k] / (20.0, -5.0)[k] for k, name in enumerate(columns)}}, scene)
    assert recording.suggested[columns[0]] == "shoulder.effort_commanded times 20"
    assert recording.suggested[columns[1]] == "elbow.effort_commanded times -5"
    assert all(np.allclose(g.values[:, 0], TAU[:, JOINTS.index(g.owner)]) for g in recording.inputs)


def test_motors_of_transmissions(tmp_path):
    (tmp_path / "arm.urdf").write_text("""<robot name="arm"><link name="base"/><link name="rod"><inertial>
<origin xyz="0 0 -.2"/><mass value="1"/><inertia ixx=".01" iyy=".01" izz=".01" ixy="0" ixz="0" iyz="0"/></inertial>
</link><joint name="hip" type="continuous"><parent link="base"/><child link="rod"/><axis xyz="0 1 0"/></joint>
<transmission name="t"><type>simple</type><joint name="hip"/><actuator name="hip_motor">
<mechanicalReduction>50</mechanicalReduction></actuator></transmission></robot>""")
    scene = crosscheck.import_model(tmp_path / "arm.urdf")
    assert scene.motors == (("hip_motor", "hip", "effort", 50.0),)
    recording = read({"t": T, "hip_pos": Q[:, 0], "hip_motor_torque": TAU[:, 0]}, scene)
    assert recording.suggested["hip_motor_torque"] == "hip.effort_commanded times 50"


@pytest.mark.parametrize(("arrays", "says"), [
    ({"joint_names": np.array(JOINTS), "joint_pos": np.zeros((9, 4, 2))}, "'joint_pos' holds 4 environments"),
    ({"fps": np.array(0), "q1": T, "q2": T}, "'fps' is 0"), ({"version": np.array(3), "q1": T}, "single number")])
def test_arrays_that_are_none(scene, arrays, says, tmp_path):
    np.savez(tmp_path / "bad.npz", **arrays)
    with pytest.raises(ArgumentError, match=says):
        read(tmp_path / "bad.npz", scene)


@pytest.mark.parametrize("name", ["log.mat", "log.mcap", "log.npz", "log.parquet"])
def test_a_file_that_is_no_such_file(scene, name, tmp_path):
    (tmp_path / name).write_bytes(b"t,q\n0,1\n" * 40)
    with pytest.raises(ArgumentError, match=name) as caught:
        read(tmp_path / name, scene)
    assert "\n" not in str(caught.value)


def test_a_missing_library_names_its_extra(scene, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "mcap.reader", None)
    (tmp_path / "log.mcap").write_bytes(b"x")
    with pytest.raises(ArgumentError, match=r"mcap is not installed; pip install 'lieeuler-crosscheck\[mcap\]'"):
        read(tmp_path / "log.mcap", scene)
