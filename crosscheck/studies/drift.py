"""Drift over long runs: energy, vertical momentum, constraint levels and orthogonality against time.

A symplectic method keeps its energy error in a band; an explicit Runge-Kutta method loses energy at a steady rate.
The words of the verdict are those of the project's definitions: an error is "without trend" where its slope times the
run stays below 5 % of its band, and growth is that of round-off where it is at most n^0.6 in the number of steps.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from crosscheck.scene.model import Scene
from crosscheck.studies.study import Ask, Progress
from crosscheck.verification.ladder import Way, ways

METHODS = ("rattle2", "rattle4", "DAE1L_LSE", "DAE1H_LSE", "RK4", "RK44", "RKMK4")
"""By default the symmetric methods, the two Euler methods that hold all levels, and explicit Runge-Kutta of order 4."""

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

PROBE = 2000
"""Steps of the short run that tells whether the long one fits into the limit."""


@dataclasses.dataclass
class Drift:
    """One long run. The energy error is relative to the largest kinetic energy, the momentum's to its largest size."""

    scene: str
    engine: str
    method: str
    form: str | None
    label: str
    step: float  # s
    steps: int
    duration: float  # s
    status: str = "success"  # or "error", "skipped"
    reason: str = ""
    wall_time: float | None = None  # s
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


def measure(scene: Scene, selected: Sequence[Way], step: float, steps: int, time_limit: float, progress: Progress,
            keep: Callable[[list[Drift]], None]) -> list[Drift]:
    """The long runs, one after the other; `keep` is called after each with all so far.

    Parameters
    ----------
    step : s
    steps : of each run; the samples lie on steps, so that it may be rounded up
    time_limit : s of one run's stepping; one that would take longer is left out, with a row that says so
    """
    intervals = min(SAMPLES - 1, steps)
    per = -(-steps // intervals)
    steps = per * intervals
    long = scene.replace(duration=steps * step, samples=intervals + 1)
    done: list[Drift] = []
    for index, way in enumerate(selected):
        progress(index, len(selected), f"{scene.name}: {way.label}")
        drift = Drift(scene.name, way.engine, way.method, way.form, way.label, step, steps, long.duration)
        done.append(drift)
        try:
            _run_into(drift, way, long, time_limit)
        except Exception as error:  # whatever an engine raises is a row of the study
            drift.status, drift.reason = "error", " ".join(str(error).split()) or type(error).__name__
        keep(done)
    return done


def too_long(scene: Scene, way: Way, step: float, steps: int, time_limit: float) -> str:
    """Why a run would take too long by what its first steps take, or nothing. Times in s, of stepping."""
    from crosscheck.running.run import run

    if steps <= 2 * PROBE:
        return ""
    short = scene.replace(duration=PROBE * step, samples=2)
    probe = run(short, way.engine, way.method, step=step, form=way.form, monitor=False,
                coordinate_map=way.coordinate_map)
    expected = probe.wall_time / PROBE * steps
    return f"it would take about {expected:.0f} s, the limit is {time_limit:g} s" if expected > time_limit else ""


def _run_into(drift: Drift, way: Way, long: Scene, time_limit: float) -> None:
    from crosscheck.running.run import run

    drift.reason = too_long(long, way, drift.step, drift.steps, time_limit)
    if drift.reason:
        drift.status = "skipped"
        return
    traj = run(long, drift.engine, drift.method, step=drift.step, form=drift.form, monitor=False,
               coordinate_map=way.coordinate_map)
    drift.wall_time = traj.wall_time
    fill_in(drift, traj)


def fill_in(drift: Drift, traj: Any) -> None:
    """The figures of a finished run, from its samples."""
    from crosscheck.scene.mechanics import kinetic_energy
    from crosscheck.scene.states import States

    states = States(traj.t, traj.x, traj.R, traj.v, traj.w)
    kinetic = float(kinetic_energy(traj.scene, states).max())
    energy = (traj.energy - traj.energy[0]) / (kinetic or 1.0)
    (drift.energy_band, drift.energy_slope, drift.energy_trend, drift.energy_growth,
     drift.energy_verdict) = judge(traj.t, energy, drift.steps)
    largest = float(np.abs(traj.momentum_vertical).max())
    momentum = (traj.momentum_vertical - traj.momentum_vertical[0]) / (largest or 1.0)
    drift.momentum_band, _, drift.momentum_trend, drift.momentum_growth, drift.momentum_verdict = judge(
        traj.t, momentum, drift.steps)
    drift.constraint_position = float(traj.constraint_position.max())
    drift.constraint_velocity = float(traj.constraint_velocity.max())
    if traj.constraint_acceleration is not None:
        drift.constraint_acceleration = float(traj.constraint_acceleration.max())
    drift.orthogonality = float(traj.orthogonality.max())


@dataclasses.dataclass(frozen=True)
class DriftAsk(Ask):
    """Also the step and how many of them each run takes."""

    time_limit: float = 120.0  # s of one run
    step: float = 2.0**-10  # s; an engine that adds up its steps misses sample times by one step where it rounds
    steps: int = 1_000_000


def long_ways(scene: Scene, engines: Sequence[str], ask: Ask) -> list[Way]:
    """The ways of long runs: each method with a fixed step in the first form that can model the scene."""
    found: dict[tuple[str, str], Way] = {}
    for way in ways(scene, engines, ask.methods or METHODS, asked_map=ask.coordinate_map)[0]:
        if not way.adaptive:
            found.setdefault((way.engine, way.method), way)
    return list(found.values())


class DriftStudy:
    """What energy, momentum, constraints and attitudes do over very many steps."""

    name = "drift"

    def scenes(self) -> tuple[str, ...]:
        """One body, and two."""
        return "single_pendulum", "double_pendulum"

    def cells(self, ask: DriftAsk, engines: tuple[str, ...], scenes: Sequence[Scene]) -> list[tuple[Scene, list[Way]]]:
        """A scene and its ways each."""
        return [(scene, long_ways(scene, engines, ask)) for scene in scenes]

    def measure(self, ask: DriftAsk, cells: list[tuple[Scene, list[Way]]], out: Path, progress: Progress,
                keep: Callable[[list[Drift]], None]) -> None:
        """Scene after scene, kept after every run."""
        before: list[Drift] = []
        for scene, selected in cells:
            earlier = tuple(before)

            def kept(drifts: list[Drift], earlier: tuple[Drift, ...] = earlier) -> None:
                keep([*earlier, *drifts])

            before += measure(scene, selected, ask.step, ask.steps, ask.time_limit, progress, kept)

    def document(self, ask: DriftAsk, results: list[Drift]) -> dict[str, Any]:
        """The runs."""
        return {"runs": [dataclasses.asdict(drift) for drift in results]}

    def table(self, document: dict[str, Any]) -> list[dict[str, Any]]:
        """A line a run."""
        return list(document["runs"])
