"""What depends on time: the clock, steps that end where a function breaks, series."""

import numpy as np
import pytest

import lieeuler
from lieeuler import _kernel


def test_the_clock_keeps_its_digits_over_many_steps():
    """A free body under a force sin(w t): its end shows the time that each step used."""
    force = lieeuler.ConstantLoad(0, force=[1.0, 0.0, 0.0], factor=lieeuler.TimeFunction(terms=[(1.0, 40.0, 0.0)]))
    body = lieeuler.Body(1.0, np.diag([0.1, 0.2, 0.15]))
    at_rest = (np.zeros((1, 3)), np.eye(3)[None], np.zeros((1, 3)), np.zeros((1, 3)))
    problem = lieeuler.Problem([body], [], np.zeros(3), *at_rest, forces=[force])
    h, T = 1e-3, 200.0
    run = lieeuler.integrate(problem, "rattle2", h, [0.0, T], monitor=False)
    t = h * np.arange(200_001, dtype=np.longdouble)
    kicks = np.sin(40.0 * t) * h
    kicks[[0, -1]] /= 2
    assert abs(run.v[0, 0, 0]) < 2  # the last sample is the end
    # v is the sum of the kicks to rounding; a time late by 1e-11 s would change each kick by a share of w times that
    assert abs(run.v[-1, 0, 0] - float(kicks.sum())) < 1e-12


def test_steps_end_on_breaks():
    """A kink: with steps across it the methods of order eight would leave 1e-6 at this tolerance."""
    kink = lieeuler.TimeFunction([[0.0], [0.0, 50.0]], breaks=[0.0, 0.4321])
    body = lieeuler.Body(1.0, np.diag([0.1, 0.2, 0.15]))
    at_rest = (np.zeros((1, 3)), np.eye(3)[None], np.zeros((1, 3)), np.zeros((1, 3)))
    problem = lieeuler.Problem([body], [], np.zeros(3), *at_rest,
                               forces=[lieeuler.ConstantLoad(0, force=[1.0, 0.0, 0.0], factor=kink)])
    for method in ("taylor", "rkmk853", "rkmk54", "seulex"):
        run = lieeuler.integrate(problem, method, t_eval=[0.0, 1.0], rtol=1e-10)
        assert run.x[-1, 0, 0] == pytest.approx(50 * (1 - 0.4321) ** 3 / 6, rel=1e-10), method
        assert run.stats.steps < 60, method


def test_series_of_the_kernel_are_functions():
    with pytest.raises(ValueError, match="series"):
        _kernel.TimeFunction([0.0], [[1.0]], []).expand(0.0, 0)
