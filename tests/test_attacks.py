"""Texts, numbers and files of strangers end in one clear line: nothing hangs, floods a report or reaches a terminal."""

import contextlib
import dataclasses
import os
import re
import sqlite3

import numpy as np
import pytest
import sqlalchemy
from typer.testing import CliRunner

import lieeuler
from crosscheck import load_scene, run
from crosscheck.adapters.base import RawRun
from crosscheck.adapters.external.own import LONGEST_NAME, completed
from crosscheck.adapters.lieeuler import build_problem
from crosscheck.cli import app as command
from crosscheck.document import Record, Way, extended
from crosscheck.errors import LONGEST, ArgumentError, CrosscheckError, SceneError
from crosscheck.files import readable
from crosscheck.jobs import table
from crosscheck.jobs.database import database
from crosscheck.jobs.workers.process import isolated
from crosscheck.running.attempt import WORD, Failed, Ran, Refused, attempt
from crosscheck.scene.file import read_scene
from crosscheck.verification.cell import judge_run
from tests import saved
from tests.engines.faults import Resting

LONG = "\x1b[31m" + 10**6 * "x"
HINGE = read_scene("hinge_pendulum")[0].read_text().replace("schema      = 1", "schema = 2")


def loud(what):
    """An engine that says `LONG` of something."""
    class Loud(Resting):
        def unsupported(self, scene, spec):
            return LONG if what == "reason" else None

        def run(self, scene, spec):
            if what in ("error", "own"):
                raise {"error": RuntimeError, "own": CrosscheckError}[what](LONG)
            words = {"status": LONG, "form": LONG} if what == "status" else {"stats": {"said": LONG}}
            return RawRun(super().run(scene, spec), 0.0, scene.samples - 1, 0.1, **words)
    return completed(Loud(), "loud", "1")


@pytest.mark.parametrize(("what", "kind"), [("error", Failed), ("own", Failed), ("reason", Refused), ("status", Ran),
                                            ("stats", Failed)])
def test_words_of_an_engine_are_cut_and_no_letter_of_them_commands_a_terminal(what, kind):
    outcome = attempt(load_scene("single_pendulum"), Way("loud", Resting.methods[0], 0.1), loud(what))
    assert isinstance(outcome, kind)
    said = [outcome.raw.status, outcome.raw.form] if kind is Ran else [str(outcome.error)]
    most = WORD if kind is Ran else LONGEST
    assert all(len(text) < most + 200 and readable(text) == text for text in said)


def shout(_task):
    """Called in a worker."""
    raise RuntimeError(LONG)


def test_what_a_worker_raises_is_cut():
    crash = isolated(shout, None)
    assert len(crash.message) < LONGEST + 200
    assert len(crash.details) < 11 * LONGEST
    assert readable(crash.message) == crash.message


@pytest.mark.parametrize("name", [LONG, "", "a\nb", 3])
def test_names_of_engines_and_methods_are_short_and_printable(name):
    for key in ("name", "methods"):
        engine = Resting()
        setattr(engine, key, name if key == "name" else (name,))
        with pytest.raises(ArgumentError, match=f"at most {LONGEST_NAME} characters"):
            completed(engine, "x", "1")


@pytest.mark.parametrize(("old", "new", "said"), [
    ('"hinge_pendulum"', f'"{300 * "n"}"', "name: has 300 characters"),
    ('"pendulum"', f'"{2000 * "n"}"', r"bodies\[0\]: name: .* too long"),
    ('"pendulum"', '"a\\u001b[31m"', r"bodies\[0\]: name: .* cannot be printed"),
    ("child_axis    = [0.0", "child_axis    = [nan", "child_axis.* not a finite number"),
    ("parent_axis ", "armature = 1e89\nparent_axis ", "armature: 1e\\+89 is so large"),
])
def test_a_wrong_entry_of_a_scene_is_named(tmp_path, old, new, said):
    file = saved(tmp_path / "scene.toml", HINGE.replace(old, new))
    with pytest.raises(SceneError, match=said):
        load_scene(file)


def test_a_large_armature_is_taken(tmp_path):
    file = saved(tmp_path / "scene.toml", HINGE + "armature = 1e9\n")
    assert load_scene(file).joints[0].armature == (1e9,)


def test_a_removed_folder_is_one_line(tmp_path, monkeypatch, capsys):
    gone = tmp_path / "gone"
    gone.mkdir()
    monkeypatch.chdir(gone)
    gone.rmdir()
    try:
        with pytest.raises(SystemExit, match="2"):
            command.main()
    finally:
        os.chdir(tmp_path)
    assert capsys.readouterr().err.splitlines() == [
        "crosscheck: the current folder has been removed; change to another one"]


