"""Pages with a folder of their own: studies, sweeps, the history. They share style, theme, menus and search."""

from __future__ import annotations

from pathlib import Path

from crosscheck.files import put
from crosscheck.report import sites

STATIC = ("report.css", "theme.js", "site.js", "tables.js")


def write_page(folder: Path, template: str, page: str = "index.html", plots: bool = True, **content: object) -> None:
    """Write a page and what it needs beside it into a folder; files are replaced as a whole.

    `plots`: whether it needs Plotly.
    """
    from crosscheck.report.pages import HERE, environment

    if plots:
        import plotly.offline

        put(folder / "plotly.min.js", plotly.offline.get_plotlyjs())
    for name in STATIC:
        put(folder / name, (HERE / "static" / name).read_text(encoding="utf-8"))
    put(folder / sites.FILE, sites.ALONE)
    put(folder / page, environment().get_template(template).render(**content))
    sites.tell(folder)


def one_file(path: Path, template: str, **content: object) -> None:
    """Write a page that carries all it needs. Folders and file are made or replaced."""
    from crosscheck.report.pages import HERE, environment

    own = {name: (HERE / "static" / name).read_text(encoding="utf-8") for name in STATIC}
    text = environment().get_template(template).render(
        inline={**own, sites.FILE: sites.script(path.parent)}, **content)
    path.parent.mkdir(parents=True, exist_ok=True)
    put(path, text)
