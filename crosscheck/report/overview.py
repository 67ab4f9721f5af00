"""What stands on the first page: counts, matrices, the worst findings. Chosen and sorted, never computed."""

from __future__ import annotations

import collections
from typing import Any

from crosscheck.report.headline import OUTCOMES

SEVERITY = ("error", "fail", "known", "unjudged", "pass", "unsupported")
"""Outcomes, the one that needs attention most first; a group of runs shows its first."""


def counted(records: list[dict[str, Any]]) -> dict[str, int]:
    """How many runs have each outcome, worst first; outcomes that do not occur are left out."""
    counts = {outcome: sum(record["outcome"] == outcome for record in records) for outcome in SEVERITY}
    return {outcome: count for outcome, count in counts.items() if count}


def by_scene_and_engine(document: dict[str, Any]) -> dict[str, dict[str, dict[str, int]]]:
    """`counted` of every scene and engine."""
    groups: dict[str, dict[str, list[dict[str, Any]]]] = {scene["name"]: {} for scene in document["scenes"]}
    for record in document["records"]:
        groups.setdefault(record["scene"], {}).setdefault(record["engine"], []).append(record)
    return {scene: {engine: counted(records) for engine, records in engines.items()}
            for scene, engines in groups.items()}


def most_accurate(document: dict[str, Any]) -> dict[str, dict[str, dict[str, Any]]]:
    """Of every scene and engine the run that passed with the smallest judged error of the position, if any did."""
    best: dict[str, dict[str, dict[str, Any]]] = {scene["name"]: {} for scene in document["scenes"]}
    for record in document["records"]:
        error = _judged_error(record)
        if record["outcome"] != "pass" or record["practical"] or error is None:
            continue
        before = best[record["scene"]].get(record["engine"])
        if before is None or error < _judged_error(before):
            best[record["scene"]][record["engine"]] = record
    return best


def leaders(accurate: dict[str, dict[str, dict[str, Any]]]) -> dict[str, int]:
    """On how many scenes a run is the most accurate of all engines but lieeuler, from `most_accurate`; many first."""
    best = [min(others, key=_judged_error)["label"] for engines in accurate.values()
            if (others := [record for engine, record in engines.items() if engine != "lieeuler"])]
    return dict(collections.Counter(best).most_common())


def _judged_error(record: dict[str, Any]) -> Any:
    return record["errors"].get("position", {}).get("judged")


