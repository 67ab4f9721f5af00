"""Scenes as MJCF and URDF: reading them back gives the scene to rounding, and anything without a place is named."""

import dataclasses

import numpy as np
import pytest

import crosscheck
from crosscheck.scene.coordinates import at_start
from crosscheck.scene.functions import sine
from crosscheck.scene.mechanics import index1
from crosscheck.scene.model import Force, Sensor, Site
from tests.scene.models.model_files import ARM_URDF, ZOO
from tests.scene.test_coordinates import body, joint, load

ROUNDING = 1e-13  # a dozen products of terms of a few metres


def same(one, other, names=True):
    assert one.n == other.n
    order = [[each.name for each in other.bodies].index(each.name) for each in one.bodies]
    for field in ("masses", "inertias", "x0", "R0", "v0", "w0"):
        np.testing.assert_allclose(getattr(one, field), getattr(other, field)[order], rtol=0, atol=ROUNDING)
    mine, theirs = (crosscheck.run(scene, "lieeuler", "taylor", rtol=1e-13, duration=0.5, samples=3).x
                    for scene in (one, other))
    np.testing.assert_allclose(mine, theirs[:, order], rtol=0, atol=1e-11)


@pytest.mark.parametrize("name", ["single_pendulum", "double_pendulum", "heavy_top", "universal_pendulum",
                                  "cylindrical_pendulum", "planar_slider", "prismatic_slider", "chain_8",
                                  "torsion_wheel"])
def test_mjcf_there_and_back(name, tmp_path):
    scene, path = crosscheck.load_scene(name), tmp_path / "robot.xml"
    crosscheck.export_model(scene, path)
    same(scene, crosscheck.import_model(path, keyframe="start", drop=False))


LOOPS = ("bricard", "double_four_bar", "driven_slider_crank", "four_bar", "iftomm_slider_crank", "parallelogram",
         "slider_crank", "squeezer")
NOT_MJCF = dict.fromkeys(LOOPS, "closes a loop") | {
    "bead_on_line": "joint 'wire' of type point_on_line", "puck_on_plane": "joint 'plane' of type point_on_plane",
    "chaplygin_sleigh": "of type knife_edge", "rolling_ball": "of type rolling_sphere",
    "rolling_disk": "of type rolling_disk", "wobbling_disk": "of type rolling_disk", "bicycle": "of type rolling_disk",
    "iftomm_simple_pendulum": "of type distance", "rod_pendulum": "of type distance",
    "driven_cart": "a joint_force", "driven_double_pendulum": "a joint_torque", "loaded_pendulum": "a constant_force"}
WELDED = {"branching_tree", "fixed_pair"}
"""Scenes with a fixed joint, whose two bodies an import makes one."""


@pytest.mark.parametrize("name", crosscheck.scenes())
def test_every_scene_of_the_library_goes_through_mjcf_or_is_refused_by_name(name, tmp_path):
    scene, path = crosscheck.load_scene(name), tmp_path / "robot.xml"
    if name in NOT_MJCF:
        with pytest.raises(crosscheck.SceneError, match=NOT_MJCF[name]):
            crosscheck.export_model(scene, path)
        return
    crosscheck.export_model(scene, path)
    again = crosscheck.import_model(path, keyframe="start")
    order = [[each.name for each in again.bodies].index(each.name) for each in scene.bodies
             if each.name not in {scene.bodies[each.child].name for each in scene.joints if each.type == "fixed"}]
    ours, theirs = arrays(scene), [values[order] for values in arrays(again)]
    for one, other in zip(ours, theirs, strict=True):
        np.testing.assert_allclose(one, other, rtol=ROUNDING, atol=ROUNDING)
    kept = {each.name: each for each in again.joints}
    assert kept.keys() == {each.name for each in scene.joints if each.type != "fixed"}
    for each in scene.joints:
        if each.name in kept:
            assert each.type == kept[each.name].type
    if name not in WELDED:
        stiff = 1 + sum(force.parameters.get("stiffness", 0.0) for force in scene.forces)
        least = min(scene.masses.min(), np.linalg.eigvalsh(scene.inertias).min())
        for one, other in zip(accelerations(scene), accelerations(again), strict=True):
            # every force is rounded, that of a spring by the rounding of its length, and acts on the least inertia
            np.testing.assert_allclose(one, other[order], rtol=ROUNDING, atol=ROUNDING * max(1, stiff / least))


def accelerations(scene):
    a, alpha, _ = index1(scene, scene.x0[None], scene.R0[None], scene.v0[None], scene.w0[None])
    return a[0], alpha[0]


def arrays(scene):
    """Masses, centres, inertias about these, attitudes and velocities of the rigid parts: bodies fixed to one another
    are one, with the axes of the parent."""
    parts = {k: [k] for k in range(scene.n)}
    for fixed in (each for each in scene.joints if each.type == "fixed"):
        parts[fixed.parent] += parts.pop(fixed.child)
    rows = []
    for first, members in parts.items():
        m = scene.masses[members]
        centre = m @ scene.x0[members] / m.sum()
        J = np.zeros((3, 3))
        for k, mass in zip(members, m, strict=True):
            turn, arm = scene.R0[first].T @ scene.R0[k], scene.R0[first].T @ (scene.x0[k] - centre)
            J += turn @ scene.inertias[k] @ turn.T + mass * (arm @ arm * np.eye(3) - np.outer(arm, arm))
        rows.append((m.sum(), centre, J, scene.R0[first], m @ scene.v0[members] / m.sum(), scene.w0[first]))
    return [np.array(column) for column in zip(*rows, strict=True)]


