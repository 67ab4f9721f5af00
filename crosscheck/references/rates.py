"""The fastest rate of a scene with springs, from the maximal formulation."""

from __future__ import annotations

from crosscheck.references.maximal import Maximal
from crosscheck.references.stiffness import eigenvalues
from crosscheck.scene.model import Scene


def fastest(scene: Scene) -> float:
    """Rate (1/s) of the fastest decay or oscillation of a scene with springs, at its start; 0 without springs."""
    if not any(force.type.endswith("spring") for force in scene.forces):
        return 0.0
    equations = Maximal(scene)
    return float(max(abs(eigenvalues(equations.rates, equations.initial()))))
