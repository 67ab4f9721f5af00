"""Sizes of quantities, and differences of motions."""

import numpy as np
import pytest

from crosscheck import load_scene
from crosscheck.compare.apart import apart, largest, scaled, spread, turn
from crosscheck.compare.sizes import at_rest, sizes
from crosscheck.scene.states import States
from crosscheck.scene.vectors import exponential

RNG = np.random.default_rng(3)


def moving(scene, by=0.0):
    """Two states of a scene, `by` (m) apart."""
    x = np.array([scene.x0, scene.x0 + by])
    return States(np.array([0.0, 1.0]), x, *(np.array([part, part]) for part in (scene.R0, scene.v0, scene.w0)))


@pytest.mark.parametrize("angle", [1e-12, 1e-6, 0.3, 3.0, np.pi])
def test_the_turn_is_the_rotation_vector(angle):
    axis = RNG.standard_normal(3)
    axis /= np.linalg.norm(axis)
    R = exponential(RNG.standard_normal(3))
    found = turn(R, R @ exponential(angle * axis))
    assert np.linalg.norm(found) == pytest.approx(angle, rel=1e-6)
    if angle < np.pi:
        assert found == pytest.approx(angle * axis, rel=1e-5, abs=1e-15)


def test_a_scene_far_from_the_origin_has_the_same_sizes():
    scene = load_scene("double_pendulum")
    near = moving(scene, 0.1)
    far = States(near.t, near.x + 1000.0, near.R, near.v, near.w)
    assert sizes(scene, near) == sizes(scene, far)


def test_what_travels_far_is_as_large_as_its_way():
    scene = load_scene("double_pendulum")
    assert sizes(scene, moving(scene, 100.0))["position"] == pytest.approx(100.0 * np.sqrt(3))


def test_rest_is_found_and_motion_is_not_rest():
    scene = load_scene("double_pendulum")
    still = moving(scene)
    still = States(still.t, still.x, still.R, 0 * still.v, 0 * still.w)
    assert at_rest(scene, still)
    still.w = still.w + 1e-6
    assert not at_rest(scene, still)


def test_differences_are_those_of_the_first_less_the_second():
    scene = load_scene("double_pendulum")
    one, other = moving(scene, 0.2), moving(scene)
    rows = apart(one, other)
    assert rows["position"][1] == pytest.approx(np.full((scene.n, 3), 0.2))
    assert largest(rows["attitude"]) < 1e-15
    assert "acceleration" not in rows
    size = {"position": 0.2, "attitude": 1.0, "velocity": 1.0, "angular velocity": 1.0}
    assert scaled(rows, size)[1, 0, :3] == pytest.approx([1.0, 1.0, 1.0])


def test_norms_are_infinite_where_nothing_is_known():
    assert largest(np.array([[1.0, np.nan]])) == np.inf
    assert largest(np.zeros((0, 3))) == 0.0
    assert spread([np.zeros((1, 3)), np.ones((1, 3)), -np.ones((1, 3))]) == pytest.approx(2 * np.sqrt(3))
