"""An engine of another version, seen from inside the environment made for it by `crosscheck.adapters.foreign.versions`.

This module is imported there, where only the engine and what its adapter needs are installed.
"""

from __future__ import annotations

import dataclasses
import functools
from typing import Any

from crosscheck.adapters import built_in
from crosscheck.adapters.base import Engine


@dataclasses.dataclass(frozen=True)
class About:
    """What an adapter says about itself without a scene."""

    version: str
    methods: tuple[str, ...]
    forms: tuple[str, ...]
    options: frozenset[str]
    adaptive_methods: tuple[str, ...]
    reads_models: bool  # its adapter has a method `native`


def describe(engine: str) -> About:
    """About the adapter of this name."""
    adapter: Any = _adapter(engine)
    return About(adapter.version(), tuple(adapter.methods), tuple(adapter.forms), frozenset(adapter.options),
                 tuple(adapter.adaptive_methods), hasattr(adapter, "native"))


def ask(engine: str, question: str, *arguments: Any) -> Any:
    """The answer of the adapter's method `question`."""
    return getattr(_adapter(engine), question)(*arguments)


@functools.cache
def _adapter(engine: str) -> Engine:
    return built_in.ENTRIES[engine].make()
