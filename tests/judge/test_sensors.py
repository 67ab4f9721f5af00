"""Errors of sensors converge with the documented order of every method, and readings are right from the start on."""

import dataclasses
import functools

import numpy as np
import pytest

import crosscheck
from crosscheck import adapters
from crosscheck.adapters.base import RunSpec
from crosscheck.judge.claim import Claim
from crosscheck.judge.defects import measured
from crosscheck.judge.metrics import Plateau, observed_order
from crosscheck.judge.sensors import judge_sensors
from crosscheck.judge.tolerances import CONSTANTS, fixed_step, order_margin
from crosscheck.scene.model import Sensor, Site
from crosscheck.scene.sensors import OWN, SENSOR_TYPES, gap, readings
from crosscheck.scene.states import States
from tests.diagnosis.test_sensors import G, arm
from tests.judge.test_law_engines import scene as law_scene
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


@functools.cache
def lawful(name, method):
    """A scene with laws of joints and every type of sensor, a run, its truth and what its intervals show."""
    scene = law_scene(name)
    site = Site("tip", scene.n - 1, np.array([0.1, -0.2, 0.3]), np.array([0.8, 0.1, -0.4, 0.3]) / np.sqrt(0.9))
    sensors = tuple(Sensor(kind, kind, "tip" if "site" in each.needs else None, scene.joints[-1].name if "joint" in
                           each.needs else None, each.axes) for kind, each in SENSOR_TYPES.items())
    scene = scene.replace(sites=(site,), sensors=sensors)
    claim = Claim(*((4, 5e-3) if method == "rkmk4" else (1, 5e-4)), None)
    traj, truth = crosscheck.run(scene, "lieeuler", method, step=claim.step), crosscheck.truth(scene)
    return scene, traj, truth, claim, measured(scene, traj, [], truth, claim)[0]


def between_events(name, method, given=None):
    """The findings, by name, on the sensors that depend on accelerations, with some readings of the engine's own."""
    scene, traj, truth, claim, run = lawful(name, method)
    traj = dataclasses.replace(traj, own_sensors=given)
    findings, errors = judge_sensors(scene, traj, truth, scene.duration, fixed_step(
        scene, truth, *claim.fixed), claim, run=run)
    assert errors.keys() == {f"sensor {each.name}" for each in scene.sensors}
    return {finding.kind.removeprefix("sensor "): finding for finding in findings
            if SENSOR_TYPES[finding.kind.removeprefix("sensor ").removesuffix(" of its state")].dynamic}


@pytest.mark.parametrize(("name", "method"), [
    *((name, "rkmk4") for name in ("friction", "lifted", "bounce", "soft", "saturated", "two")),
    ("friction", "DAE1L_LSE"), ("bounce", "DAE1L_LSE")])
def test_readings_between_events(name, method):
    """Rest, slip, stops and cut servos: what the laws give is right, and so are readings at its rounding."""
    right = lawful(name, method)[1].sensors
    for given in (None, {kind: values * (1 + 1e-13) for kind, values in right.items()}):
        found = between_events(name, method, given)
        assert {finding.status for finding in found.values()} == {"ok"}, found
        assert found["accelerometer"].value < found["accelerometer"].bound < 1e-6


WITHOUT = {"friction": {"dry_friction": ()}, "lifted": {"dry_friction": ()}, "soft": {"limits": ()}}


@pytest.mark.parametrize(("name", "kind", "wrong"), [
    *((name, kind, "the law is left out") for name in WITHOUT for kind in ("accelerometer", "torque")),
    ("bounce", "accelerometer", "gravity is left out"), ("two", "force", "one step late"),
    ("saturated", "joint_effort", "not cut"), ("saturated", "torque", "the sign")])
def test_wrong_readings_between_events(name, kind, wrong):
    scene, traj, *_ = lawful(name, "rkmk4")
    right = traj.sensors[kind]
    if wrong == "the law is left out":
        bare = scene.replace(joints=tuple(dataclasses.replace(joint, **WITHOUT[name]) for joint in scene.joints))
        values = readings(bare, States(traj.t, traj.x, traj.R, traj.v, traj.w))[kind]
    elif wrong == "not cut":
        bare = scene.replace(forces=tuple(dataclasses.replace(force, parameters={
            **force.parameters, "effort_limit": None}) for force in scene.forces))
        values = readings(bare, States(traj.t, traj.x, traj.R, traj.v, traj.w))[kind]
    else:
        values = {"gravity is left out": traj.sensors["acceleration"], "one step late": np.roll(right, 1, axis=0),
                  "the sign": -right}[wrong]
    found = between_events(name, "rkmk4", {kind: values})
    assert {each for each, finding in found.items() if finding.status == "fail"} == {kind}


def test_no_accelerations_and_no_calm_output_time():
    scene, traj, truth, claim, run = lawful("friction", "rkmk4")
    silent = dataclasses.replace(traj, a=None, alpha=None)
    findings, _ = judge_sensors(scene, silent, truth, scene.duration, fixed_step(scene, truth, *claim.fixed), claim,
                                   run=run)
    said = {finding.kind: finding for finding in findings if "gives no accelerations" in finding.why}
    assert {finding.status for finding in said.values()} == {"unresolved"}
    assert "sensor torque" in said
    assert all("forces jump next to every output time" in finding.why
               for finding in between_events("sampled", "rkmk4").values())


@pytest.mark.parametrize(("name", "shown"), [("double_pendulum", {"acceleration world"}),
                                             ("driven_double_pendulum", {"acceleration world", "force site elbow",
                                                                         "torque site elbow"})])
def test_what_mujoco_reads_instead(name, shown):
    """Its a - g, and its wrenches without loads at sites, are known while they show; any other reading fails."""
    scene = watched(name)
    traj, truth = crosscheck.run(scene, "mujoco", "RK4", step=1e-3), crosscheck.truth(scene)

    def statuses(traj):
        findings, _ = judge_sensors(scene, traj, truth, scene.duration, fixed_step(scene, truth, 4, 1e-3),
                                       Claim(4, 1e-3, None), misreads=adapters.get("mujoco").misreads)
        return {(finding.kind, finding.status): finding for finding in findings}

    found = statuses(traj)
    assert {kind.removeprefix("sensor ") for kind, status in found if status == "known"} == shown
    assert {status for _, status in found} <= {"ok", "known"}
    known = found["sensor acceleration world", "known"]
    assert known.value == pytest.approx(9.81, rel=1e-8)
    assert "1216" in known.detail
    for values, fails in ((truth.sensors["acceleration world"], {"vanished"}),
                          (traj.sensors["acceleration world"] * 1.001, {
                              "sensor acceleration world", "sensor acceleration world of its state"})):
        mended = dataclasses.replace(traj, own_sensors={**traj.own_sensors, "acceleration world": values})
        assert {kind for kind, status in statuses(mended) if status == "fail"} == fails
