"""An engine's own readings of what laws of joints act on: right ones are accused of nothing, wrong ones fail."""

import dataclasses

import numpy as np
import pytest

from crosscheck import adapters
from crosscheck.adapters.base import StandIn
from crosscheck.scene.model import Sensor, Site
from crosscheck.scene.sensors import SENSOR_TYPES, readings
from tests.fake_engine import install
from tests.judge.test_law_engines import accused, judged
from tests.judge.test_law_engines import scene as law_scene


def watched(name):
    """A scene with laws of joints and every type of sensor."""
    scene = law_scene(name)
    site = Site("tip", scene.n - 1, np.array([0.1, -0.2, 0.3]), np.array([0.8, 0.1, -0.4, 0.3]) / np.sqrt(0.9))
    return scene.replace(sites=(site,), sensors=tuple(Sensor(
        kind, kind, "tip" if "site" in each.needs else None, scene.joints[-1].name if "joint" in each.needs else None,
        each.axes) for kind, each in SENSOR_TYPES.items()))


class Reading(StandIn):
    """lieeuler, which reads its sensors itself, one of them wrongly."""

    name = "fake"

    def __init__(self, kind="", wrong=None):
        super().__init__(adapters.get("lieeuler"))
        self.kind, self.wrong = kind, wrong

    def run(self, scene, spec):
        raw = self._engine.run(scene, spec)
        read = dict(readings(scene, raw.states))
        if self.kind:
            read[self.kind] = self.wrong(scene, raw.states, read)
        raw.states.sensors = read
        return raw


def without(**laws):
    """The same without these laws of joints."""
    def read(scene, states, kind):
        bare = scene.replace(joints=tuple(dataclasses.replace(joint, **laws) for joint in scene.joints))
        return readings(bare, dataclasses.replace(states, a=None, alpha=None, sensors=None))[kind]
    return read


WRONG = [(name, kind, lambda scene, states, read, law=law, kind=kind: without(**law)(scene, states, kind))
         for name, law in (("friction", {"dry_friction": ()}), ("soft", {"limits": ()}))
         for kind in ("accelerometer", "torque")]
WRONG += [("bounce", "accelerometer", lambda scene, states, read: read["acceleration"]),
          ("two", "force", lambda scene, states, read: np.roll(read["force"], 1, axis=0)),
          ("saturated", "torque", lambda scene, states, read: -read["torque"])]


@pytest.mark.parametrize("name", ["friction", "lifted", "bounce", "soft", "saturated", "two"])
def test_right_readings_are_accused_of_nothing(monkeypatch, name):
    assert not accused(judged(watched(name), install(monkeypatch, Reading()), "rkmk4"))


@pytest.mark.parametrize(("name", "kind", "wrong"), WRONG, ids=[f"{name}-{kind}" for name, kind, _ in WRONG])
def test_wrong_readings_fail(monkeypatch, name, kind, wrong):
    found = accused(judged(watched(name), install(monkeypatch, Reading(kind, wrong)), "rkmk4"))
    assert {each.partition(":")[0] for each in found} == {f"limit sensor {kind}"}
