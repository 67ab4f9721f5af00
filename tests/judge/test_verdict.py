"""One verdict per run: every outcome, provoked with an engine whose errors are known."""

import dataclasses
import math

import numpy as np
import pytest
from msgspec.structs import replace

from crosscheck.document import QUANTITIES, Finding, Plan, Rung, Way
from crosscheck.document.known import Known
from crosscheck.judge import known
from crosscheck.judge.metrics import Plateau
from crosscheck.judge.plan import halved
from crosscheck.judge.verdict import judge_orders, worst
from crosscheck.verification.cell import run_cell
from crosscheck.verification.speed import MOST_TIMED, Timing, time_cells
from crosscheck.verification.task import Cell
from tests.fake_engine import FakeEngine, install

PLAN = Plan(0.5, {1: 1e-3}, {1: halved(4e-3)}, samples=26)


@pytest.fixture
def verdict(monkeypatch):
    def judge(study=True, **flaws):
        install(monkeypatch, FakeEngine(**flaws))
        return run_cell(Cell("single_pendulum", Way("fake", "Plain"), PLAN, study))
    return judge


def kinds(record, status):
    return {finding.kind for finding in record.findings if finding.status == status}


def test_an_honest_engine_passes(verdict):
    record = verdict()
    assert record.outcome == "pass"
    assert kinds(record, "fail") == set()
    assert {"run", "position", "attitude", "velocity", "angular velocity", "energy", "momentum", "orthogonality",
            "order position"} <= kinds(record, "ok")
    # The error is 0.1 h^2 t and nothing else, on top of rounding of numbers of size one.
    assert record.errors["position"].end == pytest.approx(0.1 * 1e-6 * 10.0, rel=1e-6)
    assert record.orders["position"].observed == pytest.approx(2.0, abs=1e-3)
    assert (record.version, record.status, record.steps, record.form) == ("1.2.3", "success", 10000, "tree")
    assert record.us_per_step == pytest.approx(1.0)


def test_a_lower_order_than_documented_fails_and_a_higher_one_does_not(verdict):
    assert "order velocity" in kinds(verdict(claimed_order=2, real_order=1, size=1e-3), "fail")
    assert verdict(claimed_order=1, real_order=2).outcome == "pass"


def test_a_low_order_is_looked_for_at_finer_steps(verdict):
    """At 4 ms the next term cancels 0.8 of the error, at half a millisecond a tenth."""
    hidden = verdict(claimed_order=1, real_order=1, size=1e-3, further=-200.0)
    assert "order position" in kinds(hidden, "ok")
    assert 4 < len(hidden.ladder) <= 8
    assert hidden.orders["position"].observed > 0.9
    low = verdict(claimed_order=2, real_order=1, size=1e-3, further=-200.0)
    assert "order position" in kinds(low, "fail")
    assert len(low.ladder) <= 8


def test_an_order_that_rounding_cuts_short_counts_to_the_nearest_whole_number():
    steps = [2e-2, 1e-2, 5e-3, 2.5e-3]

    def judged(p, floor):
        rungs = [Rung(step=h, rtol=None, errors=dict.fromkeys(QUANTITIES, h**p * (1 - 16 * h))) for h in steps]
        return judge_orders(8, rungs, dict.fromkeys(QUANTITIES, Plateau(floor)), 3)[0][0]

    assert judged(8, 1e-21).status == "ok"  # the last step is rounding; before it the order was 7.8
    assert "nearest whole number" in judged(8, 1e-21).why
    assert judged(7, 1e-19).status == "fail"
    assert judged(7, 0.0).bound == 7.85


def orders_of(documented, steps, values, plateau, rungs=4, **more):
    """The finding about positions, and the order."""
    ladder = [Rung(step=h, rtol=None, errors=dict.fromkeys(QUANTITIES, value))
              for h, value in zip(steps, values, strict=True)]
    findings, orders = judge_orders(documented, ladder, dict.fromkeys(QUANTITIES, plateau), rungs, **more)
    return findings[0], orders["position"]


@pytest.mark.parametrize(("slope", "level", "status"), [
    (0.5, 1e-9, "unresolved"), (-1.0, 1e-11, "unresolved"), (0.5, 1e-5, "fail"), (1.0, 1e-9, "fail"),
    (2.0, 1e-9, "fail")])
def test_small_errors_that_fall_no_more_show_no_order(slope, level, status):
    """RKMK8 in joint coordinates on chain_64: 1.6e-10 rad falls by seven while the step falls by 22."""
    steps = 4e-3 / 2.0 ** np.arange(8)
    values = level * (steps / 4e-3)**slope * np.random.default_rng(7).uniform(0.8, 1.25, 8)
    assert orders_of(8, steps, values, Plateau(1e-14, 1e-8, 8))[0].status == status


