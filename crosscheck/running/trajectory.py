"""Trajectories: the states of a run, and what follows from them by the same formulas for all engines."""

from __future__ import annotations

import dataclasses
import functools
from typing import TYPE_CHECKING, cast

import numpy as np

from crosscheck.adapters.base import RawRun, Stats
from crosscheck.running import export
from crosscheck.scene import mechanics
from crosscheck.scene.constraints import Constraints
from crosscheck.scene.coordinates import JointHistory, histories
from crosscheck.scene.model import Scene
from crosscheck.scene.monitor import MAXIMA, level_norms

if TYPE_CHECKING:
    import os

    import pandas as pd
    import xarray as xr
    from matplotlib.figure import Figure


@dataclasses.dataclass(frozen=True)
class Trajectory:
    """A run at its output times: T samples of n bodies, in SI units, with the frames of `crosscheck.scene.states`.

    `a`, `alpha` and `constraint_acceleration` are None if the engine gives no accelerations, `lam` and `reactions` if
    it gives no multipliers. At t = 0 they are computed from the initial state by the index-1 equations.
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
    kinetic_energy: np.ndarray  # (T,) J, a part of `energy`
    momentum_vertical: np.ndarray  # (T,) kg m^2/s, about the upward vertical through the origin
    orthogonality: np.ndarray  # (T,) max-norm of R^T R - I
    constraint_position: np.ndarray  # (T,) max-norm of Phi
    constraint_velocity: np.ndarray  # (T,) max-norm of G u
    constraint_acceleration: np.ndarray | None  # (T,) max-norm of G du/dt + gamma
    reactions: dict[str, tuple[np.ndarray, np.ndarray]] | None  # force, torque (T, 3) on the child at its anchor, world
    wall_time: float  # s, stepping only
    steps: int
    status: str
    stats: Stats  # counters of the run, "step" (s), and the maxima over every step under the keys of MAXIMA

    @functools.cached_property
    def work(self) -> np.ndarray:
        """Work of loads, dampers and moving rest angles since the start, (T,) J; see `mechanics.work`."""
        return mechanics.work(self.scene, self)

    def __repr__(self) -> str:
        until = f"{self.t[-1]:.6g} s" if len(self.t) else "its start"
        return (f"Trajectory({self.scene.name}: {self.engine} {self.method}{f', {self.form}' if self.form else ''}, "
                f"{self.status}, {len(self.t)} samples to {until}, {self.steps} steps)")

    def _repr_html_(self) -> str:
        return export.table(self)

    def to_frame(self) -> pd.DataFrame:
        """As a `pandas.DataFrame` with one row per output time (needs the extra `data`)."""
        return export.frame(self)

    def to_xarray(self) -> xr.Dataset:
        """As an `xarray.Dataset` over t, body and axis, with units (needs the extra `data`)."""
        return export.dataset(self)

    def plot(self) -> Figure:
        """A matplotlib figure of heights, angular speeds, energy and constraint levels (needs the extra `report`)."""
        return export.figure(self)

    def to_rerun(self, path: str | os.PathLike[str]) -> None:
        """Write bodies, paths and energies for the rerun viewer (.rrd, single precision; needs the extra `rerun`)."""
        export.record(self, path)

    @functools.cached_property
    def joints(self) -> dict[str, JointHistory]:
        """`.position` and `.velocity` over time, by name, of the joints that have coordinates."""
        return histories(self.scene, self)

    @property
    def maxima(self) -> dict[str, float]:
        """The maxima over every step under the keys of `crosscheck.scene.monitor.MAXIMA`; empty if monitor=False."""
        return {key: value for key, value in self.stats.items() if key in MAXIMA and isinstance(value, float | int)}

    @property
    def potential_energy(self) -> np.ndarray:
        """(T,) J. It is zero if all mass centres are at the origin and all springs at rest."""
        potential: np.ndarray = self.energy - self.kinetic_energy
        return potential


def derive(scene: Scene, engine: str, method: str, raw: RawRun) -> Trajectory:
    """The trajectory of an engine's raw run, with energies, constraint levels and reactions computed from its states.

    If the engine gives accelerations or multipliers, their first values are replaced by those of the index-1 equations.
    """
    s = raw.states
    a, alpha, lam = s.a, s.alpha, s.lam
    constraints = Constraints(scene)
    with np.errstate(over="ignore", invalid="ignore"):
        if len(s.t) and (a is not None or lam is not None):
            start = mechanics.index1(scene, s.x[:1], s.R[:1], s.v[:1], s.w[:1], t=s.t[:1])
            a, alpha, lam = (None if values is None else np.concatenate([first, values[1:]])
                             for values, first in zip((a, alpha, lam), start, strict=True))
        levels = level_norms(constraints, s.x, s.R, s.v, s.w, a, alpha, s.t,
                             constraints.leaders_at(s.x, s.R, s.v, s.w, s.t))
        return Trajectory(
            scene=scene, engine=engine, method=method, form=raw.form, t=s.t, x=s.x, R=s.R, v=s.v, w=s.w,
            a=a, alpha=alpha, lam=lam, energy=mechanics.energy(scene, s),
            kinetic_energy=mechanics.kinetic_energy(scene, s),
            momentum_vertical=mechanics.momentum_vertical(scene, s), orthogonality=mechanics.orthogonality(s.R),
            reactions=None if lam is None else constraints.reactions(s.x, s.R, lam), wall_time=raw.wall_time,
            steps=raw.steps, status=raw.status,
            stats=cast(Stats, {**raw.stats, "step": raw.step, **(raw.maxima or {})}), **levels)
