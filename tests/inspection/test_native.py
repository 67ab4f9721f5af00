"""The native check: seeded mistakes in model files are named, and a file without one is not accused."""

import dataclasses
import subprocess
import sys

import numpy as np
import pytest

import crosscheck
from crosscheck import adapters
from crosscheck.adapters.common.native import JointStates, Part, assembled, moved
from crosscheck.inspection import native
from crosscheck.scene.models.words import together
from tests import saved
from tests.scene.models.model_files import ARM_MJCF, ARM_URDF

PLAIN = ARM_URDF.replace('<dynamics damping="0.5"/>', "").replace('<dynamics damping="2"/>', "")
MJCF = ARM_MJCF.format(quat="0.8 0.6 0 0", turn="1 0 0 0", inertia="0.1 0.12 0.05 0.01 0.002 0").replace(
    'damping="0.5"', 'damping="0.5" armature="0.3"')

def beside(monkeypatch, good, path, engines=None):
    """The native check of a file whose scene is that of the file `good`, as if the engines misread it."""
    with monkeypatch.context() as patch:
        patch.setattr(native, "import_model", lambda _, **given: crosscheck.import_model(good, **given))
        return crosscheck.inspect(path, engines)


URDF_MISTAKES = [  # the text replaced, its replacement, and the words of the finding
    ('rpy="0.3 0.2 0.1"/><mass value="1"', 'rpy="0 0 0"/><mass value="1"', "inertial rotation of upper lost or turned"),
    ('rpy="0.3 0.2 0.1"/><mass value="1"', 'rpy="0.3 0.2 -0.1"/><mass value="1"', "inertial rotation of upper"),
    ('<axis xyz="0 1 0"/>', '<axis xyz="0 -1 0"/>', "axis of joint shoulder is flipped"),
    ('<axis xyz="0.6 0.8 0"/>', '<axis xyz="0.8 0.6 0"/>', "axis of joint elbow is turned by 16.26 deg"),
    ('<mass value="0.5"/>', '<mass value="5"/>', "mass of link lower"),
    ('<mass value="1"/>', '<mass value="1.001"/>', "mass of link upper times 1.001"),
    ('ixx="0.02"', 'ixx="0.03"', "inertia of link lower: principal moments"),
    ('xyz="0 0 -0.6" rpy="0 0 0.4"', 'xyz="0 0 -0.7" rpy="0 0 0.4"', "frame of joint elbow is shifted"),
    ('xyz="0 0 -0.6" rpy="0 0 0.4"', 'xyz="0 0 -0.6" rpy="0 0 22.918311805232928"', "degree for radian"),
    ('rpy="0.2 0.1 0"', 'rpy="0.2 0.1 0.05"', "frame of joint shoulder is turned by"),
    ('<origin xyz="0 0.1 -0.4"/>', '<origin xyz="0.1 0 -0.4"/>', "frame of joint"),
    ('<origin xyz="0.1 0 -0.3"', '<origin xyz="0.1 0.01 -0.3"', "of link upper is shifted by (0, 0.01, 0) m"),
    ('<origin xyz="0.1 0 -0.3"', '<origin xyz="0.1 0 0.3"', "centre of mass of link upper is shifted by (0, 0, 0.6) m"),
    ('ixy="0.01"', 'ixy="-0.01"', "inertial rotation of upper lost or turned"),
    ('xyz="0 0 -0.6" rpy="0 0 0.4"', 'xyz="0 0 -600" rpy="0 0 0.4"', "joint elbow is shifted by (0, 0, -599.4)"),
    ('<mass value="0.5"/>', '<mass value="500"/>', "mass of link lower times 833.5: 500.1 kg in place of 0.6 kg"),
    ('iyy="0.025" izz="0.01"', 'iyy="0.045" izz="0.03"', "inertia of link lower: principal moments"),
    ('ixx="0.002" iyy="0.0015" izz="0.001"', 'ixx="0.02" iyy="0.015" izz="0.01"', "inertia of link finger"),
    ('name="elbow" type="continuous"', 'name="elbow" type="fixed"', "joint elbow is not in its model"),
    ('name="reach" type="prismatic"', 'name="reach" type="revolute"', "joint reach is revolute in place of prismatic"),
    ('rpy="0.2 0.1 0"', 'rpy="0 0.1 0.2"', "frame of joint shoulder is turned by 16.98 deg"),
    ('<axis xyz="0 1 0"/>', "", "axis of joint shoulder is turned by 90 deg"),
    ('<child link="tool"/><origin xyz="0 0.1 -0.4"/>', '<child link="tool"/>', "inertia of link lower"),
    ('<mass value="0.1"/>', '<mass value="0"/>', "mass of link lower times 0.833333"),
    ('xyz="0 0 1" rpy="0.2', 'xyz="0 0 1.2" rpy="0.2', "joint shoulder is shifted by (0, 0, 0.2) m against the ground"),
    ('<parent link="tool"/>', '<parent link="upper"/>', "joint reach joins upper and finger in place of lower and"),
]
MJCF_MISTAKES = [
    (' armature="0.3"', "", "armature of joint shoulder missing"),
    (' armature="0.3"', ' armature="0.03"', "armature of joint shoulder is 0.03, not 0.3"),
    ('damping="0.5" ', "", "damping of joint shoulder missing"),
    ('damping="2"', 'damping="0.2"', "damping of joint reach is 0.2, not 2"),
    ('axis="0.6 0.8 0"', 'axis="-0.6 -0.8 0"', "axis of joint elbow is flipped"),
    ('<compiler angle="radian"/>', '<compiler angle="radian"/><option gravity="0 0 9.81"/>', "gravity is"),
    ('pos="0 0.02 -0.2" mass="0.5"', 'pos="0 0.02 -0.2" mass="0.25"', "mass of link lower"),
    ('damping="2"', 'damping="2" stiffness="5"', "stiffness of joint reach is 5, not 0"),
    ('name="elbow"', 'name="elbow" pos="0 0 0.1"', "frame of joint elbow is shifted by (0, 0, 0.1) m"),
    ('name="elbow"', 'name="elbow" ref="0.3"', "frame of joint elbow is turned by 17.19 deg"),
    ('type="slide"', 'type="hinge"', "joint reach is revolute in place of prismatic"),
    ('<body name="tool"', '<body name="tool" gravcomp="1"', "differs by an effort"),
    ('angle="radian"/>', 'angle="radian"/><option><flag gravity="disable"/></option>', "gravity is"),
    ('quat="0.8 0.6 0 0"', 'quat="0.6 0.8 0 0"', "frame of joint shoulder is turned by 32.52 deg"),
]


