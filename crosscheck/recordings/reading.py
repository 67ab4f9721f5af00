"""Files of recorded motions: CSV, NPZ, Parquet or data frames, with their columns named, scaled and checked.

pandas reads them. What a column means follows from its name ("upper.vx", "elbow.position [deg]"), or from a mapping.
Values become SI units; what a scene would have shown in their place is computed by `crosscheck.recordings.comparing`.
"""

from __future__ import annotations

import dataclasses
import math
import os
import re
import tomllib
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from decimal import Decimal, InvalidOperation
from pathlib import Path
from typing import Any

import numpy as np

from crosscheck.errors import ArgumentError, missing, unknown
from crosscheck.scene.joints import JOINT_TYPES
from crosscheck.scene.model import Scene, rotation_from_quaternion

Progress = Callable[[int, int | None, str], None]

LENGTH, ANGLE, TIME, FORCE, NUMBER = (1, 0, 0, 0), (0, 1, 0, 0), (0, 0, 1, 0), (0, 0, 0, 1), (0, 0, 0, 0)
UNITS: dict[str, tuple[tuple[int, ...], float]] = {
    "m": (LENGTH, 1.0), "mm": (LENGTH, 1e-3), "cm": (LENGTH, 1e-2), "km": (LENGTH, 1e3), "in": (LENGTH, 0.0254),
    "ft": (LENGTH, 0.3048), "rad": (ANGLE, 1.0), "mrad": (ANGLE, 1e-3), "deg": (ANGLE, math.pi / 180),
    "rev": (ANGLE, math.tau), "s": (TIME, 1.0), "ms": (TIME, 1e-3), "us": (TIME, 1e-6), "min": (TIME, 60.0),
    "h": (TIME, 3600.0), "N": (FORCE, 1.0), "kN": (FORCE, 1e3), "N m": ((1, 0, 0, 1), 1.0), "1": (NUMBER, 1.0),
    "g": ((1, 0, -2, 0), 9.80665), "rpm": ((0, 1, -1, 0), math.tau / 60)}
"""Units: the powers of length, angle, time and force, and the factor to SI."""

VECTORS = {"x": "position", "v": "velocity", "w": "angular_velocity"}
DIMENSIONS = {"position": LENGTH, "velocity": (1, 0, -1, 0), "angular_velocity": (0, 1, -1, 0), "attitude": NUMBER,
              "t": TIME}
GROUPS = {"position": ("position", 3), "x": ("position", 3), "velocity": ("velocity", 3), "v": ("velocity", 3),
          "angular_velocity": ("angular_velocity", 3), "w": ("angular_velocity", 3), "q": ("attitude", 4),
          "attitude": ("attitude", 4), "R": ("attitude", 9)}
"""What stands behind the name of a body for a whole group of columns: the quantity and the number of columns."""

ROWS = ("is", "unit", "scale", "offset", "columns", "order", "frame", "point", "wrap")
SHOWN = 2000
"""Rows from which the printed digits are measured."""

CHUNK = 250_000
"""Rows that are read at a time."""

DOUBLE = 15
"""Significant digits from which a printed number is a double."""

CROOKED = 0.05
"""How far a quaternion may be from norm one, or a matrix from orthogonal, to count as an attitude at all."""


@dataclasses.dataclass
class Group:
    """The recorded values of one quantity of one body, joint or sensor; attitudes are matrices."""

    key: str  # the quantity: "position" ... "joint_velocity", or the name of a sensor
    owner: str  # name of the body, joint or sensor
    parts: tuple[int, ...]  # which components
    values: np.ndarray  # (T, parts) in SI units, or (T, 3, 3)
    floor: np.ndarray  # (T,) what the printed digits leave open, in the norm
    frame: str = ""  # "world" or "body" where it is not the usual one
    point: np.ndarray | None = None  # (3,) body axes, where it is not the centre of mass
    wrap: bool = False
    crooked: float = 0.0  # largest distance of the recorded attitudes from rotations
    unit: str = ""  # SI
    angle: bool = False  # whether values are angles of joints, which go on over full turns

    @property
    def label(self) -> str:
        """In words."""
        return self.owner if self.key == self.owner else f"{self.key.replace('_', ' ')} of {self.owner}"


