"""Runs inside the process of an engine that has one of its own; see `crosscheck.adapters.external.apart`.

In the environment of a version only the engine and the packages that its adapter needs are installed.
"""

from __future__ import annotations

import dataclasses
import functools
import os
from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

import numpy as np

from crosscheck.adapters import built_in
from crosscheck.adapters.base import Engine, RunSpec
from crosscheck.adapters.common.native import JointStates, Native
from crosscheck.adapters.common.probe import Probe
from crosscheck.adapters.external.plain import PlainRun, doubles, plain
from crosscheck.scene.model import Scene
from crosscheck.scene.states import States

T = TypeVar("T")

@dataclasses.dataclass
class Card:
    """What an engine says of itself; the fields of `crosscheck.adapters.base.Engine` with these names."""

    name: str
    methods: tuple[str, ...]
    forms: tuple[str, ...]
    adaptive_methods: tuple[str, ...]
    fixed_step_methods: tuple[str, ...]
    orders: dict[str, int]
    checks_sizes: bool
    options: frozenset[str]
    pace: int
    on_group: bool
    eps: float
    interpolation: float


@dataclasses.dataclass(frozen=True)
class Home:
    """Where an engine of the user comes from; the arguments of `own.load`."""

    name: str
    known: tuple[str, ...]
    stated: str | None = None
    folder: str | None = None  # with its files, of an engine from another machine


def card(engine: str | Home) -> Card:
    """The card of an engine. Errors as `own.load`."""
    adapter = _adapter(engine)
    said = {field.name: getattr(adapter, field.name) for field in dataclasses.fields(Card)}
    return Card(**said | {"orders": dict(adapter.orders)})


def asked(method: Callable[..., T], engine: str | Home, *arguments: object) -> T:
    """What the engine answers to a method of `Engine`, decoded strictly to the type that it is annotated with."""
    answer: T = getattr(_adapter(engine), method.__name__)(*arguments)
    return answer


def turning(engine: str | Home, scene: Scene, form: str | None) -> tuple[int, ...]:
    """As the engine's."""
    return tuple(_adapter(engine).turning(scene, form))


def probe(engine: str | Home, scene: Scene, states: States, form: str | None) -> Probe:
    """As the engine's."""
    answer: Probe = _adapter(engine).probe(scene, states, form)
    return answer


def derivatives(engine: str | Home, scene: Scene, state: tuple[np.ndarray, np.ndarray]) -> dict[str, np.ndarray] | None:
    """As the engine's, or None if it has none."""
    give = getattr(_adapter(engine), "derivatives", None)
    return None if give is None else {str(name): doubles(name, values) for name, values in give(scene, state).items()
                                      if values is not None}


def run(engine: str | Home, scene: Scene, spec: RunSpec) -> PlainRun:
    """The run of the adapter."""
    return plain(_adapter(engine).run(scene, spec))


def native(engine: str | Home, path: str, states: JointStates) -> Native:
    """What the engine's own reader makes of a model file; see `crosscheck.inspection.native`."""
    return _adapter(engine).native(path, states)


@functools.cache
def _adapter(engine: str | Home) -> Engine:
    if isinstance(engine, str):
        return built_in.ENTRIES[engine].make()
    from crosscheck.adapters.external import own

    name = engine.name
    if engine.folder is not None:
        os.chdir(engine.folder)
        name = Path(name).name
    return own.load(name, engine.known, engine.stated)
