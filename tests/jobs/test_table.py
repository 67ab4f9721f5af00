"""The table: rows come back with every bit, sessions continue after kills, and speed stays with its own."""

import math
import os
import sqlite3
import subprocess
import sys
import threading

import numpy as np
import pytest

from crosscheck.document import Errors, Finding, Record
from crosscheck.document.curves import Packed, RunCurves
from crosscheck.errors import ArgumentError
from crosscheck.files import digest
from crosscheck.jobs import table as tables
from crosscheck.jobs.table import Table
from crosscheck.verification.job import ROW_TYPES
from tests import ROOT
from tests.databases import on_server


@pytest.fixture(params=[True, False], ids=["file", "server"])
def place(request, monkeypatch):
    """A table of each kind."""
    if not request.param:
        monkeypatch.setenv(tables.VARIABLE, on_server(request))
    return os.environ[tables.VARIABLE]


def asked(ask="one", fresh=False, types=ROW_TYPES):
    return Table.opened().session(ask, "crosscheck verify", types, fresh)


def killed(ask="one", fresh=False, **rows):
    """A session that puts these rows and does not end."""
    ended_by(MemoryError, ask, fresh, lambda session: [
        session.put("speed" if isinstance(value, float) else "stage", key, value) for key, value in rows.items()])


def ended_by(error, ask, fresh, work, types={"stage": int, "speed": float}):  # noqa: B006 - nobody changes it
    """A session that does this work and is then ended by an error."""
    def whole():
        with asked(ask, fresh, types) as session:
            work(session)
            raise error

    with pytest.raises(error):
        whole()


def awkward():
    return Record(
        scene="scene", engine="engine", version="1", method="method", form=None, step=0.1 + 0.2, documented_order=4,
        findings=[Finding("position", "fail", math.inf, 1e-300, "m", "why", "ü→")],
        errors={"position": Errors(unit="m", max=float("nan"), end=np.float64(1 / 3), time=np.int64(2), body="ü")},
        curves=RunCurves(kinetic=Packed(0.0, 0.1 + 0.2, n=3), errors={"position": "truth", "attitude": None}))


def test_a_record_comes_back_with_every_bit(place):
    with asked() as session:
        given = session.put("cell", "key", awkward())
    with asked("another") as session:
        again = session.get("cell", "key")
        assert session.get("cell", "another") is None
        assert session.get("truth", "key") is None
    for found in (given, again):
        assert isinstance(found, Record)
        assert found.step == 0.1 + 0.2
        assert found.findings == awkward().findings
        assert math.isnan(found.errors["position"].max)
        assert found.errors["position"].end == 1 / 3
        assert found.curves == awkward().curves


def test_a_fresh_session_takes_only_its_own_rows_also_after_a_kill(place):
    killed(old=1)
    killed(ask="two", fresh=True, own=2)
    types = {"stage": int, "speed": float}
    with asked("two", True, types) as session:
        assert session.continued
        assert session.left == 1
        assert (session.get("stage", "own"), session.get("stage", "old")) == (2, None)
        assert session.get("stage", "old", ever=True) == 1
        session.put("stage", "old", 3)
    with asked("three", False, types) as session:
        assert not session.continued
        assert session.get("stage", "old") == 3  # the newest
        assert session.reused == 1
    with asked("one", False, types) as session:  # the first one still waits to be continued
        assert session.continued
        assert session.get("stage", "old") == 3


def test_speed_is_of_the_session_that_measured_it_unless_nothing_is_computed(place):
    killed(row=1, fast=0.5)
    types = {"stage": int, "speed": float}
    with asked("one", False, types) as session:
        assert session.kept("speed", ["fast"], "samples") == {"fast": 0.5}  # it was killed, and goes on
        assert session.reused == 0
    with asked("two", False, types) as session:
        assert not session.kept("speed", ["fast"], "samples")
    for _ in range(3):  # a session that only read takes nothing away from the next
        with asked("one", False, types) as session:
            assert session.kept("speed", ["fast"], "samples") == {"fast": 0.5}
    with asked("one", False, types) as session:
        assert not session.continued
        assert session.kept("speed", ["fast"], "samples") == {"fast": 0.5}  # nothing new: what was measured then
        session.put("stage", "new", 2)
        assert not session.kept("speed", ["fast"], "samples")
    with asked("one", True, types) as session:
        assert not session.kept("speed", ["fast"], "samples")


def test_many_keys_at_once(place):
    types = {"speed": float}
    keys = [digest(number) for number in range(1200)]  # more than one statement takes
    with asked("one", False, types) as session:
        assert session.kept("speed", keys) == {}
        session.put_all("speed", dict.fromkeys(keys[:700], 1.0))
        session.put_all("speed", dict.fromkeys(keys[500:800], 2.0))
        assert session.kept("speed", keys).keys() == set(keys[:800])
        assert session.kept("another", keys) == {}
    with asked("two", False, types) as session:
        assert session.kept("speed", keys).keys() == set(keys[:800])
        assert session.reused == 800
        assert session.kept("speed", keys[:800], "samples") == {}  # measured for another ask
        session.put_all("speed", {keys[0]: 3.0})
        found = session.kept("speed", keys)
        assert [found[key] for key in (keys[0], keys[1], keys[500])] == [3.0, 1.0, 2.0]
        assert len(found) == 800
    with asked("one", False, types) as session:
        assert session.kept("speed", keys, "samples") == dict.fromkeys(keys[:500], 1.0) | dict.fromkeys(
            keys[500:800], 2.0)
    with asked("one", True, types) as session:
        assert session.kept("speed", keys[:800]) == {}


