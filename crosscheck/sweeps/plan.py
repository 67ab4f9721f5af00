"""The request of a sweep: read it from TOML, JSON or a dict, and check it before anything runs."""

from __future__ import annotations

import dataclasses
import itertools
import json
import os
import tomllib
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from crosscheck import adapters
from crosscheck.adapters.base import ENGINE_OPTIONS, Engine
from crosscheck.document import Way
from crosscheck.errors import ArgumentError, install, unknown
from crosscheck.running.provenance import NOT_INSTALLED, engine_version
from crosscheck.scene.file import read_scene, scene_from
from crosscheck.scene.model import Scene
from crosscheck.scene.paths import content_of, number_at
from crosscheck.scene.schema import Content

KEYS = ("scenes", "engines", "steps", "rtols", "samples", "duration", "parameters", "perturb", "timing")
PERTURBED = ("angular_velocity", "attitude", "joint_position", "joint_velocity")
SAMPLING = ("normal", "latin_hypercube")
DIRECTIONS = ("attitude", "reference_attitude", "parent_axis", "child_axis")
"""Quaternions and axes of a scene file, whose length does not count."""

MOST_CELLS = 10_000_000
Value = float | list[float]
"""The value of a parameter: a number, or a vector in the notation of the scene file."""


@dataclasses.dataclass(frozen=True)
class Perturbation:
    """Random members around each start. `deviations` are absolute for state quantities and relative for paths."""

    deviations: tuple[tuple[str, float], ...]
    count: int
    seed: int
    sampling: str


@dataclasses.dataclass(frozen=True)
class Origin:
    """A scene of the sweep."""

    name: str
    path: str
    scene: Scene


@dataclasses.dataclass(frozen=True)
class Plan:
    """The checked request of a sweep."""

    origins: tuple[Origin, ...]
    ways: tuple[Way, ...]
    engines: tuple[tuple[str, str], ...]  # with their versions
    parameters: tuple[tuple[str, tuple[Value, ...]], ...]
    perturbation: Perturbation | None
    timing: bool
    source: Content  # the request itself, with absolute paths of files

    @property
    def members(self) -> int:
        """Number of members of each start."""
        return self.perturbation.count if self.perturbation else 1

    def grid(self) -> Iterator[dict[str, Value]]:
        """Every combination of the parameters, by path."""
        names = [name for name, _ in self.parameters]
        for values in itertools.product(*(values for _, values in self.parameters)):
            yield dict(zip(names, values, strict=True))

    @property
    def cells(self) -> int:
        """Number of runs."""
        points = int(np.prod([len(values) for _, values in self.parameters])) if self.parameters else 1
        return len(self.origins) * points * self.members * len(self.ways)


def read(source: Mapping[str, object] | str | os.PathLike[str]) -> Plan:
    """Read and check a request, given as a dict or as the path of a TOML or JSON file.

    Raises
    ------
    ArgumentError, SceneError
        The message says in one line what is wrong and what is allowed. For files it names the file.
    """
    if isinstance(source, Mapping):
        return _checked(source, Path())
    try:
        path = Path(source)
        text = path.read_text(encoding="utf-8")
        data = json.loads(text) if path.suffix == ".json" else tomllib.loads(text)
    except TypeError:
        raise ArgumentError(f"sweep: a dict or the path of a TOML file is wanted, not {source!r}") from None
    except OSError as error:
        raise ArgumentError(f"{source}: cannot be read ({error.strerror or error}); give the path of a TOML file with "
                            "scenes, engines and steps or rtols") from None
    except (tomllib.TOMLDecodeError, json.JSONDecodeError, UnicodeDecodeError) as error:
        raise ArgumentError(f"{source}: neither TOML nor JSON, {error}") from None
    try:
        return _checked(data, path.parent)
    except ArgumentError as error:
        raise ArgumentError(f"{source}: {error}") from None


