"""The page of runs at a coarse step in a real browser, beside the runs of the report at their own steps."""

import pytest
from msgspec.structs import replace

from crosscheck.document import Way
from crosscheck.report import write_report
from crosscheck.verification import job
from crosscheck.verification.cell import run_cell
from crosscheck.verification.task import Cell

PAGE = "study-coarse.html"
STEP = 0.02
RUNS = (("lieeuler", "DAE3L_LE"), ("lieeuler", "DAE1L_LSE"), ("lieeuler", "INDEX1_LE"), ("mujoco", "Euler"),
        ("mujoco", "implicitfast"), ("pinocchio", "SymplecticEuler"))


@pytest.fixture(scope="module")
def coarse(document, tmp_path_factory):
    """A document with six more runs, of the double pendulum at 20 ms, and the folder of its report."""
    scene, = (each for each in document.scenes if each.name == "double_pendulum")
    plan = replace(scene.plan, practical=STEP)
    judged = [run_cell(Cell(scene.name, Way(engine, method), plan, study=False, practical=True))
              for engine, method in RUNS]
    more = [replace(each, label=label) for each, label in zip(judged, job.labels(judged), strict=True)]
    made = job.document(document.meta, document.scenes, [*document.records, *more])
    folder = tmp_path_factory.mktemp("coarse") / "report"
    write_report(made, folder)
    return made, folder


@pytest.fixture
def pages(coarse):
    return coarse[1]


both = pytest.mark.parametrize("watched", [(1280, "light"), (390, "dark")], indirect=True, ids=["wide", "phone"])


@both
def test_the_page_lists_the_coarse_runs_alone_and_leads_to_them(watched, coarse):
    page = watched.open(PAGE)
    assert page.evaluate("document.documentElement.scrollWidth") <= page.viewport_size["width"]
    rows = page.locator("table[data-filter='coarse-1'] tbody tr")
    shown = {row.locator("th a").inner_text(): row for row in rows.all()}
    records = {f"{each.engine} {each.method}": each for each in coarse[0].records if each.practical}
    assert shown.keys() == records.keys() == {" ".join(run) for run in RUNS}
    for name, record in records.items():
        assert record.word in shown[name].locator(".tag").inner_text()
        assert float(shown[name].locator("td").nth(1).get_attribute("data-sort")) == pytest.approx(
            record.energy_error, rel=1e-2)
    page.get_by_role("searchbox", name="filter the rows").fill("mujoco")
    assert page.locator("table[data-filter='coarse-1'] tbody tr:visible").count() == 2
    page.get_by_role("link", name="mujoco Euler").click()
    page.wait_for_url("**/scene-double_pendulum.html#*")
    assert page.locator("#run-mujoco-Euler-at-20-ms").get_attribute("open") is not None


def test_menus_lead_to_the_page(watched):
    page = watched.open("study-convergence.html")
    page.locator("nav summary", has_text="Studies").click()
    page.get_by_role("link", name="At a coarse step").click()
    assert page.locator("h1").inner_text() == "At a coarse step"
    assert page.locator("h2").first.text_content() == "double pendulum, 20 ms"


def test_the_figures_of_the_scene_compare_coarse_runs_only_when_asked(watched):
    page = watched.open("scene-double_pendulum.html")
    page.wait_for_selector("[data-figure='speed'] .main-svg")
    names = "[...document.querySelectorAll('[data-legend]')][0].innerText"
    assert "at 20 ms" not in page.evaluate(names)
    page.select_option("#group", label="coarse steps")
    assert page.evaluate("document.querySelectorAll('[data-legend]')[0].querySelectorAll('button').length") == len(RUNS)


def test_a_figure_without_data_draws_again_when_there_are_some(watched):
    page = watched.open("scene-double_pendulum.html")
    page.wait_for_selector("[data-figure='speed'] .main-svg")
    for _ in range(2):
        page.select_option("#group", label="coarse steps")  # which are not timed
        page.wait_for_selector("[data-figure='speed'].empty")
        assert page.locator("[data-figure='speed']").inner_text() == "no data for this choice"
        page.select_option("#group", label="every run")
        page.wait_for_selector("[data-figure='speed'] .main-svg")
        assert "no data" not in page.locator("[data-figure='speed']").text_content()
    dimmed = page.evaluate("""() => { const plot = document.querySelector("[data-figure='speed']");
        plot.emit("plotly_hover", {points: [{data: plot.data.find((each) => each.meta)}]});
        return [...plot.querySelectorAll(".trace")].filter((node) => node.style.opacity === "0.15").length; }""")
    assert dimmed > 0  # the other runs are dimmed: the figure still listens


@both
def test_the_page_is_accessible(watched):
    page = watched.open(PAGE)
    page.wait_for_load_state("load")
    watched.assert_accessible()
