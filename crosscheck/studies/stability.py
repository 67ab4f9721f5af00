"""The stability map: the largest usable step of every way, scene by scene.

Every way is searched in a worker process (`crosscheck.studies.bisection`) and kept in a journal as it ends.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from crosscheck import adapters as all_engines
from crosscheck.jobs.grid import Crash, Limits, run_tasks
from crosscheck.jobs.journal import Journal
from crosscheck.jobs.workers.process import GIGABYTE
from crosscheck.running import provenance
from crosscheck.scene.model import Scene
from crosscheck.studies import results_folder
from crosscheck.studies.bisection import COMMON, USABLE, Row, Task, search
from crosscheck.studies.study import Ask, Progress

TAG = "hard"
ALSO = ("single_pendulum", "double_pendulum", "heavy_top")
"""What the hard scenes are compared with: everyday ones."""

OWN = "lieeuler"

ADDED = ("pinocchio",)
"""Engines without an integrator: their methods are steppers of this package over the engine's dynamics."""

WAYS = 60
"""A way may take this many times the limit of one run; its search makes some forty runs, most of them short."""

PATIENCE = 900.0
"""s that a way may take in any case: on a crowded machine, loading an engine alone takes a minute."""

TRUTH_LIMIT = 1800.0
"""s that the truth of one scene may take; that of stiff_damped takes a hundred on a machine that is free."""

MEMORY = 4.0 * GIGABYTE

SHADES = (0.95, 0.5, 0.1, 0.01)
"""Shares of the largest step of a scene that bound the shades of the map, the first of which is as good as the best."""

TYPES = {"truth": dict[str, str], "way": Row}


@dataclasses.dataclass(frozen=True)
class StabilityAsk(Ask):
    """Also the number of worker processes. All scenes: the hard ones and `ALSO`."""

    time_limit: float = 2.0  # s of one run
    jobs: int = 2
    step: float | None = None  # s, the common one; None: one that suits each scene
    duration: float | None = None  # s; None: the scene's


class Stability:
    """The largest usable steps. A study that was killed goes on where it was."""

    name = "stability"

    def __init__(self) -> None:
        self._seconds = 0.0  # of all sessions

    def scenes(self) -> tuple[str, ...]:
        """Everyday scenes, then the hard ones."""
        return (*ALSO, *hard_scenes())

    def cells(self, ask: StabilityAsk, engines: tuple[str, ...], scenes: Sequence[Scene]) -> list[Task]:
        """A way on a scene each."""
        return [Task(scene, engine, method, ask.time_limit, chart, ask.step, ask.duration)
                for scene in ask.scenes or self.scenes() for engine in engines
                for chart in [all_engines.coordinate_map(engine, ask.coordinate_map)]
                for method in fixed_step_methods(engine) if ask.methods is None or method in ask.methods]

    def measure(self, ask: StabilityAsk, cells: list[Task], out: Path, progress: Progress,
                keep: Callable[[list[Row]], None]) -> None:
        """In worker processes, kept as each way ends."""
        from crosscheck.scene.file import load_scene

        hashes = {task.scene: load_scene(task.scene).hash for task in cells}
        engines = dict.fromkeys(task.engine for task in cells)
        state = provenance.code_digest(engines, [dataclasses.asdict(ask), hashes])
        found: list[Row | None] = [None] * len(cells)
        with results_folder.journal(out, self.name, state, TYPES) as journal:
            def kept(index: int, row: Row) -> None:
                found[index] = row
                self._seconds = journal.seconds
                rows = [each for each in found if each is not None]
                keep(rows)
                progress(len(rows), len(cells), cells[index].key)

            _measure(cells, ask, journal, kept, progress)

    def document(self, ask: StabilityAsk, results: list[Row]) -> dict[str, Any]:
        """The map, the largest steps of each scene, and every run."""
        meta = {"time_limit": ask.time_limit, "jobs": ask.jobs, "seconds": self._seconds}
        return {"meta": meta, "usable": USABLE, "common": COMMON, "scenes": summary(results), "map": shaded(results),
                "rows": [dataclasses.asdict(row) for row in results]}

    def table(self, document: dict[str, Any]) -> list[dict[str, Any]]:
        """A line a way."""
        return [{key: value for key, value in row.items() if key != "runs"} for row in document["rows"]]


def _measure(ways: list[Task], ask: StabilityAsk, journal: Journal, keep: Callable[[int, Row], None],
             progress: Progress) -> None:
    """Hand the row of every way to `keep`, from the journal where it is there."""
    untrue = _without_truth(list({way.scene: way for way in ways}.values()), ask.jobs, journal, progress)
    open_ways = []
    for index, way in enumerate(ways):
        row = journal.get("way", way.key)
        if row is None and way.scene in untrue:
            row = _failed(way, untrue[way.scene])
        if row is None:
            open_ways.append(index)
        else:
            keep(index, row)

    def done(place: int, row: Any) -> None:
        way = ways[open_ways[place]]
        if isinstance(row, Crash):  # not into the journal: what a crowded machine stopped may end the next time
            keep(open_ways[place], _failed(way, row.message))
        else:
            keep(open_ways[place], journal.put("way", way.key, row))

    run_tasks(search, [ways[index] for index in open_ways], ask.jobs, done,
              Limits(max(PATIENCE, WAYS * ask.time_limit), MEMORY))


