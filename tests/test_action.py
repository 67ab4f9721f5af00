"""The steps of action.yml and of the workflows, run here as a runner would run them."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

from tests import ROOT

yaml = pytest.importorskip("yaml")


def step(name):
    action = yaml.safe_load((ROOT / "action.yml").read_text())
    return next(each for each in action["runs"]["steps"] if each["name"] == name)["run"], action["inputs"]


def filled(script, inputs, **given):
    for name, content in inputs.items():
        script = script.replace("${{ inputs." + name + " }}", given.get(name, content["default"]))
    assert "${{" not in script
    return script


@pytest.mark.parametrize(("given", "code"), [
    ({"scenes": "single_pendulum", "engines": "lieeuler"}, 0),
    ({"scenes": "no_such_scene"}, 2),
])
def test_the_verify_step(given, code, tmp_path):
    script, inputs = step("Verify")
    output, summary = tmp_path / "output", tmp_path / "summary"
    summary.touch()
    environment = {**os.environ, "GITHUB_OUTPUT": str(output), "GITHUB_STEP_SUMMARY": str(summary),
                   "PATH": f"{os.path.dirname(sys.executable)}:{os.environ['PATH']}"}
    ended = subprocess.run(["bash", "-e", "-c", filled(script, inputs, **given)], cwd=tmp_path, env=environment,
                           capture_output=True, text=True, check=False)
    assert ended.returncode == code, ended.stderr
    assert output.read_text() == f"code={code}\n"
    assert ("::error" in ended.stdout) == (code > 0)
    assert bool(summary.read_text()) == (code == 0)


def test_workflows_use_what_is_there():
    for file in sorted((ROOT / ".github" / "workflows").glob("*.yml")):
        workflow = yaml.safe_load(file.read_text())
        for job in workflow["jobs"].values():
            for each in job["steps"]:
                if each.get("uses") == "./":
                    action = yaml.safe_load((ROOT / "action.yml").read_text())
                    assert set(each.get("with", {})) <= set(action["inputs"])
                if each.get("run", "").startswith(".ci/"):
                    assert (ROOT / each["run"]).is_file()
