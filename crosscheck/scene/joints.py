"""The types of joints, each an entry of one table.

Schema, checks, constraint rows, initial states, tree links and the adapter of lieeuler read this table. The references
have their own, so that a wrong entry here does not make them wrong in the same way.

Rows, with d the vector from the parent's anchor to the child's, a the parent's axis and n1, n2 its reference vectors:
`Row("point")` is d = 0, `Row("distance")` is (d . d - c^2) / (2 c), `Row("dot1", p, c)` is the product of a vector of
the parent with one of the child, `Row("dot2", p)` is the product of a vector of the parent with d,
`Row("contact")` is the height of a contact with a plane, `Row("slip")` holds a velocity there and no position.
`crosscheck.scene.constraints` builds the vectors from their names.
"""

from __future__ import annotations

import dataclasses
from typing import Literal

Zero = Literal["identity", "axes", "start"]


@dataclasses.dataclass(frozen=True)
class Row:
    """A basic constraint of a joint; its vectors are given by name."""

    kind: Literal["point", "dot1", "dot2", "distance", "contact", "slip"]
    parent: str = ""
    child: str = ""


@dataclasses.dataclass(frozen=True)
class JointType:
    """A type of joint.

    Attributes
    ----------
    rows : its constraint rows in their order.
    motion : its free motions, from the parent outwards: "slide", "turn" (along, about the axis), "slide n1",
        "slide n2" (along the references of the axis), "turn parent", "turn child" (about the axis of that body),
        "ball", "rod" (two turns of a rod's direction and a ball at its end).
    coordinates : the words of `motion` whose values a scene may give, in the order in which it gives them.
    axes : which axes it needs and how they lie in the world: "parallel", "perpendicular" and "any" need both.
    zero : the attitude of the child in the parent at zero coordinates: "axes" is the shortest rotation that takes the
        child's axis to the parent's, "start" that of the initial state.
    length, radius : whether it needs one.
    """

    rows: tuple[Row, ...]
    motion: tuple[str, ...] = ()
    coordinates: tuple[str, ...] = ()
    axes: Literal["none", "parent", "parallel", "perpendicular", "any"] = "none"
    zero: Zero = "identity"
    length: bool = False
    radius: bool = False

    @property
    def needs(self) -> dict[str, bool]:
        """For each optional key of a scene file, whether the type needs it."""
        return {"parent_axis": self.axes != "none", "child_axis": self.axes not in ("none", "parent"),
                "length": self.length, "radius": self.radius}

    @property
    def positions(self) -> int:
        """Number of its position coordinates; a ball has four, a quaternion, and three velocities."""
        return 4 if self.is_ball else len(self.coordinates)

    def number(self, measure: str) -> int:
        """Which of its coordinates is the "angle" or the "slide" of a force law; of one that it lacks the first."""
        word = {"angle": "turn"}.get(measure, measure)
        return self.coordinates.index(word) if word in self.coordinates else 0

    @property
    def is_elastic(self) -> bool:
        """Whether it may have springs, dampers and armature: the axis of each coordinate is fixed in both bodies."""
        return bool(self.coordinates) and {"turn", "slide"}.issuperset(self.coordinates)

    @property
    def slides(self) -> bool:
        """Whether it has one coordinate, a slide."""
        return self.coordinates == ("slide",)

    @property
    def turns(self) -> bool:
        """Whether it has one coordinate, an angle about an axis that is fixed in both bodies."""
        return self.coordinates == ("turn",)

    @property
    def has_one(self) -> bool:
        """Whether it has one coordinate, an angle or a slide along an axis that is fixed in both bodies."""
        return self.slides or self.turns

    @property
    def is_ball(self) -> bool:
        """Whether its coordinate is a relative attitude."""
        return self.coordinates == ("ball",)

    @property
    def anchors_coincide(self) -> bool:
        """Whether it holds the two anchors together."""
        return self.rows[0].kind == "point"

    @property
    def slips(self) -> bool:
        """Whether it has rows that hold velocities and no positions; its parent is the ground then."""
        return any(row.kind == "slip" for row in self.rows)

    @property
    def keeps_attitude(self) -> bool:
        """Whether rows hold the relative attitude of the initial state."""
        return any(row.child in ("b", "f1", "f2", "f3") for row in self.rows)

    @property
    def has_angle(self) -> bool:
        """Whether it turns about one axis fixed in both bodies and about no other; it may also slide."""
        return self.is_elastic and "turn" in self.coordinates


_POINT = Row("point")
_PARALLEL = (Row("dot1", "n1", "axis"), Row("dot1", "n2", "axis"))
_ON_LINE = (Row("dot2", "n1"), Row("dot2", "n2"))
_NO_TURN = Row("dot1", "n1", "b")
_ON_PLANE = Row("dot2", "axis")
_ALL_AXES = (Row("dot1", "e1", "f2"), Row("dot1", "e2", "f3"), Row("dot1", "e3", "f1"))
_ROLLING = (Row("contact"), Row("slip"), Row("slip"))
_PLANE = ("slide n1", "slide n2")
_TWO_AXES = ("turn parent", "turn child")

JOINT_TYPES: dict[str, JointType] = {
    "spherical": JointType((_POINT,), ("ball",), ("ball",)),
    "universal": JointType((_POINT, Row("dot1", "axis", "axis")), _TWO_AXES, _TWO_AXES, "perpendicular", "start"),
    "revolute": JointType((_POINT, *_PARALLEL), ("turn",), ("turn",), "parallel", "axes"),
    "cylindrical": JointType((*_PARALLEL, *_ON_LINE), ("slide", "turn"), ("turn", "slide"), "parallel", "axes"),
    "prismatic": JointType((*_PARALLEL, *_ON_LINE, _NO_TURN), ("slide",), ("slide",), "parallel", "start"),
    "planar": JointType((*_PARALLEL, _ON_PLANE), (*_PLANE, "turn"), (*_PLANE, "turn"), "parallel", "axes"),
    "fixed": JointType((_POINT, *_ALL_AXES), zero="start"),
    "distance": JointType((Row("distance"),), ("rod",), length=True),
    "point_on_line": JointType(_ON_LINE, ("slide", "ball"), axes="parent"),
    "point_on_plane": JointType((_ON_PLANE,), (*_PLANE, "ball"), axes="parent"),
    "knife_edge": JointType(_ROLLING[:2], (*_PLANE, "ball"), axes="any"),
    "rolling_disk": JointType(_ROLLING, (*_PLANE, "ball"), axes="any", radius=True),
    "rolling_sphere": JointType(_ROLLING, (*_PLANE, "ball"), axes="parent", radius=True),
}
"""The types by their names in scene files, in the order in which messages list them."""


def joint_types(trait: str) -> tuple[str, ...]:
    """Names of the types that have a property of `JointType`."""
    return tuple(name for name, kind in JOINT_TYPES.items() if getattr(kind, trait))
