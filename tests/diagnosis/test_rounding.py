"""Rounding to one side in every step is told from random rounding, from a wrong model and from errors of the steps."""

import dataclasses
import zlib

import numpy as np
import pytest

from crosscheck import diagnosis
from crosscheck.adapters.base import RawRun, steps_per_sample
from crosscheck.diagnosis import observe, of_stepping
from crosscheck.diagnosis.observe import Subject
from crosscheck.document import Way
from crosscheck.references.maximal import Maximal
from crosscheck.scene.file import load_scene
from crosscheck.scene.states import States

SINGLE = 2.0**-23


@dataclasses.dataclass
class Made:
    """The true motion in numbers of single precision, with errors that are known."""

    spun_up: float = 0.0  # share of the angular velocity that every step adds
    shaken: float = 0.0  # the same, at random
    open: float = 0.0  # share of the angular velocity by which steps of 1 s are wrong
    gravity: float = 1.0
    name = "made"
    methods = ("Plain",)
    forms = ()
    options = frozenset()
    eps = SINGLE

    def version(self):
        return "1"

    def documented_order(self, scene, spec):
        return 1

    def held_levels(self, scene, spec):
        return frozenset()

    def unsupported(self, scene, spec):
        return None

    def run(self, scene, spec):
        per, step = steps_per_sample(scene, spec.step)
        true = Maximal(scene.replace(gravity=self.gravity * scene.gravity)).run()
        done = per * np.arange(scene.samples)[:, None, None]
        random = np.random.default_rng(zlib.crc32(np.float64(step).tobytes())).normal(size=true.w.shape)
        walk = np.cumsum(np.sqrt(per) * random, axis=0) - np.sqrt(per) * random[:1]
        factor = 1 + self.spun_up * done + self.shaken * walk + self.open * step * scene.t[:, None, None]
        parts = [part.astype(np.float32).astype(float) for part in (true.x, true.R, true.v, factor * true.w)]
        return RawRun(States(scene.t, *parts), 1e-6, per * (scene.samples - 1), step)


@pytest.mark.parametrize(("engine", "named"), [
    (Made(spun_up=3e-7), True), (Made(spun_up=-3e-8), True), (Made(spun_up=3e-7, open=0.3), True),
    (Made(spun_up=3e-7, shaken=1e-6), True), (Made(), False), (Made(shaken=1e-5), False), (Made(open=1.0), False),
    (Made(gravity=1.001), False), (Made(gravity=1.1, spun_up=3e-8), False)],
    ids=["spun up", "slowed down", "with errors of the steps", "with random rounding", "rounded to nearest",
         "random rounding", "errors of the steps", "gravity", "gravity, which is more"])
def test_errors_that_double_with_the_steps_and_keep_their_direction_are_named(engine, named):
    scene = load_scene("single_pendulum")
    scale = observe.scale_of(scene)
    answer = diagnosis.Explanation("", "", "", None, "pass", "", [], [], [], 1.0, None, None)
    found = of_stepping.adds_up(Subject(engine, Way("fake", "Plain")), observe.window(scene, scale), scale, answer)
    assert found == answer.evidence[0].holds == named, answer.evidence
    assert answer.names == ("rounding that adds up",) * named


@pytest.mark.parametrize(("engine", "outcome", "named"), [
    (Made(spun_up=3e-7), "fail", True), (Made(gravity=1.01), "unresolved", False), (Made(), "pass", False)])
def test_the_whole_explanation_names_it_and_accuses_a_right_engine_of_nothing(engine, outcome, named):
    scene = load_scene("single_pendulum").replace(duration=1.0, samples=51)
    answer = diagnosis.explain(scene, engine, "Plain", step=1e-3)
    assert (answer.outcome, answer.names) == (outcome, ("rounding that adds up",) if named else ()), answer.sentence
