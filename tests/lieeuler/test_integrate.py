"""The public entry point: arguments, sampling and statuses; test_repeated_runs.py has threads and interruption."""

from __future__ import annotations

import numpy as np
import pytest

import lieeuler
from tests.lieeuler.systems import SYSTEMS

T = np.linspace(0, 1, 11)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"method": "DAE1L_LES"}, "did you mean DAE1L_LSE"),
        ({"method": "RK4"}, "DAE3L_LE"),
        ({"step": 0.0}, "step must be positive"),
        ({"step": -1e-3}, "step must be positive"),
        ({"step": np.nan}, "step must be positive"),
        ({"t_eval": [0.0]}, "at least two"),
        ({"t_eval": [0.0, 1.0, 0.5]}, "increasing"),
        ({"t_eval": [0.0, np.inf]}, "finite"),
        ({"map": "euler"}, "exp, cayley, ccsk"),
        ({"alpha": 1.0}, "BAUMGARTE_LE"),
        ({"method": "BAUMGARTE_LE", "beta": -1.0}, "not below 0"),
        ({"method": "BAUMGARTE_LE", "alpha": "x"}, "alpha must be a number"),
        ({"method": ["DAE1L_LSE"]}, "method must be one of"),
        ({"step": None}, "step must be a number"),
        ({"step": "x"}, "step must be a number"),
        ({"step": 1e-60}, "more than 1e"),
        ({"step": 1e-300}, "out of range"),
        ({"t_eval": "abc"}, "at least two"),
        ({"problem": None}, "lieeuler.Problem"),
    ],
)
def test_wrong_arguments_are_named(changes, words):
    problem = SYSTEMS["single_pendulum"]()
    arguments = {"problem": problem, "method": "DAE1L_LSE", "step": 1e-2, "t_eval": T, **changes}
    with pytest.raises(lieeuler.ArgumentError, match=words):
        lieeuler.integrate(**arguments)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"x": [[0, 0, 0.5]]}, "violates the joints"),
        ({"v": [[1.0, 0, 0]]}, "violates the velocity constraints"),
        ({"x": [[0, 0]]}, "shape"),
        ({"w": [[np.nan, 0, 0]]}, "finite"),
        ({"R": [np.diag([1.0, 1.0, -1.0])]}, "rotation"),
        ({"joints": [lieeuler.spherical_joint(-1, 3, [0, 0, 0], [0, 0, 1.0])]}, r"joints\[0\].*child 3"),
        ({"bodies": []}, "at least one body"),
        ({"bodies": [1]}, r"bodies\[0\] is of another kind"),
        ({"x": "abc"}, "x must be numbers"),
    ],
)
def test_wrong_problems_are_named(change, words):
    p = SYSTEMS["single_pendulum"]()
    fields = {name: getattr(p, name) for name in ("bodies", "joints", "gravity", "x", "R", "v", "w")}
    with pytest.raises(lieeuler.ArgumentError, match=words):
        lieeuler.Problem(**{**fields, **change})


@pytest.mark.parametrize(("mass", "inertia"), [(0.0, np.eye(3)), (1.0, -np.eye(3)), (1.0, np.eye(2)),
                                               (1.0, np.triu(np.ones((3, 3)))), (np.inf, np.eye(3)),
                                               ("1", np.eye(3)), (1.0, "x"), (1.0, np.diag([1.0, 1.0, 9.0]))])
def test_wrong_bodies_are_refused(mass, inertia):
    with pytest.raises(lieeuler.ArgumentError):
        lieeuler.Body(mass, inertia)


Z = [0, 0, 1.0]


