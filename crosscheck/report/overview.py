"""The content of the first page: counts, matrices and the worst findings. It is chosen and sorted, not computed."""

from __future__ import annotations

import collections
import dataclasses
import itertools
import math
from collections.abc import Iterable, Sequence
from typing import get_args

import numpy as np

from crosscheck.document import ENDED, Change, Document, Finding, Record, Scene, grouped
from crosscheck.document.curves import Packed
from crosscheck.document.outcomes import KINDS, Outcome
from crosscheck.report.curves import unpack
from crosscheck.report.headline import OUTCOMES

SEVERITY: tuple[Outcome, ...] = get_args(Outcome)
"""Outcomes, the most urgent first."""


def counted(records: Iterable[Record]) -> dict[str, int]:
    """Number of runs with each outcome that occurs, in the order of `OUTCOMES`."""
    counts = collections.Counter(record.outcome for record in records)
    return {outcome: counts[outcome] for outcome in OUTCOMES if counts[outcome]}


def pairs(records: Iterable[Record]) -> dict[tuple[str, str], list[Record]]:
    """The runs by scene and engine."""
    return grouped(records, lambda record: (record.scene, record.engine))


@dataclasses.dataclass(frozen=True)
class Advice:
    """Scenes for which the same run is recommended for the same reason."""

    run: str | None  # its label; None if no run can be recommended
    why: str
    scenes: list[Scene]


def recommended(scenes: Sequence[Scene]) -> list[Advice]:
    """Scenes grouped by recommended run and reason, the largest group first. Groups without a run come last."""
    def key(scene: Scene) -> tuple[str | None, str]:
        advice = scene.recommended
        return ((advice.runs[0], advice.why.partition(",")[0]) if advice else
                (None, scene.trust))

    runs = [Advice(run, why, each) for (run, why), each in grouped(scenes, key).items()]
    return sorted(runs, key=lambda group: (group.run is None, -len(group.scenes)))


def by_method(document: Document) -> dict[str, list[tuple[str, dict[str, Record]]]]:
    """Runs by engine: rows of (label, run of each scene)."""
    labelled = grouped(document.records, lambda record: record.label)
    rows = [(label, {record.scene: record for record in records}) for label, records in labelled.items()]
    return grouped(rows, lambda row: next(iter(row[1].values())).engine)


FEW = 24
"""Runs that the first table holds one by one; of more, one an engine and scene."""


def first_rows(document: Document) -> list[Record]:
    """The runs of the first table, scene by scene, with lieeuler last: a reader looks for the engine that he uses.

    All, if they are few; else the run to trust of each engine on each scene, or the worst where none is.
    """
    order = {scene.name: number for number, scene in enumerate(document.scenes)}
    rows = sorted(document.records, key=lambda record: (
        order.get(record.scene, len(order)), record.engine == "lieeuler"))
    if len(rows) <= FEW:
        return rows
    trusted = {(scene.name, row.engine): row.recommended.runs[0] for scene in document.scenes for row in scene.engines
               if row.recommended is not None}
    return [next((record for record in records if record.label == trusted.get(pair)),
                 min(records, key=lambda record: SEVERITY.index(record.outcome)))
            for pair, records in pairs(rows).items()]


@dataclasses.dataclass(frozen=True)
class Wrong:
    """Runs with the same problem."""

    outcome: Outcome
    engine: str  # "" for known defects, which several engines may share
    why: str
    runs: list[tuple[Record, Finding | None]]  # with their worst findings, the worst run first
    scenes: int
    new: int  # number of runs that became worse since the earlier run that `changes` compare with


def worst_first(records: Sequence[Record], changes: Sequence[Change] | None = None) -> list[Wrong]:
    """Failed runs and known defects, grouped by engine and problem: new problems first, known defects last."""
    worse = {(change.scene, change.engine, change.method) for change in changes or [] if change.bad}
    bad = [(record, record.worst) for record in records if record.outcome in ("fail", "error", "known")]
    bad.sort(key=lambda pair: -math.inf if pair[1] is None else -pair[1].severity)
    groups = grouped(bad, lambda pair: (
        pair[0].outcome, "" if pair[0].outcome == "known" else pair[0].engine, _matter(*pair)))
    wrong = [Wrong(outcome, engine, why, runs, len({record.scene for record, _ in runs}),
                   sum((record.scene, record.engine, record.label.removeprefix(f"{record.engine} ")) in worse
                       for record, _ in runs))
             for (outcome, engine, why), runs in groups.items()]
    # Sorting is stable: otherwise groups stay in the order of their worst runs.
    return sorted(wrong, key=lambda group: (not group.new, SEVERITY.index(group.outcome)))


def _matter(record: Record, finding: Finding | None) -> str:
    """What is wrong with a run, in words that are the same for similar runs. For a known defect: its reason."""
    if record.outcome == "error" or finding is None:
        return "did not run"
    if record.outcome == "known":
        return finding.why
    if finding.kind == "asked end":
        return "did not reach its end" if finding.why == ENDED else "printed text that nobody reads"
    return KINDS[finding.about].title


DRAWN = 6
"""Most failing runs whose errors the first page draws."""

WIDE, HIGH = 320, 60
"""Size of such a picture, px."""


@dataclasses.dataclass(frozen=True)
class Picture:
    """The error of a run over time as a line, on a logarithmic scale."""

    quantity: str
    unit: str
    end: float  # s
    least: float
    most: float
    points: str  # of an SVG polyline, px


def pictures(document: Document, worst: Sequence[Wrong]) -> dict[tuple[str, str], Picture]:
    """By scene and label the errors of the worst failing runs."""
    times = {scene.name: np.array(scene.curves.t) for scene in document.scenes}
    failing = [record for group in worst if group.outcome == "fail" for record, _ in group.runs]
    drawn = ((record, _picture(record, times[record.scene])) for record in failing)
    return {(record.scene, record.label): made for record, made in itertools.islice(
        ((record, made) for record, made in drawn if made is not None), DRAWN)}


def _picture(record: Record, t: np.ndarray) -> Picture | None:
    """The error that fails, or else the first one that is kept; None if there is none to draw."""
    known = {name: curve for name, curve in record.curves.errors.items() if isinstance(curve, Packed)}
    if not known:
        return None
    name = record.worst.row if record.worst is not None and record.worst.row in known else next(iter(known))
    values = unpack(known[name])
    keep = np.isfinite(values) & (values > np.finfo(float).eps * np.nanmax(values, initial=0.0))
    if np.count_nonzero(keep) < 2:
        return None
    size = np.log10(values[keep])
    x, y = WIDE * t[:len(values)][keep] / t[-1], HIGH * (size.max() - size) / max(float(np.ptp(size)), 1.0)
    return Picture(name, record.errors[name].unit if name in record.errors else "", float(t[-1]),
                   float(values[keep].min()), float(values[keep].max()),
                   " ".join(f"{a:.0f},{b:.1f}" for a, b in zip(x, y, strict=True)))
