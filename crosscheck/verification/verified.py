"""`crosscheck.verify`: the main job with its table of rows, and what it answers. The command is built on it."""

from __future__ import annotations

import contextlib
import dataclasses
import html
import math
import os
import threading
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import msgspec

from crosscheck import report
from crosscheck.document import AS_PLANNED, Asked, Document, Finding, renamed
from crosscheck.document.outcomes import Outcome
from crosscheck.errors import ArgumentError, needing
from crosscheck.files import cache_folder, digest, put
from crosscheck.jobs.drive import Limits
from crosscheck.judge.overrides import Overrides
from crosscheck.report import exports
from crosscheck.report.headline import ROW, headline, row, sentence
from crosscheck.scene.file import as_scene
from crosscheck.scene.model import Scene
from crosscheck.scene.models import import_model, is_model
from crosscheck.scene.models.writing import toml
from crosscheck.scene.paths import content_of
from crosscheck.verification import job

if TYPE_CHECKING:
    import pandas as pd

Given = Scene | str | os.PathLike[str]


@dataclasses.dataclass(frozen=True)
class Verification:
    """What `crosscheck.verify` answers. `document` is the content of results.json, with its curves."""

    document: Document
    page: Path | None = None  # the first page, where a folder was given

    @property
    def outcome(self) -> Outcome:
        """The worst of all runs: pass, known, fail, unresolved, unsupported or error."""
        return self.document.outcome

    @property
    def findings(self) -> list[tuple[str, str, Finding]]:
        """Scene, run and finding of every judged value that is not within its bound, in the order of the runs."""
        return [(record.scene, record.label, finding) for record in self.document.records
                for finding in record.findings if finding.status != "ok"]

    def frame(self) -> pd.DataFrame:
        """A row a run, with the columns of results.csv, units in their names. Raises `ArgumentError` without pandas.

        Among them are the errors by quantity, the observed order, the resolution, the share that is resolved, the cost
        and the command that repeats the run. The extra `data` has pandas.
        """
        with needing("frame"):
            import pandas as pd
        return pd.DataFrame({title: [value(record) for record in self.document.records]
                             for title, value in exports.columns(self.document)})

    def report(self, folder: str | os.PathLike[str]) -> Path:
        """Write the report into a folder, and return the page to open. Raises `ArgumentError` if it cannot be written.

        A folder that holds something else than a report is never replaced.
        """
        return report.write(self.document, Path(folder))

    def __str__(self) -> str:
        return "; ".join([*self.document.answers, f"{self.outcome}: {headline(self.document)}"])

    def _repr_html_(self) -> str:
        """The outcome and a table with a row a run, for a notebook."""
        rows = [(*row(record), "" if record.outcome == "pass" else sentence(record))
                for record in self.document.records]
        lines = [f"<tr>{''.join(f'<{tag}>{html.escape(each)}</{tag}>' for each in cells)}</tr>"
                 for tag, cells in (("th", (*ROW, "")), *(("td", cells) for cells in rows))]
        return f"<p>{html.escape(str(self))}</p><table>{''.join(lines)}</table>"


