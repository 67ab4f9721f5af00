"""Which engine and method to trust on a scene, and why; from the records and nothing else.

Only runs that passed are recommended, with the step, the error and the time of the run that was judged.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from crosscheck.document import EULER, Recommended, Record, SceneTruth

TARGETS = (1e-6, 1e-3)
"""Errors over the scene's length that the recommendation asks for: the first that any passing run reaches."""

NOISE_RATIO, NOISE_DEVIATIONS = 1.1, 4.0
"""Two times differ beyond noise when their medians do by more than this ratio and this many median deviations."""


def recommend(scene: SceneTruth, records: Sequence[Record]) -> Recommended | None:
    """The recommendation for one scene: the fastest passing run of those accurate enough, and its equals.

    None where nothing can be recommended.
    """
    passing = [record for record in records if record.outcome == "pass" and not record.practical
               and math.isfinite(judged_error(record))]
    if scene.scales is None or not passing:
        return None
    length = scene.scales.length
    for target in TARGETS:
        accurate = [record for record in passing if judged_error(record) <= target * length]
        if accurate:
            best = min(accurate, key=_seconds)
            tied = sorted((record for record in accurate if record is not best and not _slower(record, best)),
                          key=_seconds)
            why = f"the fastest with an error below {target:.0e} of the scene's length, {_checks(best)} checks passed"
            break
    else:
        best, tied = min(passing, key=judged_error), []
        why = f"the smallest error of those that pass, {_checks(best)} checks passed"
    if tied:
        why += ", times equal within noise"
    return Recommended(runs=[record.label for record in (best, *tied)], step=best.step, rtol=best.rtol,
                       error=judged_error(best), until=best.judged_until, seconds=best.seconds_per_second, why=why)


def judged_error(record: Record) -> float:
    """The largest position error (m) over the judged time; infinite where it was not judged."""
    error = record.errors.get("position")
    return math.inf if error is None or error.judged is None else error.judged


def _seconds(record: Record) -> float:
    return float("inf") if record.seconds_per_second is None else record.seconds_per_second


def _slower(record: Record, best: Record) -> bool:
    """Whether its time exceeds the best one beyond noise, each deviation taken as a share of its own median.

    A deviation in seconds would hide any difference between a slow run and a fast one.
    """
    ratio = _seconds(record) / _seconds(best) if math.isfinite(_seconds(best)) else 1.0
    shares = ((each.seconds_deviation or 0.0) / _seconds(each) for each in (record, best))
    return ratio > NOISE_RATIO and math.log(ratio) > NOISE_DEVIATIONS * max(shares)


def sentence(scene: SceneTruth, records: Sequence[Record]) -> str:
    """The recommendation for one scene in words, with the runs that are not to be trusted."""
    if scene.failure:
        return f"No recommendation: the truth of this scene failed ({scene.failure})."
    if scene.no_truth:
        return f"No recommendation, the scene has no truth: {scene.no_truth}." + _not_trusted(records)
    found = recommend(scene, records)
    if found is None:
        return "No recommendation: no run of this scene passed every check." + _not_trusted(records)
    size = f"step {found.step:.2g} s" if found.step else f"rtol {found.rtol:.0e}"
    time = "" if found.seconds is None else f", {1e3 * found.seconds:.2g} ms per simulated second"
    part = "" if found.until is None else f", judged up to {found.until:g} s"
    text = (f"Trust {' or '.join(found.runs)}: {found.why} (position error {found.error:.1e} m at {size}"
            f"{part}{time})")
    return text + _among_euler(found.runs, records) + "." + _not_trusted(records)


def _checks(record: Record) -> int:
    return sum(finding.status == "ok" for finding in record.findings)


def _among_euler(best: Sequence[str], records: Sequence[Record]) -> str:
    """Which of the eight Euler methods to take, when the recommendation is not one of them."""
    euler = [record for record in records if record.outcome == "pass" and not record.practical
             and record.engine == "lieeuler" and record.method in EULER]
    if not euler or any(record.label in best for record in euler):
        return ""
    def held(record: Record) -> int:
        return sum(level.held for level in record.levels.values())
    chosen = min(euler, key=lambda each: (-held(each), each.errors["position"].max or 0.0))
    return (f"; among the eight Lie group Euler methods {chosen.method}, which holds {held(chosen)} of 3 constraint "
            f"levels at rounding level with the smallest error of those that do")


def _not_trusted(records: Sequence[Record]) -> str:
    bad = [record.label for record in records if record.outcome in ("fail", "error", "known")]
    return f" Not to be trusted here: {', '.join(bad)}." if bad else ""
