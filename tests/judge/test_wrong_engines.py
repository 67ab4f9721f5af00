"""Every engine with a visible mistake fails, whenever the mistake begins; the right stepper is accused of nothing."""

import dataclasses

import numpy as np
import pytest

from crosscheck.adapters.base import steps_per_sample
from crosscheck.document import Plan, Way
from crosscheck.verification.cell import run_cell
from crosscheck.verification.task import Cell
from tests.engines.mistakes import MISTAKES, STEP
from tests.engines.stepper import CLASSIC, Turning
from tests.fake_engine import install

PLAN = Plan({1: STEP}, samples=26, duration=1.0)
SCENES = ("single_pendulum", "double_pendulum")


def judged(monkeypatch, engine, scene, order):
    install(monkeypatch, engine)
    return run_cell(Cell(scene, Way("fake", f"RKMK{order}"), PLAN))


def failing(run):
    return {finding.kind for finding in run.findings if finding.status == "fail"}


@pytest.mark.parametrize("scene", SCENES)
@pytest.mark.parametrize("order", [1, 2, 4])
def test_the_right_stepper_is_accused_of_nothing(monkeypatch, scene, order):
    assert not failing(judged(monkeypatch, Turning(), scene, order))


class Silent(Turning):
    """Does not say which step it takes."""

    def run(self, scene, spec):
        return dataclasses.replace(super().run(scene, spec), step=None)


def test_an_engine_that_does_not_tell_its_step_is_accused_of_nothing(monkeypatch):
    assert not failing(judged(monkeypatch, Silent(), "single_pendulum", 4))


class Lagging(Turning):
    """Reports accelerations of a step before, as engines of first order do that store them when they begin a step."""

    def run(self, scene, spec):
        self.h = steps_per_sample(scene, spec.step)[1]
        return super().run(scene, spec)

    def reported(self, scene, states):
        before = [self.step(scene, 0.0, [getattr(states, name)[k] for name in "xRvw"], -self.h, CLASSIC[4])
                  for k in range(1, len(states.t))]
        later = zip(*(self.told(scene, 0.0, state)[4:] for state in before), strict=True)
        return dataclasses.replace(states, **{name: np.array([getattr(states, name)[0], *part])
                                              for name, part in zip(("a", "alpha", "lam"), later, strict=True)})


@pytest.mark.parametrize("scene", SCENES)
def test_accelerations_of_the_step_before_are_accused_of_nothing(monkeypatch, scene):
    assert not failing(judged(monkeypatch, Lagging(), scene, 1))


def test_there_are_enough_mistakes():
    assert len(MISTAKES) >= 60
    assert len({mistake.name for mistake in MISTAKES}) == len(MISTAKES)


@pytest.mark.parametrize(("mistake", "scene", "order"), [
    pytest.param(mistake, scene, order, id=f"{mistake.name}-{scene}-{order}")
    for mistake in MISTAKES for scene in mistake.scenes for order in mistake.orders])
def test_every_visible_mistake_fails(monkeypatch, mistake, scene, order):
    run = judged(monkeypatch, mistake.make(np.random.default_rng(150)), scene, order)
    assert run.outcome == "fail", f"{mistake.name} on {scene} at order {order}"
