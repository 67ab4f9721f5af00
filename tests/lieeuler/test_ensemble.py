"""Ensembles: each member equals the run of `integrate`, whatever the others do, on any number of threads."""

from __future__ import annotations

import contextlib
import dataclasses
import signal
import threading
import time

import numpy as np
import pytest

import lieeuler
from lieeuler import Status
from tests.lieeuler import systems

T = np.linspace(0.0, 1.0, 6)
FIELDS = ("x", "R", "v", "w")


def spun(problem, count, seed=1, size=0.1):
    """States (count, ...) with other angular velocities, of chains of ball joints from the ground."""
    rng = np.random.default_rng(seed)
    w = problem.w + size * rng.standard_normal((count, *problem.w.shape))
    v = np.zeros_like(w)
    for k in range(count):
        for j, joint in enumerate(problem.joints):
            above = np.zeros(3)
            if j > 0:
                above = v[k, j - 1] + problem.R[j - 1] @ np.cross(w[k, j - 1], joint.parent_anchor)
            v[k, j] = above - problem.R[j] @ np.cross(w[k, j], joint.child_anchor)
    return {"v": v, "w": w}


def hinge():
    """A body that a spring turns about an axis of its own."""
    axis = np.array([0.0, 0.0, 1.0])
    spring = lieeuler.TorsionalSpring(-1, 0, axis, axis, 3.0, 0.4, 0.1)
    return lieeuler.Problem((lieeuler.Body(1.0, np.diag([0.2, 0.3, 0.4])),), (), np.zeros(3), np.zeros((1, 3)),
                            np.eye(3)[None], np.zeros((1, 3)), np.array([[0.1, -0.2, 0.5]]), (spring,))


def member(problem, states, k):
    return dataclasses.replace(problem, **{name: values[k] for name, values in states.items()})


WAYS = [("taylor", {"rtol": 1e-9}), ("rkmk853", {"rtol": 1e-8}), ("seulex", {"rtol": 1e-8}), ("rkmk4", {"step": 0.01}),
        ("DAE1L_LSE", {"step": 0.01}), ("DAE2H_LSE", {"step": 0.01, "map": "cayley"}),
        ("rattle4", {"step": 0.01})]


@pytest.mark.parametrize(("method", "controls"), WAYS)
@pytest.mark.parametrize("make", systems.SYSTEMS.values(), ids=systems.SYSTEMS)
def test_each_member_is_the_run_of_its_own_state(make, method, controls):
    problem = make()
    states = spun(problem, 3)
    many = lieeuler.integrate_ensemble(problem, method, t_eval=T, threads=2, **states, **controls)
    assert (many.status == Status.SUCCESS).all()
    assert many.success.all()
    for k in range(3):
        alone = lieeuler.integrate(member(problem, states, k), method, t_eval=T, **controls)
        for name in FIELDS:
            np.testing.assert_array_equal(getattr(many, name)[k], getattr(alone, name))
        assert many.steps[k] == alone.stats.steps


@pytest.mark.parametrize(("method", "controls"), WAYS)
def test_results_do_not_depend_on_the_number_of_threads(method, controls):
    problem = systems.double_pendulum()
    states = spun(problem, 23)
    one, two, four = (lieeuler.integrate_ensemble(problem, method, t_eval=T, threads=threads, **states, **controls)
                      for threads in (1, 2, 4))
    for name in FIELDS:
        np.testing.assert_array_equal(getattr(one, name), getattr(two, name))
        np.testing.assert_array_equal(getattr(one, name), getattr(four, name))
    assert len(np.unique(one.x[:, -1], axis=0)) == 23


def test_parameters_change_each_member():
    problem = systems.spring_chain(2)
    masses, stiffness, down = np.array([0.5, 1.0, 2.0]), np.array([5.0, 10.0, 20.0]), np.array([-9.0, -9.81, -10.0])
    many = lieeuler.integrate_ensemble(
        problem, "taylor", rtol=1e-9, t_eval=T,
        parameters={"bodies.0.mass": masses, "forces.0.stiffness": stiffness, "gravity.2": down})
    for k in range(3):
        body = dataclasses.replace(problem.bodies[0], mass=masses[k])
        spring = dataclasses.replace(problem.forces[0], stiffness=stiffness[k])
        alone = lieeuler.integrate(
            dataclasses.replace(problem, bodies=(body, problem.bodies[1]), forces=(spring,),
                                gravity=[0.0, 0.0, down[k]]), "taylor", rtol=1e-9, t_eval=T)
        np.testing.assert_array_equal(many.x[k], alone.x)


