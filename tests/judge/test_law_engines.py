"""Force laws of joints: every engine with a mistake in one of them fails, and right ones are accused of nothing."""

import dataclasses
import functools
import pathlib
import tempfile

import pytest

import crosscheck
from crosscheck import adapters
from crosscheck.adapters.base import RunSpec, StandIn
from crosscheck.document import Record
from crosscheck.verification.cell import judge_run
from tests import law_engines
from tests.adapters.test_laws import pendulum as hinge_pendulum
from tests.fake_engine import install
from tests.law_mistakes import MISTAKES, SCENES, Mistake, Wrong, control, times
from tests.references.law_scenes import pendulum, servo

ORDERS = {1: 5e-4, 2: 1e-3, 4: 5e-3, 6: 1e-2, 8: 1e-2}
"""Steps, s, by documented order: what a user would take for errors of 1e-3 to 1e-9."""


@functools.cache
def scene(name):
    with tempfile.TemporaryDirectory() as folder:
        return {**SCENES, **law_engines.SCENES, **BETWEEN}[name](pathlib.Path(folder)).replace(name=name)


def judged(given, engine, method):
    """The verdict on one run."""
    spec = RunSpec(method, rtol=1e-9) if method in engine.adaptive_methods else RunSpec(method, step=1e-3)
    order = engine.documented_order(given, spec)
    step = None if order is None else ORDERS[order]
    traj = crosscheck.run(given, engine=engine.name, method=method, step=step, rtol=spec.rtol)
    run = Record(scene=given.name, engine=engine.name, version="1", method=method, form=traj.form, step=step,
              rtol=spec.rtol, documented_order=order)
    return judge_run(run, given, traj, engine.held_levels(given, spec))


def accused(verdict):
    return {f"{finding.kind}: {finding.value} of {finding.bound}, {finding.detail}" for finding in verdict.findings
            if finding.status == "fail"}


CASES = [pytest.param(mistake, method, id=f"{mistake.what}-{method}")
         for mistake in MISTAKES for method in mistake.methods]
AROUND_EVENTS = ("friction 1 % high-rkmk4", "more friction on the way back-rkmk4",
                 "more friction on the way there-rkmk4", "restitution .51 instead of .5-rkmk4")
"""Mistakes that the segments before and after an event show."""


def wrong(monkeypatch, mistake, method):
    engine = install(monkeypatch, Wrong(mistake))
    verdict = judged(scene(mistake.scene), engine, method)
    assert verdict.outcome == "fail", f"{mistake.what} is not noticed"
    return accused(verdict)


@pytest.mark.parametrize(("mistake", "method"), [case for case in CASES if case.id in AROUND_EVENTS])
def test_a_mistake_on_either_side_of_an_event_fails(monkeypatch, mistake, method):
    assert any(each.startswith("limit ") for each in wrong(monkeypatch, mistake, method))


@pytest.mark.parametrize(("mistake", "method"), CASES)
def test_every_wrong_engine_fails(monkeypatch, mistake, method):
    wrong(monkeypatch, mistake, method)


RIGHT = [(name, method) for name in SCENES for method in ("DAE3L_LE", "DAE1L_LSE", "DAE2H_LSE", "rattle2", "rkmk4",
                                                          "rattle8", "rkmk853", "taylor")]


@pytest.mark.parametrize(("name", "method"), RIGHT)
def test_a_right_engine_is_accused_of_nothing(name, method):
    verdict = judged(scene(name), adapters.get("lieeuler"), method)
    assert not accused(verdict)


BETWEEN = {f"{delay} of {samples}": lambda folder, delay=delay, samples=samples: pendulum(
    folder, forces=[servo("h", derivative=1.0, period=0.025, delay=delay)], samples=samples)
    for delay, samples in ((0, 33), (0, 38), (2, 33))}
