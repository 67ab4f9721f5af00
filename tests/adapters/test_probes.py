"""A simulator that is known by its files alone gets the whole verdict."""

import csv
import json

import numpy as np
import pytest
from typer.testing import CliRunner

import crosscheck
from crosscheck.cli.app import app
from crosscheck.cli.runs import write_csv
from crosscheck.errors import ArgumentError
from crosscheck.scene.model import Body, Joint
from crosscheck.verification.probing import judge_probes

STEP = 2e-3


def read(path, base):
    """The scene in a file of a question, which differs from `base` by where it stands and how it starts."""
    data = json.loads(path.read_text(encoding="utf-8"))

    def made(kind, entry):
        return kind(**{key: np.array(value) if isinstance(value, list) else value for key, value in entry.items()})

    return base.replace(gravity=np.array(data["gravity"]), duration=data["duration"], samples=data["samples"],
                        bodies=tuple(made(Body, each) for each in data["bodies"]),
                        joints=tuple(made(Joint, each) for each in data["joints"]))


def simulate(base, folder, gravity):
    """What somebody's simulator does with the questions of a folder."""
    with (folder / "questions.csv").open(encoding="utf-8") as stream:
        for row in csv.DictReader(stream):
            scene = read(folder / row["scene"], base)
            own = scene.replace(gravity=gravity * scene.gravity)
            traj = crosscheck.run(own, "mujoco", "RK4", step=float(row["step [s]"]))
            write_csv(scene, traj, str(folder / row["answer"]))


@pytest.mark.parametrize(("gravity", "outcome", "code"), [(1.0, "pass", 0), (1.0 + 1e-6, "fail", 1)])
def test_the_whole_verdict_from_files(tmp_path, gravity, outcome, code):
    scene, log, folder = crosscheck.load_scene("double_pendulum"), tmp_path / "log.csv", tmp_path / "p"
    scene = scene.replace(duration=1.0, samples=51)
    own = scene.replace(gravity=gravity * scene.gravity)
    write_csv(scene, crosscheck.run(own, "mujoco", "RK4", step=STEP), str(log))
    words = ["judge", "double_pendulum", str(log), "--probes", str(folder), "--step", str(STEP), "--order", "4"]
    first = CliRunner().invoke(app, words)
    assert first.exit_code == 3
    assert "questions open" in first.output
    for _ in range(3):
        simulate(scene, folder, gravity)
        last = CliRunner().invoke(app, words)
        if "open" not in last.output:
            break
    assert (last.exit_code, last.output.partition(":")[0]) == (code, outcome), last.output


def test_a_question_is_asked_once(tmp_path):
    scene, log = crosscheck.load_scene("single_pendulum").replace(duration=1.0, samples=26), tmp_path / "log.csv"
    write_csv(scene, crosscheck.run(scene, "mujoco", "RK4", step=STEP), str(log))
    one, two = (judge_probes(scene, log, tmp_path / "p", STEP, 4) for _ in range(2))
    assert one == two
    assert len(one[1]) == len(list((tmp_path / "p").glob("*.json")))


def test_a_log_without_states_is_one_clear_error(tmp_path):
    (tmp_path / "log.csv").write_text("t [s],q\n0,1\n1,1\n2,1\n")
    with pytest.raises((ArgumentError, crosscheck.CrosscheckError), match="file of states has no"):
        judge_probes(crosscheck.load_scene("single_pendulum"), tmp_path / "log.csv", tmp_path / "p", STEP, 4)
