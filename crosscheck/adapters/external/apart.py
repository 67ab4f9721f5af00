"""Engines in a process of their own: those of another environment, and the user's own.

What such an engine does to its process (rounding mode, limits, patched packages, working folder, threads, handlers)
reaches no other engine and no judge. Its answers are plain data, see `crosscheck.jobs.workers.frames`.
"""

from __future__ import annotations

import sys
import weakref
from collections.abc import Callable
from functools import partial
from typing import Any

from crosscheck.adapters.base import Engine, RawRun, RunSpec
from crosscheck.adapters.external import remote
from crosscheck.adapters.external.plain import PlainRun
from crosscheck.errors import ArgumentError, EngineDied, EngineError, SceneError, Unsupported
from crosscheck.scene.model import Scene

LOADING, MEMORY = 60.0, 4 * 2**30
"""Time limit (s) and resident memory (bytes) for importing an engine of the user."""


class Process:
    """The process in which an engine runs. It is started again after it has died."""

    def __init__(self, name: str, python: str | None = None) -> None:
        from crosscheck.jobs.workers.process import Worker

        self._name, self._worker = name, Worker(python)  # for messages; path of the interpreter, None: this one
        # With the engine its process ends; `subprocess` itself would keep it, and its pipe open.
        weakref.finalize(self, self._worker.close).atexit = False

    def call(self, function: Callable[..., Any], *arguments: object, loading: bool = False) -> Any:
        """The result of a function there.

        Raises the error that it raises, as an `EngineError` if it is none of ours, or `EngineDied` if the process
        ended, also because loading took too long or too much memory.
        """
        from crosscheck.jobs.workers.process import Crash, Limits

        self._worker.ready()
        answer = self._worker.call(function, arguments, Limits(LOADING, MEMORY) if loading else None)
        if isinstance(answer, Crash):
            error = answer.error()
            if isinstance(error, ArgumentError | EngineError | SceneError | Unsupported | ImportError):
                raise error
            raise (EngineError if self._worker.alive else EngineDied)(f"{self._name}: {answer.message}")
        sys.stderr.write(self._worker.printed())
        return answer


def _asked(function: Callable[..., Any]) -> Callable[..., Any]:
    return lambda self, *arguments: self.ask(function, *arguments)


class Stranger(Engine):
    """An engine of the user. Its module is never imported in this process.

    Raises `ArgumentError` and `EngineError` as `own.load`, and `EngineError` if loading it ends its process.
    """

    def __init__(self, home: remote.Home) -> None:
        self._home, self._process = home, Process(home.name)
        try:
            card: remote.Card = self._process.call(remote.card, home, loading=True)
        except EngineDied as error:
            raise EngineError(f"engine {home.name} cannot be loaded: {error}") from None
        vars(self).update(vars(card))
        self._version: str = self.ask(partial(remote.asked, Engine.version))

    def version(self) -> str:
        """The version that it stated when it was loaded, with the digest of its code."""
        return self._version

    unsupported = _asked(partial(remote.asked, Engine.unsupported))
    documented_order = _asked(partial(remote.asked, Engine.documented_order))
    held_levels = _asked(partial(remote.asked, Engine.held_levels))
    iteration = _asked(partial(remote.asked, Engine.iteration))
    refused_map = _asked(partial(remote.asked, Engine.refused_map))
    turning = _asked(remote.turning)
    probe = _asked(remote.probe)
    derivatives = _asked(remote.derivatives)

    def run(self, scene: Scene, spec: RunSpec) -> RawRun:
        """The engine's run."""
        plain: PlainRun = self.ask(remote.run, scene, spec)
        return plain.raw()

    def ask(self, function: Callable[..., Any], *arguments: object) -> Any:
        """The engine's own answer, from its process."""
        return self._process.call(function, self._home, *arguments)
