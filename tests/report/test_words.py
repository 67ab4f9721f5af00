"""The words of the pages: headline, recommendations, groups of findings."""

import re
import xml.etree.ElementTree as ElementTree

import pytest
from msgspec.structs import replace

from crosscheck.cli.verify import print_verdicts
from crosscheck.document import Advice, Asked, Errors, Finding, Order, Recommended, Scene, extended, outcomes
from crosscheck.history import nightly
from crosscheck.judge import verdict
from crosscheck.report import exports, headline, overview, pages, schema
from crosscheck.verification import job, trust
from crosscheck.verification.verified import Verification
from tests.report_making import CHANGES, failed_scene, made


def test_recommendation_names_the_fastest_passing_run(results):
    def run(name, seconds, deviation=1e-6):
        return replace(results.records[0], label=name, seconds_per_second=seconds,
                                   seconds_deviation=deviation)

    fast, slow = run("fake Fast", 1e-3), run("fake Slow", 2e-3)
    assert trust.sentence(results.scenes[0], []) == "No recommendation: no run of this scene has ended."
    said = trust.sentence(results.scenes[0], [slow, fast, results.records[1]])
    assert said.startswith("Trust fake Fast:")
    assert trust.not_trusted([slow, fast, results.records[1]]) == ["fake Broken"]
    found = trust.recommend(results.scenes[0], [slow, fast])
    # The figures are those of the judged run, not of some point of a study.
    assert (found.step, found.error) == (fast.step, fast.error)
    # 5 % is within the ratio of noise, and 50 % within four deviations of a restless clock: no winner.
    near, restless = run("fake Near", 1.05e-3), run("fake Restless", 1.5e-3, deviation=2e-4)
    found = trust.recommend(results.scenes[0], [slow, restless, near, fast])
    assert found.runs == ["fake Fast", "fake Near", "fake Restless"]
    # A third of the time of a run a hundred times slower is no noise of the fastest run.
    found = trust.recommend(results.scenes[0], [run("fake Crawling", 0.1, deviation=0.03), fast])
    assert found.runs == ["fake Fast"]


def test_a_run_that_is_not_resolved_is_no_run_to_trust(results):
    passing = replace(results.records[0], label="fake Slow", seconds_per_second=2e-3)
    vague = replace(passing, label="fake Vague", outcome="unresolved", share=0.4, seconds_per_second=1e-3)
    assert vague.within
    assert trust.recommend(results.scenes[0], [vague, passing]).runs == ["fake Slow"]
    alone = trust.recommend(results.scenes[0], [vague])
    assert (alone.runs, alone.passes) == (["fake Vague"], False)
    said = trust.sentence(results.scenes[0], [vague])
    assert said.startswith("No run passes; nearest is fake Vague: of unresolved runs the ")


def test_runs_that_cannot_be_made_do_not_count(results):
    absent = replace(results.records[0], engine="absent", outcome="unsupported", message="not installed")
    partly_able = replace(absent, engine=results.records[0].engine)
    told = trust.by_engine(results.scenes[0], [results.records[0], partly_able, absent, absent])
    assert [(row.passing, row.runs) for row in told] == [(1, 1), (0, 0)]
    assert told[1].text == "absent: no run: not installed."


def test_the_headline_claims_no_more_than_was_found(results):
    passing, known = results.records[0], results.records[3]
    assert headline.headline(made(results.scenes[:1], [passing])) == "The only run passes"
    assert headline.headline(made(results.scenes[:1], [passing, results.records[2]])) == (
        "The only run that could be made passes")
    assert headline.headline(made(results.scenes[:1], [passing] * 3)) == "All 3 runs pass"
    said = headline.headline(made(results.scenes[:1], [passing, known]))
    assert said == "1 run passes, 1 shows only known defects, none fails"
    assert headline.headline(made(results.scenes[:1], [])) == "Nothing was run"
    going = made(results.scenes[:1], [])
    going = replace(going, meta=replace(going.meta, left=3))
    assert headline.headline(going) == "no run has ended yet"
    assert headline.headline(replace(going, scenes=[])).startswith("no run has ended yet: truth is being computed")
    short = made(results.scenes[:1], [replace(passing, share=0.1)]).records[0]
    assert (short.word, passing.word) == ("unresolved, resolved over 10 %", "pass")


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
    message = nightly.summary(plain, "2026-11-21", None, False, tmp_path / "index.html")
    assert said in message.splitlines()[0]
    assert re.search(r"- fake: fake Broken on single_pendulum, CC10\d: it broke", message)
    assert len(message.splitlines()) < 20


