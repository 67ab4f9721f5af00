"""Every status that can end a run is reached by a run."""

import signal

import numpy as np
import pytest

import crosscheck
import lieeuler
from crosscheck.adapters.lieeuler import build_problem
from lieeuler import Status
from tests.lieeuler.systems import SYSTEMS
from tests.lieeuler.test_laws import slides
from tests.lieeuler.test_redundant import linkage


def spring_at_rest(stiffness, free_length, start):
    """One body on a spring from its centre to the origin, without gravity."""
    spring = lieeuler.LinearSpring(-1, 0, np.zeros(3), np.zeros(3), stiffness, free_length)
    return lieeuler.Problem([lieeuler.Body(1.0, np.eye(3))], [], np.zeros(3), [[0, 0, start]], [np.eye(3)],
                            [np.zeros(3)], [np.zeros(3)], [spring])


def stops_at_once():
    """Two slides one on the other that reach their elastic stops at half a second."""
    return slides([0.5, 0.5], [-1.0, -1.0], [lieeuler.Stops(0.0, restitution=0.5)] * 2, 0.0, rides=True)


WAYS = {
    Status.SUCCESS: lambda: (SYSTEMS["double_pendulum"](), "rkmk4", {"step": 0.01}),
    Status.NEWTON_FAILED: lambda: (SYSTEMS["double_pendulum"](), "rattle2", {"step": 0.4}),
    Status.SINGULAR_MATRIX: lambda: (linkage([[0, 0, 0], [1, 0, 0], [3, 0, 0], [2, 0, 0]]), "rkmk4", {"step": 1e-3}),
    Status.MAP_DOMAIN: lambda: (SYSTEMS["heavy_top"](), "DAE1L_LSE", {"step": 0.1}),  # 15 rad a step
    Status.NON_FINITE: lambda: (spring_at_rest(4.0, 0.5, 0.0), "taylor", {"rtol": 1e-8}),  # no direction, no series
    Status.STEP_TOO_SMALL: lambda: (spring_at_rest(1e30, 1.0, -1.5), "taylor", {"rtol": 1e-6}),
    Status.CONSTRAINTS_OPEN: lambda: (build_problem(crosscheck.load_scene("bricard")), "DAE2L_LE", {"step": 0.01}),
    Status.NOT_UNIQUE: lambda: (stops_at_once(), "rkmk4", {"step": 0.01}),
    Status.INTERRUPTED: lambda: (SYSTEMS["double_pendulum"](), "rkmk4", {"step": 1e-7}),
}  # fmt: skip


@pytest.mark.parametrize("status", Status)
def test_a_run_ends_with_each_status(status):
    """The exception, its solution, the printed line and the advice all name the status; every sample is finite."""
    problem, method, control = WAYS[status]()
    if status is Status.INTERRUPTED:
        signal.setitimer(signal.ITIMER_PROF, 0.1)  # s of computing
        before = signal.signal(signal.SIGPROF, signal.default_int_handler)
    try:
        solution = lieeuler.integrate(problem, method, t_eval=[0.0, 8.0], **control)
        assert status in (Status.SUCCESS, Status.CONSTRAINTS_OPEN)
    except (lieeuler.IntegrationError, lieeuler.Interrupted) as ended:
        solution = ended.solution
        assert solution.t_end < 8
    finally:
        if status is Status.INTERRUPTED:
            signal.signal(signal.SIGPROF, before)
    assert solution.status is status
    assert status.value in str(solution)
    assert bool(status.advice) is (status is not Status.SUCCESS)
    assert all(np.isfinite(getattr(solution, name)).all() for name in ("x", "R", "v", "w", "a", "alpha", "lam"))


@pytest.mark.parametrize("status", [each for each in Status if each not in (Status.INTERRUPTED, Status.NOT_UNIQUE)])
def test_a_member_of_an_ensemble_ends_with_each_status(status):
    problem, method, control = WAYS[status]()
    many = lieeuler.integrate_ensemble(problem, method, t_eval=[0.0, 8.0], v=problem.v[None], **control)
    assert list(many.status) == [status]
