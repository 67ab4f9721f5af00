"""Engines of the user, given as "module:Class" or "path/file.py:Class", with defaults for what they leave out."""

from __future__ import annotations

import contextlib
import hashlib
import importlib
import importlib.util
import numbers
import os
import sys
import time
import types
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, cast

from crosscheck.adapters.base import RawRun, RunSpec, StandIn, Stats, steps_per_sample
from crosscheck.adapters.external import code
from crosscheck.adapters.external.plain import doubles
from crosscheck.errors import ArgumentError, EngineError, brief, errors_as, named, unknown
from crosscheck.scene.model import Scene
from crosscheck.scene.states import States

COARSEST = 2.0**-23
"""Spacing at 1 of single precision: an engine cannot claim coarser numbers."""

LONGEST_NAME = 100
"""Characters of the name of a method: it stands in tables."""

LONGEST = 1e9
"""Longest wall time (s), or length (m), that is taken for one; any other is an error of its own."""


class Completed(StandIn):
    """An engine with at least `name`, `methods`, `unsupported` and `run`, and defaults for the rest of `Engine`.

    Its `run` may return `States` alone: the number of steps follows from the fixed step then. The wall time is that of
    the call, by the clock of the harness; what the engine says of it is kept as "stated_time" of `stats`.
    """

    def __init__(self, engine: Any, version: str | None, own: str) -> None:
        super().__init__(engine)
        self._version, self._own = version, own
        self.methods, self.forms, self.adaptive_methods = (
            tuple(given) for given in (self.methods, self.forms, self.adaptive_methods))
        self.orders = self.orders or {}
        self.checks_sizes |= hasattr(engine, "documented_order") and not hasattr(engine, "adaptive_methods")
        self.options = frozenset(self.options)
        self.eps, self.interpolation = min(float(self.eps), COARSEST), max(float(self.interpolation), 0.0)

    def version(self) -> str:
        """The version that the engine or its package states, and the digest of its code."""
        stated = getattr(self._engine, "version", None)
        said = (stated() if callable(stated) else stated) or self._version
        return ", ".join([*([] if said is None else [brief(str(said), LONGEST_NAME)]),
                          *([f"code {self._own}"] if self._own else [])])

    def held_levels(self, scene: Scene, spec: RunSpec) -> frozenset[str]:
        """From the engine's method of this name, else none."""
        held = getattr(self._engine, "held_levels", super().held_levels)
        return frozenset(held(scene, spec))

    def iteration(self, scene: Scene, spec: RunSpec) -> float:
        """From the engine's method of this name, else 0; raises `EngineError` if that is no length."""
        left = getattr(self._engine, "iteration", super().iteration)(scene, spec)
        if not isinstance(left, numbers.Real) or not 0.0 <= float(left) <= LONGEST:
            raise EngineError(f"{self.name} {spec.method}: iteration returned {brief(str(left))}, not a length in m")
        return float(left)

    def unsupported(self, scene: Scene, spec: RunSpec) -> str | None:
        """The engine's answer; forms and scene elements that it does not declare are refused here."""
        if reason := scene.beyond(getattr(self._engine, "elements", ())):
            return reason
        if spec.form is not None and spec.form not in self.forms:
            return f"form {spec.form} is not among those of this engine: {', '.join(self.forms) or 'it names none'}"
        reason = self._engine.unsupported(scene, spec)
        return brief(reason) if isinstance(reason, str) else reason

    @property
    def derivatives(self) -> Any:
        """The engine's own `derivatives(scene, state)`, or None."""
        return getattr(self._engine, "derivatives", None)

    def run(self, scene: Scene, spec: RunSpec) -> RawRun:
        """The engine's run; raises `EngineError` if it does not return states."""
        began = time.perf_counter()
        result = self._engine.run(scene, spec)
        wall = time.perf_counter() - began
        if isinstance(result, States):
            per, step = steps_per_sample(scene, spec.step) if spec.step is not None else (1, None)
            result = RawRun(result, wall, per * (scene.samples - 1), step, form=spec.form)
        elif not isinstance(result, RawRun):
            raise EngineError(f"{self.name} {spec.method}: run returned {type(result).__name__}; it has to return "
                              "crosscheck.scene.states.States, or crosscheck.adapters.base.RawRun")
        elif isinstance(result.wall_time, numbers.Real) and 0.0 <= result.wall_time <= LONGEST and isinstance(
                result.stats, dict):
            # What its iterations leave would widen bounds; from an engine of the user it is not granted.
            given_stats = {name: value for name, value in result.stats.items() if name != "newton_left"}
            result.stats = cast(Stats, {**given_stats, "stated_time": float(result.wall_time)})
            result.wall_time = wall
        _complete(result.states)
        return result