@pytest.mark.parametrize("flipped", [0, 5, 20])
def test_a_row_that_the_disk_has_changed_is_computed_anew(tmp_path, monkeypatch, flipped):
    monkeypatch.setenv(table.VARIABLE, str(tmp_path / "rows.sqlite"))
    with table.Table.opened().session("asked", "verify", {"cell": list[float]}) as session:
        session.put("cell", "key", [1.5, 2.5, 3.5])
    with contextlib.closing(sqlite3.connect(tmp_path / "rows.sqlite")) as store:
        content = bytearray(store.execute("select result from rows_1").fetchone()[0])
        content[flipped] ^= 4
        store.execute("update rows_1 set result = ?", [bytes(content)])
        store.commit()
    with table.Table.opened().session("asked", "verify", {"cell": list[float]}) as session:
        assert session.get("cell", "key") is None
        assert session.kept("cell", ["key"]) == {}
        assert session.put("cell", "key", [1.5]) == [1.5] == session.get("cell", "key")


def test_a_store_that_the_disk_has_changed_is_one_line(tmp_path):
    file = tmp_path / "rows.sqlite"
    with database(file, "--store", sqlalchemy.MetaData()).begin() as connection:
        connection.exec_driver_sql("create table t (a text)")
        connection.exec_driver_sql("insert into t values " + ",".join(["('" + 99 * "x" + "')"] * 500))
    content = bytearray(file.read_bytes())
    content[4096:] = b"\xff" * (len(content) - 4096)
    file.write_bytes(content)
    with pytest.raises(ArgumentError, match=r"--store .*: cannot be used any more \("), database(
            file, "--store", sqlalchemy.MetaData()).connect() as connection:
        connection.exec_driver_sql("select a from t").all()


@pytest.mark.parametrize("word", [np.array([1, 2]), ["off"], {"reduce": "off"}, 3])
def test_a_word_that_is_none_is_named(word):
    problem = build_problem(load_scene("single_pendulum"))
    for call in (lambda: lieeuler.integrate(problem, "rkmk4", 0.1, [0.0, 0.1], reduce=word),
                 lambda: run("single_pendulum", "lieeuler", "rkmk4", step=0.1, reduce=word)):
        with pytest.raises((lieeuler.ArgumentError, ArgumentError), match=r"reduce.* welded"):
            call()


def test_an_engine_file_that_ends_python_ends_nothing_else(tmp_path):
    (tmp_path / "leaving.py").write_text("import sys\nsys.exit(0)\n")
    done = CliRunner().invoke(command.app, [
        "run", "single_pendulum", "--engine", f"{tmp_path}/leaving.py:Engine", "--method", "rkmk4", "--step", "0.1"])
    assert done.exit_code != 0
    assert "ended the process" in str(done.exception)


@pytest.mark.parametrize("words", [["nightly"], ["verify"], ["run", "single_pendulum"]])
def test_a_folder_that_takes_no_file_is_one_line(words):
    option, place = ("--csv", "/proc/nowhere/run.csv") if words[0] == "run" else ("--out", "/proc/nowhere/report")
    more = ["--engine", "lieeuler", "--method", "rkmk4", "--step", "0.1"] if words[0] == "run" else []
    done = CliRunner().invoke(command.app, [*words, *more, option, place])
    assert isinstance(done.exception, ArgumentError), done.output
    assert re.match(rf"{option} /proc/nowhere\S*: .*\Z", str(done.exception))


@pytest.mark.parametrize("gravity", [9.81, 0.0])
def test_a_pendulum_that_hangs_still_warns_of_nothing(gravity):
    scene = load_scene("single_pendulum")
    body = dataclasses.replace(scene.bodies[0], attitude=np.array([1.0, 0.0, 0.0, 0.0]), velocity=np.zeros(3),
                               position=np.array([0.0, 0.0, -1.0]), angular_velocity=np.zeros(3))
    still = scene.replace(name="still", duration=1.0, samples=11, bodies=(body,),
                          gravity=gravity * scene.gravity / 9.81)
    way = Way.of("lieeuler", "rkmk4", 0.1)
    run = extended(Record, way, scene="still", version="1", documented_order=4)
    judged = judge_run(run, still, attempt(still, way).trajectory, frozenset())
    assert judged.outcome == "unresolved"
