"""The journal: complete lines survive, a line cut by a kill is dropped, and values are read back as written."""

import json
import math

import numpy as np
import pytest

from crosscheck.document import Errors, Finding, Judged
from crosscheck.document.curves import Packed, RunCurves
from crosscheck.errors import ArgumentError
from crosscheck.jobs.grid import Crash
from crosscheck.jobs.journal import Journal
from crosscheck.verification.job import JOURNAL_TYPES


def opened(path):
    return Journal(path, JOURNAL_TYPES)


def awkward():
    return Judged(
        scene="scene", engine="engine", version="1", method="method", form=None, step=0.1 + 0.2, documented_order=4,
        findings=[Finding("position", "fail", math.inf, 1e-300, "m", "why", "ü→")],
        errors={"position": Errors(unit="m", max=float("nan"), end=np.float64(1 / 3), time=np.int64(2), body="ü")},
        curves=RunCurves(kinetic=Packed(0.0, 0.1 + 0.2, n=3), errors={"position": "truth", "attitude": None}))


def test_a_record_comes_back_with_every_bit(tmp_path):
    path = tmp_path / "journal.jsonl"
    first = opened(path)
    given = first.put("cell", "key", awkward())
    first.close()
    again = opened(path).get("cell", "key")
    for found in (given, again):
        assert isinstance(found, Judged)
        assert found.step == 0.1 + 0.2
        assert found.findings == awkward().findings
        assert math.isnan(found.errors["position"].max)
        assert found.errors["position"].end == 1 / 3
        assert found.curves == awkward().curves
    assert opened(path).get("cell", "another") is None


def test_a_crash_stays_a_crash_with_its_texts(tmp_path):
    path = tmp_path / "journal.jsonl"
    opened(path).put("cell", "key", Crash("it died", "here", error=ValueError("x")))
    found = opened(path).get("cell", "key")
    assert isinstance(found, Crash)
    assert (found.message, found.details) == ("it died", "here")


@pytest.mark.parametrize("cut", [1, 20, 200])
def test_a_line_cut_short_is_dropped_and_written_anew(tmp_path, cut):
    path = tmp_path / "journal.jsonl"
    first = opened(path)
    first.put("speed", "one", [[(1.0, 2.0)]])
    first.put("cell", "two", awkward())
    first.close()
    path.write_bytes(path.read_bytes()[:-cut])
    second = opened(path)
    assert second.get("speed", "one") == [[(1.0, 2.0)]]
    assert second.get("cell", "two") is None
    second.put("cell", "two", awkward())
    second.close()
    assert opened(path).get("cell", "two").step == 0.1 + 0.2
    assert all(json.loads(line) for line in path.read_text(encoding="utf-8").splitlines())


def test_the_time_of_killed_sessions_counts(tmp_path):
    path = tmp_path / "journal.jsonl"
    lines = [{"stage": "speed", "key": str(number), "session": session, "elapsed": elapsed, "result": []}
             for number, (session, elapsed) in enumerate([(1, 10.0), (1, 70.0), (2, 5.0)])]
    path.write_text("".join(json.dumps(line) + "\n" for line in lines), encoding="utf-8")
    journal = opened(path)
    assert 75.0 < journal.seconds < 80.0
    journal.put("speed", "more", [])
    assert json.loads(path.read_text(encoding="utf-8").splitlines()[-1])["session"] == 3


def test_a_file_that_is_no_journal_is_named(tmp_path):
    path = tmp_path / "journal.jsonl"
    path.write_text('{"stage": "cell"}\n', encoding="utf-8")
    with pytest.raises(ArgumentError, match=r"journal.jsonl, line 1: not a line of a journal"):
        opened(path)
