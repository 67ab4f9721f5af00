"""The one loop over tasks: what has no row in the table of rows runs in workers, and its rows are put there.

A task that raises, crashes, hangs or takes too much memory gives a `Crash` as its result, and the others go on.
`concurrent.futures.ProcessPoolExecutor` is not used, because one dead worker breaks its whole pool, and a task that
hangs cannot be stopped. Here the executor has one thread per worker process, which waits for that process.
"""

from __future__ import annotations

import concurrent.futures
import contextlib
import dataclasses
import functools
import itertools
from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import TYPE_CHECKING, Any, Self, cast

from crosscheck.errors import FAILED, CrosscheckError
from crosscheck.jobs.workers.process import Crash, Crew, Limits, Result, Task, isolated

if TYPE_CHECKING:
    from crosscheck.jobs.table import Reuse, Session

__all__ = ["Crash", "Limits", "Place", "Stages", "drive", "run_tasks"]

TRIES = 5
"""How often a task is tried whose process was killed from outside."""

OUTSIDE = ("SIGKILL", "SIGTERM")
"""Signals by which others end a process."""

AHEAD = 4
"""Tasks submitted per worker. More would keep all tasks of a large sweep in memory, fewer could leave workers idle."""


class Place:
    """Where tasks run: in worker processes of this machine, or on an executor from outside.

    Each worker of such an executor, for example `dask.distributed.Client(address).get_executor()`, starts one worker
    process. At the end of the context all workers end, after an error even in the middle of their tasks.
    """

    def __init__(self, workers: int, executor: concurrent.futures.Executor | None = None) -> None:
        self.workers, self._crew, self._far = workers, Crew(), executor is not None
        self._pool = executor or concurrent.futures.ThreadPoolExecutor(workers)
        self._flying: set[concurrent.futures.Future[Any]] = set()  # of tasks of several kinds

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: object, *_: object) -> None:
        if kind is not None:
            self._crew.kill()
            for future in self._flying:
                future.cancel()
        if not self._far:
            self._pool.shutdown(cancel_futures=True)
        self._crew.close()

    def submit(self, function: Callable[[Task], Result], task: Task, limits: Limits | None
               ) -> concurrent.futures.Future[Result | Crash]:
        """The future of a task's result."""
        run = isolated if self._far else self._crew.call
        future: concurrent.futures.Future[Result | Crash] = self._pool.submit(
            functools.partial(run, function, task, limits))
        self._flying.add(future)
        return future

    def result(self, future: concurrent.futures.Future[Result | Crash]) -> Result | Crash:
        """The result of a future that has ended. Raises `CrosscheckError` if the scheduler was lost or failed."""
        self._flying.discard(future)
        failure = None if future.cancelled() else future.exception()
        name = type(failure).__name__
        if future.cancelled() or name in ("CancelledError", "FutureCancelledError"):
            raise CrosscheckError("the scheduler was lost; what ended is kept, and the same command continues from "
                                  "there")
        if failure is None:
            return future.result()
        if self._far and name != "KilledWorker":
            raise CrosscheckError(f"the scheduler failed: {name}: {failure}")
        return Crash(f"{name}: {failure}", signal="SIGKILL" if self._far else "")


def drive(function: Callable[[Task], Result], tasks: Iterable[Task], place: Place, limits: Limits | None = None,
          retry: bool = False) -> Iterator[tuple[int, Task, Result | Crash]]:
    """(position, task, result) of every task as it ends. Tasks are drawn from `tasks` as workers become free.

    Parameters
    ----------
    function, tasks : picklable; the function must be importable by name
    limits : most time and resident memory of one task
    retry : run a task once more if its process was killed from outside, for example by a system out of memory

    Raises
    ------
    CrosscheckError
        The connection to the scheduler behind the place was lost.
    """
    waiting = enumerate(tasks)
    flying: dict[concurrent.futures.Future[Result | Crash], tuple[int, Task, int]] = {}
    while True:
        for index, task in itertools.islice(waiting, max(0, AHEAD * place.workers - len(flying))):
            flying[place.submit(function, task, limits)] = index, task, 1
        if not flying:
            return
        ended, _ = concurrent.futures.wait(flying, return_when=concurrent.futures.FIRST_COMPLETED)
        for future in ended:
            index, task, tries = flying.pop(future)
            result = place.result(future)
            if retry and isinstance(result, Crash) and result.signal in OUTSIDE and tries < TRIES:
                flying[place.submit(function, task, limits)] = index, task, tries + 1
            else:
                yield index, task, result


def run_tasks(function: Callable[[Task], Result], tasks: Iterable[Task], jobs: int = 2,
              done: Callable[[int, Result | Crash], object] | None = None, limits: Limits | None = None,
              retry: bool = False, place: Place | None = None) -> list[Result | Crash]:
    """Results of `function(task)` for every task, in order, from `jobs` workers. `done` is called with (index, result)
    in this thread as each task ends. `place`: workers that stay. The others are those of `drive`.
    """
    listed = list(tasks)
    if not listed:
        return []
    results: dict[int, Result | Crash] = {}
    with contextlib.nullcontext(place) if place else Place(min(jobs, len(listed))) as place:
        for index, _, result in drive(function, listed, place, limits, retry):
            results[index] = result
            if done is not None:
                done(index, result)
    return [results[index] for index in range(len(listed))]


@dataclasses.dataclass
class Stages:
    """Run the stages of a command: many tasks of one kind each. Without a session nothing is kept."""

    jobs: int
    session: Session | None
    count: Callable[[str], None]  # called as each task ends
    place: Place | None = None  # whose workers serve all stages; otherwise each stage starts its own

    def run(self, stage: str, function: Callable[[Task], Result], tasks: Sequence[Task], keys: Sequence[str],
            labels: Sequence[str], limits: Limits | None = None, retry: bool = False,
            failure: Callable[[Result | Crash], str] | None = None, reuse: Reuse = "rows",
            on_results: Callable[[list[Result | Crash | None]], object] | None = None) -> list[Result | Crash]:
        """Results of one stage, in order. `keys` are those of the rows, `labels` name tasks in the progress bar.

        With `retry`, a task whose process was killed from outside runs once more. `failure` returns what is wrong with
        a result, or "". If something is wrong, the label begins with `FAILED` and ends with that text. `on_results` is
        called with all results as tasks end: None for those that have not.
        """
        kept = self.kept(stage, keys, reuse)
        results: list[Result | Crash | None] = [kept.get(key) for key in keys]
        missing = [index for index, result in enumerate(results) if result is None]
        for index in set(range(len(tasks))) - set(missing):
            self.count(labels[index])

        def ended(position: int, result: Result | Crash) -> None:
            index = missing[position]
            if self.session is not None and not isinstance(result, Crash):  # which a busy machine may have caused
                result = self.session.put(stage, keys[index], result)
            results[index] = result
            wrong = failure(result) if failure is not None else ""
            self.count(f"{FAILED}{labels[index]}: {wrong}" if wrong else labels[index])
            if on_results is not None:
                on_results(results)

        run_tasks(function, [tasks[index] for index in missing], self.jobs, ended, limits, retry, self.place)
        return cast(list[Result | Crash], results)

    def kept(self, stage: str, keys: Sequence[str], reuse: Reuse = "rows") -> dict[str, Any]:
        """The results of tasks that have not to be run, by their keys."""
        return {} if self.session is None else self.session.kept(stage, keys, reuse)
