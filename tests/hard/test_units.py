"""The units of length, mass and time are the user's choice: scaled by powers of two, runs agree to rounding."""

import dataclasses

import numpy as np
import pytest

import crosscheck
import lieeuler
from crosscheck.engines.lieeuler import build_problem
from crosscheck.scene import Scene
from tests.hard.methods import FIXED

POWERS = ((2.0**10, 1.0, 1.0), (2.0**-10, 1.0, 1.0), (1.0, 2.0**10, 1.0), (1.0, 2.0**-10, 1.0), (1.0, 1.0, 2.0**10),
          (1.0, 1.0, 2.0**-10), (2.0**-10, 2.0**20, 2.0**-5))

AGREEMENT = 1e-11
"""Iterations may end at another rounding, some 1e-15 a step; 200 steps add up and the pendulum magnifies tenfold."""


def in_other_units(scene: Scene, length: float, mass: float, time: float) -> Scene:
    """The same system, with numbers for units that are smaller by these factors."""
    bodies = tuple(dataclasses.replace(
        body, mass=body.mass * mass, inertia=body.inertia * mass * length**2, position=body.position * length,
        velocity=body.velocity * length / time, angular_velocity=body.angular_velocity / time) for body in scene.bodies)
    joints = tuple(dataclasses.replace(
        joint, parent_anchor=joint.parent_anchor * length, child_anchor=joint.child_anchor * length,
        length=None if joint.length is None else joint.length * length) for joint in scene.joints)
    assert not scene.forces
    return scene.replace(bodies=bodies, joints=joints, gravity=scene.gravity * length / time**2,
                         duration=scene.duration * time)


@pytest.mark.parametrize("method", FIXED)
@pytest.mark.parametrize(("name", "duration"), [("double_pendulum", 0.2), ("four_bar", 0.02)])
def test_results_do_not_depend_on_units(name, duration, method):
    scene = crosscheck.load_scene(name).replace(duration=duration, samples=3)
    gains = {"alpha": 10.0, "beta": 10.0} if method == "BAUMGARTE_LE" else {}
    here = lieeuler.integrate(build_problem(scene), method, 1e-3, scene.t, **gains)
    for units in POWERS:
        length, _, time = units
        scaled = in_other_units(scene, *units)
        scaled_gains = {key: value / time for key, value in gains.items()}
        there = lieeuler.integrate(build_problem(scaled), method, 1e-3 * time, scaled.t, **scaled_gains)
        assert there.stats.steps == here.stats.steps
        assert np.abs(there.x / length - here.x).max() < AGREEMENT, units
        assert np.abs(there.R - here.R).max() < AGREEMENT, units
        assert np.abs(there.w * time - here.w).max() < AGREEMENT * np.abs(here.w).max(), units
