"""Engines in a process of their own: those of another environment, and the user's own.

What such an engine does to its process (rounding mode, limits, patched packages, working folder, threads, handlers)
reaches no other engine and no judge. Its answers are plain data, see `crosscheck.jobs.workers.frames`.
"""

from __future__ import annotations

import sys
import weakref
from collections.abc import Callable, Sequence
from typing import Any, TypeVar

import numpy as np

from crosscheck.adapters.base import Engine, RawRun, RunSpec
from crosscheck.adapters.common.probe import Probe
from crosscheck.adapters.foreign import remote
from crosscheck.errors import ArgumentError, EngineDied, EngineError, SceneError, Unsupported
from crosscheck.scene.model import Scene
from crosscheck.scene.states import States

T = TypeVar("T")

LOADING, MEMORY = 60.0, 4 * 2**30
"""Time limit (s) and resident memory (bytes) for importing an engine of the user."""


class Process:
    """The process in which an engine runs. It is started when it is needed, and again after it has died."""

    def __init__(self, name: str, python: str | None = None) -> None:
        self._name, self._python = name, python  # for messages; path of the interpreter, None: this one
        self._worker: Any = None

    def call(self, function: Callable[..., Any], *arguments: object, loading: bool = False) -> Any:
        """The result of a function there.

        Raises the error that it raises, as an `EngineError` if it is none of ours, or `EngineDied` if the process
        ended, also because loading took too long or too much memory.
        """
        from crosscheck.jobs.workers.process import Crash, Limits, Worker

        if self._worker is None or not self._worker.alive:
            self._worker = Worker(self._python)
            # With the engine its process ends; `subprocess` itself would keep it, and its pipes open.
            weakref.finalize(self, self._worker.close).atexit = False
        answer = self._worker.call(function, arguments, Limits(LOADING, MEMORY) if loading else None)
        if isinstance(answer, Crash):
            if isinstance(answer.error, ArgumentError | EngineError | SceneError | Unsupported | ImportError):
                raise answer.error
            raise (EngineError if self._worker.alive else EngineDied)(f"{self._name}: {answer.message}")
        sys.stderr.write(self._worker.printed())
        return answer


class Stranger(Engine):
    """An engine of the user. Its module is never imported in this process.

    Raises `ArgumentError` and `EngineError` as `own.load`, and `EngineError` if loading it ends its process.
    """

    known_defects = ()  # nobody excuses findings of his own engine

    def __init__(self, home: remote.Home) -> None:
        self._home, self._process = home, Process(home.name)
        try:
            card: remote.Card = self._process.call(remote.card, home, loading=True)
        except EngineDied as error:
            raise EngineError(f"engine {home.name} cannot be loaded: {error}") from None
        vars(self).update(vars(card))
        self._version: str = self._process.call(remote.version, home)

    def version(self) -> str:
        """The version that it stated when it was loaded, with the digest of its code."""
        return self._version

    def unsupported(self, scene: Scene, spec: RunSpec) -> str | None:
        """The engine's answer."""
        return self._ask(remote.unsupported, scene, spec)

    def documented_order(self, scene: Scene, spec: RunSpec) -> int | None:
        """The engine's claim."""
        return self._ask(remote.documented_order, scene, spec)

    def held_levels(self, scene: Scene, spec: RunSpec) -> frozenset[str]:
        """The engine's claim."""
        return self._ask(remote.held_levels, scene, spec)

    def refused_map(self, spec: RunSpec) -> str | None:
        """The engine's answer."""
        return self._ask(remote.refused_map, spec)

    def turning(self, scene: Scene, form: str | None) -> Sequence[int]:
        """The engine's answer."""
        return self._ask(remote.turning, scene, form)

    def probe(self, scene: Scene, states: States, form: str | None) -> Probe:
        """The engine's answer."""
        return self._ask(remote.probe, scene, states, form)

    def derivatives(self, scene: Scene, state: tuple[np.ndarray, np.ndarray]) -> dict[str, np.ndarray] | None:
        """The engine's, or None."""
        return self._ask(remote.derivatives, scene, state)

    def run(self, scene: Scene, spec: RunSpec) -> RawRun:
        """The engine's run."""
        return self._ask(remote.run, scene, spec).raw()

    def _ask(self, function: Callable[..., T], *arguments: object) -> T:
        answer: T = self._process.call(function, self._home, *arguments)
        return answer
