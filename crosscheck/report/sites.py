"""Reports, studies, sweeps and the history side by side: each folder knows the others' pages, for menus and search.

`sites.js` stands in every folder, so that a folder that is moved elsewhere lacks no file.
"""

from __future__ import annotations

import contextlib
import html
import json
import os
import re
from pathlib import Path

from crosscheck.files import put

FILE = "sites.js"
ALONE = "window.CROSSCHECK_SITES = [];\n"
"""What `FILE` holds where nothing is known of other folders."""

KINDS = ("index", "scene", "study", "engine")
"""Beginnings of the names of pages, in the order of the menus."""

HEAD = 700
"""Characters of a page in which its title stands."""


def tell(folder: Path) -> None:
    """Write `FILE` anew into this folder and those beside it. A folder that cannot be written keeps the one it has."""
    found = _around(folder)
    for here in found:
        with contextlib.suppress(OSError):
            put(here / FILE, _script(found, here))


def script(folder: Path) -> str:
    """What `FILE` of a folder holds, for a page that carries it itself."""
    return _script(_around(folder), folder.absolute())


def _around(folder: Path) -> dict[Path, list[tuple[str, str, str]]]:
    """The folders of pages around a folder and their pages, itself among them where it has a first page."""
    # A night stands beside other nights, one of which `latest` leads to; what is beside the nights counts.
    home = folder.absolute().parent
    home = home.parent if (home / "latest").is_symlink() else home
    found = [path for pattern in ("*", "*/latest") for path in sorted(home.glob(pattern))
             if all((path / name).is_file() for name in ("index.html", "report.css", "theme.js"))]
    return {path: _pages(path) for path in found if path.parent == home or path.is_symlink()}


def _script(found: dict[Path, list[tuple[str, str, str]]], here: Path) -> str:
    told = [{"name": (path.parent if path.is_symlink() else path).name, "here": path == here,
             "report": (path / "results.json").is_file(),
             "pages": [[kind, title, (Path(os.path.relpath(path, here)) / name).as_posix()]
                       for kind, title, name in pages]}
            for path, pages in found.items()]
    return f"window.CROSSCHECK_SITES = {json.dumps(told, separators=(',', ':'))};\n".replace("</", "<\\/")


def _pages(folder: Path) -> list[tuple[str, str, str]]:
    """Kind, title and file of every page of a folder, the first page first."""
    found = []
    for path in folder.glob("*.html"):
        kind = path.stem.partition("-")[0]
        with contextlib.suppress(OSError, UnicodeDecodeError), path.open(encoding="utf-8") as page:
            title = re.search(r"<title>crosscheck: (.*?)</title>", page.read(HEAD))
            if title:
                found.append((kind if kind in KINDS else "study", html.unescape(title[1]), path.name))
    return sorted(found, key=lambda page: (KINDS.index(page[0]), page[1]))
