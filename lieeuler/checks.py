"""Checks of arguments; each raises ArgumentError with the name and what is wanted."""

from __future__ import annotations

import numbers

import numpy as np

from lieeuler.errors import ArgumentError
from lieeuler.types import ArrayLike


def vector(name: str, value: ArrayLike) -> np.ndarray:
    """Three finite numbers, read-only."""
    return array(name, value, (3,))


def unit(name: str, value: ArrayLike) -> np.ndarray:
    """A vector of length one in the given direction."""
    direction = vector(name, value)
    length = np.linalg.norm(direction)
    if length == 0:
        raise ArgumentError(f"{name} must not vanish")
    return direction / length


def number(name: str, value: float, lowest: float | None = None) -> float:
    """A finite number, not below `lowest` where that is given."""
    bound = "" if lowest is None else f", not below {lowest:g}"
    if isinstance(value, bool) or not isinstance(value, numbers.Real):
        raise ArgumentError(f"{name} must be a number{bound}, not {value!r}")
    if not np.isfinite(value) or (lowest is not None and value < lowest):
        raise ArgumentError(f"{name} must be finite{bound}, not {value!r}")
    return float(value)


def positive(name: str, value: float) -> float:
    """A finite number above zero."""
    bounded = isinstance(value, numbers.Real) and not isinstance(value, bool)
    if bounded and not (np.isfinite(value) and value > 0):
        raise ArgumentError(f"{name} must be positive and finite, not {value!r}")
    return number(name, value)


def array(name: str, value: ArrayLike, shape: tuple[int, ...]) -> np.ndarray:
    """Finite numbers of the given shape, read-only and contiguous."""
    try:
        values = np.array(value, dtype=float, order="C")
    except (TypeError, ValueError):
        raise ArgumentError(f"{name} must be numbers of shape {shape}, not {value!r}") from None
    if values.shape != shape or not np.isfinite(values).all():
        raise ArgumentError(f"{name} must be finite and of shape {shape}, not {values.shape}")
    values.setflags(write=False)
    return values


def body_index(name: str, value: int) -> int:
    """A whole number; whether there is such a body is checked where bodies are known."""
    if isinstance(value, bool) or not isinstance(value, numbers.Integral):
        raise ArgumentError(f"{name} must be the index of a body (-1 for the ground), not {value!r}")
    return int(value)


def rotation(name: str, value: ArrayLike) -> np.ndarray:
    """A rotation matrix (3, 3)."""
    R = array(name, value, (3, 3))
    if not np.abs(R.T @ R - np.eye(3)).max() < 1e-10 or np.linalg.det(R) < 0:
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
