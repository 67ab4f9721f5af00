"""Light bodies that carry heavy ones: the ratio of the masses, a million, costs no digits.

A solve by G M^-1 G^T alone loses as many as the masses differ by: accelerations violated the joints by 1e-7 m/s^2, and
the terms of a Taylor series by 2e-6 from the second one on, which left errors of 1e-5 m at every tolerance.
"""

import dataclasses

import numpy as np
import pytest

import crosscheck
import lieeuler
from crosscheck.adapters.lieeuler import build_problem
from crosscheck.references import truth
from tests.hard.methods import FIXED

HOLDING = tuple(method for method in FIXED if len(lieeuler.METHODS[method].held) == 3)
ADAPTIVE = tuple(name for name, method in lieeuler.METHODS.items() if "rtol" in method.controls)
LIGHT = 1e-6


def graded_chain():
    """Eight links, more parts than the small saddle point takes; every other link light."""
    scene = crosscheck.load_scene("chain_8").replace(duration=0.3, samples=4)
    return scene.replace(bodies=tuple(
        dataclasses.replace(body, mass=LIGHT * body.mass, inertia=LIGHT * body.inertia) if number % 2 == 0 else body
        for number, body in enumerate(scene.bodies)))


@pytest.mark.parametrize("method", [*HOLDING, *ADAPTIVE])
def test_velocities_and_accelerations_keep_the_joints_to_rounding(method):
    scene = crosscheck.load_scene("light_heavy")
    control = {"rtol": 1e-9} if method in ADAPTIVE else {"step": 1e-3}
    maxima = lieeuler.integrate(build_problem(scene), method, t_eval=scene.t, **control).stats.maxima
    assert maxima["constraint_velocity"] < 1e-13  # 50 eps of 4 m/s
    assert maxima["constraint_acceleration"] < 2e-12  # 50 eps of 160 m/s^2


@pytest.mark.parametrize("method", ["taylor", "rkmk853", "rkmk54"])
def test_a_tight_tolerance_is_met(method):
    scene = crosscheck.load_scene("light_heavy")
    exact = truth(scene).states
    found = lieeuler.integrate(build_problem(scene), method, t_eval=scene.t, rtol=1e-12)
    for quantity, size in (("x", 2.0), ("R", 1.0), ("v", 6.0), ("w", 10.0)):
        assert np.abs(getattr(found, quantity) - getattr(exact, quantity)).max() < 1e-11 * size, quantity


def test_taylor_series_of_a_chain_agree_with_another_method():
    problem, t = build_problem(graded_chain()), graded_chain().t
    series = lieeuler.integrate(problem, "taylor", t_eval=t, rtol=1e-12)
    stages = lieeuler.integrate(problem, "rkmk853", t_eval=t, rtol=1e-12)
    assert np.abs(series.x - stages.x).max() < 1e-11
    assert np.abs(series.w - stages.w).max() < 1e-10 * np.abs(stages.w).max()
    assert series.stats.maxima["constraint_acceleration"] < 1e-9
