"""Differences of two motions by quantity, and their norm."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from crosscheck.scene.states import Motion, States

STATE = ("position", "attitude", "velocity", "angular velocity")
"""The quantities of a state."""

ROUNDED = 1e-9
"""Share within which two times, or two states, are one: sums of a million steps round to 1e-10 of it."""

Rows = Mapping[str, np.ndarray]
"""By quantity (T, n, k): the vectors that differ, for T times and n bodies."""


def turn(R: np.ndarray, S: np.ndarray) -> np.ndarray:
    """Rotation vectors (rad) of R^T S, (..., 3)."""
    D = np.swapaxes(R, -1, -2) @ S
    twice = np.stack([D[..., 2, 1] - D[..., 1, 2], D[..., 0, 2] - D[..., 2, 0], D[..., 1, 0] - D[..., 0, 1]], -1)
    sine = np.linalg.norm(twice, axis=-1)
    angle = np.arctan2(sine, np.trace(D, axis1=-2, axis2=-1) - 1.0)
    lost = (sine < np.sqrt(np.finfo(float).eps)) & (angle > 1.0)  # at half a turn any direction will do
    direction = np.where(lost[..., None], [1.0, 0.0, 0.0], twice / np.where(sine > 0.0, sine, 1.0)[..., None])
    return np.asarray(direction * angle[..., None])


def state_apart(one: Motion, other: Motion) -> dict[str, np.ndarray]:
    """`one` less `other` at the same times, (T, n, 3) of each of `STATE`, world axes but for attitudes and w (body)."""
    return {"position": one.x - other.x, "attitude": turn(other.R, one.R), "velocity": one.v - other.v,
            "angular velocity": one.w - other.w}


def apart(one: States, other: States) -> dict[str, np.ndarray]:
    """As `state_apart`, and "orthogonality", (T, n, 9), R^T R - I of `one`; accelerations if both have them."""
    gram = np.swapaxes(one.R, -1, -2) @ one.R - np.eye(3)
    rows = state_apart(one, other) | {"orthogonality": gram.reshape(*gram.shape[:2], 9)}
    if one.a is not None and other.a is not None:
        rows["acceleration"] = one.a - other.a
    if one.alpha is not None and other.alpha is not None:
        rows["angular acceleration"] = one.alpha - other.alpha
    return rows


def largest(vectors: np.ndarray) -> float:
    """The largest Euclidean norm along the last axis; infinite if anything is not finite, 0 of nothing."""
    norms = np.linalg.norm(vectors, axis=-1)
    return float(norms.max(initial=0.0)) if np.isfinite(norms).all() else math.inf


def spread(answers: Sequence[np.ndarray]) -> float:
    """The largest difference of any two answers."""
    return max((largest(one - other) for k, one in enumerate(answers) for other in answers[:k]), default=0.0)


def scaled(rows: Rows, sizes: Mapping[str, float]) -> np.ndarray:
    """(T, n, 12) the differences of x, R, v, w, each over its size."""
    return np.concatenate([rows[name] / sizes[name] for name in STATE], axis=-1)
