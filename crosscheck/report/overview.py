"""What stands on the first page: counts, matrices, the worst findings. Chosen and sorted, never computed."""

from __future__ import annotations

from typing import Any

from crosscheck.report.words import OUTCOMES

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


def worst_first(records: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Runs that are not fine, grouped by the reason of their worst finding: failures first, then known defects.

    Each group has the keys "outcome", "why" and "runs", pairs of (run, its worst finding or None).
    """
    bad = [(record, record["worst"]) for record in records if record["outcome"] in ("fail", "error", "known")]
    bad.sort(key=lambda pair: (pair[0]["outcome"] == "known", -_excess(pair[1])))
    groups: dict[tuple[str, str], dict[str, Any]] = {}
    for record, finding in bad:
        why = (finding["detail"] or finding["why"]) if finding else record["message"]
        group = groups.setdefault((record["outcome"], why), {"outcome": record["outcome"], "why": why, "runs": []})
        group["runs"].append((record, finding))
    return list(groups.values())


def _excess(finding: dict[str, Any] | None) -> float:
    """How far beyond its bound, as a factor, only to sort by; what is not finite comes first."""
    if not finding or not finding["value"] or not finding["bound"]:
        return float("inf")
    ratio = finding["value"] / finding["bound"]
    return 1 / ratio if finding["kind"].startswith("order") else ratio


def summary_counts(records: list[dict[str, Any]]) -> dict[str, int]:
    """How many runs have each outcome, in the order of `OUTCOMES`."""
    return {outcome: sum(record["outcome"] == outcome for record in records) for outcome in OUTCOMES}
