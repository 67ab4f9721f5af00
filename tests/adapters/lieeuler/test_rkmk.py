"""Munthe-Kaas Runge-Kutta methods: order, error proportional to the tolerance, dense output, all joints."""

from __future__ import annotations

import numpy as np
import pytest

import crosscheck
import lieeuler
from crosscheck.adapters.lieeuler import build_problem
from tests.adapters.lieeuler.against_truth import errors, scene, solve, truth
from tests.lieeuler.accuracy import QUANTITIES, assert_on_the_constraints, slopes
from tests.lieeuler.test_rkmk import ADAPTIVE

TOLERANCES = 10.0 ** -np.arange(4, 13)


# Steps in the asymptotic range and above round-off, five of each.
LADDERS = {
    ("double_pendulum", "rkmk4"): (1 / 210, 1 / 360),
    ("double_pendulum", "rkmk54"): (1 / 250, 1 / 420),
    ("double_pendulum", "rkmk853"): (1 / 60, 1 / 110),
    ("heavy_top", "rkmk4"): (1 / 1300, 1 / 2860),
    ("heavy_top", "rkmk54"): (1 / 1130, 1 / 2500),
    ("heavy_top", "rkmk853"): (1 / 365, 1 / 600),
}


@pytest.mark.parametrize(("system", "method"), LADDERS)
def test_order(system, method):
    duration = {"double_pendulum": 1.0, "heavy_top": 0.3}[system]
    order = lieeuler.METHODS[method].order
    steps, rows = [], []
    for h in np.geomspace(*LADDERS[system, method], 5):
        run = solve(system, method, duration, 11, step=h)
        assert_on_the_constraints(run, build_problem(scene(system, duration, 11)))
        steps.append(run.stats.step)
        rows.append(errors(system, run, duration, 11))
    for quantity, slope in zip(QUANTITIES, slopes(steps, rows), strict=True):
        if (system, method) == ("double_pendulum", "rkmk853") and quantity in "xRv":
            # The leading term is small here: down to round-off the next, of order 9, dominates; w has order 8.
            assert 7.85 < slope < 9.5, quantity
        else:
            assert slope == pytest.approx(order, abs=0.15), quantity


@pytest.mark.parametrize("method", [*ADAPTIVE, "seulex"])
@pytest.mark.parametrize(("system", "duration"), [("double_pendulum", 1.0), ("heavy_top", 0.3)])
def test_error_is_proportional_to_the_tolerance(system, duration, method):
    rows, tolerances = [], TOLERANCES[::2] if method == "seulex" else TOLERANCES
    for rtol in tolerances:
        run = solve(system, method, duration, 11, rtol=rtol)
        assert_on_the_constraints(run, build_problem(scene(system, duration, 11)))
        rows.append(errors(system, run, duration, 11))
    for quantity, slope in zip(QUANTITIES, slopes(tolerances, rows), strict=True):
        assert 0.8 < slope < 1.2, (quantity, slope)


@pytest.mark.parametrize("method", ADAPTIVE)
def test_samples_between_steps_are_as_accurate_as_steps(method):
    """A thousand samples do not change the steps; their errors are like those at the ends of steps."""
    rtol, duration = 1e-7, 0.3
    few, many = (solve("heavy_top", method, duration, samples, rtol=rtol) for samples in (2, 1001))
    assert few.stats.steps == many.stats.steps
    assert np.array_equal(few.x[-1], many.x[-1])
    dense = errors("heavy_top", many, duration, 1001)
    problem, states = build_problem(scene("heavy_top", duration, 1001)), truth("heavy_top", duration, 1001)
    at_steps = np.zeros(4)
    for k in range(50, 1001, 50):
        run = lieeuler.integrate(problem, method, None, [0.0, many.t[k]], rtol=rtol, spin_free=False)
        gaps = [np.abs(getattr(run, q)[-1] - getattr(states, q)[k]).max() for q in QUANTITIES]
        at_steps = np.maximum(at_steps, gaps)
    assert (np.array(dense) < 3 * at_steps).all(), (dense, at_steps)


SCENES = [name for name in crosscheck.scenes() if name not in ("chain_64", "stiff_damped", "stiff_spring")]


@pytest.mark.parametrize("name", SCENES)
def test_all_joints_and_forces(name):
    """Against the extrapolated implicit Euler method, which shares no step with the explicit ones."""
    duration = 0.03 if name == "squeezer" else 0.2  # s: it turns five hundred times faster than the others
    explicit = solve(name, "rkmk853", duration, 5, rtol=1e-10)
    implicit = solve(name, "seulex", duration, 5, rtol=1e-8)
    assert_on_the_constraints(explicit, build_problem(scene(name, duration, 5)))
    length = max(1.0, np.abs(explicit.x).max())
    assert np.abs(explicit.x - implicit.x).max() < 1e-6 * length
    assert np.abs(explicit.R - implicit.R).max() < 1e-6
    if name in ("four_bar", "bricard"):
        assert explicit.stats.redundant_rows == implicit.stats.redundant_rows > 0


def test_counters():
    run = solve("double_pendulum", "rkmk853", 1.0, 2, rtol=1e-8)
    stats = run.stats
    # twelve evaluations a step, one at the start and one for the first step's size; a rejected step spares its last
    assert 12 * stats.steps + 2 <= stats.force_evaluations <= 12 * (stats.steps + stats.rejected_steps) + 2
    assert stats.step is None
    assert stats.newton_iterations == 0


def test_wrong_controls_are_named():
    problem = build_problem(scene("double_pendulum", 1.0, 2))
    cases = [
        (("rkmk54", 1e-2), {"rtol": 1e-6}, "not both"),
        (("rkmk4", None), {"rtol": 1e-6}, "rtol=1e-06 is for rkmk54, rkmk853, seulex, taylor"),
        (("seulex", 1e-2), {}, "leave it out with seulex, whose options are rtol"),
        (("rkmk54", None), {"rtol": 1e-17}, "rtol must lie between"),
        (("rkmk54", None), {"rtol": "x"}, "rtol must be a number"),
        (("rkmk54", 1e-2), {"map": "cayley"}, "leave it out with rkmk54, whose options are step, rtol"),
    ]
    for (method, step), options, words in cases:
        with pytest.raises(lieeuler.ArgumentError, match=words):
            lieeuler.integrate(problem, method, step, [0.0, 1.0], **options)
    with pytest.raises(lieeuler.ArgumentError, match="t_eval is missing"):
        lieeuler.integrate(problem, "rkmk54", rtol=1e-6)
    assert lieeuler.integrate(problem, "rkmk54", t_eval=[0.0, 0.1]).success  # the default tolerance
