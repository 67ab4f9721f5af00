"""What all studies share: what is asked for, the shape of a study, and how one is conducted.

A study is a file with a class of this shape, and the template of its page.
"""

from __future__ import annotations

import dataclasses
import shlex
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, Protocol, TypeVar

from crosscheck.errors import ArgumentError
from crosscheck.scene.model import Scene
from crosscheck.studies import results_folder

Progress = Callable[[int, int | None, str], Any]
"""Called with the number of pieces done, that of all or None, and what is at work."""

SHARE = 0.1
"""Of the time of a study that may go into writing its folder on the way."""


@dataclasses.dataclass(frozen=True)
class Ask:
    """What to measure, None for the study's own choice. `time_limit` is in s of one run's stepping."""

    scenes: tuple[str, ...] | None = None
    engines: tuple[str, ...] | None = None
    methods: tuple[str, ...] | None = None
    time_limit: float = 1.0
    coordinate_map: str | None = dataclasses.field(default=None, kw_only=True)  # of engines that have this option

    def command(self, study: str) -> str:
        """The shell command that asks for this; what has its default is left out."""
        words = ["crosscheck", "study", study, *(self.scenes or ())]
        for field in dataclasses.fields(self):
            value = getattr(self, field.name)
            if field.name == "scenes" or value == field.default:
                continue
            flag = {"engines": "engine", "methods": "method", "coordinate_map": "map"}.get(
                field.name, field.name.replace("_", "-"))
            if isinstance(value, bool):
                words.append(f"--{flag}" if value else f"--no-{flag}")
                continue
            for each in value if isinstance(value, tuple) else (value,):
                words += [f"--{flag}", str(each)]
        return shlex.join(words)


Asked = TypeVar("Asked", bound=Ask, contravariant=True)
Cell = TypeVar("Cell")


class Study(Protocol[Asked, Cell]):
    """One question, answered by many runs."""

    name: str
    """Of its files and of the template of its page."""

    def cells(self, ask: Asked, engines: tuple[str, ...], scenes: Sequence[Scene]) -> list[Cell]:
        """What is measured piece by piece; raises `ArgumentError` before anything runs."""

    def scenes(self) -> tuple[str, ...]:
        """Those of a study that names none."""

    def measure(self, ask: Asked, cells: list[Cell], out: Path, progress: Progress,
                keep: Callable[[list[Any]], None]) -> None:
        """Measure all; `keep` is called after every piece of work with all results so far. A failed run is a result."""

    def document(self, ask: Asked, results: list[Any]) -> dict[str, Any]:
        """What the page shows, from the results so far; its "meta" joins what every study says of itself."""

    def table(self, document: dict[str, Any]) -> list[dict[str, Any]]:
        """The lines of the CSV file."""


def conduct(study: Study[Asked, Any], ask: Asked, out: Path, progress: Progress) -> dict[str, Any]:
    """Measure, write the folder on the way and at the end, also where the study is interrupted; return the document.

    Raises `ArgumentError` for wrong names or a folder that must not be replaced.
    """
    from crosscheck import adapters
    from crosscheck.running import provenance
    from crosscheck.scene.file import load_scene

    engines = ask.engines or adapters.names()
    check_names(engines, ask.methods)
    scenes = [load_scene(name) for name in ask.scenes or study.scenes()]
    results_folder.check(out, study.name)
    cells = study.cells(ask, engines, scenes)
    sheet = _Sheet(study, ask, out, {
        "study": study.name, "meta": provenance.describe(engines) | {"command": ask.command(study.name)}})
    try:
        study.measure(ask, cells, out, progress, sheet.keep)
    finally:
        sheet.write()
    return sheet.document


class _Sheet:
    """The document of a study under way, and when it was last written."""

    def __init__(self, study: Study[Any, Any], ask: Ask, out: Path, heading: dict[str, Any]) -> None:
        self._study, self._ask, self._out, self._heading = study, ask, out, heading
        self._began = time.perf_counter()
        self._next, self._stale = 0.0, False
        self.document = heading

    def keep(self, results: list[Any]) -> None:
        """Take in all results so far, and write them unless that would take too large a share of the time."""
        more = self._study.document(self._ask, results)
        meta = self._heading["meta"] | {"seconds": time.perf_counter() - self._began} | more.pop("meta", {})
        self.document, self._stale = self._heading | {"meta": meta} | more, True
        if time.perf_counter() >= self._next:
            self.write()

    def write(self) -> None:
        """Write the folder, unless it holds this already."""
        if not self._stale:
            return
        start = time.perf_counter()
        results_folder.write(self._out, self.document, self._study.table(self.document))
        end = time.perf_counter()
        self._next, self._stale = end + (end - start) / SHARE, False


def check_names(engines: Sequence[str], methods: Sequence[str] | None) -> None:
    """Raise `ArgumentError` for an engine whose times compare with no other, or a method that none of them has."""
    from crosscheck.adapters import has_own_environment
    from crosscheck.adapters import methods as methods_of
    from crosscheck.errors import unknown

    known: list[str] = []
    for name in engines:
        if has_own_environment(name):
            raise ArgumentError(f"engine: {name} runs in an environment of its own, so that its times compare with no "
                                f"other; name the installed version, {name.partition('==')[0]}")
        known += methods_of(name)
    for method in methods or ():
        if method not in known:
            raise ArgumentError(unknown("method", method, tuple(dict.fromkeys(known))))
