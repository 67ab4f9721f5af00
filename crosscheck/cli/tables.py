"""Tables for terminals of any width, without cutting numbers.

If the columns do not fit, words are folded at spaces. If the numbers alone do not fit, the table is printed in blocks,
each of which begins with the columns that name its rows.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rich.console import Console

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
    if title:
        terminal.print(title, style="italic", markup=False)
    for block in _blocks(columns, rows, terminal.width):
        _print(terminal, [columns[k] for k in block], [[row[k] for k in block] for row in rows], styles)


def _blocks(columns: Sequence[Column], rows: Sequence[Sequence[str]], width: int) -> list[list[int]]:
    """Indices of the columns of every block."""
    keys = [k for k, column in enumerate(columns) if column.key]
    share = width // (SHARE * max(1, len(keys)))
    least = [_least(column, [row[k] for row in rows], share if column.key else 0) for k, column in enumerate(columns)]
    room = width - sum(least[k] + GAP for k in keys)
    blocks: list[list[int]] = [[]]
    used = 0
    for k in range(len(columns)):
        if k in keys:
            continue
        if blocks[-1] and used + least[k] + GAP > room:
            blocks.append([])
            used = 0
        blocks[-1].append(k)
        used += least[k] + GAP
    return [sorted([*keys, *block]) for block in blocks]


def _least(column: Column, cells: Sequence[str], share: int = 0) -> int:
    """The least width of a column: its longest number or word; for a key also up to `share`, if its cells need it."""
    longest = max((len(line) for cell in cells for line in cell.splitlines()), default=0)
    parts = [column.title, *cells] if column.words else [column.title]
    word = max((len(each) for part in parts for each in part.split()), default=0)
    return max(word, min(longest, share)) if column.words else max(word, longest)


def _widths(columns: Sequence[Column], rows: Sequence[Sequence[str]], width: int) -> list[int]:
    """Widths of the columns of a block: the least width of each; the rest goes to words, then to titles."""
    keys = max(1, sum(column.key for column in columns))
    cells = [[row[k] for row in rows] for k in range(len(columns))]
    widths = [_least(column, cells[k], width // (SHARE * keys) if column.key else 0)
             for k, column in enumerate(columns)]
    natural = [max(len(line) for cell in (column.title, *cells[k]) for line in (cell.splitlines() or [""]))
               for k, column in enumerate(columns)]
    left = width - sum(widths) - GAP * (len(columns) - 1)
    for kind in (True, False):
        wanting = sorted((k for k, column in enumerate(columns) if column.words is kind),
                         key=lambda k: natural[k] - widths[k])
        for place, k in enumerate(wanting):
            room = left // (len(wanting) - place) if kind else left
            more = max(0, min(natural[k] - widths[k], room))
            widths[k] += more
            left -= more
    return widths


def _print(terminal: Console, columns: Sequence[Column], rows: Sequence[Sequence[str]], styles: Sequence[str]) -> None:
    from rich.table import Table
    from rich.text import Text

    table = Table(box=None, pad_edge=False, padding=(0, GAP, 0, 0))
    for column, width in zip(columns, _widths(columns, rows, terminal.width), strict=True):
        table.add_column(Text(column.title), width=width, overflow="fold")
    for k, row in enumerate(rows):
        table.add_row(*(Text(cell) for cell in row), style=styles[k] if k < len(styles) else "")
    terminal.print(table)
