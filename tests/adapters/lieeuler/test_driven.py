"""What depends on time: accelerations, prescribed joints."""

import dataclasses

import numpy as np
import pytest

import lieeuler
from crosscheck.adapters.lieeuler import build_problem
from crosscheck.scene import functions, mechanics
from crosscheck.scene.constraints import Constraints
from tests.adapters.lieeuler.against_truth import errors, scene, solve
from tests.lieeuler.accuracy import assert_on_the_constraints, slopes

NAMES = ("driven_double_pendulum", "driven_cart", "driven_slider_crank")


@pytest.mark.parametrize("name", NAMES[:2])
@pytest.mark.parametrize("t0", [0.0, 0.37, 1.6])
def test_accelerations_at_any_time_are_those_of_the_dense_equations(name, t0):
    s = scene(name, 2.0, 3)
    run = lieeuler.integrate(build_problem(s), "INDEX1_LE", 1e-6, [t0, t0 + 1e-6])
    a, alpha, _ = mechanics.index1(s, s.x0[None], s.R0[None], s.v0[None], s.w0[None], t=np.array([t0]))
    size = max(np.abs(a).max(), np.abs(alpha).max())
    assert max(np.abs(run.a[0] - a[0]).max(), np.abs(run.alpha[0] - alpha[0]).max()) < 1e-13 * size


@pytest.mark.parametrize(("name", "duration"), [
    ("driven_cart", 1.2), ("driven_double_pendulum", 2.0), ("driven_slider_crank", 2.0)])
@pytest.mark.parametrize("method", ["rkmk54", "rkmk853", "taylor", "seulex"])
def test_errors_of_adaptive_methods_follow_the_tolerance(name, duration, method):
    """Over breaks too, of the cart; the crank is prescribed."""
    tolerances = np.logspace(-5, -10, 6)
    runs = [solve(name, method, duration, 5, rtol=rtol, monitor=False) for rtol in tolerances]
    found = slopes(tolerances, [errors(name, run, duration, 5) for run in runs])
    assert (found > 0.8).all(), found
    assert (found < 1.2).all(), found


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("method", ["DAE1L_LSE", "rattle4", "taylor", "rkmk853"])
def test_constraints_are_held(name, method):
    run = solve(name, method, 2.0, 5, **({"rtol": 1e-9} if method in ("taylor", "rkmk853") else {"step": 1e-2}))
    assert_on_the_constraints(run, build_problem(scene(name, 2.0, 5)))


LEVELS = ("constraint_position", "constraint_velocity", "constraint_acceleration")


@pytest.mark.parametrize(("method", "control"), [
    ("DAE1L_LSE", {"step": 1e-3}), ("DAE1H_LSE", {"step": 1e-3}), ("rattle8", {"step": 1e-2}),
    ("rkmk853", {"rtol": 1e-10}), ("taylor", {"rtol": 1e-10}), ("seulex", {"rtol": 1e-8})])
def test_a_prescribed_crank_is_held_at_all_three_levels(method, control):
    """By the kernel's own rows after every step, and by the rows of the harness, which share nothing with them."""
    s = scene("driven_slider_crank", 1.0, 6)
    run = lieeuler.integrate(build_problem(s), method, t_eval=s.t, **control)
    rows = Constraints(s)
    found = [rows.position(run.x, run.R, s.t), rows.velocity(run.x, run.R, run.v, run.w, s.t),
             rows.acceleration(run.x, run.R, run.v, run.w, run.a, run.alpha, s.t)]
    # lengths of one, speeds up to 5, accelerations up to 150: some hundred roundings of each
    for values, level, size in zip(found, LEVELS, (1.0, 5.0, 150.0), strict=True):
        assert np.abs(values).max() < 1e-14 * max(size, 2.0), level
        assert run.stats.maxima[level] < 1e-14 * max(size, 2.0), level
    angle = np.arctan2(run.R[:, 0, 2, 0], run.R[:, 0, 0, 0])  # about -y from the level
    drive = s.joints[0].drive
    np.testing.assert_allclose(angle, drive(s.t), rtol=0, atol=1e-14)
    np.testing.assert_allclose(-run.w[:, 0, 1], drive(s.t, 1), rtol=0, atol=5e-14)
    np.testing.assert_allclose(-run.alpha[:, 0, 1], drive(s.t, 2), rtol=0, atol=1e-12)


@pytest.mark.parametrize("method", ["DAE3L_LE", "DAE2L_LE", "DAE2H_LSE", "generalized_alpha"])
def test_levels_of_a_prescribed_crank_that_a_method_holds(method):
    s = scene("driven_slider_crank", 1.0, 6)
    maxima = lieeuler.integrate(build_problem(s), method, 1e-3, s.t).stats.maxima
    for level in ("position", "velocity"):
        held = level in lieeuler.METHODS[method].held
        assert (maxima[f"constraint_{level}"] < 1e-13) == held, (level, maxima)


def test_a_prescribed_slide_is_held():
    """The cart of the driven scene, its force replaced by the motion itself; the pendulum on it swings."""
    base = scene("driven_cart", 1.0, 5)
    drive = functions.spline([0.0, 0.3, 0.7, 1.0], [0.2, 0.5, 0.1, 0.3])
    rail = dataclasses.replace(base.joints[0], drive=drive)
    bodies = tuple(dataclasses.replace(body, velocity=np.array([drive(0.0, 1), 0.0, 0.0])) for body in base.bodies)
    s = base.replace(joints=(rail, base.joints[1]), forces=base.forces[1:], bodies=bodies)
    runs = [lieeuler.integrate(build_problem(s), method, t_eval=s.t, **control) for method, control in (
        ("rattle4", {"step": 2.5e-3}), ("taylor", {"rtol": 1e-11}), ("rkmk853", {"rtol": 1e-11}))]
    for run in runs:
        np.testing.assert_allclose(run.x[:, 0, 0], drive(s.t), rtol=0, atol=1e-14)
        np.testing.assert_allclose(run.v[:, 0, 0], drive(s.t, 1), rtol=0, atol=1e-13)
        assert np.abs(run.x - runs[1].x).max() < 1e-7  # rattle4 at this step
    assert np.abs(runs[1].x - runs[2].x).max() < 1e-9


def test_a_run_from_a_later_time_goes_on_as_the_whole_one_did():
    """The second half from where the first one ended, at its own time: to the rounding of the states handed over."""
    s = scene("driven_cart", 2.0, 5)
    whole = lieeuler.integrate(build_problem(s), "taylor", t_eval=[0.0, 0.5, 1.0, 2.0], rtol=1e-12)
    problem = build_problem(s)
    states = (whole.x[2], whole.R[2], whole.v[2], whole.w[2])
    later = lieeuler.Problem(problem.bodies, problem.joints, problem.gravity, *states, forces=problem.forces)
    for method, control in (("taylor", {"rtol": 1e-12}), ("rkmk853", {"rtol": 1e-12}), ("rattle8", {"step": 1e-2})):
        again = lieeuler.integrate(later, method, t_eval=[1.0, 2.0], **control)
        # rattle8 in steps of 1e-2, with stages beyond the break at 1.5 s, is the least accurate of the three
        assert np.abs(again.x[-1] - whole.x[-1]).max() < 1e-9, method
    wrong = lieeuler.integrate(later, "taylor", t_eval=[0.0, 1.0], rtol=1e-12)
    assert np.abs(wrong.x[-1] - whole.x[-1]).max() > 1e-2
