"""What counts as a change between runs, and where a series changes its level."""

import numpy as np
import pytest

from crosscheck.adapters.base import RawRun
from crosscheck.document import Order, Way
from crosscheck.history.changes import change_points, compare, machine_factor, sparkline
from crosscheck.history.figures import Figure
from crosscheck.history.overview import write_trend
from crosscheck.history.runs import Usual, run_from_document
from crosscheck.scene.file import load_scene
from crosscheck.verification import speed
from tests.history.store.documents import document, record


def run(*records, **more):
    return run_from_document("a run", document(list(records) or None, **more))


def told(before, after, **more):
    return [(change.kind, change.who, change.bad) for change in compare(before, after, **more)]


def test_the_same_run_has_not_changed():
    assert compare(run(), run(started="2026-11-21T02:00:00+00:00")) == []


def test_a_change_within_rounding_is_none_and_beyond_it_is_one():
    # Rounding is 1e-12 + 1e-14 * 1000 = 1.1e-11 m by the document's scene.
    assert compare(run(), run(record(error=1e-6 + 1e-11))) == []
    changes = compare(run(), run(record(error=1e-6 + 3e-11)))
    assert [(change.kind, change.scene, change.engine, change.method, change.quantity, change.bad)
            for change in changes] == [("accuracy", "single_pendulum", "mujoco", "RK4", "position error", True)]
    assert "rounding explains" in changes[0].text
    assert told(run(), run(record(error=1e-7))) == [("accuracy", "mujoco RK4", False)]


def test_a_lower_order_is_worse():
    order = Order(documented=4, observed=3.5, median=4.0, segments=8)
    change, = compare(run(), run(record(order=order)))
    assert (change.quantity, change.before, change.after, change.bad) == ("order", 4.0, 3.5, True)


def test_errors_as_large_as_the_scene_are_not_compared():
    assert compare(run(record(error=4.0)), run(record(error=4.4))) == []


def test_a_share_that_shrank_is_worse_and_one_that_grew_is_not():
    def changes(before, after):
        return told(run(record(outcome="unresolved", share=before)), run(record(outcome="unresolved", share=after)))

    assert changes(0.9, 0.9) == []
    assert changes(0.9, 0.8) == [("accuracy", "mujoco RK4", True)]
    assert changes(0.8, 0.9) == [("accuracy", "mujoco RK4", False)]


@pytest.mark.parametrize(("before", "after", "bad"), [
    ("pass", "unresolved", True), ("known", "unresolved", True), ("unresolved", "pass", False),
    ("unresolved", "unresolved", None), ("unresolved", "fail", True), ("fail", "fail", None)])
def test_an_outcome_that_stays_is_no_change(before, after, bad):
    found = told(run(record(outcome=before)), run(record(outcome=after)))
    assert [each[2] for each in found] == ([] if bad is None else [bad])


@pytest.mark.parametrize(("ratio", "deviation", "found"), [
    (0.0109, 1e-5, []),  # within 10 %
    (0.0090, 1e-5, [("speed", "mujoco RK4", False)]),
    (0.0130, 1e-4, [("speed", "mujoco RK4", True)]),
    (0.0130, 8e-4, []),  # within 4 deviations
])
def test_a_change_of_speed_is_beyond_ten_per_cent_and_four_deviations(ratio, deviation, found):
    assert told(run(record(deviation=1e-5)), run(record(ratio=ratio, deviation=deviation))) == found


@pytest.mark.parametrize(("factors", "found"), [
    ((1.0, 1.02, 423.0, 440.0, 467.0), []),  # most repeats had to wait for the machine
    ((2.0, 2.01, 2.02, 2.05, 90.0), [("speed", "mujoco RK4", True)]),
])
def test_a_run_is_slower_if_its_fastest_repeat_is(factors, found):
    summary = speed.summarise([(1e-5 * factor, 1e-3) for factor in factors])
    assert told(run(record(deviation=1e-5)), run(record(ratio=summary.ratio, deviation=summary.deviation))) == found


