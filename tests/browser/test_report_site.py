"""The pages in a real browser, from disk: they load, sort, filter, play, change colours and lead somewhere."""

import csv
import io
import itertools
import re
from pathlib import Path

import pytest

from crosscheck.scene.file import load_scene

SCENE = "scene-double_pendulum.html"


def pages(site):
    """Names of all pages, the first page first."""
    return ["index.html", *sorted(path.name for path in site.glob("*-*.html"))]


def column(page, table, index):
    """What the shown rows of a table hold in one column, as it is sorted."""
    return page.eval_on_selector_all(
        f"table[data-filter='{table}'] tbody tr:not([hidden])",
        f"rows => rows.map(row => row.cells[{index}].dataset.sort ?? row.cells[{index}].textContent.trim())")


def picture(page):
    """The present content of the canvas."""
    return page.evaluate("document.getElementById('stage').toDataURL()")


def check_pages(watched, names):
    """Every figure is drawn, nothing is cut, and there is no error."""
    for name in names:
        page = watched.open(name)
        for section in page.query_selector_all("details.section:not([open]) > summary"):
            section.click()
        for figure in page.query_selector_all("[data-figure]"):
            figure.scroll_into_view_if_needed()
        page.wait_for_function("[...document.querySelectorAll('[data-figure]')].every(e => e.childNodes.length)")
        # Wide tables scroll inside their boxes, never the page.
        assert page.evaluate("document.documentElement.scrollWidth") <= page.viewport_size["width"], name
        cut = page.eval_on_selector_all("h1, h2, h3, h4", "all => all.filter(e => e.scrollWidth > e.clientWidth + 1)"
                                        ".map(e => e.textContent)")
        assert cut == [], name
        assert watched.complaints == [], name


def test_every_page_draws_all_its_figures_and_is_no_wider_than_the_window(watched, site):
    check_pages(watched, pages(site))


@pytest.mark.parametrize("watched", [{"viewport": {"width": 390, "height": 844}, "color_scheme": "dark"}],
                         indirect=True)
def test_pages_fit_a_phone(watched):
    check_pages(watched, ["index.html", SCENE, "engine-mujoco.html", "study-conservation.html"])


@pytest.mark.parametrize("watched", [{"viewport": {"width": 390, "height": 844}}], indirect=True)
def test_what_to_trust_needs_no_sideways_swipe_on_a_phone(watched):
    page = watched.open("index.html")
    for table in ("table.trust", "table.tiles", "[data-filter=changes]"):
        page.locator(table).evaluate("e => { const folded = e.closest('details'); if (folded) folded.open = true; }")
        box = page.locator(".scroll", has=page.locator(table))
        assert box.evaluate("e => [e.scrollWidth - e.clientWidth, e.clientWidth > 300]") == [0, True], table
    shown = page.locator("table.trust tbody tr").first
    assert "error, of size" in shown.evaluate("e => getComputedStyle(e.cells[3], '::before').content")
    assert shown.locator("th").bounding_box()["y"] < shown.locator("td").first.bounding_box()["y"]


@pytest.mark.parametrize("watched", [{"viewport": {"width": 390, "height": 844}}], indirect=True)
def test_a_phone_folds_the_sections_of_a_scene_but_no_finding(watched):
    page = watched.open(SCENE)
    folded = "details.section:not([open])"
    assert page.locator(folded).count() == page.locator("details.section").count() > 5
    assert page.locator("[data-figure='energies'] .main-svg").count() == 0
    assert page.locator("#findings").is_visible()
    page.locator(".contents a", has_text="Energy").click()
    page.wait_for_selector("[data-figure='energies'] .main-svg")
    page.emulate_media(media="print")
    page.evaluate("dispatchEvent(new Event('beforeprint'))")
    assert page.locator(folded).count() == 0


def test_a_page_is_there_before_the_library_of_its_plots_and_draws_what_is_near(watched):
    watched.page.add_init_script("addEventListener('load', () => { window.early = 'Plotly' in window; })")
    page = watched.open(SCENE)
    assert page.evaluate("window.early") is False
    page.wait_for_selector("[data-figure='speed'] .main-svg")
    assert page.locator("[data-figure='convergence'] .main-svg").count() == 0
    page.locator("[data-figure='convergence']").scroll_into_view_if_needed()
    page.wait_for_selector("[data-figure='convergence'] .main-svg")


def test_the_table_of_a_study_shows_the_scene_of_its_figure_or_every_one(watched, document):
    page = watched.open("study-convergence.html")
    count = {name: sum(record.scene == name and bool(record.order and record.ladder) for record in document.records)
             for name in ("double_pendulum", "spring_pendulum")}
    assert set(column(page, "orders", 0)) == {"double pendulum"}
    page.select_option("[data-choose='scene']", "spring_pendulum")
    assert column(page, "orders", 0) == ["spring pendulum"] * count["spring_pendulum"]
    page.get_by_label("every scene").check()
    assert len(column(page, "orders", 0)) == sum(count.values())