@pytest.mark.parametrize(("slope", "said"), [
    (-1.0, known.RISES), (-0.6, known.RISES), (-0.1, ""), (0.0, ""), (0.5, "")])
def test_errors_that_rise_as_steps_shrink_are_said_to_and_those_that_stay_are_not(slope, said):
    """Newton MuJoCoEuler on heavy_top gains spin by every step: 0.25 rad/s at 20 us, 0.5 at 10 us, 0.9 at 5 us."""
    steps = 2e-5 / 2.0 ** np.arange(7)
    finding, _ = orders_of(1, steps, 0.25 * (steps / steps[0]) ** slope, Plateau(1e-5, 1e-3, 1), rungs=3)
    assert (finding.status, finding.detail) == ("fail", said)


def test_two_errors_that_do_not_fall_are_rounding_where_the_order_was_shown_before():
    """Exudyn TrapezoidalIndex2 on stiff_damped, rad; and an order that is lost, which is none."""
    steps = 5e-5 / 2.0 ** np.arange(4)
    for documented, values, status in ((2, (2.63e-10, 6.45e-11, 3.36e-11, 3.42e-11), "unresolved"),
                                       (2, (1e-9, 2.5e-10, 6e-11, 2e-11), "ok"),
                                       (4, (1e-9, 6.25e-11, 1.6e-11, 4e-12), "fail")):
        assert orders_of(documented, steps, values, Plateau(1e-16, 1.5e-8, documented))[0].status == status


@pytest.mark.parametrize(("documented", "values", "used"), [
    (4, (4.92e-7, 3.05e-8, 2.53e-9, 1.72e-9, 1.69e-9, 1.68e-9, 1.69e-9), 3),  # Exudyn RK44, needle
    (5, (9.34e-11, 2.92e-12, 9.22e-14, 1.05e-14, 1.88e-14, 2.26e-14, 1.06e-14, 6.78e-14), 3),  # DOPRI5, bead_on_line
    (6, (6.4e-8, 1e-9, 1.56e-11, 2.44e-13, 2.5e-14), 4)])  # only the last order is too low
def test_an_order_that_was_shown_before_errors_stall_counts(documented, values, used):
    finding, order = orders_of(documented, 0.02 / 2.0 ** np.arange(len(values)), values,
                               Plateau(1e-16, 1.5e-8, documented), rungs=None)
    assert (finding.status, order.used, order.exhausted) == ("ok", used, True)


@pytest.mark.parametrize(("values", "status"), [
    ((1.11e-3, 5.75e-4, 3.42e-4, 4.57e-4, 1.07e-3, 1.50e-3), "ok"),  # Warp implicitfast on hinge_pendulum, m/s
    ((1.11e-3, 9.0e-4, 8.5e-4, 8.4e-4, 9e-4, 8.4e-4), "fail"),
    ((1.11e-3, 5.75e-4, 3.42e-4, 2.0e-3, 8.0e-3, 3.2e-2), "fail")])
def test_rounding_of_positions_rises_in_velocities_as_steps_shrink(values, status):
    """In single precision 1e-7 m over a step of 25 us is 2e-3 m/s; what rises faster, or from more, is none."""
    steps = 8e-4 / 2.0 ** np.arange(6)
    assert orders_of(1, steps, values, Plateau(1e-9, 8.6e-4, 1), rungs=4)[0].status == status


def test_a_lower_order_at_small_errors_is_no_plateau():
    steps = 0.02 / 2.0 ** np.arange(6)
    for real in (1, 2, 3):
        finding, order = orders_of(4, steps, 1e-9 * (steps / 0.02)**real, Plateau(1e-16, 1.5e-8, 4))
        assert (finding.status, order.observed) == ("fail", pytest.approx(real))


def test_an_order_that_rises_where_rounding_sets_in_is_that_of_the_finest_steps():
    """RKMK8 on cylindrical_pendulum: 7.0 7.4 7.7 down to 25 steps, and rounding at 35."""
    finding, order = orders_of(8, 1 / np.array([10, 15, 20, 25, 35]), (3.59e-11, 2.08e-12, 2.48e-13, 4.5e-14, 1.32e-15),
                               Plateau(1e-15))
    assert (finding.status, finding.value) == ("ok", pytest.approx(7.65, abs=0.01))
    assert "rounding sets in" in finding.why
    assert order.observed == finding.value


