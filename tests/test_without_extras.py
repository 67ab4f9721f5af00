"""Every command without extras: it works, or one line names the missing extra."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys

import pytest
from typer.main import get_command

from crosscheck import errors
from crosscheck.cli.app import app
from tests import ROOT
from tests.scene.models.model_files import ARM_URDF

HIDE = """
import importlib.metadata, sys
HIDDEN = {hidden}
class Hiding:
    def __init__(self, finder):
        self.finder = finder
    def find_spec(self, name, path=None, target=None):
        return None if name.partition(".")[0] in HIDDEN else self.finder.find_spec(name, path, target)
    def __getattr__(self, name):
        return getattr(self.finder, name)
sys.meta_path[:] = [Hiding(finder) for finder in sys.meta_path]
found = importlib.metadata.Distribution.from_name.__func__
def from_name(cls, name):
    if name.lower() in HIDDEN:
        raise importlib.metadata.PackageNotFoundError(name)
    return found(cls, name)
importlib.metadata.Distribution.from_name = classmethod(from_name)
"""
"""As `sitecustomize.py` in PYTHONPATH it hides the extras from every process, the workers of a run among them."""

DRIVER = """
import contextlib, io, json, sys
from crosscheck.cli.app import main
for words in json.loads(sys.argv[1]):
    sys.argv[1:], said, complained, code = words, io.StringIO(), io.StringIO(), 0
    with contextlib.redirect_stdout(said), contextlib.redirect_stderr(complained):
        try:
            main()
        except SystemExit as end:
            code = end.code or 0
    print(json.dumps([code, said.getvalue(), complained.getvalue()]))
"""

RATTLE = "--engine lieeuler --method rattle2"
WORK = {  # and what they say
    "--version": "mujoco not installed", "list": "heavy_top", "list --support": "lieeuler",
    f"run brief.toml {RATTLE} --step 0.01": "pass: error against truth",
    "truth brief.toml": "checked against: index-1 equations",
    "inspect brief.toml": "lieeuler-crosscheck[mujoco]", "convert brief.toml -o out.xml": "written",
    "linearise brief.toml": "lieeuler-crosscheck[pinocchio]", "linearise --modes bicycle": "-0.775341882",
    "run brief.toml --engine mujoco --method RK4 --step 0.01 --script": "import mujoco",
    "study sweep sweep.toml -o sweep --dry-run": "1 cell, of which 0 finished and 1 to be computed",
    f"verify --scene brief.toml {RATTLE} --profile smoke --jobs 1 --out report": "results.json",
    "nightly --scene brief.toml --engine one.py:One --profile smoke --out nights": "first run, nothing to compare with",
    "history add report": "added: ", "history list": "smoke", "history show": "brief",
    "history accept latest": "accepted: ", "history compare latest latest": "nothing beyond rounding and noise",
    f"history trend outcome --scene brief.toml {RATTLE}": "pass"}
LACK = {  # and what
    "run brief.toml --engine mujoco --method RK4 --step 0.01": "mujoco",
    "run brief.toml --engine pinocchio --method RKMK4 --step 0.01": "pinocchio",
    "run brief.toml --engine exudyn --method RK44 --step 0.01": "exudyn",
    "verify --scene brief.toml --engine mujoco": "mujoco", "verify --engine drake": "drake",
    "verify --scene brief.toml --scheduler tcp://127.0.0.1:9": "cluster",
    "advise brief.toml --engine exudyn --error 1e-2": "exudyn", "explain brief.toml --engine pinocchio": "pinocchio",
    "judge brief.toml report/results.csv": "data",
    "inspect arm.urdf arm.urdf": "mujoco",
    "inspect arm.urdf": "mujoco", "convert arm.urdf -o arm.toml": "mujoco", "convert brief.toml -o out.py": "exudyn",
    "report report": "report", "report report --format svg": "report",
    "report report --format paper": "report", "history page": "report", "study sweep sweep.toml -o sweep": "data",
    "history list --store postgresql://somebody@127.0.0.1:1/some": "history",
    f"study work-precision brief.toml {RATTLE} --repeats 1": "truth",
    f"study work-precision brief.toml {RATTLE} --repeats 1 --time-limit 0.002 --no-bound": "report",
    "study work-precision brief.toml --engine mujoco": "mujoco",
    "study stability brief.toml --engine one.py:One": "report",
    f"study drift brief.toml {RATTLE} --steps 100": "report"}


@pytest.fixture(scope="module")
def ended(tmp_path_factory):
    """Exit code, output and errors of each command."""
    folder, site = tmp_path_factory.mktemp("here"), tmp_path_factory.mktemp("site")
    (site / "sitecustomize.py").write_text(HIDE.format(hidden=set(errors.EXTRAS)))
    text = (ROOT / "scenarios" / "single_pendulum.toml").read_text()
    (folder / "brief.toml").write_text(text.replace("duration    = 10.0", "duration    = 0.2"))
    (folder / "sweep.toml").write_text('scenes = ["single_pendulum"]\nsteps = [0.01]\nduration = 0.1\nsamples = 2\n'
                                       '[engines]\nlieeuler = ["rattle2"]\n')
    (folder / "arm.urdf").write_text(ARM_URDF)
    (folder / "one.py").write_text("from crosscheck.adapters.lieeuler import LieEuler\n\n\nclass One(LieEuler):\n"
                                   "    methods = ('rattle2',)\n")
    commands = [*WORK, *LACK]
    done = subprocess.run([sys.executable, "-c", DRIVER, json.dumps([command.split() for command in commands])],
                          capture_output=True, text=True, cwd=folder, check=False,
                          env={**os.environ, "PYTHONPATH": str(site), "CROSSCHECK_CACHE": str(folder / "cache")})
    assert done.returncode == 0, done.stderr
    return folder, dict(zip(commands, map(json.loads, done.stdout.splitlines()), strict=True))


@pytest.mark.parametrize("command", WORK)
def test_what_needs_no_extra_works(ended, command):
    code, said, complained = ended[1][command]
    assert code == 0, complained
    assert WORK[command] in said


@pytest.mark.parametrize("command", LACK)
def test_what_lacks_an_extra_names_it_in_one_line(ended, command):
    code, _, complained = ended[1][command]
    assert code == 2, complained
    assert f"pip install 'lieeuler-crosscheck[{LACK[command]}]'" in complained
    said = [line for line in complained.strip().splitlines() if not re.match(r"\d+ s: ", line)]  # but its progress
    assert len(said) == 1, complained


def test_verify_without_the_report_writes_results_and_says_so(ended):
    folder, said = ended
    assert (folder / "report" / "results.json").is_file()
    assert not (folder / "report" / "index.html").exists()
    complained = next(complained for command, (*_, complained) in said.items() if "--out report" in command)
    assert "lieeuler-crosscheck[report]" in complained


FETCHES = ["bisect"]
"""Commands that make environments from the network."""


def test_every_command_is_among_them():
    for name, command in get_command(app).commands.items():
        for full in (f"{name} {part}" for part in getattr(command, "commands", [""])):
            assert any(f"{tried} ".startswith(full) for tried in [*WORK, *LACK, *FETCHES]), full
