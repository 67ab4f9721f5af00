"""Stiffness of springs and dampers, and the integrator and tolerance that the maximal formulation uses for it."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from scipy.integrate import DOP853, Radau

DECAYS = 5000.0
"""The implicit method is used if the rate of the fastest decay times the duration exceeds this: the stability of an
explicit method would require a hundred thousand evaluations or more."""

IMPLICIT_RTOL = 1e-12
"""Tolerance of the implicit method: a tenth of it gives the same error with twice the evaluations."""

QUIET = 100.0
"""Highest rate (1/s) at which rounding stays within the tightest tolerance. The rounding error of a position causes an
acceleration, larger by the square of the rate, and changes the velocity of one step by the rate times that error. With
a tolerance below that, noise would make the steps ever shorter."""

DIFFERENCE = 1e-6
"""Step of the central differences of the rates, relative to entries of order one."""


def eigenvalues(rates: Callable[[float, np.ndarray], np.ndarray], start: np.ndarray) -> np.ndarray:
    """Eigenvalues (1/s) of the derivative of dy/dt = rates(t, y) with respect to y at `start`."""
    columns = [rates(0.0, start + step) - rates(0.0, start - step) for step in DIFFERENCE * np.eye(len(start))]
    return np.linalg.eigvals(np.array(columns).T / (2 * DIFFERENCE))


def integrator(values: np.ndarray, duration: float, tightest: float) -> tuple[type[Any], float]:
    """Integrator and relative tolerance for equations with these eigenvalues (1/s) over `duration` (s).

    `tightest`: the relative tolerance if nothing is stiff.
    """
    if -values.real.min() * duration > DECAYS:
        return Radau, IMPLICIT_RTOL
    return DOP853, tightest * max(1.0, float(np.abs(values).max()) / QUIET)
