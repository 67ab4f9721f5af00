"""From findings and shares to one outcome, its words and its code, for made-up runs."""

import numpy as np
import pytest

from crosscheck.document import Finding, Record
from crosscheck.document.known import Known
from crosscheck.document.outcomes import KINDS, percent
from crosscheck.judge import verdict


def found(kind, status, value=1.0, bound=2.0, size=1.0):
    return Finding(kind, status, value, bound, "m", "why", size=size)


def settled(findings, entry=None, share=1.0, planned=True, **more):
    run = Record(scene="single_pendulum", engine="fake", version="1", method="Plain", duration=1.0, share=share, **more)
    return verdict.with_outcome(run, findings, () if entry is None else (entry,), planned=planned)


@pytest.mark.parametrize(("statuses", "outcome"), [
    (["ok"], "pass"), (["known", "ok"], "known"), (["known", "fail"], "fail"), ([], "pass")])
def test_the_worst_status_makes_the_outcome(statuses, outcome):
    assert verdict.outcome_of([found("limit position", status) for status in statuses]) == outcome


@pytest.mark.parametrize(("status", "share", "need", "outcome"), [
    ("ok", 0.04, 1.0, "unresolved"), ("known", 0.04, 1.0, "unresolved"), ("fail", 0.04, 1.0, "fail"),
    ("ok", 0.96, 0.95, "pass"), ("known", 0.96, 0.95, "known"), ("ok", 0.94, 0.95, "unresolved")])
def test_less_than_the_share_that_is_needed_is_unresolved(status, share, need, outcome):
    assert verdict.outcome_of([found("limit position", status)], share, need) == outcome


def test_every_row_needs_its_share():
    """x, R, v, w may be resolved over all of the time, and reactions over a part of it."""
    run = settled([found("limit position", "ok")], shares={"position": 1.0, "reaction force": 0.5})
    assert run.least_share == 0.5
    lacks = verdict.needing(run, 1.0)
    assert (lacks.outcome, lacks.message) == ("unresolved", "resolved over 50 % of its time")
    assert verdict.needing(run, 0.5).outcome == "pass"


def test_nothing_resolved_is_unresolved_whatever_is_needed():
    run = settled([found("unresolved rest", "unresolved")], share=0.0, not_judged="nothing moves")
    assert (run.outcome, run.message, run.code) == ("unresolved", "nothing moves", "")
    assert verdict.code(run) == KINDS["unresolved"].code
    assert verdict.needing(run, 1e-9).outcome == "unresolved"
    assert settled([found("promise orthogonality", "fail")], share=0.0).outcome == "fail"


def test_a_run_passes_where_its_share_is_what_is_needed():
    run = settled([found("limit position", "ok")], share=0.5, not_judged="truth ends at 2 s")
    assert (run.outcome, run.message) == ("unresolved", "resolved over 50 % of its time, since truth ends at 2 s")
    enough = verdict.needing(run, 0.5)
    assert (enough.outcome, enough.message, verdict.word(enough)) == ("pass", "", "pass, resolved over 50 %")
    assert verdict.needing(enough, 0.6).outcome == "unresolved"
    failed = settled([found("limit position", "fail")], share=0.5)
    assert verdict.needing(failed, 0.1) == failed


def test_a_share_that_is_not_all_is_not_written_as_all():
    assert [percent(share) for share in (1.0, 0.25, 0.999999999, 0.9951)] == ["100 %", "25 %", "99.9999 %", "99.51 %"]


@pytest.mark.parametrize(("outcome", "share", "word"), [
    ("pass", 1.0, "pass"), ("pass", 0.1, "pass, resolved over 10 %"), ("known", 0.1, "known, resolved over 10 %"),
    ("unresolved", 0.0, "unresolved, resolved over 0 %"), ("fail", 0.1, "fail"), ("error", 0.1, "error"),
    ("unsupported", None, "unsupported"), ("pass", None, "pass")])
def test_words_claim_no_more_than_was_resolved(outcome, share, word):
    run = Record(scene="s", engine="fake", version="1", method="Plain", outcome=outcome, share=share)
    assert verdict.word(run) == word


def test_the_farthest_beyond_its_bound_is_named_first_and_what_was_not_done_before_it():
    near = [found("limit position", "ok", 0.5, 1.0), found("asked end", "ok", None, None),
            found("limit velocity", "ok", 0.9, 1.0)]
    beyond = [found("limit energy", "fail", 1e6), found("promise level position", "fail", 1e3),
              found("order", "known", 1.0, 0.5)]
    assert verdict.worst(near).kind == "asked end"
    assert verdict.worst([*near, *beyond]).kind == "limit energy"
    assert verdict.worst([*near, beyond[2]]).kind == "order"
    assert verdict.worst([*beyond, found("limit velocity", "fail", np.inf)]).kind == "limit velocity"
    assert verdict.worst([*beyond, found("asked steps", "fail", 1.5, 1.01)]).kind == "asked steps"
    assert verdict.worst([found("unresolved rest", "unresolved")]) is None


@pytest.mark.parametrize("about", sorted(KINDS))
def test_what_is_wrong_has_a_stable_code(about):
    run = settled([found(f"{about} position", "fail", 3.0)])
    assert verdict.code(run) == KINDS[about].code
    assert verdict.code(settled([found("limit position", "ok")])) == ""


KNOWN = Known("fake", ("1",), ("Plain",), {"limit position": 0.5, "asked end": 0.0}, "its documentation says so",
              "measured on two scenes")


@pytest.mark.parametrize(("value", "size", "outcome"), [
    (0.74, 1.0, "known"), (0.76, 1.0, "fail"), (7.4, 10.0, "known"), (7.6, 10.0, "fail"), (np.inf, 1.0, "fail"),
    (np.nan, 1.0, "fail")])
def test_a_known_defect_excuses_up_to_half_more_than_the_size_that_was_measured(value, size, outcome):
    run = settled([found("limit position", "fail", value, 1e-3, size)], KNOWN)
    assert run.outcome == outcome
    assert (run.findings[0].why == KNOWN.reason) == (outcome == "known")


def test_a_known_defect_excuses_its_rows_and_no_other():
    for kind, outcome in (("limit position", "known"), ("limit velocity", "fail"), ("gap position", "fail"),
                          ("order", "fail")):
        assert settled([found(kind, "fail", 0.5, 1e-3)], KNOWN).outcome == outcome
    assert settled([found("asked end", "fail", None, None)], KNOWN).outcome == "known"
    assert settled([found("asked start", "fail", None, None)], KNOWN).outcome == "fail"


@pytest.mark.parametrize(("always", "planned", "outcome"), [
    (True, True, "fail"), (True, False, "pass"), (False, True, "pass")])
def test_a_defect_that_always_shows_and_does_not_has_vanished(always, planned, outcome):
    """At steps or a duration of the user it may not show."""
    entry = Known("fake", ("1",), ("Plain",), {"order": 2.0}, "why", "how", always=always)
    run = settled([found("order", "ok", 0.1, 0.5)], entry, planned=planned)
    assert run.outcome == outcome
    assert ("asked vanished" in [each.kind for each in run.findings]) == always
    assert settled([found("order", "fail", 2.0, 0.5)], entry).outcome == "known"
