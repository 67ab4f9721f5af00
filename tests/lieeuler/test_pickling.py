"""Problems and errors travel between processes and can be copied."""

import concurrent.futures
import copy
import multiprocessing
import pickle

import numpy as np
import pytest

import lieeuler
from tests.lieeuler.systems import double_pendulum, spring_chain


def sprung():
    """Bodies, joints, a spring, a load and a torsional spring; the kernel has been made."""
    p = spring_chain(2)
    load = lieeuler.ConstantLoad(1, force=[0.1, 0.2, 0.3], frame="body")
    return lieeuler.Problem(p.bodies, p.joints, p.gravity, p.x, p.R, p.v, p.w, (*p.forces, load))


def copies(thing):
    return [pickle.loads(pickle.dumps(thing)), copy.deepcopy(thing), copy.copy(thing)]


def test_a_problem_can_be_copied():
    problem = sprung()
    run = lieeuler.integrate(problem, "rattle2", step=1e-2, t_eval=[0.0, 0.1])
    for other in copies(problem):
        again = lieeuler.integrate(other, "rattle2", step=1e-2, t_eval=[0.0, 0.1])
        assert np.array_equal(run.x, again.x)
        assert np.array_equal(run.lam, again.lam)
        for array in (other.x, other.bodies[0].inertia, other.joints[0].child_anchor, other.forces[1].force):
            assert not array.flags.writeable


def failing():
    with pytest.raises(lieeuler.IntegrationError) as caught:
        lieeuler.integrate(double_pendulum(), "DAE1L_LSE", step=5.0, t_eval=[0.0, 10.0, 20.0])
    return caught.value


def test_errors_can_be_copied():
    error = failing()
    for found, other in ((error, each) for each in copies(error)):
        assert (str(other), other.status, other.advice) == (str(found), found.status, found.advice)
        assert np.array_equal(other.solution.x, found.solution.x)
    interrupted = lieeuler.Interrupted(error.solution)
    for other in copies(interrupted):
        assert str(other) == str(interrupted)
        assert other.solution.t_end == error.solution.t_end


def run_too_coarsely(problem):
    return lieeuler.integrate(problem, "DAE1L_LSE", step=5.0, t_eval=[0.0, 10.0, 20.0])


@pytest.mark.parametrize("kind", ["pool", "executor"])
def test_process_pools_hand_the_error_back(kind):
    spawn = multiprocessing.get_context("spawn")
    if kind == "pool":
        with spawn.Pool(1) as pool, pytest.raises(lieeuler.IntegrationError):
            pool.apply_async(run_too_coarsely, (double_pendulum(),)).get(60.0)
    else:
        with concurrent.futures.ProcessPoolExecutor(1, mp_context=spawn) as executor:
            error = executor.submit(run_too_coarsely, double_pendulum()).exception(60.0)
            assert isinstance(error, lieeuler.IntegrationError)
