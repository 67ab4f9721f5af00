"""Light bodies that carry heavy ones: the ratio of the masses, a million, costs no digits.

A solve by G M^-1 G^T alone loses as many as the masses differ by: accelerations violated the joints by 1e-7 m/s^2, and
the terms of a Taylor series by 2e-6 from the second one on, which left errors of 1e-5 m at every tolerance.
"""

import dataclasses
from random import Random

import mpmath
import numpy as np
import pytest

import crosscheck
import lieeuler
from crosscheck.adapters.lieeuler import build_problem
from crosscheck.references import truth
from tests import random_mechanisms
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


def exact_accelerations(problem):
    """(n, 2, 3) v' and w' at rest from the whole saddle point in fifty digits."""
    n, at_rest = 6 * problem.n, (problem.x, problem.R, problem.v, problem.w)
    parts = lieeuler._kernel.constraints(problem.kernel, *at_rest, np.zeros(problem.rows))
    with mpmath.workdps(50):
        whole = mpmath.zeros(n + problem.rows)
        for k, body in enumerate(problem.bodies):
            for i in range(3):
                whole[6 * k + i, 6 * k + i] = body.mass
                for j in range(3):
                    whole[6 * k + 3 + i, 6 * k + 3 + j] = mpmath.mpf(body.inertia[i, j])
        for (i, j), entry in np.ndenumerate(parts["G"]):
            whole[n + i, j] = whole[j, n + i] = mpmath.mpf(entry)
        forces = lieeuler._kernel.forces(problem.kernel, *at_rest)["f"]
        found = mpmath.lu_solve(whole, mpmath.matrix([*forces, *-parts["gamma"]]))
        return np.array([float(value) for value in found[:n]]).reshape(-1, 2, 3)


@pytest.mark.parametrize("seed", [4001163, 4002856, 4003120])
def test_between_masses_of_ten_decades_accelerations_are_exact(seed):
    """Trees with needles: eliminating the bodies left errors as large as the accelerations, whatever was refined."""
    make, options = random_mechanisms.case(Random(seed))
    solution, exact = lieeuler.integrate(make(), **options), exact_accelerations(make())
    found = np.stack([solution.a[0], solution.alpha[0]], axis=1)
    assert np.abs(found - exact).max() <= 1e-8 * np.abs(exact).max()  # what the moments span, 1e-10, leaves of eps


@pytest.mark.parametrize("seed", [4000823, 4001307, 4001600, 4000774])
def test_loops_between_masses_of_ten_decades_are_held(seed):
    """The number of dependent rows does not depend on the masses, however they differ."""
    make, options = random_mechanisms.case(Random(seed))
    solution = lieeuler.integrate(make(), **options)
    assert solution.success
    length = max(np.abs(solution.x).max(), make().kernel.length)
    size = np.abs(solution.a).max() + length * np.abs(solution.alpha).max() + 1.0  # m/s^2
    assert solution.stats.maxima["constraint_acceleration"] <= 1e-12 * size
