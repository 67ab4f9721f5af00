"""Which constraint levels a method holds: small systems."""

import numpy as np
import pytest

import lieeuler
from lieeuler import Status, _kernel
from lieeuler.methods import LEVELS
from lieeuler.problem import CLOSED
from tests.lieeuler.systems import SYSTEMS, spring_chain

T = np.linspace(0.0, 1.0, 3)


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


def test_a_state_says_which_levels_are_open():
    problem = SYSTEMS["double_pendulum"]()
    x, R, v, w = (np.repeat(getattr(problem, name)[None], 3, axis=0) for name in "xRvw")
    x[1] += 1e-3
    v[2] += 1e-3
    levels = _kernel.constraint_levels(problem.kernel, x, R, v, w, 0.0, 1.0)
    assert (levels > CLOSED).tolist() == [[False, False], [True, False], [False, True]]


@pytest.mark.parametrize("monitor", [True, False])
def test_a_level_that_opens_is_a_failure_of_methods_that_hold_it(monitor):
    """The velocities of DAE3L_LE are open on the way, which it does not hold."""
    problem = SYSTEMS["double_pendulum"]()
    run = lieeuler.prepare(problem, "DAE3L_LE", 1e-2, T, monitor=monitor)
    for level, status in (("position", Status.SUCCESS), ("velocity", Status.CONSTRAINTS_OPEN)):
        run.compiled.held = 1 << LEVELS.index(level)
        assert run().status is status
