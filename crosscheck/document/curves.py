"""The curves of scenes and runs in the packed form of the pages. `crosscheck.verification.curves` makes them."""

from __future__ import annotations

from typing import Literal

import msgspec

from crosscheck.document.part import Part

PACKED_STEPS, PACKED_MISSING = 65533, 65535
"""Of a packed curve: the largest integer for a value, and the integer for a value that is not finite."""


class Packed(Part, frozen=True, omit_defaults=True):
    """One curve. `q` holds little-endian 16-bit integers in base64: 1 to `PACKED_STEPS` stand for equally spaced
    values from `lo` to `hi`, and `PACKED_MISSING` for a value that is not finite. With `log`, `lo` and `hi` are decimal
    logarithms, and 0 stands for zero. A curve of equal values has their number `n` instead of `q`. With `over`, the
    values are differences from the true curve, which keeps small differences exact.
    """

    lo: float
    hi: float
    q: str | None = None
    n: int | None = None
    log: bool = False
    over: bool = False


Curve = Packed | Literal["truth"] | None
"""The word "truth" stands for the true curve, if the two differ by two integers or less. None: there is no curve."""


class Reaction(Part, frozen=True, omit_defaults=True):
    """Force (N) and torque (N m) of a joint, three components each. A torque that is only rounding is left out."""

    force: list[Curve]
    torque: list[Curve] | None = None


class Motion(Part, frozen=True, kw_only=True, omit_defaults=True):
    """The motion at the output times. If no curves are kept, all fields are None."""

    x: list[list[Curve]] | None = None  # m, per body three components
    q: list[list[Curve]] | None = None  # per body a quaternion w, x, y, z
    kinetic: Curve = None  # J
    potential: Curve = None  # J
    total: Curve = None  # J
    momentum: Curve = None  # kg m^2/s, about the vertical
    reactions: dict[str, Reaction] | None = None  # by joint

    @property
    def drawn(self) -> bool:
        """Whether there are curves."""
        return self.x is not None


class RunCurves(Motion, frozen=True, kw_only=True, omit_defaults=True):
    """The curves of a run and of its errors. Errors have a logarithmic scale."""

    errors: dict[str, Curve] = {}  # by quantity
    energy: Curve = None  # its error over the largest kinetic energy
    momentum_error: Curve = msgspec.field(default=None, name="momentum error")  # kg m^2/s
    orthogonality: Curve = None
    constraint_position: Curve = msgspec.field(default=None, name="constraint position")  # m
    constraint_velocity: Curve = msgspec.field(default=None, name="constraint velocity")  # m/s
    constraint_acceleration: Curve = msgspec.field(default=None, name="constraint acceleration")  # m/s^2


class DrawnBody(Part, frozen=True):
    """The box of uniform density that has the mass (kg) and inertia of a body."""

    name: str
    mass: float
    corners: list[list[float]]  # m, body axes; bit k of a corner's index tells on which side of axis k it is


class DrawnJoint(Part, frozen=True):
    """A joint. Anchors are in m, and all vectors in the frames of the scene file."""

    name: str
    type: str
    parent: int
    child: int
    parent_anchor: list[float] | None
    child_anchor: list[float] | None
    parent_axis: list[float] | None
    child_axis: list[float] | None


class Drawing(Part, frozen=True):
    """Geometry for a picture. A force also has its parameters under their names in the scene file.

    `turn` is the largest angle (rad) that a body turns between two output times. From pi on, playback cannot show it.
    """

    gravity: list[float]  # m/s^2
    joints: list[DrawnJoint]
    forces: list[dict[str, str | int | float | list[float] | None]]
    ground: int
    bodies: list[DrawnBody]
    turn: float


class SceneCurves(Motion, frozen=True, kw_only=True, omit_defaults=True):
    """Output times, geometry, and the true motion if there is truth."""

    t: list[float] = []  # s
    drawing: Drawing | None = None
