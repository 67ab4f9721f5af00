"""The folder of a report. It is replaced as a whole, and only if it holds nothing but a report."""

from __future__ import annotations

import json
import os
import re
import shutil
import tempfile
from pathlib import Path

from crosscheck.document import Document
from crosscheck.errors import ArgumentError
from crosscheck.report import is_file_of_report, sites, write_report


def check_out(out: Path) -> None:
    """Raise `ArgumentError` if a report must not or cannot be written to `out`. Called before anything runs.

    A folder is replaced only if it is empty, or if its results.json and file names show that it is a report.
    """
    try:
        if out.is_symlink() and not out.exists():
            raise ArgumentError(f"--out {out}: a link that leads nowhere; remove it or choose another folder")
        if out.exists() and not out.is_dir():
            raise ArgumentError(f"--out {out}: a file is there; choose a folder that does not exist yet")
        if out.is_dir() and any(out.iterdir()) and not _is_report(out):
            raise ArgumentError(f"--out {out}: this folder holds something else than a report of crosscheck, and would "
                                "be replaced; choose an empty folder or one that does not exist yet")
        place = next(folder for folder in out.resolve().parents if folder.exists())
        try:
            tempfile.TemporaryDirectory(dir=place).cleanup()  # permissions say too little: root may "write" in /proc
        except OSError:
            raise ArgumentError(f"--out {out}: {place} cannot be written; choose another folder") from None
    except OSError as error:
        raise ArgumentError(f"--out {out}: {error.strerror or error}") from None


def _is_report(folder: Path) -> bool:
    """Whether this folder holds a report that `write` made, and nothing else."""
    try:
        document = json.loads((folder / "results.json").read_text(encoding="utf-8"))
        ours = str(document["meta"]["command"]).startswith("crosscheck verify")
    except (OSError, ValueError, KeyError, TypeError):
        return False
    return ours and all(is_file_of_report(path) for path in folder.iterdir())


def write(document: Document, out: Path) -> Path:
    """Write the report into the folder `out`. An older report there is replaced when the new one is complete.

    Returns the path of the page to open, or of results.json if the extra `report` is missing. Raises `ArgumentError`
    as `check_out` does, and if writing fails.
    """
    import psutil

    check_out(out)
    out = out.resolve()
    aside = out.with_name(f".{out.name}.{os.getpid()}.new")
    old = out.with_name(f".{out.name}.{os.getpid()}.old")
    for leftover in out.parent.glob(f".{out.name}.*.*"):
        if (left := re.fullmatch(r"\.(\d+)\.(new|old)", leftover.name.removeprefix(f".{out.name}"))) and (
                not psutil.pid_exists(int(left[1]))):
            shutil.rmtree(leftover)  # its process was killed while it wrote
    try:
        write_report(document, aside)
        if out.exists():
            out.rename(old)
        try:
            aside.rename(out)
        except OSError:
            if old.exists():
                old.rename(out)
            raise
    except OSError as error:
        raise ArgumentError(f"--out {out}: the report cannot be written ({error.strerror or error})") from error
    finally:
        for leftover in (aside, old):
            if leftover.exists():
                shutil.rmtree(leftover)
    sites.tell(out)
    return out / ("index.html" if (out / "index.html").exists() else "results.json")
