"""Where tasks run: in worker processes of this machine, on a Dask cluster, or on any executor from a factory."""

from __future__ import annotations

import concurrent.futures
import itertools
from collections.abc import Callable, Iterator
from typing import Any

from crosscheck.errors import CrosscheckError
from crosscheck.jobs.workers.crew import Crew, isolated
from crosscheck.jobs.workers.process import Crash, Limits
from crosscheck.running.cluster import Cluster
from crosscheck.sweeps import cells

LIMITS = Limits(time=3600.0, memory=4 * 2**30)
TRIES = 5
"""How often a task is tried if its worker is lost."""

Handle = Callable[[cells.Task, Any], list[cells.Task]]
"""A function that takes a task and its `Done` or `Crash`, and returns tasks to run in its place."""


class Local:
    """Worker processes of this machine."""

    def __init__(self, workers: int) -> None:
        self.workers = workers
        self._crew = Crew()
        self._pool = concurrent.futures.ThreadPoolExecutor(workers)

    def submit(self, task: cells.Task) -> concurrent.futures.Future[Any]:
        """The future of a task's `Done` or `Crash`."""
        return self._pool.submit(self._crew.call, cells.run, task, LIMITS, True)

    def close(self, at_once: bool) -> None:
        """End the workers; with `at_once`, even in the middle of their tasks."""
        if at_once:
            self._crew.kill()
        self._pool.shutdown(cancel_futures=True)
        self._crew.close()


class Foreign:
    """An executor from outside. Each of its workers starts one worker process of `crosscheck.jobs.workers`."""

    def __init__(self, cluster: Cluster) -> None:
        self.workers, self._cluster = cluster.workers, cluster

    def submit(self, task: cells.Task) -> concurrent.futures.Future[Any]:
        """The future of a task's `Done` or `Crash`."""
        return self._cluster.executor.submit(isolated, cells.run, task, LIMITS, True)

    def close(self, at_once: bool) -> None:
        """Disconnect from the executor."""
        self._cluster.close()


def run(tasks: Iterator[cells.Task], place: Local | Foreign, handle: Handle) -> None:
    """Run all tasks, with at most four per worker submitted at a time. `handle` is called in this thread for each.

    Raises
    ------
    CrosscheckError
        The connection to the scheduler was lost, or the scheduler failed.
    """
    flying: dict[concurrent.futures.Future[Any], tuple[cells.Task, int]] = {}
    waiting = iter(tasks)
    most = 4 * place.workers
    while True:
        for task in itertools.islice(waiting, max(0, most - len(flying))):
            flying[place.submit(task)] = task, 1
        if not flying:
            return
        ended, _ = concurrent.futures.wait(flying, return_when=concurrent.futures.FIRST_COMPLETED)
        for future in ended:
            task, tries = flying.pop(future)
            failure = None if future.cancelled() else future.exception()
            if future.cancelled() or type(failure).__name__ in ("CancelledError", "FutureCancelledError"):
                raise CrosscheckError("the scheduler was lost")
            if failure is not None and type(failure).__name__ == "KilledWorker" and tries < TRIES:
                flying[place.submit(task)] = task, tries + 1
            elif failure is not None:
                raise CrosscheckError(f"the scheduler failed: {type(failure).__name__}: {failure}")
            else:
                result = future.result()
                if isinstance(result, Crash) and result.signal == "SIGKILL" and tries < TRIES:
                    flying[place.submit(task)] = task, tries + 1
                    continue
                flying |= {place.submit(each): (each, 1) for each in handle(task, result)}
