"""Logs of driven machines, judged by predictions from their own states."""

from __future__ import annotations

import itertools
import json
import math
import re

import numpy as np
import pytest

import crosscheck
from crosscheck.errors import ArgumentError
from crosscheck.recordings import noise, write_page
from crosscheck.recordings.inputs import Signal, System
from crosscheck.recordings.reading import read
from crosscheck.recordings.validation import CRITICAL, MISSED, Fit, Log, Predicted, poses, priors, touches
from crosscheck.references import dense
from crosscheck.references.base import Series
from crosscheck.scene.model import Force
from crosscheck.scene.touching import Touching
from tests.recordings import machines
from tests.recordings.machines import RIGHT, WRONG, Spoiled

pytest.importorskip("mujoco")
pytest.importorskip("heyoka")


@pytest.fixture(scope="module")
def scenes(tmp_path_factory):
    """The scene of each plan."""
    folder, made = tmp_path_factory.mktemp("plans"), {}
    for plan in machines.PLANS:
        path = folder / f"{plan}.xml"
        path.write_text(machines.model(plan))
        made[plan] = crosscheck.import_model(path)
    return made


CLEAN = Spoiled()


def frame(plan="arm", seed=1, spoiled=CLEAN, duration=3.0, **changed):
    import pandas as pd

    return pd.DataFrame(machines.log(plan, seed, spoiled, duration, **changed))


@pytest.fixture(scope="module")
def right():
    """A log of two seconds and a half that is as its model says."""
    return frame(duration=2.5, spoiled=Spoiled(5e-4))


def test_right_passes_and_says_what_would_have_shown(scenes, right, monkeypatch):
    verdict = crosscheck.judge_recording(scenes["arm"], right)
    assert verdict.outcome == "pass", str(verdict)
    assert verdict.exit_code == 0
    assert 0.0 < verdict.detectable["mass lower"] < 0.05
    assert 0.0 < verdict.detectable["friction elbow"] < 0.05
    assert 0.0 < verdict.detectable["delay"] < 5e-3
    seen = verdict.predicted
    assert seen.horizons == (0.05, 0.1, 0.2, 0.5, 1.0)
    assert (seen.ratio < 2.5).all()
    assert np.allclose(seen.u**2, seen.u_D**2 + seen.u_input**2 + seen.u_num**2)
    assert verdict.plain()["predicted"]["elbow"]["horizon"] == list(seen.horizons)
    monkeypatch.setattr(Predicted, "allowed", 0.1)  # as if states were less certain than u_D says
    doubtful = crosscheck.judge_recording(scenes["arm"], right)
    assert doubtful.outcome == "unresolved"
    assert "less certain than u_D" in doubtful.reason
    tight = crosscheck.judge_recording(scenes["arm"], right, tolerance={"joint_position": 1e-5})
    assert tight.outcome == "fail"


@pytest.mark.parametrize(("cause", "spoiled", "changed", "size"), [
    ("mass of lower", Spoiled(), {"m2": 0.605}, 0.1), ("gravity", Spoiled(), {"gz": -3.71}, -0.6218),
    ("delay of the inputs", Spoiled(delay=6e-3), {}, 6e-3)])
def test_wrong_is_named_with_its_size(scenes, cause, spoiled, changed, size):
    verdict = crosscheck.judge_recording(scenes["arm"], frame(spoiled=spoiled, duration=2.5, **changed))
    assert verdict.outcome == "fail"
    assert verdict.cause == cause
    said = next(line for line in verdict.lines if line.startswith("cause"))
    value, unit, half = re.search(r"([-+][\d.e-]+) (\S+), 95 % within ([\d.e-]+)", said).groups()
    scale = 0.01 if unit == "%" else 1.0
    assert abs(float(value) * scale - size) < 2.5 * float(half) * scale
    assert float(half) * scale < 0.1 * abs(size)


@pytest.mark.parametrize(("noise", "resolution"), [(0.05, 0.05), (4e-3, None)])
def test_noise_passes_nothing(scenes, noise, resolution):
    verdict = crosscheck.judge_recording(scenes["arm"], frame(spoiled=Spoiled(noise=noise), duration=2.5),
                                         resolution=resolution)
    assert verdict.outcome == "unresolved"
    assert "u_val leaves open" in verdict.reason
    assert f"the resolution is {100 * (resolution or 0.01):g} %" in verdict.reason


@pytest.fixture(scope="module")
def touching():
    """A log of an arm whose lower half strikes a wall."""
    return frame("fenced", spoiled=Spoiled(2e-4))


