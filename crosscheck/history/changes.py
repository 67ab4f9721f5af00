"""What changed between two runs, and when a figure changed through many. Nothing here reads a store or a file."""

from __future__ import annotations

import dataclasses
import math
import statistics
from collections.abc import Sequence
from typing import Any

from msgspec.structs import replace

from crosscheck.document import Change
from crosscheck.history.store.figures import SPEED, Figure
from crosscheck.history.store.runs import CellKey, StoredResult, StoredRun, Usual
from crosscheck.verification.trust import NOISE_DEVIATIONS, NOISE_RATIO

KINDS = ("run", "outcome", "accuracy", "speed", "missing", "version", "truth", "scene", "settings", "new", "machine")
"""Kinds of changes, in the order in which a page lists them."""

RANKS = {"pass": 0, "partly": 0, "known": 0, "unsupported": 1, "unjudged": 1, "fail": 2, "error": 3}
"""How bad an outcome is: a change to a higher one is a finding."""


def compare(before: StoredRun, after: StoredRun, usual: dict[CellKey, Usual] | None = None) -> list[Change]:
    """All changes from one run to a later one, findings first.

    Parameters
    ----------
    before, after : with their results
    usual : level and spread of the speed ratio of a cell over runs that did not change, where they are known: one run
        has strayed itself, so that the level stands in its place
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
    # An edited scene is told once and not for every run of it.
    edited = {change.scene: replace(change, engine="", method="") for change in changes if change.kind == "scene"}
    changes = [change for change in changes if change.kind != "scene"] + list(edited.values())
    changes += _engine_speeds(before, after, common or 1.0, usual)
    return sorted(changes, key=lambda each: (not each.bad, KINDS.index(each.kind), each.engine, each.method,
                                             each.scene))


def _at_level(run: StoredRun, usual: dict[CellKey, Usual]) -> StoredRun:
    """The run with the usual speeds in place of its own."""
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
    """Engines, packages, Python, processor."""
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
    """The figure that moved most beyond rounding; one change a cell, an error shows in many figures."""
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
    return figure.value < former.value if figure.name.endswith("order") else figure.value > former.value


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
    """More than 10 % in the median ratio, and more than 4 median absolute deviations.

    The deviations are those of the repeats of either run, and `usual`, between runs, where that is larger.
    """
    ratio = figure.value / former.value
    deviation = max(former.deviation or 0.0, figure.deviation or 0.0, usual)
    return (not 1 / NOISE_RATIO <= ratio <= NOISE_RATIO
            and abs(figure.value - former.value) > NOISE_DEVIATIONS * deviation)


def _engine_speeds(before: StoredRun, after: StoredRun, common: float, usual: dict[CellKey, Usual]) -> list[Change]:
    """Engines whose runs became slower or faster together, which shows through noise that hides it in each of them.

    The rule is that of a single run: with the deviation of the median of its runs, or between runs that did not change
    that of a typical one of them, where this is larger: one night may stretch them all alike.
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
"""A median of n normal draws strays sqrt(pi / 2) / sqrt(n) times as far as one draw."""

FEWEST = 5
"""Runs of an engine that it takes to speak of all of them."""


def machine_factor(before: StoredRun, after: StoredRun) -> float | None:
    """How much longer most engines took, beside the calibration kernel; None with fewer than three engines.

    Engines are different programs by different people: what slows most of them alike is the machine.
    """
    by_engine = _factors(before, after)
    if len(by_engine) < 3:
        return None
    return statistics.median(statistics.median(by_cell.values()) for by_cell in by_engine.values())


def _factors(before: StoredRun, after: StoredRun) -> dict[str, dict[CellKey, float]]:
    """By engine and cell, the speed ratio after over that before, of the runs that are the same in both."""
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
    """Indices at which a series moved to another level: beyond noise for speeds, beyond rounding for the rest.

    A point is compared with the median of its level so far. Of a speed the next point has to agree, where there is one:
    a single slow night is no change. Figures without rounding and other than speeds never change.
    """
    found: list[int] = []
    start = 0
    for index in range(1, len(figures)):
        level = statistics.median(figure.value for figure in figures[start:index])
        following = figures[index:index + 2] if figures[index].name == SPEED else figures[index:index + 1]
        former = figures[start]._replace(value=level)
        if all(_moved(former, figure) and (figure.value > level) == (figures[index].value > level)
               for figure in following):
            found.append(index)
            start = index
    return found


def _moved(former: Figure, figure: Figure) -> bool:
    if figure.name == SPEED:
        return beyond_noise(former, figure)
    rounding = max(former.rounding or 0.0, figure.rounding or 0.0)
    return former.rounding is not None and abs(figure.value - former.value) > rounding


BARS = "▁▂▃▄▅▆▇█"


def sparkline(values: Sequence[float]) -> str:
    """One bar a value, on a log scale where the values are positive and differ more than tenfold."""
    if not values:
        return ""
    if min(values) > 0 and max(values) > 10 * min(values):
        values = [math.log(value) for value in values]
    low, high = min(values), max(values)
    if high == low:
        return BARS[3] * len(values)
    return "".join(BARS[min(7, int(8 * (value - low) / (high - low)))] for value in values)