def _failed(way: Task, reason: str) -> Row:
    from crosscheck.scene.file import load_scene

    return Row(load_scene(way.scene).name, way.engine, way.method, "failed", reason=reason)


def _without_truth(ways: list[Task], jobs: int, journal: Journal, progress: Progress) -> dict[str, str]:
    """Why some scenes have no truth, of a way for each. That of the others is in the cache then, and costs no time."""
    kept = {way.scene: journal.get("truth", way.scene) for way in ways}
    missing = [scene for scene, entry in kept.items() if entry is None]

    def done(place: int, result: Any) -> None:
        if isinstance(result, Crash):
            kept[missing[place]] = {"reason": result.message}
        else:
            kept[missing[place]] = journal.put("truth", missing[place], {"reason": ""})
        progress(place + 1, len(missing), f"truth of {missing[place]}")

    run_tasks(prepare, [way for way in ways if way.scene in missing], jobs, done, Limits(TRUTH_LIMIT, MEMORY))
    return {scene: entry["reason"] for scene, entry in kept.items() if entry["reason"]}


def prepare(way: Task) -> None:
    """Put the truth of a way's scene into the cache; raises what `crosscheck.truth` raises."""
    from crosscheck.references import truth

    truth(way.scene_asked())


def hard_scenes() -> tuple[str, ...]:
    """Names of the built-in scenes with the tag "hard"."""
    from crosscheck.scene.file import load_scene, scene_names

    return tuple(name for name in scene_names() if TAG in load_scene(name).tags)


def fixed_step_methods(engine: str) -> tuple[str, ...]:
    """Methods that take a step and do not change it."""
    adapter = all_engines.get(engine)
    fixed = getattr(adapter, "fixed_step_methods", None)
    if fixed is not None:
        return tuple(fixed)
    return tuple(name for name in adapter.methods if name not in getattr(adapter, "adaptive_methods", ()))


def summary(rows: Sequence[Row]) -> list[dict[str, Any]]:
    """Per scene the largest usable step in-house, among engines with integrators of their own, and among all others.

    `ratio` is in-house over the former, `ratio_any` over the latter; None where either is missing.
    """
    found = []
    for scene in dict.fromkeys(row.scene for row in rows):
        usable = [row for row in rows if row.scene == scene and row.h_max is not None]
        own = _largest([row for row in usable if row.engine == OWN])
        stock = _largest([row for row in usable if row.engine not in (OWN, *ADDED)])
        other = _largest([row for row in usable if row.engine != OWN])
        found.append({"scene": scene, "own": _label(own), "own_h_max": _step(own), "stock": _label(stock),
                      "stock_h_max": _step(stock), "ratio": _ratio(own, stock), "any": _label(other),
                      "any_h_max": _step(other), "ratio_any": _ratio(own, other)})
    return found


def shaded(rows: Sequence[Row]) -> list[dict[str, Any]]:
    """The map: for every engine and method a cell per scene, shaded from 0, the scene's largest step, to `SHADES`."""
    scenes = list(dict.fromkeys(row.scene for row in rows))
    largest = {scene: max((row.h_max for row in rows if row.scene == scene and row.h_max), default=0.0)
               for scene in scenes}
    by_way: dict[tuple[str, str], dict[str, Row]] = {}
    for row in rows:
        by_way.setdefault((row.engine, row.method), {})[row.scene] = row
    return [{"engine": engine, "method": method, "cells": [_cell(cells.get(scene), scene, largest[scene])
                                                           for scene in scenes]}
            for (engine, method), cells in by_way.items()]


def _cell(row: Row | None, scene: str, largest: float) -> dict[str, Any]:
    """A cell of the map; `row` is None where this way was not measured."""
    if row is None:
        return {"scene": scene, "h_max": None, "shade": None, "common_error": None, "outcome": "", "reason": ""}
    step = row.h_max
    return {"scene": scene, "h_max": step, "common_error": row.common_error, "outcome": row.outcome,
            "shade": None if step is None else sum(step < share * largest for share in SHADES),
            "reason": row.failures or row.reason}


def _largest(rows: Sequence[Row]) -> Row | None:
    return max(rows, key=lambda row: row.h_max or 0.0, default=None)


def _label(row: Row | None) -> str:
    return "" if row is None else f"{row.engine} {row.method}"


def _step(row: Row | None) -> float | None:
    return None if row is None else row.h_max


def _ratio(one: Row | None, other: Row | None) -> float | None:
    return one.h_max / other.h_max if one and other and one.h_max and other.h_max else None
