"""How commands end, by mistakes of the user and of ours, and the lines while they work."""

import io
import json
import subprocess
import sys
import time
from contextlib import redirect_stderr

import pytest

from crosscheck import errors
from crosscheck.cli import console
from crosscheck.cli.app import COMMANDS, main


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