@dataclasses.dataclass
class Recording:
    """A recorded motion."""

    name: str
    t: np.ndarray  # (T,) s, scene time
    groups: list[Group]
    ignored: tuple[str, ...] = ()
    blur: float = 0.0  # s, what the printed digits of the times leave open

    @property
    def keys(self) -> list[str]:
        """The recorded quantities."""
        return list(dict.fromkeys(group.key for group in self.groups))


@dataclasses.dataclass(frozen=True)
class Meaning:
    """What a column or a group of columns is."""

    key: str
    owner: str
    parts: tuple[int, ...]
    form: str = ""  # of an attitude: "q" or "R"
    dimension: tuple[int, ...] | None = None  # None: any


@dataclasses.dataclass(frozen=True)
class Use:
    """Columns of the file, and what becomes of them."""

    columns: tuple[str, ...]
    meaning: Meaning
    scale: float = 1.0
    offset: float = 0.0  # in the unit of the column
    factor: float = 1.0  # of the unit
    frame: str = ""
    point: np.ndarray | None = None
    wrap: bool = False


def factor_of(unit: str, dimension: tuple[int, ...] | None, where: str) -> float:
    """The factor of a unit to SI. Raises `ArgumentError` if it is unknown or of another kind."""
    text = unit.strip().replace("°", "deg").replace("·", " ").replace("Nm", "N m")
    top, _, below = text.partition("/")
    match = re.fullmatch(r"(\w+?)\^?([12]?)", below.strip()) if below else None
    if top.strip() not in UNITS or (below and (match is None or match[1] not in UNITS)):
        raise ArgumentError(f"{where}: {unknown('unit', unit, [*UNITS, 'deg/s', 'mm/s', 'm/s^2'])}")
    powers, factor = UNITS[top.strip()]
    if match is not None:
        count = int(match[2] or 1)
        less, size = UNITS[match[1]]
        powers = tuple(a - count * b for a, b in zip(powers, less, strict=True))
        factor /= size**count
    if dimension is not None and powers != dimension:
        raise ArgumentError(f"{where}: the unit {unit!r} is of another kind; SI here is "
                            f"{next((name for name, known in _si().items() if known == dimension), 'a number')}")
    return factor


def _si() -> dict[str, tuple[int, ...]]:
    return {"m": LENGTH, "rad": ANGLE, "s": TIME, "m/s": (1, 0, -1, 0), "rad/s": (0, 1, -1, 0), "N": FORCE}


def meaning_of(scene: Scene, text: str) -> Meaning | None:
    """What a name stands for, or None if it is none of a recording."""
    if text in ("t", "time"):
        return Meaning("t", "", (0,), dimension=TIME)
    for sensor in scene.sensors:
        axes = "wxyz" if sensor.type == "attitude" else "xyz"
        if text == sensor.name:
            return Meaning(sensor.name, sensor.name, ())
        if text.startswith(f"{sensor.name}.") and text[len(sensor.name) + 1:] in tuple(axes):
            return Meaning(sensor.name, sensor.name, (axes.index(text[-1]),))
    for joint in scene.joints:
        match = re.fullmatch(re.escape(joint.name) + r"[. ](position|velocity)(?:[.\[]?(\d)\]?)?", text)
        words = JOINT_TYPES[joint.type].coordinates
        if match and words:
            k, rate = int(match[2] or 0), match[1] == "velocity"
            word = words[min(k, len(words) - 1)]
            base = NUMBER if word == "ball" and not rate else LENGTH if word.startswith("slide") else ANGLE
            count = (3 if rate else 4) if words == ("ball",) else len(words)
            parts = (k,) if match[2] or count == 1 else tuple(range(count))
            return Meaning(f"joint_{match[1]}", joint.name, parts,
                           dimension=tuple(a - rate * b for a, b in zip(base, TIME, strict=True)))
    for body in scene.bodies:
        if text.startswith((f"{body.name}.", f"{body.name} ")):
            return _of_body(body.name, text[len(body.name) + 1:])
    return None


