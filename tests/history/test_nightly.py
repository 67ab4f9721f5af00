"""The nightly run: kills lose nothing, seeded regressions are on the first page, unchanged runs raise no alarm."""

import json
import os
import random
import subprocess
import sys
from pathlib import Path

import pytest
from typer.testing import CliRunner

from crosscheck.cli.app import app
from crosscheck.errors import ArgumentError
from crosscheck.history import nightly
from crosscheck.history.runs import open_store, recent
from crosscheck.jobs import table
from tests import ROOT
from tests.commands import crosscheck
from tests.killing import killed, results, rows, timeless

SEEDS = ROOT / "tests" / "seeds"
FEW, TEN = (f"{SEEDS / 'few.py'}:{name}" for name in ("Few", "Ten"))
QUICK = ("--profile", "smoke", "--scene", "single_pendulum", "--engine", FEW, "--jobs", "1")
TIMED = ("--profile", "full", "--scene", "single_pendulum", "--engine", TEN, "--jobs", "1")


def command(out, *words, seed=""):
    environment = {**os.environ, "CROSSCHECK_TEST_SEED": seed, "COLUMNS": "200", "PYTHONPATH": os.pathsep.join(
        filter(None, (str(SEEDS), os.environ.get("PYTHONPATH"))))}
    environment.pop("CROSSCHECK_STORE", None)
    return {"args": [sys.executable, "-m", "crosscheck", "nightly", *words, "--out", str(out)],
            "env": environment, "text": True, "stdout": subprocess.PIPE, "stderr": subprocess.PIPE}


def night(out, *words, seed=""):
    """A night in this process, a seeded one in its own."""
    if seed:
        return subprocess.run(**command(out, *words, seed=seed), timeout=1500)
    return crosscheck("nightly", *words, "--out", str(out))


def latest(out):
    return json.loads((out / "latest" / "results.json").read_text(encoding="utf-8"))


def history_names(out):
    return [run.name for run in recent(open_store(out.parent / "history.sqlite"), 100)]


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory):
    """The first night."""
    out = tmp_path_factory.mktemp("nights") / "nightly"
    return night(out, *QUICK), out


def test_a_night_leaves_report_history_and_summary(undisturbed):
    done, out = undisturbed
    assert done.returncode == 0, done.stdout + done.stderr
    folder, = (path for path in out.iterdir() if nightly.NAME.fullmatch(path.name))
    assert (out / "latest").readlink() == Path(folder.name)
    assert sorted(path.name for path in out.iterdir()) == [".lock", folder.name, "latest"]
    assert (folder / "index.html").is_file()
    assert (folder / "summary.txt").read_text(encoding="utf-8") == done.stdout
    assert done.stdout.splitlines()[0].startswith("crosscheck nightly")
    assert "first run, nothing to compare with" in done.stdout
    assert len(done.stdout.splitlines()) < 40
    assert history_names(out) == [folder.name]
    assert latest(out)["changes"] is None


def test_any_report_can_be_put_into_a_history(undisturbed, tmp_path):
    words = ["history", "add", str(undisturbed[1] / "latest"), "--store", str(tmp_path / "other.sqlite")]
    first, second = (CliRunner().invoke(app, words).stdout for _ in range(2))
    assert first.startswith("added: ")
    assert second == first.replace("added", "already there")
    run, = recent(open_store(tmp_path / "other.sqlite"))
    assert (run.profile, run.good) == ("smoke", True)


def test_a_killed_night_goes_on_and_ends_as_if_nothing_had_happened(undisturbed, tmp_path):
    out = tmp_path / "nightly"
    assert killed(command(out, *QUICK), 2)
    assert not (out / "latest").exists()
    before = rows()
    assert len(before) >= 2
    done = night(out, *QUICK)
    assert done.returncode == 0, done.stdout + done.stderr
    assert set(before) <= set(rows())
    assert len({key for key, _ in rows()}) == len(rows())  # nothing that had ended was run again
    assert timeless(results(out / "latest")) == timeless(results(undisturbed[1] / "latest"))
    assert len(history_names(out)) == 1
    # The next night computes everything anew, unless it is told not to.
    count = len(rows())
    for words, expected in ((("--no-fresh",), count), ((), 2 * count)):
        assert night(out, *QUICK, *words).returncode == 0
        assert len(rows()) == expected
        assert latest(out)["changes"] == []
    assert len(history_names(out)) == 3


