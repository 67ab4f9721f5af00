"""Taylor series: coefficients, error against tolerance, constraints, dense output."""

from __future__ import annotations

import numpy as np
import pytest

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
