"""The nightly run: it runs everything, compares with the last good run, and writes a report.

The folder of the nights contains a folder for every finished run, `latest` (a link to the newest) and a lock. A killed
run is a session in the table of rows, which the next one continues. `latest` always leads to a complete report.
"""

from __future__ import annotations

import contextlib
import dataclasses
import datetime
import os
import re
import secrets
import shutil
import textwrap
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from msgspec.structs import replace

from crosscheck.document import AS_PLANNED, Asked, Change, Document
from crosscheck.errors import ArgumentError, counted, writing
from crosscheck.history import runs as store
from crosscheck.history.changes import compare
from crosscheck.history.figures import SPEED
from crosscheck.jobs.drive import Stages
from crosscheck.jobs.table import Session, Table
from crosscheck.report import standalone, write_report
from crosscheck.report.headline import headline, sentence
from crosscheck.report.overview import worst_first
from crosscheck.verification import job
from crosscheck.verification.speed import measure_speed

if TYPE_CHECKING:
    from sqlalchemy import Engine

    from crosscheck.jobs.drive import Limits
    from crosscheck.verification.job import Progress

NAME = re.compile(r"\d{4}-\d\d-\d\dT\d\d-\d\d-\d\dZ-[0-9a-f]{4}")
"""Names of the folders of runs: the start time (UTC), and random digits in case two machines share a store."""

LATEST, LOCK = "latest", ".lock"
ASIDE = ".new-"
"""Prefix of the names of incomplete folders."""

CONFIRMATIONS = 2
"""How often a suspected change of speed is measured again. It is reported only if all measurements show it."""


@dataclasses.dataclass(frozen=True)
class Night:
    """A finished nightly run."""

    folder: Path
    exit_code: int
    summary: str
    changes: list[Change]


@dataclasses.dataclass(frozen=True)
class Wanted:
    """The options of a nightly run."""

    profile: str = "full"
    scenes: Sequence[str] | None = None
    engines: Sequence[str] | None = None
    jobs: int = 2
    limits: Limits | None = None
    asked: Asked = AS_PLANNED
    scheduler: str | None = None
    fresh: bool = True  # rows that other runs computed do not count

    @property
    def command(self) -> str:
        """The command line, without options that do not affect results."""
        return job.command("nightly", self.profile, self.scenes, self.engines, more=self.asked.words)


def nightly(out: Path, wanted: Wanted, where: str | Path | None = None, keep: int = 14,
            progress: Progress | None = None) -> Night:
    """Run, compare, store and report. If a run of the same code and options was killed, continue it.

    Parameters
    ----------
    out : folder of the nights; it is made if it does not exist
    wanted : profile, scenes, engines and other options
    where : the store, as in `history.runs.open_store`; None: CROSSCHECK_STORE, or history.sqlite next to `out`
    keep : number of finished runs whose reports are kept; the store keeps all runs
    progress : called as in `crosscheck.verification.job.verify`

    Raises
    ------
    ArgumentError
        An argument is wrong, the folder or store cannot be used, or another nightly run uses the same folder.
    """
    if keep < 1:
        raise ArgumentError(f"keep has to be at least 1, not {keep}")
    out = _folder(out)
    with _alone(out):
        history_store = store.open_store(where or os.environ.get("CROSSCHECK_STORE") or out.parent / "history.sqlite")
        try:
            return _night(out, wanted, history_store, keep, progress)
        finally:
            history_store.dispose()


def _night(out: Path, wanted: Wanted, history_store: Engine, keep: int, progress: Progress | None) -> Night:
    for leftover in [*out.glob(f"{ASIDE}*"), *out.glob(f".{LATEST}-*")]:
        _discard(leftover)
    ask = job.fingerprint(wanted.profile, wanted.scenes, wanted.engines, wanted.command, str(out))
    with contextlib.closing(Table.opened()) as table, table.session(
            ask, wanted.command, job.ROW_TYPES, wanted.fresh) as session:
        name = f"{session.started[:19].replace(':', '-')}Z-{session.token}"
        results = job.verify(wanted.profile, wanted.scenes, wanted.engines, wanted.jobs, progress, session,
                             wanted.limits, search=wanted.profile == "full", asked=wanted.asked,
                             scheduler=wanted.scheduler)
        results = replace(results, meta=replace(
            results.meta, command=wanted.command, started=session.started,
            time=session.started.replace("T", " ")[:16] + " UTC"))
        results, before = _compared(results, name, history_store, session, wanted.limits)
        document = replace(results, meta=replace(results.meta, seconds=session.seconds))
        changes = document.changes or []
        good = not any(change.bad for change in changes) and not any(scene.failure for scene in document.scenes)
        exit_code = document.exit_code if good else 1
        text = summary(document, name, before, good, out / LATEST / "index.html")
        # If the process is killed between these steps, the next start repeats them. Each step may run twice.
        store.save(history_store, store.run_from_document(name, document, good=good))
        folder = _publish(out, name, document, text)
        _point_latest(out, folder.name)
        standalone.write_neighbours(out / LATEST)
    _prune(out, keep)
    return Night(folder, exit_code, text, changes)


