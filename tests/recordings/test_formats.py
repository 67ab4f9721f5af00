"""Recordings as other programs write them: what is read, what the data decide, and what is refused in words.

The motions are SciPy's, on equations written by hand (`tests.recordings.motions`).
"""

from __future__ import annotations

import numpy as np
import pytest
from typer.testing import CliRunner

import crosscheck
from crosscheck.cli.app import app
from crosscheck.recordings import suggest
from tests.recordings.motions import SCENES, TIMES, arm, tumbler, two

pd = pytest.importorskip("pandas")

JOINTS = ("shoulder", "elbow")
PASSES = {"joint_position": 1e-5}


@pytest.fixture(scope="module")
def scene(tmp_path_factory):
    path = tmp_path_factory.mktemp("scenes") / "two.toml"
    path.write_text(SCENES["two"])
    return crosscheck.load_scene(path)


@pytest.fixture(scope="module")
def q():
    """(T, 4) angles and rates of the two joints."""
    made = two()
    return np.stack([made[f"{joint}.{key}"] for key in ("position", "velocity") for joint in JOINTS], axis=1)


def judged(scene, text, tmp_path, name="run.csv", tolerance=PASSES, **options):
    (tmp_path / name).write_text(text)
    return crosscheck.judge_recording(scene, tmp_path / name, tolerance=tolerance, **options)


def table(header, rows, separator=","):
    return "\n".join([header, *(separator.join(map(repr, map(float, row))) for row in rows)]) + "\n"


def opensim(q, degrees, says=True, path="/jointset/{0}/{0}/{1}"):
    scale = 180 / np.pi if degrees else 1.0
    names = [path.format(joint, word) for joint in JOINTS for word in ("value", "speed")]
    head = ["states", "version=1", f"nRows={len(q)}", "nColumns=5",
            *([f"inDegrees={'yes' if degrees else 'no'}"] if says else []), "", "endheader"]
    return "\n".join(head) + "\n" + table("\t".join(["time", *names]),
                                          np.column_stack([TIMES, scale * q[:, [0, 2, 1, 3]]]), "\t")


@pytest.mark.parametrize(("path", "degrees", "says"), [
    *(("/jointset/{0}/{0}/{1}", degrees, says) for degrees in (False, True) for says in (True, False)),
    ("{0}/{0}_coord/{1}", True, True), ("model/{0}/{1}", False, True)])
def test_a_preamble_says_degrees_or_the_data_do(scene, q, degrees, says, path, tmp_path):
    verdict = judged(scene, opensim(q, degrees, says, path), tmp_path, "states.sto", start="recorded")
    assert verdict.outcome == "pass", str(verdict)
    assert verdict.suggested[path.format("elbow", "value")] == "elbow.position"
    assert says or f"in {'deg and deg/s' if degrees else 'rad and rad/s'} (the data decide)" in str(verdict)


def flattened(q, prefix="", order=(0, 1), bracket=False):
    one = "[{}]" if bracket else "{}"
    names = [f"{prefix}{word}{one.format(k)}" for word in ("name", "position", "velocity") for k in (0, 1)]
    rows = [",".join([repr(float(t)), *(JOINTS[k] for k in order), *(repr(float(row[k])) for k in order),
                      *(repr(float(row[2 + k])) for k in order)]) for t, row in zip(TIMES, q, strict=True)]
    return "\n".join([",".join(["time", *names]), *rows]) + "\n"


@pytest.mark.parametrize(("prefix", "order", "bracket"), [("", (0, 1), False), ("", (1, 0), False),
                                                          ("field.", (1, 0), False), ("/joint_states/", (1, 0), True)])
def test_a_joint_state_names_the_joint_of_each_number(scene, q, prefix, order, bracket, tmp_path):
    verdict = judged(scene, flattened(q, prefix, order, bracket), tmp_path)
    assert verdict.outcome == "pass", str(verdict)
    assert set(verdict.errors) == {"joint_position", "joint_velocity"}


def test_a_joint_state_whose_names_change_is_refused(scene, q, tmp_path):
    text = flattened(q).replace("shoulder,elbow", "elbow,shoulder", 1)
    with pytest.raises(crosscheck.ArgumentError, match=r"names 'elbow', then 'shoulder'"):
        judged(scene, text, tmp_path)


