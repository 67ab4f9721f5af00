"""The engine adapters: names, lookup, methods. An engine's package is imported only when the engine is used.

An engine is given by its name, by a class of the user ("module:Class", "path/file.py:Class"), or by name and version
("mujoco==3.3.7").
"""

from __future__ import annotations

import contextlib
import functools
import importlib.metadata
from collections.abc import Iterator, Sequence

from crosscheck.adapters import built_in
from crosscheck.adapters.base import Engine
from crosscheck.errors import ArgumentError, unknown
from crosscheck.scene.model import Scene

_GROUP = "crosscheck.engines"


def names() -> tuple[str, ...]:
    """Names of the engines: the four built in, the optional ones that are installed, then entry points, sorted."""
    from crosscheck.adapters.foreign import versions

    listed = (name for name, entry in built_in.ENTRIES.items()
              if (versions.present(name) if entry.version else entry.importable()))
    offered = {point.name for point in importlib.metadata.entry_points(group=_GROUP)}
    return (*listed, *sorted(offered - set(built_in.ENTRIES)))


def get(name: str) -> Engine:
    """The adapter for `name`, in the forms of the package docstring; an entry point cannot replace a built-in name.

    Raises
    ------
    ArgumentError
        There is no such engine, it lacks a required attribute or method, or `name` is not a text.
    EngineError
        The environment of a version cannot be made.
    """
    if not isinstance(name, str):
        raise ArgumentError(f"engine: a name is wanted, not {type(name).__name__}; allowed: {', '.join(names())}")
    return _LENT.get(name) or _get(str(name))


_LENT: dict[str, Engine] = {}


@contextlib.contextmanager
def lent(engine: Engine) -> Iterator[str]:
    """A temporary name for an engine that is given as an object, valid within the context."""
    name = f"{engine.name} {id(engine)}"
    _LENT[name] = engine
    try:
        yield name
    finally:
        del _LENT[name]


@functools.cache
def _get(name: str) -> Engine:
    if has_own_environment(name):
        from crosscheck.adapters.foreign.versions import Versioned

        return Versioned(name)
    if name in built_in.ENTRIES:
        return built_in.ENTRIES[name].make()
    from crosscheck.adapters.foreign import code, own

    for point in importlib.metadata.entry_points(group=_GROUP, name=name):
        stated = point.dist.version if point.dist else None
        return own.completed(point.load()(), name, stated, code.digest(point.module))
    if is_own(name):
        return own.load(name, names())
    raise ArgumentError(unknown("engine", name, names()))


def split(entry: str) -> tuple[str, str]:
    """(engine, method) of "engine", "engine:method" and, for a class of the user, "module:Class:method"."""
    if is_own(entry):
        home, _, rest = entry.rpartition(":")
        # A Windows path has a colon too, after its drive letter.
        return (home, rest) if ":" in home[2:] else (entry, "")
    engine, _, method = entry.partition(":")
    return engine, method


def is_own(name: str) -> bool:
    """Whether `name` gives a class of the user, by module or file."""
    return ":" in name and "==" not in name and name.partition(":")[0] not in names()


def has_own_environment(name: str) -> bool:
    """Whether this engine, or version of one, runs in its own environment, so that its times cannot be compared."""
    return "==" in name or (name in built_in.ENTRIES and bool(built_in.ENTRIES[name].version))


def methods(name: str) -> tuple[str, ...]:
    """Names of the methods of an engine; raises `ArgumentError` if there is no such engine."""
    return get(name).methods


def turning(name: str, scene: Scene, form: str | None) -> Sequence[int]:
    """Bodies that an engine's model has on coordinates of SO(3), see `Engine`; all if the engine does not say."""
    declared = getattr(get(name.partition("==")[0]), "turning", None)
    return range(scene.n) if declared is None else declared(scene, form)


def coordinate_map(name: str, wanted: str | None) -> str | None:
    """The coordinate map `wanted` if the engine declares this option, else None."""
    return wanted if "coordinate_map" in getattr(get(name), "options", ()) else None


def pace(name: str) -> int:
    """How slow runs of an engine are, see `Engine`; slow ones are started first."""
    return getattr(get(name), "pace", 0)


def on_group(name: str) -> bool:
    """Whether an engine keeps attitudes on SO(3) by construction, see `Engine`."""
    return getattr(get(name), "on_group", False)


COARSEST = 2.0**-23
"""Spacing at 1 of single precision: an engine cannot claim coarser numbers."""


def eps(name: str) -> float:
    """Spacing at 1 of the numbers of an engine, see `Engine`; that of doubles if it does not say."""
    return min(float(getattr(get(name), "eps", 2.0**-52)), COARSEST)
