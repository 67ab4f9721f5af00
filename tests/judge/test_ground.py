"""No green without ground: scenes in which nothing moves, and tolerances of the user over the whole run."""

import dataclasses

import numpy as np
import pytest
from typer.testing import CliRunner

from crosscheck import load_scene
from crosscheck.cli.app import app
from crosscheck.compare.sizes import AT_REST, at_rest
from crosscheck.document import Plan, Way
from crosscheck.judge.overrides import BY_USER
from crosscheck.judge.verdict import needing
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
    run = run_cell(Cell(str(resting), Way("lieeuler", "rkmk4"), Plan({1: 1e-2}, samples=26)))
    assert (run.outcome, run.share) == ("unresolved", 0.0)
    assert "nothing moves" in run.message
    assert needing(run, 1e-9).outcome == "unresolved"
    moving = load_scene("single_pendulum").replace(duration=1.0, samples=26)
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


def test_a_tolerance_of_the_user_holds_over_the_whole_run(monkeypatch):
    """The error grows in proportion to the time."""
    install(monkeypatch, FakeEngine(claimed_order=1, real_order=1, size=1e-2))
    cell = Cell("single_pendulum", Way("fake", "Plain"), Plan({1: 1e-3}, samples=26))
    plain = run_cell(cell)
    most = plain.errors["position"]
    assert most.time == 10.0
    for tol, outcome in ((0.5 * most.max, "fail"), (2.0 * most.max, plain.outcome)):
        assert run_cell(dataclasses.replace(cell, overrides=(("position", tol, BY_USER),))).outcome == outcome
