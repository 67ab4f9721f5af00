"""One verdict per run: every outcome, provoked with an engine whose errors are known."""

import math
import time
from collections import Counter

import numpy as np
import pytest

from crosscheck import adapters
from crosscheck.adapters.base import RawRun
from crosscheck.adapters.external.own import completed
from crosscheck.document import Finding, Plan, Way
from crosscheck.jobs.drive import Stages
from crosscheck.judge.verdict import worst
from crosscheck.verification import speed
from crosscheck.verification.cell import run_cell
from crosscheck.verification.speed import measure_speed
from crosscheck.verification.task import Cell
from tests.fake_engine import FakeEngine, install

PLAN, LASTS = Plan({1: 1e-3}, samples=26), 1.0  # s


@pytest.fixture
def verdict(monkeypatch):
    def judge(**flaws):
        install(monkeypatch, FakeEngine(**flaws))
        return run_cell(Cell("single_pendulum", Way("fake", "Plain"), PLAN))
    return judge


def kinds(record, status):
    return {finding.kind for finding in record.findings if finding.status == status}


def test_an_honest_engine_passes_and_says_that_it_was_not_started_elsewhere(verdict):
    record = verdict()
    assert record.outcome == "pass"
    assert kinds(record, "fail") == set()
    assert {"asked end", "asked steps", "asked start position", "limit position", "limit attitude", "limit velocity",
            "limit angular velocity", "promise orthogonality"} <= kinds(record, "ok")
    assert "not started elsewhere: " in record.not_judged
    # The error is 0.1 h^2 t and nothing else, on top of rounding of numbers of size one.
    assert record.errors["position"].end == pytest.approx(0.1 * 1e-6 * 10.0, rel=1e-6)
    assert record.order.median == pytest.approx(2.0, abs=1e-2)
    assert (record.version, record.status, record.steps, record.form) == ("1.2.3", "success", 10000, "tree")
    assert record.us_per_step == pytest.approx(1.0)
    assert [rung.step for rung in record.ladder] == pytest.approx(sorted((rung.step for rung in record.ladder),
                                                                         reverse=True))
    assert record.asked_steps > 1.0


def test_a_lower_order_than_documented_fails_and_a_higher_one_does_not(verdict):
    low = verdict(claimed_order=2, real_order=1, size=1e-3)
    assert (low.outcome, low.order.observed) == ("fail", pytest.approx(1.0, abs=1e-2))
    assert "order" in kinds(low, "fail")
    assert verdict(claimed_order=1, real_order=2).outcome == "pass"


def test_a_low_order_is_looked_for_at_finer_steps(verdict):
    """At 4 ms the next term cancels 0.8 of the error, at half a millisecond a tenth."""
    assert "order" not in kinds(verdict(claimed_order=1, real_order=1, size=1e-3, further=-200.0), "fail")
    assert "order" in kinds(verdict(claimed_order=2, real_order=1, size=1e-3, further=-200.0), "fail")


def test_an_error_that_no_step_makes_smaller_fails(verdict):
    record = verdict(claimed_order=2, real_order=0, size=1e-3)
    assert record.outcome == "fail"
    assert {"limit position", "limit attitude"} <= kinds(record, "fail")
    assert worst(record.findings).value > worst(record.findings).bound


def test_a_large_error_that_steps_make_smaller_is_none(verdict):
    """What its limit is, is not known well enough to pass; what the run is off by is said."""
    record = verdict(claimed_order=2, real_order=2, size=1e4)
    assert kinds(record, "fail") <= {"promise level position", "promise level velocity"}
    assert record.off > 0.01


def test_a_level_said_to_be_held_has_to_be(verdict):
    assert "promise level position" in kinds(verdict(held=frozenset({"position"})), "fail")
    assert "promise level position" not in kinds(verdict(held=frozenset()), "fail")


def test_a_failed_run_is_recorded_with_its_words(verdict):
    record = verdict(breaks="the solver gave up at t = 0.3 s")
    assert record.outcome == "fail"
    assert worst(record.findings).kind == "asked end"
    assert "gave up at t = 0.3 s" in record.message


def test_what_an_engine_cannot_model_is_no_failure(verdict):
    record = verdict(refuses="it knows no ball joints")
    assert (record.outcome, record.message) == ("unsupported", "it knows no ball joints")


def timed(engine, step, monkeypatch):
    """The record of a run of an engine at this step with its times."""
    install(monkeypatch, engine)
    monkeypatch.setattr("crosscheck.jobs.drive.run_tasks", lambda function, tasks, jobs, done, *_: [
        done(place, function(task)) for place, task in enumerate(tasks)])
    record = run_cell(Cell("single_pendulum", Way("fake", "Plain"), Plan({1: step}, samples=26, duration=LASTS)))
    (made,), _ = measure_speed([record], "default", Stages(1, None, lambda label: None))
    return made


def test_times_are_those_of_stepping_and_come_with_the_errors_of_the_ladder(monkeypatch):
    run = timed(FakeEngine(), 1e-3, monkeypatch)
    assert [rung for _, rung in run.timing] == run.ladder
    assert len(run.ladder) == 3
    for seconds, rung in run.timing:
        assert rung.steps == pytest.approx(LASTS / rung.step)
        assert seconds == pytest.approx(1e-6 * rung.steps)
    assert run.us_per_step == pytest.approx(1.0)
    assert run.seconds_per_second == pytest.approx(1e-6 / 1e-3)


def test_short_runs_are_timed_in_several_turns_and_long_ones_once(monkeypatch):
    started = Counter()

    def attempt(scene, way, **_):
        started[way.step] += 1
        end = time.process_time() + (1.1 * speed.ONCE if way.step == 8e-3 else 0.0)
        while time.process_time() < end:
            pass
        steps = round(scene.duration / way.step)
        return speed.Ran(scene, way, RawRun(None, 1e-6 * steps, steps, way.step))

    monkeypatch.setattr(speed, "attempt", attempt)
    long, short = speed.time_round(speed.Round("single_pendulum", tuple(
        speed.Burst(Way("lieeuler", "rattle2", step)) for step in (8e-3, 4e-3))))
    assert started[8e-3] == 2  # one loads libraries
    assert 2 + speed.REPEATS <= started[4e-3] <= 2 + speed.REPEATS * speed.PATIENCE
    assert (len(long), len(short)) == (1, speed.REPEATS)
    assert {round(1e6 * seconds, 9) for seconds, _ in long + short} == {1.0}


@pytest.mark.parametrize("method", [
    method for method in adapters.get("mujoco").methods if not method.startswith("RK4")])
def test_a_share_of_gravity_does_not_pass_unseen(method):
    """A wrong model has a limit that is not the truth, at any step."""
    stock = adapters.get("mujoco")

    class Heavy(type(stock)):
        def run(self, scene, spec):
            return super().run(scene.replace(gravity=1.001 * np.asarray(scene.gravity)), spec)

    outcomes = []
    for engine in (stock, Heavy()):
        with adapters.lent(completed(engine, "heavy", "1")) as name:
            plan = Plan({1: 1e-4}, samples=51, duration=1.0)
            outcomes.append(run_cell(Cell("single_pendulum", Way(name, method), plan)).outcome)
    assert outcomes == ["pass", "fail"]


def test_a_finding_with_an_infinite_bound_has_the_least_severity():
    """Without a truth nothing bounds a gap: its quotient is 0, which has no logarithm."""
    assert Finding("gap position", "ok", 1.8e-16, math.inf, "m", "").severity == -math.inf
