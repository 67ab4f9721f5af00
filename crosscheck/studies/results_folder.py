"""The folder of a study: JSON, CSV and a page. Every file is replaced as a whole."""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Sequence
from pathlib import Path

from crosscheck.document import Origin, Part
from crosscheck.errors import ArgumentError
from crosscheck.files import cell, plain, put


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
    """Create the folder. Raises `ArgumentError` unless it is new, empty, or holds an earlier run of this study.

    Parameters
    ----------
    out : the folder
    study : name of the study and of its files
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


def write(out: Path, document: StudyDocument, rows: Sequence[object]) -> None:
    """Write <study>.json, <study>.csv with the rows, and index.html with the files that it needs.

    Numbers that are not finite become null in JSON and empty in CSV. Lists in a row are left out of the CSV file.
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
