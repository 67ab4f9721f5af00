"""Findings and outcomes of the verdict, one rule at a time, for made-up runs."""

import math
from types import SimpleNamespace

import numpy as np
import pytest

from crosscheck.document import LEVELS, QUANTITIES, Errors, Finding, Order, Record, Scales
from crosscheck.document.known import Known
from crosscheck.document.outcomes import percent
from crosscheck.judge import tolerances, verdict
from crosscheck.judge.claim import Claim
from crosscheck.judge.tolerances import Tol
from crosscheck.scene import mechanics
from crosscheck.scene.file import load_scene
from tests.judge.made_up import truth_of


@pytest.fixture(scope="module")
def scene():
    return load_scene("double_pendulum").replace(duration=2.0, samples=5)


def found(kind, status, value=1.0, bound=2.0, why="why"):
    return Finding(kind, status, value, bound, "m", why)


@pytest.mark.parametrize(("value", "empty", "status"), [
    (2.0, False, "ok"), (np.nextafter(2.0, 3.0), False, "fail"), (np.nan, False, "fail"), (np.inf, False, "fail"),
    (1.0, True, "unresolved"), (3.0, True, "unresolved"), (np.nan, True, "fail"), (np.inf, True, "fail")])
def test_a_figure_is_within_its_bound_or_not(value, empty, status):
    assert verdict._judged("position", value, Tol(2.0, "why"), "m", empty=empty).status == status


@pytest.mark.parametrize(("statuses", "outcome"), [
    (["ok"], "pass"), (["ok", "unresolved"], "pass"), (["known", "ok"], "known"), (["known", "fail"], "fail"),
    ([], "pass")])
def test_the_worst_status_makes_the_outcome(statuses, outcome):
    assert verdict.outcome_of([found("position", status) for status in statuses]) == outcome


@pytest.mark.parametrize(("status", "share", "need", "outcome"), [
    ("ok", 0.04, 1.0, "unresolved"), ("known", 0.04, 1.0, "unresolved"), ("fail", 0.04, 1.0, "fail"),
    ("ok", 0.96, 0.95, "pass"), ("known", 0.96, 0.95, "known"), ("ok", 0.94, 0.95, "unresolved")])
def test_less_than_the_share_that_is_needed_is_unresolved(status, share, need, outcome):
    assert verdict.outcome_of([found("position", status)], share, need) == outcome


@pytest.mark.parametrize("kind", verdict.BLIND)
def test_nothing_judged_is_unresolved_whatever_is_needed(kind):
    run = settled([found(kind, "unresolved"), found("energy", "ok")])
    assert (run.outcome, run.share) == ("unresolved", 0.0)
    assert verdict.needing(run, 1e-9).outcome == "unresolved"
    assert settled([found(kind, "unresolved"), found("energy", "fail")]).outcome == "fail"


def test_a_run_passes_where_its_share_is_what_is_needed():
    run = settled([found("position", "ok")], until=0.5)
    assert (run.outcome, run.message) == ("unresolved", "judged over 50 % of its time")
    enough = verdict.needing(run, 0.5)
    assert (enough.outcome, enough.message, verdict.word(enough)) == ("pass", "", "pass, judged over 50 %")
    assert verdict.needing(enough, 0.6).outcome == "unresolved"
    failed = settled([found("position", "fail")], until=0.5)
    assert verdict.needing(failed, 0.1) == failed


def test_a_share_that_is_not_all_is_not_written_as_all():
    assert [percent(share) for share in (1.0, 0.25, 0.999999999, 0.9951)] == ["100 %", "25 %", "99.9999 %", "99.51 %"]


@pytest.mark.parametrize("status", ["ok", "fail"])
@pytest.mark.parametrize("kind", ["sub-steps", "rtol"])
def test_what_only_guards_against_cheats_is_named_where_it_fails(kind, status):
    """One step, if one was asked for, is exactly at its bound and is not shown as the worst finding."""
    shown = verdict.worst([found("energy", "ok", 0.1), found(kind, status, 2.0), found("limit", "ok", 2.0)])
    assert shown is not None
    assert shown.kind == (kind if status == "fail" else "energy")


@pytest.mark.parametrize(("status", "first"), [("fail", "position"), ("ok", "energy")])
def test_a_figure_without_a_finite_size_is_named_first_where_it_fails_alone(status, first):
    """Within bounds it says nothing; beyond them nothing is farther."""
    shown = verdict.worst([found("energy", status, 5.0), found("position", status, np.inf)])
    assert shown is not None
    assert shown.kind == first


