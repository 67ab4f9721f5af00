"""Checks of arguments, each with one clear error."""

from __future__ import annotations

import numpy as np

from lieeuler.errors import ArgumentError
from lieeuler.types import ArrayLike


def vector(name: str, value: ArrayLike) -> np.ndarray:
    """Three finite numbers, read-only; ArgumentError otherwise."""
    try:
        array = np.array(value, dtype=float)
    except (TypeError, ValueError):
        array = np.empty(0)
    if array.shape != (3,) or not np.isfinite(array).all():
        raise ArgumentError(f"{name} must be three finite numbers, not {value!r}")
    array.setflags(write=False)
    return array


def unit(name: str, value: ArrayLike) -> np.ndarray:
    """A vector of length one in the given direction."""
    direction = vector(name, value)
    length = np.linalg.norm(direction)
    if length == 0:
        raise ArgumentError(f"{name} must not vanish")
    return direction / length


def number(name: str, value: float, lowest: float | None = None) -> float:
    """A finite number, not below `lowest` where that is given."""
    if not np.isfinite(value) or (lowest is not None and value < lowest):
        bound = "" if lowest is None else f", not below {lowest:g}"
        raise ArgumentError(f"{name} must be finite{bound}, not {value!r}")
    return float(value)


def rotation(name: str, value: ArrayLike) -> np.ndarray:
    """A rotation matrix (3, 3)."""
    R = np.array(value, dtype=float)
    if R.shape != (3, 3) or not np.abs(R.T @ R - np.eye(3)).max() < 1e-10 or np.linalg.det(R) < 0:
        raise ArgumentError(f"{name} must be a rotation matrix, 3 x 3")
    return R


def normals(axis: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Unit vectors n1, n2 with n1 x n2 = axis, a unit vector (3,).

    n1 is the coordinate direction in which the axis has its smallest component (the first of equals), made normal to
    it: no axis is special.
    """
    n1 = np.eye(3)[np.argmin(np.abs(axis))]
    n1 = n1 - (n1 @ axis) * axis
    n1 /= np.linalg.norm(n1)
    return n1, np.cross(axis, n1)
