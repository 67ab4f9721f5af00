"""Tables of columns as other programs write them: CSV and its kin, NPZ, Parquet, data frames. pandas reads them.

A table knows where a row stands, how its numbers are printed, and the unit that a cell or a preamble says.
"""

from __future__ import annotations

import csv
import functools
import itertools
import os
import re
import warnings
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from crosscheck.errors import ArgumentError, errors_as, missing
from crosscheck.scene.model import Scene

Progress = Callable[[int, int | None, str], None]

SHOWN = 2000
"""Rows from which the printed digits are measured."""

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

    def load(self, names: Sequence[str], progress: Progress | None) -> dict[str, np.ndarray]:
        """The columns as numbers, NaN where a cell has no value. Raises `ArgumentError` for text."""
        numbers = {}
        for name in names:
            column = self.arrays[name]
            try:
                numbers[name] = np.asarray(column, dtype=float)
            except (TypeError, ValueError):
                at = next(k for k, value in enumerate(column) if not is_number(value))
                raise ArgumentError(f"{self.name}: {self.place(at)}, column {name!r}: {column[at]!r} is no number"
                                    ) from None
        return numbers

    def texts(self, name: str) -> Sequence[str]:
        """The first values as they are written: the shortest digits that give the same number."""
        shown = np.asarray(self.arrays[name][:SHOWN], dtype=float)
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
        self.header = not all(numbers) and not named
        self.columns = first if self.header else comments[-1] if named else [str(k) for k in range(len(first))]
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
                           header=None, names=self.columns, skiprows=self.skipped, decimal=self.decimal,
                           encoding="utf-8-sig", index_col=False, skipinitialspace=True, na_values=list(MISSING),
                           dtype={name: str if name in self.units else kind for name in names}, **options)

    def load(self, names: Sequence[str], progress: Progress | None) -> dict[str, np.ndarray]:
        """The columns as numbers, read in chunks; memory: 8 bytes a number, and one chunk at a time."""
        import pandas as pd

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
        return {name: np.concatenate(chunks) for name, chunks in parts.items()}

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


def opened(data: object, scene: Scene) -> Source:
    """The table of a path, data frame or mapping of arrays. Raises `ArgumentError` if it cannot be read."""
    if hasattr(data, "to_parquet"):
        return Source("data frame", _of_frame(data))
    if isinstance(data, Mapping):
        return Source("arrays", _of_arrays(data, scene, "arrays"))
    if not isinstance(data, str | os.PathLike):
        raise ArgumentError(f"recording: a path, a data frame or a mapping of arrays is wanted, not "
                            f"{type(data).__name__}")
    path = Path(data)

    def unreadable(error: Exception) -> ArgumentError:  # each library has errors of its own for a broken file
        if isinstance(error, ImportError):
            return ArgumentError(f"{path}: {missing(error)}")
        return ArgumentError(f"{path}: cannot be read ({error.strerror or error})" if isinstance(error, OSError) else
                             f"{path}: no {path.suffix[1:] or 'CSV'} file that can be read ({error})")

    with errors_as(unreadable):
        if path.is_dir() or not path.exists():
            raise ArgumentError(f"{path}: {'is a folder' if path.is_dir() else 'there is no such file'}; "
                                "name a .csv, .npz or .parquet file")
        if path.stat().st_size == 0:
            raise ArgumentError(f"{path}: the file is empty")
        if path.suffix == ".npz":
            with np.load(path, allow_pickle=False) as stored:
                return Source(str(path), _of_arrays(dict(stored), scene, str(path)))
        import pandas as pd

        return Source(str(path), _of_frame(pd.read_parquet(path))) if path.suffix == ".parquet" else Text(path)


def _of_frame(frame: Any) -> dict[str, np.ndarray]:
    if frame.index.name is not None:
        frame = frame.reset_index()
    return {str(name): frame[name].to_numpy() for name in frame}


def _of_arrays(arrays: Mapping[str, object], scene: Scene, where: str) -> dict[str, np.ndarray]:
    """Columns of arrays: (T,) as it is; (T, k) as name[0] ...; x, v, w (T, n, 3), q and R of all bodies by body."""
    columns: dict[str, np.ndarray] = {}
    for name, given in arrays.items():
        array = np.asarray(given)
        if array.ndim == 0:
            raise ArgumentError(f"{where}: {name!r} is a single number; one row a time is wanted")
        if array.ndim > 2 and array.shape[1] == scene.n:
            owned = {f"{body.name}.{name}": array[:, b] for b, body in enumerate(scene.bodies)}
        else:
            owned = {name: array}
        for title, part in owned.items():
            flat = part.reshape(len(part), -1)
            columns |= {title: part} if part.ndim == 1 else {f"{title}[{k}]": one for k, one in enumerate(flat.T)}
    counts = {len(column) for column in columns.values()}
    if len(counts) > 1:
        raise ArgumentError(f"{where}: the arrays have different lengths, {sorted(counts)}; one row a time is wanted")
    return columns
