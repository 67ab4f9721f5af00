"""`explain` on a suite of seeded mistakes: none is acquitted, none named wrongly, few stay unknown."""

import functools

import pytest

from crosscheck import adapters
from crosscheck.diagnosis import explain
from tests.diagnosis.mistakes import MISTAKES, scene_of, scored
from tests.diagnosis.stepper import Stepper

SEED = 41
CASES = [(mistake, name) for mistake in MISTAKES for name in mistake.scenes]
QUICK = {("gyroscopic factor", "single_pendulum"), ("no centripetal term", "single_pendulum"),
         ("x at the joint", "single_pendulum"), ("float32 states", "single_pendulum")}


@functools.cache
def answered(key, name):
    """(score, sentence, exit code) of a mistake on a scene."""
    return scored(next(each for each in MISTAKES if each.key == key), name, SEED)


@pytest.mark.parametrize(("key", "name"), [
    pytest.param(mistake.key, name, marks=() if (mistake.key, name) in QUICK else pytest.mark.slow)
    for mistake, name in CASES])
def test_a_mistake_is_neither_acquitted_nor_named_wrongly(key, name):
    score, sentence, code = answered(key, name)
    assert score in ("named", "equally", "unknown"), sentence
    assert code > 0


@pytest.mark.slow
def test_few_stay_unknown():
    scores = [answered(mistake.key, name)[0] for mistake, name in CASES]
    assert len(MISTAKES) >= 60
    assert scores.count("unknown") <= 0.1 * len(scores)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["single_pendulum", "double_pendulum", "spring_pendulum", "hinge_pendulum",
                                  "torsion_wheel", "four_bar", "damped_pendulum", "loaded_pendulum", "rod_pendulum",
                                  "universal_pendulum", "triple_pendulum", "branching_tree"])
def test_a_right_engine_is_accused_of_nothing(name):
    answer = explain(scene_of(name), Stepper(), "RK4")
    assert (answer.outcome, answer.exit_code) == ("agrees", 0), answer.sentence


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
