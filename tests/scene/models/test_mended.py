"""Files that one engine or the other refuses: read as the others read them, and told, where the motion allows it."""

import numpy as np
import pytest

import crosscheck
from crosscheck.scene.mechanics import index1

GRAVITY, LIGHT = 9.81, 1e-6  # the light inertias are 1e-7 of what they carry
BODY = ('<inertial><origin xyz="0.1 0 -0.4"/><mass value="2"/><inertia ixx=".1" iyy=".12" izz=".05" ixy=".01" ixz="0" '
        'iyz="0"/></inertial>')


def robot(*parts, head=""):
    return f'{head}<robot name="r"><link name="base"/>{"".join(parts)}</robot>'


def joint(name, parent, axis, kind="continuous", rest="", at="0 0 0"):
    return (f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="of {name}"/><axis xyz="{axis}"/>'
            f'<origin xyz="{at}"/>{rest}</joint>')


def link(name, inertial=""):
    return f'<link name="of {name}">{inertial}</link>'


def imported(tmp_path, text, **options):
    path = tmp_path / ("robot.urdf" if "<robot" in text else "robot.xml")
    path.write_text(text)
    return crosscheck.import_model(path, **options)


def accelerations(scene):
    a, alpha, _ = index1(scene, scene.x0[None], scene.R0[None], scene.v0[None], scene.w0[None])
    return a[0], alpha[0]


def test_links_without_mass_between_two_joints_carry_the_next_one(tmp_path):
    """A universal joint written as two hinges, as MuJoCo has it on one body."""
    scene = imported(tmp_path, robot(link("x"), joint("x", "base", "1 0 0"), link("y", BODY),
                                     joint("y", "of x", "0 1 0")), qpos=[0.3, 0.5], qvel=[1.0, -2.0])
    assert [body.name for body in scene.bodies if not body.mass] == ["of x"]
    assert not any("of x" in str(each) for each in scene.left_out)
    exact = imported(tmp_path, '<mujoco><compiler angle="radian"/><worldbody><body><joint axis="1 0 0"/><joint '
                     'axis="0 1 0"/><inertial pos=".1 0 -.4" mass="2" fullinertia=".1 .12 .05 .01 0 0"/></body>'
                     "</worldbody></mujoco>", qpos=[0.3, 0.5], qvel=[1.0, -2.0])
    for ours, theirs in zip(accelerations(scene), accelerations(exact), strict=True):
        np.testing.assert_allclose(ours[-1], theirs[0], atol=1e-13 * np.abs(theirs).max())


def test_a_point_on_a_rod_is_a_pendulum(tmp_path):
    point = '<inertial><origin xyz="0 0 -0.5"/><mass value="3"/></inertial>'
    scene = imported(tmp_path, robot(link("hinge", point), joint("hinge", "base", "0 1 0")), qpos=[0.7])
    assert scene.left_out == (
        ("", "link 'of hinge' has no inertia about an axis: 1e-07 of what it carries is added", ""),)
    assert accelerations(scene)[1][0, 1] == pytest.approx(-GRAVITY / 0.5 * np.sin(0.7), rel=LIGHT)


@pytest.mark.parametrize("end", [
    (link("tip"), joint("tip", "of hinge", "1 0 0", "revolute", '<limit lower="-1" upper="1"/>')),
    (link("tip", '<inertial><mass value="1"/></inertial>'), joint("tip", "of hinge", "1 0 0", at="0 0 -.5"))])
def test_a_joint_that_moves_nothing_is_fixed(tmp_path, end):
    scene = imported(tmp_path, robot(link("hinge", BODY), joint("hinge", "base", "0 1 0"), *end))
    assert ("", "joint 'tip', which moves no mass: it is fixed", "") in scene.left_out
    fixed = imported(tmp_path, robot(link("hinge", BODY), joint("hinge", "base", "0 1 0"), *(
        part.replace('"continuous"', '"fixed"').replace('"revolute"', '"fixed"') if "tip" in part else part
        for part in (*end[:1], end[1]))))
    assert [body.mass for body in fixed.bodies] == [body.mass for body in scene.bodies]
    np.testing.assert_array_equal(accelerations(scene)[1], accelerations(fixed)[1])


