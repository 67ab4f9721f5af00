"""The three answers: does an engine converge, to which law of friction, stops and servos, how far apart are they."""

from __future__ import annotations

import json
import types

import numpy as np
import pytest
from typer.testing import CliRunner

import crosscheck
from crosscheck import adapters
from crosscheck.adapters.common.own_law import OwnLaw
from crosscheck.adapters.mujoco.own_law import default
from crosscheck.cli.app import app
from crosscheck.diagnosis import Explanation, explain, laws, of_laws
from crosscheck.diagnosis.observe import Subject
from crosscheck.document import Advice, Way
from crosscheck.errors import ArgumentError, Unsupported
from crosscheck.scene.states import States
from tests.adapters.test_laws import SERVO, arm, coulomb, pendulum
from tests.law_mistakes import MISTAKES, SCENES, Wrong
from tests.references.law_scenes import pendulum as hanging
from tests.scene.models.model_files import ARM_URDF


def states(scene, angles):
    """The states of the pendulum at these angles; rates are only compared with rest."""
    q = np.array(angles)[:, None]
    moved = OwnLaw(scene, default, "mujoco").motion(q, np.gradient(q, scene.t, axis=0), np.zeros_like(q))
    return States(scene.t, moved.x, moved.R, moved.v, moved.w)


@pytest.fixture
def coulombs(monkeypatch):
    """The friction pendulum, with Coulomb's law by DOP853 and events as its truth."""
    scene = pendulum(dry_friction=0.5)
    exact = states(scene, coulomb(scene, 0.5)[0])
    monkeypatch.setattr(laws, "truth", lambda each: types.SimpleNamespace(states=exact))
    return scene


def test_mujoco_converges_to_its_own_friction_which_is_known_to_be_this_far(coulombs):
    answers = laws.which_law(coulombs, "mujoco", "RK4", 4e-3)
    assert answers.way.converges
    assert answers.way.limit() == "its own"
    assert answers.apart.size == pytest.approx(1.5882e-2, rel=1e-4)
    assert answers.way.to_scene[-1].size == pytest.approx(1.588e-2, rel=2e-3)
    assert answers.nearest.limit() == "the scene's"
    assert answers.nearest.to_scene[-1].size < 2e-3
    text = str(answers)
    for words in ("does it converge: yes", "to which law does it come: its own", "how far apart are the two: 1.588e-02",
                  "nearest setting: softness tight"):
        assert words in text


def test_tight_friction_is_the_scenes(coulombs):
    answers = laws.which_law(coulombs, "mujoco", "Euler", 2e-3, softness="tight")
    assert answers.way.limit() == "the scene's"
    assert answers.way.order == pytest.approx(1.0, abs=0.2)
    assert answers.nearest is None


def test_steps_that_cannot_tell_the_laws_apart_say_so(coulombs):
    """At a tenth of a second MuJoCo's Euler is farther from either law than these are from each other."""
    answers = laws.which_law(coulombs, "mujoco", "Euler", 0.1)
    assert answers.way.limit() == "both"
    assert answers.limit == "undecided"
    assert "to which law does it come: undecided, these steps may still change it by" in str(answers)
    assert "take a smaller --step" in str(answers)


def test_advise_gives_the_three_answers_in_words_and_in_json(coulombs, monkeypatch, tmp_path):
    advice = Advice(scene="pendulum", engine="mujoco", wanted=1e-2, until=4.0, least=1e-3, method="RK4", step=4e-3,
                    error=2e-3, cost=0.1)
    monkeypatch.setattr("crosscheck.verification.advice.advise", lambda scene, engine, error: advice)
    hanging(tmp_path, {"position": 1.2, "dry_friction": 0.5}, duration=4.0, samples=41)  # the same pendulum as a file
    asked = ["advise", str(tmp_path / "laws.json"), "--engine", "mujoco", "--error", "1e-2"]
    told = json.loads(CliRunner().invoke(app, [*asked, "--json"]).stdout)
    assert told["method"] == "RK4"
    said = CliRunner().invoke(app, asked).stdout
    for answer in ("does it converge: yes", "to which law does it come: its own",
                   "how far apart are the two: 1.588e-02", "nearest setting: softness tight (solreffriction="):
        assert answer in told["law"]
        assert f"law      {answer}" in said


def test_advise_asks_every_engine_and_takes_a_model(monkeypatch, tmp_path):
    """An engine without a softness is asked, too; the command repeats the model and what was dropped of it."""
    asked = []
    monkeypatch.setattr("crosscheck.diagnosis.laws.which_law",
                        lambda scene, engine, *given, **more: asked.append((engine, *given)) or "so")
    monkeypatch.setattr("crosscheck.verification.advice.advise", lambda scene, engine, error: Advice(
        scene=scene.name, engine=engine, wanted=error, until=1.0, least=1e-6, method="RKMK4", step=1e-2, error=1e-6,
        cost=0.1, command=f"crosscheck run {scene.name} --engine {engine}"))
    (tmp_path / "arm.urdf").write_text(ARM_URDF.replace('damping="0.5"', 'damping="0.5" friction="0.5"'))
    model = str(tmp_path / "arm.urdf")
    for drop in ([], ["--drop"]):  # which leaves the friction out
        done = CliRunner().invoke(app, ["advise", model, "--engine", "pinocchio", "--error", "1e-3", *drop])
        assert done.exit_code == 0, done.exception
        assert " ".join(["crosscheck run", model, *drop, "--engine pinocchio"]) in done.stdout
        assert ("law      so" in done.stdout) == (not drop)
    assert asked == [("pinocchio", "RKMK4", 1e-2)]


