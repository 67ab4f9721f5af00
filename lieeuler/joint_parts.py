"""What a joint holds besides its bodies and anchors: rows, coordinates with their drives and rotors, and contacts."""

from __future__ import annotations

import dataclasses

import numpy as np

from lieeuler.checks import Frozen, body_index, normals, number, positive, rotation, unit, vector
from lieeuler.errors import ArgumentError
from lieeuler.functions import TimeFunction
from lieeuler.types import Measured


@dataclasses.dataclass(frozen=True)
class Dot(Frozen):
    """One scalar constraint row  scale * A . B - constant = 0.

    A and B are "difference" (child anchor minus parent anchor, world), or an axis fixed in "parent" or "child"
    (`a_axis`, `b_axis`, in that body's frame).
    """

    a: str
    b: str
    a_axis: np.ndarray = dataclasses.field(default_factory=lambda: np.zeros(3))
    b_axis: np.ndarray = dataclasses.field(default_factory=lambda: np.zeros(3))
    constant: float = 0.0
    scale: float = 1.0

    def __post_init__(self) -> None:
        for carrier in (self.a, self.b):
            if not isinstance(carrier, str) or carrier not in ("difference", "parent", "child"):
                raise ArgumentError(f"a dot row multiplies 'difference', 'parent' or 'child', not {carrier!r}")
        self._take(vector, "a_axis", "b_axis")
        self._take(number, "constant", "scale")


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

    parent_axis: np.ndarray
    child_axis: np.ndarray
    relative: np.ndarray | None = None

    def __post_init__(self) -> None:
        self._take(unit, "parent_axis", "child_axis")
        if self.relative is not None:
            self._take(rotation, "relative")

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

    def __post_init__(self) -> None:
        for name, kind in (("function", TimeFunction), ("coordinate", Coordinate)):
            if not isinstance(getattr(self, name), kind):
                raise ArgumentError(f"{name} must be a lieeuler.{kind.__name__}, not {getattr(self, name)!r}")


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

    joint: int
    coordinate: Coordinate
    leader: Coordinate
    ratio: float
    offset: float = 0.0

    def __post_init__(self) -> None:
        self._take(body_index, "joint")
        for name in ("coordinate", "leader"):
            if not isinstance(getattr(self, name), Coordinate):
                raise ArgumentError(f"{name} must be a lieeuler.Coordinate, not {getattr(self, name)!r}")
        self._take(number, "ratio", "offset")


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

    inertia: float
    parent_axis: np.ndarray
    child_axis: np.ndarray
    turns: bool = True

    def __post_init__(self) -> None:
        self._take(positive, "inertia")
        self._take(unit, "parent_axis", "child_axis")
        if not isinstance(self.turns, bool):
            raise ArgumentError(f"turns must be True or False, not {self.turns!r}")


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

    kind: str
    normal: np.ndarray
    axis: np.ndarray
    radius: float = 0.0

    def __post_init__(self) -> None:
        if self.kind not in ("edge", "disk", "sphere"):
            raise ArgumentError(f"kind must be 'edge', 'disk' or 'sphere', not {self.kind!r}")
        self._take(unit, "normal", "axis")
        if self.kind == "edge":
            object.__setattr__(self, "radius", 0.0)
        else:
            self._take(positive, "radius")

    @property
    def across(self) -> tuple[np.ndarray, ...]:
        """Directions of the plane in which nothing slips; of an edge one that stands for that across its blade."""
        return normals(self.normal)[:1] if self.kind == "edge" else normals(self.normal)
