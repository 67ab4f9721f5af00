"""Bodies on which nothing acts keep energy and angular momentum in twice the digits, if asked."""

import dataclasses

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import crosscheck
import lieeuler
from crosscheck.adapters.lieeuler import build_problem
from tests.references.closed_form import solve


def turning_over(rotation=None):
    """30 s about the middle axis, on which a rounding of one flip moves the next by a million roundings."""
    scene = crosscheck.load_scene("axis_flip")
    Q = np.eye(3) if rotation is None else rotation
    J = Q @ np.diag([1.0, 2.0, 3.0]) @ Q.T
    book = dataclasses.replace(scene.bodies[0], inertia=(J + J.T) / 2,
                               velocity=np.zeros(3), angular_velocity=Q @ [0.001, 2.0, 0.001])
    return scene.replace(bodies=(book,), duration=30.0, samples=61)


def left(scene, method, truth, **options):
    run = lieeuler.integrate(build_problem(scene), method, None, scene.t, rtol=1e-12, **options)
    return max(np.abs(run.R - truth.R).max(), np.abs(run.w - truth.w).max())


@pytest.mark.parametrize("method", ["taylor", "rkmk853"])
def test_a_body_that_turns_over_keeps_its_digits(method):
    scene = turning_over()
    truth = solve(scene)
    with_it, without = (left(scene, method, truth, conserve=value) for value in (True, False))
    assert with_it < (2e-12 if method == "taylor" else 2e-10)
    assert without > 10 * with_it


def test_the_axes_of_the_body_do_not_matter():
    """Products of inertia carry roundings of their own, a millionth of which the flips magnify."""
    Q = Rotation.from_rotvec([0.3, -1.2, 0.8]).as_matrix()
    scene = turning_over(Q)
    truth = solve(turning_over())
    run = lieeuler.integrate(build_problem(scene), "taylor", None, scene.t, rtol=1e-12, conserve=True)
    assert np.abs(run.w @ Q - truth.w).max() < 1e-8
    energy = 0.5 * np.einsum("tbi,ij,tbj->t", run.w, scene.bodies[0].inertia, run.w)
    assert np.abs(energy - energy[0]).max() < 4 * np.finfo(float).eps * energy[0]


def test_bodies_that_something_acts_on_are_left_alone():
    problem = build_problem(crosscheck.load_scene("double_pendulum"))
    runs = [lieeuler.integrate(problem, "taylor", None, [0.0, 1.0], rtol=1e-9, conserve=value)
            for value in (True, False)]
    assert np.array_equal(runs[0].R, runs[1].R)


@pytest.mark.parametrize(("method", "accuracy"), [("seulex", {"rtol": 1e-9}), ("DAE1L_LSE", {"step": 1e-3}),
                                                  ("rkmk54", {"step": 1e-3})])
def test_other_methods_refuse_it(method, accuracy):
    problem = build_problem(crosscheck.load_scene("axis_flip"))
    with pytest.raises(lieeuler.ArgumentError, match=r"conserve=True is for (rkmk54, .*|runs with rtol)"):
        lieeuler.integrate(problem, method, t_eval=[0.0, 1.0], conserve=True, **accuracy)


def test_crosscheck_passes_it_on():
    """The attitude of a body that turns over comes out to rounding, forty times nearer than without."""
    exact = solve(crosscheck.load_scene("axis_flip"))
    bare, kept = (crosscheck.run("axis_flip", "lieeuler", "taylor", rtol=1e-14, **options)
                  for options in ({}, {"conserve": True}))
    assert np.abs(kept.R - exact.R).max() < 20 * np.finfo(float).eps
    assert np.abs(bare.R - exact.R).max() > 10 * np.abs(kept.R - exact.R).max()
    with pytest.raises(crosscheck.ArgumentError, match="conserve=True is for rkmk54, rkmk853, taylor; leave it out"):
        crosscheck.run("axis_flip", "lieeuler", "rattle2", step=1e-2, conserve=True)
    with pytest.raises(crosscheck.ArgumentError, match="conserve"):
        crosscheck.run("axis_flip", "mujoco", "RK4", step=1e-2, conserve=True)
