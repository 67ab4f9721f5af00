"""The drift study of several scenes, written after every run."""

from __future__ import annotations

import dataclasses
import time
from pathlib import Path
from typing import Any

from crosscheck import adapters as all_engines
from crosscheck.running import provenance
from crosscheck.studies import results_folder
from crosscheck.studies.drift import Drift, chosen, measure
from crosscheck.studies.work_precision import Progress, check_names

STUDY = "drift"
SCENES = ("single_pendulum", "double_pendulum")


@dataclasses.dataclass(frozen=True)
class Request:
    """What to measure. `engines` and `methods` are names, None for all engines and `drift.METHODS`."""

    scenes: tuple[str, ...] = SCENES
    engines: tuple[str, ...] | None = None
    methods: tuple[str, ...] | None = None
    step: float = 2.0**-10  # s; an engine that adds up its steps misses sample times by one step where it rounds
    steps: int = 1_000_000
    time_limit: float = 120.0  # s of one run


def study(request: Request, out: Path, progress: Progress) -> dict[str, Any]:
    """Measure, write into `out` after every run, and return the document.

    Raises `ArgumentError` for wrong names or a folder that must not be replaced; a failed run is a row.
    """
    from crosscheck.scene.file import load_scene

    engines = request.engines or all_engines.names()
    check_names(engines, request.methods)
    scenes = [load_scene(name) for name in request.scenes]
    results_folder.check(out, STUDY)
    began = time.perf_counter()
    document: dict[str, Any] = {"study": STUDY, "meta": provenance.describe(engines), "runs": []}
    for scene in scenes:
        before = list(document["runs"])

        def keep(drifts: list[Drift], before: list[dict[str, Any]] = before) -> None:
            document["runs"] = [*before, *(dataclasses.asdict(drift) for drift in drifts)]
            document["meta"]["seconds"] = time.perf_counter() - began
            results_folder.write(out, document, document["runs"])

        measure(scene, chosen(scene, engines, request.methods), request.step, request.steps, request.time_limit,
                progress, keep)
    return document
