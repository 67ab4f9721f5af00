"""The changes between two runs, and the points at which a value changed over many runs. Reads no store and no file."""

from __future__ import annotations

import dataclasses
import math
import statistics
from collections.abc import Sequence
from typing import Any

from msgspec.structs import replace

from crosscheck.document import Change
from crosscheck.history.figures import SHARE, SPEED, Figure
from crosscheck.history.runs import CellKey, StoredResult, StoredRun, Usual
from crosscheck.verification.trust import NOISE_DEVIATIONS, NOISE_RATIO

KINDS = ("run", "outcome", "accuracy", "speed", "missing", "version", "truth", "scene", "settings", "new", "machine")
"""Kinds of changes, in the order of the pages."""

RANKS: dict[str, int] = {"pass": 0, "known": 0, "unsupported": 1, "unresolved": 1, "fail": 2, "error": 3}
"""Ranks of outcomes. A change to a higher rank is a finding."""


def compare(before: StoredRun, after: StoredRun, usual: dict[CellKey, Usual] | None = None) -> list[Change]:
    """All changes from one run to a later one, findings first.

    Parameters
    ----------
    before, after : the two runs with their results
    usual : if known, level and spread of the speed ratio of each cell over several runs without changes; the level
        then replaces the speed of `before`, which is one noisy measurement
    """
    usual = usual or {}
    before = _at_level(before, usual)
    changes = _versions(before, after)
    common = machine_factor(before, after)
    if common is not None and not 1 / NOISE_RATIO <= common <= NOISE_RATIO:
        changes.append(_general("machine", "", SPEED, 1.0, common, f"most engines alike took {common:.2f} times as "
                                "long beside the calibration kernel: the machine, and no change of an engine"))
    for key in before.results.keys() | after.results.keys():
        old, new = before.results.get(key), after.results.get(key)
        if old is None or new is None:
            changes += [] if old is None else [
                _cell("missing", old, "", old.outcome, None, "this run is no longer made", True)]
            changes += [] if new is None else [
                _cell("new", new, "", None, new.outcome, f"made for the first time: {new.outcome}", False)]
        elif old.scene_hash != new.scene_hash:
            changes.append(_cell("scene", new, "", old.scene_hash[:12], new.scene_hash[:12],
                                 "the scene file changed: figures are not compared", False))
        elif (old.step, old.rtol) != (new.step, new.rtol):
            changes.append(_cell("settings", new, "", old.step or old.rtol, new.step or new.rtol,
                                 "it ran at another step or tolerance: figures are not compared", False))
        else:
            if old.outcome != new.outcome:
                text = f"{old.outcome}, now {new.outcome}" + (f": {new.message}" if new.message else "")
                changes.append(_cell("outcome", new, "", old.outcome, new.outcome, text,
                                     RANKS[new.outcome] > RANKS[old.outcome]))
            changes += _accuracy(old, new)
            changes += _speed(old, new, usual[key].deviation if key in usual else 0.0, common or 1.0)
    # An edited scene is one change, not one for each of its runs.
    edited = {change.scene: replace(change, engine="", method="") for change in changes if change.kind == "scene"}
    changes = [change for change in changes if change.kind != "scene"] + list(edited.values())
    changes += _engine_speeds(before, after, common or 1.0, usual)
    return sorted(changes, key=lambda each: (not each.bad, KINDS.index(each.kind), each.engine, each.method,
                                             each.scene))


def _at_level(run: StoredRun, usual: dict[CellKey, Usual]) -> StoredRun:
    """The run with the usual speeds instead of its own."""
    def levelled(key: CellKey, result: StoredResult) -> StoredResult:
        if key not in usual or SPEED not in result.figures:
            return result
        figure = result.figures[SPEED]._replace(value=usual[key].level)
        return dataclasses.replace(result, figures=result.figures | {SPEED: figure})

    return dataclasses.replace(run, results={key: levelled(key, result) for key, result in run.results.items()})


def _cell(kind: str, result: StoredResult, quantity: str, before: Any, after: Any, text: str, bad: bool) -> Change:
    method = result.label.removeprefix(f"{result.key[1]} ")
    return Change(kind=kind, scene=result.key[0], engine=result.key[1], method=method, quantity=quantity,
                  before=before, after=after, text=text, bad=bad)


