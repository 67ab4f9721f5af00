"""What a joint holds besides its bodies and anchors: rows, coordinates with their drives and rotors, and contacts."""

from __future__ import annotations

import dataclasses
from typing import Annotated

import numpy as np

from lieeuler.checks import Flag, Frozen, Index, Number, Positive, Rotation, Unit, Vector, normals, one_of, positive
from lieeuler.functions import TimeFunction
from lieeuler.types import Measured


@dataclasses.dataclass(frozen=True)
class Dot(Frozen):
    """One scalar constraint row  scale * A . B - constant = 0.

    A and B are "difference" (child anchor minus parent anchor, world), or an axis fixed in "parent" or "child"
    (`a_axis`, `b_axis`, in that body's frame).
    """

    a: Annotated[str, one_of("difference", "parent", "child")]
    b: Annotated[str, one_of("difference", "parent", "child")]
    a_axis: Vector = dataclasses.field(default_factory=lambda: np.zeros(3))
    b_axis: Vector = dataclasses.field(default_factory=lambda: np.zeros(3))
    constant: Number = 0.0
    scale: Number = 1.0


@dataclasses.dataclass(frozen=True)
class Coordinate(Frozen):
    """The angle of a hinge, or the slide of a prismatic joint.

    Parameters
    ----------
    parent_axis, child_axis : (3,)
        The joint's axes, each in its body's frame.
    relative : (3, 3), optional
        R_child^T R_parent where the angle is zero; None means the slide, which is parent_axis . d.
    """

    parent_axis: Unit
    child_axis: Unit
    relative: Rotation | None = None

    @property
    def measured(self) -> Measured:
        """As the kernel takes it."""
        n1, n2 = normals(self.parent_axis)
        turns = self.relative is not None
        return turns, self.parent_axis, self.child_axis, n1, n2, n1 if self.relative is None else self.relative @ n1


@dataclasses.dataclass(frozen=True)
class Drive(Frozen):
    """A coordinate of a joint as a function of time, rad or m."""

    function: TimeFunction
    coordinate: Coordinate


@dataclasses.dataclass(frozen=True)
class Mimic(Frozen):
    """A coordinate follows one of another joint: coordinate = ratio * leader + offset.

    An angle of the leader counts from (-pi, pi] at the start, and is continuous from then on.

    Parameters
    ----------
    joint : int
        Index of the leader's joint.
    coordinate, leader : Coordinate
        Of the joint itself, and of the other.
    ratio, offset : float
        Units follow from the two coordinates: rad, m.
    """

    joint: Index
    coordinate: Coordinate
    leader: Coordinate
    ratio: Number
    offset: Number = 0.0


@dataclasses.dataclass(frozen=True)
class Rotor(Frozen):
    """Rotor inertia (armature) I of a hinge's angle or of a slide: it adds the kinetic energy I rate^2 / 2.

    It adds no gyroscopic torque, the same as in engines with joint coordinates. The joint must keep the two axes
    parallel.

    Parameters
    ----------
    inertia : float
        kg m^2 about the axis, or kg along it; > 0.
    parent_axis, child_axis : (3,)
        The joint's axes, each in its body's frame.
    turns : bool
        True: the rate is that of the child's angle relative to the parent; False: that of the slide parent_axis . d.
    """

    inertia: Positive
    parent_axis: Unit
    child_axis: Unit
    turns: Flag = True


@dataclasses.dataclass(frozen=True)
class Contact(Frozen):
    """One point of a body touches a plane of the ground, and does not slip: across a blade, or at all.

    Parameters
    ----------
    kind : "edge" | "disk" | "sphere"
    normal : (3,)
        Of the plane, towards the body, world axes.
    axis : (3,)
        Of the blade or of the disk, in the body's frame; that of a sphere is not looked at.
    radius : float
        m; 0 of an edge.
    """

    kind: Annotated[str, one_of("edge", "disk", "sphere")]
    normal: Unit
    axis: Unit
    radius: float = 0.0

    def __post_init__(self) -> None:
        super().__post_init__()
        object.__setattr__(self, "radius", 0.0 if self.kind == "edge" else positive("radius", self.radius))

    @property
    def across(self) -> tuple[np.ndarray, ...]:
        """Directions of the plane in which nothing slips; of an edge one that stands for that across its blade."""
        return normals(self.normal)[:1] if self.kind == "edge" else normals(self.normal)
