"""A mistake in one column of the equations, of either formulation, is no truth, or is the error that it states."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import numpy as np
import pytest

from crosscheck.references import TruthError, articulated, compute, joint_motion, loops, tree_laws, tree_loads
from crosscheck.references import defects as defects_of
from crosscheck.references.taylor import Taylor
from crosscheck.scene import armature, basics, constraints, contacts, laws, mechanics
from crosscheck.scene.file import load_scene
from tests.references import law_scenes
from tests.references.test_joints_and_forces import joined, looped

SMALL = 1e-6
"""Relative, of numbers; a sign is turned."""


def turned(value):
    """The negative of an answer, of whatever shape."""
    return [turned(entry) for entry in value] if isinstance(value, list) else -1.0 * value


def grown(value):
    """A millionth more."""
    return [grown(entry) for entry in value] if isinstance(value, list) else (1.0 + SMALL) * value


def first(change):
    return lambda answer: (change(answer[0]), *answer[1:])


def brief(name, duration=0.3):
    return lambda folder: load_scene(name).replace(duration=duration, samples=4)


def made(kind, seed=77, *order):
    return lambda folder: joined(kind, seed, *order)


PENDULUM, PAIR, TOP = brief("hinge_pendulum"), brief("double_pendulum"), brief("heavy_top", 0.2)
FRICTION = lambda f: law_scenes.pendulum(f, {"position": 1.2, "dry_friction": 0.5})  # noqa: E731
SOFT = lambda f: law_scenes.pendulum(f, {"position": 1.2, "limits": {  # noqa: E731
    "lower": -0.5, "upper": 2.0, "stiffness": 300.0, "damping": 2.0}})
SERVO = lambda f: law_scenes.arm(f, forces=[law_scenes.servo("j1", effort_limit=8.0)])  # noqa: E731
LINE = lambda f: law_scenes.arm(f, forces=[law_scenes.servo("j1", effort_limit=8.0, no_load_speed=3.0)])  # noqa: E731
SAMPLED = lambda f: law_scenes.arm(f, forces=[law_scenes.servo("j1", period=0.02, delay=1)], duration=0.3)  # noqa: E731
BOUNCE = lambda f: law_scenes.arm(f, {"position": 1.0}, {"limits": {  # noqa: E731
    "lower": -0.3, "upper": 0.4, "restitution": 0.5}})
ROTOR = lambda f: load_scene("geared_arm").replace(duration=0.3, samples=4)  # noqa: E731

SEEDS: list[tuple[object, str, Callable, Callable]] = [
    # the series, in minimal coordinates
    (articulated, "gyroscopic", turned, TOP), (articulated, "gyroscopic", grown, TOP),
    (articulated, "weight", grown, PAIR), (articulated, "centripetal", turned, PAIR),
    (articulated, "_drag", turned, made("prismatic")), (articulated, "_drag", turned, made("point_on_plane")),
    (articulated, "_drag", turned, made("cylindrical")), (tree_loads, "slope", grown, made("revolute")),
    (tree_loads, "angle_rate", turned, made("revolute")),
    (loops, "acceleration", grown, lambda f: looped("distance", 37)),
    (loops, "_contact_terms", lambda terms: (*terms[:3], 0.0 * terms[3], *terms[4:]), brief("wobbling_disk")),
    (joint_motion, "zero_turn", lambda q: [q[0], q[1] + SMALL, *q[2:]], brief("universal_pendulum")),
    (tree_laws.LawfulTaylor, "table", lambda table: table * [1, 1 + SMALL, 1, 1, 1], FRICTION),
    (tree_laws.LawfulTaylor, "table", lambda table: table * [1, 1, 1 + SMALL, 1, 1], SOFT),
    (tree_laws.LawfulTaylor, "table", lambda table: table * [1, 1, 1, 1 + SMALL, 1], SOFT),
    (tree_laws.LawfulTaylor, "wanted", grown, SERVO), (tree_laws.LawfulTaylor, "wanted", grown, SAMPLED),
    (tree_laws.LawfulTaylor, "bound", lambda ends: 1.001 * ends, SERVO),
    (tree_laws, "_line", lambda line: (line[0], grown(line[1])), LINE),
    (tree_laws.LawfulTaylor, "kicked", lambda y: y * (1 + SMALL), BOUNCE),
    (tree_laws.LawfulTaylor, "moving", first(lambda q: q + SMALL), BOUNCE),
    (tree_laws.LawfulTaylor, "holding", grown, lambda f: law_scenes.slide(f, {"dry_friction": 0.5}, forces=[{
        "type": "joint_force", "joint": "s", "force": {"type": "sine", "terms": [[1.0, 1.0, 0.0]]}}], duration=2.0)),
    # the index-1 equations, in maximal coordinates
    (mechanics, "gyroscopic", turned, TOP), (mechanics, "gyroscopic", grown, TOP),
    (mechanics, "applied_forces", grown, PAIR), (mechanics, "inverse_mass", grown, made("revolute")),
    (mechanics, "_measured", first(grown), brief("torsion_wheel")), (mechanics, "_rate", turned, made("revolute")),
    (mechanics, "_point_velocity", turned, made("revolute")), (mechanics, "_in_world", turned, made("revolute")),
    (constraints.Constraints, "gamma", grown, PAIR), (basics.Basic, "gamma", turned, made("universal", 78)),
    (basics.Basic, "gamma", turned, made("cylindrical", 78)), (basics.Basic, "gamma", turned, made("distance", 78)),
    (contacts.RollingDisk, "gamma", grown, brief("wobbling_disk")),
    (basics.Angle, "gamma", lambda gamma: gamma + SMALL, brief("driven_slider_crank")),
    (armature, "_slide", lambda row: (row[0], turned(row[1]) + SMALL), ROTOR),
    (laws.DryFriction, "force", grown, FRICTION), (laws.Limits, "force", grown, SOFT),
    (laws.Servo, "effort", grown, SERVO), (laws.Servo, "bounds", lambda ends: tuple(map(grown, ends)), LINE),
    (laws.Servo, "effort", grown, SAMPLED),
    (defects_of._Events, "_impact", lambda change: None if change is None else grown(change), BOUNCE),
]


@pytest.mark.parametrize(("where", "name", "change", "scene"), SEEDS,
                         ids=[f"{getattr(seed[0], '__name__', '').split('.')[-1]} {seed[1]} {k}"
                              for k, seed in enumerate(SEEDS)])
def test_a_mistake_in_one_formulation_is_no_truth(where, name, change, scene, tmp_path, monkeypatch):
    loaded = scene(tmp_path)
    original = getattr(where, name)
    monkeypatch.setattr(where, name, lambda *arguments, **more: change(original(*arguments, **more)))
    try:
        found = compute(loaded)
    except TruthError:
        return
    assert found.error == found.disagreement > 100 * found.allowed


def test_a_start_beside_that_of_the_scene_is_no_truth(monkeypatch):
    loaded = load_scene("double_pendulum").replace(duration=0.3, samples=4)
    original = Taylor.__init__

    def beside(self, scene):
        original(self, dataclasses.replace(scene, bodies=tuple(dataclasses.replace(
            body, angular_velocity=body.angular_velocity + SMALL) for body in scene.bodies)))

    monkeypatch.setattr(Taylor, "__init__", beside)
    with pytest.raises(TruthError, match="disagree by"):
        compute(loaded)


@pytest.mark.parametrize("late", [1e-9, -1e-9])
def test_an_event_that_is_late_by_a_nanosecond_is_seen(late, tmp_path, monkeypatch):
    """It stops where it still moves, by the deceleration times that."""
    original = tree_laws.first_crossing

    def beside(surfaces, length, instant=0.0):
        found = original(surfaces, length, instant)
        return found and dataclasses.replace(found, after=found.after + late)

    monkeypatch.setattr(tree_laws, "first_crossing", beside)
    found = compute(FRICTION(tmp_path))
    assert 1e-10 < found.disagreement < 1e-7


def test_no_event_is_left_out(tmp_path, monkeypatch):
    """Friction that does not turn with the motion, and a stop that is passed."""
    monkeypatch.setattr(tree_laws, "first_crossing", lambda *arguments: None)
    for scene in (FRICTION, BOUNCE):
        with pytest.raises(TruthError, match=r"disagree by|breaks its laws"):
            compute(scene(tmp_path))


def test_what_the_defects_of_a_right_motion_leave_is_rounding(tmp_path):
    for scene in (PENDULUM, PAIR, TOP, FRICTION, SOFT, SERVO, SAMPLED, BOUNCE, ROTOR):
        found = compute(scene(tmp_path))
        assert found.disagreement < found.allowed, found
        assert np.isfinite(found.states.x).all()
