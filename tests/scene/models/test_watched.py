"""Sites and sensors of MJCF files: the imported scene reads what MuJoCo reads."""

from __future__ import annotations

import numpy as np
import pytest

import crosscheck
from crosscheck.scene.sensors import readings
from crosscheck.scene.states import States

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
    assert set(scene.left_out) == {"sensor 'far' (rangefinder)", "sensor 'capped' (jointpos)"}
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
    path = tmp_path / "arm.xml"
    path.write_text(ARM.replace("<sensor>", f"<sensor>{line}"))
    assert f"sensor 'x' ({said})" in crosscheck.import_model(path).left_out
