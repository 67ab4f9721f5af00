"""The verdict on one run: its findings with what is known of the engine, and one outcome.

The outcomes are those of `crosscheck.document.outcomes`.
"""

from __future__ import annotations

from collections.abc import Sequence

from msgspec.structs import replace

from crosscheck.document import Finding, Record, outcomes
from crosscheck.document.known import Known
from crosscheck.document.outcomes import Outcome, percent
from crosscheck.judge import known


def with_outcome(run: Record, findings: list[Finding], defects: Sequence[Known] = (), message: str = "",
           planned: bool = True) -> Record:
    """The verdict on a run: mark known defects, notice those that no longer show, and determine the outcome.

    `defects` are those of the engine that are about this run; only if `planned`, run as the library plans it, one has
    to show. What the user asked for is not affected by them.
    """
    for entry in defects:
        excused = [each for each in findings if each.status == "fail" and known.excuses(entry, each)]
        findings = [replace(each, status="known", why=entry.reason) if each in excused else each
                    for each in findings]
        if entry.always and not any(each.status in ("fail", "known") and each.kind in entry.rows for each in findings):
            findings.append(Finding("asked vanished", "fail" if planned else "ok", None, None, "", f"a known defect no "
                                    f"longer shows: {entry.reason}", "if the engine was mended, remove the entry"))
    outcome = outcome_of(findings, run.least_share)
    if outcome == "unresolved":
        message = _unresolved(run)
    return replace(run, findings=findings, outcome=outcome, message=message)


def outcome_of(findings: Sequence[Finding], share: float = 1.0, need: float = 1.0) -> Outcome:
    """The outcome that follows from findings and from the smallest `share` of its time in which a row is resolved."""
    statuses = {finding.status for finding in findings}
    return ("fail" if "fail" in statuses else "unresolved" if share < need else
            "known" if "known" in statuses else "pass")


def _unresolved(run: Record) -> str:
    """Why a run is unresolved."""
    why = f", since {run.not_judged}" if run.not_judged else ""
    return f"resolved over {percent(run.least_share)} of its time{why}" if run.share else run.not_judged


def needing(run: Record, need: float) -> Record:
    """The run with the outcome that it has where its rows have to be resolved over a share `need` of its time.

    Only runs that pass, are known or unresolved by their share depend on it.
    """
    if run.outcome not in ("pass", "known", "unresolved") or not run.share:
        return run
    outcome = outcome_of(run.findings, run.least_share, need)
    return replace(run, outcome=outcome, message=_unresolved(run) if outcome == "unresolved" else "")


def covered(run: Record, share: float, ends: float, why: str) -> Record:
    """A run up to where truth ends (s), at this share of the time that was asked for, with the reason."""
    shares = {name: share * each for name, each in run.shares.items()}
    return needing(replace(run, share=share * (run.share or 0.0), shares=shares, not_judged=why,
                           findings=[*run.findings, Finding.truth_ends(ends, why)]), 1.0)


def worded(run: Record, need: float = 1.0) -> Record:
    """The run as `needing` has it, with what is told of it: its word, its code and its worst finding."""
    run = needing(run, need)
    return replace(run, word=word(run), code=code(run), worst=worst(run.findings))


def beyond(run: Record, finding: Finding, message: str = "") -> Record:
    """The run with one more finding, which fails."""
    return replace(run, findings=[*run.findings, finding], outcome="fail",
                   message="; ".join(filter(None, (run.message, message))))


def worst(findings: Sequence[Finding]) -> Finding | None:
    """The finding to name first: a failing one, else a known one, else a passing one.

    What was not done at all comes first, then what is farthest beyond its bound.
    """
    def place(finding: Finding) -> tuple[int, bool, float]:
        return ({"fail": 2, "known": 1, "ok": 0}[finding.status], finding.about == "asked", finding.severity)

    return max((finding for finding in findings if finding.status != "unresolved"), key=place, default=None)


def code(run: Record) -> str:
    """The stable code of what is wrong with a run or open; "" for a pass."""
    finding = worst(run.findings)
    return outcomes.code(run.outcome, "asked" if finding is None or finding.status == "ok" else finding.about)


def word(run: Record) -> str:
    """The outcome, with the share of the run over which it is resolved if that is not all of it."""
    if run.share is None or run.outcome not in ("pass", "known", "unresolved") or run.least_share >= 1:
        return run.outcome
    return f"{run.outcome}, resolved over {percent(run.least_share)}"
