"""Distances between the shapes of a scene, by coal's algorithms for convex bodies; there is no geometry here."""

from __future__ import annotations

import importlib.util
from typing import Any

import numpy as np

from crosscheck.errors import Unsupported
from crosscheck.scene.model import GROUND, Scene, rotation_from_quaternion

TOLERANCE = 1e-10
"""Of distances, m. At 1e-14 coal's iterations do not end, and give distances that are wrong by any size."""

MOST_ITERATIONS = 1000


def available() -> bool:
    """Whether the library of the distances is installed."""
    return importlib.util.find_spec("coal") is not None


class Touching:
    """The distances that the monitors of type touch watch; raises `Unsupported` without coal.

    `monitors` are their indices among those of the scene.
    """

    def __init__(self, scene: Scene) -> None:
        if not available():
            raise Unsupported(f"{scene.name!r}: distances between shapes need coal, which comes with pin; pip install "
                              "pin, or remove the monitors of type touch")
        self.monitors = [k for k, monitor in enumerate(scene.monitors) if monitor.joint is None]
        watched = [scene.monitors[k] for k in self.monitors]
        names = {name for monitor in watched for name in monitor.shapes}
        shapes = [shape for shape in scene.shapes if shape.name in names]
        at = {shape.name: k for k, shape in enumerate(shapes)}
        self._solids = [solid(shape.type, shape.size, shape.points) for shape in shapes]
        self._balls = [_ball(shape.type, made) for shape, made in zip(shapes, self._solids, strict=True)]
        self._places = [(shape.body, np.array(shape.position), rotation_from_quaternion(np.array(shape.attitude)))
                        for shape in shapes]
        self._pairs = [(at[monitor.shapes[0]], at[monitor.shapes[1]], monitor.margin) for monitor in watched]

    def gaps(self, x: np.ndarray, R: np.ndarray) -> np.ndarray:
        """Distance minus margin of each monitor, m, for bodies at x (n, 3), R (n, 3, 3); negative within it."""
        placed = [self._placed(k, x, R) for k in range(len(self._solids))]
        return np.array([distance(placed[a], placed[b]) - margin for a, b, margin in self._pairs])

    def gap(self, row: int, x: np.ndarray, R: np.ndarray) -> float:
        """That of the monitor of one row."""
        a, b, margin = self._pairs[row]
        return distance(self._placed(a, x, R), self._placed(b, x, R)) - margin

    def below(self, x: np.ndarray, R: np.ndarray) -> np.ndarray:
        """(K, monitors) what `gaps` are at least, from balls around the shapes, for K poses x (K, n, 3), R."""
        centres = np.array([position + attitude @ ball for _, position, attitude, ball in (
            (*self._places[k], self._balls[k][0]) for k in range(len(self._solids)))]).reshape(-1, 3)
        bodies = np.array([body for body, *_ in self._places], dtype=int)
        moved = np.broadcast_to(centres, (len(x), *centres.shape)).copy()
        on = bodies != GROUND
        moved[:, on] = x[:, bodies[on]] + np.einsum("knij,nj->kni", R[:, bodies[on]], centres[on])
        radii = np.array([radius for _, radius in self._balls])
        a, b = (np.array([pair[end] for pair in self._pairs], dtype=int) for end in (0, 1))
        margins = np.array([margin for *_, margin in self._pairs])
        return np.asarray(np.linalg.norm(moved[:, a] - moved[:, b], axis=2) - radii[a] - radii[b] - margins)

    def _placed(self, k: int, x: np.ndarray, R: np.ndarray) -> tuple[Any, np.ndarray, np.ndarray]:
        body, position, attitude = self._places[k]
        if body != GROUND:
            position, attitude = x[body] + R[body] @ position, R[body] @ attitude
        return self._solids[k], position, attitude


def solid(kind: str, size: Any, points: Any = ()) -> Any:
    """What coal makes of a shape: `size` as `laws.SIZES` has it for the kind, points (n, 3) of the hull of a mesh."""
    import coal

    if kind == "sphere":
        return coal.Sphere(size[0])
    if kind == "capsule":
        return coal.Capsule(size[0], 2.0 * size[1])
    if kind == "cylinder":
        return coal.Cylinder(size[0], 2.0 * size[1])
    if kind == "box":
        return coal.Box(*(2.0 * half for half in size))
    if kind == "ellipsoid":
        return coal.Ellipsoid(*size)
    if kind == "plane":
        return coal.Halfspace(np.array([0.0, 0.0, 1.0]), 0.0)
    corners = coal.StdVec_Vec3s()
    corners.extend(np.array(point, dtype=float) for point in points)
    return coal.Convex.convexHull(corners, True, None)


def _ball(kind: str, made: Any) -> tuple[np.ndarray, float]:
    """Centre (3,) and radius of a ball around a solid, in its frame; that of a plane has no end."""
    if kind == "plane":
        return np.zeros(3), np.inf
    made.computeLocalAABB()
    return np.array(made.aabb_center), float(made.aabb_radius)


def distance(one: tuple[Any, np.ndarray, np.ndarray], other: tuple[Any, np.ndarray, np.ndarray]) -> float:
    """Distance, m, of two solids at a position (3,) and attitude (3, 3) each; negative where they overlap."""
    import coal

    request = coal.DistanceRequest()
    request.enable_signed_distance = True
    request.gjk_tolerance = request.epa_tolerance = TOLERANCE
    request.gjk_max_iterations = request.epa_max_iterations = MOST_ITERATIONS
    (a, *first), (b, *second) = one, other
    return float(coal.distance(a, coal.Transform3s(first[1], first[0]), b, coal.Transform3s(second[1], second[0]),
                               request, coal.DistanceResult()))
