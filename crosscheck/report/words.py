"""How figures and outcomes are written for a person."""

from __future__ import annotations

from typing import Any

OUTCOMES = {"pass": ("✓", "pass", "every check within its bound"),
            "known": ("≈", "known", "only defects of the engine that are listed with their reason"),
            "fail": ("✗", "fail", "a figure is beyond its bound"),
            "error": ("‼", "error", "it did not run"),
            "unsupported": ("–", "n/a", "the engine cannot model this scene")}
"""Symbol, word and meaning of each outcome."""


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
    if record["outcome"] in ("error", "unsupported") or worst is None:
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
