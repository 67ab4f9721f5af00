"""The report: complete, well formed, self-contained, and readable in a browser."""

import csv
import json
import re
import runpy
import shutil
import xml.etree.ElementTree as ElementTree

import pytest
from msgspec.structs import replace
from typer.testing import CliRunner

from crosscheck import document as types
from crosscheck import references, report
from crosscheck import report as report_folder
from crosscheck.cli.app import app
from crosscheck.document import (
    Way,
)
from crosscheck.errors import ArgumentError, Unsupported
from crosscheck.report import exports, schema
from crosscheck.verification.cell import run_cell
from crosscheck.verification.plan import Profile
from crosscheck.verification.scene_truth import prepare_truth
from crosscheck.verification.task import Cell
from tests import ROOT
from tests.fake_engine import FakeEngine, install
from tests.report_making import CHANGES, document, made

SCENE = "single_pendulum"


def test_every_file_is_there(folder):
    found = {path.name for path in folder.iterdir()}
    assert found == {"index.html", "scene-single_pendulum.html", "scene-single_pendulum.js", "engine-fake.html",
                     "study-convergence.html", "study-conservation.html", "runs.js", "report.css",
                     "theme.js", "site.js", "sites.js", "tables.js", "decision.js", "plots.js", "study.js", "scene.js",
                     "emphasis.js", "pens.js", "geometry.js", "playback.js", "plotly.min.js", "summary.md",
                     "results.csv", "junit.xml", "results.json"}
    assert all(report.is_file_of_report(path) for path in folder.iterdir())


def test_junit_counts_outcomes_and_known_passes(folder):
    suite, _ = ElementTree.parse(folder / "junit.xml").getroot().findall("testsuite")
    assert {key: suite.get(key) for key in ("tests", "failures", "errors", "skipped")} == {
        "tests": "4", "failures": "1", "errors": "0", "skipped": "1"}
    cases = {case.get("name"): case for case in suite}
    assert cases["fake Plain"].find("failure") is None
    assert cases["fake Flawed"].find("failure") is None
    assert "its makers say so" in cases["fake Flawed"].find("system-out").text
    told = json.loads((folder / "results.json").read_text(encoding="utf-8"))["records"]
    outcomes = {record["label"]: record["outcome"] for record in told if record["scene"] == suite.get("name")}
    assert {name: case.find("system-out").text.splitlines()[0] for name, case in cases.items()} == {
        name: f"outcome: {outcome}" for name, outcome in outcomes.items()}
    assert "it broke" in cases["fake Broken"].find("failure").get("message")


def test_csv_keeps_full_precision_and_every_run(folder, results):
    with open(folder / "results.csv", newline="", encoding="utf-8") as stream:
        rows = list(csv.DictReader(stream))
    assert [row["outcome"] for row in rows] == ["pass", "fail", "unsupported", "known"]
    assert float(rows[0]["position max error [m]"]) == results.records[0].errors["position"].max


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
            name = name.partition("?")[0]
            assert (folder / (name or page.name)).is_file()
            assert not place or place in ids[name or page.name]


def test_engine_messages_are_shown_as_text(folder):
    text = (folder / "scene-single_pendulum.html").read_text(encoding="utf-8")
    assert "&lt;b&gt;markup&lt;/b&gt;" in text
    assert "<b>markup" not in text


def test_the_page_states_truth_and_how_to_repeat(folder, results):
    text = (folder / "scene-single_pendulum.html").read_text(encoding="utf-8")
    assert results.scenes[0].hash in text
    assert results.scenes[0].truth.source in text
    assert results.records[0].command in text


def test_exit_codes(results):
    whole = [results.scenes[0]]
    passing, failing = results.records[0], results.records[1]
    assert made(whole, [passing, results.records[2], results.records[3]]).exit_code == 0
    assert made(whole, [results.records[2]]).exit_code == 3  # what is unsupported, alone
    assert made(whole, [passing, failing]).exit_code == 1
    assert (results.outcome, results.exit_code) == ("error", 1)  # the truth of a scene failed
    assert made(whole, []).exit_code == 3
    part = replace(passing, outcome="unresolved", share=0.9)
    assert made(whole, [passing, part, results.records[3]]).exit_code == 3
    assert made(whole, [passing, part, failing]).exit_code == 1
    lax = document(whole, [part], ["lieeuler"], need=0.9)
    assert (lax.exit_code, lax.records[0].word) == (0, "pass, resolved over 90 %")


