"""Models of others as scenes: they move as in MuJoCo, and anything without a place is refused by name."""

import operator
import os

import numpy as np
import pytest

import crosscheck
from crosscheck.scene.coordinates import at_start
from tests.scene.models.model_files import ARM_MJCF, ARM_URDF, ZOO


def written(tmp_path, text, name="model.xml"):
    path = tmp_path / name
    path.write_text(text)
    return path


def native(path, scene, qpos, qvel, h=1e-4):
    """Attitudes (T, n, 3, 3) and centres of mass (T, n, 3) of a rollout of the file in MuJoCo itself."""
    import mujoco

    model = mujoco.MjModel.from_xml_path(str(path))
    model.opt.integrator, model.opt.timestep = mujoco.mjtIntegrator.mjINT_RK4, h
    data = mujoco.MjData(model)
    data.qpos[:], data.qvel[:] = qpos, qvel
    R = np.empty((scene.samples, scene.n, 3, 3))
    for sample in range(scene.samples):
        mujoco.mj_kinematics(model, data)
        for k, body in enumerate(scene.bodies):
            R[sample, k] = data.body(body.name).xmat.reshape(3, 3)
        mujoco.mj_step(model, data, nstep=round(scene.t[1] / h))
    return R


def test_the_imported_scene_moves_as_the_model_in_mujoco(tmp_path):
    import mujoco

    path = written(tmp_path, ZOO)
    model = mujoco.MjModel.from_xml_path(str(path))
    rng = np.random.default_rng(0)
    q = model.qpos0.copy()
    mujoco.mj_integratePos(model, q, 0.3 * rng.normal(size=model.nv), 1.0)
    v = 0.5 * rng.normal(size=model.nv)
    scene = crosscheck.import_model(path, qpos=q, qvel=v, duration=1.0, samples=6)
    assert [joint.type for joint in scene.joints] == ["revolute", "prismatic", "spherical", "planar", "universal",
                                                      "cylindrical"]
    traj = crosscheck.run(scene, "lieeuler", "taylor", rtol=1e-13)
    # order 4 at 0.1 ms with rates of 10 / s: (1e-3)^4, and springs of length 16 m at rounding
    assert np.abs(traj.R - native(path, scene, q, v)).max() < 1e-11
    assert traj.joints["h"].position[0] == pytest.approx(q[0], abs=1e-14)
    assert traj.joints["s"].position[0] == pytest.approx(q[1], abs=1e-14)


SIX = ('<mujoco><worldbody><body name="b" pos="0 0 1">'
       '<joint type="slide" axis="1 0 0"/><joint type="slide" axis="0 1 0"/><joint type="slide" axis="0 0 1"/>'
       '<joint type="hinge" axis="1 0 0"/><joint type="hinge" axis="0 1 0"/><joint type="hinge" axis="0 0 1"/>'
       '<inertial pos="0.1 0 0" mass="2" diaginertia="0.1 0.2 0.15"/></body></worldbody></mujoco>')


def test_three_slides_and_three_hinges_are_a_free_body_wherever_it_starts(tmp_path):
    q, v = np.array([0.3, -0.2, 0.5, 0.4, 0.3, -0.2]), np.array([1.0, 0.5, -0.3, 2.0, -1.0, 1.5])
    path = written(tmp_path, SIX)
    scene = crosscheck.import_model(path, qpos=q, qvel=v, duration=0.5, samples=6)
    assert scene.joints == ()
    traj = crosscheck.run(scene, "lieeuler", "taylor", rtol=1e-13)
    assert np.abs(traj.R - native(path, scene, q, v)).max() < 1e-11
    apart = SIX.replace('<joint type="hinge" axis="0 0 1"/>', '<joint type="hinge" axis="0 0 1" pos="0.1 0 0"/>')
    for start in (q, np.zeros(6)):
        chain = crosscheck.import_model(written(tmp_path, apart), qpos=start)
        assert [joint.type for joint in chain.joints] == ["prismatic"] * 3 + ["revolute"] * 3