def test_what_lies_in_contacts_is_not_judged(scenes, touching):
    import mujoco

    verdict = crosscheck.judge_recording(scenes["fenced"], touching)
    assert verdict.outcome == "unresolved", str(verdict)
    assert 0.7 < verdict.share < 0.95
    assert "touches of wall and rod" in verdict.reason
    assert crosscheck.judge_recording(scenes["fenced"], touching, need=0.7).outcome == "pass"
    model = mujoco.MjModel.from_xml_string(machines.model("fenced"))
    data, struck = mujoco.MjData(model), []
    for t, *q in touching[["time", "shoulder_pos", "elbow_pos"]].to_numpy():
        data.qpos[:] = q
        mujoco.mj_forward(model, data)
        struck += [t] * (data.ncon > 0)
    log = Log(scenes["fenced"], read(touching, scenes["fenced"]))
    assert len(struck) > 10
    assert not any(start <= t < start + log.span for start in log.starts for t in struck)
    assert max(log.starts) > max(struck) > min(log.starts)  # a segment begins after a touch


def test_a_mistake_between_contacts_is_found(scenes):
    verdict = crosscheck.judge_recording(scenes["fenced"], frame("fenced", spoiled=Spoiled(2e-4), m2=0.605))
    assert verdict.outcome == "fail"
    assert verdict.cause == "mass of lower"


def test_a_touch_between_two_rows_is_looked_for(scenes):
    """At every row the shapes are apart; from one to the next they come closer by more than that."""
    t = 5e-3 * np.arange(200)
    apart, near = [], []
    for by in (0.0, 0.05):
        q = np.stack([-0.376 + by + 3.3 * np.abs(t - 0.4975), 0.0 * t], axis=1)
        gaps = [Touching(scenes["fenced"]).gap(0, *pose) for pose in zip(*poses(scenes["fenced"], q), strict=True)]
        (_, found), = touches(scenes["fenced"], t, q)
        apart, near = [*apart, min(gaps)], [*near, found.any()]
    assert apart[0] > 1e-3
    assert near == [True, False]


def test_uncertain_inputs_are_no_mistakes(scenes):
    log = frame(duration=2.5, m2=0.575)
    assert crosscheck.judge_recording(scenes["arm"], log).cause == "mass of lower"
    verdict = crosscheck.judge_recording(scenes["arm"], log, uncertain={"mass": 0.1}, resolution=1.0)
    assert verdict.outcome == "pass", str(verdict)
    assert (verdict.predicted.u_input > 0).all()


def test_two_models(scenes, right, tmp_path):
    path = tmp_path / "heavy.xml"
    path.write_text(machines.model("arm", m2=0.8))
    verdict = crosscheck.judge_recording(scenes["arm"], right, model=crosscheck.import_model(path))
    lines = [line for line in verdict.lines if line.startswith("elbow after")]
    assert len(lines) == 5
    assert "arm predicts better" in lines[-2] or f"{scenes['arm'].name} predicts better" in lines[-2]


def test_flow_meets_truth_across_breaks(scenes, right):
    """Held inputs jump at every row; friction and a servo are laws of the scene."""
    scene = scenes["arm"]
    recording = read(right, scene)
    log, system = Log(scene, recording), System(scene, recording.inputs, recording.t)
    fit = Fit(log, system)
    assert fit.numerical((0.1, 0.5), 1).max() < 1e-7
    start = system.at_start(log.state[0, :, 0], log.state[0, :, 1], float(log.starts[0]), 0.5)
    assert len(start.knots) > 90
    series = dense(start.replace(duration=0.02)).series
    compiled = series._integrator
    pieces, _ = series.advance(series.begin, 0.5)
    assert series._integrator is compiled
    assert len(pieces) > 90
    assert np.isfinite(Series(pieces)(np.array([0.5]))).all()


def test_alterations_are_those_of_other_models(scenes, tmp_path, right):
    recording = read(right, scenes["arm"])
    system = System(scenes["arm"], recording.inputs, recording.t)
    start = np.zeros(1), np.array([[0.3, 0.4, 0.5, -1.0]])
    lean = {"gx": 9.81 * math.sin(0.1), "gz": -9.81 * math.cos(0.1)}  # gravity in axes of a base that leans forward
    for name, changed, by in (
            (("mass", "lower"), {"m2": 0.605}, 0.1), (("armature", "elbow"), {"a2": 0.015}, 0.005),
            (("damping", "shoulder"), {"d1": 0.12}, 0.04), (("friction", "elbow"), {"f2": 0.03}, 0.03),
            (("tilt y", ""), lean, 0.1), (("gravity", ""), {"gz": -9.81 * 0.4}, -0.6)):
        path = tmp_path / f"{name[0]}.xml"
        path.write_text(machines.model("arm", **changed))
        other = System(crosscheck.import_model(path), recording.inputs, recording.t)
        altered = np.zeros((1, len(system.names)))
        altered[0, system.names.index(name)] = by
        one, two = system.flow(*start, 0.5, 5e-3, altered)[1], other.flow(*start, 0.5, 5e-3)[1]
        assert np.abs(one - two).max() < 1e-9, name
        assert np.abs(one - system.flow(*start, 0.5, 5e-3)[1]).max() > 1e-4, name
    given = dict(zip(system.names, priors(system, {"mass": 0.02}), strict=True))
    assert given["mass", "lower"] == given["mass and inertia", "lower"] == pytest.approx(0.02 * math.sqrt(0.5))
    assert given["inertia", "lower"] == 0.0


