"""Numbers of a scene by their paths in its file, such as "bodies.upper.mass" or "joints.elbow.child_anchor.0".

A change by path is the file edited and read again: all that is checked or follows there, the start too, does so here.
"""

from __future__ import annotations

import copy
import difflib
import json
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from crosscheck.errors import ArgumentError, SceneError
from crosscheck.scene.building import scene_from
from crosscheck.scene.model import Scene
from crosscheck.scene.schema import Content

UNITS = {"speed": "m/s", "mass": "kg", "inertia": "kg m²", "gravity": "m/s²", "duration": "s", "parent_anchor": "m",
         "child_anchor": "m", "angular_velocity": "rad/s", "parent_point": "m", "child_point": "m", "free_length": "m",
         "torque": "N m", "force": "N", "radius": "m", "length": "m"}
"""Of the numbers whose unit is known by their name; stiffness and damping are of turns or of lengths."""

OF_BODIES = {"position": "m", "velocity": "m/s"}
"""Of the same names of joints it depends on the joint."""


def unit(path: str) -> str:
    """The unit of the number at a path, "" if it has none or it depends on the joint."""
    group, *words = path.split(".")
    known = UNITS | (OF_BODIES if group == "bodies" else {})
    return next((known[word] for word in reversed((group, *words)) if word in known), "")


def content_of(scene: Scene) -> Content:
    """The content of the scene's file, with the scene's own duration and number of samples.

    Raises
    ------
    ArgumentError
        The scene is no longer that of its file.
    """
    content: Content = json.loads(scene.file[1]) if scene.file else {}
    if scene.file is None or scene_from(content, scene.file[0]).key != scene.key:
        raise ArgumentError(f"scene {scene.name!r} was changed in Python after it was read, so that its file does not "
                            "have its numbers; change the content of the file, and read that")
    return content | {"duration": scene.duration, "samples": scene.samples}


def changed(scene: Scene, changes: Mapping[str, object]) -> Scene:
    """The scene of the edited file: with other numbers, or lists of them, at these paths.

    Raises
    ------
    ArgumentError
        There is no number at a path, or it cannot be changed by itself, as the position of a body that joints hold.
    """
    return read(content_of(scene), changes, scene.file[0] if scene.file else scene.name)


def read(content: Content, changes: Mapping[str, object], origin: str) -> Scene:
    """The scene with this content of a file after some changes; see `changed`."""
    try:
        return scene_from(edited(content, changes), origin)
    except SceneError as error:
        what = " and ".join(f"{path} = {value!r}" for path, value in changes.items())
        raise ArgumentError(f"{what}: not to be changed {'together' if len(changes) > 1 else 'by itself'}: {error}"
                            ) from None


def number_at(content: Content, path: str) -> Any:
    """The number or list of numbers at a path.

    Raises
    ------
    ArgumentError
        There is nothing at the path, or not a number. The message names the scene and the nearest path.
    """
    value = _entry(content, path)
    if not _numeric(value):
        bodies = content.get("bodies") or [{}]
        raise ArgumentError(f"{path}: in scene {content.get('name')!r} this is no number but {value!r}; name a number, "
                            f"such as bodies.{bodies[0].get('name', '0')}.mass")
    return value


def size_at(content: Content, path: str) -> float:
    """The size of the number at a path, for steps of differences: of a zero that of the list it is in, or one."""
    value = number_at(content, path)
    words = path.split(".")
    while not np.any(value) and words[-1].isdecimal() and _numeric(_entry(content, ".".join(words[:-1]))):
        words = words[:-1]
        value = _entry(content, ".".join(words))
    return float(np.abs(value).max()) or 1.0


def numbers(content: Any, path: str = "") -> Iterator[str]:
    """The paths of all numbers of a file, or of a part of it at a path."""
    parts = content.items() if isinstance(content, dict) else [
        (part["name"] if isinstance(part, dict) and "name" in part else k, part) for k, part in enumerate(content)
    ] if isinstance(content, list) else ()
    for key, part in parts:
        yield from numbers(part, f"{path}.{key}".lstrip("."))
    if _numeric(content) and not isinstance(content, list):
        yield path


def edited(content: Content, changes: Mapping[str, object]) -> Content:
    """A copy of the content with the values of `changes` at their paths; the two entries of an inertia go together."""
    content = copy.deepcopy(content)
    for path, value in changes.items():
        *before, key = path.split(".")
        places = [(before, key)]
        if before[-2:-1] == ["inertia"]:
            places.append(([*before[:-1], key], before[-1]))
        for place, last in places:
            owner = _entry(content, ".".join(place)) if place else content
            if isinstance(owner, list):
                _entry(content, path)  # raises if there is no such entry
                owner[_index(owner, last) or 0] = value
            else:
                owner[last] = value
    return content


def _entry(node: Any, path: str) -> Any:
    walked: list[str] = []
    scene = node.get("name")
    for word in path.split("."):
        if isinstance(node, dict):
            names, entry = list(node), node.get(word)
        elif isinstance(node, list):
            index = _index(node, word)
            names = [each["name"] for each in node if isinstance(each, dict) and "name" in each]
            names = names or [str(k) for k in range(len(node))]
            entry = None if index is None else node[index]
        else:
            names, entry = [], None
        if entry is None:
            here = ".".join([*walked, word])
            near = difflib.get_close_matches(word, names, n=1)
            guess = f"did you mean {'.'.join([*walked, near[0]])!r}? " if near else ""
            there = f"there {'is' if len(names) == 1 else 'are'} {', '.join(names)}" if names else (
                f"there is nothing below {'.'.join(walked)!r}")
            raise ArgumentError(f"{path}: scene {scene!r} has no {here!r}; {guess}{there}")
        node = entry
        walked.append(word)
    return node


def _index(entries: list[Any], word: str) -> int | None:
    """The index of an entry by its name or number, or None."""
    for k, entry in enumerate(entries):
        if isinstance(entry, dict) and entry.get("name") == word:
            return k
    return int(word) if word.isdecimal() and int(word) < len(entries) else None


def _numeric(value: object) -> bool:
    if isinstance(value, list):
        return bool(value) and all(map(_numeric, value))
    return isinstance(value, int | float) and not isinstance(value, bool)
