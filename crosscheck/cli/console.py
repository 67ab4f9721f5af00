"""The terminal: its width, progress of a job, error messages, and tables of any width, without cutting numbers.

If the columns of a table do not fit, words are folded at spaces. If the numbers alone do not fit, the table is printed
in blocks, each of which begins with the columns that name its rows.
"""

from __future__ import annotations

import contextlib
import dataclasses
import itertools
import os
import re
import sys
import textwrap
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from typing import TYPE_CHECKING

from crosscheck.errors import FAILED, brief, counted, counting_warnings

if TYPE_CHECKING:
    from rich.console import Console

Progress = Callable[[int, int | None, str], None]
"""Called with the number of finished tasks, the number of all tasks or None, and the label of a task."""

UNIT = re.compile(r"(?<=[\d)]) (?=(?:m|rad|s|us|ms)\b)")
"""The space between a number and its unit, at which no line is broken."""

INTERRUPTED = 130
"""Exit code after Ctrl-C, the same as in shells: 128 plus the number of the signal."""

PAUSE = 6.0
"""Time between two lines of progress, s. With what Python takes to start and a busy machine to wake, 10 s at most."""


def console(width: int) -> Console:
    """The terminal. Without one the width is COLUMNS, or `width`, because Rich would fold tables at 80 columns."""
    from rich.console import Console

    piped = not sys.stdout.isatty() and not os.environ.get("COLUMNS")
    return Console(width=width if piped else None, highlight=False)


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
def progress_bar(what: str = "starting") -> Iterator[Progress]:
    """Progress on stderr: a bar in a terminal, otherwise the lines of `at_work`."""
    if not sys.stderr.isatty():
        with at_work(what) as lines:
            yield lines
        return
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

    columns = (BarColumn(bar_width=30), MofNCompleteColumn(), TimeElapsedColumn(), TextColumn("{task.description}"))
    with _innermost(None), Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task(what, total=None)

        def update_bar(done: int, total: int | None, label: str) -> None:
            if label.startswith(FAILED):
                bar.console.print(label, markup=False, highlight=False)
            bar.update(task, completed=done, total=total, description=label)

        yield update_bar


@contextlib.contextmanager
def at_work(what: str) -> Iterator[Progress]:
    """A line on stderr every `PAUSE` seconds of what is being done, from a thread, however long one task takes.

    Of nested ones the outermost keeps the time, and the innermost is told of; none while a bar is shown.
    """
    lines, over = _Lines(what), threading.Event()
    thread = None if _working else threading.Thread(target=_speak, args=(over,), daemon=True)
    with _innermost(lines):
        if thread is not None:
            thread.start()
        try:
            yield lines
        finally:
            over.set()
            if thread is not None:
                thread.join()


_working: list[_Lines | None] = []
"""What is being done, the innermost last; None is a bar."""


@contextlib.contextmanager
def _innermost(lines: _Lines | None) -> Iterator[None]:
    _working.append(lines)
    try:
        yield
    finally:
        _working.pop()


def _speak(over: threading.Event) -> None:
    began = time.monotonic()
    while not over.wait(PAUSE):
        if (lines := _working[-1]) is not None:
            print(f"{time.monotonic() - began:.0f} s: {lines}", file=sys.stderr, flush=True)


class _Lines:
    """Progress as one line; failures are printed at once."""

    def __init__(self, what: str) -> None:
        self._done = 0
        self._total: int | None = None
        self._label = what

    def __call__(self, done: int, total: int | None, label: str) -> None:
        if label.startswith(FAILED):
            print(label, file=sys.stderr, flush=True)
        self._done, self._total, self._label = done, total, label

    def __str__(self) -> str:
        of = "" if self._total is None else f" of {self._total}"
        return f"{self._done}{of} done, {self._label}" if self._done or of else self._label


def annotate(outcome: str, title: str, message: str) -> None:
    """Print a line that GitHub shows beside the change: an error, or a warning of what is unresolved."""
    def plain(text: str) -> str:
        return text.replace("%", "%25").replace("\r", "%0D").replace("\n", "%0A")

    kind = "warning" if outcome == "unresolved" else "error"
    print(f"::{kind} title={plain(title).replace(':', '%3A').replace(',', '%2C')}::{plain(message)}")


def complain(message: str) -> None:
    """Print one line on stderr."""
    print(f"crosscheck: {' '.join(brief(message).split())}", file=sys.stderr)


