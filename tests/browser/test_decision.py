"""The first page's decision and the looks of runs in a real browser: choices, address, isolation, keyboard, access."""

import itertools
import re
import shutil

import msgspec
import pytest
from msgspec.structs import replace

from crosscheck.report import identity
from crosscheck.report.exports import read_curves

SCENE = "scene-double_pendulum.html"


VIEWS = {"wide-light": (1280, "light"), "phone-dark": (390, "dark"), "wide-dark": (1280, "dark"),
         "phone-light": (390, "light")}


in_every_view = pytest.mark.parametrize("watched", VIEWS.values(), ids=VIEWS, indirect=True)


@in_every_view
def test_the_decision_answers_and_the_address_keeps_it(watched, document):
    page = watched.open("index.html")
    page.select_option("#decide-engine", "mujoco")
    page.select_option("#decide-error", label="1e−6")
    said = page.inner_text("#decide-answer")
    row, = (row for row in document.advice if (row.scene, row.engine) == ("double_pendulum", "mujoco")
            and abs(row.wanted / 1e-6 - 1) < 1e-9)
    assert "RK4" in said
    assert "7.0e-7 of its size" in said
    assert row.command in said
    assert page.locator("#decide-table tr.mine th").inner_text() == "mujoco"
    rows = page.locator("#decide-table tbody th")
    assert rows.all_inner_texts() == ["mujoco", "pinocchio"]  # ours only where it is asked for, or no other reaches it
    page.select_option("#decide-engine", "lieeuler")
    assert sorted(rows.all_inner_texts()) == ["lieeuler", "mujoco", "pinocchio"]
    page.select_option("#decide-engine", "mujoco")
    address = page.url
    page.goto("about:blank")
    page.goto(address)
    assert page.input_value("#decide-engine") == "mujoco"
    assert page.inner_text("#decide-answer") == said
    page.select_option("#decide-engine", "pinocchio")
    assert "pinocchio: not within the budget of 30 s" in page.inner_text("#decide-answer")
    page.select_option("#decide-scene", "spring_pendulum")
    assert "cannot model this scene, or was not tried" in page.inner_text("#decide-answer")
    assert page.evaluate("document.documentElement.scrollWidth") <= page.viewport_size["width"]


OPACITIES = """() => [...document.querySelectorAll("[data-figure='speed'] .trace")]
  .filter((node) => node.__data__?.[0]?.trace?.meta).map((node) => [node.__data__[0].trace.meta, node.style.opacity])"""


@in_every_view
def test_a_click_isolates_a_run_and_escape_ends_it(watched):
    page = watched.open(SCENE)
    page.wait_for_selector("[data-figure='speed'] .main-svg")
    button = page.locator("[data-legend] button[data-run='mujoco RK4']").first
    button.focus()  # the element with the keyboard focus stands out
    assert {name for name, opacity in page.evaluate(OPACITIES) if opacity == ""} == {"mujoco RK4"}
    page.keyboard.press("Enter")
    assert button.get_attribute("aria-pressed") == "true"
    faint = {opacity for name, opacity in page.evaluate(OPACITIES) if name != "mujoco RK4"}
    assert faint == {"0.06"}
    page.keyboard.press("Escape")
    button.blur()
    assert {opacity for _, opacity in page.evaluate(OPACITIES)} == {""}


@in_every_view
def test_no_two_rendered_lines_are_alike(watched):
    page = watched.open(SCENE)
    page.select_option("#group", label="every run")
    page.locator("[data-figure='error']").first.scroll_into_view_if_needed()
    page.wait_for_selector("[data-figure='error'] .main-svg")
    drawn = page.evaluate("""() => [...document.querySelector("[data-figure='error']").querySelectorAll(".trace")]
        .filter((node) => node.__data__?.[0]?.trace?.meta).map((node) => node.querySelector(".js-line"))
        .map((line) => [line.style.stroke, line.style.strokeDasharray])""")
    assert len(drawn) == 7
    assert all(one != other for one, other in itertools.combinations(map(tuple, drawn), 2))


PAGES = ("index.html", SCENE, "engine-mujoco.html", "study-convergence.html", "study-speed.html",
         "study-conservation.html")


@pytest.mark.parametrize(("name", "watched"), [
    pytest.param(name, view, id=f"{name}-{place}") for name in PAGES for place, view in VIEWS.items()],
    indirect=["watched"])
def test_pages_are_accessible(watched, name):
    page = watched.open(name)
    page.wait_for_load_state("load")
    page.wait_for_timeout(300)
    watched.assert_accessible()


@in_every_view
def test_the_run_selector_drives_playback_and_the_address_keeps_the_view(watched):
    page = watched.open(SCENE)
    page.select_option("#run", label="mujoco RK4")
    assert page.get_attribute("#stage", "data-shown") == "truth, mujoco RK4"
    boxes = "all => all.filter(e => e.checked).map(e => e.value)"
    assert page.eval_on_selector_all("#actors input", boxes) == ["truth", "mujoco RK4"]
    page.select_option("#body", label="lower")
    page.locator("#scrub").evaluate("e => { e.value = 250; e.dispatchEvent(new Event('input'));"
                                    " e.dispatchEvent(new Event('change')); }")
    address = page.url
    assert "run=mujoco+RK4" in address
    assert "t=0.2500" in address
    page.goto("about:blank")
    page.goto(address)
    assert page.eval_on_selector("#run", "e => e.selectedOptions[0].text") == "mujoco RK4"
    assert page.get_attribute("#stage", "data-shown") == "truth, mujoco RK4"
    assert float(page.get_attribute("#stage", "data-time")) == pytest.approx(0.25)
    assert page.locator("[data-body]").text_content() == "lower"


