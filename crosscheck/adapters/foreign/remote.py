"""Runs inside the separate environment of an engine's version, made by `crosscheck.adapters.foreign.versions`.

Only the engine and the packages that its adapter needs are installed there.
"""

from __future__ import annotations

import dataclasses
import functools
from typing import Any

from crosscheck.adapters import built_in
from crosscheck.adapters.base import Engine


@dataclasses.dataclass(frozen=True)
class About:
    """Properties of an adapter that do not depend on a scene."""

    version: str
    methods: tuple[str, ...]
    forms: tuple[str, ...]
    options: frozenset[str]
    adaptive_methods: tuple[str, ...]
    reads_models: bool  # its adapter has a method `native`


def describe(engine: str) -> About:
    """The properties of the adapter of this name."""
    adapter: Any = _adapter(engine)
    return About(adapter.version(), tuple(adapter.methods), tuple(adapter.forms), frozenset(adapter.options),
                 tuple(adapter.adaptive_methods), hasattr(adapter, "native"))


def ask(engine: str, question: str, *arguments: Any) -> Any:
    """The result of the adapter's method `question`."""
    return getattr(_adapter(engine), question)(*arguments)


@functools.cache
def _adapter(engine: str) -> Engine:
    return built_in.ENTRIES[engine].make()
