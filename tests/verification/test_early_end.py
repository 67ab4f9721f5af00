"""A scene whose claim a monitor ends at once is judged up to there, and the headline says so."""

import json

from tests.commands import crosscheck

SCENE = """
schema = 3
name = "gate"
description = "a pendulum that is watched over its first fall"
source = "own"
gravity = [0.0, 0.0, -9.81]
duration = 2.0
samples = 101

[[bodies]]
name = "arm"
mass = 1.0
inertia = [[0.02, 0, 0], [0, 0.02, 0], [0, 0, 0.02]]

[[joints]]
name = "pivot"
type = "revolute"
parent = "ground"
child = "arm"
parent_anchor = [0.0, 0.0, 0.0]
child_anchor = [0.0, 0.0, 0.5]
parent_axis = [0.0, 1.0, 0.0]
child_axis = [0.0, 1.0, 0.0]
position = 1.2

[[monitors]]
type = "range"
joint = "pivot"
lower = 1.2
upper = 2.0
"""


def judged(folder, lower):
    path = folder / "gate.toml"
    path.write_text(SCENE.replace("lower = 1.2", f"lower = {lower}"))
    return crosscheck("verify", str(path), "--engine", "pinocchio", "--method", "RKMK4", "-o", str(folder / "report"))


def test_runs_are_judged_up_to_a_monitor_that_fires_before_the_first_output_time(tmp_path):
    said = judged(tmp_path, 1.19)
    assert said.returncode == 0, said.stderr
    words = " ".join(said.stdout.split())
    assert "All 2 runs pass; gate is judged until pivot leaves its range at .0344" in words
    [scene] = json.loads((tmp_path / "report" / "results.json").read_text())["scenes"]
    horizon = scene["truth"]["horizon"]
    # It falls from rest, by a constant torque.
    assert abs(horizon - (2 * 0.01 * 0.27 / (9.81 * 0.5 * 0.932)) ** 0.5) < 1e-4
    assert horizon < scene["plan"]["duration"] < 1.2 * horizon


def test_a_claim_that_ends_at_the_start_names_what_ends_it(tmp_path):
    words = " ".join(judged(tmp_path, 1.2).stdout.split())
    assert "gate could not be judged: 'gate' has no truth: at its start already pivot leaves its range" in words
