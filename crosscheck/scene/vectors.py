"""Vectors of three components: products over the last axis, normals of an axis, rotations."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np


def cross(p: np.ndarray, q: np.ndarray) -> np.ndarray:
    """p x q over the last axis, with broadcasting; `numpy.cross` takes several times longer on small batches."""
    (a, b, c), (d, e, f) = ([each[..., k] for k in range(3)] for each in (p, q))
    first = b * f - c * e
    product = np.empty((*first.shape, 3), first.dtype)
    product[..., 0], product[..., 1], product[..., 2] = first, c * d - a * f, a * e - b * d
    return product


def hat(w: np.ndarray) -> np.ndarray:
    """The matrices (..., 3, 3) of w x (.) of vectors (..., 3)."""
    upper = np.zeros((*w.shape, 3))
    upper[..., 0, 1], upper[..., 0, 2], upper[..., 1, 2] = -w[..., 2], w[..., 1], -w[..., 0]
    return upper - np.swapaxes(upper, -1, -2)


def welded(masses: Sequence[float], centres: Sequence[np.ndarray], inertias: Sequence[np.ndarray]
           ) -> tuple[float, np.ndarray, np.ndarray]:
    """Mass, centre of mass (3,) and inertia (3, 3) about it of one body made of several, all in the same axes."""
    m, at = np.array(masses, dtype=float), np.array(centres)
    mass = float(m.sum())
    centre = m @ at / mass if mass else at[0]
    spread = hat(at - centre)
    return mass, centre, np.asarray(np.sum(inertias, axis=0) - np.einsum("k,kij,kjl->il", m, spread, spread))


def normal_references(axis: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Two unit vectors n1, n2 with n1 x n2 = `axis` (3,), a unit vector.

    n1 is the coordinate direction along which the axis has its smallest component (the first of equal ones), made
    normal to the axis.
    """
    n1 = np.zeros(3)
    n1[np.argmin(np.abs(axis))] = 1.0
    n1 -= (n1 @ axis) * axis
    n1 /= np.linalg.norm(n1)
    return n1, cross(axis, n1)


def slide_direction(word: str, axis: np.ndarray) -> np.ndarray:
    """The unit vector of "slide", "slide n1" or "slide n2", words of `JointType.motion`, for a unit `axis`."""
    return axis if word == "slide" else normal_references(axis)[word == "slide n2"]


def shortest_rotation(start: np.ndarray, end: np.ndarray) -> np.ndarray:
    """The rotation (3, 3) by the smallest angle that takes the unit vector `start` to `end`.

    For opposite vectors its axis is n1 of `normal_references(end)`.
    """
    cosine = start @ end
    if cosine < -1 + 1e-12:  # the formula below would lose every digit of the axis
        n1, _ = normal_references(end)
        return 2 * np.outer(n1, n1) - np.eye(3)
    x, y, z = cross(start, end)
    hat = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.asarray(np.eye(3) + hat + hat @ hat / (1 + cosine))


def dot(p: np.ndarray, q: np.ndarray) -> np.ndarray:
    """p . q over the last axis, which stays with length 1."""
    product: np.ndarray = p[..., 0] * q[..., 0] + p[..., 1] * q[..., 1] + p[..., 2] * q[..., 2]
    return product[..., None]


def exponential(theta: np.ndarray) -> np.ndarray:
    """exp(hat(theta)), (..., 3, 3), of rotation vectors (..., 3)."""
    from scipy.spatial.transform import Rotation

    return np.asarray(Rotation.from_rotvec(theta.reshape(-1, 3)).as_matrix().reshape(*theta.shape, 3))


def inverse_tangent(theta: np.ndarray, w: np.ndarray) -> np.ndarray:
    """dexp^-1 at theta of body angular velocities w, (..., 3), to the order that fourth-order methods need."""
    once = cross(theta, w)
    return w + 0.5 * once + cross(theta, once) / 12.0
