"""Prepared runs: wrong states and failures have their names, and repeated runs the same bits."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

import lieeuler
from lieeuler import checks
from tests.lieeuler.systems import SYSTEMS

T = np.linspace(0, 0.2, 3)
FIELDS = ("t", "x", "R", "v", "w", "a", "alpha", "lam")


def assert_equal(one, other):
    assert all(np.array_equal(getattr(one, name), getattr(other, name)) for name in FIELDS)
    assert (one.status, one.t_end, one.method) == (other.status, other.t_end, other.method)
    assert dataclasses.replace(one.stats, wall_time=0.0) == dataclasses.replace(other.stats, wall_time=0.0)


@pytest.mark.parametrize(("change", "message"), [
    ({"v": [[9.0, 0, 0]]}, "violates the velocity constraints"), ({"x": [[9.0, 0, 0]]}, "violates the joints"),
    ({"R": [2 * np.eye(3)]}, "rotation matrices"), ({"R": [np.diag([1.0, 1, -1])]}, "rotation matrices"),
    ({"w": [[np.nan, 0, 0]]}, "w must be finite"), ({"w": [0, 0]}, "w must be finite and of shape"),
    ({"x": "here"}, "x must be numbers"), ({"v": [[1e200, 0, 0]]}, "out of range"),
])
def test_a_wrong_state_is_named(change, message):
    run = lieeuler.prepare(SYSTEMS["single_pendulum"](), "rattle2", 1e-2, T)
    with pytest.raises(lieeuler.ArgumentError, match=message):
        run(**change)
    assert run().success


def test_kept_runs_are_those_of_their_arguments():
    problem = SYSTEMS["single_pendulum"]()
    times = np.array([0.0, 1.0])
    problem = dataclasses.replace(problem, gravity=0 * problem.gravity, v=0 * problem.v, w=0 * problem.w)
    one = lieeuler.integrate(problem, "rattle2", 1, times)
    with pytest.raises(lieeuler.ArgumentError, match="step"):
        lieeuler.integrate(problem, "rattle2", True, times)
    times[1] = 2.0  # other times in the same array
    assert lieeuler.integrate(problem, "rattle2", 1, times).t[-1] == 2.0
    assert_equal(one, lieeuler.integrate(problem, "rattle2", 1, [0.0, 1.0]))
    for h in np.linspace(0.1, 0.5, 40):
        lieeuler.integrate(problem, "rattle2", h, times)
    assert len(problem.kept) <= 20
    assert_equal(one, lieeuler.integrate(problem, "rattle2", 1, np.array([0.0, 1.0])))


@pytest.mark.parametrize("monitor", [True, False])
def test_a_run_that_fails_fails_again(monitor):
    run = lieeuler.prepare(SYSTEMS["double_pendulum"](), "rattle2", 2.0, [0, 2.0, 40.0], monitor=monitor)
    ended = []
    for _ in range(2):
        with pytest.raises(lieeuler.IntegrationError) as caught:
            run()
        ended.append(caught.value.solution)
    assert_equal(*ended)
    assert len(ended[0].t) < 3


@pytest.mark.parametrize("size", [5e-324, 1e-200, 1e100])
def test_an_axis_of_any_size_has_its_direction(size):
    np.testing.assert_allclose(checks.unit("axis", [0.0, size, 0.0]), [0.0, 1.0, 0.0])
