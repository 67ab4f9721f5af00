"""The page of the stability study in a real browser: its figure, its colours, and nothing wider than a phone."""

import itertools

import msgspec
import pytest

from crosscheck.running import provenance
from crosscheck.studies import results_folder
from crosscheck.studies.bisection import Row
from crosscheck.studies.results_folder import StudyMeta
from crosscheck.studies.stability import Stability, StabilityAsk
from tests.browser.conftest import Watched

SCENES = ("single_pendulum", "fast_top_1500", "sleeping_top_below")
WAYS = (("lieeuler", "DAE1H_LSE"), ("lieeuler", "rkmk853"), ("mujoco", "implicitfast"), ("pinocchio", "RKMK8"),
        ("exudyn", "GeneralizedAlpha"))


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A page of figures made up, with a failure of every kind."""
    rows = []
    for index, (scene, (engine, method)) in enumerate(itertools.product(SCENES, WAYS)):
        if index == 4:
            found = {"outcome": "unsupported", "reason": "no such joint"}
        elif index == 7:
            found = {"outcome": "none within the limit", "reason": "finer runs would take more than 1 s " * 5,
                     "failures": "diverged 3"}
        else:
            found = {"outcome": "usable", "h_max": 0.3 / (1 + index) ** 2, "steps": 10 + index, "error": 0.09,
                     "milliseconds": 1.5, "common_step": 0.01, "common_outcome": "usable", "common_error": 1e-5 * index,
                     "failures": "inaccurate 3, map_domain 2"}
        rows.append(Row(scene, engine, method, **found))
    meta = msgspec.convert(provenance.describe(["lieeuler"]) | {
        "command": "crosscheck study stability", "seconds": 1.0, "time_limit": 1.0}, StudyMeta)
    out = tmp_path_factory.mktemp("stability")
    results_folder.write(out, Stability().document(StabilityAsk(), meta, rows), rows)
    return out


@pytest.mark.parametrize(("width", "scheme"), [(1280, "light"), (390, "dark")])
def test_the_page_draws_its_figure_and_fits(browser, folder, width, scheme):
    context = browser.new_context(viewport={"width": width, "height": 900}, color_scheme=scheme)
    watched = Watched(context, folder)
    page = watched.open("index.html")
    page.wait_for_selector("#dots .main-svg")
    assert page.evaluate("document.documentElement.scrollWidth") <= width
    assert page.evaluate("document.documentElement.dataset.theme") == scheme
    shown = "document.getElementById('dots').data.flatMap(trace => trace.y)"
    assert len(page.evaluate(shown)) == 4  # one way is not supported on the first scene
    page.select_option("#scene", "fast_top_1500")
    assert "lieeuler DAE1H_LSE" in page.evaluate(shown)
    page.select_option("#value", "common_error")
    assert "error" in page.evaluate("document.getElementById('dots').layout.xaxis.title.text")
    assert page.locator(".map td.none").count() == 1
    assert page.locator(".map td.shade0").count() == len(SCENES)
    context.close()
    assert watched.complaints == []
    assert watched.foreign == []
