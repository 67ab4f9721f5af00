"""How figures and outcomes are written for a person."""

from __future__ import annotations

from typing import Any

OUTCOMES = {"pass": ("✓", "pass", "every check within its bound, over the time it names or else the whole run"),
            "known": ("≈", "known", "only defects of the engine that are listed with their reason"),
            "fail": ("✗", "fail", "a figure is beyond its bound"),
            "error": ("‼", "error", "it did not run"),
            "unjudged": ("?", "unjudged", "no truth: only energy, held constraints and orthogonality were judged"),
            "unsupported": ("–", "n/a", "the engine cannot model this scene")}
"""Symbol, word and meaning of each outcome."""


def headline(document: dict[str, Any]) -> str:
    """What the run came to, in one clause that claims no more than was found."""
    records = document["records"]
    def count(*outcomes: str) -> int:
        return sum(record["outcome"] in outcomes for record in records)
    if document["exit_code"] == 2:
        return "The run is incomplete"
    bad, known = count("fail", "error"), count("known")
    defects = f"{known} known defect{'s' if known != 1 else ''}"
    if bad:
        return f"{bad} of {len(records)} runs failed" + (f", beside {defects}" if known else "")
    if known:
        return f"No unexpected finding: {count('pass')} pass, {defects}"
    if count("unjudged"):
        return f"No finding, but {count('unjudged')} of {len(records)} runs have no truth to be judged by"
    return f"All {count('pass')} runs that could be made are within their bounds"


def partly(document: dict[str, Any]) -> str:
    """How many runs were judged over less than their whole length, or not by their motion; empty where none."""
    records = document["records"]
    short = sum(record["partly"] and record["outcome"] in ("pass", "known") for record in records)
    stable = sum(record["word"] == "stable" for record in records)
    said = [f"{short} of them judged only over the first seconds" if short else "",
            f"{stable} only by energy and held constraints" if stable else ""]
    return ", ".join(each for each in said if each)


def span(record: dict[str, Any]) -> str:
    """Over what part of its length the motion was judged."""
    if record["practical"] or record["outcome"] == "unjudged":
        return "motion not judged"
    if record["judged_until"] is None or record["duration"] is None:
        return ""
    if record["partly"]:
        return f"to {record['judged_until']:g} s of {record['duration']:g} s"
    return f"all {record['duration']:g} s"


def number(value: float | None, digits: int = 2) -> str:
    """A figure with few digits; a dash where there is none."""
    if value is None:
        return "–"
    if value == 0:
        return "0"
    return f"{value:.{digits}g}" if 0.01 <= abs(value) < 1000 else f"{value:.{digits - 1}e}"


def sentence(record: dict[str, Any]) -> str:
    """The worst finding of a run in one clause."""
    worst = record["worst"]
    if record["outcome"] in ("error", "unsupported", "unjudged") or worst is None:
        return record["message"]
    if worst["kind"] in ("run", "vanished", "step"):
        return worst["detail"] or worst["why"]
    unit = "" if worst["unit"] in ("1", "") else f" {worst['unit']}"
    kind = worst["kind"].replace("level ", "constraint at level ").replace("order ", "observed order in ")
    if worst["kind"].startswith("order"):
        relation = "at least" if worst["status"] == "ok" else "below"
        return f"{kind} {number(worst['value'], 3)}, {relation} {number(worst['bound'], 3)}"
    relation = "within" if worst["status"] == "ok" else "beyond"
    return f"{kind} {number(worst['value'])}{unit}, {relation} {number(worst['bound'])}{unit}"


def plain_number(value: float | None) -> str:
    """A figure for a table to sort by; empty where there is none."""
    return "" if value is None else f"{value:.6g}"


def spoken(name: str) -> str:
    """A name for a heading: without underscores."""
    return name.replace("_", " ")