def test_the_usual_spread_between_runs_counts_too():
    cell = ("single_pendulum", "mujoco", "RK4", "")
    assert told(run(), run(record(ratio=0.013)), usual={cell: Usual(0.010, 8e-4)}) == []


@pytest.mark.parametrize(("engine", "call", "told"), [
    ("lieeuler", 0.0, 0.77e-6), ("mine.py:Mine", 1.2e-3, 0.77e-6), ("mine.py:Mine", 0.2, 0.77e-6 + 0.2 / 100)])
def test_a_step_of_an_engine_of_the_user_is_timed_without_what_a_call_costs(monkeypatch, engine, call, told):
    """Its clock is around the whole call: 1.2 ms of building on 100 steps of 0.8 us would hide 30 % of them."""
    def attempt(scene, way, **_):
        steps = round(scene.duration / way.step)
        return speed.Ran(scene, way, RawRun(None, call + 0.77e-6 * steps, steps, way.step))

    monkeypatch.setattr(speed, "attempt", attempt)
    scene, burst = load_scene("single_pendulum"), speed.Burst(Way(engine, "Any", step=1e-3))
    spans = speed._spans(scene, burst)
    assert speed._seconds_per_step(scene, burst, spans, 3) == pytest.approx(told, rel=1e-9)


def test_speeds_are_compared_with_the_usual_level_and_not_with_a_night_that_strayed():
    usual = {("single_pendulum", "mujoco", "RK4", ""): Usual(0.010, 2e-4)}
    strayed, slower = run(record(ratio=0.012)), run(record(ratio=0.013))
    assert told(strayed, slower) == []
    assert told(strayed, slower, usual=usual) == [("speed", "mujoco RK4", True)]
    assert told(run(record(ratio=0.008)), run(record(ratio=0.0102))) == [("speed", "mujoco RK4", True)]
    assert told(run(record(ratio=0.008)), run(record(ratio=0.0102)), usual=usual) == []


def engines(factors):
    return [record(engine=name, ratio=0.01 * factor) for name, factor in factors.items()]


def test_what_slows_most_engines_alike_is_the_machine():
    names = ("lieeuler", "mujoco", "pinocchio", "exudyn")
    before = run(*engines(dict.fromkeys(names, 1.0)))
    slow = run(*engines(dict.fromkeys(names, 1.25)))
    assert told(before, slow) == [("machine", "", False)]
    both = run(*engines(dict.fromkeys(names, 1.25) | {"exudyn": 1.25 * 1.3}))
    assert told(before, both) == [("speed", "exudyn RK4", True), ("machine", "", False)]
    one = run(*engines(dict.fromkeys(names, 1.0) | {"exudyn": 1.3}))
    assert told(before, one) == [("speed", "exudyn RK4", True)]
    two = ("lieeuler", "mujoco")
    assert machine_factor(run(*engines(dict.fromkeys(two, 1.0))), run(*engines(dict.fromkeys(two, 1.3)))) is None


def test_an_engine_that_slows_down_as_a_whole_shows_through_the_noise_of_its_runs():
    def noisy(factor, count, seed):
        generator = np.random.default_rng(seed)
        return run(*(record(method=f"M{number}", ratio=0.01 * factor * (1 + 0.08 * generator.standard_normal()),
                            deviation=2.5e-3) for number in range(count)))
    assert told(noisy(1.0, 14, 1), noisy(1.0, 14, 2)) == []
    assert told(noisy(1.0, 14, 1), noisy(1.4, 14, 3)) == [("speed", "mujoco", True)]
    assert told(noisy(1.4, 14, 1), noisy(1.0, 14, 3)) == [("speed", "mujoco", False)]
    assert told(noisy(1.0, 4, 1), noisy(1.4, 4, 3)) == []  # too few runs for a statement about all
    pairs = range(0, 400, 2)
    alarms, found = (sum(bool(told(noisy(1.0, 14, seed), noisy(factor, 14, seed + 1))) for seed in pairs)
                     for factor in (1.0, 1.3))
    assert alarms <= 4  # of 200; a nightly run measures a suspect twice more
    assert found >= 190
    cells = {("single_pendulum", "mujoco", f"M{number}", ""): Usual(0.01, 1.2e-3) for number in range(14)}
    assert told(noisy(1.0, 14, 1), noisy(1.35, 14, 3), usual=cells) == []  # nights differ as much


