"""Pages of studies, sweeps and the history, which have their own folders but the style and menus of the report."""

from __future__ import annotations

from pathlib import Path

from crosscheck.files import put
from crosscheck.report import sites

STATIC = ("report.css", "theme.js", "site.js", "tables.js")


def write_page(folder: Path, template: str, page: str = "index.html", plots: bool = True, **content: object) -> None:
    """Write a page and the files that it needs into a folder. Existing files are replaced as a whole.

    `plots` says whether the page needs Plotly.
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
    """Write a page that contains all it needs. Missing folders are made, and an existing file is replaced."""
    from crosscheck.report.pages import HERE, environment

    own = {name: (HERE / "static" / name).read_text(encoding="utf-8") for name in STATIC}
    text = environment().get_template(template).render(
        inline={**own, sites.FILE: sites.script(path.parent)}, **content)
    path.parent.mkdir(parents=True, exist_ok=True)
    put(path, text)
