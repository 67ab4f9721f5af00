"""Munthe-Kaas Runge-Kutta methods: tableaux, whole turns, springs, ends."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import lieeuler
from lieeuler import tableaux
from tests.lieeuler.accuracy import EPS

METHODS = [name for name, method in lieeuler.METHODS.items() if method.tableau]
ADAPTIVE = [name for name in METHODS if "rtol" in lieeuler.METHODS[name].controls]
RULES = (tableaux.KUTTA_4, tableaux.DORMAND_PRINCE_5, tableaux.DORMAND_PRINCE_8)


def square(rows, columns):
    return np.array([[*row, *[0.0] * (columns - len(row))] for row in rows])


@pytest.mark.parametrize("rule", RULES, ids=lambda rule: f"order {rule.order}")
def test_order_conditions(rule):
    """Those of bushy and tall trees and of one branch on them, up to the order (Hairer, Norsett, Wanner, II.2)."""
    s = len(rule.weights)
    A, b = square([(), *rule.stages], s), np.array(rule.weights)
    c = A.sum(axis=1)
    bound = 1e3 * EPS  # weights of size 30 cancel
    for p in range(1, rule.order + 1):
        assert abs(b @ c ** (p - 1) - 1 / p) < bound
        tall = np.ones(s)
        factorial = 1.0
        for k in range(1, p):
            tall, factorial = A @ tall, factorial * (k + 1)
        assert abs(b @ tall - 1 / factorial) < bound
        for inner in range(1, p):  # sum b_i c_i^(p-1-inner) a_ij c_j^(inner-1)
            assert abs(b @ (c ** (p - 1 - inner) * (A @ c ** (inner - 1))) - 1 / (p * inner)) < bound
    for row in rule.errors:
        assert abs(sum(row)) < bound


def test_tableaux_are_the_published_ones():
    """Against SciPy's copies of the same rules."""
    from scipy.integrate import RK45
    from scipy.integrate._ivp import dop853_coefficients as published

    five, eight = tableaux.DORMAND_PRINCE_5, tableaux.DORMAND_PRINCE_8
    assert np.allclose(square([(), *five.stages], 5), RK45.A, rtol=4 * EPS, atol=0)
    assert np.allclose(five.weights, RK45.B, rtol=4 * EPS, atol=0)
    assert np.allclose(np.abs(five.errors[0]), np.abs(RK45.E), rtol=4 * EPS, atol=0)
    assert np.allclose(square([(), *eight.stages], 12), published.A[:12, :12], rtol=4 * EPS, atol=0)
    assert np.allclose(eight.weights, published.B, rtol=4 * EPS, atol=0)
    assert np.allclose(square(eight.errors, 13), [published.E5, published.E3], rtol=4 * EPS, atol=0)
    assert np.allclose(square(eight.extra, 16), published.A[13:], rtol=4 * EPS, atol=0)
    assert np.allclose(square(eight.dense, 16), published.D, rtol=4 * EPS, atol=0)


def spinning(rate):
    """A free body that turns about a principal axis at so many rad/s, for ever."""
    return lieeuler.Problem([lieeuler.Body(1.0, np.diag([0.1, 0.2, 0.15]))], [], np.zeros(3), np.zeros((1, 3)),
                            np.eye(3)[None], np.zeros((1, 3)), [[0.0, 0.0, rate]])


@pytest.mark.parametrize("method", METHODS)
def test_a_whole_turn_in_a_step_is_refused(method):
    """dexp^-1 is singular there. Here its argument is along w, so that only the bound itself shows it."""
    def run(turn):
        return lieeuler.integrate(spinning(turn / 0.1), method, 0.1, [0.0, 1.0], spin_free=False)

    turned = run(2 * np.pi * 0.999)
    assert np.abs(turned.R[-1, 0] - Rotation.from_rotvec([0, 0, 20 * np.pi * 0.999]).as_matrix()).max() < 1e-12
    with pytest.raises(lieeuler.IntegrationError) as caught:
        run(2 * np.pi * 1.001)
    assert caught.value.status is lieeuler.Status.MAP_DOMAIN


@pytest.mark.parametrize("method", ADAPTIVE)
def test_steps_of_ones_own_choice_stay_below_a_whole_turn(method):
    """The error of a steady rotation is zero, so that only the bound limits the steps."""
    run = lieeuler.integrate(spinning(2 * np.pi), method, t_eval=[0.0, 1000.0], rtol=1e-3, spin_free=False)
    assert run.stats.steps >= 1000
    # each of a few thousand products of rotations adds a rounding, and the angle of 1000 turns has one of its own
    assert np.abs(run.R[-1, 0] - np.eye(3)).max() < 50 * EPS * 2000 * np.pi


def sprung_wheel(rate):
    """A wheel of 1 kg m^2 on a hinge with a torsional spring of 1 N m/rad: an oscillator of 1 rad/s."""
    up = [0, 0, 1.0]
    hinge = lieeuler.revolute_joint(-1, 0, [0, 0, 0], [0, 0, 0], up, up)
    spring = lieeuler.TorsionalSpring(-1, 0, up, up, 1.0, 0.0)
    return lieeuler.Problem([lieeuler.Body(1.0, np.eye(3))], [hinge], np.zeros(3), np.zeros((1, 3)), np.eye(3)[None],
                            np.zeros((1, 3)), [[0.0, 0.0, rate]], [spring])


@pytest.mark.parametrize("method", METHODS)
def test_a_step_that_would_lose_count_of_a_springs_turns_is_refused(method):
    """Angles are unwrapped from step to step: two bodies may turn by half a turn against each other, no more."""
    def run(turn):
        return lieeuler.integrate(sprung_wheel(turn / 0.01), method, 0.01, [0.0, 0.01], spin_free=False)

    assert run(0.49 * np.pi).success
    with pytest.raises(lieeuler.IntegrationError) as caught:
        run(0.52 * np.pi)
    assert caught.value.status is lieeuler.Status.MAP_DOMAIN


@pytest.mark.parametrize("method", ADAPTIVE)
def test_a_spring_wound_up_over_many_turns(method):
    """100 sin t rad, sixteen turns each way; at this tolerance steps turn further than angles can be unwrapped."""
    run = lieeuler.integrate(sprung_wheel(100.0), method, t_eval=np.linspace(0, 3, 31), rtol=1e-2, spin_free=False)
    assert np.abs(run.w[:, 0, 2] - 100 * np.cos(run.t)).max() < 100 * 1e-2


@pytest.mark.parametrize("method", [*ADAPTIVE, "taylor"])
def test_steps_too_small_end_the_run(method):
    """A spring of 1e15 rad/s against steps of 1e-12 of the run: a status with advice instead of endless steps."""
    body = lieeuler.Body(1.0, np.eye(3))
    spring = lieeuler.LinearSpring(-1, 0, [0, 0, 0], [0, 0, 0], 1e30, 1.0)
    problem = lieeuler.Problem([body], [], np.zeros(3), [[0, 0, -1.5]], [np.eye(3)], [np.zeros(3)], [np.zeros(3)],
                               [spring])
    with pytest.raises(lieeuler.IntegrationError) as caught:
        lieeuler.integrate(problem, method, None, [0.0, 1.0], rtol=1e-6)
    assert caught.value.status is lieeuler.Status.STEP_TOO_SMALL
    assert "stiff" in caught.value.advice