@pytest.mark.parametrize(("cell", "scale"), [("{:.9f} sec", 1.0), ("{:.6f} ms", 1e3)])
def test_a_unit_may_stand_in_each_cell(scene, q, cell, scale, tmp_path):
    rows = [f"{cell.format(scale * t)},{np.degrees(a):.9f} deg,{b:.12f} rad" for t, (a, b, *_) in zip(
        TIMES, q, strict=True)]
    verdict = judged(scene, "\n".join(["time,shoulder.position,elbow.position", *rows]), tmp_path)
    assert verdict.outcome == "pass", str(verdict)
    with pytest.raises(crosscheck.ArgumentError, match=r"row 3 .*'elbow.position': 'x rad|'x' is no number"):
        judged(scene, "\n".join(["time,shoulder.position,elbow.position", *rows[:2],
                                 rows[2].rpartition(",")[0] + ",x rad"]), tmp_path)


@pytest.mark.parametrize("rows", [[5], [0, 5, 5, 200]])
def test_rows_that_repeat_are_one(scene, q, rows, tmp_path):
    order = np.sort(np.concatenate([np.arange(len(TIMES)), rows]))
    text = table("t,shoulder.position,elbow.position", np.column_stack([TIMES, q[:, :2]])[order])
    verdict = judged(scene, text, tmp_path)
    assert verdict.outcome == "pass", str(verdict)
    assert f"{len(rows)} rows repeat the time" in str(verdict)


@pytest.mark.parametrize("empty", ["", "NaN"])
def test_a_missing_cell_is_no_missing_file(scene, q, empty, tmp_path):
    rows = [[repr(float(t)), *(repr(float(v)) for v in row)] for t, row in zip(TIMES, q, strict=True)]
    for k, column in ((0, 3), (7, 1), (7, 2), (50, 4), (121, 2)):
        rows[k][column] = empty
    header = "t,shoulder.position,elbow.position,shoulder.velocity,elbow.velocity"
    for start in ("scene", "recorded"):
        verdict = judged(scene, "\n".join([header, *map(",".join, rows)]), tmp_path, start=start)
        assert verdict.outcome == "pass", str(verdict)
        assert verdict.missing == 5
    rows[60][1] = "0.7"
    verdict = judged(scene, "\n".join([header, *map(",".join, rows)]), tmp_path)
    assert verdict.outcome == "fail"
    assert "t = 0.6 s" in str(verdict)


@pytest.mark.parametrize("start", ["scene", "recorded"])
def test_topics_that_were_merged_have_times_of_their_own(scene, start, tmp_path):
    late = TIMES[:-1] + 0.003
    early, other = two(), two(t=late)
    rows = [(t, a, b, np.nan, np.nan) for t, a, b in zip(TIMES, early["shoulder.position"], early["elbow.position"],
                                                        strict=True)]
    rows += [(t, np.nan, np.nan, a, b) for t, a, b in zip(late, other["shoulder.velocity"], other["elbow.velocity"],
                                                         strict=True)]
    text = table("t,shoulder.position,elbow.position,shoulder.velocity,elbow.velocity", sorted(rows))
    verdict = judged(scene, text.replace("nan", ""), tmp_path, start=start,
                     tolerance={"joint_position": 1e-4, "joint_velocity": 1e-3})
    assert verdict.outcome == "pass", str(verdict)
    assert verdict.errors["joint_velocity"] < (1e-9 if start == "scene" else 1e-4)


def test_a_period_gives_the_time(scene, q, tmp_path):
    text = table("q1,q2,dq1,dq2", q)
    with pytest.raises(crosscheck.ArgumentError, match="--period"):
        judged(scene, text, tmp_path)
    assert judged(scene, text, tmp_path, period=0.01).outcome == "pass"
    assert judged(scene, text, tmp_path, period=0.011).outcome == "fail"
    with pytest.raises(crosscheck.ArgumentError, match="has the times"):
        judged(scene, table("t,q1,q2", np.column_stack([TIMES, q[:, :2]])), tmp_path, period=0.01)


def test_a_mapping_comes_before_names_and_sends_columns_nowhere(scene, q, tmp_path):
    data = {"t": TIMES, "elbow.position": q[:, 1] + 1, "true elbow": q[:, 1], "shoulder_angle": q[:, 0] + 1}
    columns = {"true elbow": "elbow.position", "shoulder_angle": {"ignore": True}}
    verdict = crosscheck.judge_recording(scene, data, columns=columns, tolerance=PASSES)
    assert verdict.outcome == "pass", str(verdict)
    assert verdict.suggested == {}
    assert "columns ignored: elbow.position, shoulder_angle" in str(verdict)


def test_no_two_columns_have_one_meaning(scene, q, tmp_path):
    data = {"t": TIMES, "elbow_pos": q[:, 1], "elbow_angle": q[:, 1] + 1, "shoulder_pos": q[:, 0],
            "shoulder_cmd_pos": q[:, 0] + 1}
    verdict = crosscheck.judge_recording(scene, data, tolerance=PASSES)
    assert verdict.suggested == {"shoulder_pos": "shoulder.position"}
    assert "'elbow_pos', 'elbow_angle' may all be elbow.position" in str(verdict)
    assert verdict.outcome == "pass", str(verdict)


