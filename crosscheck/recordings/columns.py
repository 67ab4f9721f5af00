"""What the columns of a recording mean: by a mapping, by the names of a scene, or by the words in foreign names.

A name of the scene is a promise: SI units, world axes for velocities, body axes for angular velocities. What a foreign
name leaves open (`Column.open`) is decided by the data, and said.
"""

from __future__ import annotations

import dataclasses
import itertools
import math
import os
import re
import tomllib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Literal

import msgspec
import numpy as np

from crosscheck.errors import ArgumentError, unknown
from crosscheck.recordings.tables import Source
from crosscheck.scene.joints import JOINT_TYPES
from crosscheck.scene.model import Motor, Scene

Powers = tuple[int, ...]
LENGTH, ANGLE, TIME, FORCE, NUMBER = (1, 0, 0, 0), (0, 1, 0, 0), (0, 0, 1, 0), (0, 0, 0, 1), (0, 0, 0, 0)
UNITS: dict[str, tuple[Powers, float]] = {
    "m": (LENGTH, 1.0), "mm": (LENGTH, 1e-3), "cm": (LENGTH, 1e-2), "km": (LENGTH, 1e3), "in": (LENGTH, 0.0254),
    "ft": (LENGTH, 0.3048), "rad": (ANGLE, 1.0), "mrad": (ANGLE, 1e-3), "deg": (ANGLE, math.pi / 180),
    "rev": (ANGLE, math.tau), "s": (TIME, 1.0), "ms": (TIME, 1e-3), "us": (TIME, 1e-6), "ns": (TIME, 1e-9),
    "min": (TIME, 60.0), "h": (TIME, 3600.0), "N": (FORCE, 1.0), "kN": (FORCE, 1e3), "N m": ((1, 0, 0, 1), 1.0),
    "mN m": ((1, 0, 0, 1), 1e-3), "1": (NUMBER, 1.0), "g": ((1, 0, -2, 0), 9.80665),
    "rpm": ((0, 1, -1, 0), math.tau / 60)}
"""Units: the powers of length, angle, time and force, and the factor to SI."""

TORQUE: Powers = (1, 0, 0, 1)
SI: dict[Powers, str] = {LENGTH: "m", ANGLE: "rad", TIME: "s", (1, 0, -1, 0): "m/s", (0, 1, -1, 0): "rad/s", FORCE: "N",
                         TORQUE: "N m"}
VECTORS = (("", "x", "position", LENGTH), ("v", "v", "velocity", (1, 0, -1, 0)),
           ("w", "w", "angular_velocity", (0, 1, -1, 0)))
"""Vectors of a body: letter of a component, of all three, quantity and dimension."""

EFFORTS = ("effort", "effort_commanded", "effort_measured")
TARGETS = ("target", "target_velocity")
"""Recorded inputs of a joint: the torque or force that acts on it, and the set points of its servo."""