URDF_SAME = [  # another file of the same arm
    ('ixx="0.1" iyy="0.12"', 'iyy="0.12" ixx="0.1"'), ('<axis xyz="0 1 0"/>', '<axis xyz="0 2 0"/>'),
    ('rpy="0 0 0.4"', 'rpy="0 0 6.683185307179586"'), ('<link name="base"/>', '<!-- base --><link name="base"></link>'),
    ('lower="-1" upper="1"', 'lower="-2" upper="2"'),
    ('name="elbow" type="continuous">', 'name="elbow" type="revolute"><limit lower="-1e9" upper="1e9" effort="1" '
                                        'velocity="1"/>'),
    ('<link name="tool"><inertial>', '<link name="tool"><inertial><origin xyz="0 0 0" rpy="0.4 1 2"/>'),
    ('<link name="base"/>', '<link name="base"><visual><geometry><box size="1 1 1"/></geometry></visual></link>'),
]
MJCF_SAME = [
    ('quat="0.8 0.6 0 0"', 'quat="-0.8 -0.6 0 0"'), ('quat="0.8 0.6 0 0"', 'quat="8 6 0 0"'),
    ('<body name="tool" pos="0 0.1 -0.4">', '<body name="tool" pos="0 0.1 -0.4"><site name="s"/>'),
    ('axis="0.6 0.8 0"', 'axis="3 4 0"'), ('<mujoco model="arm">', '<mujoco model="other">'),
    ('<body name="tool" pos="0 0.1 -0.4">', '<body name="tool" pos="0 0.1 -0.4"><geom size="1" mass="0" contype="0" '
                                            'conaffinity="0"/>'),
]


@pytest.mark.parametrize(("plain", "right", "other", "engine"), [
    *((PLAIN, *pair, engine) for pair in URDF_SAME for engine in ("mujoco", "pinocchio")),
    *((MJCF, *pair, "mujoco") for pair in MJCF_SAME)])