@in_every_view
def test_a_change_before_the_event_of_the_last_one_stays(watched):
    page = watched.open(SCENE)
    page.evaluate("""() => new Promise((heard) => {
        window.addEventListener("hashchange", () => setTimeout(heard, 0), {once: true});
        const body = document.getElementById("body");
        body.selectedIndex = 1;
        body.dispatchEvent(new Event("change"));
        document.getElementById("vectors").click();
    })""")
    assert not page.get_by_label("error vectors").is_checked()


STAGE = "document.getElementById('stage').dataset"


@in_every_view
def test_views_stand_beside_each_other_and_the_address_keeps_them(watched):
    page = watched.open(SCENE)
    page.select_option("#views", "beside")
    assert page.evaluate(STAGE + ".views") == "2"
    page.locator(".chooser summary").click()
    for name in ("lieeuler rattle4", "mujoco RK4"):
        page.get_by_role("checkbox", name=name, exact=True).check()
    assert page.evaluate(STAGE + ".views") == "4"
    page.get_by_label("error vectors").uncheck()
    page.locator("#stage").hover()
    page.mouse.wheel(0, -300)
    page.wait_for_function("location.hash.includes('camera')")
    address = page.url
    page.goto("about:blank")
    page.goto(address)
    assert page.evaluate(STAGE + ".views") == "4"
    assert "mujoco RK4" in page.evaluate(STAGE + ".shown")
    assert not page.get_by_label("error vectors").is_checked()
    page.get_by_role("button", name="reset view").click()
    page.wait_for_function("!location.hash.includes('camera')")


RED = """() => { const e = document.getElementById("stage");
  const p = e.getContext("2d").getImageData(0, 0, e.width, e.height).data;
  let red = 0; for (let k = 0; k < p.length; k += 4) red += p[k] === 193 && p[k + 1] === 18 && p[k + 2] === 31;
  return red; }"""


@pytest.mark.parametrize("watched", [(1280, "light")], indirect=True)
def test_a_joint_that_opens_reddens_and_errors_have_their_power_of_ten(watched, site, tmp_path):
    """The lower body of one run is put a centimetre aside; another run is left alone."""
    watched.folder = tmp_path / "report"
    shutil.copytree(site, watched.folder)
    script = watched.folder / "scene-double_pendulum.js"
    text = script.read_text(encoding="utf-8")
    packed = read_curves(text).runs["mujoco RK4"].x[1][2]
    old, new = (msgspec.json.encode(replace(packed, lo=packed.lo + aside, hi=packed.hi + aside)).decode()
                for aside in (0.0, 0.01))
    assert text.count(old) == 1
    script.write_text(text.replace(old, new), encoding="utf-8")
    page = watched.open(SCENE)
    assert page.evaluate(STAGE + ".open") == "0"
    assert page.evaluate(RED) == 0
    assert int(page.evaluate(STAGE + ".power")) > 1
    page.select_option("#run", label="mujoco RK4")
    assert float(page.evaluate(STAGE + ".open")) == pytest.approx(0.01, rel=1e-3)
    assert page.evaluate(RED) > 20
    assert page.evaluate(STAGE + ".power") == "1"  # a centimetre of a picture of two metres
    assert page.locator("#power").inner_text() == "× 10¹"


@in_every_view
def test_one_cursor_follows_playback_on_every_plot_over_time(watched):
    page = watched.open(SCENE)
    page.locator("#motion").scroll_into_view_if_needed()
    if not page.locator("[data-figure='position']").is_visible():
        page.locator("#motion").click()
    figure = page.locator("[data-figure='position']")
    figure.scroll_into_view_if_needed()
    figure.locator(":scope > .cursor").wait_for(state="attached")
    where = lambda share: page.evaluate(  # noqa: E731
        """share => { const e = document.getElementById("scrub"); e.value = 1000 * share;
        e.dispatchEvent(new Event("input"));
        const plot = document.querySelector("[data-figure='position']"), area = plot.querySelector(".nsewdrag");
        const bar = plot.querySelector(":scope > .cursor").getBoundingClientRect(), box = area.getBoundingClientRect();
        return (bar.left - box.left) / box.width; }""", share)
    assert [where(share) for share in (0.25, 0.5, 0.9)] == pytest.approx([0.25, 0.5, 0.9], abs=0.01)
    assert page.locator("[data-figure='speed'] > .cursor").count() == 0


@pytest.mark.parametrize("watched", [(1280, "light")], indirect=True)
@pytest.mark.parametrize("theme", ["light", "dark"])
def test_sixty_runs_are_rendered_in_sixty_ways(watched, theme):
    counts = {"lieeuler": 24, "mujoco": 10, "pinocchio": 8, "exudyn": 15, "drake": 3}
    sixty = [identity.look(engine, place) for engine, count in counts.items() for place in range(count)]
    page = watched.open(SCENE)
    page.wait_for_function("window.Plotly")
    drawn = page.evaluate("""async (looks) => {
        const box = document.body.appendChild(document.createElement("div"));
        await Plotly.newPlot(box, looks.map(([color, dash], k) => ({x: [0, 1], y: [k, k], mode: "lines",
          line: {color, dash, width: 1.6}})), {width: 600, height: 600});
        return [...box.querySelectorAll(".scatterlayer .js-line")].map((line) => getComputedStyle(line))
          .map((style) => [style.stroke, style.strokeDasharray]); }""",
                          [[getattr(each, theme), each.dash] for each in sixty])
    assert len(drawn) == 60
    colours = [(*map(int, re.findall(r"\d+", stroke)), dash) for stroke, dash in drawn]
    for one, other in itertools.combinations(colours, 2):
        apart = max(abs(a - b) for a, b in zip(one[:3], other[:3], strict=True))
        assert one[3] != other[3] or apart > 8, (one, other)
