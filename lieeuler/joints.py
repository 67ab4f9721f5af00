"""Joints, composed of the basic constraints spherical, dot-1, dot-2 and distance (after Haug).

d = child anchor - parent anchor (world); n1, n2 are unit vectors of the parent, normal to its axis and to each other.

==================  ====  ==========================================================================================
joint               rows  constraints, in the order of the multipliers
==================  ====  ==========================================================================================
spherical              3  d = 0
universal              4  d = 0; parent_axis . child_axis = 0
revolute               5  d = 0; n1 . child_axis = 0, n2 . child_axis = 0
cylindrical            4  n1 . child_axis = 0, n2 . child_axis = 0; n1 . d = 0, n2 . d = 0
prismatic              5  those of cylindrical; n1 . b = 0, b of the child normal to its axis
planar                 3  n1 . child_axis = 0, n2 . child_axis = 0; parent_axis . d = 0
fixed                  6  d = 0; e1 . f2 = 0, e2 . f3 = 0, e3 . f1 = 0
distance               1  (d . d - c^2) / (2 c) = 0
point_on_line          2  n1 . d = 0, n2 . d = 0
point_on_plane         1  parent_axis . d = 0
knife_edge             2  parent_axis . d = 0; (parent_axis x child_axis) . s = 0
rolling_disk           3  height of the centre; n1 . s = 0, n2 . s = 0
rolling_sphere         3  parent_axis . d - radius = 0; n1 . s = 0, n2 . s = 0
==================  ====  ==========================================================================================

s is the velocity of the body's point that touches the plane. Its rows hold velocities alone, A(q) u = 0: no position is
closed to them. The height of a disk's centre is parent_axis . d - radius sqrt(1 - (parent_axis . child_axis)^2).

Anchors are measured from the centre of mass in the body's frame; those of the ground (index -1) are world coordinates.
Axes are given in the body's frame and are normalised here.
"""

from __future__ import annotations

import dataclasses
from typing import Annotated, Any

import numpy as np

from lieeuler import _kernel
from lieeuler.checks import Flag, Frozen, Index, normals, positive, rotation, unit, vector
from lieeuler.errors import ArgumentError
from lieeuler.joint_parts import Contact, Dot, Drive, Mimic, Rotor
from lieeuler.joint_parts import Coordinate as Coordinate
from lieeuler.types import GROUND, ArrayLike


