"""The parts of the estimator: what each catches, and what looks like it and is right."""

import dataclasses
from types import SimpleNamespace

import numpy as np
import pytest

import crosscheck
from crosscheck import adapters, load_scene
from crosscheck.adapters.base import RunSpec, StandIn
from crosscheck.adapters.external.own import completed
from crosscheck.compare.sizes import sizes
from crosscheck.document import Record
from crosscheck.errors import EngineError
from crosscheck.judge import system_flow
from crosscheck.judge.segments import Segment
from crosscheck.judge.system_flow import SystemFlow
from crosscheck.references import truth
from crosscheck.references.maximal import Maximal
from crosscheck.scene.starts import restarted
from crosscheck.verification.solution import judge
from tests.judge.test_law_engines import scene as law_scene

STEP = 1e-3


class Changed(StandIn):
    """lieeuler, whose scene, states or answers are changed."""

    name = "changed"

    def __init__(self, gravity=1.0, at_home=False, order=None, raw=None, left=0.0):
        super().__init__(adapters.get("lieeuler"))
        self.gravity, self.at_home, self.order, self.raw, self.left = gravity, at_home, order, raw, left
        self.rng = np.random.default_rng(5)

    def documented_order(self, scene, spec):
        return self.order or self._engine.documented_order(scene, spec)

    def iteration(self, scene, spec):
        return self.left

    def unsupported(self, scene, spec):
        return "it knows its own scenes alone" if self.at_home and scene.name == "elsewhere" else None

    def run(self, scene, spec):
        raw = self._engine.run(scene.replace(gravity=self.gravity * np.asarray(scene.gravity)), spec)
        return raw if self.raw is None else self.raw(self, scene, raw)


def verdict(engine, method="rattle2", scene="double_pendulum", duration=0.5, known=True, **given):
    """The verdict on a run, with truth or without."""
    scene = load_scene(scene).replace(duration=duration, samples=41) if isinstance(scene, str) else scene
    with adapters.lent(engine) as name:
        traj = crosscheck.run(scene, engine=name, method=method, step=STEP)
        order = adapters.get(name).documented_order(scene, RunSpec(method, step=STEP))
        run = Record(scene=scene.name, engine=name, version="1", method=method, step=STEP, documented_order=order)
        return judge(run, scene, traj, truth(scene) if known else None, "" if known else "no formulas")


def failing(found):
    return {each.kind for each in found.findings if each.status == "fail"}


# --- an engine that cannot be started elsewhere


def test_an_engine_that_cannot_be_started_elsewhere_is_judged_by_whole_runs():
    found = verdict(Changed(at_home=True))
    assert not failing(found)
    assert found.share == 1.0
    assert found.why.startswith("not started elsewhere")
    assert any("not started elsewhere" in each.detail for each in found.findings)


def test_a_mistake_in_whole_runs_alone_is_seen():
    assert "limit position" in failing(verdict(Changed(1.0 + 1e-6, at_home=True)))


# --- no truth


def test_without_truth_a_right_engine_is_unresolved_with_the_reason():
    found = verdict(Changed(), known=False)
    assert not failing(found)
    assert found.share == 0.0
    assert "no formulas" in found.why
    assert found.order.observed > 1.5
    assert found.ladder == []


def test_without_truth_an_order_can_fail():
    assert "order" in failing(verdict(Changed(order=4), known=False))