@pytest.fixture(scope="module")
def rubbing(tmp_path_factory):
    """(An arm whose joints have dry friction, one whose elbow has half of it, a log of the first)."""
    made = []
    for f2 in (0.1, 0.05):
        path = tmp_path_factory.mktemp("rubbing") / "arm.xml"
        path.write_text(machines.model("arm", f1=0.3, f2=f2))
        made.append(crosscheck.import_model(path))
    return *made, frame(spoiled=Spoiled(2e-4, rate=100.0, quantum=2 * math.pi / 2**14), f1=0.3, f2=0.1)


def test_dry_friction_in_model_and_machine(rubbing):
    right, wrong, log = rubbing
    assert crosscheck.judge_recording(right, log, resolution=0.05).outcome == "pass"
    verdict = crosscheck.judge_recording(wrong, log, resolution=0.05)
    assert verdict.cause == "dry friction of elbow"
    size, half = interval(verdict, "dry friction of elbow")
    assert abs(size - 0.05) < 1.5 * half < 0.01


def test_flow_and_its_slopes_across_stops(rubbing):
    """Joints stop, stay and turn around within steps: flow is that of truth, and slopes are those of the flow."""
    scene, _, recorded = rubbing
    recording = read(recorded, scene)
    log, system = Log(scene, recording), System(scene, recording.inputs, recording.t)
    fit = Fit(log, system)
    assert fit.step >= 1e-3
    assert fit.numerical((0.1, 0.5)).max() < 5e-6
    none = np.zeros(len(system.names))
    flow = fit.flow(fit.begun, none)
    assert (np.diff(np.sign(flow[2]), axis=0) != 0).sum() > 10
    which = [system.names.index(name) for name in (("mass", "lower"), ("friction", "elbow"), ("delay", ""))]
    slopes = fit.slopes(flow, which, none)[..., 2 * system.n:]
    for k, (each, size) in enumerate(zip(which, (1e-6, 1e-7, 1e-7), strict=True)):
        ahead = fit.flow(fit.begun, none + size * (np.arange(len(none)) == each))
        true = np.concatenate([(a - b) / size for a, b in zip(ahead[1:3], flow[1:3], strict=True)], axis=-1)
        off = np.abs(slopes[..., k] - true).max(axis=(0, 2)) / np.abs(true).max(axis=(0, 2))
        assert np.median(off) < 1e-3, system.names[each]


def test_more_rows_never_make_states_less_certain(scenes):
    log = frame(spoiled=Spoiled(5e-4, rate=1000.0, quantum=2e-4), duration=4.0)
    sizes = []
    for every in (10, 5, 2, 1):
        made = Log(scenes["arm"], read(log.iloc[::every].reset_index(drop=True), scenes["arm"]))
        sizes.append(np.sqrt(made.spread[..., 1, 1].mean(axis=0)))
    for fine, coarse in itertools.pairwise(reversed(sizes)):
        assert (fine < 1.3 * coarse).all()  # both are estimates
    assert (sizes[-1] < sizes[0]).all()


@pytest.mark.parametrize("between", ["hold", "linear", "spline"])
def test_signals(between):
    t = np.array([0.0, 0.1, 0.25, 0.3, 0.6, 0.7])
    signal = Signal(t, np.array([1.0, -2.0, 0.5, 3.0, 1.0, 2.0]), between)
    edges = np.array([0.02, 0.13, 0.29, 0.55])
    fine = [np.mean(signal.within(0.0, 0.7)(np.linspace(a, b, 20001)[:-1])) for a, b in itertools.pairwise(edges)]
    assert np.allclose(signal.means(edges), fine, atol=2e-3)


