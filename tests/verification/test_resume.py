"""`crosscheck verify` continues after a kill, only with the same command and code."""

import json
import os
import signal
import subprocess
import sys
import time

import pytest

from crosscheck.errors import ArgumentError
from crosscheck.jobs.resume import resumable
from tests.history.test_nightly import results, timeless

QUICK = ("--profile", "smoke", "--scene", "single_pendulum", "--engine", "lieeuler", "--jobs", "1", *(
    word for method in ("DAE3L_LE", "DAE2H_LE", "DAE1L_LSE", "rattle2", "rattle4") for word in ("--method", method)))


def command(out, *words):
    return [sys.executable, "-m", "crosscheck", "verify", *words, "--out", str(out)]


def verify(out, *words):
    return subprocess.run(command(out, *words), capture_output=True, text=True, timeout=1500)


def journal_of(out):
    return out.with_name(f".{out.name}.running") / "journal.jsonl"


def killed(out, words, moment):
    """Start a run and kill it when its journal has so many lines."""
    process = subprocess.Popen(command(out, *words), stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    while process.poll() is None:
        if journal_of(out).exists() and journal_of(out).read_bytes().count(b"\n") >= moment:
            process.send_signal(signal.SIGKILL)
        time.sleep(0.01)
    return process.returncode == -signal.SIGKILL


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory):
    out = tmp_path_factory.mktemp("verify") / "out"
    done = verify(out, *QUICK)
    assert done.returncode == 0, done.stdout + done.stderr
    assert [path.name for path in out.parent.iterdir()] == ["out"]
    return results(out)


def document(report):
    return {key: value for key, value in timeless(report).items() if key != "meta"}


def test_a_killed_run_goes_on_and_ends_as_if_nothing_had_happened(undisturbed, tmp_path):
    out = tmp_path / "out"
    for moment in (1, 4):
        assert killed(out, QUICK, moment)
        assert not out.exists()
    ended = {json.loads(line)["key"]: line for line in journal_of(out).read_bytes().splitlines()}
    kept = tmp_path / "journal.jsonl"
    kept.hardlink_to(journal_of(out))  # the run removes its journal at the end
    done = verify(out, *QUICK)
    assert done.returncode == 0, done.stdout + done.stderr
    assert f"going on with a run that was killed: {len(ended)} results are kept" in done.stderr
    again = {json.loads(line)["key"]: line for line in kept.read_bytes().splitlines()}
    assert ended.items() <= again.items()  # nothing that had ended was run again
    assert document(results(out)) == document(undisturbed)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["journal.jsonl", "out"]


def test_another_command_starts_anew(undisturbed, tmp_path):
    out = tmp_path / "out"
    assert killed(out, QUICK, 2)
    done = verify(out, *QUICK, "--tol", "position=1")
    assert done.returncode == 0, done.stdout + done.stderr
    assert "going on" not in done.stderr
    assert [path.name for path in tmp_path.iterdir()] == ["out"]


def kept(out, identity, stages=None):
    with resumable(out, identity, {"stage": int}) as found:
        for number in stages or ():
            found.journal.put("stage", str(number), number)
        if stages:
            raise MemoryError
        return found.results, os.listdir(out.parent)


def test_an_error_keeps_what_ended_and_an_interrupt_nothing(tmp_path):
    out = tmp_path / "out"
    with pytest.raises(MemoryError):
        kept(out, "one", [1, 2])
    assert kept(out, "one")[0] == 2
    assert kept(out, "one")[0] == 0  # that one ended
    with pytest.raises(MemoryError):
        kept(out, "one", [1, 2])
    assert kept(out, "another")[0] == 0
    with pytest.raises(KeyboardInterrupt), resumable(out, "one", {}):
        raise KeyboardInterrupt
    assert list(tmp_path.iterdir()) == []


def test_two_runs_at_once_share_no_journal(tmp_path):
    with resumable(tmp_path / "out", "one", {}) as first, resumable(tmp_path / "out", "one", {}) as second:
        assert first.journal is not None
        assert second.journal is None


def test_a_journal_that_cannot_be_written_is_one_line(tmp_path):
    (tmp_path / ".out.running").write_text("a file")
    with pytest.raises(ArgumentError, match="cannot be written"), resumable(tmp_path / "out", "one", {}):
        pass
