"""Errors of sensors converge with the documented order of every method, and readings are right from the start on."""

import numpy as np
import pytest

import crosscheck
from crosscheck import adapters
from crosscheck.adapters.base import RunSpec
from crosscheck.adapters.common import known
from crosscheck.document import Record
from crosscheck.scene.sensors import OWN, gap
from crosscheck.verification.cell import judge_run
from tests.diagnosis.test_sensors import G, arm
from tests.scene.test_sensors import watched

T, SAMPLES = 0.2, 3
COUNTS = {1: (25, 50, 100, 200), 2: (25, 50, 100, 200), 4: (5, 10, 20, 40), 5: (5, 10, 20, 40), 6: (2, 4, 8, 16),
          8: (1, 2, 3, 4)}
"""By order, numbers of steps in .1 s with which errors lie above rounding."""
SCENE = arm(damping=0.0).replace(forces=(), duration=T, samples=SAMPLES)
DOUBLE = [engine for engine in adapters.names() if adapters.get(engine).eps < 1e-12]
"""Engines of double precision: sensors of the others end at their rounding."""
WAYS = [(engine, method) for engine in DOUBLE for method in adapters.get(engine).methods]


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
    margin = 0.5 if order == 8 else 0.3  # a plan's coarsest steps are finer than these
    runs = [errors(engine, method, step=step) for step in steps]
    for name in runs[0]:
        fall = np.array([run[name] for run in runs])
        kept = fall > 1e-14  # what is left is rounding
        if name == "joint_effort":
            assert runs[0][name] == 0.0  # nothing drives it
        else:
            assert kept.sum() > 1
            assert np.polyfit(np.log(np.array(steps)[kept]), np.log(fall[kept]), 1)[0] >= order - margin, name


@pytest.mark.parametrize("name", ["arm", "driven_double_pendulum", "driven_slider_crank", "geared_arm"])
def test_the_start(name):
    """At t = 0, also where a drive moves: every engine reads what truth reads, or what it is known to read."""
    scene = arm() if name == "arm" else watched(name)
    truth = crosscheck.truth(scene).sensors
    told = 0
    for engine in DOUBLE:
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


@pytest.mark.parametrize(("name", "shown"), [
    ("double_pendulum", {"acceleration world"}),
    ("driven_double_pendulum", {"acceleration world", "force site elbow", "torque site elbow"})])
def test_what_mujoco_reads_instead_is_known_by_the_type_of_the_sensor(name, shown):
    """Its a - g, and its wrenches without loads at sites."""
    scene = watched(name).replace(duration=1.0, samples=51)
    traj = crosscheck.run(scene, "mujoco", "RK4", step=1e-3)
    run = Record(scene=name, engine="mujoco", version="4.0.0", method="RK4", form=traj.form, step=1e-3,
                 documented_order=4)
    held, entries = adapters.get("mujoco").held_levels(scene, RunSpec("RK4", step=1e-3)), known.table()
    found = judge_run(run, scene, traj, held)
    wrong = {each.kind.removeprefix("promise sensor "): each for each in found.findings if each.status == "fail"}
    assert wrong.keys() == shown
    rows = [rows for entry in entries if entry.engine == "mujoco" for rows in [known.of_sensors(entry, scene).rows]]
    for each in wrong.values():
        assert any(each.value <= 1.5 * most[each.kind] * each.size for most in rows if each.kind in most), each
