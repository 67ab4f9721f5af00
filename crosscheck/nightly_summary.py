"""The one-page summary of a nightly run, plain text for a chat message: what changed, what failed, where to look."""

from __future__ import annotations

import datetime
from pathlib import Path
from typing import Any

from crosscheck.report.words import headline, sentence
from crosscheck.store import StoredRun

MOST_LINES = 12
"""Changes and failures that are listed; the report has the rest."""


def summary(document: dict[str, Any], name: str, before: StoredRun | None, exit_code: int, page: Path) -> str:
    """About twenty lines; the first says all that somebody has to know who reads no further."""
    meta, changes = document["meta"], document["changes"] or []
    findings = [change for change in changes if change["bad"]]
    notes = [change for change in changes if not change["bad"]]
    verdict = {0: "good", 1: "look at this", 2: "INCOMPLETE"}[exit_code]
    changed = "first run, nothing to compare with" if before is None else _count(len(findings), "finding")
    length = datetime.timedelta(seconds=round(meta["seconds"]))
    lines = [f"crosscheck nightly {meta['time']}: {verdict}. {changed}. {headline(document)}.",
             f"{len(document['records'])} runs of {_count(len(document['scenes']), 'scene')} on "
             + ", ".join(f"{engine} {version}" for engine, version in meta["engines"].items())
             + f"; {length} on {meta['machine']['cores']} cores; commit {meta['commit'] or 'unknown'}"]
    if before is not None:
        lines.append(f"compared with {before.name} (commit {before.environment.get('commit') or 'unknown'})")
    lines += _listed("Findings", grouped(findings)) + _listed("Worth knowing", grouped(notes))
    lines += _listed("Failed", _failures(document))
    return "\n".join([*lines, "", f"run {name}, report {page}", ""])


def _count(number: int, word: str) -> str:
    return f"{number or 'no'} {word}{'' if number == 1 else 's'}"


def _listed(title: str, lines: list[str]) -> list[str]:
    if not lines:
        return []
    more = [f"- and {len(lines) - MOST_LINES} more"] if len(lines) > MOST_LINES else []
    return ["", f"{title}:", *(f"- {line}" for line in lines[:MOST_LINES]), *more]


def grouped(changes: list[dict[str, Any]]) -> list[str]:
    """One line per kind, engine and method with the scenes it concerns; methods of which the same is told share one."""
    groups: dict[tuple[str, str, str], list[dict[str, Any]]] = {}
    for change in changes:
        groups.setdefault((change["kind"], change["engine"], change["method"]), []).append(change)
    alike: dict[tuple[str, str, str], list[str]] = {}
    for (kind, engine, method), each in groups.items():
        scenes = list(dict.fromkeys(change["scene"] for change in each if change["scene"]))
        text = f"{_places(scenes)}: {each[0]['text']}"
        alike.setdefault((kind, engine, text.replace(method, "…") if method else text), []).append(method)
    lines = []
    for (kind, engine, text), methods in alike.items():
        several = f", {len(methods)} methods, for one" if len(methods) > 1 else ""
        who = f"{engine}{several} {methods[0]}".strip()
        lines.append(f"{kind}{': ' if who else ''}{who}{text.replace('…', methods[0])}")
    return lines


def _places(scenes: list[str]) -> str:
    if not scenes:
        return ""
    return f" on {scenes[0]}" if len(scenes) == 1 else f" on {len(scenes)} scenes, for one {scenes[0]}"


def _failures(document: dict[str, Any]) -> list[str]:
    broken = [f"{scene['name']}: {scene.get('failure') or scene.get('no_truth')}" for scene in document["scenes"]
              if "failure" in scene or scene.get("disputed")]
    runs: dict[str, list[dict[str, Any]]] = {}
    for record in document["records"]:
        if record["outcome"] in ("fail", "error"):
            runs.setdefault(record["label"], []).append(record)
    alike: dict[str, list[str]] = {}
    for label, each in runs.items():
        text = f"{_places([record['scene'] for record in each])}: {sentence(each[0])}"
        alike.setdefault(text.replace(label, "…"), []).append(label)
    for text, labels in alike.items():
        several = f"{len(labels)} runs, for one " if len(labels) > 1 else ""
        broken.append(f"{several}{labels[0]}{text.replace('…', labels[0])}")
    return broken
