"""Every engine with a visible mistake fails, whenever the mistake begins; the right stepper is accused of nothing."""

import dataclasses

import numpy as np
import pytest

from crosscheck.adapters.base import steps_per_sample
from crosscheck.document import Plan, Way
from crosscheck.judge.plan import halved, parts
from crosscheck.scene import mechanics
from crosscheck.verification.cell import run_cell
from crosscheck.verification.task import Cell
from tests.fake_engine import install
from tests.wrong_engines import MISTAKES, STEP, TABLEAUX, Right

PLAN = Plan(0.5, {1: STEP}, {1: halved(4e-3), 4: parts(0.1, 10, 14, 20, 28)}, samples=26, duration=1.0)
SCENES = ("single_pendulum", "double_pendulum")


def judged(monkeypatch, engine, scene, order, study=False):
    install(monkeypatch, engine)
    return run_cell(Cell(scene, Way("fake", f"RKMK{order}"), PLAN, study))


def failing(run):
    return {finding.kind for finding in run.findings if finding.status == "fail"}


@pytest.mark.parametrize("scene", SCENES)
@pytest.mark.parametrize("order", [1, 2, 4])
def test_the_right_stepper_is_accused_of_nothing(monkeypatch, scene, order):
    run = judged(monkeypatch, Right(), scene, order, study=True)
    assert failing(run) <= {"step"}, run.findings  # first order at this step has no bound on the double pendulum


class Lagging(Right):
    """Reports accelerations of a step before, as engines of first order do that store them when they begin a step."""

    def run(self, scene, spec):
        self.h = steps_per_sample(scene, spec.step)[1]
        return super().run(scene, spec)

    def reported(self, scene, states):
        before = [self.step(scene, [part[k:k + 1] for part in (states.x, states.R, states.v, states.w)], -self.h,
                            *TABLEAUX[4]) for k in range(1, len(states.t))]
        a, alpha, lam = mechanics.index1(scene, *(np.concatenate(parts) for parts in zip(*before, strict=True)))
        later = {"a": a, "alpha": alpha, "lam": lam}
        return dataclasses.replace(states, **{name: np.concatenate([getattr(states, name)[:1], part])
                                              for name, part in later.items()})


@pytest.mark.parametrize("scene", SCENES)
def test_accelerations_of_the_step_before_are_accused_of_nothing(monkeypatch, scene):
    assert failing(judged(monkeypatch, Lagging(), scene, 1)) <= {"step"}


def test_there_are_enough_mistakes():
    assert len(MISTAKES) >= 60
    assert len({mistake.name for mistake in MISTAKES}) == len(MISTAKES)


@pytest.mark.parametrize(("mistake", "scene", "order"), [
    pytest.param(mistake, scene, order, id=f"{mistake.name}-{scene}-{order}")
    for mistake in MISTAKES for scene in mistake.scenes for order in mistake.orders])
def test_every_visible_mistake_fails(monkeypatch, mistake, scene, order):
    run = judged(monkeypatch, mistake.make(np.random.default_rng(150)), scene, order)
    assert failing(run) - {"step"}, f"{mistake.name} on {scene} at order {order}"
