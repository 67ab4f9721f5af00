"""Taylor series: known motions, and where there is no series."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import lieeuler


def test_steady_rotation():
    """w is constant, its series ends at once; the steps have to follow R, which is known."""
    body = lieeuler.Body(1.0, np.diag([0.1, 0.2, 0.15]))
    problem = lieeuler.Problem([body], [], np.zeros(3), np.zeros((1, 3)), np.eye(3)[None], np.zeros((1, 3)),
                               np.array([[0.0, 5.0, 0.0]]))
    t = np.linspace(0, 20, 9)
    run = lieeuler.integrate(problem, "taylor", rtol=1e-12, t_eval=t)
    exact = np.array([[[np.cos(5 * s), 0, np.sin(5 * s)], [0, 1, 0], [-np.sin(5 * s), 0, np.cos(5 * s)]] for s in t])
    assert np.abs(run.R[:, 0] - exact).max() < 1e-12 * 100  # rtol times the angle, 100 rad


def test_bodies_tied_to_each_other_and_not_to_the_ground():
    """The mass centre of two free bodies with a joint is in free fall, whatever their motion."""
    body = lieeuler.Body(1.0, np.diag([0.1, 0.2, 0.15]))
    w = np.array([[0.0, 3.0, 0.0], [2.0, 3.0, 0.0]])
    v = np.array([np.cross(w[0], [0, 0, -1.0]), -np.cross(w[1], [0, 0, 1.0])]) + np.array([1.0, 0.0, 2.0])
    v[0] = v[1] + np.cross(w[1], [0, 0, 1.0]) - np.cross(w[0], [0, 0, -1.0])
    joint = lieeuler.spherical_joint(0, 1, [0, 0, -1.0], [0, 0, 1.0])
    problem = lieeuler.Problem([body, body], [joint], [0, 0, -9.81], np.array([[0, 0, 1.0], [0, 0, -1.0]]),
                               np.array([np.eye(3)] * 2), v, w)
    t = np.linspace(0, 1, 5)
    run = lieeuler.integrate(problem, "taylor", rtol=1e-13, t_eval=t)
    fall = np.outer(t, v.mean(axis=0)) + np.outer(0.5 * t**2, [0, 0, -9.81])
    assert np.abs(run.x.mean(axis=1) - fall).max() < 1e-12  # rtol times the way, 10 m
    momentum = sum(np.cross(run.x[:, b] - run.x.mean(axis=1), run.v[:, b])
                   + np.einsum("tij,j,tj->ti", run.R[:, b], np.diag(body.inertia), run.w[:, b]) for b in (0, 1))
    assert np.abs(momentum - momentum[0]).max() < 1e-12 * 10  # kg m^2/s, its size is 10


def test_a_spring_of_zero_length_has_no_series():
    """Unless its free length is zero: then it is linear in the distance and smooth through it."""
    body = lieeuler.Body(1.0, np.eye(3))
    state = ([0, 0, 0.0], [[0, 0, 0.0]], [np.eye(3)], [[1.0, 0, 0]], [[0, 0, 0.0]])

    def spring(free_length):
        force = lieeuler.LinearSpring(-1, 0, np.zeros(3), np.zeros(3), 4.0, free_length)
        return lieeuler.Problem([body], [], *state, [force])

    with pytest.raises(lieeuler.IntegrationError) as caught:
        lieeuler.integrate(spring(0.5), "taylor", rtol=1e-8, t_eval=[0, 1])
    assert caught.value.status is lieeuler.Status.NON_FINITE
    t = np.linspace(0, 3, 7)
    run = lieeuler.integrate(spring(0.0), "taylor", rtol=1e-13, t_eval=t)
    assert np.abs(run.x[:, 0, 0] - np.sin(2 * t) / 2).max() < 1e-12  # amplitude 1/2 m, 3 s


def test_a_flat_needle_on_a_pin_keeps_the_digits_of_its_moments():
    """They differ by less than the rounding of those about the pin."""
    J, w, t = np.array([2e-9, 1e-9, 2.5e-9]), np.array([1.0, 0.7, 3.0]), [0.0, 0.5]
    about = J + np.array([1.0, 1.0, 0.0])
    slopes = np.array([J[1] - J[2] + 1.0, J[2] - J[0] - 1.0, J[0] - J[1]]) / about
    truth = solve_ivp(lambda _, w: slopes * w[[1, 2, 0]] * w[[2, 0, 1]], t, w, method="DOP853", rtol=1e-13, atol=1e-14)
    centre = np.array([0.0, 0.0, 1.0])
    needle = lieeuler.Problem([lieeuler.Body(1.0, np.diag(J))], [lieeuler.spherical_joint(-1, 0, (0, 0, 0), -centre)],
                              (0, 0, 0), [centre], [np.eye(3)], [np.cross(w, centre)], [w])
    run = lieeuler.integrate(needle, "taylor", t_eval=t, rtol=1e-14)
    assert np.abs(run.w[-1, 0] - truth.y[:, -1]).max() < 3e-13
    many = lieeuler.integrate_ensemble(needle, "taylor", t_eval=t, rtol=1e-14, w=np.tile(w, (9, 1, 1)))
    assert np.abs(many.w[:, -1, 0] - truth.y[:, -1]).max() < 3e-13
