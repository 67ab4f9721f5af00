"""A test that leaves method and step open starts no run of millions of steps."""

from __future__ import annotations

import pytest

import crosscheck
from crosscheck.testing.agreement import contender
from crosscheck.verification.plan import PROFILES


@pytest.mark.parametrize("engine", ["lieeuler", "lieeuler:DAE1L_LSE", "mujoco:Euler"])
def test_a_chosen_step_keeps_to_the_budget_and_one_of_ones_own_is_taken(engine):
    scene = crosscheck.load_scene("heavy_top").replace(duration=1.0, samples=11)
    truth = crosscheck.truth(scene)
    chosen = contender(engine, scene, truth)
    assert scene.duration / chosen.step <= PROFILES["default"].most_steps
    assert contender(engine, scene, truth, 1e-4).step == 1e-4
    assert contender((chosen.engine, chosen.method, {"step": 1e-5}), scene, truth, 1e-4).step == 1e-5