WRONG = {
    "sign": lambda q: q * [1, -1, 1, -1], "exchanged": lambda q: q[:, [1, 0, 3, 2]],
    "units": lambda q: np.degrees(q)}


@pytest.mark.parametrize("name", WRONG)
def test_a_mistake_of_columns_is_undone_for_the_start_and_named(scene, q, name):
    wrong = WRONG[name](q)
    data = {"t": TIMES} | {f"{joint}.{key}": wrong[:, k] for k, (key, joint) in enumerate(
        (key, joint) for key in ("position", "velocity") for joint in JOINTS)}
    verdict = crosscheck.judge_recording(scene, data, start="recorded", tolerance=PASSES)
    assert verdict.outcome == "fail", str(verdict)
    assert verdict.cause == name, str(verdict)


@pytest.mark.parametrize(("side", "outcome"), [("backward", "pass"), ("central", "pass"), ("wrong", "fail")])
def test_velocities_that_are_differences_have_the_error_of_differences(scene, q, side, outcome):
    angles = q[:, :2]
    rates = np.gradient(angles, TIMES, axis=0)
    if side == "backward":
        rates = np.diff(angles, axis=0, prepend=angles[:1]) / 0.01
    if side == "wrong":
        rates = rates * 1.02
    data = {"t": TIMES, "shoulder.position": angles[:, 0], "elbow.position": angles[:, 1],
            "shoulder.velocity": rates[:, 0], "elbow.velocity": rates[:, 1]}
    verdict = crosscheck.judge_recording(scene, data, start="recorded", tolerance={"joint_position": 1e-4})
    assert verdict.outcome == outcome, str(verdict)


ROOT = """<mujoco><worldbody><body name="trunk" pos="0 0 5"><freejoint/>
<inertial pos="{point}" mass="2" diaginertia=".03 .05 .07"/></body></worldbody></mujoco>"""


@pytest.mark.parametrize("frame", ["body", "world"])
@pytest.mark.parametrize("point", [(0.02, 0.0, 0.01), (-0.1, 0.05, 0.2), (0.0, 0.0, 0.0)])
@pytest.mark.parametrize("at", ["origin", "centre"])
def test_the_data_decide_points_and_axes(frame, point, at, tmp_path):
    """A log of a free body: root_pos_w is a point of the body, root_ang_vel in axes of the body or of the world."""
    (tmp_path / "trunk.xml").write_text(ROOT.format(point=" ".join(map(str, point))))
    model = crosscheck.import_model(tmp_path / "trunk.xml")
    made = tumbler()
    get = lambda name, axes: np.stack([made[f"brick.{name}{axis}"] for axis in axes], axis=1)  # noqa: E731
    x, v, w, quaternion = get("", "xyz"), get("v", "xyz"), get("w", "xyz"), get("q", "wxyz")
    from scipy.spatial.transform import Rotation
    R = Rotation.from_quat(quaternion, scalar_first=True)
    back = -np.array(point) if at == "origin" else np.zeros(3)
    x, v = x + R.apply(back), v + R.apply(np.cross(w, back))
    data = {"time": TIMES} | {f"root_pos_w_{a}": x[:, k] for k, a in enumerate("xyz")} | {
        f"root_quat_w_{a}": quaternion[:, k] for k, a in enumerate("wxyz")} | {
        f"root_lin_vel_w_{a}": v[:, k] for k, a in enumerate("xyz")} | {
        f"root_ang_vel_{a}": (w if frame == "body" else R.apply(w))[:, k] for k, a in enumerate("xyz")}
    verdict = crosscheck.judge_recording(model, data, start="recorded", tolerance={"position": 1e-6})
    assert verdict.outcome == "pass", str(verdict)
    assert f"in {frame} axes (the data decide)" in str(verdict)
    text = suggest(data, model)
    assert ("frame = \"world\"" in text.split("root_ang_vel_x")[1]) is (frame == "world"), text
    if any(point):
        assert ("point = " in text) is (at == "origin"), text


