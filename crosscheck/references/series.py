"""Truncated power series over arrays, with the operations for poses, and polynomials about another origin."""

from __future__ import annotations

import dataclasses
import functools
import math

import numpy as np

from crosscheck.references.base import ORDERS

WINDOW = 8  # number of last coefficients that determine a step; symmetry, as at rest, may make several in a row zero


@dataclasses.dataclass
class Series:
    """Coefficients 0 ... ORDERS along the last axis."""

    c: np.ndarray

    def __add__(self, other: Series | float) -> Series:
        if isinstance(other, Series):
            return Series(self.c + other.c)
        moved = self.c.copy()
        moved[..., 0] += other
        return Series(moved)

    def __neg__(self) -> Series:
        return Series(-self.c)

    def __sub__(self, other: Series | float) -> Series:
        return self + -other

    def __rsub__(self, other: float) -> Series:
        return -self + other

    def __mul__(self, other: Series | float) -> Series:
        if not isinstance(other, Series):
            return Series(other * self.c)
        product = np.zeros_like(self.c)
        for k in range(product.shape[-1]):
            product[..., k] = np.sum(self.c[..., :k + 1] * other.c[..., k::-1], axis=-1)
        return Series(product)

    __radd__, __rmul__ = __add__, __mul__

    def sin(self) -> Series:
        """Sine."""
        return self._sine_cosine()[0]

    def cos(self) -> Series:
        """Cosine."""
        return self._sine_cosine()[1]

    def _sine_cosine(self) -> tuple[Series, Series]:
        """Both, by k s_k = sum of j a_j c_(k-j), k c_k = - sum of j a_j s_(k-j)."""
        sine, cosine = np.zeros_like(self.c), np.zeros_like(self.c)
        sine[..., 0], cosine[..., 0] = np.sin(self.c[..., 0]), np.cos(self.c[..., 0])
        slope = self.c * np.arange(self.c.shape[-1])
        for k in range(1, self.c.shape[-1]):
            sine[..., k] = np.sum(slope[..., 1:k + 1] * cosine[..., k - 1::-1], axis=-1) / k
            cosine[..., k] = -np.sum(slope[..., 1:k + 1] * sine[..., k - 1::-1], axis=-1) / k
        return Series(sine), Series(cosine)


def safe_step(tc: np.ndarray) -> float:
    """The step from the last coefficients (dimension, order + 1) (Jorba and Zou, Experimental Mathematics 14, 2005).

    The radius of convergence is the least estimate from the last WINDOW coefficients that are not zero; the factor is
    that of the paper, with which the remainder of the series is below rounding.
    """
    sizes, order = np.abs(tc).max(axis=0), tc.shape[1] - 1
    last = np.arange(order - WINDOW + 1, order + 1)
    last = last[sizes[last] > 0.0]
    if not len(last):
        return math.inf
    radius = float(np.min((max(1.0, sizes[0]) / sizes[last]) ** (1.0 / last)))
    return radius * math.exp(-2.0 - 0.7 / (order - 1))


@functools.cache
def _binomials(size: int) -> np.ndarray:
    return np.array([[math.comb(j, k) for k in range(ORDERS + 1)] for j in range(size)], dtype=float)


def shifted(tc: np.ndarray, tau: float) -> np.ndarray:
    """Coefficients 0 ... ORDERS about t0 + tau of polynomials (dimension, order + 1) about t0."""
    size = tc.shape[-1]
    powers = np.subtract.outer(np.arange(size), np.arange(ORDERS + 1))
    moved: np.ndarray = tc @ (_binomials(size) * np.where(powers >= 0, float(tau) ** np.maximum(powers, 0), 0.0))
    return moved
