"""`crosscheck verify` computes only what is missing: after a kill, when it is repeated, and when it asks for more."""

import os
import random
import re
import signal
import subprocess
import sys

import pytest

from crosscheck.errors import ArgumentError
from crosscheck.jobs import table
from crosscheck.report import is_complete, write
from crosscheck.verification import job
from tests.commands import crosscheck
from tests.killing import killed, results, rows, timeless

QUICK = ("--profile", "smoke", "--scene", "single_pendulum", "--engine", "lieeuler", "--jobs", "1", *(
    word for method in ("DAE1L_LSE", "rattle2", "rattle4") for word in ("--method", method)))


def command(out, *words):
    return {"args": [sys.executable, "-m", "crosscheck", "verify", *words, "--out", str(out)],
            "text": True, "stdout": subprocess.PIPE, "stderr": subprocess.PIPE}


def verify(out, *words):
    """A run in a process of its own."""
    return subprocess.run(**command(out, *words), timeout=1500)


def here(out, *words):
    """A run in this process."""
    return crosscheck("verify", *words, "--out", str(out))


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory):
    out = tmp_path_factory.mktemp("verify") / "out"
    done = here(out, *QUICK)
    assert done.returncode == 0, done.stdout + done.stderr
    assert [path.name for path in out.parent.iterdir()] == ["out"]
    return results(out)


def document(report):
    return {key: value for key, value in timeless(report).items() if key != "meta"}


def said(done, words):
    return words in " ".join(done.stdout.split())


@pytest.mark.parametrize("fresh", [(), ("--fresh",)])
def test_a_killed_run_goes_on_and_ends_as_if_nothing_had_happened(undisturbed, tmp_path, fresh):
    out = tmp_path / "out"
    assert killed(command(out, *QUICK, *fresh), 2)
    assert not is_complete(out)
    before = rows()
    done = here(out, *QUICK, *fresh)
    assert done.returncode == 0, done.stdout + done.stderr
    assert f"going on with a run that was killed: {len(before)} results are kept" in done.stderr
    assert set(before) <= set(rows())
    assert len({key for key, _ in rows()}) == len(rows()) == 4  # nothing that had ended was run again
    assert document(results(out)) == document(undisturbed)
    assert [path.name for path in tmp_path.iterdir()] == ["out"]
    if not fresh:
        asking_again_computes_nothing(undisturbed, tmp_path)


def asking_again_computes_nothing(undisturbed, tmp_path):
    """It says so, unless it is told to start afresh."""
    before = rows()
    done = here(tmp_path / "second", *QUICK)
    assert rows() == before
    assert said(done, "4 results from earlier runs, since ")
    assert document(results(tmp_path / "second")) == document(undisturbed)
    anew = here(tmp_path / "third", *QUICK, "--fresh")
    assert not said(anew, "from earlier runs")
    assert sorted(key for key, _ in rows()) == sorted(2 * [key for key, _ in before])


def test_ci_computes_everything_anew_by_default():
    code = ("from typer.main import get_command\nfrom crosscheck.cli.app import app\n"
            "commands = get_command(app).commands\n"
            "both = commands['study'].commands['sweep'], commands['verify']\n"
            "print(*(each.default for one in both for each in one.params\n"
            "        if each.name == 'fresh'))")
    done = subprocess.run([sys.executable, "-c", code], env={**os.environ, "CI": "true"}, text=True,
                          capture_output=True, check=True)
    assert done.stdout.split() == ["True"] * 2  # and elsewhere not: above


def test_the_page_fills_as_runs_end(tmp_path, monkeypatch):
    monkeypatch.setattr(job, "PAUSE", 0.0)
    monkeypatch.setattr(job, "SHARE", 1e9)
    parts = []
    whole = job.verify("smoke", ["single_pendulum"], ["lieeuler"], 1, methods=["DAE1L_LSE", "rattle2", "rattle4"],
                       on_results=parts.append)
    assert [(len(part.records), part.meta.left) for part in parts] == [(0, 3), (1, 2), (2, 1), (3, 0)]
    assert parts[-1].records == whole.records
    for part, filling in ((parts[0], "3 tasks"), (parts[1], "2 tasks"), (whole, "")):
        page = write(part, tmp_path / "out")
        assert is_complete(tmp_path / "out") != bool(filling)
        text = page.read_text("utf-8")
        assert f"{filling} have not ended" in text if filling else "have not ended" not in text


def test_a_budget_tells_what_has_ended_cheap_runs_first_and_the_rest_goes_on(tmp_path, monkeypatch):
    monkeypatch.setattr(job, "PAUSE", 0.0)
    monkeypatch.setattr(job, "SHARE", 1e9)
    scenes, parts, told = ["single_pendulum", "triple_pendulum"], {}, []
    for budget in (None, 1e-3):
        parts[budget] = []
        whole = job.verify("smoke", scenes, ["lieeuler"], 1, methods=["rattle2"], on_results=parts[budget].append,
                           budget=budget, on_budget=told.append)
    assert [parts[budget][1].records[0].scene for budget in (None, 1e-3)] == ["triple_pendulum", "single_pendulum"]
    assert [(part.meta.left > 0, len(part.records)) for part in told] == [(True, 0)]
    assert (len(whole.records), whole.meta.left) == (2, 0)
    with pytest.raises(ArgumentError, match=r"^budget: a positive number"):
        job.verify("smoke", scenes, budget=0.0)


