"""Scenes as MJCF and URDF: reading them back gives the scene to rounding, and what has no place is named."""

import numpy as np
import pytest

import crosscheck
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