@dataclasses.dataclass(frozen=True)
class Joint(Frozen):
    """Basic constraints between two bodies, or a body and the ground (index -1).

    Parameters
    ----------
    parent, child : int
        Body indices; the parent may be the ground.
    parent_anchor, child_anchor : (3,)
        From the centre of mass, in the body's frame; in world coordinates for the ground.
    spherical : bool
        Whether the anchors coincide (three rows, first).
    dots : tuple of Dot
        Further rows.
    drive : Drive, optional
        The last row: a coordinate as a function of time.
    mimic : Mimic, optional
        The last row: a coordinate follows one of another joint.
    rotors : tuple of Rotor
        Inertias of the joint's coordinates; they constrain nothing and have no row in lam.
    contact : Contact, optional
        With a plane of the ground through the parent's anchor: rows of its height and of its slip.
    """

    parent: Index
    child: Index
    parent_anchor: Annotated[Any, vector]
    child_anchor: Annotated[Any, vector]
    spherical: Flag = True
    dots: tuple[Dot, ...] = ()
    drive: Drive | None = None
    rotors: tuple[Rotor, ...] = ()
    contact: Contact | None = None
    mimic: Mimic | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.rows:
            raise ArgumentError("a joint needs at least one constraint row")
        if self.contact is not None and (self.parent != GROUND or self.rows > 1 + len(self.contact.across)):
            raise ArgumentError("a contact is with the ground, and the only thing in its joint")

    @property
    def rows(self) -> int:
        """Number of constraint rows."""
        touching = 0 if self.contact is None else 1 + len(self.contact.across)
        return 3 * self.spherical + len(self.dots) + (self.drive is not None) + touching + (self.mimic is not None)

    @property
    def basic_rows(self) -> tuple[list[np.ndarray], list[Dot]] | None:
        """Directions of the parent along which the anchors do not move apart, and the rows that keep an axis of the
        parent normal to one of the child; None if there are others, as of a distance. Drives and mimics do not count.
        """
        across, normal = list(np.eye(3)) if self.spherical else [], []
        for dot in self.dots:
            if (dot.a, dot.b, dot.constant) == ("parent", "difference", 0.0):
                across.append(dot.a_axis)
            elif (dot.a, dot.b, dot.constant) == ("parent", "child", 0.0):
                normal.append(dot)
            else:
                return None
        return (across, normal) if self.contact is None else None

    @property
    def ball(self) -> bool:
        """Whether it is a spherical joint and nothing else."""
        return self.spherical and self.rows == 3 and not self.rotors

    def add_to(self, system: _kernel.System) -> None:
        """Add this joint to the compiled system."""
        system.add_joint(self.parent, self.child, self.parent_anchor, self.child_anchor, self.spherical,
                         [_kernel.Carrier[carrier] for dot in self.dots for carrier in (dot.a, dot.b)],
                         [axis for dot in self.dots for axis in (dot.a_axis, dot.b_axis)],
                         [dot.constant for dot in self.dots], [dot.scale for dot in self.dots])
        if self.contact is not None:
            system.add_contact(_kernel.ContactKind[self.contact.kind], self.contact.normal, self.contact.axis,
                               self.contact.radius, self.contact.across)
        if self.drive is not None:
            system.drive_joint(self.drive.coordinate.measured, self.drive.function.kernel)
        if self.mimic is not None:
            system.follow(self.mimic.coordinate.measured, self.mimic.ratio, self.mimic.offset)

    def add_rotors_to(self, system: _kernel.System, index: int) -> None:
        """Add the rotor inertias of this joint, the system's `index`-th."""
        for rotor in self.rotors:
            n1, n2 = normals(rotor.parent_axis)
            system.add_rotor(index, rotor.inertia, (rotor.turns, rotor.parent_axis, rotor.child_axis, n1, n2,
                                                    normals(rotor.child_axis)[0]))

    def driven(self, drive: Drive) -> Joint:
        """The same joint with its coordinate prescribed."""
        return dataclasses.replace(self, drive=drive)

    def following(self, mimic: Mimic) -> Joint:
        """The joint with a coordinate that follows one of another joint."""
        return dataclasses.replace(self, mimic=mimic)

    def geared(self, *rotors: Rotor) -> Joint:
        """The same joint with rotor inertias on its coordinates."""
        return dataclasses.replace(self, rotors=rotors)


def _across(*directions: np.ndarray) -> tuple[Dot, ...]:
    """Rows (dot-2) that keep the anchors from moving apart along these directions of the parent."""
    return tuple(Dot("parent", "difference", direction) for direction in directions)


def _normal(parent_direction: np.ndarray, child_direction: np.ndarray) -> Dot:
    """A row (dot-1) that keeps two directions perpendicular."""
    return Dot("parent", "child", parent_direction, child_direction)


def _parallel(parent_axis: np.ndarray, child_axis: np.ndarray) -> tuple[Dot, ...]:
    return tuple(_normal(n, child_axis) for n in normals(parent_axis))


def spherical_joint(parent: int, child: int, parent_anchor: ArrayLike, child_anchor: ArrayLike) -> Joint:
    """A ball joint."""
    return Joint(parent, child, parent_anchor, child_anchor)


def universal_joint(parent: int, child: int, parent_anchor: ArrayLike, child_anchor: ArrayLike,
                    parent_axis: ArrayLike, child_axis: ArrayLike) -> Joint:
    """A cross of two perpendicular axes, one in each body."""
    dots = (_normal(unit("parent_axis", parent_axis), unit("child_axis", child_axis)),)
    return Joint(parent, child, parent_anchor, child_anchor, True, dots)


def revolute_joint(parent: int, child: int, parent_anchor: ArrayLike, child_anchor: ArrayLike,
                   parent_axis: ArrayLike, child_axis: ArrayLike) -> Joint:
    """A hinge; both axes coincide in the world."""
    dots = _parallel(unit("parent_axis", parent_axis), unit("child_axis", child_axis))
    return Joint(parent, child, parent_anchor, child_anchor, True, dots)


def cylindrical_joint(parent: int, child: int, parent_anchor: ArrayLike, child_anchor: ArrayLike,
                      parent_axis: ArrayLike, child_axis: ArrayLike) -> Joint:
    """Turns about and slides along one axis."""
    axis = unit("parent_axis", parent_axis)
    dots = _parallel(axis, unit("child_axis", child_axis)) + _across(*normals(axis))
    return Joint(parent, child, parent_anchor, child_anchor, False, dots)


