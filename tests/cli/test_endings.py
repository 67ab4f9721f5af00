"""How commands end, by mistakes of the user and of ours, and the lines while they work."""

import contextlib
import io
import json
import re
import subprocess
import sys
import time
from contextlib import redirect_stderr
from pathlib import Path

import pytest

from crosscheck import errors
from crosscheck.cli import console
from crosscheck.cli.app import COMMANDS, main
from crosscheck.files import cache_folder
from tests import ROOT
from tests.commands import crosscheck


@pytest.mark.parametrize(("error", "code", "words"), [
    (KeyError("elbow"), 70, "internal error, a mistake of crosscheck: KeyError: 'elbow' (test_endings.py, line "),
    (ZeroDivisionError("float division by zero"), 70, "please report it"),
    (ImportError("cannot import name 'x'"), 70, "internal error"),
    (ModuleNotFoundError("no", name="crosscheck.lost"), 70, "internal error"),
    (errors.EngineError("it fell over"), 2, "crosscheck: it fell over"),
    (ModuleNotFoundError("no", name="pandas"), 2, "pip install"),
    (PermissionError(13, "Permission denied", "/kept/log.csv"), 2, "crosscheck: /kept/log.csv: Permission denied")])
def test_a_mistake_of_ours_is_told_from_one_of_the_user(monkeypatch, error, code, words):
    def raising():
        raise error

    monkeypatch.setattr("crosscheck.cli.app.app", raising)
    complained = io.StringIO()
    with redirect_stderr(complained), pytest.raises(SystemExit) as end:
        main()
    assert end.value.code == code
    assert words in complained.getvalue()
    assert complained.getvalue().count("\n") == 1


def test_there_is_a_line_after_every_pause_however_long_one_task_takes(monkeypatch):
    monkeypatch.setattr(console, "PAUSE", 0.05)
    complained = io.StringIO()
    with redirect_stderr(complained), console.at_work("crosscheck judge"):
        time.sleep(0.2)
        for task in range(8):  # none of which lasts as long as a pause
            with console.progress_bar("three runs") as progress:
                progress(task, 8, "the longest")
                time.sleep(0.04)
        time.sleep(0.2)
    lines = complained.getvalue().splitlines()
    assert lines[0] == "0 s: crosscheck judge"
    assert any(line.endswith(" of 8 done, the longest") for line in lines)
    assert lines[-1] == "1 s: crosscheck judge"
    assert 8 <= len(lines) <= 15


HELPED = """import contextlib, io, json, sys
from crosscheck.cli.app import main
for words in json.loads(sys.argv[1]):
    sys.argv = ["crosscheck", *words]
    with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
        try:
            main()
        except SystemExit as end:
            assert end.code == (0 if "--help" in words else 2), words
print(json.dumps(sorted(sys.modules)))
"""


def test_help_and_a_mistyped_option_import_neither_scenes_nor_engines():
    words = [["--help"], ["study", "drift", "--help"], ["history", "list", "--hlep"],
             *([name, option] for name in COMMANDS for option in ("--help", "--hlep"))]
    done = subprocess.run([sys.executable, "-c", HELPED, json.dumps(words)], capture_output=True, text=True,
                          timeout=120, check=True)
    imported = json.loads(done.stdout)
    own = {name for name in imported if name.startswith(("crosscheck.", "lieeuler"))}
    assert {name for name in own if not name.startswith("crosscheck.cli")} == {
        "crosscheck.errors", "crosscheck.files", "crosscheck.jobs", "crosscheck.jobs.threads"}
    assert not {"numpy", "scipy", "msgspec", "sqlalchemy", "psutil", "rich", "jinja2"} & {*imported}
    assert len(imported) < 500  # of which Typer's are the most


def test_help_leads_with_the_commands_that_answer_a_question():
    told = crosscheck("--help").stdout
    assert [*COMMANDS] == ["verify", "judge", "run", "advise", "inspect", "explain", "study", "linearise", "truth",
                           "convert", "nightly", "history", "list", "bisect", "report"]
    places = [told.index(words) for words in ("\nCommands that answer a question:\n", *(
        f"\n  {name} " for name in [*COMMANDS][:5]), "\nOthers:\n", *(f"\n  {name} " for name in [*COMMANDS][5:]))]
    assert places == sorted(places)
    assert max(map(len, told.splitlines())) <= 80


