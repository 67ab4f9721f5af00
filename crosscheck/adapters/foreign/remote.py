"""An engine of another version, seen from inside the environment made for it.

`crosscheck.adapters.foreign.versions` calls this.

Imported there, where only the engine and what its adapter needs are installed.
"""

from __future__ import annotations

from typing import Any


def describe(engine: str) -> dict[str, Any]:
    """What the adapter says about itself without a scene."""
    from crosscheck import adapters

    adapter: Any = adapters.get(engine)
    found = {"version": adapter.version(), "methods": tuple(adapter.methods), "forms": tuple(adapter.forms),
             "options": frozenset(adapter.options)}
    return found | {"adaptive_methods": tuple(adapter.adaptive_methods)}


def ask(engine: str, question: str, *arguments: Any) -> Any:
    """The answer of the adapter's method `question`."""
    from crosscheck import adapters

    return getattr(adapters.get(engine), question)(*arguments)