def test_many_findings_stand_in_few_groups_the_new_ones_first(results):
    order = Finding("order", "fail", 3.0, 0.5, "1", "the documented order less 1/2")
    drift = Finding("limit position", "fail", 1.0, 1e-6, "m", "bound", "body rod, .3 s after the segment begins")
    records = []
    for engine, finding in (("fake", order), ("other", drift)):
        records += [replace(results.records[0], scene=f"s{index}", engine=engine, label=f"{engine} Plain",
                                        outcome="fail", findings=[replace(finding, value=1.0 + index,
                                                                                      detail=f"at {index}")])
                    for index in range(20)]
    records = made([], records).records
    groups = overview.worst_first(records)
    assert [(group.engine, group.why, len(group.runs), group.scenes) for group in groups] == [
        ("other", "as steps vanish it does not come to the truth", 20, 20),
        ("fake", "the error falls more slowly than documented", 20, 20)]
    assert groups[0].runs[0][0].scene == "s19"  # the largest excess
    new = [replace(CHANGES[0], scene="s7", engine="fake", method="Plain")]
    first, second = overview.worst_first(records, new)
    assert (first.engine, first.new, second.engine, second.new) == ("fake", 1, "other", 0)


@pytest.mark.parametrize(("finding", "said"), [
    (Finding("order", "fail", 2.5, 0.5, "1", "why"), "CC103: observed order 1.5, documented 4"),
    (Finding("limit position", "fail", 0.25, 1e-3, "m", "why"),
     "CC102: as steps vanish position is off by 0.25 m, beyond 1.0e-03 m"),
    (Finding("gap velocity", "fail", 0.25, 1e-3, "m/s", "why"),
     "CC101: from its own states velocity goes on otherwise by 0.25 m/s, beyond 1.0e-03 m/s"),
    (Finding("promise level position", "fail", 0.25, 1e-3, "m", "why"),
     "CC104: level position is off by 0.25 m, beyond 1.0e-03 m"),
    (Finding("tolerance energy", "fail", 0.25, 1e-3, "1", "why"), "CC106: error of energy 0.25, beyond 1.0e-03"),
    (Finding("asked end", "fail", None, None, "", "why", "it broke"), "CC105: it broke")])
def test_what_is_wrong_is_one_clause_with_its_figures(results, finding, said):
    record = replace(results.records[0], outcome="fail", findings=[finding],
                     order=Order(documented=4, observed=1.5, median=3.9, segments=8))
    assert headline.sentence(made([], [record]).records[0]) == said


def test_scenes_share_a_line_of_advice_where_the_same_run_is_recommended_for_the_same_reason():
    def scene(name, run, why):
        best = Recommended(runs=[run], step=None, rtol=None, error=1e-9, seconds=None, why=why)
        return extended(Scene, failed_scene(name, ""), recommended=best if run else None,
                        trust=f"No recommendation: {why}.", not_trusted=["x"])

    groups = overview.recommended([scene("a", None, "none passed"), scene("b", "m RK4", "fastest, 3 checks passed"),
                                   scene("c", "l taylor", "fastest, 13 checks passed"),
                                   scene("d", "l taylor", "fastest, 12 checks passed")])
    assert [(group.run, group.why, [each.name for each in group.scenes]) for group in groups] == [
        ("l taylor", "fastest", ["c", "d"]), ("m RK4", "fastest", ["b"]),
        (None, "No recommendation: none passed.", ["a"])]


@pytest.mark.parametrize(("off", "shade"), [(0.0, 0), (1e-9, 0), (1e-7, 1), (1e-4, 2), (0.05, 3), (0.2, 4),
                                            (None, 4)])
