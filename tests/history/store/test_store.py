"""The history in real databases: values are read back as written, also with several writers and after kills."""

import contextlib
import dataclasses
import os
import signal
import sqlite3
import subprocess
import sys
import threading
import time
from random import Random

import pytest
import sqlalchemy

from crosscheck.errors import ArgumentError
from crosscheck.history.runs import (
    Usual,
    baseline,
    find,
    load,
    open_store,
    recent,
    run_from_document,
    save,
    series,
    set_good,
    usual,
)
from crosscheck.history.schema import METADATA
from tests.commands import crosscheck
from tests.history.store.documents import document, many, record

CELL = ("single_pendulum", "mujoco", "RK4", "")


def writer(url, prefix, count, results):
    return subprocess.Popen([sys.executable, "-m", "tests.history.store.writer", url, prefix, str(count), str(results)],
                            stdout=subprocess.PIPE, text=True)


def test_a_run_comes_back_as_it_went_in(url):
    store = open_store(url)
    run = run_from_document("first", document(many(5)), good=True)
    assert save(store, run)
    assert load(store, "first") == run
    assert [dataclasses.replace(each, results=run.results) for each in recent(store)] == [run]
    assert not save(store, dataclasses.replace(run, exit_code=1))
    assert load(store, "first").exit_code == run.exit_code


def test_figures_keep_every_bit_and_what_is_not_finite_is_left_out(url):
    store = open_store(url)
    values = [0.1 + 0.2, 5e-324, 1.7976931348623157e308, 1e-17]
    records = [record(method=f"M{number}", energy_error=value) for number, value in enumerate(values)]
    save(store, run_from_document("bits", document([*records, record(method="M9", energy_error=float("nan"))])))
    found = [result.figures.get("energy error") for result in load(store, "bits").results.values()]
    assert [figure.value for figure in found[:-1]] == values
    assert found[-1] is None


def test_two_processes_write_at_once_and_nothing_is_lost(url):
    # Neither finds a schema, so that both make it.
    writers = [writer(url, prefix, 8, 20) for prefix in ("one", "two")]
    for each in writers:
        each.communicate(timeout=60)
        assert each.returncode == 0
    store = open_store(url)
    names = {run.name for run in recent(store, 100)}
    assert names == {f"{prefix}-{number}" for prefix in ("one", "two") for number in range(8)}
    expected = run_from_document("", document(many(20))).results
    assert all(load(store, name).results == expected for name in names)