def _folder(out: Path) -> Path:
    with writing(out):
        out.mkdir(parents=True, exist_ok=True)
        strange = [path.name for path in out.iterdir() if not (
            path.name in (LATEST, LOCK) or path.name.startswith((ASIDE, f".{LATEST}-"))
            or NAME.fullmatch(path.name))]
    if strange:
        raise ArgumentError(f"--out {out}: this folder holds something else than nightly runs ({strange[0]}); choose "
                            "an empty folder or one that does not exist yet")
    return out.resolve()


@contextlib.contextmanager
def _alone(out: Path) -> Iterator[None]:
    """Hold the lock of the folder. The system releases it in any case when the process ends."""
    import fcntl

    with contextlib.ExitStack() as stack:
        with writing(out):
            file = stack.enter_context(open(out / LOCK, "w", encoding="utf-8"))
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise ArgumentError(f"--out {out}: another nightly run is at work in this folder; wait for it or choose "
                                "another folder") from None
        yield


def _compared(results: Document, name: str, history_store: Engine, session: Session, limits: Limits | None
              ) -> tuple[Document, store.StoredRun | None]:
    """The document with the changes since the last good run, and that run.

    Suspected changes of speed are measured again and kept only if all measurements show them. The document has the
    times of the last measurement.
    """
    run = store.run_from_document(name, results)
    before = store.baseline(history_store, run)
    if before is None:
        return results, None
    usual = store.usual(history_store, run, SPEED)
    changes = compare(before, run, usual)
    doubtful = {_cell_of(change) for change in changes if change.kind == "speed"}
    for attempt in range(1, CONFIRMATIONS + 1):
        if not doubtful:
            break
        results = _remeasured(results, doubtful, f"again {attempt}", session, limits)
        changes = compare(before, store.run_from_document(name, results), usual)
        doubtful &= {_cell_of(change) for change in changes if change.kind == "speed"}
    kept = [change for change in changes if change.kind != "speed" or _cell_of(change) in doubtful]
    return replace(results, changes=kept, meta=replace(results.meta, compared_with=before.name)), before


def _cell_of(change: Change) -> tuple[str, str, bool]:
    """Scene and run of a change, and whether it became slower: a slowdown is not confirmed by a faster repeat."""
    return change.scene, change.who, change.bad


def _remeasured(results: Document, doubtful: set[tuple[str, str, bool]], name: str, session: Session,
                    limits: Limits | None) -> Document:
    cells = {(scene, label) for scene, label, _ in doubtful}
    # A change of a whole engine has no scene.
    chosen = [index for index, record in enumerate(results.records)
              if (record.scene, record.label) in cells or ("", record.engine) in cells]
    stages = Stages(1, session, lambda label: None)
    timed, _ = measure_speed([results.records[index] for index in chosen], results.meta.profile, stages, limits,
                             name)
    records = list(results.records)
    for index, record in zip(chosen, timed, strict=True):
        records[index] = record
    return replace(job.document(results.meta, results.scenes, records), advice=results.advice)


def _publish(out: Path, name: str, document: Document, text: str) -> Path:
    """Write the report into a temporary folder, and rename that when all is on the disk."""
    folder, aside = out / name, out / f"{ASIDE}{name}"
    if folder.exists():  # complete: an earlier process of this run was killed after the renaming
        return folder
    try:
        write_report(document, aside)
        (aside / "summary.txt").write_text(text, encoding="utf-8")
        for path in [*aside.rglob("*"), aside]:
            _sync(path)
        aside.rename(folder)
        _sync(out)
    except OSError as error:
        raise ArgumentError(f"--out {out}: the report cannot be written ({error.strerror or error}); mend this and "
                            "start the run again, all results are kept") from error
    return folder


def _point_latest(out: Path, name: str) -> None:
    """Let `latest` lead to this run, without a moment in which there is no `latest`."""
    link = out / f".{LATEST}-{os.getpid()}"
    link.unlink(missing_ok=True)
    link.symlink_to(name, target_is_directory=True)
    os.replace(link, out / LATEST)
    _sync(out)


