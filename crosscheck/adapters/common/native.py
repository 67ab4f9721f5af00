"""The model that an engine makes of a model file by itself, in the terms of scene tables."""

from __future__ import annotations

import dataclasses

import numpy as np


@dataclasses.dataclass(frozen=True)
class Link:
    """A body with all bodies welded to it, in the axes of its link in the file."""

    mass: float
    inertia: np.ndarray  # (3, 3) about the centre of mass


@dataclasses.dataclass(frozen=True)
class Hinge:
    """A joint with one coordinate, at coordinate zero. Points are from the centres of mass, in the body's axes."""

    parent: str
    child: str
    parent_anchor: np.ndarray
    child_anchor: np.ndarray
    axis: np.ndarray  # (3,) in the child
    attitude: np.ndarray  # (3, 3) of the child in the parent
    kind: str = "revolute"  # or "prismatic"
    damping: float = 0.0
    armature: float = 0.0
    stiffness: float = 0.0
    rest_position: float = 0.0
    mimic: str = ""  # the joint that it follows


@dataclasses.dataclass(frozen=True)
class Native:
    """An engine's own model of a file, evaluated at K states of the joints in `order`."""

    engine: str
    links: dict[str, Link]
    joints: dict[str, Hinge]
    gravity: np.ndarray
    order: tuple[str, ...] = ()
    mass_matrix: np.ndarray | None = None  # (K, nv, nv)
    bias: np.ndarray | None = None  # (K, nv)
    acceleration: np.ndarray | None = None  # (K, nv)
    solver: str = ""  # the engine's function for the accelerations
    refusal: str = ""  # the engine's error for the file itself, if it could be read only without its meshes


@dataclasses.dataclass(frozen=True)
class JointStates:
    """K states of joints with one coordinate each, by name."""

    names: tuple[str, ...]
    position: np.ndarray  # (K, count)
    velocity: np.ndarray  # (K, count)