def _of_body(name: str, part: str) -> Meaning | None:
    if match := re.fullmatch(r"(?:x_)?([xyz])", part):
        return Meaning("position", name, ("xyz".index(match[1]),), dimension=LENGTH)
    if match := re.fullmatch(r"([vw])_?([xyz])", part):
        key = VECTORS[match[1]]
        return Meaning(key, name, ("xyz".index(match[2]),), dimension=DIMENSIONS[key])
    if match := re.fullmatch(r"q_?([wxyz])", part):
        return Meaning("attitude", name, ("wxyz".index(match[1]),), "q", NUMBER)
    if match := re.fullmatch(r"R([012])([012])|R_([123])([123])", part):
        i, j = (int(match[1]), int(match[2])) if match[1] else (int(match[3]) - 1, int(match[4]) - 1)
        return Meaning("attitude", name, (3 * i + j,), "R", NUMBER)
    if part in GROUPS:
        key, count = GROUPS[part]
        return Meaning(key, name, tuple(range(count)), "" if key != "attitude" else "R" if count == 9 else "q",
                       DIMENSIONS[key])
    return None


def split_unit(header: str) -> tuple[str, str, bool]:
    """(name, unit or "", whether it says wrap) of a header such as "elbow.position [deg, wrap]"."""
    match = re.fullmatch(r"\s*(.*?)\s*(?:[\[(]([^\])]*)[\])])?\s*(wrap)?\s*", header)
    if match is None or (match[2] or "").strip().isdigit():
        return header.strip(), "", False
    unit, _, more = (match[2] or "").partition(",")
    return match[1], unit.strip(), "wrap" in (match[3] or "") or "wrap" in more


class Source:
    """A table of columns; subclasses know where a row stands in the file."""

    def __init__(self, name: str, arrays: Mapping[str, np.ndarray]) -> None:
        self.name, self.arrays = name, dict(arrays)
        self.columns = list(self.arrays)

    def load(self, names: Sequence[str], progress: Progress | None) -> dict[str, np.ndarray]:
        """The columns as numbers. Raises `ArgumentError` for text."""
        numbers = {}
        for name in names:
            column = self.arrays[name]
            try:
                numbers[name] = np.asarray(column, dtype=float)
            except (TypeError, ValueError):
                at = next(k for k, value in enumerate(column) if not _is_number(value))
                raise ArgumentError(f"{self.name}: {self.place(at)}, column {name!r}: {column[at]!r} is no number"
                                    ) from None
        return numbers

    def texts(self, name: str, values: np.ndarray) -> Sequence[str]:
        """Some values as they are written."""
        shown = values[:SHOWN]
        if np.array_equal(shown, shown.astype(np.float32)):  # the shortest digits that give the same number
            return [str(value) for value in shown.astype(np.float32)]
        return [repr(float(value)) for value in shown]

    def place(self, row: int) -> str:
        """Where a row of data stands, in words."""
        return f"row {row + 1}"


