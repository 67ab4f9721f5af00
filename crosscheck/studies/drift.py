"""Drift over long runs: energy, vertical momentum, constraint levels and orthogonality against time.

A symplectic method keeps its energy error in a band; an explicit Runge-Kutta method loses energy at a steady rate.
The words of the verdict are those of the project's definitions: an error is "without trend" where its slope times the
run stays below 5 % of its band, and growth is that of round-off where it is at most n^0.6 in the number of steps.
"""

from __future__ import annotations

import dataclasses
from typing import Any

import msgspec
import numpy as np

from crosscheck.scene.model import Scene
from crosscheck.studies.long_runs import LongRun, begun, long_run, long_ways, run_all
from crosscheck.studies.results_folder import StudyDocument, StudyMeta
from crosscheck.studies.study import Ask, Work

TREND = 0.05
"""Share of the band that slope times duration may have in an error without trend."""

ROUND_OFF = 0.6
"""Largest exponent in the number of steps by which accumulated rounding grows: 0.5 for a random walk, and noise."""

EPS = float(np.finfo(float).eps)
WALK = 50.0
"""Energy errors below so many EPS times the root of the number of steps may be a random walk of roundings."""

BLOCKS, ABOVE = 500, 1.5
"""Blocks of a run whose mean errors show how it grows, and by how much a change has to exceed that from one block to
the next, which is left from oscillations. The exponents of true random walks then scatter by 0.07 about 0.50."""

SAMPLES = 10_001
"""Output times: with some hundred independent ones a slope fitted to a band without trend is below 5 % of it."""


class Drift(LongRun, frozen=True, kw_only=True):
    """One long run. The energy error is relative to the largest kinetic energy, the momentum's to its largest size."""

    steps: int
    energy_band: float | None = None  # largest less smallest error
    energy_slope: float | None = None  # 1/s, by least squares
    energy_trend: float | None = None  # |slope| times duration, over the band
    energy_growth: float | None = None  # exponent of `growth`
    energy_verdict: str = ""
    momentum_band: float | None = None
    momentum_trend: float | None = None
    momentum_growth: float | None = None
    momentum_verdict: str = ""
    constraint_position: float | None = None  # m, the largest
    constraint_velocity: float | None = None  # m/s
    constraint_acceleration: float | None = None  # m/s^2
    orthogonality: float | None = None


class DriftDocument(StudyDocument, frozen=True, kw_only=True):
    """drift.json."""

    runs: list[Drift]


def growth(values: np.ndarray) -> float:
    """Exponent p of the rms of the change over n steps ~ n^p, n up to a quarter of the run; 0 where nothing grows.

    1/2 for a random walk, 1 for a line: one run shows it, where the growth of the largest value would need many. Means
    over blocks are compared, because oscillations would hide what grows below them.
    """
    blocks = np.array([block.mean() for block in np.array_split(values, min(BLOCKS, len(values)))])
    lags = np.unique(np.geomspace(1, max(1, len(blocks) // 4), 24).astype(int))
    sizes = np.array([np.sqrt(np.mean((blocks[lag:] - blocks[:-lag]) ** 2)) for lag in lags])
    grown = sizes > ABOVE * sizes[0]
    if np.count_nonzero(grown) < 3 or sizes[0] == 0:
        return 0.0
    return float(np.polyfit(np.log(lags[grown]), np.log(sizes[grown]), 1)[0])


def judge(t: np.ndarray, errors: np.ndarray, steps: int) -> tuple[float, float, float, float, str]:
    """(band, slope in 1/s, trend, growth, verdict) of a relative error (T,) at the times t (T,) s."""
    band = float(errors.max() - errors.min())
    slope = float(np.polyfit(t, errors, 1)[0])
    trend = abs(slope) * float(t[-1] - t[0]) / band if band > 0 else 0.0
    exponent = growth(errors)
    if trend <= TREND:
        verdict = "bounded, without trend"
    elif band <= WALK * EPS * np.sqrt(steps) and exponent <= ROUND_OFF:
        verdict = "round-off"
    else:
        verdict = "drifts"
    return band, slope, trend, exponent, verdict


def with_figures(drift: Drift, traj: Any) -> Drift:
    """The row of a finished run with its figures, from its samples."""
    from crosscheck.scene.mechanics import kinetic_energy
    from crosscheck.scene.states import States

    states = States(traj.t, traj.x, traj.R, traj.v, traj.w)
    kinetic = float(kinetic_energy(traj.scene, states).max())
    energy = judge(traj.t, (traj.energy - traj.energy[0]) / (kinetic or 1.0), drift.steps)
    largest = float(np.abs(traj.momentum_vertical).max())
    momentum = judge(traj.t, (traj.momentum_vertical - traj.momentum_vertical[0]) / (largest or 1.0), drift.steps)
    acceleration = traj.constraint_acceleration
    return msgspec.structs.replace(
        drift, wall_time=traj.wall_time, energy_band=energy[0], energy_slope=energy[1], energy_trend=energy[2],
        energy_growth=energy[3], energy_verdict=energy[4], momentum_band=momentum[0], momentum_trend=momentum[2],
        momentum_growth=momentum[3], momentum_verdict=momentum[4],
        constraint_position=float(traj.constraint_position.max()),
        constraint_velocity=float(traj.constraint_velocity.max()),
        constraint_acceleration=None if acceleration is None else float(acceleration.max()),
        orthogonality=float(traj.orthogonality.max()))


@dataclasses.dataclass(frozen=True)
class DriftAsk(Ask):
    """Also the step and the number of steps of each run, which is rounded up so that samples lie on steps."""

    time_limit: float = 120.0  # s of one run
    step: float = 2.0**-10  # s; an engine that adds up its steps misses sample times by one step where it rounds
    steps: int = 1_000_000


class DriftStudy:
    """What energy, momentum, constraints and attitudes do over very many steps."""

    name = "drift"

    def scenes(self) -> tuple[str, ...]:
        """One body, and two."""
        return "single_pendulum", "double_pendulum"

    def measure(self, work: Work[DriftAsk, Drift]) -> None:
        """Scene after scene, kept after every run."""
        ask = work.ask
        intervals = min(SAMPLES - 1, ask.steps)
        steps = -(-ask.steps // intervals) * intervals
        done: list[Drift] = []
        for scene in work.scenes:
            long = scene.replace(duration=steps * ask.step, samples=intervals + 1)
            rows = [begun(Drift, long, way, ask.step, steps=steps)
                    for way in long_ways(scene, work.engines, ask)]

            def measured(drift: Drift, long: Scene = long) -> Drift:
                return with_figures(drift, long_run(drift, long, ask.time_limit))

            done += run_all(work, rows, done, measured)

    def document(self, ask: DriftAsk, meta: StudyMeta, results: list[Drift]) -> DriftDocument:
        """The runs."""
        return DriftDocument(study=self.name, meta=meta, runs=results)

    def rows(self, document: DriftDocument) -> list[Drift]:
        """A line a run."""
        return document.runs
