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


PLACE = {"github.action_path": str(ROOT)}


def step(folder, name, given, place=PLACE, **more):
    """The exit code of a step, what it printed, its outputs and its summary."""
    each = next(each for each in ACTION["runs"]["steps"] if each["name"] == name)
    inputs = {key: given.get(key, content["default"]) for key, content in ACTION["inputs"].items()}
    known = {f"inputs.{key}": value for key, value in inputs.items()} | place
    filled = {key: re.sub(r"\$\{\{ (.+?) \}\}", lambda found: known[found[1]] if found[1] in known else
                          known.get("release", "") if found[1].startswith("github.action_repository &&") else found[0],
                          text) for key, text in each["env"].items()}
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
    ({"model": "$(touch owned)", "logs": "`touch owned`", "tolerance": "$(touch owned)", "need": "$(touch owned)"}, 2),
])
def test_the_step_that_runs(given, code, tmp_path):
    ended, printed, output, summary = step(tmp_path, "Run", given)
    assert ended == code, printed
    assert output == f"code={code}\n"
    assert ("::error" in printed) == (code > 0)
    assert bool(summary) == (code == 0)
    assert not (tmp_path / "owned").exists()


@pytest.mark.parametrize(("given", "said"), [
    ({"command": "nightly; touch owned"}, "command is judge, verify or nightly, not nightly; touch owned"),
    ({"need": "0.5"}, "model, tolerance and need go with judge and verify, not with nightly")])
def test_a_command_or_an_input_that_there_is_not(tmp_path, given, said):
    ended, printed, _, _ = step(tmp_path, "Run", given)
    assert (ended, printed) == (2, f"::error title=crosscheck::{said}\n")
    assert not (tmp_path / "owned").exists()


PYTHON = """\
#!/bin/sh
echo "$@" >> asked
case "$*" in
  *download*"$HAS"*) for word; do test "$before" = --dest && touch "$word/lieeuler_crosscheck-1-any.whl"; before=$word
                     done; exit 0 ;;
  *download*) exit 1 ;;
esac
"""


@pytest.mark.parametrize(("release", "has", "installed"), [
    ("https://example.org/a/b/releases/v1", "releases/v1", r"/tmp\S+/lieeuler_crosscheck-1-any\.whl"),
    ("https://example.org/a/b/releases/main", "releases/v1", re.escape(str(ROOT))),
    ("", "nothing", re.escape(str(ROOT)))])
def test_a_wheel_of_the_release_is_installed_or_else_the_sources(release, has, installed, tmp_path):
    python = tmp_path / "bin" / "python"
    python.parent.mkdir()
    python.write_text(PYTHON)
    python.chmod(0o755)
    ended, printed, _, _ = step(tmp_path, "Install", {"extras": "mujoco"}, PLACE | {"release": release}, HAS=has,
                                PATH=f"{python.parent}:{os.environ['PATH']}")
    assert ended == 0, printed
    assert re.fullmatch(rf"-m pip install {installed}\[mujoco\]", (tmp_path / "asked").read_text().splitlines()[-1])
    assert ("compiled, which takes minutes" in printed) == (str(ROOT) in (tmp_path / "asked").read_text())


ROBOT = """<robot name="robot"><link name="base"/><link name="arm"><inertial><origin xyz=".5 0 0"/><mass value="1"/>
<inertia ixx=".01" iyy=".02" izz=".02" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="elbow" type="continuous"><parent link="base"/><child link="arm"/><axis xyz="0 1 0"/></joint></robot>
"""

SIMULATE = """\
import mujoco, os
os.mkdir("logs")
for name, gain in (("right", 1.0), ("wrong", 1.01)):
    model = mujoco.MjModel.from_xml_path("robot.urdf")
    model.opt.timestep, model.opt.integrator = 1e-3, mujoco.mjtIntegrator.mjINT_RK4
    data = mujoco.MjData(model)
    with open(f"logs/{name}.csv", "w") as log:
        print("t,elbow.position [rad]", file=log)
        for _ in range(1001):
            print(f"{data.time:.3f},{gain * data.qpos[0]:.9f}", file=log)
            mujoco.mj_step(model, data)
"""


def test_the_workflow_of_the_page_from_an_empty_repository(tmp_path):
    (shown,) = re.findall(r"```yaml\n(.*?)```", (ROOT / "docs" / "nightly.md").read_text(), re.DOTALL)
    job = yaml.safe_load(shown)["jobs"]["judge"]
    (tmp_path / "robot.urdf").write_text(ROBOT)
    (tmp_path / "simulate.py").write_text(SIMULATE)
    (tmp_path / "simulate.sh").write_text(f"#!/bin/sh\n{sys.executable} simulate.py\n")
    (tmp_path / "simulate.sh").chmod(0o755)
    _, _, simulate, own = job["steps"]
    subprocess.run(["bash", "-e", "-c", simulate["run"]], cwd=tmp_path, check=True)
    assert set(own["with"]) <= set(ACTION["inputs"])
    ended, printed, output, summary = step(tmp_path, "Run", own["with"])
    assert (ended, output) == (1, "code=1\n"), printed
    errors = [line for line in printed.splitlines() if line.startswith("::error")]
    assert len(errors) == 1
    assert re.match(r"::error title=CC\d+ logs/wrong\.csv::", errors[0])
    assert "::" not in summary
    assert "pass: logs/right.csv: " in summary
    assert [*(tmp_path / "crosscheck-report").glob("junit.xml")]
    (tmp_path / "logs" / "wrong.csv").unlink()
    ended, printed, _, summary = step(tmp_path, "Run", own["with"])
    assert ended == 0, printed
    assert "::error" not in printed
    assert "pass: robot: " in summary


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


def test_oldest_and_newest_python_and_both_compilers():
    project = (ROOT / "pyproject.toml").read_text()
    matrix = WORKFLOWS["ci.yml"]["jobs"]["test"]["strategy"]["matrix"]
    versions = re.findall(r"Python :: (3\.\d+)", project)
    assert matrix["python"] == [versions[0], versions[-1]]
    assert f'requires-python = ">={versions[0]}"' in project
    assert re.findall(r"cp3(\d+)-\*", project) == [each.removeprefix("3.") for each in versions]
    assert matrix["compiler"] == ["g++", "clang++"]
