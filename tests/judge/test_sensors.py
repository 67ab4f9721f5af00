"""Errors of sensors converge with the documented order of every method, and readings are right from the start on."""

import numpy as np
import pytest

import crosscheck
from crosscheck import adapters
from crosscheck.adapters.base import RunSpec
from crosscheck.judge.metrics import Plateau, observed_order
from crosscheck.judge.tolerances import CONSTANTS, order_margin
from crosscheck.scene.sensors import OWN, gap
from tests.diagnosis.test_sensors import G, arm
from tests.scene.test_sensors import watched

T, SAMPLES = 0.2, 3
COUNTS = {1: (25, 50, 100, 200), 2: (25, 50, 100, 200), 4: (5, 10, 20, 40), 5: (5, 10, 20, 40), 6: (2, 4, 8, 16),
          8: (1, 2, 3, 4)}
"""By order, numbers of steps in .1 s with which errors lie above rounding."""
SCENE = arm(damping=0.0).replace(forces=(), duration=T, samples=SAMPLES)
WAYS = [(engine, method) for engine in adapters.names() for method in adapters.get(engine).methods]


def errors(engine, method, **size):
    """The largest error of each sensor after the start, with MuJoCo's `framelinacc` corrected by g."""
    read, truth = crosscheck.run(SCENE, engine, method, **size).sensors, crosscheck.truth(SCENE).sensors
    by_g = G if engine.startswith("mujoco") and read.source["acceleration"] == OWN else 0.0 * G
    return {name: float(gap(values + (by_g if name == "acceleration" else 0.0), truth[name])[1:].max())
            for name, values in read.items()}


@pytest.mark.parametrize(("engine", "method"), WAYS)
def test_order(engine, method):
    adapter = adapters.get(engine)
    adaptive = method in adapter.adaptive_methods
    spec = RunSpec(method, rtol=1e-6) if adaptive else RunSpec(method, step=1e-3)
    if (reason := adapter.unsupported(SCENE, spec)) is not None:
        pytest.skip(reason)
    if adaptive:
        for rtol in (1e-4, 1e-7, 1e-10):
            for name, error in errors(engine, method, rtol=rtol).items():
                size = max(1.0, float(np.abs(crosscheck.truth(SCENE).sensors[name]).max()))
                assert error <= (100 * rtol + 1e-12) * size, (name, rtol)
        return
    order = adapter.documented_order(SCENE, spec)
    steps = [T / 2 / count for count in COUNTS[order]]
    # A plan's coarsest steps are finer than these; of order 8 the nearest whole number counts.
    margin = CONSTANTS["order_margin_coarse"] if order == 8 else 2 * order_margin(order)
    runs = [errors(engine, method, step=step) for step in steps]
    for name in runs[0]:
        observed = observed_order(steps, [run[name] for run in runs], Plateau(1e-15, 0.0, order)).observed
        if name == "joint_effort":
            assert runs[0][name] == 0.0  # nothing drives it
        else:
            assert observed is not None
            assert observed >= order - margin, name


@pytest.mark.parametrize("name", ["arm", "driven_double_pendulum", "driven_slider_crank", "geared_arm"])
def test_the_start(name):
    """At t = 0, also where a drive moves: every engine reads what truth reads, or what it is known to read."""
    scene = arm() if name == "arm" else watched(name)
    truth = crosscheck.truth(scene).sensors
    told = 0
    for engine in adapters.names():
        adapter = adapters.get(engine)
        method = next((each for each in adapter.methods if adapter.unsupported(scene, RunSpec(
            each, **({"rtol": 1e-9} if each in adapter.adaptive_methods else {"step": 1e-3}))) is None), None)
        if method is None:
            continue
        size = {"rtol": 1e-9} if method in adapter.adaptive_methods else {"step": 1e-3}
        read = crosscheck.run(scene, engine, method, **size).sensors
        for sensor in scene.sensors:
            if read.source[sensor.name] == OWN and sensor.type in ("acceleration", "force", "torque"):
                continue  # MuJoCo's framelinacc, and its wrenches without the load on a site
            size_of = max(1.0, float(np.nanmax(np.abs(truth[sensor.name]), initial=0.0)))
            gap_at = float(gap(read[sensor.name], truth[sensor.name])[0])
            assert gap_at <= 1e-8 * size_of, (engine, sensor.name)
            told += 1
    assert told > 20