def test_a_session_at_work_is_not_continued_by_another(place):
    types = {"stage": int}
    with asked("one", True, types) as first, asked("one", True, types) as second:
        first.put("stage", "key", 1)
        assert second.get("stage", "key") is None
        second.put("stage", "key", 2)
        assert first.get("stage", "key") == 1
        assert first.token != second.token


def test_the_time_of_killed_sessions_counts(place, monkeypatch):
    clock = [0.0]
    monkeypatch.setattr(tables.time, "perf_counter", lambda: clock[0])

    def work(session):
        clock[0] = 70.0
        session.put("stage", "key", 1)

    ended_by(KeyboardInterrupt, "one", False, work)
    with asked(types={"stage": int}) as session:
        clock[0] = 75.0
        assert session.seconds == 75.0


WRITER = """
import os, sys
from crosscheck.jobs.table import Table
with Table.opened().session(sys.argv[1], "", {"stage": int}) as session:
    for number in range(40):
        session.put("stage", f"{sys.argv[1]} {number}", number)
    if sys.argv[2] == "die":
        print("written", flush=True)
        os.kill(os.getpid(), 9)
"""


def writers(*endings):
    made = [subprocess.Popen([sys.executable, "-c", WRITER, str(number), ending], cwd=ROOT)
            for number, ending in enumerate(endings)]
    return [process.wait(120) for process in made]


def test_commands_at_once_lose_nothing_and_a_killed_one_keeps_what_it_wrote(place):
    assert writers("end", "end", "die") == [0, 0, -9]
    with asked("2", True, {"stage": int}) as session:
        assert session.continued
        found = [session.get("stage", f"{who} {number}", ever=True) for who in range(3) for number in range(40)]
    assert found == 3 * list(range(40))


def test_old_sessions_make_room(place, monkeypatch):
    types = {"stage": bytes}
    for number in range(4):
        with asked(str(number), types=types) as session:
            session.put("stage", str(number), os.urandom(1000))
    monkeypatch.setattr(tables, "MOST_BYTES", 2500)
    with asked("last", types=types) as session:
        assert [session.get("stage", str(number)) is None for number in range(4)] == [True, True, False, False]


@pytest.mark.parametrize("spoil", [lambda path: path.write_bytes(b"no database, but a long text of many letters"),
                                   lambda path: path.mkdir(), lambda path: path.parent.rmdir()])
def test_a_table_that_cannot_be_used_is_told_and_does_without(tmp_path, monkeypatch, spoil):
    folder = tmp_path / "cache"
    folder.mkdir()
    path = folder / "rows.sqlite"
    spoil(path)
    if not folder.exists():
        folder.write_text("a file")
    monkeypatch.setenv("CROSSCHECK_CACHE", str(folder))
    monkeypatch.setenv(tables.VARIABLE, "")
    table = Table.opened()
    assert str(path) in table.trouble
    assert "for this command only" in table.trouble
    with table.session("one", "", {"stage": int}) as session:
        session.put("stage", "key", 1)
        assert session.get("stage", "key") == 1
    monkeypatch.setenv(tables.VARIABLE, str(path))  # named by the user: he should know
    with pytest.raises(ArgumentError, match=tables.VARIABLE):
        Table.opened()


def test_a_full_disk_is_one_line_that_says_how_to_go_on(monkeypatch):
    path = os.environ[tables.VARIABLE]
    with asked(types={"stage": bytes}) as session:
        session.put("stage", "first", b"1")
        with session._table.engine.connect() as connection:
            connection.exec_driver_sql("PRAGMA max_page_count = 1")
        with pytest.raises(ArgumentError, match="the same command again, it goes on where it was"):
            session.put("stage", "second", os.urandom(1_000_000))
    with sqlite3.connect(path) as connection:
        assert connection.execute("SELECT key FROM rows_1").fetchall() == [("first",)]


def test_threads_of_one_command_may_ask_at_once():
    found = []

    def ask(number):
        with asked(str(number), types={"stage": int}) as session:
            session.put("stage", str(number), number)
            found.append(session.get("stage", str(number)))

    threads = [threading.Thread(target=ask, args=(number,)) for number in range(8)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert sorted(found) == list(range(8))


def test_a_key_is_of_the_whole_content():
    first = awkward()
    assert digest("a", first) == digest("a", awkward())
    assert len({digest("a", first), digest("b", first), digest("a", first, None), digest("a", [first]),
                digest("a", math.nan), digest("a", math.inf), digest("a", None), digest("a", 1), digest("a", 1.5),
                digest({1: 2, 3: 4}), digest({1: 2, 3: 5})}) == 11
    assert digest({"x": 1, "y": 2}) == digest({"y": 2, "x": 1})
