"""The steps of action.yml and of the workflows, run as by a runner."""

from __future__ import annotations

import os
import re
import subprocess
import sys

import pytest

from tests import ROOT

yaml = pytest.importorskip("yaml")
ACTION = yaml.safe_load((ROOT / "action.yml").read_text())
WORKFLOWS = {file.name: yaml.safe_load(file.read_text()) for file in (ROOT / ".github" / "workflows").glob("*.yml")}
SEEDS = ROOT / "tests" / "seeds"
FEW = f"{SEEDS / 'few.py'}:Few"


def step(folder, name, given, **more):
    """The exit code of a step, what it printed, its outputs and its summary."""
    each = next(each for each in ACTION["runs"]["steps"] if each["name"] == name)
    inputs = {key: given.get(key, content["default"]) for key, content in ACTION["inputs"].items()}
    filled = {key: re.sub(r"\$\{\{ inputs\.(\w+) \}\}", lambda found: inputs[found[1]], text)
              for key, text in each["env"].items()}
    assert "${{" not in each["run"] + "".join(filled.values())
    output, summary = folder / "output", folder / "summary"
    for file in (output, summary):
        file.write_text("")
    environment = {**os.environ, "PATH": f"{os.path.dirname(sys.executable)}:{os.environ['PATH']}", **filled, **more,
                   "GITHUB_OUTPUT": str(output), "GITHUB_STEP_SUMMARY": str(summary)}
    environment.pop("CROSSCHECK_STORE", None)
    ended = subprocess.run(["bash", "-e", "-c", each["run"]], cwd=folder, env=environment, capture_output=True,
                           text=True, check=False)
    return ended.returncode, ended.stdout + ended.stderr, output.read_text(), summary.read_text()


@pytest.mark.parametrize(("given", "code"), [
    ({"command": "verify", "scenes": "single_pendulum", "engines": FEW}, 0),
    ({"command": "verify", "scenes": "no_such_scene"}, 2),
    ({"scenes": "$(touch owned) `touch owned`"}, 2),
])
def test_the_step_that_runs(given, code, tmp_path):
    ended, printed, output, summary = step(tmp_path, "Run", given)
    assert ended == code, printed
    assert output == f"code={code}\n"
    assert ("::error" in printed) == (code > 0)
    assert bool(summary) == (code == 0)
    assert not (tmp_path / "owned").exists()


def test_a_command_that_there_is_not(tmp_path):
    ended, printed, _, _ = step(tmp_path, "Run", {"command": "nightly; touch owned"})
    assert (ended, printed) == (2, "::error title=crosscheck::command is nightly or verify, not nightly; touch owned\n")
    assert not (tmp_path / "owned").exists()


NIGHT = """\
#!/bin/sh
mkdir -p crosscheck-history/nightly/1 && ln -sfn 1 crosscheck-history/nightly/latest
printf '%s\n' 'crosscheck nightly: look at this.' '' 'Findings:' '- speed: 20 % slower' '' 'Worth knowing:' \
  '- version: 1, now 2' '' 'run 1' '- no finding' > crosscheck-history/nightly/1/summary.txt
exit 1
"""


def test_lines_of_the_summary_are_annotations(tmp_path):
    command = tmp_path / "bin" / "crosscheck"
    command.parent.mkdir()
    command.write_text(NIGHT)
    command.chmod(0o755)
    ended, printed, output, summary = step(tmp_path, "Run", {}, PATH=f"{command.parent}:{os.environ['PATH']}")
    assert (ended, output) == (1, "code=1\n")
    assert printed == ("::error title=crosscheck::speed: 20 %25 slower\n"
                       "::notice title=crosscheck::version: 1, now 2\n")
    assert summary == (tmp_path / "crosscheck-report" / "summary.txt").read_text()


@pytest.mark.parametrize(("code", "ended", "kind"), [(0, 0, ""), (1, 1, "error"), (3, 0, "warning"), (2, 2, "error"),
                                                     (70, 70, "error")])
def test_what_is_unresolved_is_a_finding_and_no_broken_run(code, ended, kind, tmp_path):
    command = tmp_path / "bin" / "crosscheck"
    command.parent.mkdir()
    command.write_text("#!/bin/sh\nmkdir -p crosscheck-report\necho said > crosscheck-report/summary.md\n"
                       f"exit {code}\n")
    command.chmod(0o755)
    found, printed, output, summary = step(tmp_path, "Run", {"command": "verify"},
                                           PATH=f"{command.parent}:{os.environ['PATH']}")
    assert (found, output) == (ended, f"code={code}\n")
    assert re.findall(r"^::(\w+) ", printed, re.MULTILINE) == ([kind] if kind else [])
    assert summary == ("said\n" if code in (0, 1, 3) else "")


def test_nights_are_compared_and_what_became_worse_is_annotated(tmp_path):
    given = {"scenes": "single_pendulum", "engines": FEW}
    ended, printed, _, summary = step(tmp_path, "Run", given)
    assert ended == 0, printed
    assert "first run, nothing to compare with" in summary
    assert "::error" not in printed
    assert {"index.html", "results.json"} <= {path.name for path in (tmp_path / "crosscheck-report").iterdir()}
    (tmp_path / "crosscheck-report").rename(tmp_path / "report-of-the-first-night")  # a runner starts empty
    ended, printed, output, _ = step(tmp_path, "Run", given, CROSSCHECK_TEST_SEED="coefficient", PYTHONPATH=str(SEEDS))
    assert (ended, output) == (1, "code=1\n"), printed
    errors = [line for line in printed.splitlines() if line.startswith("::error title=crosscheck::")]
    assert any(line.startswith(f"::error title=crosscheck::accuracy: {FEW} rattle4 on single_pendulum: ")
               for line in errors)
    assert all("rattle4" in line for line in errors)


def test_workflows_use_what_is_there():
    for workflow in WORKFLOWS.values():
        for job in workflow["jobs"].values():
            assert (ROOT / job["uses"]).is_file() if "uses" in job else job["steps"]
            for each in job.get("steps", ()):
                if each.get("uses") == "./":
                    assert set(each.get("with", {})) <= set(ACTION["inputs"])
                if each.get("run", "").startswith(".ci/"):
                    assert (ROOT / each["run"]).is_file()


def test_pages_show_the_workflows_as_they_are():
    shown = re.findall(r"```yaml\n(.*?)```", (ROOT / "docs" / "nightly.md").read_text(), re.DOTALL)
    assert [yaml.safe_load(each) for each in shown] == [WORKFLOWS["nightly.yml"]]


def test_oldest_and_newest_python_and_both_compilers():
    project = (ROOT / "pyproject.toml").read_text()
    matrix = WORKFLOWS["ci.yml"]["jobs"]["test"]["strategy"]["matrix"]
    versions = re.findall(r"Python :: (3\.\d+)", project)
    assert matrix["python"] == [versions[0], versions[-1]]
    assert f'requires-python = ">={versions[0]}"' in project
    assert re.findall(r"cp3(\d+)-\*", project) == [each.removeprefix("3.") for each in versions]
    assert matrix["compiler"] == ["g++", "clang++"]