NOISY = """import warnings
import numpy as np
from crosscheck.adapters.base import steps_per_sample
from mine import PivotRK4

class Noisy(PivotRK4):
    def run(self, scene, spec):
        for value in range(240):
            np.float64(1.0) / np.float64(0.0)
        for value in range(5):
            warnings.warn(f"step {value} is coarse", UserWarning)
        return super().run(scene, spec)
"""


def test_warnings_of_an_engine_are_counted_and_told_in_one_line(tmp_path):
    (tmp_path / "mine.py").write_text((ROOT / "examples" / "my_engine.py").read_text("utf-8"), "utf-8")
    (tmp_path / "noisy.py").write_text(NOISY, "utf-8")
    done = subprocess.run([sys.executable, "-m", "crosscheck", "run", "single_pendulum", "--engine", "noisy.py:Noisy",
                           "--method", "RK4", "--step", "1e-2", "--duration", ".1", "--csv", "-"], cwd=tmp_path,
                          capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr
    line, = (line for line in done.stderr.splitlines() if not re.match(r"\d+ s: ", line))  # progress, of a busy machine
    assert line.startswith("crosscheck: 245 warnings: RuntimeWarning: divide by zero encountered in scalar divide "
                           "(noisy.py, line 9), 240 times; UserWarning: step 0 is coarse (noisy.py, line 11); ")
    assert line.endswith("; and 3 other places")


ARM = """<mujoco><worldbody><body name="arm"><joint name="elbow" axis="0 1 0" frictionloss=".01"/>
<inertial pos=".5 0 0" mass="1" diaginertia=".01 .02 .02"/></body></worldbody></mujoco>
"""


@pytest.mark.parametrize("words", [
    ("verify", "--engine", "mujoco", "--method", "Euler", "--profile", "smoke", "--drop", "--format", "github",
     "--budget", "0.01"),
    ("run", "--engine", "mujoco", "--method", "Euler", "--step", "1e-2", "--duration", "0.5"), ("inspect",)])
def test_sentences_name_the_model_of_the_user_and_no_file_of_the_cache(tmp_path, monkeypatch, words):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "my robots").mkdir()
    (tmp_path / "my robots" / "arm.xml").write_text(ARM, "utf-8")
    command, *options = words
    done = crosscheck(command, "my robots/arm.xml", *options, *(["--out", "out"] if command == "verify" else []))
    assert done.returncode in (0, 1, 3), done.stderr
    texts = {"stdout": done.stdout, "stderr": done.stderr} | {
        file.name: file.read_text("utf-8") for file in tmp_path.glob("out/*") if file.name != "plotly.min.js"}
    assert not [name for name, text in texts.items() if str(cache_folder()) in text]
    if command == "verify":
        record, = json.loads(texts["results.json"])["records"]
        assert record["scene"] == "my robots/arm.xml"
        assert record["command"].startswith("crosscheck run 'my robots/arm.xml' --drop --engine mujoco --method Euler ")


@pytest.mark.parametrize(("command", "said"), [
    (("verify", "--tol", "posituon=1"), "did you mean 'position'?"), (("verify", "--method", "RK5"), "RK5"),
    (("verify", "--engine", "mujco"), "mujco"), (("run", "--method", "rattle3", "--step", "1"), "rattle2"),
    (("explain", "--engine", "mujoco", "--method", "RK5"), "RK4"),
    (("advise", "--engine", "mujco", "--error", "1e-3"), "mujco"),
    (("judge", "log.csv", "--tol", "joint_posituon=1"), "did you mean 'joint_position'?")])
