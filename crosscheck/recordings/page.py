"""The page of a judged recording: what was found, errors over time, and the motion with truth as a ghost."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import msgspec
import numpy as np

from crosscheck.errors import ArgumentError, writing
from crosscheck.files import put
from crosscheck.recordings.comparing import Differences, part_of, restored
from crosscheck.report.standalone import page_of
from crosscheck.verification.curves import drawing, quaternions

Verdict = Any
"""A `crosscheck.recordings.Verdict`; not imported, because its module imports this one."""

POINTS = 1000
"""Points of a curve; of a longer recording the largest error between two of them."""

PICTURES = 400
"""Instants of the motion in the picture."""


def write_page(verdict: Verdict, folder: Path) -> Path:
    """Write the page, verdict.json and defects.csv into a folder. Returns the path of the page."""
    seen = verdict.differences
    if seen is None and verdict.predicted is None:
        raise ArgumentError("no page: nothing of the recording could be compared with truth")
    with writing(folder):
        folder.mkdir(parents=True, exist_ok=True)
        put(folder / "verdict.json", json.dumps(verdict.plain(), indent=1))
        if verdict.defects is not None:
            put(folder / "defects.csv", verdict.defects.to_csv(index=False))
    return page_of(folder, "recording.html.j2", verdict=verdict, scene=verdict.scene, curves=_predicted(
        verdict) if seen is None else _curves(verdict, seen), drawn=None if seen is None else _drawn(seen))


def write_all(verdicts: Mapping[str, Verdict], folder: Path) -> None:
    """Write the page of each recording, its errors over time as CSV, and one file of JUnit's XML.

    The page of a single recording is in the folder itself, those of several in folders of their names.
    """
    import pandas as pd

    suite = ElementTree.Element("testsuite", name="recordings", tests=str(len(verdicts)), failures=str(
        sum(verdict.outcome != "pass" for verdict in verdicts.values())))
    for k, (name, verdict) in enumerate(verdicts.items()):
        own = folder if len(verdicts) == 1 else folder / f"{k + 1}-{Path(name).stem}"
        case = ElementTree.SubElement(suite, "testcase", classname="recordings", name=name)
        if verdict.outcome != "pass":
            ElementTree.SubElement(case, "failure", type=verdict.outcome,
                                   message=f"{verdict.code}: {verdict.why}").text = str(verdict)
        if verdict.differences is not None or verdict.predicted is not None:
            write_page(verdict, own)
        if (seen := verdict.differences) is not None:
            errors = {group.label: sizes for group, sizes in zip(seen.recording.groups, seen.sizes, strict=True)}
            with writing(own):
                put(own / "errors.csv", pd.DataFrame({"t": seen.recording.t} | errors).to_csv(index=False))
    ElementTree.indent(suite)
    with writing(folder):
        folder.mkdir(parents=True, exist_ok=True)
        put(folder / "junit.xml", ElementTree.tostring(suite, encoding="unicode", xml_declaration=True) + "\n")


def _predicted(verdict: Verdict) -> dict[str, object]:
    """Errors of prediction of each joint, and u_val, over the horizon."""
    seen, names = verdict.predicted, [joint.name for joint in verdict.scene.joints]
    return {"errors": [{"x": list(seen.horizons), "y": _plain(values), "name": f"{word}{name}"}
                       for word, rows in (("", seen.error), ("u_val of ", seen.u))
                       for name, values in zip(names, rows, strict=True)], "defects": [], "series": {}}


def _curves(verdict: Verdict, diff: Differences) -> dict[str, object]:
    """Curves for Plotly: errors, defects, and recorded beside true values."""
    rows = np.unique(np.linspace(0, len(diff.t) - 1, POINTS).astype(int))
    t = _plain(diff.recording.t[rows])
    errors, values = [], {}
    for group, sizes, true in zip(diff.recording.groups, diff.sizes, diff.values, strict=True):
        largest = np.maximum.reduceat(sizes, rows)
        errors.append({"x": t, "y": _plain(np.where(largest > 0, largest, np.nan)), "name": group.label})
        if group.key != "attitude":
            values[group.label] = [
                {"x": t, "y": _plain(part[rows, k]), "name": f"{name}{' xyz'[1 + group.parts[k]] if many else ''}"}
                for name, part in (("recorded", group.values), ("truth", true))
                for many in [part.shape[1] > 1 and max(group.parts) < 3] for k in range(part.shape[1])]
    defects = [] if verdict.defects is None else [
        {"x": _plain(verdict.defects["t"].to_numpy()), "y": _plain(verdict.defects[key].to_numpy()), "mode": "markers",
         "marker": {"size": 4}, "name": key} for key in verdict.defects if key != "t"]
    return {"errors": errors, "defects": defects, "series": values}


def _drawn(diff: Differences) -> dict[str, Any] | None:
    """The motion, as recorded and as it is in truth; None where the recording does not determine it."""
    rows = np.unique(np.linspace(0, len(diff.t) - 1, PICTURES).astype(int))
    scene, piece = diff.outputs.scene, part_of(diff.recording, rows)
    exact = diff.truth.at(diff.t[rows])
    recorded = restored(scene, piece, exact)
    if recorded is None:
        return None
    actors = [{"label": label, "x": _plain(np.moveaxis(states.x, 0, -1)), "q": _plain(quaternions(states.R)),
               "dx": None if label == "truth" else _plain(np.moveaxis(states.x - exact.x, 0, -1))}
              for label, states in (("truth", exact), ("recording", recorded))]
    return {"t": _plain(diff.t[rows]), "drawing": msgspec.to_builtins(drawing(scene)), "actors": actors}


def _plain(values: np.ndarray) -> object:
    """Numbers with six digits, None for those that are not finite."""
    if values.ndim > 1:
        return [_plain(row) for row in values]
    return [float(f"{value:.6g}") if np.isfinite(value) else None for value in values]