def _checked(data: Mapping[str, object], folder: Path) -> Plan:
    for key in data:
        if key not in KEYS:
            raise ArgumentError(unknown("key of a sweep", key, KEYS))
    scenes = _several("scenes", data.get("scenes"), "names or paths")
    changes: dict[str, float] = {}
    if "samples" in data:
        changes["samples"] = _whole("samples", data["samples"], 2)
    if "duration" in data:
        changes["duration"] = _positive("duration", data["duration"])
    origins = tuple(_origin(scene, folder, changes) for scene in scenes)
    steps = [_positive("steps", step) for step in _several("steps", data.get("steps", []), "s", empty=True)]
    rtols = [_positive("rtols", rtol) for rtol in _several("rtols", data.get("rtols", []), "numbers", empty=True)]
    if not steps and not rtols:
        raise ArgumentError("steps: missing; give steps = [..] (s), rtols = [..], or both")
    timing = data.get("timing", False)
    if not isinstance(timing, bool):
        raise ArgumentError(f"timing: true or false is wanted, not {timing!r}")
    parameters = _parameters(data.get("parameters", {}), origins)
    ways = _ways(data.get("engines"), steps, rtols)
    engines = tuple((name, engine_version(name)) for name in sorted({way.engine for way in ways}))
    plan = Plan(origins, ways, engines, parameters,
                _perturbation(data.get("perturb"), origins, [name for name, _ in parameters]), timing,
                {**data, "scenes": [origin.path if Path(origin.name).suffix else origin.name
                                    for origin in origins]})
    if plan.cells > MOST_CELLS:
        raise ArgumentError(f"the sweep has {plan.cells} cells, more than {MOST_CELLS}; leave some out")
    return plan


def _origin(scene: Any, folder: Path, changes: dict[str, float]) -> Origin:
    """A scene by name, by path or as a Scene, with the request's duration and samples.

    Paths are relative to the folder of the request.
    """
    if isinstance(scene, Scene):
        return Origin(scene.name, scene.name, scene.replace(**changes))
    file = folder / str(scene)
    name = file.resolve() if "." in str(scene) and file.exists() else scene
    path, data = read_scene(name)
    return Origin(str(scene), str(path), scene_from(data | changes, path))


def _ways(engines: object, steps: Sequence[float], rtols: Sequence[float]) -> tuple[Way, ...]:
    if not isinstance(engines, Mapping) or not engines:
        raise ArgumentError('engines: a table of engines with lists of methods is wanted, lieeuler = ["rattle2"] say')
    ways = []
    for engine, methods in engines.items():
        adapter = adapters.get(engine)
        if engine_version(engine) == NOT_INSTALLED:
            raise ArgumentError(f"engines: {engine} is not installed; {install(engine)}, or leave it out")
        for entry in _several(f"engines.{engine}", methods, "methods"):
            method, options = _method(engine, adapter, entry)
            controls = [(step, None) for step in steps if method in adapter.fixed_step_methods] + [
                (None, rtol) for rtol in rtols if method in adapter.adaptive_methods]
            if not controls:
                wanted = "rtols" if method in adapter.adaptive_methods else "steps"
                raise ArgumentError(f"engines.{engine}: {method} needs {wanted} = [..]")
            ways += [Way.of(engine, method, step, rtol, **options) for step, rtol in controls]
    return tuple(ways)


def _method(engine: str, adapter: Engine, entry: object) -> tuple[str, dict[str, Any]]:
    table = {"method": entry} if isinstance(entry, str) else entry
    if not isinstance(table, Mapping) or "method" not in table:
        raise ArgumentError(f'engines.{engine}: "METHOD" or {{ method = "METHOD", form = .. }} is wanted, not '
                            f"{entry!r}")
    for key in table:
        if key not in ("method", *ENGINE_OPTIONS):
            raise ArgumentError(unknown(f"engines.{engine}", key, ("method", *ENGINE_OPTIONS)))
    if table["method"] not in adapter.methods:
        raise ArgumentError(unknown(f"method of {engine}", table["method"], adapter.methods))
    return table["method"], {key: value for key, value in table.items() if key != "method"}


