"""The page of the stability study in a real browser: its figure, its colours, and nothing wider than a phone."""

import pytest

from tests.browser.conftest import Watched
from tests.browser.pages_making import SCENES, stability


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A page of made-up figures, with a failure of every kind."""
    out = tmp_path_factory.mktemp("stability")
    stability(out)
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
    assert len(page.evaluate(shown)) == 4  # one method is not supported on the first scene
    page.select_option("#scene", "fast_top_1500")
    assert "lieeuler DAE1H_LSE" in page.evaluate(shown)
    page.select_option("#value", "common_error")
    assert "error" in page.evaluate("document.getElementById('dots').layout.xaxis.title.text")
    assert page.locator(".map td.none").count() == 1
    assert page.locator(".map td.shade0").count() == len(SCENES)
    context.close()
    assert watched.complaints == []
    assert watched.foreign == []
