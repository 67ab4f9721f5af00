"""Why DAE2H_LE ends early: the step that Newton fails."""

from __future__ import annotations

import numpy as np
import pytest

import crosscheck
import lieeuler
from crosscheck.adapters.lieeuler import build_problem
from tests import batch_oracle
from tests.lieeuler.systems import SYSTEMS
from tests.lieeuler.test_readings import dense


@pytest.mark.parametrize(("name", "h"), [("single_pendulum", 5e-3), ("double_pendulum", 5e-3), ("chain_64", 1e-3)])
def test_the_step_that_newton_fails_has_no_solution(name, h):
    """The solutions that come from vanishing steps turn back before this one: no iteration could have found one."""
    problem = SYSTEMS[name]() if name in SYSTEMS else build_problem(crosscheck.load_scene(name))
    with pytest.raises(lieeuler.IntegrationError, match="newton_failed") as failure:
        lieeuler.integrate(problem, "DAE2H_LE", h, np.arange(0.0, 200.0))
    last = failure.value.solution.t_end
    solved = lieeuler.integrate(problem, "DAE2H_LE", h, [0, last - h, last])
    system, _ = dense(problem)
    reached = [batch_oracle.turning_point(system, (solved.x[k], solved.R[k]),
                                          np.hstack([solved.v[k], solved.w[k]]).ravel(), h) for k in (1, 2)]
    assert reached[0] == 1  # the solution of the step before is found
    assert reached[1] < 1
    print(f"{name}: the solutions turn back at {reached[1]:.3f} of the step after {last:.6g} s")
