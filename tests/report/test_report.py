"""The report: complete, well formed, self-contained, and readable in a browser."""

import csv
import json
import math
import re
import shutil
import xml.etree.ElementTree as ElementTree

import pytest
from msgspec.structs import replace
from typer.testing import CliRunner

from crosscheck import document as types
from crosscheck import references, report
from crosscheck.cli.app import app
from crosscheck.document import (
    Finding,
    Judged,
    Machine,
    Meta,
    Recommended,
    Scene,
    SceneTruth,
    Support,
    extended,
)
from crosscheck.errors import ArgumentError, Unsupported
from crosscheck.history import summary
from crosscheck.jobs.journal import Journal
from crosscheck.judge.plan import Profile
from crosscheck.report import exports, headline, names, overview, pdf, schema
from crosscheck.report import folder as report_folder
from crosscheck.verification import job, trust
from crosscheck.verification.cell import run_cell
from crosscheck.verification.scene_truth import prepare_truth
from crosscheck.verification.task import Cell
from tests import ROOT
from tests.fake_engine import FakeEngine, install
from tests.report_making import CHANGES, document

SCENE = "single_pendulum"
DOCS = ROOT / "docs"


def failed_scene(name, failure):
    """A scene that could not be prepared."""
    return SceneTruth(name=name, title=name, description="", source="", hash="", bodies=[], duration=0.0, plan=None,
                      truth=None, scales=None, failure=failure)


def made(scenes, records):
    """A document of nothing but these."""
    meta = Meta(time="2026-11-21 02:00 UTC", engines={}, packages={}, python="3.11", commit=None, profile="default",
                machine=Machine(system="Linux", processor="some", cores=2), jobs=1, command="crosscheck verify",
                seconds=1.0)
    return job.document(meta, scenes, records)


@pytest.fixture(scope="module")
def results():
    """One run of each outcome on one scene, and a scene without truth."""
    with pytest.MonkeyPatch.context() as patch:
        install(patch, FakeEngine())
        scene = prepare_truth((SCENE, True, Profile.most_steps))
        runs = [run_cell(Cell(SCENE, "fake", "Plain", None, scene.plan, True))]
        install(patch, FakeEngine(breaks="it broke with <b>markup</b> & a \x07 bell"))
        runs.append(run_cell(Cell(SCENE, "fake", "Broken", None, scene.plan, False)))
        install(patch, FakeEngine(refuses="it cannot"))
        runs.append(run_cell(Cell(SCENE, "fake", "Unable", None, scene.plan, False)))
        runs.append(Judged(
            scene=SCENE, engine="fake", version="1", method="Flawed", form=None, step=1e-3, documented_order=2,
            command="crosscheck run", outcome="known",
            findings=[Finding("energy", "known", math.inf, 1.0, "1", "bound", "its makers say so")]))
        return document([scene, failed_scene("lost", "no closed form")], runs, ["fake"])


@pytest.fixture(scope="module")
def folder(results, tmp_path_factory):
    return report_folder.write(results, tmp_path_factory.mktemp("reports") / "latest").parent


def test_every_file_is_there(folder):
    found = {path.name for path in folder.iterdir()}
    assert found == {"index.html", "scene-single_pendulum.html", "scene-single_pendulum.js", "engine-fake.html",
                     "study-convergence.html", "study-speed.html", "study-conservation.html", "runs.js", "report.css",
                     "theme.js", "tables.js", "decision.js", "plots.js", "study.js", "scene.js", "playback.js",
                         "plotly.min.js",
                     "summary.md", "results.csv", "results.parquet", "junit.xml", "results.json"}
    assert all(report.is_file_of_report(path) for path in folder.iterdir())


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
    assert float(rows[0]["position max error [m]"]) == results.records[0].errors["position"].max


def test_parquet_holds_the_same_table(folder):
    import pandas

    table, same = pandas.read_csv(folder / "results.csv"), pandas.read_parquet(folder / "results.parquet")
    assert list(same) == list(table)
    for title in table.select_dtypes("number"):
        assert same[title].astype(float).equals(table[title].astype(float)), title


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
    assert made(whole, [passing, failing]).exit_code == 1
    assert results.exit_code == 2
    assert made(whole, []).exit_code == 2


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


