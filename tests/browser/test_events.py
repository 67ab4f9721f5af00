"""The page of a scene with events in a real browser: marked in the curves, listed, and each leads to its picture."""

import pytest

from crosscheck.document import Way
from crosscheck.report import write_report
from crosscheck.scene.file import read_scene
from crosscheck.scene.models.writing import toml
from crosscheck.verification.cell import run_cell
from crosscheck.verification.plan import Profile
from crosscheck.verification.scene_truth import prepare_truth
from crosscheck.verification.task import Cell
from tests.report_making import document


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """Pages of a pendulum with dry friction, and of one whose claim ends on its way; when it does (s)."""
    folder = tmp_path_factory.mktemp("events")
    _, content = read_scene("hinge_pendulum")
    hinge = content["joints"][0]
    scenes = []
    for name, more in (("rubbing", {"joints": [hinge | {"dry_friction": 1.0}]}),
                       ("leaving", {"monitors": [{"type": "range", "joint": hinge["name"], "lower": 0.0}]})):
        path = folder / f"{name}.toml"
        path.write_text(toml(content | {"schema": 3, "name": name, "duration": 2.0, "samples": 51} | more))
        scenes.append((str(path), prepare_truth((str(path), None, Profile.most_steps))))
    cells = [run_cell(Cell(path, Way("lieeuler", "taylor"), scene.plan)) for path, scene in scenes]
    assert scenes[0][1].truth.events
    write_report(document([scene for _, scene in scenes], cells, ["lieeuler"]), folder / "report")
    return folder / "report", scenes[1][1].truth.horizon


@pytest.fixture(scope="module")
def pages(made):
    return made[0]


@pytest.mark.parametrize("watched", [(1280, "light"), (390, "dark")], indirect=True, ids=["wide", "phone"])
def test_events_are_marked_and_lead_to_their_picture(watched, pages):
    page = watched.open(next(pages.glob("scene-*rubbing*.html")).name)
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


def test_the_picture_ends_with_truth(watched, pages, made):
    page = watched.open(next(pages.glob("scene-*leaving*.html")).name)
    page.locator("#scrub").evaluate("e => { e.value = 1000; e.dispatchEvent(new Event('input')); }")
    time = float(page.locator("#stage").get_attribute("data-time"))
    assert 0.0 < time <= made[1] < time + 0.04 < 2.0  # the last output time before
    assert page.evaluate("Geometry.blend([1, 2, null], [3, null, 5], 0.5).map(String)") == ["2", "NaN", "NaN"]