def test_the_motion_is_true(tmp_path):
    path = written(tmp_path, ZOO)
    scene = crosscheck.import_model(path, duration=0.5, samples=6)
    traj = crosscheck.run(scene, "lieeuler", "taylor", rtol=1e-13)
    assert np.abs(traj.x - crosscheck.truth(scene).states.x).max() < 1e-11


def test_urdf_and_mjcf_of_one_arm_are_one_motion(tmp_path):
    from scipy.spatial.transform import Rotation

    turn = Rotation.from_euler("xyz", [0.3, 0.2, 0.1]).as_matrix()
    J = turn @ np.array([[0.1, 0.01, 0.002], [0.01, 0.12, 0.0], [0.002, 0.0, 0.05]]) @ turn.T
    quats = [" ".join(map(repr, Rotation.from_euler("xyz", angles).as_quat(scalar_first=True).tolist()))
             for angles in ([0.2, 0.1, 0.0], [0.0, 0.0, 0.4])]
    inertia = " ".join(repr(float(J[entry])) for entry in ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2)))
    mjcf = written(tmp_path, ARM_MJCF.format(quat=quats[0], turn=quats[1], inertia=inertia))
    urdf = written(tmp_path, ARM_URDF, "arm.urdf")
    assert [monitor.joint for monitor in crosscheck.import_model(urdf).monitors] == ["reach"]
    dropped = crosscheck.import_model(urdf, drop=True, duration=1.0)
    assert (dropped.left_out, [monitor.joint for monitor in dropped.monitors]) == ((), ["reach"])
    one, other = (crosscheck.run(scene, "lieeuler", "taylor", rtol=1e-13)
                  for scene in (dropped, crosscheck.import_model(mjcf, duration=1.0)))
    assert [body.name for body in dropped.bodies] == ["upper", "lower", "finger"]
    np.testing.assert_allclose(one.x, other.x, atol=1e-12)


def test_a_free_base_falls(tmp_path):
    urdf = written(tmp_path, ARM_URDF.replace('<link name="base"/>', '<link name="base"><inertial><mass value="3"/>'
                   '<inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>'), "arm.urdf")
    scene = crosscheck.import_model(urdf, base="free", drop=True)
    assert scene.bodies[0].name == "base"
    traj = crosscheck.run(scene, "lieeuler", "taylor", rtol=1e-12)
    centre = np.einsum("n,tnk->tk", scene.masses, traj.x) / scene.masses.sum()
    np.testing.assert_allclose(centre[:, 2] - centre[0, 2], -9.81 * traj.t**2 / 2, atol=1e-11)


@pytest.mark.parametrize(("change", "words"), [
    (('<joint name="ball"', '<joint limited="true" range="0 2" name="ball"'), "limits of joint 'ball'"),
    (('<joint name="ball"', '<joint frictionloss="1" name="ball"'), "dry friction of joint 'ball'"),
    (('<motor joint="h"/>', '<intvelocity joint="h" kp="3" actrange="-1 1"/>'), "actuator of joint 'h'"),
    (('springlength="1.5"', 'springlength="1 2"'), "tendon 'rope'"),
    (('<site name="tip"', '<geom size="0.1"/><site name="tip"'), None),
    (('<body name="fly" pos="2 0 0">',
      '<geom type="plane" size="1 1 1"/><body name="fly" pos="2 0 0"><geom size="1"/>'),
     "contacts of the colliding bodies 'ground - fly'"),
    (('gravity="0.3 0 -9.81"', 'density="1.2"'), "drag of the medium"),
    (('<joint name="u2" axis="0 1 0"/>', '<joint type="ball"/><joint type="slide" axis="0 1 0"/>'),
     "ball is not the last"),
    (('<joint name="ball"', '<joint damping="1" name="ball"'), "damping of joint 'ball'")])
