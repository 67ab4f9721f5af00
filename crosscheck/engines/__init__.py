"""The engine adapters: names, lookup, methods. An engine's package is imported only when the engine is used.

Called, this package answers the names of the engines: `crosscheck.engines()`.
"""

from __future__ import annotations

import functools
import importlib
import importlib.metadata
import sys
import types

from crosscheck.engines.base import Engine
from crosscheck.errors import ArgumentError
from crosscheck.spelling import unknown

_ADAPTERS = {
    "lieeuler": ("crosscheck.engines.lieeuler", "LieEuler"),
    "mujoco": ("crosscheck.engines.mujoco", "MuJoCo"),
    "pinocchio": ("crosscheck.engines.pinocchio", "Pinocchio"),
    "exudyn": ("crosscheck.engines.exudyn", "Exudyn"),
}
_GROUP = "crosscheck.engines"


def names() -> tuple[str, ...]:
    """Names of the engines: the four built in, then those other packages offer as entry points, sorted."""
    offered = {point.name for point in importlib.metadata.entry_points(group=_GROUP)}
    return (*_ADAPTERS, *sorted(offered - set(_ADAPTERS)))


def get(name: str) -> Engine:
    """The adapter called `name`; a built-in name cannot be taken over by an entry point.

    Raises `ArgumentError` where there is none, or where `name` is no text.
    """
    if not isinstance(name, str):
        raise ArgumentError(f"engine: a name is wanted, not {type(name).__name__}; allowed: {', '.join(names())}")
    return _get(str(name))


@functools.cache
def _get(name: str) -> Engine:
    if name in _ADAPTERS:
        module, adapter = _ADAPTERS[name]
        return getattr(importlib.import_module(module), adapter)()
    for point in importlib.metadata.entry_points(group=_GROUP, name=name):
        return point.load()()
    raise ArgumentError(unknown("engine", name, names()))


def methods(name: str) -> tuple[str, ...]:
    """Names of the methods of the engine called `name`; raises `ArgumentError` where there is no such engine."""
    return get(name).methods


class _CallablePackage(types.ModuleType):
    """`crosscheck.engines` is a public function by name and a subpackage by import: this makes it both."""

    def __call__(self) -> tuple[str, ...]:
        return names()


sys.modules[__name__].__class__ = _CallablePackage
