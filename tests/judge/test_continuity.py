"""Jumps that no motion has: silent resets and discontinuities, made in a true motion."""

import dataclasses

import numpy as np
import pytest

from crosscheck.judge.continuity import judge_continuity
from crosscheck.scene.file import load_scene


@pytest.fixture(scope="module")
def scene():
    return load_scene("double_pendulum").replace(duration=1.0, samples=51)


def judged(scene, states, truth):
    return {finding.kind: finding for finding in judge_continuity(scene, states, truth)}


def changed(states, **parts):
    return dataclasses.replace(states, **parts)


def test_a_true_motion_is_continuous_and_does_not_come_back(scene, truth):
    found = judged(scene, truth.states, truth)
    assert found["continuity"].status == "ok"
    assert 0 < found["continuity"].value <= found["continuity"].bound
    assert found["reset"].status == "ok"
    assert found["reset"].value == 0


def test_a_reset_to_the_start_is_seen_twice(scene, truth):
    states, parts = truth.states, {}
    for name in "xRvw":
        values = getattr(states, name)
        parts[name] = np.concatenate([values[:30], values[:21]])  # starts again, as after an automatic reset
    found = judged(scene, changed(states, **parts), truth)
    assert found["reset"].status == "fail"
    assert found["reset"].value == 1
    assert f"t = {scene.t[30]:.4g} s" in found["reset"].detail
    assert found["continuity"].status == "fail"
    assert found["continuity"].value > found["continuity"].bound


@pytest.mark.parametrize("body", [0, 1])
def test_a_jump_beyond_the_speeds_is_named_with_body_and_time(scene, truth, body):
    x = truth.states.x.copy()
    x[25:, body] += [1.0, 0.0, 0.0]
    found = judged(scene, changed(truth.states, x=x), truth)["continuity"]
    assert found.status == "fail"
    assert found.unit == "m"
    assert scene.bodies[body].name in found.detail
    assert f"{scene.t[24]:.4g} and {scene.t[25]:.4g} s" in found.detail


def test_a_turned_body_is_a_jump_too(scene, truth):
    R = truth.states.R.copy()
    R[40:, 1] = R[40:, 1] @ np.diag([1.0, -1.0, -1.0])
    found = judged(scene, changed(truth.states, R=R), truth)["continuity"]
    assert (found.status, found.unit) == ("fail", "rad")


def test_a_coarse_but_continuous_run_is_no_jump(scene, truth):
    """Errors that grow smoothly to a tenth of a metre."""
    x = truth.states.x + 0.1 * scene.t[:, None, None] ** 2
    assert judged(scene, changed(truth.states, x=x), truth)["continuity"].status == "ok"


def test_nothing_is_judged_beyond_the_horizon(scene, truth):
    x = truth.states.x.copy()
    x[40:] += 5.0
    early = dataclasses.replace(truth, horizon=float(scene.t[30]))
    assert judged(scene, changed(truth.states, x=x), early)["continuity"].status == "ok"
    assert judged(scene, changed(truth.states, x=x), truth)["continuity"].status == "fail"
