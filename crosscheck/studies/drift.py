"""Drift over long runs: energy, vertical momentum, constraint levels and orthogonality against time.

A symplectic method keeps its energy error in a band, and an explicit Runge-Kutta method loses energy at a steady rate.
An error is "without trend" if its fitted slope times the duration is below 5 % of its band. Growth with the number of
steps n is "round-off" if it is at most n^0.6.
"""

from __future__ import annotations

import dataclasses
import operator
from collections.abc import Sequence
from typing import NamedTuple

import msgspec
import numpy as np

from crosscheck.adapters import built_in
from crosscheck.document import Way, extended
from crosscheck.errors import ArgumentError, CrosscheckError, Unsupported, said
from crosscheck.running.attempt import Ran, attempt
from crosscheck.running.trajectory import Trajectory
from crosscheck.scene.mechanics import kinetic_energy
from crosscheck.scene.model import Scene
from crosscheck.scene.states import States
from crosscheck.studies.study import Ask, StudyDocument, StudyMeta, Work
from crosscheck.verification.ladder import GradedWay, ways

METHODS = ("rattle2", "rattle4", "DAE1L_LSE", "DAE1H_LSE", "RK4", "RK44", "RKMK4")
"""The default methods: symmetric ones, the two Euler methods that satisfy all levels, and Runge-Kutta of order 4."""

PROBE = 2000
"""Steps of a short run, from which the time of the long run is estimated."""

TREND = 0.05
"""Largest share of the band that slope times duration may have in an error without trend."""

ROUND_OFF = 0.6
"""Largest growth exponent of accumulated rounding: 0.5 for a random walk, plus noise."""

EPS = float(np.finfo(float).eps)
WALK = 50.0
"""Energy errors below WALK * EPS * sqrt(number of steps) may be a random walk of roundings."""

BLOCKS, ABOVE = 500, 1.5
"""Number of blocks of a run whose mean errors are compared. A change counts if it exceeds the change between neighbour
blocks, which comes from oscillations, by the factor ABOVE. The exponents of true random walks are then 0.50 +- 0.07."""

LEVELS = ("constraint_position", "constraint_velocity", "constraint_acceleration", "orthogonality")

SAMPLES = 10_001
"""Number of output times. It makes the slope that is fitted to a band without trend smaller than 5 % of the band."""