def test_what_a_scene_cannot_hold_is_named(change, words, tmp_path):
    assert change[0] in ZOO
    path = written(tmp_path, ZOO.replace(*change))
    if words is None:  # a shape that collides with nothing
        assert crosscheck.import_model(path).left_out == ()
        return
    with pytest.raises(crosscheck.SceneError, match=words):
        crosscheck.import_model(path)
    if "not the last" not in words:
        assert words in " ".join(map(str, crosscheck.import_model(path, drop=True).left_out))


def test_a_keyframe_brings_the_state(tmp_path):
    q = "0.7 0.1 1 0 0 0 2 0 5 1 0 0 0 0 0 0 0 0 0 0"
    path = written(tmp_path, ZOO.replace("</mujoco>", f'<keyframe><key name="up" qpos="{q}"/></keyframe></mujoco>'))
    scene = crosscheck.import_model(path, keyframe="up")
    assert scene.joints[0].start == (0.7,)
    assert scene.x0[3][2] == pytest.approx(5.0)
    with pytest.raises(crosscheck.ArgumentError, match="did you mean 'up'"):
        crosscheck.import_model(path, keyframe="upp")


def test_a_mocap_body_stays_where_the_model_or_its_keyframe_puts_it(tmp_path):
    path = written(tmp_path, '''<mujoco><worldbody><body name="hand" mocap="true" pos="0 0 2">
      <body name="rod"><joint name="wrist" axis="0 1 0"/><inertial pos="0 0 -1" mass="1" diaginertia=".1 .1 .1"/></body>
      </body></worldbody><keyframe><key name="aside" qpos="0.3" mpos="1 0 2"/></keyframe></mujoco>''')
    scene = crosscheck.import_model(path)
    assert scene.n == 1
    assert scene.left_out == ()
    np.testing.assert_allclose(scene.joints[0].parent_anchor, (0.0, 0.0, 2.0))
    aside = crosscheck.import_model(path, keyframe="aside")
    np.testing.assert_allclose(aside.joints[0].parent_anchor, (1.0, 0.0, 2.0))
    np.testing.assert_allclose(aside.x0, [[1.0 - np.sin(0.3), 0.0, 2.0 - np.cos(0.3)]], atol=1e-12)


def test_loops_are_joints(tmp_path):
    body = ('<body name="{0}" pos="{1} 0 0"><joint name="j{0}" axis="0 1 0"/><inertial pos="0.5 0 0" mass="1" '
            'diaginertia="0.1 0.1 0.1"/>{2}</body>')
    bars = body.format("a", 0, body.format("b", 1, "")) + body.format("c", 2, "")
    closed = '<connect name="closed" body1="b" body2="c" anchor="1 0 0"/>'
    geared = '<joint joint1="jc" joint2="ja" polycoef="0.1 2 0 0 0"/>'
    path = written(tmp_path, f"<mujoco><worldbody>{bars}</worldbody><equality>{closed}{geared}</equality></mujoco>")
    scene = crosscheck.import_model(path)
    assert scene.joints[-1].type == "spherical"
    assert scene.joints[2].mimic.ratio == 2.0
    assert scene.joints[2].mimic.offset == pytest.approx(0.1)


