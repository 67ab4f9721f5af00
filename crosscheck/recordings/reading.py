"""Files of recorded motions: CSV, NPZ, Parquet or data frames, with their columns named, scaled and checked.

pandas reads them. What a column means follows from its name ("upper.vx", "elbow.position [deg]"), or from a mapping.
Values become SI units; what a scene would have shown in their place is computed by `crosscheck.recordings.comparing`.
"""

from __future__ import annotations

import csv
import dataclasses
import functools
import itertools
import json
import math
import os
import re
import tomllib
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from decimal import Decimal
from pathlib import Path
from typing import Any, Literal

import msgspec
import numpy as np

from crosscheck.errors import ArgumentError, foreign, missing, unknown
from crosscheck.scene.joints import JOINT_TYPES
from crosscheck.scene.model import Scene, rotation_from_quaternion

Progress = Callable[[int, int | None, str], None]

Powers = tuple[int, ...]
LENGTH, ANGLE, TIME, FORCE, NUMBER = (1, 0, 0, 0), (0, 1, 0, 0), (0, 0, 1, 0), (0, 0, 0, 1), (0, 0, 0, 0)
UNITS: dict[str, tuple[Powers, float]] = {
    "m": (LENGTH, 1.0), "mm": (LENGTH, 1e-3), "cm": (LENGTH, 1e-2), "km": (LENGTH, 1e3), "in": (LENGTH, 0.0254),
    "ft": (LENGTH, 0.3048), "rad": (ANGLE, 1.0), "mrad": (ANGLE, 1e-3), "deg": (ANGLE, math.pi / 180),
    "rev": (ANGLE, math.tau), "s": (TIME, 1.0), "ms": (TIME, 1e-3), "us": (TIME, 1e-6), "ns": (TIME, 1e-9),
    "min": (TIME, 60.0), "h": (TIME, 3600.0), "N": (FORCE, 1.0), "kN": (FORCE, 1e3), "N m": ((1, 0, 0, 1), 1.0),
    "1": (NUMBER, 1.0), "g": ((1, 0, -2, 0), 9.80665), "rpm": ((0, 1, -1, 0), math.tau / 60)}
"""Units: the powers of length, angle, time and force, and the factor to SI."""

SI: dict[Powers, str] = {LENGTH: "m", ANGLE: "rad", TIME: "s", (1, 0, -1, 0): "m/s", (0, 1, -1, 0): "rad/s", FORCE: "N"}
VECTORS = (("", "x", "position", LENGTH), ("v", "v", "velocity", (1, 0, -1, 0)),
           ("w", "w", "angular_velocity", (0, 1, -1, 0)))
"""Vectors of a body: letter of a component, of all three, quantity and dimension."""

SHOWN = 2000
"""Rows from which the printed digits are measured."""

CHUNK = 250_000
"""Rows that are read at a time."""

DOUBLE = 15
"""Significant digits from which a printed number is a double."""

CROOKED = 0.05
"""How far a quaternion may be from norm one, or a matrix from orthogonal, to count as an attitude at all."""