def _parameters(given: object, origins: Sequence[Origin]) -> tuple[tuple[str, tuple[Value, ...]], ...]:
    if not isinstance(given, Mapping):
        raise ArgumentError('parameters: a table of paths is wanted, such as "bodies.upper.mass" = [0.9, 1.1]')
    parameters = []
    for path, values in given.items():
        for origin in origins:
            now = number_at(content_of(origin.scene), path)
            for value in _several(f"parameters.{path}", values, "values"):
                if np.shape(value) != np.shape(now) or not np.isfinite(np.asarray(value, dtype=float)).all():
                    raise ArgumentError(f"parameters.{path}: {value!r} is not like {now!r}, the scene's, of "
                                        f"{origin.name!r}")
        parameters.append((path, tuple(values)))
    return tuple(parameters)


def _perturbation(given: object, origins: Sequence[Origin], taken: Sequence[str]) -> Perturbation | None:
    if given is None:
        return None
    if not isinstance(given, Mapping):
        raise ArgumentError("perturb: a table is wanted, such as angular_velocity = 1e-3 and count = 20")
    deviations = []
    for key, value in given.items():
        if key in ("count", "seed", "sampling"):
            continue
        if key not in PERTURBED:
            if "." not in key:
                raise ArgumentError(unknown("perturb", key, (*PERTURBED, "count", "seed", "sampling", "a path")))
            for origin in origins:
                _check_perturbed(content_of(origin.scene), key, origin.name)
        deviations.append((key, _positive(f"perturb.{key}", value)))
    if not deviations:
        raise ArgumentError(f"perturb: nothing is perturbed; give one of {', '.join(PERTURBED)}, or a path")
    sampling = given.get("sampling", "normal")
    if sampling not in SAMPLING:
        raise ArgumentError(unknown("perturb.sampling", sampling, SAMPLING))
    if "count" not in given:
        raise ArgumentError("perturb.count: missing; give the number of members")
    return Perturbation(tuple(deviations), _whole("perturb.count", given["count"], 1),
                        _whole("perturb.seed", given.get("seed", 0), 0), sampling)


def _check_perturbed(content: Content, path: str, scene: str) -> None:
    """Raise if relative deviations of the numbers at a path change nothing."""
    if not np.any(number_at(content, path)):
        raise ArgumentError(f"perturb: {path!r} is 0 in {scene!r}, and relative deviations of 0 are none; vary it in "
                            "parameters")
    group, owner, key, *_ = (*path.split("."), "", "")
    whole = number_at(content, f"{group}.{owner}.{key}") if key in (*DIRECTIONS, "position") else []
    if (key in DIRECTIONS or np.size(whole) == 4) and np.count_nonzero(whole) == 1:
        raise ArgumentError(f"perturb: {path!r} in {scene!r} is a direction, {whole}, whose length does not count; "
                            'perturb "attitude" or "joint_position" (rad), or vary it in parameters')


def _several(name: str, given: object, what: str, empty: bool = False) -> list[Any]:
    if not isinstance(given, list | tuple | np.ndarray) or (len(given) == 0 and not empty):
        raise ArgumentError(f"{name}: a list of {what} is wanted, not {given!r}")
    return list(given)


def _positive(name: str, value: object) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float | np.number) or not 0 < value < np.inf:
        raise ArgumentError(f"{name}: positive numbers are wanted, not {value!r}")
    return float(value)


def _whole(name: str, value: object, lowest: int) -> int:
    if isinstance(value, bool) or not isinstance(value, int | np.integer) or value < lowest:
        raise ArgumentError(f"{name}: a whole number of at least {lowest} is wanted, not {value!r}")
    return int(value)
