"""The page of a scene with events in a real browser: marked in the curves, listed, and each leads to its picture."""

import pytest

from crosscheck.document import Way
from crosscheck.judge.plan import Profile
from crosscheck.report import write_report
from crosscheck.scene.file import read_scene
from crosscheck.scene.models.writing import toml
from crosscheck.verification.cell import run_cell
from crosscheck.verification.scene_truth import prepare_truth
from crosscheck.verification.task import Cell
from tests.report_making import document


@pytest.fixture(scope="module")
def pages(tmp_path_factory):
    folder = tmp_path_factory.mktemp("events")
    _, content = read_scene("hinge_pendulum")
    path = folder / "rubbing.toml"
    path.write_text(toml(content | {"schema": 3, "name": "rubbing", "duration": 2.0, "samples": 51, "joints": [
        content["joints"][0] | {"dry_friction": 1.0}]}))
    scene = prepare_truth((str(path), True, Profile.most_steps))
    made = document([scene], [run_cell(Cell(str(path), Way("lieeuler", "taylor"), scene.plan, False))], ["lieeuler"])
    assert scene.truth.events
    write_report(made, folder / "report")
    return folder / "report"


@pytest.mark.parametrize("watched", [(1280, "light"), (390, "dark")], indirect=True, ids=["wide", "phone"])
def test_events_are_marked_and_lead_to_their_picture(watched, pages):
    page = watched.open(next(pages.glob("scene-*.html")).name)
    page.locator("summary", has_text="of the true motion").click()
    first = page.locator("#events button").first
    time = float(first.get_attribute("data-time"))
    place = page.locator("[data-figure=error]").first
    place.scroll_into_view_if_needed()
    page.wait_for_selector("[data-figure=error] .main-svg")
    assert place.evaluate("e => e.layout.shapes.map((each) => each.x0)")[0] == time
    first.click()
    words = page.locator("#events tbody tr").first.locator("td").all_inner_texts()
    assert page.locator("#clock").inner_text().endswith(f"{words[1]} {words[2]}")
    assert page.evaluate("document.documentElement.scrollWidth") <= page.viewport_size["width"]
    watched.assert_accessible()
