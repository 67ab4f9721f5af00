"""The stability map: the bisection on methods of known limits, a real run, its page, and a run that is killed."""

import csv
import json
import math

import numpy as np
import pytest
from typer.testing import CliRunner

from crosscheck import load_scene
from crosscheck.cli.app import app
from crosscheck.document import Way
from crosscheck.errors import ArgumentError
from crosscheck.studies import stability, study
from crosscheck.studies.stability import Attempt, Row, Search, Stability, StabilityAsk, Task
from crosscheck.studies.study import conduct

ONE = ["study", "stability", "single_pendulum", "--engine", "lieeuler", "--time-limit", "20", "--jobs", "1"]


def pretend(monkeypatch, outcome, seconds=1e-6):
    """Runs by a rule: `outcome(steps)` in place of an engine; `seconds` for a step."""
    made = []

    def tried(goal, way, steps):
        made.append(steps)
        return Attempt(steps, outcome(steps), None, seconds * steps)

    monkeypatch.setattr(stability, "tried", tried)
    return made


@pytest.mark.parametrize("limit", [1, 2, 7, 100, 4567])
def test_the_bisection_finds_the_fewest_usable_steps(monkeypatch, limit):
    pretend(monkeypatch, lambda steps: "usable" if steps >= limit else "inaccurate")
    found = Search(None, Way("engine", "method"), 10.0).fewest()
    assert limit <= found <= max(limit, math.ceil(stability.CLOSE * limit))


def test_a_step_that_is_usable_by_chance_does_not_count(monkeypatch):
    pretend(monkeypatch, lambda steps: "usable" if steps >= 100 or steps == 16 else "newton_failed")
    assert Search(None, Way("engine", "method"), 10.0).fewest() >= 100


def test_no_usable_step_within_the_limit(monkeypatch):
    made = pretend(monkeypatch, lambda steps: "diverged", seconds=1e-3)
    assert Search(None, Way("engine", "method"), 1.0).fewest() is None
    assert max(made) <= 1.35 * 1000 + 1  # finer runs would take longer than a second


def test_the_error_counts_positions_and_of_free_bodies_attitudes():
    scene = load_scene("single_pendulum").replace(samples=2)
    x, R = np.zeros((1, 3)), np.eye(3)[None]
    quarter = np.array([[[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]])
    jointed, free = (stability.Target(scene, x, R, 2.0, attitudes) for attitudes in (False, True))
    assert stability.end_error(jointed, x + np.array([0.0, 0.3, 0.4]), quarter) == pytest.approx(0.25)
    assert stability.end_error(free, x, quarter) == pytest.approx(np.pi / 2)
    assert stability.end_error(jointed, np.full((1, 3), np.nan), R) == math.inf


def row(scene, engine, method, step, outcome="usable"):
    return Row(engine, method, scene=scene, outcome=outcome, h_max=step)


def test_the_summary_takes_the_largest_steps_and_the_map_shades_by_them():
    rows = [row("a", "lieeuler", "one", 0.2), row("a", "lieeuler", "two", 0.4), row("a", "mujoco", "RK4", 0.1),
            row("a", "pinocchio", "RKMK8", 0.8), row("b", "lieeuler", "one", None, "failed"),
            row("b", "mujoco", "RK4", 0.3)]
    first, second = stability.summary(rows)
    assert (first.own, first.ratio, first.ratio_any) == ("lieeuler two", 4.0, 0.5)
    assert (second.own, second.stock, second.ratio) == ("", "mujoco RK4", None)
    shades = {(line.method, cell.scene): cell.shade for line in stability.shaded(rows) for cell in line.cells}
    assert shades["RKMK8", "a"] == 0
    assert shades["two", "a"] == 1
    assert shades["one", "a"] == 2
    assert shades["one", "b"] is None
    assert shades["RK4", "b"] == 0


def test_the_command_and_its_page(tmp_path):
    done = CliRunner().invoke(app, [*ONE, "--engine", "mujoco", "--method", "rattle2", "--method", "RK4", "--method",
                                    "DAE1H_LSE", "--out", str(tmp_path)])
    assert done.exit_code == 0, done.output
    rows = {row["method"]: row for row in csv.DictReader((tmp_path / "stability.csv").open())}
    assert set(rows) == {"rattle2", "RK4", "DAE1H_LSE"}
    steps = {method: float(row["h_max"]) for method, row in rows.items()}
    assert steps["DAE1H_LSE"] < steps["rattle2"] < steps["RK4"]  # by order: 1, 2, 4
    document = json.loads((tmp_path / "stability.json").read_text())
    runs = {run["steps"]: run["outcome"] for run in document["rows"][0]["runs"]}
    fewest = document["rows"][0]["steps"]
    assert all(outcome == "usable" for steps, outcome in runs.items() if fewest <= steps <= 1.35 * fewest)
    page = (tmp_path / "index.html").read_text()
    assert "lieeuler rattle2" in page
    assert {"report.css", "theme.js", "tables.js", "plotly.min.js"} <= {path.name for path in tmp_path.iterdir()}
    assert not list(tmp_path.glob(".*"))


@pytest.mark.slow  # that of drift is quick
def test_a_killed_study_goes_on_where_it_was(tmp_path, monkeypatch):
    """The study ends after its first method; the next study does not run that method again."""
    # an edit of the package between the two changes the code, so that the study starts afresh
    monkeypatch.setattr(study.provenance, "code_digest", lambda *_: 64 * "0")
    request = StabilityAsk(("single_pendulum",), ("lieeuler",), ("rattle2", "rattle4"), 20.0, 1)

    class Killed(BaseException):
        pass

    def progress(done, total, label):
        if label.endswith("rattle2"):
            raise Killed

    with pytest.raises(Killed):
        conduct(Stability(), request, tmp_path, progress)
    asked = []
    real = stability.run_tasks

    def watched(function, tasks, *more):
        asked.extend(tasks)
        return real(function, tasks, *more)

    monkeypatch.setattr(stability, "run_tasks", watched)
    document = conduct(Stability(), request, tmp_path, lambda *_: None)
    assert {task.way.method for task in asked if isinstance(task, Task)} == {"rattle4"}
    assert [row.method for row in document.rows] == ["rattle2", "rattle4"]
    assert all(row.outcome == "usable" for row in document.rows)


def test_folders_of_other_things_are_left_alone(tmp_path):
    (tmp_path / "thesis.tex").write_text("")
    with pytest.raises(ArgumentError, match="something else"):
        conduct(Stability(), StabilityAsk(("single_pendulum",)), tmp_path, lambda *_: None)