def test_recommendation_names_the_fastest_passing_run(results):
    def run(name, seconds, deviation=1e-6):
        return replace(results.records[0], label=name, seconds_per_second=seconds,
                                   seconds_deviation=deviation)

    fast, slow = run("fake Fast", 1e-3), run("fake Slow", 2e-3)
    said = trust.sentence(results.scenes[0], [slow, fast, results.records[1]])
    assert said.startswith("Trust fake Fast:")
    assert "Not to be trusted here: fake Broken" in said
    found = trust.recommend(results.scenes[0], [slow, fast])
    # The figures are those of the judged run, not of some point of a study.
    assert (found.step, found.error) == (fast.step, fast.errors["position"].judged)
    # 5 % is within the ratio of noise, and 50 % within four deviations of a restless clock: no winner.
    near, restless = run("fake Near", 1.05e-3), run("fake Restless", 1.5e-3, deviation=2e-4)
    found = trust.recommend(results.scenes[0], [slow, restless, near, fast])
    assert found.runs == ["fake Fast", "fake Near", "fake Restless"]
    # Of a run a hundred times slower a third of its time is no noise of the fastest.
    found = trust.recommend(results.scenes[0], [run("fake Crawling", 0.1, deviation=0.03), fast])
    assert found.runs == ["fake Fast"]


def test_the_headline_claims_no_more_than_was_found(results):
    passing, known = results.records[0], results.records[3]
    assert headline.headline(made(results.scenes[:1], [passing])) == "The only run passes"
    assert headline.headline(made(results.scenes[:1], [passing, results.records[2]])) == (
        "The only run that could be made passes")
    assert headline.headline(made(results.scenes[:1], [passing] * 3)) == "All 3 runs pass"
    said = headline.headline(made(results.scenes[:1], [passing, known]))
    assert said == "1 run passes, 1 shows only known defects, none fails"
    assert headline.headline(made(results.scenes[:1], [])) == "Nothing was run"
    short = made(results.scenes[:1], [replace(passing, judged_until=1.0)]).records[0]
    assert (short.word, passing.word) == ("pass to 1 s", "pass")
    assert made(results.scenes[:1], [replace(passing, practical=True)]).records[0].word == "stable"


def test_the_headline_tells_passes_what_is_worse_and_what_was_not_judged_and_why(results):
    plain = results  # one run of each outcome, beside a scene without truth
    said = headline.headline(replace(plain, changes=CHANGES))
    assert said == ("1 run passes, 1 shows only known defects, 1 fails (fake Broken on single pendulum); worse than "
                    "before: accuracy (mujoco RK4 on double pendulum); lost could not be judged: no closed form")
    assert "nothing is worse than before" in headline.headline(replace(plain, changes=CHANGES[1:]))
    many = [results.records[0]] * 3 + [results.records[1]] * 141
    disputed = {"no_truth": "'single_pendulum': A and B disagree by 1e-9; the rest", "disputed": True}
    said = headline.headline(made([replace(results.scenes[0], **disputed)], many))
    assert said == "3 runs pass, 141 fail on 1 scene; single pendulum could not be judged: A and B disagree by 1e-9"
    lost = [failed_scene(str(index), "it broke") for index in range(4)]
    assert headline.headline(made(lost, many[:1])).endswith(
        "4 scenes could not be judged: 0 (it broke), 1 (it broke) and 2 more")


def test_the_same_words_open_the_page_the_markdown_and_the_message(results, folder, tmp_path):
    plain = results
    said = headline.headline(plain)
    heading = re.search(r"<h1>(.*?)</h1>", (folder / "index.html").read_text(encoding="utf-8")).group(1)
    assert re.sub(r"<[^>]*>", "", heading) == said
    assert (folder / "summary.md").read_text(encoding="utf-8").startswith(f"# {said}\n")
    message = summary.summary(plain, "2026-11-21", None, 2, tmp_path / "index.html")
    assert said in message.splitlines()[0]
    assert "- fake: fake Broken on single_pendulum, it broke" in message
    assert len(message.splitlines()) < 20


