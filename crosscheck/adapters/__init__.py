"""The engine adapters: names, lookup, methods. An engine's package is imported only when the engine is used.

An engine is given by its name, by a class of the user ("module:Class", "path/file.py:Class"), by a program of the user
("PROGRAM {scene} {step} {out}"), or by name and version ("mujoco==3.3.7").
"""

from __future__ import annotations

import contextlib
import hashlib
import importlib.metadata
import time
from collections.abc import Callable, Iterable, Iterator, Mapping

from crosscheck.adapters import built_in
from crosscheck.adapters.base import Engine
from crosscheck.adapters.external.program import Program, is_program
from crosscheck.errors import ArgumentError, unknown
from crosscheck.files import cache_folder, put

_GROUP = "crosscheck.engines"


def names() -> tuple[str, ...]:
    """Names of the engines: the four built in, the optional ones that are installed, then entry points, sorted."""
    from crosscheck.adapters.external import versions

    listed = (name for name, entry in built_in.ENTRIES.items()
              if (versions.present(name) if entry.version else entry.importable()))
    offered = {point.name for point in importlib.metadata.entry_points(group=_GROUP)}
    return (*listed, *sorted(offered - set(built_in.ENTRIES)))


def get(engine: str | Engine) -> Engine:
    """The adapter of an engine: a name in the forms of the package docstring, or an object.

    An entry point cannot replace a built-in name. An object of the user is completed as a class of the user is.

    Raises
    ------
    ArgumentError
        There is no such engine, or it lacks a required attribute or method.
    EngineError
        The environment of a version cannot be made.
    """
    if isinstance(engine, str):
        if (made := _LENT.get(engine) or _MADE.get(engine)) is None:
            made = _MADE[engine] = _make(str(engine))
        return made
    from crosscheck.adapters.external import own

    if isinstance(engine, type) or not hasattr(engine, "run"):
        raise ArgumentError(f"engine: a name or an object with the methods of an engine is wanted, not "
                            f"{type(engine).__name__}; names: {', '.join(names())}")
    ours = type(engine).__module__.startswith(f"{__name__}.")
    return engine if ours else own.completed(engine, type(engine).__name__, "not stated")


def sources(engines: Iterable[str]) -> dict[str, dict[str, bytes]]:
    """The files of those engines that are classes of the user, for `carry`; programs have to be where they run."""
    from crosscheck.adapters.external import code

    return {name: code.sources(name.rpartition(":")[0]) for name in engines if is_own(name) and not is_program(name)}


def carry(given: Mapping[str, Mapping[str, bytes]]) -> None:
    """From now on, in this process, engines of these names are made of these files, which came from another machine."""
    for name, files in given.items():
        whole = hashlib.sha256(repr(sorted(files.items())).encode()).hexdigest()
        folder = cache_folder() / "carried" / whole[:16]
        for path, content in files.items():
            if not (folder / path).exists():
                (folder / path).parent.mkdir(parents=True, exist_ok=True)
                put(folder / path, content)
        if _CARRIED.get(name) != str(folder):
            _CARRIED[name] = str(folder)
            renew()


_CARRIED: dict[str, str] = {}
_LENT: dict[str, Engine] = {}
_MADE: dict[str, Engine] = {}


@contextlib.contextmanager
def lent(engine: Engine) -> Iterator[str]:
    """A temporary name, valid within the context, for an engine object."""
    name = f"{engine.name} {id(engine)}"
    _LENT[name] = engine
    try:
        yield name
    finally:
        del _LENT[name]


def _make(name: str) -> Engine:
    if has_own_environment(name):
        from crosscheck.adapters.external.versions import Versioned

        return Versioned(name)
    if name in built_in.ENTRIES:
        return built_in.ENTRIES[name].make()
    from crosscheck.adapters.external.apart import Stranger
    from crosscheck.adapters.external.remote import Home

    if is_program(name):
        from crosscheck.adapters.external import own

        program = Program(name)
        return own.completed(program, name, None, program.digest())
    for point in importlib.metadata.entry_points(group=_GROUP, name=name):
        return Stranger(Home(point.value, names(), point.dist.version if point.dist else None))
    if is_own(name):
        return Stranger(Home(name, names(), folder=_CARRIED.get(name)))
    raise ArgumentError(unknown("engine", name, names()))


def renew() -> None:
    """Load classes of the user anew when they are next asked for: a process may outlive an edit of their files."""
    for name in [*filter(is_own, _MADE)]:
        del _MADE[name]


def split(entry: str) -> tuple[str, str]:
    """(engine, method) of "engine", "engine:method" and, for a class of the user, "module:Class:method"."""
    if is_program(entry):
        return entry, ""
    if is_own(entry):
        home, _, rest = entry.rpartition(":")
        return (home, rest) if ":" in home else (entry, "")
    engine, _, method = entry.partition(":")
    return engine, method


def is_own(name: str) -> bool:
    """Whether `name` gives a class of the user, by module or file, or a program of his."""
    return is_program(name) or (":" in name and "==" not in name and name.partition(":")[0] not in names())


def has_own_environment(name: str) -> bool:
    """Whether this engine, or version of one, runs in its own environment, so that its times cannot be compared."""
    return "==" in name or (name in built_in.ENTRIES and bool(built_in.ENTRIES[name].version))


def clock(name: str) -> Callable[[], float]:
    """The clock (s) of what runs of an engine take: the processor's, so that a busy machine does not count.

    Of engines in processes of their own, that of these and of all processes that they have started, to hundredths.
    """
    if not (is_own(name) or has_own_environment(name)):
        return time.process_time
    from crosscheck.jobs.workers.process import Family

    return Family(whole=True).processor


def methods(name: str) -> tuple[str, ...]:
    """Names of the methods of an engine; raises `ArgumentError` if there is no such engine."""
    return get(name).methods
