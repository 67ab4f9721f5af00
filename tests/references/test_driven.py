"""Truth of driven scenes: both formulations agree, and a late or missing function in one of them is found."""

import numpy as np
import pytest

from crosscheck.references import compute, maximal, taylor, tree_loads, truth
from crosscheck.scene import mechanics, model
from crosscheck.scene.constraints import Constraints
from crosscheck.scene.file import load_scene
from crosscheck.scene.functions import polynomial
from crosscheck.scene.model import GROUND, Body, Joint
from tests.scene_making import make_scene

NAMES = ("driven_double_pendulum", "driven_cart")
PRESCRIBED = ("driven_slider_crank",)


@pytest.mark.parametrize("name", NAMES)
def test_formulations_agree(name):
    scene = load_scene(name)
    truth = compute(scene)
    assert truth.disagreement <= 1e-12  # the bound of a well-conditioned scene: growth here is below 20
    other = maximal.Maximal(scene).run()
    for quantity in "xR":
        np.testing.assert_allclose(getattr(other, quantity), getattr(truth.states, quantity), rtol=0, atol=1e-13)
    states = truth.states
    a, alpha, _ = mechanics.index1(scene, states.x, states.R, states.v, states.w,
                                   mechanics.torsion_angles(scene, states), states.t)
    # accelerations up to some hundred, from states to 1e-14
    np.testing.assert_allclose(a, states.a, rtol=0, atol=1e-11)
    np.testing.assert_allclose(alpha, states.alpha, rtol=0, atol=1e-11)


@pytest.mark.parametrize("name", NAMES + PRESCRIBED)
def test_the_cached_truth_has_two_formulations(name):
    found = truth(load_scene(name))
    assert found.disagreement <= 1e-12
    assert "Taylor" in found.source
    assert "index-1 equations" in found.second_source


def test_the_truth_of_a_prescribed_crank_keeps_its_rows():
    scene = load_scene("driven_slider_crank")
    states, rows = truth(scene).states, Constraints(scene)
    found = (rows.position(states.x, states.R, states.t),
             rows.velocity(states.x, states.R, states.v, states.w, states.t),
             rows.acceleration(states.x, states.R, states.v, states.w, states.a, states.alpha, states.t))
    # a coordinate whose second derivative is integrated twice: roundings of some hundred steps
    assert [np.abs(values).max() < 1e-13 * size for values, size in zip(found, (1, 5, 150), strict=True)] == [True] * 3


def test_a_driven_hinge_may_have_opposite_axes_at_angle_zero():
    """The child starts upside down, so that its own axis is minus the parent's; the angle is the drive's."""
    z, still = np.array([0.0, 0.0, 1.0]), [0.0, 0.0, 0.0]
    arm = Body("arm", 1.0, np.diag([0.2, 0.3, 0.4]), [0.0, 1.0, 0.0, 0.0], still, [0.5, 0.0, 0.0], still)
    motor = Joint("motor", "revolute", GROUND, 0, np.zeros(3), np.array([-0.5, 0.0, 0.0]), z, -z,
                  drive=polynomial((0.0, 0.0, 1.5)))
    scene = make_scene([arm], [motor], samples=3)
    found = compute(scene)
    assert found.disagreement <= 1e-12
    angles = np.arctan2(found.states.R[:, 0, 1, 0], found.states.R[:, 0, 0, 0])
    np.testing.assert_allclose(angles, 1.5 * scene.t**2, rtol=0, atol=1e-13)


def late(function):
    return lambda value, t, *rest: function(value, t - 1e-9, *rest)


@pytest.mark.parametrize("module", [model, taylor])
def test_a_function_that_is_late_by_a_nanosecond_or_off_by_as_much_is_seen(module, monkeypatch):
    """1e-9 s times rates of some 30 1/s: far above 1e-12, and below what one would see in a figure."""
    scene = load_scene("driven_cart").replace(duration=0.4, samples=3)
    exact = maximal.Maximal(scene).run().x
    if module is taylor:
        monkeypatch.setattr(taylor.Taylor, "_expression", _weaker(taylor.Taylor._expression))
        other = taylor.Taylor(scene)
        found = other.states(other.run()).x
    else:
        monkeypatch.setattr(module, "at", late(module.at))
        found = maximal.Maximal(scene).run().x
    assert 1e-12 < np.abs(found - exact).max() < 1e-7


def _weaker(original):
    def expression(self, value):
        return original(self, value) * (1.0 - 1e-9)
    return expression


def test_a_joint_force_left_out_is_seen(monkeypatch):
    scene = load_scene("driven_cart").replace(duration=0.4, samples=3)
    right = maximal.Maximal(scene).run().x
    monkeypatch.setattr(tree_loads.Loads, "_along", lambda self, force, p, angle: None)
    other = taylor.Taylor(scene)
    assert np.abs(other.states(other.run()).x - right).max() > 1e-3
