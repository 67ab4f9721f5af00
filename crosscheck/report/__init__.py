"""The report: pages, figures and tables of the records.

It computes no results: every number on a page is in a record, and the pages only choose, round and draw. Pages open
from the disk without a network, because Plotly and the data are script files in the same folder. The folder is replaced
as a whole, and only if it holds nothing but a report.
"""

from __future__ import annotations

import importlib.util
import json
import os
import re
import shutil
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from msgspec.structs import replace

from crosscheck.document import Document, Scene
from crosscheck.document.curves import RunCurves, SceneCurves
from crosscheck.errors import ArgumentError
from crosscheck.files import put
from crosscheck.report import exports, pages, schema, standalone

STATIC = ("report.css", "theme.js", "site.js", "tables.js", "decision.js", "emphasis.js", "plots.js",
          "study.js", "scene.js", "pens.js", "geometry.js", "playback.js")


def write_report(document: Document, folder: Path) -> None:
    """Write pages, their data, summary.md, results.csv, results.json and junit.xml into a new folder.

    Without the extra `report`, only the files that need no template are written. `rewrite_pages` can write the missing
    files later.

    Parameters
    ----------
    document : the results with their curves
    folder : must not exist yet
    """
    folder.mkdir(parents=True)
    for name, content in _files(document) if installed("jinja2", "plotly") else _tables(document):
        put(folder / name, content)


def installed(*modules: str) -> bool:
    """Whether all these modules are there."""
    return all(importlib.util.find_spec(module) for module in modules)


def rewrite_pages(folder: Path) -> Path:
    """Write the pages of a report again, from its results.json and curves. Every file is replaced as a whole.

    Returns the first page. Raises `ArgumentError` if the folder holds no report.
    """
    document = load_report(folder)
    kept = {path.name for path in folder.iterdir()}
    for name, content in _files(document):
        if name != "results.json":
            put(folder / name, content)
            kept.discard(name)
    # Remove pages of an earlier version, which would have dead links.
    for name in kept:
        if name.endswith((".html", ".js")) and is_file_of_report(folder / name):
            (folder / name).unlink()
    standalone.write_neighbours(folder)
    return folder / "index.html"


def load_report(folder: Path) -> Document:
    """The document of the report in `folder`, with its curves.

    Raises `ArgumentError` if results.json is missing, is not a report or has another schema.
    """
    document = schema.read_document(folder / "results.json")
    scenes: list[Scene] = []
    runs: dict[str, dict[str, RunCurves]] = {}
    for scene in document.scenes:
        path = folder / pages.data_file(scene)
        curves = SceneCurves()
        if not scene.failure and path.exists():
            try:
                content = exports.read_curves(path.read_text(encoding="utf-8"))
            except (OSError, ValueError) as error:
                raise ArgumentError(f"{path}: the curves cannot be read ({error}); run `crosscheck verify` again"
                                    ) from None
            curves, runs[scene.name] = content.scene, content.runs
        scenes.append(replace(scene, curves=curves))
    records = [replace(record, curves=runs.get(record.scene, {}).get(record.label, RunCurves()))
               for record in document.records]
    return replace(document, scenes=scenes, records=records)


def _files(document: Document) -> Iterator[tuple[str, str]]:
    """Name and text of every file of a report."""
    import plotly.offline

    yield "index.html", pages.index(document)
    for scene in document.scenes:
        if not scene.failure:
            yield pages.scene_file(scene), pages.scene(document, scene)
    for engine in document.meta.engines:
        yield pages.engine_file(engine), pages.engine(document, engine)
    for key in pages.studies(document):
        yield pages.study_file(key), pages.study(document, key)
    for name in STATIC:
        yield name, (pages.HERE / "static" / name).read_text(encoding="utf-8")
    yield "plotly.min.js", plotly.offline.get_plotlyjs()
    yield standalone.FILE, standalone.ALONE
    yield "runs.js", exports.runs_script(document)
    yield "summary.md", pages.summary(document)
    yield from _tables(document)


def _tables(document: Document) -> Iterator[tuple[str, str]]:
    """Name and text of the files that need no template."""
    for scene in document.scenes:
        if not scene.failure:
            yield pages.data_file(scene), exports.curves_script(document, scene)
    yield "results.csv", exports.table(document)
    yield "junit.xml", exports.junit(document)
    yield "results.json", json.dumps(schema.plain(document), separators=(",", ":"), allow_nan=False)


