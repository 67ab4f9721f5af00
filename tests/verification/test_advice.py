"""Advice: its choice among known runs, its ladder of runs of an engine of known errors, and a real engine."""

import dataclasses
import json

import msgspec
import numpy as np
import pytest
from typer.testing import CliRunner

import crosscheck
from crosscheck import adapters
from crosscheck.adapters.base import Engine, RawRun, step_text, steps_per_sample
from crosscheck.cli.app import app
from crosscheck.compare.sizes import sizes
from crosscheck.errors import ArgumentError, EngineError, Unsupported
from crosscheck.studies.stability import lines
from crosscheck.verification import advice
from crosscheck.verification.advice import choose, of_ladders
from crosscheck.verification.ladder import Ladder, Rung


@pytest.fixture(autouse=True)
def short(monkeypatch):
    """Ladders of a few seconds."""
    monkeypatch.setattr(advice, "BUDGET", 8.0)


def rung(method, size, error, cost, order=2):
    errors = {} if error is None else {"max_position": 3 * error, "max_attitude": error / 2}
    return Rung("engine", method, size, form="tree", scene="scene", label=f"engine {method}", order=order,
                steps=round(1 / size), error=error, wall_ms=cost and 1e3 * cost, **errors)


KNOWN = Ladder(scene="scene", engine="engine", until=1.0, interval=0.2, climbed=[1e-3], rungs={
    str(place): each for place, each in enumerate([
        rung("fine", 0.1, 1e-3, 2.0), rung("fine", 0.05, 2e-4, 4.0), rung("fine", 0.2, 0.5, 1.0),
        rung("cheap", 0.1, 2e-2, 0.1), rung("cheap", 0.01, 9e-4, 1.5), rung("cheap", 0.2, None, None)])})


def test_the_cheapest_method_with_its_largest_step_is_chosen():
    loose, tight = choose(KNOWN, 1e-3, "my scene.toml"), choose(KNOWN, 5e-4, "scene")
    assert (loose.method, loose.step, loose.error, loose.cost) == ("cheap", 0.01, 9e-4, 1.5)
    assert loose.breaks_at == 0.2  # a run that failed
    assert loose.command == "crosscheck run 'my scene.toml' --engine engine --method cheap --step 0.01"
    assert (tight.method, tight.step, tight.breaks_at) == ("fine", 0.05, 0.2)  # a run wrong by half of the scene


@pytest.mark.parametrize(("interval", "count", "text"), [
    (0.01, 7, "0.00143"), (0.01, 10, "0.001"), (2 / 300, 1, "0.00667"), (0.01, 4096, "2.442e-06"), (0.1, 3, "0.0334")])
def test_a_step_has_few_digits_and_makes_the_same_run(interval, count, text):
    assert step_text(interval, interval / count) == text
    scene = crosscheck.load_scene("single_pendulum").replace(duration=2 * interval, samples=3)
    assert steps_per_sample(scene, float(text))[0] == count


def test_no_method_is_named_where_none_reaches_the_error():
    found = choose(KNOWN, 1e-5, "scene")
    assert (found.method, found.step, found.command, found.least) == (None, None, None, 2e-4)
    assert found.tried == "within the budget of 8 s; finest step tried 0.01 s"
    stalled = choose(msgspec.structs.replace(KNOWN, stalled=True), 1e-5, "scene")
    assert stalled.tried == "down to steps at which errors fall no more; finest step tried 0.01 s"


def test_errors_by_quantity_are_in_si_and_count_alone():
    assert choose(KNOWN, {"attitude": 1.2e-4}, "scene").step == 0.05
    assert choose(KNOWN, {"position": 3e-3, "attitude": 1.2e-4}, "scene").step == 0.05
    assert choose(KNOWN, {"position": 5e-4}, "scene").method is None


def test_a_body_whose_centre_rests_is_not_right_by_its_position(monkeypatch):
    """Of a body that tumbles about a resting centre of mass any step has the positions; the attitude decides."""
    found = crosscheck.advise("axis_flip", engine="mujoco", error=1e-4)
    assert found.errors["position"] < 1e-12
    assert 1e-6 < found.errors["attitude"] <= found.error <= 1e-4
    assert crosscheck.advise("axis_flip", engine="mujoco", error={"position": 1e-6}).step > 2 * found.step


@dataclasses.dataclass
class Known(Engine):
    """Position errors of `floor` + 0.0817 h^order along x; a step costs 10 us, and steps above `limit` (s) fail."""

    order: int
    floor: float = 0.0
    limit: float = np.inf
    refuses: str | None = None

    name = "known"
    checks_sizes = True
    methods = ("Plain",)
    runs = None  # the steps of all

    def version(self):
        return "1"

    def documented_order(self, scene, spec):
        return self.order

    def unsupported(self, scene, spec):
        return self.refuses

    def run(self, scene, spec):
        from crosscheck.references import truth

        per, h = steps_per_sample(scene, spec.step)
        self.runs = [*(self.runs or ()), h]
        if h > self.limit:
            raise EngineError("it diverged")
        states = truth(scene).states
        x = states.x + (self.floor + 0.0817 * h**self.order) * np.array([1.0, 0.0, 0.0])
        count = per * (scene.samples - 1)
        return RawRun(dataclasses.replace(states, x=x), wall_time=1e-5 * count, steps=count, step=h)


@pytest.fixture
def pretend(monkeypatch):
    """Makes an engine the only one."""
    def use(engine):
        monkeypatch.setattr(adapters, "get", lambda name: engine)
        return engine
    return use


