"""Closed loops from any start: multipliers of least norm, accelerations, rows that depend on others."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

import crosscheck
import lieeuler
from crosscheck.adapters.lieeuler import build_problem
from crosscheck.scene import mechanics
from crosscheck.scene.constraints import Constraints
from crosscheck.scene.starts import restarted
from tests.lieeuler.accuracy import EPS


def test_multipliers_stay_of_least_norm_wherever_a_run_begins():
    """Those that are so already differ from others by rounding alone, in which conjugate gradients must not go on."""
    scene = crosscheck.load_scene("bricard").replace(samples=126)
    states = crosscheck.run(scene, engine="lieeuler", method="rattle4", step=0.02)
    for k in range(0, 125, 5):
        begun = restarted(scene, states, k, 0.48, 16)
        for step in (0.02, 0.04):
            run = crosscheck.run(begun, engine="lieeuler", method="rattle4", step=step)
            wanted = mechanics.index1(begun, run.x, run.R, run.v, run.w, {}, run.t)[2]
            np.testing.assert_allclose(run.lam, wanted, rtol=0, atol=1e-9)


def test_accelerations_in_a_redundant_loop_are_those_of_the_step():
    """Multipliers that act at its start, taken at its end, were 15 rad/s^2 off about the axes of the thin bars."""
    scene, errors = crosscheck.load_scene("bricard"), []
    inertias, inverse = np.array(scene.inertias), mechanics.inverse_mass(scene)
    for h in (1e-3, 5e-4):
        run = lieeuler.integrate(build_problem(scene), "DAE2H_LSE", h, [0, 1.0 - h, 1.0])
        _, alpha, lam = mechanics.index1(scene, run.x[2:], run.R[2:], run.v[2:], run.w[2:])
        errors.append(np.abs(run.alpha[2] - alpha).max())
        assert np.abs(run.lam[2] - lam).max() < 1e2 * h
        # The impulse of the joints, as far as multipliers can give it.
        spins = [np.einsum("bij,bj->bi", inertias, w) for w in run.w]
        turned = np.einsum("bji,bjk,bk->bi", run.R[2], run.R[1], spins[1])
        pushed = np.array(scene.masses)[:, None] * (run.v[1] - run.v[2] + h * scene.gravity)
        impulse = np.hstack([pushed, turned - spins[2]]).ravel() / h
        G = Constraints(scene).jacobian(run.x[2:], run.R[2:])[0]
        assert np.abs(G @ (inverse @ (impulse - G.T @ run.lam[2]))).max() < 1e3 * EPS / h
    assert errors[1] < 0.1
    assert errors[0] / errors[1] == pytest.approx(2, rel=0.1)


@pytest.mark.parametrize("step", [1e-3, 1e-2, 5e-2])
@pytest.mark.parametrize("method", [*lieeuler.EULER_METHODS, "INDEX1_LE", "BAUMGARTE_LE", "generalized_alpha"])
def test_rows_that_depend_on_others_only_with_joints_closed(method, step):
    """Bricard's mechanism with a damped spring: where a method lets the joints open, the last row depends on none."""
    problem = build_problem(crosscheck.load_scene("bricard"))
    spring = lieeuler.LinearSpring(-1, 2, [-1.0, 1.0, 2.0], np.zeros(3), 1e4, 2.0, 5.0)
    sprung = dataclasses.replace(problem, forces=(spring,))
    try:
        run = lieeuler.integrate(sprung, method, step, [0, 10 * step])
    except lieeuler.IntegrationError as error:
        run = error.solution
    assert run.status is not lieeuler.Status.SINGULAR_MATRIX
    assert run.stats.redundant_rows == 1
    if {"position", "velocity"} <= set(lieeuler.METHODS[method].held) and step < 5e-2:
        assert run.success
