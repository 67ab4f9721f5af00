"""The common part of all studies: the request, the interface of a study, and the function that conducts one.

A study is a file with a class that has the interface `Study`, and a template for its page.
"""

from __future__ import annotations

import contextlib
import csv
import dataclasses
import io
import json
import shlex
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, Generic, Protocol, TypeVar

import msgspec

from crosscheck import adapters
from crosscheck.document import Origin, Part, set_words
from crosscheck.errors import ArgumentError, writing
from crosscheck.files import cell, digest, plain, put
from crosscheck.jobs.table import Session, Table
from crosscheck.report.standalone import page_of
from crosscheck.running import provenance
from crosscheck.scene.file import load_scene
from crosscheck.scene.model import Scene
from crosscheck.verification.job import check_methods, check_options
from crosscheck.verification.ladder import STAGE as LADDER
from crosscheck.verification.ladder import Ladder


class StudyMeta(Origin, frozen=True, kw_only=True, omit_defaults=True):
    """What the results of a study were made with."""

    command: str
    seconds: float  # total time of all its sessions
    time_limit: float  # s of stepping of one run
    repeats: int | None = None  # number of rounds, of which the medians are taken
    jobs: int | None = None  # number of worker processes


class StudyDocument(Part, frozen=True, kw_only=True):
    """The content of a study's JSON file. The page shows nothing else."""

    study: str
    meta: StudyMeta


def check(out: Path, study: str) -> None:
    """Create the folder. Raises `ArgumentError` unless it is new, empty, or holds an earlier run of this study."""
    with writing(out):
        if out.is_dir() and not (out / f"{study}.json").is_file() and any(
                not path.name.startswith(f".{study}-") for path in out.iterdir()):
            raise ArgumentError(f"--out {out}: this folder holds something else than a study {study}; choose an empty "
                                "folder or one that does not exist yet")
        out.mkdir(parents=True, exist_ok=True)
        put(out / ".writable", "")
        (out / ".writable").unlink()


def write_folder(out: Path, document: StudyDocument, rows: Sequence[object]) -> None:
    """Write <study>.json, <study>.csv with the rows, and index.html with the files that it needs.

    Numbers that are not finite become null in JSON and empty in CSV. Lists in a row are left out of the CSV file.
    """
    study, content = document.study, plain(document)
    put(out / f"{study}.json", json.dumps(content, indent=1, allow_nan=False))
    text = io.StringIO()
    table = [{key: cell(value) for key, value in row.items() if not isinstance(value, list)} for row in plain(rows)]
    if table:
        columns = sorted(table[0], key="scene".__ne__)  # the scene first
        writer = csv.DictWriter(text, columns, lineterminator="\n")
        writer.writeheader()
        writer.writerows(table)
    put(out / f"{study}.csv", text.getvalue())
    page_of(out, f"{study}.html.j2", document=content, meta=content["meta"])


Progress = Callable[[int, int | None, str], object]
"""Called with the number of finished pieces of work, the number of all or None, and the name of the current one."""

STAGE = "study"
"""Stage of the rows of studies in the table."""

SHARE = 0.1
"""Largest share of a study's time for writing its folder before the end."""


@dataclasses.dataclass(frozen=True)
class Ask:
    """What to measure. None means the default of the study. `time_limit` (s) is for the stepping of one run."""

    scenes: tuple[str, ...] | None = None
    engines: tuple[str, ...] | None = None
    methods: tuple[str, ...] | None = None
    time_limit: float = 1.0
    options: tuple[tuple[str, Any], ...] = dataclasses.field(default=(), kw_only=True)  # of engines that have them
    fresh: bool = dataclasses.field(default=True, kw_only=True)  # rows of other studies, with their times, do not count

    def command(self, study: str) -> str:
        """The shell command with these options. Options with their default values are left out."""
        words = ["crosscheck", "study", study, *(self.scenes or ())]
        for field in dataclasses.fields(self):
            value = getattr(self, field.name)
            if field.name == "scenes" or value == field.default:
                continue
            if field.name == "options":
                words += set_words(value)
                continue
            flag = {"engines": "engine", "methods": "method"}.get(field.name, field.name.replace("_", "-"))
            if isinstance(value, bool):
                words.append(f"--{flag}" if value else f"--no-{flag}")
                continue
            for each in value if isinstance(value, tuple) else (value,):
                words += [f"--{flag}", str(each)]
        return shlex.join(words)