@pytest.mark.parametrize(("lack", "first"), [(1.05, "order position"), (0.95, "energy")])
def test_one_order_too_little_weighs_as_ten_times_a_bound(lack, first):
    shown = verdict.worst([found("energy", "fail", 20.0), found("order position", "fail", 3.0, 3.0 + lack)])
    assert shown is not None
    assert shown.kind == first


def test_bounds_judge_the_motion_unless_those_of_positions_or_attitudes_are_empty():
    assert [verdict.Bounds({}, {}, frozenset(empty), 2.0).reach for empty in ((), ("velocity",), ("attitude",))] == [
        2.0, 2.0, 0.0]


def settled(findings, entry=None, until=1.0):
    run = Record(scene="single_pendulum", engine="fake", version="1", method="Plain", form=None, duration=1.0,
                   errors={"position": Errors(unit="m", end=1.0, max=1.0, time=0.0, body="b")})
    return verdict.settle(run, findings, () if entry is None else (entry,), judged_until=until)


@pytest.mark.parametrize(("until", "outcome"), [
    (1.0, "pass"), (0.5, "unresolved"), (None, "pass"), (1.0 - 1e-12, "pass"), (1.0 - 1e-6, "unresolved")])
def test_what_was_judged_over_a_part_of_the_time_is_unresolved(until, outcome):
    assert settled([found("position", "ok")], until=until).outcome == outcome
    assert settled([found("position", "fail")], until=until).outcome == "fail"


def test_a_settled_run_says_what_was_judged_of_its_errors():
    run = settled([found("position", "ok", 0.25, 0.5, "because")])
    assert (run.errors["position"].judged, run.errors["position"].bound, run.errors["position"].why) == (
        0.25, 0.5, "because")
    assert run.message == ""
    blind = settled([found("step", "unresolved")])
    assert (blind.outcome, blind.share, blind.message) == ("unresolved", 0.0, "why")


KNOWN = Known(("1",), ("Plain",), ("single_pendulum",), None, {"position": 3.0, "energy": 1.0},
              "its documentation says so")


def test_a_known_defect_excuses_what_it_names_and_nothing_else(monkeypatch):
    run = settled([found("position", "fail", 3.0), found("energy", "ok")], KNOWN)
    assert [(each.status, each.detail) for each in run.findings] == [("known", KNOWN.reason), ("ok", "")]
    other = settled([found("position", "fail", 3.0), found("momentum", "fail", 3.0)], KNOWN)
    assert [each.status for each in other.findings] == ["known", "fail"]
    mine = settled([found("position", "fail", 3.0, 2.0, f"{tolerances.BY_USER}: tight")], KNOWN)
    assert [each.status for each in mine.findings] == ["fail"]


def test_a_known_defect_vanished_only_where_all_of_it_was_looked_for(monkeypatch):
    both = [found("position", "ok"), found("energy", "ok")]
    assert [each.kind for each in settled(both, KNOWN).findings] == ["position", "energy", "vanished"]
    assert settled(both, KNOWN).outcome == "fail"
    for half in ([both[0]], [both[0], found("energy", "unresolved")], [found("position", "fail", 3.0), both[1]]):
        assert "vanished" not in [each.kind for each in settled(half, KNOWN).findings]


@pytest.mark.parametrize(("share", "word"), [
    (0.1, "pass, judged over 10 %"), (1.0, "pass"), (None, "pass"), (0.0, "pass, judged over 0 %")])
def test_words_claim_no_more_than_was_judged(share, word):
    run = SimpleNamespace(share=share, outcome="pass")
    assert verdict.word(run) == word
    for outcome, said in (("fail", "fail"), ("unsupported", "unsupported"), ("error", "error")):
        run.outcome = outcome
        assert verdict.word(run) == said
    for run.outcome in ("known", "unresolved"):
        assert verdict.word(run) == word.replace("pass", run.outcome)


def test_undecided_orders_are_low_measured_and_neither_settled_nor_exhausted():
    def order(settled=False, exhausted=False):
        return {"position": Order(observed=1.0, documented=2, used=4, pairs=(), settled=settled, exhausted=exhausted)}

    low = [found("order position", "fail")]
    assert verdict.undecided(low, order())
    assert not verdict.undecided(low, order(settled=True))
    assert not verdict.undecided(low, order(exhausted=True))
    assert not verdict.undecided([found("order position", "fail", None)], order())
    assert not verdict.undecided([found("order position", "ok")], order())


