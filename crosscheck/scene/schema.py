"""The keys, types and shapes of a scene file. `crosscheck.scene.checks` checks values and their consistency."""

from __future__ import annotations

import difflib
import math
import re
from collections.abc import Collection, Iterable, Mapping
from typing import Any, Literal, get_args

import msgspec

from crosscheck.scene.joints import JOINT_TYPES, JointType, joint_types
from crosscheck.scene.laws import SIZES

VERSIONS = (1, 2, 3)
"""The versions of the scene format this package reads."""

KEYS: dict[int, dict[str, tuple[str, ...]]] = {
    2: {"bodies": ("origin",),
        "joints": ("reference_attitude", "position", "velocity", "armature", "damping", "stiffness", "rest_position",
                   "mimic", "drive", "radius"), "": ("left_out",)},
    3: {"joints": ("dry_friction", "limits"), "": ("shapes", "monitors", "sites", "sensors", "published", "motors")}}
"""Keys that each later version of the format brought, by table."""

TYPES: dict[int, dict[str, tuple[str, ...]]] = {
    2: {"forces": ("joint_torque", "joint_force"),
        "joints": joint_types("slips")},
    3: {"forces": ("servo",)}}
"""Types that each later version brought, by table."""

FUNCTIONS = {"polynomial": 2, "sine": 2, "spline": 2, "hold": 3, "linear": 3}
"""The version that brought each function of time."""

LARGEST = 1e100
"""Largest magnitude of a number in a scene: a product of three such numbers is still a finite double."""

MOST_LISTED = 60
"""Largest number of names in one message; there are forty built-in scenes."""

Content = dict[str, Any]
"""A scene file, or one of its tables, as read from TOML or JSON, before any check."""

Vector = tuple[float, float, float]
Matrix = tuple[Vector, Vector, Vector]
Quaternion = tuple[float, float, float, float]


class EntryError(Exception):
    """One entry of a scene file is wrong: where, what is wrong, and what to write instead."""

    def __init__(self, entry: str, problem: str, mend: str) -> None:
        super().__init__(f"{entry}: {problem}; {mend}")
        self.entry, self.problem, self.mend = entry, problem, mend


class BodyEntry(msgspec.Struct, frozen=True):
    """One of [[bodies]]."""

    name: str
    mass: float
    inertia: Matrix
    attitude: Quaternion | None = None
    angular_velocity: Vector | None = None
    position: Vector | None = None
    velocity: Vector | None = None
    origin: Vector | None = None


