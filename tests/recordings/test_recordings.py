"""Recordings of right and wrong motions, made by other code; bad files; orders and limits; printed digits."""

from __future__ import annotations

import json
import re

import numpy as np
import pytest
from typer.testing import CliRunner

import crosscheck
from crosscheck.cli.app import app
from crosscheck.recordings import _tends, suggest
from crosscheck.recordings import causes as find_causes
from crosscheck.scene.alterations import alterations
from crosscheck.scene.altered import of_scene
from crosscheck.scene.coordinates import histories
from tests.recordings.corpus import LAWS, RIGHT, WRONG, only, written
from tests.recordings.motions import SCENES, TIMES, arm, hinged, lawful, solved, toml, tumbler, two

pd = pytest.importorskip("pandas")

KEYS = ("position", "attitude", "velocity", "angular_velocity", "joint_position", "joint_velocity")
NAMED = ("tumbler: gravity sign", "slider: mass", "arm: parent anchor", "slider: free length",
         "tumbler: start velocity", "top: conjugate", "tumbler: spin in world axes", "slider: millimetres",
         "arm: offset", "top: another point", "top: axes", "top: early sample", "top: held sample", "tumbler: clamp",
         "imu: acceleration without gravity", "imu: lever of an accelerometer", "imu: accelerometer in g",
         "imu: gyroscope late", "imu: sign of a gyroscope", "imu: gravity", "sled: dry friction")
"""Wrong recordings whose cause has to be found."""


@pytest.fixture(scope="module")
def scenes(tmp_path_factory):
    """Paths of the scenes by name."""
    folder = tmp_path_factory.mktemp("scenes")
    for name, text in SCENES.items():
        (folder / f"{name}.toml").write_text(text)
    return {name: folder / f"{name}.toml" for name in SCENES}


def judged(scenes, case, tmp_path):
    columns = {name: values for name, values in case.make().items() if name == "t" or case.keep in name}
    data, mapping = written(columns, case.style, tmp_path)
    digits = int(case.style[6:]) if case.style.startswith("digits") else 15  # pass nothing that they do not hold
    allowed = max(case.tolerance, 4 * 10.0**-digits)  # and bounces pile up after .75 of 2 s
    return crosscheck.judge_recording(scenes[case.scene], data, columns=mapping, start=case.start, need=0.37,
                                      tolerance=dict.fromkeys(keys(columns), allowed))


PARTS = {"x": "position", "y": "position", "z": "position", "q": "attitude", "v": "velocity", "w": "angular_velocity",
         "position": "joint_position", "velocity": "joint_velocity"}


def keys(columns):
    """The quantities of columns: a tolerance on another one would leave a recording unresolved."""
    owners = [name.rpartition(".")[::2] for name in columns if "." in name]
    return {owner if owner in ("acceleration", "rate") else PARTS.get(part) or PARTS[part[0]] for owner, part in owners}


@pytest.mark.parametrize("case", RIGHT, ids=lambda case: f"{case.scene}: {case.style}")
def test_right_recordings_pass(scenes, case, tmp_path):
    verdict = judged(scenes, case, tmp_path)
    assert verdict.outcome == "pass", str(verdict)
    assert verdict.cause is None


@pytest.mark.parametrize("case", WRONG, ids=lambda case: f"{case.scene}: {case.kind}")
def test_wrong_recordings_fail_and_no_cause_is_false(scenes, case):
    columns = case.make()
    verdict = crosscheck.judge_recording(scenes[case.scene], columns, tolerance=dict.fromkeys(keys(columns), 1e-5))
    assert verdict.outcome == "fail", str(verdict)
    if f"{case.scene}: {case.kind}" in NAMED:
        assert verdict.cause is not None, str(verdict)
    if verdict.cause is not None:
        assert any(name.startswith(case.names) for name in verdict.cause.split(" or ")), str(verdict)


