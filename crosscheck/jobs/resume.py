"""Resume a killed run: the next run with the same identity continues with the results that were kept."""

from __future__ import annotations

import contextlib
import dataclasses
import fcntl
import json
import os
import shutil
from collections.abc import Iterator, Mapping
from pathlib import Path

from crosscheck.errors import ArgumentError
from crosscheck.files import put
from crosscheck.jobs.journal import Journal


@dataclasses.dataclass(frozen=True)
class Kept:
    """The journal of a run, and the number of results of an earlier run that were in it at the start."""

    journal: Journal | None
    results: int


@contextlib.contextmanager
def resumable(out: Path, identity: str, types: Mapping[str, object]) -> Iterator[Kept]:
    """The journal of a run that will write `out`. It is kept in a hidden folder next to `out`.

    The folder is removed when the run ends or is interrupted by Ctrl-C. A kill or an error leaves it for the next run
    with the same `identity`. The journal is None while another run uses the folder.

    Raises
    ------
    ArgumentError
        The folder cannot be written.
    """
    folder = out.resolve().with_name(f".{out.resolve().name}.running")
    try:
        folder.mkdir(parents=True, exist_ok=True)
        lock = open(folder / "lock", "w", encoding="utf-8")  # noqa: SIM115 - held as long as the run
    except OSError as error:
        raise ArgumentError(f"--out {out}: {folder} cannot be written ({error.strerror or error})") from None
    with lock:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            yield Kept(None, 0)
            return
        journal = _opened(folder, identity, types)
        try:
            yield Kept(journal, len(journal))
        except KeyboardInterrupt:
            _end(journal, folder)
            raise
        except BaseException:
            journal.close()
            raise
        _end(journal, folder)


def _opened(folder: Path, identity: str, types: Mapping[str, object]) -> Journal:
    heading, journal = folder / "run.json", folder / "journal.jsonl"
    try:
        with contextlib.suppress(FileNotFoundError, ValueError, AttributeError):
            if json.loads(heading.read_text(encoding="utf-8")).get("identity") == identity:
                return Journal(journal, types)
        journal.unlink(missing_ok=True)
        put(heading, json.dumps({"identity": identity}))
    except OSError as error:
        raise ArgumentError(f"{folder}: {error.strerror or error}; mend this or remove the folder") from None
    return Journal(journal, types)


def _end(journal: Journal, folder: Path) -> None:
    journal.close()
    aside = folder.with_name(f"{folder.name}.{os.getpid()}")
    with contextlib.suppress(OSError):  # a folder that cannot be removed does no harm
        folder.rename(aside)
        shutil.rmtree(aside)
