"""Pages with a folder of their own: studies and trends. They share style, theme, search and navigation with reports."""

from __future__ import annotations

from pathlib import Path

from crosscheck.files import put

STATIC = ("report.css", "theme.js", "tables.js")


def write_page(folder: Path, template: str, page: str = "index.html", **content: object) -> None:
    """Write a page and what it needs beside it into a folder; files are replaced as a whole."""
    import plotly.offline

    from crosscheck.report.pages import HERE, environment

    put(folder / "plotly.min.js", plotly.offline.get_plotlyjs())
    for name in STATIC:
        put(folder / name, (HERE / "static" / name).read_text(encoding="utf-8"))
    text = environment().get_template(template).render(siblings=siblings(folder), **content)
    put(folder / page, text)


def siblings(folder: Path) -> dict[str, str]:
    """Names of the reports, studies and trends in the folders beside this one, and how they are reached."""
    here = folder.resolve()
    found = [path.parent for path in sorted(here.parent.glob("*/index.html")) if path.parent != here]
    return {path.name: f"../{path.name}/index.html" for path in found
            if (path / "results.json").is_file() or (path / "report.css").is_file()}
