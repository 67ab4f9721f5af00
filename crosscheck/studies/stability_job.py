"""The stability study of several scenes: every way in a worker process, kept in a journal, written as ways end."""

from __future__ import annotations

import dataclasses
import math
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from crosscheck import adapters as all_engines
from crosscheck.jobs.grid import Crash, Limits, run_tasks
from crosscheck.jobs.journal import Journal
from crosscheck.jobs.workers.process import GIGABYTE
from crosscheck.running import provenance
from crosscheck.studies import results_folder
from crosscheck.studies.stability import COMMON, USABLE, Way, blank, search

STUDY = "stability"
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

PAUSE = 10.0
"""s between two writings of the folder: the journal keeps every way as it ends, the page may lag behind."""

STATIC = ("report.css", "theme.js", "tables.js")

SHADES = (0.95, 0.5, 0.1, 0.01)
"""Shares of the largest step of a scene that bound the shades of the map, the first of which is as good as the best."""

TYPES = {"truth": dict[str, Any], "way": dict[str, Any]}


@dataclasses.dataclass(frozen=True)
class Request:
    """What to measure; None: the hard scenes and `ALSO`, all engines, all methods that take a fixed step."""

    scenes: tuple[str, ...] | None = None
    engines: tuple[str, ...] | None = None
    methods: tuple[str, ...] | None = None
    time_limit: float = 2.0  # s of one run
    jobs: int = 2


def study(request: Request, out: Path, progress: Callable[[int, int | None, str], Any]) -> dict[str, Any]:
    """Measure, write into `out` on the way, and return the document. A study that was killed goes on where it was.

    Raises `ArgumentError` for wrong names or a folder that must not be replaced; a failed way is a row.
    """
    from crosscheck.scene.file import load_scene
    from crosscheck.studies.work_precision import check_names

    engines = request.engines or all_engines.names()
    check_names(engines, request.methods)
    scenes = request.scenes or (*ALSO, *hard_scenes())
    hashes = [load_scene(name).hash for name in scenes]
    results_folder.check(out, STUDY)
    ways = [Way(scene, engine, method, request.time_limit) for scene in scenes for engine in engines
            for method in fixed_step_methods(engine) if request.methods is None or method in request.methods]
    state = provenance.code_digest(engines, [dataclasses.asdict(request), hashes])
    found: list[dict[str, Any] | None] = [None] * len(ways)
    with results_folder.journal(out, STUDY, state, TYPES) as journal:
        sheet = _Sheet(out, engines, request, journal)

        def keep(index: int, row: dict[str, Any]) -> None:
            found[index] = row
            rows = [each for each in found if each is not None]
            sheet.write(rows, last=len(rows) == len(ways))
            progress(len(rows), len(ways), f"{row['scene']} {row['engine']} {row['method']}")

        _measure(ways, request, journal, keep, progress)
    return sheet.document


class _Sheet:
    """The document, and when it was last written."""

    def __init__(self, out: Path, engines: tuple[str, ...], request: Request, journal: Journal) -> None:
        self._out, self._journal, self._written = out, journal, -math.inf
        self.document: dict[str, Any] = {
            "study": STUDY, "usable": USABLE, "common": COMMON, "scenes": [], "map": [], "rows": [],
            "meta": provenance.describe(engines) | {"time_limit": request.time_limit, "jobs": request.jobs}}

    def write(self, rows: list[dict[str, Any]], last: bool) -> None:
        """Write the folder, unless it was written just now."""
        if not last and time.perf_counter() - self._written < PAUSE:
            return
        self.document |= {"rows": rows, "scenes": summary(rows), "map": shaded(rows)}
        self.document["meta"]["seconds"] = self._journal.seconds
        table = [{key: value for key, value in row.items() if key != "runs"} for row in rows]
        results_folder.write(self._out, self.document, table, "stability.html.j2", STATIC)
        self._written = time.perf_counter()


def _measure(ways: list[Way], request: Request, journal: Journal, keep: Callable[[int, dict[str, Any]], None],
             progress: Callable[[int, int | None, str], Any]) -> None:
    """Hand the row of every way to `keep`, from the journal where it is there."""
    untrue = _without_truth(list(dict.fromkeys(way.scene for way in ways)), request.jobs, journal, progress)
    open_ways = []
    for index, way in enumerate(ways):
        row = journal.get("way", _key(way))
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
            keep(open_ways[place], journal.put("way", _key(way), row))

    run_tasks(search, [ways[index] for index in open_ways], request.jobs, done,
              Limits(max(PATIENCE, WAYS * request.time_limit), MEMORY))


def _key(way: Way) -> str:
    return f"{way.scene} {way.engine} {way.method}"