@pytest.mark.parametrize("order", [1, 2, 4])
@pytest.mark.parametrize("error", [1e-2, 1e-4, 1e-6])
def test_the_largest_step_is_found_to_a_few_percent(pretend, order, error):
    if order == 1 and error == 1e-6:
        pytest.skip("1e6 steps")
    pretend(Known(order))
    found = crosscheck.advise("single_pendulum", engine="known", error=error)
    scene = crosscheck.load_scene("single_pendulum")
    interval = scene.duration / (scene.samples - 1)
    size = sizes(scene, crosscheck.truth(scene).states)["position"]
    fewest = max(1.0, interval / (error * size / 0.0817) ** (1 / order))  # steps in an interval, not yet a whole number
    assert found.errors["position"] == pytest.approx(found.error * size)
    assert found.error <= error
    assert fewest <= round(interval / found.step) <= max(np.ceil(fewest), advice.CLOSE * fewest + 1)


def test_a_wrong_model_reaches_nothing_and_a_limit_of_steps_is_named(pretend):
    pretend(Known(2, floor=1e-3, limit=0.03))
    found = crosscheck.advise("single_pendulum", engine="known", error={"position": 1e-4})
    assert found.method is None
    scene = crosscheck.load_scene("single_pendulum")
    assert 1e-3 <= found.least * sizes(scene, crosscheck.truth(scene).states)["position"] < 1.1e-3
    rough = crosscheck.advise("single_pendulum", engine="known", error={"position": 2e-3})
    assert rough.breaks_at > 0.03 >= rough.step


def test_no_run_is_made_twice(pretend):
    """Another error climbs the same ladder: it begins with the rungs that are known, whatever asked for them."""
    engine = pretend(Known(2))
    first = crosscheck.advise("single_pendulum", engine="known", error=1e-3)
    made = list(engine.runs)
    assert crosscheck.advise("single_pendulum", engine="known", error=1e-3) == first
    assert engine.runs == made
    second = crosscheck.advise("single_pendulum", engine="known", error=1e-5)
    added = engine.runs[len(made):]
    assert not {*made} & {step for step in added if abs(step / second.step - 1) > 1e-12}
    assert min(added) < min(made)
    ladder = advice.climb(crosscheck.load_scene("single_pendulum"), "known", [1e-5])
    before = list(engine.runs)
    advice.prepare(("single_pendulum", "known", ladder), every=True)  # for the study of largest steps
    assert engine.runs == before
    line, = lines(ladder)
    assert (line.step, line.breaks_at) == (max(before), None)


def test_a_document_has_the_advice_for_errors_that_were_looked_for():
    assert [each.wanted for each in of_ladders(["scene"], [KNOWN])] == [1e-3]
    assert of_ladders(["scene"], ["it has no method"]) == []


def test_wrong_arguments_and_scenes_that_an_engine_cannot_model(pretend):
    for error in (0.0, -1.0, float("nan"), float("inf"), "much", True, None):
        with pytest.raises(ArgumentError, match="positive number is wanted"):
            crosscheck.advise("single_pendulum", engine="mujoco", error=error)
    for error in ({}, {"place": 1.0}, {"position": 0.0}):
        with pytest.raises(ArgumentError, match="error"):
            crosscheck.advise("single_pendulum", engine="mujoco", error=error)
    with pytest.raises(ArgumentError, match="mujocco"):
        crosscheck.advise("single_pendulum", engine="mujocco", error=1e-3)
    pretend(Known(2, refuses="no such joint"))
    with pytest.raises(Unsupported, match="no such joint"):
        crosscheck.advise("single_pendulum", engine="known", error=1e-3)


def test_a_scene_at_rest_has_no_advice(tmp_path):
    """An engine that does nothing is right there, at any step."""
    hanging = {"schema": 2, "name": "rest", "gravity": [0.0, 0.0, -9.81], "duration": 1.0, "samples": 11,
               "bodies": [{"name": "bob", "mass": 1.0, "inertia": (0.01 * np.eye(3)).tolist()}],
               "joints": [{"name": "pivot", "type": "revolute", "parent": "ground", "child": "bob",
                           "parent_anchor": [0.0] * 3, "child_anchor": [0.0, 0.0, 0.5], "parent_axis": [0.0, 1.0, 0.0],
                           "child_axis": [0.0, 1.0, 0.0], "position": 0.0, "velocity": 0.0}]}
    (tmp_path / "rest.json").write_text(json.dumps(hanging))
    with pytest.raises(Unsupported, match="nothing moves"):
        crosscheck.advise(tmp_path / "rest.json", engine="mujoco", error=1e-3)


def test_a_real_run_keeps_what_the_advice_promises():
    found = crosscheck.advise("single_pendulum", engine="mujoco", error=1e-4)
    traj = crosscheck.run("single_pendulum", "mujoco", found.method, step=found.step, rtol=found.rtol)
    exact = crosscheck.truth("single_pendulum").states
    for name, size in (("x", "position"), ("v", "velocity"), ("w", "angular velocity")):
        error = np.linalg.norm(getattr(traj, name) - getattr(exact, name), axis=-1).max()
        assert error == pytest.approx(found.errors[size], rel=1e-6, abs=1e-14)
    assert found.error <= 1e-4
    assert traj.form == found.form
    done = CliRunner().invoke(app, ["advise", "single_pendulum", "--engine", "mujoco", "--error", "1e-4"])
    assert done.exit_code == 0, done.output
    assert found.command in done.output
    words = found.command.split()
    assert CliRunner().invoke(app, words[1:]).exit_code == 0