def test_nothing_is_named_where_a_file_says_the_same_in_other_words(plain, right, other, engine, tmp_path, monkeypatch):
    assert plain.count(right) == 1
    suffix = "xml" if "<mujoco" in plain else "urdf"
    one, two = tmp_path / f"one.{suffix}", tmp_path / f"two.{suffix}"
    one.write_text(plain)
    two.write_text(plain.replace(right, other))
    assert beside(monkeypatch, one, two, [engine]).agree


@pytest.mark.parametrize(("right", "wrong", "words"), URDF_MISTAKES)
@pytest.mark.parametrize("engine", ["mujoco", "pinocchio"])
def test_a_mistake_in_a_urdf_is_named(engine, right, wrong, words, tmp_path, monkeypatch):
    assert PLAIN.count(right) == 1
    good, bad = tmp_path / "good.urdf", tmp_path / "bad.urdf"
    good.write_text(PLAIN)
    bad.write_text(PLAIN.replace(right, wrong))
    found = beside(monkeypatch, good, bad, [engine])
    assert words in " ".join(found.lines), found.lines


@pytest.mark.parametrize(("right", "wrong", "words"), MJCF_MISTAKES)
def test_a_mistake_in_an_mjcf_is_named(right, wrong, words, tmp_path, monkeypatch):
    assert MJCF.count(right) == 1
    good, bad = tmp_path / "good.xml", tmp_path / "bad.xml"
    good.write_text(MJCF)
    bad.write_text(MJCF.replace(right, wrong))
    found = beside(monkeypatch, good, bad, ["mujoco"])
    assert words in " ".join(found.lines), found.lines


@pytest.mark.parametrize(("text", "suffix", "engine"), [(PLAIN, "urdf", "mujoco"), (PLAIN, "urdf", "pinocchio"),
                                                        (MJCF, "xml", "mujoco")])
def test_nothing_is_named_in_the_file_without_the_mistake(text, suffix, engine, tmp_path):
    path = saved(tmp_path / f"good.{suffix}", text)
    assert crosscheck.inspect(path, [engine]).agree


def test_damping_that_aba_does_not_apply_is_named(tmp_path):
    path = saved(tmp_path / "arm.urdf", ARM_URDF)
    found = crosscheck.inspect(path)
    assert found.of("mujoco") == ()
    assert [each.words for each in found.of("pinocchio")] == [
        "damping of joint shoulder is stored but not applied by aba",
        "damping of joint reach is stored but not applied by aba"]


def test_mass_from_collision_geometry_and_a_fused_root_are_named(tmp_path):
    path = tmp_path / "arm.urdf"
    box = "<collision><geometry><box size='0.1 0.1 0.1'/></geometry></collision>"
    base = '<inertial><mass value="3"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>'
    path.write_text(PLAIN.replace('<link name="base"/>', f'<link name="base">{base}</link>').replace(
        "</robot>", f'<link name="gripper">{box}</link><joint name="held" type="fixed"><parent link="finger"/>'
                    '<child link="gripper"/></joint></robot>'))
    found = crosscheck.inspect(path)
    assert [each.words for each in found.of("mujoco") if each.quantity in ("mass", "root")] == [
        "mass of link finger made from collision geometry: 1.2 kg in place of 0.2 kg",
        "the root is fused to the world: 3 kg do not move"]
    assert found.of("pinocchio") == ()


def test_a_refusal_stands_beside_what_the_others_read(tmp_path):
    path = tmp_path / "arm.urdf"
    shape = "<collision><geometry><mesh filename='no.stl'/></geometry></collision>"
    path.write_text(PLAIN.replace("</visual></link>", f"</visual>{shape}</link>"))
    found = crosscheck.inspect(path, ["mujoco", "pinocchio"])
    assert "no.stl" in found.refused["mujoco"]
    assert found.lines[-1].startswith("mujoco refuses the file, and is shown below as 'mujoco without meshes': ")
    assert [each.engine for each in found.native] == ["mujoco without meshes", "pinocchio"]
    assert found.differences == ()
    assert not found.agree