@contextlib.contextmanager
def warnings_in_one_line() -> Iterator[None]:
    """Print at the end, in one line on stderr, how many warnings came and the three that came most often."""
    counts: dict[str, int] = {}
    try:
        with counting_warnings(counts):
            yield
    finally:
        most = sorted(counts, key=lambda text: -counts[text])
        warnings_listed = [f"{text}{f', {counts[text]} times' if counts[text] > 1 else ''}" for text in most[:3]]
        more = f"; and {counted(len(most) - 3, 'other place')}" if len(most) > 3 else ""
        if warnings_listed:
            complain(f"{counted(sum(counts.values()), 'warning')}: {'; '.join(warnings_listed)}{more}")


def interrupted() -> str:
    """One line that says what an interrupted command has kept."""
    asked = " ".join(sys.argv[1:3])
    return "interrupted; " + (
        "the same command goes on from here" if asked.startswith(("nightly", "verify", "study sweep")) else
        "what was finished is in the folder of --out" if asked.startswith("study") else "nothing was written")


GAP = 2
"""Spaces between two cells."""

SHARE = 3
"""The columns that name rows are folded if together they would take more than 1 / SHARE of the width."""


@dataclasses.dataclass(frozen=True)
class Column:
    """A column. `words` can be folded, numbers cannot; a `key` names its row and is in every block."""

    title: str
    words: bool = False
    key: bool = False


def words(title: str) -> Column:
    """A column of words."""
    return Column(title, words=True)


def key(title: str) -> Column:
    """A column of words that names the rows."""
    return Column(title, words=True, key=True)


def figures(*titles: str) -> list[Column]:
    """Columns of numbers."""
    return [Column(title) for title in titles]


def print_table(terminal: Console, columns: Sequence[Column], rows: Sequence[Sequence[str]], title: str = "",
                styles: Sequence[str] = ()) -> None:
    """Print a table in as many blocks as the terminal needs; `styles` are Rich styles of the rows."""
    from rich.table import Table
    from rich.text import Text

    if title:
        terminal.print(title, style="italic", markup=False)
    keys = [k for k, column in enumerate(columns) if column.key]
    share = terminal.width // (SHARE * max(1, len(keys)))
    least = [_least(column, [row[k] for row in rows], share) for k, column in enumerate(columns)]
    for block in _blocks(len(columns), keys, least, terminal.width):
        own, cells = [columns[k] for k in block], [[row[k] for k in block] for row in rows]
        table = Table(box=None, pad_edge=False, padding=(0, GAP, 0, 0))
        for column, width in zip(own, _widened([least[k] for k in block], own, cells, terminal.width), strict=True):
            table.add_column(Text(column.title), width=width, overflow="fold")
        for row, style in itertools.zip_longest(cells, styles, fillvalue=""):
            table.add_row(*map(Text, row), style=style)
        terminal.print(table)


def _least(column: Column, cells: Sequence[str], share: int) -> int:
    """The least width of a column: its longest number or word; for a key also up to `share`, if its cells need it."""
    longest = max((len(line) for cell in cells for line in cell.splitlines()), default=0)
    parts = [column.title, *cells] if column.words else [column.title]
    word = max((len(each) for part in parts for each in part.split()), default=0)
    return max(word, longest if not column.words else min(longest, share) if column.key else 0)


def _blocks(count: int, keys: Sequence[int], least: Sequence[int], width: int) -> list[list[int]]:
    """Indices of the columns of every block, of which each has all keys."""
    room = width - sum(least[k] + GAP for k in keys)
    blocks: list[list[int]] = [[]]
    for k in (k for k in range(count) if k not in keys):
        if blocks[-1] and sum(least[each] + GAP for each in (*blocks[-1], k)) > room:
            blocks.append([])
        blocks[-1].append(k)
    return [sorted([*keys, *block]) for block in blocks]


def _widened(least: Sequence[int], columns: Sequence[Column], rows: Sequence[Sequence[str]], width: int) -> list[int]:
    """Widths of the columns of a block: what is left goes in equal parts to words, then to titles."""
    natural = [max(len(line) for cell in (column.title, *(row[k] for row in rows))
                   for line in cell.splitlines() or [""]) for k, column in enumerate(columns)]
    widths, left = list(least), width - sum(least) - GAP * (len(columns) - 1)
    for kind in (True, False):
        wanting = sorted((k for k, column in enumerate(columns) if column.words is kind),
                         key=lambda k: natural[k] - least[k])
        for place, k in enumerate(wanting):
            more = max(0, min(natural[k] - least[k], left // (len(wanting) - place) if kind else left))
            widths[k] += more
            left -= more
    return widths
