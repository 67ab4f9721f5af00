"""A scene whose claim a monitor ends at once is judged up to there, and the headline says so."""

import json

from tests.commands import crosscheck
from tests.scene_making import ARM

MONITOR = 'position = 1.2\n[[monitors]]\ntype = "range"\njoint = "elbow"\nlower = {}\nupper = 2.0\n'


URDF = """<robot name="arm">
  <link name="base"><collision><origin xyz="0 0 -.6"/><geometry><sphere radius=".3"/></geometry></collision></link>
  <link name="upper"><inertial><origin xyz=".2 0 0"/><mass value="2"/>
    <inertia ixx=".002" iyy=".03" izz=".03" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <link name="lower"><inertial><origin xyz=".15 0 0"/><mass value="1"/>
    <inertia ixx=".001" iyy=".01" izz=".01" ixy="0" ixz="0" iyz="0"/></inertial>
    <collision><origin xyz=".3 0 0"/><geometry><sphere radius=".05"/></geometry></collision></link>
  <joint name="shoulder" type="continuous"><parent link="base"/><child link="upper"/><axis xyz="0 1 0"/></joint>
  <joint name="elbow" type="continuous"><parent link="upper"/><child link="lower"/><origin xyz=".4 0 0"/>
    <axis xyz="0 1 0"/></joint>
</robot>
"""


def judged(folder, lower, *more):
    path = folder / "arm.toml"
    path.write_text(ARM.replace("0.1", "0.02") + MONITOR.format(lower))
    return crosscheck("verify", str(path), "--engine", "pinocchio", "--method", "RKMK4", *more,
                      "-o", str(folder / "report"))


def test_runs_are_judged_up_to_a_monitor_that_fires_before_the_first_output_time(tmp_path):
    """That is a small share of the time asked for: a pass only where no more is needed, as with `run`."""
    said = judged(tmp_path, 1.19)
    assert said.returncode == 3, said.stderr
    words = " ".join(said.stdout.split())
    assert "2 unresolved (resolved over 3.4 % of the time" in words
    assert "arm is judged until elbow leaves its range at .0344" in words
    assert "--duration 0.034, before truth ends, or --need 0.034" in words
    enough = judged(tmp_path, 1.19, "--need", "0.034")
    assert enough.returncode == 0, enough.stderr
    assert "All 2 runs pass; arm is judged until elbow leaves its range at .0344" in " ".join(enough.stdout.split())
    [scene] = json.loads((tmp_path / "report" / "results.json").read_text())["scenes"]
    horizon = scene["truth"]["horizon"]
    # It falls from rest, by a constant torque.
    assert abs(horizon - (2 * 0.01 * 0.27 / (9.81 * 0.5 * 0.932)) ** 0.5) < 1e-4
    assert scene["plan"]["duration"] == horizon


def test_a_step_that_is_asked_for_is_made_up_to_the_last_whole_one_before_truth_ends(tmp_path):
    said = judged(tmp_path, 1.19, "--step", "1e-3")
    assert "resolved over 3.4 % of the time" in " ".join(said.stdout.split())
    found = json.loads((tmp_path / "report" / "results.json").read_text())
    assert {record["step"] for record in found["records"]} == {1e-3}
    assert found["scenes"][0]["plan"]["duration"] == 0.034
    ended, = (each for each in found["records"][0]["findings"] if each["kind"] == "unresolved ended")
    assert abs(ended["value"] - 0.0344) < 1e-4


def test_a_model_files_own_duration_ends_with_truth_and_one_that_is_asked_for_counts_in_full(tmp_path):
    """Nobody asked for the two seconds of an import; links touch before."""
    model = tmp_path / "arm.urdf"
    model.write_text(URDF)
    asked = (str(model), "--engine", "mujoco", "--method", "RK4", "--step", "1e-3")
    for command, more in (("run", ()), ("verify", ("-o", str(tmp_path / "report")))):
        said = crosscheck(command, *asked, *more)
        assert said.returncode == 0, said.stdout
        assert "base sphere 0 touches lower sphere 1 at .3226 s" in " ".join(said.stdout.split())
        whole = crosscheck(command, *asked, "--duration", "2", *more)
        assert whole.returncode == 3, whole.stdout
        assert "--need 0.16" in whole.stdout


def test_a_claim_that_ends_at_the_start_names_what_ends_it(tmp_path):
    words = " ".join(judged(tmp_path, 1.2).stdout.split())
    assert "arm could not be judged: 'arm' has no truth: at its start already elbow leaves its range" in words