def test_what_was_compared_and_is_the_same_is_said_and_nothing_else(tmp_path, monkeypatch):
    (tmp_path / "arm.urdf").write_text(ARM_URDF)
    found, told = crosscheck.inspect(tmp_path / "arm.urdf"), []
    native.printed(found, told.append)
    assert told[-1] == ("the same in all that loaded it: masses, inertias, centres of mass, joints, axes, frames, "
                        "armature, stiffness, mass matrix, bias forces")  # Pinocchio applies no damping
    (tmp_path / "rough.urdf").write_text(PLAIN.replace("</joint>", '<dynamics friction="0.3"/></joint>', 1))
    rough = crosscheck.inspect(tmp_path / "rough.urdf")
    assert "accelerations" not in rough.same
    assert [str(each) for each in rough.differences if each.quantity == "friction"] == [
        f"pinocchio: friction of joint {rough.scene.joints[0].name} is stored but not applied by aba"]
    (tmp_path / "heavy.urdf").write_text(ARM_URDF.replace('<mass value="1"/>', '<mass value="1.001"/>'))
    other = beside(monkeypatch, tmp_path / "arm.urdf", tmp_path / "heavy.urdf", ["mujoco"])
    assert {"masses", "mass matrix", "accelerations"}.isdisjoint(other.same)
    assert {"axes", "frames", "damping"} <= set(other.same)
    (tmp_path / "plain.urdf").write_text(PLAIN)
    plain = crosscheck.inspect(tmp_path / "plain.urdf")
    assert set(plain.same) == set(native.COMPARED)


def test_a_body_that_one_engine_refuses_is_read_by_the_others(tmp_path):
    path = tmp_path / "arm.urdf"
    path.write_text(PLAIN.replace('ixx="0.001" iyy="0.001" izz="0.001"', 'ixx="0.001" iyy="0.001" izz="0.003"'))
    found = crosscheck.inspect(path, ["mujoco", "pinocchio"])  # the tool alone is no body, with the lower arm it is one
    assert "A + B >= C" in found.refused["mujoco"]
    assert [each.engine for each in found.native] == ["pinocchio"]
    assert found.differences == ()
    assert not found.agree


def test_a_file_that_cannot_be_a_scene_is_still_shown_as_engines_read_it(tmp_path):
    path = saved(tmp_path / "arm.urdf", PLAIN.replace('ixx="0.002" iyy="0.0015"', 'ixx="0.02" iyy="0.0015"'))
    found = crosscheck.inspect(path)
    assert found.scene is None
    assert "A + B >= C" in found.no_scene
    told: list[str] = []
    native.printed(found, told.append)
    assert "pinocchio reads 3 moving bodies, 3 joints with one coordinate, 1.8 kg" in told[0]
    with pytest.raises(crosscheck.SceneError, match="A \\+ B >= C"):
        crosscheck.inspect(path, ["mujoco"])


@pytest.mark.parametrize("engine", ["mujoco", "pinocchio"])
def test_armature_is_read_and_counted(engine, tmp_path):
    path = saved(tmp_path / "arm.xml", MJCF.replace(' damping="0.5"', "").replace(' damping="2"', ""))
    found = crosscheck.inspect(path, [engine])
    assert found.scene.joints[0].armature == (0.3,)
    assert found.agree, found.lines


@pytest.mark.parametrize("engine", ["mujoco", "pinocchio"])
def test_joints_without_a_name_are_found_by_their_bodies(engine, tmp_path):
    path = tmp_path / "arm.xml"
    path.write_text(MJCF.replace(' damping="0.5"', "").replace(' damping="2"', "").replace('name="elbow" ', ""))
    found = crosscheck.inspect(path, [engine])
    assert found.agree, found.lines
    assert "lower joint" in found.native[0].order


def test_a_mimic_that_an_engine_ignores_is_named_and_its_force_is_no_mistake(tmp_path):
    path = tmp_path / "arm.urdf"
    follow = '<mimic joint="shoulder" multiplier="2"/><axis xyz="0.6 0.8 0"/>'
    path.write_text(ARM_URDF.replace('<axis xyz="0.6 0.8 0"/>', follow))
    found = crosscheck.inspect(path)
    assert found.of("mujoco") == ()  # it holds the mimic by a force
    assert [each.words for each in found.of("pinocchio")] == [
        "joint elbow follows no other joint in place of shoulder",
        "damping of joint shoulder is stored but not applied by aba",
        "damping of joint reach is stored but not applied by aba"]


def test_bodies_without_a_name_are_found_by_their_joints(tmp_path):
    path = tmp_path / "arm.xml"
    path.write_text(MJCF.replace(' damping="0.5"', "").replace(' damping="2"', "").replace('name="lower"', ""))
    found = crosscheck.inspect(path)
    assert found.agree, found.lines
    assert [each.engine for each in found.native] == ["mujoco", "pinocchio"]


