"""The pages of modes and derivatives in a browser: figures, a shape that moves, nothing wider than a phone."""

import json

import pytest
from typer.testing import CliRunner

from crosscheck.cli.app import app
from tests.jointspace.test_modes import described


@pytest.fixture(scope="module")
def pages(tmp_path_factory):
    out = tmp_path_factory.mktemp("linear")
    (out / "hung.json").write_text(json.dumps(described(0.0)), "utf-8")
    for name, *arguments in (("modes", str(out / "hung.json"), "--over", "gravity.2=-12:-8", "--points", "3"),
                             ("derivatives", "hinge_pendulum")):
        answer = CliRunner().invoke(app, ["linearise", *arguments, "--out", str(out / name)])
        assert (out / name / "index.html").exists(), answer.output
    return out


@pytest.mark.parametrize("watched", [(1280, "light"), (390, "dark")], indirect=True)
def test_figures_are_drawn_and_the_shape_moves(watched):
    page = watched.open("modes/index.html")
    page.wait_for_selector("#curves .main-svg")
    assert page.evaluate("document.getElementById('curves').layout.xaxis.title.text") == "gravity 2 (m/s²)"
    assert page.evaluate("document.documentElement.scrollWidth") <= page.viewport_size["width"]
    watched.assert_accessible()
    still = page.locator("#stage").screenshot()
    page.locator("#scrub").evaluate("e => { e.value = 250; e.dispatchEvent(new Event('input')); }")
    assert page.locator("#clock").inner_text() != "0.00 s"
    assert page.locator("#stage").screenshot() != still
    assert page.locator("#actors").locator("*").count() > 2


@pytest.mark.parametrize("watched", [(390, "dark")], indirect=True)
def test_sources_are_drawn(watched):
    page = watched.open("derivatives/index.html")
    for name in ("cost", "curve"):
        page.wait_for_selector(f"#{name} .main-svg")
    assert page.evaluate("document.getElementById('cost').data.flatMap(trace => trace.x).length") == page.locator(
        "table.sortable tbody tr").count()
    assert page.evaluate("document.documentElement.scrollWidth") <= page.viewport_size["width"]
    watched.assert_accessible()