def _complete(states: States) -> None:
    """Turn lists into arrays of doubles; their shapes are checked later, as for every engine."""
    for name in ("t", "x", "R", "v", "w", "a", "alpha", "lam", "hinges"):
        if (values := getattr(states, name)) is not None:
            setattr(states, name, doubles(name, values))


def load(name: str, known: Iterable[str], stated: str | None = None) -> Completed:
    """The engine given by "module:Class" or "path/file.py:Class".

    Modules are also searched in the current folder. `known` are the names of other engines, for the message; `stated`
    is the version of the package that offers it.

    Raises
    ------
    ArgumentError
        There is no such engine, or it lacks a required attribute or method.
    """
    home, _, attribute = name.rpartition(":")
    if not home or not attribute:
        raise ArgumentError(f"engine: {name!r} is not understood; a class is given as module:Class or "
                            "path/file.py:Class")
    try:
        own = code.digest(home) if Path(home).suffix == ".py" and Path(home).is_file() else ""  # what comes next
        with errors_as(lambda error: ArgumentError(f"engine: {home} cannot be imported: {named(error)}"),
                     ModuleNotFoundError):
            module = _module(home)
    except ModuleNotFoundError as error:
        if error.name != home.partition(".")[0]:  # a module that this module imports
            raise ArgumentError(f"engine: {home} cannot be imported: {error}; install it") from error
        raise ArgumentError(f"{unknown('engine', home, known)}; and there is no module of this name"
                            ) from None
    kind = getattr(module, attribute, None)
    if not callable(kind):
        classes = [key for key, value in vars(module).items()
                   if hasattr(value, "unsupported") and hasattr(value, "run")]
        raise ArgumentError(f"engine: {home} has no class {attribute!r}"
                            + (f"; engines there: {', '.join(classes)}" if classes else ""))
    with errors_as(lambda error: ArgumentError(f"engine: {name} cannot be made without arguments: {named(error)}")):
        engine = kind()
    stated = stated or getattr(module, "__version__", None)
    return completed(engine, name, None if stated is None else str(stated),
                     own or code.digest(home, getattr(module, "__file__", None)))


def _is_name(given: object) -> bool:
    return isinstance(given, str) and given.isprintable() and 0 < len(given) <= LONGEST_NAME


def completed(engine: Any, name: str, version: str | None, own: str = "") -> Completed:
    """`engine` with its defaults; raises `ArgumentError` naming what it lacks.

    Parameters
    ----------
    name : as the user wrote it
    version : of its module or package; None: it states none
    own : digest of its code; "": it is an object of the user's program, whose results are not stored
    """
    for method in ("unsupported", "run"):
        if not callable(getattr(engine, method, None)):
            raise ArgumentError(f"engine: {name} has no method {method}(scene, spec); an engine needs `unsupported` "
                                "and `run`, and the attributes `name` and `methods`")
    if not _is_name(getattr(engine, "name", None)):
        raise ArgumentError(f"engine: {name} has no attribute `name`; give it one, a text that is printable and has at "
                            f"most {LONGEST_NAME} characters")
    methods = getattr(engine, "methods", None)
    if not isinstance(methods, tuple | list) or not methods or not all(map(_is_name, methods)):
        raise ArgumentError(f"engine: {name}: `methods` has to be a tuple of names with at least one, printable and of "
                            f"at most {LONGEST_NAME} characters, not {brief(repr(methods), LONGEST_NAME)}")
    orders = getattr(engine, "orders", None) or {}
    if not isinstance(orders, Mapping) or not set(orders) <= set(methods) or not all(
            isinstance(order, int) and order > 0 for order in orders.values()):
        raise ArgumentError(f"engine: {name}: `orders` has to map names of its methods to whole numbers from 1, "
                            f"not {orders!r}")
    return Completed(engine, version, own)


def _module(home: str) -> types.ModuleType:
    if not home.endswith(".py"):
        if os.getcwd() not in sys.path:  # Python does not search there for a console script
            sys.path.append(os.getcwd())
        return importlib.import_module(home)
    path = Path(home).resolve()
    if not path.is_file():
        raise ArgumentError(f"engine: there is no file {home}")
    # The name distinguishes two files of the same name; the folder is needed for imports of files beside it.
    name = f"{path.stem}_{hashlib.sha256(str(path).encode()).hexdigest()[:8]}"
    if name in sys.modules:
        return sys.modules[name]
    if str(path.parent) not in sys.path:
        sys.path.append(str(path.parent))
    spec = importlib.util.spec_from_file_location(name, path)
    assert spec is not None
    assert spec.loader is not None
    module = sys.modules[name] = importlib.util.module_from_spec(spec)
    with contextlib.ExitStack() as broken:
        broken.callback(sys.modules.pop, name)
        spec.loader.exec_module(module)
        broken.pop_all()
    return module
