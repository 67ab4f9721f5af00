"""Taylor series: coefficients, error against tolerance, constraints, dense output, loops."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import crosscheck
import lieeuler
from crosscheck.adapters.lieeuler import build_problem
from lieeuler import _kernel
from tests.lieeuler.accuracy import EPS, dense_index1

# Between them: every kind of joint and force, bodies pinned and free, trees of few and many rows, redundant loops.
SCENES = ("single_pendulum", "double_pendulum", "universal_pendulum", "hinge_pendulum", "cylindrical_pendulum",
          "prismatic_slider", "planar_slider", "fixed_pair", "rod_pendulum", "bead_on_line", "puck_on_plane",
          "spring_pendulum", "damped_pendulum", "torsion_wheel", "loaded_pendulum", "branching_tree", "chain_8",
          "slider_crank", "four_bar", "bricard")  # fmt: skip
SMOOTH = (*(name for name in SCENES if name not in ("chain_8", "slider_crank")), "heavy_top", "triple_pendulum")


def start_of(name):
    problem = build_problem(crosscheck.load_scene(name))
    return problem, (problem.x, problem.R, problem.v, problem.w)


def horner(coefficients, t):
    value = np.zeros_like(coefficients[0])
    for c in coefficients[::-1]:
        value = value * t + c
    return value


def derivative(coefficients):
    return coefficients[1:] * np.arange(1, len(coefficients)).reshape(-1, *[1] * (coefficients.ndim - 1))


@pytest.mark.parametrize("name", SCENES)
def test_coefficients_solve_the_equations_order_by_order(name):
    """Put into the index-1 system, series of order p leave a residual of order t^p: every coefficient is right."""
    problem, state = start_of(name)
    order = 6
    series = _kernel.taylor_coefficients(problem.kernel, *state, order)
    assert series["status"] == "success"
    x, R, w = series["x"], series["R"], series["w"]
    v = derivative(x)

    def residual(t):
        at = [np.ascontiguousarray(horner(c, t)) for c in (x, R, v, w)]
        a = dense_index1(problem, *at)[0]
        # of the last coefficients of x and w, x is differentiated twice, w once: residuals of order - 1 and order
        return np.array([np.abs(a[:, 3:] - horner(derivative(w), t)).max(),
                         np.abs(a[:, :3] - horner(derivative(v), t)).max()]), np.abs(a).max()

    rate = max(1.0, np.abs(w[0]).max(), np.abs(v[0]).max())
    (coarse, size), (fine, _) = residual(0.04 / rate), residual(0.02 / rate)
    noise = 1e3 * EPS * size  # of accelerations from positions and velocities of rounding error eps
    for k, p in ((0, order), (1, order - 1)):
        assert fine[k] < noise or fine[k] < coarse[k] * 0.5 ** (p - 0.7), (k, coarse, fine)
        assert coarse[k] < 1e-2 * size


@pytest.mark.parametrize("name", ["double_pendulum", "heavy_top", "spring_pendulum"])
def test_error_proportional_to_the_tolerance(name, crosscheck_run, crosscheck_truth):
    tolerances = 10.0 ** np.arange(-4, -13, -1)
    truth = crosscheck_truth(name)
    # The whole rotation of the top, so that enough tolerances stay above what truth is known to.
    errors = [np.abs(crosscheck_run(name, "lieeuler", "taylor", rtol=rtol, spin_free=False).x[-1]
                     - truth.states.x[-1]).max() for rtol in tolerances]
    above = np.array(errors) > truth.allowed  # truth is not known below this
    slope = np.polyfit(np.log(tolerances[above]), np.log(np.array(errors)[above]), 1)[0]
    assert above.sum() >= 6
    assert 0.8 < slope < 1.2


@pytest.mark.parametrize("name", SMOOTH)
def test_error_floor(name, crosscheck_run, crosscheck_truth):
    """With the smallest useful tolerance: 1e-11, or what rounding of 1e-14 grows to, which truth has measured."""
    truth = crosscheck_truth(name)
    run = crosscheck_run(name, "lieeuler", "taylor", rtol=1e-13)
    horizon = truth.t <= truth.horizon
    bound = max(1e-11, 1e-14 * truth.amplification)
    assert np.abs(run.x - truth.states.x)[horizon].max() < bound
    assert np.abs(run.R - truth.states.R)[horizon].max() < bound


@pytest.mark.parametrize("name", ["double_pendulum", "rod_pendulum", "four_bar", "bricard"])
@pytest.mark.parametrize("rtol", [1e-4, 1e-10])
def test_constraints_hold_at_rounding_level(name, rtol, crosscheck_run):
    scene = crosscheck.load_scene(name)
    run = crosscheck_run(name, "lieeuler", "taylor", rtol=rtol)
    length = max(1.0, *(np.linalg.norm(s) for j in scene.joints for s in (j.parent_anchor, j.child_anchor)))
    rate = max(1.0, np.abs(run.w).max(), np.abs(run.v).max() / length)
    size = max(np.abs(run.a).max(), length * np.abs(run.alpha).max(), length * rate**2)
    assert run.stats["constraint_position"] < 50 * EPS * length
    speeds = np.abs(run.v).max() + length * np.abs(run.w).max()  # the terms of G u
    assert run.stats["constraint_velocity"] < 50 * EPS * max(1.0, speeds)
    assert run.stats["constraint_acceleration"] < 50 * EPS * size
    assert run.stats["orthogonality"] < 50 * EPS


@pytest.mark.parametrize("name", ["double_pendulum", "torsion_wheel", "four_bar"])
def test_dense_output(name, crosscheck_truth):
    """Samples between steps are as good as the steps, on the constraints, and have no influence on the steps."""
    truth = crosscheck_truth(name)
    problem, _ = start_of(name)
    many = lieeuler.integrate(problem, "taylor", rtol=1e-9, t_eval=truth.t)
    few = lieeuler.integrate(problem, "taylor", rtol=1e-9, t_eval=truth.t[[0, -1]])
    assert many.stats.steps == few.stats.steps < len(truth.t) * 5
    assert np.array_equal(many.x[-1], few.x[-1])
    errors = np.abs(many.x - truth.states.x).max(axis=(1, 2))
    assert errors.max() < 1e-9 * max(10.0, truth.amplification)
    gaps = [np.abs(_kernel.constraints(problem.kernel, many.x[k], many.R[k], many.v[k], many.w[k],
                                       np.zeros(problem.rows))["phi"]).max() for k in range(len(many.t))]
    assert max(gaps) < 50 * EPS * 5


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