def test_two_processes_write_the_same_run_and_one_of_them_does(url):
    store = open_store(url)
    content = document(many(50))
    written = []
    both = threading.Barrier(2)

    def write():
        both.wait()
        written.append(save(store, run_from_document("same", content)))

    threads = [threading.Thread(target=write) for _ in range(2)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert sorted(written) == [False, True]
    assert len(load(store, "same").results) == 50


def test_a_kill_during_a_write_leaves_whole_runs_only_and_the_next_write_works(url):
    store = open_store(url)
    expected = run_from_document("", document(many(200))).results
    survived = []
    for attempt in range(2):
        process = writer(url, f"killed{attempt}", 1000, 200)
        said = [process.stdout.readline().strip() for _ in range(2)]
        time.sleep(0.02 + 0.05 * attempt)  # somewhere within the writes that follow
        process.send_signal(signal.SIGKILL)
        rest = process.communicate(timeout=30)[0].split()
        survived += [name for name in (*said, *rest) if name.startswith("killed")]
    names = {run.name for run in recent(store, 1000)}
    assert set(survived) <= names  # everything reported as written is there
    assert all(load(store, name).results == expected for name in names)
    assert save(store, run_from_document("afterwards", document(many(3))))


def test_the_tables_are_those_of_the_queries(url):
    inspector = sqlalchemy.inspect(open_store(url))
    for table in METADATA.sorted_tables:
        found = {column["name"]: column["nullable"] for column in inspector.get_columns(table.name)}
        assert found.keys() == {column.name for column in table.columns}


def test_tables_of_something_else_are_left_alone(url):
    store = open_store(url)
    with store.begin() as connection:
        connection.execute(sqlalchemy.text("ALTER TABLE results ADD COLUMN colour TEXT"))
    with pytest.raises(ArgumentError, match="its table results is not that of this crosscheck; name another store"):
        open_store(url)


def test_the_baseline_is_the_last_good_run_alike(url):
    store = open_store(url)
    def put(name, day, good, **more):
        content = document(started=f"2026-11-{day:02d}T02:00:00+00:00", **more)
        run = run_from_document(name, content, good)
        save(store, run)
        return run
    other = [record(scene="heavy_top")]
    first = put("first", 1, False)
    assert baseline(store, first) is None
    second = put("second", 2, False)
    assert baseline(store, second).name == "first"  # none was good: the last
    put("third", 3, True)
    put("fourth", 4, False)
    put("other scenes", 5, True, records=other)
    late = put("late", 6, False)
    assert baseline(store, late).name == "third"
    assert baseline(store, put("seventh", 7, False)).name == "third"
    set_good(store, "fourth")
    assert baseline(store, put("eighth", 8, False)).name == "fourth"


def test_series_and_spread_of_one_cell(url):
    store = open_store(url)
    ratios = [0.010, 0.011, 0.012, 0.010, 0.015]
    for day, ratio in enumerate(ratios, 1):
        content = document([record(ratio=ratio), record(method="Euler")], started=f"2026-11-{day:02d}T02:00:00+00:00")
        run = run_from_document(f"run {day}", content, good=day < 5)
        save(store, run)
    found = series(store, "speed ratio", CELL)
    assert [(each.name, figure.value) for each, figure in found] == [(f"run {k}", r) for k, r in enumerate(ratios, 1)]
    # 0.010 0.010 0.011 0.012: middle 0.0105, deviations 0.0005 0.0005 0.0005 0.0015
    assert usual(store, run, "speed ratio")[CELL] == pytest.approx(Usual(0.0105, 0.0005))
    assert usual(store, run, "speed ratio", fewest=5) == {}


def test_the_usual_level_is_that_of_the_newest_runs_and_begins_anew_where_a_change_was_accepted(url):
    store = open_store(url)

    def put(day, ratio, step=1e-3, **more):
        content = document([record(ratio=ratio, step=step)], started=f"2026-11-{day:02d}T02:00:00+00:00", **more)
        run = run_from_document(f"run {day}", content, good=True)
        save(store, run)

    for day, ratio in enumerate([0.05, 0.02, 0.02, 0.02, 0.01, 0.01, 0.01], 1):
        put(day, ratio)
    tonight = run_from_document("tonight", document([record(step=1e-3)], started="2026-11-09T02:00:00+00:00"))
    assert usual(store, tonight, "speed ratio")[CELL].level == 0.01  # the last five: 0.02 0.02 0.01 0.01 0.01
    elsewhere = run_from_document("other", document([record(step=2e-3)], started="2026-11-09T02:00:00+00:00"))
    assert usual(store, elsewhere, "speed ratio") == {}
    put(8, 0.03, exit_code=1)  # a finding that was accepted
    assert usual(store, tonight, "speed ratio") == {}
    assert usual(store, tonight, "speed ratio", fewest=1)[CELL] == pytest.approx(Usual(0.03, 0.0))


def test_runs_are_found_by_their_beginning(url):
    store = open_store(url)
    with pytest.raises(ArgumentError, match="the store has no run yet: `crosscheck nightly`"):
        find(store, "latest")
    for day, name in enumerate(("2026-11-20T02", "2026-11-21T02"), 20):
        save(store, run_from_document(name, document(started=f"2026-11-{day}T02:00:00+00:00")))
    assert find(store, "latest") == find(store, "2026-11-21") == "2026-11-21T02"
    with pytest.raises(ArgumentError, match="several begin so"):
        find(store, "2026-11")
    with pytest.raises(ArgumentError, match="latest"):
        find(store, "2025")


@pytest.mark.parametrize(("where", "message"), [
    ("mysql://somewhere/x", "mysql is not supported; allowed: sqlite, postgresql"),
    ("postgresql://somebody:secret@127.0.0.1:1/x", "cannot be used"),
    ("nonsense://", "not supported"),
    ("://", "cannot be read"),
])
def test_a_store_that_cannot_be_used_gets_one_clear_line(where, message):
    with pytest.raises(ArgumentError, match="--store") as caught:
        open_store(where)
    assert message in str(caught.value)
    assert "secret" not in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_file_that_is_no_store_is_left_alone(tmp_path):
    path = tmp_path / "thesis.txt"
    path.write_text("years of work, and more of it than a database header\n" * 10, encoding="utf-8")
    before = path.read_bytes()
    with pytest.raises(ArgumentError, match="cannot be used"):
        open_store(path)
    assert path.read_bytes() == before


@pytest.mark.parametrize("seed", range(6))
def test_a_file_with_flipped_bytes_answers_or_is_refused_in_one_line(tmp_path, seed):
    random, path = Random(seed), tmp_path / "damaged.sqlite"
    store = open_store(path)
    for name in ("first", "second"):
        save(store, run_from_document(name, document(many(5)), good=True))
    store.dispose()
    whole = path.read_bytes()
    for _ in range(4):
        content = bytearray(whole)
        for _ in range(random.choice((1, 30, 300))):
            content[random.randrange(random.choice((4096, len(content))))] ^= random.randrange(1, 256)
        path.write_bytes(content)
        for words in (["list"], ["show"]):
            done = crosscheck("history", *words, "--store", str(path))
            assert done.returncode in (0, 2)
            assert done.stderr.count("\n") == (done.returncode == 2)


@pytest.mark.parametrize("change", [
    "metrics SET unit = x'00'", "metrics SET value = 'x'", "results SET label = x'00ff'",
    "versions SET version = x'01'", "runs SET exit_code = 'x'"])
def test_a_value_of_another_type_is_refused_in_one_line(tmp_path, change):
    """A flipped byte in the head of a row makes text a number; SQLite keeps any value in any column."""
    path = tmp_path / "damaged.sqlite"
    store = open_store(path)
    save(store, run_from_document("first", document(many(5)), good=True))
    store.dispose()
    with contextlib.closing(sqlite3.connect(path)) as base:
        base.execute(f"UPDATE {change}")
        base.commit()
    done = crosscheck("history", "show", "--store", str(path))
    assert done.returncode == 2
    assert "it is damaged" in done.stderr
    assert done.stderr.count("\n") == 1


def test_the_environment_names_the_store(tmp_path, monkeypatch):
    monkeypatch.setenv("CROSSCHECK_STORE", str(tmp_path / "here.sqlite"))
    save(open_store(), run_from_document("x", document()))
    assert os.path.exists(tmp_path / "here.sqlite")
