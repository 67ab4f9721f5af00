"""The work-precision study of several scenes: measured one after the other, written after every round."""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from crosscheck import adapters as all_engines
from crosscheck.errors import Unsupported
from crosscheck.running import provenance
from crosscheck.studies import frontier, results_folder
from crosscheck.studies.work_precision import Progress, Rung, check_names, measure, reference, ways

STUDY = "work-precision"
SCENES = ("single_pendulum", "double_pendulum", "heavy_top")

FRONTIERS = {"end position": ("end_position", "m"), "end attitude": ("end_attitude", "rad"),
             "largest position": ("max_position", "m"), "largest attitude": ("max_attitude", "rad")}
"""Errors by which a frontier is drawn: column of a rung, and unit."""


@dataclasses.dataclass(frozen=True)
class Request:
    """What to measure. `engines` and `methods` are names, None for all; `time_limit` is in s of one run's stepping."""

    scenes: tuple[str, ...] = SCENES
    engines: tuple[str, ...] | None = None
    methods: tuple[str, ...] | None = None
    repeats: int = 5
    time_limit: float = 1.0
    bound: bool = True


def study(request: Request, out: Path, progress: Progress) -> dict[str, Any]:
    """Measure, write into `out` after every round, and return the document.

    Raises `ArgumentError` for wrong names or a folder that must not be replaced; a scene without truth and a run that
    fails are written into the document.
    """
    from crosscheck.scene.file import load_scene

    engines = request.engines or all_engines.names()
    check_names(engines, request.methods)
    scenes = [load_scene(name) for name in request.scenes]
    results_folder.check(out, STUDY)
    began = time.perf_counter()
    document: dict[str, Any] = {
        "study": STUDY, "meta": provenance.describe(engines) | {
            "repeats": request.repeats, "time_limit": request.time_limit, "seconds": 0.0}, "scenes": []}
    for scene in scenes:
        described: dict[str, Any] = {"name": scene.name, "description": scene.description, "duration": scene.duration,
                                     "failure": None, "truth": None, "rungs": [], "frontier": {}}
        document["scenes"].append(described)

        missing: list[Rung] = []

        def keep(rungs: Sequence[Rung], described: dict[str, Any] = described, missing: list[Rung] = missing) -> None:
            described["rungs"] = [rung.plain() for rung in (*rungs, *missing)]
            described["frontier"] = _frontiers(described["rungs"])
            document["meta"]["seconds"] = time.perf_counter() - began
            _write(document, out)

        try:
            progress(0, None, f"{scene.name}: truth")
            sampled, truth = reference(scene)
        except (Unsupported, _truth_error()) as error:
            described["failure"] = " ".join(str(error).split())
            _write(document, out)
            continue
        described |= {"duration": sampled.duration, "truth": {
            "source": truth.source, "disagreement": truth.disagreement, "amplification": truth.amplification}}
        chosen, refused = ways(sampled, engines, request.methods)
        missing += refused
        measure(sampled, chosen, truth, request.repeats, request.time_limit, progress, keep, request.bound)
    return document


def _truth_error() -> type[Exception]:
    from crosscheck.references import TruthError

    return TruthError


def _frontiers(rungs: list[dict[str, Any]]) -> dict[str, list[dict[str, Any]]]:
    return {name: [dataclasses.asdict(front) for front in frontier.frontier(frontier.curves(rungs, column))]
            for name, (column, _) in FRONTIERS.items()}


def _write(document: dict[str, Any], out: Path) -> None:
    rows = [rung for scene in document["scenes"] for rung in scene["rungs"]]
    results_folder.write(out, document, rows, "work-precision.html.j2")