def test_every_scene_of_the_library_that_a_urdf_holds_goes_through_one(tmp_path):
    held, path = [], tmp_path / "robot.urdf"
    for name in crosscheck.scenes():
        scene = crosscheck.load_scene(name)
        try:
            crosscheck.export_model(scene, path)
        except crosscheck.SceneError:
            continue
        held.append(name)
        start = at_start(scene)
        order = [each.name for each in crosscheck.import_model(path, drop=True).joints]
        q, v = ([value for each in order for value in start[each][k]] for k in (0, 1))
        again = crosscheck.import_model(path, drop=True, qpos=q, qvel=v)
        for one, other in zip(arrays(scene), arrays(again), strict=True):
            np.testing.assert_allclose(one, other, rtol=ROUNDING, atol=ROUNDING)
    # the others have balls, springs between points, loops or another gravity
    assert held == ["coupled_arm", "hinge_pendulum"]


def test_an_imported_model_goes_there_and_back(tmp_path):
    (tmp_path / "zoo.xml").write_text(ZOO.replace(' gravcomp="0.5"', ""))
    scene = crosscheck.import_model(tmp_path / "zoo.xml")
    crosscheck.export_model(scene, tmp_path / "again.xml")
    again = crosscheck.import_model(tmp_path / "again.xml", keyframe="start")
    assert sorted(each.type for each in again.joints) == sorted(each.type for each in scene.joints)
    same(scene, again)


def test_urdf_there_and_back(tmp_path):
    (tmp_path / "arm.urdf").write_text(ARM_URDF)
    start = {"qpos": [0.3, -0.4, 0.1], "qvel": [0.5, 0.2, -0.3]}
    scene = crosscheck.import_model(tmp_path / "arm.urdf", drop=True, **start)
    crosscheck.export_model(scene, tmp_path / "again.urdf")
    same(scene, crosscheck.import_model(tmp_path / "again.urdf", **start))
    assert crosscheck.inspect(tmp_path / "again.urdf", ["mujoco"]).agree


def test_one_robot_through_both_formats_is_one_motion(tmp_path):
    (tmp_path / "arm.urdf").write_text(ARM_URDF)
    scene = crosscheck.import_model(tmp_path / "arm.urdf", drop=True)
    crosscheck.export_model(scene, tmp_path / "arm.xml")
    same(scene, crosscheck.import_model(tmp_path / "arm.xml"))


@pytest.mark.parametrize(("scene", "suffix", "words"), [
    ("single_pendulum", ".urdf", "joint 'pivot' of type spherical"), ("four_bar", ".urdf", "closes a loop"),
    ("four_bar", ".xml", "closes a loop"), ("bead_on_line", ".xml", "of type point_on_line")])
def test_what_a_format_cannot_hold_is_named(scene, suffix, words, tmp_path):
    with pytest.raises(crosscheck.SceneError, match=words):
        crosscheck.export_model(scene, tmp_path / f"robot{suffix}")
    assert not list(tmp_path.iterdir())


def test_a_urdf_holds_no_armature(tmp_path):
    scene = load(tmp_path, [body("a")], [joint("revolute", np.random.default_rng(1), position=0.1, armature=0.2)])
    with pytest.raises(crosscheck.SceneError, match="armature of joint 'on ground'"):
        crosscheck.export_model(scene, tmp_path / "robot.urdf")
    crosscheck.export_model(scene, tmp_path / "robot.xml")
    assert crosscheck.import_model(tmp_path / "robot.xml").joints[0].armature == (0.2,)


@pytest.mark.parametrize("ending", [".xml", ".urdf"])
@pytest.mark.parametrize("given", ["drive", "rest_angle"])
def test_functions_of_time_are_refused(given, ending, tmp_path):
    scene = crosscheck.load_scene("driven_double_pendulum")
    turning = sine([(0.1, 2.0, 0.0)])
    if given == "drive":
        driven = dataclasses.replace(scene.joints[0], drive=turning)
        scene = scene.replace(forces=(), joints=(driven, *scene.joints[1:]))
    else:
        spring = {"stiffness": 1.0, "damping": 0.0, "rest_angle": turning}
        scene = scene.replace(forces=(Force("torsional_spring", None, None, scene.joints[0].name, spring),))
    with pytest.raises(crosscheck.SceneError, match=r"cannot hold (the drive|forces)"):
        crosscheck.export_model(scene, tmp_path / f"robot{ending}")


def test_what_changes_no_motion_and_is_left_out_is_named(tmp_path):
    scene = crosscheck.load_scene("hinge_pendulum").replace(
        sites=(Site("tip", 0, (0.0, 0.0, -0.1), (1.0, 0.0, 0.0, 0.0)),),
        sensors=(Sensor("turned", "joint_position", joint="hinge"),))
    for ending in (".xml", ".urdf"):
        assert crosscheck.export_model(scene, tmp_path / f"model{ending}") == ("site 'tip'", "sensor 'turned'")
