"""How far the truth of a scene can be trusted: growth of a small perturbation of its initial state."""

from __future__ import annotations

import dataclasses

import numpy as np

from crosscheck.references.generic import quaternion_product
from crosscheck.references.taylor import Taylor
from crosscheck.references.tree import scene_length

PERTURBATION = 1e-8  # scaled down to 1e-14 afterwards: at 1e-14 itself, round-off of the run would be measured instead
SMALL_PERTURBATION = 1e-11  # where PERTURBATION grows until the motion stops being linear in it
NONLINEAR = 1e-2  # a central difference this large is still linear to its square
HORIZON_GROWTH = 1e-10 / 1e-15
INSTANTS = 401  # growth oscillates; a grid of its own keeps it independent of the scene's number of samples


@dataclasses.dataclass(frozen=True)
class Conditioning:
    """Growth of the worst small perturbation, its maximum over the run, and the time until it reaches 1e5."""

    amplification: float  # over the run, of |dx| / length and |dR|_F, the larger
    within_horizon: float  # the same up to the horizon
    horizon: float  # s


def measure(integrator: Taylor) -> Conditioning:
    """Perturb the initial state along every direction of its manifold and take the worst combination of them.

    Directions: attitudes by angles (rad), angular velocities in units of a rate, max(|w0|, sqrt(g / length)),
    free roots by lengths and length times rate. Central differences of Taylor runs. Growth beyond 1e10 saturates.
    """
    t = np.linspace(0.0, integrator.scene.duration, INSTANTS)
    growth = _growth(integrator, t, PERTURBATION)
    if np.max(growth) * PERTURBATION > NONLINEAR:
        small = _growth(integrator, t, SMALL_PERTURBATION)
        growth = np.where(growth * PERTURBATION > NONLINEAR, np.maximum(small, growth), growth)
    over = np.flatnonzero(growth >= HORIZON_GROWTH)
    last = max(over[0] - 1, 0) if len(over) else INSTANTS - 1
    return Conditioning(float(np.max(growth)), float(np.max(growth[:last + 1])), float(t[last]))


def _growth(integrator: Taylor, t: np.ndarray, size: float) -> np.ndarray:
    """(T,) largest singular value of the derivative of any body's x / length or R by the initial state."""
    length = scene_length(integrator.scene)
    columns_x, columns_R = [], []
    for plus, minus in _perturbed(integrator, size, length):
        (x1, R1), (x0, R0) = (integrator.pose(integrator.run(state, t)) for state in (plus, minus))
        columns_x.append((x1 - x0) / (2 * size * length))
        columns_R.append((R1 - R0).reshape(*R0.shape[:2], 9) / (2 * size))
    worst = [np.linalg.norm(np.stack(columns, axis=-1), ord=2, axis=(-2, -1)) for columns in (columns_x, columns_R)]
    return np.max(worst, axis=(0, 2))


def _perturbed(integrator: Taylor, size: float, length: float):
    """Pairs of initial state vectors, one step of `size` either way along each direction."""
    scene, start = integrator.scene, integrator.initial
    n = scene.n
    rate = max(np.max(np.linalg.norm(scene.w0, axis=1)), np.sqrt(np.linalg.norm(scene.gravity) / length)) or 1.0
    for body in range(n):
        at = slice(4 * body, 4 * body + 4)
        for k in range(3):
            turns = []
            for sign in (1.0, -1.0):
                half = sign * size / 2  # the cosine differs from 1 by less than a rounding
                turned = start.copy()
                turned[at] = quaternion_product(start[at], [1.0, *(half * np.eye(3)[k])])
                turns.append(turned)
            yield turns
    units = [rate] * (3 * n) + (3 * [length] + 3 * [length * rate]) * len(integrator.free)
    for k, unit in enumerate(units):
        step = np.zeros_like(start)
        step[4 * n + k] = size * unit
        yield start + step, start - step
