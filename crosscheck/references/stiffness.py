"""How stiff springs and dampers are, and which integrator, how tight, the maximal formulation then takes."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from scipy.integrate import DOP853, Radau

DECAYS = 5000.0
"""Rate of the fastest decay times the duration from which on the implicit method is used: an explicit one needs the
steps that stability allows, a hundred thousand evaluations and more."""

IMPLICIT_RTOL = 1e-12
"""Of the implicit method: a tenth of it is off by as much, and takes twice the evaluations."""

QUIET = 100.0
"""Highest rate (1/s) whose rounding stays within the tightest tolerance. A rounding of a position comes back as an
acceleration, the square of the rate times as large, and moves the velocity of one step by the rate times a rounding:
a tolerance below that answers to noise with ever shorter steps."""

DIFFERENCE = 1e-6
"""Step of the central differences of the rates, relative to entries of order one."""


def eigenvalues(rates: Callable[[float, np.ndarray], np.ndarray], start: np.ndarray) -> np.ndarray:
    """Eigenvalues (1/s) of the derivative of dy/dt = rates(t, y) by y at `start`."""
    columns = [rates(0.0, start + step) - rates(0.0, start - step) for step in DIFFERENCE * np.eye(len(start))]
    return np.linalg.eigvals(np.array(columns).T / (2 * DIFFERENCE))


def integrator(values: np.ndarray, duration: float, tightest: float) -> tuple[type[Any], float]:
    """Integrator and relative tolerance for equations with these eigenvalues (1/s) over `duration` (s).

    `tightest`: the tolerance (relative) where nothing is stiff.
    """
    if -values.real.min() * duration > DECAYS:
        return Radau, IMPLICIT_RTOL
    return DOP853, tightest * max(1.0, float(np.abs(values).max()) / QUIET)
