"""Monitors, which end the claim of a scene: when the first of them fires on the series in minimal coordinates.

They change no motion, so that one formulation is enough. Distances of shapes are those of coal's algorithms for convex
bodies; there is no collision geometry here.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any

import numpy as np

from crosscheck.errors import Unsupported
from crosscheck.references.modes import Law, Mode
from crosscheck.references.pieces import NODE_PLACES, first_crossing
from crosscheck.scene.functions import at
from crosscheck.scene.model import Scene, rotation_from_quaternion

TOLERANCE = 1e-14
"""Of distances, m; a monitor is located by them to TOLERANCE over the speed of approach."""

STEEPER = 4.0
"""How many times as steep as from the nodes around them distances may fall between two nodes."""


@dataclasses.dataclass(frozen=True)
class Fired:
    """A monitor: after how long (s) in a step it fires, its name, and what happened."""

    after: float
    name: str
    what: str
    touches: bool = False


class Monitors:
    """The monitors of a scene on the steps of its `LawfulTaylor`."""

    def __init__(self, series: Any) -> None:
        self.series, scene = series, series.scene
        joints = {joint.name: joint for joint in scene.joints}
        self.watched = [each for each in scene.monitors if each.joint is not None]
        self.places = [series.place(Law(joints[each.joint], joints[each.joint].type == "revolute", None, None, None))
                       for each in self.watched]
        self.touches = [(each, distance_of(scene, each.shapes)) for each in scene.monitors if each.joint is None]

    def first(self, mode: Mode, length: float, states: Callable[[np.ndarray], np.ndarray],
              times: Callable[[np.ndarray], np.ndarray], instant: float) -> Fired | None:
        """The first monitor that fires within a step, from states and times at times after its start.

        With an `instant` (s) the motion may begin at the end of a range and turn inside.
        """
        fired = []
        if self.watched:
            crossing = first_crossing(lambda tau: self._values(mode, times(tau), states(tau)), length, instant)
            if crossing is not None:
                monitor = self.watched[crossing.labels[0][0]]
                whose = monitor.joint if monitor.type == "range" else monitor.name
                fired.append(Fired(crossing.after, monitor.name, f"{whose} leaves its range"))
        for monitor, distance in self.touches:
            after = self._touch(monitor.margin, distance, length, states)
            if after is not None:
                fired.append(Fired(after, monitor.name, f"{monitor.shapes[0]} touches {monitor.shapes[1]}", True))
        return min(fired, key=lambda each: each.after, default=None)

    def _values(self, mode: Mode, t: np.ndarray, Y: np.ndarray) -> dict[tuple[int, str], np.ndarray]:
        gaps = {}
        for k, (monitor, (coordinate, speed, sign, start)) in enumerate(zip(self.watched, self.places, strict=True)):
            q, rate = start + sign * Y[:, coordinate], sign * Y[:, speed]
            value = {"range": q, "speed": rate}.get(monitor.type)
            if value is None:
                value = self._effort(monitor.joint, mode, t, q, rate)
            for name, room, end in (("lower", value - monitor.lower, monitor.lower),
                                    ("upper", monitor.upper - value, monitor.upper)):
                if np.isfinite(end):
                    gaps[k, name] = room
        return gaps

    def _effort(self, joint: str, mode: Mode, t: np.ndarray, q: np.ndarray, rate: np.ndarray) -> np.ndarray:
        """What the actuators of a joint give."""
        total = np.zeros(len(t))
        for force in self.series.scene.forces:
            if force.joint == joint and force.type.startswith("joint_"):
                total = total + at(force.parameters["torque" if force.type == "joint_torque" else "force"], t)
        for i, (law, part) in enumerate(zip(self.series.laws, mode, strict=True)):
            if law.joint.name == joint and law.servo is not None:
                if law.servo.period is not None:
                    total = total + part.acting
                else:
                    total = total + (self.series.bound(i, part, part.cut, rate) if part.cut
                                     else self.series.wanted(i, t, q, rate))
        return total

    def _touch(self, margin: float, distance: Callable[[np.ndarray, np.ndarray], float], length: float,
               states: Callable[[np.ndarray], np.ndarray]) -> float | None:
        """When two shapes come closer than a margin; their distance may have corners, so it is only bracketed."""
        from scipy.optimize import brentq, minimize_scalar

        def room(tau: float) -> float:
            x, R = self.series.pose(states(np.array([tau])))
            return distance(x[0], R[0]) - margin

        places = length * NODE_PLACES
        x, R = self.series.pose(states(places))
        rooms = np.array([distance(*pose) - margin for pose in zip(x, R, strict=True)])
        if rooms[0] <= 0.0:
            return 0.0
        for k in range(1, len(places)):
            if rooms[k] <= 0.0:
                return float(brentq(room, places[k - 1], places[k], xtol=1e-15 * max(1.0, length), rtol=1e-15))
            if k + 1 < len(places) and rooms[k] <= min(rooms[k - 1], rooms[k + 1]):  # nearest between two nodes
                before, after = np.diff(places[k - 1:k + 2])
                falls = (rooms[k - 1] - rooms[k]) * after / before, (rooms[k + 1] - rooms[k]) * before / after
                if rooms[k] > STEEPER * max(falls):
                    continue
                lowest = minimize_scalar(room, bounds=(places[k - 1], places[k + 1]), method="bounded",
                                         options={"xatol": 1e-9 * length})
                if lowest.fun <= 0.0:
                    return float(brentq(room, places[k - 1], lowest.x, xtol=1e-15 * max(1.0, length), rtol=1e-15))
        return None


def distance_of(scene: Scene, names: tuple[str, ...]) -> Callable[[np.ndarray, np.ndarray], float]:
    """Distance (m) of two shapes, negative where they overlap, from poses x (n, 3) and R (n, 3, 3) of all bodies.

    Raises
    ------
    Unsupported
        coal, which comes with the `pin` package, is not installed.
    """
    try:
        import coal
    except ImportError:
        raise Unsupported(f"truth of {scene.name!r}: monitors of type touch need coal, which comes with pin; install "
                          "it, or remove the monitor") from None
    shapes = {shape.name: shape for shape in scene.shapes}
    first, second = (shapes[name] for name in names)
    geometries = [_geometry(coal, shape) for shape in (first, second)]
    request = coal.DistanceRequest()
    request.enable_signed_distance = True
    request.gjk_tolerance = request.epa_tolerance = TOLERANCE
    request.gjk_max_iterations = request.epa_max_iterations = 1000

    def distance(x: np.ndarray, R: np.ndarray) -> float:
        places = []
        for shape in (first, second):
            turn, place = rotation_from_quaternion(np.array(shape.attitude)), np.array(shape.position)
            if shape.body >= 0:
                place, turn = x[shape.body] + R[shape.body] @ place, R[shape.body] @ turn
            places.append(coal.Transform3s(turn, place))
        return float(coal.distance(geometries[0], places[0], geometries[1], places[1], request, coal.DistanceResult()))

    return distance


def _geometry(coal: Any, shape: Any) -> Any:
    size = shape.size
    if shape.type == "sphere":
        return coal.Sphere(size[0])
    if shape.type == "capsule":
        return coal.Capsule(size[0], 2.0 * size[1])
    if shape.type == "cylinder":
        return coal.Cylinder(size[0], 2.0 * size[1])
    if shape.type == "box":
        return coal.Box(*(2.0 * half for half in size))
    if shape.type == "ellipsoid":
        return coal.Ellipsoid(*size)
    if shape.type == "plane":
        return coal.Halfspace(np.array([0.0, 0.0, 1.0]), 0.0)
    points = coal.StdVec_Vec3s()
    points.extend(np.array(point) for point in shape.points)
    return coal.Convex.convexHull(points, True, None)
