"""The output of commands at 80, 120 and 200 columns: nothing wider, no figure cut, and as in the snapshots.

`python -m tests.cli.test_widths` writes the snapshots anew; read them before they are committed.
"""

from __future__ import annotations

import contextlib
import io
import itertools
import os
import re
import tempfile
from pathlib import Path
from types import SimpleNamespace
from unittest import mock

import pytest
from msgspec.structs import replace
from typer.testing import CliRunner

from crosscheck.cli import app, runs, study, verify
from crosscheck.document import Advice, Finding, Order
from crosscheck.history import nightly
from crosscheck.history.nightly import summary
from crosscheck.history.runs import open_store, run_from_document, save
from crosscheck.sweeps import job
from crosscheck.verification import trust
from tests.browser import pages_making
from tests.history.store.documents import document, record
from tests.report_making import CHANGES

SNAPSHOTS = Path(__file__).parent / "snapshots"
WIDTHS = (80, 120, 200)
FIGURE = re.compile(r"\d[\d.]*(?:e[-+]\d+)?")
FINE = [Finding(f"promise level {name}", "ok", 1e-15, 1e-12, "m", "rounding") for name in ("position", "velocity")]
LOW = Finding("order", "fail", 2.0, 0.5, "1", "the documented order less 1/2")

SECOND = Order(documented=4, observed=2.0, median=2.0, segments=8)


def made_up():
    """Passes, a known defect and a failure, of two engines on two scenes."""
    known = Finding("order", "known", 2.0, 0.5, "1", "a sum of rates is of second order where a joint turns on SO(3)")
    made = document([
        record(findings=FINE), record(method="Euler", error=3.2e-4),
        record(engine="pinocchio", method="RKMK4", error=1.8e-12, findings=FINE[:1]),
        record(engine="pinocchio", method="RK4naive", error=3.7e-7, outcome="known", worst=known,
               word="known", order=SECOND, findings=[known]),
        record(scene="double_pendulum", engine="pinocchio", method="SymplecticEuler", error=2.5e-2, outcome="fail",
               word="fail", order=SECOND, findings=[LOW], worst=LOW)])
    return replace(made, scenes=[replace(
        scene, trust=trust.sentence(scene, own), not_trusted=trust.not_trusted(own),
        recommended=trust.recommend(scene, own),
        engines=trust.by_engine(scene, own)) for scene in made.scenes
        for own in [[each for each in made.records if each.scene == scene.name]]])


STUDIES = {"work-precision": pages_making.work_precision, "stability": pages_making.stability,
           "drift": pages_making.drift}

HISTORY = {"history": ["show"], "history list": ["list"],
           "history trend": ["trend", "position error", "--scene", "double_pendulum", "--engine", "pinocchio",
                             "--method", "SymplecticEuler"]}

SWEEP = "sweep --dry-run"

WHOLE = ("verify", "advise", "nightly", SWEEP, *HISTORY, "history empty", *STUDIES)
"""What has snapshots: its figures are made up."""


def told(name, folder):
    """What a command prints, with the width in COLUMNS."""
    if name in STUDIES:
        kept = {}
        with mock.patch.object(pages_making, "write_folder", lambda out, made, rows: kept.update({made.study: made})):
            STUDIES[name](folder)
        with mock.patch.object(study, "_conduct", return_value=kept[name]):
            print(CliRunner().invoke(app.app, ["study", name]).stdout, end="")
    elif name == "nightly":
        night = SimpleNamespace(exit_code=1, summary=summary(
            replace(made_up(), changes=CHANGES), "2026-11-20T02-00-00Z-00ff", None, False,
            Path("reports/nightly/latest")))
        with mock.patch.object(nightly, "nightly", return_value=night):
            print(CliRunner().invoke(app.app, ["nightly"]).stdout, end="")
    elif name == "verify":
        verify.print_verdicts(made_up(), Path("reports/latest/index.html"))
    elif name == SWEEP:
        with mock.patch.object(job, "estimate", return_value=(100_000, 99_950, 4100.0)):
            words = ["study", "sweep", "masses-of-both-pendulums.toml", "--dry-run"]
            print(CliRunner().invoke(app.app, words).stdout, end="")
    elif name == "advise":
        advice = Advice(scene="heavy_top", engine="mujoco", wanted=1e-4, until=1.0, least=1e-12, method="RK4",
                        form="tree", step=2.9412e-4, error=8.1e-5, cost=0.0297, breaks_at=1.25e-3,
                        command="crosscheck run heavy_top --engine mujoco --method RK4 --step 0.00029412")
        runs.print_advice(advice)
    else:
        store = folder / ("empty.sqlite" if name == "history empty" else "history.sqlite")
        words = ["history", *HISTORY.get(name, ["list"]), "--store", str(store)] if "history" in name else name.split()
        print(CliRunner().invoke(app.app, words).stdout, end="")


def keep(place):
    """A history of one run."""
    run = run_from_document("2026-11-20T02-00-00Z-00ff", made_up(), good=True)
    save(open_store(str(place / "history.sqlite")), run)
    return place


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return keep(tmp_path_factory.mktemp("history"))


@pytest.mark.parametrize("name", [*WHOLE, "list --support", "list", "--help",
                                  *(f"{each} --help" for each in app.COMMANDS),
                                  "inspect heavy_top --engine mujoco --engine exudyn --states 1"])
def test_nothing_is_wider_than_the_terminal_and_no_figure_is_cut(name, folder, monkeypatch, capsys):
    shown = {}
    for width in WIDTHS:
        monkeypatch.setenv("COLUMNS", str(width))
        told(name, folder)
        shown[width] = capsys.readouterr().out
        wide = [line for line in shown[width].splitlines() if len(line.rstrip()) > width]
        assert all(line.startswith(("report: ", "command ", "reproduce: ")) for line in wide), wide  # to be copied
        if name in WHOLE:
            assert shown[width] == (SNAPSHOTS / f"{name.replace(' ', '-')}-{width}.txt").read_text("utf-8")
    for width in WIDTHS[:2]:
        assert set(FIGURE.findall(shown[200])) == set(FIGURE.findall(shown[width]))


def test_a_sentence_is_one_line_where_no_terminal_says_how_wide_it_is(monkeypatch, capsys):
    monkeypatch.delenv("COLUMNS", raising=False)
    verify.print_verdicts(made_up(), Path("index.html"))
    assert any(len(line) > 200 for line in capsys.readouterr().out.splitlines())


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as place:
        keep(Path(place))
        for name, width in itertools.product(WHOLE, WIDTHS):
            os.environ["COLUMNS"] = str(width)
            with contextlib.redirect_stdout(io.StringIO()) as shown:
                told(name, Path(place))
            (SNAPSHOTS / f"{name.replace(' ', '-')}-{width}.txt").write_text(shown.getvalue(), "utf-8")
