"""Engines that crash, hang, return NaN, eat memory or print: each costs one verdict, and the report is complete."""

import concurrent.futures
import json
import multiprocessing
import subprocess
import sys
import time
from pathlib import Path

import pytest

from crosscheck import report as folder
from crosscheck.errors import ArgumentError
from crosscheck.jobs import drive
from crosscheck.jobs.workers.process import GIGABYTE, Limits, isolated
from crosscheck.verification import job
from crosscheck.verification.job import limits_of
from tests import ROOT
from tests.engines.faults import be_busy, sleep_for, square_or_die

REASONS = {
    "Killed": "SIGKILL (killed from outside",
    "NotANumber": "the state is not finite at t = ",
    "Segfaulting": "SIGSEGV (a crash inside the engine",
    "Hungry": "more memory than the limit of 0.8 GB resident",
    "HungryChild": "more memory than the limit of 0.8 GB resident",
    "Chatting": "it printed {lines} lines, first: Traceback (most recent call last): ??[31m{{",
    "Exiting": "ended the process (exit code 0)",
    "Odd": "run returned list; it has to return crosscheck.scene.states.States",
    "Raising": "Local: no such luck, half \\ud800 of a character",
    "Moody": "SIGSEGV (a crash inside the engine",
}


def bad(name):
    return f"tests/engines/faults.py:{name}"


@pytest.fixture(scope="module")
def ended(tmp_path_factory):
    """A run of all of them and of a right one, and how many lines were printed: two in each run of `Chatting`."""
    names, told = [*(bad(name) for name in REASONS), "mujoco"], tmp_path_factory.mktemp("chatting") / "runs"
    with pytest.MonkeyPatch.context() as changed:
        changed.setenv("CROSSCHECK_TEST_RUNS", str(told))
        done = job.verify("smoke", ["single_pendulum"], names, methods=["Rest", "RK4"],
                          limits=limits_of(300.0, 0.8))
    return done, 2 * told.stat().st_size


@pytest.fixture(scope="module")
def results(ended):
    return ended[0]


@pytest.mark.parametrize("name", REASONS)
def test_every_failure_is_one_failed_verdict_with_its_reason(ended, name):
    results, lines = ended
    assert lines >= 12  # the main run, that of its intervals and the ladder
    reason = REASONS[name].format(lines=lines)
    record, = [record for record in results.records if record.engine == bad(name)]
    assert record.outcome in ("fail", "error")
    findings = [finding for finding in record.findings if finding.kind == "asked end" and finding.status == "fail"]
    assert len(findings) == 1
    assert reason in findings[0].detail
    assert reason in record.message


def test_an_engine_that_hangs_is_one_failed_verdict(tmp_path):
    results = job.verify("smoke", ["single_pendulum"], [bad("Hanging")], limits=limits_of(4.0, 0.8))
    record, = results.records
    assert record.outcome == "error"
    assert record.message == "stopped: it did not end within the time limit of 4 s"
    assert results.exit_code == 1
    assert record.message in folder.write(results, tmp_path / "report").read_text(encoding="utf-8")


def test_the_rest_goes_on(results):
    other, = (record for record in results.records if record.engine == "mujoco")
    assert other.outcome == "pass"
    assert results.exit_code == 1


def test_the_report_is_complete(results, tmp_path):
    page = folder.write(results, tmp_path / "report")
    document = json.loads((page.parent / "results.json").read_text(encoding="utf-8"))
    assert [record["label"] for record in document["records"]] == [record.label for record in results.records]
    shown = page.read_text(encoding="utf-8")
    for name in REASONS:
        assert bad(name) in shown
    assert not {"\x00", "\x1b"} & set(shown)