class Row(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A row of a mapping; scale, then offset, in the unit of the column."""

    what: str = msgspec.field(name="is", default="")
    unit: str = ""
    scale: float = 1.0
    offset: float = 0.0
    columns: tuple[str, ...] = ()
    order: Literal["wxyz", "xyzw"] | None = None
    frame: Literal["", "world", "body"] = ""
    point: tuple[float, float, float] | None = None
    wrap: bool = False
    ignore: bool = False
    between: Literal["", "hold", "linear", "spline"] = ""  # of an input, from one value to the next; "": not known
    side: Literal["", "motor", "link"] = ""  # of an effort: before or behind the friction of the joint
    gear: float = 1.0  # turns of the motor per turn of the joint, by which an effort of a motor is multiplied
    clock: str = ""  # the column of the times of an input, where it has its own


AS_IT_IS = Row()


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
    open: frozenset[str] = frozenset()  # of "unit", "frame" and "point": what its name leaves to the data

    def scaled(self, values: np.ndarray) -> np.ndarray:
        """Recorded numbers in SI units."""
        return np.asarray((self.row.scale * values + self.row.offset) * self.factor)


def factor_of(unit: str, dimension: Powers | None, where: str) -> float:
    """The factor of a unit to SI. Raises `ArgumentError` if it is unknown or of another kind."""
    text = unit.strip().replace("°", "deg").replace("·", " ").replace("Nm", "N m")
    top, _, below = UNIT_WORDS.get(text, text).partition("/")
    top, below = (UNIT_WORDS.get(part.strip(), part.strip()) for part in (top, below))
    match = re.fullmatch(r"(\w+?)\^?([12]?)", below) if below else None
    if top not in UNITS or (below and (match is None or match[1] not in UNITS)):
        raise ArgumentError(f"{where}: {unknown('unit', unit, [*UNITS, 'deg/s', 'mm/s', 'm/s^2'])}")
    powers, factor = UNITS[top]
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
    known = {"t": Column("t", "", (0,), TIME)}
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
        words, key = joint.kind.coordinates, ("position", "velocity")[rate]
        count = (3 if rate else 4) if words == ("ball",) else len(words)
        for k in range(count):
            word = words[min(k, len(words) - 1)]
            base = NUMBER if word == "ball" and not rate else LENGTH if word.startswith("slide") else ANGLE
            one = Column(f"joint_{key}", joint.name, (k,), tuple(a - rate * b for a, b in zip(base, TIME, strict=True)))
            for dot, end in itertools.product(". ", (f"{k}", f".{k}", f"[{k}]")):
                known[f"{joint.name}{dot}{key}{end}"] = one
                known.setdefault(f"{joint.name}{dot}{key}", dataclasses.replace(one, parts=tuple(range(count))))
        if not rate and joint.kind.has_one:
            word, size = ("torque", TORQUE) if base == ANGLE else ("force", FORCE)
            for each in EFFORTS:
                column = Column(each, joint.name, (0,), size)
                known |= {f"{joint.name}.{each}": column, f"{joint.name}.{each.replace('effort', word)}": column}
            if any(name == joint.name for name, _ in scene.servos.values()):
                known |= {f"{joint.name}.{each}": Column(each, joint.name, (0,), tuple(
                    a - k * b for a, b in zip(base, TIME, strict=True))) for k, each in enumerate(TARGETS)}
    return known


def split_unit(header: str) -> tuple[str, str, bool]:
    """(name, unit or "", whether it says wrap) of a header such as "elbow.position [deg, wrap]"."""
    match = re.fullmatch(r"\s*(.*?)\s*(?:[\[(]([^\])]*)[\])])?\s*(wrap)?\s*", header)
    if match is None or match[1] == "der" or (match[2] or "").strip().isdigit():  # "der(x)": Modelica's dx/dt
        return header.strip(), "", False
    unit, _, more = (match[2] or "").partition(",")
    return match[1], unit.strip(), "wrap" in (match[3] or "") or "wrap" in more


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
            if bool(rows[key].what) is rows[key].ignore:
                raise msgspec.ValidationError("either `is` or `ignore = true` is wanted")
        except msgspec.ValidationError as error:
            raise ArgumentError(f"{where}: column {key!r}: {error}; keys: {', '.join(Row.__struct_encode_fields__)}"
                                ) from None
    return rows


@dataclasses.dataclass
class Assigned:
    """What the columns of a table are."""

    columns: list[Column]
    ignored: list[str]
    suggested: dict[str, str]  # foreign names that were recognised, and what they are
    unclear: dict[str, list[str]]  # meanings that several foreign names may have, which none of them gets


def assigned(scene: Scene, source: Source, rows: Mapping[str, Row]) -> Assigned:
    """What the columns are: by the mapping, then by their names, then by the words in foreign names."""
    known = meanings(scene)
    made = Assigned([], list(source.columns), {}, {})
    taken: set[tuple[str, str, int]] = set()

    def take(key: str, row: Row, mapped: bool, leaves: frozenset[str] = frozenset()) -> bool:
        column = dataclasses.replace(_mapped(known, scene, source, key, row), open=leaves)
        places = {(column.key, column.owner, part) for part in column.parts}
        if not mapped and places & taken:
            return False
        taken.update(places)
        made.columns.append(column)
        made.ignored = [name for name in made.ignored if name not in column.names]
        return True

    for key, row in rows.items():
        if row.ignore and key not in source.columns:
            raise ArgumentError(f"{source.name}: column {key!r}: {unknown('column of the file', key, source.columns)}")
        if not row.ignore:
            take(key, row, True)
    sent = {key for key, row in rows.items() if row.ignore}
    for column in [name for name in made.ignored if name not in sent]:
        name, unit, wrap = split_unit(column)
        whole = re.sub(r"\[\d+\]$", "", column)
        if column in made.ignored and name in known:
            take(column, Row(name, unit, wrap=wrap), False)
        elif column in made.ignored and whole in known:
            take(whole, Row(whole), False)
    left = [name for name in made.ignored if name not in sent]
    found, made.unclear = recognised(scene, source, known, left)
    for column, (row, leaves) in found.items():
        if take(column, row, False, leaves):
            made.suggested[column] = row.what + f" times {row.scale:g}" * (row.scale != 1.0)
    return made


def recognised(scene: Scene, source: Source, known: Mapping[str, Column], columns: Sequence[str]
               ) -> tuple[dict[str, tuple[Row, frozenset[str]]], dict[str, list[str]]]:
    """(what the words in foreign names say, and what they leave open; meanings that several columns may have)."""
    stated = _stated(source, known, columns)
    says = {column: _said(scene, source, known, column) for column in columns if column not in stated}
    says |= {column: (Row(target), frozenset[str]()) for column, target in stated.items() if target}
    claims: dict[str, list[str]] = {}
    for column, (row, _) in says.items():
        if row.what in known:
            claims.setdefault(row.what, []).append(column)
    for what, names in claims.items():  # a quantity that has a column of its own needs no derivative
        claims[what] = [name for name in names if not name.startswith("der(")] or names
    made = {names[0]: says[names[0]] for what, names in claims.items() if len(names) == 1 or what == "t"}
    numbered: dict[str, dict[int, tuple[str, Row]]] = {"position": {}, "velocity": {}, "effort": {}, "control": {}}
    for column in columns:
        places, words = re.findall(r"\d+", split_unit(column)[0]), _words(column)[0]
        places = places or ["0"] * ({*words} <= CONTROLS and len(scene.motors) == 1)
        kinds = {what for what, spelled in WORDS.items() if {*words} & {*spelled}}
        settled = column in stated or column.startswith("der(")
        if settled or not places or says[column][0].what in known:
            continue
        if (own := {*words} - {*places}) and own <= CONTROLS:
            numbered["control"].setdefault(int(places[-1]), (column, says[column][0]))
        elif {*words} & {*EFFORT_WORDS, "qfrc"} and not {*words} & {*COMMANDED, *PASSIVE}:
            numbered["effort"].setdefault(int(places[-1]), (column, says[column][0]))
        elif kinds & {"rate", "pose"} and not {*words} & OTHERS:
            rate = "rate" in kinds or words[-1].endswith("dot")
            numbered["velocity" if rate else "position"].setdefault(int(places[-1]), (column, says[column][0]))
    for word, places_of in numbered.items():  # q1, q2, ... qd1, qd2, ...: all coordinates in the order of the scene
        names, first = _coordinates(scene, known, word), min(places_of, default=0)
        scales = [motor.factor for motor in scene.motors] if word == "control" else [1.0] * len(names)
        if sorted(places_of) == list(range(first, first + len(names))) and {*names} <= {*known}:
            for k, (what, scale) in enumerate(zip(names, scales, strict=True)):
                column, row = places_of[first + k]
                row = msgspec.structs.replace(row, what=what, scale=scale)
                made[column] = row, _leaves(scene, source, known[what], column, row)
    return made, {what: names for what, names in claims.items() if len(names) > 1 and what != "t"}


def _stated(source: Source, known: Mapping[str, Column], columns: Sequence[str]) -> dict[str, str]:
    """Columns of a joint state in one row, and what they are: name0 holds the joint whose angle is in position0."""
    made = {}
    for column in columns:
        match = re.fullmatch(r"(.*?)name[\[._]?(\d+)\]?", column)
        texts = source.words(column) if match else []
        if match is None or not texts:
            continue
        if len(texts) > 1:
            raise ArgumentError(f"{source.name}: column {column!r} names {texts[0]!r}, then {texts[1]!r}; one joint a "
                                "column is wanted")
        made[column] = ""
        for word, form in itertools.product(("position", "velocity", "effort"), ("{}", "[{}]", ".{}", "_{}")):
            name = f"{match[1]}{word}{form.format(match[2])}"
            if name in columns:
                target = f"{texts[0]}.{word}"
                made[name] = target if target in known else ""
    return made


def _words(column: str) -> tuple[list[str], str]:
    """(the words of a foreign name without those of its unit, the unit)."""
    name, unit, _ = split_unit(column)
    words = re.findall(r"[a-z]+|\d+", re.sub(r"([a-z])([A-Z])", r"\1 \2", name).lower())
    per = len(words) > 2 and words[-1] in ("s", "sec") and words[-2 - (words[-2] == "per")] in UNIT_WORDS
    last = len(words) - 1 - (per and 1 + (words[-2] == "per"))
    if last > 0 and words[last] in UNIT_WORDS and not name.endswith(".s"):  # such as "elbow_vel_deg_s"
        unit, words = unit or UNIT_WORDS[words[last]] + "/s" * per, words[:last]
    return words, "" if unit == "1" else unit


def _said(scene: Scene, source: Source, known: Mapping[str, Column], column: str) -> tuple[Row, frozenset[str]]:
    """What the words in a foreign name say, and what they leave open."""
    name, unit, _ = split_unit(column)
    if name.startswith("der("):  # the rate of a position, or no coordinate
        owner, _, what = _said(scene, source, known, name[4:-1])[0].what.rpartition(".")
        row = Row(f"{owner}.velocity", unit) if what == "position" else Row(unit=unit)
        return row, _leaves(scene, source, known[row.what], column, row) if row.what else frozenset()
    (words, unit), frame = _words(column), ""
    if (motor := _motor(scene, words)) and _control(motor) in known:
        return Row(_control(motor), unit, scale=motor.factor), frozenset()
    if {*words} & OTHERS:
        target = _input(scene, words)
        return Row(target if target in known else "", unit), frozenset()
    if len(words) > 2 and words[-2] in SIDES and {words[-3]} & {*WORDS["q"], *WORDS["rate"], *WORDS["pose"]} - {"w"}:
        frame = SIDES[words.pop(-2)]  # such as "root_lin_vel_w_x", in world axes
    if {"ang", "vel"} <= {*words}:
        words[words.index("ang")] = "angvel"
    says = {what for what, spelled in WORDS.items() if {*words} & {*spelled}}
    if source.angles and words[-1:] == ["u"]:  # OpenSim's speeds
        says.add("rate")
    target = _guess(scene, words, says)
    if target not in known or len(known[target].parts) != 1:
        return Row(unit=unit), frozenset()
    if target == "t":
        return clock(source, column, unit), frozenset()
    row = Row(target, unit, frame=frame if "v" in known[target].key else "")  # type: ignore[arg-type]
    return row, _leaves(scene, source, known[target], column, row)


def _leaves(scene: Scene, source: Source, meaning: Column, column: str, row: Row) -> frozenset[str]:
    """What a foreign name leaves open: unit, frame of a rate, point of a body."""
    angle = meaning.dimension is not None and meaning.dimension[1] == 1
    leaves = {"unit"} if angle and not _unit(source, [column], meaning, row) else set()
    if meaning.key in ("velocity", "angular_velocity") and not row.frame:
        leaves.add("frame")
    body = next((body for body in scene.bodies if body.name == meaning.owner), None)
    if meaning.key in ("position", "velocity") and body is not None and body.origin.any() and "com" not in _words(
            column)[0]:
        leaves.add("point")
    return frozenset(leaves)


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
    unit = _unit(source, names, meaning, row)
    return dataclasses.replace(meaning, names=tuple(names), parts=parts, form=form, row=row,
                               factor=factor_of(unit, meaning.dimension, where) if unit else 1.0)


def _unit(source: Source, names: Sequence[str], meaning: Column, row: Row) -> str:
    """The unit that a mapping, a header, the cells or a preamble say; "" if none does."""
    says = row.unit or (split_unit(names[0])[1] if len(names) == 1 else "") or source.units.get(names[0], "")
    angle = meaning.dimension is not None and meaning.dimension[1] == 1 and not any(meaning.dimension[::3])
    return says or (source.angles + "/s" * -meaning.dimension[2] if source.angles and angle and meaning.dimension
                    else "")


def _motor(scene: Scene, words: Sequence[str]) -> Motor | None:
    """The actuator that a column is named after, with words of a control or an effort at most; None for none."""
    found = []
    for motor in scene.motors:
        own = re.findall(r"[a-z]+|\d+", re.sub(r"([a-z])([A-Z])", r"\1 \2", motor.name).lower())
        at = next((k for k in range(len(words)) if [*words[k:k + len(own)]] == own), None)
        rest = {*words[:at], *words[at + len(own):]} if at is not None else set()
        allowed = CONTROLS | (EFFORT_WORDS if motor.control == "effort" else set())
        if at is not None and (rest or motor.name != motor.joint) and rest <= allowed:
            found.append((len(own), motor))
    return max(found, key=lambda pair: pair[0])[1] if found else None


def _control(motor: Motor) -> str:
    """What the control of an actuator is to its joint."""
    return f"{motor.joint}.{'effort_commanded' if motor.control == 'effort' else motor.control}"


def _input(scene: Scene, words: Sequence[str]) -> str:
    """The input that a column with these words probably is; "" for none. Numbers are places among the joints."""
    said, joints = {*words}, [joint for joint in scene.joints if joint.kind.has_one]
    named = [joint.name for joint in sorted(joints, key=lambda joint: len(joint.name))
             if re.sub(r"[^a-z0-9]", "", joint.name.lower()) in "".join(words)]
    commanded, efforts = bool(said & COMMANDED), bool(said & EFFORT_WORDS)
    if not named or said & {"error", "limit", "max", "min"}:
        return ""
    if efforts:
        kind = "_commanded" if commanded else "_measured" if said & {"measured", "meas", "sensed", "actual"} else ""
        return f"{named[-1]}.effort{kind}"
    rate = bool(said & {*WORDS["rate"]})
    other = said & {"acc", "accel", "acceleration", "current"}
    return f"{named[-1]}.{TARGETS[rate]}" if commanded and not other else ""


COMMANDED = {"cmd", "command", "commanded", "target", "desired", "des", "ref", "reference", "setpoint", "computed"}
EFFORT_WORDS = {"effort", "torque", "tau", "force", "moment", "efforts", "torques", "forces"}
PASSIVE = {"bias", "passive", "constraint", "smooth", "inverse", "gravcomp", "fluid", "spring", "damper"}
CONTROLS = {"ctrl", "control", "controls", "u", "input", "actuator", "actuators", *COMMANDED}

WORDS = {
    "t": ("t", "time", "timestamp", "stamp", "tout", "clock", "sec", "secs", "seconds"),
    "rate": ("vel", "velocity", "velocities", "rate", "speed", "qd", "qdot", "dq", "qvel", "dtheta", "dot", "twist",
             "linear", "w", "omega", "gyro", "angvel", "angular"),
    "spin": ("omega", "gyro", "angvel", "angular"), "q": ("quat", "quaternion", "orientation", "attitude", "rotation"),
    "pose": ("pos", "position", "angle", "theta", "q", "qpos", "displacement", "slide", "phi", "joint", "coordinate",
             "value", "positions")}
"""Words of foreign names, by what they say."""

OTHERS = {*COMMANDED, *EFFORT_WORDS, "current", "error", "acc", "accel", "acceleration", "temperature", "voltage",
          "qfrc", "ctrl"}
"""Words of foreign names of what is no coordinate and no rate of the motion."""

SIDES = {"w": "world", "b": "body"}
"""Letters between a quantity and its axis, by the frame that they say."""

UNIT_WORDS = {"degrees": "deg", "degree": "deg", "radians": "rad", "radian": "rad", "meters": "m", "metres": "m",
              "sec": "s", "secs": "s", "seconds": "s", "msec": "ms", "usec": "us", "nsec": "ns", "dps": "deg/s"} | {
    unit: unit for unit in ("deg", "rad", "mm", "cm", "ms", "us", "ns", "rpm", "m", "s")}

EPOCH = 1e8
"""Times (s) from which on zero is no start of a scene: three years."""


def clock(source: Source, column: str, unit: str) -> Row:
    """The row of a column of times, with unit and offset; those since 1970 say their unit by their size."""
    first = float(source.load([column], None)[column][0])
    unit = unit or source.units.get(column, "")
    if not unit and first > EPOCH:
        unit = next(name for name, size in (("ns", 1e17), ("us", 1e14), ("ms", 1e11), ("s", 0.0)) if first > size)
    since = first * UNITS.get(UNIT_WORDS.get(unit, unit), (TIME, 1.0))[1] > EPOCH
    return Row("t", unit, offset=-first if since else 0.0)


def _coordinates(scene: Scene, known: Mapping[str, Column], word: str) -> list[str]:
    """Names of all coordinates, rates or efforts, body after body: MuJoCo's qpos and qvel; quaternions have the scalar
    first. Controls are those of the actuators."""
    if word == "control":
        return [_control(motor) for motor in scene.motors]
    names = []
    free = {"position": ("x", "y", "z", "qw", "qx", "qy", "qz"), "velocity": ("vx", "vy", "vz", "wx", "wy", "wz")}
    for body, owner in enumerate(scene.bodies):
        joints = [joint for joint in scene.joints if joint.child == body]
        names += [f"{owner.name}.{part}" for part in free.get(word, ()) if not joints]
        for name in (f"{joint.name}.{word}" for joint in joints):
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
        joint, own = joints[-1], ""
        if re.sub(r"[^a-z0-9]", "", joint.lower()) in "".join(words[:-1]):
            own = words[-1]  # "s", "v" and "a", of Modelica
        rate = "rate" in says or own == "v" or words[-1].endswith("dot")
        return "" if own == "a" else f"{joint}.{'velocity' if rate else 'position'}"
    if not bodies or axis is None:
        return ""
    letter = "" if len(axis[1]) > 1 else "q" if "q" in says else "w" if "spin" in says else (
        "v" if says & {"rate"} and words[-1] != "w" else "")
    return f"{bodies[-1]}.{letter}{axis[1]}"