@pytest.mark.parametrize(("make", "words"), [
    (lambda: lieeuler.spherical_joint(-1, 0.5, [0, 0, 0], Z), "child"),
    (lambda: lieeuler.spherical_joint(-1, 0, [0, 0], Z), "parent_anchor"),
    (lambda: lieeuler.revolute_joint(-1, 0, [0, 0, 0], Z, [0, 0, 0], Z), "axis"),
    (lambda: lieeuler.distance_joint(-1, 0, [0, 0, 0], Z, 0.0), "length"),
    (lambda: lieeuler.fixed_joint(-1, 0, [0, 0, 0], Z, 2 * np.eye(3)), "rotation"),
    (lambda: lieeuler.LinearSpring(-1, 0, [0, 0, 0], Z, -1.0, 0.0), "stiffness"),
    (lambda: lieeuler.TorsionalSpring(-1, 0, Z, Z, 1.0, np.nan), "rest_angle"),
    (lambda: lieeuler.ConstantLoad(0, frame="sky"), "frame"),
    (lambda: lieeuler.Rotor(0.0, Z, Z), "inertia"),
    (lambda: lieeuler.Rotor(0.1, [0, 0, 0], Z), "parent_axis"),
    (lambda: lieeuler.Rotor(0.1, Z, Z, turns=1), "turns"),
    (lambda: lieeuler.rolling_sphere_joint(0, 1, np.zeros(3), np.zeros(3), Z, 0.3), "with the ground"),
    (lambda: lieeuler.rolling_disk_joint(-1, 0, np.zeros(3), np.zeros(3), Z, [1.0, 0, 0], -0.3), "radius"),
    (lambda: lieeuler.TimeFunction([[]]), "coefficient"),
    (lambda: lieeuler.TimeFunction([[1.0], [2.0]]), "every piece needs a break"),
    (lambda: lieeuler.TimeFunction([[1.0], [2.0]], breaks=[1.0, 0.0]), "increase"),
    (lambda: lieeuler.TimeFunction(terms=[(1.0, 2.0)]), "amplitude"),
    (lambda: lieeuler.TimeFunction(1.0), "rows of numbers"),
    (lambda: lieeuler.ConstantLoad(0, factor=2.0), "TimeFunction"),
    (lambda: lieeuler.SlideForce(0, 1, np.zeros(3), np.zeros(3), np.zeros(3), 1.0), "vanish"),
])
def test_wrong_joints_and_forces_are_named(make, words):
    with pytest.raises(lieeuler.ArgumentError, match=words):
        make()


def test_step_is_shortened_to_divide_the_interval():
    s = lieeuler.integrate(SYSTEMS["single_pendulum"](), "DAE1L_LSE", 3e-2, T)
    assert (s.stats.steps, s.stats.step) == (40, pytest.approx(0.025, rel=1e-15))
    uneven = lieeuler.integrate(SYSTEMS["single_pendulum"](), "DAE1L_LSE", 1e-2, [0, 0.005, 0.1, 0.101])
    assert uneven.stats.steps == 1 + 10 + 1


def test_samples_do_not_change_the_motion():
    problem = SYSTEMS["double_pendulum"]()
    few, many = (lieeuler.integrate(problem, "DAE1H_LSE", 1e-2, np.linspace(0, 1, n)) for n in (2, 11))
    assert np.abs(few.x[-1] - many.x[-1]).max() < 1e-12
    assert np.array_equal(many.x[0], problem.x)


@pytest.mark.parametrize(("method", "coordinate_map", "step", "status"), [
    ("DAE1L_LSE", "exp", 0.1, lieeuler.Status.MAP_DOMAIN),  # 15 rad a step
    ("DAE3H_LE", "exp", 0.05, lieeuler.Status.MAP_DOMAIN),
    ("DAE2L_LE", "ccsk", 0.02, lieeuler.Status.MAP_DOMAIN),  # 3 rad a step, the map ends at pi/2
])
def test_failure_carries_status_advice_and_trajectory(method, coordinate_map, step, status):
    with pytest.raises(lieeuler.IntegrationError) as caught:
        lieeuler.integrate(SYSTEMS["heavy_top"](), method, step, np.linspace(0, 1, 11), map=coordinate_map)
    assert caught.value.status is status
    assert "smaller step" in caught.value.advice
    assert len(caught.value.solution.t) == len(caught.value.solution.x) >= 1


def test_monitor_can_be_switched_off():
    s = lieeuler.integrate(SYSTEMS["single_pendulum"](), "DAE1L_LSE", 1e-2, T, monitor=False)
    assert s.stats.maxima == {}