Asked = TypeVar("Asked", bound=Ask)
Result = TypeVar("Result")
Doc = TypeVar("Doc", bound=StudyDocument)


@dataclasses.dataclass(frozen=True)
class Work(Generic[Asked, Result]):
    """A running study: what to measure, and functions to call while measuring.

    `keep` is called with all results so far after every piece of work.
    """

    ask: Asked
    engines: tuple[str, ...]
    scenes: Sequence[Scene]
    out: Path
    progress: Progress
    keep: Callable[[list[Result]], None]
    session: Session

    def key(self, scene: Scene, engine: str | None, task: object) -> str:
        """The key of a row: of one engine, or of all of the study."""
        return digest(provenance.code_digest((engine,) if engine else self.engines, []), scene.hash, task)

    def once(self, scene: Scene, engine: str | None, task: object, compute: Callable[[], Result]) -> Result:
        """The row of a piece of work, from the table if an earlier process of this study has put it there."""
        key = self.key(scene, engine, task)
        kept: Result | None = self.session.get(STAGE, key)
        return kept if kept is not None else self.session.put(STAGE, key, compute())


class Study(Protocol[Asked, Result, Doc]):
    """One question, answered by many runs."""

    name: str
    """The name of its files and of the template of its page."""

    row_type: type[Any]
    """The type of its rows in the table."""

    @property
    def scenes(self) -> tuple[str, ...]:
        """The default scenes."""

    def measure(self, work: Work[Asked, Result]) -> None:
        """Measure everything. A failed run is a result, too."""

    def document(self, ask: Asked, meta: StudyMeta, results: list[Result]) -> Doc:
        """The content of the page from the results so far."""

    def rows(self, document: Doc) -> Sequence[object]:
        """The lines of the CSV file: structs or dataclasses. Lists in them are only in the JSON file."""


def conduct(study: Study[Asked, Result, Doc], ask: Asked, out: Path, progress: Progress) -> Doc:
    """Conduct a study and return its document. The folder is written now and then, and at the end or an interrupt.

    A study that was killed goes on. Raises `ArgumentError` for wrong names, or a folder that must not be replaced.
    """
    provenance.need(ask.engines or ())
    engines = ask.engines or tuple(name for name in adapters.names() if not adapters.has_own_environment(name))
    check_names(engines, ask.methods)
    check_options(ask.options, engines)
    scenes = [load_scene(name) for name in ask.scenes or study.scenes]
    check(out, study.name)
    meta = msgspec.convert(provenance.describe(engines) | {
        "command": ask.command(study.name), "seconds": 0.0, "time_limit": ask.time_limit}, StudyMeta)
    document, stale, due = study.document(ask, meta, []), False, 0.0

    def write() -> None:
        nonlocal stale, due
        start = time.perf_counter()
        write_folder(out, document, study.rows(document))
        end = time.perf_counter()
        stale, due = False, end + (end - start) / SHARE

    def keep(results: list[Result]) -> None:
        nonlocal document, stale
        document = study.document(ask, msgspec.structs.replace(meta, seconds=session.seconds), results)
        stale = True
        if time.perf_counter() >= due:
            write()

    state = provenance.code_digest(engines, [study.name, dataclasses.asdict(ask), [scene.hash for scene in scenes]])
    with contextlib.closing(Table.opened()) as table, table.session(
            state, ask.command(study.name), {STAGE: study.row_type, LADDER: Ladder}, ask.fresh) as session:
        try:
            study.measure(Work(ask, engines, scenes, out, progress, keep, session))
        finally:
            if stale:
                write()
    return document


def check_names(engines: Sequence[str], methods: Sequence[str] | None) -> None:
    """Raise `ArgumentError` for an engine in its own environment, or a method that none of the engines has."""
    for name in engines:
        if adapters.has_own_environment(name):
            raise ArgumentError(f"engine: {name} runs in an environment of its own, so that its times compare with no "
                                f"other; name the installed version, {name.partition('==')[0]}")
    check_methods(methods, engines)
