"""Workers that live on from task to task, for any thread."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Any

from crosscheck.jobs.workers.process import Crash, Limits, Worker


class Crew:
    """Workers that live on from task to task: one is started when a task comes and none is idle."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._idle: list[Worker] = []
        self._all: set[Worker] = set()
        self._ending = False

    def call(self, function: Callable[[Any], Any], task: Any, limits: Limits | None = None, again: bool = False
             ) -> Any:
        """`function(task)` in a worker: its result, or a `Crash`. For any thread.

        With `again`, a task whose process was killed from outside, as by a system out of memory, runs once more.
        """
        result = self._call(function, task, limits)
        if again and isinstance(result, Crash) and result.signal == "SIGKILL":
            result = self._call(function, task, limits)
        return result

    def _call(self, function: Callable[[Any], Any], task: Any, limits: Limits | None) -> Any:
        with self._lock:
            if self._ending:
                return Crash("not run: stopped before it began")
            worker = self._idle.pop() if self._idle else Worker()
            self._all.add(worker)
        if not worker.alive:  # ended while it had nothing to do
            self._dismiss(worker)
            with self._lock:
                worker = Worker()
                self._all.add(worker)
        result = worker.call(function, (task,), limits)
        most = limits.memory / 2 if limits is not None and limits.memory is not None else None
        if not worker.alive or (most is not None and worker.memory() > most):  # what earlier tasks left counts too
            self._dismiss(worker)
        else:
            with self._lock:
                self._idle.append(worker)
        return result

    def close(self) -> None:
        """Let every worker end; none may be busy."""
        with self._lock:
            workers, self._all, self._idle = list(self._all), set(), []
        for worker in workers:
            worker.close()

    def kill(self) -> None:
        """End every worker at once, busy or not; no new one is started."""
        with self._lock:
            self._ending = True
            workers = list(self._all)
        for worker in workers:
            worker.kill("stopped by an interrupt")

    def _dismiss(self, worker: Worker) -> None:
        with self._lock:
            self._all.discard(worker)
        worker.close()


_crew: Crew | None = None


def isolated(function: Callable[[Any], Any], task: Any, limits: Limits | None = None, again: bool = False) -> Any:
    """`function(task)` in a worker process beside this one: what an executor on another machine is given to run."""
    global _crew
    if _crew is None:
        _crew = Crew()
    return _crew.call(function, task, limits, again)
