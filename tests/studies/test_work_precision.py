"""The work-precision study: a short real run, its failures, its ladders, its arguments."""

import csv
import dataclasses
import itertools
import json

import pytest
from typer.testing import CliRunner

from crosscheck import load_scene
from crosscheck.cli.app import app
from crosscheck.errors import ArgumentError, EngineError
from crosscheck.running.attempt import Failed
from crosscheck.scene.laws import DryFriction
from crosscheck.studies import work_precision
from crosscheck.studies.study import check_names, conduct
from crosscheck.studies.work_precision import WorkPrecision, WorkPrecisionAsk, measure
from crosscheck.verification import ladder as ladder_module
from crosscheck.verification import speed
from crosscheck.verification.ladder import INTERVALS, GradedWay, ladder, reference, ways


def quietly(*_):
    """A progress bar, or a keeper of rungs, that does nothing."""


@pytest.fixture(scope="module")
def swing():
    return reference(load_scene("single_pendulum").replace(duration=1.0))


def test_the_command(tmp_path):
    done = CliRunner().invoke(app, ["study", "work-precision", "single_pendulum", "--engine", "lieeuler", "--engine",
                                    "mujoco", "--method", "rkmk4", "--method", "taylor", "--method", "RK4",
                                    "--repeats", "1", "--time-limit", "0.004", "--no-bound", "--out", str(tmp_path)])
    assert done.exit_code == 0, done.output
    document = json.loads((tmp_path / "work-precision.json").read_text())
    (scene,) = document["scenes"]
    rows = list(csv.DictReader((tmp_path / "work-precision.csv").open()))
    assert len(rows) == len(scene["rungs"])
    timed = [rung for rung in scene["rungs"] if rung["status"] == "success"]
    assert {rung["label"] for rung in timed} == {"lieeuler rkmk4 (maximal)", "lieeuler taylor (maximal)",
                                                  "mujoco RK4 (tree)", "mujoco RK4 (maximal)"}
    assert all(rung["wall_ms"] > 0 and rung["setup_ms"] > 0 and rung["end_position"] <= rung["max_position"]
               for rung in timed)
    assert all(rung["force_evaluations"] for rung in timed if rung["engine"] == "lieeuler")
    assert [front["level"] for front in scene["frontier"]["end position"]] == [10.0**-k for k in range(2, 12)]
    page = (tmp_path / "index.html").read_text()
    assert "site.js" in page
    assert "plotly.min.js" in (tmp_path / "site.js").read_text()  # loaded where plots come into view
    assert "lieeuler taylor" in page
    assert (tmp_path / "plotly.min.js").stat().st_size > 1_000_000


def test_errors_fall_with_the_order_of_the_method(swing):
    scene, truth = swing
    way = GradedWay("lieeuler", "rkmk4", form="maximal", order=4)
    rungs = measure(scene, [way], truth, 1, 0.002, quietly, quietly, bound=False)
    by_steps = {rung.steps: rung.end_position for rung in rungs if rung.status == "success"}
    assert by_steps[16] / by_steps[32] == pytest.approx(2**4, rel=0.3)  # +-0.4 in the order: the steps are still long


def test_heyoka_is_the_bound_and_near_rounding_at_its_tightest(swing):
    scene, truth = swing
    rungs = measure(scene, [], truth, 1, 1.0, quietly, quietly)
    assert {rung.label for rung in rungs} == {"bound: heyoka"}
    assert all(rung.wall_ms and rung.steps for rung in rungs)
    # the truth itself is known to 1e-12, see crosscheck.references
    assert min(rung.max_attitude for rung in rungs) < 1e-12


def test_a_motion_in_pieces_is_measured_without_the_bound():
    free = load_scene("hinge_pendulum").replace(duration=0.5)
    rough = dataclasses.replace(free.joints[0], dry_friction=(DryFriction(0.1, 0.1),))
    scene, truth = reference(free.replace(joints=(rough, *free.joints[1:])))
    chosen, _ = ways(scene, ["lieeuler"], methods=["rkmk4"])
    rungs = measure(scene, chosen, truth, 1, 0.1, quietly, quietly)
    assert {rung.engine for rung in rungs} == {"lieeuler"}


def test_a_failed_run_is_a_row_and_the_others_go_on(swing, monkeypatch):
    scene, truth = swing
    way = GradedWay("lieeuler", "rkmk4", form="maximal", order=4)
    true_attempt = ladder_module.attempt
    calls = itertools.count()

    def breaking(scene, rung, samples, monitor, derived):
        if rung.step == 0.25:
            return Failed(EngineError("it broke\nin two lines"))
        if rung.step == 0.125 and samples == 2 and next(calls) == 1:
            return Failed(EngineError("not twice"))
        ran = true_attempt(scene, rung, samples=samples, monitor=monitor, derived=derived)
        if isinstance(ran, Failed):
            return ran
        steps = ran.raw.steps
        return dataclasses.replace(ran, raw=dataclasses.replace(ran.raw, wall_time=1e-6 * steps))  # on every machine

    monkeypatch.setattr(ladder_module, "attempt", breaking)
    monkeypatch.setattr(speed, "attempt", breaking)
    kept = []
    rungs = measure(scene, [way], truth, 2, 1e-4, quietly, lambda rungs: kept.append(len(rungs)), bound=False)
    broken = {rung.step: rung for rung in rungs if rung.status == "failed"}
    assert broken[0.25].reason == "it broke in two lines"
    assert broken[0.25].wall_ms is None
    assert broken[0.125].reason == "when timed: not twice"
    assert any(rung.status == "success" for rung in rungs)
    assert rungs[-1].status == "skipped"
    assert "longer than the limit" in rungs[-1].reason
    assert kept == [len(rungs)] * 3  # after the errors and after each round


