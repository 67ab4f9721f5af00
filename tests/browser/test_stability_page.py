"""The page of the stability study in a real browser: its figure, its colours, and nothing wider than a phone."""

import pytest

from tests.browser.pages_making import SCENES, stability


@pytest.fixture(scope="module")
def pages(tmp_path_factory):
    """A page of made-up figures, with a failure of every kind."""
    out = tmp_path_factory.mktemp("stability")
    stability(out)
    return out


@pytest.mark.parametrize("watched", [(1280, "light"), (390, "dark")], indirect=True)
def test_the_page_draws_its_figure_and_fits(watched):
    page = watched.open("index.html")
    page.wait_for_selector("#dots .main-svg")
    assert page.evaluate("document.documentElement.scrollWidth") <= page.viewport_size["width"]
    wide = page.viewport_size["width"] == 1280
    assert page.evaluate("document.documentElement.dataset.theme") == ("light" if wide else "dark")
    shown = "document.getElementById('dots').data.flatMap(trace => trace.y)"
    assert len(page.evaluate(shown)) == 4  # one method is not supported on the first scene
    page.select_option("#scene", "fast_top_1500")
    assert "lieeuler DAE1H_LSE" in page.evaluate(shown)
    page.select_option("#value", "common_error")
    assert "error" in page.evaluate("document.getElementById('dots').layout.xaxis.title.text")
    assert page.locator(".map td.none").count() == 1
    assert page.locator(".map td.shade0").count() == len(SCENES)
