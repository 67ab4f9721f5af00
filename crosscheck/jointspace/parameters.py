"""Numbers of a scene by their paths, "bodies.upper.mass", "gravity.2", "joints.elbow.child_anchor.0"."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any

import numpy as np

from crosscheck.errors import ArgumentError
from crosscheck.jointspace.motion import coordinates, placed
from crosscheck.scene.model import Scene
from crosscheck.scene.schema import listed, nearest

UNITS = {"speed": "m/s", "mass": "kg", "inertia": "kg m²", "gravity": "m/s²", "duration": "s", "parent_anchor": "m",
         "child_anchor": "m", "velocity": "m/s", "angular_velocity": "rad/s", "parent_point": "m", "child_point": "m",
         "rest_length": "m", "torque": "N m", "force": "N", "radius": "m"}
"""Of the numbers whose unit is known by their name; stiffness and damping are of turns or of lengths."""


def unit(path: str) -> str:
    """The unit of the number at a path, "" if it has none or it depends on the joint."""
    return next((UNITS[word] for word in reversed(path.split(".")) if word in UNITS), "")


def value_of(scene: Scene, path: str) -> float:
    """The number at a path. Raises `ArgumentError` naming the part that is not there."""
    node: Any = scene
    for part in path.split("."):
        parts = _parts(node)
        if part not in parts:
            raise ArgumentError(f"{path!r}: there is no {part!r}; {nearest(part, list(parts))}it has "
                                f"{listed(list(parts)) or 'no parts'}")
        node = parts[part]
    if isinstance(node, bool) or not isinstance(node, int | float | np.floating):
        raise ArgumentError(f"{path!r} of scene {scene.name!r} is no number")
    return float(node)


def _parts(node: object) -> dict[str, object]:
    """What there is below a part of a scene; members of a tuple by their names, and by their numbers."""
    if isinstance(node, tuple | np.ndarray):
        return {getattr(each, "name", None) or str(k): each for k, each in enumerate(node)} | {
            str(k): each for k, each in enumerate(node)}
    if dataclasses.is_dataclass(node):
        fields = {field.name: getattr(node, field.name) for field in dataclasses.fields(node)}
        return fields | dict(fields.get("parameters", ()))
    return dict(node) if isinstance(node, Mapping) else {}


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
        q, v = coordinates(scene)
        return placed(changed, q[0], v[0])
    return changed


def _set(node: Any, parts: list[str], value: float) -> Any:
    """The part of a scene with another number at a path below it; axes stay of unit length."""
    if not parts:
        return value
    part, below = parts[0], _set(_parts(node)[parts[0]], parts[1:], value)
    if isinstance(node, tuple | np.ndarray):
        index = int(part) if part.isdecimal() else [getattr(each, "name", "") for each in node].index(part)
        changed = [below if k == index else each for k, each in enumerate(node)]
        return tuple(changed) if isinstance(node, tuple) else np.array(changed)
    if isinstance(node, Mapping):
        return {**node, part: below}
    if part.endswith("_axis"):
        below = below / np.linalg.norm(below)
    if part not in {field.name for field in dataclasses.fields(node)}:
        return dataclasses.replace(node, parameters={**node.parameters, part: below})
    return dataclasses.replace(node, **{part: below})