class Text(Source):
    """A CSV file."""

    def __init__(self, path: Path) -> None:
        self.name, self.path = str(path), path
        try:
            with open(path, encoding="utf-8-sig") as stream:
                head = [line for _, line in zip(range(400), stream, strict=False)]
        except UnicodeDecodeError as error:
            raise ArgumentError(f"{path}: byte {error.start} is not UTF-8; save it as UTF-8 text") from None
        marks = [line[:1] for line in head if line[:1] in "#%"]
        self.comment = marks[0] if marks else None
        lines = [line.rstrip("\n") for line in head if line.strip() and line[:1] != self.comment]
        if not lines:
            raise ArgumentError(f"{path}: no rows; a header and rows of numbers are wanted")
        self.separator = _separator(lines)
        self.decimal = "," if self.separator == ";" and re.search(r"\d,\d", "".join(lines[1:9])) else "."
        first = self._cells(lines[0])
        headless = all(_is_number(cell) for cell in first)
        comments = [line[1:].strip() for line in head if line[:1] == self.comment]
        if headless and comments and len(self._cells(comments[-1])) == len(first):
            self.columns = self._cells(comments[-1])  # as numpy.savetxt writes it
        else:
            self.columns = [str(k) for k in range(len(first))] if headless else first
        twice = next((name for name in self.columns if self.columns.count(name) > 1), None)
        if twice is not None:
            raise ArgumentError(f"{path}: two columns are called {twice!r}; give each a name of its own")
        self.header = not headless
        if len(lines) < 2 and self.header:
            raise ArgumentError(f"{path}: a header, but no rows of numbers below it")

    def _cells(self, line: str) -> list[str]:
        import csv

        if self.separator == " ":
            return line.split()
        return [cell.strip() for cell in next(csv.reader([line], delimiter=self.separator))]

    def _frames(self, **options: Any) -> Any:
        import pandas as pd

        return pd.read_csv(self.path, sep=r"\s+" if self.separator == " " else self.separator, comment=self.comment,
                           header=None, names=self.columns, skiprows=self._skipped() if self.header else None,
                           decimal=self.decimal, encoding="utf-8-sig", index_col=False,
                           skipinitialspace=True, **options)

    def _skipped(self) -> int:
        """Number of lines up to the header, with it."""
        with open(self.path, encoding="utf-8-sig") as stream:
            for k, line in enumerate(stream, 1):
                if line.strip() and line[:1] != self.comment:
                    return k
        return 0

    def load(self, names: Sequence[str], progress: Progress | None) -> dict[str, np.ndarray]:
        """The columns as numbers, read in chunks; memory: 8 bytes a number, and one chunk at a time."""
        import pandas as pd

        parts: dict[str, list[np.ndarray]] = {name: [] for name in names}
        rows = 0
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("error", pd.errors.ParserWarning)  # a row of more cells than the header
                for frame in self._frames(dtype=dict.fromkeys(names, float), chunksize=CHUNK):
                    for name in names:
                        parts[name].append(frame[name].to_numpy())
                    rows += len(frame)
                    if progress is not None:
                        progress(rows, None, f"reading {self.path.name}")
        except (ValueError, pd.errors.ParserError, pd.errors.ParserWarning) as error:
            raise self._wrong(names, error) from None
        return {name: np.concatenate(chunks) if chunks else np.zeros(0) for name, chunks in parts.items()}

    def _wrong(self, names: Sequence[str], error: Exception) -> ArgumentError:
        """The error that names the first cell that is no number."""
        import pandas as pd

        try:
            for frame in self._frames(dtype=str, chunksize=CHUNK, keep_default_na=False):
                frame = frame[list(names)]
                plain = frame.apply(lambda column: column.str.replace(self.decimal, ".", regex=False))
                bad = plain.apply(pd.to_numeric, errors="coerce").isna()
                if bad.to_numpy().any():
                    at, column = np.argwhere(bad.to_numpy())[0]
                    return ArgumentError(f"{self.name}: {self.place(int(frame.index[at]))}, column "
                                         f"{frame.columns[column]!r}: {frame.iloc[at, column]!r} is no number")
        except (ValueError, pd.errors.ParserError) as other:
            error = other
        return ArgumentError(f"{self.name}: cannot be read as columns of numbers ({' '.join(str(error).split())})")

    def texts(self, name: str, values: np.ndarray) -> Sequence[str]:
        """The first values as they are printed."""
        column = self._frames(dtype=str, nrows=SHOWN)[name]
        return [str(cell).replace(self.decimal, ".") for cell in column]

    def place(self, row: int) -> str:
        """The row of data, and its line in the file."""
        left = row + self.header
        with open(self.path, encoding="utf-8-sig", errors="replace") as stream:
            for k, line in enumerate(stream, 1):
                if line.strip() and line[:1] != self.comment:
                    if left == 0:
                        return f"row {row + 1} (line {k})"
                    left -= 1
        return f"row {row + 1}"


def _separator(lines: Sequence[str]) -> str:
    """The separator that the first lines have in common: the one that divides them into most cells."""
    counts = {mark: min(line.count(mark) for line in lines[:9]) for mark in (";", "\t", ",")}
    best = max(counts, key=lambda mark: counts[mark])
    return best if counts[best] else " " if len(lines[-1].split()) > 1 else ","


def _is_number(value: Any) -> bool:
    try:
        float(value)
    except (TypeError, ValueError):
        return False
    return True


def opened(data: Any, scene: Scene) -> Source:
    """The table of a path, data frame or mapping of arrays. Raises `ArgumentError` if it cannot be read."""
    if hasattr(data, "to_parquet"):
        return Source("data frame", _of_frame(data))
    if isinstance(data, Mapping):
        return Source("arrays", _of_arrays(data, scene, "arrays"))
    if not isinstance(data, str | os.PathLike):
        raise ArgumentError(f"recording: a path, a data frame or a mapping of arrays is wanted, not "
                            f"{type(data).__name__}")
    path = Path(data)
    try:
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
    except ImportError as error:
        raise ArgumentError(f"{path}: {missing(error)}") from None
    except OSError as error:
        raise ArgumentError(f"{path}: cannot be read ({error.strerror or error})") from None
    except ArgumentError:
        raise
    except Exception as error:  # each library has errors of its own for a broken file
        raise ArgumentError(f"{path}: no {path.suffix[1:] or 'CSV'} file that can be read ({error})") from None


