"""`explain` on a suite of seeded mistakes: none is acquitted, none named wrongly, few stay unknown."""

import functools

import pytest

from crosscheck import adapters
from crosscheck.diagnosis import explain, of_verdict
from crosscheck.diagnosis.observe import Subject
from crosscheck.document import Way
from tests.diagnosis.mistakes import LIKE, MISTAKES, made, method_of, scene_of, scored
from tests.engines.right import Adaptive, Floats, Millimetres, Projected, Rotations
from tests.engines.stepper import TABLEAUX, Matrices, Stepper

SEED = 41
RIGHT = ("single_pendulum", "double_pendulum", "heavy_top", "hinge_pendulum", "four_bar", "universal_pendulum",
         "spring_pendulum", "cylindrical_pendulum", "prismatic_slider", "triple_pendulum")
CASES = [(mistake, name) for mistake in MISTAKES for name in mistake.scenes]


@functools.cache
def answered(key, name):
    """(score, answer) of a mistake on a scene."""
    return scored(next(each for each in MISTAKES if each.key == key), name, SEED)


@pytest.mark.parametrize(("key", "name"), [(mistake.key, name) for mistake, name in CASES])
def test_a_mistake_is_neither_acquitted_nor_named_wrongly(key, name):
    score, answer = answered(key, name)
    assert score in ("named", "equally", "unknown"), answer.sentence
    assert answer.exit_code > 0


@pytest.mark.parametrize("cause", LIKE)
def test_a_look_alike_is_not_named(cause):
    mistake = next(each for each in MISTAKES if each.key == LIKE[cause])
    assert cause not in mistake.names
    _, answer = answered(mistake.key, mistake.scenes[0])
    assert cause not in {option for name in answer.names for option in name.split(" or ")}, answer.sentence


def test_every_cause_has_a_look_alike():
    assert {name for mistake in MISTAKES for name in mistake.names} <= LIKE.keys()


@pytest.mark.parametrize(("key", "name"), [(mistake.key, name) for mistake, name in CASES])
def test_there_is_no_tick_where_verify_fails(key, name):
    scene, engine = made(next(each for each in MISTAKES if each.key == key), name, SEED)
    if of_verdict.judged(Subject(engine, Way(engine.name, method_of(engine, scene))), scene, None).outcome == "fail":
        assert answered(key, name)[1].exit_code > 0


def test_few_stay_unknown():
    scores = [answered(mistake.key, name)[0] for mistake, name in CASES]
    assert len(MISTAKES) >= 60
    assert scores.count("unknown") <= 0.1 * len(scores)


@pytest.mark.parametrize("name", ["single_pendulum", "double_pendulum", "spring_pendulum", "hinge_pendulum",
                                  "torsion_wheel", "four_bar", "damped_pendulum", "loaded_pendulum", "rod_pendulum",
                                  "universal_pendulum", "triple_pendulum", "branching_tree"])
def test_a_right_engine_is_accused_of_nothing(name):
    answer = explain(scene_of(name), Stepper(), "RK4")
    assert (answer.outcome, answer.exit_code) == ("pass", 0), answer.sentence


def right_engines():
    """(scene, engine, method) of engines that are accused of nothing: all orders, other units, adaptive, declared."""
    engines = [*((Rotations, f"RK{order}") for order in TABLEAUX), (Matrices, "RK4"), (Projected, "RK4"),
               (Floats, "RK4"), (Adaptive, "DP5"), (Millimetres, "RK4")]
    return [(name, engine, method) for engine, method in engines for name in RIGHT
            if not (engine is Millimetres and name in ("spring_pendulum", "cylindrical_pendulum", "prismatic_slider"))]


@pytest.mark.parametrize(("name", "engine", "method"), right_engines())
def test_right_engines_are_accused_of_nothing(name, engine, method):
    scene = scene_of(name)
    answer = explain(scene.replace(duration=min(scene.duration, 0.75), samples=16), engine(), method)
    assert (answer.outcome, answer.exit_code) == ("pass", 0), answer.sentence


def test_an_object_of_two_methods_is_explained():
    """The class of docs/adding-an-engine.md: no orders, no levels, states alone."""
    class Bare:
        name, methods = "bare", ("rkmk4",)

        def unsupported(self, scene, spec):
            return None

        def run(self, scene, spec):
            wrong = scene.replace(gravity=0.9 * scene.gravity)
            return adapters.get("lieeuler").run(wrong, spec).states

    answer = explain(scene_of("single_pendulum"), Bare())
    assert "gravity size" in " ".join(answer.names), answer.sentence
