"""The laws of forces: those along one measure, a table; those of one joint coordinate, smooth on pieces; monitors.

A measure s is the distance of two points, the angle or the slide of a joint; its rate is S u with u all velocities, so
that an effort f along it is the force S^T f. Each law has two columns: its effort, which the index-1 equations of
`crosscheck.scene.mechanics` and engines that step in Python read, and its potential and dissipation, of which the
references in minimal coordinates take the slopes. Neither reads the other's, so that a mistake in one shows.

An angle or slide is that of `crosscheck.scene.coordinates`, continuous over whole turns.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Mapping
from typing import Any, Literal

import numpy as np

from crosscheck.scene.functions import Value, at


@dataclasses.dataclass(frozen=True)
class DryFriction:
    """Coulomb friction: -sliding sign(rate) while the coordinate moves (N m or N); at rest, what keeps it there.

    It stays at rest where that is at most `static`.
    """

    sliding: float
    static: float

    def force(self, rate: Any) -> Any:
        """The force in motion; 0 at rest."""
        return -self.sliding * np.sign(rate)


@dataclasses.dataclass(frozen=True)
class Limits:
    """The range of a coordinate (rad or m), with a rigid stop at each end, or a spring and damper beyond it."""

    lower: float = -math.inf
    upper: float = math.inf
    restitution: float = 0.0  # of a rigid stop: the rate after an impact is this times that before it, reversed
    stiffness: float | None = None  # None: rigid
    damping: float = 0.0

    @property
    def rigid(self) -> bool:
        return self.stiffness is None

    def depth(self, q: Any) -> Any:
        """How far q is beyond the range: positive above, negative below, 0 inside."""
        return np.maximum(q - self.upper, 0.0) + np.minimum(q - self.lower, 0.0)

    def force(self, q: object, rate: object) -> Any:
        """The force of spring and damper beyond the range, which pushes back and never pulls; 0 for a rigid stop."""
        depth, side = self.depth(q), np.sign(self.depth(q))
        return -side * np.maximum((self.stiffness or 0.0) * abs(depth) + self.damping * side * rate, 0.0)

    def energy(self, q: object) -> Any:
        """That of the spring, J."""
        return 0.5 * (self.stiffness or 0.0) * self.depth(q) ** 2


@dataclasses.dataclass(frozen=True)
class Servo:
    """A controller of one coordinate, with the keys of its entry in the file; a motor has feedforward alone.

    It gives cut(proportional (target - q) + derivative (target_velocity - rate) + feedforward). With a period this is
    evaluated at the times phase, phase + period, ... and held; with a delay of d periods the value of sample k acts
    from sample k + d on, at the instant of that sample too: accelerations and efforts there are those after it. A
    scene that begins in the middle of another's run has two keys that no file has: `phase`, and `held`, the d + 1
    values that act until sample d, the first of them before sample 0. By default they are 0.
    """

    target: Value = 0.0
    target_velocity: Value = 0.0
    feedforward: Value = 0.0
    proportional: float = 0.0
    derivative: float = 0.0
    effort_limit: tuple[float, float] | None = None
    no_load_speed: float | None = None  # where the limit in the direction of motion has fallen to 0
    period: float | None = None  # s; None: continuous
    delay: int = 0
    phase: float = 0.0
    held: tuple[float, ...] = ()

    def bounds(self, rate: Any) -> tuple[Any, Any]:
        """The least and the greatest effort at this rate."""
        lower, upper = self.effort_limit or (-math.inf, math.inf)
        if self.no_load_speed is None:
            return lower, upper
        left = np.maximum(0.0, 1.0 - abs(rate) / self.no_load_speed)
        return np.where(rate < 0, lower * left, lower), np.where(rate > 0, upper * left, upper)

    def effort(self, t: object, q: object, rate: object) -> Any:
        """The effort that the law gives at this time and state, after the cut."""
        wanted = (self.proportional * (at(self.target, t) - q) + self.derivative * (at(self.target_velocity, t) - rate)
                  + at(self.feedforward, t))
        return np.clip(wanted, *self.bounds(rate))

    def samples(self, t: np.ndarray) -> np.ndarray:
        """(T,) whether it samples at these times, (T,)."""
        if self.period is None:
            return np.zeros(len(t), bool)
        ticks = (t - self.phase) / self.period
        due: np.ndarray = (abs(ticks - np.round(ticks)) * self.period < 1e-9) & (ticks > -0.5)
        return due


Parameters = Mapping[str, Any]
"""The keys of a force, with the values of its functions of time at some times."""


@dataclasses.dataclass(frozen=True)
class ForceType:
    """A type of force: a law along a measure, or a force or torque on one body.

    Attributes
    ----------
    measure : "length" between two points, "angle" of a joint from the shortest turn of its axis, "slide", "coordinate",
        which is the only one of a hinge or slide; "force" or "torque" on a body, along a vector.
    effort : (parameters, u, rate) -> what acts along the measure, N or N m, u the measure beyond rest; None of loads
    potential : parameters -> coefficients of the energy in powers of u, J; None where the references have modes
    dissipation : parameters -> coefficients in powers of the rate of what has the damping force as its slope
    rest : the key with the value of the measure at rest; "" where u is the measure
    stores : whether its potential is energy of the system
    element : what an engine has to declare, "" nothing, by default the name of the type
    """

    measure: Literal["length", "angle", "slide", "coordinate", "force", "torque"]
    effort: Any = None
    potential: Any = None
    dissipation: Callable[[Parameters], tuple[Any, ...]] = lambda p: ()
    rest: str = ""
    stores: bool = False
    element: str | None = None

    @property
    def has_modes(self) -> bool:
        """Whether it is a servo, which jumps or is cut, and of which the references have modes."""
        return self.effort is not None and self.potential is None

    @property
    def on_joint(self) -> bool:
        """Whether its measure is a coordinate of a joint."""
        return self.measure in ("angle", "slide", "coordinate")

    @property
    def is_motor(self) -> bool:
        """Whether it is what drives a coordinate of a joint: a torque, a force or a servo."""
        return self.on_joint and not self.stores


def _spring(measure: Literal["length", "angle", "slide"], rest: str) -> ForceType:
    return ForceType(measure, lambda p, u, rate: -(p["stiffness"] * u + p["damping"] * rate),
                     lambda p: (0.0, 0.0, 0.5 * p["stiffness"]), lambda p: (0.0, 0.0, 0.5 * p["damping"]), rest, True,
                     element="")


def _servo(p: Parameters, u: Any, rate: Any) -> Any:
    """Of a sampled one nothing is known."""
    return np.nan * rate if p.get("period") is not None else Servo(**p).effort(0.0, u, rate)


FORCE_TYPES: dict[str, ForceType] = {
    "linear_spring": _spring("length", "free_length"),
    "torsional_spring": _spring("angle", "rest_angle"),
    "slide_spring": _spring("slide", "rest_position"),
    "servo": ForceType("coordinate", _servo),
    "joint_torque": ForceType("angle", lambda p, u, rate: p["torque"] + 0.0 * rate, lambda p: (0.0, -p["torque"]),
                              element="joint_torque"),
    "joint_force": ForceType("slide", lambda p, u, rate: p["force"] + 0.0 * rate, lambda p: (0.0, -p["force"]),
                             element="joint_torque"),
    "constant_force": ForceType("force", element=""),
    "constant_torque": ForceType("torque", element="")}
"""The types of forces by their names in scene files; only the springs and dampers of joints are slide springs."""


def power_series(coefficients: tuple[Any, ...], u: Any) -> Any:
    """The sum of coefficients[k] u^k."""
    total = 0.0 * u
    for coefficient in reversed(coefficients):
        total = total * u + coefficient
    return total


@dataclasses.dataclass(frozen=True)
class Shape:
    """How a body looks from outside, for monitors: its size has the numbers that `SIZES` names for its type."""

    name: str
    body: int
    type: str
    size: tuple[float, ...]
    position: tuple[float, ...] = (0.0, 0.0, 0.0)  # in the body, from its centre of mass, m
    attitude: tuple[float, ...] = (1.0, 0.0, 0.0, 0.0)  # of the shape in the body, a unit quaternion
    points: tuple[tuple[float, ...], ...] = ()  # the corners of a mesh, whose convex hull it is


SIZES = {"sphere": ("radius",), "capsule": ("radius", "half length"), "cylinder": ("radius", "half length"),
         "box": ("half x", "half y", "half z"), "ellipsoid": ("x", "y", "z"), "plane": (), "mesh": ()}
"""The numbers of the size of each type of shape."""


@dataclasses.dataclass(frozen=True)
class Monitor:
    """What ends the claim of a scene: two shapes closer than `margin`, or a joint's value that leaves its range."""

    type: str  # touch; range, speed or effort of a joint
    shapes: tuple[str, ...] = ()
    margin: float = 0.0  # m
    joint: str | None = None
    lower: float = -math.inf
    upper: float = math.inf

    @property
    def name(self) -> str:
        """What it watches, for messages and lists of events."""
        return " and ".join(self.shapes) if self.joint is None else f"{self.type} of {self.joint}"
