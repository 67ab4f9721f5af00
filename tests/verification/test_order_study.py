"""The order study keeps its limit of time and refines no lost order; the plans of stiff scenes."""

import dataclasses

import numpy as np
import pytest

from crosscheck import adapters
from crosscheck.document import Plan, Rung, Way
from crosscheck.errors import EngineError
from crosscheck.judge import tolerances
from crosscheck.judge.plan import RTOLS, halved
from crosscheck.references import truth
from crosscheck.scene.file import load_scene
from crosscheck.verification import order_study, scene_truth
from crosscheck.verification.cell import run_cell
from crosscheck.verification.task import Cell
from tests.adapters.test_laws import pendulum
from tests.fake_engine import FakeEngine, install

PLAN = Plan(0.5, {1: 1e-3}, {1: halved(4e-3)}, samples=26)
# At a microsecond a step the four runs of the study take 0.125, 0.25, 0.5 and 1 ms.
ALL, THREE, TWO = 2e-3, 1.5e-3, 0.6e-3


class Clocked(FakeEngine):
    """Tells the clock of the study a microsecond a step."""

    now = 0.0

    def run(self, scene, spec):
        raw = super().run(scene, spec)
        self.now += raw.wall_time
        return raw


def judged(monkeypatch, most_seconds, **flaws):
    engine = install(monkeypatch, Clocked(**flaws))
    monkeypatch.setattr(order_study, "clock", lambda: engine.now)
    return run_cell(Cell("single_pendulum", Way("fake", "Plain"), PLAN, most_seconds=most_seconds))


def orders(record):
    """Steps of the study, without those of the intervals of the main run."""
    return {finding.kind: finding for finding in record.findings
            if finding.kind.startswith("order") and finding.kind != "order intervals"}


def test_a_study_within_its_bound_is_not_cut(monkeypatch):
    record = judged(monkeypatch, ALL)
    assert (len(record.ladder), record.ladder_cut) == (4, "")
    assert {finding.status for finding in orders(record).values()} == {"ok"}


def test_three_steps_within_the_bound_show_an_order(monkeypatch):
    record = judged(monkeypatch, THREE)
    assert len(record.ladder) == 3
    assert record.ladder_cut == "cut before a step of 0.0005 s, with which the study would take more than 0.0015 s"
    assert record.orders["position"].observed == pytest.approx(2.0, abs=1e-3)
    assert record.outcome == "pass"


def test_fewer_than_three_steps_show_none_and_say_why(monkeypatch):
    record = judged(monkeypatch, TWO)
    assert len(record.ladder) == 2
    assert record.orders == {}
    for finding in orders(record).values():
        assert finding.status == "unresolved"
        assert finding.detail == f"order not measured: {record.ladder_cut}"


def test_what_a_cut_study_left_undecided_is_no_failure_and_what_it_decided_is(monkeypatch):
    undecided = judged(monkeypatch, ALL, claimed_order=1, real_order=1, size=1e-3, further=-200.0)
    assert "cut before" in undecided.ladder_cut
    assert orders(undecided)["order position"].status == "unresolved"
    assert "finer steps may lift it" in orders(undecided)["order position"].detail
    assert orders(judged(monkeypatch, ALL, real_order=1))["order position"].status == "fail"


def test_a_hopeless_run_is_not_refined(monkeypatch):
    hopeless = judged(monkeypatch, None, claimed_order=1, real_order=1, size=1e4, further=-200.0)
    assert len(hopeless.ladder) == 4
    assert hopeless.outcome == "fail"


class EndsEarly(FakeEngine):
    """Cannot step the whole scene, only its first second."""

    def run(self, scene, spec):
        if scene.duration > 1.0:
            raise EngineError("lost the solution at t = 7 s")
        return super().run(scene, spec)


def test_an_order_is_measured_where_only_the_main_run_fails(monkeypatch):
    install(monkeypatch, EndsEarly())
    record = run_cell(Cell("single_pendulum", Way("fake", "Plain"), PLAN))
    assert record.outcome == "fail"
    assert len(record.ladder) == 4
    assert {finding.status for finding in orders(record).values()} == {"ok"}


@pytest.mark.parametrize("friction", [0.5, 0.502])
def test_a_step_that_always_meets_an_event_at_one_distance_has_no_order_there(monkeypatch, friction):
    """Steps of .8, .4 and .2 ms all meet .7976 s, 5.8 us before the pendulum turns: the rate is off by as much at each.

    An engine with .4 % too much friction is not excused.
    """
    scene = pendulum(1.0, 6, dry_friction=0.5)
    monkeypatch.setattr(order_study, "REFINEMENTS", 1)  # every further one takes twice as long, and tells the same
    if friction != 0.5:
        run, wrong = adapters.get("pinocchio").run, pendulum(1.0, 6, dry_friction=friction)
        monkeypatch.setattr(type(adapters.get("pinocchio")), "run", lambda self, _, spec: run(wrong, spec))
    cell = Cell("pendulum", Way("pinocchio", "SymplecticEuler"), Plan(1.0, {1: 2e-4}, {1: halved(8e-4, 3)}, samples=6))
    study = order_study.order_study(cell, 1, scene, truth(scene), [], False)
    found = {finding.kind: finding.status for finding in study.findings}
    assert study.orders["angular velocity"].observed < 0.0 or friction != 0.5
    assert ("fail" in found.values()) == (friction != 0.5)
    assert found["order angular velocity"] != "ok"