def _of_frame(frame: Any) -> dict[str, np.ndarray]:
    if frame.index.name is not None:
        frame = frame.reset_index()
    return {str(name): frame[name].to_numpy() for name in frame}


def _of_arrays(arrays: Mapping[str, Any], scene: Scene, where: str) -> dict[str, np.ndarray]:
    """Columns of arrays: (T,) as it is; (T, k) as name[0] ...; x, v, w (T, n, 3), q and R of all bodies by body."""
    columns: dict[str, np.ndarray] = {}
    for name, array in arrays.items():
        array = np.asarray(array)
        if array.ndim == 1:
            columns[name] = array
        elif array.ndim == 2:
            columns |= {f"{name}[{k}]": array[:, k] for k in range(array.shape[1])}
        elif array.ndim > 2 and array.shape[1] == scene.n and name in GROUPS:
            flat = array.reshape(len(array), scene.n, -1)
            columns |= {f"{body.name}.{name}[{k}]": flat[:, b, k]
                        for b, body in enumerate(scene.bodies) for k in range(flat.shape[2])}
    counts = {len(column) for column in columns.values()}
    if len(counts) > 1:
        raise ArgumentError(f"{where}: the arrays have different lengths, {sorted(counts)}; one row a time is wanted")
    return columns


def mapping_of(columns: Any) -> dict[str, Any]:
    """The rows of a mapping: of a TOML file, or of a dict with the same content."""
    if columns is None:
        return {}
    where = "columns"
    if isinstance(columns, str | os.PathLike):
        where = str(columns)
        try:
            columns = tomllib.loads(Path(columns).read_text(encoding="utf-8-sig"))
        except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
            raise ArgumentError(f"{where}: cannot be read as a mapping ({error})") from None
    if not isinstance(columns, Mapping):
        raise ArgumentError(f"columns: a TOML file or a dict is wanted, not {type(columns).__name__}")
    rows = columns.get("columns", columns)
    for key, row in rows.items():
        if isinstance(row, str):
            continue
        if not isinstance(row, Mapping) or "is" not in row:
            raise ArgumentError(f'{where}: column {key!r}: write {{ is = "upper.x" }}')
        for entry in row:
            if entry not in ROWS:
                raise ArgumentError(f"{where}: column {key!r}: {unknown('key', entry, ROWS)}")
    return {key: {"is": row} if isinstance(row, str) else dict(row) for key, row in rows.items()}


def uses(scene: Scene, source: Source, rows: Mapping[str, Any]) -> tuple[list[Use], tuple[str, ...]]:
    """What the columns are, by the mapping and by their headers, and the names of the others."""
    made, taken = [], set()
    for key, row in rows.items():
        use = _mapped(scene, source, key, row)
        taken |= set(use.columns)
        made.append(use)
    wholes: dict[str, list[str]] = {}
    for column in source.columns:
        if column in taken:
            continue
        name, unit, wrap = split_unit(column)
        if (match := re.fullmatch(r"(.*)\[\d+\]", column)) and (meaning_of(scene, match[1]) is not None):
            wholes.setdefault(match[1], []).append(column)
            continue
        meaning = meaning_of(scene, name)
        if meaning is None:
            continue
        where = f"{source.name}: column {column!r}"
        taken.add(column)
        made.append(Use((column,), dataclasses.replace(meaning, parts=meaning.parts[:1] or (0,)),
                        factor=factor_of(unit, meaning.dimension, where) if unit else 1.0, wrap=wrap))
    for name, columns in wholes.items():
        meaning = meaning_of(scene, name)
        if meaning is not None and len(meaning.parts) in (0, len(columns)):
            parts = meaning.parts or tuple(range(len(columns)))
            made.append(Use(tuple(columns), dataclasses.replace(meaning, parts=parts)))
            taken |= set(columns)
    if not any(use.meaning.key == "t" for use in made):
        raise ArgumentError(f"{source.name}: no column t; name the column of times t, or map it "
                            f'("Time [s]" = {{ is = "t" }}). Its columns: {", ".join(source.columns[:20])}')
    if all(use.meaning.key == "t" for use in made):
        names = [f"{body.name}.x" for body in scene.bodies] + [f"{joint.name}.position" for joint in scene.joints]
        raise ArgumentError(f"{source.name}: no column is one of scene {scene.name!r}, such as {', '.join(names[:8])}; "
                            "name them so, or give a mapping (--suggest writes one). Its columns: "
                            f"{', '.join(source.columns[:20])}")
    return made, tuple(column for column in source.columns if column not in taken)