def test_figures_hold_the_curves_they_name(watched):
    page = watched.open(SCENE)
    assert page.locator("[data-figure]").count() == 22
    page.locator("[data-figure='error'][data-quantity='position']").scroll_into_view_if_needed()
    page.wait_for_selector("[data-quantity='position'] .main-svg")
    read = "document.querySelector(\"[data-quantity='position']\").data.map(trace => trace.name)"
    shown = "e => e.selectedOptions[0].text"
    assert page.eval_on_selector("#run", shown).startswith("mujoco")  # the user's engine first
    page.select_option("#group", label="order 4")
    assert page.evaluate(read)[:3] == ["lieeuler rattle4", "mujoco RK4", "pinocchio RK4naive"]
    page.select_option("#run", label="mujoco RK4")
    assert page.eval_on_selector("#run", shown) == "mujoco RK4"
    page.locator("[data-figure='convergence']").scroll_into_view_if_needed()
    page.wait_for_selector("[data-figure='convergence'] .main-svg")
    notes = page.eval_on_selector("[data-figure='convergence']", "e => e.layout.annotations.map(note => note.text)")
    assert any(3.5 < float(note) < 4.5 for note in notes)


def test_names_at_line_ends_do_not_cover_each_other(watched):
    page = watched.open(SCENE)
    figure = page.locator("[data-figure='error']").first  # whose axis a bound far above all errors stretches
    figure.scroll_into_view_if_needed()
    figure.locator(".annotation-text").nth(2).wait_for()
    boxes = sorted(each.bounding_box()["y"] for each in figure.locator(".annotation-text").all())
    assert min(lower - upper for upper, lower in itertools.pairwise(boxes)) > 9, boxes  # of text 10 px high


def test_tables_sort_both_ways_and_filter_by_words_and_verdict(watched):
    page = watched.open(SCENE)
    heading = page.locator("table[data-filter='runs'] thead button", has_text="position, m")
    place = heading.evaluate("button => button.closest('th').cellIndex")
    heading.click()
    rising = [float(value) for value in column(page, "runs", place)]
    assert rising == sorted(rising)
    assert len(set(rising)) > 3
    heading.click()
    assert [float(value) for value in column(page, "runs", place)] == rising[::-1]
    page.get_by_role("button", name="run").first.click()

    bar = page.locator(".filter", has=page.locator("xpath=following-sibling::*[1]//table[@data-filter='runs']"))
    bar.get_by_role("searchbox").fill("mujoco rk4")
    assert column(page, "runs", 1) == ["RK4"]
    assert bar.get_by_role("status").inner_text() == "1 of 7"
    bar.get_by_role("searchbox").fill("DAE1L_LSE")
    found = column(page, "runs", 1)
    assert found
    for spelling in ("DAE1_IELS", "dae1l_les"):  # as P1 also writes it
        bar.get_by_role("searchbox").fill(spelling)
        assert column(page, "runs", 1) == found
    bar.get_by_role("searchbox").fill("")
    bar.get_by_role("combobox").select_option("known")
    assert column(page, "runs", 1) == ["RK4naive"]


def test_playback_plays_pauses_and_scrubs(watched):
    page = watched.open(SCENE)
    time = lambda: float(page.get_attribute("#stage", "data-time"))  # noqa: E731
    page.get_by_role("button", name="play").click()
    page.wait_for_function("Number(document.getElementById('stage').dataset.time) > 0.005")
    page.get_by_role("button", name="pause").click()
    held = time()
    page.wait_for_timeout(120)
    assert time() == held
    page.locator("#scrub").evaluate("e => { e.value = 500; e.dispatchEvent(new Event('input')); }")
    assert time() == pytest.approx(0.5, abs=1e-6)  # the first second of the scene
    assert page.locator("#clock").inner_text() == "0.500 s"


def test_the_picture_shows_chosen_runs_trails_and_turns(watched):
    page = watched.open(SCENE)
    page.locator("#scrub").evaluate("e => { e.value = 900; e.dispatchEvent(new Event('input')); }")
    seen = [picture(page)]
    page.locator(".chooser summary").click()
    page.get_by_role("checkbox", name="lieeuler DAE3L_LE").check()
    seen.append(picture(page))
    page.select_option("#trails", "all")
    seen.append(picture(page))
    box = page.locator("#stage").bounding_box()
    page.mouse.move(box["x"] + 200, box["y"] + 200)
    page.mouse.down()
    page.mouse.move(box["x"] + 300, box["y"] + 230)
    page.mouse.up()
    seen.append(picture(page))
    page.mouse.wheel(0, -300)
    seen.append(picture(page))
    assert len(set(seen)) == len(seen)
    page.get_by_role("button", name="reset view").click()
    assert picture(page) == seen[2]


