"""Numbers of a problem by paths such as "bodies.0.mass", "joints.1.child_anchor" or "gravity.2"."""

from __future__ import annotations

import dataclasses
import difflib
from collections.abc import Callable, Collection, Mapping, Sequence
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


def changed(node: Any, changes: Mapping[tuple[str, ...], Callable[[Any], Any]]) -> Any:
    """The problem, or a part of it, with what paths name replaced, all at once; an inertia stays symmetric."""
    below: dict[str, dict[tuple[str, ...], Callable[[Any], Any]]] = {}
    for path, change in changes.items():
        if path:
            below.setdefault(path[0], {})[path[1:]] = change
        else:
            node = change(node)
    if not below:
        return node
    parts = _parts(node)
    made = {part: changed(parts[part], inner) for part, inner in below.items()}
    if "inertia" in made:
        made["inertia"] = _symmetric(made["inertia"], below["inertia"])
    if isinstance(node, tuple | np.ndarray):
        items = [made.get(str(k), each) for k, each in enumerate(node)]
        return tuple(items) if isinstance(node, tuple) else np.array(items)
    if hasattr(node, "unchecked"):
        return type(node).unchecked(node, **made)
    return dataclasses.replace(node, **made)


def _symmetric(J: Any, paths: Collection[tuple[str, ...]]) -> Any:
    """A tensor with each entry or row that `paths` set also on the other side, unless they set that one too."""
    made = np.array(J)
    for row, *column in (path for path in paths if path):
        for other in column or "012":
            if not {(other, row), (other,)} & set(paths):
                made[int(other), int(row)] = J[int(row), int(other)]
    return made