def _mapped(scene: Scene, source: Source, key: str, row: Mapping[str, Any]) -> Use:
    where = f"{source.name}: column {key!r}"
    meaning = meaning_of(scene, str(row["is"]))
    if meaning is None:
        names = [body.name for body in scene.bodies] + [joint.name for joint in scene.joints]
        raise ArgumentError(f"{where}: {row['is']!r} is nothing of scene {scene.name!r}, whose bodies and joints are "
                            f"{', '.join(names)}; write one of them with .x .y .z .q .R .v .w, .position or .velocity")
    columns = [str(name) for name in row.get("columns", ())]
    if not columns:
        whole = [name for name in source.columns if re.fullmatch(re.escape(key) + r"(\[\d+\]|[._][wxyz])", name)]
        columns = [key] if key in source.columns or not whole else whole
    for name in columns:
        if name not in source.columns:
            raise ArgumentError(f"{where}: {unknown('column of the file', name, source.columns)}")
    parts, form = meaning.parts, meaning.form
    if str(row["is"]).endswith(".x") and len(columns) == 3:
        parts = (0, 1, 2)
    if form and len(parts) > 1 and len(columns) in (4, 9):  # "attitude" is both
        form, parts = ("q", (0, 1, 2, 3)) if len(columns) == 4 else ("R", tuple(range(9)))
    if not parts:
        parts = tuple(range(len(columns)))
    if len(parts) != len(columns):
        raise ArgumentError(f"{where}: {row['is']} has {len(parts)} numbers, and {len(columns)} columns are named; "
                            'list them: columns = ["q1", "q2", "q3", "q4"]')
    order = row.get("order")
    if order is not None:
        if form != "q" or order not in ("wxyz", "xyzw"):
            raise ArgumentError(f'{where}: order: "wxyz" or "xyzw" of a quaternion is wanted, not {order!r}')
        parts = tuple("wxyz".index(letter) for letter in order)
    frame = row.get("frame", "")
    if frame not in ("", "world", "body"):
        raise ArgumentError(f'{where}: frame: "world" or "body" is wanted, not {frame!r}')
    point = row.get("point")
    if point is not None and np.shape(point) != (3,):
        raise ArgumentError(f"{where}: point: three numbers in m, body axes, are wanted, not {point!r}")
    numbers = [row.get("scale", 1.0), row.get("offset", 0.0)]
    if not all(isinstance(value, int | float) for value in numbers):
        raise ArgumentError(f"{where}: scale and offset: numbers are wanted")
    unit = row.get("unit") or (split_unit(columns[0])[1] if len(columns) == 1 else "")
    return Use(tuple(columns), dataclasses.replace(meaning, parts=parts, form=form), float(numbers[0]),
               float(numbers[1]), factor_of(unit, meaning.dimension, where) if unit else 1.0, frame,
               None if point is None else np.array(point, dtype=float), bool(row.get("wrap", False)))


