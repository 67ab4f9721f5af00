"""Runs inside the separate environment of an engine, made by `crosscheck.adapters.foreign.versions`.

Only the engine and the packages that its adapter needs are installed there.
"""

from __future__ import annotations

import functools
from typing import Any

from crosscheck.adapters import built_in
from crosscheck.adapters.base import Engine


def ask(engine: str, question: str, *arguments: Any) -> Any:
    """The result of the adapter's method `question`."""
    return getattr(_adapter(engine), question)(*arguments)


@functools.cache
def _adapter(engine: str) -> Engine:
    return built_in.ENTRIES[engine].make()
