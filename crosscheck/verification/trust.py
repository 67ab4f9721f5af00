"""Which engine and method to trust on a scene, and why. This follows from the records alone.

Only runs are recommended that are right as far as they were judged, with their step, error, time and the share of the
motion that is resolved. Every engine has a row with its own recommendation.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from crosscheck.document import EngineTrust, Recommended, Record, Scene, grouped
from crosscheck.document.outcomes import percent
from crosscheck.errors import counted
from crosscheck.verification.ladder import reaching

TARGETS = (1e-6, 1e-3)
"""Wanted errors, each quantity's over its size. The recommendation is for the first one that a passing run reaches."""

NOISE_RATIO, NOISE_DEVIATIONS = 1.1, 4.0
"""Two times differ beyond noise if their medians differ by more than this ratio and this many median deviations."""


def recommend(scene: Scene, records: Sequence[Record]) -> Recommended | None:
    """The recommendation for one scene: the fastest of the accurate passing runs, and those equally fast within noise.

    None if nothing can be recommended.
    """
    known = [record for record in records if record.within and math.isfinite(record.error)]
    passing = [record for record in known if record.outcome == "pass"] or known
    if scene.sizes is None or not passing:
        return None
    for target in TARGETS:
        if accurate := reaching(passing, target):
            best = accurate[0]
            tied = [record for record in accurate[1:] if not _slower(record, best)]
            why = f"the fastest with an error of every quantity below {target:.0e} of its size, {_checks(best)} passed"
            break
    else:
        best, tied = min(passing, key=lambda record: record.error), []
        why = f"the smallest error of all, {_checks(best)} passed"
    if tied:
        why += ", times equal within noise"
    if best.outcome != "pass":
        why = f"of unresolved runs {why}"
    share = 1.0 if best.share is None else best.least_share
    if share < 1:
        why += f", resolved over {percent(share)} of the time"
    return Recommended(runs=[record.label for record in (best, *tied)], step=best.step, rtol=best.rtol,
                       error=best.error, share=share, passes=best.outcome == "pass", seconds=best.seconds_per_second,
                       why=why)


def _slower(record: Record, best: Record) -> bool:
    """Whether a run is slower than the best one beyond noise. Deviations are taken relative to their own medians.

    The deviation of a slow run in seconds would hide its difference from a fast one.
    """
    ratio = record.cost / best.cost if math.isfinite(best.cost) else 1.0
    shares = ((each.seconds_deviation or 0.0) / each.cost for each in (record, best))
    return ratio > NOISE_RATIO and math.log(ratio) > NOISE_DEVIATIONS * max(shares)


def sentence(scene: Scene, records: Sequence[Record]) -> str:
    """The recommendation for one scene in words."""
    if scene.failure:
        return f"No recommendation: the truth of this scene failed ({scene.failure})."
    if scene.no_truth:
        return f"No recommendation, the scene has no truth: {scene.no_truth}."
    if not records:
        return "No recommendation: no run of this scene has ended."
    best = recommend(scene, records)
    if best is None:
        return "No recommendation: no run of this scene passed every check."
    words = _advised(best)
    return f"{words[0].upper()}{words[1:]}."


def by_engine(scene: Scene, records: Sequence[Record]) -> list[EngineTrust]:
    """The recommendation for each engine, in the order of the records."""
    rows, first = [], None if scene.failure or scene.no_truth else recommend(scene, records)
    for engine, own in grouped(records, lambda record: record.engine).items():
        made = [record for record in own if record.outcome != "unsupported"]
        best = None if scene.failure or scene.no_truth else recommend(scene, made)
        passing = sum(record.outcome == "pass" for record in made)
        advice = "as said" if best and best == first else _advised(best) if best else (
            "no run can be recommended")
        text = f"{advice}; {passing} of {len(made)} runs pass."
        if not made:
            text = f"no run: {own[0].message}."
        rows.append(EngineTrust(engine=engine, runs=len(made), passing=passing, recommended=best,
                                text=f"{engine}: {text}"))
    return rows


def _advised(best: Recommended) -> str:
    """That it is to be trusted, or that nothing is and this comes nearest, with why."""
    size = f"step {best.size}" if best.step else best.size
    pace = 1e3 * (best.seconds or 0.0)
    spelled = f"{pace:.2g}" if pace < 100 else f"{pace:.0f}"
    time = "" if best.seconds is None else f", {spelled} ms per simulated second"
    word = "trust" if best.passes else "no run passes; nearest is"
    return f"{word} {' or '.join(best.runs)}: {best.why} (error {best.error:.1e} of its size at {size}{time})"


def _checks(record: Record) -> str:
    return counted(sum(finding.status == "ok" for finding in record.findings), "check")


def not_trusted(records: Sequence[Record]) -> list[str]:
    """The labels of runs that are not to be trusted."""
    return [record.label for record in records if record.outcome in ("fail", "error", "known")]
