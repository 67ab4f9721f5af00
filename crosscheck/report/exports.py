"""The results for other programs (CSV, JUnit XML) and for the scripts of the pages.

The data of the figures are script files next to the pages: runs.js for all pages, scene-*.js with the curves.
"""

from __future__ import annotations

import csv
import io
import json
import operator
import xml.etree.ElementTree as ElementTree
from collections.abc import Callable
from typing import Any

import msgspec

from crosscheck.document import EULER, LEVELS, QUANTITIES, Document, Record, Scene
from crosscheck.document.curves import RunCurves, SceneCurves
from crosscheck.document.part import Part
from crosscheck.files import cell, readable
from crosscheck.report import identity
from crosscheck.report.headline import answers, ending, number, sentence


def columns(document: Document) -> list[tuple[str, Callable[[Record], Any]]]:
    """The columns of results.csv: titles with units, and functions that read a record's value."""
    hashes = {scene.name: scene.hash for scene in document.scenes}
    titled: list[tuple[str, Callable[[Record], object]]] = [
        (name, operator.attrgetter(name))
        for name in ("scene", "engine", "version", "method", "form", "outcome", "status")]
    titled += [("step [s]", lambda r: r.step), ("rtol", lambda r: r.rtol),
                ("documented order", lambda r: r.documented_order),
                ("verdict", lambda r: r.word), ("duration [s]", lambda r: r.duration),
                ("share resolved", lambda r: r.share), ("not resolved since", lambda r: r.not_judged),
                ("observed order", lambda r: None if r.order is None else r.order.observed)]
    for name, unit in QUANTITIES.items():
        titled += [(f"{name} {field} [{unit}]", _of("errors", name, key))
                    for key, field in (("end", "end error"), ("max", "max error"), ("size", "size"))]
        titled.append((f"{name} resolution over size", _of("resolution", name)))
    titled += [("energy error over largest kinetic energy", lambda r: r.energy_error),
                ("energy error over |E(0)|", lambda r: r.energy_error_by_start),
                ("vertical momentum error [kg m^2/s]", lambda r: r.momentum_error)]
    for name in LEVELS:
        titled.append((f"constraint {name}, max over steps",
                      _of("levels", name, "max")))
    titled += [("orthogonality", lambda r: r.orthogonality), ("steps", lambda r: r.steps),
                ("wall time [s]", lambda r: r.wall_time), ("us per step", lambda r: r.us_per_step),
                ("worst finding", sentence), ("message", lambda r: r.message), ("code", lambda r: r.code),
                ("scene hash", lambda r: hashes.get(r.scene, "")), ("command", lambda r: r.command)]
    return titled


def _of(part: str, name: str, key: str = "") -> Callable[[Record], object]:
    """A function that reads `record.PART[NAME]`, or its KEY, or None if the record has no such entry."""
    def read(record: Record) -> object:
        entry = getattr(record, part).get(name)
        return getattr(entry, key, None) if key else entry
    return read


def table(document: Document) -> str:
    """CSV with one line per run: units in the header, full precision, and an empty field if there is no value."""
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    read = columns(document)
    writer.writerow([title for title, _ in read])
    for record in document.records:
        values = [value(record) for _, value in read]
        writer.writerow(["" if value is None else repr(value) if isinstance(value, float) else cell(value)
                         for value in values])
    return stream.getvalue()


def junit(document: Document) -> str:
    """JUnit XML: a suite per scene, a case per run. A known defect passes, and the case's output has its reason.

    An unresolved run is a failure of the type "unresolved"; what is unsupported is skipped.
    """
    root = ElementTree.Element("testsuites", name="crosscheck verify")
    for scene in document.scenes:
        records = [record for record in document.records if record.scene == scene.name]
        suite = ElementTree.SubElement(root, "testsuite", name=scene.name)
        if told := answers(records, document.meta.need):
            given = ElementTree.SubElement(suite, "properties")
            for answer in told:
                ElementTree.SubElement(given, "property", name="within tolerance", value=answer)
        for record in records:
            asked = answers([record], document.meta.need)
            case = ElementTree.SubElement(suite, "testcase", classname=f"crosscheck.{scene.name}",
                                          name=record.label, time=f"{record.wall_time or 0.0:.6f}")
            # Findings within their bounds are only in results.json.
            lines = [f"{finding.status}: {finding.kind} {number(finding.value)} {finding.unit}, bound "
                     f"{number(finding.bound)}; {finding.why}; {finding.detail}"
                     for finding in record.findings if finding.status in ("fail", "known")]
            if record.outcome in ("fail", "unresolved"):
                message = sentence(record) if record.outcome == "fail" else "; ".join(
                    [*asked, f"{record.word}: {sentence(record)}"])
                failure = ElementTree.SubElement(case, "failure", type=record.outcome, message=message)
                failure.text = "\n".join(line for line in lines if line.startswith("fail")) or None
            elif record.outcome in ("error", "unsupported"):
                ElementTree.SubElement(case, "error" if record.outcome == "error" else "skipped",
                                       message=record.message)
            output = ElementTree.SubElement(case, "system-out")
            output.text = "\n".join([*asked, f"outcome: {record.outcome}", *lines, *filter(None, (ending(record),)),
                                     f"repeat: {record.command}"])
        for attribute, tag in (("failures", "failure"), ("errors", "error"), ("skipped", "skipped")):
            suite.set(attribute, str(len(suite.findall(f"testcase/{tag}"))))
        suite.set("tests", str(len(records)))
    ElementTree.indent(root)
    return '<?xml version="1.0" encoding="utf-8"?>\n' + readable(ElementTree.tostring(root, encoding="unicode")) + "\n"


DIGITS = 5
"""Significant digits of numbers in runs.js. results.json has all digits."""

RUN_KEYS = ("scene", "engine", "version", "label", "form", "method", "outcome", "word", "step", "rtol",
            "documented_order", "own_environment", "share", "energy_error", "orthogonality")
RUNG_KEYS = ("step", "rtol", "errors")
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
    errors = {name: {"max": error.max} for name, error in record.errors.items()}
    levels = {name: {"max": level.max, "held": level.held} for name, level in record.levels.items()}
    ladder = [{key: getattr(rung, key) for key in RUNG_KEYS} for rung in record.ladder]
    timing = [{"step": rung.step, "rtol": rung.rtol, "wall_time": seconds, "error": rung.errors.get("position")}
              for seconds, rung in record.timing]
    return _compact({**{key: getattr(record, key) for key in RUN_KEYS}, "errors": errors,
                     "order": None if record.order is None else record.order.observed,
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


def _compact(value: object) -> str:
    return json.dumps(_short(value), separators=(",", ":"), allow_nan=False)


def _short(value: object) -> object:
    if isinstance(value, dict):
        return {key: _short(each) for key, each in value.items()}
    if isinstance(value, list | tuple):
        return [_short(each) for each in value]
    return float(f"{value:.{DIGITS}g}") if isinstance(value, float) else value