def test_an_order_that_still_rises_where_the_study_ends_counts_to_the_nearest_whole_number():
    """RK67 on stiff_cable: 5.69 5.75 5.79 5.85 in steps that differ by a fifth."""
    steps = 0.1 / np.array([250, 300, 360, 435, 530])
    values = (1.72e-6, 6.14e-7, 2.16e-7, 7.20e-8, 2.27e-8)
    assert orders_of(6, steps, values, Plateau(1e-15, 1e-10, 6))[0].status == "fail"
    assert orders_of(6, steps, values, Plateau(1e-15, 1e-10, 6), final=True)[0].status == "ok"
    lower = orders_of(7, steps, values, Plateau(1e-15, 1e-10, 7), final=True)[0]
    assert (lower.status, lower.bound) == ("fail", 6.5)


def test_an_error_beyond_its_bound_fails_and_is_the_worst(verdict):
    record = verdict(claimed_order=2, real_order=2, size=1e5)
    assert record.outcome == "fail"
    assert {"position", "attitude"} <= kinds(record, "fail")
    assert worst(record.findings).status == "fail"
    assert worst(record.findings).value > worst(record.findings).bound


def test_a_level_said_to_be_held_has_to_be(verdict):
    assert "level position" in kinds(verdict(held=frozenset({"position"})), "fail")
    assert "level position" in kinds(verdict(held=frozenset()), "ok")


def test_a_failed_run_is_recorded_with_its_words(verdict):
    record = verdict(breaks="the solver gave up at t = 0.3 s")
    assert record.outcome == "fail"
    assert worst(record.findings).kind == "run"
    assert "gave up at t = 0.3 s" in record.message
    assert len(record.ladder) == 1  # the coarsest run fails as well, and finer ones tell no more
    assert all("gave up" in rung.message for rung in record.ladder)


def test_what_an_engine_cannot_model_is_no_failure(verdict):
    record = verdict(refuses="it knows no ball joints")
    assert (record.outcome, record.message) == ("unsupported", "it knows no ball joints")


def test_a_step_too_coarse_to_judge_is_a_failure_of_the_plan(monkeypatch):
    install(monkeypatch, FakeEngine(claimed_order=1, real_order=1, size=1e-6))
    record = run_cell(Cell("single_pendulum", Way("fake", "Plain"), Plan(0.5, {1: 0.1}, {1: halved(0.1)},
                                                                              samples=26), False))
    assert "step" in kinds(record, "fail")


def test_a_step_too_coarse_to_judge_leaves_a_run_unjudged_where_a_budget_chose_it(monkeypatch):
    plan = Plan(0.5, {1: 0.1}, {1: halved(0.1)}, samples=26, budgeted=True)
    for held, outcome in ((frozenset(), "unresolved"), (frozenset({"position"}), "fail")):
        install(monkeypatch, FakeEngine(claimed_order=1, real_order=1, size=1e-6, held=held))
        record = run_cell(Cell("single_pendulum", Way("fake", "Plain"), plan, False))
        assert record.outcome == outcome
        assert "step" in kinds(record, "unresolved")


def entry(*found):
    return Known(("1",), ("Plain",), ("single_pendulum",), None, dict.fromkeys(found, 1.0),
                 "its documentation says so")


def test_a_known_defect_passes_with_its_reason(verdict, monkeypatch):
    monkeypatch.setattr(FakeEngine, "known_defects", (entry("order position", "order attitude", "order velocity",
                                               "order angular velocity", "order intervals"),))
    record = verdict(claimed_order=2, real_order=1, size=1e-3)
    assert record.outcome == "known"
    assert worst(record.findings).detail == "its documentation says so"


def test_a_known_defect_does_not_cover_another_one(verdict, monkeypatch):
    monkeypatch.setattr(FakeEngine, "known_defects", (entry("energy"),))
    assert verdict(claimed_order=2, real_order=1, size=1e-3).outcome == "fail"


def test_a_vanished_defect_fails(verdict, monkeypatch):
    monkeypatch.setattr(FakeEngine, "known_defects", (entry("order position"),))
    record = verdict()
    assert record.outcome == "fail"
    assert worst(record.findings).kind == "vanished"
    # Without an order study nothing looks for it, and at the user's own step or duration it may not show.
    assert verdict(study=False).outcome == "pass"
    for plan in (replace(PLAN, budgeted=True), replace(PLAN, duration=5.0)):
        install(monkeypatch, FakeEngine(claimed_order=2, real_order=2))
        assert run_cell(Cell("single_pendulum", Way("fake", "Plain"), plan)).outcome == "pass"


