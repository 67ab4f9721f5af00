"""Numbers of a problem by paths such as "bodies.0.mass", "joints.1.child_anchor" or "gravity.2"."""

from __future__ import annotations

import dataclasses
import difflib
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from lieeuler.errors import ArgumentError


def _parts(node: Any) -> dict[str, Any]:
    """What there is below a part of a problem, by its name or number."""
    if dataclasses.is_dataclass(node):
        return {field.name: getattr(node, field.name) for field in dataclasses.fields(node)}
    return {str(k): each for k, each in enumerate(node)} if isinstance(node, tuple | np.ndarray) else {}


def along(problem: Any, path: str, argument: str, roots: Sequence[str] = ()) -> list[Any]:
    """What a path passes, from the problem to what it names. `roots`: what it may begin with, if not with anything.

    Raises
    ------
    ArgumentError
        There is nothing of this path; the message names the argument.
    """
    nodes = [problem]
    for part in str(path).split("."):
        known = {name: each for name, each in _parts(nodes[-1]).items() if len(nodes) > 1 or not roots or name in roots}
        if part not in known:
            names = [name for name, each in known.items() if not isinstance(each, str | bool | None)]
            near = difflib.get_close_matches(part, names, n=1)
            raise ArgumentError(f"{argument}: there is no {path!r}: {part!r} is none of {', '.join(names) or 'it'}"
                                + (f"; did you mean {near[0]!r}?" if near else ""))
        nodes.append(known[part])
    return nodes


def changed(node: Any, path: Sequence[str], change: Callable[[Any], Any]) -> Any:
    """The problem, or a part of it, with what a path names replaced; an inertia stays symmetric."""
    if not path:
        return change(node)
    part = path[0]
    if isinstance(node, np.ndarray) and len(path) == 2 and node.shape == (3, 3):
        made = np.array(node)
        for i, j in {(int(part), int(path[1])), (int(path[1]), int(part))}:
            made[i, j] = change(made[i, j])
        return made
    below = changed(_parts(node)[part], path[1:], change)
    if isinstance(node, tuple | np.ndarray):
        items = [below if k == int(part) else each for k, each in enumerate(node)]
        return tuple(items) if isinstance(node, tuple) else np.array(items)
    if hasattr(node, "unchecked"):
        return type(node).unchecked(node, **{part: below})
    return dataclasses.replace(node, **{part: below})