def test_a_half_written_report_does_not_replace_a_good_one(results, tmp_path, monkeypatch):
    out = tmp_path / "latest"
    report_folder.write(results, out)
    before = (out / "index.html").read_text(encoding="utf-8")
    def full_disk(document):
        raise OSError("no space left")

    monkeypatch.setattr(exports, "junit", full_disk)
    with pytest.raises(ArgumentError, match="no space left"):
        report_folder.write(results, out)
    assert (out / "index.html").read_text(encoding="utf-8") == before
    assert [path.name for path in tmp_path.iterdir()] == ["latest"]


@pytest.fixture(scope="module")
def folder_without_truth(tmp_path_factory):
    """A report of a scene that has no truth: one good run, one whose attitudes leave the group."""
    def none(scene):
        raise Unsupported("no reference equations")

    exact = references.truth  # the engine of the tests takes its states from there
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(references, "truth", none)
        scene = prepare_truth((SCENE, None, Profile.most_steps))
        patch.setattr(references, "truth", exact)
        runs = []
        for method, held in (("Plain", frozenset()), ("Broken", frozenset({"position"}))):
            install(patch, FakeEngine(held=held))
            runs.append(run_cell(Cell(SCENE, Way("fake", method), scene.plan, no_truth=scene.no_truth)))
        results = document([scene], runs, ["fake"])
    return results, report_folder.write(results, tmp_path_factory.mktemp("reports") / "latest").parent


def test_a_scene_without_truth_is_run_and_judged_by_what_needs_none(folder_without_truth):
    results, folder = folder_without_truth
    good, bad = results.records
    assert (good.outcome, good.message) == ("unresolved", "no truth: no reference equations")
    assert {"promise orthogonality", "asked end", "asked steps"} <= {
        each.kind for each in good.findings if each.status == "ok"}
    # The engine of the tests moves bodies off their joints, so that a claim to hold them is false.
    assert bad.outcome == "fail"
    assert bad.worst.kind == "promise level position"
    assert results.exit_code == 1
    assert made(results.scenes, [good]).exit_code == 3
    assert made([replace(results.scenes[0], disputed=True)], [good]).exit_code == 1
    assert "no reference equations" in (folder / "scene-single_pendulum.html").read_text(encoding="utf-8")


def test_the_pages_are_rendered_again_alike_from_what_the_report_holds(folder, tmp_path):
    copy = tmp_path / "latest"
    shutil.copytree(folder, copy)
    before = {path.name: path.read_bytes() for path in copy.iterdir()}
    (copy / "index.html").write_text("broken")
    (copy / "study-former.html").write_text("a page of a former layout")
    assert report.rewrite_pages(copy) == copy / "index.html"
    assert {path.name for path in copy.iterdir()} == set(before)
    for name, content in before.items():
        assert (copy / name).read_bytes() == content, name


@pytest.mark.parametrize(("change", "said"), [
    ({"schema": 0}, "schema 0 is not 5"),
    ({"records": [{"scene": "x"}]}, r"missing required field .*records\[0\]"),
    ({"meta": None}, r"\$.meta"),
    ({"scenes": [{"name": "x", "failure": 1}]}, r"scenes\[0\]"),
])
def test_a_wrong_results_json_is_refused_with_its_place(folder, tmp_path, change, said):
    path = tmp_path / "results.json"
    path.write_text(json.dumps(json.loads((folder / "results.json").read_text(encoding="utf-8")) | change))
    with pytest.raises(ArgumentError, match=said):
        report.load_report(tmp_path)
    path.write_text("{")
    with pytest.raises(ArgumentError, match="no JSON"):
        report.load_report(tmp_path)
    path.unlink()
    with pytest.raises(ArgumentError, match="cannot be read"):
        report.load_report(tmp_path)


def test_the_schema_lists_every_key_that_is_written(folder, folder_without_truth):
    for each in (folder, folder_without_truth[1]):
        document = json.loads((each / "results.json").read_text(encoding="utf-8"))
        schema.from_plain(document)
        assert unlisted(document, schema.json_schema(), schema.json_schema()) == set()


