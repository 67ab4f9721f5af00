"""The part of a sweep that workers do: run each member with all its ways and compare the runs with one truth."""

from __future__ import annotations

import dataclasses
import functools
import hashlib
import json
import math
import time
from collections.abc import Sequence
from typing import Any

from msgspec.structs import replace

from crosscheck import references
from crosscheck.compare.errors import energy_gap, errors
from crosscheck.compare.sizes import sizes
from crosscheck.document import Way, extended
from crosscheck.errors import Unsupported, said
from crosscheck.jobs.workers import child
from crosscheck.references.base import TruthError
from crosscheck.references.members import Members
from crosscheck.running import provenance
from crosscheck.running.attempt import Ran, attempt
from crosscheck.running.work import work
from crosscheck.scene.model import Scene
from crosscheck.scene.states import States

ERRORS = {"position": "position_error", "attitude": "attitude_error", "velocity": "velocity_error",
          "angular velocity": "angular_velocity_error"}
LEVELS = ("energy_error", "constraint_position", "constraint_velocity", "constraint_acceleration", "orthogonality")
FIGURES = (*ERRORS.values(), *LEVELS)
COLUMNS = ("cell", "scene", "engine", "version", "method", "form", "step", "rtol", "member", "parameters", "status",
           *FIGURES, "steps", "wall_time", "message")
"""The columns of the table of cells, which are fields of `Row`."""

KEPT_STRUCTURES = 8
"""Number of compiled integrators that a worker keeps."""


@dataclasses.dataclass(frozen=True)
class Member:
    """One scene to run, with the ways that have no result yet."""

    scene: Scene
    structure: Scene  # the same except for the initial state; members with the same one share a compiled truth
    name: str  # of the scene in the request
    index: int
    parameters: tuple[tuple[str, Any], ...]
    ways: tuple[Way, ...]
    checked: bool  # whether its truth is compared with the second formulation


@dataclasses.dataclass(frozen=True)
class Code:
    """Versions of all that the cells of a sweep depend on, by name."""

    engines: tuple[tuple[str, str], ...]
    libraries: tuple[tuple[str, str], ...]  # Python and the code of this project, too

    def engine(self, way: Way) -> str:
        """The version of a way's engine."""
        return dict(self.engines)[way.engine]


@dataclasses.dataclass(frozen=True)
class Task:
    """Members that are run one after the other in one worker."""

    members: tuple[Member, ...]
    code: Code  # a worker with other versions refuses the task
    timing: bool

    @property
    def cells(self) -> int:
        """Number of runs."""
        return sum(len(member.ways) for member in self.members)

    def split(self) -> list[Task]:
        """A separate task for each run."""
        return [dataclasses.replace(self, members=(dataclasses.replace(member, ways=(way,)),))
                for member in self.members for way in member.ways]


class Row(Way, frozen=True, kw_only=True):
    """A cell as it is stored. NaN means that there is no value."""

    cell: str  # its content key, see `key`
    scene: str
    version: str
    member: int
    parameters: str  # JSON, by path
    status: str = ""
    position_error: float = math.nan  # m
    attitude_error: float = math.nan  # rad
    velocity_error: float = math.nan  # m/s
    angular_velocity_error: float = math.nan  # rad/s
    energy_error: float = math.nan
    constraint_position: float = math.nan  # m
    constraint_velocity: float = math.nan  # m/s
    constraint_acceleration: float = math.nan  # m/s^2
    orthogonality: float = math.nan
    steps: int = 0
    wall_time: float = math.nan  # s
    message: str = ""


@dataclasses.dataclass(frozen=True)
class Done:
    """The result of a task: its rows, and the times (s) for truth and for runs."""

    rows: list[Row]
    truth_seconds: float
    run_seconds: float
    checked: list[float]  # disagreements of the two formulations
    trouble: list[str]  # why there is no truth


def keys(scene: Scene, ways: Sequence[Way], code: Code, timing: bool) -> list[str]:
    """The content keys of cells: digests of all that determines their values, and of nothing else."""
    own = scene.hash
    return [hashlib.sha256(json.dumps([own, way.engine, code.engine(way), way.method, way.arguments, code.libraries,
                                       timing], sort_keys=True).encode()).hexdigest()[:32] for way in ways]


def run(task: Task) -> Done:
    """Run all cells of a task. Each gives a row, even if its engine fails.

    Raises
    ------
    CrosscheckError
        This worker has other versions than those of the sweep.
    """
    engines = {way.engine: task.code.engine(way) for member in task.members for way in member.ways}
    provenance.refuse_others(dict(task.code.libraries) | engines, _own_versions(tuple(sorted(engines))), "this worker")
    rows: list[Row] = []
    checked: list[float] = []
    trouble: list[str] = []
    truth_seconds = run_seconds = 0.0
    for member in task.members:
        began = time.perf_counter()
        exact, why = _truth(member, checked)
        trouble += [why] if why else []
        middle = time.perf_counter()
        for way, row in zip(member.ways, empty_rows(member, task), strict=True):
            child.at(f"{member.name} {way.engine} {way.method}")
            rows.append(_measured(row, member, way, exact, task.timing))
        truth_seconds += middle - began
        run_seconds += time.perf_counter() - middle
    return Done(rows, truth_seconds, run_seconds, checked, trouble)


_own_versions = functools.lru_cache(maxsize=4)(provenance.versions)


def _compiled(scene: Scene) -> Members:
    if scene.hash not in _kept:
        while len(_kept) >= KEPT_STRUCTURES:
            del _kept[next(iter(_kept))]
        _kept[scene.hash] = Members(scene)
    return _kept[scene.hash]


_kept: dict[str, Members] = {}  # by the hash of a structure


def _truth(member: Member, checked: list[float]) -> tuple[States | None, str]:
    """The states of the truth and "", or None and why there is no truth."""
    try:
        try:
            compiled = _compiled(member.structure)
        except ImportError:  # without the extra heyoka, SciPy integrates two formulations for every member
            reference = references.truth(member.scene)
            checked.append(reference.disagreement)
            return reference.states.until(reference.horizon), ""
        states = compiled.states(member.scene)
        if member.checked:
            checked.append(compiled.check(member.scene, states))
        return states, ""
    except (Unsupported, TruthError) as error:
        return None, said(error)


def _measured(row: Row, member: Member, way: Way, exact: States | None, timing: bool) -> Row:
    """The row of a cell with its values. If there is none, the row has its status and message instead."""
    outcome = attempt(member.scene, way, derived=False)
    if not isinstance(outcome, Ran):
        return replace(row, status=outcome.status, message=outcome.why)
    raw = outcome.raw
    values = {key: value for key, value in (raw.maxima or {}).items() if key in LEVELS}
    if exact is not None:
        values |= {ERRORS[name]: error.max for name, error in errors(member.scene, raw.states, exact).items()}
    gap = energy_gap(member.scene, raw.states, exact, raw.maxima or {}, lambda: work(member.scene, raw.states))
    values["energy_error"] = gap / sizes(member.scene, raw.states if exact is None else exact)["energy"]
    return replace(row, status=raw.status, form=raw.form, steps=raw.steps,
                   wall_time=raw.wall_time if timing else math.nan, **values)


def empty_rows(member: Member, task: Task) -> list[Row]:
    """The rows of a member's cells before they ran."""
    parameters = json.dumps(dict(member.parameters))
    return [extended(Row, way, cell=key, scene=member.name, version=task.code.engine(way), member=member.index,
                     parameters=parameters)
            for key, way in zip(keys(member.scene, member.ways, task.code, task.timing), member.ways, strict=True)]
