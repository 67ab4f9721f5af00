"""The units of length, mass and time are the user's choice: in others runs take the same steps and agree to rounding.

Powers of two change no digit of any number, so that a run in other units can differ only where a threshold has units;
millimetres, kilometres and milliseconds round every number anew.
"""

import dataclasses

import numpy as np
import pytest

import crosscheck
import lieeuler
from crosscheck.adapters.lieeuler import build_problem
from crosscheck.scene.model import Force, Scene
from tests.hard.methods import FIXED

POWERS = ((2.0**10, 1.0, 1.0), (2.0**-10, 1.0, 1.0), (1.0, 2.0**10, 1.0), (1.0, 2.0**-10, 1.0), (1.0, 1.0, 2.0**10),
          (1.0, 1.0, 2.0**-10), (2.0**-10, 2.0**20, 2.0**-5))

DECIMAL = ((1e3, 1.0, 1.0), (1e-3, 1.0, 1.0), (1.0, 1e3, 1.0), (1.0, 1.0, 1e3), (1e3, 1e-3, 1e3))
"""mm; km; g; ms; and mm, t, ms, as structural engineers like them."""

AGREEMENT = 1e-11
"""Iterations may end at another rounding, some 1e-15 a step; 200 steps add up and the pendulum magnifies tenfold."""

SCENES = (("double_pendulum", 0.2), ("heavy_top", 0.05), ("stiff_spring", 0.1), ("torsion_wheel", 0.2))
"""Joints at rest, a fast body, dormant rates of 1000 rad/s, a light spring without a length; and s of them."""

ADAPTIVE = tuple(name for name, method in lieeuler.METHODS.items() if "rtol" in method.controls)

TOUCHY = ("stiff_spring", "seulex")
"""One rounding more or less in the initial position alone makes 29 steps 40: its error estimates on an undamped spring
are those of an oscillation by several turns a step."""


def in_other_units(scene: Scene, length: float, mass: float, time: float) -> Scene:
    """The same system, with numbers for units that are smaller by these factors."""
    bodies = tuple(dataclasses.replace(
        body, mass=body.mass * mass, inertia=body.inertia * mass * length**2, position=body.position * length,
        velocity=body.velocity * length / time, angular_velocity=body.angular_velocity / time) for body in scene.bodies)
    joints = tuple(dataclasses.replace(
        joint, parent_anchor=joint.parent_anchor * length, child_anchor=joint.child_anchor * length,
        length=None if joint.length is None else joint.length * length) for joint in scene.joints)
    return scene.replace(bodies=bodies, joints=joints, gravity=scene.gravity * length / time**2,
                         forces=tuple(_force(force, length, mass, time) for force in scene.forces),
                         duration=scene.duration * time)


def _force(force: Force, length: float, mass: float, time: float) -> Force:
    stiffness = mass / time**2 * (length**2 if force.type == "torsional_spring" else 1.0)
    factors = {"parent_point": length, "child_point": length, "free_length": length, "rest_angle": 1.0,
               "stiffness": stiffness, "damping": stiffness * time}
    return dataclasses.replace(force, parameters={
        name: np.asarray(value) * factors[name] if np.ndim(value) else value * factors[name]
        for name, value in force.parameters.items()})


def run(scene, method, units=(1.0, 1.0, 1.0), step=None):
    """A run of the scene in other units; x, R and w back in the first ones, each as a part of its largest."""
    length, _, time = units
    scaled = in_other_units(scene, *units)
    gains = {"alpha": 10.0 / time, "beta": 10.0 / time} if method == "BAUMGARTE_LE" else {}
    control = {"rtol": 1e-8} if step is None else {"step": step * time}
    found = lieeuler.integrate(build_problem(scaled), method, t_eval=scaled.t, **control, **gains)
    return (found.x / length, found.R, found.w * time), found.stats


def assert_same_run(scene, method, units, step=None):
    here, work = run(scene, method, step=step)
    there, same_work = run(scene, method, units, step)
    assert (same_work.steps, same_work.rejected_steps) == (work.steps, work.rejected_steps), units
    for one, other in zip(here, there, strict=True):
        assert np.abs(other - one).max() < AGREEMENT * max(1.0, np.abs(one).max()), units
    return work, same_work


@pytest.mark.parametrize("method", FIXED)
@pytest.mark.parametrize(("name", "duration"), [*SCENES, ("four_bar", 0.02)])
def test_results_do_not_depend_on_units(name, duration, method):
    scene = crosscheck.load_scene(name).replace(duration=duration, samples=3)
    for units in POWERS:
        work, same_work = assert_same_run(scene, method, units, step=1e-3)
        assert same_work.newton_iterations == work.newton_iterations, units
    for units in DECIMAL:
        assert_same_run(scene, method, units, step=1e-3)


@pytest.mark.parametrize("method", ADAPTIVE)
@pytest.mark.parametrize(("name", "duration"), [*SCENES, ("four_bar", 0.05)])
def test_steps_of_adaptive_methods_do_not_depend_on_units(name, duration, method):
    scene = crosscheck.load_scene(name).replace(duration=duration, samples=3)
    for units in POWERS + DECIMAL:
        if units in DECIMAL and (name, method) == TOUCHY:
            continue
        assert_same_run(scene, method, units)


@pytest.mark.parametrize("method", ["rkmk54", "rkmk853", "seulex"])
def test_masses_have_no_unit_in_adaptive_methods(method):
    """Errors are weighed per length and rate: masses cancel to the last bit."""
    scene = crosscheck.load_scene("double_pendulum").replace(duration=0.5, samples=3)
    here, work = run(scene, method)
    for mass in (2.0**20, 2.0**-20):
        there, same_work = run(scene, method, (1.0, mass, 1.0))
        assert same_work.steps == work.steps
        for one, other in zip(here, there, strict=True):
            np.testing.assert_array_equal(other, one)


@pytest.mark.parametrize("length", [1e-6, 1e6])
def test_the_initial_state_is_judged_by_the_size_of_the_system(length):
    """A joint open by a part of 1e-7 of the system is refused in any unit, one of 1e-9 is not."""
    joint = lieeuler.spherical_joint(-1, 0, [0, 0, 0], [0, 0, length])
    body = lieeuler.Body(1.0, np.diag([0.1, 0.2, 0.15]) * length**2)
    def problem(gap, speed):
        return lieeuler.Problem([body], [joint], [0, 0, -9.81 * length], [[0, 0, -length * (1 + gap)]], [np.eye(3)],
                                [[length * speed, 0, 0]], [[0, 0, 0]])

    problem(1e-9, 1e-9)
    with pytest.raises(lieeuler.ArgumentError, match="violates the joints"):
        problem(1e-7, 0)
    with pytest.raises(lieeuler.ArgumentError, match="violates the velocity constraints"):
        problem(0, 1e-7)


@pytest.mark.parametrize("method", lieeuler.METHODS)
def test_a_system_without_any_rate_rests(method):
    """Nothing pulls at it and nothing moves: no rate there is to be relative to."""
    body = lieeuler.Body(2.0, np.diag([0.1, 0.2, 0.15]))
    problem = lieeuler.Problem([body], [], [0, 0, 0], [[0, 0, 0]], [np.eye(3)], [[0, 0, 0]], [[0, 0, 0]])
    control = {"step": 0.1} if "step" in lieeuler.METHODS[method].controls else {}
    solution = lieeuler.integrate(problem, method, t_eval=[0, 0.5, 1.0], **control)
    assert not solution.x.any()
    np.testing.assert_array_equal(solution.R, np.broadcast_to(np.eye(3), solution.R.shape))