def test_the_page_of_the_schema_names_every_key():
    reference = runpy.run_path(str(ROOT / "docs" / "reference.py"))
    written = reference["fields"]()
    sections = dict(re.findall(r"^## (\w+)$(.*?)(?=^## |\Z)", written, re.MULTILINE | re.DOTALL))
    assert sections.keys() == schema.json_schema()["$defs"].keys() | {"Way", "Origin"}
    for name, text in sections.items():
        named = set(re.findall(r"^\| `(\w+)`", text, re.MULTILINE))
        assert named == set(vars(getattr(types, name))["__annotations__"]), name


def unlisted(value, described, whole, place="$"):
    """Places of a document that its JSON Schema does not name."""
    kinds = described.get("anyOf", [described])
    kinds = [whole["$defs"][kind["$ref"].rpartition("/")[2]] if "$ref" in kind else kind for kind in kinds]
    if isinstance(value, list):
        kinds = [kind for kind in kinds if kind.get("type") == "array"]
        items = kinds[0].get("items") or {}  # false: only the listed ones, which are numbers
        return set().union(*(unlisted(each, items, whole, f"{place}[]") for each in value))
    if not isinstance(value, dict):
        return set()
    named = [kind["properties"] for kind in kinds if "properties" in kind]
    if not named:
        free = next((kind.get("additionalProperties") for kind in kinds if "additionalProperties" in kind), None)
        return set().union(*(unlisted(each, free, whole, f"{place}.*") for each in value.values())) if free else set()
    fitting = min(named, key=lambda keys: len(set(value) - set(keys)))
    missing = {f"{place}.{key}" for key in set(value) - set(fitting)}
    return missing.union(*(unlisted(each, fitting[key], whole, f"{place}.{key}") for key, each in value.items()
                           if key in fitting))


def test_changes_are_shown_where_the_document_has_them(results, tmp_path):
    plain = results
    report.write_report(replace(plain, changes=CHANGES), tmp_path / "with")
    first = (tmp_path / "with" / "index.html").read_text(encoding="utf-8")
    places = [first.index(each) for each in ("Is it right, to what", "What is wrong", "the largest error grew beyond")]
    assert places == sorted(places)
    assert "the largest error grew beyond rounding" in (tmp_path / "with" / "summary.md").read_text(encoding="utf-8")
    assert schema.read_document(tmp_path / "with" / "results.json").changes == CHANGES
    report.write_report(replace(plain, changes=[]), tmp_path / "none")
    assert "Nothing beyond rounding" in (tmp_path / "none" / "index.html").read_text(encoding="utf-8")
    report.write_report(plain, tmp_path / "first")
    assert "What changed" not in (tmp_path / "first" / "index.html").read_text(encoding="utf-8")


def test_figures_for_papers_are_the_same_every_time(folder, tmp_path):
    from crosscheck.report.figures import write_figures

    document = report.load_report(folder)
    written = write_figures(document, tmp_path / "one")
    assert {path.name for path in written} >= {"scene-single_pendulum-position-error.svg",
                                               "scene-single_pendulum-convergence.svg",
                                               "scene-single_pendulum-path.svg", "scene-single_pendulum-energies.svg",
                                               "scene-single_pendulum-rotation-pendulum.svg"}
    for path in write_figures(document, tmp_path / "other"):
        text = path.read_text(encoding="utf-8")
        assert text == (tmp_path / "one" / path.name).read_text(encoding="utf-8")
        ElementTree.fromstring(text)
    text = (tmp_path / "one" / "scene-single_pendulum-position-error.svg").read_text(encoding="utf-8")
    assert "position error (m)" in text  # text, not outlines of letters
    assert "fake Plain" in text


def test_the_command_renders_and_refuses(folder, tmp_path):
    runner = CliRunner()
    copy = tmp_path / "latest"
    shutil.copytree(folder, copy)
    (copy / "index.html").unlink()
    done = runner.invoke(app, ["report", str(copy / "results.json")])
    assert done.exit_code == 0
    assert str(copy / "index.html") in done.output
    assert (copy / "index.html").exists()
    assert isinstance(runner.invoke(app, ["report", str(copy), "--format", "doc"]).exception, ArgumentError)
    assert "no such folder" in str(runner.invoke(app, ["report", str(tmp_path / "nowhere")]).exception)


