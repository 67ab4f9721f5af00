"""Compares two formulations of a motion, and a third one if they differ, to find the truth and its error."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import numpy as np

from crosscheck.errors import Unsupported
from crosscheck.references.base import TruthError
from crosscheck.references.tree import scene_length
from crosscheck.scene.model import Scene
from crosscheck.scene.states import States

FLOOR = 1e-12  # relative difference of two formulations on a well-conditioned scene
ROUNDOFF = 1e-14  # the rounding errors of a whole run as a perturbation of its start, before the scene amplifies it
USABLE = 1e-6  # relative; a hundredth of the loosest bound of a verdict, that of a method of order one
OUTVOTED = 0.1  # two formulations outvote a third if their difference is at most this part of its difference from them


@dataclasses.dataclass(frozen=True, eq=False)
class Solved:
    """One formulation's motion, and its name."""

    states: States
    source: str


@dataclasses.dataclass(frozen=True)
class Agreement:
    """The chosen motion, the one that confirms it, their difference, and which formulation was outvoted."""

    chosen: Solved
    second: Solved
    difference: float
    outvoted: str = ""


@dataclasses.dataclass(frozen=True)
class Difference:
    """The largest |dx| / length or |dR|_F of two trajectories, and where it is."""

    size: float
    sample: int
    body: int


def difference(scene: Scene, first: States, second: States, count: int) -> Difference:
    """The largest difference of two trajectories at the first `count` times."""
    x = np.linalg.norm(first.x[:count] - second.x[:count], axis=-1) / scene_length(scene)
    R = np.linalg.norm(first.R[:count] - second.R[:count], axis=(-2, -1))
    sizes = np.maximum(x, R)
    sizes = np.where(np.isnan(sizes), np.inf, sizes)
    sample, body = np.unravel_index(np.argmax(sizes), sizes.shape)
    return Difference(float(sizes[sample, body]), int(sample), int(body))


def agree(scene: Scene, first: Solved, second: Solved, count: int, allowed: float,
          solve_third: Callable[[Scene, np.ndarray], Solved | None] | None = None) -> Agreement:
    """The motion on which two formulations, or two of three, agree at the first `count` times.

    If the two differ by more than `allowed`, a third formulation is computed, by default in natural coordinates. A
    formulation is outvoted if it differs from the other two ten times as much as these do from each other. If none is,
    the difference counts as the error of the first one.

    Raises
    ------
    TruthError
        The difference leaves no usable digits; the message names the sources, the time and the body.
    """
    apart = difference(scene, first.states, second.states, count)
    if apart.size <= allowed:
        return Agreement(first, second, apart.size)
    third = (solve_third or natural_coordinates)(scene, first.states.t[:count])
    if third is not None:
        pairs = [(difference(scene, one.states, third.states, count).size, one, other)
                 for one, other in ((first, second), (second, first))]
        nearest, one, other = min(pairs, key=lambda pair: pair[0])
        if nearest <= max(allowed, OUTVOTED * apart.size) and nearest <= USABLE:
            off = f"{other.source} is off by {apart.size:.1e} at {_place(scene, first, apart)}"
            return Agreement(one, third, nearest, off)
    if apart.size <= USABLE:
        return Agreement(first, second, apart.size)
    raise TruthError(f"{scene.name!r}: {first.source} and {second.source} disagree by {apart.size:.2e} at "
                     f"{_place(scene, first, apart)}; the scene's conditioning explains {allowed:.2e}"
                     + (", and a third formulation sides with neither" if third is not None else ""))


def _place(scene: Scene, solved: Solved, where: Difference) -> str:
    return f"t = {solved.states.t[where.sample]:.6g} s in body {scene.bodies[where.body].name!r}"


def natural_coordinates(scene: Scene, times: np.ndarray) -> Solved | None:
    """The motion in natural coordinates, None if these cannot compute it."""
    from crosscheck.references import natural

    try:
        return Solved(natural.Natural(scene).run(times), natural.SOURCE)
    except (Unsupported, TruthError, np.linalg.LinAlgError):
        return None
