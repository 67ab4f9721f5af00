"""Tables of columns: CSV and its kin, which pandas reads, and arrays.

A table knows where a row stands, how its numbers are printed, and the unit that a cell or a preamble says.
"""

from __future__ import annotations

import csv
import functools
import itertools
import re
import warnings
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from crosscheck.errors import ArgumentError

Progress = Callable[[int, int | None, str], None]

SHOWN = 2000
"""Rows from which the printed digits are measured."""

STAMPS = (("sec", "nanosec"), ("secs", "nsecs"), ("sec", "nsec"))
"""Endings of columns of seconds and of nanoseconds."""

CHUNK = 250_000
"""Rows that are read at a time."""

MISSING = ("", "nan", "-nan", "NaN", "NA", "N/A", "n/a", "null", "NULL", "None")
"""Cells without a value."""


class Source:
    """A table of columns of numbers or texts."""

    angles = ""  # unit of angles, where the table says one for all

    def __init__(self, name: str, arrays: Mapping[str, np.ndarray]) -> None:
        self.name, self.arrays = name, dict(arrays)
        self.columns = list(self.arrays)
        self.units: dict[str, str] = {}  # of columns whose cells say it: "0.01 sec"
        self._join_stamps()

    def _join_stamps(self) -> None:
        """Of seconds and nanoseconds in two columns the first is the time, and the second is none of its own."""
        every = {*self.columns}
        self.parts = {name: rest for name in self.columns for a, b in STAMPS if name.endswith(a)
                      for rest in [name.removesuffix(a) + b] if rest in every and not name.endswith(b)}
        self.fields, rests = self.columns, {*self.parts.values()}  # all that the table has
        self.columns = [name for name in self.fields if name not in rests]

    def load(self, names: Sequence[str], progress: Progress | None) -> dict[str, np.ndarray]:
        """The columns as numbers, NaN where a cell has no value. Raises `ArgumentError` for text."""
        numbers = {}
        for name in [*names, *(self.parts[name] for name in names if name in self.parts)]:
            column = self.arrays[name]
            try:
                numbers[name] = np.asarray(column, dtype=float)
            except (TypeError, ValueError):
                at = next(k for k, value in enumerate(column) if not is_number(value))
                raise ArgumentError(f"{self.name}: {self.place(at)}, column {name!r}: {column[at]!r} is no number"
                                    ) from None
        return self._joined(numbers)

    def _joined(self, numbers: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
        """Seconds with their nanoseconds."""
        for name, rest in self.parts.items():
            if name in numbers:
                numbers[name] = numbers[name] + 1e-9 * numbers.pop(rest)
        return numbers

    def texts(self, name: str) -> Sequence[str]:
        """The first values as they are written: the shortest digits that give the same number."""
        shown = (np.asarray(self.arrays[name][:SHOWN], dtype=float) if name not in self.parts else
                 self.load([name], None)[name][:SHOWN])
        single = shown.astype(np.float32)
        return [str(value) for value in single] if np.array_equal(shown, single, equal_nan=True) else [
            repr(float(value)) for value in shown]

    def words(self, name: str) -> list[str]:
        """The different texts of a column, in the order in which they come; none if it holds numbers."""
        column = np.asarray(self.arrays[name])
        return [] if column.dtype.kind in "fiub" else list(dict.fromkeys(map(str, column)))

    def place(self, row: int) -> str:
        """Where a row of data stands, in words."""
        return f"row {row + 1}"


class Text(Source):
    """A text file: CSV, or columns below a preamble that ends with `endheader` (OpenSim's .sto and .mot)."""

    def __init__(self, path: Path) -> None:
        self.name, self.path = str(path), path
        try:
            with open(path, encoding="utf-8-sig") as stream:
                head = list(itertools.islice(stream, 400))
        except UnicodeDecodeError as error:
            raise ArgumentError(f"{path}: byte {error.start} is not UTF-8; save it as UTF-8 text") from None
        self.preamble = next((k + 1 for k, line in enumerate(head) if line.strip().lower() == "endheader"), 0)
        settings = dict(line.lower().split("=", 1) for line in head[:self.preamble] if "=" in line)
        self.angles = {"yes": "deg", "no": "rad"}.get(settings.get("indegrees", "").strip(), "")
        head = head[self.preamble:]
        marks = [line[:1] for line in head if line[:1] in "#%"]
        self.comment = marks[0] if marks else None
        lines = [(k, line.strip("\n")) for k, line in enumerate(head) if self._counts(line)]
        if not lines:
            raise ArgumentError(f"{path}: no rows; a header and rows of numbers are wanted")
        self.separator = _separator([line for _, line in lines])
        self.decimal = "," if self.separator == ";" and re.search(r"\d,\d", "".join(x for _, x in lines[1:9])) else "."
        first = self._cells(lines[0][1])
        comments = [self._cells(line[1:]) for line in head if line[:1] == self.comment]
        numbers = [is_number(cell) for cell in first]
        named = any(numbers) and comments and len(comments[-1]) == len(first)  # numpy.savetxt, rostopic
        echoed = None if named or len(lines) < 2 else _joint_state(first, self._cells(lines[1][1]))
        self.header = not all(numbers) and not named and not echoed
        self.columns = first if self.header else comments[-1] if named else echoed or [
            str(k) for k in range(len(first))]
        twice = next((name for name in self.columns if self.columns.count(name) > 1), None)
        if twice is not None:
            raise ArgumentError(f"{path}: two columns are called {twice!r}; give each a name of its own")
        rows = [self._cells(line) for _, line in lines[self.header:50]]
        if not rows:
            raise ArgumentError(f"{path}: a header, but no rows of numbers below it")
        most = max(map(len, rows))
        least = min(max((k for k, cell in enumerate(row, 1) if cell), default=0) for row in rows)
        if most < len(self.columns) or least > len(self.columns):
            raise ArgumentError(f"{path}: the header has {len(self.columns)} names and its rows have "
                                f"{most if most < len(self.columns) else least} numbers; "
                                f"name each column of numbers, and no other ({', '.join(self.columns[:20])})")
        self.skipped = self.preamble + (lines[0][0] + 1 if self.header else 0)
        self.units = {}
        for name, cells in zip(self.columns, zip(*(row for row in rows if len(row) == most), strict=True),
                               strict=False):
            found = {match[2] for cell in cells if (match := re.fullmatch(r"([-+.\d]\S*)\s+(\S.*)", cell))
                     and is_number(match[1].replace(self.decimal, "."))}
            if len(found) == 1 and self.separator != " ":
                self.units[name] = found.pop()
        self._join_stamps()

    def _counts(self, line: str) -> bool:
        """Whether a line is no comment and not blank."""
        return bool(line.strip()) and line[:1] != self.comment

    def _cells(self, line: str) -> list[str]:
        return [cell.strip() for cell in next(csv.reader([line.strip(" \r\n")], delimiter=self.separator,
                                                         skipinitialspace=True))]

    def _frames(self, names: Sequence[str], **options: object) -> Any:
        import pandas as pd

        kind = options.pop("kind")
        return pd.read_csv(self.path, sep=r"\s+" if self.separator == " " else self.separator, comment=self.comment,
                           header=None, names=self.fields, skiprows=self.skipped, decimal=self.decimal,
                           encoding="utf-8-sig", index_col=False, skipinitialspace=True, na_values=list(MISSING),
                           dtype={name: str if name in self.units else kind for name in names}, **options)

    def load(self, names: Sequence[str], progress: Progress | None) -> dict[str, np.ndarray]:
        """The columns as numbers, read in chunks; memory: 8 bytes a number, and one chunk at a time."""
        import pandas as pd

        names = [*names, *(self.parts[name] for name in names if name in self.parts)]
        parts: dict[str, list[np.ndarray]] = {name: [np.zeros(0)] for name in names}
        rows = 0
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("error", pd.errors.ParserWarning)  # a row of more cells than the header
                for frame in self._frames(names, kind=float, chunksize=CHUNK):
                    for name in names:
                        column = frame[name]
                        if name in self.units:
                            column = pd.to_numeric(self._bare(name, column))
                        parts[name].append(column.to_numpy(dtype=float))
                    rows += len(frame)
                    if progress is not None:
                        progress(rows, None, f"reading {self.path.name}")
        except (ValueError, pd.errors.ParserError, pd.errors.ParserWarning) as error:
            raise ArgumentError(f"{self.name}: {self._wrong(names, error)}") from None
        return self._joined({name: np.concatenate(chunks) for name, chunks in parts.items()})

    def _bare(self, name: str, cells: Any) -> Any:
        """Cells without the unit that each of them says."""
        return cells.str.removesuffix(self.units[name]).str.strip().str.replace(self.decimal, ".")

    def _wrong(self, names: Sequence[str], error: Exception) -> str:
        """The first cell that is no number, in words."""
        import pandas as pd

        def bad(cell: str) -> bool:
            return cell not in MISSING and not is_number(cell.replace(self.decimal, "."))

        try:
            for frame in self._frames(names, kind=str, chunksize=CHUNK, keep_default_na=False):
                for name in self.units:
                    frame[name] = self._bare(name, frame[name])
                wrong = frame[list(names)].fillna("").map(bad).to_numpy()
                if wrong.any():
                    at, column = np.argwhere(wrong)[0]
                    return (f"{self.place(int(frame.index[at]))}, column {names[column]!r}: "
                            f"{frame[names[column]].iloc[at]!r} is no number")
        except (ValueError, pd.errors.ParserError) as other:
            error = other
        return f"cannot be read as columns of numbers ({' '.join(str(error).split())})"

    @functools.cached_property
    def _head(self) -> Any:
        return self._frames(self.columns, kind=str, nrows=SHOWN)

    def texts(self, name: str) -> Sequence[str]:
        """The first values as they are printed."""
        if name in self.parts:
            return [repr(value) for value in self.load([name], None)[name][:SHOWN].tolist()]
        cells = self._head[name]
        return [str(cell).replace(self.decimal, ".") for cell in (
            self._bare(name, cells) if name in self.units else cells)]

    def words(self, name: str) -> list[str]:
        """The different texts of a column, in the order in which they come; none if it holds numbers."""
        if is_number(str(self._head[name].iloc[0])) or name in self.units:
            return []
        cells = (frame[name] for frame in self._frames([name], kind=str, usecols=[name], chunksize=CHUNK))
        return list(dict.fromkeys(str(cell) for part in cells for cell in part.unique()))

    def place(self, row: int) -> str:
        """The row of data, and its line in the file."""
        with open(self.path, encoding="utf-8-sig", errors="replace") as stream:
            numbers = (k for k, line in enumerate(stream, 1) if k > self.preamble and self._counts(line))
            return f"row {row + 1} (line {next(itertools.islice(numbers, row + self.header, None), '?')})"


def _joint_state(first: Sequence[str], second: Sequence[str]) -> list[str] | None:
    """The columns of joint states that `ros2 topic echo --csv` prints, without a header; None if rows are others.

    A row has seconds and nanoseconds, a frame, the names of n joints, and n positions, and as many rates and efforts
    where it has any.
    """
    texts = [k for k, cell in enumerate(first) if cell and not is_number(cell) and k > 2]
    n = len(texts)
    if (not n or texts != list(range(3, 3 + n)) or first[2:3 + n] != second[2:3 + n] or len(first) != len(second)
            or len(first) - 3 - n not in (n, 2 * n, 3 * n) or not all(map(is_number, (*first[:2], *first[3 + n:])))):
        return None
    return ["sec", "nanosec", "frame_id", *(f"{word}{k}" for word in ("name", "position", "velocity", "effort")
                                            for k in range(n))][:len(first)]


def _separator(lines: Sequence[str]) -> str:
    """The separator that the first lines have in common: the one that divides them into most cells."""
    counts = {mark: min(line.count(mark) for line in lines[:9]) for mark in (";", "\t", ",")}
    best = max(counts, key=lambda mark: counts[mark])
    return best if counts[best] else " " if len(lines[-1].split()) > 1 else ","


def is_number(value: Any) -> bool:
    """Whether a text or a value is a number."""
    try:
        float(value)
    except (TypeError, ValueError):
        return False
    return True
