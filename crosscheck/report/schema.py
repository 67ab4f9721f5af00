"""The shape of results.json, checked when a report is read; docs/results-schema.md describes it in words.

SI units, angles in rad; null where there is no figure. Keys that are not listed are kept and passed on: a newer run may
have more of them. `exports.SCHEMA` is the version.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any, Literal

import msgspec

from crosscheck.errors import ArgumentError
from crosscheck.report.exports import SCHEMA

Number = float | None
Outcome = Literal["pass", "known", "fail", "error", "unjudged", "unsupported"]


class Machine(msgspec.Struct):
    """The machine a run was made on."""

    system: str
    processor: str
    cores: int | None


class Meta(msgspec.Struct):
    """Where the results come from."""

    time: str  # UTC
    engines: dict[str, str]  # name to version
    packages: dict[str, str]
    python: str
    machine: Machine
    commit: str | None
    profile: str
    jobs: int
    command: str
    seconds: float  # of the whole run
    calibration: dict[str, Any] | None = None  # the kernel that speeds are compared with, where they were measured


class Truth(msgspec.Struct):
    """Where the truth of a scene comes from, and how far to trust it."""

    source: str
    second_source: str
    disagreement: float
    allowed: float
    amplification: float
    horizon: float  # s


class Plan(msgspec.Struct):
    """Steps (s) of the runs of a scene by order of the method."""

    window: float  # s, of the order study
    steps: dict[str, float]
    ladders: dict[str, list[float]]
    rtol: float
    practical: Number
    samples: int
    duration: Number = None  # s
    budgeted: bool = False


class Recommended(msgspec.Struct):
    """Which runs to trust, the fastest first, with the figures of the first."""

    runs: list[str]
    step: Number
    rtol: Number
    error: float  # m
    until: Number  # s
    seconds: Number  # of stepping per simulated second
    why: str


class Scene(msgspec.Struct):
    """A scene whose truth is known, or that has none."""

    name: str
    title: str
    description: str
    source: str
    hash: str
    bodies: list[str]
    duration: float  # s
    plan: Plan
    truth: Truth | None
    scales: dict[str, Any]  # sizes of the scene that bounds use
    trust: str
    recommended: Recommended | None
    no_truth: str = ""
    disputed: bool = False
    rounding: dict[str, Any] | None = None


class FailedScene(msgspec.Struct):
    """A scene whose truth could not be made."""

    name: str
    failure: str
    details: str
    plan: None
    trust: str
    recommended: None


class Finding(msgspec.Struct):
    """One judged figure and its bound."""

    kind: str
    status: Literal["ok", "fail", "known", "unjudged"]
    value: Number
    bound: Number
    unit: str
    why: str
    detail: str


class Errors(msgspec.Struct):
    """Errors of one quantity against truth, the worst body."""

    unit: str
    end: Number
    max: Number
    time: Number  # s, of the largest
    body: str
    judged: Number = None
    bound: Number = None
    why: str = ""


class Level(msgspec.Struct):
    """Largest constraint row at one level."""

    max: Number
    held: bool
    unit: str


class Order(msgspec.Struct):
    """Observed order of one quantity."""

    observed: Number
    documented: int
    used: int
    pairs: list[Number]
    note: str


class Rung(msgspec.Struct):
    """One step, or tolerance, of the order study."""

    step: Number
    rtol: Number
    errors: dict[str, Number]
    end: dict[str, Number]
    wall_time: Number  # s
    steps: int | None
    guide: Number = None  # m, the documented slope through the coarsest rung
    message: str = ""


class Point(msgspec.Struct):
    """One step, or tolerance, of the timing study."""

    step: Number
    rtol: Number
    wall_time: float  # s, median
    steps: int
    us_per_step: float
    seconds_per_second: float
    seconds_deviation: float
    error: Number  # m, at the end
    main: bool


class Record(msgspec.Struct):
    """One run."""

    scene: str
    engine: str
    version: str
    method: str
    form: str | None
    step: Number  # s
    rtol: Number
    documented_order: int | None
    command: str
    label: str
    default_form: bool
    own_environment: bool
    practical: bool
    outcome: Outcome
    message: str
    status: str
    findings: list[Finding]
    judged_until: Number  # s
    duration: Number  # s
    errors: dict[str, Errors]
    levels: dict[str, Level]
    energy_error: Number
    momentum_error: Number  # kg m^2/s
    orthogonality: Number
    steps: int | None
    wall_time: Number  # s
    us_per_step: Number
    seconds_per_second: Number
    seconds_deviation: Number
    speed: dict[str, Any]
    orders: dict[str, Order]
    ladder: list[Rung]
    timing: list[Point]
    word: str
    partly: bool
    worst: Finding | None
    ladder_cut: str = ""


class Change(msgspec.Struct):
    """What differs from the run before; empty texts where it is about more than one scene, engine or method."""

    kind: str
    scene: str
    engine: str
    method: str
    quantity: str
    before: float | str | None
    after: float | str | None
    text: str
    bad: bool = False  # whether it is a finding, or only worth knowing


class Support(msgspec.Struct):
    """Which methods of an engine can run a scene in one form."""

    scene: str
    engine: str
    form: str | None
    reason: str | None  # why those that cannot do not; null where all can
    methods: list[str] = msgspec.field(default_factory=list)  # those that can


class Document(msgspec.Struct):
    """results.json."""

    schema: int
    meta: Meta
    scenes: list[dict[str, Any]]  # `Scene`, or `FailedScene` where it has the key "failure"
    records: list[Record]
    exit_code: int
    changes: list[Change] | None = None
    support: list[Support] | None = None


def check(document: dict[str, Any]) -> None:
    """Raise `msgspec.ValidationError` with the place where a document departs from the schema."""
    if document.get("schema") != SCHEMA:
        raise msgspec.ValidationError(f"schema {document.get('schema')!r} is not {SCHEMA}")
    msgspec.convert(document, Document)
    for index, scene in enumerate(document["scenes"]):
        try:
            msgspec.convert(scene, FailedScene if "failure" in scene else Scene)
        except msgspec.ValidationError as error:
            raise msgspec.ValidationError(f"scenes[{index}]: {error}") from None


def read_document(path: Path) -> dict[str, Any]:
    """The content of a results.json, checked; `ArgumentError` names the file and what is wrong with it."""
    try:
        document = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise ArgumentError(f"{path}: cannot be read ({error.strerror}); name a folder that `crosscheck verify` wrote"
                            ) from None
    except ValueError as error:
        raise ArgumentError(f"{path}: no JSON ({error})") from None
    try:
        check(document if isinstance(document, dict) else {})
    except msgspec.ValidationError as error:
        raise ArgumentError(f"{path}: not a results.json of this version ({error}); run `crosscheck verify` again"
                            ) from None
    return document


def json_schema() -> dict[str, Any]:
    """The JSON Schema of results.json, with the scenes spelled out."""
    (document, *scenes), definitions = msgspec.json.schema_components([Document, Scene, FailedScene],
                                                                      ref_template="#/$defs/{name}")
    definitions["Document"]["properties"]["scenes"]["items"] = {"anyOf": scenes}
    definitions["Document"]["properties"]["schema"] = {"const": SCHEMA}
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", "title": "results.json of crosscheck verify",
            **document, "$defs": definitions}