def test_noise_is_that_of_the_recording():
    rng, t = np.random.default_rng(0), np.arange(2000) * 5e-3
    y = np.sin(3 * t) + 0.3 * np.sin(7 * t)
    assert noise.measured(t, y + 1e-3 * rng.standard_normal(2000)).sigma == pytest.approx(1e-3, rel=0.05)
    stepped = noise.measured(t, np.round(y / 2e-3) * 2e-3)
    assert stepped.quantum == pytest.approx(2e-3)
    assert stepped.sigma == pytest.approx(2e-3 / math.sqrt(12), rel=0.1)
    white = noise.measured(t, y + 1e-3 * rng.standard_normal(2000))
    within = np.tile([0.0, 10.0], (36, 1))
    state, spread, _ = noise.states(t, y + 1e-3 * rng.standard_normal(2000), t[100:1900:50], white, within)
    true = np.stack([y[100:1900:50], (3 * np.cos(3 * t) + 2.1 * np.cos(7 * t))[100:1900:50]], axis=1)
    z = (state - true) / np.sqrt(np.einsum("sii->si", spread))
    assert (np.sqrt(np.mean(z**2, axis=0)) > 0.6).all()
    assert (np.sqrt(np.mean(z**2, axis=0)) < 1.5).all()


def test_names_of_inputs(scenes, right):
    given = read(right, scenes["arm"])
    assert [(g.key, g.owner) for g in given.inputs] == [("effort", "shoulder"), ("effort", "elbow")]
    names = {"shoulder_torque": "tau1", "elbow_torque": "tau2", "shoulder_pos": "q1", "elbow_pos": "q2"}
    other = right.rename(columns=names)
    assert [g.owner for g in read(other, scenes["arm"]).inputs] == ["shoulder", "elbow"]
    both = right.assign(elbow_torque_cmd=right.elbow_torque)
    assert "effort_commanded" in [g.key for g in read(both, scenes["arm"]).inputs]
    mapping = {"shoulder_torque": {"is": "shoulder.torque", "unit": "mN m", "gear": 50.0, "side": "motor"}}
    one = next(g for g in read(right, scenes["arm"], mapping).inputs if g.owner == "shoulder")
    assert one.row.gear == 50.0
    assert one.values[0, 0] == pytest.approx(1e-3 * right.shoulder_torque[0])


@pytest.mark.parametrize(("options", "says"), [
    ({"uncertain": {"weight": 0.1}}, "weight"), ({"uncertain": {"mass": -1.0}}, "a number > 0"),
    ({"uncertain": {"between": 0.1}}, "between"),
    ({"order": 2}, "leave steps and order out"),
    ({"columns": {"shoulder_torque": {"is": "shoulder.torque", "unit": "kg"}}}, "unit"),
    ({"columns": {"shoulder_torque": {"is": "shoulder.torque", "clock": "t2"}}}, "t2")])
def test_bad_input(scenes, right, options, says):
    with pytest.raises(ArgumentError, match=says) as caught:
        crosscheck.judge_recording(scenes["arm"], right, **options)
    assert "\n" not in str(caught.value)


def test_what_a_log_with_inputs_is_not_judged_by_is_said_and_passes_nothing(scenes, right):
    scene = scenes["arm"]
    beside = right.assign(**{f"{scene.bodies[1].name}.x": 7.0})  # wrong at every time
    found = crosscheck.judge_recording(scene, beside, start="recorded")
    assert found.outcome == "pass"
    assert f"not judged: position of {scene.bodies[1].name}; a log with inputs is judged by its joints" in found.lines
    for key in ("position", "joint_velocity"):
        asked = crosscheck.judge_recording(scene, beside, tolerance={key: 1e-3})
        assert asked.outcome == "unresolved"
        assert f"not of {key.replace('_', ' ')}; leave that tolerance out" in asked.reason


def test_one_joint_without_positions_is_unresolved(scenes, right):
    verdict = crosscheck.judge_recording(scenes["arm"], right.drop(columns="elbow_pos"))
    assert verdict.outcome == "unresolved"
    assert "'elbow'" in verdict.reason


@pytest.mark.parametrize("k", range(len(RIGHT)))
def test_right_machines(scenes, k):
    plan, spoiled = RIGHT[k]
    log = frame(plan, k, spoiled, 4.0)
    verdict = crosscheck.judge_recording(scenes[plan], log)
    if verdict.outcome == "unresolved":
        assert spoiled.noise > machines.LOW
        assert "u_val leaves open" in verdict.reason
        verdict = crosscheck.judge_recording(scenes[plan], log, resolution=0.05)
    assert verdict.outcome == "pass", str(verdict)


