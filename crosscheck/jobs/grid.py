"""Run independent tasks in worker processes. A task that raises, crashes, hangs or takes too much memory gives a
`Crash` as its result, and the others go on.

`concurrent.futures.ProcessPoolExecutor` is not used, because one dead worker breaks its whole pool, and a task that
hangs cannot be stopped. Here the executor has one thread per worker process, which waits for that process.
"""

from __future__ import annotations

import concurrent.futures
import functools
from collections.abc import Callable, Iterable
from typing import Any

from crosscheck.errors import CrosscheckError
from crosscheck.jobs.workers.crew import Crew, isolated
from crosscheck.jobs.workers.process import Crash, Limits

__all__ = ["Crash", "Limits", "run_tasks"]


def run_tasks(function: Callable[[Any], Any], tasks: Iterable[Any], jobs: int = 2,
              done: Callable[[int, Any], None] | None = None, limits: Limits | None = None,
              executor: concurrent.futures.Executor | None = None, again: bool = False) -> list[Any]:
    """Results of `function(task)` for every task, in order, computed by `jobs` worker processes.

    Parameters
    ----------
    function, tasks : picklable; the function must be importable by name
    jobs : number of worker processes, each of which runs one task after the other
    done : called in this thread with (index, result) as soon as a task ends
    limits : most time and resident memory of one task
    executor : runs the tasks instead of `jobs` threads of this process, for example `dask.distributed.Client(address)
        .get_executor()`; each of its workers starts one worker process
    again : run a task once more if its process was killed from outside

    Returns
    -------
    list
        One result per task. It is a `Crash` if the task raised or exceeded its limits, or if its process died.

    Raises
    ------
    CrosscheckError
        The connection to the scheduler behind `executor` was lost.
    """
    waiting = list(enumerate(tasks))
    results: list[Any] = [None] * len(waiting)
    if not waiting:
        return results
    crew = Crew()
    pool = executor or concurrent.futures.ThreadPoolExecutor(min(jobs, len(waiting)))
    run = isolated if executor is not None else crew.call
    flying: dict[concurrent.futures.Future[Any], int] = {}
    try:
        for index, task in waiting:
            flying[pool.submit(functools.partial(run, function, task, limits, again))] = index
        for future in concurrent.futures.as_completed(flying):
            index = flying[future]
            if future.cancelled() or type(failure := future.exception()).__name__ == "FutureCancelledError":
                raise CrosscheckError("the scheduler was lost; what ended is kept, and the same "
                                      "command continues from there")
            results[index] = future.result() if failure is None else Crash(f"{type(failure).__name__}: {failure}")
            if done is not None:
                done(index, results[index])
    except BaseException:
        crew.kill()
        for future in flying:
            future.cancel()
        raise
    finally:
        if executor is None:
            pool.shutdown(cancel_futures=True)
        crew.close()
    return results
