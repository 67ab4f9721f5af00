"""Conditioning of a scene: the growth of small perturbations of its initial state."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator

import numpy as np

from crosscheck.references.base import scene_length
from crosscheck.references.generic import quaternion_product
from crosscheck.references.joint_motion import COORDINATES
from crosscheck.references.maximal import Maximal
from crosscheck.references.taylor import Taylor
from crosscheck.references.tree import FREE
from crosscheck.scene.model import Scene

PERTURBATION = 1e-8  # the growth is linear and applies to 1e-14 too, where rounding of the run would hide it
SMALL_PERTURBATION = 1e-11  # used if PERTURBATION grows until the motion is no longer linear in it
NONLINEAR = 1e-2  # central differences up to this size are linear up to their square
HORIZON_GROWTH = 1e-10 / 1e-15
INSTANTS = 401  # growth oscillates; this grid makes it independent of the scene's number of samples
RESOLVED = 40  # a horizon within this many instants of the start is searched again on a finer grid
CLOSURE_STEP = 1e-5  # step of central differences of loop rows; their error, its square, times PERTURBATION is 1e-18
STARTS = 16  # times of a motion from which `floor` follows perturbations
SAMPLES = 12  # with more directions, so many random combinations are followed; accurate to about a fifth


@dataclasses.dataclass(frozen=True)
class Conditioning:
    """Growth of the worst small perturbation in the larger of |dx| / length and |dR|_F."""

    amplification: float  # maximum over the run
    within_horizon: float  # maximum up to the horizon
    horizon: float  # s, the time until it reaches 1e5, at most the duration


def measure(integrator: Taylor) -> Conditioning:
    """Perturb the initial state along every direction of its manifold and take the worst combination.

    Attitudes and joint angles are perturbed by angles (rad), displacements by lengths, their rates in units of the
    rate max(|w0|, sqrt(g / length)) and of length times this rate. With loops, only combinations that keep the rows
    closed count. Derivatives are differences of runs; growth beyond 1e10 saturates. With more than SAMPLES directions
    the root of the sum of squares over all of them is estimated instead, which is no less than the worst.
    """
    t = np.linspace(0.0, integrator.scene.duration, INSTANTS)
    growth = growth_over(integrator, t)
    amplification = float(np.max(growth))
    over = np.flatnonzero(growth >= HORIZON_GROWTH)
    while len(over) and over[0] < RESOLVED and over[0] > 0:
        t = np.linspace(0.0, t[over[0]], INSTANTS)
        growth = _growth(integrator, t, PERTURBATION)
        over = np.flatnonzero(growth >= HORIZON_GROWTH)
    last = max(over[0] - 1, 0) if len(over) else INSTANTS - 1
    return Conditioning(amplification, float(np.max(growth[:last + 1])), float(t[last]))


def growth_over(integrator: Taylor, t: np.ndarray, solver: Maximal | None = None) -> np.ndarray:
    """(T,) growth of the worst small perturbation of the start at times t, which begin with 0; see `measure`.

    `solver` : what solves the equations instead of the Taylor series
    """
    growth = _growth(integrator, t, PERTURBATION, solver)
    if np.max(growth) * PERTURBATION > NONLINEAR:
        small = _growth(integrator, t, SMALL_PERTURBATION, solver)
        growth = np.where(growth * PERTURBATION > NONLINEAR, np.maximum(small, growth), growth)
    return growth


def floor(scene: Scene) -> tuple[float, float]:
    """What rounding leaves of a scene in double precision, and the time at which it does most.

    eps times the growth of the worst small perturbation between any of STARTS times and any later one, of |dx| / length
    and |dR|_F: a perturbation may grow more in the middle of a motion, as where a body flips, than from its start.
    """
    if scene.has_laws:  # a run cannot start between events without the mode there
        from crosscheck.references.tree_laws import LawfulTaylor

        return float(np.finfo(float).eps * measure(LawfulTaylor(scene)).amplification), 0.0
    integrator = Taylor(scene)
    starts = np.linspace(0.0, scene.duration, STARTS + 1)
    growths = []
    for start, state in zip(starts[:-1], integrator.run(times=starts)[:-1], strict=True):
        integrator.initial = state
        later = np.linspace(start, scene.duration, INSTANTS)
        growths.append(float(np.max(_growth(integrator, later, PERTURBATION))))
    worst = int(np.argmax(growths))
    return float(np.finfo(float).eps * growths[worst]), float(starts[worst])


def _growth(integrator: Taylor, t: np.ndarray, size: float, solver: Maximal | None = None) -> np.ndarray:
    """(T,) largest singular value of the derivative of any body's x / length or R with respect to the initial state."""
    length = scene_length(integrator.scene)
    directions = _all_directions(integrator, length)
    sampled = len(directions) > SAMPLES
    if sampled:
        directions = np.random.default_rng(0).normal(size=(SAMPLES, len(directions))) @ directions

    def poses(state: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        if solver is None:
            return integrator.pose(integrator.run(state, t))
        found = solver.run(t, integrator.states(state[None], t[:1]))
        return found.x, found.R

    columns_x, columns_R = [], []
    x, R = poses(integrator.initial)
    for direction in directions:
        moved_x, moved_R = poses(_moved(integrator, size * direction))
        columns_x.append((moved_x - x) / (size * length))
        columns_R.append((moved_R - R).reshape(*R.shape[:2], 9) / size)
    if not columns_x:  # nothing can move
        return np.zeros(len(t))
    stacked = (np.stack(columns, axis=-1) for columns in (columns_x, columns_R))
    if sampled:  # E |D g|^2 = |D|_F^2, which is no less than the square of the largest singular value
        worst = [np.sqrt(np.mean(np.sum(derivative**2, axis=-2), axis=-1)) for derivative in stacked]
    else:
        worst = [np.linalg.norm(derivative, ord=2, axis=(-2, -1)) for derivative in stacked]
    largest: np.ndarray = np.max(worst, axis=(0, 2))
    return largest


def _all_directions(integrator: Taylor, length: float) -> np.ndarray:
    """Directions as rows: steps of `_moved` of unit size in the units of `measure`."""
    units = _units(integrator, length)
    if not integrator.rank:
        return np.diag(units)
    rows = []
    for unit in np.diag(CLOSURE_STEP * units):
        change = integrator.closure(_moved(integrator, unit)) - integrator.closure(_moved(integrator, -unit))
        rows.append(change / (2 * CLOSURE_STEP))
    _, _, V = np.linalg.svd(np.array(rows).T)
    slips = sum(cut.slips for cut in integrator.cuts)  # rows without values
    directions: np.ndarray = V[2 * integrator.rank - slips:] * units
    return directions


def _units(integrator: Taylor, length: float) -> np.ndarray:
    """Sizes of the entries of a step of `_moved`."""
    scene = integrator.scene
    rate = max(np.max(np.linalg.norm(scene.w0, axis=1)), np.sqrt(np.linalg.norm(scene.gravity) / length)) or 1.0
    units: list[float] = []
    for factor in (1.0, rate):
        for link in integrator.tree.by_body:
            units += link.turn * [factor] + COORDINATES[link.shift] * [factor * length]
    return np.array(units)


def _moved(integrator: Taylor, step: np.ndarray) -> np.ndarray:
    """The initial state after a small step on its manifold.

    Entries of a step: for each link in the order of bodies, then again for the speeds, three small angles of a free
    turn or the changes of its angles, and the changes of displacements.
    """
    tree, state, entries = integrator.tree, integrator.initial.copy(), iter(step)
    for table in (tree.coordinates, tree.speeds):
        for link in tree.by_body:
            at = table[link.body]
            place = at.start
            if link.turn == FREE and table is tree.coordinates:  # the cosine of so small an angle is 1 to rounding
                half = 0.5 * _taken(entries, 3)
                state[place:place + 4] = quaternion_product(state[place:place + 4].tolist(), [1.0, *half])
                place += 4
            else:
                state[place:place + link.turn] += _taken(entries, link.turn)
                place += link.turn
            state[place:at.stop] += _taken(entries, at.stop - place)
    integrator.follow_angles(state)
    return state


def _taken(entries: Iterator[float], count: int) -> np.ndarray:
    return np.array([next(entries) for _ in range(count)])
