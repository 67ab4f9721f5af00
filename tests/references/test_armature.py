"""Armature and mimics in both formulations of the truth: trees, and loops that have a joint without them to be cut."""

import dataclasses

import pytest

import crosscheck
from crosscheck import references


def geared(name, armatures):
    scene = crosscheck.load_scene(name).replace(duration=0.4, samples=4)
    joints = (dataclasses.replace(joint, armature=(value,) if value else ())
              for joint, value in zip(scene.joints, armatures, strict=True))
    return scene.replace(joints=tuple(joints))


@pytest.mark.parametrize(("name", "armatures"), [
    ("four_bar", (0.05, 0.02, 0.03, 0)),
    ("four_bar", (0, 0.02, 0.03, 0.04)), ("slider_crank", (0.05, 0.01, 0, 0.2))])
def test_formulations_agree_on_loops_with_redundant_rows(name, armatures):
    found = references.compute(geared(name, armatures))
    assert found.disagreement < found.allowed


@pytest.mark.parametrize("name", ["geared_arm", "coupled_arm"])
def test_formulations_agree_on_slides_and_cylinders(name):
    found = references.compute(crosscheck.load_scene(name))
    assert found.disagreement < found.allowed


def test_a_loop_of_rotors_alone_is_refused():
    words = r"armature, mimics and laws of joint '.*' are not built where every joint"
    with pytest.raises(crosscheck.Unsupported, match=words):
        crosscheck.truth(geared("four_bar", (0.1, 0.1, 0.1, 0.1)))
