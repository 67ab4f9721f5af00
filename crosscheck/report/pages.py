"""The pages: which records go where. Texts and numbers come from the document as they are."""

from __future__ import annotations

import hashlib
import json
import re
from pathlib import Path
from typing import Any

from crosscheck.report.words import OUTCOMES, headline, number, partly, sentence, span
from crosscheck.studies.plan import EULER

HERE = Path(__file__).resolve().parent
PENDULUMS = {"single_pendulum": "Table 1", "double_pendulum": "Table 2"}
"""The two scenes of [P1], and the table of the paper that each of ours stands for."""
LEVELS = ("position", "velocity", "acceleration")
QUANTITIES = ("position", "attitude", "velocity", "angular velocity")


def _environment() -> Any:
    import jinja2

    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(HERE / "templates"), undefined=jinja2.StrictUndefined, trim_blocks=True,
        lstrip_blocks=True, keep_trailing_newline=True,
        autoescape=jinja2.select_autoescape(enabled_extensions=("html.j2",), default=False))
    environment.filters |= {"number": number, "sentence": sentence, "anchor": anchor, "span": span}
    environment.globals |= {"OUTCOMES": OUTCOMES, "LEVELS": LEVELS, "QUANTITIES": QUANTITIES}
    return environment


def slug(text: str) -> str:
    """Text as a part of a file name or an anchor."""
    return re.sub(r"[^A-Za-z0-9_]+", "-", text).strip("-") or "scene"


def anchor(record: dict[str, Any]) -> str:
    """The place of a run on the page of its scene."""
    return slug(f"run {record['label']}")


def stem(scene: dict[str, Any]) -> str:
    """File name of a scene's page without its ending, another one for every scene.

    Names that lose letters on the way, such as paths, get a piece of their checksum; so do those that a file system
    which ignores capitals could take for another's.
    """
    name = scene["name"]
    part = slug(Path(name).stem if name.endswith((".toml", ".json")) else name)
    if part == name == name.lower():
        return f"scene-{part}"
    return f"scene-{part}-{hashlib.sha256(name.encode('utf-8', 'surrogatepass')).hexdigest()[:8]}"


def scene_file(scene: dict[str, Any]) -> str:
    """File name of a scene's page."""
    return stem(scene) + ".html"


def data_file(scene: dict[str, Any]) -> str:
    """File name of a scene's curves."""
    return stem(scene) + ".js"


def index(document: dict[str, Any]) -> str:
    """The first page: verdict matrix, worst findings, what to trust."""
    return _environment().get_template("index.html.j2").render(_overview(document))


def summary(document: dict[str, Any]) -> str:
    """The same in Markdown, for a terminal or a pull request."""
    return _environment().get_template("summary.md.j2").render(_overview(document))


def _overview(document: dict[str, Any]) -> dict[str, Any]:
    records = document["records"]
    rows: dict[str, dict[str, Any]] = {}
    coarse: dict[tuple[str, float], list[dict[str, Any]]] = {}
    for record in records:
        if record["practical"]:
            coarse.setdefault((record["scene"], record["step"] or 0.0), []).append(record)
            continue
        rows.setdefault(record["label"], {})[record["scene"]] = record
    by_engine: dict[str, list[tuple[str, dict[str, Any]]]] = {}
    for label, cells in rows.items():
        by_engine.setdefault(next(iter(cells.values()))["engine"], []).append((label, cells))
    counts = {outcome: sum(record["outcome"] == outcome for record in records) for outcome in OUTCOMES}
    return {"document": document, "meta": document["meta"], "scenes": document["scenes"], "matrix": by_engine,
            "practical": [{"scene": name, "step": step, "records": found} for (name, step), found in coarse.items()],
            "headline": headline(document), "partly": partly(document),
            "counts": counts, "worst": worst_first(records), "scene_file": scene_file,
            "pages": {scene["name"]: scene_file(scene) for scene in document["scenes"] if "failure" not in scene}}


def worst_first(records: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Runs that are not fine, grouped by the reason of their worst finding: failures first, then known defects.

    Each group has the keys "outcome", "why" and "runs", pairs of (run, its worst finding).
    """
    bad = [(record, record["worst"]) for record in records if record["outcome"] in ("fail", "error", "known")]
    bad.sort(key=lambda pair: (pair[0]["outcome"] == "known", -_excess(pair[1])))
    groups: dict[tuple[str, str], dict[str, Any]] = {}
    for record, finding in bad:
        why = finding["detail"] or finding["why"]
        group = groups.setdefault((record["outcome"], why), {"outcome": record["outcome"], "why": why, "runs": []})
        group["runs"].append((record, finding))
    return list(groups.values())


def _excess(finding: dict[str, Any]) -> float:
    """How far beyond its bound, as a factor, only to sort by; what is not finite comes first."""
    if not finding or not finding["value"] or not finding["bound"]:
        return float("inf")
    ratio = finding["value"] / finding["bound"]
    return 1 / ratio if finding["kind"].startswith("order") else ratio


def scene(document: dict[str, Any], described: dict[str, Any]) -> str:
    """The page of one scene."""
    records = [record for record in document["records"] if record["scene"] == described["name"]]
    return _environment().get_template("scene.html.j2").render(
        document=document, meta=document["meta"], scene=described, records=records,
        paper_table=PENDULUMS.get(described["name"]), compared=paper_rows(records),
        data_file=data_file(described), scenes=document["scenes"], scene_file=scene_file)


def paper_rows(records: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """The runs of the paper's table: its eight methods in its order, then every run of the established engines."""
    euler = [record for method in EULER for record in records
             if record["engine"] == "lieeuler" and record["method"] == method and not record["practical"]]
    return euler + [record for record in records if record["engine"] != "lieeuler" and record["errors"]
                    and not record["practical"]]


def scene_data(document: dict[str, Any], described: dict[str, Any]) -> str:
    """The curves of one scene as a script that sets a global."""
    runs = []
    for record in document["records"]:
        if record["scene"] == described["name"] and (record["curves"] or record["ladder"]):
            kept = ("engine", "method", "form", "outcome", "step", "rtol", "documented_order", "practical", "curves",
                    "ladder", "timing")
            runs.append({"label": record["label"], "euler": record["engine"] == "lieeuler"
                         and record["method"] in EULER, **{key: record[key] for key in kept}})
    data = {"scene": {key: described[key] for key in ("name", "title", "bodies", "duration", "plan", "scales",
                                                      "curves")}, "runs": runs}
    text = json.dumps(data, separators=(",", ":"), allow_nan=False)
    return f"window.CROSSCHECK = {text};\n"
