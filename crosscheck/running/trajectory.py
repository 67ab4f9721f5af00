"""Trajectories: states of a run and everything derived from them by formulas common to all engines."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np

from crosscheck.adapters.base import RawRun
from crosscheck.scene import mechanics
from crosscheck.scene.constraints import Constraints
from crosscheck.scene.model import Scene
from crosscheck.scene.states import States

MAXIMA = ("energy_error", "constraint_position", "constraint_velocity", "constraint_acceleration", "orthogonality")
"""Keys of the maxima over every step; energy_error is |E - E(0)| over the largest kinetic energy."""


@dataclasses.dataclass(frozen=True)
class Trajectory:
    """A run at its output times, T samples of n bodies; SI units, frames as in `crosscheck.scene.states`.

    What an engine does not know is None: `a`, `alpha` and `constraint_acceleration` without accelerations, `lam` and
    `reactions` without multipliers. At t = 0 those are the index-1 values of the initial state.
    """

    scene: Scene
    engine: str
    method: str
    form: str | None
    t: np.ndarray  # (T,)
    x: np.ndarray  # (T, n, 3) world
    R: np.ndarray  # (T, n, 3, 3) body to world
    v: np.ndarray  # (T, n, 3) world
    w: np.ndarray  # (T, n, 3) body axes
    a: np.ndarray | None  # (T, n, 3) world
    alpha: np.ndarray | None  # (T, n, 3) body axes
    lam: np.ndarray | None  # (T, m)
    energy: np.ndarray  # (T,) J
    momentum_vertical: np.ndarray  # (T,) kg m^2/s, about the upward vertical through the origin
    orthogonality: np.ndarray  # (T,) max-norm of R^T R - I
    constraint_position: np.ndarray  # (T,) max-norm of Phi
    constraint_velocity: np.ndarray  # (T,) max-norm of G u
    constraint_acceleration: np.ndarray | None  # (T,) max-norm of G du/dt + gamma
    reactions: dict[str, tuple[np.ndarray, np.ndarray]] | None  # force, torque (T, 3) on the child at its anchor, world
    wall_time: float  # s, stepping only
    steps: int
    status: str
    stats: dict[str, Any]  # the run's counters, "step" (s), and its maxima over every step by the keys of MAXIMA


class Monitor:
    """Running maxima of energy error, constraint levels and orthogonality, fed with batches of successive steps.

    The energy error is taken from the initial state of the scene, and is relative to the largest kinetic energy met.
    """

    def __init__(self, scene: Scene) -> None:
        self._scene = scene
        self._constraints = Constraints(scene)
        self._angles: dict[str, float] | None = None
        self._kinetic, self._gap = 0.0, 0.0
        self._maxima: dict[str, float] = {}
        self._energy = 0.0
        self._energy = float(self._energies(scene.x0[None], scene.R0[None], scene.v0[None], scene.w0[None])[0])

    def update(self, x: np.ndarray, R: np.ndarray, v: np.ndarray, w: np.ndarray, a: np.ndarray | None = None,
               alpha: np.ndarray | None = None) -> None:
        """Take in states (T, n, ...) after successive steps; accelerations where the engine has them."""
        if len(x) == 0:
            return
        # a diverging run overflows here; its maxima then are inf or nan and say so
        with np.errstate(over="ignore", invalid="ignore"):
            energies = self._energies(x, R, v, w)
            self._gap = float(np.maximum(self._gap, np.abs(energies - self._energy).max()))
            levels = _levels(self._constraints, x, R, v, w, a, alpha)
            for key, values in {**levels, "orthogonality": mechanics.orthogonality(R)}.items():
                if values is not None:
                    self._maxima[key] = float(np.maximum(self._maxima.get(key, 0.0), values.max()))

    def maxima(self) -> dict[str, float]:
        """The maxima so far by the keys of MAXIMA; without `constraint_acceleration` where none was ever given."""
        scale = self._kinetic if self._kinetic > 0 else 1.0  # a scene that never moves: the plain gap in J
        found = {"energy_error": self._gap / scale, **self._maxima}
        return {key: found[key] for key in MAXIMA if key in found}

    def _energies(self, x: np.ndarray, R: np.ndarray, v: np.ndarray, w: np.ndarray) -> np.ndarray:
        batch = States(np.empty(0), x, R, v, w)
        angles = mechanics.torsion_angles(self._scene, R, previous=self._angles)
        self._angles = {joint: float(values[-1]) for joint, values in angles.items()}
        kinetic = mechanics.kinetic_energy(self._scene, batch)
        self._kinetic = float(np.maximum(self._kinetic, kinetic.max()))
        return kinetic + mechanics.potential_energy(self._scene, x, R, angles)


def derive(scene: Scene, engine: str, method: str, raw: RawRun) -> Trajectory:
    """The trajectory of an engine's raw run: energies, constraint levels and reactions from its own states.

    Accelerations and multipliers, where the engine has them, are replaced at t = 0 by the index-1 values.
    """
    s = raw.states
    a, alpha, lam = s.a, s.alpha, s.lam
    constraints = Constraints(scene)
    with np.errstate(over="ignore", invalid="ignore"):
        if len(s.t) and (a is not None or lam is not None):
            start = mechanics.index1(scene, s.x[:1], s.R[:1], s.v[:1], s.w[:1])
            a, alpha, lam = (_with_first(values, first) for values, first in zip((a, alpha, lam), start, strict=True))
        levels = _levels(constraints, s.x, s.R, s.v, s.w, a, alpha)
        return Trajectory(
            scene=scene, engine=engine, method=method, form=raw.form, t=s.t, x=s.x, R=s.R, v=s.v, w=s.w,
            a=a, alpha=alpha, lam=lam, energy=mechanics.energy(scene, s),
            momentum_vertical=mechanics.momentum_vertical(scene, s), orthogonality=mechanics.orthogonality(s.R),
            reactions=None if lam is None else constraints.reactions(s.x, s.R, lam), wall_time=raw.wall_time,
            steps=raw.steps, status=raw.status, stats={**raw.stats, "step": raw.step, **(raw.maxima or {})}, **levels)


def _with_first(values: np.ndarray | None, first: np.ndarray) -> np.ndarray | None:
    return None if values is None else np.concatenate([first, values[1:]])


def _levels(constraints: Constraints, x: np.ndarray, R: np.ndarray, v: np.ndarray, w: np.ndarray,
            a: np.ndarray | None, alpha: np.ndarray | None) -> dict[str, Any]:
    """Max-norms (T,) of the constraint levels by their names in `Trajectory`."""
    acceleration = None
    if a is not None and alpha is not None:
        acceleration = constraints.acceleration(x, R, v, w, a, alpha)
    rows = {"constraint_position": constraints.position(x, R),
            "constraint_velocity": constraints.velocity(x, R, v, w),
            "constraint_acceleration": acceleration}
    return {key: None if values is None else np.abs(values).max(axis=1, initial=0.0) for key, values in rows.items()}