BAD = {
    "bomb.xml": '<!DOCTYPE a [<!ENTITY x "y">]><mujoco>&x;</mujoco>',
    "round.xml": '<mujoco><include file="round.xml"/></mujoco>',
    "script.urdf": '<robot xmlns:xacro="http://x"><xacro:macro/></robot>', "tag.xml": "<mujoco><nonsense/></mujoco>",
    "outside.xml": '<mujoco><include file="../../etc/passwd"/></mujoco>', "empty.xml": "", "page.xml": "<html/>",
    "mesh.xml": '<mujoco><asset><mesh name="m" file="no.stl"/></asset><worldbody><body name="b"><joint/>'
                '<geom type="mesh" mesh="m"/></body></worldbody></mujoco>',
    "deep.xml": f"<mujoco><worldbody>{'<body>' * 1000}{'</body>' * 1000}</worldbody></mujoco>",
    "many.xml": f"<mujoco><worldbody>{'<body/>' * 100001}</worldbody></mujoco>",
    "copies.xml": '<mujoco><worldbody><replicate count="1000000000"><body><joint/><geom size="1"/></body></replicate>'
                  '</worldbody></mujoco>',
    "nothing.xml": "<mujoco><include/></mujoco>", "folder.xml": '<mujoco><include file="."/></mujoco>',
    "height.xml": '<mujoco><asset><hfield name="h" file="/etc/passwd" size="1 1 1 1"/></asset></mujoco>',
    "other.xml": '<mujoco><asset><model name="m" file="../other.xml"/></asset></mujoco>',
    "flex.xml": '<mujoco><worldbody><flexcomp name="f" type="mesh" file="/etc/passwd"/></worldbody></mujoco>',
    "far.xml": '<mujoco><compiler meshdir="/etc"/><asset><mesh name="m" file="passwd"/></asset><worldbody>'
               '<body name="b"><joint/><geom type="mesh" mesh="m"/></body></worldbody></mujoco>',
    "endless.urdf": ARM_URDF.replace('<mass value="1"/>', '<mass value="inf"/>'),
    "heavy.urdf": ARM_URDF.replace('<mass value="1"/>', '<mass value="heavy"/>'),
    "reserved.xml": '<mujoco><size nkey="20000000"/></mujoco>', "long.xml": f'<mujoco model="{"a" * 10**6}"/>',
    "links.urdf": "<robot name='r'>" + "<link name='l'/>" * 1500 + "</robot>",
    "still.xml": "<mujoco/>", "arm.xacro": ARM_URDF, "cut.urdf": ARM_URDF[:300],
}
WORDS = {"bomb.xml": "document type", "round.xml": "in a circle", "script.urdf": "xacro", "tag.xml": "nonsense",
         "outside.xml": "outside its folder", "empty.xml": "not XML", "page.xml": "<html>", "mesh.xml": "no.stl",
         "deep.xml": "400 deep", "many.xml": "more than 100000 elements", "copies.xml": "more than 100000 elements",
         "nothing.xml": "names no file", "folder.xml": "is no file", "height.xml": "outside its folder",
         "other.xml": "outside its folder", "flex.xml": "the flexible body", "far.xml": "outside its folder",
         "endless.urdf": "not finite", "heavy.urdf": "not written in numbers",
         "reserved.xml": "line 1: nkey reserves room for 20000000 entries", "links.urdf": "has 1500 links",
         "long.xml": "line 1: a name has 1000000 characters",
         "still.xml": "nothing in it moves", "arm.xacro": "xacro", "cut.urdf": "not XML"}


@pytest.mark.parametrize("name", BAD)
def test_a_bad_file_is_one_clear_line_and_leaves_nothing_behind(name, tmp_path, monkeypatch):
    from typer.testing import CliRunner

    from crosscheck.cli.app import app

    monkeypatch.chdir(tmp_path)
    written(tmp_path, BAD[name], name)
    with pytest.raises(crosscheck.SceneError, match=WORDS[name]) as caught:
        crosscheck.import_model(name)
    assert "\n" not in str(caught.value)
    assert CliRunner().invoke(app, ["convert", name, "-o", "scene.toml"]).exit_code != 0
    assert [path.name for path in tmp_path.iterdir()] == [name]


ENTITIES = "".join(f'<!ENTITY e{k} "{f"&e{k - 1};" * 10}">' for k in range(1, 12))
HOSTILE = {
    "junk.xml": (np.random.default_rng(0).bytes(10 * 2**20), "not XML"), "zeros.urdf": (bytes(1000), "not XML"),
    "letters.urdf": (b"a" * 10 * 2**20, "not XML"),
    "bomb.xml": (f'<?xml version="1.0" encoding="utf-16"?><!DOCTYPE m [<!ENTITY e0 "aaaaaaaaaa">{ENTITIES}]>'
                 "<mujoco>&e11;</mujoco>".encode("utf-16"), "document type"),
    "reader.urdf": ('<?xml version="1.0" encoding="utf-16"?><!DOCTYPE r [<!ENTITY x SYSTEM "file:///etc/passwd">]>'
                    "<robot>&x;</robot>".encode("utf-16"), "document type"),
}