FILES = frozenset({"index.html", "plotly.min.js", "runs.js", "summary.md", "results.csv", "junit.xml",
                   "results.json", standalone.FILE, *STATIC})
"""Files of a report, apart from the pages and curves of scenes, engines and studies, and the folder of figures."""

FIGURES, PAPER = "figures", "paper"


def is_file_of_report(path: Path) -> bool:
    """Whether this is a file of a report, or its folder of figures or of a paper."""
    if path.is_symlink():
        return False
    if path.is_dir():
        return (path.name == FIGURES and all(each.suffix == ".svg" for each in path.iterdir())) or (
            path.name == PAPER and (path / "paper.tex").is_file())
    page = path.name.startswith(("scene-", "engine-", "study-")) and path.suffix in (".html", ".js")
    return path.is_file() and (path.name in FILES or page)


def check_out(out: Path) -> None:
    """Raise `ArgumentError` if a report must not or cannot be written to `out`. Called before anything runs.

    A folder is replaced only if it is empty, or if its results.json and file names show that it is a report.
    """
    try:
        if out.is_symlink() and not out.exists():
            raise ArgumentError(f"--out {out}: a link that leads nowhere; remove it or choose another folder")
        if out.exists() and not out.is_dir():
            raise ArgumentError(f"--out {out}: a file is there; choose a folder that does not exist yet")
        if out.is_dir() and any(out.iterdir()) and not _is_report(out):
            raise ArgumentError(f"--out {out}: this folder holds something else than a report of crosscheck, and would "
                                "be replaced; choose an empty folder or one that does not exist yet")
        place = next(folder for folder in out.resolve().parents if folder.exists())
        try:
            tempfile.TemporaryDirectory(dir=place).cleanup()  # permissions say too little: root may "write" in /proc
        except OSError:
            raise ArgumentError(f"--out {out}: {place} cannot be written; choose another folder") from None
    except OSError as error:
        raise ArgumentError(f"--out {out}: {error.strerror or error}") from None


def _meta(folder: Path) -> dict[str, object]:
    """What the report that `write` made in this folder says of itself; empty if there is none."""
    try:
        meta: dict[str, Any] = json.loads((folder / "results.json").read_text(encoding="utf-8"))["meta"]
        return meta if str(meta["command"]).startswith("crosscheck verify") else {}
    except (OSError, ValueError, KeyError, TypeError):
        return {}


def is_complete(out: Path) -> bool:
    """Whether the folder holds a report of which nothing was left to run."""
    meta = _meta(out)
    return bool(meta) and not meta.get("left")


def _is_report(folder: Path) -> bool:
    """Whether this folder holds a report that `write` made, and nothing else."""
    return bool(_meta(folder)) and all(is_file_of_report(path) for path in folder.iterdir())


def write(document: Document, out: Path) -> Path:
    """Write the report into the folder `out`. An older report there is replaced when the new one is complete.

    Returns the path of the page to open, or of results.json if the extra `report` is missing. Raises `ArgumentError`
    as `check_out` does, and if writing fails.
    """
    import psutil

    check_out(out)
    out = out.resolve()
    aside = out.with_name(f".{out.name}.{os.getpid()}.new")
    old = out.with_name(f".{out.name}.{os.getpid()}.old")
    for leftover in out.parent.glob(f".{out.name}.*.*"):
        if (left := re.fullmatch(r"\.(\d+)\.(new|old)", leftover.name.removeprefix(f".{out.name}"))) and (
                not psutil.pid_exists(int(left[1]))):
            shutil.rmtree(leftover)  # its process was killed while it wrote
    try:
        write_report(document, aside)
        if out.exists():
            out.rename(old)
        try:
            aside.rename(out)
        except OSError:
            if old.exists():
                old.rename(out)
            raise
    except OSError as error:
        raise ArgumentError(f"--out {out}: the report cannot be written ({error.strerror or error})") from error
    finally:
        for leftover in (aside, old):
            if leftover.exists():
                shutil.rmtree(leftover)
    standalone.write_neighbours(out)
    return out / ("index.html" if (out / "index.html").exists() else "results.json")
