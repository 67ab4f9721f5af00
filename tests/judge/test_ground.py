"""No green without ground: scenes in which nothing moves, and bounds of the user past those of the method."""

import dataclasses

import numpy as np
import pytest
from typer.testing import CliRunner

from crosscheck import load_scene
from crosscheck.cli.app import app
from crosscheck.compare.sizes import AT_REST, at_rest
from crosscheck.document import Finding, Plan, Record, Way
from crosscheck.judge.overrides import override
from crosscheck.judge.plan import halved
from crosscheck.judge.verdict import judge_rest, settle
from crosscheck.references import truth
from crosscheck.verification.cell import run_cell
from crosscheck.verification.task import Cell
from tests.fake_engine import FakeEngine, install

RESTING = """schema = 2
name = "resting"
gravity = [0.0, 0.0, -9.81]
duration = 1.0
samples = 26

[[bodies]]
name = "bob"
mass = 1.0
inertia = [[0.1, 0, 0], [0, 0.2, 0], [0, 0, 0.15]]
position = [0.0, 0.0, -1.0]

[[joints]]
name = "pivot"
type = "spherical"
parent = "ground"
child = "bob"
parent_anchor = [0.0, 0.0, 0.0]
child_anchor = [0.0, 0.0, 1.0]
"""
"""A pendulum that hangs still."""


@pytest.fixture
def resting(tmp_path):
    path = tmp_path / "resting.toml"
    path.write_text(RESTING, encoding="utf-8")
    return path


def test_a_scene_at_rest_judges_nothing(resting):
    scene = load_scene(resting)
    found = judge_rest(scene, truth(scene))
    assert [(each.kind, each.status) for each in found] == [("rest", "unresolved")]
    run = Record(scene="still", engine="fake", method="Plain", version="1", duration=1.0)
    settled = settle(run, [Finding("position", "ok", 0.0, 1e-9, "m", "why"), *found], (), judged_until=1.0)
    assert (settled.outcome, settled.share) == ("unresolved", 0.0)
    moving = load_scene("single_pendulum").replace(duration=1.0, samples=26)
    assert not judge_rest(moving, truth(moving))
    assert not at_rest(moving, truth(moving).states)


@pytest.mark.parametrize(("share", "rests"), [(0.9, True), (1.1, False)])
def test_rest_is_a_share_of_a_fall_through_the_length(resting, share, rests):
    scene = load_scene(resting)
    still = truth(scene)
    v = np.zeros_like(still.states.v)
    v[3, 0, 0] = np.sqrt(2 * share * AT_REST * 9.81)
    assert at_rest(scene, dataclasses.replace(still.states, v=v)) == rests


def test_a_robot_at_rest_is_unresolved(resting, tmp_path):
    words = ["verify", "--profile", "smoke", "--scene", str(resting), "--engine", "lieeuler", "--method", "rkmk4",
             "--jobs", "1", "--out", str(tmp_path / "report")]
    plain, lax = (CliRunner().invoke(app, [*words, *more]) for more in ([], ["--need", "0.01"]))
    assert (plain.exit_code, lax.exit_code) == (3, 3), plain.output
    assert plain.output.startswith("unresolved: ")
    assert "nothing moves" in plain.output
    assert "All" not in plain.output
    assert "Trust" not in plain.output


def test_a_bound_of_the_user_holds_as_far_as_truth_reaches(monkeypatch):
    """The error grows in proportion to the time: within the window of computed bounds it is a tenth."""
    install(monkeypatch, FakeEngine(claimed_order=1, real_order=1, size=1e-2))
    plan = Plan(1.0, {1: 1e-3}, {1: halved(4e-3)}, samples=26)
    cell = Cell("single_pendulum", Way("fake", "Plain"), plan, study=False)
    end = run_cell(cell).errors["position"]
    for tol, outcome in ((0.5 * end.max, "fail"), (2.0 * end.max, "pass")):
        run = run_cell(dataclasses.replace(cell, overrides=(("position", tol, "set by the user"),)))
        assert run.outcome == outcome
    assert end.judged == end.max
    assert end.time == 10.0


def test_a_bound_of_the_user_judges_the_largest_value():
    finding = Finding("position", "ok", 1e-5, 1e-3, "m", "why", "up to 1 s")
    kept, = override([finding], (("position", 2e-5, "set by the user"),))
    judged, = override([finding], (("position", 2e-5, "set by the user"),), {"position": (1.9e-4, "at 9 s")})
    assert (kept.status, judged.status, judged.value, judged.detail) == ("ok", "fail", 1.9e-4, "at 9 s")