@pytest.mark.parametrize("order", [(0, 1, 2), (2, 1, 0), (1, 2, 0)])
def test_components_of_one_axis_are_set_together(order):
    problem, axes = hinge(), np.array([[0.6, 0.0, 0.8], [2.0, 1.0, 2.0]])
    whole = lieeuler.integrate_ensemble(problem, "rkmk4", step=0.01, t_eval=T, parameters={
        "forces.0.parent_axis": axes, "forces.0.child_axis": axes})
    parts = {f"forces.0.{end}_axis.{k}": axes[:, k] for end in ("parent", "child") for k in order}
    found = lieeuler.integrate_ensemble(problem, "rkmk4", step=0.01, t_eval=T, parameters=parts)
    np.testing.assert_array_equal(found.w, whole.w)
    assert np.abs(whole.w[0] - whole.w[1]).max() > 1e-2


def test_entries_of_one_inertia_are_set_together():
    problem = systems.double_pendulum()
    J = np.array([problem.bodies[0].inertia + d * np.array([[0, 1, -1], [1, 0, 0], [-1, 0, 1]]) for d in (1e-3, 2e-3)])
    whole = lieeuler.integrate_ensemble(problem, "taylor", rtol=1e-9, t_eval=T, parameters={"bodies.0.inertia": J})
    parts = {f"bodies.0.inertia.{i}.{j}": J[:, i, j] for i, j in ((0, 1), (2, 0), (2, 2))}
    found = lieeuler.integrate_ensemble(problem, "taylor", rtol=1e-9, t_eval=T, parameters=parts)
    np.testing.assert_array_equal(found.w, whole.w)
    with pytest.raises(lieeuler.ArgumentError, match="inertia"):
        lieeuler.integrate_ensemble(problem, "taylor", rtol=1e-9, t_eval=T, parameters={
            "bodies.0.inertia.0.1": [1e-3], "bodies.0.inertia.1.0": [2e-3]})


def driven(t):
    """A hinge whose angle is 0.3 + 0.8 t, with its state at time t."""
    axis, q = np.array([0.0, 0.0, 1.0]), 0.3 + 0.8 * t
    R = np.array([[[np.cos(q), -np.sin(q), 0.0], [np.sin(q), np.cos(q), 0.0], [0.0, 0.0, 1.0]]])
    joint = lieeuler.revolute_joint(-1, 0, [0.0] * 3, [0.0] * 3, axis, axis).driven(
        lieeuler.Drive(lieeuler.TimeFunction([[0.3, 0.8]]), lieeuler.Coordinate(axis, axis, np.eye(3))))
    return lieeuler.Problem((lieeuler.Body(1.0, np.eye(3)),), (joint,), np.zeros(3), np.zeros((1, 3)), R,
                            np.zeros((1, 3)), np.array([[0.0, 0.0, 0.8]]), time=t)


def test_starts_belong_to_the_first_output_time():
    late = driven(0.5)
    states = {name: getattr(late, name)[None] for name in FIELDS}
    for more in ({}, {"parameters": {"bodies.0.mass": [1.5]}}):
        found = lieeuler.integrate_ensemble(driven(0.0), "rkmk4", step=0.01, t_eval=T + 0.5, **states, **more)
        np.testing.assert_allclose(found.R[0, -1, 0, 0, 0], np.cos(0.3 + 0.8 * 1.5), rtol=0, atol=1e-9)
        with pytest.raises(lieeuler.ArgumentError, match="member 0"):
            lieeuler.integrate_ensemble(late, "rkmk4", step=0.01, t_eval=T, **states, **more)


def test_a_member_that_fails_is_nan_from_there_and_harms_no_other():
    problem = systems.double_pendulum()
    states = spun(problem, 5)
    wild = spun(dataclasses.replace(problem), 5, seed=3, size=1e4)
    for name in states:
        states[name][2] = wild[name][2]
    many = lieeuler.integrate_ensemble(problem, "DAE1L_LSE", step=0.01, t_eval=T, threads=2, **states)
    with pytest.raises(lieeuler.IntegrationError) as failure:
        lieeuler.integrate(member(problem, states, 2), "DAE1L_LSE", step=0.01, t_eval=T)
    assert many.status[2] == failure.value.status
    assert many.t_end[2] == failure.value.solution.t_end
    reached = len(failure.value.solution.t)
    assert np.isfinite(many.x[2, :reached]).all()
    assert np.isnan(many.x[2, reached:]).all()
    assert np.isnan(many.R[2, reached:]).all()
    others = [0, 1, 3, 4]
    assert (many.status[others] == "success").all()
    alone = lieeuler.integrate_ensemble(problem, "DAE1L_LSE", step=0.01, t_eval=T,
                                        **{name: values[others] for name, values in states.items()})
    np.testing.assert_array_equal(many.x[others], alone.x)


