"""Numbers of a scene by their paths, "bodies.upper.mass", "gravity.2", "joints.elbow.child_anchor.0"."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any

import numpy as np

from crosscheck.errors import ArgumentError
from crosscheck.jointspace.motion import placed, positions
from crosscheck.scene.coordinates import at_start
from crosscheck.scene.model import Scene
from crosscheck.scene.schema import listed, nearest


def value_of(scene: Scene, path: str) -> float:
    """The number at a path. Raises `ArgumentError` naming the part that is not there."""
    node: Any = scene
    for part in path.split("."):
        node = _below(node, part, path)
    if isinstance(node, bool) or not isinstance(node, int | float | np.floating):
        raise ArgumentError(f"{path!r} of scene {scene.name!r} is no number")
    return float(node)


def altered(scene: Scene, path: str, value: float) -> Scene:
    """The scene with another number, at the same joint coordinates and rates.

    "speed" multiplies all velocities, so that the centre of mass of the first body has this speed (m/s).
    """
    if path == "speed":
        speed = float(np.linalg.norm(scene.v0[0]))
        if speed == 0.0:
            raise ArgumentError(f"speed: the first body of scene {scene.name!r} is at rest")
        factor = value / speed
        return scene.replace(bodies=tuple(dataclasses.replace(
            body, velocity=factor * body.velocity, angular_velocity=factor * body.angular_velocity)
            for body in scene.bodies))
    value_of(scene, path)
    parts = path.split(".")
    changed: Scene = _set(scene, parts, value)
    if parts[0] == "joints" and parts[-2] in ("parent_anchor", "child_anchor", "parent_axis", "child_axis"):
        q, v = positions(scene), np.concatenate([np.zeros(0), *(rate for _, rate in at_start(scene).values())])
        return placed(_normalised(changed, parts), q, v)
    return changed


def _normalised(scene: Scene, parts: list[str]) -> Scene:
    """With unit axes again."""
    if not parts[-2].endswith("axis"):
        return scene
    return scene.replace(joints=tuple(
        dataclasses.replace(joint, **{parts[-2]: (axis := np.array(getattr(joint, parts[-2]))) / np.linalg.norm(axis)})
        if joint.name == parts[1] or str(k) == parts[1] else joint for k, joint in enumerate(scene.joints)))


def _names(node: Any) -> list[str]:
    if isinstance(node, Mapping):
        return list(node)
    if dataclasses.is_dataclass(node):
        return [field.name for field in dataclasses.fields(node)]
    named = [each.name for each in node if hasattr(each, "name")] if isinstance(node, tuple) else []
    return named or [str(k) for k in range(len(node))] if isinstance(node, tuple | np.ndarray) else []


def _index(node: Any, part: str, path: str) -> int:
    names = _names(node)
    if part in names:
        return names.index(part)
    if part.isdigit() and int(part) < len(node):
        return int(part)
    raise ArgumentError(f"{path!r}: there is no {part!r}; {nearest(part, names)}it has {listed(names) or 'no parts'}")


def _below(node: Any, part: str, path: str) -> Any:
    if isinstance(node, tuple | np.ndarray):
        return node[_index(node, part, path)]
    if isinstance(node, Mapping) and part in node:
        return node[part]
    if dataclasses.is_dataclass(node):
        if hasattr(node, part) and part in _names(node):
            return getattr(node, part)
        if hasattr(node, "parameters") and part in node.parameters:
            return node.parameters[part]
    names = _names(node)
    raise ArgumentError(f"{path!r}: there is no {part!r}; {nearest(part, names)}it has {listed(names) or 'no parts'}")


def _set(node: Any, parts: list[str], value: float) -> Any:
    if not parts:
        return value
    part, rest = parts[0], parts[1:]
    if isinstance(node, np.ndarray):
        found = np.array(node)
        index = _index(node, part, part)
        found[index] = _set(found[index], rest, value)
        return found
    if isinstance(node, tuple):
        index = _index(node, part, part)
        return (*node[:index], _set(node[index], rest, value), *node[index + 1:])
    if isinstance(node, Mapping):
        return {**node, part: _set(node[part], rest, value)}
    if part not in _names(node):
        return dataclasses.replace(node, parameters=_set(node.parameters, parts, value))
    return dataclasses.replace(node, **{part: _set(getattr(node, part), rest, value)})