def verify(scene: Given | Sequence[Given] | None = None, engine: str | Sequence[str] | None = None,
           method: str | Sequence[str] | None = None, step: float | None = None, need: float = 1.0,
           budget: float | None = None, *, duration: float | None = None, profile: str = "default",
           asked: Asked = AS_PLANNED, jobs: int = 2, scheduler: str | None = None, limits: Limits | None = None,
           tolerances: Overrides = (), fresh: bool = False, out: Path | None = None,
           spoken: Sequence[tuple[str, str]] = (), command: str = "crosscheck.verify",
           progress: job.Progress | None = None, note: Callable[[str], object] = lambda text: None,
           on_budget: Callable[[Verification], object] = print) -> Verification:
    """Run methods and engines over scenes and judge every run, as `crosscheck verify` does.

    Results that were computed before, by this code and these versions, are taken from the table of rows, also after a
    kill; times are measured anew.

    Parameters
    ----------
    scene : one or more: a Scene, a built-in name, a path to a scene file or a model; None: those of the profile
    engine, method : one or more names; None: all
    step : s, of methods with a fixed step; None: one that suits the scene
    need : share of its time over which the motion of a run has to be judged for it to pass, up to 1
    budget : cheap runs come first, and after this time (s) `on_budget` is called, from a thread, with what has ended by
        then, if anything is left; the job goes on
    duration : s; None: the scene's
    profile : "default"; "smoke", the first second without timing; "full", every scene within a budget of steps
    asked : further options of main runs
    jobs : number of worker processes
    scheduler : a Dask scheduler, tcp://host:port, or another executor, module:factory
    limits : of one cell, from `crosscheck.verification.job.limits_of`
    tolerances : from `crosscheck.judge.overrides.read`
    fresh : compute everything anew
    out : folder of the report. Where none is complete yet, it fills as runs end
    spoken : of each scene its name in the answer and its words in commands; none: those of the scene and its file
    command : what the table of rows says of this session
    progress : called with the number of ended tasks, of all, and the name of the last
    note : called with what the user should know before anything runs: that a killed run is continued, or the table of
        rows cannot be used

    Raises
    ------
    SceneError, ArgumentError, EngineError
        A name or an argument is wrong. This is checked before anything runs.
    """
    from crosscheck.jobs.table import Table  # a database, which workers do not need

    for name, value in (("step", step), ("duration", duration)):
        if value is not None and not 0 < value < math.inf:
            raise ArgumentError(f"{name}: a positive number of seconds is wanted, not {value!r}")
    if out is not None:
        report.check_out(out)
    engines = None if engine is None else _several(engine)
    methods = None if method is None else _several(method)
    job.check_methods(methods, job.select_engines(engines))
    names: dict[str, tuple[str, str]] = {}
    scenes = None if scene is None else [_file(each, names) for each in _several(scene)]
    names |= zip(scenes or (), spoken, strict=False)
    asked = msgspec.structs.replace(asked, step=step, duration=duration)
    within = limits or job.limits_of()
    identity = job.fingerprint(profile, scenes, engines, dataclasses.astuple(within), tolerances, methods, asked.words)
    writing = threading.Lock()  # pages are written by two threads

    def named(document: Document) -> Document:
        return _named(document, names)

    def filled(document: Document) -> Path | None:
        with writing:
            return None if out is None else report.write(named(document), out)

    def going(done: int, total: int, label: str) -> None:
        for file, (name, _) in names.items():
            label = label.replace(Path(file).name, Path(name).name)
        if progress is not None:
            progress(done, total, label)

    with contextlib.closing(Table.opened()) as table, table.session(
            identity, command, job.ROW_TYPES, fresh) as session:
        if table.trouble:
            note(table.trouble)
        if session.continued:
            note(f"going on with a run that was killed: {session.left} results are kept")
        # An older report stays until this one is complete, or provisional.
        fills = None if out is None or (report.is_complete(out) and budget is None) else filled
        document = named(job.verify(
            profile, scenes, engines, jobs, going, session, within, tolerances, methods=methods, asked=asked,
            scheduler=scheduler, on_results=fills, need=need, budget=budget,
            on_budget=lambda part: on_budget(Verification(named(part), filled(part)))))
    return Verification(document, None if out is None else report.write(document, out))


def _several(given: Any) -> list[Any]:
    return list(given) if isinstance(given, list | tuple) else [given]


def _file(scene: Given, names: dict[str, tuple[str, str]]) -> str:
    """The name or file of a scene. That of a Scene or a model is written to the cache folder, with its name."""
    if not isinstance(scene, Scene):
        if not is_model(scene):
            as_scene(scene)
            return os.fspath(scene)
        scene = import_model(scene)
    content = content_of(scene)
    target = cache_folder() / "models" / f"{digest(content)[:12]}.toml"
    target.parent.mkdir(parents=True, exist_ok=True)
    put(target, toml(content))
    names[str(target)] = scene.name, str(target)
    return str(target)


def _named(document: Document, names: Mapping[str, tuple[str, str]]) -> Document:
    """With names that the user knows in place of files in the cache folder, and commands that run."""
    words = {file: word for file, (_, word) in names.items()}
    known = {file: name for file, (name, _) in names.items()}
    replace = msgspec.structs.replace

    def rows(given: Sequence[Any]) -> list[Any]:
        return [replace(renamed(replace(each, command=""), known), command=renamed(each.command, words))
                for each in given]

    bare: Document = renamed(replace(document, records=[], advice=None), known)
    return replace(bare, meta=renamed(document.meta, words), records=rows(document.records),
                   advice=None if document.advice is None else rows(document.advice))
