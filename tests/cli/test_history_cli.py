"""`crosscheck history` as a user sees it, on a store of made-up runs."""

import pytest
from typer.testing import CliRunner

from crosscheck.cli.app import app, main
from crosscheck.errors import ArgumentError
from crosscheck.history.runs import load, open_store, run_from_document, save
from tests.history.store.documents import document, record

NAMES = [f"2026-11-{day:02d}T02-00-00Z-00ff" for day in range(1, 7)]
CELL = ("--scene", "single_pendulum", "--engine", "mujoco", "--method", "RK4")


@pytest.fixture
def store(tmp_path):
    path = str(tmp_path / "history.sqlite")
    opened = open_store(path)
    for day, name in enumerate(NAMES, 1):
        content = document([record(ratio=0.01 if day < 4 else 0.013)], started=f"2026-11-{day:02d}T02:00:00+00:00")
        save(opened, run_from_document(name, content, good=day != 4))
    return path


def history(*words, store):
    done = CliRunner().invoke(app, ["history", *words, "--store", store], env={"COLUMNS": "250"})
    if done.exception is not None and not isinstance(done.exception, SystemExit):
        raise done.exception
    return done


def test_list_has_the_newest_first(store):
    lines = history("list", store=store).stdout.splitlines()
    assert [line.split()[0] for line in lines[1:]] == NAMES[::-1]
    assert "mujoco 4.0.0" in lines[1]


def test_history_alone_lists_the_runs(store):
    assert history(store=store).stdout == history("list", store=store).stdout


@pytest.mark.parametrize(("words", "port"), [
    *((words, "1") for words in ((), ("list",), ("show",), ("compare", "latest"), ("accept",))),
    *(((), port) for port in ("99999", "port", "-1"))])
def test_a_store_that_cannot_be_reached_is_one_line(words, port, monkeypatch, capfd):
    """As a user sees it at 80 columns: no usage, no help, no box."""
    monkeypatch.setenv("COLUMNS", "80")
    monkeypatch.setattr("sys.argv", ["crosscheck", "history", *words, "--store", f"postgresql://u@127.0.0.1:{port}/db"])
    with pytest.raises(SystemExit, match="2"):
        main()
    said = capfd.readouterr()
    assert said.out == ""
    line, = said.err.splitlines()
    assert line.startswith("crosscheck: --store")


def test_show_has_the_figures_of_one_run(store):
    text = history("show", "2026-11-05", "--metric", "speed ratio", "--metric", "position error", store=store).stdout
    assert text.startswith(NAMES[4])
    assert "0.013" in text
    assert "1e-06" in text
    with pytest.raises(ArgumentError, match="did you mean 'speed ratio'"):
        history("show", "--metric", "sped ratio", store=store)


def test_trend_takes_every_column_of_show(store):
    header = history("show", store=store).stdout.splitlines()[1]
    for column in ("outcome", "position error", "speed ratio"):
        assert column in header
        assert "6 runs" in history("trend", column, *CELL, store=store).stdout


def test_an_empty_history_says_what_to_do(tmp_path):
    text = history("list", store=str(tmp_path / "empty.sqlite")).stdout
    assert "crosscheck nightly" in text
    assert "crosscheck history add" in text


def test_compare_names_what_became_worse(store):
    done = history("compare", "2026-11-03", "2026-11-04", store=store)
    assert done.exit_code == 1
    assert "✗ speed: single_pendulum, mujoco RK4: 1.30 times the time per step" in done.stdout
    done = history("compare", "2026-11-04", store=store)
    assert done.exit_code == 0
    assert "nothing beyond rounding and noise" in done.stdout


def test_trend_marks_the_change(store, tmp_path):
    page = tmp_path / "trend.html"
    lines = history("trend", "speed ratio", *CELL, "--page", str(page), store=store).stdout.splitlines()
    assert lines[0] == "speed ratio of mujoco RK4 on single_pendulum, 6 runs"
    assert lines[1].startswith("▁▁▁███")
    assert lines[2] == "   ◆"
    assert lines[3].startswith(f"◆ {NAMES[3]}: 0.01 -> 0.013")
    assert page.is_file()
    with pytest.raises(ArgumentError, match="speed ratio"):
        history("trend", "sped", *CELL, store=store)
    with pytest.raises(ArgumentError, match="no run in the store has this"):
        history("trend", "speed ratio", *CELL[:-1], "RK5", store=store)


def test_accept_makes_a_run_the_one_to_compare_with(store):
    assert not load(open_store(store), NAMES[3]).good
    assert history("accept", "2026-11-04", store=store).stdout == f"accepted: {NAMES[3]}\n"
    assert load(open_store(store), NAMES[3]).good