@pytest.mark.parametrize(("limits", "words"), [
    ({"processor": 1e-3}, "did not end within .* of processor time"), ({"memory": 2**20}, "took more memory")])
@pytest.mark.parametrize("use", [crosscheck.import_model, crosscheck.inspect])
def test_a_model_that_stalls_or_swells_is_stopped(limits, words, use, tmp_path, monkeypatch):
    from crosscheck.scene import models

    monkeypatch.setattr(models, "LIMITS", limits)
    bodies = '<body><joint/><geom size="1"/></body>' * 3000
    path = written(tmp_path, f"<mujoco><worldbody>{bodies}</worldbody></mujoco>")
    with pytest.raises(crosscheck.SceneError, match=words) as caught:
        use(path)
    assert "\n" not in str(caught.value)


def test_a_mistake_in_reading_is_not_blamed_on_the_file():
    from crosscheck.scene import models

    with pytest.raises(TypeError, match="cannot be interpreted"):
        models.apart(operator.index, "a word", "arm.xml")


@pytest.mark.parametrize("name", HOSTILE)
@pytest.mark.parametrize("use", [crosscheck.import_model, crosscheck.inspect])
def test_hostile_bytes_are_one_clear_line(name, use, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / name).write_bytes(HOSTILE[name][0])
    with pytest.raises(crosscheck.SceneError, match=HOSTILE[name][1]) as caught:
        use(name)
    assert "\n" not in str(caught.value)
    assert [path.name for path in tmp_path.iterdir()] == [name]


def test_what_is_no_file_and_what_a_link_leads_out_to_are_refused(tmp_path):
    os.mkfifo(tmp_path / "pipe.xml")
    with pytest.raises(crosscheck.SceneError, match="is no file"):
        crosscheck.import_model(tmp_path / "pipe.xml")
    inner = tmp_path / "robot"
    inner.mkdir()
    (tmp_path / "secret.xml").write_text("<mujoco/>")
    (inner / "part.xml").symlink_to(tmp_path / "secret.xml")
    path = written(inner, '<mujoco><include file="part.xml"/></mujoco>')
    with pytest.raises(crosscheck.SceneError, match="outside its folder"):
        crosscheck.import_model(path)


def test_a_mesh_outside_is_not_read_and_not_needed_beside_an_inertial(tmp_path):
    inner = tmp_path / "robot"
    inner.mkdir()
    (tmp_path / "arm.stl").write_text("no mesh")
    path = written(inner, '<mujoco><asset><mesh name="m" file="../arm.stl"/></asset><worldbody><body name="b"><joint/>'
                          '<inertial pos="0 0 1" mass="1" diaginertia="1 1 1"/><geom type="mesh" mesh="m"/></body>'
                          "</worldbody></mujoco>")
    assert crosscheck.import_model(path).n == 1
    found = crosscheck.inspect(path)
    assert "outside its folder" in found.refused["mujoco"]
    assert found.of("pinocchio") == ()


def test_a_keyframe_of_numbers_that_are_none_is_refused(tmp_path):
    path = written(tmp_path, '<mujoco><worldbody><body name="b"><joint/><geom size="1"/></body></worldbody><keyframe>'
                             '<key name="k" qpos="nan"/></keyframe></mujoco>')
    with pytest.raises(crosscheck.SceneError, match="keyframe 'k' holds a number that is not finite"):
        crosscheck.import_model(path, keyframe="k")