def test_no_step_of_a_stiff_scene_is_longer_than_its_fastest_decay():
    scene = load_scene("stiff_damped").replace(duration=0.05)
    longest = scene_truth.longest_step(scene)
    assert longest == pytest.approx(1 / 2e4, rel=0.05)  # of a damper of 2e4 N s/m on a mass of 1 kg
    plan = scene_truth.plan_within(scene, "stiff_damped", 20_000)
    assert max(plan.steps.values()) <= longest
    assert max(ladder[0] for ladder in plan.ladders.values()) <= longest * (1 + 1e-12)
    assert plan.most_steps <= 20_000


def test_a_scene_without_springs_takes_any_step():
    assert scene_truth.longest_step(load_scene("double_pendulum")) == float("inf")
    soft = load_scene("spring_pendulum")
    assert scene_truth.longest_step(dataclasses.replace(soft, forces=())) == float("inf")
    assert 0.05 < scene_truth.longest_step(soft) < 1.0


def test_errors_of_an_adaptive_method_have_to_follow_its_tolerance():
    def slope(errors, steps=(10, 20, 40, 80), order=None, rtols=(1e-4, 1e-6, 1e-8, 1e-10)):
        rungs = [Rung(step=None, rtol=rtol, steps=count, errors={"position": error})
                 for rtol, error, count in zip(rtols, errors, steps, strict=True)]
        return order_study.judge_tolerances(rungs, 1e-13, order)[0].status

    assert slope((1e-4, 2e-6, 3e-8, 1e-10)) == "ok"
    assert slope((1e-7, 1e-9, 1e-11, 1e-14)) == "ok"  # the last one is rounding
    assert slope((1e-7, 1e-7, 9e-8, 1e-7), (30, 31, 32, 33)) == "fail"
    assert slope((1e-9, 1e-12, 1e-14, 1e-14)) == "unresolved"
    rooted = 1e-2 * np.array([1, 1.02e-1, 1.04e-2, 1.06e-3])  # steps of order one with errors of the tolerance
    assert (slope(rooted), slope(rooted, order=1), slope(rooted, order=5)) == ("fail", "ok", "fail")
    assert slope(rooted**0.8, order=1) == "fail"
    # Drake's runge_kutta5 on the fast top, whose loose steps end at the outputs, and one that only begins so.
    top = (5.2e-8, 1.1e-8, 1.3e-9, 9e-7, 9e-8, 7e-9, 7.5e-10)
    ways = {"steps": (6, 10, 10, 26, 35, 51, 76), "rtols": RTOLS}
    assert slope(top, **ways) == "ok"
    assert slope((*top[:3], 9e-7, 8e-7, 7e-7, 9e-7), **ways) == "fail"
    # Its ladders of the short profile on single_pendulum and of the whole one on hinge_pendulum.
    assert slope((3.2e-6, 4.7e-5, 6.3e-7), (13, 26, 51), rtols=RTOLS[:6:2]) == "unresolved"
    assert slope((5.2e-8, 5.2e-8, 3.2e-6, 2.5e-9, 4.8e-10, 1.5e-9, 3.5e-10), (70, 71, 100, 110, 160, 250, 430),
                 rtols=RTOLS) == "ok"
    quadruped = (1.4e-8, 1.4e-8, 5.5e-9, 4.5e-10, 4.7e-11, 1.2e-9, 7.6e-11)  # the same, in 42 steps at most
    assert slope(quadruped, (6, 6, 10, 11, 19, 27, 42), rtols=RTOLS) == "unresolved"
    assert slope(quadruped, (6, 6, 10, 11, 19, 27, 84), rtols=RTOLS) == "fail"


def test_an_adaptive_method_of_order_one_may_take_the_steps_that_it_needs():
    scene = load_scene("universal_pendulum").replace(duration=1.0)
    exact = truth(scene)
    for order, power in ((1, 2), (2, 3), (3, 4), (5, 4), (None, 4)):
        most = [tolerances.most_steps(scene, exact, rtol, 0, 10**12, order) for rtol in (1e-4, 1e-8)]
        assert most[1] / most[0] == pytest.approx(1e4 ** (1 / power), rel=0.05), order
    assert tolerances.most_steps(scene, exact, 1e-8, 0, 7, 1) == 7
