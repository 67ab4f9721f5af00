"""Recorded motions: the columns of a file as quantities of a scene in SI units, with what their digits leave open.

What a scene would have shown in their place is computed by `crosscheck.recordings.comparing`.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Mapping, Sequence
from decimal import Decimal

import numpy as np

from crosscheck.errors import ArgumentError, unknown
from crosscheck.recordings.columns import (
    AS_IT_IS,
    EFFORTS,
    EPOCH,
    SI,
    TARGETS,
    Assigned,
    Column,
    Row,
    assigned,
    mapping_of,
)
from crosscheck.recordings.readers import opened
from crosscheck.recordings.tables import Progress, Source, is_number
from crosscheck.scene.model import Scene, rotation_from_quaternion

ROUNDING = 1e-12
"""Difference of numbers that are one, over the largest of their column."""

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
    point: tuple[float, float, float] | None = None  # m, body axes, where it is not the centre of mass
    wrap: bool = False
    crooked: float = 0.0  # largest distance of the recorded attitudes from rotations
    unit: str = ""  # SI
    angle: bool = False  # whether values are angles of joints, which go on over full turns
    columns: tuple[str, ...] = ()  # names in the file
    open: frozenset[str] = frozenset()  # what the names leave to the data
    scale: float = 1.0  # by which a reading of the columns has multiplied them
    row: Row = AS_IT_IS  # of its first column
    t: np.ndarray | None = None  # s, the times of an input that has a clock of its own

    @property
    def label(self) -> str:
        """In words."""
        return self.owner if self.key == self.owner else f"{self.key.replace('_', ' ')} of {self.owner}"


@dataclasses.dataclass
class Recording:
    """A recorded motion; NaN where a row does not have a quantity."""

    name: str
    t: np.ndarray  # (T,) s, scene time
    groups: list[Group]
    ignored: tuple[str, ...] = ()
    blur: float = 0.0  # s, what the printed digits of the times leave open
    missing: int = 0  # cells without a value, of the columns that are used
    merged: int = 0  # rows of the same time that were put together
    suggested: dict[str, str] = dataclasses.field(default_factory=dict)  # foreign names, and what they were taken for
    notes: tuple[str, ...] = ()
    inputs: tuple[Group, ...] = ()  # efforts and set points of joints, which are given and not judged

    @property
    def keys(self) -> list[str]:
        """The recorded quantities."""
        return list(dict.fromkeys(group.key for group in self.groups))

    @property
    def complete(self) -> np.ndarray:
        """(T,) whether a row has all quantities."""
        every = np.ones(len(self.t), dtype=bool)
        for group in self.groups:
            every &= np.isfinite(group.values.reshape(len(self.t), -1)).all(axis=1)
        return every


def read(data: object, scene: Scene, columns: object = None, progress: Progress | None = None,
         period: float | None = None) -> Recording:
    """A recording of a scene.

    Parameters
    ----------
    data : path of a text, .npz or .parquet file, a data frame, or a mapping of arrays
    columns : a mapping (TOML file or dict); None: by the headers alone
    period : s between two rows, of a table without times; the first row is at 0

    Raises
    ------
    ArgumentError
        The file cannot be read, has text in a cell, times that fall, no known column ...; the message names file, row
        and column.
    """
    source = opened(data, scene)
    made = assigned(scene, source, mapping_of(columns))
    _check_assigned(scene, source, made, period)
    wanted = [name for column in made.columns for name in (*column.names, *filter(None, [column.row.clock]))]
    for name in wanted:
        if name not in source.columns:
            raise ArgumentError(f"{source.name}: clock: {unknown('column of the file', name, source.columns)}")
    numbers = source.load(list(dict.fromkeys(wanted)), progress)
    if min(map(len, numbers.values())) == 0:
        raise ArgumentError(f"{source.name}: no rows")
    for name, values in numbers.items():
        if np.isinf(values).any():
            at = int(np.argmax(np.isinf(values)))
            raise ArgumentError(f"{source.name}: {source.place(at)}, column {name!r}: infinite; a number is wanted")
    clock = next((column for column in made.columns if column.key == "t"), None)
    others = [column for column in made.columns if column.key != "t"]
    if clock is None:
        t = np.arange(len(next(iter(numbers.values())))) * float(period or 0.0)
        missing, merged, blur = sum(int(np.isnan(values).sum()) for values in numbers.values()), 0, 0.0
    else:
        t, numbers, missing, merged = _in_order(source, clock, numbers)
        blur = _blur(source, clock, t)
    groups = list(_grouped(source, others, numbers))
    for group in groups:
        if group.row.clock and clock is not None:
            group.t = clock.scaled(numbers[group.row.clock])
    inputs = tuple(group for group in groups if group.key in (*EFFORTS, *TARGETS) and np.nan_to_num(group.values).any())
    groups = [group for group in groups if group.key not in (*EFFORTS, *TARGETS)]
    notes = [f"columns {', '.join(map(repr, names))} may all be {what}: none is used; map one of them"
             for what, names in made.unclear.items()]
    return Recording(source.name, t, groups, tuple(made.ignored), blur, missing, merged, made.suggested, tuple(notes),
                     inputs)


def _check_assigned(scene: Scene, source: Source, made: Assigned, period: float | None) -> None:
    """Raises `ArgumentError` unless there is one column of times, or a period, and a column of the scene."""
    times = [column for column in made.columns if column.key == "t"]
    if len(times) > 1:
        raise ArgumentError(f"{source.name}: columns {times[0].names[0]!r} and {times[1].names[0]!r} are both t")
    if period is not None and (times or not 0 < period < np.inf):
        raise ArgumentError(f"{source.name}: period: column {times[0].names[0]!r} has the times; leave the period out"
                            if times else f"period: a number of seconds > 0 is wanted, not {period}")
    examples = [f"{body.name}.x" for body in scene.bodies] + [f"{joint.name}.position" for joint in scene.joints]
    unclear = "".join(f"; columns {', '.join(names)} may all be {what}, map one" for what, names in
                      made.unclear.items())
    problem = "" if times or period else (
        'no column t; name it so, map it ("Time [s]" = { is = "t" }), or give the period of its rows '
        "(--period 0.01)")
    if not any(column.key not in ("t", *EFFORTS, *TARGETS) for column in made.columns):
        problem = (f"no column is one of scene {scene.name!r}, such as {', '.join(examples[:8])}; name them so, or "
                   f"give a mapping (--suggest writes one){unclear}")
    if problem:
        raise ArgumentError(f"{source.name}: {problem}. Its columns: {', '.join(source.columns[:20])}")


def _in_order(source: Source, clock: Column, numbers: dict[str, np.ndarray]
              ) -> tuple[np.ndarray, dict[str, np.ndarray], int, int]:
    """(increasing times, the numbers at these, cells without a value, rows put together).

    Rows of the same time are one row where no number of theirs differs by more than rounding. A row without a time has
    no place.
    """
    name = clock.names[0]
    placed = np.isfinite(numbers[name])
    rows = np.flatnonzero(placed)
    missing = int(len(placed) - len(rows)) + sum(
        int(np.isnan(values[rows]).sum()) for each, values in numbers.items() if each != name)
    if not len(rows):
        raise ArgumentError(f"{source.name}: column {name!r}: no row has a time")
    t = clock.scaled(numbers[name][rows])
    if t[0] < 0:
        raise ArgumentError(f"{source.name}: {source.place(int(rows[0]))}, column {name!r}: time {t[0]:.9g} s is "
                            "before the scene's start at 0; subtract it (offset)")
    if t[0] > EPOCH:
        raise ArgumentError(f"{source.name}: column {name!r}: times begin at {t[0]:.9g} s, not near the scene's start "
                            f"at 0; subtract the first one (offset = {-numbers[name][0]!r}), as --suggest does")
    starts = np.flatnonzero(np.diff(t, prepend=-np.inf) != 0)
    joined = {each: np.fmax.reduceat(values[rows], starts) for each, values in numbers.items()}
    lowest = {each: np.fmin.reduceat(values[rows], starts) for each, values in numbers.items()}
    wrong = [np.flatnonzero(joined[each] - lowest[each] > ROUNDING * np.fmax.reduce(np.abs(joined[each]), initial=0.0))
             for each in numbers]
    falls = np.flatnonzero(np.diff(t[starts]) < 0) + 1
    first = min((int(part[0]) for part in (*wrong, falls) if len(part)), default=None)
    if first is not None:
        at = int(starts[first])
        later = at + (0 if first in falls else 1)
        raise ArgumentError(f"{source.name}: {source.place(int(rows[later]))}, column {name!r}: time {t[later]:.9g} s "
                            f"does not follow {t[later - 1]:.9g} s; times have to increase")
    return t[starts], joined, missing, len(t) - len(starts)


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
        floor, unit, crooked = np.nan_to_num(floor), SI.get(first.dimension or (), ""), 0.0
        if not np.isfinite(values).all(axis=1).any():
            raise ArgumentError(f"{source.name}: columns {', '.join(name for name, _ in held.values())} have no row of "
                                "numbers; leave them out (ignore = true)")
        if key == "attitude":
            wanted = 4 if first.form == "q" else 9
            if len(order) != wanted:
                raise ArgumentError(f"{source.name}: the attitude of {owner!r} has {len(order)} of {wanted} columns; "
                                    "give all of them")
            values, crooked = _attitudes(source, values, owner)
            floor, order, unit = floor * (2.0 if wanted == 4 else 1.0), (0,), "rad"
        yield Group(key, owner, order, values, floor, first.row.frame, first.row.point,
                    any(each.row.wrap for _, each in held.values()), crooked, unit,
                    key == "joint_position" and unit == "rad", tuple(name for name, _ in held.values()),
                    frozenset().union(*(each.open for _, each in held.values())), row=first.row)


def _attitudes(source: Source, columns: np.ndarray, owner: str) -> tuple[np.ndarray, float]:
    """(T, 3, 3) rotations next to the recorded quaternions or matrices, and their largest distance from these."""
    if columns.shape[1] == 4:
        norms = np.linalg.norm(columns, axis=1)
        off = np.abs(norms - 1.0)
        R = rotation_from_quaternion(columns / np.where(norms > 0, norms, 1.0)[:, None])
    else:
        given = columns.reshape(-1, 3, 3)
        known = np.isfinite(given).all(axis=(1, 2))
        U, _, Vt = np.linalg.svd(given[known])
        R = np.full(given.shape, np.nan)
        R[known] = U @ Vt
        off = np.abs(given - R).max(axis=(1, 2)) + (np.linalg.det(R) < 0)
    off = np.where(np.isnan(off), 0.0, off)
    if off.max() > CROOKED:
        at = int(np.argmax(off))
        kind = "unit quaternion" if columns.shape[1] == 4 else "rotation matrix"
        raise ArgumentError(f"{source.name}: {source.place(at)}: the attitude of {owner!r} is no {kind}: off by "
                            f"{off[at]:.2g}")
    return R, float(off.max())


def digits(texts: Sequence[str]) -> tuple[int, int]:
    """(decimals, significant digits) to which numbers are printed; those of a constant are exact."""
    numbers = [number for text in texts if is_number(text) and (number := Decimal(text.strip())).is_finite()]
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
    """What the printed digits of times leave open, s: half of the last one.

    Times that are multiples of their usual distance, whether or not rows are missing, are held exactly by the digits.
    """
    decimals, significant = digits(source.texts(column.names[0]))
    if len(t) < 3:
        return 0.0
    if significant >= DOUBLE:  # times since 1970 are no exact doubles
        return float(np.spacing(abs(column.row.offset)) * abs(column.factor))
    last = 10.0**-decimals * abs(column.row.scale * column.factor)
    count = (t - t[0]) / float(np.median(np.diff(t)))
    even = np.abs(count - np.round(count)) * float(np.median(np.diff(t))) <= 1e-3 * last
    return 0.0 if even.all() else 0.5 * last