def _general(kind: str, engine: str, quantity: str, before: Any, after: Any, text: str, bad: bool = False) -> Change:
    return Change(kind=kind, scene="", engine=engine, method="", quantity=quantity, before=before, after=after,
                  text=text, bad=bad)


def _versions(before: StoredRun, after: StoredRun) -> list[Change]:
    """Changed versions of engines, packages and Python, and a changed processor."""
    changes = []
    for kind in ("engine", "package"):
        old, new = before.versions.get(kind, {}), after.versions.get(kind, {})
        for name in sorted(old.keys() | new.keys()):
            if old.get(name) != new.get(name):
                a, b = old.get(name, "absent"), new.get(name, "absent")
                changes.append(_general("version", name, "version", a, b, f"version {a}, now {b}"))
    for name in ("python", "processor", "cores"):
        former, now = getattr(before.environment, name), getattr(after.environment, name)
        if former != now:
            changes.append(_general("version", name, "version", str(former), str(now), f"{former}, now {now}"))
    return changes


def _accuracy(old: StoredResult, new: StoredResult) -> list[Change]:
    """The value of a cell that changed most beyond rounding. It is one change only, as an error affects many values."""
    moved = []
    for name, figure in new.figures.items():
        former = old.figures.get(name)
        if former is None or former.rounding is None or figure.rounding is None:
            continue
        rounding = max(former.rounding, figure.rounding)
        if abs(figure.value - former.value) > rounding:
            moved.append((_worse(former, figure), abs(figure.value - former.value) / max(rounding, 1e-300), former,
                          figure))
    if not moved:
        return []
    worse, _, former, figure = max(moved, key=lambda each: each[:2])
    others = f", and {len(moved) - 1} other figures" if len(moved) > 1 else ""
    text = (f"{figure.name} {_number(former)}, now {_number(figure)}{others}; rounding explains "
            f"{max(former.rounding or 0.0, figure.rounding or 0.0):.1e}")
    return [_cell("accuracy", new, figure.name, former.value, figure.value, text, worse)]


def _worse(former: Figure, figure: Figure) -> bool:
    less_is_worse = figure.name.endswith("order") or figure.name == SHARE
    return figure.value < former.value if less_is_worse else figure.value > former.value


def _number(figure: Figure) -> str:
    return f"{figure.value:.3g}" + ("" if figure.unit == "1" else f" {figure.unit}")


def _speed(old: StoredResult, new: StoredResult, usual: float, common: float) -> list[Change]:
    former, figure = old.figures.get(SPEED), new.figures.get(SPEED)
    if former is None or figure is None:
        return []
    adjusted = figure._replace(value=figure.value / common, deviation=(figure.deviation or 0.0) / common)
    if not beyond_noise(former, adjusted, usual):
        return []
    factor = adjusted.value / former.value
    spread = max(former.deviation or 0.0, adjusted.deviation or 0.0, usual) / former.value
    times = [each.figures["us per step"] for each in (old, new) if "us per step" in each.figures]
    seen = f"; {_number(times[0])} a step, now {_number(times[1])}" if len(times) == 2 else ""
    text = f"{factor:.2f} times the time per step{seen}; spread of the repeats {spread:.0%}"
    return [_cell("speed", new, SPEED, former.value, figure.value, text, factor > 1)]


def beyond_noise(former: Figure, figure: Figure, usual: float = 0.0) -> bool:
    """Whether a speed changed by more than 10 % and by more than 4 median absolute deviations.

    The deviation is the largest of those of the repeats of both runs and `usual`, which is that between runs.
    """
    ratio = figure.value / former.value
    deviation = max(former.deviation or 0.0, figure.deviation or 0.0, usual)
    return (not 1 / NOISE_RATIO <= ratio <= NOISE_RATIO
            and abs(figure.value - former.value) > NOISE_DEVIATIONS * deviation)


