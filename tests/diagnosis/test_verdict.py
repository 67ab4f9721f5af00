"""Where `crosscheck verify` fails, `explain` never says that nothing differs, even if all its own looks are blind."""

import dataclasses

import numpy as np
import pytest

from crosscheck import adapters, diagnosis
from crosscheck.diagnosis import of_verdict
from crosscheck.diagnosis.observe import Subject
from crosscheck.diagnosis.result import Explanation
from crosscheck.document import Plan, Way
from crosscheck.document.known import Known
from crosscheck.scene.file import load_scene
from crosscheck.verification.cell import run_cell
from crosscheck.verification.task import Cell
from tests.diagnosis import misbuilt
from tests.engines.right import Adaptive
from tests.engines.stepper import Misbuilt

NAME, METHOD = "single_pendulum", "rkmk4"


def reporting(**changes):
    """lieeuler that reports some of its states otherwise: `change(t, values)`."""
    def report(scene, raw):
        for name, change in changes.items():
            setattr(raw.states, name, change(scene.t[:, None, None], getattr(raw.states, name)))
        return raw
    return Misbuilt(adapters.get("lieeuler"), (), (report,))


MISTAKES = {
    "single precision": reporting(x=lambda t, x: x.astype(np.float32).astype(float)),
    "clamp": reporting(w=lambda t, w: np.clip(w, -1.0, 1.0)),
    "lost sign": reporting(R=lambda t, R: np.where(t[..., None] > 5.0, np.swapaxes(R, -1, -2), R)),
    "noise": reporting(x=lambda t, x: x + 1e-7 * np.random.default_rng(1).normal(size=x.shape)),
    "late": reporting(x=lambda t, x: np.where(t > 8.0, np.roll(x, 1, axis=0), x)),
    "open joint": reporting(x=lambda t, x: x + 1e-3 * (t > 9.0)),
    "acceleration without gravity": reporting(a=lambda t, a: a + 9.81 * np.array([0.0, 0.0, 1.0])),
    "multipliers reversed": reporting(lam=lambda t, lam: -lam),
    "multipliers too large": reporting(lam=lambda t, lam: 1.5 * lam),
    "gravity": Misbuilt(adapters.get("lieeuler"), (misbuilt.gravity(lambda g: 1.001 * g),)),
}


@pytest.mark.parametrize("key", MISTAKES)
def test_no_tick_where_verify_fails(key, monkeypatch):
    with adapters.lent(MISTAKES[key]) as name:
        assert run_cell(Cell(NAME, Way(name, METHOD), Plan({1: 1e-2}, samples=101))).outcome == "fail"

    monkeypatch.setattr(diagnosis, "_judge", lambda *given: None)
    monkeypatch.setattr(diagnosis, "_look_through", lambda *given: None)
    answer = diagnosis.explain(NAME, MISTAKES[key], METHOD)
    assert answer.outcome != "pass"
    assert answer.exit_code > 0
    assert answer.verdict == "fail"


def test_findings_about_reports_are_causes_and_others_are_not():
    scene = load_scene(NAME)
    answers = {}
    for key in ("acceleration without gravity", "multipliers reversed", "multipliers too large", "gravity"):
        answers[key] = Explanation(NAME, "", METHOD, None, "pass", "", [], [], [], 1.0, 0.0, 0.0)
        of_verdict.add(Subject(MISTAKES[key], Way("lieeuler", METHOD)), scene, None, answers[key])
        answers[key].conclude()
    assert answers["acceleration without gravity"].names == ("reported accelerations",)
    assert answers["multipliers reversed"].names == ("reversed multipliers",)
    assert answers["multipliers too large"].names == ("reported multipliers",)
    assert answers["gravity"].outcome == "unresolved"
    assert "crosscheck verify rejects it" in answers["gravity"].sentence


def test_a_known_defect_is_told_with_its_reason(monkeypatch):
    subject, scene = Subject(MISTAKES["gravity"], Way("lieeuler", METHOD)), load_scene(NAME).replace(duration=1.0)
    failing = [each for each in of_verdict.judged(subject, scene, 1e-2).findings if each.status == "fail"]
    entry = Known("", ("",), (METHOD,), {each.kind: each.value / (each.size or 1.0) for each in failing},
                  "heavier on Sundays", "")
    monkeypatch.setattr("crosscheck.verification.cell.defects", lambda engine, run: (entry,))
    answer = Explanation(NAME, "", METHOD, None, "pass", "", [], [], [], 1.0, 0.0, 0.0)
    of_verdict.add(subject, scene, 1e-2, answer)
    answer.conclude()
    assert answer.outcome == "pass"
    assert answer.verdict.startswith("known; heavier on Sundays")


def test_a_tolerance_that_is_too_loose_is_named():
    class Loose(Adaptive):
        def run(self, scene, spec):
            return super().run(scene, dataclasses.replace(spec, rtol=1e3 * spec.rtol))

    # Long, so that its tolerance and not the distance of the outputs, .24 s, makes its steps.
    answer = diagnosis.explain(load_scene(NAME).replace(duration=60.0, samples=31), Loose(), "DP5")
    assert answer.names == ("loose tolerance",), answer.sentence


def test_a_right_engine_passes_and_its_name_is_taken_back():
    engine = Misbuilt(adapters.get("lieeuler"))
    assert of_verdict.judged(Subject(engine, Way("lieeuler", METHOD)), load_scene(NAME), None).outcome == "pass"
    assert not adapters._LENT
