"""What an engine declares: its tolerance, its steps, its Newton residual, the precision of its numbers."""

import dataclasses

import numpy as np
import pytest

import crosscheck
from crosscheck import load_scene
from crosscheck.adapters.base import RawRun, RunSpec, steps_per_sample
from crosscheck.document import Plan, Way
from crosscheck.judge.plan import PLANS, STUDY_SAMPLES, halved, parts
from crosscheck.judge.substeps import judge_substeps
from crosscheck.references import truth
from crosscheck.running.trajectory import derive
from crosscheck.verification.cell import run_cell
from crosscheck.verification.task import Cell
from tests.fake_engine import install
from tests.references.law_scenes import pendulum
from tests.right_engines import Adaptive, Floats, Rotations
from tests.wrong_engines import MISTAKES, STEP, Right

SCENES = ("single_pendulum", "double_pendulum", "triple_pendulum", "heavy_top", "hinge_pendulum", "universal_pendulum")
LADDERS = {1: halved(4e-3), 4: parts(0.1, 10, 14, 20, 28)}


def judged(monkeypatch, engine, scene, method, study=True, rungs=None, ladders=LADDERS):
    window = PLANS[scene].window if scene in PLANS else 1.0
    if method.startswith("RK"):
        window = 0.5
    install(monkeypatch, engine)
    plan = Plan(window, {1: STEP}, ladders, samples=26, duration=window)
    return run_cell(Cell(scene, Way("fake", method), plan, study, rungs))


def finding(run, kind):
    return next(each for each in run.findings if each.kind == kind)


class Loose(Adaptive):
    """Takes a tolerance for another one."""

    def __init__(self, times):
        self.times = times

    def run(self, scene, spec):
        return super().run(scene, dataclasses.replace(spec, rtol=min(0.5, self.times * spec.rtol)))


@pytest.mark.parametrize(("times", "status"), [(1, "ok"), (100, "fail")])
def test_a_tolerance_that_is_taken_for_another_fails(monkeypatch, times, status):
    run = judged(monkeypatch, Loose(times), "single_pendulum", "DP5", rungs=3)
    assert finding(run, "rtol").status == status, finding(run, "rtol")
    assert run.outcome == {"ok": "pass"}.get(status, status), run.findings


@pytest.mark.parametrize("scene", SCENES)
@pytest.mark.parametrize(("times", "outcome"), [(1, "pass"), (100, "fail"), (1000, "fail")])
def test_every_tolerance_that_is_taken_for_another_fails(monkeypatch, times, outcome, scene):
    run = judged(monkeypatch, Loose(times), scene, "DP5")
    assert run.outcome == outcome or (outcome == "pass" and run.within), run.findings


