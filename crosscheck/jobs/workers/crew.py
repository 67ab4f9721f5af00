"""A pool of worker processes that each run many tasks, to be called from any thread."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import TypeVar

from crosscheck.jobs.workers.process import Crash, Limits, Worker

Task = TypeVar("Task")
Result = TypeVar("Result")


class Crew:
    """Workers that each run many tasks. A new one is started when a task arrives and none is idle."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._idle: list[Worker] = []
        self._all: set[Worker] = set()
        self._ending = False

    def call(self, function: Callable[[Task], Result], task: Task, limits: Limits | None = None) -> Result | Crash:
        """The result of `function(task)` in a worker, or a `Crash`. May be called from any thread."""
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
        if not worker.alive or (most is not None and worker.memory() > most):  # memory that tasks have not freed
            self._dismiss(worker)
        else:
            with self._lock:
                self._idle.append(worker)
        return result

    def close(self) -> None:
        """Let every worker end. None may be busy."""
        with self._lock:
            workers, self._all, self._idle = list(self._all), set(), []
        for worker in workers:
            worker.close()

    def kill(self) -> None:
        """End every worker at once, even a busy one, and start no new one."""
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


def isolated(function: Callable[[Task], Result], task: Task, limits: Limits | None = None) -> Result | Crash:
    """The result of `function(task)` in a worker process of this machine. Executors on other machines call this."""
    global _crew
    if _crew is None:
        _crew = Crew()
    return _crew.call(function, task, limits)