def test_times_are_measured_without_the_engine_that_ends_it():
    from crosscheck.document import Errors, Record
    from crosscheck.verification.speed import measure_speed

    errors = {"position": Errors(unit="m", end=1e-3, max=1e-3, time=1.0, body="pendulum", size=1.0)}
    records = [Record(engine, method, 1e-2, scene="single_pendulum", version="1", duration=1.0, steps=100,
                      errors=errors, us_per_step=1.0, outcome="pass")
               for engine, method in (("mujoco", "RK4"), (bad("Segfaulting"), "Rest"), ("mujoco", "Euler"))]
    made, _ = measure_speed(records, "default", drive.Stages(1, None, lambda label: None))
    assert [each.speed is not None for each in made] == [True, False, True]
    assert [each.outcome for each in made] == ["pass", "fail", "pass"]
    assert "SIGSEGV" in made[1].findings[-1].detail
    assert all(each.us_per_step != 1.0 for each in made[::2])


def test_a_worker_lives_on_and_its_successor_too():
    results = drive.run_tasks(square_or_die, [2, -1, 3, -2, 4], 1)
    assert [results[index] for index in (0, 2, 4)] == [4, 9, 16]
    assert "SIGKILL" in results[1].message
    assert results[3].message == "ValueError: minus two is not liked"
    assert isinstance(results[3].error(), ValueError)


def test_the_time_limit_is_that_of_each_task():
    results = drive.run_tasks(sleep_for, [2.2, 2.2, 60.0, 0.1], 1, limits=Limits(time=4.0))
    assert [results[index] for index in (0, 1, 3)] == [2.2, 2.2, 0.1]
    assert results[2].message == "stopped: it did not end within the time limit of 4 s"


def test_processor_time_does_not_count_waiting():
    assert isolated(sleep_for, 2.0, Limits(processor=1.0)) == 2.0
    assert isolated(be_busy, None, Limits(processor=1.0)).message == (
        "stopped: it did not end within 1 s of processor time")


def test_limits_are_positive():
    assert limits_of(10.0, 2.0) == Limits(10.0, 2.0 * GIGABYTE)
    for wrong in ({"time_limit": 0.0}, {"memory_limit": -1.0}, {"time_limit": float("nan")}):
        with pytest.raises(ArgumentError, match=next(iter(wrong)).replace("_", "-")):
            limits_of(**wrong)


def forks(number):
    return concurrent.futures.ProcessPoolExecutor(number, mp_context=multiprocessing.get_context("fork"))


@pytest.mark.parametrize("executor", [concurrent.futures.ThreadPoolExecutor, forks])
def test_another_executor_runs_the_same_workers(executor):
    assert isolated(square_or_die, 2) == 4  # by a worker of this process, which a fork of it cannot use
    with executor(1) as pool, drive.Place(2, pool) as place:
        results = drive.run_tasks(square_or_die, [3, -1, 5], limits=Limits(time=30.0), place=place)
    assert (results[0], results[2]) == (9, 25)
    assert "SIGKILL" in results[1].message


def test_what_cannot_travel_is_told():
    lost = drive.run_tasks(lambda task: task, [1], 1)[0]
    assert "cannot be sent to a worker" in lost.message
    assert "cannot be sent" in drive.run_tasks(square_or_die, [lambda: None], 1)[0].message


@pytest.mark.skipif(not Path("/proc/self").exists(), reason="reads /proc")
def test_a_worker_ends_with_its_parent(tmp_path):
    told = tmp_path / "pid"
    program = ("import pathlib, sys; from crosscheck.jobs import drive; from tests.engines import faults; "
               "drive.run_tasks(faults.tell_and_sleep, [pathlib.Path(sys.argv[1])], 1)")
    parent = subprocess.Popen([sys.executable, "-c", program, str(told)], cwd=ROOT)
    await_true(lambda: told.exists() and told.read_text())
    parent.kill()
    parent.wait()
    await_true(lambda: not Path(f"/proc/{told.read_text()}").exists())


def await_true(condition, watchdog=120.0):
    began = time.monotonic()
    while not condition():
        assert time.monotonic() - began < watchdog
        time.sleep(0.1)