def test_the_theme_follows_the_system_and_the_button_and_stays(watched):
    theme = "document.documentElement.dataset.theme"
    page = watched.open(SCENE)
    assert page.evaluate(theme) == "light"
    page.emulate_media(color_scheme="dark")
    page.wait_for_function(f"{theme} === 'dark'")
    light_on_dark = page.evaluate("getComputedStyle(document.body).color")
    page.locator("[data-figure='position']").scroll_into_view_if_needed()
    page.wait_for_selector("[data-figure='position'] .main-svg")
    ink = "document.querySelector(\"[data-figure='position']\").layout.font.color"
    dark_ink = page.evaluate(ink)
    page.locator("#theme").click()
    assert page.evaluate(theme) == "light"
    assert page.evaluate("getComputedStyle(document.body).color") != light_on_dark
    assert page.evaluate(ink) != dark_ink
    page.reload()
    assert page.evaluate(theme) == "light"


def test_links_and_menus_lead_through_the_site(watched):
    page = watched.open("index.html")
    assert "beyond rounding" in page.locator("#changes ~ .scroll table").first.inner_text()
    page.locator("summary", has_text="How do the engines compare").click()
    page.locator("a.tile").first.click()
    page.wait_for_url(re.compile(r"scene-double_pendulum\.html\?engine=lieeuler#runs"))
    assert set(column(page, "runs", 0)) == {"lieeuler"}
    page.locator("table[data-filter='runs'] tbody a", has_text="rattle4").click()
    page.locator("#run-lieeuler-rattle4[open]").wait_for()
    assert "crosscheck run double_pendulum" in page.locator("#run-lieeuler-rattle4").inner_text()
    page.locator("header summary", has_text="Engines").click()
    page.locator("header a", has_text="mujoco").click()
    assert page.locator("h1").inner_text().startswith("mujoco 4")
    page.locator("header summary", has_text="Studies").click()
    page.locator("header a", has_text="Convergence").click()
    assert page.locator("h1").inner_text() == "Convergence"
    page.get_by_role("link", name="Overview").click()
    assert page.url.endswith("index.html")


@pytest.mark.parametrize("axis", [1, 2])
def test_the_path_is_that_of_the_mass_centre_and_of_the_end(watched, axis):
    """At the start of the last body, as the scene file has them."""
    page = watched.open(SCENE)
    figure = f"[data-figure='path'][data-axis='{axis}']"
    page.locator(figure).scroll_into_view_if_needed()
    page.wait_for_selector(f"{figure} .main-svg")
    drawn = dict(page.evaluate(f"document.querySelector(\"{figure}\").data.map(t => [t.name, [t.x[0], t.y[0]]])"))
    scene = load_scene("double_pendulum")
    x, R, anchor = scene.x0[-1], scene.R0[-1], scene.joints[-1].child_anchor
    # 16 bits over paths of a few metres and quaternions of one.
    assert drawn["mass centre"] == pytest.approx(x[[0, axis]], abs=3e-4)
    assert drawn["end"] == drawn["end, start"] == pytest.approx((x - R @ anchor)[[0, axis]], abs=3e-4)


def test_a_plot_gives_its_data_as_csv_and_itself_as_svg(watched, document):
    page = watched.open(SCENE)
    figure = page.locator("figure", has=page.locator("[data-quantity='position']"))
    page.select_option("#group", label="every run")
    with page.expect_download() as waiting:
        figure.get_by_role("link", name="CSV").click()
    assert waiting.value.suggested_filename == "scene-double_pendulum-error-position.csv"
    rows = list(csv.DictReader(io.StringIO(Path(waiting.value.path()).read_text(encoding="utf-8"))))
    assert list(rows[0]) == ["curve", "time (s)", "position error (m)"]
    record = next(each for each in document.records if each.label == "mujoco Euler")
    values = [float(row["position error (m)"]) for row in rows if row["curve"] == "mujoco Euler"]
    # 16 bits over the decades of a curve: four digits.
    assert max(values) == pytest.approx(record.errors["position"].max, rel=1e-3)
    with page.expect_download() as waiting:
        figure.get_by_role("link", name="SVG").click()
    drawn = Path(waiting.value.path()).read_text(encoding="utf-8")
    assert "<svg" in drawn[:200]
    assert "position error (m)" in drawn


def test_the_page_to_print_draws_everything_at_once_in_light_colours(watched):
    page = watched.open(SCENE)
    page.emulate_media(color_scheme="dark", media="print")
    page.wait_for_function("window.Plotly")
    page.evaluate("window.dispatchEvent(new Event('beforeprint'))")
    assert page.evaluate("[...document.querySelectorAll('[data-figure]')].every(e => e.childNodes.length)")
    assert page.evaluate("document.documentElement.dataset.theme") == "light"
    assert not page.locator("header").is_visible()
