"""The report: complete, well formed, self-contained, and readable in a browser."""

import csv
import dataclasses
import json
import math
import re
import shutil
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import pytest

from crosscheck import provenance, references, trust, verify
from crosscheck.errors import Unsupported
from crosscheck.report import pages, words
from crosscheck.studies.cell import Cell, prepare_truth, run_cell
from crosscheck.verdict import Finding, Record
from tests.fake_engine import FakeEngine, install

SCENE = "single_pendulum"
CHROMIUM = shutil.which("chromium")


@pytest.fixture(scope="module")
def results():
    """One run of each outcome on one scene, and a scene without truth."""
    with pytest.MonkeyPatch.context() as patch:
        install(patch, FakeEngine())
        scene = prepare_truth((SCENE, True))
        plan = scene.pop("plan")
        records = [run_cell(Cell(SCENE, "fake", "Plain", None, plan, True))]
        install(patch, FakeEngine(breaks="it broke with <b>markup</b> & a \x07 bell"))
        records.append(run_cell(Cell(SCENE, "fake", "Broken", None, plan, False)))
        install(patch, FakeEngine(refuses="it cannot"))
        records.append(run_cell(Cell(SCENE, "fake", "Unable", None, plan, False)))
        meta = provenance.describe(["fake"])
    known = Record(SCENE, "fake", "1", "Flawed", None, 1e-3, None, 2, "crosscheck run")
    known.outcome = "known"
    known.findings = [Finding("energy", "known", math.inf, 1.0, "1", "bound", "its makers say so")]
    records.append(known)
    for record in records:
        record.label = f"{record.engine} {record.method}"
    scene["plan"] = dataclasses.asdict(plan)
    scene["recommended"] = trust.recommend(scene, records)
    scene["trust"] = trust.sentence(scene, records)
    lost = {"name": "lost", "failure": "no closed form", "details": "", "plan": None, "trust": "none",
            "recommended": None}
    meta |= {"profile": "default", "jobs": 1, "command": "crosscheck verify", "seconds": 1.0}
    return verify.Results(meta, [scene, lost], records)


@pytest.fixture(scope="module")
def folder(results, tmp_path_factory):
    return verify.write(results, tmp_path_factory.mktemp("reports") / "latest").parent


def test_every_file_is_there(folder):
    names = {path.name for path in folder.iterdir()}
    assert names == {"index.html", "scene-single_pendulum.html", "scene-single_pendulum.js", "report.css", "report.js",
                     "plotly.min.js", "summary.md", "results.csv", "junit.xml", "results.json"}


def test_junit_counts_outcomes_and_known_passes(folder):
    suite, _ = ElementTree.parse(folder / "junit.xml").getroot().findall("testsuite")
    assert {key: suite.get(key) for key in ("tests", "failures", "errors", "skipped")} == {
        "tests": "4", "failures": "1", "errors": "0", "skipped": "1"}
    cases = {case.get("name"): case for case in suite}
    assert cases["fake Plain"].find("failure") is None
    assert cases["fake Flawed"].find("failure") is None
    assert "its makers say so" in cases["fake Flawed"].find("system-out").text
    assert "it broke" in cases["fake Broken"].find("failure").get("message")


def test_csv_keeps_full_precision_and_every_run(folder, results):
    with open(folder / "results.csv", newline="", encoding="utf-8") as stream:
        rows = list(csv.DictReader(stream))
    assert [row["outcome"] for row in rows] == ["pass", "fail", "unsupported", "known"]
    assert float(rows[0]["position max error [m]"]) == results.records[0].errors["position"]["max"]


def test_json_is_strict_and_without_curves(folder):
    def refuse(constant):
        raise AssertionError(f"{constant} is no JSON")

    document = json.loads((folder / "results.json").read_text(encoding="utf-8"), parse_constant=refuse)
    assert len(document["records"]) == 4
    assert all("curves" not in record for record in document["records"])


