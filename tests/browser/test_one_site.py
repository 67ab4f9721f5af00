"""Studies, sweep, history and trend in a real browser: the report's menus, theme and search, on every kind of page."""

import json
import re

import pytest

from crosscheck.report import standalone
from tests.browser.pages_making import PAGES

WIDE, PHONE = (1280, "light"), (390, "dark")


@pytest.fixture
def pages(home):
    return home


@pytest.mark.parametrize(("name", "watched"), [
    pytest.param(name, view, id=f"{name}-{view[0]}") for name in PAGES for view in (WIDE, PHONE)], indirect=["watched"])
def test_every_page_has_the_menus_fits_and_is_accessible(watched, name):
    page = watched.open(name)
    page.wait_for_load_state("load")
    if page.locator(".plot").count():
        page.wait_for_selector(".main-svg")
    menus = page.locator("header nav > a, header summary").all_inner_texts()
    assert [each.split()[0] for each in menus[:5]] == ["Overview", "Scenes", "Engines", "Studies", "More"]
    assert page.evaluate("document.documentElement.scrollWidth") <= page.viewport_size["width"]
    watched.assert_accessible()


def test_the_menus_lead_from_a_study_to_the_report_and_back(watched):
    page = watched.open("drift/index.html")
    page.locator("header summary", has_text="Scenes").click()
    page.locator("header a", has_text="double pendulum").click()
    assert page.url.endswith("report/scene-double_pendulum.html")
    page.locator("header summary", has_text="More").click()
    assert page.locator("#sites a").count() == 6
    page.locator("#sites a", has_text="history").click()
    assert page.locator("h1").inner_text() == "History"
    assert page.locator("#sites a[aria-current]").count() == 1


@pytest.mark.parametrize("watched", [WIDE, PHONE], indirect=True, ids=["wide-light", "phone-dark"])
def test_search_finds_pages_of_every_folder_and_runs_of_this_one(watched):
    page = watched.open("report/scene-double_pendulum.html")
    page.keyboard.press("/")
    box = page.get_by_role("searchbox", name="search pages")
    box.fill("mujoco rk4")
    assert page.locator("#find a").all_inner_texts() == ["mujoco RK4"]
    box.fill("no such thing")
    assert page.locator("#find [role=status]").inner_text() == "0 found"
    box.fill("spring_pend")
    assert page.locator("#find a").all_inner_texts() == ["spring pendulum"]
    box.fill("usable steps")
    page.keyboard.press("Enter")
    page.wait_for_url(re.compile("stability/index.html"))


def test_the_theme_is_one_for_all_pages(watched):
    page = watched.open("history/index.html")
    page.locator("#theme").click()
    page.locator("#theme").click()
    page.goto(watched.folder.as_uri() + "/sweep/index.html")
    assert page.evaluate("document.documentElement.dataset.theme") == "dark"


def test_the_history_draws_every_scene_and_run(watched):
    page = watched.open("history/index.html")
    nights = page.locator("table[data-filter='scenes'] tbody tr").first.locator("rect")
    assert nights.count() == 8
    assert nights.evaluate_all("all => all.map(e => e.className.baseVal)") == ["unresolved"] * 7 + ["fail"]
    assert page.locator("table[data-filter='scenes'] td .quiet").first.inner_text() == "1 fail, 1 unresolved"
    row = page.locator("table[data-filter='runs'] tbody tr", has_text="single pendulum").first
    assert row.locator("polyline").count() == 3
    assert row.locator("td").last.locator("circle").count() == 1  # the speed changed its level once
    assert "0.01 to 0.013" in row.inner_text()


def test_a_night_is_told_of_the_folders_beside_the_nights(tmp_path):
    """Folders with other pages, and folders that cannot be written, change nothing."""
    for place in ("latest", "nightly/2026-11-01", "strange"):
        folder = tmp_path / "reports" / place
        folder.mkdir(parents=True)
        (folder / "index.html").write_text("<title>crosscheck: a &amp; b</title>", encoding="utf-8")
        for name in ("report.css", "theme.js") if place != "strange" else ():
            (folder / name).touch()
    (tmp_path / "reports/nightly/latest").symlink_to("2026-11-01", target_is_directory=True)
    standalone.write_neighbours(tmp_path / "reports/nightly/latest")
    assert not (tmp_path / "reports/strange/sites.js").exists()
    text = (tmp_path / "reports/nightly/2026-11-01/sites.js").read_text(encoding="utf-8")
    told = json.loads(text.removeprefix("window.CROSSCHECK_SITES = ").rstrip(";\n"))
    assert [(each["name"], each["here"], each["pages"]) for each in told] == [
        ("latest", False, [["index", "a & b", "../../latest/index.html"]]),
        ("nightly", True, [["index", "a & b", "index.html"]])]


@pytest.mark.parametrize("watched", [PHONE], indirect=True)
def test_a_phone_shows_the_first_rows_of_a_long_table_until_asked(watched):
    page = watched.open("drift/index.html")
    rows, shown = (page.locator(f"table[data-filter='runs'] tbody tr{which}") for which in ("", ":visible"))
    assert rows.count() == shown.count() == 15  # not long
    page.goto(watched.folder.as_uri() + "/stability/index.html")
    assert (rows.count(), shown.count()) == (30, 8)
    assert page.locator(".filter [role=status]").inner_text() == "8 of 30"
    page.get_by_role("searchbox", name="filter the rows").fill("top 1500")
    assert shown.count() == 8
    page.get_by_role("button", name="all rows").click()
    assert shown.count() == 10