def test_many_findings_stand_in_few_groups_the_new_ones_first(results):
    order = Finding("order position", "fail", 1.0, 3.85, "1", "documented order 4, least squares over 4 steps of 4")
    drift = Finding("position", "fail", 1.0, 1e-6, "m", "bound", "body rod, t = 0.3 s, judged up to 1 s")
    records = []
    for engine, finding in (("fake", order), ("other", drift)):
        records += [replace(results.records[0], scene=f"s{index}", engine=engine, label=f"{engine} Plain",
                                        outcome="fail", findings=[replace(finding, value=1.0 + index,
                                                                                      detail=f"at {index}")])
                    for index in range(20)]
    records = made([], records).records
    groups = overview.worst_first(records)
    assert [(group.engine, group.why, len(group.runs), group.scenes) for group in groups] == [
        ("other", "error of the motion beyond its bound", 20, 20),
        ("fake", "observed order below the documented one", 20, 20)]
    assert groups[0].runs[0][0].scene == "s19"  # the largest excess
    new = [replace(CHANGES[0], scene="s7", engine="fake", method="Plain")]
    first, second = overview.worst_first(records, new)
    assert (first.engine, first.new, second.engine, second.new) == ("fake", 1, "other", 0)


def test_scenes_share_a_line_of_advice_where_the_same_run_is_recommended_for_the_same_reason():
    def scene(name, run, why):
        best = Recommended(runs=[run], step=None, rtol=None, error=1e-9, until=None, seconds=None, why=why)
        return extended(Scene, failed_scene(name, ""), recommended=best if run else None,
                        trust=f"No recommendation: {why}. Not to be trusted here: x.")

    groups = overview.recommended([scene("a", None, "none passed"), scene("b", "m RK4", "fastest, 3 checks passed"),
                                   scene("c", "l taylor", "fastest, 13 checks passed"),
                                   scene("d", "l taylor", "fastest, 12 checks passed")])
    assert [(group.run, group.why, [each.name for each in group.scenes]) for group in groups] == [
        ("l taylor", "fastest", ["c", "d"]), ("m RK4", "fastest", ["b"]),
        (None, "No recommendation: none passed.", ["a"])]


def test_every_scene_has_a_page_of_its_own():
    scenes = ["top", "Top", "a/top.toml", "b/top.toml", "a top", "a-top", "a/b.toml", "a-b-toml"]
    assert len({names.scene_file(failed_scene(name, "")).lower() for name in scenes}) == len(scenes)


@pytest.fixture(scope="module")
def folder_without_truth(tmp_path_factory):
    """A report of a scene that has no truth: one run in order, one whose attitudes leave the group."""
    def none(scene):
        raise Unsupported("no reference equations")

    exact = references.truth  # the engine of the tests takes its states from there
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(references, "truth", none)
        scene = prepare_truth((SCENE, True, Profile.most_steps))
        patch.setattr(references, "truth", exact)
        runs = []
        for method, held in (("Plain", frozenset()), ("Broken", frozenset({"position"}))):
            install(patch, FakeEngine(held=held))
            runs.append(run_cell(Cell(SCENE, "fake", method, None, scene.plan, no_truth=scene.no_truth)))
        results = document([scene], runs, ["fake"])
    return results, report_folder.write(results, tmp_path_factory.mktemp("reports") / "latest").parent


def test_a_scene_without_truth_is_run_and_judged_by_what_needs_none(folder_without_truth):
    results, folder = folder_without_truth
    good, bad = results.records
    assert (good.outcome, good.message) == ("unjudged", "unjudged: no truth (no reference equations)")
    assert {"energy", "orthogonality", "run"} == {each.kind for each in good.findings if each.status == "ok"}
    # The engine of the tests moves bodies off their joints, so that a claim to hold them is false.
    assert bad.outcome == "fail"
    assert bad.worst.kind == "level position"
    assert results.exit_code == 1
    assert made(results.scenes, [good]).exit_code == 0
    assert made([replace(results.scenes[0], disputed=True)], [good]).exit_code == 2
    assert "no reference equations" in (folder / "scene-single_pendulum.html").read_text(encoding="utf-8")


def test_the_pages_are_rendered_again_alike_from_what_the_report_holds(folder, tmp_path):
    copy = tmp_path / "latest"
    shutil.copytree(folder, copy)
    before = {path.name: path.read_bytes() for path in copy.iterdir()}
    (copy / "index.html").write_text("broken")
    (copy / "study-former.html").write_text("a page of a former layout")
    assert report.render_again(copy) == copy / "index.html"
    assert {path.name for path in copy.iterdir()} == set(before)
    for name, content in before.items():
        if not name.endswith(".parquet"):
            assert (copy / name).read_bytes() == content, name


