"""Truth without heyoka: Taylor series in natural coordinates against DOP853 in maximal ones, or a closed form.

Both formulations need only NumPy and SciPy. Derivatives follow from the coefficients of the series in natural
coordinates, the growth of perturbations from runs with perturbed starts.
"""

from __future__ import annotations

import math

import numpy as np

from crosscheck.errors import Unsupported
from crosscheck.references import closed_form
from crosscheck.references.agreement import USABLE, Solved, difference
from crosscheck.references.base import Reference, TruthError
from crosscheck.references.maximal import Maximal
from crosscheck.references.natural import SOURCE, Natural
from crosscheck.references.natural_loads import Motion
from crosscheck.references.series import ORDERS
from crosscheck.references.tree import scene_length
from crosscheck.scene.model import Scene
from crosscheck.scene.states import States

DIRECTIONS = 4
"""Number of random perturbations."""
PERTURBATION = 1e-9
HORIZON_GROWTH = 1e5
"""Growth of a perturbation from 1e-15 to 1e-10, as for compiled series."""
SUBPOINTS = 4
"""Number of points of a step at which derivatives are evaluated."""


def compute(scene: Scene, floor: float, roundoff: float) -> Reference:
    """Truth of a scene; `floor` and `roundoff` are those of `crosscheck.references`.

    Raises
    ------
    Unsupported
        The scene is too large for natural coordinates.
    TruthError
        The formulations differ so much that no usable digits are left, or one of them ends early.
    """
    natural = Natural(scene)
    steps: list[tuple[float, Motion]] = []
    series = Solved(natural.run(steps=steps), SOURCE)
    growth = _growth(scene, natural, series.states)
    over = np.flatnonzero(growth >= HORIZON_GROWTH)
    last = max(int(over[0]) - 1, 0) if len(over) else len(growth) - 1
    if last < 1:
        raise TruthError(f"{scene.name!r}: a perturbation of 1e-15 grows to 1e-10 before the first output time; ask "
                         "for a shorter duration or more samples")
    horizon, within = float(scene.t[last]), float(growth[:last + 1].max())
    try:
        first, second = Solved(closed_form.solve(scene), closed_form.SOURCE), series
    except Unsupported:
        other = Maximal(scene)
        first, second = series, Solved(other.run(scene.t[:last + 1]), other.source)
    allowed = max(floor, roundoff * within)
    # `agree` cannot help here: its third formulation is the first one of these two.
    apart = difference(scene, first.states, second.states, last + 1)
    if apart.size > max(allowed, USABLE):
        raise TruthError(f"{scene.name!r}: {first.source} and {second.source} disagree by {apart.size:.2e} at "
                         f"t = {scene.t[apart.sample]:.6g} s in body {scene.bodies[apart.body].name!r}; the scene's "
                         f"conditioning explains {allowed:.2e}")
    position, attitude = _derivative_maxima(scene, steps)
    return Reference(first.states, first.source, second.source, apart.size, allowed, float(growth.max()), horizon,
                     position, attitude)


def _growth(scene: Scene, natural: Natural, states: States) -> np.ndarray:
    """(T,) estimated growth of the worst perturbation of the start, in |dx| / length and |dR|_F.

    On average a random direction contains the worst one with the factor one over the root of the number of freedoms.
    """
    length = scene_length(scene)
    rate = max(float(np.abs(scene.w0).max(initial=0.0)), math.sqrt(float(np.linalg.norm(scene.gravity)) / length))
    rng = np.random.default_rng(0)
    freedoms = max(1, 12 * scene.n - 2 * natural.rows.count)
    largest = np.zeros(len(scene.t))
    for _ in range(DIRECTIONS):
        x, turn, v, w = PERTURBATION * rng.standard_normal((4, scene.n, 3))
        start = natural.start_beside(length * x, turn, rate * length * v, rate * w)
        other = natural.run(start=start)
        gaps = np.maximum(np.linalg.norm(other.x - states.x, axis=-1).max(axis=1) / length,
                          np.linalg.norm(other.R - states.R, axis=(-2, -1)).max(axis=1))
        largest = np.maximum(largest, gaps / PERTURBATION)
    return np.maximum(1.0, math.sqrt(freedoms / DIRECTIONS) * largest)


def _derivative_maxima(scene: Scene, steps: list[tuple[float, Motion]]) -> tuple[np.ndarray, np.ndarray]:
    """Largest |d^k x/dt^k| and |d^k R/dt^k|_F over the run and the bodies, k = 0 ... ORDERS."""
    position, attitude = np.zeros((2, ORDERS + 1))
    for h, motion in steps:
        coefficients = motion.q[:, :-1].astype(float)
        highest = len(coefficients) - 1
        for tau in np.arange(SUBPOINTS) * h / SUBPOINTS:
            for k in range(ORDERS + 1):
                weights = np.array([math.perm(j, k) * tau ** (j - k) for j in range(k, highest + 1)])
                derivative = np.einsum("j,j...->...", weights, coefficients[k:])
                position[k] = max(position[k], np.linalg.norm(derivative[:, 0], axis=-1).max())
                attitude[k] = max(attitude[k], np.linalg.norm(derivative[:, 1:], axis=(-2, -1)).max())
    return position, attitude