def test_severity_ranks_findings(verdict):
    record = verdict(size=1e5)
    largest = worst(record.findings)
    assert largest.severity == pytest.approx(math.log10(largest.value / largest.bound))
    assert largest.severity == max(finding.severity for finding in record.findings if finding.status == "fail"
                                   and not finding.kind.startswith("order"))


def test_timing_gives_stepping_time_and_end_error(monkeypatch):
    install(monkeypatch, FakeEngine())
    cell = Cell("single_pendulum", Way("fake", "Plain"), PLAN, True)
    (points,) = time_cells(Timing(((cell, 2, None),), 2))
    assert [point.step for point in points] == list(PLAN.ladder(2))
    for point in points:
        # 0.1 h^2 t at t = 0.5 s, on numbers of size one
        assert point.error == pytest.approx(0.1 * point.step ** 2 * 0.5, rel=1e-6)
        assert point.us_per_step == pytest.approx(1.0)


def test_timing_repeats_short_runs_whose_times_differ_and_ends_repeats_early(monkeypatch):
    started, plan = [], Plan(1.0, PLAN.steps, PLAN.ladders, samples=PLAN.samples)
    coarse, *_, fine = plan.ladder(2)

    class Slow(FakeEngine):
        def run(self, scene, spec):
            started.append((spec.step, round(scene.duration / spec.step)))
            raw = super().run(scene, spec)
            later = 1.0 + 0.1 * len(started) if spec.step in (coarse, fine) else 1.0
            return dataclasses.replace(raw, wall_time=later * (1.0 if spec.step == fine else raw.wall_time))

    install(monkeypatch, Slow())
    cell, main = Cell("single_pendulum", Way("fake", "Plain"), plan, True), plan.window / 10_000
    (points,) = time_cells(Timing(((cell, 2, main),), 3))
    counts = [sum(step == size for step, _ in started) for size in (*plan.ladder(2), main)]
    assert counts == [3] + [2] * (len(counts) - 1)
    assert {steps for step, steps in started if step == main} == {MOST_TIMED}
    assert [steps for step, steps in started if step == fine] == [round(plan.window / fine), MOST_TIMED]
    assert points[-1].main
    assert points[-1].error is None
    assert points[-1].us_per_step == pytest.approx(1.0)
    assert points[-1].seconds_per_second == pytest.approx(1e-6 / main)


@pytest.mark.parametrize("profile", ["default", "smoke"])
def test_one_percent_of_gravity_does_not_pass_unseen(monkeypatch, profile):
    """A wrong model has an error that no step makes smaller: every method must fail by truth or by observed order."""
    pytest.importorskip("mujoco")
    from crosscheck.adapters import get
    from crosscheck.judge.plan import PLANS
    from crosscheck.judge.plan import profile as profile_called
    from crosscheck.verification.task import cells_of

    adapter = type(get("mujoco"))
    right = adapter.run
    monkeypatch.setattr(adapter, "run", lambda self, scene, spec: right(
        self, scene.replace(gravity=tuple(1.01 * g for g in scene.gravity)), spec))
    cells = [cell for cell in cells_of("single_pendulum", "mujoco", profile_called(profile)) if cell.default_form]
    assert len(cells) == len(get("mujoco").methods)
    for cell in cells:
        record = run_cell(dataclasses.replace(cell, plan=PLANS["single_pendulum"]))
        assert record.outcome == "fail", record.method
        assert kinds(record, "fail") & {"position", "attitude", "order position", "order attitude"}, record.method


def test_the_farthest_beyond_its_bound_is_named_first_and_plausibility_within_bounds_last():
    def found(kind, status, value, bound):
        return Finding(kind, status, value, bound, "m", "why")

    near = [found("continuity", "ok", 0.99, 1.0), found("run", "ok", None, None),
            found("level position", "ok", 0.5, 1.0), found("angular velocity", "ok", 1e-3, 1.0)]
    assert worst(near).kind == "angular velocity"
    assert worst(near[:3]).kind == "level position"
    assert worst(near[:2]).kind == "continuity"
    beyond = [found("continuity", "fail", 1e6, 1.0), found("level velocity", "fail", 1e3, 1.0),
              found("energy", "fail", 2.0, 1.0), found("order position", "known", 1.0, 3.9)]
    assert worst([*near, *beyond]).kind == "continuity"  # by how far it is beyond its bound
    assert worst([*near, *beyond, Finding("energy", "fail", 3.7e7, 1e6, "1", "why")]).kind == "energy"  # it blew up
    assert worst([*near, *beyond[3:]]).kind == "order position"
    assert worst([*near, *beyond, found("run", "fail", None, None)]).kind == "run"