def run_of(truth, energy=0.0, momentum=0.0, scene=None, **series):
    """A run with the energies and momenta of truth and these errors of them, at every other time."""
    wave = np.arange(len(truth.t)) % 2
    exact = mechanics.energy(scene, truth.states), mechanics.momentum_vertical(scene, truth.states)
    return SimpleNamespace(t=truth.t, energy=exact[0] - energy * wave, momentum_vertical=exact[1] - momentum * wave,
                           stats={}, **series)


def test_energy_and_momentum_are_judged_as_far_as_the_bounds_reach(scene, monkeypatch):
    truth = truth_of(scene)
    kinetic = tolerances.scales(scene, truth).kinetic
    monkeypatch.setattr(tolerances, "energy", lambda *_: Tol(0.1, "energy"))
    monkeypatch.setattr(tolerances, "momentum", lambda *_: Tol(0.3, "momentum"))
    traj = run_of(truth, 0.2 * kinetic, 0.2, scene)

    def judged(until, empty=frozenset()):
        bounds = verdict.Bounds({}, {}, empty, until)
        return verdict.judge_invariants(scene, traj, truth, bounds)

    energy, momentum = judged(2.0)
    assert (energy.status, energy.value) == ("fail", pytest.approx(0.2))
    assert (momentum.status, momentum.value) == ("ok", pytest.approx(0.2))
    assert judged(0.5)[0].status == "fail"  # 0.5 s is the second time, and belongs to what is judged
    assert judged(0.4)[0].status == "ok"
    assert [each.status for each in judged(2.0, frozenset({"energy", "momentum"}))] == ["unresolved"] * 2


@pytest.mark.parametrize("conserved", [True, False])
def test_a_coarse_run_may_change_its_energy_by_what_lifting_all_bodies_takes(scene, monkeypatch, conserved):
    truth = truth_of(scene, horizon=0.4)
    scale = tolerances.scales(scene, truth)
    lift = 2 * sum(scene.masses) * 9.81 * scale.reach
    monkeypatch.setattr(verdict, "_conservative", lambda *_: conserved)
    for share, status in ((0.99, "ok"), (1.01, "fail")):
        judged = verdict.judge_coarse(scene, run_of(truth, share * lift, scene=scene), truth)
        assert judged.status == (status if conserved else "ok")  # beyond the horizon the work of drives is unknown
        assert judged.bound == pytest.approx(lift / scale.kinetic)


def test_a_coarse_run_without_gravity_may_change_its_energy_by_what_motors_turn_over():
    """An error below the variation of the kinetic energy does not prove another motion; a larger one does."""
    scene = load_scene("squeezer").replace(samples=7)
    truth = truth_of(scene)
    kinetic = mechanics.kinetic_energy(scene, truth.states)
    for share, status in ((0.9, "ok"), (1.1, "fail")):
        run = run_of(truth, share * np.ptp(kinetic), scene=scene)
        assert verdict.judge_coarse(scene, run, truth).status == status


def test_without_truth_the_lifted_energy_and_that_of_the_start_bound_the_change():
    scene = load_scene("thrown_double")
    reach = sum(math.hypot(*joint.child_anchor) + math.hypot(*joint.parent_anchor) for joint in scene.joints)
    start = sum(0.5 * m * (v @ v) + 0.5 * w @ (J @ w) for m, J, v, w in zip(
        scene.masses, scene.inertias, scene.v0, scene.w0, strict=True))
    reach = max(reach, *(math.hypot(*x) for x in scene.x0))
    allowed = 2 * sum(scene.masses) * math.hypot(*scene.gravity) * reach + start
    for share, status in ((0.999, "ok"), (1.001, "fail")):
        judged = verdict.judge_without_truth(scene, SimpleNamespace(energy=np.array([7.0, 7.0 - share * allowed, 7.0])))
        assert (judged.status, judged.bound) == (status, pytest.approx(allowed))
    sprung = load_scene("spring_pendulum")
    assert verdict.judge_without_truth(sprung, SimpleNamespace(energy=np.array([7.0, 8.0]))).status == "unresolved"


def test_a_motion_is_conservative_to_the_doubt_of_truth(scene, monkeypatch):
    truth = truth_of(scene)
    scale = tolerances.scales(scene, truth)
    for name, size in (("energy", scale.kinetic), ("momentum_vertical", scale.momentum)):
        for share, conserved in ((0.99, True), (1.01, False)):
            monkeypatch.setattr(mechanics, "energy", lambda *_: np.array([3.0, 3.0]))
            monkeypatch.setattr(mechanics, "momentum_vertical", lambda *_: np.array([3.0, 3.0]))
            moved = np.array([0.0, -10 * truth.error * size * share])
            monkeypatch.setattr(mechanics, name, lambda *_, moved=moved: moved)
            assert verdict._conservative(scene, truth) == conserved


