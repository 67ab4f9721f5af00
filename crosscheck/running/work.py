"""Work of loads, dampers, drives and laws along a run.

Output times alone do not tell it: power oscillates and jumps between them. The equations do: from each of the run's own
states the true motion to the next output time gains what is done on it in between: (15.2) of docs/theory.md.
"""

from __future__ import annotations

import math

import numpy as np

from crosscheck.errors import CrosscheckError
from crosscheck.references.restarts import follow
from crosscheck.scene import mechanics
from crosscheck.scene.batch import integrate
from crosscheck.scene.coordinates import hinge_angles
from crosscheck.scene.model import Scene
from crosscheck.scene.starts import restarted
from crosscheck.scene.states import Motion, States

SETTLED = 1e-8
"""Share of the largest energy by which twice the steps may change that at the end of an interval: of order eight, the
finer one is then good to 4e-11."""

HALVINGS = 9
"""Of the steps of an interval. One that is still not settled then has no known work."""


def work(scene: Scene, states: Motion) -> np.ndarray:
    """Work of loads, dampers, drives, laws of joints and impacts since the first time, (T,) in J.

    It is what the energy of the true motion over each interval of output times gains, from the run's own state at its
    begin. NaN from the first interval on in which that is not known: it does not settle as steps are halved, turns of a
    hinge are not known, or the truth of a scene with laws of joints does not reach its end.
    """
    total = np.zeros(len(states.t))
    if not scene.worked_on or len(states.t) < 2:
        return total
    hinges = hinge_angles(scene, states)[:-1]
    begin = States(*(getattr(states, key)[:-1] for key in "txRvw"), hinges=hinges)
    with np.errstate(over="ignore", invalid="ignore"):
        before = mechanics.energy(scene, begin)
        ended = _lawful(scene, states) if scene.has_laws else _lawless(scene, begin, np.diff(states.t), before)
    total[1:] = np.cumsum(ended - before)
    return total


def _lawful(scene: Scene, states: Motion) -> np.ndarray:
    """The energy at the end of each interval of a scene with laws of joints, by the series of its truth."""
    ended = np.full(len(states.t) - 1, np.nan)
    try:
        followed = follow(
            scene, 1.0, ((float(t), restarted(scene, states, k, 1.0)) for k, t in enumerate(states.t[:-1])),
            np.diff(states.t).tolist())[0]
    except CrosscheckError:
        return ended
    for k, until in enumerate(states.t[1:]):
        if abs(followed[k].end.t[0] - until) <= 1e-9 * max(1.0, until):  # the claim of the scene may end before
            ended[k] = mechanics.energy(scene, followed[k].end)[0]
    return ended


def _lawless(scene: Scene, begin: States, tau: np.ndarray, before: np.ndarray) -> np.ndarray:
    """The energy at the end of each interval, of `tau` s, by the index-1 equations with ever shorter steps."""
    ended, last = np.full((2, len(tau)), np.nan)
    open_ = np.flatnonzero(np.isfinite(before))
    spins = np.linalg.norm(begin.w[open_], axis=-1).max(axis=1, initial=0.0) * tau[open_]
    first = math.ceil(math.log2(max(1.0, 2.0 * spins.max(initial=0.0))))  # from call to call hinges turn less than pi
    size = np.abs(before[open_]).max(initial=0.0)
    for k in range(first, first + HALVINGS + 1):
        if not len(open_):
            break
        now, sizes = np.full((2, len(tau)), np.nan)
        try:
            end = integrate(scene, begin.at(open_), tau[open_], 2**k, 1)[0]
            now[open_], sizes[open_] = mechanics.energy(scene, end), mechanics.kinetic_energy(scene, end)
        except (RuntimeError, ValueError, np.linalg.LinAlgError):  # too long a step leads nowhere
            pass
        converged = np.abs(now - last) <= SETTLED * np.maximum(size, sizes)
        ended[converged], last = now[converged], now
        open_ = open_[~converged[open_]]
    return ended
