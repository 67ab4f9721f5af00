"""Every command in docs/papers.md runs, shortened where it would take minutes."""

from __future__ import annotations

import itertools
import re
import shlex
import subprocess
import sys

import pytest
from typer.testing import CliRunner

import crosscheck
import lieeuler
from crosscheck.cli.app import app
from crosscheck.studies.paper import figures, runs
from tests import ROOT

PAGE = (ROOT / "docs" / "papers.md").read_text("utf-8")
SHORTER = {"crosscheck paper": ["--duration", "0.1", "--step", "0.01", "--format", "svg", "--method", "DAE1L_LSE"],
           "crosscheck study": ["--steps", "2000"], "crosscheck run": ["--duration", "0.1"], "crosscheck support": [],
           "python -m benchmarks.orthogonality": ["--steps", "200"],
           "python -m benchmarks.euler_parameters": ["--steps", "200"], "python -m pytest": ["--collect-only"]}
"""Added to a command, by how it begins; an option given twice counts as it is given last."""


def commands():
    """The commands of the page in its shell blocks and its tables, without the folder of the environment."""
    blocks = re.findall(r"^```sh\n(.*?)^```", PAGE, re.DOTALL | re.MULTILINE)
    lines = [line for block in blocks for line in block.splitlines() if line]
    spans = re.findall(r"`((?:crosscheck|\.venv/bin/python) [^`]+)`", PAGE)
    found = [line.partition("#")[0].strip().replace(".venv/bin/", "") for line in [*lines, *spans]]
    return list(dict.fromkeys(command for command in found if command != "crosscheck study drift"))


FOUR = "single_pendulum double_pendulum triple_pendulum heavy_top"


@pytest.mark.parametrize("command", [
    *(pytest.param(command, marks=pytest.mark.slow if FOUR in command or "euler_parameters" in command else ())
      for command in commands()),
    *(command.replace(FOUR, "heavy_top") for command in commands() if FOUR in command)])
def test_command_runs(command, tmp_path, monkeypatch):
    start = next(start for start in SHORTER if command.startswith(start))
    words = shlex.split(command) + SHORTER[start]
    if words[0] == "python":
        done = subprocess.run([sys.executable, *words[1:]], cwd=ROOT, capture_output=True, text=True)
        assert done.returncode == 0, done.stderr
        return
    monkeypatch.chdir(tmp_path)
    if FOUR not in command:  # drawing takes the longest, and tests/studies/test_paper.py looks at every figure
        drawings = figures.drawings
        monkeypatch.setattr(figures, "drawings", lambda *given: itertools.islice(drawings(*given), 1))
    done = CliRunner().invoke(app, words[1:])
    assert done.exit_code == 0, (done.output, done.exception)


def test_every_method_scene_and_figure_is_named():
    assert set(lieeuler.EULER_METHODS) <= set(re.findall(r"`(DAE\w+)`", PAGE))
    scene = crosscheck.load_scene("single_pendulum").replace(duration=0.05)
    drawn = figures.drawings(runs.measure(scene, runs.Request(step=0.01), lambda what: None), "DAE1L_LSE")
    assert {f"<scene>-{drawing.name.replace('pendulum', '<body>')}" for drawing in drawn} <= set(
        re.findall(r"`(<scene>-[^`]+)`", PAGE))


@pytest.mark.parametrize("spelling", ["DAE1_IELS", "DAE1L_LES"])
def test_other_spellings_of_the_papers_are_answered(spelling):
    with pytest.raises(crosscheck.ArgumentError, match="did you mean 'DAE1L_LSE'"):
        crosscheck.run("single_pendulum", "lieeuler", spelling, step=1e-2)
    with pytest.raises(lieeuler.ArgumentError, match="did you mean DAE1L_LSE"):
        lieeuler.integrate(_problem(), spelling, 1e-2, [0, 1])


def _problem():
    return lieeuler.Problem([lieeuler.Body(1.0, [[1.0, 0, 0], [0, 1.0, 0], [0, 0, 1.0]])], [], [0, 0, 0],
                            x=[[0, 0, 0]], R=[[[1, 0, 0], [0, 1, 0], [0, 0, 1]]], v=[[0, 0, 0]], w=[[0, 0, 0]])
