"""The report: pages, figures and tables from the records. It computes nothing.

Every number on a page stands in a record; the pages only choose, round and draw. They open from disk: one classic
script of Plotly beside them, data in script files, nothing from a network.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from crosscheck.report import exports, pages


def write_report(document: dict[str, Any], folder: Path) -> None:
    """Write index.html, a page per scene, summary.md, results.csv, junit.xml and results.json into a new folder.

    Parameters
    ----------
    document : what `crosscheck.verify.Results.plain` returns
    folder : must not exist yet
    """
    import plotly.offline

    folder.mkdir(parents=True)
    write = _writer(folder)
    write("index.html", pages.index(document))
    for scene in document["scenes"]:
        if "failure" not in scene:
            write(pages.scene_file(scene), pages.scene(document, scene))
            write(pages.data_file(scene), pages.scene_data(document, scene))
    for name in ("report.css", "report.js"):
        write(name, (pages.HERE / "static" / name).read_text(encoding="utf-8"))
    write("plotly.min.js", plotly.offline.get_plotlyjs())
    write("summary.md", pages.summary(document))
    write("results.csv", exports.table(document))
    write("junit.xml", exports.junit(document))
    write("results.json", json.dumps(exports.without_curves(document), indent=1, allow_nan=False))


FILES = frozenset({"index.html", "report.css", "report.js", "plotly.min.js", "summary.md", "results.csv", "junit.xml",
                   "results.json"})
"""What every report holds, beside the pages and curves of its scenes."""


def is_file_of_report(path: Path) -> bool:
    """Whether a report writes a file of this name."""
    scene = path.name.startswith("scene-") and path.suffix in (".html", ".js")
    return path.is_file() and not path.is_symlink() and (path.name in FILES or scene)


def _writer(folder: Path) -> Any:
    def write(name: str, text: str) -> None:
        (folder / name).write_text(text, encoding="utf-8")
    return write
