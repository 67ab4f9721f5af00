"""Truth against elliptic functions; these, for tops, against printed digits, conserved quantities and their limits."""

import numpy as np
import pytest

from crosscheck.errors import Unsupported
from crosscheck.references import compute, taylor, truth
from crosscheck.scene.file import load_scene
from crosscheck.scene.model import GROUND, rotation_from_quaternion
from tests.references import closed_form

PRINTED = 2e-15  # fifteen decimals are printed; half a unit of the last one and a few roundings of numbers below 1


def random_top(build, seed, duration=2.0):
    """A top of random shape, pivot, gravity and motion."""
    rng = np.random.default_rng(seed)
    lever, across, along = rng.normal(size=3), 0.3, 0.25
    e = lever / np.linalg.norm(lever)
    half = (along - across) * np.outer(e, e) / 2
    body = (1.3, across * np.eye(3) + half + half.T, rng.normal(size=4), 3 * rng.normal(size=3))
    return build([body], [(GROUND, 0, rng.normal(size=3), -lever)], gravity=5 * rng.normal(size=3), duration=duration)


def test_printed_digits(top):
    states = closed_form.solve(top)
    np.testing.assert_allclose(states.x[100, 0], [.173343964098386, .640088592070569, -.748490791133581],
                               rtol=0, atol=PRINTED)
    np.testing.assert_allclose(states.x[20, 0], [.605550561377120, .598957681794919, -.523983027430003],
                               rtol=0, atol=PRINTED)
    q = np.array([.732943980679664, -.278285719337613, .531824611334163, -.320176142736249])
    # the printed components are off by up to 5e-16 each, and enter R in products with factors up to 2
    np.testing.assert_allclose(states.R[100, 0], rotation_from_quaternion(q), rtol=0, atol=4 * PRINTED)


@pytest.mark.parametrize("seed", range(5))
def test_conserved(build, seed):
    scene = random_top(build, seed)
    states = closed_form.solve(scene)
    body, x, w = scene.bodies[0], states.x[:, 0] - scene.joints[0].parent_anchor, states.w[:, 0]
    spin = np.einsum("tij,jk,tk->ti", states.R[:, 0], body.inertia, w)
    kinetic = 0.5 * body.mass * np.sum(states.v[:, 0] ** 2, axis=1) + 0.5 * np.sum(w * (w @ body.inertia), axis=1)
    energy = kinetic - body.mass * x @ scene.gravity
    momentum = (spin + body.mass * np.cross(x, states.v[:, 0])) @ scene.gravity
    # sums of about ten terms of rounded doubles: rounding level is 50 eps of the largest term
    for values in (energy, momentum):
        assert np.ptp(values) <= 50 * np.finfo(float).eps * max(np.max(kinetic), np.max(np.abs(values)))


@pytest.mark.parametrize("seed", range(5))
def test_agrees_with_taylor_in_everything(build, seed):
    scene = random_top(build, seed)
    exact, integrator = closed_form.solve(scene), taylor.Taylor(scene)
    series = integrator.states(integrator.run())
    for name in ("x", "R", "v", "w", "a", "alpha"):
        one, other = getattr(exact, name), getattr(series, name)
        # the floor of two formulations, (14.2) of docs/theory.md, relative to the size of the quantity
        np.testing.assert_allclose(one, other, rtol=0, atol=1e-12 * np.max(np.abs(one)), err_msg=name)


def test_steady_precession(build):
    """A double root u1 = u2: the axis keeps its angle and precesses at the constant rate of the textbook."""
    mass, length, across, along, g, theta, precession = 2.0, 0.5, 0.1, 0.2, 9.81, 1.0, 1.5
    pivot = across + mass * length**2
    spin = pivot * precession * np.cos(theta) / along + mass * g * length / (along * precession)
    tilt = [np.cos(theta / 2), np.sin(theta / 2), 0.0, 0.0]
    body = (mass, np.diag([across, across, along]), tilt, [0.0, precession * np.sin(theta), spin])
    scene = build([body], [(GROUND, 0, [0, 0, 0], [0, 0, -length])], duration=5.0)
    x = closed_form.solve(scene).x[:, 0]
    phase = precession * scene.t - np.pi / 2
    circle = np.column_stack([np.sin(theta) * np.cos(phase), np.sin(theta) * np.sin(phase),
                              np.full_like(phase, np.cos(theta))])
    # the spin is rounded to 2e-16 relative and nutation answers in proportion: rounding level over 5 s
    np.testing.assert_allclose(x, length * circle, rtol=0, atol=50 * np.finfo(float).eps)


def test_long_run_follows_every_branch(build):
    """Precession and spin go through many periods; a lost branch would be an error of order one."""
    scene = random_top(build, 11, duration=20.0)
    found, exact = compute(scene), closed_form.solve(scene)
    for name in "xR":
        np.testing.assert_allclose(getattr(found.states, name), getattr(exact, name), rtol=0, atol=found.error)


@pytest.mark.parametrize("name", ["axis_flip", "fast_top_1500", "heavy_top", "needle", "nesc_brick",
                                  "sleeping_top_above", "sleeping_top_below"])
def test_the_truth_of_the_library_is_that_of_elliptic_functions(name):
    """At five times up to the horizon, within the stated error."""
    found = truth(load_scene(name))
    taken = np.flatnonzero(found.states.t <= found.horizon)[[0, 1, 7, -2, -1]]
    exact = closed_form.solve(load_scene(name), found.states.t[taken])
    for quantity in "xR":
        np.testing.assert_allclose(getattr(found.states, quantity)[taken], getattr(exact, quantity), rtol=0,
                                   atol=found.error)


@pytest.mark.parametrize(("change", "reason"), [
    ({"inertia": np.diag([0.1, 0.2, 0.15])}, "not symmetric"),
    ({"gravity": (0, 0, 0)}, "no moment"),
    ({"anchor": [0, 0, 0]}, "no moment"),
    ({"w": [0, 2.0, 0]}, "vertical"),
])
def test_refuses_what_is_no_top(build, change, reason):
    tilt = [np.cos(0.5), 0.0, np.sin(0.5), 0.0]
    body = (1.0, change.get("inertia", np.diag([0.2, 0.2, 0.1])), tilt, change.get("w", [0.5, 0.3, 1.0]))
    scene = build([body], [(GROUND, 0, [0, 0, 0], change.get("anchor", [0, 0, 1]))],
                  gravity=change.get("gravity", (0, 0, -9.81)))
    with pytest.raises(Unsupported, match=reason):
        closed_form.solve(scene)
