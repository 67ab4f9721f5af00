"""Pages in folders of their own (studies, sweeps, the history) with style and menus of the report, and the list of all.

Reports, studies, sweeps and the history in neighbouring folders know each other: the list of all pages, for menu and
search, is `sites.js`. Every folder has its own copy, so that it can be moved to another place.
"""

from __future__ import annotations

import contextlib
import html
import json
import os
import re
from pathlib import Path
from typing import Any

from crosscheck.errors import ArgumentError, missing, writing
from crosscheck.files import put
from crosscheck.report.pages import HERE, environment

STATIC = ("report.css", "theme.js", "site.js", "tables.js")
PLAYED = ("pens.js", "geometry.js", "playback.js")


def page_of(folder: Path, template: str, plots: bool = True, **content: Any) -> Path:
    """Write a page and the files that it needs into a folder, which is made if it is not there, and return its path.

    Existing files are replaced as a whole. `plots` says whether the page needs Plotly; a page with something `drawn` in
    it plays motions. Raises `ArgumentError` if a package is missing or the folder cannot be written.
    """
    with writing(folder):
        folder.mkdir(parents=True, exist_ok=True)
        try:
            text = environment().get_template(template).render(**content)
            if plots:
                import plotly.offline

                put(folder / "plotly.min.js", plotly.offline.get_plotlyjs())
        except ImportError as error:
            raise ArgumentError(f"--out {folder}: no page: {missing(error)}") from None
        for name in STATIC + (PLAYED if content.get("drawn") else ()):
            put(folder / name, (HERE / "static" / name).read_text(encoding="utf-8"))
        put(folder / FILE, ALONE)
        put(folder / "index.html", text)
        write_neighbours(folder)
    return folder / "index.html"


def one_file(path: Path, template: str, **content: object) -> None:
    """Write a page that contains all it needs. Missing folders are made, and an existing file is replaced."""
    own = {name: (HERE / "static" / name).read_text(encoding="utf-8") for name in STATIC}
    text = environment().get_template(template).render(
        inline={**own, FILE: script(path.parent)}, **content)
    path.parent.mkdir(parents=True, exist_ok=True)
    put(path, text)


FILE = "sites.js"
ALONE = "window.CROSSCHECK_SITES = [];\n"
"""The content of `FILE` if no other folders are known."""

KINDS = ("index", "scene", "study", "engine")
"""First words of the file names of pages, in the order of the menus."""

HEAD = 700
"""The title of a page is within this number of characters from its beginning."""


def write_neighbours(folder: Path) -> None:
    """Write `FILE` into this folder and its neighbours. A folder that cannot be written keeps its old file."""
    folders = _around(folder)
    for here in folders:
        with contextlib.suppress(OSError):
            put(here / FILE, _script(folders, here))


def script(folder: Path) -> str:
    """The content of a folder's `FILE`, for a page that contains it."""
    return _script(_around(folder), folder.absolute())


def _around(folder: Path) -> dict[Path, list[tuple[str, str, str]]]:
    """The neighbouring folders with pages, and their pages. The folder itself is among them if it has a first page."""
    # Nightly runs share a folder in which `latest` is a link. The neighbours are those of that folder.
    home = folder.absolute().parent
    home = home.parent if (home / "latest").is_symlink() else home
    folders = [path for pattern in ("*", "*/latest") for path in sorted(home.glob(pattern))
             if all((path / name).is_file() for name in ("index.html", "report.css", "theme.js"))]
    return {path: _pages(path) for path in folders if path.parent == home or path.is_symlink()}


def _script(folders: dict[Path, list[tuple[str, str, str]]], here: Path) -> str:
    entries = [{"name": (path.parent if path.is_symlink() else path).name, "here": path == here,
             "report": (path / "results.json").is_file(),
             "pages": [[kind, title, (Path(os.path.relpath(path, here)) / name).as_posix()]
                       for kind, title, name in pages]}
            for path, pages in folders.items()]
    return f"window.CROSSCHECK_SITES = {json.dumps(entries, separators=(',', ':'))};\n".replace("</", "<\\/")


def _pages(folder: Path) -> list[tuple[str, str, str]]:
    """Kind, title and file of every page of a folder. The first page comes first."""
    titled = []
    for path in folder.glob("*.html"):
        kind = path.stem.partition("-")[0]
        with contextlib.suppress(OSError, UnicodeDecodeError), path.open(encoding="utf-8") as page:
            title = re.search(r"<title>crosscheck: (.*?)</title>", page.read(HEAD))
            if title:
                titled.append((kind if kind in KINDS else "study", html.unescape(title[1]), path.name))
    return sorted(titled, key=lambda page: (KINDS.index(page[0]), page[1]))