def test_ladders_meet_the_samples_of_the_truth(swing):
    scene, _ = swing
    for order in (2, 8):
        way = GradedWay("lieeuler", "any", order=order)
        counts = [count for count, _ in itertools.islice(ladder(scene, way), 9)]
        assert counts == sorted(set(counts))
        assert all(INTERVALS % min(INTERVALS, count & -count) == 0 for count in counts)
    taylor = GradedWay("lieeuler", "taylor", adaptive=True)
    adaptive = [value for count, value in ladder(scene, taylor) if count is None]
    assert adaptive == sorted(adaptive, reverse=True)


def test_every_combination_is_a_way_or_has_a_reason(swing):
    from crosscheck import adapters

    scene, _ = swing
    names = ("lieeuler", "mujoco")
    found, missing = ways(scene, names)
    combinations = sum(len(adapters.get(name).forms) * len(adapters.methods(name)) for name in names)
    assert len(found) + len(missing) == combinations
    assert all(reason for _, reason in missing)
    assert {way.method for way in found if way.engine == "lieeuler"} == set(adapters.methods("lieeuler"))


def test_wrong_names_and_folders(tmp_path):
    with pytest.raises(ArgumentError, match=r"environment of its own.*mujoco"):
        check_names(["mujoco==3.3.7"], None)
    with pytest.raises(ArgumentError, match="tylor"):
        check_names(["lieeuler"], ["tylor"])
    (tmp_path / "thesis.tex").write_text("years of work")
    done = CliRunner().invoke(app, ["study", "work-precision", "single_pendulum", "--out", str(tmp_path)])
    assert isinstance(done.exception, ArgumentError)
    assert "something else" in str(done.exception)


def test_a_scene_without_truth_is_told(tmp_path, monkeypatch):
    from crosscheck.references import TruthError

    def disagree(scene):
        raise TruthError("two formulations disagree")

    monkeypatch.setattr(work_precision, "reference", disagree)
    document = conduct(WorkPrecision(), WorkPrecisionAsk(("single_pendulum",), ("lieeuler",)), tmp_path, quietly)
    assert document.scenes[0].failure == "two formulations disagree"
    assert "two formulations disagree" in (tmp_path / "index.html").read_text()


def test_the_truth_ends_where_it_stops_being_comparable(monkeypatch):
    from crosscheck import references

    scene = load_scene("single_pendulum").replace(duration=1.0)
    found = references.truth(scene.replace(samples=INTERVALS + 1))
    monkeypatch.setattr(references, "truth", lambda scene: dataclasses.replace(found, horizon=0.73))
    shortened, _ = reference(scene)
    assert shortened.duration == pytest.approx(0.7)


def test_runs_of_free_bodies_are_ranked_by_attitude(tmp_path):
    """Their centres of mass are right at any step. The page and the tables say what is compared."""
    done = CliRunner().invoke(app, ["study", "work-precision", "axis_flip", "--engine", "lieeuler", "--method", "rkmk4",
                                    "--repeats", "1", "--time-limit", "0.01", "--duration", "2", "--no-bound", "--out",
                                    str(tmp_path)])
    assert done.exit_code == 0, done.output
    assert "end attitude, rad" in done.output
    assert "ms to an end attitude of" in done.output
    assert "end error" not in done.output
    (scene,) = json.loads((tmp_path / "work-precision.json").read_text())["scenes"]
    assert scene["compared"] == "end attitude"
    rungs = [rung for rung in scene["rungs"] if rung["status"] == "success"]
    assert all(rung["end_position"] < 1e-12 for rung in rungs)
    assert rungs[0]["end_attitude"] > 1e-2
    assert min(rung["end_attitude"] for rung in rungs) < 1e-4  # the ladder does not end with the right positions
    costs = [front["own_cost"] for front in scene["frontier"]["end attitude"] if front["own_cost"]]
    assert costs == sorted(costs)
    assert costs[0] < costs[-1]
    page = (tmp_path / "index.html").read_text()
    assert '<option value="end_attitude" selected>' in page
    assert "error, rad" in page
    assert "error, m" not in page


@pytest.mark.parametrize("name", ["single_pendulum", "rolling_disk", "stiff_spring", "driven_cart"])
def test_runs_of_bodies_on_which_something_acts_are_ranked_by_position(name):
    """A joint or a force turns what a body does into a motion of its centre."""
    scene = load_scene(name)
    assert work_precision.compared(scene) == "end position"
    if not scene.joints:
        assert work_precision.compared(scene.replace(forces=())) == "end attitude"
