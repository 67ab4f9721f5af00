"""The key of a system and the hash of a scene: what counts, what does not, and that no altered scene keeps its own."""

from __future__ import annotations

import copy
import dataclasses
import pickle

import numpy as np
import pytest

import crosscheck
from crosscheck.scene import model
from crosscheck.scene.functions import TimeFunction
from crosscheck.scene.laws import DryFriction, Limits
from crosscheck.scene.model import Mimic

OTHER = {  # another value of each field that has none in the scenes below
    "mimic": Mimic("other", 2.0), "drive": TimeFunction(terms=((0.1, 2.0, 0.0),)), "reference": [0.0, 1.0, 0.0, 0.0],
    "start": (-0.2,), "armature": (0.3,), "damping": (0.3,), "stiffness": (0.4,), "rest_position": (0.2,),
    "length": 2.0, "radius": 2.0, "parent_axis": [0.0, 1.0, 0.0], "child_axis": [0.0, 1.0, 0.0], "joint": "other",
    "dry_friction": (DryFriction(0.5, 0.5),), "limits": (Limits(-1.0),)}


@pytest.fixture(scope="module")
def scene():
    return crosscheck.load_scene("torsion_wheel")


def changed(name, value):
    if name in OTHER:
        return OTHER[name]
    if value is None:  # a body
        return 0
    if isinstance(value, str):
        return value + " 2"
    if isinstance(value, model.Mapping):
        return {**value, "stiffness": 1.25 * value["stiffness"]}
    return 1.0 + np.asarray(value) if isinstance(value, np.ndarray) else value + 1


def fields():
    return [(kind, field.name) for kind in ("bodies", "joints", "forces")
            for field in dataclasses.fields({"bodies": model.Body, "joints": model.Joint, "forces": model.Force}[kind])]


@pytest.mark.parametrize(("kind", "name"), [each for each in fields() if each != ("bodies", "origin")])
def test_every_field_counts(scene, kind, name):
    first, *rest = getattr(scene, kind)
    other = dataclasses.replace(first, **{name: changed(name, getattr(first, name))})
    assert scene.replace(**{kind: (other, *rest)}).key != scene.key


def test_the_origin_of_a_models_frame_does_not_count(scene):
    first, *rest = scene.bodies
    moved = dataclasses.replace(first, origin=first.origin + 0.1)
    assert scene.replace(bodies=(moved, *rest)).key == scene.key


def test_two_starts_of_a_joint_are_two_systems(scene):
    """Joint positions of 0 and -.2 had one hash."""
    joint = scene.joints[0]
    starts = [scene.replace(joints=(dataclasses.replace(joint, start=(at,)), *scene.joints[1:])) for at in (0.0, -0.2)]
    assert len({each.hash for each in starts}) == 2


def test_what_the_motion_does_not_depend_on_does_not_count(scene):
    assert scene.replace(name="x", description="x", source="x", tags=("x",), left_out=("x",)).hash == scene.hash
    longer = scene.replace(duration=2 * scene.duration, samples=7)
    assert longer.key == scene.key
    assert longer.hash != scene.hash
    assert scene.replace(gravity=[0.0, 0.0, -1.0]).key != scene.key


def test_nothing_of_a_scene_can_be_written_to(scene):
    arrays = [scene.gravity, scene.masses, scene.inertias, scene.x0, scene.R0, scene.v0, scene.w0,
              scene.bodies[0].inertia, scene.joints[0].parent_anchor]
    for shown in (scene, pickle.loads(pickle.dumps(scene)), copy.deepcopy(scene)):
        assert shown.hash == scene.hash
        for array in (*arrays, shown.bodies[0].inertia):
            with pytest.raises(ValueError, match="WRITEABLE"):
                array.setflags(write=True)
        with pytest.raises(TypeError):
            shown.forces[0].parameters["stiffness"] = 0.0


def test_a_scene_that_is_altered_by_force_has_another_key(scene):
    altered = copy.deepcopy(scene)
    assert altered.hash == scene.hash
    object.__setattr__(altered.bodies[0], "mass", 2.0 * altered.bodies[0].mass)
    assert altered.hash != scene.hash
    assert altered.key != scene.key