class MimicEntry(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The key `mimic` of one of [[joints]]."""

    joint: str
    ratio: float
    offset: float = 0.0


class PolynomialEntry(msgspec.Struct, frozen=True, forbid_unknown_fields=True, tag_field="type", tag="polynomial"):
    """A function of time: sum of coefficients[k] t^k."""

    coefficients: list[float]


class SineEntry(msgspec.Struct, frozen=True, forbid_unknown_fields=True, tag_field="type", tag="sine"):
    """A function of time: offset + sum of amplitude sin(angular frequency t + phase)."""

    terms: list[Vector]
    offset: float = 0.0


class SplineEntry(msgspec.Struct, frozen=True, forbid_unknown_fields=True, tag_field="type", tag="spline"):
    """A function of time: the cubic spline through a table."""

    times: list[float]
    values: list[float]


class HoldEntry(SplineEntry, frozen=True, tag="hold"):
    """A function of time: each value until the next time."""


class LinearEntry(SplineEntry, frozen=True, tag="linear"):
    """A function of time: straight between the values."""


FunctionEntry = PolynomialEntry | SineEntry | SplineEntry | HoldEntry | LinearEntry
Timed = float | PolynomialEntry | SineEntry | SplineEntry | HoldEntry | LinearEntry
TimedVector = tuple[Timed, Timed, Timed]


class DryFrictionEntry(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The key `dry_friction` of one of [[joints]], where the static value differs from the sliding one."""

    sliding: float
    static: float | None = None


class LimitsEntry(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The key `limits` of one of [[joints]]."""

    lower: float | None = None
    upper: float | None = None
    restitution: float | None = None
    stiffness: float | None = None
    damping: float | None = None


class JointEntry(msgspec.Struct, frozen=True):
    """One of [[joints]]."""

    name: str
    type: str
    parent: str
    child: str
    parent_anchor: Vector
    child_anchor: Vector
    parent_axis: Vector | None = None
    child_axis: Vector | None = None
    length: float | None = None
    radius: float | None = None
    reference_attitude: Quaternion | None = None
    position: float | list[float] | None = None
    velocity: float | list[float] | None = None
    armature: float | list[float] | None = None
    damping: float | list[float] | None = None
    stiffness: float | list[float] | None = None
    rest_position: float | list[float] | None = None
    mimic: MimicEntry | None = None
    drive: FunctionEntry | None = None
    dry_friction: float | DryFrictionEntry | list[float | DryFrictionEntry] | None = None
    limits: LimitsEntry | list[LimitsEntry] | None = None

    @property
    def kind(self) -> JointType:
        """Its entry in the table of types."""
        return JOINT_TYPES[self.type]


class LinearSpringEntry(msgspec.Struct, frozen=True, tag_field="type", tag="linear_spring"):
    """One of [[forces]]: spring-damper between two points."""

    parent: str
    child: str
    parent_point: Vector
    child_point: Vector
    stiffness: float
    free_length: float
    damping: float = 0.0


class TorsionalSpringEntry(msgspec.Struct, frozen=True, tag_field="type", tag="torsional_spring"):
    """One of [[forces]]: spring-damper about the axis of a joint."""

    joint: str
    stiffness: float
    rest_angle: Timed
    damping: float = 0.0


class JointTorqueEntry(msgspec.Struct, frozen=True, tag_field="type", tag="joint_torque"):
    """One of [[forces]]: torque about the axis of a joint on its child, the opposite on its parent."""

    joint: str
    torque: Timed


class JointForceEntry(msgspec.Struct, frozen=True, tag_field="type", tag="joint_force"):
    """One of [[forces]]: force along the axis of a slide on its child, the opposite on its parent."""

    joint: str
    force: Timed


class ConstantForceEntry(msgspec.Struct, frozen=True, tag_field="type", tag="constant_force"):
    """One of [[forces]]: force at a point of a body, its components constant or functions of time."""

    child: str
    child_point: Vector
    frame: Literal["world", "body"]
    force: TimedVector


class ConstantTorqueEntry(msgspec.Struct, frozen=True, tag_field="type", tag="constant_torque"):
    """One of [[forces]]: torque on a body, its components constant or functions of time."""

    child: str
    frame: Literal["world", "body"]
    torque: TimedVector


class ServoEntry(msgspec.Struct, frozen=True, tag_field="type", tag="servo"):
    """One of [[forces]]: a controller of a revolute or prismatic joint."""

    joint: str
    target: Timed = 0.0
    target_velocity: Timed | None = None
    feedforward: Timed = 0.0
    proportional: float = 0.0
    derivative: float = 0.0
    effort_limit: float | tuple[float, float] | None = None
    no_load_speed: float | None = None
    period: float | None = None
    delay: int = 0


ForceEntry = (LinearSpringEntry | TorsionalSpringEntry | ConstantForceEntry | ConstantTorqueEntry | JointTorqueEntry
              | JointForceEntry | ServoEntry)
FORCE_ENTRIES = {str(cls.__struct_config__.tag): cls for cls in get_args(ForceEntry)}


class ShapeEntry(msgspec.Struct, frozen=True):
    """One of [[shapes]]."""

    name: str
    body: str
    type: str
    size: list[float] = []
    position: Vector = (0.0, 0.0, 0.0)
    attitude: Quaternion = (1.0, 0.0, 0.0, 0.0)
    file: str | None = None
    points: list[Vector] = []


class TouchEntry(msgspec.Struct, frozen=True, tag_field="type", tag="touch"):
    """One of [[monitors]]: two shapes closer than a margin."""

    shapes: tuple[str, str]
    margin: float = 0.0


class RangeEntry(msgspec.Struct, frozen=True, tag_field="type", tag="range"):
    """One of [[monitors]]: the coordinate of a joint leaves its range."""

    joint: str
    lower: float | None = None
    upper: float | None = None


class SpeedEntry(RangeEntry, frozen=True, tag_field="type", tag="speed"):
    """One of [[monitors]]: the rate of a joint leaves its range."""


class EffortEntry(RangeEntry, frozen=True, tag_field="type", tag="effort"):
    """One of [[monitors]]: what the actuator of a joint gives leaves its range."""


MonitorEntry = TouchEntry | RangeEntry | SpeedEntry | EffortEntry
MONITOR_ENTRIES = {str(cls.__struct_config__.tag): cls for cls in get_args(MonitorEntry)}
class SiteEntry(msgspec.Struct, frozen=True):
    """One of [[sites]]."""

    name: str
    body: str
    position: Vector = (0.0, 0.0, 0.0)
    attitude: Quaternion = (1.0, 0.0, 0.0, 0.0)


class SensorEntry(msgspec.Struct, frozen=True):
    """One of [[sensors]]; `crosscheck.scene.sensors` has the types."""

    name: str
    type: str
    site: str | None = None
    joint: str | None = None
    frame: Literal["site", "world"] | None = None


class PublishedEntry(msgspec.Struct, frozen=True):
    """One of [[published]]: a figure that somebody else printed."""

    source: str
    quantity: Literal["position", "attitude", "velocity", "angular_velocity", "energy", "joint_position",
                      "joint_velocity", "eigenvalue"]
    value: float | list[float]
    error: float
    body: str | None = None
    joint: str | None = None
    time: float | None = None


class SceneEntry(msgspec.Struct, frozen=True):
    """A whole scene file."""

    schema: int
    name: str
    gravity: Vector
    duration: float
    samples: int
    bodies: list[BodyEntry]
    joints: list[JointEntry] = []
    forces: list[ForceEntry] = []
    description: str = ""
    source: str = ""
    tags: list[str] = []
    assemble: bool = False
    left_out: list[tuple[str, str, float | str | tuple[float | str, ...]]] = []
    shapes: list[ShapeEntry] = []
    monitors: list[MonitorEntry] = []
    sites: list[SiteEntry] = []
    sensors: list[SensorEntry] = []
    published: list[PublishedEntry] = []
    motors: list[tuple[str, str, Literal["effort", "target", "target_velocity"], float]] = []


ENTRIES: dict[str, Any] = {"bodies": BodyEntry, "joints": JointEntry, "shapes": ShapeEntry, "sites": SiteEntry,
                            "sensors": SensorEntry, "published": PublishedEntry}
"""The tables of a scene file whose entries all have the same keys."""

_VECTOR_METRES = "three numbers in m"
EXPECTED = {
    "schema": "2", "name": 'a name in quotes', "description": "one line in quotes", "source": "text in quotes",
    "tags": 'a list of words, ["smooth"]', "gravity": "three numbers in m/s^2, [0.0, 0.0, -9.81]",
    "duration": "a number of seconds > 0", "samples": "a whole number >= 2", "assemble": "true or false",
    "bodies": "at least one [[bodies]] table", "joints": "[[joints]] tables", "forces": "[[forces]] tables",
    "published": "[[published]] tables", "quantity": "what it is, as position or joint_position",
    "value": "a number, or a list of numbers", "error": "a number >= 0, what the printed digits allow",
    "time": "a number of seconds within the duration",
    "sites": "[[sites]] tables", "sensors": "[[sensors]] tables", "body": '"ground" or the name of a body',
    "site": "the name of one of [[sites]]",
    "mass": "a number of kg > 0, or 0 of a frame between joints", "inertia": "three rows of three numbers in kg m^2",
    "attitude": "a quaternion of four numbers w, x, y, z", "angular_velocity": "three numbers in rad/s, body axes",
    "position": _VECTOR_METRES, "origin": _VECTOR_METRES, "velocity": "three numbers in m/s",
    "type": "one of the types this table can have", "parent": '"ground" or the name of a body',
    "child": "the name of a body", "parent_anchor": _VECTOR_METRES, "child_anchor": _VECTOR_METRES,
    "parent_axis": "three numbers, not all zero", "child_axis": "three numbers, not all zero",
    "length": "a number of m > 0", "radius": "a number of m > 0",
    "parent_point": _VECTOR_METRES, "child_point": _VECTOR_METRES,
    "stiffness": "a number >= 0 in N/m (N m/rad for a torsional spring)", "damping": "a number >= 0 in SI units",
    "free_length": "a number of m >= 0", "rest_angle": "a number or a function of time in rad",
    "joint": "the name of a joint",
    "reference_attitude": "a quaternion of four numbers w, x, y, z", "armature": "a number >= 0 in kg m^2 or kg",
    "rest_position": "a number of rad or m", "mimic": 'a table, { joint = "motor", ratio = 3.0 }',
    "ratio": "a number", "offset": "a number of rad or m",
    "left_out": 'a list of [where, what, value], as ["elbow", "dry friction of joint", 0.3]',
    "motors": 'a list of [name, joint, "effort", "target" or "target_velocity", factor of the control]',
    "frame": '"world" or "body"', "force": "three numbers or functions of time in N (one along a joint)",
    "torque": "three numbers or functions of time in N m (one about a joint)", "coefficients": "a list of numbers",
    "terms": "rows of amplitude, angular frequency, phase", "times": "a list of s", "values": "a list of numbers",
    "drive": 'a function of time, { type = "sine", terms = [[0.5, 3.0, 0.0]] }',
    "dry_friction": "a number >= 0 in N m or N, or { sliding = 0.5, static = 0.7 }",
    "limits": "a table, { lower = -1.0, upper = 2.0 }, in rad or m", "sliding": "a number >= 0 in N m or N",
    "static": "a number not below the sliding one", "lower": "a number", "upper": "a number",
    "restitution": "a number from 0 to 1", "target": "a number or a function of time in rad or m",
    "target_velocity": "a number or a function of time in rad/s or m/s",
    "feedforward": "a number or a function of time in N m or N", "proportional": "a number >= 0 in N m/rad or N/m",
    "derivative": "a number >= 0 in N m s/rad or N s/m", "effort_limit": "a number > 0 in N m or N, or [lower, upper]",
    "no_load_speed": "a number > 0 in rad/s or m/s", "period": "a number of s > 0", "delay": "a whole number >= 0",
    "shapes": "[[shapes]] tables (of a monitor: the names of two)", "monitors": "[[monitors]] tables",
    "margin": "a number of m >= 0",
    "size": "a list of numbers of m > 0", "file": "the name of a mesh file",
    "points": "rows of three numbers in m",
    "joints position": "a number of rad or m, or a list of the joint's coordinates",
    "joints velocity": "a number of rad/s or m/s, or a list of the joint's rates", "sensors frame": '"site" or "world"',
}


def expected(table: object, key: str) -> str:
    """What a key of a table takes, for messages and the reference."""
    return EXPECTED.get(f"{table} {key}", EXPECTED[key])


_PLAIN_TYPES = {"float": "a number", "int": "a whole number", "str": "text", "bool": "true or false",
                "array": "a list", "object": "a table", "null": "nothing"}


def listed(names: Iterable[str]) -> str:
    """Names in quotes with commas, for a message; only the first MOST_LISTED."""
    names = list(names)
    more = f" and {len(names) - MOST_LISTED} more" if len(names) > MOST_LISTED else ""
    return ", ".join(f'"{name}"' for name in names[:MOST_LISTED]) + more


def check_named(entry: str, what: str, name: str | None, known: Collection[str]) -> None:
    """Raise `EntryError` unless the scene has a body, joint, site or shape of this name."""
    if name not in known:
        raise EntryError(entry, f'no {what} is named "{name}"', f"{nearest(str(name), known)}write one of "
                         f"{listed(known) or '(the scene has none)'}")


def check_not_negative(entry: str, value: float, unit: str = "", number: str = "a number") -> None:
    """Raise `EntryError` for a value below 0."""
    if value < 0:
        raise EntryError(entry, f"{value:g}{unit and ' ' + unit} is negative",
                         f"write {number}{unit and ' of ' + unit} >= 0")


def check_positive(entry: str, value: float, unit: str = "", smallest: float = 0.0, instead: str = "") -> None:
    """Raise `EntryError` for a value that is not above 0, or below `smallest`."""
    if value <= 0:
        raise EntryError(entry, f"{value:g}{unit and ' ' + unit} is not positive",
                         f"write a number{unit and ' of ' + unit} > 0{instead}")
    if value < smallest:
        raise EntryError(entry, f"{value:g} {unit} is out of range", f"write a number above {smallest:g}")


def nearest(word: str, known: Iterable[str]) -> str:
    """'did you mean "mass"? ' if a known word is similar to `word`, otherwise ''."""
    close = difflib.get_close_matches(word, list(known), n=1)
    return f'did you mean "{close[0]}"? ' if close else ""


def entry_name(data: Any, path: Iterable[str | int]) -> str:
    """The place of a value in words: ("bodies", 1, "inertia") becomes `bodies[1] "lower": inertia`."""
    text, node = "", data
    for part in path:
        if isinstance(part, int):
            text += f"[{part}]"
        else:
            text += (": " if text.endswith(('"', "]")) else "") + part
        try:
            node = node[part]
        except (KeyError, IndexError, TypeError):
            node = None
        if isinstance(part, int) and isinstance(node, dict) and isinstance(node.get("name"), str):
            text += f' "{node["name"]}"'
    return text or "the file"


def decode(data: Content) -> SceneEntry:
    """The typed content of a scene file from its plain mapping; raises `EntryError` for the first error found."""
    _check_version(data)
    _check_keys(data)
    _check_finite(data, data, ())
    try:
        return msgspec.convert(data, SceneEntry, strict=True)
    except msgspec.ValidationError as error:
        raise _translated(data, str(error)) from None


def _check_version(data: Content) -> None:
    if "schema" not in data:
        raise EntryError("schema", "missing", "add schema = 1 at the top of the file")
    if type(data["schema"]) is not int or data["schema"] not in VERSIONS:
        raise EntryError("schema", f"version {data['schema']!r} is not known here", "write schema = 1")
    for version in VERSIONS[data["schema"]:]:
        if (path := _of_version(data, version)) is not None:
            brought = KEYS[version].get("" if len(path) == 1 else str(path[0]), ())
            what = "is a key of" if path[-1] in brought else "is of"
            raise EntryError(entry_name(data, path), f"{what} version {version}",
                             f"write schema = {version} at the top")


def _of_version(data: Content, version: int) -> tuple[str | int, ...] | None:
    """The place of the first key, type or function of time that this version brought, or None."""
    for key in KEYS[version].get("", ()):
        if key in data:
            return (key,)
    for group in ("joints", "forces"):
        tables = data.get(group, [])
        for index, table in enumerate(tables if isinstance(tables, list) else []):
            for key, value in table.items() if isinstance(table, dict) else ():
                parts = value if isinstance(value, list) else [value]
                brought = any(isinstance(part, dict) and FUNCTIONS.get(str(part.get("type")), 2) == version
                              for part in parts)
                if (key in KEYS[version].get(group, ()) or brought
                        or (key == "type" and value in TYPES[version].get(group, ()))):
                    return group, index, key
    return None


def _check_keys(data: Content) -> None:
    """Refuse unknown keys before msgspec does, so that a misspelt key is not reported as a missing one."""
    _check_table_keys(data, (), SceneEntry.__struct_fields__)
    typed: dict[str, Mapping[str, Any]] = {"forces": FORCE_ENTRIES, "monitors": MONITOR_ENTRIES}
    for group in ("bodies", "joints", "forces", "shapes", "monitors", "sites", "sensors", "published"):
        tables = data.get(group, [])
        for index, table in enumerate(tables if isinstance(tables, list) else []):
            if not isinstance(table, dict):
                continue
            types = tuple(typed.get(group, JOINT_TYPES if group == "joints" else SIZES if group == "shapes" else ()))
            kind = table.get("type")
            if types and (not isinstance(kind, str) or kind not in types):
                entry = entry_name(data, (group, index, "type"))
                if kind is None:
                    raise EntryError(entry, "missing", f"add type = one of {listed(types)}")
                hint = nearest(kind, types) if isinstance(kind, str) else ""
                raise EntryError(entry, f"unknown type {kind!r}", f"{hint}write one of {listed(types)}")
            if group in typed:
                allowed = ("type", *typed[group][str(kind)].__struct_fields__)
            else:
                allowed = ENTRIES[group].__struct_fields__
            _check_table_keys(data, (group, index), allowed)


def _check_table_keys(data: Any, path: tuple[str | int, ...], allowed: tuple[str, ...]) -> None:
    table = data
    for part in path:
        table = table[part]
    for key in table:
        if key not in allowed:
            raise EntryError(entry_name(data, (*path, key)), f'unknown key "{key}"',
                             f"{nearest(key, allowed)}the keys known here are {listed(allowed)}")


def _check_finite(data: object, node: object, path: tuple[str | int, ...]) -> None:
    if isinstance(node, float) and not math.isfinite(node):
        raise EntryError(entry_name(data, path), f"{node} is not a finite number", "write a finite number")
    if isinstance(node, int | float) and not isinstance(node, bool) and abs(node) > LARGEST:
        number = f"{node:g} is" if isinstance(node, float) else "number"
        raise EntryError(entry_name(data, path), f"{number} out of range", f"write a number below {LARGEST:g}")
    if isinstance(node, dict | list):
        for key, value in node.items() if isinstance(node, dict) else enumerate(node):
            _check_finite(data, value, (*path, key))


def _translated(data: object, message: str) -> EntryError:
    """An `EntryError` from a message of msgspec, such as "Expected `float`, got `str` - at `$.bodies[0].mass`"."""
    problem, _, where = message.partition(" - at `$")
    path: tuple[str | int, ...] = tuple(int(index) if index else name
                                        for name, index in re.findall(r"\.(\w+)|\[(\d+)\]", where))
    missing = re.search(r"missing required field `(\w+)`", problem)
    if missing:
        key = missing.group(1)
        return EntryError(entry_name(data, (*path, key)), "missing", f"add {key}: {expected([*path, ''][0], key)}")
    keys = [part for part in path if isinstance(part, str)]
    problem = re.sub(r"`(\w+)`", lambda match: _PLAIN_TYPES.get(match.group(1), match.group(1)), problem)
    return EntryError(entry_name(data, path), problem[:1].lower() + problem[1:],
                      f"write {expected(keys[0], keys[-1])}" if keys else "write a table of keys")
