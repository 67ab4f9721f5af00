"""Run tasks on other machines: on a Dask cluster by its address, or on any executor that a factory function makes."""

from __future__ import annotations

import concurrent.futures
import contextlib
import dataclasses
import functools
import importlib
from collections.abc import Callable, Mapping
from typing import TypeVar

from crosscheck import adapters
from crosscheck.errors import ArgumentError, CrosscheckError, errors_as, install, named
from crosscheck.running import versions

T = TypeVar("T")
Task = TypeVar("Task")

CONNECT = 10.0
"""Time to wait for a scheduler to answer, s."""


@dataclasses.dataclass
class Cluster:
    """An executor from outside, the number of tasks it runs at once, and the function that disconnects from it."""

    executor: concurrent.futures.Executor
    workers: int
    close: Callable[[], None]


def connect(scheduler: str, engines: tuple[str, ...]) -> Cluster:
    """Connect to a Dask cluster at "tcp://host:port", or call the factory "module:function" for an executor.

    All workers of a Dask cluster must have the same versions of `engines` and libraries as this machine.

    Raises
    ------
    ArgumentError
        Nothing answers at the address, the cluster has no workers, or the extra `cluster` is not installed.
    CrosscheckError
        A worker has other versions; the message says which.
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
    with contextlib.ExitStack() as unfit:
        unfit.callback(client.close)
        try:
            there = client.run(carrying, adapters.sources(engines), versions.of, engines)
        except ModuleNotFoundError as error:
            raise CrosscheckError(f"--scheduler {scheduler}: a worker there lacks {error.name}; install the same "
                                  "environment on all machines") from None
        if not there:
            raise ArgumentError(f"--scheduler {scheduler}: it has no workers; start one with `dask worker {scheduler}`")
        own = versions.of(engines)
        for worker, theirs in there.items():
            versions.refuse_others(own, theirs, f"worker {worker}")
        unfit.pop_all()
    workers = sum(client.nthreads().values())
    return Cluster(client.get_executor(pure=False), workers, functools.partial(client.close, timeout=5))


def carrying(sources: Mapping[str, Mapping[str, bytes]], function: Callable[[Task], T], task: Task) -> T:
    """`function(task)` on a machine to which the user's own engines come, as from `adapters.sources`."""
    adapters.carry(sources)
    return function(task)


def _made(name: str) -> Cluster:
    module, colon, factory = name.partition(":")
    with errors_as(lambda error: ArgumentError(
            f"--scheduler {name}: {named(error)}; give tcp://host:port, or module:factory of a function that returns a "
            "concurrent.futures executor")):
        executor = getattr(importlib.import_module(module), factory)()
    if not colon or not hasattr(executor, "submit"):
        raise ArgumentError(f"--scheduler {name}: what it returns is no executor")
    return Cluster(executor, int(getattr(executor, "_max_workers", 2)), executor.shutdown)