@pytest.mark.parametrize(("scene", "since", "changes"), [
    ("bounce", 0.16, {"bounce": 0.51}), ("bounce", 0.0, {"late": lambda t: 0.02 * (t < 0.1)}),
    ("bounce", 0.25, {"late": lambda t: 0.02 * (t > 0.25)}), ("rough", 0.63, {"friction": (1.5, 1.515)}),
    ("sampled", 1.0, {"late": lambda t: 0.01 * (t > 1)}), ("soft", 0.16, {"soft": (0.9, 61.0, 0.4)}),
])
def test_intervals_show_mistakes_on_either_side_of_an_event(scenes, scene, since, changes):
    """Stops, friction, a sampled servo with a delay: intervals before the mistake are right, that of its begin is not.
    """
    columns = only(lawful(**(LAWS[scene] | changes)), "pivot")
    defects = crosscheck.judge_recording(scenes[scene], columns, tolerance={"joint_position": 1e3}).defects
    wrong = defects["t"][np.maximum(defects["joint_position"], defects["joint_velocity"]) > 1e-6].to_numpy()
    assert wrong[0] == pytest.approx(since, abs=0.0101)


@pytest.mark.parametrize(("text", "said"), [
    ("", "is empty"), ("# nothing\n", "no rows"), ("t,pivot.position\n", "no rows"),
    ("t,pivot.position\n0,1\n0.1,abc\n", "row 2 (line 3), column 'pivot.position': 'abc'"),
    ("# x\nt;pivot.position\n0;\n# y\n0,1;\n", "columns pivot.position have no row of numbers"),
    ("t,q1,q2\n0,1\n0.1,1\n", "the header has 3 names and its rows have 2 numbers"),
    ("t,pivot.position\n0,1,2,\n0.1,1,2,\n", "the header has 2 names and its rows have 3 numbers"),
    ("t,pivot.position\n0,1\n0,2\n0.1,1\n", "row 2 (line 3)"),
    ("t,pivot.position\n0,1\n0.1,inf\n", "infinite"), ("t,pivot.position\n0,1\n0.2,1\n0.1,1\n", "row 3 (line 4)"),
    ("t,pivot.position\n-1,1\n0.2,1\n", "before the scene's start"), ("pivot.position\n1\n2\n", "no column t"),
    ("t,elbow.position\n0,1\n1,2\n", "no column is one of scene 'arm'"),
    ("t,pivot.position [furlong]\n0,1\n1,2\n", "'furlong' is not known"),
    ("t,pivot.position [mm]\n0,1\n1,2\n", "of another kind"), ("t,bar.x,bar.x\n0,1,1\n", "called 'bar.x'"),
    ("t,bar.qw,bar.qx\n0,1,0\n1,1,0\n", "2 of 4 columns"),
    ("t,bar.qw,bar.qx,bar.qy,bar.qz\n0,1,0,0,0\n1,1,1,0,0\n", "row 2 (line 3): the attitude of 'bar' is no unit"),
    ("t,pivot.position\n0,1\n1,2,3,4\n", "cannot be read as columns"),
])
def test_a_bad_file_is_one_error_with_row_and_column(scenes, text, said, tmp_path):
    (tmp_path / "bad.csv").write_text(text)
    with pytest.raises(crosscheck.ArgumentError) as error:
        crosscheck.judge_recording(scenes["arm"], tmp_path / "bad.csv")
    assert said in str(error.value)
    assert "bad.csv" in str(error.value)


@pytest.mark.parametrize(("rows", "said"), [
    ({"a": {"is": "pivot.speed"}}, "nothing of scene 'arm'"), ({"b": {"is": "pivot.position"}}, "column of the file"),
    ({"a": {"is": "bar.q"}}, "has 4 numbers, and 1 columns"),
    ({"a": {"is": "pivot.position", "units": "deg"}}, "`units`"),
    ({"a": {"is": "pivot.position", "order": "xyzw"}}, "order"), ({"a": {"is": "bar.vx", "frame": "moon"}}, "frame"),
    ({"a": {"is": "bar.x", "point": [1, 2]}}, "length 3"), ({"a": {"unit": "deg"}}, "`is`"),
    ({"b": {"ignore": True}}, "column of the file"), ({"a": {"is": "bar.x", "ignore": True}}, "`ignore = true`"),
])
def test_a_bad_mapping_is_one_error(scenes, rows, said):
    with pytest.raises(crosscheck.ArgumentError, match=said):
        crosscheck.judge_recording(scenes["arm"], {"t": TIMES, "a": TIMES}, columns=rows)


