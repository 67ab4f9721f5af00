"""The terminal: its width, the progress of a job, complaints."""

from __future__ import annotations

import contextlib
import os
import re
import sys
import textwrap
import time
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING

from crosscheck.errors import FAILED

if TYPE_CHECKING:
    from rich.console import Console

Progress = Callable[[int, int | None, str], None]
"""Called with the number of tasks done, that of all tasks or None, and what is at work."""

UNIT = re.compile(r"(?<=[\d)]) (?=(?:m|rad|s|us|ms)\b)")
"""The space between a figure and its unit, which stay on one line."""

INTERRUPTED = 130
"""Exit code after Ctrl-C, as shells have it: 128 and the number of the signal."""

PAUSE = 10.0
"""s between two lines of progress where the error stream is no terminal."""


def console(width: int) -> Console:
    """The terminal. Where there is none, it has COLUMNS columns, or `width`: Rich would fold tables at 80."""
    from rich.console import Console

    piped = not sys.stdout.isatty() and not os.environ.get("COLUMNS")
    return Console(width=width if piped else None, highlight=False)


def say(text: str, indent: int = 0, hang: int = 4) -> None:
    """Print a sentence, in a terminal folded at spaces, so that no figure is cut at its edge.

    Elsewhere it stays one line, which can be searched, unless COLUMNS says how wide that is. What is to be copied, a
    path or a command, is no sentence.
    """
    line = " " * indent + text
    if sys.stdout.isatty() or os.environ.get("COLUMNS"):
        line = textwrap.fill(UNIT.sub("\N{NO-BREAK SPACE}", text), console(0).width, initial_indent=" " * indent,
                             subsequent_indent=" " * (indent + hang), break_long_words=False, break_on_hyphens=False
                             ).replace("\N{NO-BREAK SPACE}", " ")
    print(line)


@contextlib.contextmanager
def progress_bar() -> Iterator[Progress]:
    """Progress on the error stream: a bar in a terminal, elsewhere a plain line now and then."""
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


class _Lines:
    """Progress in plain lines, the first once `PAUSE` is over, so that a short job prints none; failures at once."""

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
    """One line on the error stream."""
    print(f"crosscheck: {' '.join(message.split())}", file=sys.stderr)


def interrupted() -> str:
    """What an interrupted command leaves behind, in one line."""
    goes_on = "the same command goes on from here"
    kept = {"nightly": goes_on, "sweep": goes_on, "study": "what was finished is in the folder of --out"}
    return f"interrupted; {kept.get(' '.join(sys.argv[1:2]), 'nothing was written')}"
