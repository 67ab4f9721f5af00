"""The units of length, mass and time are the user's choice: scaled by powers of two, runs agree to rounding.

Powers of two change no digit of any number, so that a run in other units can differ only where a threshold has units.
"""

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

TINY_TO_HUGE = tuple((2.0**power, 1.0, 1.0) for power in (-10, -5, 5, 10))
"""Lengths from a millimetre to a kilometre."""

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


def adaptive(scene, method, units=(1.0, 1.0, 1.0)):
    """An adaptive run of the scene in other units, back in the first ones: x, R, w, and the number of steps."""
    length, _, time = units
    scaled = in_other_units(scene, *units)
    found = lieeuler.integrate(build_problem(scaled), method, t_eval=scaled.t, rtol=1e-8)
    return found.x / length, found.R, found.w * time, found.stats.steps


@pytest.mark.parametrize(("name", "duration"), [("double_pendulum", 1.0), ("four_bar", 0.05)])
def test_taylor_does_not_depend_on_units(name, duration):
    scene = crosscheck.load_scene(name).replace(duration=duration, samples=3)
    here = adaptive(scene, "taylor")
    for units in POWERS:
        there = adaptive(scene, "taylor", units)
        assert there[3] == here[3]
        for one, other in zip(here[:3], there[:3], strict=True):
            assert np.abs(other - one).max() < AGREEMENT * max(1.0, np.abs(one).max()), units


@pytest.mark.parametrize("method", ["rkmk54", "rkmk853", "seulex"])
def test_masses_have_no_unit_in_adaptive_methods(method):
    """Errors are weighed per length and rate: masses cancel to the last bit."""
    scene = crosscheck.load_scene("double_pendulum").replace(duration=0.5, samples=3)
    here = adaptive(scene, method)
    for mass in (2.0**20, 2.0**-20):
        there = adaptive(scene, method, (1.0, mass, 1.0))
        assert there[3] == here[3]
        for one, other in zip(here[:3], there[:3], strict=True):
            np.testing.assert_array_equal(other, one)


@pytest.mark.parametrize("method", ["rkmk54", "rkmk853", "seulex"])
def test_errors_of_adaptive_methods_stay_within_tolerance_in_any_unit(method):
    """Step control of these weighs rates below 1 rad/s as such: they differ with the unit of time, by their tolerance.
    """
    scene = crosscheck.load_scene("double_pendulum").replace(duration=0.5, samples=3)
    exact = lieeuler.integrate(build_problem(scene), "taylor", t_eval=scene.t, rtol=1e-13)
    for units in POWERS + TINY_TO_HUGE:
        x, R, *_ = adaptive(scene, method, units)
        # a dozen steps, each of which may be off by the tolerance, in a motion that magnifies about tenfold
        assert np.abs(x - exact.x).max() < 1e-8 * 12 * 10, units
        assert np.abs(R - exact.R).max() < 1e-8 * 12 * 10, units