def test_arguments_are_checked(scenes):
    for options, said in (({"tolerance": {"positions": 1.0}}, "did you mean 'position'"), ({"start": "x"}, "start"),
                          ({"tolerance": {"position": -1.0}}, ">= 0")):
        with pytest.raises(crosscheck.ArgumentError, match=said):
            crosscheck.judge_recording(scenes["arm"], arm(), **options)
    with pytest.raises(crosscheck.ArgumentError, match="the step of each"):
        crosscheck.judge_recording(scenes["arm"], [arm(), arm()])
    with pytest.raises(AssertionError, match="is allowed"):
        crosscheck.assert_recording(scenes["arm"], arm(g=9.7), tolerance={"joint_position": 1e-3})


@pytest.mark.parametrize("digits", [5, 6, 9])
def test_a_small_error_of_an_inertia_is_measured_and_named(scenes, digits, tmp_path):
    """1e-4 of a moment: its effect on the motion within 2 % and its size, at three levels of printed digits."""
    wrong, right = tumbler(J=(0.03, 0.05 * (1 + 1e-4), 0.07)), tumbler()
    frame = pd.DataFrame(wrong)
    frame.to_csv(tmp_path / "run.csv", index=False, float_format=f"%.{digits}f")
    verdict = crosscheck.judge_recording(scenes["tumbler"], tmp_path / "run.csv",
                                         tolerance=dict.fromkeys(KEYS[:4], 1e-9))
    effect = np.linalg.norm([wrong[f"brick.w{axis}"] - right[f"brick.w{axis}"] for axis in "xyz"], axis=0).max()
    assert verdict.errors["angular_velocity"] == pytest.approx(effect, rel=0.02)
    assert verdict.outcome == "fail"
    assert "inertia" in verdict.cause
    size = re.search(r"Jyy off by \+(\S+) kg", str(verdict))
    assert float(size[1]) == pytest.approx(5e-6, rel=1e-2)


def euler(step, g=9.81, semi=True):
    """The arm by (semi-implicit) Euler at every 20 ms."""
    angle, rate, rows = 0.4, 1.5, []
    for k in range(round(2.0 / step) + 1):
        if k % round(0.02 / step) == 0:
            rows.append((k * step, angle, rate))
        a = (1.2 * g * 0.4 * np.cos(angle) - 0.02 * rate) / (0.03 + 1.2 * 0.16)
        angle, rate = (angle + step * (rate + step * a), rate + step * a) if semi else (angle + step * rate,
                                                                                        rate + step * a)
    t, angle, rate = np.array(rows).T
    return {"t": t, "pivot.position": angle, "pivot.velocity": rate}


@pytest.mark.parametrize(("changed", "cause"), [({"damping": 0.03}, "damping"), ({"g": 9.7}, "gravity")])
def test_positions_alone_of_another_model_are_no_steps_of_euler(scenes, changed, cause):
    """The second differences of any smooth motion are those of such a step, but for its truncation error."""
    log = {name: values for name, values in arm(**changed).items() if name in ("t", "pivot.position")}
    verdict = crosscheck.judge_recording(scenes["arm"], log, tolerance={"joint_position": 1e-4})
    assert "Euler" not in verdict.cause, str(verdict)
    assert cause in verdict.cause, str(verdict)


@pytest.mark.parametrize(("make", "steps", "order", "cause", "observed"), [
    (lambda h: euler(h), (2e-3, 1e-3), 1, None, 1.0), (lambda h: euler(h), (2e-3, 1e-3), 2, "order", 1.0),
    (lambda h: euler(h, semi=False), (1e-3, 2e-3, 4e-3), 1, None, 1.0),
    (lambda h: euler(h, g=9.7), (2e-3, 1e-3), 1, "gravity", None),
    (lambda h: euler(h, g=9.7), (4e-3, 2e-3, 1e-3), 1, "gravity", 1.0),
])
def test_order_and_limit_of_files_at_several_steps(scenes, make, steps, order, cause, observed):
    verdict = crosscheck.judge_recording(scenes["arm"], [make(h) for h in steps], steps=list(steps), order=order)
    if cause is None:
        assert verdict.outcome == "pass", str(verdict)
        assert verdict.limit_error["joint_position"] <= verdict.limit_unsure["joint_position"]
    else:
        assert verdict.outcome == "fail", str(verdict)
        assert cause in verdict.cause, str(verdict)
    if observed is not None:
        assert verdict.order["joint_position"] == pytest.approx(observed, abs=0.1)


