"""Springs from soft to all but rigid, springs without length, and steps so short that only rounding is left."""

import numpy as np
import pytest

import crosscheck
import lieeuler
from crosscheck.adapters.lieeuler import build_problem
from crosscheck.scene.model import GROUND, Body, Force
from tests.hard.methods import FIXED
from tests.scene_making import make_scene

EPS = np.finfo(float).eps
SYMMETRIC = ("rattle2", "rattle4", "rattle6", "rattle8")


def on_a_spring(stiffness, stretch, free_length=1.0, mass=1.0, damping=0.0):
    """A body hung by its centre of mass, so that it moves up and down and nothing turns; stretch in m at the start."""
    body = Body("load", mass, np.diag([0.1, 0.2, 0.15]), np.array([1.0, 0.0, 0.0, 0.0]), np.zeros(3),
                np.array([0.0, 0.0, -free_length - stretch]), np.zeros(3))
    spring = Force("linear_spring", GROUND, 0, None, {
        "parent_point": (0.0, 0.0, 0.0), "child_point": (0.0, 0.0, 0.0), "stiffness": stiffness,
        "free_length": free_length, "damping": damping})
    return make_scene([body], [], forces=[spring], gravity=np.array([0.0, 0.0, -9.81]))


@pytest.mark.parametrize("stiffness", [1e3, 1e5, 1e7, 1e9])
@pytest.mark.parametrize("method", SYMMETRIC)
def test_a_load_on_a_spring_rings_at_its_frequency(method, stiffness):
    """Along its line the motion is that of one linear oscillator, which is known in closed form."""
    omega, rest = np.sqrt(stiffness), 9.81 / stiffness
    scene = on_a_spring(stiffness, 3 * rest)
    scene = scene.replace(duration=20.0 / omega, samples=21)
    per_radian = {"rattle2": 400, "rattle4": 20, "rattle6": 20, "rattle8": 10}[method]
    traj = crosscheck.run(scene, "lieeuler", method, step=1.0 / (omega * per_radian))
    exact = -1.0 - rest - 2 * rest * np.cos(omega * traj.t)
    # the phase of a method of order p lags by at most (omega h)^p over the 20 rad, as a share of the amplitude; a
    # length of 1 m carries a rounding each of up to 20 * per_radian steps besides
    order = int(method[-1])
    bound = 2 * rest * 20 * (1.0 / per_radian) ** order + 50 * EPS * 20 * per_radian * 20
    assert np.abs(traj.x[:, 0, 2] - exact).max() < bound


@pytest.mark.parametrize("method", [name for name in FIXED if name != "BAUMGARTE_LE"])
def test_a_spring_that_starts_without_length_does_no_harm(method):
    """It exerts no force at that instant; with free length zero it is linear, and the body swings through its end."""
    scene = on_a_spring(50.0, 0.0, free_length=0.0).replace(duration=1.0, samples=11, gravity=np.zeros(3))
    traj = crosscheck.run(scene, "lieeuler", method, step=1e-2)
    np.testing.assert_array_equal(traj.x, 0.0 * traj.x)
    falling = crosscheck.run(scene.replace(gravity=np.array([0.0, 0.0, -9.81])), "lieeuler", method, step=1e-3)
    omega = np.sqrt(50.0)
    exact = -9.81 / 50.0 * (1 - np.cos(omega * falling.t))
    # first order, after 7 rad: the amplitude changes and lags by up to omega h / 2 a radian
    assert np.abs(falling.x[:, 0, 2] - exact).max() < 2 * 9.81 / 50.0 * 7.1 * omega * 1e-3


@pytest.mark.parametrize("method", FIXED)
def test_steps_of_a_nanosecond_leave_only_rounding(method):
    """A thousand of them: a step adds less than a rounding of most numbers, none of which may pile up.

    Methods that hold positions alone take velocities from differences of positions: a rounding over the step, each time
    anew. That is the noise of index 3, which no arithmetic in doubles avoids and a constraint on velocities removes.
    """
    gains = {"alpha": 10.0, "beta": 10.0} if method == "BAUMGARTE_LE" else {}
    scene = crosscheck.load_scene("double_pendulum").replace(duration=1e-6, samples=2)
    end = lieeuler.integrate(build_problem(scene), method, 1e-9, scene.t, **gains)
    exact = lieeuler.integrate(build_problem(scene), "taylor", t_eval=scene.t, rtol=1e-13)
    # rounding walks at random, 50 roundings times the root of a thousand; no method's own error reaches 1e-6 * 1e-9
    bound = 50 * EPS * np.sqrt(1000) * 4.0  # x up to 3 m, v up to 4 m/s
    noise = 50 * EPS * 3.0 / 1e-9 if set(lieeuler.METHODS[method].held) == {"position"} else 0.0
    for name in ("x", "R", "v", "w"):
        slack = noise if name in "vw" else 0.0
        assert np.abs(getattr(end, name)[-1] - getattr(exact, name)[-1]).max() < bound + slack, name


@pytest.mark.parametrize("damping", [1.0, 1e3, 1e6])
def test_strong_damping_takes_energy_and_never_gives_any(damping):
    scene = on_a_spring(1e4, 0.1, damping=damping).replace(duration=0.5, samples=51)
    traj = crosscheck.run(scene, "lieeuler", "DAE2L_LSE", step=1e-3)
    # implicit Euler of a linear oscillator: each step ends with less energy than it began with, up to its rounding
    assert np.diff(traj.energy).max() <= 50 * EPS * np.abs(traj.energy).max() + 50 * EPS * 9.81
