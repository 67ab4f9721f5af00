"""The summary of a nightly run as plain text for a chat message: what changed, what failed, where the report is."""

from __future__ import annotations

import datetime
import textwrap
from collections.abc import Sequence
from pathlib import Path

from crosscheck.document import Change, Document
from crosscheck.history.store import StoredRun
from crosscheck.report.headline import headline, sentence
from crosscheck.report.overview import worst_first

MOST_LINES = 12
"""Most changes and failures that are listed. The report has all."""

LONGEST = 160
"""Most characters of an engine's error message."""

VERDICTS = {0: "good", 1: "look at this", 2: "NOT ALL COULD BE JUDGED"}
"""Verdict by exit code."""


def summary(document: Document, name: str, before: StoredRun | None, exit_code: int, page: Path) -> str:
    """The summary in about twenty lines. The first line is the `headline`."""
    meta, changes = document.meta, document.changes or []
    findings = [change for change in changes if change.bad]
    notes = [change for change in changes if not change.bad]
    length = datetime.timedelta(seconds=round(meta.seconds))
    lines = [f"crosscheck nightly {meta.time}: {VERDICTS[exit_code]}. {headline(document)}.",
             f"{_count(len(document.records), 'run')} of {_count(len(document.scenes), 'scene')} on "
             + ", ".join(f"{engine} {version}" for engine, version in meta.engines.items())
             + f"; {length} on {meta.machine.cores} cores; commit {meta.commit or 'unknown'}",
             "first run, nothing to compare with" if before is None else
             f"compared with {before.name} (commit {before.environment.commit or 'unknown'})"]
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


def grouped(changes: Sequence[Change]) -> list[str]:
    """One line per kind, engine and method with its scenes. Methods with the same text share a line."""
    groups: dict[tuple[str, str, str], list[Change]] = {}
    for change in changes:
        groups.setdefault((change.kind, change.engine, change.method), []).append(change)
    alike: dict[tuple[str, str, str], list[str]] = {}
    for (kind, engine, method), each in groups.items():
        scenes = list(dict.fromkeys(change.scene for change in each if change.scene))
        where = scenes[0] if len(scenes) == 1 else f"{len(scenes)} scenes, for one {scenes[0]}" if scenes else ""
        text = f"{' on ' if where else ''}{where}: {each[0].text}"
        alike.setdefault((kind, engine, text.replace(method, "…") if method else text), []).append(method)
    lines = []
    for (kind, engine, text), methods in alike.items():
        several = f", {len(methods)} methods, for one" if len(methods) > 1 else ""
        who = f"{engine}{several} {methods[0]}".strip()
        lines.append(f"{kind}{': ' if who else ''}{who}{text.replace('…', methods[0])}")
    return lines


def _failures(document: Document) -> list[str]:
    """One line per scene with missing or disputed truth, then one per engine and kind of failure, new ones first."""
    broken = [f"{scene.name}: {scene.failure or scene.no_truth}" for scene in document.scenes
              if scene.failure or scene.disputed]
    lost = {scene.name for scene in document.scenes if scene.failure}
    records = [record for record in document.records if record.outcome in ("fail", "error")
               and record.scene not in lost]
    for group in worst_first(records, document.changes):
        worst = group.runs[0][0]
        several = f"{group.why}, {len(group.runs)} runs on {_count(group.scenes, 'scene')}, worst "
        broken.append(f"{group.engine}: {several if len(group.runs) > 1 else ''}"
                      f"{worst.label} on {worst.scene}, {textwrap.shorten(sentence(worst), LONGEST)}")
    return broken