@pytest.mark.parametrize(("powers", "steps", "seen", "resolved"), [
    ((2, 2), (1e-3, 2e-3), 2.0, True), ((2, 2), (1e-3, 2e-3, 4e-3), 2.0, True), ((2, 3), (1e-3, 2e-3), 2.03, True),
    ((1, 8), (1.0, 4.0), None, False)])  # the last ones are not parallel
def test_two_files_tell_an_order_where_their_errors_are_parallel(powers, steps, seen, resolved):
    def error(h):
        return np.array([[[h ** powers[0], 0.05 * h ** powers[1]]]])

    order, limit = _tends([error(h) for h in steps], steps, 1e-12, None)
    assert order == (None if seen is None else pytest.approx(seen, abs=0.03))
    assert limit.size <= limit.uncertainty
    _, off = _tends([error(h) + 1.0 for h in steps], steps, 1e-12, 2)
    assert (off.size > off.uncertainty) == resolved


def test_printed_digits_are_a_floor_which_passes_nothing(scenes, tmp_path):
    pd.DataFrame(two()).to_csv(tmp_path / "run.csv", index=False, float_format="%.3f")
    for allowed, outcome in ((1e-3, "pass"), (1e-9, "unresolved")):
        verdict = crosscheck.judge_recording(scenes["two"], tmp_path / "run.csv", tolerance={"joint_position": allowed})
        assert verdict.outcome == outcome, str(verdict)
        assert verdict.floors["joint_position"] == pytest.approx(5e-4, rel=0.01)


def test_a_missing_row_leaves_nothing_open(scenes, tmp_path):
    """Times of two decimals hold a grid of 10 ms exactly, whichever rows are there."""
    frame = pd.DataFrame({"t": [f"{t:.2f}" for t in TIMES]} | {k: v for k, v in arm().items() if k != "t"})
    frame["pivot.position"] += np.where(TIMES > 1.0, 0.025, 0.0)
    for rows, name in ((frame, "whole.csv"), (frame.drop(index=57), "gap.csv")):
        rows.to_csv(tmp_path / name, index=False)
        verdict = crosscheck.judge_recording(scenes["arm"], tmp_path / name, tolerance={"joint_position": 1e-3})
        assert verdict.outcome == "fail", str(verdict)
        assert verdict.floors["joint_position"] < 1e-6


def test_defects_are_one_row_an_interval_and_show_a_jump(scenes):
    columns = arm()
    columns["pivot.position"] = columns["pivot.position"] + np.where(TIMES > 1.0, 0.2, 0.0)
    verdict = crosscheck.judge_recording(scenes["arm"], columns, tolerance={"velocity": 1e-3})
    assert len(verdict.defects) == 200
    assert verdict.defects["t"][int(np.argmax(verdict.defects["joint_position"]))] == pytest.approx(1.0)
    assert verdict.outcome == "fail"
    assert verdict.cause == "jump"


def test_unresolved_without_a_tolerance_without_its_quantity_and_beyond_truth(scenes):
    assert "no tolerance" in crosscheck.judge_recording(scenes["arm"], arm()).reason
    only = {name: values for name, values in arm().items() if name in ("t", "pivot.position")}
    verdict = crosscheck.judge_recording(scenes["arm"], only, tolerance={"velocity": 1.0})
    assert verdict.outcome == "unresolved"
    assert "does not have velocity" in verdict.reason
    assert verdict.errors.keys() == {"joint_position"}


@pytest.mark.parametrize("wrong", [{"g": 10.6}, {"damping": 0.0}])
def test_causes_end_where_truth_ends(wrong, tmp_path):
    """Times of samples are sought on the true motion, which is nothing after its horizon."""
    text = toml("arm", *hinged(), ("monitors", {"type": "range", "joint": "pivot", "lower": -9.0, "upper": 1.2}),
                schema=3)
    (tmp_path / "arm.toml").write_text(text)
    verdict = crosscheck.judge_recording(tmp_path / "arm.toml", arm(**wrong), tolerance={"joint_position": 1e-5})
    assert verdict.outcome == "fail"
    assert ("gravity" if "g" in wrong else "damper") in verdict.cause, str(verdict)


def test_a_model_at_rest_has_no_time_at_which_it_is_where_the_recording_is(tmp_path):
    text = toml("arm", *hinged()).replace("-9.81", "0.0").replace("velocity = 1.5", "velocity = 0.0")
    (tmp_path / "arm.toml").write_text(text)
    verdict = crosscheck.judge_recording(tmp_path / "arm.toml", arm(), tolerance={"joint_position": 1e-5})
    assert verdict.outcome == "fail"


