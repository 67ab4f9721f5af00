"""Disks that are full, folders that cannot be written, a clock that goes back, a store that is lost, workers that die:
one line, nothing half written, and the same command goes on.
"""

from __future__ import annotations

import datetime
import json
import os
import random
import resource
import signal
import subprocess
import sys
import threading
import types

import pytest

from crosscheck.errors import ArgumentError
from crosscheck.history import nightly
from crosscheck.jobs import table
from crosscheck.verification import job
from tests.history.test_nightly import FEW, QUICK, TEN, history_names
from tests.killing import rows

SWEEP = {"scenes": ["single_pendulum"], "engines": {"lieeuler": ["rattle2"]}, "steps": [1e-2], "samples": 2,
         "duration": 0.1, "perturb": {"attitude": 1e-3, "count": 100}}
PENDULUM = ("single_pendulum", "--engine", "lieeuler", "--method", "rattle2", "--step", "1e-3")


def commands(folder):
    """Name, words, and the file or folder that the command is to make in `folder`."""
    (folder.parent / "sweep.json").write_text(json.dumps(SWEEP))
    yield "verify", (*QUICK, "--out", str(folder / "report")), "report"
    yield "nightly", (*QUICK, "--out", str(folder / "nights")), "nights"
    yield "study", ("sweep", str(folder.parent / "sweep.json"), "--out", str(folder / "sweep")), "sweep"
    yield "run", (*PENDULUM, "--csv", str(folder / "run.csv")), "run.csv"
    yield "truth", ("single_pendulum", "--csv", str(folder / "truth.csv")), "truth.csv"
    yield "convert", ("chain_64", "--out", str(folder / "chain.xml")), "chain.xml"


def ask(name, words, **more):
    environment = {**os.environ, "COLUMNS": "300", "CROSSCHECK_STORE": "", table.VARIABLE: ""}
    return subprocess.run([sys.executable, "-m", "crosscheck", name, *words], capture_output=True, text=True,
                          env=environment, timeout=1500, **more)


def one_line(done):
    """The last line says what is wrong; there is no traceback."""
    assert done.returncode == 2, done.stdout + done.stderr
    assert "Traceback" not in done.stderr
    return done.stderr.strip().splitlines()[-1]


def full_disk():
    """No file of this process grows beyond 4 kB."""
    resource.setrlimit(resource.RLIMIT_FSIZE, (4096, 4096))


@pytest.mark.parametrize("which", range(6))
def test_a_full_disk_is_one_line_and_leaves_nothing_half(which, tmp_path, monkeypatch):
    monkeypatch.setenv("CROSSCHECK_CACHE", str(tmp_path / "cache"))
    folder = tmp_path / "out"
    folder.mkdir()
    name, words, made = list(commands(folder))[which]
    said = one_line(ask(name, words, preexec_fn=full_disk))
    assert str(folder) in said
    assert "file too large" in said.lower() or "disk I/O error" in said
    if "." in made:
        assert list(folder.iterdir()) == []
    done = ask(name, words)
    assert done.returncode == 0, done.stdout + done.stderr
    assert (folder / made).exists()


@pytest.mark.parametrize("which", range(6))
def test_a_folder_that_cannot_be_written_is_one_line(which, tmp_path):
    (tmp_path / "out").write_text("a file in the place of the folder")
    name, words, _ = list(commands(tmp_path / "out"))[which]
    assert str(tmp_path / "out") in one_line(ask(name, words))


def test_a_clock_that_goes_back_loses_no_night(tmp_path, monkeypatch):
    """The second night is dated before the first: it is the latest all the same, compared with the first, and kept."""
    out = tmp_path / "nights"
    wanted = nightly.Wanted("smoke", ["single_pendulum"], [FEW], 1)
    names = []
    for year in (2031, 2030):
        at = datetime.datetime(year, 1, 1, tzinfo=datetime.UTC)
        clock = types.SimpleNamespace(now=lambda zone, at=at: at)
        monkeypatch.setattr(table, "datetime", types.SimpleNamespace(datetime=clock, UTC=datetime.UTC))
        night = nightly.nightly(out, wanted, tmp_path / "history.sqlite", keep=1)
        names.append(night.folder.name)
    assert (out / "latest").resolve().name == names[1]
    assert (out / names[1] / "results.json").is_file()
    assert len(history_names(out)) == 2


def test_a_store_that_is_lost_in_the_midst_is_one_line_and_nothing_runs_twice(tmp_path):
    out, where = tmp_path / "nights", tmp_path / "history.sqlite"
    wanted = nightly.Wanted("smoke", ["single_pendulum"], [FEW], 1)
    ran = []

    def lose(done, total, label):
        ran.append(label)
        if where.is_file():
            where.unlink()
            where.mkdir()

    with pytest.raises(ArgumentError, match=r"history\.sqlite.*cannot be"):
        nightly.nightly(out, wanted, where, progress=lose)
    kept = rows()
    where.rmdir()
    nightly.nightly(out, wanted, where)
    assert len(ran) == len(kept) == len(rows())
    assert len(history_names(out)) == 1


@pytest.mark.parametrize("moment", range(8))
def test_a_worker_killed_at_each_stage_costs_its_own_run_at_most(moment, tmp_path):
    """Killed within a task, after so many tasks: truth is computed again; a run is an error or unchanged."""
    import psutil

    generator = random.Random(moment)
    undisturbed = {record.method: record for record in job.verify("smoke", ["single_pendulum"], [TEN], 1).records}
    timers = []

    def kill():
        for worker in psutil.Process().children(recursive=True):
            os.kill(worker.pid, signal.SIGKILL)

    def ended(done, total, label):
        if done == moment + 1:
            timers.append(threading.Timer(generator.uniform(0.0, 0.1), kill))
            timers[-1].start()

    found = job.verify("smoke", ["single_pendulum"], [TEN], 1, ended)
    for timer in timers:
        timer.join()
    assert [record.method for record in found.records] == list(undisturbed)
    lost = [record for record in found.records if record.outcome == "error"]
    assert len(lost) <= 1
    for record in found.records:
        if record not in lost:
            assert record.errors == undisturbed[record.method].errors
            assert record.levels == undisturbed[record.method].levels
