"""Bounds follow from documented order and truth, and from nothing else."""

import dataclasses

import numpy as np
import pytest

from crosscheck.judge import tolerances
from crosscheck.judge.metrics import QUANTITIES, errors
from crosscheck.scene.file import load_scene

SECOND = {"duration": 1.0, "samples": 6}


@pytest.fixture(scope="module")
def pendulum():
    return load_scene("single_pendulum").replace(**SECOND)


@pytest.fixture(scope="module")
def truth(pendulum, crosscheck_truth):
    return crosscheck_truth(pendulum)


@pytest.mark.parametrize("order", [1, 2, 4, 6])
def test_bound_scales_with_the_documented_order(pendulum, truth, order):
    coarse, fine = (tolerances.fixed_step(pendulum, truth, order, step) for step in (0.1, 0.05))
    floor = tolerances.rounding(pendulum, truth, tolerances.scales(pendulum, truth).of("position"), 20)
    ratio = (coarse["position"].value - floor) / (fine["position"].value - floor)
    assert ratio == pytest.approx(2.0**order, rel=1e-4)  # the floors of 10 and 20 steps differ by some 1e-12


def test_every_bound_says_why(pendulum, truth):
    for bound in tolerances.fixed_step(pendulum, truth, 2, 1e-3).values():
        assert "A T h^2" in bound.why
        assert "from truth" in bound.why


def euler(scene, step, flaw=1.0):
    """Semi-implicit Euler for a body on a ball joint at the origin, in plain NumPy; gravity scaled by `flaw`."""
    from scipy.linalg import expm

    def hat(a):
        return np.array([[0, -a[2], a[1]], [a[2], 0, -a[0]], [-a[1], a[0], 0]])

    s, m, J, R, w = scene.joints[0].child_anchor, scene.masses[0], scene.inertias[0], scene.R0[0], scene.w0[0]
    about_joint = J - m * hat(s) @ hat(s)
    frames, per = [(R, w)], round(scene.duration / (scene.samples - 1) / step)
    for _ in range(scene.samples - 1):
        for _ in range(per):
            weight = np.cross(-s, m * flaw * (R.T @ scene.gravity))
            w = w + step * np.linalg.solve(about_joint, weight - np.cross(w, about_joint @ w))
            R = R @ expm(step * hat(w))
        frames.append((R, w))
    R, w = (np.array(part)[:, None] for part in zip(*frames, strict=True))
    from crosscheck.scene.states import States

    x = -np.einsum("tnij,j->tni", R, s)
    v = -np.einsum("tnij,tnj->tni", R, np.cross(w, s))
    return States(scene.t, x, R, v, w)


def test_a_right_method_is_within_its_bounds_and_a_wrong_one_is_not(pendulum, truth):
    step = 1e-3
    bounds = tolerances.fixed_step(pendulum, truth, 1, step)
    right = errors(pendulum, euler(pendulum, step), truth.states)
    assert all(right[name].max <= bounds[name].value for name in QUANTITIES)
    wrong = errors(pendulum, euler(pendulum, step, flaw=0.8), truth.states)
    assert any(wrong[name].max > bounds[name].value for name in QUANTITIES)


def test_bounds_that_would_pass_anything_are_noticed(pendulum, truth):
    assert tolerances.vacuous(pendulum, truth, tolerances.fixed_step(pendulum, truth, 1, 0.1)) >= {"position"}
    assert not tolerances.vacuous(pendulum, truth, tolerances.fixed_step(pendulum, truth, 1, 1e-4))


def test_held_levels_are_at_rounding_and_grow_with_the_size_of_their_terms(pendulum, truth):
    assert tolerances.held_level(pendulum, truth, "position").value == 1e-12
    top = load_scene("heavy_top").replace(duration=0.1, samples=6)
    from crosscheck.references import truth as truth_of

    terms = 2 * 150.0**2  # centripetal acceleration at one metre, twice
    assert tolerances.held_level(top, truth_of(top), "acceleration").value >= 50 * tolerances.EPS * terms


def test_levels_without_a_bound_are_not_judged(pendulum, truth):
    bounds = tolerances.fixed_step(pendulum, truth, 1, 1e-4)
    assert tolerances.free_level(pendulum, truth, "acceleration", bounds) is None
    assert tolerances.free_level(pendulum, truth, "position", bounds).value >= bounds["position"].value


def test_invariants_are_bounded_without_amplification(pendulum, truth):
    loose = tolerances.fixed_step(pendulum, truth, 1, 1e-4)
    tight = tolerances.fixed_step(pendulum, truth, 1, 1e-4, amplification=1.0)
    assert tolerances.energy(pendulum, truth, tight).value < tolerances.energy(pendulum, truth, loose).value
    assert tolerances.momentum(pendulum, truth, tight).value < tolerances.momentum(pendulum, truth, loose).value


@pytest.mark.parametrize(("name", "roundings"), [("single_pendulum", 50), ("triple_pendulum", 50), ("chain_64", 64),
                                                 ("light_heavy", 1e6), ("heavy_light", 1e6), ("needle", 1e6)])
def test_graded_masses_and_inertias_are_allowed_their_roundings(name, roundings):
    assert tolerances.grading(load_scene(name)) == pytest.approx(roundings, rel=1e-5)


def test_a_plate_is_graded_by_its_largest_moment(pendulum):
    body = dataclasses.replace(pendulum.bodies[0], inertia=np.diag([0.01, 1.0, 1.01]))
    assert tolerances.grading(pendulum.replace(bodies=(body,))) == pytest.approx(101.0)


def test_every_sample_of_an_adaptive_run_may_be_a_step(pendulum, truth):
    few, many = (tolerances.most_steps(pendulum, truth, 1e-8, samples, 10**9) for samples in (0, 100))
    assert many - few == 100


def test_bounds_of_an_adaptive_run_are_those_of_the_scenes_size(pendulum, truth):
    """A tenth of the pendulum's length, with the same angles."""
    joint = dataclasses.replace(pendulum.joints[0], child_anchor=0.1 * pendulum.joints[0].child_anchor)
    states = dataclasses.replace(truth.states, x=0.1 * truth.states.x, v=0.1 * truth.states.v)
    whole, tenth = (tolerances.adaptive(scene, known, 1e-6, 100)["position"].value for scene, known in (
        (pendulum, truth), (pendulum.replace(joints=(joint,)), dataclasses.replace(truth, states=states))))
    assert tenth < 0.2 * whole
