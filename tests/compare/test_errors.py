"""Errors of runs against truth."""

import numpy as np
import pytest

from crosscheck.compare.apart import turn
from crosscheck.compare.errors import errors
from crosscheck.errors import ArgumentError
from crosscheck.scene.file import load_scene
from crosscheck.scene.states import States

EPS = np.finfo(float).eps


def turned(angle, axis=(1.0, 2.0, -2.0)):
    """Rotation about an axis by Rodrigues' formula, the versine written so that it keeps its digits near 0."""
    x, y, z = np.array(axis) / np.linalg.norm(axis)
    K = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + np.sin(angle) * K + 2 * np.sin(angle / 2) ** 2 * K @ K


@pytest.mark.parametrize("angle", [1e-12, 1e-9, 1e-6, 1e-3, 0.5, 1.5, 3.0, np.pi - 1e-6])
def test_angle_between_attitudes(angle):
    start = turned(0.7, (3.0, -1.0, 0.5))
    # Three products of rotations, each element rounded: some ten eps in the angle, whatever its size.
    assert np.linalg.norm(turn(start, start @ turned(angle))) == pytest.approx(angle, abs=20 * EPS, rel=0)


def test_angle_is_symmetric_and_zero_on_itself():
    R, S = turned(1.1), turned(0.4, (0.0, 1.0, 0.3))
    assert np.linalg.norm(turn(R, R)) < 5 * EPS
    assert np.linalg.norm(turn(R, S)) == pytest.approx(np.linalg.norm(turn(S, R)), abs=5 * EPS)


def standing(scene, samples=5):
    """A scene's initial state, repeated at `samples` times."""
    def still(values):
        return np.repeat(values[None], samples, axis=0)
    return States(np.linspace(0, 1, samples), still(scene.x0), still(scene.R0), still(scene.v0), still(scene.w0))


def test_errors_name_the_worst_body_and_time():
    scene = load_scene("double_pendulum")
    truth, run = standing(scene), standing(scene)
    run.x[3, 1] += [0.0, 3e-3, 4e-3]
    run.x[4, 0] += [1e-3, 0.0, 0.0]
    run.R[2, 0] = run.R[2, 0] @ turned(1e-5)
    found = errors(scene, run, truth)
    position, attitude = found["position"], found["attitude"]
    # Differences of numbers of size one: an eps each.
    assert position.max == pytest.approx(5e-3, abs=4 * EPS)
    assert (position.time, position.body) == (0.75, scene.bodies[1].name)
    assert position.end == pytest.approx(1e-3, abs=4 * EPS)
    assert attitude.max == pytest.approx(1e-5, abs=20 * EPS)
    assert attitude.body == scene.bodies[0].name
    assert found["velocity"].max == 0.0
    assert errors(scene, run, truth, until=0.5)["position"].max == 0.0


def test_a_run_that_blew_up_is_infinitely_wrong():
    scene = load_scene("single_pendulum")
    run = standing(scene)
    run.x[2:] = np.nan
    found = errors(scene, run, standing(scene))["position"]
    assert (found.max, found.end) == (np.inf, np.inf)
    assert found.time == 0.5


def test_different_output_times_are_refused():
    scene = load_scene("single_pendulum")
    late = standing(scene)
    late.t[1:] += 0.01
    for one, other in ((standing(scene, 4), standing(scene, 5)), (late, standing(scene))):
        with pytest.raises(ArgumentError, match="samples="):
            errors(scene, one, other)
    near = standing(scene)
    near.t[1:] += 0.8e-9  # as sums of steps differ
    assert errors(scene, near, standing(scene))["position"].max == 0