@pytest.mark.parametrize("k", range(len(WRONG)))
def test_wrong_machines(scenes, k):
    _, changed, plan, spoiled = WRONG[k]
    verdict = crosscheck.judge_recording(scenes[plan], frame(plan, 100 + k, spoiled, 4.0, **changed))
    assert verdict.outcome == "fail", str(verdict)


def test_coverage(scenes):
    """95 of 100 intervals hold the size of the mistake: between 90 and 99."""
    held = 0
    for seed in range(100):
        verdict = crosscheck.judge_recording(scenes["arm"], frame(seed=seed, duration=2.0, m2=0.605))
        said = next(line for line in verdict.lines if line.startswith("cause"))
        value, half = map(float, re.search(r"mass of lower ([-+][\d.e-]+) %, 95 % within ([\d.e-]+)", said).groups())
        held += abs(value - 10.0) < half
    assert 90 <= held <= 99


def interval(verdict, name):
    """(size, half of the 95 % interval) of the cause in its own unit."""
    said = next(line for line in verdict.lines if line.startswith("cause"))
    value, half = re.search(rf"{name} ([-+][\d.e-]+) .*?, 95 % within ([\d.e-]+)", said).groups()
    return float(value), float(half)


@pytest.mark.parametrize("held", [1, 2])
def test_half_the_rate_gives_the_same(scenes, held):
    """Whether a command is held for two rows, or another one comes at each, which half of the rows do not have."""
    log = frame(spoiled=Spoiled(5e-4, rate=400.0, held=held), duration=2.5, m2=0.605)
    sizes = [interval(crosscheck.judge_recording(scenes["arm"], each), "mass of lower")
             for each in (log, log.iloc[::2].reset_index(drop=True))]
    for size, half in sizes:
        assert abs(size - 10.0) < 1.5 * half
    assert abs(sizes[0][0] - sizes[1][0]) < sizes[0][1] + sizes[1][1]


@pytest.mark.parametrize("seed", [1, 4])
def test_commands_that_are_not_in_the_log_are_no_mistake_of_the_model(scenes, seed):
    log = frame(seed=seed, spoiled=Spoiled(5e-4, rate=400.0), duration=2.5).iloc[::2].reset_index(drop=True)
    assert crosscheck.judge_recording(scenes["arm"], log, resolution=0.05).outcome == "pass"
    held = {name: {"is": name.replace("_", "."), "between": "hold"} for name in ("shoulder_torque", "elbow_torque")}
    assert crosscheck.judge_recording(scenes["arm"], log, held).outcome == "fail"  # the mapping says they were held


def test_the_interval_of_friction_has_what_its_law_misses(scenes):
    """Dry friction of MuJoCo is soft, so that Coulomb's law does not leave noise alone."""
    verdict = crosscheck.judge_recording(scenes["arm"], frame(spoiled=Spoiled(2e-4), f2=0.1))
    size, half = interval(verdict, "dry friction of elbow")
    assert abs(size - 0.1) < half < 0.005


@pytest.mark.parametrize("mass", [0.55, 0.605])
def test_noise_of_measured_torques_is_none_of_the_motion(scenes, mass):
    log, rng = frame(spoiled=Spoiled(2e-4), m2=mass), np.random.default_rng(0)
    names = {name: f"{name}_measured" for name in ("shoulder_torque", "elbow_torque")}
    noisy = log.assign(**{name: log[name] + 0.01 * rng.standard_normal(len(log)) for name in names})
    verdict = crosscheck.judge_recording(scenes["arm"], noisy.rename(columns=names), resolution=0.1)
    assert (verdict.predicted.u_input > 0).all()
    if mass == 0.55:
        assert verdict.outcome == "pass", str(verdict)
        told = {name: {"is": name.replace("_", ".") + "_commanded", "between": "hold"} for name in names}
        assert crosscheck.judge_recording(scenes["arm"], noisy, told, resolution=0.1).outcome == "fail"
    else:
        size, half = interval(verdict, "mass of lower")
        assert abs(size - 10.0) < 1.5 * half < 10.0


def test_rates_that_are_measured_narrow_what_may_be_wrong(scenes):
    """The wrong mass is within a narrower interval than without them; differences of positions are not used."""
    log = frame(spoiled=Spoiled(2e-3, rates=0.02), duration=2.5, m2=0.605)
    without = log.drop(columns=["shoulder_vel", "elbow_vel"])
    differences = without.assign(**{f"{name}_vel": np.gradient(log[f"{name}_pos"], log.time) for name in (
        "shoulder", "elbow")})
    own, plain, derived = (crosscheck.judge_recording(scenes["arm"], each, resolution=0.1) for each in (
        log, without, differences))
    assert "recorded rates: shoulder measured on their own; elbow measured on their own" in own.lines
    assert "elbow differences of positions, whose noise they share, not used" in str(derived)
    assert interval(derived, "mass of lower") == interval(plain, "mass of lower")
    (size, half), (_, wide) = (interval(each, "mass of lower") for each in (own, plain))
    assert abs(size - 10.0) < 1.5 * half
    assert half < 0.8 * wide


