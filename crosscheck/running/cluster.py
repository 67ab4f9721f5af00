"""Run tasks on other machines: on a Dask cluster by its address, or on any executor that a factory function makes."""

from __future__ import annotations

import concurrent.futures
import contextlib
import importlib
from collections.abc import Callable, Iterator, Mapping
from typing import Any, TypeVar

from crosscheck import adapters
from crosscheck.errors import ArgumentError, CrosscheckError, errors_as, install, named
from crosscheck.jobs.drive import Place
from crosscheck.running import provenance

T = TypeVar("T")
Task = TypeVar("Task")

CONNECT = 10.0
"""Time to wait for a scheduler to answer, s."""


@contextlib.contextmanager
def place(scheduler: str, engines: tuple[str, ...]) -> Iterator[Place]:
    """Where tasks run: a Dask cluster at "tcp://host:port", or the executor of the factory "module:function".

    All workers of a Dask cluster must have the same versions of `engines` and libraries as this machine.

    Raises
    ------
    ArgumentError
        Nothing answers at the address, the cluster has no workers, or the extra `cluster` is not installed.
    CrosscheckError
        A worker has other versions; the message says which.
    """
    with contextlib.ExitStack() as stack:
        if "://" in scheduler:
            client = _client(scheduler)
            stack.callback(client.close, timeout=5)
            _check(scheduler, client, engines)
            executor, workers = client.get_executor(pure=False), sum(client.nthreads().values())
        else:
            executor = _made(scheduler)
            stack.callback(executor.shutdown)
            workers = int(getattr(executor, "_max_workers", 2))
        yield stack.enter_context(Place(workers, executor))


def _client(scheduler: str) -> Any:
    try:
        from distributed import Client
    except ImportError:
        raise ArgumentError(f"--scheduler needs Dask; {install('distributed')}") from None
    try:
        return Client(scheduler, timeout=CONNECT, set_as_default=False)
    except (OSError, ValueError) as error:
        reason = " ".join(str(error).split())[:200] or type(error).__name__
        raise ArgumentError(f"--scheduler {scheduler}: no scheduler answers there ({reason}); start one with "
                            "`dask scheduler` and workers with `dask worker tcp://host:8786`") from None


def _check(scheduler: str, client: Any, engines: tuple[str, ...]) -> None:
    """Raise if there are no workers, or one has other versions than this machine."""
    try:
        there = client.run(carrying, adapters.sources(engines), provenance.versions, engines)
    except ModuleNotFoundError as error:
        raise CrosscheckError(f"--scheduler {scheduler}: a worker there lacks {error.name}; install the same "
                              "environment on all machines") from None
    if not there:
        raise ArgumentError(f"--scheduler {scheduler}: it has no workers; start one with `dask worker {scheduler}`")
    for worker, theirs in there.items():
        provenance.refuse_others(provenance.versions(engines), theirs, f"worker {worker}")


def carrying(sources: Mapping[str, Mapping[str, bytes]], function: Callable[[Task], T], task: Task) -> T:
    """`function(task)` on a machine to which the user's own engines come, as from `adapters.sources`."""
    adapters.carry(sources)
    return function(task)


def _made(name: str) -> concurrent.futures.Executor:
    module, colon, factory = name.partition(":")
    with errors_as(lambda error: ArgumentError(
            f"--scheduler {name}: {named(error)}; give tcp://host:port, or module:factory of a function that returns a "
            "concurrent.futures executor")):
        executor: concurrent.futures.Executor = getattr(importlib.import_module(module), factory)()
    if not colon or not hasattr(executor, "submit"):
        raise ArgumentError(f"--scheduler {name}: what it returns is no executor")
    return executor
