"""The correction of stabilised Lagrangian methods weighted with the mass, or plain: (4.1) of docs/theory.md."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

import lieeuler
from tests.lieeuler.systems import SYSTEMS
from tests.lieeuler.test_methods import ROUNDING
from tests.lieeuler.test_oracle import assert_agrees, referred
from tests.lieeuler.test_redundant import FOUR_BAR, SPRING, linkage

METHODS = ("DAE2L_LSE", "DAE1L_LSE", "generalized_alpha")


def uneven(name):
    """The system with masses and inertias of one to three: the weight of equal ones of 1 kg would show little."""
    problem = SYSTEMS[name]()
    return dataclasses.replace(problem, bodies=tuple(
        lieeuler.Body(3.0 / (k + 1), 2.5 * body.inertia) for k, body in enumerate(problem.bodies)))


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("name", ["single_pendulum", "double_pendulum"])
def test_kernel_agrees_with_dense_oracle(name, method):
    problem, h, steps = uneven(name), 1e-2, 20
    plain = lieeuler.METHODS[method](step=h, correction="plain")
    run = lieeuler.integrate(problem, plain, [0, steps * h])
    q, u, _, lam = referred(problem, plain, steps)
    assert_agrees(run, q, u, lam, 1e3 * np.finfo(float).eps / h**2)
    mass = lieeuler.integrate(problem, method, h, [0, steps * h])
    assert np.abs(mass.x[-1] - run.x[-1]).max() > 1e-7  # another method: the test would notice the wrong weight


@pytest.mark.parametrize("method", METHODS)
def test_levels_stay_at_rounding_level(method):
    run = lieeuler.integrate(SYSTEMS["double_pendulum"](), method, 1e-2, [0, 10.0], correction="plain")
    for level in lieeuler.METHODS[method].held:
        assert run.stats.maxima[f"constraint_{level}"] < ROUNDING[level]
    assert run.stats.maxima["orthogonality"] < ROUNDING["orthogonality"]


FIGURES = [("single_pendulum", 1e-2, "mass", "3.36e-02", "1.02e-01"),
           ("single_pendulum", 1e-2, "plain", "3.37e-02", "1.03e-01"),
           ("double_pendulum", 1e-2, "mass", "5.30e-02", "1.38e-01"),
           ("double_pendulum", 1e-2, "plain", "5.55e-02", "1.45e-01"),
           ("heavy_top", 1e-3, "mass", "1.61e-01", "1.31e-02"), ("heavy_top", 1e-3, "plain", "1.06e-01", "1.11e-02")]


@pytest.mark.parametrize(("name", "step", "word", "error", "energy"), FIGURES)
def test_the_figures_of_the_theory(name, step, word, error, energy):
    problem = SYSTEMS[name]()
    exact = lieeuler.integrate(problem, "rkmk853", rtol=1e-13, t_eval=[0, 1.0])
    run = lieeuler.integrate(problem, "DAE1L_LSE", step, [0, 1.0], correction=word)
    assert f"{np.abs(run.x[-1] - exact.x[-1]).max():.2e}" == error
    assert f"{run.stats.maxima['energy_error']:.2e}" == energy


@pytest.mark.parametrize("damping", [0.0, 5.0])
@pytest.mark.parametrize("method", METHODS[:2])
def test_in_a_redundant_loop_with_a_stiff_spring(method, damping):
    """In its plane no row depends on others, and the motion is the same."""
    bar = linkage(FOUR_BAR)
    spring = lieeuler.LinearSpring(-1, 1, **SPRING, stiffness=1e4, damping=damping)
    problem = dataclasses.replace(bar, forces=(spring,))
    whole, plane = (lieeuler.integrate(problem, method, 5e-3, [0, 0.1], correction="plain", reduce=word)
                    for word in ("off", "planar"))
    assert whole.stats.redundant_rows == 3
    assert np.abs(whole.x - plane.x).max() < 1e-10
    assert whole.stats.maxima["constraint_velocity"] < 1e-11


@pytest.mark.parametrize("method", ["DAE3L_LE", "DAE2H_LSE", "rattle2", "rkmk54", "taylor"])
def test_others_refuse_it_by_name(method):
    size = {"rtol": 1e-6} if method in ("rkmk54", "taylor") else {"step": 1e-2}
    with pytest.raises(lieeuler.ArgumentError, match="correction='plain' is for DAE2L_LSE, DAE1L_LSE, generalized_alp"):
        lieeuler.integrate(SYSTEMS["single_pendulum"](), method, t_eval=[0, 1], correction="plain", **size)
