"""The type of a reference: states accurate to about 1e-12, their sources and their error."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping

import numpy as np

from crosscheck.errors import CrosscheckError
from crosscheck.scene.model import Scene
from crosscheck.scene.states import States

ORDERS = 10
"""Highest derivative whose maximum is recorded."""

LONGEST = 8.0
"""Longest piece of a series, s: where nothing moves, or a parabola is exact, nothing else would end it."""


@dataclasses.dataclass(frozen=True)
class Piece:
    """One step of a series: state = sum of coefficients[:, k] tau^k for a time tau from its start to its length (s)."""

    start: float
    rest: float  # what the start has beyond a double
    length: float
    coefficients: np.ndarray  # (dimension, order + 1)


@dataclasses.dataclass(frozen=True)
class End:
    """Where a series goes on: its state, and the time in two parts as that of a piece."""

    state: np.ndarray
    time: float = 0.0
    rest: float = 0.0


def breaks(scene: Scene) -> list[float]:
    """Times at which a derivative of a function of time jumps, also beyond the scene's duration."""
    return sorted({t for function in scene.functions for t in function.inner_breaks if t > 0.0})


@dataclasses.dataclass(frozen=True)
class Reference:
    """Independent truth for one scene, at its output times.

    The two formulations differ by `disagreement` (max over samples and bodies of |dx| / length and |dR|_F). The scene's
    conditioning explains `allowed = max(1e-12, 1e-14 * amplification)` of it. A larger difference increases `error`,
    and a third formulation then decided which of them is wrong.
    """

    states: States  # with a and alpha
    source: str  # "closed form (Jacobi elliptic functions)" or "Taylor series (heyoka)"
    second_source: str  # the formulation it was compared with
    disagreement: float
    allowed: float
    amplification: float  # growth of a 1e-14 perturbation of the initial state over the run
    horizon: float  # s; the time up to which a 1e-15 perturbation stays below 1e-10, at most the duration
    position_derivatives: np.ndarray  # (11,) k-th entry: max over time and bodies of |d^k x / dt^k|, world, SI
    attitude_derivatives: np.ndarray  # (11,) k-th entry: max over time and bodies of |d^k R / dt^k|_F
    outvoted: str = ""  # which formulation two others outvoted, and by how much

    @property
    def error(self) -> float:
        """Bound on the error of this truth, in |dx| / length and |dR|_F, up to the horizon.

        It is the larger of the difference of the formulations and the effect of rounding on the scene.
        """
        return max(self.allowed, self.disagreement)

    @property
    def sensors(self) -> Mapping[str, np.ndarray]:
        """The readings of the scene's sensors, where `crosscheck.truth` made this; NaN where they are not unique."""
        return self.states.sensors or {}

    @property
    def t(self) -> np.ndarray:
        """Output times, (T,)."""
        return self.states.t


class TruthError(CrosscheckError):
    """A scene has no truth: its formulations disagree too much, or one of them does not reach the end."""


class Chaotic(TruthError):
    """The truth of a scene ends at its `horizon` (s), before the first output time after the start."""

    def __init__(self, message: str, horizon: float) -> None:
        super().__init__(message)
        self.horizon = horizon
