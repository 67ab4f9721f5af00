"""The code that an engine of the user consists of: its own file and all that it imports from the user's folders.

A version that an engine states says what its author believes. Stored results belong to the code that made them.
"""

from __future__ import annotations

import ast
import hashlib
import importlib.machinery
import os
import sys
import sysconfig
from collections.abc import Iterator
from pathlib import Path

NOT_THE_USERS = frozenset({"crosscheck", "lieeuler"})
"""Packages whose code counts elsewhere."""


def digest(home: str, file: str | None = None) -> str:
    """Eight hexadecimal digits of the code of an engine given as "path/file.py", or as a module found on the path.

    Imports count wherever they stand in a file, and those of what is imported. The standard library and installed
    packages do not. Not seen are modules that are imported by a name computed at run time, or from a folder that the
    engine itself puts on the path.

    Parameters
    ----------
    file : of a module that is found in another way, as by an editable install
    """
    whole = hashlib.sha256()
    for name, _, content in _all(home, file):
        whole.update(f"{name} {len(content)} ".encode() + content)
    return whole.hexdigest()[:8]


def sources(home: str) -> dict[str, bytes]:
    """The contents of these files by their paths in a folder from which the engine can be loaded; see `digest`."""
    return {str(Path(*name.split("."), path.name) if path.name == "__init__.py" else
                Path(*name.split(".")[:-1], path.name)): content for name, path, content in _all(home)}


def _all(home: str, file: str | None = None) -> list[tuple[str, Path, bytes]]:
    """Name, path and content of the files, by their names and contents."""
    folders = list(_folders())
    if home.endswith(".py"):
        folders.insert(0, str(Path(home).resolve().parent))
        first = [(Path(home).stem, Path(home).resolve())]
    else:
        first = list(_files(home, folders)) or ([(home, Path(file))] if file else [])
    waiting, read = first, dict[Path, tuple[str, bytes]]()
    while waiting:
        name, path = waiting.pop()
        if path not in read:
            content = path.read_bytes()
            read[path] = name, content
            waiting += [each for wanted in _imported(name, path, content) for each in _files(wanted, folders)]
    return sorted(((name, path, content) for path, (name, content) in read.items()),
                  key=lambda each: (each[0], each[2]))


def _folders() -> Iterator[str]:
    """The folders of the user on the path of modules, the current one among them.

    A virtual environment may see packages that are installed for the system or for another one.
    """
    installed = [Path(sysconfig.get_path(kind)).resolve() for kind in ("stdlib", "platstdlib", "purelib", "platlib")]
    for entry in dict.fromkeys(os.path.abspath(entry) for entry in (*sys.path, "")):
        if Path(entry).name not in ("site-packages", "dist-packages") and not any(
                Path(entry).resolve().is_relative_to(place) for place in installed):
            yield entry


def _files(name: str, folders: list[str]) -> Iterator[tuple[str, Path]]:
    """Names and files of a module and of the packages it is in, as far as they are in these folders."""
    if name.partition(".")[0] in NOT_THE_USERS | sys.stdlib_module_names:
        return
    path: list[str] | None = folders
    parts = name.split(".")
    for depth in range(1, len(parts) + 1):
        spec = None if path is None else importlib.machinery.PathFinder.find_spec(".".join(parts[:depth]), path)
        if spec is None:
            return
        if spec.origin and spec.has_location:
            yield spec.name, Path(spec.origin).resolve()
        locations = spec.submodule_search_locations
        path = None if locations is None else list(locations)


def _imported(name: str, path: Path, content: bytes) -> Iterator[str]:
    """Names that a file imports; "from a import b" may name a module b."""
    if path.suffix != ".py":
        return
    try:
        tree = ast.parse(content)
    except (SyntaxError, ValueError):  # its import says so
        return
    package = name if path.name == "__init__.py" else name.rpartition(".")[0]
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            above = package.rsplit(".", node.level - 1)[0] if node.level > 1 else package
            base = ".".join(part for part in (above if node.level else "", node.module or "") if part)
            yield from (f"{base}.{alias.name}" if base else alias.name for alias in node.names)