def test_one_factor_of_all_masses_is_one_line(tmp_path):
    path = tmp_path / "arm.xml"
    path.write_text(MJCF.replace('<compiler angle="radian"/>', '<compiler angle="radian" settotalmass="3.6"/>'))
    words = [each.words for each in crosscheck.inspect(path, ["pinocchio"]).differences]
    assert words[0] == "masses of all links times 0.5"
    assert not any("mass of link" in each or "inertia" in each for each in words)


def test_many_differences_of_one_kind_are_one_line(tmp_path):
    assert together([(f"damping of joint j{k} is lost", f"j{k}") for k in range(10)]) == [
        "damping of joint j0 is lost; likewise j1, j2, j3, j4, j5, j6 and 3 more"]
    few = [(f"damping of joint j{k} is {k}", f"j{k}") for k in range(10)]
    assert together(few) == [sentence for sentence, _ in few]
    assert together([("limits of joint 'a', 'b'", "")] * 2) == ["limits of joint 'a', 'b'"] * 2


def test_what_is_not_compared_is_said(tmp_path):
    path, told = tmp_path / "ball.xml", []
    path.write_text('<mujoco><worldbody><body name="b"><joint name="j" type="ball"/><inertial pos="0 0 1" mass="1" '
                    'diaginertia="1 1 1"/></body></worldbody></mujoco>')
    native.printed(crosscheck.inspect(path, ["mujoco"]), told.append)
    assert told[1].startswith("not compared: mass matrix, bias forces and accelerations")


def test_what_a_parser_prints_is_in_its_refusal_and_nowhere_else(tmp_path, monkeypatch, capfd):
    path = saved(tmp_path / "arm.urdf", PLAIN.replace('type="prismatic"', 'type="wobbly"'))
    with pytest.raises(crosscheck.SceneError, match="invalid joint type"):
        crosscheck.inspect(path)
    (tmp_path / "good.urdf").write_text(PLAIN)
    found = beside(monkeypatch, tmp_path / "good.urdf", path)
    assert "Joint [reach] has no known type [wobbly]" in found.refused["pinocchio"]
    assert capfd.readouterr() == ("", "")


def test_pinocchio_lacks_the_springs_of_an_mjcf(tmp_path):
    path = saved(tmp_path / "arm.xml", MJCF.replace('name="elbow"', 'name="elbow" stiffness="3" springref="0.4"'))
    words = [each.words for each in crosscheck.inspect(path, ["pinocchio"]).differences]
    assert "stiffness of joint elbow missing" in words
    assert not any("rest position" in each for each in words)


@pytest.mark.parametrize("engine", ["mujoco", "pinocchio"])
def test_files_are_read_where_only_the_engine_is_installed(engine, tmp_path):
    path = saved(tmp_path / "arm.urdf", ARM_URDF)
    code = ("import sys; sys.modules |= dict.fromkeys(['typer', 'rich', 'sqlalchemy', 'psutil', 'mpmath']); "
            f"import numpy as np; from crosscheck.adapters.{engine} import native; "
            "from crosscheck.adapters.common.native import JointStates; print(len(native.load("
            f"{str(path)!r}, JointStates((), np.zeros((1, 0)), np.zeros((1, 0)))).links))")
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout == "3\n"


def test_the_inertial_rotation_that_an_old_mujoco_loses_is_named(tmp_path):
    path = saved(tmp_path / "arm.urdf", PLAIN)
    old, new = "mujoco==3.3.7", "mujoco==4.0.0"
    found = crosscheck.inspect(path, [old, new])
    assert found.of(new) == ()
    assert found.of(old)[0].words.startswith("inertial rotation of upper lost or turned")


def test_the_command_prints_the_words(tmp_path, monkeypatch):
    from typer.testing import CliRunner

    from crosscheck.cli.app import app

    monkeypatch.chdir(tmp_path)
    (tmp_path / "arm.urdf").write_text(ARM_URDF)
    told = CliRunner().invoke(app, ["inspect", "arm.urdf", "--engine", "pinocchio", "--engine", "exudyn"])
    assert told.exit_code == 1
    assert "damping of joint shoulder is stored but not applied by aba" in told.output
    assert "exudyn refuses the file" in told.output
    assert [path.name for path in tmp_path.iterdir()] == ["arm.urdf"]


