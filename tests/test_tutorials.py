"""Every tutorial runs from an empty folder, cell by cell, and comes to the answer that its page draws."""

from __future__ import annotations

import os
import re
import subprocess
import sys

import pytest

from tests import ROOT

CELL = re.compile(r"^```\{code-cell\} python\n(.*?)^```$", re.DOTALL | re.MULTILINE)
ANSWERS = {
    "robot": ["damping of joint shoulder is stored but not applied by aba", "pass: error against truth",
              "method   RK4", r"pinocchio  \d\.\de-1\d m"],
    "log": ["✓ pass: arm", "✗ fail: arm", "cause: extra damping", r"\? unresolved"],
    "integrator": ["CC103", "observed order: midpoint 2", "work/index.html|page: work",
                   "document: judged/paper"],
    "engine": ["1 run behaves as documented", "CC102", "inertia"]}
"""What the output of each has, in this order."""


def ran(text: str) -> str:
    """The cells as one script: files are written, commands run in a shell, and what they print is passed on."""
    script = ["import subprocess"]
    for cell in CELL.findall(text):
        if cell.startswith("%%writefile "):
            name, _, content = cell.removeprefix("%%writefile ").partition("\n")
            script.append(f"open({name!r}, 'w', encoding='utf-8').write({content!r})")
            continue
        for line in cell.splitlines():
            script.append(f"print(subprocess.run({line[1:]!r}, shell=True, capture_output=True, text=True).stdout)"
                          if line.startswith("!") else line)
    return "\n".join(script)


@pytest.mark.parametrize("name", ANSWERS)
def test_a_tutorial_comes_to_its_answer(name, tmp_path):
    text = (ROOT / "docs" / "tutorials" / f"{name}.md").read_text("utf-8")
    path = os.pathsep.join([os.path.dirname(sys.executable), os.environ["PATH"]])
    done = subprocess.run([sys.executable, "-c", ran(text)], cwd=tmp_path, capture_output=True, text=True,
                          env={**os.environ, "PATH": path, "COLUMNS": "120"})
    assert done.returncode == 0, done.stderr
    assert re.search(".*?".join(ANSWERS[name]), done.stdout, re.DOTALL), done.stdout


def test_every_tutorial_is_run():
    assert {path.stem for path in (ROOT / "docs" / "tutorials").glob("*.md")} == set(ANSWERS)