def test_errors_are_coloured_by_their_size_whatever_the_verdict(results, off, shade):
    for outcome in ("pass", "fail", "known"):
        errors = {} if off is None else {
            "attitude": Errors(unit="rad", end=0.0, max=2 * off, time=1.0, body="a", size=2.0),
            "position": Errors(unit="m", end=0.0, max=0.0, time=1.0, body="a", size=1.0)}
        record = replace(results.records[0], errors=errors, outcome=outcome)
        assert headline.shade(record) == shade
        text = pages.index(made(results.scenes[:1], [record]))
        assert (f'class="off off{shade} figure"' in text) == (off is not None)


@pytest.mark.parametrize(("step", "said"), [(1e-3, "0.001 s"), (0.02, "0.02 s"), (2 / 3 * 1e-3, "0.000667 s")])
def test_a_step_has_one_format_everywhere(results, capsys, monkeypatch, tmp_path, step, said):
    monkeypatch.delenv("COLUMNS", raising=False)
    document = made(results.scenes[:1], [replace(results.records[0], step=step, rtol=None)])
    text = pages.index(document)
    assert set(re.findall(r'data-sort="[^"]*">([^<]* s)</td>', text)) == {said}
    print_verdicts(document, tmp_path)
    assert f"by {document.records[0].method} at {said}" in capsys.readouterr().out
    assert f" at step {said}" in document.scenes[0].trust


def test_a_file_has_its_own_name_and_advice_is_said_once(results):
    assert headline.spoken("/of/a_user/arm_2.urdf") == "arm_2.urdf"
    assert headline.spoken("heavy_top") == "heavy top"
    records = [results.records[0], replace(results.records[0], engine="other", label="other Plain", outcome="fail")]
    first, second = trust.by_engine(results.scenes[0], records)
    assert (first.text, second.text) == ("fake: as said; 1 of 1 runs pass.",
                                         "other: no run can be recommended; 0 of 1 runs pass.")
    scene, = made(results.scenes[:1], records).scenes
    assert headline.advice(scene) == f"{scene.trust} Not to be trusted here: other Plain."


def test_a_page_advises_what_ladders_of_runs_found_and_nothing_else(results):
    """An estimate from one run named another step than `crosscheck advise` of the same engine."""
    plain = made(results.scenes[:1], results.records[:1])
    assert plain.advice is None
    assert "<code>crosscheck advise SCENE --engine NAME --error 1e-4</code>" in pages.index(plain)
    found = Advice(scene=plain.scenes[0].name, engine="fake", wanted=1e-4, until=1.0, least=1e-5, method="Plain",
                   step=2e-3, error=9e-5, cost=0.1, command="crosscheck run single_pendulum")
    assert '"step": 0.002' in pages.index(replace(plain, advice=[found]))


def test_every_scene_has_a_page_of_its_own():
    scenes = ["top", "Top", "a/top.toml", "b/top.toml", "a top", "a-top", "a/b.toml", "a-b-toml"]
    assert len({pages.scene_file(failed_scene(name, "")).lower() for name in scenes}) == len(scenes)


def test_runs_at_too_coarse_steps_and_shares_of_time_stand_in_the_headline(results):
    whole = replace(results.records[0], outcome="pass")
    part = replace(whole, outcome="unresolved", share=0.25, duration=10.0)
    part = replace(part, not_judged="the step is too coarse")
    coarse = replace(part, share=0.0)
    said = headline.headline(made(results.scenes[:1], [whole, part, part, coarse]))
    assert said == ("1 run passes, 3 unresolved (resolved over 0 to 25 % of the time, mostly since the step is too "
                    "coarse), none fails")
    ended = replace(part, not_judged="a monitor ended the scene")
    said = headline.headline(made(results.scenes[:1], [whole, ended]))
    assert "(resolved over 25 % of the time, since a monitor ended the scene)" in said
    plain = made(results.scenes[:1], [whole, part, coarse])
    text = pages.index(replace(plain, meta=replace(plain.meta, engines={"fake": "1"})))
    assert 'class="tag unresolved" style="--share: 0%"' in text
    assert "2 unresolved, resolved over 0 to 25 % of the time" in text