def prismatic_joint(parent: int, child: int, parent_anchor: ArrayLike, child_anchor: ArrayLike,
                    parent_axis: ArrayLike, child_axis: ArrayLike, relative: ArrayLike) -> Joint:
    """Slides along one axis; `relative` (3, 3) is the constant attitude R_child^T R_parent."""
    a, c = unit("parent_axis", parent_axis), unit("child_axis", child_axis)
    n1, n2 = normals(a)
    b = rotation("relative", relative) @ n2
    b = unit("relative", b - (b @ c) * c)
    dots = (*_parallel(a, c), *_across(n1, n2), _normal(n1, b))
    return Joint(parent, child, parent_anchor, child_anchor, False, dots)


def planar_joint(parent: int, child: int, parent_anchor: ArrayLike, child_anchor: ArrayLike,
                 parent_axis: ArrayLike, child_axis: ArrayLike) -> Joint:
    """Slides in the plane normal to the axis and turns about the axis."""
    axis = unit("parent_axis", parent_axis)
    dots = _parallel(axis, unit("child_axis", child_axis)) + _across(axis)
    return Joint(parent, child, parent_anchor, child_anchor, False, dots)


def fixed_joint(parent: int, child: int, parent_anchor: ArrayLike, child_anchor: ArrayLike,
                relative: ArrayLike) -> Joint:
    """No relative motion; `relative` (3, 3) is the constant attitude R_child^T R_parent."""
    Q = rotation("relative", relative)
    dots = tuple(_normal(np.eye(3)[k], Q[:, (k + 1) % 3]) for k in range(3))
    return Joint(parent, child, parent_anchor, child_anchor, True, dots)


def distance_joint(parent: int, child: int, parent_anchor: ArrayLike, child_anchor: ArrayLike,
                   length: float) -> Joint:
    """A massless rod of the given length (m) between the anchors."""
    length = positive("length", length)
    rod = Dot("difference", "difference", constant=0.5 * length, scale=0.5 / length)
    return Joint(parent, child, parent_anchor, child_anchor, False, (rod,))


def point_on_line_joint(parent: int, child: int, parent_anchor: ArrayLike, child_anchor: ArrayLike,
                        parent_axis: ArrayLike) -> Joint:
    """The child's anchor stays on the line along the axis through the parent's anchor."""
    dots = _across(*normals(unit("parent_axis", parent_axis)))
    return Joint(parent, child, parent_anchor, child_anchor, False, dots)


def point_on_plane_joint(parent: int, child: int, parent_anchor: ArrayLike, child_anchor: ArrayLike,
                         parent_axis: ArrayLike) -> Joint:
    """The child's anchor stays in the plane normal to the axis through the parent's anchor."""
    dots = _across(unit("parent_axis", parent_axis))
    return Joint(parent, child, parent_anchor, child_anchor, False, dots)


def knife_edge_joint(parent: int, child: int, parent_anchor: ArrayLike, child_anchor: ArrayLike,
                     parent_axis: ArrayLike, child_axis: ArrayLike) -> Joint:
    """A blade along child_axis touches the plane normal to parent_axis at the child's anchor: it does not slip across
    the blade. The parent is the ground."""
    contact = Contact("edge", unit("parent_axis", parent_axis), unit("child_axis", child_axis))
    return Joint(parent, child, parent_anchor, child_anchor, False, contact=contact)


def rolling_disk_joint(parent: int, child: int, parent_anchor: ArrayLike, child_anchor: ArrayLike,
                       parent_axis: ArrayLike, child_axis: ArrayLike, radius: float) -> Joint:
    """The rim of a disk about child_axis, its centre at the child's anchor, rolls on the plane normal to parent_axis.
    The parent is the ground."""
    contact = Contact("disk", unit("parent_axis", parent_axis), unit("child_axis", child_axis), radius)
    return Joint(parent, child, parent_anchor, child_anchor, False, contact=contact)


def rolling_sphere_joint(parent: int, child: int, parent_anchor: ArrayLike, child_anchor: ArrayLike,
                         parent_axis: ArrayLike, radius: float) -> Joint:
    """A sphere, its centre at the child's anchor, rolls on the plane normal to parent_axis. The parent is the
    ground."""
    axis = unit("parent_axis", parent_axis)
    return Joint(parent, child, parent_anchor, child_anchor, False, contact=Contact("sphere", axis, axis, radius))
