"""Series of the motion in natural coordinates, in extended precision, with the products that forces need."""

from __future__ import annotations

import numpy as np

LONG = np.longdouble


class Motion:
    """Coefficients of q, (order + 1, n + 1, 4, 3), the ground last, and of angles of torsional springs."""

    def __init__(self, q: np.ndarray, rate: np.ndarray, angles: np.ndarray, order: int) -> None:
        self.q = np.zeros((order + 1, *q.shape), LONG)
        self.q[0], self.q[1] = q, rate
        self.angles = np.zeros((order + 1, len(angles)), LONG)
        self.angles[0] = angles

    def at(self, tau: np.longdouble) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """q, q', q'' and angles at a time after the start of the step."""
        q, rate, second = np.zeros((3, *self.q.shape[1:]), LONG)
        angles = np.zeros(self.angles.shape[1], LONG)
        for k in range(len(self.q) - 1, -1, -1):
            q, angles = q * tau + self.q[k], angles * tau + self.angles[k]
            rate = rate * tau + k * self.q[k] if k else rate
            second = second * tau + k * (k - 1) * self.q[k] if k > 1 else second
        return q, rate, second, angles

    def vector(self, body: int, own: np.ndarray, k: int) -> np.ndarray:
        """k-th coefficient of a vector fixed in a body, world axes."""
        found: np.ndarray = own @ self.q[k, body, 1:]
        return found

    def point(self, body: int, own: np.ndarray, k: int) -> np.ndarray:
        """k-th coefficient of a point fixed in a body."""
        found: np.ndarray = self.q[k, body, 0] + own @ self.q[k, body, 1:]
        return found


def product(one: np.ndarray, other: np.ndarray, k: int) -> np.ndarray:
    """k-th coefficient of the product of a scalar series and a series of numbers or vectors."""
    weights = one[k::-1] if k else one[:1]
    found: np.ndarray = np.tensordot(weights, other[:k + 1], 1)
    return found


def crossed(one: np.ndarray, other: np.ndarray, k: int) -> np.ndarray:
    """k-th coefficient of the cross product of series of vectors; `other` may hold several vectors per coefficient."""
    first = one[k::-1] if k else one[:1]
    first = first.reshape(len(first), *(1,) * (other.ndim - 2), 3)
    found: np.ndarray = np.cross(first, other[:k + 1]).sum(axis=0)
    return found