@pytest.mark.parametrize(("spoil", "says"), [
    (lambda v, d: v + d, "measured on their own"), (lambda v, d: np.roll(v, 2) + d, "late by 0.0098 s"),
    (lambda v, d: 1.02 * v + d, "scaled by 1.02"), (lambda v, d: v + 0.01 + d, "off by 0.01"),
    (lambda v, d: v + np.convolve(d, np.ones(5) / 5, "same"), "filtered, or without noise")])
def test_what_recorded_rates_are(spoil, says):
    rng, t = np.random.default_rng(0), np.arange(1000) * 5e-3
    q, v = np.sin(3 * t) + 0.3 * np.sin(7 * t), 3 * np.cos(3 * t) + 2.1 * np.cos(7 * t)
    own, what = noise.of_rates(t, q + 1e-3 * rng.standard_normal(1000), 1e-3, spoil(
        v, 1e-2 * rng.standard_normal(1000)), CRITICAL)
    assert what.startswith(says)
    assert (own is not None) is (says == "measured on their own")


@pytest.mark.parametrize(("rate", "fast"), [(50.0, 10.0), (100.0, 20.0), (200.0, 20.0)])
def test_true_rates_of_a_fast_motion_are_no_differences(rate, fast):
    """Polynomials do not follow it over many rows: what they leave of rates is that of positions, and no noise."""
    rng, t = np.random.default_rng(0), np.arange(int(4 * rate)) / rate
    q, v = np.sin(fast * t) + 0.3 * np.sin(1.7 * fast * t), fast * (np.cos(fast * t) + 0.51 * np.cos(1.7 * fast * t))
    given = q + 1e-4 * rng.standard_normal(len(t))
    for rates, own in ((v + 1e-2 * rng.standard_normal(len(t)), True), (np.gradient(given, t), False), (
            np.diff(given, prepend=given[0]) * rate, False)):
        assert (noise.of_rates(t, given, 1e-4, rates, CRITICAL)[1] == "measured on their own") is own


def with_servo(scene, **parameters):
    joint = scene.joints[1]
    return scene.replace(forces=(*scene.forces, Force("servo", joint.parent, joint.child, joint.name, {
        "target": 0.3, "proportional": 20.0, "derivative": 0.5, **parameters})))


def test_a_recorded_effort_is_all_that_its_servo_gives(scenes, right):
    assert crosscheck.judge_recording(with_servo(scenes["arm"], period=2e-3), right).outcome == "pass"


@pytest.mark.parametrize(("cause", "gains"), [
    ("stiffness of elbow's servo", {"proportional": 22.0}), (
        "derivative gain of elbow's servo or damping of elbow", {"derivative": 0.6})])
def test_wrong_gains_of_a_servo_are_named(tmp_path, cause, gains):
    """The log has its set points. Without their rates a damper does what a derivative gain does, and both are named."""
    import pandas as pd
    from scipy.integrate import solve_ivp

    path, rng, t = tmp_path / "wheel.xml", np.random.default_rng(2), 1e-2 * np.arange(400)
    path.write_text('<mujoco><worldbody><body><inertial pos="0 0 0" mass="1.8" diaginertia=".1 .1 .1"/>'
                    '<joint name="elbow" axis="0 0 1"/></body></worldbody></mujoco>')
    scene = crosscheck.import_model(path)
    target = 0.5 * np.sin(3.0 * t) + 0.3 * np.sin(8.0 * t)
    kp, kd = ({"proportional": 20.0, "derivative": 0.5} | gains).values()
    y, rows = np.array([0.0, 0.0]), []
    for wanted in target:
        rows.append(y[0])
        y = solve_ivp(lambda _, y, wanted=wanted: [y[1], (kp * (wanted - y[0]) - kd * y[1]) / 0.1], (0.0, 1e-2), y,
                      rtol=1e-9, atol=1e-12).y[:, -1]
    joint = scene.joints[0]
    model = scene.replace(forces=(Force("servo", joint.parent, joint.child, joint.name, {
        "target": 0.0, "proportional": 20.0, "derivative": 0.5}),))
    log = pd.DataFrame({"t": t, "elbow.position": np.array(rows) + 2e-4 * rng.standard_normal(len(t)),
                        "elbow.target": target})
    assert set(crosscheck.judge_recording(model, log).cause.split(" or ")) == set(cause.split(" or "))


