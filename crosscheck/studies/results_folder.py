"""The folder of a study: JSON, CSV and, where it has one, a page. Files are replaced as a whole, never in part."""

from __future__ import annotations

import contextlib
import csv
import io
import json
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from crosscheck.document import Origin, Part
from crosscheck.errors import ArgumentError
from crosscheck.files import cell, plain, put

if TYPE_CHECKING:
    from crosscheck.jobs.journal import Journal


class StudyMeta(Origin, frozen=True, kw_only=True, omit_defaults=True):
    """Where the figures of a study come from."""

    command: str
    seconds: float  # of all its sessions
    time_limit: float  # s of one run's stepping
    repeats: int | None = None  # rounds whose medians count
    jobs: int | None = None  # worker processes


class StudyDocument(Part, frozen=True, kw_only=True):
    """The JSON file of a study: all that its page shows."""

    study: str
    meta: StudyMeta


def check(out: Path, study: str) -> None:
    """Raise `ArgumentError` unless the folder is new, empty, or holds an earlier run of this study; create it.

    Parameters
    ----------
    out : the folder
    study : name of the study, which is that of its files
    """
    try:
        if out.is_dir() and not (out / f"{study}.json").is_file() and any(
                not path.name.startswith(f".{study}-") for path in out.iterdir()):
            raise ArgumentError(f"--out {out}: this folder holds something else than a study {study}; choose an empty "
                                "folder or one that does not exist yet")
        out.mkdir(parents=True, exist_ok=True)
        put(out / ".writable", "")
        (out / ".writable").unlink()
    except OSError as error:
        raise ArgumentError(f"--out {out}: {error.strerror or error}; choose another folder") from None


@contextlib.contextmanager
def journal(out: Path, study: str, state: str, types: Mapping[str, type]) -> Iterator[Journal]:
    """The journal of a study under way; one that a kill left is gone on with where its state was the same.

    Parameters
    ----------
    out, study : as in `check`
    state : digest of all that results depend on; what another state left is removed
    types : as of `Journal`
    """
    from crosscheck.jobs.journal import Journal

    path = out / f".{study}-{state[:16]}.journal"
    for other in out.glob(f".{study}-*.journal"):
        if other != path:
            other.unlink()
    kept = Journal(path, types)
    try:
        yield kept
    finally:
        kept.close()
    path.unlink()


def write(out: Path, document: StudyDocument, rows: Sequence[object]) -> None:
    """Write <study>.json, <study>.csv of its rows and index.html with what it needs beside it.

    Numbers that are not finite become null, and empty cells; lists of a row are left out of the CSV file.
    """
    from crosscheck.report.standalone import write_page

    study, content = document.study, plain(document)
    put(out / f"{study}.json", json.dumps(content, indent=1, allow_nan=False))
    text = io.StringIO()
    table = [{key: cell(value) for key, value in row.items() if not isinstance(value, list)} for row in plain(rows)]
    if table:
        writer = csv.DictWriter(text, list(table[0]), lineterminator="\n")
        writer.writeheader()
        writer.writerows(table)
    put(out / f"{study}.csv", text.getvalue())
    write_page(out, f"{study}.html.j2", document=content, meta=content["meta"])