@pytest.mark.parametrize(("change", "said"), [
    ({"schema": 0}, "schema 0 is not 1"),
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
    """A key that is new has to be described in `crosscheck.document` and docs/results-schema.md."""
    for each in (folder, folder_without_truth[1]):
        document = json.loads((each / "results.json").read_text(encoding="utf-8"))
        schema.from_plain(document)
        assert unlisted(document, schema.json_schema(), schema.json_schema()) == set()


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


def test_the_schema_file_is_the_one_of_the_code():
    text = (DOCS / "results-schema.json").read_text(encoding="utf-8")
    assert json.loads(text) == schema.json_schema()
    words_of_it = (DOCS / "results-schema.md").read_text(encoding="utf-8")
    assert f"version {types.SCHEMA}" in words_of_it
    for struct in (types.Document, types.Meta, types.Scene, types.Record, types.Finding):
        for key in set(struct.__struct_fields__) - {"curves"}:  # in files of their own
            assert f"`{key}`" in words_of_it, (struct.__name__, key)


def test_changes_and_support_are_shown_where_the_document_has_them(results, tmp_path):
    plain = results
    row = Support(scene=SCENE, engine="fake", form="tree", reason="it is not made for this")
    report.write_report(replace(plain, changes=CHANGES, support=[row]), tmp_path / "with")
    first = (tmp_path / "with" / "index.html").read_text(encoding="utf-8")
    assert first.index("the largest error grew beyond rounding") < first.index("What is wrong, worst first")
    assert "the largest error grew beyond rounding" in (tmp_path / "with" / "summary.md").read_text(encoding="utf-8")
    for page in ("scene-single_pendulum.html", "engine-fake.html"):
        assert "it is not made for this" in (tmp_path / "with" / page).read_text(encoding="utf-8")
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
                                               "scene-single_pendulum-convergence.svg"}
    for path in write_figures(document, tmp_path / "other"):
        text = path.read_text(encoding="utf-8")
        assert text == (tmp_path / "one" / path.name).read_text(encoding="utf-8")
        ElementTree.fromstring(text)
    text = (tmp_path / "one" / "scene-single_pendulum-position-error.svg").read_text(encoding="utf-8")
    assert "position error (m)" in text  # text, not outlines of letters
    assert "fake Plain" in text


def test_pdf_without_a_browser_says_what_to_do(folder, monkeypatch):
    monkeypatch.setenv("PATH", "")
    monkeypatch.delenv("CROSSCHECK_BROWSER", raising=False)
    with pytest.raises(ArgumentError, match="apt-get install chromium"):
        pdf.find_browser()
    monkeypatch.setenv("CROSSCHECK_BROWSER", "no-such-browser")
    with pytest.raises(ArgumentError, match="CROSSCHECK_BROWSER=no-such-browser"):
        pdf.find_browser()


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


BEFORE = ROOT / "tests" / "report" / "results-before.json"
"""What the release before the typed document wrote, cut down to five runs, and a scene that failed."""


def test_a_results_file_of_before_is_read_and_written_with_the_same_figures(tmp_path):
    old = json.loads(BEFORE.read_text(encoding="utf-8"))
    found = schema.read_document(BEFORE)
    assert found.scenes[-1].failure == "its worker died"
    now = schema.plain(found)
    for before, after in zip(old["records"], now["records"], strict=True):
        for key in set(before) - {"speed"}:  # {} became null
            assert contains(after[key], before[key]), key
    report.write_report(found, tmp_path / "report")
    assert (tmp_path / "report" / "scene-heavy_top.html").exists()


def contains(after, before):
    """Whether a value of now has all that one of before had."""
    if isinstance(before, dict):
        return all(key in after and contains(after[key], each) for key, each in before.items())
    if isinstance(before, list):
        return len(after) == len(before) and all(map(contains, after, before))
    return after == before


def test_a_journal_of_before_is_read(tmp_path):
    record = json.loads(BEFORE.read_text(encoding="utf-8"))["records"][0] | {"speed": {}}
    line = {"stage": "cell", "key": "k", "session": 1, "elapsed": 1.0, "result": record}
    (tmp_path / "journal.jsonl").write_text(json.dumps(line) + "\n")
    found = Journal(tmp_path / "journal.jsonl", job.JOURNAL_TYPES).get("cell", "k")
    assert isinstance(found, Judged)
    assert found.errors["position"].max == record["errors"]["position"]["max"]
