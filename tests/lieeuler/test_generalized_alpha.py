"""generalized_alpha against the dense oracle and the prototype's figures (theory note, generalized-alpha)."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

import lieeuler
from lieeuler import reference
from tests.lieeuler import accuracy
from tests.lieeuler.systems import SYSTEMS, spring_chain
from tests.lieeuler.test_oracle import assert_agrees, referred

NAME = "generalized_alpha"


@pytest.mark.parametrize("radius", [0.0, 0.5, 0.8, 1.0])
@pytest.mark.parametrize("system", ["single_pendulum", "double_pendulum"])
def test_kernel_agrees_with_dense_oracle(system, radius):
    h, steps = 1e-2, 20
    method, problem = lieeuler.GeneralizedAlpha(h, spectral_radius=radius), SYSTEMS[system]()
    q, u, _, lam = referred(problem, method, steps)
    solution = lieeuler.integrate(problem, method, [0, steps * h])
    noise = 1e3 * np.finfo(float).eps / h  # accelerations contain u / h and its rounding
    assert_agrees(solution, q, u, lam, noise)


# Errors at one second of x and of the method's own multipliers, largest component, spectral radius 0.8: the prototype.
FIGURES = {20: ("4.35e-03", "8.60e-02"), 40: ("1.09e-03", "2.13e-02"), 80: ("2.74e-04", "5.31e-03"),
           160: ("6.87e-05", "1.33e-03")}


@pytest.mark.parametrize("steps", FIGURES)
def test_prototype_figures_to_all_printed_digits(steps):
    problem = SYSTEMS["single_pendulum"]()
    truth = lieeuler.integrate(problem, "rkmk853", rtol=1e-13, t_eval=[0, 1])
    system = reference.System(problem)
    own = reference.alpha_steps(system, lieeuler.GeneralizedAlpha(1 / steps), system.q, system.u)
    *_, lam = next(itertools.islice(own, steps - 1, None))
    solution = lieeuler.integrate(problem, NAME, 1 / steps, [0, 1])
    errors = np.abs(solution.x[-1] - truth.x[-1]).max(), np.abs(lam - truth.lam[-1]).max()
    assert tuple(f"{error:.2e}" for error in errors) == FIGURES[steps]
    assert solution.stats.maxima["constraint_position"] < 2 * np.finfo(float).eps  # x and R s have size one
    accuracy.assert_on_the_constraints(solution, problem)


ORDER = 0.15  # of the slope, as for the other methods of higher order
STEPS = (1 / 160, 1 / 320, 1 / 640, 1 / 1280)


@pytest.mark.parametrize("radius", [0.2, 0.8])
@pytest.mark.parametrize("make", [SYSTEMS["single_pendulum"], SYSTEMS["double_pendulum"], lambda: spring_chain(3)])
def test_order_two_in_states_and_multipliers(make, radius):
    problem, t = make(), np.linspace(0, 1, 11)
    truth = lieeuler.integrate(problem, "taylor", rtol=1e-14, t_eval=t)
    runs = [lieeuler.integrate(problem, NAME, h, t, spectral_radius=radius) for h in STEPS]
    for quantity in (*accuracy.QUANTITIES, "lam"):
        errors = [np.abs(getattr(run, quantity) - getattr(truth, quantity))[1:].max() for run in runs]
        slope = np.polyfit(np.log(STEPS), np.log(errors), 1)[0]
        assert abs(slope - 2) < ORDER, quantity
    for run in runs:
        accuracy.assert_on_the_constraints(run, problem)