def _asked(results, label, value, share, status="ok", scene=None):
    finding = Finding("tolerance position", status, value, 1e-4, "m", "set by the user")
    return replace(results.records[0], label=label, step=1e-3, rtol=None, duration=2.0, findings=[finding],
                   shares={finding.kind: share}, share=share, scene=scene or results.scenes[0].name,
                   outcome="fail" if status == "fail" else "pass" if share == 1 else "unresolved")


@pytest.mark.parametrize(("value", "share", "status", "said"), [
    (3.14e-6, 1.0, "ok", "yes: error of position 3.1e-06 m over all 2 s, allowed 0.0001 m: fake A at 0.001 s"),
    (0.02, 0.5, "fail", "no: error of position 0.02 m over 50 % of the time, allowed 0.0001 m: fake A at 0.001 s"),
    (3.14e-6, 0.15, "ok",
     "not decided: error of position 3.1e-06 m over 15 % of the time, allowed 0.0001 m: fake A at 0.001 s"),
    (float("nan"), 1.0, "fail",
     "no: error of position infinite over all 2 s, allowed 0.0001 m: fake A at 0.001 s"),
    (None, 0.0, "unresolved",
     "not decided: error of position not known over 0 % of the time, allowed 0.0001 m: fake A at 0.001 s")])
def test_a_tolerance_is_answered_first_in_its_own_quantity(results, tmp_path, capsys, monkeypatch, value, share, status,
                                                                      said):
    """Is RK4 at 1 ms good to .1 mm? The terminal, the page, its Markdown, JUnit and results.json begin with it."""
    monkeypatch.delenv("COLUMNS", raising=False)
    run = _asked(results, "fake A", value, share, status)
    document = made(results.scenes[:1], [run])
    assert document.answers == [said]
    print_verdicts(document, tmp_path)
    assert capsys.readouterr().out.splitlines()[0] == said
    assert str(Verification(document)).startswith(f"{said}; {document.outcome}: ")
    heading = re.search(r"<h1>(.*?)</h1>", pages.index(document)).group(1)
    assert re.sub(r"<[^>]*>", "", heading).startswith(f"{said}; ")
    assert pages.summary(document).startswith(f"# {said}; ")
    assert schema.plain(document)["answers"] == [said]
    suite, = ElementTree.fromstring(exports.junit(document))
    assert [(each.get("name"), each.get("value")) for each in suite.find("properties")] == [("within tolerance", said)]
    assert suite.find("testcase/system-out").text.startswith(said)
    failure = suite.find("testcase/failure")
    assert (failure is None) == (document.outcome == "pass")
    assert document.outcome != "unresolved" or failure.get("message").startswith(said)
    enough = said.replace("not decided", "yes") if share == 0.15 else said
    assert headline.answers(document.records, 0.15) == [enough]


def test_a_tolerance_by_which_no_run_could_be_judged_is_answered_too(results):
    run = replace(results.records[2], findings=[])
    assert run.outcome == "unsupported"
    whole = made(results.scenes[:1], [run])
    meta = replace(whole.meta, tolerances=[("position", 1e-3), ("energy", 0.1)])
    assert job.document(meta, whole.scenes, [run]).answers == [
        "not decided: error of position, allowed 0.001 m: no run was judged",
        "not decided: error of energy, allowed 0.1: no run was judged"]
    assert job.document(meta, whole.scenes, []).answers == []  # none has ended yet


