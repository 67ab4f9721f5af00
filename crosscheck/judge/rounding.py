"""What rounding may leave: in a step, in a run, and in what a method promises to keep."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from crosscheck.references.base import Reference
from crosscheck.scene.mechanics import weights
from crosscheck.scene.model import Scene

EPS = float(np.finfo(float).eps)

USUAL = 50.0
"""Roundings (eps) that a step is allowed: about the size of the terms of accelerations over their sum, in an ordinary
scene."""


def grading(scene: Scene) -> float:
    """Roundings (eps) that a step is allowed in this scene: `USUAL`, and more if masses or inertias differ widely.

    Joints transmit the forces of all bodies. The lightest body is moved by a difference of such forces that is as small
    as its mass, and a needle turns about its own axis by one as small as its least moment of inertia.
    """
    masses, inertias = weights(scene)
    principal = np.linalg.eigvalsh(inertias)
    return float(max(USUAL, scene.masses.sum() / masses.min(), (principal[:, -1] / principal[:, 0]).max()))


def rounding_of(scene: Scene, truth: Reference, sizes: Mapping[str, float]) -> dict[str, tuple[float, float]]:
    """(a, b) by quantity: in n steps rounding changes a figure by no more than a + b n.

    The same code gives the same bits on one machine, but another processor or library may round differently. a is the
    error of truth, b the rounding of a step, magnified by the motion.
    """
    step = grading(scene) * EPS * truth.amplification
    return {name: (truth.error * size, step * size) for name, size in sizes.items()}
