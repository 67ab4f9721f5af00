"""Accelerations, multipliers and reactions at a state: against the dense equations, and Newton's and Euler's laws."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

import lieeuler
from lieeuler import reference
from tests.lieeuler.systems import SYSTEMS

Z = [0, 0, 1.0]


def arm():
    """A cross on a slide: joints with torques."""
    slide = lieeuler.prismatic_joint(-1, 0, [0, 0, 0], [0, 0, 0], [1.0, 0, 0], [1.0, 0, 0], np.eye(3))
    cross = lieeuler.universal_joint(0, 1, [0, 0, -0.1], [0, 0, 0.5], [1.0, 0, 0], [0, 1.0, 0])
    bodies = [lieeuler.Body(2.0, np.diag([0.1, 0.2, 0.25])), lieeuler.Body(1.0, np.diag([0.05, 0.06, 0.02]))]
    w = np.array([[0, 0, 0], [0.7, -1.2, 0]])
    v = [[0.3, 0, 0], np.array([0.3, 0, 0]) + np.cross(w[1], [0, 0, -0.5])]
    return lieeuler.Problem(bodies, [slide, cross], [0, 0.4, -9.81], [[0, 0, 0], [0, 0, -0.6]], [np.eye(3)] * 2, v, w)


PROBLEMS = {**SYSTEMS, "arm": arm}


@pytest.mark.parametrize("name", PROBLEMS)
def test_they_are_those_of_the_dense_equations(name):
    problem = PROBLEMS[name]()
    system, found = reference.System(problem), lieeuler.accelerations(problem)
    a, lam = system.index1(system.q, system.u)
    scale = max(1.0, np.abs(a).max())
    assert np.abs(np.hstack([found.a, found.alpha]).ravel() - a).max() < 1e-13 * scale
    assert np.abs(found.lam - lam).max() < 1e-13 * max(1.0, np.abs(lam).max())
    assert found.redundant_rows == 0


@pytest.mark.parametrize("name", PROBLEMS)
def test_reactions_obey_newton_and_euler(name):
    """Mass times acceleration is weight and what the joints exert; of a body's joints to others the opposite."""
    problem = PROBLEMS[name]()
    found = lieeuler.accelerations(problem)
    for b, body in enumerate(problem.bodies):
        force, torque = body.mass * problem.gravity, np.zeros(3)
        for k, joint in enumerate(problem.joints):
            for end, sign, anchor in ((joint.child, 1, joint.child_anchor), (joint.parent, -1, joint.parent_anchor)):
                if end == b:
                    force = force + sign * found.force[k]
                    torque = torque + sign * (found.torque[k] + np.cross(problem.R[b] @ anchor, found.force[k]))
        w = problem.w[b]
        turn = problem.R[b] @ (body.inertia @ found.alpha[b] + np.cross(w, body.inertia @ w))
        size = max(1.0, np.abs(body.mass * found.a[b]).max(), np.abs(turn).max())
        assert np.abs(body.mass * found.a[b] - force).max() < 1e-12 * size
        assert np.abs(turn - torque).max() < 1e-12 * size


def test_a_ball_exerts_no_torque_and_a_state_may_be_given():
    problem = SYSTEMS["double_pendulum"]()
    run = lieeuler.integrate(problem, lieeuler.Taylor(rtol=1e-12), np.linspace(0, 1, 3))
    found = lieeuler.accelerations(problem, (run.x[1], run.R[1], run.v[1], run.w[1]))
    assert np.abs(found.torque).max() < 1e-14
    assert np.abs(found.a - run.a[1]).max() < 1e-9
    with pytest.raises(lieeuler.ArgumentError, match="rotation"):
        lieeuler.accelerations(problem, (run.x[1], 2 * run.R[1], run.v[1], run.w[1]))


def test_the_time_of_a_problem_is_that_of_its_loads():
    ramp = lieeuler.TimeFunction([[0.0, 2.0]])
    body = lieeuler.Body(1.0, np.eye(3))
    ball = lieeuler.Problem([body], [], [0, 0, 0], [[0, 0, 0]], [np.eye(3)], [[0, 0, 0]], [[0, 0, 0]],
                            [lieeuler.ConstantLoad(0, force=[1.0, 0, 0], factor=ramp)])
    assert lieeuler.accelerations(ball).a[0, 0] == 0
    assert lieeuler.accelerations(dataclasses.replace(ball, time=3.0)).a[0, 0] == 6


@pytest.mark.parametrize("method", [lieeuler.Taylor(rtol=1e-9), lieeuler.RKMK54(rtol=1e-7), lieeuler.Seulex(rtol=1e-6)])
@pytest.mark.parametrize("name", ["double_pendulum", "heavy_top"])
def test_values_between_samples_are_those_of_the_same_steps(method, name):
    problem, end = SYSTEMS[name](), 0.05 if name == "heavy_top" else 1.0
    run = lieeuler.integrate(problem, method, np.array([0.0, end]))
    times = end * np.array([0.1234, 0.5, 0.77])
    dense = run.at(times)
    whole = lieeuler.integrate(problem, method, np.array([0.0, *times, end]))
    for field in ("x", "R", "v", "w", "a", "alpha", "lam"):
        assert np.array_equal(getattr(dense, field), getattr(whole, field)[1:4])
    assert whole.stats.steps == run.stats.steps


def test_values_between_samples_have_their_bounds():
    problem = SYSTEMS["double_pendulum"]()
    with pytest.raises(lieeuler.ArgumentError, match="choose their steps"):
        lieeuler.integrate(problem, lieeuler.RKMK4(1e-2), [0, 1.0]).at([0.5])
    run = lieeuler.integrate(problem, lieeuler.Taylor(rtol=1e-6), [0, 1.0])
    for wrong in ([1.1], [-0.1], [0.5, 0.4], [], "now", 0.5, [np.nan]):
        with pytest.raises(lieeuler.ArgumentError, match="times must increase"):
            run.at(wrong)
