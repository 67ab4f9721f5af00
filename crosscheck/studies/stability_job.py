"""The stability study of several scenes, every way in a worker process, written after every way."""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from crosscheck import engines as all_engines
from crosscheck import provenance
from crosscheck.grid import Crash, Limits, run_tasks
from crosscheck.studies import results_folder
from crosscheck.studies.stability import COMMON, USABLE, Way, blank, search
from crosscheck.workers.process import GIGABYTE

STUDY = "stability"
TAG = "hard"
OWN = "lieeuler"

ADDED = ("pinocchio",)
"""Engines without an integrator: their methods are steppers of this package over the engine's dynamics."""

WAYS = 60
"""A way may take this many times the limit of one run; its search makes some forty runs, most of them short."""

TRUTH_LIMIT = 600.0
"""s that the truth of one scene may take."""

MEMORY = 4.0 * GIGABYTE


@dataclasses.dataclass(frozen=True)
class Request:
    """What to measure; None: the scenes tagged "hard", all engines, all methods that take a fixed step."""

    scenes: tuple[str, ...] | None = None
    engines: tuple[str, ...] | None = None
    methods: tuple[str, ...] | None = None
    time_limit: float = 2.0  # s of one run


def study(request: Request, out: Path, progress: Callable[[int, int | None, str], Any]) -> dict[str, Any]:
    """Measure, write into `out` after every way, and return the document.

    Raises `ArgumentError` for wrong names or a folder that must not be replaced; a failed way is a row.
    """
    from crosscheck.scene_file import load_scene
    from crosscheck.studies.work_precision import check_names

    engines = request.engines or all_engines.names()
    check_names(engines, request.methods)
    scenes = request.scenes or hard_scenes()
    for name in scenes:
        load_scene(name)
    results_folder.check(out, STUDY)
    ways = [Way(scene, engine, method, request.time_limit) for scene in scenes for engine in engines
            for method in fixed_step_methods(engine) if request.methods is None or method in request.methods]
    total = len(ways)
    began = time.perf_counter()
    untrue = _without_truth(scenes)
    document: dict[str, Any] = {"study": STUDY, "meta": provenance.describe(engines), "usable": USABLE,
                                "common": COMMON, "scenes": [], "rows": []}

    def keep(index: int, found: Any) -> None:
        way = ways[index]
        if isinstance(found, Crash):
            found = blank(load_scene(way.scene).name, way) | {"outcome": "failed", "reason": found.message}
        document["rows"].append(found)
        document["scenes"] = summary(document["rows"])
        document["meta"]["seconds"] = time.perf_counter() - began
        results_folder.write(out, document, [{key: value for key, value in row.items() if key != "runs"}
                                             for row in document["rows"]])
        progress(len(document["rows"]), total, f"{found['scene']} {way.engine} {way.method}")

    for index, way in enumerate(ways):
        if way.scene in untrue:
            keep(index, untrue[way.scene])
    ways = [way for way in ways if way.scene not in untrue]
    run_tasks(search, ways, 1, keep, Limits(WAYS * request.time_limit, MEMORY))
    return document


def _without_truth(scenes: tuple[str, ...]) -> dict[str, Crash]:
    """Why some scenes have no truth. That of the others is in the cache then, and costs their ways no time."""
    found = run_tasks(prepare, scenes, 1, limits=Limits(TRUTH_LIMIT, MEMORY))
    return {scene: crash for scene, crash in zip(scenes, found, strict=True) if crash is not None}


def prepare(scene: str) -> None:
    """Put the truth of a scene into the cache; raises what `crosscheck.truth` raises."""
    from crosscheck.references import truth
    from crosscheck.scene_file import load_scene

    truth(load_scene(scene))


def hard_scenes() -> tuple[str, ...]:
    """Names of the built-in scenes with the tag "hard"."""
    from crosscheck.scene_file import load_scene, scene_names

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


def _largest(rows: list[dict[str, Any]]) -> dict[str, Any] | None:
    return max(rows, key=lambda row: row["h_max"], default=None)


def _label(row: dict[str, Any] | None) -> str:
    return "" if row is None else f"{row['engine']} {row['method']}"


def _step(row: dict[str, Any] | None) -> float | None:
    return None if row is None else row["h_max"]


def _ratio(one: dict[str, Any] | None, other: dict[str, Any] | None) -> float | None:
    return None if one is None or other is None else one["h_max"] / other["h_max"]
