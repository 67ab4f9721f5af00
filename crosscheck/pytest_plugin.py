"""pytest plugin: `crosscheck_run` and `crosscheck_truth` run each engine and compute each truth once a session."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest


@pytest.fixture(scope="session")
def crosscheck_run() -> Callable[..., Any]:
    """`crosscheck.run` that remembers: the same arguments a second time return the same trajectory at once.

    Called with a Scene, a built-in name or a path, then as `crosscheck.run`. Failed runs are not remembered. The
    arrays of a trajectory are shared between tests: they are read-only.
    """
    remembered: dict[tuple[Any, ...], Any] = {}

    def run(scene: Any, engine: str, method: str, **options: Any) -> Any:
        from crosscheck.running import run as run_scene

        loaded = _loaded(scene)
        # The hash leaves out the name, which a trajectory carries along.
        key = (loaded.hash, loaded.name, engine, method, tuple(sorted(options.items())))
        try:
            hash(key)
        except TypeError:  # a list or an array among the arguments: let `crosscheck.run` say what is wrong with it
            return _frozen(run_scene(loaded, engine, method, **options))
        if key not in remembered:
            remembered[key] = _frozen(run_scene(loaded, engine, method, **options))
        return remembered[key]

    return run


@pytest.fixture(scope="session")
def crosscheck_truth() -> Callable[[Any], Any]:
    """`crosscheck.truth` that remembers within the session, on top of its cache on disk; the arrays are read-only."""
    remembered: dict[str, Any] = {}

    def truth(scene: Any) -> Any:
        from crosscheck.references import truth as truth_of

        loaded = _loaded(scene)
        if loaded.hash not in remembered:
            reference = truth_of(loaded)
            _frozen(reference.states)
            remembered[loaded.hash] = reference
        return remembered[loaded.hash]

    return truth


def _loaded(scene: Any) -> Any:
    from crosscheck.scene_file import as_scene

    return as_scene(scene)


def _frozen(record: Any) -> Any:
    """Make every array of a record read-only, so that no test changes what the next one sees."""
    import dataclasses

    import numpy as np

    for field in dataclasses.fields(record):
        value = getattr(record, field.name)
        if isinstance(value, np.ndarray):
            value.setflags(write=False)
    return record