def _prune(out: Path, keep: int) -> None:
    """Keep the newest `keep` finished runs and the one of `latest`; remove the others."""
    for name in sorted(path.name for path in out.iterdir() if NAME.fullmatch(path.name))[:-keep]:
        if (out / LATEST).resolve().name != name:
            _discard(out / name)


def _discard(path: Path) -> None:
    """Remove a link, a file or a folder. A folder is renamed first, so that a kill leaves no incomplete folder."""
    if path.is_symlink() or path.is_file():
        path.unlink()
    elif path.is_dir():
        doomed = path.with_name(f"{ASIDE}{secrets.token_hex(4)}")
        path.rename(doomed)
        shutil.rmtree(doomed)


def _sync(path: Path) -> None:
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


MOST_LINES = 12
"""Most changes and failures that are listed. The report has all."""

LONGEST = 160
"""Most characters of an engine's error message."""


def summary(document: Document, name: str, before: store.StoredRun | None, good: bool, page: Path) -> str:
    """The summary in about twenty lines. The first line is the `headline`."""
    meta, changes = document.meta, document.changes or []
    findings = [change for change in changes if change.bad]
    notes = [change for change in changes if not change.bad]
    length = datetime.timedelta(seconds=round(meta.seconds))
    lines = [f"crosscheck nightly {meta.time}: {'good' if good else 'look at this'}, {document.outcome}. "
             f"{headline(document)}.",
             f"{counted(len(document.records), 'run', none='no')} of "
             f"{counted(len(document.scenes), 'scene', none='no')} on "
             + ", ".join(f"{engine} {version}" for engine, version in meta.engines.items())
             + f"; {length} on {meta.machine.cores} cores; commit {meta.commit or 'unknown'}",
             "first run, nothing to compare with" if before is None else
             f"compared with {before.name} (commit {before.environment.commit or 'unknown'})"]
    lines += _listed("Findings", grouped(findings)) + _listed("Worth knowing", grouped(notes))
    lines += _listed("Failed", _failures(document))
    return "\n".join([*lines, "", f"run {name}, report {page}", ""])


def _listed(title: str, lines: list[str]) -> list[str]:
    if not lines:
        return []
    more = [f"- and {len(lines) - MOST_LINES} more"] if len(lines) > MOST_LINES else []
    return ["", f"{title}:", *(f"- {line}" for line in lines[:MOST_LINES]), *more]


def grouped(changes: Sequence[Change]) -> list[str]:
    """One line per kind, engine and method with its scenes. Methods with the same text share a line."""
    groups: dict[tuple[str, str, str], list[Change]] = {}
    for change in changes:
        groups.setdefault((change.kind, change.engine, change.method), []).append(change)
    alike: dict[tuple[str, str, str], list[str]] = {}
    for (kind, engine, method), each in groups.items():
        scenes = list(dict.fromkeys(change.scene for change in each if change.scene))
        where = scenes[0] if len(scenes) == 1 else f"{len(scenes)} scenes, for one {scenes[0]}" if scenes else ""
        text = f"{' on ' if where else ''}{where}: {each[0].text}"
        alike.setdefault((kind, engine, text.replace(method, "…") if method else text), []).append(method)
    lines = []
    for (kind, engine, text), methods in alike.items():
        several = f", {len(methods)} methods, for one" if len(methods) > 1 else ""
        who = f"{engine}{several} {methods[0]}".strip()
        lines.append(f"{kind}{': ' if who else ''}{who}{text.replace('…', methods[0])}")
    return lines


def _failures(document: Document) -> list[str]:
    """One line per scene with missing or disputed truth, then one per engine and kind of failure, new ones first."""
    broken = [f"{scene.name}: {scene.failure or scene.no_truth}" for scene in document.scenes
              if scene.failure or scene.disputed]
    lost = {scene.name for scene in document.scenes if scene.failure}
    records = [record for record in document.records if record.outcome in ("fail", "error")
               and record.scene not in lost]
    for group in worst_first(records, document.changes):
        worst = group.runs[0][0]
        several = f"{group.why}, {len(group.runs)} runs on {counted(group.scenes, 'scene')}, worst "
        broken.append(f"{group.engine}: {several if len(group.runs) > 1 else ''}"
                      f"{worst.label} on {worst.scene}, {textwrap.shorten(sentence(worst), LONGEST)}")
    return broken