def test_without_truth_a_run_that_is_not_what_the_engine_does_fails():
    def late(engine, scene, raw):
        if scene.name != "elsewhere":
            raw.states.x[len(raw.states.t) // 2:, 0, 0] += 1e-3
        return raw

    assert any(kind.startswith("gap") for kind in failing(verdict(Changed(raw=late), known=False)))


def test_without_truth_accelerations_that_are_not_those_of_the_states_fail():
    def scaled(engine, scene, raw):
        raw.states.a = 1.01 * raw.states.a
        return raw

    assert "promise acceleration" in failing(verdict(Changed(raw=scaled), "DAE1L_LSE", known=False))
    assert not failing(verdict(Changed(), "DAE1L_LSE", known=False))


# --- start, noise, iteration


def test_a_run_that_begins_elsewhere_fails():
    def off(engine, scene, raw):
        for part in (raw.states.x, ):
            part[:, :, 1] += 1e-9 * (scene.name != "elsewhere")
        return raw

    assert "asked start position" in failing(verdict(Changed(raw=off)))


def scattered(size):
    def raw(engine, scene, found):
        found.states.x[1:, :, 0] += size * engine.rng.uniform(-1.0, 1.0, found.states.x[1:, :, 0].shape)
        return found
    return raw


def test_repeats_that_scatter_by_more_than_the_error_are_told():
    assert "noise position" in failing(verdict(Changed(raw=scattered(1e-4))))


def test_noise_below_the_error_accuses_nothing():
    assert not failing(verdict(Changed(raw=scattered(1e-8))))


def left(engine, scene, raw):
    """What an iteration that ends early leaves: another part of its tolerance in each run."""
    raw.states.x[1:, :, 2] += 1e-8 * np.sin(1e5 * raw.step)
    return raw


def test_what_an_iteration_is_declared_to_leave_is_allowed_and_shown():
    assert failing(verdict(Changed(raw=left), "rkmk4"))
    found = verdict(Changed(raw=left, left=1e-8), "rkmk4")
    assert not failing(found)
    assert any("iteration (declared)" in each.detail for each in found.findings)


@pytest.mark.parametrize("said", ["1e-8", -1.0, np.nan])
def test_what_an_iteration_leaves_is_a_length(said):
    engine = completed(Changed(left=said), "tests", "1")
    with pytest.raises(EngineError, match="not a length in m"):
        engine.iteration(load_scene("double_pendulum"), RunSpec("rkmk4", step=STEP))


# --- the flow without heyoka


@pytest.mark.parametrize("name", ["double_pendulum", "four_bar", "torsion_wheel"])
def test_the_flow_is_the_same_without_heyoka(monkeypatch, name):
    scene = load_scene(name).replace(duration=0.2, samples=11)
    reference = truth(scene)
    start = restarted(scene, reference.states, 3, 0.14, 8)
    usual = SystemFlow(scene, sizes(scene, reference.states), reference)
    monkeypatch.setattr(system_flow, "dense", lambda scene: SimpleNamespace(series=Maximal(scene)))
    stepped = SystemFlow(scene, sizes(scene, reference.states), reference)
    one, other = (each.from_(start, float(reference.t[3]), start.t) for each in (usual, stepped))
    assert not stepped.minimal
    for part in ("x", "R", "v", "w", "a", "alpha"):
        assert getattr(one.states, part) == pytest.approx(getattr(other.states, part), abs=1e-8), part
    assert other.error < 1e-10
    assert other.growth == pytest.approx(one.growth, rel=1.0)


# --- events


def test_what_jumps_at_the_last_output_is_left_out_there():
    """A servo's sample falls on the end of the segment: an acceleration before it or after it is right."""
    scene = law_scene("sampled")
    reference = truth(scene)
    flow, period = SystemFlow(scene, sizes(scene, reference.states), reference), scene.forces[0].parameters["period"]
    last = int(np.flatnonzero(np.abs(scene.t / period - np.round(scene.t / period)) < 1e-9)[1])
    segment = Segment(0, last, scene, scene.replace(duration=scene.t[last], samples=last + 1))
    segment.flowed = flow.from_(segment.start, 0.0, segment.t)
    assert any(jump.after == pytest.approx(segment.t[-1]) for jump in segment.flowed.jumps)
    for step in (0.0, period / 100):
        assert not segment.kept("acceleration", step)[-1]
        assert segment.kept("position", step).all()


# --- the whole run against truth


def drifting(more):
    """An error of order 2 without one constant, since the run began; whole runs drift, too."""
    def raw(engine, scene, found):
        t, h = found.states.t[:, None], found.step
        size = h**2 * (1.0 + 0.3 * np.sin(1e7 * h))
        found.states.x[:, :, 0] += size * (1.0 - np.cos(17.0 * t))
        found.states.v[:, :, 0] += size * 17.0 * np.sin(17.0 * t)
        if scene.name != "elsewhere":
            found.states.x[:, :, 1] += more * t**2 / 2
            found.states.v[:, :, 1] += more * t
        return found
    return raw


def test_a_run_that_drifts_within_what_its_restarts_leave_open_fails_in_the_whole():
    found = verdict(Changed(raw=drifting(1e-5), order=2), scene="nesc_brick")
    assert failing(found) == {"limit position"}
    assert any("of whole runs" in each.detail for each in found.findings if each.status == "fail")


def test_a_run_whose_error_falls_with_the_step_passes_though_it_is_not_what_its_restarts_do():
    found = verdict(Changed(raw=drifting(0.0), order=2), scene="nesc_brick")
    assert not failing(found)
    assert found.share == 1.0


# --- where truth ends


def test_where_truth_ends_by_a_touch_the_rest_counts_as_unresolved_and_nothing_is_accused(monkeypatch):
    known = truth  # of the references
    monkeypatch.setitem(globals(), "truth", lambda scene: dataclasses.replace(
        known(scene), horizon=0.3, horizon_cause="bodies a and b touch"))
    found = verdict(Changed())
    assert not failing(found)
    assert found.share == pytest.approx(0.6)
    assert "bodies a and b touch" in found.why
    assert "limit position" in failing(verdict(Changed(1.0 + 1e-6)))