def test_outcomes_cells_scenes_and_settings():
    assert told(run(), run(record(outcome="fail", message="beyond"))) == [("outcome", "mujoco RK4", True)]
    assert told(run(record(outcome="fail")), run()) == [("outcome", "mujoco RK4", False)]
    assert told(run(), run(record(method="Euler"))) == [("missing", "mujoco RK4", True), ("new", "mujoco Euler", False)]
    edited = run(record(error=1.0), record(method="Euler"), hashes={"single_pendulum": "another"})
    assert told(run(record(), record(method="Euler")), edited) == [("scene", "", False)]
    assert told(run(), run(record(step=2e-3, error=1e-3))) == [("settings", "mujoco RK4", False)]


def test_a_version_is_named_and_no_finding():
    changes = compare(run(), run(versions={"mujoco": "4.1.0"}))
    assert [(change.kind, change.engine, change.before, change.after, change.bad) for change in changes] == [
        ("version", "mujoco", "4.0.0", "4.1.0", False)]


def test_findings_come_first():
    changes = compare(run(), run(record(error=1e-3), versions={"mujoco": "4.1.0"}))
    assert [change.kind for change in changes] == ["accuracy", "version"]


def speeds(values, deviation=2e-4):
    return [Figure("speed ratio", "1", value, deviation, 9) for value in values]


def test_change_points_of_a_speed_are_steps_and_not_single_nights():
    assert change_points(speeds([1.0] * 5)) == []
    assert change_points(speeds([1.0, 1.01, 0.99, 1.3, 1.31, 1.3, 1.0, 1.0])) == [3, 6]
    assert change_points(speeds([1.0, 1.0, 1.5, 1.0, 1.0])) == []
    assert change_points(speeds([1.0, 1.0, 1.3])) == [2]  # the last run: whether the change persists is unknown
    assert change_points([]) == []


def test_change_points_of_an_error_are_beyond_rounding():
    def errors(*values):
        return [Figure("position error", "m", value, rounding=1e-12) for value in values]
    assert change_points(errors(1e-6, 1e-6 + 5e-13, 1e-6)) == []
    assert change_points(errors(1e-6, 2e-6, 2e-6, 1e-6)) == [1, 3]
    assert change_points([Figure("steps", "1", value) for value in (1.0, 2.0)]) == []


def test_noise_alone_has_no_change_points():
    generator = np.random.default_rng(7)
    for _ in range(200):
        samples = 1.0 + 0.03 * generator.standard_normal((30, 9))
        middles = np.median(samples, axis=1)
        spread = np.median(np.abs(samples - middles[:, None]), axis=1)
        figures = [Figure("speed ratio", "1", *pair, 9) for pair in zip(middles, spread, strict=True)]
        assert change_points(figures) == []


def test_sparklines():
    assert sparkline([]) == ""
    assert sparkline([2.0, 2.0]) == "▄▄"
    assert sparkline([0.0, 1.0, 2.0]) == "▁▅█"
    assert sparkline([1e-9, 1e-6, 1e-3]) == "▁▅█"  # on a log scale


def test_the_page_of_a_trend_marks_its_changes(tmp_path):
    runs = [run(started=f"2026-11-{day:02d}T02:00:00+00:00") for day in range(1, 9)]
    series = list(zip(runs, speeds([1.0, 1.01, 0.99, 1.3, 1.31, 1.3, 1.29, 1.3]), strict=True))
    page = tmp_path / "below" / "trend.html"
    write_trend(page, series, "single_pendulum", "mujoco", "mujoco RK4")
    text = page.read_text(encoding="utf-8")
    assert text.count('class="mark"') == 1
    assert text.count('class="point"') == 7
    assert "1 time, marked" in text
    assert "http" not in text
    assert list(page.parent.iterdir()) == [page]
