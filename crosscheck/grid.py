"""Independent tasks in worker processes. One that raises, or that kills its worker, becomes a `Crash`, not an end."""

from __future__ import annotations

import concurrent.futures
import contextlib
import dataclasses
import multiprocessing
import os
import signal
import traceback
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures.process import BrokenProcessPool
from typing import Any


@dataclasses.dataclass(frozen=True)
class Crash:
    """What is left of a task that did not return."""

    message: str  # one line
    details: str = ""  # traceback, where there is one


def _prepare_worker() -> None:
    """One thread per worker, so that two workers do not time each other; engines' chatter must not mix with --json."""
    for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ.setdefault(variable, "1")
    # Ctrl-C reaches the whole process group; the parent alone answers it, and ends its workers.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    silence = os.open(os.devnull, os.O_WRONLY)
    os.dup2(silence, 1)
    os.close(silence)


def _guarded(function: Callable[[Any], Any], task: Any) -> Any:
    try:
        return function(task)
    except Exception as error:
        return Crash(f"{type(error).__name__}: {error}", traceback.format_exc())


def _pool(workers: int) -> concurrent.futures.ProcessPoolExecutor:
    # Spawned, not forked: engines and heyoka hold threads and compiled code that do not survive a fork.
    return concurrent.futures.ProcessPoolExecutor(
        workers, mp_context=multiprocessing.get_context("spawn"), initializer=_prepare_worker)


@contextlib.contextmanager
def _stopping(pool: concurrent.futures.ProcessPoolExecutor) -> Iterator[concurrent.futures.ProcessPoolExecutor]:
    """The pool; after an interrupt its workers end at once, where leaving it would wait for their tasks."""
    try:
        with pool:
            try:
                yield pool
            except KeyboardInterrupt:
                # The executor offers no way to stop a running task before Python 3.14.
                for process in list((pool._processes or {}).values()):
                    process.terminate()
                pool.shutdown(wait=False, cancel_futures=True)
                raise
    finally:
        pool.shutdown(wait=False, cancel_futures=True)


def _alone(function: Callable[[Any], Any], task: Any) -> Any:
    """Run a task in a worker of its own; if that worker dies, the task is what killed it."""
    with _stopping(_pool(1)) as pool:
        try:
            return pool.submit(_guarded, function, task).result()
        except BrokenProcessPool:
            return Crash("the worker process died while it ran this (a crash inside an engine, or memory ran out)")


def run_tasks(function: Callable[[Any], Any], tasks: Iterable[Any], jobs: int = 2,
              done: Callable[[int, Any], None] | None = None) -> list[Any]:
    """Results of `function(task)` for every task, in order, computed by `jobs` spawned processes.

    Parameters
    ----------
    function, tasks : picklable; the function must be importable by name
    jobs : number of worker processes
    done : called in this process with (index, result) as each task ends

    Returns
    -------
    list
        One result per task; a `Crash` where the task raised or its process died.
    """
    waiting: list[tuple[int, Any]] = list(enumerate(tasks))
    results: list[Any] = [None] * len(waiting)

    def record(index: int, result: Any) -> None:
        results[index] = result
        if done is not None:
            done(index, result)

    while waiting:
        suspects = _drain(function, waiting, jobs, record)
        # A dead worker takes the whole pool with it: of the few tasks in flight only a run alone tells which did it.
        for index, task in suspects:
            record(index, _alone(function, task))
    return results


def _drain(function: Callable[[Any], Any], waiting: list[tuple[int, Any]], jobs: int,
           record: Callable[[int, Any], None]) -> Sequence[tuple[int, Any]]:
    """Work off `waiting` until it is empty or a worker dies; returns the tasks that were in flight then."""
    flying: dict[concurrent.futures.Future[Any], tuple[int, Any]] = {}
    broken = False
    with _stopping(_pool(min(jobs, len(waiting)))) as pool:
        while (waiting or flying) and not broken:
            while waiting and len(flying) < jobs and not broken:
                try:
                    flying[pool.submit(_guarded, function, waiting[0][1])] = waiting[0]
                    waiting.pop(0)
                except BrokenProcessPool:
                    broken = True
            ended, _ = concurrent.futures.wait(flying, return_when=concurrent.futures.FIRST_COMPLETED)
            for future in ended:
                if isinstance(future.exception(), BrokenProcessPool):
                    broken = True
                else:
                    record(flying.pop(future)[0], future.result())
    # Leaving the pool waited for the rest: one that still finished is not a suspect.
    for future in [future for future in flying if future.exception() is None]:
        record(flying.pop(future)[0], future.result())
    return list(flying.values())
