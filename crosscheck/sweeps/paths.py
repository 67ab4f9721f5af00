"""Read and replace numbers in the content of a scene file by paths such as "bodies.upper.mass" or "gravity.2"."""

from __future__ import annotations

import copy
import difflib
from collections.abc import Mapping
from typing import Any

from crosscheck.errors import ArgumentError
from crosscheck.scene.schema import Content


def read(data: Content, path: str, scene: str) -> Any:
    """The number or list of numbers at a path.

    Raises
    ------
    ArgumentError
        There is nothing at the path, or not a number. The message names the scene and the nearest path.
    """
    value = _walk(data, path, scene)
    if not _numeric(value):
        bodies = data.get("bodies") or [{}]
        raise ArgumentError(f"{path}: in scene {scene!r} this is no number but {value!r}; name a number, such as "
                            f"bodies.{bodies[0].get('name', '0')}.mass")
    return value


def replaced(data: Content, changes: Mapping[str, object], scene: str) -> Content:
    """A copy of the content with the values of `changes` at their paths."""
    data = copy.deepcopy(data)
    for path, value in changes.items():
        words = path.split(".")
        target = _walk(data, ".".join(words[:-1]), scene) if len(words) > 1 else data
        key = words[-1]
        if isinstance(target, list):
            _walk(target, key, scene)  # raises if there is no such entry
            target[_index(target, key) or 0] = value
        else:
            target[key] = value
    return data


def _walk(data: Any, path: str, scene: str) -> Any:
    walked: list[str] = []
    for word in path.split("."):
        if isinstance(data, dict):
            names = list(data)
            found = data.get(word)
        elif isinstance(data, list):
            index = _index(data, word)
            names = [each["name"] for each in data if isinstance(each, dict) and "name" in each]
            names = names or [str(k) for k in range(len(data))]
            found = None if index is None else data[index]
        else:
            names, found = [], None
        if found is None:
            here = ".".join([*walked, word])
            near = difflib.get_close_matches(word, names, n=1)
            guess = f"did you mean {'.'.join([*walked, near[0]])!r}? " if near else ""
            raise ArgumentError(f"{path}: scene {scene!r} has no {here!r}; {guess}there "
                                f"{'is' if len(names) == 1 else 'are'} {', '.join(names) or 'nothing below'}")
        data = found
        walked.append(word)
    return data


def _index(entries: list[Any], word: str) -> int | None:
    """The index of an entry by its name or number, or None."""
    for k, entry in enumerate(entries):
        if isinstance(entry, dict) and entry.get("name") == word:
            return k
    return int(word) if word.isdecimal() and int(word) < len(entries) else None


def _numeric(value: Any) -> bool:
    if isinstance(value, list):
        return bool(value) and all(map(_numeric, value))
    return isinstance(value, int | float) and not isinstance(value, bool)