def test_a_lost_rotation_is_not_blamed_on_the_damping(tmp_path, monkeypatch):
    good, bad = tmp_path / "good.urdf", tmp_path / "bad.urdf"
    good.write_text(ARM_URDF)
    bad.write_text(ARM_URDF.replace('rpy="0.3 0.2 0.1"/><mass value="1"', 'rpy="0 0 0"/><mass value="1"'))
    found = beside(monkeypatch, good, bad, ["mujoco"])
    assert {each.quantity for each in found.differences} <= {"inertia", "mass matrix", "bias"}


def test_parts_of_an_engine_are_put_together_as_mujoco_does(tmp_path):
    """Bodies that MuJoCo keeps apart, with a fixed one, against what it reads where it fuses them."""
    import mujoco

    path = saved(tmp_path / "arm.urdf", PLAIN)
    m = mujoco.MjModel.from_xml_string(PLAIN.replace('<link name="base"/>', '<mujoco><compiler fusestatic="false"/>'
                                                     '</mujoco><link name="base"/>'))
    d = mujoco.MjData(m)
    mujoco.mj_forward(m, d)
    parts = {}
    for body in map(m.body, range(1, m.nbody)):
        R, joint = d.ximat[body.id].reshape(3, 3), m.jnt(body.jntadr[0]) if body.jntnum else None
        parts[body.name] = Part(
            m.body(body.parentid[0]).name.replace("world", ""), float(body.mass[0]), d.xipos[body.id].copy(),
            R @ np.diag(body.inertia) @ R.T, d.xmat[body.id].reshape(3, 3).copy(), *(() if joint is None else (
                joint.name, d.xanchor[joint.id].copy(), d.xaxis[joint.id].copy(),
                "prismatic" if joint.type[0] == mujoco.mjtJoint.mjJNT_SLIDE else "revolute")))
    assert len(parts) > len([part for part in parts.values() if part.joint])
    states = JointStates(tuple(part.joint for part in parts.values() if part.joint), np.zeros((1, 3)), np.ones((1, 3)))
    whole = adapters.get("mujoco").native(str(path), states)
    found = assembled("parts", parts, whole.gravity)
    assert list(found.links) == list(whole.links)
    for name, link in whole.links.items():
        assert found.links[name].mass == pytest.approx(link.mass)
        np.testing.assert_allclose(found.links[name].inertia, link.inertia, rtol=0, atol=1e-12)
    for name, joint in whole.joints.items():
        for key in ("parent_anchor", "child_anchor", "axis", "attitude"):
            np.testing.assert_allclose(getattr(found.joints[name], key), getattr(joint, key), rtol=0, atol=1e-12)
        assert [getattr(found.joints[name], key) for key in ("parent", "child", "kind")] == [
            joint.parent, joint.child, joint.kind]
    columns = dict(zip(states.names, (2, 0, 1), strict=True))  # an engine may have another order
    back = [columns[name] for name in states.names]
    M, bias = np.empty((3, 3)), np.empty(3)
    M[np.ix_(back, back)], bias[back] = whole.mass_matrix[0], whole.bias[0]
    again = moved(found, states, columns, "given", lambda q, v: (M, bias))
    np.testing.assert_allclose(again.acceleration, whole.acceleration, rtol=0, atol=1e-10)


def installed(engine):
    """Skips the test where there is no such engine."""
    if engine not in adapters.names():
        pytest.skip(f"{engine} is not installed")


@pytest.mark.parametrize("engine", ["drake", "pybullet"])
def test_further_engines_read_the_arm(engine, tmp_path, monkeypatch):
    installed(engine)
    (good := tmp_path / "arm.urdf").write_text(PLAIN)
    (wrong := tmp_path / "wrong.urdf").write_text(PLAIN.replace('<mass value="1"/>', '<mass value="1.001"/>'))
    found = crosscheck.inspect(good, [engine])
    assert not found.refused
    assert [each for each in found.differences if each.quantity != "frame"] == []
    assert found.native[0].acceleration is not None
    assert any("mass of link upper" in str(each) for each in beside(monkeypatch, good, wrong, [engine]).differences)


SDF = """<sdf version="1.7"><model name="swing"><link name="rod"><inertial><pose>0 0 -0.5 0 0 0</pose><mass>2</mass>
<inertia><ixx>0.1</ixx><iyy>0.1</iyy><izz>0.05</izz><ixy>0</ixy><ixz>0</ixz><iyz>0</iyz></inertia></inertial></link>
<joint name="hinge" type="revolute"><parent>world</parent><child>rod</child><axis><xyz>0 1 0</xyz>
<dynamics><damping>0.3</damping></dynamics><limit><lower>-1</lower><upper>2</upper></limit></axis></joint></model></sdf>
"""