def test_what_turns_a_mass_off_its_axis_stays_a_joint(tmp_path):
    far = link("far", '<inertial><mass value="1"/></inertial>') + joint("far", "of tip", "1 0 0", "fixed", at="0 .1 0")
    scene = imported(tmp_path, robot(link("hinge", BODY), joint("hinge", "base", "0 1 0"), link("tip"),
                                     joint("tip", "of hinge", "1 0 0"), far))
    assert len(scene.bodies) == 2


@pytest.mark.parametrize("moments", ['ixx=".1" iyy=".02" izz=".03"', 'ixx=".1" iyy="-.02" izz=".1"'])
def test_inertias_that_no_body_has_are_balanced_on_request_and_both_readers_agree(tmp_path, moments):
    text = robot(link("hinge", BODY.replace('ixx=".1" iyy=".12" izz=".05"', moments)), joint("hinge", "base", "0 1 0"))
    with pytest.raises(crosscheck.SceneError, match="--balance"):
        imported(tmp_path, text)
    scene = imported(tmp_path, text, balance=True)
    np.testing.assert_allclose(scene.inertias[0], 0.15 / 3 * np.eye(3) if "-" not in moments else 0.06 * np.eye(3),
                               atol=1e-12)
    assert "each is replaced by their mean" in scene.left_out[0].what


@pytest.mark.parametrize(("before", "after"), [
    ('\n<?xml version="1.0"?>', ""), ('<!-- a -->\n<!-- b --><?xml version="1.0"?>', "\0\n"),
    ('<?xml version="1.0"?>', "\0"), ("<!-- a -->\n" * 60, "")])
def test_what_stands_before_a_model_and_after_the_end_says_nothing(tmp_path, before, after):
    text = robot(link("hinge", BODY), joint("hinge", "base", "0 1 0"))
    assert imported(tmp_path, f"{before}{text}{after}").hash == imported(tmp_path, text).hash


def test_the_class_of_all_may_have_a_name_and_a_range_that_no_ball_has(tmp_path):
    inertial = '<inertial pos="0 0 -1" mass="1" diaginertia=".1 .1 .1"/>'
    text = ('<mujoco><default class="all"><joint range="-.5 .5" axis="0 1 0"/><default class="round"><joint '
            'type="ball"/></default></default><worldbody><body childclass="all"><joint name="hinge"/>' + inertial +
            '<body pos="0 0 -1"><joint name="ball" class="round"/>' + inertial + '</body></body></worldbody></mujoco>')
    with pytest.raises(crosscheck.SceneError, match="the attribute range of <joint> 'ball'"):
        imported(tmp_path, text)
    scene = imported(tmp_path, text, drop=True)
    assert [each.type for each in scene.joints] == ["revolute", "spherical"]
    assert scene.hash == imported(tmp_path, text.replace('="all"', '="main"'), drop=True).hash
    assert [monitor.joint for monitor in scene.monitors] == ["hinge"]


def test_a_model_attached_from_beside_the_file_comes_in_and_its_words_are_named(tmp_path):
    arm = ('<mujoco model="arm"><worldbody><body name="a"><joint name="j" axis="0 1 0"{}/><inertial pos="0 0 -1" '
           'mass="1" diaginertia=".1 .1 .1"/></body></worldbody></mujoco>')
    whole = ('<mujoco><asset><model name="m" file="arm.xml"/></asset><worldbody><attach model="m" body="a" prefix="x"/>'
             "</worldbody></mujoco>")
    (tmp_path / "arm.xml").write_text(arm.format(""))
    assert [joint.name for joint in imported(tmp_path, whole).joints] == ["xj"]
    (tmp_path / "arm.xml").write_text(arm.format(' springyield="1"'))
    with pytest.raises(crosscheck.SceneError, match="springyield of <joint>"):
        imported(tmp_path, whole)
    (tmp_path / "arm.xml").write_text('<mujoco><asset><model name="m" file="../far.xml"/></asset></mujoco>')
    with pytest.raises(crosscheck.SceneError, match="outside its folder"):
        imported(tmp_path, whole)


