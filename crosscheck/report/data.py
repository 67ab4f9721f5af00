"""The data of the figures as script files next to the pages: runs.js for all pages, scene-*.js with the curves."""

from __future__ import annotations

import json
from typing import Any

import msgspec

from crosscheck.document import EULER, Document, Record, Scene
from crosscheck.document.curves import RunCurves, SceneCurves
from crosscheck.document.part import Part
from crosscheck.report import identity

DIGITS = 5
"""Significant digits of numbers in runs.js. results.json has all digits."""

RUN_KEYS = ("scene", "engine", "version", "label", "form", "method", "outcome", "word", "step", "rtol",
            "documented_order", "practical", "own_environment", "judged_until", "energy_error", "orthogonality")
RUNG_KEYS = ("step", "rtol", "errors", "wall_time", "guide")
CURVES = "window.CROSSCHECK_CURVES = "


class SceneScript(Part, frozen=True):
    """The content of scene-*.js: the curves of a scene, and those of its runs by label."""

    scene: SceneCurves
    runs: dict[str, RunCurves]


def runs_script(document: Document) -> str:
    """The text of runs.js: scenes, methods of every engine, and runs without curves, for all pages with figures.

    The runs of a scene are one string of JSON, so that a browser parses only those of the scene that it draws.
    """
    scenes: list[object] = []
    runs: list[str] = []
    for scene in document.scenes:
        if scene.failure:
            continue
        own = [record for record in document.records if record.scene == scene.name]
        drawn = [record.engine for record in own if record.ladder or record.errors.get("position")]
        scenes.append({"name": scene.name, "title": scene.title, "bodies": scene.bodies,
                       "engines": list(dict.fromkeys(drawn))})
        # In single quotes, so that the double quotes of JSON need no escape.
        text = f"[{','.join(map(_run, own))}]".replace("\\", "\\\\").replace("'", "\\'")
        runs.append(f"{_compact(scene.name)}:'{text}'")
    known = _compact(identity.for_scripts((record.engine, record.label) for record in document.records))
    return f"window.CROSSCHECK_RUNS = {{scenes:{_compact(scenes)},looks:{known},runs:{{{','.join(runs)}}}}};\n"


def _run(record: Record) -> str:
    """A run as JSON in ASCII without line breaks."""
    errors = {name: {"max": error.max, "judged": error.judged, "bound": error.bound}
              for name, error in record.errors.items()}
    orders = {name: order.observed for name, order in record.orders.items()}
    levels = {name: {"max": level.max, "held": level.held} for name, level in record.levels.items()}
    ladder = [{key: getattr(rung, key) for key in RUNG_KEYS} | {"end": rung.end.get("position")}
              for rung in record.ladder]
    timing = [{key: getattr(point, key) for key in ("step", "rtol", "wall_time", "error")} for point in record.timing]
    return _compact({**{key: getattr(record, key) for key in RUN_KEYS}, "errors": errors, "orders": orders,
                     "levels": levels, "ladder": ladder, "timing": timing,
                     "euler": record.engine == "lieeuler" and record.method in EULER})


def curves_script(document: Document, scene: Scene) -> str:
    """The text of scene-*.js: the packed curves of one scene's truth and runs (see `crosscheck.document.curves`)."""
    runs = {record.label: record.curves for record in document.records
            if record.scene == scene.name and record.curves.drawn}
    return f"{CURVES}{msgspec.json.encode(SceneScript(scene.curves, runs)).decode()};\n"


def read_curves(text: str) -> SceneScript:
    """The content of a script that `curves_script` made. Raises `ValueError` if it is another text."""
    if not text.startswith(CURVES):
        raise ValueError("not a script of curves")
    return msgspec.json.decode(text.removeprefix(CURVES).rstrip().removesuffix(";"), type=SceneScript)


def _compact(value: Any) -> str:
    return json.dumps(_short(value), separators=(",", ":"), allow_nan=False)


def _short(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _short(each) for key, each in value.items()}
    if isinstance(value, list | tuple):
        return [_short(each) for each in value]
    return float(f"{value:.{DIGITS}g}") if isinstance(value, float) else value
