"""The data of the figures as classic scripts beside the pages: runs.js for all pages, scene-*.js with the curves."""

from __future__ import annotations

import json
from typing import Any

import msgspec

from crosscheck.document import EULER, Document, Record, Scene
from crosscheck.document.curves import RunCurves, SceneCurves
from crosscheck.document.part import Part
from crosscheck.report import identity

DIGITS = 5
"""Significant digits of the figures in runs.js; results.json has them all."""

RUN_KEYS = ("scene", "engine", "version", "label", "form", "method", "outcome", "word", "step", "rtol",
            "documented_order", "practical", "own_environment", "judged_until", "energy_error", "orthogonality")
RUNG_KEYS = ("step", "rtol", "errors", "wall_time", "guide")
CURVES = "window.CROSSCHECK_CURVES = "


class SceneScript(Part, frozen=True):
    """What scene-*.js holds: the curves of a scene, and of its runs by their labels."""

    scene: SceneCurves
    runs: dict[str, RunCurves]


def runs_script(document: Document) -> str:
    """runs.js: scenes, the methods of every engine, and runs without curves, for every page that draws.

    The runs of a scene are one string of JSON: a browser skims a string, and parses only those of the scene it draws.
    """
    scenes: list[object] = []
    runs: list[str] = []
    methods: dict[str, dict[str, None]] = {}
    for record in document.records:
        methods.setdefault(record.engine, {}).setdefault(identity.base(record.label))
    for scene in document.scenes:
        if scene.failure:
            continue
        own = [record for record in document.records if record.scene == scene.name]
        drawn = [record.engine for record in own if record.ladder or record.errors.get("position")]
        scenes.append({"name": scene.name, "title": scene.title, "bodies": scene.bodies,
                       "engines": list(dict.fromkeys(drawn))})
        # In single quotes, so that JSON in it keeps its own.
        text = f"[{','.join(map(_run, own))}]".replace("\\", "\\\\").replace("'", "\\'")
        runs.append(f"{_compact(scene.name)}:'{text}'")
    looks = identity.looks({engine: list(own) for engine, own in methods.items()})
    known = _compact({engine: {label: [look.light, look.dark, look.dash, look.marker, look.sign]
                               for label, look in own.items()} for engine, own in looks.items()})
    return f"window.CROSSCHECK_RUNS = {{scenes:{_compact(scenes)},looks:{known},runs:{{{','.join(runs)}}}}};\n"


def _run(record: Record) -> str:
    """A run as JSON: ASCII without line breaks."""
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
    """scene-*.js: the curves of truth and of every run of one scene, packed as in `crosscheck.verification.curves`."""
    runs = {record.label: record.curves for record in document.records
            if record.scene == scene.name and record.curves.drawn}
    return f"{CURVES}{msgspec.json.encode(SceneScript(scene.curves, runs)).decode()};\n"


def read_curves(text: str) -> SceneScript:
    """The content of a script of `curves_script`; `ValueError` where it is none."""
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
