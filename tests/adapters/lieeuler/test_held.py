"""A run that leaves open a constraint level that its method holds does not end in success."""

import numpy as np
import pytest

import crosscheck
import lieeuler
from crosscheck.adapters.lieeuler import build_problem
from lieeuler import Status
from lieeuler.integrate import opened
from lieeuler.methods import LEVELS
from tests.lieeuler.test_held import T


@pytest.mark.parametrize("method", ["DAE2L_LE", "DAE2H_LE"])
def test_index_two_on_redundant_rows_says_that_the_velocities_opened(method):
    problem = build_problem(crosscheck.load_scene("bricard"))
    solution = lieeuler.integrate(problem, method, step=1e-2, t_eval=T)
    assert solution.stats.maxima["constraint_velocity"] > 1e-6  # m/s, of speeds below ten
    assert solution.status is Status.CONSTRAINTS_OPEN
    assert not solution.success
    assert solution.t[-1] == T[-1]
    assert "stats.maxima" in solution.status.advice


@pytest.mark.parametrize("method", ["DAE1L_LSE", "DAE1H_LSE", "DAE2L_LSE", "DAE3L_LE", "rattle2", "rkmk4"])
@pytest.mark.parametrize("name", ["bricard", "four_bar", "needle", "heavy_light"])
def test_levels_that_are_held_are_a_success(name, method):
    scene = crosscheck.load_scene(name)
    assert lieeuler.integrate(build_problem(scene), method, step=2e-3, t_eval=T / 10).status is Status.SUCCESS


def test_of_what_is_not_monitored_the_last_state_is_judged():
    problem = build_problem(crosscheck.load_scene("bricard"))
    for method, status in (("DAE2L_LE", Status.CONSTRAINTS_OPEN), ("DAE2L_LSE", Status.SUCCESS)):
        alone = lieeuler.integrate(problem, method, step=1e-2, t_eval=T, monitor=False)
        assert alone.status is status
        assert alone.stats.maxima == {}
        many = lieeuler.integrate_ensemble(problem, method, step=1e-2, t_eval=T, v=problem.v[None].repeat(2, axis=0))
        assert (many.status == status).all()
        heavier = {"bodies.0.mass": np.array([1.0, 1.1])}
        apart = lieeuler.integrate_ensemble(problem, method, step=1e-2, t_eval=T, parameters=heavier)
        assert (apart.status == status).all()


def still_open(problem, solution):
    return tuple(level for level, left in zip(LEVELS, opened(problem, solution), strict=True) if left)


@pytest.mark.parametrize("level", ["velocity", "acceleration"])
def test_multipliers_over_the_least_mass_excuse_no_open_level(level):
    """Light links carry heavy ones: what a joint transmits would give the light one 1e7 times the acceleration."""
    problem = build_problem(crosscheck.load_scene("heavy_light"))
    solution = lieeuler.integrate(problem, "DAE1H_LSE", step=2e-3, t_eval=T / 10)
    assert still_open(problem, solution) == ()
    speed, acceleration = np.abs(solution.v).max(), np.abs(solution.a).max()
    size = {"velocity": speed, "acceleration": acceleration}[level]
    for share, found in ((1e-9, ()), (1e-5, (level,))):
        solution.stats.maxima[f"constraint_{level}"] = share * size
        assert still_open(problem, solution) == found