def test_of_several_runs_it_says_which_are_within_a_tolerance(results):
    runs = [_asked(results, "fake A", 3e-6, 1.0), _asked(results, "fake B", 2e-3, 1.0, "fail"),
            _asked(results, "of/a_user/own.py:C RK4", 2e-5, 0.5),
            *(_asked(results, f"fake {k}", 1e-9, 1.0) for k in range(4))]
    assert headline.answers(runs, 1.0) == [
        "error of position, allowed 0.0001 m, at 0.001 s: no for 1 run (fake B 2.0e-03 m over all 2 s), not decided "
        "for 1 run (own.py:C RK4 2.0e-05 m over 50 % of the time), yes for 5 runs (fake A 3.0e-06 m over all 2 s, fake "
        "0 1.0e-09 m over all 2 s, fake 1 1.0e-09 m over all 2 s and 2 more)"]
    other = replace(runs[0], step=2e-3, scene="a/other_top.urdf")
    assert headline.answers([runs[0], other], 1.0) == [
        "error of position, allowed 0.0001 m, over all 2 s: yes for 2 runs (fake A on single pendulum at 0.001 s "
        "3.0e-06 m, fake A on other_top.urdf at 0.002 s 3.0e-06 m)"]
    document = made(results.scenes[:1], runs)
    cells = re.findall(r"<td class=\"n tol\"[^>]*>([^<]*)</td>", pages.index(document))
    assert cells[:3] == ["yes, 3.0e-06 m", "no, 2.0e-03 m", "not decided, 2.0e-05 m"]
    assert ">position, allowed 0.0001 m</th>" in pages.index(document)
    assert headline.answers([results.records[0]], 1.0) == []


def test_a_step_that_could_not_be_made_stands_in_the_headline(results):
    run = replace(results.records[0], step=2 / 3 * 1e-3)
    document = made(results.scenes[:1], [run])
    meta = document.meta
    assert headline.headline(replace(document, meta=replace(meta, asked=Asked(step=7e-4)))) == (
        "The only run passes; steps of 0.000667 s were made, not of 0.0007 s, which does not divide the time between "
        "two outputs")
    assert headline.headline(replace(document, meta=replace(meta, asked=Asked(step=2 / 3 * 1e-3)))) == (
        "The only run passes")


CODES = {"gap": "CC101", "limit": "CC102", "order": "CC103", "promise": "CC104", "asked": "CC105", "tolerance": "CC106",
         "noise": "CC107", "unresolved": "CC108"}
"""Written by hand: a code never changes."""


def test_what_is_wrong_or_open_has_a_code_and_an_end(results):
    """Codes are stable: other tools have rules about them. The site lists them on the page of verdicts."""
    assert {name: kind.code for name, kind in outcomes.KINDS.items()} == CODES
    slow = Finding("order", "fail", 0.99, 0.5, "1", "documented order 3")
    run = replace(results.records[0], engine="mujoco", method="RK4", step=1e-3, outcome="fail", findings=[slow],
                  worst=slow, documented_order=3, rtol=None,
                  order=Order(documented=3, observed=2.01, median=2.1, segments=8),
                  command="crosscheck run heavy_top --engine mujoco --method RK4 --step 0.001 --samples 9")
    run = replace(run, code=verdict.code(run))
    assert headline.sentence(run) == "CC103: observed order 2.01, documented 3"
    assert headline.ending(run) == (
        "reproduce: crosscheck run heavy_top --engine mujoco --method RK4 --step 0.001 --script")
    assert headline.ending(replace(run, engine="exudyn", command="crosscheck run a --engine exudyn --step 1.0")) == (
        "reproduce: crosscheck run a --engine exudyn --step 1.0")
    assert [outcomes.code("fail", kind) for kind in outcomes.KINDS] == [each.code for each in outcomes.KINDS.values()]
    part = replace(run, outcome="unresolved", findings=[], share=0.25)
    assert (verdict.code(part), headline.ending(part)) == (
        "CC108", "what would mend it: a smaller --step, or --need 0.25, which is resolved")
    touched = replace(part, duration=2.0, findings=[Finding.truth_ends(0.6, "box touches ball at .6 s")])
    assert headline.ending(touched) == (
        "what would mend it: --duration 0.6, before truth ends, or --need 0.25, which is resolved")
    rest = Finding("unresolved rest", "unresolved", None, None, "", "nothing moves")
    assert headline.ending(replace(part, findings=[rest])) == "what would mend it: give it a start that moves"
    assert (verdict.code(replace(run, outcome="pass", findings=[])), headline.ending(replace(run, outcome="pass"))) == (
        "", "")