@pytest.mark.parametrize("method", ["explicit", "semi-implicit", "implicit"])
@pytest.mark.parametrize("rates", [True, False])
def test_euler_methods_are_told_from_each_other_and_from_damping(tmp_path, method, rates):
    (tmp_path / "arm.toml").write_text(SCENES["arm"])
    scene, h = crosscheck.load_scene(tmp_path / "arm.toml"), 0.01
    inertia = 0.03 + 1.2 * 0.16

    def a(q, v):
        return (1.2 * 9.81 * 0.4 * np.cos(q) - 0.02 * v) / inertia

    rows = [(0.4, 1.5)]
    for _ in range(200):
        q, v = rows[-1]
        if method == "explicit":
            rows.append((q + h * v, v + h * a(q, v)))
        elif method == "semi-implicit":
            v = v + h * a(q, v)
            rows.append((q + h * v, v))
        else:
            new = v
            for _ in range(50):
                new = v + h * a(q + h * new, new)
            rows.append((q + h * new, new))
    q, v = np.array(rows).T
    data = {"t": h * np.arange(201), "pivot.position": q} | ({"pivot.velocity": v} if rates else {})
    verdict = crosscheck.judge_recording(scene, data, tolerance={"joint_position": 1e-3})
    assert verdict.outcome == "fail"
    assert method + " Euler" in str(verdict.cause), str(verdict)
    damped = crosscheck.judge_recording(scene, arm(damping=0.05), tolerance={"joint_position": 1e-3})
    assert "damping" in str(damped.cause), str(damped)


def link(name, at):
    return (f'<link name="{name}"><inertial><origin xyz="{at} 0 0"/><mass value="1"/><inertia ixx=".01" iyy=".02" '
            f'izz=".02" ixy="0" ixz="0" iyz="0"/></inertial><collision><origin xyz="{at} 0 0"/><geometry><box '
            'size=".1 .1 .1"/></geometry></collision></link>')


def hinge(name, parent, child, at, turn):
    return (f'<joint name="{name}" type="continuous"><parent link="{parent}"/><child link="{child}"/><origin '
            f'xyz="{at} 0 0" rpy="0 {turn} 0"/><axis xyz="0 1 0"/></joint>')


FOLDED = ('<robot name="folded">' + link("stand", 0) + link("upper", .15) + link("fore", .3)
          + hinge("lift", "stand", "upper", 0, 0) + hinge("bend", "upper", "fore", .3, np.pi) + "</robot>")
"""An arm whose last link lies in its stand where its joints are at zero."""


def test_a_log_of_a_model_is_judged_from_its_own_start_and_what_touches_at_zero_is_watched(tmp_path):
    """A model file has no start of its own: the log starts where it starts, and that is said, not accused."""
    path = tmp_path / "folded.urdf"
    path.write_text(FOLDED)
    moved = crosscheck.import_model(path, qpos=[0.3, 2.0], duration=0.2, samples=41)
    made = crosscheck.run(moved, "lieeuler", "taylor", rtol=1e-12)
    log = pd.DataFrame({"t": made.t} | {f"{name}.{key}": getattr(made.joints[name], key).ravel()
                                        for name in ("lift", "bend") for key in ("position", "velocity")})
    log.to_csv(tmp_path / "log.csv", index=False)
    command = ["judge", str(path), str(tmp_path / "log.csv"), "--tol", "joint_position=1e-6"]
    def told_of(*more):
        return CliRunner(env={"COLUMNS": "1000"}).invoke(app, [*command, *more])

    told = told_of()
    assert told.exit_code == 0, told.output
    lines = told.stdout.splitlines()
    assert lines[0].startswith("✓ pass")
    assert lines[1] == ("the recording does not start where the scene starts: joint position of lift by 0.3 rad, joint "
                        "position of bend by 2 rad: judged from its first row")
    assert "at the recorded start they are apart, and watched: stand - fore" in lines
    wanted = told_of("--start", "scene")
    assert wanted.exit_code == 1
    assert "--start recorded judges from its first row" in wanted.stdout
    assert "judged from its first row" not in told_of("--qpos", ".3,2").stdout
    assert told_of("--qpos", ".3,2.1").exit_code == 1  # a start that was asked for is a part of the question


@pytest.mark.parametrize(("rows", "moves", "says"), [
    (1, True, "truth starts from the recording's 1 row, and none is left"), (5, True, "5 rows, and none is left"),
    (6, True, ""), (60, False, "nothing moves but rounding")])
def test_a_recording_that_tests_nothing_passes_nothing(rows, moves, says):
    scene = crosscheck.load_scene("hinge_pendulum")
    if moves:
        traj = crosscheck.run(scene, "lieeuler", "rkmk4", step=1e-3)
        angle = traj.joints[scene.joints[0].name].position[:rows]
        data = {"t": scene.t[:rows], f"{scene.joints[0].name}.position": angle}
    else:
        data = {"t": np.arange(rows) * 0.01, "hinge.position": np.zeros(rows), "hinge.velocity": np.zeros(rows)}
        scene = scene.replace(gravity=np.zeros(3))
    verdict = crosscheck.judge_recording(scene, data, start="recorded", tolerance={"joint_position": 0.1})
    assert (verdict.outcome, says in verdict.reason) == ("unresolved" if says else "pass", True)