def test_a_night_computes_again_what_an_edited_helper_made(tmp_path, monkeypatch):
    """The engine states a version, which stays; its own file as well."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "engine.py").write_text(
        "import helper\nfrom crosscheck.adapters.lieeuler import LieEuler\n\n__version__ = '1.0'\n\n\n"
        "class Mine(LieEuler):\n    methods = helper.METHODS\n", "utf-8")
    counts = []
    for more in ("", "", "# edited\n"):
        with open(tmp_path / "helper.py", "a", encoding="utf-8") as helper:
            helper.write(more or "METHODS = ('rattle2',)\n" * (not counts))
        done = night(tmp_path / "nightly", *QUICK[:4], "--engine", "engine.py:Mine", "--jobs", "1", "--no-fresh")
        assert done.returncode == 0, done.stdout + done.stderr
        counts.append(len(rows()))
    assert counts[0] == counts[1] == counts[2] - 1 > 1


def test_thirty_kills_at_random_moments(undisturbed, tmp_path):
    """Where a night has ended, another one follows in an empty folder, with an empty table."""
    generator, kills, nights = random.Random(35), 0, 0
    wanted = timeless(results(undisturbed[1] / "latest"))
    for _ in range(30):
        out = tmp_path / str(nights) / "nightly"
        kills += killed(command(out, *QUICK), generator.choice(range(5)), generator.uniform(0.0, 1.0))
        if (out / "latest").exists():
            assert timeless(results(out / "latest")) == wanted
            os.remove(os.environ[table.VARIABLE])
            nights += 1
    out = tmp_path / str(nights) / "nightly"
    assert night(out, *QUICK).returncode == 0
    assert timeless(results(out / "latest")) == wanted
    assert len({key for key, _ in rows()}) == len(rows())  # nothing that had ended was run again
    assert len(history_names(out)) == 1
    assert kills >= 20


def test_a_wrong_coefficient_and_another_version_are_named_on_the_first_page(undisturbed):
    _, out = undisturbed
    before = latest(out)
    done = night(out, *QUICK, seed="coefficient,version")
    assert done.returncode == 1, done.stdout + done.stderr
    changes = latest(out)["changes"]
    found = {(change["kind"], change["engine"], change["method"]) for change in changes}
    assert {("version", FEW, ""), ("outcome", FEW, "rattle4"), ("accuracy", FEW, "rattle4")} <= found
    assert {change["method"] for change in changes if change["bad"]} == {"rattle4"}
    page = (out / "latest" / "index.html").read_text(encoding="utf-8")
    for change in changes:
        assert change["text"].split("'")[0] in page
    assert "version 0.1.0, now 0.1.1" in done.stdout
    assert f"- accuracy: {FEW} rattle4 on single_pendulum: " in done.stdout
    # A failed run is no reference: once mended, a run equals the last good one, and nothing is reported.
    assert latest(out)["meta"]["compared_with"] == recent(open_store(out.parent / "history.sqlite"))[1].name
    mended = night(out, *QUICK)
    assert (mended.returncode, latest(out)["changes"]) == (0, []), mended.stdout
    assert timeless(latest(out)) == timeless(before)


def test_so_many_runs_are_kept_and_never_less_than_the_latest(tmp_path):
    names = [f"2026-11-{day:02d}T02-00-00Z-00ff" for day in range(1, 8)]
    for name in names:
        (tmp_path / name).mkdir()
    nightly._point_latest(tmp_path, names[0])
    nightly._prune(tmp_path, 3)
    left = {path.name for path in tmp_path.iterdir()}
    assert left == {"latest", names[0], *names[-3:]}


def test_the_link_changes_at_once(tmp_path):
    for name in ("one", "two"):
        (tmp_path / name).mkdir()
        nightly._point_latest(tmp_path, name)
        assert (tmp_path / "latest").resolve() == tmp_path / name
    assert sorted(path.name for path in tmp_path.iterdir()) == ["latest", "one", "two"]


def test_wrong_arguments_get_one_clear_line(tmp_path):
    (tmp_path / "thesis.tex").write_text("years of work", encoding="utf-8")
    (tmp_path / "locked" / ".lock").mkdir(parents=True)  # what the system refuses to open, also to root
    for out, more, message in ((tmp_path, {}, "holds something else than nightly runs"),
                               (tmp_path / "thesis.tex", {}, "--out"),
                               (tmp_path / "locked", {}, "--out"),
                               (tmp_path / "n", {"keep": 0}, "keep has to be at least 1"),
                               (tmp_path / "n", {"where": "mysql://x/y"}, "mysql is not supported")):
        with pytest.raises(ArgumentError, match=message):
            nightly.nightly(out, nightly.Wanted("smoke", ["single_pendulum"], ["lieeuler"]), **more)
    assert (tmp_path / "thesis.tex").read_text(encoding="utf-8") == "years of work"


def test_two_nights_in_one_folder_exclude_each_other(tmp_path):
    with nightly._alone(tmp_path), pytest.raises(ArgumentError, match="another nightly run is at work"):
        nightly.nightly(tmp_path, nightly.Wanted("smoke", ["single_pendulum"], ["lieeuler"]))


def test_ten_unchanged_nights_raise_no_alarm_and_a_slowdown_of_thirty_per_cent_does(tmp_path, monkeypatch):
    """Times are drawn, see `tests/seeds`: what is tested is how they are measured, repeated and compared."""
    monkeypatch.setenv("CROSSCHECK_TEST_CALIBRATIONS", str(tmp_path / "calibrations"))
    monkeypatch.setenv("PYTHONPATH", str(SEEDS))
    monkeypatch.setenv("CROSSCHECK_TEST_SEED", "clock")  # of the workers of nights in this process
    out = tmp_path / "nightly"
    for _ in range(11):
        done = night(out, *TIMED)
        assert done.returncode == 0, done.stdout + done.stderr
        assert [change for change in latest(out)["changes"] or [] if change["bad"]] == []
    done = night(out, *TIMED, seed="clock,slower")
    assert done.returncode == 1, done.stdout + done.stderr
    slower = {change["engine"] for change in latest(out)["changes"] if change["kind"] == "speed" and change["bad"]}
    assert slower == {TEN}
    page = (out / "latest" / "index.html").read_text(encoding="utf-8")
    assert "times the time per step" in page