"""Servos that sample between output times: what they hold there is not known where a part of a run begins."""
FORGETFUL = (
    Mistake("right under its name alone", "0 of 33", lambda scene: control(proportional=times(1.001))(
        scene) if scene.name == "elsewhere" else scene),
    Mistake("right before its servo holds something", "2 of 33", lambda scene: control(proportional=times(1.01))(
        scene) if any(each.held for _, each in scene.servos.values()) else scene, ("rkmk4",)),
    Mistake("delay is ignored", "2 of 33", control(delay=0, held=lambda held: (held or ())[:1])),
    Mistake("a delay too short by one", "2 of 33", control(delay=1, held=lambda held: (held or ())[:2])),
    Mistake("damping .1 % low", "0 of 38", control(derivative=times(0.999))))


@pytest.mark.parametrize("name", BETWEEN)
@pytest.mark.parametrize("method", ["DAE1L_LSE", "rattle2", "rkmk4"])
def test_samples_between_output_times_are_accused_of_nothing(name, method):
    assert not accused(judged(scene(name), adapters.get("lieeuler"), method))


@pytest.mark.parametrize(("mistake", "method"), [
    pytest.param(mistake, method, id=f"{mistake.what}-{method}")
    for mistake in FORGETFUL for method in mistake.methods])
def test_a_mistake_in_what_is_held_between_output_times_fails(monkeypatch, mistake, method):
    assert wrong(monkeypatch, mistake, method)


class Shifted(StandIn):
    """MuJoCo, whose accelerations are .1 % large."""

    name = "fake"

    def run(self, scene, spec):
        """The run, with wrong accelerations of bodies."""
        raw = self._engine.run(scene, spec)
        raw.states = dataclasses.replace(raw.states, a=1.001 * raw.states.a)
        return raw


@pytest.mark.parametrize(("engine", "method"), [
    ("mujoco", "Euler"), ("exudyn", "RK44"), ("exudyn", "GeneralizedAlpha")])
def test_soft_friction_is_not_accused_of_how_it_holds(monkeypatch, engine, method):
    """The pendulum comes to rest: soft rows and bristles hold it by laws of their own, and bristles remember."""
    resting = hinge_pendulum(dry_friction=0.5)
    assert not accused(judged(resting, adapters.get(engine), method))
    if engine == "mujoco":
        shifted = install(monkeypatch, Shifted(adapters.get("mujoco")))
        assert any("acceleration" in each for each in accused(judged(resting, shifted, method)))


def test_accelerations_are_judged_where_a_stop_bounces(monkeypatch):
    """The spring of an impact stands for a jump of velocities, and what it gives at an output time for nothing."""
    def kinds(engine):
        return {each.partition(":")[0] for each in accused(judged(scene("bounce"), engine, "RK4"))}

    accelerations = {"limit acceleration", "promise acceleration"}
    assert not kinds(adapters.get("mujoco")) & accelerations
    assert kinds(install(monkeypatch, Shifted(adapters.get("mujoco")))) & accelerations


OTHERS = [("pinocchio", name, method) for name in ("saturated", "motor", "following", "sampled", "soft")
          for method in ("SymplecticEuler", "RKMK4")]


@pytest.mark.parametrize(("engine", "name", "method"), OTHERS)
def test_other_right_engines_are_accused_of_nothing(engine, name, method):
    assert not accused(judged(scene(name), adapters.get(engine), method))


@pytest.mark.parametrize("name", [
    "drop", "encoder", "turns", "carriage", "corner"])
def test_an_engine_of_its_own_code_is_accused_of_nothing(monkeypatch, name):
    """Samples of a servo between output times, more than half a turn, and impacts near all of these."""
    assert not accused(judged(scene(name), install(monkeypatch, law_engines.Impulses()), "Plain"))


@pytest.mark.parametrize("what", law_engines.MISTAKES)
def test_a_mistake_in_its_code_fails(monkeypatch, what):
    engine = install(monkeypatch, law_engines.Impulses(what))
    assert judged(scene(law_engines.MISTAKES[what]), engine, "Plain").outcome == "fail"
