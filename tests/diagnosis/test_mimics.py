"""Wrong mimics are named, and nothing is named where mimics are right."""

import dataclasses

import numpy as np
import pytest

import crosscheck
from crosscheck import adapters
from crosscheck.diagnosis import explain
from tests import SCENARIOS
from tests.engines.stepper import Misbuilt

pytest.importorskip("pinocchio")


def arm():
    """The part of the scene that is an arm: its last joint follows none."""
    whole = crosscheck.load_scene("coupled_arm")
    return whole.replace(bodies=whole.bodies[:3], joints=whole.joints[:3])


def engine(alter, base="pinocchio"):
    """An engine with mimics that runs another scene."""
    made = Misbuilt(adapters.get(base), (alter,))
    made.elements = ("mimic",)
    return made


def with_mimics(change):
    """The scene with every mimic changed."""
    return lambda scene: scene.replace(joints=tuple(
        joint if joint.mimic is None else dataclasses.replace(joint, mimic=change(joint.mimic))
        for joint in scene.joints))


def ratio_times(factor):
    return with_mimics(lambda mimic: dataclasses.replace(mimic, ratio=factor * mimic.ratio))


@pytest.mark.parametrize(("change", "name", "words"), [
    (with_mimics(lambda mimic: None), "missing mimic", "joint 'elbow' does not follow joint 'base'"),
    (ratio_times(-1), "mimic sign", "with the ratio 2.5 in place of -2.5"),
    (ratio_times(1.001), "mimic ratio", "-2.5025 in place of -2.5"),
    (with_mimics(lambda mimic: dataclasses.replace(mimic, ratio=1 / mimic.ratio)), "mimic direction",
     "-0.4 in place of -2.5")])
def test_a_wrong_mimic_is_named(change, name, words):
    found = explain(arm(), engine(change))
    assert [cause.name for cause in found.causes] == [name], found.sentence
    assert words in found.causes[0].magnitude


def test_a_wrong_offset_is_named(tmp_path):
    path = tmp_path / "arm.toml"
    path.write_text((SCENARIOS / "coupled_arm.toml").read_text().replace("offset = 0.4", "offset = 0.42"))
    other = crosscheck.load_scene(path)
    found = explain("coupled_arm", engine(lambda scene: other.replace(duration=scene.duration, samples=scene.samples)))
    assert [cause.name for cause in found.causes] == ["mimic offset"], found.sentence
    assert "0.42 in place of 0.4" in found.causes[0].magnitude


@pytest.mark.parametrize("base", ["pinocchio", "lieeuler", "mujoco"])
def test_no_mimic_is_blamed_where_all_are_right(base):
    method = "RK4" if base == "mujoco" else None  # accelerations of discrete are changes of velocities over a step
    assert explain(arm(), engine(lambda scene: scene, base), method=method).outcome == "pass"


def test_no_mimic_is_blamed_for_a_wrong_mass():
    def heavier(scene):
        body = dataclasses.replace(scene.bodies[1], mass=1.2 * scene.bodies[1].mass)
        return scene.replace(bodies=(scene.bodies[0], body, *scene.bodies[2:]))

    found = explain(arm(), engine(heavier))
    assert found.outcome != "pass"
    assert not any("mimic" in cause.name for cause in found.causes), found.sentence
    assert not np.any(["mimic" in each.hypothesis and each.holds for each in found.evidence])
