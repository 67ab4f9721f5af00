"""The native check: seeded mistakes in model files are named, and a file without one is not accused."""

import pytest

import crosscheck
from tests.scene.models.model_files import ARM_MJCF, ARM_URDF

PLAIN = ARM_URDF.replace('<dynamics damping="0.5"/>', "").replace('<dynamics damping="2"/>', "")
MJCF = ARM_MJCF.format(quat="0.8 0.6 0 0", turn="1 0 0 0", inertia="0.1 0.12 0.05 0.01 0.002 0").replace(
    'damping="0.5"', 'damping="0.5" armature="0.3"')

URDF_MISTAKES = [  # what is written in place of what, and what has to be said
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
    ('<origin xyz="0.1 0 -0.3"', '<origin xyz="0.1 0.01 -0.3"', "against the centre of mass of upper"),
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
    ('quat="0.8 0.6 0 0"', 'quat="0.6 0.8 0 0"', "frame of joint shoulder is turned by 32.52 deg"),
]


@pytest.mark.parametrize(("right", "wrong", "words"), URDF_MISTAKES)
@pytest.mark.parametrize("engine", ["mujoco", "pinocchio"])
def test_a_mistake_in_a_urdf_is_named(engine, right, wrong, words, tmp_path):
    assert PLAIN.count(right) == 1
    good, bad = tmp_path / "good.urdf", tmp_path / "bad.urdf"
    good.write_text(PLAIN)
    bad.write_text(PLAIN.replace(right, wrong))
    found = crosscheck.inspect(bad, [engine], against=good)
    assert words in " ".join(found.lines), found.lines
    assert crosscheck.inspect(good, [engine], against=good).agree


@pytest.mark.parametrize(("right", "wrong", "words"), MJCF_MISTAKES)
def test_a_mistake_in_an_mjcf_is_named(right, wrong, words, tmp_path):
    assert MJCF.count(right) == 1
    good, bad = tmp_path / "good.xml", tmp_path / "bad.xml"
    good.write_text(MJCF)
    bad.write_text(MJCF.replace(right, wrong))
    found = crosscheck.inspect(bad, ["mujoco"], against=good)
    assert words in " ".join(found.lines), found.lines
    assert crosscheck.inspect(good, ["mujoco"], against=good).agree


def test_damping_that_aba_does_not_apply_is_named(tmp_path):
    path = tmp_path / "arm.urdf"
    path.write_text(ARM_URDF)
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
    assert "mass of link finger made from collision geometry: 1.2 kg in place of 0.2 kg" in " ".join(found.lines)
    assert found.of("pinocchio") == ()


def test_a_refusal_stands_beside_what_the_others_read(tmp_path):
    path = tmp_path / "arm.urdf"
    shape = "<collision><geometry><mesh filename='no.stl'/></geometry></collision>"
    path.write_text(PLAIN.replace("</visual></link>", f"</visual>{shape}</link>"))
    found = crosscheck.inspect(path)
    assert "no.stl" in found.refused["mujoco"]
    assert [native.engine for native in found.native] == ["pinocchio"]
    assert not found.agree


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


def test_a_lost_rotation_is_not_blamed_on_the_damping(tmp_path):
    good, bad = tmp_path / "good.urdf", tmp_path / "bad.urdf"
    good.write_text(ARM_URDF)
    bad.write_text(ARM_URDF.replace('rpy="0.3 0.2 0.1"/><mass value="1"', 'rpy="0 0 0"/><mass value="1"'))
    found = crosscheck.inspect(bad, ["mujoco"], against=good)
    assert {each.quantity for each in found.differences} <= {"inertia", "mass matrix", "bias"}
