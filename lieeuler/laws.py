"""Laws of one joint coordinate that are smooth on pieces: servos, dry friction, stops.

The coordinate q is the angle of a hinge, counted over whole turns, or the slide along an axis. In a piece a law adds
a generalized force that is linear in q and its rate, or holds q still; `lieeuler.pieces` finds where pieces end.
"""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import numpy as np

from lieeuler.checks import Frozen, Index, NonNegative, Number, Positive, cross
from lieeuler.errors import ArgumentError
from lieeuler.functions import TimeFunction, Value
from lieeuler.joint_parts import Coordinate
from lieeuler.joints import Joint
from lieeuler.types import GROUND


@dataclasses.dataclass(frozen=True)
class Servo(Frozen):
    """A controller: cut(proportional (target - q) + derivative (target_velocity - q') + feedforward).

    Parameters
    ----------
    proportional, derivative : float
        N m/rad and N m s/rad, or N/m and N s/m.
    target, target_velocity, feedforward : float or TimeFunction
        rad, rad/s, N m; or m, m/s, N. A motor has feedforward alone.
    lower, upper : float
        The cut: N m or N; infinite where there is none.
    no_load_speed : float, optional
        rad/s or m/s: in the direction of motion the cut falls in a straight line to 0 at this speed.
    period : float, optional
        s: the law is evaluated at phase, phase + period, ... and held from each of them on; at the instant itself the
        new value acts. Default: it is continuous.
    delay : int
        Whole periods between evaluation and effect; before the first effect the servo gives 0.
    phase : float
        s, the time of the first evaluation; not before the start.
    earlier : tuple of float
        The delay + 1 values that act until the first value has its effect, the oldest first. Default: zeros.
    """

    proportional: NonNegative = 0.0
    derivative: NonNegative = 0.0
    target: Value = 0.0
    target_velocity: Value = 0.0
    feedforward: Value = 0.0
    lower: float = -math.inf
    upper: float = math.inf
    no_load_speed: Positive | None = None
    period: Positive | None = None
    delay: Index = 0
    phase: float = 0.0
    earlier: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.lower <= 0.0 <= self.upper:
            raise ArgumentError(f"a cut lies around 0, not between {self.lower!r} and {self.upper!r}")
        if self.delay < 0 or (self.earlier and len(self.earlier) != self.delay + 1):
            raise ArgumentError("delay is a whole number of periods, and earlier holds delay + 1 values")

    def wanted(self, t: Any, q: Any, rate: Any) -> Any:
        """The force before the cut."""
        return (self.proportional * (at(self.target, t) - q) + self.derivative
                     * (at(self.target_velocity, t) - rate) + at(self.feedforward, t))

    def bounds(self, rate: np.ndarray | float) -> tuple[np.ndarray, np.ndarray]:
        """The cut at a rate."""
        lower, upper = np.full(np.shape(rate), self.lower), np.full(np.shape(rate), self.upper)
        if self.no_load_speed is None:
            return lower, upper
        left = np.maximum(0.0, 1.0 - np.abs(rate) / self.no_load_speed)
        return np.where(rate < 0, lower * left, lower), np.where(rate > 0, upper * left, upper)


@dataclasses.dataclass(frozen=True)
class Stops(Frozen):
    """The range of a coordinate: rigid stops, or a spring and damper beyond it that pushes back and never pulls.

    Parameters
    ----------
    lower, upper : float
        rad or m; infinite where there is none.
    restitution : float
        0 to 1: of a rigid stop, the rate after an impact over that before it.
    stiffness : float, optional
        N m/rad or N/m. Default: the stops are rigid.
    damping : float
        N m s/rad or N s/m.
    """

    lower: float = -math.inf
    upper: float = math.inf
    restitution: float = 0.0
    stiffness: float | None = None
    damping: float = 0.0

    def __post_init__(self) -> None:
        if not self.lower < self.upper:
            raise ArgumentError(f"lower must lie below upper, not {self.lower!r} and {self.upper!r}")
        if not 0 <= self.restitution <= 1:
            raise ArgumentError(f"restitution must lie between 0 and 1, not {self.restitution!r}")

    def edge(self, side: int) -> float:
        """The upper end for side 1, the lower one for -1."""
        return self.upper if side > 0 else self.lower


@dataclasses.dataclass(frozen=True)
class Law(Frozen):
    """What acts along one coordinate of a joint.

    Parameters
    ----------
    joint : int
        Index of a joint that has this coordinate: a hinge, a slide, or a cylindrical joint.
    coordinate : Coordinate
    start : float
        The coordinate in the initial state, rad or m; it gives an angle its whole turns.
    servos : tuple of Servo
    sliding, static : float
        Dry friction in motion, and the most that friction holds at rest; N m or N. `static` is at least `sliding`.
    stops : Stops, optional
    """

    joint: Index
    coordinate: Coordinate
    start: Number = 0.0
    servos: tuple[Servo, ...] = ()
    sliding: Number = 0.0
    static: Number = 0.0
    stops: Stops | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        if not 0 <= self.sliding <= self.static:
            raise ArgumentError(f"dry friction needs 0 <= sliding <= static, not {self.sliding!r} and {self.static!r}")


def at(given: float | TimeFunction, t: Any) -> Any:
    """The value of a number or a function at times t."""
    return given(t) if isinstance(given, TimeFunction) else given


def measured(law: Law, joint: Joint, x: np.ndarray, R: np.ndarray, v: np.ndarray, w: np.ndarray, a: np.ndarray,
             alpha: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The coordinate, its rate and its acceleration, (T,) each, of states (T, n, ...); an angle lies in (-pi, pi]."""
    parent, child = joint.parent, joint.child
    still, eye = np.zeros((len(x), 3)), np.broadcast_to(np.eye(3), (len(x), 3, 3))
    xp, Rp, vp, wp, ap, bp = ((still, eye, still, still, still, still) if parent == GROUND else
                              tuple(each[:, parent] for each in (x, R, v, w, a, alpha)))
    xc, Rc, vc, wc, ac, bc = (each[:, child] for each in (x, R, v, w, a, alpha))
    turns, axis, child_axis, n1, n2, pointer = law.coordinate.measured
    if turns:
        p = np.einsum("tji,tj->ti", Rp, Rc @ pointer)
        return np.arctan2(p @ n2, p @ n1), wc @ child_axis - wp @ axis, bc @ child_axis - bp @ axis

    def point(x: np.ndarray, R: np.ndarray, v: np.ndarray, w: np.ndarray, a: np.ndarray, alpha: np.ndarray,
              s: np.ndarray) -> tuple[np.ndarray, ...]:
        """Position, velocity and acceleration of the point s of a body."""
        turned = cross(w, s)
        return (x + R @ s, v + np.einsum("tij,tj->ti", R, turned),
                a + np.einsum("tij,tj->ti", R, cross(alpha, s) + cross(w, turned)))

    d, rate, acceleration = (c - p for c, p in zip(point(xc, Rc, vc, wc, ac, bc, joint.child_anchor),
                                                   point(xp, Rp, vp, wp, ap, bp, joint.parent_anchor), strict=True))
    e, e1, e2 = point(still, Rp, still, wp, still, bp, axis)
    return (np.sum(e * d, axis=1), np.sum(e * rate + e1 * d, axis=1),
            np.sum(e * acceleration + 2 * e1 * rate + e2 * d, axis=1))