def test_what_is_mistyped_is_refused_before_a_model_is_read(tmp_path, monkeypatch, command, said):
    monkeypatch.setattr("crosscheck.scene.models.table", None)  # to read a model is an internal error now
    (tmp_path / "arm.xml").write_text(ARM, encoding="utf-8")
    done = crosscheck(command[0], str(tmp_path / "arm.xml"), *command[1:])
    assert done.returncode == 2, done.stderr
    assert said in done.stderr
    assert crosscheck("truth", str(tmp_path / "arm.xml")).returncode == 70


def test_progress_names_the_file_of_the_user(tmp_path, monkeypatch):
    """A model is read from its scene file in the cache folder."""
    told = []

    def job(profile, scenes, engines, jobs, progress, *_, **__):
        progress(0, 2, f"truth of {Path(scenes[0]).name}")
        raise errors.EngineError("enough")

    monkeypatch.setattr("crosscheck.verification.job.verify", job)
    monkeypatch.setattr("crosscheck.cli.verify.progress_bar", lambda _: contextlib.nullcontext(
        lambda done, total, label: told.append(label)))
    (tmp_path / "rod.xml").write_text(ARM, encoding="utf-8")
    file, out = (str(tmp_path / name) for name in ("rod.xml", "out"))
    done = crosscheck("verify", file, "--drop", "--engine", "lieeuler", "-o", out)
    assert "enough" in done.stderr
    assert told == ["truth of rod.xml"]


@pytest.mark.parametrize(("old", "new", "told"), [
    (("diff", "double_pendulum", "double_pendulum"), "inspect", "the same motion"),
    (("support", "--engine", "lieeuler", "--no-reasons"), "list --support", "loop with redundant rows"),
    (("paper", "nowhere"), "report --format paper", ""), (("law", "--help"), "advise", "--error"),
    (("sweep", "--help"), "study sweep", "--dry-run"),
    (("derivatives", "hinge_pendulum", "--source", "mujoco"), "linearise", "known to"),
    (("modes", "bicycle"), "linearise --modes", "1/s"),
    (("import", "nowhere.urdf", "-o", "x.toml"), "convert", ""),
    (("export", "heavy_top", "-o", "x.txt"), "convert", ""),
    (("reproduce", "heavy_top", "--duration", "0.1"), "run --script --engine mujoco --method RK4 --step 1e-3",
     "import mujoco")])
def test_a_former_command_names_the_new_one_once_and_runs_it(old, new, told):
    done = crosscheck(*old)
    assert done.stderr.splitlines()[0] == f"crosscheck: crosscheck {old[0]} is now: crosscheck {new}"
    assert done.stderr.count("is now") == 1
    assert told in done.stdout
    again = crosscheck(*new.split(), *old[1:])
    assert (again.returncode, again.stdout) == (done.returncode, done.stdout)


def test_the_former_option_of_inspect_names_the_command():
    done = crosscheck("inspect", "hinge_pendulum", "--derivatives")
    assert done.returncode == 2
    assert done.stderr == (
        "crosscheck: inspect --derivatives is now: crosscheck linearise SCENE --source ENGINE\n")


def test_the_former_option_of_a_second_model_is_taken():
    done, again = (crosscheck("inspect", "double_pendulum", *more, "heavy_top") for more in (("--against",), ()))
    assert done.stderr.splitlines()[0] == "crosscheck: inspect A --against B is now: crosscheck inspect A B"
    assert (done.returncode, done.stdout) == (again.returncode, again.stdout)


@pytest.mark.parametrize(("old", "new"), [
    (("--map", "cayley"), "coordinate_map=cayley"), (("--map=cayley",), "coordinate_map=cayley"),
    (("--reduce", "off"), "reduce=off"), (("--no-conserve",), "conserve=false")])
def test_a_former_option_names_the_new_one_once_and_is_taken(old, new):
    run = "run", "single_pendulum", "--method", "rattle2", "--step", "0.1", "--duration", "0.2", "--csv", "-"
    done, again = crosscheck(*run, *old), crosscheck(*run, "--set", new)
    assert done.stderr.splitlines()[0] == f"crosscheck: {old[0].partition('=')[0]} is now: --set {new}"
    assert done.stderr.count("is now") == 1
    assert (again.returncode, again.stdout) == (done.returncode, done.stdout)