def levels_of(scene, truth, bounds, held=(), maxima=None, run=None, **series):
    traj = SimpleNamespace(t=np.linspace(0.0, 2.0, 5), stats={},
                           **{f"constraint_{level}": series.get(level, np.zeros(5)) for level in LEVELS})
    return {each.kind.removeprefix("level "): each for each in verdict.judge_levels(
        scene, traj, truth, bounds, frozenset(held), maxima or {}, run=run)}


def test_held_levels_of_an_engine_that_tells_only_samples_are_judged_by_these(scene):
    levels = levels_of(scene, truth_of(scene), None, held=LEVELS)
    assert {level: (each.status, each.value) for level, each in levels.items()} == dict.fromkeys(LEVELS, ("ok", 0.0))


def test_held_levels_are_judged_at_every_step_and_the_others_at_samples(scene, monkeypatch):
    truth = truth_of(scene)
    monkeypatch.setattr(tolerances, "held_level", lambda *_: Tol(1e-12, "held"))
    monkeypatch.setattr(tolerances, "free_level",
                        lambda scene, truth, level, bounds: None if level == "acceleration" else Tol(0.1, "free"))
    bounds = verdict.Bounds({}, {}, frozenset(), 1.0)
    late, early = np.array([0.0, 0.0, 0.0, 0.0, 1.0]), np.array([0.0, 0.0, 1.0, 0.0, 0.0])

    def status(**more):
        return {level: each.status for level, each in levels_of(scene, truth, bounds, **more).items()}

    assert status() == {"position": "ok", "velocity": "ok", "acceleration": "unresolved"}
    assert status(position=late, velocity=early) == {"position": "ok", "velocity": "fail", "acceleration": "unresolved"}
    assert status(held=["position"], position=late)["position"] == "fail"
    assert status(held=["position"], maxima={"constraint_position": 1e-3})["position"] == "fail"
    assert status(maxima={"constraint_position": 1e3})["position"] == "ok"
    assert status(acceleration=None)["acceleration"] == "unresolved"
    assert levels_of(scene, None, bounds)["position"].status == "unresolved"
    assert levels_of(scene, truth, None)["position"].status == "unresolved"
    empty = verdict.Bounds({}, {}, frozenset({"level position"}), 2.0)
    assert levels_of(scene, truth, empty, position=late)["position"].status == "unresolved"


def test_levels_left_open_are_judged_by_what_the_errors_before_add_up_to(scene, monkeypatch):
    truth = truth_of(scene)
    monkeypatch.setattr(tolerances, "free_level", lambda *_: Tol(10.0, "free"))
    bounds = verdict.Bounds({}, {}, frozenset(), 2.0)
    scale = Scales(length=0.5, speed=1.0, rate=4.0, unit_rate=1.0, reach=1.0, kinetic=1.0, momentum=1.0)
    grows = np.array([0.01, 0.1, 0.2, 0.3, 0.4])
    run = SimpleNamespace(allowed=({"position": grows, "velocity": grows, "acceleration": grows},), scale=scale)

    def judged(**series):
        return levels_of(scene, truth, bounds, run=run, **series)

    nearest = judged(position=np.array([0.0, 0.0, 0.19, 0.25, 0.0]))["position"]
    assert (nearest.status, nearest.value, nearest.bound) == ("ok", 0.19, 0.2)
    beyond = judged(position=np.array([0.0, 0.11, 0.0, 0.0, 0.39]))["position"]
    assert (beyond.status, beyond.value, beyond.bound) == ("fail", 0.11, 0.1)
    # Velocities reach 2 m/s, so that a bound of 0.6 m/s is meaningful; positions reach only 0.5 m.
    run.allowed = (dict.fromkeys(LEVELS, 1.5 * grows),)
    last = np.array([0.0, 0.0, 0.0, 0.0, 0.59])
    assert judged(position=last)["position"].bound == 10.0
    assert judged(velocity=last)["velocity"].bound == pytest.approx(0.6)


