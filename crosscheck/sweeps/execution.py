"""Where tasks run: supervised processes here, a Dask cluster by address, or any executor from a factory."""

from __future__ import annotations

import concurrent.futures
import functools
import importlib
from collections.abc import Callable, Iterator
from typing import Any

from crosscheck.errors import ArgumentError, CrosscheckError, install
from crosscheck.jobs.workers.crew import Crew, isolated
from crosscheck.jobs.workers.process import Crash, Limits
from crosscheck.running import versions
from crosscheck.sweeps import cells

LIMITS = Limits(time=3600.0, memory=4 * 2**30)
CONNECT = 10.0
"""s to wait for a scheduler."""
TRIES = 5
"""How often a task whose worker was lost is handed out."""

Handle = Callable[[cells.Task, Any], list[cells.Task]]
"""Takes a task and its `Done` or `Crash`; returns what is to be run instead."""


class Local:
    """Supervised processes of this machine."""

    def __init__(self, workers: int) -> None:
        self.workers = workers
        self._crew = Crew()
        self._pool = concurrent.futures.ThreadPoolExecutor(workers)

    def submit(self, task: cells.Task) -> concurrent.futures.Future[Any]:
        """The future of a task's `Done` or `Crash`."""
        return self._pool.submit(self._crew.call, cells.run, task, LIMITS, True)

    def close(self, at_once: bool) -> None:
        """End the workers; `at_once`: in the middle of their tasks."""
        if at_once:
            self._crew.kill()
        self._pool.shutdown(cancel_futures=True)
        self._crew.close()


class Foreign:
    """An executor that is not ours; each of its workers keeps a supervised process beside it."""

    def __init__(self, executor: Any, workers: int, close: Callable[[], None]) -> None:
        self.workers, self._executor, self._close = workers, executor, close

    def submit(self, task: cells.Task) -> concurrent.futures.Future[Any]:
        """The future of a task's `Done` or `Crash`."""
        found: concurrent.futures.Future[Any] = self._executor.submit(isolated, cells.run, task, LIMITS, True)
        return found

    def close(self, at_once: bool) -> None:
        """Let go of the executor."""
        self._close()


def connect(scheduler: str, engines: tuple[str, ...]) -> Foreign:
    """A Dask cluster at tcp://host:port whose workers have our versions, or the executor that module:factory makes.

    Raises
    ------
    ArgumentError
        Nothing answers there, it has no workers, or the extra `cluster` is missing.
    CrosscheckError
        A worker has other versions; the difference.
    """
    if "://" not in scheduler:
        return _made(scheduler)
    try:
        from distributed import Client
    except ImportError:
        raise ArgumentError(f"--scheduler needs Dask; {install('distributed')}") from None
    try:
        client = Client(scheduler, timeout=CONNECT, set_as_default=False)
    except (OSError, ValueError) as error:
        reason = " ".join(str(error).split())[:200] or type(error).__name__
        raise ArgumentError(f"--scheduler {scheduler}: no scheduler answers there ({reason}); start one with "
                            "`dask scheduler` and workers with `dask worker tcp://host:8786`") from None
    try:
        found = client.run(versions.of, engines)
        if not found:
            raise ArgumentError(f"--scheduler {scheduler}: it has no workers; start one with `dask worker {scheduler}`")
        own = versions.of(engines)
        for worker, theirs in found.items():
            cells.refuse_others(own, theirs, f"worker {worker}")
    except ModuleNotFoundError as error:
        client.close()
        raise CrosscheckError(f"--scheduler {scheduler}: a worker there lacks {error.name}; install the same "
                              "environment on all machines") from None
    except BaseException:
        client.close()
        raise
    workers = sum(client.nthreads().values())
    return Foreign(client.get_executor(pure=False), workers, functools.partial(client.close, timeout=5))


def _made(name: str) -> Foreign:
    module, colon, factory = name.partition(":")
    try:
        executor = getattr(importlib.import_module(module), factory)()
    except Exception as error:  # whatever a factory of the user's raises
        raise ArgumentError(f"--scheduler {name}: {type(error).__name__}: {error}; give tcp://host:port, or "
                            "module:factory of a function that returns a concurrent.futures executor") from None
    if not colon or not hasattr(executor, "submit"):
        raise ArgumentError(f"--scheduler {name}: what it returns is no executor")
    return Foreign(executor, int(getattr(executor, "_max_workers", 2)), executor.shutdown)


def run(tasks: Iterator[cells.Task], place: Local | Foreign, handle: Handle) -> None:
    """Keep every worker busy, with few tasks in flight; `handle` is called in this thread as each ends.

    Raises
    ------
    CrosscheckError
        The scheduler was lost.
    """
    flying: dict[concurrent.futures.Future[Any], tuple[cells.Task, int]] = {}
    waiting = iter(tasks)
    most = 4 * place.workers
    while True:
        for task in _some(waiting, most - len(flying)):
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


def _some(tasks: Iterator[cells.Task], count: int) -> Iterator[cells.Task]:
    for _ in range(count):
        try:
            yield next(tasks)
        except StopIteration:
            return
