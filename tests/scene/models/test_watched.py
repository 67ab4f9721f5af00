"""Sites and sensors of MJCF files, which MuJoCo reads alike, and those of a URDF for Gazebo."""

from __future__ import annotations

import numpy as np
import pytest

import crosscheck
from crosscheck.scene.sensors import readings
from crosscheck.scene.states import States
from tests import saved

ARM = """<mujoco model="arm"><compiler angle="radian"/><option gravity="0 0 -9.81"><flag contact="disable"/></option>
<worldbody><site name="post" pos="1 2 3"/>
<body name="upper"><joint name="shoulder" axis="0 1 0" damping=".2"/>
<inertial pos="0.1 0 -.2" mass="2" diaginertia=".1 .2 .15"/>
<body name="lower" pos="0 0 -.5"><joint name="elbow" type="ball"/>
<inertial pos="0 0 -.2" mass="1" fullinertia=".1 .12 .09 .01 0 .02"/>
<site name="imu" pos=".1 .2 -.3" quat=".8 .1 -.4 .3"/></body></body></worldbody>
<sensor><accelerometer name="a" site="imu"/><gyro name="g" site="imu"/><velocimeter name="u" site="imu"/>
<force name="f" site="imu"/><torque name="t" site="imu"/><jointpos name="q" joint="shoulder"/>
<jointvel name="v" joint="shoulder"/><ballangvel name="w" joint="elbow"/><ballquat name="b" joint="elbow"/>
<framepos name="p" objtype="site" objname="imu"/><framequat name="o" objtype="site" objname="imu"/>
<framelinvel name="lv" objtype="body" objname="lower"/><frameangvel name="av" objtype="xbody" objname="upper"/>
<framelinacc name="la" objtype="site" objname="imu"/><frameangacc name="aa" objtype="site" objname="imu"/>
<rangefinder name="far" site="imu"/><jointpos name="capped" joint="shoulder" cutoff="1"/></sensor></mujoco>"""


def test_an_imported_scene_reads_what_mujoco_reads(tmp_path):
    import mujoco

    path, model = tmp_path / "arm.xml", mujoco.MjModel.from_xml_string(ARM)
    path.write_text(ARM)
    rng = np.random.default_rng(1)
    qpos, qvel = np.array([0.7, *rng.normal(size=4)]), rng.normal(size=4)
    qpos[1:] /= np.linalg.norm(qpos[1:])
    scene = crosscheck.import_model(path, qpos=qpos, qvel=qvel)
    assert [site.name for site in scene.sites[:2]] == ["post", "imu"]
    assert set(scene.left_out) == {("far", "sensor", "rangefinder"), ("capped", "sensor", "jointpos")}
    data = mujoco.MjData(model)
    data.qpos[:], data.qvel[:] = qpos, qvel
    mujoco.mj_forward(model, data)
    read = readings(scene, States(np.zeros(1), scene.x0[None], scene.R0[None], scene.v0[None], scene.w0[None]))
    assert set(read) == {model.sensor(k).name for k in range(model.nsensor)} - {"far", "capped"}
    for name, values in read.items():
        theirs, ours = data.sensor(name).data, np.atleast_1d(values[0])
        if len(ours) == 4:
            theirs = theirs * np.sign(theirs @ ours)
        np.testing.assert_allclose(ours, theirs, atol=1e-10 * max(1.0, np.abs(theirs).max()), err_msg=name)


@pytest.mark.parametrize(("line", "said"), [
    ("<force name='x' site='post'/>", "force"), ("<subtreecom name='x' body='upper'/>", "subtreecom"),
    ("<framepos name='x' objtype='site' objname='imu' reftype='site' refname='post'/>", "framepos")])
def test_sensors_without_a_counterpart_are_left_out_by_name(line, said, tmp_path):
    path = saved(tmp_path / "arm.xml", ARM.replace("<sensor>", f"<sensor>{line}"))
    assert ("x", "sensor", said) in crosscheck.import_model(path).left_out


