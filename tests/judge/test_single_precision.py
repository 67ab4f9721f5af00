"""Engines in single precision that say so: what they can reach is told, and what is wrong above it is found."""

import dataclasses

import numpy as np
import pytest

from crosscheck.document import Way
from crosscheck.judge import tolerances
from crosscheck.references import truth
from crosscheck.verification.cell import run_cell
from crosscheck.verification.task import Cell, load
from tests.fake_engine import install
from tests.judge.test_right_engines import plan
from tests.right_engines import Floats, Rotations


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

    def after(self, scene, state):
        return Rotations.after(self, scene, state)

    def run(self, scene, spec):
        found = super().run(scene, spec)
        x = scene.joints[0].parent_anchor - found.states.R @ (scene.joints[0].child_anchor + 1e-7)
        return dataclasses.replace(found, states=dataclasses.replace(found.states, x=x))


def judged(monkeypatch, engine, name="single_pendulum", method="RK4"):
    install(monkeypatch, engine)
    return run_cell(Cell(name, Way("fake", method), plan(name), study=False, whole=False))


@pytest.mark.parametrize(("factors", "seen"), [
    ({"gravity": 1.01}, True), ({"inertia": 1.05}, True), ({"gravity": 1 + 1e-6}, False)])
def test_a_mistake_above_its_floor_is_caught_and_one_below_it_is_not(monkeypatch, factors, seen):
    run = judged(monkeypatch, Wrong(**factors))
    assert (run.outcome == "fail") == seen, [each for each in run.findings if each.status == "fail"]


def test_the_verdict_says_what_single_precision_can_reach(monkeypatch):
    run = judged(monkeypatch, Floats())
    told = next(finding for finding in run.findings if finding.kind == "arithmetic")
    assert told.why.startswith("single precision, spacing 1.2e-07 at 1, can reach about ")
    scene = load("single_pendulum", plan("single_pendulum"), False)
    exact = truth(scene)
    size = tolerances.scales(scene, exact).of("position")
    assert told.value == pytest.approx(2.0**-23 * exact.amplification * max(1.0, size), rel=1e-12)
    assert run.errors["position"].judged < 100 * told.value  # and it does
    assert not any(finding.kind == "arithmetic" for finding in judged(monkeypatch, Rotations()).findings)


@pytest.mark.parametrize(("engine", "kept"), [(Held(), True), (Open(), False)])
def test_it_counts_where_runs_show_it(monkeypatch, engine, kept):
    """Levels that hold by construction hold to the rounding of the engine's numbers, which two worlds show."""
    install(monkeypatch, engine)
    run = run_cell(Cell("single_pendulum", Way("fake", "RK4"), plan("single_pendulum"), study=False, whole=False))
    assert {each.kind: each.status for each in run.findings}["level position"] == ("ok" if kept else "fail")
