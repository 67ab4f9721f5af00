"""A run that leaves open a constraint level that its method holds does not end in success."""

import numpy as np
import pytest

import crosscheck
import lieeuler
from crosscheck.adapters.lieeuler import build_problem
from lieeuler import Status, held
from tests.lieeuler.systems import SYSTEMS, spring_chain

T = np.linspace(0.0, 1.0, 3)


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


@pytest.mark.parametrize("scale", [1e-6, 1.0, 1e6])
def test_a_system_at_rest_of_any_size_is_a_success(scale):
    """Nothing moves: the rows show only the rounding of gravity and of the multipliers."""
    joint = lieeuler.spherical_joint(-1, 0, np.zeros(3), np.array([0, 0, scale]))
    problem = lieeuler.Problem([lieeuler.Body(1.0, np.eye(3) * scale**2)], [joint], [0, 0, -9.81],
                               [[0, 0, -scale]], [np.eye(3)], [np.zeros(3)], [np.zeros(3)])
    for method in ("DAE1L_LSE", "DAE2H_LSE", "rattle2", "rkmk4"):
        step = 1e-2 * np.sqrt(scale)
        assert lieeuler.integrate(problem, method, step=step, t_eval=[0.0, 50 * step]).status is Status.SUCCESS


def test_the_usual_systems_are_a_success():
    for make in (*SYSTEMS.values(), lambda: spring_chain(5)):
        for method, record in lieeuler.METHODS.items():
            control = {"step": 1e-3} if "step" in record.controls else {"rtol": 1e-8}
            assert lieeuler.integrate(make(), method, t_eval=T / 20, **control).success


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


@pytest.mark.parametrize("level", ["velocity", "acceleration"])
def test_multipliers_over_the_least_mass_excuse_no_open_level(level):
    """Light links carry heavy ones: what a joint transmits would give the light one 1e7 times the acceleration."""
    problem = build_problem(crosscheck.load_scene("heavy_light"))
    solution = lieeuler.integrate(problem, "DAE1H_LSE", step=2e-3, t_eval=T / 10)
    assert held.open_levels(problem, solution) == ()
    speed, acceleration = np.abs(solution.v).max(), np.abs(solution.a).max()
    size = {"velocity": speed, "acceleration": acceleration}[level]
    for share, found in ((1e-9, ()), (1e-5, (level,))):
        solution.stats.maxima[f"constraint_{level}"] = share * size
        assert held.open_levels(problem, solution) == found


@pytest.mark.parametrize(("method", "opened"), [
    ("DAE3L_LE", [False, True, False]), ("DAE2L_LE", [False, False, True]), ("rattle2", [False, True, True]),
    ("BAUMGARTE_LE", [False, False, False])])
def test_a_state_is_open_in_what_the_method_holds(method, opened):
    problem = SYSTEMS["double_pendulum"]()
    x, R, v, w = (np.repeat(getattr(problem, name)[None], 3, axis=0) for name in "xRvw")
    x[1] += 1e-3
    v[2] += 1e-3
    assert held.open_at(problem, method, x, R, v, w, 0.0, 1.0).tolist() == opened