@pytest.mark.parametrize(("cause", "changed"), [
    ("damping of shoulder with damping of elbow", {"d1": 0.2, "d2": 0.1})])
def test_two_mistakes_are_named_together(scenes, cause, changed):
    verdict = crosscheck.judge_recording(scenes["arm"], frame(spoiled=Spoiled(2e-4), duration=2.5, **changed))
    assert sorted(verdict.cause.split(" with ")) == sorted(cause.split(" with "))


@pytest.mark.parametrize(("spoiled", "cause"), [
    ({"most": 0.4}, "the largest torque of elbow"), ({"gains": (1.0, 0.8)}, "torque gain of elbow"),
    ({"signs": (1.0, -1.0)}, "sign of elbow's positions")])
def test_a_torque_that_saturates_and_a_sign_are_no_gains(scenes, spoiled, cause):
    verdict = crosscheck.judge_recording(scenes["arm"], frame(seed=3, spoiled=Spoiled(5e-4, **spoiled)), resolution=0.1)
    assert verdict.cause == cause, str(verdict)


def test_a_command_with_the_other_sign_is_no_gain_beyond_nothing(scenes):
    log = frame(seed=3, spoiled=Spoiled(5e-4))
    verdict = crosscheck.judge_recording(scenes["arm"], log.assign(elbow_torque=-log.elbow_torque), resolution=0.1)
    assert verdict.cause == "sign of elbow's inputs", str(verdict)


@pytest.mark.parametrize("begin", [None, 1.3])
def test_a_load_is_dated_where_it_was_not_there_from_the_start(scenes, begin):
    """What its prediction misses is dated as well, not by the start of a segment that meets it later."""
    if begin is None:
        log = frame(seed=4, spoiled=Spoiled(5e-4), m2=0.65)
    else:
        log = frame(seed=4, spoiled=Spoiled(5e-4, load=(0.1, begin)), duration=4.0)
    verdict = crosscheck.judge_recording(scenes["arm"], log, resolution=0.1)
    said = next(line for line in verdict.lines if line.startswith("cause"))
    assert verdict.cause == "mass of lower", str(verdict)
    size, half = interval(verdict, "mass of lower")
    assert abs(size - 100 * 0.1 / 0.55) < 1.5 * half
    dates = re.findall(r"from ([\d.]+) s", str(verdict))
    assert ("s on" in said) is (begin is not None)
    assert all(abs(float(date) - begin) < 0.2 for date in dates) if begin else float(dates[0]) < 0.2


def test_when_a_servo_samples_is_in_no_log(scenes, right):
    log = right.drop(columns="elbow_torque").assign(**{"elbow.target": 0.3 + 0.0 * right.time})
    verdict = crosscheck.judge_recording(with_servo(scenes["arm"], period=2e-3), log)
    assert verdict.outcome == "unresolved"
    assert "'elbow' samples every 0.002 s" in verdict.reason


def test_inputs_may_have_a_clock_of_their_own(scenes):
    """Each row has the torques of three rows before, and when they were given."""
    log = frame(spoiled=Spoiled(2e-4), duration=2.5)
    names = ["shoulder_torque", "elbow_torque"]
    late = log.assign(given=log.time.shift(3), **{name: log[name].shift(3) for name in names})
    mapping = {name: {"is": name.replace("_", "."), "clock": "given"} for name in names}
    assert crosscheck.judge_recording(scenes["arm"], late, mapping, resolution=0.05).outcome == "pass"
    assert crosscheck.judge_recording(scenes["arm"], late).outcome == "fail"


def test_page_of_a_driven_log(scenes, right, tmp_path):
    verdict = crosscheck.judge_recording(scenes["arm"], right)
    page = write_page(verdict, tmp_path / "page").read_text("utf-8")
    assert all(name in page for name in ("shoulder", "elbow", "u_val of elbow", "the smallest that would have shown"))
    kept = json.loads((tmp_path / "page" / "verdict.json").read_text("utf-8"))
    assert kept["predicted"]["elbow"]["error"] == pytest.approx(verdict.predicted.error[1].tolist())
    assert kept["detectable"]["delay"] == verdict.detectable["delay"]


SMALL = [(key, what, round(0.3 + 0.6 * k / 19, 3)) for k in range(20)
         for key, what in [(("m2", "mass lower"), ("f2", "friction elbow"), ("delay", "delay"))[k % 3]]]
