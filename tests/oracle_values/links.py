"""Rotations, functions of time, numbers of a scene file by path, and the motion that each type of joint leaves free."""

from __future__ import annotations

import copy
import functools
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from scipy.interpolate import CubicSpline

NAMES = {"revolute": [""], "prismatic": [""], "cylindrical": [".angle", ".slide"], "universal": [".first", ".second"],
         "planar": [".x", ".y", ".angle"], "spherical": [".rx", ".ry", ".rz"], "fixed": [],
         "free": [".x", ".y", ".z", ".rx", ".ry", ".rz"]}
"""Coordinates of the joints that a tree may have; `free` is the motion of a body that no joint holds."""
SIZES = {"spherical": 4, "free": 7}
"""Numbers that place a joint, where they are more than its rates: quaternions."""


def turn(axis: np.ndarray, angle: float) -> np.ndarray:
    """The rotation by an angle about a unit vector (Rodrigues)."""
    x, y, z = axis
    K = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + np.sin(angle) * K + (1 - np.cos(angle)) * K @ K


def matrix(quaternion: Any) -> np.ndarray:
    """The rotation of a quaternion w, x, y, z of any length."""
    w, x, y, z = np.asarray(quaternion, float) / np.linalg.norm(quaternion)
    return np.array([[1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
                     [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
                     [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)]])


def quaternion(R: np.ndarray) -> np.ndarray:
    """The quaternion of a rotation: the eigenvector to 1 of its quadratic form."""
    K = np.array([[R[0, 0] + R[1, 1] + R[2, 2], R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]],
                  [0, R[0, 0] - R[1, 1] - R[2, 2], R[1, 0] + R[0, 1], R[2, 0] + R[0, 2]],
                  [0, 0, R[1, 1] - R[0, 0] - R[2, 2], R[2, 1] + R[1, 2]],
                  [0, 0, 0, R[2, 2] - R[0, 0] - R[1, 1]]])
    return np.linalg.eigh(np.triu(K) + np.triu(K, 1).T)[1][:, -1]


def cross(a: Any, b: np.ndarray) -> np.ndarray:
    """a x b for one b and one or many a, (3,) or (..., 3): the fast one."""
    x, y, z = b.tolist()
    return np.asarray(a @ np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]]))


def shortest(start: np.ndarray, end: np.ndarray) -> np.ndarray:
    """The shortest rotation that takes one unit vector to another."""
    axis = np.cross(start, end)
    size = np.linalg.norm(axis)
    return turn(axis / size, np.arctan2(size, start @ end)) if size > 1e-14 else np.eye(3)


def rate_of(q: np.ndarray, w: np.ndarray) -> np.ndarray:
    """dq/dt of a quaternion with rates w in its own axes."""
    return 0.5 * np.array([-q[1:] @ w, *(q[0] * w + cross(q[1:], w))])


@functools.cache
def spline(times: tuple[float, ...], values: tuple[float, ...]) -> CubicSpline:
    return CubicSpline(times, values)


def timed(entry: Any, t: float) -> tuple[float, float, float]:
    """A number or function of time with its two derivatives; to the right where they jump."""
    if not isinstance(entry, dict):
        return float(entry), 0.0, 0.0
    kind = entry["type"]
    if kind == "polynomial":
        p = np.polynomial.Polynomial(entry["coefficients"])
        return float(p(t)), float(p.deriv()(t)), float(p.deriv(2)(t))
    if kind == "sine":
        terms = np.array(entry["terms"])
        a, w, phase = terms.T
        s, c = np.sin(w * t + phase), np.cos(w * t + phase)
        return float(entry.get("offset", 0.0) + a @ s), float((a * w) @ c), float(-(a * w * w) @ s)
    times, values = np.array(entry["times"]), np.array(entry["values"])
    if kind == "spline":
        curve = spline(tuple(entry["times"]), tuple(entry["values"]))
        return float(curve(t)), float(curve(t, 1)), float(curve(t, 2))
    k = int(np.clip(np.searchsorted(times, t, side="right") - 1, 0, len(times) - 1))
    if kind == "hold":
        return float(values[k]), 0.0, 0.0
    inside = times[0] <= t < times[-1]
    slope = (values[k + 1] - values[k]) / (times[k + 1] - times[k]) if inside else 0.0
    return float(np.interp(t, times, values)), float(slope), 0.0