def test_the_command_writes_a_scene_that_is_the_model(tmp_path, monkeypatch):
    from typer.testing import CliRunner

    from crosscheck.cli.app import app

    monkeypatch.chdir(tmp_path)
    path = written(tmp_path, ARM_URDF, "arm.urdf")
    told = CliRunner().invoke(app, ["convert", "arm.urdf", "-o", "arm.toml", "--drop"])
    assert told.exit_code == 0, told.output
    assert "it ends at the first of 1 monitor: a joint leaves its range" in told.output
    scene = crosscheck.load_scene("arm.toml")
    assert scene.hash == crosscheck.import_model(path, drop=True).hash
    assert not scene.left_out
    assert [monitor.joint for monitor in scene.monitors] == ["reach"]  # its limits are watched
    assert CliRunner().invoke(app, ["run", "arm.urdf", "--drop", "--duration", "0.1"]).exit_code == 0
    assert CliRunner().invoke(app, ["convert", "arm.urdf", "-o", "arm.xml", "--drop"]).exit_code == 0
    assert crosscheck.import_model("arm.xml", drop=True).bodies[0].mass == scene.bodies[0].mass
    for words, said in ((["arm.toml", "-o", "b.toml"], "is a scene already"),
                        (["arm.toml", "-o", "b.xml", "--base", "free"], "base: options of a model file")):
        assert said in str(CliRunner().invoke(app, ["convert", *words]).exception)
    refused = CliRunner().invoke(app, ["run", "single_pendulum", "--limits", "keep"])
    assert "--limits go with a model file" in " ".join(str(refused.exception or refused.output).split())


def test_a_mimic_of_a_urdf_starts_where_its_leader_puts_it_and_runs(tmp_path):
    follows = ARM_URDF.replace('<axis xyz="0 1 0"/>', '<axis xyz="0 1 0"/><mimic joint="elbow" offset="0.3"/>')
    scene = crosscheck.import_model(written(tmp_path, follows, "arm.urdf"), drop=True, duration=0.1, samples=3)
    assert at_start(scene)["shoulder"][0] == pytest.approx([0.3], abs=1e-15)
    joints = crosscheck.run(scene, engine="lieeuler", method="taylor", rtol=1e-10).joints
    gap = joints["shoulder"].position - joints["elbow"].position - 0.3
    assert np.abs(gap).max() < 1e-14
    assert np.ptp(joints["elbow"].position) > 1e-3


def test_a_mimic_of_a_joint_that_does_not_move_says_nothing(tmp_path):
    held = '<child link="tool"/>', '<child link="tool"/><mimic joint="elbow"/>'
    assert ARM_URDF.count(held[0]) == 1
    plain, marked = (crosscheck.import_model(written(tmp_path, text, "arm.urdf"), drop=True)
                     for text in (ARM_URDF, ARM_URDF.replace(*held)))
    assert marked.left_out == plain.left_out
    lost = ARM_URDF.replace('<axis xyz="0 1 0"/>', '<axis xyz="0 1 0"/><mimic joint="held"/>')
    scene = crosscheck.import_model(written(tmp_path, lost, "arm.urdf"), drop=True)
    assert ("shoulder", "mimic of joint", ("held", 1.0, 0.0)) in scene.left_out


def test_links_that_no_body_could_be_are_merged_along_fixed_joints(tmp_path):
    # the tool alone breaks the triangle inequality; with the lower arm it is a body like any other
    thin = ARM_URDF.replace('iyy="0.001" izz="0.001"', 'iyy="0.001" izz="0.003"')
    scene = crosscheck.import_model(written(tmp_path, thin, "arm.urdf"), drop=True)
    plain = crosscheck.import_model(written(tmp_path, ARM_URDF, "plain.urdf"), drop=True)
    np.testing.assert_allclose(scene.inertias[1] - plain.inertias[1], np.diag([0, 0, 0.002]), atol=1e-15)
    import pinocchio

    model = pinocchio.buildModelFromXML(ARM_URDF)
    np.testing.assert_allclose(plain.inertias, [np.array(each.inertia) for each in model.inertias[1:]], atol=1e-15)
    np.testing.assert_allclose(plain.masses, [each.mass for each in model.inertias[1:]], atol=1e-15)