def hidden(base, count, counted=False):
    """An engine that takes `count` steps for each that it is asked for."""
    class Hidden(base):
        def run(self, scene, spec):
            h = steps_per_sample(scene, spec.step)[1]
            raw = super().run(scene, dataclasses.replace(spec, step=h / count))
            return raw if counted else RawRun(raw.states, raw.wall_time, raw.steps // count, h, maxima=raw.maxima)
    return Hidden()


class Blend(Rotations):
    """Of first order, with the leading error of ten of Euler's steps for each."""

    methods = ("RK1",)

    def step(self, scene, t, state, h, stages, weights):
        """Near the trapezoidal rule."""
        return super().step(scene, t, state, h, [[], [1.0]], [0.55, 0.45])


class Stored(Floats):
    """Stores the start in 32 bits, too, so that it is not exactly that of the scene."""

    def raw(self, scene, kept, steps, h):
        """The run, from its stored start."""
        return super().raw(scene, [self.after(scene, kept[0]), *kept[1:]], steps, h)


def substeps(engine, name, method, order, brief=1.0):
    """The finding on a run over the beginning of the order study's window."""
    plan = PLANS[name]
    scene = load_scene(name).replace(duration=brief * plan.window, samples=STUDY_SAMPLES)
    step = plan.ladder(order)[0]
    run = derive(scene, "fake", method, engine.run(scene, RunSpec(method, step=step, monitor=False)))
    asked = steps_per_sample(scene, step)[0] * (scene.samples - 1)
    return judge_substeps(scene, run, truth(scene), order, asked)[0]


@pytest.mark.parametrize(("engine", "method", "status"), [
    (hidden(Right, 3), "RKMK1", "fail"), (hidden(Right, 2), "RKMK4", "fail"), (hidden(Rotations, 2), "RK2", "fail"),
    (hidden(Rotations, 4, counted=True), "RK4", "fail"), (hidden(Stored, 2), "RK1", "fail"), (Stored(), "RK1", "ok"),
    (Right(), "RKMK1", "ok"), (Right(), "RKMK4", "ok"), (Rotations(), "RK2", "ok"), (Blend(), "RK1", "ok")])
def test_hidden_steps_fail_and_small_errors_do_not(engine, method, status):
    found = substeps(engine, "single_pendulum", method, int(method[-1]), 0.2 if method[-1] < "4" else 1.0)
    assert found.status == status, found


def test_a_plain_method_that_diverges_says_nothing_of_the_run():
    scene = load_scene("bricard").replace(duration=1.0, samples=STUDY_SAMPLES)
    run = crosscheck.run(scene, "lieeuler", "rkmk4", step=0.04)
    assert judge_substeps(scene, run, truth(scene), 4, run.steps)[0].status == "ok"


@pytest.mark.parametrize(("steps", "in_vain", "status"), [
    ((0.005, 0.001), 0, "ok"), ((0.005, 0.001), 40, "ok"), ((0.0025, 0.0005), 0, "fail"), ((0.001, 0.001), 0, "fail")])
def test_what_finding_events_takes_is_no_hidden_step(tmp_path, steps, in_vain, status):
    scene = pendulum(tmp_path, {"position": 1.2, "limits": {"lower": 1.15}}, duration=0.2, samples=5)
    runs = [crosscheck.run(scene, "lieeuler", "rkmk4", step=step) for step in steps]  # of 5 and 1 ms asked for
    assert truth(scene).events
    coarse, fine = (dataclasses.replace(run, steps=run.steps + in_vain) for run in runs)
    assert judge_substeps(scene, coarse, truth(scene), 4, 40, (fine, 200))[0].status == status


def test_steps_taken_in_vain_to_find_an_event_are_rejected_steps(tmp_path):
    run = crosscheck.run(pendulum(tmp_path, {"position": 1.2, "limits": {"lower": 1.15}}, duration=0.2, samples=5),
                         "lieeuler", "rkmk4", step=0.005)
    assert (len(run.events), run.steps) == (1, 41)
    assert run.stats["rejected_steps"] > 0


@pytest.mark.parametrize("scene", PLANS)
@pytest.mark.parametrize("order", [1, 2, 4])
@pytest.mark.parametrize("count", [1, 2, 5])
def test_hidden_steps_fail_everywhere(scene, order, count):
    found = substeps(hidden(Right, count), scene, f"RKMK{order}", order)
    assert found.status == ("ok" if count == 1 else "fail"), found


class Deaf(Right):
    """Takes a step of its own, whatever it is asked for, and says so."""

    def run(self, scene, spec):
        return super().run(scene, dataclasses.replace(spec, step=0.01))


def test_an_engine_that_takes_its_own_step_fails_and_its_study_ends(monkeypatch):
    run = judged(monkeypatch, Deaf(), "single_pendulum", "RKMK4", rungs=3)
    assert run.outcome == "fail"
    assert {each.status for each in run.findings if each.kind == "steps"} == {"fail"}


class Silent(Right):
    """Does not say which step it takes."""

    def run(self, scene, spec):
        return dataclasses.replace(super().run(scene, spec), step=None)


@pytest.mark.parametrize(("engine", "status"), [
    (hidden(Right, 2), "fail"), (hidden(Rotations, 4, counted=True), "fail"), (Silent(), "ok")])
def test_a_study_looks_for_hidden_steps(monkeypatch, engine, status):
    """Also of an engine that counts them and tells their size."""
    method = next(name for name in engine.methods if name.endswith("4"))
    run = judged(monkeypatch, engine, "single_pendulum", method, rungs=3,
                 ladders={4: (0.07, 0.03, 0.016)})  # which do not divide the .1 s between outputs
    assert finding(run, "sub-steps").status == status
    assert not any(each.kind == "steps" and each.status == "fail" for each in run.findings)


def test_what_newton_leaves_is_believed_up_to_what_an_iteration_may(monkeypatch):
    def claiming(base):
        run = base.run

        def told(scene, spec):
            raw = run(scene, spec)
            return dataclasses.replace(raw, stats={"newton_left": 1.0})
        base.run = told
        return base

    wrong = next(each for each in MISTAKES if each.name.startswith("gravity x 1.01"))
    run = judged(monkeypatch, claiming(wrong.make(np.random.default_rng(1))), "single_pendulum", "RKMK4", study=False)
    assert {each.kind for each in run.findings if each.status == "fail"} & {"interval position", "limit position"}
    held = claiming(Right())
    held.held_levels = lambda scene, spec: frozenset({"position"})
    run = judged(monkeypatch, held, "single_pendulum", "RKMK1", study=False)
    assert finding(run, "level position").status == "fail"


def test_no_numbers_coarser_than_those_of_32_bits_are_believed(monkeypatch):
    wrong = next(each for each in MISTAKES if each.name.startswith("gravity x 1.01"))
    engine = wrong.make(np.random.default_rng(1))
    engine.eps = 0.1
    assert judged(monkeypatch, engine, "single_pendulum", "RKMK4", study=False).outcome == "fail"