def edited(data: dict[str, Any], path: str, value: float) -> dict[str, Any]:
    """A copy of a file in which the number at a path is another one, and its twin in an inertia."""
    data, keys = copy.deepcopy(data), path.split(".")
    last = [keys]
    if "inertia" in keys:
        last.append([*keys[:-2], keys[-1], keys[-2]])
    for walk in last:
        at: Any = data
        for key in walk[:-1]:
            at = at[key] if isinstance(at, dict) else (
                at[int(key)] if key.isdigit() else next(entry for entry in at if entry["name"] == key))
        at[int(walk[-1]) if isinstance(at, list) else walk[-1]] = value
    return data


def number(data: dict[str, Any], path: str) -> float:
    """The number at a path."""
    at: Any = data
    for key in path.split("."):
        at = at[key] if isinstance(at, dict) else (
            at[int(key)] if key.isdigit() else next(entry for entry in at if entry["name"] == key))
    return float(at)


@dataclass
class Link:
    """A joint of the tree, or a body that is free: where its numbers are among those of all."""

    name: str
    kind: str
    parent: int
    child: int
    entry: dict[str, Any]
    place: slice = field(default_factory=lambda: slice(0))
    rates: slice = field(default_factory=lambda: slice(0))
    turned: bool = False
    """The child is nearer to the ground."""

    def motion(self, p: np.ndarray) -> tuple[np.ndarray, np.ndarray, list[tuple[np.ndarray, np.ndarray, bool]]]:
        """Rotation of the child and shift of its anchor, in the parent's axes; directions of the rates.

        A direction is (angular, linear, whether it rides on the child rather than on the parent).
        """
        zero, a, Q0 = np.zeros(3), self.axis, self.zero
        if self.kind == "revolute":
            return turn(a, p[0]) @ Q0, zero, [(a, zero, False)]
        if self.kind == "prismatic":
            return Q0, p[0] * a, [(zero, a, False)]
        if self.kind == "cylindrical":
            return turn(a, p[0]) @ Q0, p[1] * a, [(a, zero, False), (zero, a, False)]
        if self.kind == "universal":
            Q = turn(a, p[0]) @ Q0 @ turn(self.second, p[1])
            return Q, zero, [(a, zero, False), (Q @ self.second, zero, True)]
        if self.kind == "planar":
            first, second = self.across
            return turn(a, p[2]) @ Q0, p[0] * first + p[1] * second, [(zero, first, False), (zero, second, False),
                                                                      (a, zero, False)]
        Q = Q0 @ matrix(p[-4:]) if self.kind != "fixed" else Q0
        spins = [(axis, zero, True) for axis in Q.T]
        if self.kind == "free":
            return Q, p[:3], [(zero, axis, False) for axis in np.eye(3)] + spins
        return Q, zero, spins if self.kind == "spherical" else []

    def settle(self) -> None:
        """Constants of the joint."""
        unit = {key: np.asarray(self.entry[key], float) / np.linalg.norm(self.entry[key])
                for key in ("parent_axis", "child_axis") if key in self.entry}
        self.axis, self.second = unit.get("parent_axis", np.zeros(3)), unit.get("child_axis", np.zeros(3))
        self.zero = np.eye(3)
        if "reference_attitude" in self.entry:
            self.zero = matrix(self.entry["reference_attitude"])
        elif self.kind in ("revolute", "cylindrical", "planar"):
            self.zero = shortest(self.second, self.axis)
        if self.kind == "planar":  # of the axes, the one that is farthest from the normal comes first
            first = np.eye(3)[np.argmin(np.abs(self.axis))]
            first = first - (first @ self.axis) * self.axis
            self.across = first / np.linalg.norm(first), np.cross(self.axis, first / np.linalg.norm(first))
