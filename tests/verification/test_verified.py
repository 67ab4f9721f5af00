"""`crosscheck.verify` and `Trajectory.verdict`: the command's answers, in Python."""

import json
import shlex

import pytest
from typer.testing import CliRunner

import crosscheck
from crosscheck import adapters
from crosscheck.cli.app import app
from crosscheck.report import load_report
from tests.engines.faults import __file__ as bad

ASK = {"engine": "lieeuler", "method": "rattle2", "profile": "smoke", "jobs": 1}


@pytest.fixture(scope="module")
def answer():
    return crosscheck.verify("single_pendulum", **ASK)


def test_the_answer_is_that_of_the_command(answer, tmp_path):
    done = CliRunner().invoke(app, ["verify", "single_pendulum", "--engine", "lieeuler", "--method", "rattle2",
                                    "--profile", "smoke", "--jobs", "1", "--json", "-o", str(tmp_path / "out")])
    record, = json.loads(done.stdout)["records"]
    own, = answer.document.records
    assert answer.outcome == record["outcome"] == "pass"
    assert own.command == record["command"]
    assert own.errors["position"].max == record["errors"]["position"]["max"]
    assert answer.document.meta.command == json.loads(done.stdout)["meta"]["command"]
    assert str(answer) == "pass: The only run passes"


def test_a_frame_has_a_row_a_run_and_the_report_is_that_of_the_document(answer, tmp_path):
    frame = answer.frame()
    assert len(frame) == 1
    row, = frame.to_dict("records")
    assert (row["scene"], row["method"], row["outcome"], row["share resolved"]) == (
        "single_pendulum", "rattle2", "pass", 1.0)
    assert row["observed order"] == pytest.approx(2, abs=0.05)
    assert 0 < row["position max error [m]"] < 1e-3
    assert {"position resolution over size", "us per step", "wall time [s]", "command"} <= {*frame}
    page = answer.report(tmp_path / "out")
    assert page.name == "index.html"
    assert load_report(page.parent).outcome == "pass"
    assert "<td>lieeuler rattle2</td>" in answer._repr_html_()
    assert answer._repr_html_().count("<tr>") == 2


def test_a_wrong_engine_fails_with_findings():
    found = crosscheck.verify("single_pendulum", engine=f"{bad}:Resting", profile="smoke", jobs=1)
    assert found.outcome == "fail"
    assert {finding.status for _, _, finding in found.findings} >= {"fail"}
    assert "<td>✗ fail</td>" in found._repr_html_()


def test_a_scene_made_in_python_is_verified_under_its_name_and_its_command_runs():
    short = crosscheck.load_scene("single_pendulum").lasting(0.5)
    found = crosscheck.verify(short, **ASK)
    record, = found.document.records
    assert (record.scene, record.outcome, record.duration) == ("single_pendulum", "pass", 0.5)
    words = shlex.split(record.command)
    assert crosscheck.load_scene(words[2]).duration == 0.5


@pytest.mark.parametrize(("wrong", "said"), [
    ({"scene": "no_such"}, "no_such"), ({"need": 0.0}, "need"), ({"budget": -1.0}, "budget"), ({"jobs": 0}, "jobs"),
    ({"method": "no_such"}, "method"), ({"engine": "no_such"}, "engine"), ({"scene": 3}, "scene"),
    ({"step": -1.0}, "step"), ({"duration": 0.0}, "duration")])
def test_a_wrong_argument_is_named(wrong, said):
    with pytest.raises(crosscheck.CrosscheckError, match=said):
        crosscheck.verify(**{"scene": "single_pendulum", **ASK, **wrong})


def test_a_run_has_the_verdict_of_the_command(tmp_path):
    run = crosscheck.run("single_pendulum", "mujoco", "RK4", step=1e-3, duration=1.0)
    verdict = run.verdict()
    assert (verdict.outcome, verdict.share, verdict.code, verdict.word) == ("pass", 1.0, "", "pass")
    assert verdict.worst in verdict.findings
    done = CliRunner().invoke(app, ["run", "single_pendulum", "--engine", "mujoco", "--method", "RK4", "--step", "1e-3",
                                    "--duration", "1"])
    assert f"{verdict.errors['position'].max:.2g} m" in done.stdout.splitlines()[0]


def test_an_object_has_no_verdict():
    class Mine(type(adapters.get("mujoco"))):
        """MuJoCo under another name."""

    run = crosscheck.run("single_pendulum", Mine(), "RK4", step=1e-2, duration=0.1)
    with pytest.raises(crosscheck.ArgumentError, match="object"):
        run.verdict()