def test_a_wrong_law_is_neither(coulombs, monkeypatch):
    """The engine gets 5 % more friction: it converges, but to no law that is known."""
    run, wrong = laws.run, pendulum(dry_friction=0.525)
    monkeypatch.setattr(laws, "run", lambda scene, *rest, **options: run(wrong, *rest, **options))
    answers = laws.which_law(coulombs, "mujoco", "RK4", 4e-3)
    assert answers.way.converges
    assert answers.way.limit() == "neither"


def test_a_servo_is_the_scenes_and_has_no_other_law(monkeypatch):
    scene = arm(({**SERVO, "period": 0.02, "delay": 1},))
    exact = OwnLaw(scene, default, "mujoco").states(1e-12)
    monkeypatch.setattr(laws, "truth", lambda each: types.SimpleNamespace(states=exact))
    for engine, method in (("mujoco", "RK4"), ("pinocchio", "RKMK4")):
        answers = laws.which_law(scene, engine, method, 4e-3)
        assert answers.way.limit() == "the scene's"
        assert answers.way.order == pytest.approx(4.0, abs=0.3)
        assert answers.apart is None


def test_the_method_is_the_last_that_runs_the_scene(monkeypatch):
    """RKMK8 of Pinocchio has no friction."""
    monkeypatch.setattr(laws, "truth", lambda each: types.SimpleNamespace(states=crosscheck.run(
        each, "lieeuler", "taylor", rtol=1e-12, monitor=False)))
    answers = laws.which_law(pendulum(0.5, 6, dry_friction=0.5), "pinocchio", step=4e-3)
    assert answers.title == "pendulum, pinocchio SymplecticEuler"
    assert answers.limit == "the scene's"


def test_an_adaptive_method_is_refused():
    with pytest.raises(ArgumentError, match="fixed step"):
        laws.which_law(arm(), "lieeuler", "nothing")


NAMED = {"friction 5 % high": "dry friction", "restitution .6 instead of .5": "stop restitution",
         "a limit 5 % off": "stop lower", "saturation is ignored": "no saturation", "delay is ignored": "servo delay",
         "a spring for a stop": "soft stop", "a soft stop is rigid": "rigid limits"}


@pytest.mark.parametrize("what", NAMED)
def test_explain_names_the_law_that_an_engine_has_wrong(monkeypatch, tmp_path, what):
    mistake = next(each for each in MISTAKES if each.what == what)
    get, wrong = adapters.get, Wrong(mistake)
    monkeypatch.setattr(adapters, "get", lambda engine: get(engine) if engine == "lieeuler" else wrong)
    answer = explain(SCENES[mistake.scene](tmp_path).replace(name="made"), "fake", "rkmk4")
    assert answer.outcome == "fail"
    assert answer.names == (NAMED[what],)
    assert answer.explained < 1e-7 < answer.deviation


def test_explain_leaves_a_right_law_alone(tmp_path):
    scene = SCENES["bounce"](tmp_path)
    for engine, method in (("lieeuler", "rkmk4"), ("lieeuler", "DAE1L_LSE")):
        subject = Subject(adapters.get(engine), Way.of(engine, method))
        assert not of_laws.diagnose(subject, scene, Explanation(*[""] * 4, "pass", "", [], [], [], 1.0, None, None))


def test_a_robot_that_does_not_move_gets_no_green(monkeypatch):
    """A hinge that hangs at rest follows every law."""
    scene = pendulum(dry_friction=0.5)
    still = states(scene, np.zeros_like(scene.t))
    monkeypatch.setattr(laws, "truth", lambda each: types.SimpleNamespace(states=still))
    with pytest.raises(Unsupported, match="nothing moves in it, so that no law shows"):
        laws.which_law(scene, "mujoco", "RK4", 4e-3)


def test_motions_are_compared_until_truth_ends():
    """A monitor ends truth: all after it is NaN, which is no agreement."""
    scene = crosscheck.load_scene("hinge_pendulum").replace(duration=1.0, samples=11)
    run = crosscheck.run(scene, "lieeuler", "rattle2", step=0.02)
    exact = crosscheck.truth(scene).states
    found = laws.gap(scene, run, exact.until(0.5))
    assert found.joint
    assert found.t <= 0.5 + 1e-9
    assert found.size == laws.gap(scene, run, exact.at(slice(6))).size > 0.0
