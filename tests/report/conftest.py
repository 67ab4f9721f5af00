"""A small report, made once for all tests of this folder."""

import math

import pytest

from crosscheck import report as report_folder
from crosscheck.document import Finding, Record, Way
from crosscheck.verification.cell import run_cell
from crosscheck.verification.plan import Profile
from crosscheck.verification.scene_truth import prepare_truth
from crosscheck.verification.task import Cell
from tests.fake_engine import FakeEngine, install
from tests.report_making import document, failed_scene

SCENE = "single_pendulum"


@pytest.fixture(scope="session")
def results():
    """One run of each outcome on one scene, and a scene without truth."""
    with pytest.MonkeyPatch.context() as patch:
        install(patch, FakeEngine())
        scene = prepare_truth((SCENE, None, Profile.most_steps))
        runs = [run_cell(Cell(SCENE, Way("fake", "Plain"), scene.plan))]
        install(patch, FakeEngine(breaks="it broke with <b>markup</b> & a \x07 bell"))
        runs.append(run_cell(Cell(SCENE, Way("fake", "Broken"), scene.plan)))
        install(patch, FakeEngine(refuses="it cannot"))
        runs.append(run_cell(Cell(SCENE, Way("fake", "Unable"), scene.plan)))
        runs.append(Record(
            scene=SCENE, engine="fake", version="1", method="Flawed", form=None, step=1e-3, documented_order=2,
            command="crosscheck run", outcome="known",
            findings=[Finding("limit energy", "known", math.inf, 1.0, "J", "bound", "its makers say so")]))
        return document([scene, failed_scene("lost", "no closed form")], runs, ["fake"])


@pytest.fixture(scope="session")
def folder(results, tmp_path_factory):
    return report_folder.write(results, tmp_path_factory.mktemp("reports") / "latest").parent
