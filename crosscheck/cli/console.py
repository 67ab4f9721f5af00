"""The terminal: its width, progress of a job, error messages."""

from __future__ import annotations

import contextlib
import os
import re
import sys
import textwrap
import time
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING

from crosscheck.errors import FAILED, brief

if TYPE_CHECKING:
    from rich.console import Console

Progress = Callable[[int, int | None, str], None]
"""Called with the number of finished tasks, the number of all tasks or None, and the label of a task."""

UNIT = re.compile(r"(?<=[\d)]) (?=(?:m|rad|s|us|ms)\b)")
"""The space between a number and its unit, at which no line is broken."""

INTERRUPTED = 130
"""Exit code after Ctrl-C, the same as in shells: 128 plus the number of the signal."""

PAUSE = 10.0
"""Time between two lines of progress if stderr is not a terminal, s."""


def console(width: int) -> Console:
    """The terminal. Without one the width is COLUMNS, or `width`, because Rich would fold tables at 80 columns."""
    from rich.console import Console

    piped = not sys.stdout.isatty() and not os.environ.get("COLUMNS")
    return Console(width=width if piped else None, highlight=False)


def counted(number: int, word: str, many: str | None = None) -> str:
    """A number with its word in the singular or the plural."""
    return f"{number} {word if number == 1 else many or word + 's'}"


def say(text: str, indent: int = 0, hang: int = 4) -> None:
    """Print a sentence, folded at spaces in a terminal, so that no number is cut.

    In a file or pipe it stays one line, for searching, unless COLUMNS gives a width. Do not use it for paths and
    commands, which users copy.
    """
    line = " " * indent + text
    if sys.stdout.isatty() or os.environ.get("COLUMNS"):
        line = textwrap.fill(UNIT.sub("\N{NO-BREAK SPACE}", text), console(0).width, initial_indent=" " * indent,
                             subsequent_indent=" " * (indent + hang), break_long_words=False, break_on_hyphens=False
                             ).replace("\N{NO-BREAK SPACE}", " ")
    print(line)


@contextlib.contextmanager
def progress_bar() -> Iterator[Progress]:
    """Progress on stderr: a bar in a terminal, otherwise a plain line every `PAUSE` seconds."""
    if not sys.stderr.isatty():
        yield _Lines()
        return
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

    columns = (BarColumn(bar_width=30), MofNCompleteColumn(), TimeElapsedColumn(), TextColumn("{task.description}"))
    with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task("starting", total=None)

        def shown(done: int, total: int | None, label: str) -> None:
            if label.startswith(FAILED):
                bar.console.print(label, markup=False, highlight=False)
            bar.update(task, completed=done, total=total, description=label)

        yield shown


@contextlib.contextmanager
def waiting(what: str) -> Iterator[None]:
    """Say in a terminal what is being done, and how long already, while nothing can be counted."""
    with progress_bar() as progress:
        progress(0, None, what)
        yield


class _Lines:
    """Progress in plain lines, the first after `PAUSE` seconds; failures are printed at once."""

    def __init__(self) -> None:
        self._began = self._printed = time.monotonic()

    def __call__(self, done: int, total: int | None, label: str) -> None:
        now = time.monotonic()
        if label.startswith(FAILED):
            print(label, file=sys.stderr, flush=True)
        elif now - self._printed >= PAUSE:
            self._printed = now
            of = "" if total is None else f" of {total}"
            print(f"{now - self._began:.0f} s: {done}{of} done, {label}", file=sys.stderr, flush=True)


def complain(message: str) -> None:
    """Print one line on stderr."""
    print(f"crosscheck: {' '.join(brief(message).split())}", file=sys.stderr)


def interrupted() -> str:
    """One line that says what an interrupted command has kept."""
    goes_on = "the same command goes on from here"
    kept = {"nightly": goes_on, "verify": goes_on, "sweep": goes_on,
            "study": "what was finished is in the folder of --out"}
    return f"interrupted; {kept.get(' '.join(sys.argv[1:2]), 'nothing was written')}"