URDF = """<robot name="arm"><link name="base"/>
<link name="upper"><inertial><origin xyz="0.1 0 -.2" rpy="0 0 .3"/><mass value="2"/>
<inertia ixx=".1" iyy=".2" izz=".15" ixy="0" ixz="0" iyz="0"/></inertial></link>
<link name="tool"><inertial><mass value=".5"/>
<inertia ixx=".01" iyy=".01" izz=".01" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="shoulder" type="continuous"><parent link="base"/><child link="upper"/><origin xyz="0 0 1" rpy=".2 0 0"/>
<axis xyz="0 1 0"/></joint>
<joint name="grip" type="fixed"><parent link="upper"/><child link="tool"/><origin xyz="0 .1 -.4" rpy="0 .5 0"/></joint>
<gazebo reference="tool"><sensor name="imu" type="imu"><pose>.01 .02 .03 .1 .2 .3</pose>
<imu><initial_orientation_as_reference>false</initial_orientation_as_reference></imu></sensor></gazebo>
<gazebo reference="upper"><sensor name="still" type="imu"/>
<sensor name="eye" type="camera"><pose>0 0 0 0 0 0</pose></sensor></gazebo>
<gazebo reference="shoulder"><sensor name="wrist" type="force_torque"><force_torque><frame>child</frame>
<measure_direction>parent_to_child</measure_direction></force_torque></sensor>
<sensor name="other" type="force_torque"/></gazebo>
<gazebo reference="grip"><sensor name="held" type="force_torque"/></gazebo></robot>"""


def test_gazebo_blocks_of_a_urdf(tmp_path):
    from scipy.spatial.transform import Rotation

    path = saved(tmp_path / "arm.urdf", URDF)
    scene = crosscheck.import_model(path, qpos=[0.7], qvel=[2.0])
    assert [site.name for site in scene.sites] == ["base", "upper", "tool", "imu", "still"]
    assert {sensor.name: (sensor.type, sensor.site, sensor.joint) for sensor in scene.sensors} == {
        "imu accelerometer": ("accelerometer", "imu", None), "imu gyroscope": ("gyroscope", "imu", None),
        "imu attitude": ("attitude", "imu", None), "still accelerometer": ("accelerometer", "still", None),
        "still gyroscope": ("gyroscope", "still", None), "wrist force": ("force", "upper", "shoulder"),
        "wrist torque": ("torque", "upper", "shoulder"), "other force": ("force", "upper", "shoulder"),
        "other torque": ("torque", "upper", "shoulder")}
    assert set(scene.left_out) == {
        ("eye", "sensor", "camera"), ("held", "sensor", "force_torque"),
        ("still", "orientation of sensor", "which counts from the start"),
        ("other", "sign of sensor", "which reads the wrench on the parent: here it is that on the child")}
    read = readings(scene, States(np.zeros(1), scene.x0[None], scene.R0[None], scene.v0[None], scene.w0[None]))
    upper = Rotation.from_euler("x", 0.2) * Rotation.from_rotvec([0.0, 0.7, 0.0])
    tool = upper * Rotation.from_euler("y", 0.5)
    turned = (tool * Rotation.from_euler("xyz", [0.1, 0.2, 0.3])).as_quat(scalar_first=True)
    np.testing.assert_allclose(read["imu attitude"][0] * np.sign(turned @ read["imu attitude"][0]), turned, atol=1e-12)
    place = np.array([0.0, 0.0, 1.0]) + upper.apply([0.0, 0.1, -0.4]) + tool.apply([0.01, 0.02, 0.03])
    imu = next(site for site in scene.sites if site.name == "imu")
    np.testing.assert_allclose(scene.x0[0] + scene.R0[0] @ imu.position, place, atol=1e-12)
    spin = (tool * Rotation.from_euler("xyz", [0.1, 0.2, 0.3])).inv().apply(upper.apply([0.0, 2.0, 0.0]))
    np.testing.assert_allclose(read["imu gyroscope"][0], spin, atol=1e-12)


@pytest.mark.parametrize(("pose", "said"), [
    ("0 0 1", "its pose has 3 numbers, not six"), ("0 0 0 0 0 up", "'up' is not")])
def test_a_wrong_pose_is_named(pose, said, tmp_path):
    path = saved(tmp_path / "arm.urdf", URDF.replace(".01 .02 .03 .1 .2 .3", pose))
    with pytest.raises(crosscheck.SceneError, match=said):
        crosscheck.import_model(path)


def test_a_urdf_without_sensors_has_no_sites(tmp_path):
    path = saved(tmp_path / "arm.urdf", URDF.replace("<sensor", "<plugin").replace("</sensor>", "</plugin>"))
    assert not crosscheck.import_model(path).sites