def read(data: Any, scene: Scene, columns: Any = None, progress: Progress | None = None) -> Recording:
    """A recording of a scene.

    Parameters
    ----------
    data : path of a .csv, .npz or .parquet file, a data frame, or a mapping of arrays
    columns : a mapping (TOML file or dict); None: by the headers alone

    Raises
    ------
    ArgumentError
        The file cannot be read, has text or NaN in a cell, times that do not increase, no known column ...; the
        message names file, row and column.
    """
    source = opened(data, scene)
    made, ignored = uses(scene, source, mapping_of(columns))
    names = list(dict.fromkeys(name for use in made for name in use.columns))
    numbers = source.load(names, progress)
    rows = min(map(len, numbers.values()))
    if rows == 0:
        raise ArgumentError(f"{source.name}: no rows")
    for name, values in numbers.items():
        if not np.isfinite(values).all():
            at = int(np.argmin(np.isfinite(values)))
            raise ArgumentError(f"{source.name}: {source.place(at)}, column {name!r}: "
                                f"{'empty or NaN' if np.isnan(values[at]) else 'infinite'}; a number is wanted")
    times = [use for use in made if use.meaning.key == "t"]
    if len(times) > 1:
        raise ArgumentError(f"{source.name}: columns {times[0].columns[0]!r} and {times[1].columns[0]!r} are both t")
    t = _scaled(times[0], numbers[times[0].columns[0]])
    if rows > 1 and np.diff(t).min() <= 0:
        at = int(np.argmin(np.diff(t) > 0)) + 1
        raise ArgumentError(f"{source.name}: {source.place(at)}, column {times[0].columns[0]!r}: time {t[at]:.9g} s "
                            f"does not follow {t[at - 1]:.9g} s; times have to increase")
    if t[0] < 0:
        raise ArgumentError(f"{source.name}: {source.place(0)}, column {times[0].columns[0]!r}: time {t[0]:.9g} s is "
                            "before the scene's start at 0; subtract it (offset)")
    groups = list(_grouped(scene, source, [use for use in made if use.meaning.key != "t"], numbers))
    return Recording(source.name, t, groups, ignored, _blur(source, times[0], t))


def _scaled(use: Use, values: np.ndarray) -> np.ndarray:
    return np.asarray((use.scale * values + use.offset) * use.factor)


def _grouped(scene: Scene, source: Source, made: Sequence[Use], numbers: Mapping[str, np.ndarray]) -> Iterator[Group]:
    parts: dict[tuple[str, str], dict[int, tuple[str, Use]]] = {}
    for use in made:
        held = parts.setdefault((use.meaning.key, use.meaning.owner), {})
        for part, column in zip(use.meaning.parts, use.columns, strict=True):
            if part in held:
                raise ArgumentError(f"{source.name}: columns {held[part][0]!r} and {column!r} are both component "
                                    f"{part} of {use.meaning.owner}, {use.meaning.key}; leave one out")
            held[part] = column, use
    for (key, owner), held in parts.items():
        order = sorted(held)
        use = held[order[0]][1]
        columns = np.stack([_scaled(held[k][1], numbers[held[k][0]]) for k in order], axis=1)
        digits = [printed(source.texts(held[k][0], numbers[held[k][0]])) for k in order]
        floor = np.sqrt(sum((one.floor(numbers[held[k][0]]) * held[k][1].scale * held[k][1].factor) ** 2
                            for k, one in zip(order, digits, strict=True)))
        frame, point, crooked = use.frame, use.point, 0.0
        if key == "attitude":
            wanted = 4 if use.meaning.form == "q" else 9
            if len(order) != wanted:
                raise ArgumentError(f"{source.name}: the attitude of {owner!r} has {len(order)} of {wanted} columns; "
                                    "give all of them")
            columns, crooked = _attitudes(source, columns, owner)
            floor = floor * (2.0 if wanted == 4 else 1.0)
            order = [0]
        unit = next((name for name, known in _si().items() if known == use.meaning.dimension), "")
        yield Group(key, owner, tuple(order), columns, floor, frame, point,
                    any(each.wrap for _, each in held.values()), crooked,
                    "rad" if key == "attitude" else unit, key == "joint_position" and unit == "rad")


def _attitudes(source: Source, columns: np.ndarray, owner: str) -> tuple[np.ndarray, float]:
    """(T, 3, 3) rotations next to the recorded quaternions or matrices, and their largest distance from these."""
    if columns.shape[1] == 4:
        norms = np.linalg.norm(columns, axis=1)
        off = np.abs(norms - 1.0)
        R = rotation_from_quaternion(columns / np.where(norms > 0, norms, 1.0)[:, None])
    else:
        given = columns.reshape(-1, 3, 3)
        U, _, Vt = np.linalg.svd(given)
        R = U @ Vt
        off = np.abs(given - R).max(axis=(1, 2)) + (np.linalg.det(R) < 0)
    if off.max() > CROOKED:
        at = int(np.argmax(off))
        kind = "unit quaternion" if columns.shape[1] == 4 else "rotation matrix"
        raise ArgumentError(f"{source.name}: {source.place(at)}: the attitude of {owner!r} is no {kind}: off by "
                            f"{off[at]:.2g}")
    return R, float(off.max())


