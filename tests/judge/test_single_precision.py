"""Engines in single precision that say so: what they can reach is told, and what is wrong above it is found."""

import dataclasses

import numpy as np
import pytest

from crosscheck.document import QUANTITIES
from tests.engines.right import Floats, Rotations
from tests.judge.test_right_engines import judged


class Wrong(Floats):
    """In single precision, with another gravity or mass distribution."""

    def __init__(self, gravity=1.0, inertia=1.0):
        self.factors = gravity, inertia

    def taken(self, scene):
        """The scene with both factors."""
        gravity, inertia = self.factors
        bodies = tuple(dataclasses.replace(body, inertia=inertia * np.asarray(body.inertia)) for body in scene.bodies)
        return dataclasses.replace(scene, gravity=gravity * np.asarray(scene.gravity), bodies=bodies)


class Held(Floats):
    """It says that its joint holds to rounding."""

    def held_levels(self, scene, spec):
        return frozenset({"position"})


class Open(Held):
    """In double precision whatever it says, its joint open by what single precision may leave."""

    def after(self, scene, t, state):
        return Rotations.after(self, scene, t, state)

    def run(self, scene, spec):
        found = super().run(scene, spec)
        x = scene.joints[0].parent_anchor - found.states.R @ (scene.joints[0].child_anchor + 1e-7)
        return dataclasses.replace(found, states=dataclasses.replace(found.states, x=x))


@pytest.mark.parametrize(("factors", "seen"), [
    ({"gravity": 1.01}, True), ({"inertia": 1.05}, True), ({"gravity": 1 + 1e-6}, False)])
def test_a_mistake_above_its_floor_is_caught_and_one_below_it_is_not(monkeypatch, factors, seen):
    run = judged(monkeypatch, "single_pendulum", Wrong(**factors), "RK4")
    assert (run.outcome == "fail") == seen, [each for each in run.findings if each.status == "fail"]


@pytest.mark.parametrize(("engine", "least", "most"), [(Floats(), 1e-7, 1e-4), (Rotations(), 1e-15, 1e-9)])
def test_the_verdict_says_what_an_engine_with_its_digits_can_show(monkeypatch, engine, least, most):
    run = judged(monkeypatch, "single_pendulum", engine, "RK4")
    assert run.outcome == "pass", run.message
    assert least < max(run.resolution[name] for name in QUANTITIES) < most


@pytest.mark.parametrize(("engine", "kept"), [(Held(), True), (Open(), False)])
def test_it_counts_where_runs_show_it(monkeypatch, engine, kept):
    """Levels that hold by construction hold to the rounding of the engine's numbers, which two worlds show."""
    run = judged(monkeypatch, "single_pendulum", engine, "RK4")
    assert {each.kind: each.status for each in run.findings}["promise level position"] == ("ok" if kept else "fail")
