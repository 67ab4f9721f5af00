"""How far rounding alone may move the figures of a run: what two runs of unchanged code may differ by.

On one machine the same code gives the same bits; another processor or library may round otherwise.
"""

from __future__ import annotations

from crosscheck.judge import tolerances
from crosscheck.judge.metrics import QUANTITIES
from crosscheck.judge.tolerances import EPS, Tol
from crosscheck.references.base import Reference
from crosscheck.scene.model import Scene


def rounding_levels(scene: Scene, truth: Reference) -> dict[str, tuple[float, float]]:
    """(a, b) per figure: rounding moves it by no more than a + b n^0.6 in n steps.

    Figures: the compared quantities in their units, "energy" over the largest kinetic energy, "momentum" in
    kg m^2/s. As `tolerances.rounding`: the doubt of truth, and 50 eps (`grading`) times the size, magnified
    as the scene magnifies a perturbation.
    """
    scale = tolerances.scales(scene, truth)
    sizes = {quantity: scale.of(quantity) for quantity in QUANTITIES}
    fixed = {quantity: truth.allowed * max(1.0, size) for quantity, size in sizes.items()}
    step = tolerances.grading(scene) * EPS * truth.amplification
    growing = {quantity: step * size for quantity, size in sizes.items()}
    levels = {quantity: (fixed[quantity], growing[quantity]) for quantity in QUANTITIES}
    for name, rule in (("energy", tolerances.energy), ("momentum", tolerances.momentum)):
        a, b = (rule(scene, truth, {quantity: Tol(value, "rounding") for quantity, value in part.items()}).value
                for part in (fixed, growing))
        levels[name] = (a, b)
    return levels