@dataclasses.dataclass(frozen=True)
class Printed:
    """The digits to which numbers are printed."""

    decimals: int
    significant: int
    constant: bool = False

    def floor(self, values: np.ndarray) -> np.ndarray:
        """The rounding that these digits leave, per value."""
        if self.constant or self.significant >= DOUBLE:
            return np.asarray(np.abs(values) * 2.0**-52)
        with np.errstate(divide="ignore"):
            power = np.floor(np.log10(np.abs(values)))
        relative = 0.5 * 10.0 ** (np.where(np.isfinite(power), power, -300.0) + 1 - self.significant)
        return np.asarray(np.maximum(relative, 0.5 * 10.0**-self.decimals))


def printed(texts: Sequence[str]) -> Printed:
    """The digits of numbers as they are written: of fixed decimals, or of significant digits."""
    decimals, significant, different = 0, 0, set()
    for text in texts:
        try:
            number = Decimal(text.strip())
        except InvalidOperation:
            continue
        _, digits, exponent = number.as_tuple()
        if isinstance(exponent, int):
            different.add(number)
            decimals = max(decimals, -exponent)
            significant = max(significant, len(digits) if any(digits) else 0)
    return Printed(decimals, significant, len(different) < 2)


def _blur(source: Source, use: Use, t: np.ndarray) -> float:
    """What the printed digits of times leave open, s. Times of an even grid that the digits hold are exact."""
    digits = printed(source.texts(use.columns[0], t / (use.scale * use.factor)))
    if digits.significant >= DOUBLE or len(t) < 3:
        return 0.0
    last = 10.0**-digits.decimals * abs(use.scale * use.factor)
    jitter = float(np.abs(t - np.linspace(t[0], t[-1], len(t))).max())
    return 0.0 if jitter <= 1e-3 * last else min(jitter, 0.5 * last)


WORDS = {"position": ("pos", "position", "angle", "theta", "q", "displacement", "slide"),
         "velocity": ("vel", "velocity", "rate", "speed", "qd", "omega")}


def suggest(data: Any, scene: Scene) -> str:
    """A mapping, as the text of a TOML file, of the columns whose names and units are recognised; others as comments.
    """
    source, lines = opened(data, scene), ["[columns]"]
    for column in source.columns:
        name, unit, _ = split_unit(column)
        target = _guess(scene, name)
        row = f'{{ is = "{target}"{f", unit = {chr(34)}{unit}{chr(34)}" if unit and unit != "1" else ""} }}'
        quoted = column.replace("\\", "\\\\").replace('"', '\\"')
        lines.append(f'"{quoted}" = {row}' if target else f'# "{quoted}" = {{ is = "..." }}')
    return "\n".join(lines) + "\n"


def _guess(scene: Scene, name: str) -> str:
    """What a foreign name probably is, "" if that is not clear."""
    if meaning_of(scene, name) is not None:
        return "t" if name == "time" else name
    words = re.findall(r"[a-z]+|\d+", re.sub(r"([a-z])([A-Z])", r"\1 \2", name).lower())
    if words and words[0] in ("t", "time", "timestamp", "sec", "seconds"):
        return "t"
    def spoken(owner: str) -> bool:
        return re.sub(r"[^a-z0-9]", "", owner.lower()) in "".join(words)
    joints = [joint.name for joint in scene.joints if spoken(joint.name) and JOINT_TYPES[joint.type].coordinates]
    bodies = [body.name for body in scene.bodies if spoken(body.name)]
    tail = words[-1] if words else ""
    if (len(joints) == 1 and not bodies) or (len(joints) == 1 and tail not in tuple("xyz")):
        for part, known in WORDS.items():
            if any(word in known for word in words):
                return f"{joints[0]}.{part}"
        return f"{joints[0]}.position" if not bodies else ""
    if len(bodies) == 1 and (match := re.fullmatch(r"(q[wxyz]|[vw]?[xyz])", tail)):
        if len(match[1]) == 1:
            if any(word in ("vel", "velocity", "linvel", "v") for word in words):
                return f"{bodies[0]}.v{tail}"
            if any(word in ("omega", "gyro", "angvel", "w", "rate", "angular") for word in words):
                return f"{bodies[0]}.w{tail}"
        return f"{bodies[0]}.{tail}"
    return ""
