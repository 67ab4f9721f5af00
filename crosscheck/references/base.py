"""What a reference is: states to about 1e-12, where they come from, and how far they can be trusted."""

from __future__ import annotations

import dataclasses

import numpy as np

from crosscheck.errors import CrosscheckError
from crosscheck.scene.states import States


@dataclasses.dataclass(frozen=True)
class Reference:
    """Independent truth for one scene, at its output times.

    The two formulations agree to `disagreement` (max over samples and bodies of |dx| / length and |dR|_F). The scene's
    conditioning explains `allowed = max(1e-12, 1e-14 * amplification)` of it; what they differ by beyond that makes the
    `error` larger, and a third formulation was then asked which of them is wrong. `TruthError` where no usable digits
    are left.
    """

    states: States  # with a and alpha
    source: str  # "closed form (Jacobi elliptic functions)" or "Taylor series (heyoka)"
    second_source: str  # what it was compared with
    disagreement: float
    allowed: float
    amplification: float  # growth of a 1e-14 perturbation of the initial state over the run
    horizon: float  # s; the time up to which a 1e-15 perturbation stays below 1e-10; the duration where it always does
    position_derivatives: np.ndarray  # (11,) k-th entry: max over time and bodies of |d^k x / dt^k|, world, SI
    attitude_derivatives: np.ndarray  # (11,) k-th entry: max over time and bodies of |d^k R / dt^k|_F
    outvoted: str = ""  # which formulation two others outvoted, and by how much

    @property
    def error(self) -> float:
        """What this truth may be wrong by, of |dx| / length and |dR|_F, up to the horizon: never less than how far the
        formulations differ, nor than what rounding does on such a scene."""
        return max(self.allowed, self.disagreement)

    @property
    def t(self) -> np.ndarray:
        """Output times, (T,)."""
        return self.states.t


class TruthError(CrosscheckError):
    """A scene has no truth: its formulations disagree beyond use, or one of them does not reach the end."""


class Chaotic(TruthError):
    """Truth of a scene ends at its `horizon` (s), before the first output time after the start."""

    def __init__(self, message: str, horizon: float) -> None:
        super().__init__(message)
        self.horizon = horizon
