"""The model that an engine makes of a model file by itself, in the terms of scene tables."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterable, Mapping

import numpy as np

from crosscheck.scene.vectors import welded

TOLERANCE = 1e-7
"""Relative bound on a difference. It is small, because parsers read the same digits of the file."""


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
    limits: tuple[float, float] | None = None  # None: not said
    laws: Mapping[str, float | str] = dataclasses.field(default_factory=dict)  # what else it holds, by `LAWS`


LAWS = ("friction", "lower limit", "upper limit", "effort", "velocity limit", "damping", "mimic", "armature", "kp",
        "kv")
"""What a file may say of a joint beside its place, in N m, N, rad, m and their rates. An engine that has no such number
in its model has no such key, one that could have it and does not 0, or "none"."""


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
    frictionless: bool = False  # whether that applies no dry friction that the model stores
    refusal: str = ""  # the engine's error for the file itself, if it could be read only without its meshes
    tolerance: float = TOLERANCE  # relative, of a difference that counts
    shapes: Mapping[str, str] | None = None  # by link, as `solids` has them; None: not asked


def solids(shapes: Iterable[tuple[str, str, Iterable[float], np.ndarray]]) -> dict[str, str]:
    """Collision shapes in words, by link, from (link, kind, sizes, centre in the axes of the link), all in m.

    Of a mesh its kind alone: engines put its centre elsewhere.
    """
    listed: dict[str, list[str]] = {}
    for link, kind, sizes, centre in shapes:
        size, place = (", ".join(f"{round(each, 9) + 0.0:.6g}" for each in part) for part in (sizes, centre))
        listed.setdefault(link, []).append(kind if kind == "mesh" else f"{kind} {size} at {place}")
    return {link: "; ".join(sorted(words)) for link, words in listed.items()}


@dataclasses.dataclass(frozen=True)
class Part:
    """A link of a model as an engine holds it, with the joint that it hangs on, in world axes at coordinates zero."""

    parent: str  # "" for the world
    mass: float
    centre: np.ndarray  # (3,) of mass
    inertia: np.ndarray  # (3, 3) about it
    frame: np.ndarray  # (3, 3) axes of the link in the file
    joint: str = ""  # with one coordinate; "" where it is fixed to its parent
    anchor: np.ndarray = dataclasses.field(default_factory=lambda: np.zeros(3))
    axis: np.ndarray = dataclasses.field(default_factory=lambda: np.zeros(3))
    kind: str = "revolute"
    damping: float = 0.0
    limits: tuple[float, float] | None = None
    free: bool = False  # whether it floats
    armature: float = 0.0
    laws: Mapping[str, float | str] = dataclasses.field(default_factory=dict)  # as in `Hinge`


def assembled(engine: str, parts: Mapping[str, Part], gravity: np.ndarray) -> Native:
    """The links and joints of `parts` by name, parents first, each link with all that is fixed to it."""
    head: dict[str, str] = {"": "ground"}
    groups: dict[str, list[Part]] = {}
    for name, part in parts.items():
        head[name] = name if part.joint or part.free else head[part.parent]
        groups.setdefault(head[name], []).append(part)
    links: dict[str, Link] = {}
    centres, frames = {"ground": np.zeros(3)}, {"ground": np.eye(3)}
    for name, group in groups.items():
        if name == "ground":
            continue
        mass, centres[name], inertia = welded(*zip(*((part.mass, part.centre, part.inertia) for part in group),
                                                   strict=True))
        frame = frames[name] = parts[name].frame
        links[name] = Link(mass, frame.T @ inertia @ frame)
    joints = {}
    for name in links:
        part = parts[name]
        if part.free:
            continue
        parent, frame = head[part.parent], part.frame
        outer = frames[parent]
        joints[part.joint] = Hinge(parent, name, outer.T @ (part.anchor - centres[parent]),
                                   frame.T @ (part.anchor - centres[name]), frame.T @ part.axis, outer.T @ frame,
                                   part.kind, part.damping, part.armature, limits=part.limits, laws=part.laws)
    return Native(engine, links, joints, gravity)


def moved(model: Native, states: JointStates, columns: Mapping[str, int], solver: str,
          terms: Callable[[np.ndarray, np.ndarray], tuple[np.ndarray, ...]]) -> Native:
    """`model` with its accelerations, where all its joints are in `states`.

    Parameters
    ----------
    columns : place of each joint in the engine's coordinates
    terms : from positions and velocities in that order the mass matrix, the bias forces and, where these do not follow
        from the two, the accelerations
    """
    order = tuple(name for name in states.names if name in model.joints)
    if not order or len(order) != len(model.joints) or len(order) != len(columns):
        return model
    places, ours = [columns[name] for name in order], [states.names.index(name) for name in order]
    damping = np.array([model.joints[name].damping for name in order])
    values = []
    for position, velocity in zip(states.position, states.velocity, strict=True):
        q, v = np.zeros(len(order)), np.zeros(len(order))
        q[places], v[places] = position[ours], velocity[ours]
        M, bias, *own = terms(q, v)
        M, bias = M[np.ix_(places, places)], bias[places]
        values.append((M, bias, own[0][places] if own else np.linalg.solve(M, -bias - damping * velocity[ours])))
    mass, biases, accelerations = (np.array(each) for each in zip(*values, strict=True))
    return dataclasses.replace(model, order=order, mass_matrix=mass, bias=biases, acceleration=accelerations,
                               solver=solver)


@dataclasses.dataclass(frozen=True)
class JointStates:
    """K states of joints with one coordinate each, by name."""

    names: tuple[str, ...]
    position: np.ndarray  # (K, count)
    velocity: np.ndarray  # (K, count)
