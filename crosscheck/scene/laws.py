"""Force laws of one joint coordinate q, each smooth on pieces: dry friction, limits, servos; and what ends a claim.

The angle or slide q is that of `crosscheck.scene.coordinates`, continuous over whole turns. Adapters that step in
Python evaluate these formulas; the references have their own.
"""

from __future__ import annotations

import dataclasses
import math
from typing import Any

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