def test_other_threads_of_python_run_meanwhile():
    problem = systems.double_pendulum()
    seen = []
    ended = threading.Event()

    def look():
        while not ended.wait(0.001):
            seen.append(time.perf_counter())

    watcher = threading.Thread(target=look)
    watcher.start()
    began = time.perf_counter()
    lieeuler.integrate_ensemble(problem, "DAE1L_LSE", step=1e-4, t_eval=[0.0, 5.0], threads=1, **spun(problem, 4))
    over = time.perf_counter()
    ended.set()
    watcher.join()
    inside = [moment for moment in seen if began < moment < over]
    assert len(inside) > 3


@pytest.mark.skipif(not hasattr(signal, "SIGALRM"), reason="needs SIGALRM")
@pytest.mark.parametrize("raised", [KeyboardInterrupt, TimeoutError])
def test_what_a_signal_raises_ends_all_members(raised):
    def ring(*_):
        raise raised

    problem = systems.double_pendulum()
    before = signal.signal(signal.SIGALRM, ring)
    signal.setitimer(signal.ITIMER_REAL, 0.2)
    try:
        with pytest.raises(raised):
            lieeuler.integrate_ensemble(problem, "DAE1L_LSE", 1e-6, [0.0, 1e4], threads=2, **spun(problem, 3))
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, before)


def test_attitudes_are_rotations_to_a_tenth_of_a_nanoradian():
    problem = systems.double_pendulum()
    for stretch, refused in ((4e-11, False), (6e-11, True)):  # of R^T R by twice as much
        R = (1 + stretch) * np.repeat(problem.R[None], 2, axis=0)
        start = {name: np.repeat(getattr(problem, name)[None], 2, axis=0) for name in "xvw"} | {"R": R}
        with pytest.raises(lieeuler.ArgumentError, match="member 0") if refused else contextlib.nullcontext():
            lieeuler.integrate_ensemble(problem, "rkmk4", 0.1, [0.0, 0.1], **start)


@pytest.mark.parametrize(("arguments", "words"), [
    ({}, "needs x, R, v, w or parameters"),
    ({"w": np.zeros((2, 3))}, r"w must be numbers of shape \('N', 2, 3\)"),
    ({"w": np.zeros((2, 2, 3)), "x": np.zeros((3, 2, 3))}, "as many members"),
    ({"w": np.zeros((2, 2, 3)), "R": 2 * np.ones((2, 2, 3, 3))}, "member 0: R must hold rotation matrices"),
    ({"w": np.full((2, 2, 3), np.nan)}, "member 0: w must be finite"),
    ({"w": np.ones((2, 2, 3))}, "member 0: the initial state violates the velocity constraints"),
    ({"parameters": {"bodies.0.mas": [1.0]}}, "did you mean 'mass'"),
    ({"parameters": {"bodys.0.mass": [1.0]}}, "did you mean 'bodies'"),
    ({"parameters": {"bodies.7.mass": [1.0]}}, "'7' is none of 0, 1"),
    ({"parameters": {"bodies.0.mass": 1.0}}, "must be finite numbers of shape"),
    ({"parameters": {"bodies.0.mass": [1.0, -1.0]}}, "member 1: mass must be positive"),
    ({"parameters": {"gravity.3": [1.0]}}, "'3' is none of 0, 1, 2"),
    ({"parameters": {"joints.0.spherical": [True]}}, "is no number"),
    ({"parameters": {"x.0": [1.0]}}, "none of bodies"),
    ({"w": np.zeros((2, 2, 3)), "threads": -1}, "threads must be"),
])
def test_a_wrong_argument_is_one_sentence(arguments, words):
    with pytest.raises(lieeuler.ArgumentError, match=words):
        lieeuler.integrate_ensemble(systems.double_pendulum(), "taylor", rtol=1e-6, t_eval=T, **arguments)


def test_its_text_is_one_line():
    problem = systems.double_pendulum()
    text = repr(lieeuler.integrate_ensemble(problem, "taylor", rtol=1e-6, t_eval=T, **spun(problem, 2)))
    assert text.startswith("EnsembleSolution(taylor: 2 of 2 members reached 1 s")
    assert "\n" not in text