def test_an_sdf_file_is_read_by_the_engines_that_take_it(tmp_path, monkeypatch):
    (path := tmp_path / "swing.sdf").write_text(SDF)
    with pytest.raises(crosscheck.SceneError, match=r"read by engines alone, .*pip install 'lieeuler-crosscheck.drake"):
        crosscheck.import_model(path)
    installed("drake")
    read, rng = crosscheck.inspect(path, ["drake"]).native[0], np.random.default_rng(0)
    hinge, q, v = read.joints["hinge"], *(rng.uniform(-x, x, (4, 1)) for x in (0.6, 1.0))
    q[0], v[0] = 0.0, 0.0
    np.testing.assert_allclose(read.acceleration, -(2 * 9.81 * 0.5 * np.sin(q) + 0.3 * v) / 0.6, rtol=0, atol=1e-12)
    assert (hinge.damping, hinge.limits, hinge.axis.tolist()) == (0.3, (-1.0, 2.0), [0.0, 1.0, 0.0])


def test_a_mass_that_is_no_number_is_named_whatever_engines_make_of_it(tmp_path):
    (path := tmp_path / "arm.urdf").write_text(PLAIN.replace('<mass value="0.5"/>', '<mass value="nan"/>'))
    found = crosscheck.inspect(path, ["mujoco", "pinocchio"])
    assert "'nan' is not finite; correct it there" in found.no_scene
    assert not found.agree


def test_a_single_link_without_joints_is_read(tmp_path):
    link = ARM_URDF[ARM_URDF.index('<link name="tool">'):ARM_URDF.index('<link name="finger">')]
    (path := tmp_path / "cube.urdf").write_text(f'<robot name="cube">{link}</robot>')
    found = crosscheck.inspect(path, ["mujoco", "pinocchio"])
    assert len(found.native) == 2
    assert "--base free" in found.no_scene


USD = """#usda 1.0
(
    defaultPrim = "swing"
    metersPerUnit = 1
    upAxis = "Z"
)
def Xform "swing" (
    prepend apiSchemas = ["PhysicsArticulationRootAPI"]
) {
    def Xform "rod" (
        prepend apiSchemas = ["PhysicsRigidBodyAPI", "PhysicsMassAPI"]
    ) {
        float physics:mass = 2
        point3f physics:centerOfMass = (0, 0, -0.5)
        float3 physics:diagonalInertia = (0.1, 0.1, 0.05)
        quatf physics:principalAxes = (1, 0, 0, 0)
    }
    def PhysicsRevoluteJoint "hinge" {
        uniform token physics:axis = "Y"
        rel physics:body1 = </swing/rod>
        float physics:lowerLimit = -57.29577951308232
        float physics:upperLimit = 114.59155902616465
    }
}
"""


def newton_or_skip():
    if "newton" not in adapters.names():
        pytest.skip("the environment of newton is not made")


def test_a_usd_file_is_read_by_newton_and_by_nobody_else(tmp_path):
    (path := tmp_path / "swing.usda").write_text(USD)
    with pytest.raises(crosscheck.SceneError, match="only read by engines, for `crosscheck inspect`; convert it"):
        crosscheck.import_model(path)
    newton_or_skip()
    try:
        read = crosscheck.inspect(path, ["newton"]).native[0]
    except crosscheck.SceneError as error:
        if "newton[importers]" not in str(error):
            raise
        pytest.skip("the environment of newton is from before its importers were asked for")
    hinge, rod = read.joints["hinge"], read.links["rod"]
    assert rod.mass == pytest.approx(2.0)
    np.testing.assert_allclose(rod.inertia, np.diag([0.1, 0.1, 0.05]), atol=1e-7)
    np.testing.assert_allclose(hinge.child_anchor, [0, 0, 0.5], atol=1e-7)
    np.testing.assert_allclose(hinge.axis, [0, 1, 0], atol=1e-7)
    np.testing.assert_allclose(hinge.limits, [-1, 2], rtol=1e-6)


def test_newton_reads_a_robot_as_the_scene_has_it_in_single_precision(tmp_path):
    newton_or_skip()
    (path := tmp_path / "arm.urdf").write_text(PLAIN)
    found = crosscheck.inspect(path, ["newton"])
    assert found.agree, [str(each) for each in found.differences]
    assert found.native[0].acceleration is not None


