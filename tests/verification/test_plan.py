"""The steps that `crosscheck verify` takes, and how long its runs last."""

import dataclasses
import math

import pytest

from crosscheck.adapters.base import steps_per_sample
from crosscheck.compare.ladder import FEWEST
from crosscheck.document import Asked
from crosscheck.references import truth
from crosscheck.references.maximal import fastest
from crosscheck.scene.file import load_scene
from crosscheck.verification.plan import OUTPUTS, duration_within, plan_of


def test_no_step_of_a_stiff_scene_is_longer_than_its_fastest_decay():
    scene = load_scene("stiff_damped").replace(duration=0.05)
    assert fastest(scene) == pytest.approx(2e4, rel=0.05)  # of a damper of 2e4 N s/m on a mass of 1 kg
    steps = plan_of(scene, None, 100_000).steps
    assert max(steps.values()) * fastest(scene) < 0.2
    assert min(steps.values()) * fastest(scene) > 1e-3
    soft = dataclasses.replace(scene, forces=())
    assert min(plan_of(soft, None, 100_000).steps.values()) > 10 * max(steps.values()) or fastest(soft) == 0.0


def test_a_fast_motion_takes_smaller_steps_and_a_run_no_more_than_the_budget():
    top = load_scene("heavy_top").replace(duration=0.1, samples=6)
    slow = top.replace(bodies=tuple(dataclasses.replace(body, angular_velocity=(0.0, 0.0, 0.0)) for body in top.bodies))
    motion = truth(top).states
    assert plan_of(top, motion, 100_000).steps[1] <= 0.2 * plan_of(slow, None, 100_000).steps[1]
    few = plan_of(top, motion, 1000).steps
    assert top.duration / few[1] <= 1000
    assert all(step <= top.duration / 250 for step in plan_of(top, motion, 100_000).steps.values())


def test_a_step_and_a_duration_of_the_user_are_taken():
    scene = load_scene("double_pendulum")
    plan = plan_of(scene, None, 1000, asked=Asked(step=3e-4, duration=0.5))
    assert (plan.step(4), plan.step(1), plan.duration) == (3e-4, 3e-4, 0.5)


def test_many_bodies_run_for_a_part_of_their_time():
    chain = load_scene("chain_64")
    most = duration_within(chain)
    assert most is not None
    assert most < chain.duration
    assert duration_within(load_scene("double_pendulum")) is None
    assert duration_within(load_scene("double_pendulum"), 1.0) == 1.0


@pytest.mark.parametrize(("step", "until", "asked"), [
    (1e-3, 0.3086426602215586, None), (1e-3, 0.3086426602215586, 0.25), (7e-4, None, None), (0.02, 0.3086, None),
    (0.1, None, None), (0.01, None, None), (1e-3, None, 0.5), (5e-5, 0.3086, None)])
def test_a_step_that_is_asked_for_divides_the_interval_between_outputs(step, until, asked):
    """Truth that ends at .3086 s and 251 samples made steps of .617 ms of one of 1 ms that was asked for."""
    scene = load_scene("double_pendulum")
    plan = plan_of(scene, None, 1000, until, Asked(step=step, duration=asked))
    whole = asked or until or scene.duration
    made = (plan.duration or scene.duration) / (plan.samples - 1)
    assert made / step == pytest.approx(round(made / step), rel=1e-12)
    assert round(made / step) >= min(FEWEST, math.floor(whole / step) // OUTPUTS)  # where a run has them
    assert whole - made < (plan.duration or scene.duration) <= whole
    assert asked is None or plan.duration == asked
    assert 9 <= plan.samples <= 251


@pytest.mark.parametrize(("step", "asked"), [(7e-4, 0.5), (7e-4, 0.25), (0.03, 0.5), (3.0, None)])
def test_a_step_that_cannot_divide_it_is_cut_by_little(step, asked):
    scene = load_scene("double_pendulum").replace(duration=asked or 2.0)
    plan = plan_of(scene, None, 1000, asked=Asked(step=step, duration=asked))
    assert (plan.duration, plan.steps) == (asked, {1: step})
    made = steps_per_sample(scene.replace(samples=plan.samples), step)[1]
    assert made < step
    assert made > 0.9 * step or plan.samples == 251
    assert step == 3.0 or plan.samples < 251
