"""The report as one PDF. An installed Chromium or Chrome prints it."""

from __future__ import annotations

import os
import shutil
import subprocess
import tempfile
from collections.abc import Sequence
from pathlib import Path

from crosscheck.errors import ArgumentError
from crosscheck.files import replacing

BROWSERS = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable", "chrome")
PATIENCE = 180.0
"""Most time (s) for one page. The largest pages take about 10 s."""


def find_browser() -> str:
    """Path of the program in CROSSCHECK_BROWSER, or else of an installed Chromium or Chrome.

    Raises `ArgumentError` if there is none.
    """
    named = os.environ.get("CROSSCHECK_BROWSER")
    if named:
        if shutil.which(named) is None:
            raise ArgumentError(f"CROSSCHECK_BROWSER={named}: no such program; name a Chromium or Chrome, or unset it")
        return str(shutil.which(named))
    for name in BROWSERS:
        program = shutil.which(name)
        if program:
            return program
    raise ArgumentError("--format pdf needs Chromium or Chrome to print the pages, and none is installed (Debian, "
                        "Ubuntu: apt-get install chromium); or name one in CROSSCHECK_BROWSER")


def write_pdf(pages: Sequence[Path], target: Path, browser: str | None = None, title: str = "crosscheck") -> Path:
    """Print pages from the disk into one PDF with a bookmark for each page, and return `target`.

    An existing file is replaced as a whole.
    """
    from pypdf import PdfReader, PdfWriter

    program = browser or find_browser()
    writer = PdfWriter()
    with tempfile.TemporaryDirectory() as folder:
        for page in pages:
            printed = Path(folder) / f"{page.stem}.pdf"
            _print(program, page, printed, Path(folder) / "profile")
            with printed.open("rb") as stream:
                writer.append(PdfReader(stream), outline_item=page.stem)
        writer.add_metadata({"/Title": title})
        with replacing(target) as aside, aside.open("wb") as stream:
            writer.write(stream)
    return target


def _print(program: str, page: Path, target: Path, profile: Path) -> None:
    # "?print=1" makes the page draw all its figures at once. The budget (ms) is time in the page, not wall time.
    root = hasattr(os, "geteuid") and os.geteuid() == 0  # Chromium does not run as root with its sandbox
    command = [program, "--headless", *(["--no-sandbox"] if root else []), "--disable-gpu", "--no-pdf-header-footer",
               f"--user-data-dir={profile}", "--virtual-time-budget=20000", f"--print-to-pdf={target}",
               f"{page.resolve().as_uri()}?print=1"]
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=PATIENCE)
    except subprocess.TimeoutExpired:
        raise ArgumentError(f"{page.name}: {program} did not print it within {PATIENCE:.0f} s") from None
    if done.returncode != 0 or not target.exists():
        said = (done.stderr.strip().splitlines() or ["it said nothing"])[-1]
        raise ArgumentError(f"{page.name}: {program} could not print it ({said})")
