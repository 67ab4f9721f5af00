"""Runs that hardly converge have no limit, and what fits their noise is no cause."""

import dataclasses

import numpy as np
import pytest

from crosscheck.diagnosis import of_joints
from crosscheck.diagnosis.copies import ObservedCopy
from crosscheck.diagnosis.observe import Observation, scale_of, true_motion, window
from crosscheck.scene.file import load_scene

NOISE = 1e-2


@pytest.fixture(scope="module")
def seen():
    scene = load_scene("double_pendulum")
    scale = scale_of(scene)
    scene = window(scene, scale)
    states = true_motion(scene)
    return ObservedCopy(Observation(scene, scale, scale.flat(states), NOISE, None), states,
                 np.zeros((len(states.t) - 8, 2, 6)), NOISE, ())


def opened(seen, by):
    """The same with velocities of the lower body that open its joint, (T, 3) m/s."""
    v = seen.states.v.copy()
    v[:, 1] += by
    return dataclasses.replace(seen, states=dataclasses.replace(seen.states, v=v))


def as_from(seen, d):
    """Velocities (T, 3) of the lower body that open its joint as an anchor does that is off by d (m)."""
    return -np.einsum("tij,tj->ti", seen.states.R[:, 1], np.cross(seen.states.w[:, 1], d))


def test_a_joint_that_opens_by_little_more_than_its_noise_has_no_other_anchors(seen):
    """Newton's SemiImplicit on an arm: joints of springs, whose openings look in part like those of other anchors."""
    scale, t = seen.observation.scale, seen.states.t
    noise = 10 * NOISE * scale.length * scale.rate
    part, waves = as_from(seen, np.array([1.0, 0.0, 0.0])), np.sin(np.outer(scale.rate * t, (9.0, 12.0, 15.0)))
    opening = 0.7 * part / np.abs(part).max() + 0.5 * waves / np.abs(waves).max()
    before, found = of_joints.fitted_anchors([opened(seen, 1.1 * noise * opening / np.abs(opening).max())], 1)
    assert before == pytest.approx(1.1)
    assert found is None


@pytest.mark.parametrize("times", [3.0, 300.0])
def test_anchors_that_are_elsewhere_are_found_from_a_few_times_the_noise_on(seen, times):
    scale = seen.observation.scale
    d = np.array([times * 10 * NOISE * scale.length, 0.0, 0.0])
    before, found = of_joints.fitted_anchors([opened(seen, as_from(seen, d))], 1)
    assert before > 1.0
    assert list(found) == ["child_anchor"]
    assert np.abs(as_from(seen, found["child_anchor"] - d)).max() < 1e-6