def test_states_are_judged_over_the_window_where_the_whole_run_is_too_long(scene, monkeypatch):
    truth, window = truth_of(scene), truth_of(scene.replace(duration=1.0, samples=3))
    run = SimpleNamespace(**vars(truth.states), steps=100)
    run.x = run.x.copy()
    run.x[3, 0, 0] += 1e-3  # at 1.5 s, after the window
    monkeypatch.setattr(verdict, "_conservative", lambda *_: True)
    seen = []

    def vacuous(too_long, always=frozenset()):
        return lambda scene, reference, *_: frozenset({"position"}) if too_long and reference is truth else always

    def fixed(scene, reference, order, step, growth, eps):
        seen.append((reference is truth, order, step, growth))
        return dict.fromkeys(QUANTITIES, Tol(1e-4, "tight"))

    monkeypatch.setattr(tolerances, "fixed_step", fixed)
    claim = Claim(order=2, step=0.01, rtol=None)
    for too_long, until, status in ((False, 2.0, "fail"), (True, 1.0, "ok")):
        seen.clear()
        monkeypatch.setattr(tolerances, "vacuous", vacuous(too_long))
        findings, errors, bounds = verdict.judge_states(scene, run, truth, window, claim)
        assert (findings[0].kind, findings[0].status, bounds.until) == ("position", status, until)
        assert errors["position"].max == pytest.approx(1e-3)
        assert [growth for *_, growth in seen] == [None, 1.0] * (len(seen) // 2)
        assert [whole for whole, *_ in seen] == [True, True, *([False, False] if too_long else [])]
    for too_long, short in ((False, truth_of(scene, horizon=1.2)), (True, truth)):  # what lies beyond a horizon is free
        monkeypatch.setattr(tolerances, "vacuous", lambda *given, long=too_long: frozenset(
            {"position"} if long and given[1] is truth else ()))
        early = truth_of(scene.replace(duration=1.0, samples=3), horizon=0.7)
        findings, _, bounds = verdict.judge_states(scene, run, short, early, claim)
        assert (findings[0].status, bounds.until) == ("ok", 0.7 if too_long else 1.2)
    monkeypatch.setattr(tolerances, "vacuous", vacuous(True, frozenset({"attitude"})))
    assert verdict.judge_states(scene, run, truth, window, claim)[2].reach == 0.0
    assert [verdict.too_coarse(claim, budgeted).status for budgeted in (False, True)] == ["fail", "unresolved"]
    monkeypatch.setattr(tolerances, "vacuous", vacuous(False, frozenset({"energy"})))
    assert {each.kind for each in verdict.judge_states(scene, run, truth, window, claim)[0]} == set(QUANTITIES)
    monkeypatch.setattr(tolerances, "adaptive",
                        lambda *given: seen.append(given[2:4]) or dict.fromkeys(QUANTITIES, Tol(1.0, "wide")))
    seen.clear()
    assert verdict.judge_states(scene, run, truth, window, Claim(None, None, 1e-9))[0][0].status == "ok"
    assert set(seen) == {(1e-9, 100)}


def test_a_change_of_energy_counts_from_the_start(scene, monkeypatch):
    truth = truth_of(scene)
    most = 10 * truth.error * tolerances.scales(scene, truth).kinetic
    monkeypatch.setattr(mechanics, "momentum_vertical", lambda *_: np.zeros(3))
    for last, conserved in ((0.9, True), (1.2, False)):
        monkeypatch.setattr(mechanics, "energy", lambda *_, last=last: most * np.array([0.0, 0.6, last]))
        assert verdict._conservative(scene, truth) is conserved


@pytest.mark.parametrize(("eps", "words"), [(2.0**-23, "single precision, spacing 1.2e-07"),
                                            (1e-12, "its numbers, spacing 1.0e-12")])
def test_numbers_are_called_single_precision_from_its_spacing_on(scene, eps, words):
    told = verdict._arithmetic(scene, truth_of(scene), Claim(4, 1e-2, None, eps), 100)
    assert told.why.startswith(words)


@pytest.mark.parametrize(("allowed", "value", "status"), [
    (1.5, 1.5, "ok"), (1.5, 1.6, "fail"), (2.5, 2.5, None), (2.5, 2.6, "fail")])
def test_a_drift_is_judged_by_the_sum_over_intervals_unless_that_is_larger_than_the_scene(allowed, value, status):
    run = SimpleNamespace(allowed=[{"position": np.array([allowed])}], scale=SimpleNamespace(length=2.0, rate=1.0))
    before = found("level position", "ok")
    after = verdict._drifted(run, "position", np.array([value]), before, np.zeros(1))
    assert (after is before) == (status is None)
    assert status is None or (after.status, after.value, after.bound) == (status, value, allowed)
