"""Free bodies at rest or about a principal axis stay so."""

import numpy as np
import pytest

import lieeuler


@pytest.mark.parametrize("speed", [0.0, 3.0])
def test_bodies_at_rest_or_about_a_principal_axis_stay_so(speed):
    book = lieeuler.Body(1.0, np.diag([1.0, 2.0, 3.0]))
    problem = lieeuler.Problem([book], [], [0, 0, -9.81], [[0, 0, 0]], np.eye(3)[None], [[0, 0, 1.0]],
                               [[0, 0, speed]])
    run = lieeuler.integrate(problem, "taylor", None, [0.0, 5.0], rtol=1e-12, conserve=True)
    assert np.array_equal(run.w[-1], problem.w)
