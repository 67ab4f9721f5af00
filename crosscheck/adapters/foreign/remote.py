"""An engine of another version, seen from inside the environment made for it.

`crosscheck.adapters.foreign.versions` calls this.

Imported there, where only the engine and what its adapter needs are installed.
"""

from __future__ import annotations

import functools
from typing import Any

from crosscheck.adapters import built_in
from crosscheck.adapters.base import Engine


def describe(engine: str) -> dict[str, Any]:
    """What the adapter says about itself without a scene."""
    adapter: Any = _adapter(engine)
    found = {"version": adapter.version(), "methods": tuple(adapter.methods), "forms": tuple(adapter.forms),
             "options": frozenset(adapter.options)}
    return found | {"adaptive_methods": tuple(adapter.adaptive_methods)}


def ask(engine: str, question: str, *arguments: Any) -> Any:
    """The answer of the adapter's method `question`."""
    return getattr(_adapter(engine), question)(*arguments)


@functools.cache
def _adapter(engine: str) -> Engine:
    return built_in.ENTRIES[engine].make()