def test_files_beside_the_folder_are_read_within_one_above_both(tmp_path):
    (tmp_path / "a").mkdir()
    (tmp_path / "arm.xml").write_text('<mujoco><worldbody><body name="a"><joint name="j"/><inertial pos="0 0 -1" '
                                      'mass="1" diaginertia=".1 .1 .1"/></body></worldbody></mujoco>')
    with pytest.raises(crosscheck.SceneError, match="give --within FOLDER"):
        imported(tmp_path / "a", '<mujoco><include file="../arm.xml"/></mujoco>')
    assert imported(tmp_path / "a", '<mujoco><include file="../arm.xml"/></mujoco>', within=tmp_path).n == 1
    with pytest.raises(crosscheck.SceneError, match="outside its folder"):
        imported(tmp_path / "a", '<mujoco><include file="../../arm.xml"/></mujoco>', within=tmp_path)


@pytest.mark.parametrize(("place", "moved"), [("", True), (' pos="0 0 1"', False)])
def test_global_coordinates_are_those_of_frames_that_are_the_world_s(tmp_path, place, moved):
    rod = '<geom type="capsule" size=".05" contype="0" conaffinity="0" fromto='
    text = (f'<mujoco><compiler coordinate="global"/><worldbody><body><joint pos="0 0 1" axis="0 1 0"/>{rod}"0 0 1 0 0 '
            f'0"/><body{place}><joint pos="0 0 0" axis="0 1 0"/>{rod}"0 0 0 0 0 -1"/></body></body>'
            "</worldbody></mujoco>")
    if moved:
        local = imported(tmp_path, text.replace(' coordinate="global"', ""))
        assert imported(tmp_path, text).hash == local.hash
    else:
        with pytest.raises(crosscheck.SceneError, match="global coordinates"):
            imported(tmp_path, text)


def test_a_mesh_that_a_mass_needs_is_taken_from_beside_the_model_and_named(tmp_path):
    """From where its path says it is none, and where two files have its name neither is taken."""
    text = ('<mujoco><asset><mesh name="m" file="{}/m.obj"/></asset><worldbody><body name="b"><joint axis="1 2 0"/>'
            '<geom type="mesh" mesh="m"/></body></worldbody></mujoco>')
    obj = "v 0 0 0\nv 1 0 0\nv 0 2 0\nv 0 0 3\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"
    (tmp_path / "parts").mkdir()
    (tmp_path / "parts" / "m.obj").write_text(obj)
    right, moved = (imported(tmp_path, text.format(folder)) for folder in ("parts", "no/such"))
    assert right.hash == moved.hash
    assert moved.left_out == (
        ("", "the mesh no/such/m.obj, which is not at its path: taken from parts/m.obj", ""),)
    (tmp_path / "m.obj").write_text(obj)
    with pytest.raises(crosscheck.SceneError, match=r"from the mesh no/such/m\.obj, which is missing"):
        imported(tmp_path, text.format("no/such"))


def test_a_mesh_that_cannot_be_read_is_named_where_no_mass_is_of_it(tmp_path):
    (tmp_path / "m.stl").write_text("solid words\n")
    text = ('<mujoco><asset><mesh name="m" file="m.stl"/></asset><worldbody><body><joint/><geom type="mesh" mesh="m"/>'
            '{}</body></worldbody></mujoco>')
    inertial = '<inertial pos="0 0 -1" mass="1" diaginertia=".1 .1 .1"/>'
    left_out = imported(tmp_path, text.format(inertial), drop=True).left_out
    assert "<mesh> 'm' (line 1), which MuJoCo refuses" in left_out[0].what
    with pytest.raises(crosscheck.SceneError, match="which MuJoCo refuses; put it beside"):
        imported(tmp_path, text.format(""))


def test_shapes_that_are_too_many_to_watch_are_counted(tmp_path):
    text = ('<mujoco><worldbody><replicate count="320" offset="1 0 0"><body><freejoint/><geom size=".1"/></body>'
            "</replicate></worldbody></mujoco>")
    with pytest.raises(crosscheck.SceneError, match="contacts of the 51040 pairs of shapes"):
        imported(tmp_path, text)
    assert imported(tmp_path, text, contacts="drop").n == 320