def _failed(way: Way, reason: str) -> dict[str, Any]:
    from crosscheck.scene.file import load_scene

    return blank(load_scene(way.scene).name, way) | {"outcome": "failed", "reason": reason}


def _without_truth(scenes: list[str], jobs: int, journal: Journal,
                   progress: Callable[[int, int | None, str], Any]) -> dict[str, str]:
    """Why some scenes have no truth. That of the others is in the cache then, and costs their ways no time."""
    kept = {scene: journal.get("truth", scene) for scene in scenes}
    missing = [scene for scene, entry in kept.items() if entry is None]

    def done(place: int, result: Any) -> None:
        if isinstance(result, Crash):
            kept[missing[place]] = {"reason": result.message}
        else:
            kept[missing[place]] = journal.put("truth", missing[place], {"reason": ""})
        progress(place + 1, len(missing), f"truth of {missing[place]}")

    run_tasks(prepare, missing, jobs, done, Limits(TRUTH_LIMIT, MEMORY))
    return {scene: entry["reason"] for scene, entry in kept.items() if entry["reason"]}


def prepare(scene: str) -> None:
    """Put the truth of a scene into the cache; raises what `crosscheck.truth` raises."""
    from crosscheck.references import truth
    from crosscheck.scene.file import load_scene

    truth(load_scene(scene))


def hard_scenes() -> tuple[str, ...]:
    """Names of the built-in scenes with the tag "hard"."""
    from crosscheck.scene.file import load_scene, scene_names

    return tuple(name for name in scene_names() if TAG in load_scene(name).tags)


def fixed_step_methods(engine: str) -> tuple[str, ...]:
    """Methods that take a step and do not change it."""
    if engine == OWN:
        import lieeuler

        return tuple(name for name, method in lieeuler.METHODS.items() if "step" in method.controls)
    adapter = all_engines.get(engine)
    return tuple(name for name in adapter.methods if name not in getattr(adapter, "adaptive_methods", ()))


def summary(rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Per scene the largest usable step in-house, among engines with integrators of their own, and among all others.

    `ratio` is in-house over the former, `ratio_any` over the latter; None where either is missing.
    """
    found = []
    for scene in dict.fromkeys(row["scene"] for row in rows):
        usable = [row for row in rows if row["scene"] == scene and row["h_max"] is not None]
        own = _largest([row for row in usable if row["engine"] == OWN])
        stock = _largest([row for row in usable if row["engine"] not in (OWN, *ADDED)])
        other = _largest([row for row in usable if row["engine"] != OWN])
        found.append({"scene": scene, "own": _label(own), "own_h_max": _step(own), "stock": _label(stock),
                      "stock_h_max": _step(stock), "ratio": _ratio(own, stock), "any": _label(other),
                      "any_h_max": _step(other), "ratio_any": _ratio(own, other)})
    return found


def shaded(rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """The map: for every engine and method a cell per scene, shaded from 0, the scene's largest step, to `SHADES`."""
    scenes = list(dict.fromkeys(row["scene"] for row in rows))
    largest = {scene: max((row["h_max"] for row in rows if row["scene"] == scene and row["h_max"]), default=0.0)
               for scene in scenes}
    by_way: dict[tuple[str, str], dict[str, dict[str, Any]]] = {}
    for row in rows:
        by_way.setdefault((row["engine"], row["method"]), {})[row["scene"]] = row
    return [{"engine": engine, "method": method, "cells": [_cell(cells.get(scene), scene, largest[scene])
                                                           for scene in scenes]}
            for (engine, method), cells in by_way.items()]


def _cell(row: dict[str, Any] | None, scene: str, largest: float) -> dict[str, Any]:
    """A cell of the map; `row` is None where this way was not measured."""
    if row is None:
        return {"scene": scene, "h_max": None, "shade": None, "common_error": None, "outcome": "", "reason": ""}
    step = row["h_max"]
    return {"scene": scene, "h_max": step, "common_error": row["common_error"], "outcome": row["outcome"],
            "shade": None if step is None else sum(step < share * largest for share in SHADES),
            "reason": row["failures"] or row["reason"]}


def _largest(rows: list[dict[str, Any]]) -> dict[str, Any] | None:
    return max(rows, key=lambda row: row["h_max"], default=None)


def _label(row: dict[str, Any] | None) -> str:
    return "" if row is None else f"{row['engine']} {row['method']}"


def _step(row: dict[str, Any] | None) -> float | None:
    return None if row is None else row["h_max"]


def _ratio(one: dict[str, Any] | None, other: dict[str, Any] | None) -> float | None:
    return None if one is None or other is None else one["h_max"] / other["h_max"]