class Row(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A row of a mapping; scale, then offset, in the unit of the column."""

    what: str = msgspec.field(name="is")
    unit: str = ""
    scale: float = 1.0
    offset: float = 0.0
    columns: tuple[str, ...] = ()
    order: Literal["wxyz", "xyzw"] | None = None
    frame: Literal["", "world", "body"] = ""
    point: tuple[float, float, float] | None = None
    wrap: bool = False


AS_IT_IS = Row("")


@dataclasses.dataclass
class Group:
    """The recorded values of one quantity of one body, joint or sensor; attitudes are matrices."""

    key: str  # the quantity: "position" ... "joint_velocity", or the name of a sensor
    owner: str  # name of the body, joint or sensor
    parts: tuple[int, ...]  # which components
    values: np.ndarray  # (T, parts) in SI units, or (T, 3, 3)
    floor: np.ndarray  # (T,) what the printed digits leave open, in the norm
    frame: str = ""  # "world" or "body" where it is not the usual one
    point: tuple[float, float, float] | None = None  # m, body axes, where it is not the centre of mass
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
class Column:
    """A column or a group of columns: what it is, and what becomes of its numbers."""

    key: str
    owner: str
    parts: tuple[int, ...]  # components; (): as many as there are columns
    dimension: Powers | None = None  # None: any
    form: str = ""  # of an attitude: "q" or "R"
    names: tuple[str, ...] = ()  # in the file
    factor: float = 1.0  # of the unit
    row: Row = AS_IT_IS

    def scaled(self, values: np.ndarray) -> np.ndarray:
        """Recorded numbers in SI units."""
        return np.asarray((self.row.scale * values + self.row.offset) * self.factor)


def factor_of(unit: str, dimension: Powers | None, where: str) -> float:
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
                            f"{SI.get(dimension, 'a number')}")
    return factor


def meanings(scene: Scene) -> dict[str, Column]:
    """All names that mean something in a recording of a scene; "upper v_x" and "R_11" are those of our own exports."""
    known = {name: Column("t", "", (0,), TIME) for name in ("t", "time")}
    for sensor in scene.sensors:
        axes = "wxyz" if sensor.type == "attitude" else "xyz"
        known[sensor.name] = Column(sensor.name, sensor.name, ())
        known |= {f"{sensor.name}.{axis}": Column(sensor.name, sensor.name, (k,)) for k, axis in enumerate(axes)}
    for body, dot in itertools.product((body.name for body in scene.bodies), ". "):
        for letter, short, key, dimension in VECTORS:
            whole = Column(key, body, (0, 1, 2), dimension)
            known |= {f"{body}{dot}{short}": whole, f"{body}{dot}{key}": whole}
            for (k, axis), name in itertools.product(enumerate("xyz"), (f"{letter}{{}}", f"{short}_{{}}")):
                known[f"{body}{dot}{name.format(axis)}"] = Column(key, body, (k,), dimension)
        entries = [(f"R{i}{j}", f"R_{i + 1}{j + 1}") for i, j in itertools.product(range(3), range(3))]
        for form, names in (("R", entries), ("q", [(f"q{axis}", f"q_{axis}") for axis in "wxyz"])):
            whole = Column("attitude", body, tuple(range(len(names))), NUMBER, form)
            known |= {f"{body}{dot}{name}": whole for name in (form, "attitude")}
            known |= {f"{body}{dot}{name}": dataclasses.replace(whole, parts=(k,))
                      for k, pair in enumerate(names) for name in pair}
    for joint, rate in itertools.product(scene.joints, (0, 1)):
        words, key = JOINT_TYPES[joint.type].coordinates, ("position", "velocity")[rate]
        count = (3 if rate else 4) if words == ("ball",) else len(words)
        for k in range(count):
            word = words[min(k, len(words) - 1)]
            base = NUMBER if word == "ball" and not rate else LENGTH if word.startswith("slide") else ANGLE
            one = Column(f"joint_{key}", joint.name, (k,), tuple(a - rate * b for a, b in zip(base, TIME, strict=True)))
            for dot, end in itertools.product(". ", (f"{k}", f".{k}", f"[{k}]")):
                known[f"{joint.name}{dot}{key}{end}"] = one
                known.setdefault(f"{joint.name}{dot}{key}", dataclasses.replace(one, parts=tuple(range(count))))
    return known


def split_unit(header: str) -> tuple[str, str, bool]:
    """(name, unit or "", whether it says wrap) of a header such as "elbow.position [deg, wrap]"."""
    match = re.fullmatch(r"\s*(.*?)\s*(?:[\[(]([^\])]*)[\])])?\s*(wrap)?\s*", header)
    if match is None or (match[2] or "").strip().isdigit():
        return header.strip(), "", False
    unit, _, more = (match[2] or "").partition(",")
    return match[1], unit.strip(), "wrap" in (match[3] or "") or "wrap" in more


class Source:
    """A table of columns; a text file knows besides where a row stands and how its numbers are printed."""

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

    def texts(self, name: str) -> Sequence[str]:
        """The first values as they are written: the shortest digits that give the same number."""
        shown = np.asarray(self.arrays[name][:SHOWN], dtype=float)
        single = shown.astype(np.float32)
        return [str(value) for value in single] if np.array_equal(shown, single) else [repr(float(v)) for v in shown]

    def place(self, row: int) -> str:
        """Where a row of data stands, in words."""
        return f"row {row + 1}"


class Text(Source):
    """A CSV file."""

    def __init__(self, path: Path) -> None:
        self.name, self.path = str(path), path
        try:
            with open(path, encoding="utf-8-sig") as stream:
                head = list(itertools.islice(stream, 400))
        except UnicodeDecodeError as error:
            raise ArgumentError(f"{path}: byte {error.start} is not UTF-8; save it as UTF-8 text") from None
        marks = [line[:1] for line in head if line[:1] in "#%"]
        self.comment = marks[0] if marks else None
        lines = [(k, line.strip("\n")) for k, line in enumerate(head) if self._counts(line)]
        if not lines:
            raise ArgumentError(f"{path}: no rows; a header and rows of numbers are wanted")
        self.separator = _separator([line for _, line in lines])
        self.decimal = "," if self.separator == ";" and re.search(r"\d,\d", "".join(x for _, x in lines[1:9])) else "."
        first = self._cells(lines[0][1])
        comments = [self._cells(line[1:]) for line in head if line[:1] == self.comment]
        numbers = [_is_number(cell) for cell in first]
        named = any(numbers) and comments and len(comments[-1]) == len(first)  # numpy.savetxt, rostopic
        self.header = not all(numbers) and not named
        self.columns = first if self.header else comments[-1] if named else [str(k) for k in range(len(first))]
        twice = next((name for name in self.columns if self.columns.count(name) > 1), None)
        if twice is not None:
            raise ArgumentError(f"{path}: two columns are called {twice!r}; give each a name of its own")
        if len(lines) < 2 and self.header:
            raise ArgumentError(f"{path}: a header, but no rows of numbers below it")
        self.skipped = lines[0][0] + 1 if self.header else 0

    def _counts(self, line: str) -> bool:
        """Whether a line is no comment and not blank."""
        return bool(line.strip()) and line[:1] != self.comment

    def _cells(self, line: str) -> list[str]:
        return [cell.strip() for cell in next(csv.reader([line.strip()], delimiter=self.separator,
                                                         skipinitialspace=True))]

    def _frames(self, names: Sequence[str], **options: object) -> Any:
        import pandas as pd

        return pd.read_csv(self.path, sep=r"\s+" if self.separator == " " else self.separator, comment=self.comment,
                           header=None, names=self.columns, skiprows=self.skipped, decimal=self.decimal,
                           encoding="utf-8-sig", index_col=False, skipinitialspace=True,
                           dtype=dict.fromkeys(names, options.pop("kind")), **options)

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
                        parts[name].append(frame[name].to_numpy())
                    rows += len(frame)
                    if progress is not None:
                        progress(rows, None, f"reading {self.path.name}")
        except (ValueError, pd.errors.ParserError, pd.errors.ParserWarning) as error:
            raise ArgumentError(f"{self.name}: {self._wrong(names, error)}") from None
        return {name: np.concatenate(chunks) for name, chunks in parts.items()}

    def _wrong(self, names: Sequence[str], error: Exception) -> str:
        """The first cell that is no number, in words."""
        import pandas as pd

        try:
            for frame in self._frames(names, kind=str, chunksize=CHUNK, keep_default_na=False):
                bad = ~frame[list(names)].map(lambda cell: _is_number(cell.replace(self.decimal, "."))).to_numpy()
                if bad.any():
                    at, column = np.argwhere(bad)[0]
                    return (f"{self.place(int(frame.index[at]))}, column {names[column]!r}: "
                            f"{frame[names[column]].iloc[at]!r} is no number")
        except (ValueError, pd.errors.ParserError) as other:
            error = other
        return f"cannot be read as columns of numbers ({' '.join(str(error).split())})"

    @functools.cached_property
    def _shown(self) -> Any:
        return self._frames(self.columns, kind=str, nrows=SHOWN)

    def texts(self, name: str) -> Sequence[str]:
        """The first values as they are printed."""
        return [str(cell).replace(self.decimal, ".") for cell in self._shown[name]]

    def place(self, row: int) -> str:
        """The row of data, and its line in the file."""
        with open(self.path, encoding="utf-8-sig", errors="replace") as stream:
            numbers = (k for k, line in enumerate(stream, 1) if self._counts(line))
            return f"row {row + 1} (line {next(itertools.islice(numbers, row + self.header, None), '?')})"


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

    def told(error: Exception) -> ArgumentError:  # each library has errors of its own for a broken file
        if isinstance(error, ImportError):
            return ArgumentError(f"{path}: {missing(error)}")
        return ArgumentError(f"{path}: cannot be read ({error.strerror or error})" if isinstance(error, OSError) else
                             f"{path}: no {path.suffix[1:] or 'CSV'} file that can be read ({error})")

    with foreign(told):
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
    for name, array in arrays.items():
        array = np.asarray(array)
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


def mapping_of(columns: object) -> dict[str, Row]:
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
        raise ArgumentError(f"{where}: a TOML file or a dict is wanted, not {type(columns).__name__}")
    rows = {}
    for key, given in columns.get("columns", columns).items():
        try:
            rows[key] = msgspec.convert({"is": given} if isinstance(given, str) else given, Row)
        except msgspec.ValidationError as error:
            raise ArgumentError(f"{where}: column {key!r}: {error}; keys: {', '.join(Row.__struct_encode_fields__)}"
                                ) from None
    return rows


def assigned(scene: Scene, source: Source, rows: Mapping[str, Row]) -> tuple[list[Column], list[str]]:
    """What the columns are, by the mapping and by their headers, and the names of the others."""
    known, made = meanings(scene), []
    left = list(source.columns)

    def take(key: str, row: Row) -> None:
        made.append(_mapped(known, scene, source, key, row))
        left[:] = [name for name in left if name not in made[-1].names]

    for key, row in rows.items():
        take(key, row)
    for column in list(left):
        name, unit, wrap = split_unit(column)
        whole = re.sub(r"\[\d+\]$", "", column)
        if column in left and name in known:
            take(column, Row(name, unit, wrap=wrap))
        elif column in left and whole in known:
            take(whole, Row(whole))
    examples = [f"{body.name}.x" for body in scene.bodies] + [f"{joint.name}.position" for joint in scene.joints]
    for wanted, text in ((True, 'no column t; name it so, or map it ("Time [s]" = { is = "t" }; --suggest writes it)'),
                         (False, f"no column is one of scene {scene.name!r}, such as {', '.join(examples[:8])}; "
                          "name them so, or give a mapping (--suggest writes one)")):
        if not any((column.key == "t") is wanted for column in made):
            raise ArgumentError(f"{source.name}: {text}. Its columns: {', '.join(source.columns[:20])}")
    return made, left


def _mapped(known: Mapping[str, Column], scene: Scene, source: Source, key: str, row: Row) -> Column:
    where = f"{source.name}: column {key!r}"
    meaning = known.get(row.what)
    if meaning is None:
        names = [body.name for body in scene.bodies] + [joint.name for joint in scene.joints]
        raise ArgumentError(f"{where}: {row.what!r} is nothing of scene {scene.name!r}, whose bodies and joints are "
                            f"{', '.join(names)}; write one of them with .x .y .z .q .R .v .w, .position or .velocity")
    names = list(row.columns)
    if not names:
        whole = [name for name in source.columns if re.fullmatch(re.escape(key) + r"(\[\d+\]|[._][wxyz])", name)]
        names = [key] if key in source.columns or not whole else whole
    for name in names:
        if name not in source.columns:
            raise ArgumentError(f"{where}: {unknown('column of the file', name, source.columns)}")
    parts, form = meaning.parts or tuple(range(len(names))), meaning.form
    if meaning.key == "position" and parts == (0,) and len(names) == 3:
        parts = (0, 1, 2)
    if form and len(parts) > 1 and len(names) in (4, 9):  # "attitude" is both
        form, parts = ("q", (0, 1, 2, 3)) if len(names) == 4 else ("R", tuple(range(9)))
    if len(parts) != len(names):
        raise ArgumentError(f"{where}: {row.what} has {len(parts)} numbers, and {len(names)} columns are named; "
                            'list them: columns = ["q1", "q2", "q3", "q4"]')
    if row.order is not None:
        if form != "q":
            raise ArgumentError(f"{where}: order: of a quaternion only")
        parts = tuple("wxyz".index(letter) for letter in row.order)
    unit = row.unit or (split_unit(names[0])[1] if len(names) == 1 else "")
    return dataclasses.replace(meaning, names=tuple(names), parts=parts, form=form, row=row,
                               factor=factor_of(unit, meaning.dimension, where) if unit else 1.0)


def read(data: object, scene: Scene, columns: object = None, progress: Progress | None = None) -> Recording:
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
    made, ignored = assigned(scene, source, mapping_of(columns))
    numbers = source.load(list(dict.fromkeys(name for column in made for name in column.names)), progress)
    if min(map(len, numbers.values())) == 0:
        raise ArgumentError(f"{source.name}: no rows")
    for name, values in numbers.items():
        if not np.isfinite(values).all():
            at = int(np.argmin(np.isfinite(values)))
            raise ArgumentError(f"{source.name}: {source.place(at)}, column {name!r}: "
                                f"{'empty or NaN' if np.isnan(values[at]) else 'infinite'}; a number is wanted")
    times = [column for column in made if column.key == "t"]
    if len(times) > 1:
        raise ArgumentError(f"{source.name}: columns {times[0].names[0]!r} and {times[1].names[0]!r} are both t")
    name = times[0].names[0]
    t = times[0].scaled(numbers[name])
    later = np.diff(t, prepend=-np.inf) > 0
    if not later.all() or t[0] < 0:
        at = int(np.argmin(later))
        raise ArgumentError(f"{source.name}: {source.place(at)}, column {name!r}: time {t[at]:.9g} s " + (
            f"does not follow {t[at - 1]:.9g} s; times have to increase" if at else
            "is before the scene's start at 0; subtract it (offset)"))
    if t[0] > EPOCH:
        raise ArgumentError(f"{source.name}: column {name!r}: times begin at {t[0]:.9g} s, not near the scene's start "
                            f"at 0; subtract the first one (offset = {-numbers[name][0]!r}), as --suggest does")
    groups = list(_grouped(source, [column for column in made if column.key != "t"], numbers))
    return Recording(source.name, t, groups, tuple(ignored), _blur(source, times[0], t))


def _grouped(source: Source, made: Sequence[Column], numbers: Mapping[str, np.ndarray]) -> Iterator[Group]:
    parts: dict[tuple[str, str], dict[int, tuple[str, Column]]] = {}
    for column in made:
        held = parts.setdefault((column.key, column.owner), {})
        for part, name in zip(column.parts, column.names, strict=True):
            if part in held:
                raise ArgumentError(f"{source.name}: columns {held[part][0]!r} and {name!r} are both component "
                                    f"{part} of {column.owner}, {column.key}; leave one out")
            held[part] = name, column
    for (key, owner), held in parts.items():
        order = tuple(sorted(held))
        first = held[order[0]][1]
        values = np.stack([held[k][1].scaled(numbers[held[k][0]]) for k in order], axis=1)
        floor = np.sqrt(sum((held[k][1].row.scale * held[k][1].factor * rounding(source.texts(held[k][0]),
                                                                             numbers[held[k][0]])) ** 2 for k in order))
        unit, crooked = SI.get(first.dimension or (), ""), 0.0
        if key == "attitude":
            wanted = 4 if first.form == "q" else 9
            if len(order) != wanted:
                raise ArgumentError(f"{source.name}: the attitude of {owner!r} has {len(order)} of {wanted} columns; "
                                    "give all of them")
            values, crooked = _attitudes(source, values, owner)
            floor, order, unit = floor * (2.0 if wanted == 4 else 1.0), (0,), "rad"
        yield Group(key, owner, order, values, floor, first.row.frame, first.row.point, any(each.row.wrap for
                    _, each in held.values()), crooked, unit, key == "joint_position" and unit == "rad")


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


def digits(texts: Sequence[str]) -> tuple[int, int]:
    """(decimals, significant digits) to which numbers are printed; those of a constant are exact."""
    numbers = [number for text in texts if _is_number(text) and (number := Decimal(text.strip())).is_finite()]
    if len(set(numbers)) < 2:
        return 0, DOUBLE
    parts = [number.as_tuple() for number in numbers]
    return (max(0, *(-int(part.exponent) for part in parts)),
            max(len(part.digits) for part in parts if any(part.digits)))


def rounding(texts: Sequence[str], values: np.ndarray) -> np.ndarray:
    """What printed digits, of fixed decimals or of significant digits, leave open in each value."""
    decimals, significant = digits(texts)
    if significant >= DOUBLE:
        return np.asarray(np.abs(values) * 2.0**-52)
    with np.errstate(divide="ignore"):
        power = np.floor(np.log10(np.abs(values)))
    relative = 0.5 * 10.0 ** (np.where(np.isfinite(power), power, -300.0) + 1 - significant)
    return np.asarray(np.maximum(relative, 0.5 * 10.0**-decimals))


def _blur(source: Source, column: Column, t: np.ndarray) -> float:
    """What the printed digits of times leave open, s. Times of an even grid that the digits hold are exact."""
    decimals, significant = digits(source.texts(column.names[0]))
    if len(t) < 3:
        return 0.0
    if significant >= DOUBLE:  # times since 1970 are no exact doubles
        return float(np.spacing(abs(column.row.offset)) * abs(column.factor))
    last = 10.0**-decimals * abs(column.row.scale * column.factor)
    jitter = float(np.abs(t - np.linspace(t[0], t[-1], len(t))).max())
    return 0.0 if jitter <= 1e-3 * last else min(jitter, 0.5 * last)


WORDS = {
    "t": ("t", "time", "timestamp", "stamp", "tout", "clock", "sec", "secs", "seconds"),
    "rate": ("vel", "velocity", "rate", "speed", "qd", "qdot", "dq", "qvel", "dtheta", "dot", "twist", "linear", "w",
             "omega", "gyro", "angvel", "angular"),
    "spin": ("omega", "gyro", "angvel", "angular"), "q": ("quat", "quaternion", "orientation", "attitude", "rotation"),
    "pose": ("pos", "position", "angle", "theta", "q", "qpos", "displacement", "slide", "phi", "joint", "coordinate")}
"""Words of foreign names, by what they say."""

UNIT_WORDS = {"degrees": "deg", "msec": "ms", "usec": "us", "nsec": "ns", "dps": "deg/s"} | {
    unit: unit for unit in ("deg", "rad", "mm", "cm", "ms", "us", "ns", "rpm", "m", "s")}

EPOCH = 1e8
"""Times (s) from which on zero is no start of a scene: three years."""


def suggest(data: object, scene: Scene) -> str:
    """A mapping, as the text of a TOML file, of the columns whose names and units are recognised; others as comments.
    """
    source, known, made = opened(data, scene), meanings(scene), dict[str, tuple[str, str]]()
    numbered: dict[bool, dict[int, tuple[str, str]]] = {False: {}, True: {}}
    for column in source.columns:
        name, unit, _ = split_unit(column)
        words = re.findall(r"[a-z]+|\d+", re.sub(r"([a-z])([A-Z])", r"\1 \2", name).lower())
        per = len(words) > 2 and words[-1] in ("s", "sec") and words[-2 - (words[-2] == "per")] in UNIT_WORDS
        last = len(words) - 1 - (per and 1 + (words[-2] == "per"))
        if last > 0 and words[last] in UNIT_WORDS:  # such as "elbow_vel_deg_s"
            unit, words = unit or UNIT_WORDS[words[last]] + "/s" * per, words[:last]
        says = {what for what, spelled in WORDS.items() if {*words} & {*spelled}}
        target = ("t" if name == "time" else name) if name in known else _guess(scene, words, says)
        places = [int(word) for word in words if word.isdigit()]
        given = f', unit = "{unit}"' if unit and unit != "1" else ""
        if target == "t":
            if all(what != "t" for what, _ in made.values()):
                made[column] = "t", _clock(source, column, unit)
        elif target in known and (len(known[target].parts) == 1 or name in known):
            made[column] = target, given
        elif places and says & {"rate", "pose"}:
            numbered["rate" in says or words[-1].endswith("dot")].setdefault(places[-1], (column, given))
    for rate, columns in numbered.items():  # q1, q2, ... qd1, qd2, ...: all coordinates in the order of the scene
        names, first = _coordinates(scene, known, rate), min(columns, default=0)
        if sorted(columns) == list(range(first, first + len(names))):
            made |= {columns[first + k][0]: (what, columns[first + k][1]) for k, what in enumerate(names)}
    return "[columns]\n" + "".join(
        f'{"" if column in made else "# "}{json.dumps(column, ensure_ascii=False)} = {{ is = "{what}"{more} }}\n'
        for column in source.columns for what, more in [made.get(column, ("...", ""))])


def _clock(source: Source, column: str, unit: str) -> str:
    """Unit and offset of a column of times; those since 1970 say their unit by their size."""
    first = float(source.load([column], None)[column][0])
    if not unit and first > EPOCH:
        unit = next(name for name, size in (("ns", 1e17), ("us", 1e14), ("ms", 1e11), ("s", 0.0)) if first > size)
    since = first * UNITS.get(unit, (TIME, 1.0))[1] > EPOCH
    return (f', unit = "{unit}"' if unit else "") + (f", offset = {-first!r}" if since else "")


def _coordinates(scene: Scene, known: Mapping[str, Column], rate: bool) -> list[str]:
    """Names of all coordinates or rates, body after body: MuJoCo's qpos and qvel; quaternions have the scalar first."""
    names = []
    for body, owner in enumerate(scene.bodies):
        joints = [joint for joint in scene.joints if joint.child == body]
        free = ("vx", "vy", "vz", "wx", "wy", "wz") if rate else ("x", "y", "z", "qw", "qx", "qy", "qz")
        names += [f"{owner.name}.{part}" for part in free if not joints]
        for name in (f"{joint.name}.{'velocity' if rate else 'position'}" for joint in joints):
            count = len(known[name].parts) if name in known else 0  # none if it has no coordinates
            names += [f"{name}[{k}]" for k in range(count)] if count > 1 else [name] * count
    return names


def _guess(scene: Scene, words: Sequence[str], says: set[str]) -> str:
    """What a column with these words in its foreign name probably is."""
    if not words or words[0] in WORDS["t"] or words[-1] in WORDS["t"]:
        return "t" if words else ""
    owners = [j.name for j in scene.joints if JOINT_TYPES[j.type].coordinates], [body.name for body in scene.bodies]
    joints, bodies = ([name for name in sorted(names, key=len) if re.sub(r"[^a-z0-9]", "", name.lower()) in
                       "".join(words)] for names in owners)
    bodies = bodies or [body.name for body in scene.bodies if scene.n == 1 and not joints]
    axis = re.fullmatch(r"(q[wxyz]|[vw]?[xyz]|w)", words[-1])
    if joints and not (bodies and axis and not says & {"pose", "rate"}):
        return f"{joints[-1]}.{'velocity' if 'rate' in says or words[-1].endswith('dot') else 'position'}"
    if not bodies or axis is None:
        return ""
    letter = "" if len(axis[1]) > 1 else "q" if "q" in says else "w" if "spin" in says else (
        "v" if says & {"rate"} and words[-1] != "w" else "")
    return f"{bodies[-1]}.{letter}{axis[1]}"
