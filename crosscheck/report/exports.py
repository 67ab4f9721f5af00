"""The results for other programs: CSV, Parquet, JUnit XML, and a badge."""

from __future__ import annotations

import csv
import io
import operator
import xml.etree.ElementTree as ElementTree
from collections.abc import Callable
from pathlib import Path
from typing import Any

from crosscheck.document import LEVELS, QUANTITIES, Document, Record
from crosscheck.files import cell, readable, replacing
from crosscheck.report.headline import number, sentence, state

LETTER = 7
"""Width of a letter in pixels. `textLength` stretches the text to it, whatever the font."""

COLOURS = {0: "#1a7f37", 1: "#b3261e"}
"""Colour by exit code. White letters on both have a contrast above 4.5."""


def columns(document: Document) -> list[tuple[str, Callable[[Record], Any]]]:
    """The columns of results.csv and results.parquet: titles with units, and functions that read a record's value."""
    hashes = {scene.name: scene.hash for scene in document.scenes}
    titled: list[tuple[str, Callable[[Record], Any]]] = [
        (name, operator.attrgetter(name))
        for name in ("scene", "engine", "version", "method", "form", "outcome", "status")]
    titled += [("step [s]", lambda r: r.step), ("rtol", lambda r: r.rtol),
                ("documented order", lambda r: r.documented_order),
                ("verdict", lambda r: r.word), ("duration [s]", lambda r: r.duration),
                ("judged until [s]", lambda r: r.judged_until)]
    for name, unit in QUANTITIES.items():
        titled += [(f"{name} {field} [{unit}]", _of("errors", name, key))
                    for key, field in (("end", "end error"), ("max", "max error"), ("judged", "judged error"),
                                         ("bound", "bound"))]
        titled.append((f"{name} order", _of("orders", name, "observed")))
    titled += [("energy error over largest kinetic energy", lambda r: r.energy_error),
                ("energy error over |E(0)|", lambda r: r.energy_error_by_start),
                ("vertical momentum error [kg m^2/s]", lambda r: r.momentum_error)]
    for name in LEVELS:
        titled.append((f"constraint {name}, max over steps",
                      _of("levels", name, "max")))
    titled += [("orthogonality", lambda r: r.orthogonality), ("steps", lambda r: r.steps),
                ("wall time [s]", lambda r: r.wall_time), ("us per step", lambda r: r.us_per_step),
                ("worst finding", sentence), ("message", lambda r: r.message),
                ("scene hash", lambda r: hashes.get(r.scene, "")), ("command", lambda r: r.command)]
    return titled


def _of(part: str, name: str, key: str) -> Callable[[Record], Any]:
    """A function that reads `record.PART[NAME].KEY`, or None if the record has no such entry."""
    return lambda record: getattr(getattr(record, part).get(name), key, None)


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


def write_parquet(document: Document, path: Path) -> None:
    """Write the same table as a Parquet file. An existing file is replaced as a whole."""
    import pandas

    read = columns(document)
    frame = pandas.DataFrame({title: [value(record) for record in document.records] for title, value in read})
    # pandas gives a column without any value the type object, which Parquet does not have.
    empty = [title for title in frame if frame[title].isna().all()]
    frame = frame.astype(dict.fromkeys(empty, "float64"))
    with replacing(path) as aside:
        frame.to_parquet(aside, index=False)


def junit(document: Document) -> str:
    """JUnit XML: a suite per scene, a case per run. A known defect passes, and the case's output has its reason."""
    root = ElementTree.Element("testsuites", name="crosscheck verify")
    for scene in document.scenes:
        records = [record for record in document.records if record.scene == scene.name]
        suite = ElementTree.SubElement(root, "testsuite", name=scene.name)
        for record in records:
            case = ElementTree.SubElement(suite, "testcase", classname=f"crosscheck.{scene.name}",
                                          name=record.label, time=f"{record.wall_time or 0.0:.6f}")
            # Findings within their bounds are only in results.json.
            lines = [f"{finding.status}: {finding.kind} {number(finding.value)} {finding.unit}, bound "
                     f"{number(finding.bound)}; {finding.why}; {finding.detail}"
                     for finding in record.findings if finding.status in ("fail", "known")]
            if record.outcome == "fail":
                failure = ElementTree.SubElement(case, "failure", message=sentence(record))
                failure.text = "\n".join(line for line in lines if line.startswith("fail"))
            elif record.outcome == "error":
                ElementTree.SubElement(case, "error", message=record.message)
            elif record.outcome in ("unsupported", "unjudged"):
                ElementTree.SubElement(case, "skipped", message=record.message)
            output = ElementTree.SubElement(case, "system-out")
            output.text = "\n".join([f"outcome: {record.outcome}", *lines, f"repeat: {record.command}"])
        for attribute, outcomes in (("failures", ("fail",)), ("errors", ("error",)),
                                    ("skipped", ("unsupported", "unjudged"))):
            suite.set(attribute, str(sum(record.outcome in outcomes for record in records)))
        suite.set("tests", str(len(records)))
    ElementTree.indent(root)
    return '<?xml version="1.0" encoding="utf-8"?>\n' + readable(ElementTree.tostring(root, encoding="unicode")) + "\n"


def badge(document: Document) -> str:
    """A small SVG for a README, with the numbers of runs that pass, pass partly and fail."""
    failing = sum(record.outcome in ("fail", "error") for record in document.records)
    passing = sum(state(record) in ("pass", "known") for record in document.records)
    part = sum(state(record) == "partly" for record in document.records)
    counts = {"pass": passing, "partly": part, "fail": failing}
    told = ", ".join(f"{count} {word}" for word, count in counts.items() if count) or "nothing ran"
    colour = COLOURS.get(document.exit_code, "#5f6368") if any(counts.values()) else "#5f6368"
    left, right = (LETTER * len(word) + 12 for word in ("crosscheck", told))
    return (f'<svg xmlns="http://www.w3.org/2000/svg" width="{left + right}" height="20" role="img" '
            f'aria-label="crosscheck: {told}"><title>crosscheck: {told}</title>'
            f'<rect width="{left}" height="20" fill="#444"/><rect x="{left}" width="{right}" height="20" '
            f'fill="{colour}"/><g fill="#fff" font-family="Verdana,sans-serif" font-size="11">'
            f'<text x="6" y="14" textLength="{left - 12}">crosscheck</text>'
            f'<text x="{left + 6}" y="14" textLength="{right - 12}">{told}</text></g></svg>\n')