def test_causes_end_where_the_recording_itself_meets_its_stop(tmp_path):
    """Without its damper it is there sooner than truth, and rests against it in the last row that is judged."""
    text = toml("arm", *hinged(), ("monitors", {"type": "range", "joint": "pivot", "lower": -9.0, "upper": 1.2}),
                schema=3)
    (tmp_path / "arm.toml").write_text(text)
    free = arm(damping=0.0)
    stopped = np.maximum.accumulate(free["pivot.position"] > 1.2)
    first = int(np.argmax(stopped))
    log = {"t": free["t"], "pivot.position": np.where(stopped, free["pivot.position"][first], free["pivot.position"]),
           "pivot.velocity": np.where(stopped, 0.0, free["pivot.velocity"])}
    verdict = crosscheck.judge_recording(tmp_path / "arm.toml", log, tolerance={"joint_position": 1e-5})
    assert verdict.outcome == "fail"
    assert verdict.cause == "missing damper", str(verdict)


def test_command_line(scenes, tmp_path):
    run = CliRunner().invoke
    pd.DataFrame(arm()).to_csv(tmp_path / "run.csv", index=False)
    scene, file = str(scenes["arm"]), str(tmp_path / "run.csv")
    assert run(app, ["judge", scene, file, "--tol", "joint_position=1e-6"]).exit_code == 0
    assert run(app, ["judge", scene, file]).exit_code == 3
    page = run(app, ["judge", scene, file, "--json", "-o", str(tmp_path / "page")])
    assert json.loads(page.stdout)["outcome"] == "unresolved"
    text = (tmp_path / "page" / "index.html").read_text()
    assert f"<h1>Does the recording follow arm? Unresolved: {json.loads(page.stdout)['reason']}</h1>" in text
    assert "<th>joint position, rad</th>" in text
    pd.DataFrame(arm(g=9.0)).to_csv(tmp_path / "wrong.csv", index=False)
    assert run(app, ["judge", scene, str(tmp_path / "wrong.csv"), "--tol", "joint_position=1e-6"]).exit_code == 1
    assert run(app, ["judge", scene, file, "--suggest"]).stdout.startswith("[columns]\n")
    assert isinstance(run(app, ["judge", scene, "no.csv"]).exception, crosscheck.ArgumentError)


def test_suggest_recognises_names_and_units(scenes, tmp_path):
    columns = {"Time [ms]": 1e3 * TIMES, "Pivot Angle [deg]": TIMES, "pivotVel [deg/s]": TIMES, "foo": TIMES}
    pd.DataFrame(columns).to_csv(tmp_path / "run.csv", index=False)
    text = suggest(tmp_path / "run.csv", crosscheck.load_scene(scenes["arm"]))
    assert '"Time [ms]" = { is = "t", unit = "ms" }' in text
    assert '"Pivot Angle [deg]" = { is = "pivot.position", unit = "deg" }' in text
    assert '"pivotVel [deg/s]" = { is = "pivot.velocity", unit = "deg/s" }' in text
    assert '# "foo"' in text


def test_derivatives_yield_to_columns_of_their_own(scenes, tmp_path):
    """Modelica's names: s, v, a of slides, phi, w, a of hinges, and derivatives of states beside them."""
    names = ["time", "pivot.phi", "der(pivot.phi)", "pivot.w", "pivot.a", "der(pivot.w)"]
    for file, header in (("all.csv", names), ("states.csv", names[:3])):
        pd.DataFrame(dict.fromkeys(header, TIMES)).to_csv(tmp_path / file, index=False)
    text, of_states = (suggest(tmp_path / file, crosscheck.load_scene(scenes["arm"])) for file in (
        "all.csv", "states.csv"))
    assert '"pivot.phi" = { is = "pivot.position"' in text
    assert '"pivot.w" = { is = "pivot.velocity"' in text
    assert text.count(" is = ") == 3 + text.count('# "')
    assert '"der(pivot.phi)" = { is = "pivot.velocity"' in of_states