def test_nothing_is_loaded_from_a_network(folder):
    for page in folder.glob("*.html"):
        text = page.read_text(encoding="utf-8")
        loaded = re.findall(r"<(?:script|link|img|iframe)[^>]*(?:src|href)=\"([^\"]*)\"", text)
        assert loaded
        assert all(name.startswith("data:") or (folder / name).is_file() for name in loaded)
        assert "fetch(" not in text
        assert 'type="module"' not in text
    css = (folder / "report.css").read_text(encoding="utf-8")
    assert "url(" not in css
    assert "@import" not in css


def test_links_between_pages_lead_somewhere(folder):
    ids = {page.name: set(re.findall(r'id="([^"]+)"', page.read_text(encoding="utf-8")))
           for page in folder.glob("*.html")}
    for page in folder.glob("*.html"):
        for target in re.findall(r'<a [^>]*href="([^"]+)"', page.read_text(encoding="utf-8")):
            if target.startswith("https://doi.org/"):
                continue
            name, _, place = target.partition("#")
            assert (folder / (name or page.name)).is_file()
            assert not place or place in ids[name or page.name]


def test_engine_messages_are_shown_as_text(folder):
    text = (folder / "scene-single_pendulum.html").read_text(encoding="utf-8")
    assert "&lt;b&gt;markup&lt;/b&gt;" in text
    assert "<b>markup" not in text


def test_the_page_states_truth_and_how_to_repeat(folder, results):
    text = (folder / "scene-single_pendulum.html").read_text(encoding="utf-8")
    assert results.scenes[0]["hash"] in text
    assert results.scenes[0]["truth"]["source"] in text
    assert results.records[0].command in text


def test_exit_codes(results):
    whole = [results.scenes[0]]
    passing, failing = results.records[0], results.records[1]
    assert verify.Results({}, whole, [passing, results.records[2], results.records[3]]).exit_code == 0
    assert verify.Results({}, whole, [passing, failing]).exit_code == 1
    assert results.exit_code == 2
    assert verify.Results({}, whole, []).exit_code == 2


def test_a_half_written_report_does_not_replace_a_good_one(results, tmp_path, monkeypatch):
    out = tmp_path / "latest"
    verify.write(results, out)
    before = (out / "index.html").read_text(encoding="utf-8")
    from crosscheck.report import exports

    def full_disk(document):
        raise OSError("no space left")

    monkeypatch.setattr(exports, "junit", full_disk)
    with pytest.raises(verify.ArgumentError, match="no space left"):
        verify.write(results, out)
    assert (out / "index.html").read_text(encoding="utf-8") == before
    assert [path.name for path in tmp_path.iterdir()] == ["latest"]


def test_recommendation_names_the_fastest_passing_run(results):
    def run(name, seconds, deviation=1e-6):
        return dataclasses.replace(results.records[0], label=name, seconds_per_second=seconds,
                                   seconds_deviation=deviation)

    fast, slow = run("fake Fast", 1e-3), run("fake Slow", 2e-3)
    said = trust.sentence(results.scenes[0], [slow, fast, results.records[1]])
    assert said.startswith("Trust fake Fast:")
    assert "Not to be trusted here: fake Broken" in said
    found = trust.recommend(results.scenes[0], [slow, fast])
    # The figures are those of the judged run, not of some point of a study.
    assert (found["step"], found["error"]) == (fast.step, fast.errors["position"]["judged"])
    # 5 % is within the ratio of noise, and 50 % within four deviations of a restless clock: no winner.
    near, restless = run("fake Near", 1.05e-3), run("fake Restless", 1.5e-3, deviation=2e-4)
    found = trust.recommend(results.scenes[0], [slow, restless, near, fast])
    assert found["runs"] == ["fake Fast", "fake Near", "fake Restless"]


def test_the_headline_claims_no_more_than_was_found(results):
    passing, known = results.records[0], results.records[3]
    assert words.headline(verify.Results({}, results.scenes[:1], [passing]).plain()).startswith("All 1 runs")
    said = words.headline(verify.Results({}, results.scenes[:1], [passing, known]).plain())
    assert said == "No unexpected finding: 1 pass, 1 known defect"
    short = dataclasses.replace(passing, judged_until=1.0)
    assert (short.word, passing.word) == ("pass to 1 s", "pass")
    assert dataclasses.replace(passing, practical=True).word == "stable"