def _engine_speeds(before: StoredRun, after: StoredRun, common: float, usual: dict[CellKey, Usual]) -> list[Change]:
    """Engines whose runs became slower or faster together, even if noise hides it in the single runs.

    The rule is `beyond_noise` with the deviation of the median over the engine's runs. If it is larger, the deviation
    between nights of a typical run is used instead, because one night may slow down all runs alike.
    """
    changes = []
    for engine, by_cell in _factors(before, after).items():
        factors = list(by_cell.values())
        middle = statistics.median(factors) / common
        deviation = statistics.median(abs(factor / common - middle) for factor in factors)
        between = [usual[key].deviation / usual[key].level for key in by_cell if key in usual]
        noise = max(MEDIAN_STRAYS * deviation / math.sqrt(len(factors)), statistics.median(between or [0.0]))
        if len(factors) >= FEWEST and beyond_noise(Figure(SPEED, "1", 1.0), Figure(SPEED, "1", middle, noise)):
            text = (f"{middle:.2f} times the time per step, the median of its {len(factors)} runs; spread between them "
                    f"{deviation:.0%}")
            changes.append(_general("speed", engine, SPEED, 1.0, middle, text, middle > 1))
    return changes


MEDIAN_STRAYS = 1.25
"""sqrt(pi / 2): the median of n normal values has a deviation of sqrt(pi / 2) / sqrt(n) times that of one value."""

FEWEST = 5
"""Fewest runs of an engine for a statement about the engine."""


def machine_factor(before: StoredRun, after: StoredRun) -> float | None:
    """The factor by which most engines became slower relative to the calibration kernel; None for less than 3 engines.

    Engines are independent programs. If most of them become slower by the same factor, the machine is the cause.
    """
    by_engine = _factors(before, after)
    if len(by_engine) < 3:
        return None
    return statistics.median(statistics.median(by_cell.values()) for by_cell in by_engine.values())


def _factors(before: StoredRun, after: StoredRun) -> dict[str, dict[CellKey, float]]:
    """Speed ratio after / before by engine and cell, for cells with the same scene, step and tolerance in both runs."""
    by_engine: dict[str, dict[CellKey, float]] = {}
    for key, result in after.results.items():
        old = before.results.get(key)
        if old is None or (old.scene_hash, old.step, old.rtol) != (result.scene_hash, result.step, result.rtol):
            continue
        if SPEED in old.figures and SPEED in result.figures:
            factor = result.figures[SPEED].value / old.figures[SPEED].value
            by_engine.setdefault(key[1], {})[key] = factor
    return by_engine


def change_points(figures: Sequence[Figure]) -> list[int]:
    """Indices at which a series moved to another level: beyond noise for speeds, beyond rounding for other values.

    A point is compared with the median of the points since the last change. For a speed, the next point must agree, if
    there is one, so that a single slow night is not a change. Values with unknown rounding have no change points.
    """
    points: list[int] = []
    start = 0
    for index in range(1, len(figures)):
        level = statistics.median(figure.value for figure in figures[start:index])
        following = figures[index:index + 2] if figures[index].name == SPEED else figures[index:index + 1]
        former = figures[start]._replace(value=level)
        if all(_moved(former, figure) and (figure.value > level) == (figures[index].value > level)
               for figure in following):
            points.append(index)
            start = index
    return points


def _moved(former: Figure, figure: Figure) -> bool:
    if figure.name == SPEED:
        return beyond_noise(former, figure)
    rounding = max(former.rounding or 0.0, figure.rounding or 0.0)
    return former.rounding is not None and abs(figure.value - former.value) > rounding


def heights(values: Sequence[float]) -> list[float]:
    """Values scaled from 0 for the smallest to 1 for the largest; 0.5 if all are equal."""
    shown = [scaled(value, spans_decades(values)) for value in values]
    low, high = min(shown), max(shown)
    return [(value - low) / (high - low) if high > low else 0.5 for value in shown]


def spans_decades(values: Sequence[float]) -> bool:
    """Whether values are shown on a logarithmic scale: they are positive and differ by more than a factor of ten."""
    return min(values) > 0 and max(values) > 10 * min(values)


def scaled(value: float, logarithmic: bool) -> float:
    """A value on its scale."""
    return math.log10(max(value, 1e-300)) if logarithmic else value


BARS = "▁▂▃▄▅▆▇█"


def sparkline(values: Sequence[float]) -> str:
    """One bar per value, as high as `heights` says."""
    if len(set(values)) < 2:
        return BARS[3] * len(values)
    return "".join(BARS[min(7, int(8 * height))] for height in heights(values))
