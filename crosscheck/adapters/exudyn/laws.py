"""Dry friction, limits and servos as connectors of Exudyn between the ground and a coordinate of a kinematic tree.

Friction and limits are `CoordinateSpringDamperExt`. A joint that sticks hangs on a bristle, a spring and damper, and a
limit is a spring and damper that pulls until the coordinate is back in the range. Where the scene has them rigid, they
are as stiff as the step resolves, so that they converge to the scene's as it falls. Static friction decays with the
rate. A servo is a spring and damper, or a function of Python where it is cut or sampled or changes with time.
"""

from __future__ import annotations

import dataclasses
import importlib
import itertools
import math
from collections.abc import Callable
from typing import Any

import numpy as np

from crosscheck.adapters.common import tree
from crosscheck.adapters.common.held import Held
from crosscheck.adapters.common.own_law import Row
from crosscheck.scene.coordinates import at_start
from crosscheck.scene.functions import TimeFunction
from crosscheck.scene.laws import DryFriction, Limits, Servo
from crosscheck.scene.model import Scene

BRISTLE, RATIO = 0.5, 0.5
"""Radians a step of the oscillation on a bristle, and its damping ratio."""

STOP = 0.5
"""Radians a step of that at a rigid stop, where the damping is critical."""


@dataclasses.dataclass(frozen=True)
class Place:
    """A coordinate of the scene: sign times that of a column of the tree, plus `zero`."""

    column: int
    sign: float
    zero: float


def places(scene: Scene, carried: tuple[tree.Link, ...]) -> dict[tuple[str, int], Place]:
    """The places of the coordinates of hinges, slides and cylinders, by the joint's name and their number in it."""
    placed, first = {}, 0
    for link in carried:
        if link.type in ("revolute", "prismatic", "cylindrical"):
            for k in range(link.dofs):
                part, sign, zero = tree.coordinate(scene, link, k)
                placed[link.joint, k] = Place(first + part, sign, zero)
        first += link.dofs
    return placed


def add(scene: Scene, system: Any, node: Any, at: dict[tuple[str, int], Place], h: float) -> None:
    """Add the connectors of all laws for steps h, s; the rest of the model is complete."""
    from exudyn.itemInterface import MarkerNodeCoordinate, NodePointGround

    system.Assemble()
    mass = np.array(importlib.import_module("exudyn.solver").ComputeLinearizedSystem(system)[0])
    moved = 1.0 / np.diag(np.linalg.inv(mass))
    ground = system.AddMarker(MarkerNodeCoordinate(nodeNumber=system.AddNode(NodePointGround()), coordinate=0))

    def markers(place: Place) -> list[Any]:
        return [ground, system.AddMarker(MarkerNodeCoordinate(nodeNumber=node, coordinate=place.column))]

    for joint in scene.joints:
        for k, (friction, limits) in enumerate(itertools.zip_longest(joint.dry_friction, joint.limits)):
            if friction or limits:
                place = at[joint.name, k]
                q, rate = (float(part[k]) for part in at_start(scene)[joint.name])
                state = place.sign * (q - place.zero), place.sign * rate
                _add_friction_and_limits(system, markers(place), place, friction, limits,
                                         float(moved[place.column]), h, state)
    held = Held(scene, h)
    for index, (name, servo) in scene.servos.items():
        _add_servo(system, markers(at[name, 0]), at[name, 0], servo, index, held)
    if held:
        def measure(name: str) -> tuple[float, float]:
            place = at[name, 0]
            q, v = (float(get()[place.column]) for get in (system.systemData.GetODE2Coordinates,
                                                           system.systemData.GetODE2Coordinates_t))
            return place.sign * q + place.zero, place.sign * v

        def sample(_: Any, t: float) -> bool:  # called before a step, with the time of its end
            held.update(round(t / h) - 1, measure)
            return True

        held.update(0, measure)
        system.SetPreStepUserFunction(sample)


def _add_friction_and_limits(system: Any, markers: list[Any], place: Place, friction: DryFriction | None,
                             limits: Limits | None, mass: float, h: float, state: tuple[float, float]) -> None:
    from exudyn.itemInterface import NodeGenericData, ObjectConnectorCoordinateSpringDamperExt

    values: dict[str, Any] = {}
    if friction:
        omega, over = BRISTLE / h, friction.static - friction.sliding
        values |= {"dynamicFrictionForce": friction.sliding, "stickingStiffness": mass * omega**2,
                   "stickingDamping": 2.0 * RATIO * mass * omega}
        if over:  # it has decayed within the rate of one step
            values |= {"staticFrictionOffsetForce": over, "exponentialDecayStatic": over / mass * h}
    if limits:
        low, high = tree.ends(limits, place.sign, place.zero, 1e9)
        stiffness, damping = limits.stiffness, limits.damping
        if stiffness is None:
            stiffness, damping = mass * (STOP / h) ** 2, 2.0 * mass * STOP / h
        values |= {"useLimitStops": True, "limitStopsLower": low, "limitStopsUpper": high,
                   "limitStopsStiffness": stiffness, "limitStopsDamping": damping}
    slips = float(np.sign(state[1])) * (friction.sliding if friction else 0.0)
    memory = system.AddNode(NodeGenericData(initialCoordinates=[slips, state[0], 0.0], numberOfDataCoordinates=3))
    system.AddObject(ObjectConnectorCoordinateSpringDamperExt(markerNumbers=markers, nodeNumber=memory, **values))


def _add_servo(system: Any, markers: list[Any], place: Place, servo: Servo, index: int, held: Held) -> None:
    from exudyn.itemInterface import ObjectConnectorCoordinateSpringDamper, ObjectConnectorCoordinateSpringDamperExt

    target, speed, ahead = (math.nan if isinstance(value, TimeFunction) else value
                            for value in (servo.target, servo.target_velocity, servo.feedforward))
    if (servo.period is None and servo.effort_limit is None and servo.proportional
            and math.isfinite(target + speed + ahead)):
        system.AddObject(ObjectConnectorCoordinateSpringDamperExt(
            markerNumbers=markers, stiffness=servo.proportional, damping=servo.derivative,
            offset=place.sign * (target - place.zero + ahead / servo.proportional), velocityOffset=place.sign * speed))
        return
    system.AddObject(ObjectConnectorCoordinateSpringDamper(
        markerNumbers=markers, springForceUserFunction=_given(place, servo, index, held)))


def _given(place: Place, servo: Servo, index: int, held: Held) -> Callable[..., float]:
    def resisted(_: Any, t: float, item: int, q: float, rate: float, *rest: float) -> float:
        effort = held.efforts[index] if servo.period is not None else servo.effort(
            t, place.sign * q + place.zero, place.sign * rate)
        return -place.sign * float(effort)

    return resisted


def pulling(law: DryFriction | Limits, weight: float, q: float, rate: float) -> Row | None:
    """The row of a soft limit, which pulls until q is back in the range; see `crosscheck.adapters.common.own_law`."""
    assert isinstance(law, Limits)
    depth = float(law.depth(q))
    return None if depth == 0 else (1.0, -(law.stiffness or 0.0) * depth - law.damping * rate, 0.0, -math.inf, math.inf)