def test_every_scene_has_a_page_of_its_own():
    names = ["top", "Top", "a/top.toml", "b/top.toml", "a top", "a-top", "a/b.toml", "a-b-toml"]
    assert len({pages.scene_file({"name": name}).lower() for name in names}) == len(names)


@pytest.fixture(scope="module")
def folder_without_truth(tmp_path_factory):
    """A report of a scene that has no truth: one run in order, one whose attitudes leave the group."""
    def none(scene):
        raise Unsupported("no reference equations")

    exact = references.truth  # the engine of the tests takes its states from there
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(references, "truth", none)
        scene = prepare_truth((SCENE, True))
        patch.setattr(references, "truth", exact)
        plan, reason = scene.pop("plan"), scene["no_truth"]
        records = []
        for method, held in (("Plain", frozenset()), ("Broken", frozenset({"position"}))):
            install(patch, FakeEngine(held=held))
            records.append(run_cell(Cell(SCENE, "fake", method, None, plan, no_truth=reason)))
        meta = provenance.describe(["fake"])
    for record in records:
        record.label = f"{record.engine} {record.method}"
    scene |= {"plan": dataclasses.asdict(plan), "recommended": trust.recommend(scene, records),
              "trust": trust.sentence(scene, records)}
    meta |= {"profile": "default", "jobs": 1, "command": "crosscheck verify", "seconds": 1.0}
    results = verify.Results(meta, [scene], records)
    return results, verify.write(results, tmp_path_factory.mktemp("reports") / "latest").parent


def test_a_scene_without_truth_is_run_and_judged_by_what_needs_none(folder_without_truth):
    results, folder = folder_without_truth
    good, bad = results.records
    assert (good.outcome, good.message) == ("unjudged", "unjudged: no truth (no reference equations)")
    assert {"energy", "orthogonality", "run"} == {each.kind for each in good.findings if each.status == "ok"}
    # The engine of the tests moves bodies off their joints, so that a claim to hold them is false.
    assert bad.outcome == "fail"
    assert bad.worst.kind == "level position"
    assert results.exit_code == 1
    assert verify.Results({}, results.scenes, [good]).exit_code == 0
    assert verify.Results({}, [results.scenes[0] | {"disputed": True}], [good]).exit_code == 2
    assert "no reference equations" in (folder / "scene-single_pendulum.html").read_text(encoding="utf-8")


@pytest.mark.skipif(CHROMIUM is None, reason="no Chromium on this machine")
def test_a_page_without_truth_opens_without_an_error(folder_without_truth):
    check_pages(folder_without_truth[1], 1280, 8)


@pytest.mark.skipif(CHROMIUM is None, reason="no Chromium on this machine")
@pytest.mark.parametrize("width", [1280, 390])
def test_pages_open_from_disk_without_an_error(folder, width):
    check_pages(folder, width, 15)


def check_pages(folder, width, figures):
    """Open the pages and scroll through them: no complaint, nothing from a network, no page wider than the window."""
    playwright = pytest.importorskip("playwright.sync_api")
    complaints, foreign = [], []
    with playwright.sync_playwright() as driver:
        browser = driver.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox"])
        for name in ("index.html", "scene-single_pendulum.html"):
            page = browser.new_page(viewport={"width": width, "height": 900})
            page.on("console", lambda message: complaints.append(message.text) if message.type == "error" else None)
            page.on("pageerror", lambda error: complaints.append(str(error)))
            page.on("request", lambda request: foreign.append(request.url) if request.url.startswith("http") else None)
            page.goto(Path(folder / name).as_uri())
            if name != "index.html":
                for plot in page.query_selector_all("[data-plot], [data-panels]"):
                    plot.scroll_into_view_if_needed()
                page.wait_for_function("[...document.querySelectorAll('[data-plot]')].every(e => e.children.length)")
                assert page.locator(".js-plotly-plot").count() >= figures
            # Wide tables scroll inside their boxes, never the page.
            assert page.evaluate("document.documentElement.scrollWidth") <= width
        browser.close()
    assert complaints == []
    assert foreign == []