def test_the_first_line_of_a_budget_is_provisional_and_a_kill_after_it_loses_nothing(undisturbed, tmp_path):
    out = tmp_path / "out"
    with subprocess.Popen(**command(out, *QUICK, "--budget", "0.001"), start_new_session=True) as process:
        first = process.stdout.readline()
        os.killpg(process.pid, signal.SIGKILL)
    assert re.fullmatch(r"provisional: unresolved: no run has ended yet: truth is being computed, which every run "
                        r"needs; [1-9]\d* tasks left after \d+ s; "
                        r"\S+/out/index.html\n",
                        first)
    assert "Provisional." in (out / "index.html").read_text("utf-8")
    assert results(out)["meta"]["left"] > 0
    done = here(out, *QUICK)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "provisional" not in done.stdout
    assert document(results(out)) == document(undisturbed)


def test_thirty_kills_at_random_moments(undisturbed, tmp_path):
    generator = random.Random(35)
    kills = 0
    for _ in range(30):
        out = tmp_path / "out"
        if is_complete(out):  # it had ended: the table is emptied, and it starts anew
            assert document(results(out)) == document(undisturbed)
            os.remove(os.environ[table.VARIABLE])
            out.rename(tmp_path / f"out{kills}")
        kills += killed(command(out, *QUICK), generator.choice(range(4)), generator.uniform(0.0, 0.5))
    done = verify(tmp_path / "out", *QUICK)
    assert done.returncode == 0, done.stdout + done.stderr
    assert document(results(tmp_path / "out")) == document(undisturbed)
    assert len({key for key, _ in rows()}) == len(rows()) == 4
    assert kills >= 25


def test_asking_for_more_computes_the_rest(tmp_path):
    few = QUICK[:-4]
    assert here(tmp_path / "few", *few).returncode == 0
    before = rows()
    done = here(tmp_path / "more", *QUICK)
    assert said(done, f"{len(before)} results from earlier runs")
    assert len(rows()) == len(before) + 2
    strict = here(tmp_path / "strict", *QUICK, "--tol", "position=1e-30")
    assert strict.returncode == 1  # another bound is another verdict
    assert said(strict, "1 result from earlier runs")  # the truth


def test_an_edited_engine_is_computed_again(tmp_path, monkeypatch):
    """An edited helper of it is as well, and one that stays is not: tests/adapters/test_own_code.py."""
    monkeypatch.chdir(tmp_path)
    engine = tmp_path / "engine.py"
    engine.write_text("from crosscheck.adapters.lieeuler import LieEuler\n\n\n"
                      "class Mine(LieEuler):\n    methods = ('rattle2',)\n", "utf-8")
    counts = []
    for more in ("", "# edited\n"):
        engine.write_text(engine.read_text("utf-8") + more, "utf-8")
        done = here(tmp_path / "out", "--profile", "smoke", "--scene", "single_pendulum", "--engine",
                    "engine.py:Mine", "--jobs", "1")
        assert done.returncode == 0, done.stdout + done.stderr
        counts.append(len(rows()))
    assert counts == [2, 3]


def test_a_resumed_run_takes_no_row_of_an_engine_that_was_edited_meanwhile(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "helper.py").write_text("METHODS = ('rattle4', 'rattle2')\n", "utf-8")
    (tmp_path / "engine.py").write_text(
        "import time, helper\nfrom crosscheck.adapters.lieeuler import LieEuler\n\n\nclass Mine(LieEuler):\n"
        "    methods = helper.METHODS\n    def run(self, scene, spec):\n"
        "        if spec.method == 'rattle2':\n            time.sleep(30)\n"
        "        return super().run(scene, spec)\n",
        "utf-8")
    words = ("--profile", "smoke", "--scene", "single_pendulum", "--engine", "engine.py:Mine", "--jobs", "1")
    assert killed(command(tmp_path / "out", *words), 2)  # the truth and rattle4; rattle2 is asleep
    before = {key for key, _ in rows()}
    (tmp_path / "helper.py").write_text("METHODS = ('rattle4',)\n", "utf-8")
    done = verify(tmp_path / "out", *words)
    assert done.returncode == 0, done.stdout + done.stderr
    assert len({key for key, _ in rows()} - before) == 1


def test_a_run_that_was_killed_is_tried_again(tmp_path):
    (tmp_path / "engine.py").write_text(
        "import os, pathlib\nfrom crosscheck.adapters.lieeuler import LieEuler\n\n\nclass Mine(LieEuler):\n"
        "    def run(self, scene, spec):\n"
        f"        mark = pathlib.Path({str(tmp_path / 'mark')!r})\n"
        "        if not mark.exists():\n            mark.touch()\n            os.kill(os.getpid(), 9)\n"
        "        return super().run(scene, spec)\n", "utf-8")
    words = ("--profile", "smoke", "--scene", "single_pendulum", "--engine", f"{tmp_path / 'engine.py'}:Mine",
             "--method", "rattle2", "--jobs", "1")
    first = here(tmp_path / "out", *words)
    assert said(first, "SIGKILL"), first.stdout
    assert (first.returncode, len(rows())) == (1, 1)
    assert here(tmp_path / "out", *words).returncode == 0
    assert len(rows()) == 2
