"""What rounding may leave in a scene, and what a method that says so may leave of what it promises."""

import dataclasses
from types import SimpleNamespace

import numpy as np
import pytest

from crosscheck import load_scene
from crosscheck.compare.sizes import sizes
from crosscheck.document import LEVELS, Record
from crosscheck.judge.rounding import EPS, grading, rounding_of
from crosscheck.references import truth
from crosscheck.verification.promises import judge_asked, judge_promises


@pytest.mark.parametrize(("name", "roundings"), [("single_pendulum", 50), ("triple_pendulum", 50), ("chain_64", 64),
                                                 ("light_heavy", 1e6 + 1), ("heavy_light", 1e6 + 1), ("needle", 1e6)])
def test_graded_masses_and_inertias_are_allowed_their_roundings(name, roundings):
    assert grading(load_scene(name)) == pytest.approx(roundings, rel=1e-5)


@pytest.mark.parametrize(("changes", "expected"), [
    ({"inertia": np.diag([1.0, 1.0, 1e-3])}, 1e3), ({"inertia": np.diag([0.01, 1.0, 1.01])}, 101.0),
    ({"mass": 1e-3}, 1001.0), ({}, 50.0)])
def test_one_thin_or_light_body_grades_a_scene(changes, expected):
    scene = load_scene("double_pendulum")
    whole = dataclasses.replace(scene.bodies[0], mass=1.0)
    bodies = whole, dataclasses.replace(whole, name="other", **changes)
    assert grading(scene.replace(bodies=bodies)) == pytest.approx(expected)


def test_rounding_between_two_versions_grows_with_the_steps_and_the_motion():
    scene = load_scene("double_pendulum").replace(duration=0.5, samples=6)
    known = truth(scene)
    size = sizes(scene, known.states)
    found = rounding_of(scene, known, size)
    assert set(found) == set(size)
    assert found["velocity"] == pytest.approx((known.error * size["velocity"], 50 * EPS * known.amplification
                                               * size["velocity"]))


def run_of(steps=100, orthogonality=0.0, maxima=None, told=0.01, **levels):
    """A run of five outputs with these residuals at the last one."""
    series = {f"constraint_{level}": np.array([0.0] * 4 + [levels.get(level, 0.0)]) for level in LEVELS}
    return SimpleNamespace(t=np.linspace(0.0, 1.0, 5), x=np.ones((5, 1, 3)), steps=steps, maxima=maxima or {},
                           orthogonality=np.array([orthogonality]), stats={"step": told}, status="success", **series)


SIZES = {"position": 1.0, "velocity": 2.0, "acceleration": 4.0, "angular velocity": 5.0}


def failing(traj, held=(), iteration=0.0, on_group=False, eps=EPS):
    found = judge_promises(load_scene("single_pendulum"), traj, frozenset(held), SIZES, eps, iteration, on_group)
    return {each.kind.removeprefix("promise ") for each in found if each.status == "fail"}


@pytest.mark.parametrize(("level", "size"), [("position", 2.0), ("velocity", 102.0), ("acceleration", 204.0)])
def test_held_levels_hold_to_rounding_at_every_step(level, size):
    """Rates are differences of the level below over a step."""
    beyond, within = 1.01 * 50 * EPS * size, 0.99 * 50 * EPS * size
    assert failing(run_of(**{level: beyond}), [level]) == {f"level {level}"}
    assert failing(run_of(maxima={f"constraint_{level}": beyond}), [level]) == {f"level {level}"}
    assert not failing(run_of(**{level: within}), [level])
    assert not failing(run_of(**{level: 1e3}))  # nothing is promised
    assert not failing(run_of(**{level: 1e3 * within}), [level], eps=1e3 * EPS)


@pytest.mark.parametrize(("level", "rate"), [("position", 1.0), ("velocity", 2.0), ("acceleration", 4.0)])
def test_what_an_iteration_is_declared_to_leave_is_allowed(level, rate):
    assert not failing(run_of(**{level: rate * 3e-6}), [level], iteration=1e-6)
    assert failing(run_of(**{level: rate * 3.03e-6}), [level], iteration=1e-6)


def test_rows_of_another_form_differ_by_the_turn_of_an_opening_below():
    assert not failing(run_of(position=1e-6, velocity=14.9e-6), ["velocity"])
    assert failing(run_of(position=1e-6, velocity=15.1e-6), ["velocity"]) == {"level velocity"}
    assert failing(run_of(position=1e-6, velocity=1e-6), ["position", "velocity"]) == {"level position"}


def test_rotation_matrices_that_are_declared_to_stay_on_the_group_are_orthogonal_to_rounding():
    assert not failing(run_of(10**6, 0.99 * 50 * EPS), on_group=True)
    assert failing(run_of(10**6, 1.01 * 50 * EPS), on_group=True) == {"orthogonality"}
    assert not failing(run_of(10**6, 0.1), on_group=False)  # its limit is judged


@pytest.mark.parametrize(("steps", "told", "status"), [
    (100, 0.01, "ok"), (100, None, "ok"), (99, 0.01, "fail"), (50, 0.02, "fail"), (100, 0.02, "fail"),
    (200, 0.01, "fail")])
def test_a_run_makes_the_steps_that_it_was_asked_for(steps, told, status):
    run = Record(scene="single_pendulum", engine="fake", version="1", method="Plain", step=0.01)
    end, made = judge_asked(run, load_scene("single_pendulum"), run_of(steps, told=told), 25, 0.01)
    assert (end.status, made.status) == ("ok", status)