def test_suggestions_read_logs_as_others_write_them(scenes, tmp_path):
    """Degrees and milliseconds since 1970, comment headers of nanoseconds, numbered coordinates, qpos and qvel."""
    q, since = np.stack([two()[f"{joint}.{key}"] for key in ("position", "velocity") for joint in (
        "shoulder", "elbow")], axis=1), 1732547854123
    brick = tumbler()
    odometry = [f"pose.position.{axis}" for axis in "xyz"] + [f"pose.orientation.{axis}" for axis in "wxyz"] + [
        f"twist.{kind}.{axis}" for kind in ("linear", "angular") for axis in "xyz"]
    free = np.stack([brick[f"brick.{part}"] for part in (*"xyz", "qw", "qx", "qy", "qz", "vx", "vy", "vz", "wx", "wy",
                                                         "wz")], axis=1)
    ticks = since * 10**6 + np.round(1e9 * TIMES).astype(np.int64)
    logs = {"ros": ("two", "stamp_ms,shoulder_pos_deg,elbow_pos_deg,shoulder_vel_deg_s,elbow_vel_deg_s,battery_v", [
                (since + 1e3 * t, *np.degrees(row), 24.1) for t, row in zip(TIMES, q, strict=True)]),
            "topic": ("two", "%time,name0,name1,position0,position1,velocity0,velocity1", [
                (int(t), "shoulder", "elbow", *row) for t, row in zip(ticks, q, strict=True)]),
            "simulink": ("two", "time,q(1),q(2),qd(1),qd(2)", np.column_stack([TIMES, q])),
            "matlab": ("two", "Time,theta1,theta2,theta1_dot,theta2_dot", np.column_stack([TIMES, q])),
            "odometry": ("tumbler", ",".join(["stamp", *odometry]), np.column_stack([TIMES, free]))}
    for name, (_, header, rows) in logs.items():
        (tmp_path / f"{name}.csv").write_text("\n".join([header, *(",".join(map(str, row)) for row in rows)]))
    np.savez(tmp_path / "mujoco.npz", time=TIMES, qpos=free[:, :7], qvel=free[:, 7:], ctrl=np.zeros((len(TIMES), 0)))
    for file, scene in [(f"{name}.csv", scene) for name, (scene, *_) in logs.items()] + [("mujoco.npz", "tumbler")]:
        (tmp_path / "map.toml").write_text(suggest(tmp_path / file, crosscheck.load_scene(scenes[scene])))
        verdict = crosscheck.judge_recording(scenes[scene], tmp_path / file, tmp_path / "map.toml",
                                             tolerance=dict.fromkeys(KEYS[4:] if scene == "two" else KEYS[:4], 1e-6))
        assert verdict.outcome == "pass", str(verdict)
        assert len(verdict.errors) == (2 if scene == "two" else 4), str(verdict)
    with pytest.raises(crosscheck.ArgumentError, match="subtract the first one"):
        crosscheck.judge_recording(scenes["arm"], {"t": TIMES + 1.7e9, "pivot.position": TIMES})


def test_a_made_motion_is_that_of_its_equation():
    """The corpus itself: energy of the tumbling body and of the arm."""
    w = np.stack([tumbler()[f"brick.w{axis}"] for axis in "xyz"])
    assert np.ptp(np.array([0.03, 0.05, 0.07]) @ w**2) < 1e-12
    assert solved(lambda _, y: [y[0]], [1.0], np.array([1.0]))[0, 0] == pytest.approx(np.e, rel=1e-11)


def test_damping_that_would_drive_a_motion_is_no_cause():
    """An explicit Euler method gains energy as negative damping would, which no body has."""
    scene = crosscheck.load_scene("single_pendulum")
    right = of_scene(scene)
    for kind in ("extra damping", "quadratic drag", "Coulomb friction"):
        slowed = [each for each in alterations(scene) if each.cause == kind]
        assert slowed
        for each in slowed:
            assert find_causes._altered(right, each, np.array([0.1])) is not None
            assert find_causes._altered(right, each, np.array([-0.1])) is None


def test_a_late_drive_is_named():
    """All functions of time of the scene come two rows late."""
    scene = crosscheck.load_scene("driven_cart").replace(duration=0.5, samples=51)
    moved = crosscheck.run(scene.delayed(0.02), "lieeuler", "rkmk4", step=1e-3, monitor=False)
    log = {"t": scene.t} | {f"{name}.position": each.position for name, each in histories(scene, moved).items()}
    verdict = crosscheck.judge_recording("driven_cart", log, tolerance={"joint_position": 1e-5})
    assert verdict.cause == "delay of a drive", str(verdict)
    assert "0.02 s late" in str(verdict)