class Drift(Way, frozen=True, kw_only=True):
    """One long run. Energy errors are over the largest kinetic energy, momentum errors over the largest momentum."""

    scene: str
    label: str
    duration: float  # s
    status: str = "success"  # or "skipped", "unsupported", "failed"
    reason: str = ""
    wall_time: float | None = None  # s
    steps: int
    energy_band: float | None = None  # largest minus smallest error
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
    """The exponent p in (rms of the change over n steps) ~ n^p, for n up to a quarter of the run; 0 without growth.

    It is 1/2 for a random walk and 1 for a line. One run is enough for it; the growth of the largest value would need
    many runs. Means over blocks are compared, because oscillations would hide slow growth.
    """
    blocks = np.array([block.mean() for block in np.array_split(values, min(BLOCKS, len(values)))])
    lags = np.unique(np.geomspace(1, max(1, len(blocks) // 4), 24).astype(int))
    sizes = np.array([np.sqrt(np.mean((blocks[lag:] - blocks[:-lag]) ** 2)) for lag in lags])
    grown = sizes > ABOVE * sizes[0]
    if np.count_nonzero(grown) < 3 or sizes[0] == 0:
        return 0.0
    return float(np.polyfit(np.log(lags[grown]), np.log(sizes[grown]), 1)[0])


class Trend(NamedTuple):
    """Of an error over time."""

    band: float
    slope: float  # 1/s
    trend: float
    growth: float
    verdict: str


def judge(t: np.ndarray, errors: np.ndarray, steps: int) -> Trend:
    """What a relative error (T,) does over the times t (T,) s."""
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
    return Trend(band, slope, trend, exponent, verdict)


class TooLong(ArgumentError):
    """A run would take longer than the limit."""


def long_ways(scene: Scene, engines: Sequence[str], ask: Ask) -> list[GradedWay]:
    """The ways for long runs: every method with a fixed step, in the first form that can model the scene.

    By default those of METHODS, and all methods of an engine of the user.
    """
    first: dict[tuple[str, str], GradedWay] = {}
    for way in ways(scene, engines, ask.methods, options=ask.options)[0]:
        if not way.adaptive and (ask.methods or way.method in METHODS or way.engine not in built_in.ENTRIES):
            first.setdefault((way.engine, way.method), way)
    if not first:
        raise ArgumentError(f"{scene.name!r}: {', '.join(engines)} has no method of fixed step that models it; "
                            "--method chooses others")
    return list(first.values())


def long_run(row: Drift, scene: Scene, time_limit: float) -> Trajectory:
    """The trajectory of a row. Raises `TooLong` if a short run predicts more than `time_limit` (s) of stepping."""
    def over(scene: Scene) -> Trajectory:
        outcome = attempt(scene, row, monitor=False)
        if isinstance(outcome, Ran):
            return outcome.trajectory
        raise outcome.error

    step = row.step or row.duration
    steps = round(row.duration / step)
    if steps > 2 * PROBE:
        expected = over(scene.replace(duration=PROBE * step, samples=2)).wall_time / PROBE * steps
        if expected > time_limit:
            raise TooLong(f"it would take about {expected:.0f} s, the limit is {time_limit:g} s")
    return over(scene)


def measured(drift: Drift, long: Scene, time_limit: float) -> Drift:
    """Make the run of a row and return the row with the values from its samples."""
    traj = long_run(drift, long, time_limit)
    states = States(traj.t, traj.x, traj.R, traj.v, traj.w)
    kinetic = float(kinetic_energy(traj.scene, states).max())
    largest = float(np.abs(traj.momentum_vertical).max())
    found = {"wall_time": traj.wall_time}
    for name, values, size in (("energy", traj.energy, kinetic), ("momentum", traj.momentum_vertical, largest)):
        trend = judge(traj.t, (values - values[0]) / (size or 1.0), drift.steps)
        found |= {f"{name}_{key}": value for key, value in trend._asdict().items()}
    del found["momentum_slope"]
    found |= {name: float(values.max()) for name in LEVELS if (values := getattr(traj, name)) is not None}
    return msgspec.structs.replace(drift, **found)


@dataclasses.dataclass(frozen=True)
class DriftAsk(Ask):
    """Also the step and the number of steps of each run. The number is rounded up so that samples lie on steps."""

    time_limit: float = 120.0  # s of one run
    step: float = 2.0**-10  # s; a power of 2, so that engines that add up their steps have no rounding in the time
    steps: int = 1_000_000


class DriftStudy:
    """How do energy, momentum, constraints and attitudes behave over very many steps?"""

    name = "drift"
    row_type = Drift

    scenes = ("single_pendulum", "double_pendulum")  # one body, and two
    rows = staticmethod(operator.attrgetter("runs"))

    def measure(self, work: Work[DriftAsk, Drift]) -> None:
        """Measure scene by scene."""
        ask = work.ask
        intervals = min(SAMPLES - 1, ask.steps)
        steps = -(-ask.steps // intervals) * intervals
        done: list[Drift] = []
        for scene in work.scenes:
            long = scene.replace(duration=steps * ask.step, samples=intervals + 1)
            rows = [extended(Drift, way, scene=scene.name, label=way.label, duration=long.duration, step=ask.step,
                             steps=steps) for way in long_ways(scene, work.engines, ask)]
            for index, start in enumerate(rows):
                work.progress(index, len(rows), f"{scene.name}: {start.label}")
                done.append(_finished(work, long, start))
                work.keep(done)

    def document(self, ask: DriftAsk, meta: StudyMeta, results: list[Drift]) -> DriftDocument:
        """The document with all runs."""
        return DriftDocument(study=self.name, meta=meta, runs=results)


def _finished(work: Work[DriftAsk, Drift], long: Scene, start: Drift) -> Drift:
    """The row of a run with its results. One without results has the reason, and is tried again after a kill."""
    try:
        return work.once(long, start.engine, start, lambda: measured(start, long, work.ask.time_limit))
    except TooLong as limit:
        return msgspec.structs.replace(start, status="skipped", reason=str(limit))
    except CrosscheckError as error:
        status = "unsupported" if isinstance(error, Unsupported) else "failed"
        return msgspec.structs.replace(start, status=status, reason=said(error))