@pytest.mark.parametrize(("tolerance", "named"), [(native.TOLERANCE, {"mass", "axis"}), (3e-5, set())])
def test_a_reader_in_single_precision_is_not_accused_of_its_roundings(tmp_path, tolerance, named):
    (path := tmp_path / "arm.urdf").write_text(PLAIN)
    exact = crosscheck.inspect(path, ["pinocchio"]).native[0]
    first, *_ = exact.links
    hinge = next(name for name, joint in exact.joints.items())
    turned = exact.joints[hinge].axis + 8e-4 * np.array([1.0, 0.0, 0.0])
    rough = dataclasses.replace(
        exact, tolerance=tolerance, links=exact.links | {first: dataclasses.replace(
            exact.links[first], mass=exact.links[first].mass * (1 + 1e-5))},
        joints=exact.joints | {hinge: dataclasses.replace(exact.joints[hinge], axis=turned / np.linalg.norm(turned))})
    assert {quantity for quantity, _, _ in native._differences(exact, rough, frozenset())} == named


LIMITED = ARM_URDF.replace('name="shoulder" type="continuous"', 'name="shoulder" type="revolute"').replace(
    '<dynamics damping="0.5"/>', '<limit lower="-1" upper="2" effort="40" velocity="3"/>'
    '<dynamics damping="0.5" friction="0.3"/>')


def test_what_each_engine_holds_of_a_joint_is_a_table_of_what_differs(tmp_path):
    path = saved(tmp_path / "arm.urdf", LIMITED)
    found = crosscheck.inspect(path, ["mujoco", "pinocchio"])
    rows = {row[0]: row[1:] for row in found.laws}
    assert rows["velocity limit of shoulder"] == ["3", "-", "3"]  # MuJoCo has none
    assert not any(quantity in row for row in rows for quantity in ("friction", "effort", "limit of elbow"))
    assert found.said["shoulder"]["friction"] == 0.3


@pytest.mark.parametrize(("unit", "alike"), [("degree", False), ("radian", True)])
def test_engines_that_hold_two_numbers_for_one_limit_do_not_agree(unit, alike, tmp_path):
    """Pinocchio takes the range of a slide for degrees where a file's angles are in degrees."""
    path = saved(tmp_path / "rail.xml", f"""<mujoco><compiler angle="{unit}"/><worldbody><body name="cart">
        <joint name="rail" type="slide" range="-4 4"/><geom size=".1" mass="2"/></body></worldbody></mujoco>""")
    found = crosscheck.inspect(path, ["mujoco", "pinocchio"])
    assert found.agree == alike
    assert [row[0] for row in found.laws] == ([] if alike else ["lower limit of rail", "upper limit of rail"])


@pytest.mark.parametrize(("shape", "lost"), [
    ('<box size=".1 .2 .3"/>', False), ('<cylinder radius=".03" length=".2"/>', False),
    ('<sphere radius=".05"/>', False), ('<capsule radius=".03" length=".2"/>', True)])
def test_collision_shapes_of_each_engine_are_compared(shape, lost, tmp_path):
    """Pinocchio leaves capsules out without a word."""
    form = f'<collision><origin xyz=".14 0 0" rpy="0 1 0"/><geometry>{shape}</geometry></collision></link>'
    path = saved(tmp_path / "arm.urdf", ARM_URDF.replace("</link>", form))
    found = crosscheck.inspect(path, ["mujoco", "pinocchio"])
    assert len(found.outlined) >= 2
    rows = [cells for name, *cells in found.laws if name.startswith("collision shapes of ")]
    assert bool(rows) == lost
    assert not (lost and found.agree)
    assert all("capsule 0.03, 0.2 at " in row[0] and row[1:] == [row[0], "none"] for row in rows)


def test_what_is_not_installed_is_named_with_its_command(tmp_path, monkeypatch):
    path = saved(tmp_path / "arm.sdf", '<sdf version="1.9"><model name="a"/></sdf>')
    monkeypatch.setattr(adapters, "names", lambda: ("mujoco", "pinocchio"))
    with pytest.raises(crosscheck.SceneError, match=r"no engine that reads it is installed; drake: pip install .* or "
                                                    r"pybullet: crosscheck list --engine pybullet"):
        crosscheck.inspect(path)
