"""A pool of worker processes that each run many tasks, to be called from any thread."""

from __future__ import annotations

import functools
import threading
from collections.abc import Callable
from typing import TypeVar

from crosscheck.jobs.workers.frames import Crash
from crosscheck.jobs.workers.process import Limits, Worker

Task = TypeVar("Task")
Result = TypeVar("Result")


class Crew:
    """Workers that each run many tasks. A new one is started when a task arrives and none is idle."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._idle: list[Worker] = []
        self._all: list[Worker] = []
        self._ending = False

    def call(self, function: Callable[[Task], Result], task: Task, limits: Limits | None = None) -> Result | Crash:
        """The result of `function(task)` in a worker, or a `Crash`. May be called from any thread."""
        with self._lock:
            if self._ending:
                return Crash("not run: stopped before it began")
            if not self._idle:
                self._all.append(Worker())
                self._idle.append(self._all[-1])
            worker = self._idle.pop()
            worker.ready()
        result = worker.call(function, (task,), limits)
        if limits is not None and limits.memory is not None and worker.memory() > limits.memory / 2:
            worker.close()  # memory that tasks have not freed
        with self._lock:
            self._idle.append(worker)
        return result

    def close(self) -> None:
        """Let every worker end. None may be busy."""
        with self._lock:
            while self._all:
                self._all.pop().close()
            self._idle.clear()

    def kill(self) -> None:
        """End every worker at once, even a busy one, and start no new one."""
        with self._lock:
            self._ending = True
            for worker in self._all:
                worker.kill("stopped by an interrupt")


_crew = functools.cache(Crew)


def isolated(function: Callable[[Task], Result], task: Task, limits: Limits | None = None) -> Result | Crash:
    """The result of `function(task)` in a worker process of this machine. Executors on other machines call this."""
    return _crew().call(function, task, limits)
