"""Modes of the force laws of joints, and which follows which at an event.

A coordinate is held, by dry friction or at a rigid stop, or it moves. What is held follows from the box problem of
Gauss' principle: accelerations a = b + S f of coordinates under holding efforts lo <= f <= hi, with a = 0 where f is
inside, a >= 0 where f = lo and a <= 0 where f = hi. It minimises the convex function 1/2 f S f + b f over the box, so
its solution is unique. `crosscheck.references.defects` checks modes and events without them.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from crosscheck.errors import Unsupported
from crosscheck.references.base import TruthError
from crosscheck.references.pieces import LATE, Event, Label, Values
from crosscheck.scene.model import Joint, Scene

Number = Any  # a number, or an array of them over times

RESTING = 1e-12
"""Rates below this part of the largest of the scene (1 at least) are zero at the start and after impacts."""
SLACK = 1e-11
"""N m or N: what begins to hold with no more to spare than that, as a stop that carries nothing, lets go beyond it."""
CLOSED = 1e-6
"""Relative distance from a stop at which a motion that was held there still is."""
COUPLED = 1e-12
"""What an impulse at one stop changes of the rate at another one is rounding below this part of their own."""
DEAD = 1e-12
"""A joint whose acceleration by an effort is below this part of the largest before is at a dead centre."""
PILE = 1e-4
"""Bounces less than this (s) apart pile up."""
SIDES = {-1: "lower", 1: "upper"}


@dataclasses.dataclass(frozen=True)
class Law:
    """The laws of one coordinate: of a hinge (`turns`) or a slide; `start` is the coordinate at the start."""

    joint: Joint
    turns: bool
    friction: Any  # the records of the scene, or None
    limits: Any
    servo: Any

    @property
    def number(self) -> int:
        """Of the coordinate in its joint: a cylindrical one has the turn first, then the slide."""
        return int(self.joint.type == "cylindrical" and not self.turns)

    @property
    def rigid(self) -> bool:
        """Whether it has rigid stops."""
        return self.limits is not None and self.limits.stiffness is None

    @property
    def bounded(self) -> bool:
        """Whether a continuous servo is cut."""
        return self.servo is not None and self.servo.effort_limit is not None and self.servo.period is None


def laws_of(scene: Scene) -> list[Law]:
    """The coordinates of a scene that have laws.

    Raises
    ------
    Unsupported
        A joint has two servos.
    """
    laws = []
    for joint in scene.joints:
        servos = [servo for name, servo in scene.servos.values() if name == joint.name]
        if len(servos) > 1:
            raise Unsupported(f"truth of {scene.name!r}: joint {joint.name!r} has {len(servos)} servos; give their sum")
        kinds = {"revolute": (True,), "prismatic": (False,), "cylindrical": (True, False)}.get(joint.type, ())
        for k, turns in enumerate(kinds):
            friction, limits = ((given[k] if k < len(given) else None) for given in (joint.dry_friction, joint.limits))
            servo = servos[0] if servos and k == 0 else None
            if friction or limits or servo:
                laws.append(Law(joint, turns, friction, limits, servo))
    return laws


@dataclasses.dataclass(frozen=True)
class Part:
    """The mode of one coordinate, and the memory of its sampled servo."""

    held: bool = False
    slack: float = 0.0  # N m or N beyond what can hold it, before it lets go
    side: int = 0  # of the rigid stop at which it is held: -1 lower, +1 upper
    slip: int = 0  # direction in which dry friction slips
    soft: int = 0  # side of the range beyond which it is
    pushing: bool = False  # whether the spring and damper there push
    cut: int = 0  # which limit cuts the servo, a sampled one at its last sample
    way: int = 1  # sign of the rate, twice that beyond the no-load speed
    acting: float = 0.0  # what a sampled servo gives
    waiting: tuple[float, ...] = ()  # what it will give
    sample: int = 0  # number of the next sample
    hit: float = -math.inf  # time of the last bounce


Mode = tuple[Part, ...]


@dataclasses.dataclass
class AfterEvent:
    """What follows an event: state, mode, what to list, and why the truth ends there if it does."""

    state: np.ndarray
    mode: Mode
    events: list[Event] = dataclasses.field(default_factory=list)
    cause: str = ""


class Machine:
    """Events of a `LawfulTaylor`."""

    def __init__(self, form: Any) -> None:
        self.form, self.laws = form, form.laws
        self.breaks = form.scene.knots
        self.gains = np.zeros(len(self.laws))  # the largest accelerations by unit efforts at starts

    def next_time(self, t: float, mode: Mode) -> float:
        """The next time after t at which a function of time breaks or a servo samples."""
        times = [time for time in self.breaks if time > t]
        times[1:] = [_sample_time(law.servo, part.sample) for law, part in zip(self.laws, mode, strict=True)
                     if law.servo is not None and law.servo.period is not None]
        return min(times, default=math.inf)

    def surfaces(self, mode: Mode, t: np.ndarray, Y: np.ndarray) -> Values:
        """Values, positive inside the mode, over states (T, dimension)."""
        q, rate = self.form.moving(t, Y)
        values: dict[Label, np.ndarray] = {}
        if any(part.held for part in mode):
            holding = self.form.holding(mode, t, Y)
        for i, (law, part) in enumerate(zip(self.laws, mode, strict=True)):
            if part.held:
                lo, hi = _box(law, part.side)
                rooms = (("lo", holding[i] - lo + part.slack), ("hi", hi - holding[i] + part.slack))
                values |= {(i, name): room for name, room in rooms if np.isfinite(room).all()}
            elif part.slip:
                values[i, "rest"] = part.slip * rate[i]
            if law.limits is not None and not part.held:
                values |= self._limits(i, law, part, q[i], rate[i])
            if law.bounded:
                wanted = self.form.wanted(i, t, q[i], rate[i])
                upper, lower = (self.form.bound(i, part, side, rate[i]) for side in (1, -1))
                over, under = wanted - upper, wanted - lower
                values |= {(i, name): value for name, value in {
                    0: (("above", -over), ("below", under)), 1: (("back", over),), -1: (("back", -under),)}[part.cut]
                    if np.isfinite(value).all()}
                if law.servo.no_load_speed is not None and not part.held:
                    speed = np.sign(part.way) * rate[i]
                    top = law.servo.no_load_speed
                    values |= ({(i, "slow"): speed - top} if abs(part.way) == 2 else
                              {(i, "way"): speed, (i, "fast"): top - speed})
        return values

    def _limits(self, i: int, law: Law, part: Part, q: np.ndarray, rate: np.ndarray) -> dict[Label, np.ndarray]:
        limits = law.limits
        if part.soft:
            end = limits.lower if part.soft < 0 else limits.upper
            push = self.form.push(i, part.soft, q, rate)
            return {(i, "inside"): part.soft * (q - end), (i, "push"): push if part.pushing else -push}
        return {(i, side): value for side, value in ((-1, q - limits.lower), (1, limits.upper - q))
                if np.isfinite(value).all()}

    def begin(self, y: np.ndarray, t: float = 0.0, before: Mode | None = None) -> AfterEvent:
        """The mode at a start; what happens there is no event.

        `before`: the mode of a motion that comes there, with the memory that a state lacks.
        """
        q, rate = (each[:, 0] for each in self.form.moving(np.full(1, t), y[None]))
        tiny = RESTING * max(1.0, np.abs(rate).max(initial=0.0))
        if self.laws:
            self.gains = np.maximum(self.gains, np.diag(self.form.response(t, y)[1]))
        parts, fired = [], list[Label]()
        for i, law in enumerate(self.laws):
            part = Part(way=1 if rate[i] >= 0 else -1)
            if law.friction:
                part = dataclasses.replace(part, slip=int(np.sign(rate[i])) or 1)
                fired += [(i, "rest")] if abs(rate[i]) <= tiny else []
            if law.limits is not None:
                for side, end in ((-1, law.limits.lower), (1, law.limits.upper)):
                    beyond = side * (q[i] - end)
                    if math.isinf(end):
                        continue
                    stays = before is not None and before[i].held and before[i].side == side
                    near = CLOSED if stays else 1e-12
                    if law.rigid and abs(beyond) <= near * max(1.0, abs(end)) and side * rate[i] >= -tiny:
                        fired.append((i, side))
                    elif not law.rigid and beyond > 0.0:
                        pushing = bool(self.form.push(i, side, q[i], rate[i]) > 0.0)
                        part = dataclasses.replace(part, soft=side, pushing=pushing)
            if law.servo is not None:
                part = self._started(i, part, t, float(q[i]), float(rate[i]))
            if before is not None:  # a bounce at this time is the one that this state comes to
                hit = before[i].hit if t - before[i].hit > LATE * max(1.0, t) else -math.inf
                part = dataclasses.replace(part, acting=before[i].acting, waiting=before[i].waiting,
                                           sample=before[i].sample, hit=hit,
                                           cut=part.cut if law.bounded else before[i].cut)
            parts.append(part)
        after = self.after_event(t, y, tuple(parts), fired)
        after.events = []
        return after

    def _started(self, i: int, part: Part, t: float, q: float, rate: float) -> Part:
        servo = self.laws[i].servo
        if servo.period is not None:
            held = servo.held or (0.0,) * (servo.delay + 1)
            return dataclasses.replace(part, acting=held[0], waiting=tuple(held[1:]))
        if servo.no_load_speed is not None and abs(rate) > servo.no_load_speed:
            part = dataclasses.replace(part, way=2 * part.way)
        if servo.effort_limit is None:
            return part
        wanted = self.form.wanted(i, t, q, rate)
        cut = (wanted > self.form.bound(i, part, 1, rate)) - 1 * (wanted < self.form.bound(i, part, -1, rate))
        return dataclasses.replace(part, cut=int(cut))

    def after_event(self, t: float, y: np.ndarray, mode: Mode, fired: Sequence[Label]) -> AfterEvent:
        """What follows when these surfaces are reached, or a function of time breaks or a servo samples."""
        now = _Change(self, t, y, list(mode))
        for label in fired:
            now.fire(*label)
        now.impacts()
        now.sampling()
        now.gauss()
        return AfterEvent(now.y, tuple(now.parts), now.listed(), now.cause)


def _sample_time(servo: Any, k: int) -> float:
    return float(servo.phase + k * servo.period)


def _box(law: Law, side: int) -> tuple[float, float]:
    """Least and greatest effort that can hold a coordinate."""
    static = law.friction.static if law.friction else 0.0
    return -math.inf if side > 0 else -static, math.inf if side < 0 else static


def coupled(members: list[int], S: np.ndarray) -> list[list[int]]:
    """The members in groups: no impulse along one of a group moves one of another."""
    groups, left = list[list[int]](), list(members)
    while left:
        group = [left.pop(0)]
        for i in group:
            joined = [j for j in left if abs(S[i, j]) > COUPLED * math.sqrt(S[i, i] * S[j, j])]
            group += joined
            left = [j for j in left if j not in joined]
        groups.append(sorted(group))
    return groups


class _Change:
    """One event: the mode while it changes."""

    def __init__(self, machine: Machine, t: float, y: np.ndarray, parts: list[Part]) -> None:
        self.form, self.laws, self.t, self.y, self.parts = machine.form, machine.laws, t, y, parts
        self.gains = machine.gains
        self.names: dict[str, str] = {}
        self.resting: dict[int, int] = {}  # coordinates that came to rest, with the direction in which they moved
        self.hits: dict[int, int] = {}
        self.cause = ""

    def listed(self) -> list[Event]:
        return [(self.t, name, what) for name, what in self.names.items() if what]

    def name(self, i: int, what: str) -> None:
        """List it, unless something is listed for the joint."""
        self.names.setdefault(self.laws[i].joint.name, what)

    def change(self, i: int, **values: Any) -> None:
        self.parts[i] = dataclasses.replace(self.parts[i], **values)

    def moving(self) -> tuple[np.ndarray, np.ndarray]:
        q, rate = self.form.moving(np.array([self.t]), self.y[None])
        return q[:, 0], rate[:, 0]

    def fire(self, i: int, name: Any) -> None:
        """One surface is reached."""
        part, law = self.parts[i], self.laws[i]
        if name == "rest" and self.at_dead_centre(i):
            self.turn_back(i)
        elif name == "rest":
            self.y = self.form.on_surface(self.y, i, None, 0.0)
            self.resting[i] = part.slip
        elif name in ("lo", "hi"):
            self.free(i, 1 if name == "lo" else -1)
        elif name in (-1, 1):
            if law.rigid:
                self.hits[i] = name
            else:
                self.change(i, soft=name, pushing=True)
            self.name(i, f"hits_{SIDES[name]}")
        elif name == "inside":
            self.name(i, f"leaves_{SIDES[part.soft]}")
            self.change(i, soft=0, pushing=False)
        elif name == "push":  # without damping the force ends where the range begins, and that may come first
            self.change(i, pushing=bool(part.soft) and not part.pushing)
        elif name in ("above", "below"):
            self.change(i, cut=1 if name == "above" else -1)
            self.name(i, "saturates")
        elif name == "back":
            self.change(i, cut=0)
            self.name(i, "unsaturates")
        else:
            sign = int(np.sign(part.way))
            self.change(i, way={"way": -sign, "fast": 2 * sign, "slow": sign}[name])

    def at_dead_centre(self, i: int) -> bool:
        """Whether no effort along a coordinate moves it or holds it, as along the guide of a straight slider-crank."""
        return bool(self.form.response(self.t, self.y)[1][i, i] <= DEAD * self.gains[i])

    def turn_back(self, i: int) -> None:
        """Its friction changes sign where its acceleration, on which friction has no part there, takes it back."""
        slip, pulled = self.parts[i].slip, float(self.form.response(self.t, self.y)[0][i])
        if not slip * pulled < 0.0:
            self.cause = f"joint {self.laws[i].joint.name!r} is at rest at its dead centre, where nothing holds it"
        self.change(i, slip=-slip, way=-slip)
        self.name(i, "reverses")

    def free(self, i: int, direction: int) -> None:
        """A held coordinate begins to move."""
        part = self.parts[i]
        self.name(i, f"leaves_{SIDES[part.side]}" if part.side else "slips")
        self.change(i, held=False, side=0, slip=direction if self.laws[i].friction else 0, way=direction)

    def impacts(self) -> None:
        """Impulses of the rigid stops that are hit; those that act on each other share an impact."""
        if not self.hits:
            return
        sides = {i: part.side for i, part in enumerate(self.parts) if part.side and part.held} | self.hits
        _, S = self.form.response(self.t, self.y)
        _, rate = self.moving()
        impulses = np.zeros(len(self.laws))
        for group in coupled(sorted(sides), S):
            if not self.hits.keys() & set(group):
                continue
            bounces = [self.laws[i].limits.restitution for i in group]
            if len(group) == 1:
                impulses[group] = -(1.0 + bounces[0]) * rate[group] / S[group, group]
                continue
            if any(bounces):
                names = " and ".join(repr(self.laws[i].joint.name) for i in group)
                self.cause = f"the stops of {names} act at one instant, and one of them bounces"
            lo, hi = (np.array([-np.inf if sides[i] > 0 else 0.0 for i in group]),
                      np.array([np.inf if sides[i] < 0 else 0.0 for i in group]))
            impulses[group] = self.form.choose(rate[group], S[np.ix_(group, group)], lo, hi)[0]
        self.y = self.form.kicked(self.t, self.y, impulses)
        after = self.moving()[1]
        tiny = RESTING * max(1.0, np.abs(rate).max())
        for i, side in sides.items():
            if abs(after[i]) <= tiny:
                end = self.laws[i].limits.lower if side < 0 else self.laws[i].limits.upper
                self.y = self.form.on_surface(self.y, i, end, 0.0)
                self.change(i, held=True, side=side, slip=0)
            elif i in self.hits:
                self.bounce(i, side)
            else:
                self.free(i, -side)
        after = self.moving()[1]
        for i, part in enumerate(self.parts):
            if (part.held or self.laws[i].friction) and not (part.held and part.side) and abs(after[i]) > tiny:
                if part.held:
                    self.name(i, "slips")
                self.change(i, held=False, side=0, slip=int(np.sign(after[i])) if self.laws[i].friction else 0)
                self.resting.pop(i, None)
            if abs(after[i]) > tiny:
                self.change(i, way=int(np.sign(after[i])) * abs(part.way))

    def bounce(self, i: int, side: int) -> None:
        """Remember when it bounced; bounces that pile up end the truth and then end."""
        end = self.laws[i].limits.lower if side < 0 else self.laws[i].limits.upper
        self.y = self.form.on_surface(self.y, i, end, None)
        if self.t - self.parts[i].hit < PILE:
            self.cause = self.cause or f"bounces of {self.laws[i].joint.name!r} pile up"
            self.y = self.form.on_surface(self.y, i, end, 0.0)
            self.change(i, held=True, side=side, slip=0)
        self.change(i, hit=self.t)

    def sampling(self) -> None:
        """Servos that sample at this time."""
        q, rate = self.moving()
        for i, law in enumerate(self.laws):
            servo, part = law.servo, self.parts[i]
            if servo is None or servo.period is None or _sample_time(servo, part.sample) > self.t:
                continue
            way = 1 if rate[i] >= 0.0 else -1
            if servo.no_load_speed is not None and abs(rate[i]) > servo.no_load_speed:
                way *= 2
            there = dataclasses.replace(part, way=way)
            value = float(self.form.wanted(i, self.t, q[i], rate[i]))
            if servo.effort_limit is not None:
                value = min(max(value, float(self.form.bound(i, there, -1, rate[i]))),
                            float(self.form.bound(i, there, 1, rate[i])))
            cut = int(np.sign(float(self.form.wanted(i, self.t, q[i], rate[i])) - value))
            if cut != part.cut:
                self.name(i, "saturates" if cut else "unsaturates")
            waiting = (*part.waiting, value)
            self.change(i, cut=cut, acting=waiting[0], waiting=waiting[1:], sample=part.sample + 1)

    def gauss(self) -> None:
        """Which of the coordinates at rest stay there."""
        rest = sorted({i for i, part in enumerate(self.parts) if part.held} | set(self.resting))
        if not rest:
            return
        b, S = self.form.response(self.t, self.y)
        q, rate = self.moving()
        released: dict[int, int] = {}
        while True:
            still = [i for i in rest if i not in released]
            mode = [dataclasses.replace(part, held=i in still, slip=0 if i in still or not self.laws[i].friction
                                        else released.get(i, part.slip)) for i, part in enumerate(self.parts)]
            efforts = self.form.efforts(tuple(mode), self.t, q, rate)
            free = (b + S @ efforts)[still]
            boxes = np.array([_box(self.laws[i], self.parts[i].side) for i in still]).reshape(-1, 2)
            f, a = self.form.choose(free, S[np.ix_(still, still)], boxes[:, 0], boxes[:, 1])
            size = 1e-11 * np.abs(free).max(initial=0.0)
            leaving = {i: int(np.sign(a[k])) for k, i in enumerate(still) if abs(a[k]) > max(size, SLACK * S[i, i])}
            if not leaving:
                break
            steep = [i for i in leaving if self.laws[i].friction
                     and self.laws[i].friction.static > self.laws[i].friction.sliding]
            if steep and len(leaving) > 1:
                names = " and ".join(repr(self.laws[i].joint.name) for i in leaving)
                raise TruthError(f"{self.form.scene.name!r}: {names} release at one instant, t = {self.t:.6g} s, which "
                                 "has no unique continuation where static friction is above sliding friction")
            released |= leaving
        for i in rest:
            self.rest_or_go(i, released.get(i, 0))
        for i, effort, (lo, hi) in zip(still, f, boxes, strict=True):
            self.change(i, slack=SLACK if min(effort - lo, hi - effort) < SLACK else 0.0)

    def rest_or_go(self, i: int, direction: int) -> None:
        part, law = self.parts[i], self.laws[i]
        if not direction:
            if i in self.resting and not part.held and not part.side:
                self.name(i, "sticks")
            self.change(i, held=True, slip=0)
        elif part.held:
            if i in self.hits:  # it hits a stop from which it goes at once
                self.change(i, held=False, side=0, slip=direction if law.friction else 0, way=direction)
            else:
                self.free(i, direction)
        else:
            if direction != self.resting[i]:
                self.name(i, "reverses")
            self.change(i, slip=direction, way=direction * max(1, abs(part.way) % 2 or 1))
