"""One sentence per scene: which engine and method to trust on it, and why; from the records and nothing else."""

from __future__ import annotations

from typing import Any

from crosscheck.studies.plan import EULER
from crosscheck.verdict import Record

TARGETS = (1e-6, 1e-3)
"""End errors over the scene's length that the recommendation asks for: the first that any passing run reaches."""


def sentence(scene: dict[str, Any], records: list[Record]) -> str:
    """The recommendation for one scene."""
    if "failure" in scene:
        return f"No recommendation: the truth of this scene failed ({scene['failure']})."
    passing = [record for record in records if record.outcome == "pass" and not record.practical]
    if not passing:
        return "No recommendation: no run of this scene passed every check."
    best = _fastest(passing, scene["scales"]["length"])
    if best is None:
        record = min(passing, key=lambda each: each.errors["position"]["max"])
        text = (f"Trust {record.label}: it passed {_checks(record)} checks and has the smallest position error of the "
                f"passing runs, {record.errors['position']['max']:.1e} m over {scene['duration']:g} s")
    else:
        record, point, target = best
        size = f"step {point['step']:.2g} s" if point["step"] else f"rtol {point['rtol']:.0e}"
        text = (f"Trust {record.label}: it passed {_checks(record)} checks and is the fastest to an end error below "
                f"{target:.0e} of the scene's length ({point['error']:.1e} m in {1e3 * point['wall_time']:.2g} ms "
                f"for {scene['plan']['window']:g} s of motion, {size})")
    return text + _among_euler(record, passing) + "." + _not_trusted(records)


def _checks(record: Record) -> int:
    return sum(finding.status == "ok" for finding in record.findings)


def _fastest(passing: list[Record], length: float) -> tuple[Record, dict[str, Any], float] | None:
    for target in TARGETS:
        reached = [(point["wall_time"], index, record, point) for index, record in enumerate(passing)
                   for point in record.timing or record.ladder_points if point["error"] <= target * length]
        if reached:
            _, _, record, point = min(reached, key=lambda each: each[:2])
            return record, point, target
    return None


def _among_euler(best: Record, passing: list[Record]) -> str:
    """Which of the eight Euler methods to take, when the recommendation is not one of them."""
    euler = [record for record in passing if record.engine == "lieeuler" and record.method in EULER]
    if not euler or best in euler:
        return ""
    chosen = min(euler, key=lambda each: (-sum(level["held"] for level in each.levels.values()),
                                          each.errors["position"]["max"]))
    held = sum(level["held"] for level in chosen.levels.values())
    return (f"; among the eight Lie group Euler methods {chosen.method}, which holds {held} of 3 constraint levels at "
            f"rounding level with the smallest error of those that do")


def _not_trusted(records: list[Record]) -> str:
    bad = [record.label for record in records if record.outcome in ("fail", "error", "known")]
    return f" Not to be trusted here: {', '.join(bad)}." if bad else ""
