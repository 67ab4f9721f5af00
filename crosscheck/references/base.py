"""The type of a reference: states accurate to about 1e-12, their sources and their error."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from crosscheck.errors import CrosscheckError
from crosscheck.scene.model import GROUND, Scene
from crosscheck.scene.states import States

LONGEST = 8.0
"""Longest piece of a series, s: where nothing moves, or a parabola is exact, nothing else would end it."""


@dataclasses.dataclass(frozen=True)
class Piece:
    """One step of a series: state = sum of coefficients[:, k] tau^k for a time tau from its start to its length (s)."""

    start: float
    rest: float  # what the start has beyond a double
    length: float
    coefficients: np.ndarray  # (dimension, order + 1)
    mode: np.ndarray | None = None  # numbers of its force laws, if these have modes


@dataclasses.dataclass(frozen=True)
class End:
    """Where a series goes on: its state, and the time in two parts as that of a piece."""

    state: np.ndarray
    time: float = 0.0
    rest: float = 0.0
    mode: Any = ()  # of the force laws
    events: tuple[tuple[float, str, str], ...] = ()  # until there: (time, joint or monitor, what happened)
    horizon: float = math.inf  # s; where a unique continuation, or the claim of the scene, ended before
    cause: str = ""  # why


class Series:
    """Pieces one after the other: state vectors and modes at any times within them."""

    def __init__(self, pieces: Sequence[Piece]) -> None:
        self.starts, self.rests, self.lengths, self.coefficients = (np.array([getattr(
            piece, name) for piece in pieces]) for name in ("start", "rest", "length", "coefficients"))
        self.modes = np.array([piece.mode for piece in pieces]) if pieces and pieces[0].mode is not None else None

    def __call__(self, t: np.ndarray) -> np.ndarray:
        """(T, dimension) at times t. The coefficients of all times at once, for `polynomial`, would be large."""
        index = self._piece_of(t)
        tau = ((t - self.starts[index]) - self.rests[index])[:, None]
        values = np.zeros((len(t), self.coefficients.shape[1]))
        for k in reversed(range(self.coefficients.shape[2])):
            values = values * tau + self.coefficients[index, :, k]
        return values

    def modes_at(self, t: np.ndarray) -> np.ndarray | None:
        """(T, 5 L) numbers of the laws, if these have modes."""
        return None if self.modes is None else self.modes[self._piece_of(t)]

    def _piece_of(self, t: np.ndarray) -> np.ndarray:
        """Index of the piece of each time; at an event, of what follows it."""
        index: np.ndarray = np.clip(np.searchsorted(self.starts, t + rounding(t), side="right") - 1, 0, None)
        return index


def polynomial(coefficients: np.ndarray, tau: np.ndarray) -> np.ndarray:
    """Values (..., dimension) of series (..., dimension, order + 1) at times tau (...) after their starts."""
    values = np.zeros((*tau.shape, coefficients.shape[-2]))
    for k in reversed(range(coefficients.shape[-1])):
        values = values * tau[..., None] + coefficients[..., k]
    return values


def rounding(t: Any) -> Any:
    """Times (s) less than this apart are one: a sample of a servo is at the output time that it is meant for."""
    return 1e-12 * np.maximum(1.0, t)


def scene_length(scene: Scene) -> float:
    """Largest distance from a centre of mass to an anchor, or rod length, m; if all are zero, a radius of gyration."""
    levers = [np.linalg.norm(joint.child_anchor) for joint in scene.joints if joint.child != GROUND]
    levers += [np.linalg.norm(joint.parent_anchor) for joint in scene.joints if joint.parent != GROUND]
    levers += [joint.length for joint in scene.joints if joint.length]
    if max(levers, default=0.0) > 0.0:
        return float(max(levers))
    return float(max(np.sqrt(np.trace(body.inertia) / body.mass) for body in scene.bodies if body.mass))


@dataclasses.dataclass(frozen=True)
class Reference:
    """Independent truth for one scene, at its output times.

    `disagreement` is the error that the defects of the motion in the second formulation make. The scene's conditioning
    explains `allowed = max(1e-12, 1e-14 * amplification)` of it. A larger one increases `error`.
    """

    states: States  # with a and alpha
    source: str  # such as "Taylor series (heyoka), minimal coordinates"
    second_source: str  # the formulation it was compared with
    disagreement: float
    allowed: float
    amplification: float  # growth of a 1e-14 perturbation of the initial state over the run
    horizon: float  # s; the time up to which a 1e-15 perturbation stays below 1e-10, at most the duration
    horizon_cause: str = ""  # why the truth ends at its horizon, if that is before the end
    events: tuple[tuple[float, str, str], ...] = ()  # (time, joint or monitor, what happened), up to the horizon

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


def ending(horizon: float, cause: str) -> str:
    """Why nothing is judged after the end (s) of a truth."""
    return f"truth ends at {horizon:g} s: {cause}"


GROWN = "a perturbation of 1e-15 has grown to 1e-10"
"""Why a truth ends early, where no monitor ends it."""


class Chaotic(TruthError):
    """The truth of a scene ends at its `horizon` (s), before the first output time after the start."""

    def __init__(self, message: str, horizon: float) -> None:
        super().__init__(message)
        self.horizon = horizon
