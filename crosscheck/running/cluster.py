"""Other machines: a Dask cluster by its address, or any executor from a factory."""

from __future__ import annotations

import concurrent.futures
import dataclasses
import functools
import importlib
from collections.abc import Callable

from crosscheck.errors import ArgumentError, CrosscheckError, install
from crosscheck.running import versions

CONNECT = 10.0
"""s to wait for a scheduler."""


@dataclasses.dataclass
class Cluster:
    """An executor that is not ours, how many tasks it runs at once, and what lets go of it."""

    executor: concurrent.futures.Executor
    workers: int
    close: Callable[[], None]


def connect(scheduler: str, engines: tuple[str, ...]) -> Cluster:
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
            versions.refuse_others(own, theirs, f"worker {worker}")
    except ModuleNotFoundError as error:
        client.close()
        raise CrosscheckError(f"--scheduler {scheduler}: a worker there lacks {error.name}; install the same "
                              "environment on all machines") from None
    except BaseException:
        client.close()
        raise
    workers = sum(client.nthreads().values())
    return Cluster(client.get_executor(pure=False), workers, functools.partial(client.close, timeout=5))


def _made(name: str) -> Cluster:
    module, colon, factory = name.partition(":")
    try:
        executor = getattr(importlib.import_module(module), factory)()
    except Exception as error:  # whatever a factory of the user's raises
        raise ArgumentError(f"--scheduler {name}: {type(error).__name__}: {error}; give tcp://host:port, or "
                            "module:factory of a function that returns a concurrent.futures executor") from None
    if not colon or not hasattr(executor, "submit"):
        raise ArgumentError(f"--scheduler {name}: what it returns is no executor")
    return Cluster(executor, int(getattr(executor, "_max_workers", 2)), executor.shutdown)