def recommended(scenes: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Scenes grouped by the run that is recommended and why, the largest group first; then those that have none.

    Each group has the keys "run" (its label, None where no run can be recommended), "why" and "scenes".
    """
    groups: dict[tuple[str | None, str], list[dict[str, Any]]] = {}
    for scene in scenes:
        advice = scene["recommended"]
        if advice:
            key = advice["runs"][0], advice["why"].partition(",")[0]
        else:
            key = None, scene["trust"].partition(" Not to be trusted here")[0]
        groups.setdefault(key, []).append(scene)
    found = [{"run": run, "why": why, "scenes": each} for (run, why), each in groups.items()]
    return sorted(found, key=lambda group: (group["run"] is None, -len(group["scenes"])))


def by_method(document: dict[str, Any]) -> dict[str, list[tuple[str, dict[str, dict[str, Any]]]]]:
    """Runs at their judged steps: engine to rows of (label, run of each scene)."""
    rows: dict[str, dict[str, dict[str, Any]]] = {}
    for record in document["records"]:
        if not record["practical"]:
            rows.setdefault(record["label"], {})[record["scene"]] = record
    found: dict[str, list[tuple[str, dict[str, dict[str, Any]]]]] = {}
    for label, cells in rows.items():
        found.setdefault(next(iter(cells.values()))["engine"], []).append((label, cells))
    return found


def at_coarse_steps(document: dict[str, Any]) -> list[dict[str, Any]]:
    """Runs too coarse for a bound of the motion, grouped by scene and step."""
    found: dict[tuple[str, float], list[dict[str, Any]]] = {}
    for record in document["records"]:
        if record["practical"]:
            found.setdefault((record["scene"], record["step"] or 0.0), []).append(record)
    return [{"scene": name, "step": step, "records": records} for (name, step), records in found.items()]


MATTERS = {"position": "error of the motion beyond its bound", "attitude": "error of the motion beyond its bound",
           "velocity": "error of the motion beyond its bound",
           "angular velocity": "error of the motion beyond its bound",
           "energy": "energy error beyond its bound", "momentum": "momentum error beyond its bound",
           "orthogonality": "attitudes that are no rotations",
           "step": "step too coarse to judge the motion", "vanished": "a known defect no longer shows"}
"""What is wrong, by the kind of a finding; `_matter` tells the rest."""


def worst_first(records: list[dict[str, Any]], changes: list[dict[str, Any]] | None = None) -> list[dict[str, Any]]:
    """Runs that are not fine, grouped by engine and by what is wrong: new ones, other failures, known defects.

    Each group has the keys "outcome", "engine" (empty for known defects, which engines share), "why", "scenes" (how
    many), "new" (how many of its runs became worse since the run of `changes`) and "runs", pairs of (run, its worst
    finding or None), the worst first.
    """
    worse = {(change["scene"], change["engine"], change["method"]) for change in changes or [] if change["bad"]}
    bad = [(record, record["worst"]) for record in records if record["outcome"] in ("fail", "error", "known")]
    bad.sort(key=lambda pair: -_excess(pair[1]))
    groups: dict[tuple[str, str, str], list[tuple[dict[str, Any], Any]]] = {}
    for record, finding in bad:
        engine = "" if record["outcome"] == "known" else record["engine"]
        groups.setdefault((record["outcome"], engine, _matter(record, finding)), []).append((record, finding))
    found = [{"outcome": outcome, "engine": engine, "why": why, "runs": runs,
              "scenes": len({record["scene"] for record, _ in runs}),
              "new": sum(_who(record) in worse for record, _ in runs)}
             for (outcome, engine, why), runs in groups.items()]
    # The order within each of these, that of the worst run of a group, is kept: sorting is stable.
    return sorted(found, key=lambda group: (not group["new"], SEVERITY.index(group["outcome"])))


def _who(record: dict[str, Any]) -> tuple[str, str, str]:
    """Scene, engine and method of a run as a change names them."""
    return record["scene"], record["engine"], record["label"].removeprefix(f"{record['engine']} ")


def _matter(record: dict[str, Any], finding: dict[str, Any] | None) -> str:
    """What is wrong with a run, in words that it shares with others; of a known defect, its reason."""
    if record["outcome"] == "error" or finding is None:
        return "did not run"
    if record["outcome"] == "known":
        return str(finding["detail"] or finding["why"])
    kind = str(finding["kind"])
    if kind == "run":
        ended = finding["why"] != "a run has to reach its end"
        return "printed text that nobody reads" if ended else "did not reach its end"
    if kind.startswith("order"):
        return "observed order below the documented one"
    if kind.startswith("level"):
        return f"constraints at {kind.removeprefix('level ')} level beyond their bound"
    return MATTERS.get(kind, f"{kind} beyond its bound")


def _excess(finding: dict[str, Any] | None) -> float:
    """How far beyond its bound, as a factor, only to sort by; what is not finite comes first."""
    if not finding or not finding["value"] or not finding["bound"]:
        return float("inf")
    ratio = finding["value"] / finding["bound"]
    return 1 / ratio if finding["kind"].startswith("order") else ratio


def summary_counts(records: list[dict[str, Any]]) -> dict[str, int]:
    """How many runs have each outcome, in the order of `OUTCOMES`."""
    return {outcome: sum(record["outcome"] == outcome for record in records) for outcome in OUTCOMES}