"""Mistakes, and their sizes over the uncertainty that a noisy log leaves of them."""


@pytest.fixture(scope="module")
def noisy(scenes):
    """Standard deviations of alterations in a noisy log; a delay is also told from straight lines, by half a row."""
    shown = crosscheck.judge_recording(scenes["arm"], frame(spoiled=Spoiled(machines.HIGH))).detectable
    return {what: (size - 2.5e-3 * (what == "delay")) / (CRITICAL + MISSED) for what, size in shown.items()}


@pytest.mark.parametrize("k", range(len(SMALL)))
def test_a_mistake_below_the_uncertainty_is_unresolved(scenes, noisy, k):
    key, what, part = SMALL[k]
    size = part * noisy[what]
    changed = {"m2": {"m2": 0.55 * (1 + size)}, "f2": {"f2": size}, "delay": {}}[key]
    spoiled = Spoiled(machines.HIGH, delay=size if key == "delay" else 0.0)
    verdict = crosscheck.judge_recording(scenes["arm"], frame(seed=200 + k, spoiled=spoiled, **changed),
                                         resolution=5e-3)  # 2 u_val is above that in each log, above 1 % in most
    assert verdict.outcome == "unresolved", str(verdict)
    assert "u_val leaves open" in verdict.reason
    assert size < verdict.detectable[what]  # nor does what it says exclude the mistake


def test_a_wheel_that_gravity_does_not_move(tmp_path):
    """Gravity is in no equation of a balanced wheel on an upright axis. Its motion under held torques is exact."""
    import pandas as pd

    path, rng, h = tmp_path / "wheel.xml", np.random.default_rng(3), 5e-3
    path.write_text('<mujoco><worldbody><body><inertial pos="0 0 0" mass="1.8" diaginertia=".01 .01 .011"/>'
                    '<joint name="wheel" axis="0 0 1"/></body></worldbody></mujoco>')
    torque = 0.05 * np.sin(3.0 * h * np.arange(600)) + 0.01 * rng.standard_normal(600)
    speed = np.concatenate([[0.0], np.cumsum(torque[:-1] * h / 0.011)])
    angle = np.concatenate([[0.0], np.cumsum(speed[:-1] * h + 0.5 * torque[:-1] * h**2 / 0.011)])
    log = pd.DataFrame({"t": h * np.arange(600), "wheel.position": angle + 1e-4 * rng.standard_normal(600),
                        "wheel.torque": torque})
    assert crosscheck.judge_recording(crosscheck.import_model(path), log).outcome == "pass"
    log["wheel.torque"] *= 1.1
    assert crosscheck.judge_recording(crosscheck.import_model(path), log).outcome == "fail"


QUILL = """<mujoco><worldbody><body name="quill" pos="0 0 1">
<joint name="lift" type="slide" axis="0 0 1" range="-.5 .5" limited="true" damping="3"/>
<joint name="spin" axis="0 0 1" damping=".01"/>
<inertial pos=".02 0 -.1" mass="{mass}" diaginertia=".003 .003 .001"/></body></worldbody>
<actuator><position name="up" joint="lift" kp="800" kv="40"/><motor name="turn" joint="spin"/></actuator></mujoco>"""


@pytest.mark.parametrize("mass", [0.7, 0.9])
def test_a_frame_between_joints_is_no_mistake_of_the_model_and_no_cause(mass, tmp_path):
    """A mass of 1e-7 of what it carries would show in a log without noise."""
    mujoco = pytest.importorskip("mujoco")
    (tmp_path / "quill.xml").write_text(QUILL.format(mass=0.7))
    m = mujoco.MjModel.from_xml_string(QUILL.format(mass=mass))
    m.opt.integrator, m.opt.timestep = mujoco.mjtIntegrator.mjINT_RK4, 2e-4
    d, rows = mujoco.MjData(m), []
    for k in range(5001):
        if k % 50 == 0:
            t = k * m.opt.timestep
            d.ctrl[:] = 0.05 * np.sin(2 * t), 0.01 * np.cos(3 * t)
            rows.append([t, *d.qpos, *d.ctrl])
        mujoco.mj_step(m, d)
    log = pytest.importorskip("pandas").DataFrame(np.round(rows, 10), columns=["t", "lift", "spin", "up", "turn"])
    verdict = crosscheck.judge_recording(tmp_path / "quill.xml", log)
    assert [body.name for body in verdict.scene.bodies if not body.mass] == ["quill after lift"]
    assert verdict.outcome == ("pass" if mass == 0.7 else "fail"), str(verdict)
    assert (verdict.cause or "") == ("" if mass == 0.7 else "mass of quill"), str(verdict)
