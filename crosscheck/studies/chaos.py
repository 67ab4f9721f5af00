"""Chaotic scenes past their horizon. No trajectory can be correct there, but the averages over time can.

A long run of every engine and method is compared with many runs of the reference integration by the distributions over
time of the kinetic energy and of the bodies' heights, with the Kolmogorov-Smirnov statistic. The law of this statistic
holds for independent samples, but the samples of one run are correlated, some for minutes. Therefore a run counts as
the number of independent samples that explains how much the reference's runs differ from each other (`Law`). The
probability of a false alarm in a whole study is `FALSE_ALARM`, of which each comparison gets its share (Bonferroni).
"""

from __future__ import annotations

import dataclasses
import functools
import operator

import msgspec
import numpy as np

from crosscheck.references import taylor
from crosscheck.references import truth as reference
from crosscheck.scene.mechanics import kinetic_energy, momentum_vertical
from crosscheck.scene.model import Scene
from crosscheck.scene.states import States
from crosscheck.studies.long_runs import LongRun, begun, long_run, long_ways, run_all
from crosscheck.studies.study import Ask, StudyDocument, StudyMeta, Work

FALSE_ALARM = 0.01
"""Probability that a study finds a difference although there is none."""

FEWEST = 50
"""Fewest effective samples for a verdict, because the law of the statistic is that for many samples."""

RUNS = 20
"""Number of reference runs. They give the deviation between runs with an error of about a sixth."""

QUANTILES = np.arange(0.1, 1.0, 0.1)

SPACING = 0.25
"""Time (s) between samples. It is a large part of the correlation time of heights; a smaller one gains little."""


class Comparison(LongRun, frozen=True, kw_only=True):
    """One engine and method on one scene, judged by the observable with the smallest p."""

    horizon: float  # s, the time up to which a perturbation of 1e-15 stays below 1e-10
    comparisons: int = 1  # of the whole study
    verdict: str = ""  # "agrees", "differs" or "undecided"
    worst: str = ""  # observable of the smallest p
    distance: float | None = None  # Kolmogorov-Smirnov: largest difference of the two distribution functions
    effective: float | None = None  # effective number of independent samples
    p: float | None = None  # probability that chance gives this distance or a larger one
    energy_error: float | None = None  # largest, over the largest kinetic energy
    momentum_error: float | None = None  # about the vertical, largest, over the largest size of its terms


class ChaosDocument(StudyDocument, frozen=True, kw_only=True):
    """chaos.json."""

    false_alarm: float  # see `FALSE_ALARM`
    comparisons: int
    runs: list[Comparison]


@dataclasses.dataclass(frozen=True)
class ChaosAsk(Ask):
    """Also the length and the step of each run. A run whose stepping would take over `time_limit` (s) is skipped."""

    time_limit: float = 120.0
    duration: float = 2000.0  # s
    step: float = 2.0**-8  # s


def observables(scene: Scene, states: States) -> dict[str, np.ndarray]:
    """Series (T,) by name: total kinetic energy (J) and the height (m) of every body."""
    up = -scene.gravity / np.linalg.norm(scene.gravity)
    heights = {f"height of {body.name}": states.x[:, k] @ up for k, body in enumerate(scene.bodies)}
    return {"kinetic energy": kinetic_energy(scene, states), **heights}


def momentum_error(scene: Scene, states: States) -> float:
    """Largest change of the angular momentum about the vertical, over the sum of the sizes of its terms."""
    momentum = momentum_vertical(scene, states)
    orbital = scene.masses * np.linalg.norm(np.cross(states.x, states.v), axis=-1)
    spin = np.linalg.norm(np.einsum("njk,tnk->tnj", scene.inertias, states.w), axis=-1)
    return float(np.abs(momentum - momentum[0]).max() / (orbital + spin).sum(axis=1).max())


@dataclasses.dataclass(frozen=True)
class Law:
    """The distribution of an observable over many reference runs."""

    values: np.ndarray  # of all runs, sorted
    effective: float  # number of independent samples that one run counts as

    @classmethod
    def of(cls, runs: np.ndarray) -> Law:
        """From series of equal length, (runs, T).

        The share of a run's samples below a decile differs from run to run. `effective` is the number of independent
        samples whose shares would differ as much, for the decile with the largest differences.
        """
        levels = np.quantile(runs, QUANTILES)
        scatter = np.array([(runs < level).mean(axis=1).var(ddof=1) for level in levels])
        scatter = np.maximum(scatter, QUANTILES * (1.0 - QUANTILES) / runs.shape[1])
        return cls(np.sort(runs, axis=None), float(np.min(QUANTILES * (1.0 - QUANTILES) / scatter)))

    def compare(self, series: np.ndarray) -> tuple[float, float, float]:
        """(distance, effective samples, p) of a series (T,) that is as long as one reference run."""
        from scipy.special import kolmogorov
        from scipy.stats import ks_2samp

        distance = float(ks_2samp(series, self.values, method="asymp").statistic)
        count = self.effective / (1.0 + len(series) / len(self.values))
        return distance, count, float(kolmogorov(np.sqrt(count) * distance))


def judged(row: Comparison, truth: dict[str, Law], shown: dict[str, np.ndarray]) -> Comparison:
    """The row with its worst observable and its verdict."""
    results = {name: law.compare(shown[name]) for name, law in truth.items()}
    worst = min(results, key=lambda name: results[name][2])
    distance, effective, p = results[worst]
    if p < FALSE_ALARM / row.comparisons:
        verdict = "differs"
    else:
        verdict = "agrees" if min(count for _, count, _ in results.values()) >= FEWEST else "undecided"
    return msgspec.structs.replace(row, worst=worst, distance=distance, effective=effective, p=p, verdict=verdict)


def long_scene(scene: Scene, duration: float) -> Scene:
    """The scene over a duration (s), with samples `SPACING` apart."""
    intervals = max(1, round(duration / SPACING))
    return scene.replace(duration=intervals * SPACING, samples=intervals + 1)


def laws(long: Scene) -> dict[str, Law]:
    """The laws of a scene's observables from `RUNS` reference runs. Each run begins where the one before ends."""
    each = long.samples - 1
    all_runs = long.replace(duration=RUNS * long.duration, samples=RUNS * each + 1)
    integrator = taylor.Taylor(all_runs)
    series = observables(long, integrator.states(integrator.run()))
    return {name: Law.of(values[1:].reshape(RUNS, each)) for name, values in series.items()}


def compared(row: Comparison, long: Scene, truth: dict[str, Law], time_limit: float) -> Comparison:
    """Make the run of a row, compare it with the reference, and return the row with the results."""
    traj = long_run(row, long, time_limit)
    states = States(traj.t, traj.x, traj.R, traj.v, traj.w)
    error = float(np.abs(traj.energy - traj.energy[0]).max() / kinetic_energy(long, states).max())
    return judged(msgspec.structs.replace(row, wall_time=traj.wall_time, energy_error=error,
                                          momentum_error=momentum_error(long, states)),
                  truth, observables(long, states))


class ChaosStudy:
    """Do engines and methods give the same distributions of energies and heights where trajectories cannot agree?"""

    name = "chaos"
    row_type = Comparison

    scenes = ("thrown_double", "thrown_triple")  # free flights of jointed bodies
    rows = staticmethod(operator.attrgetter("runs"))

    def measure(self, work: Work[ChaosAsk, Comparison]) -> None:
        """Measure scene by scene. Raises `TruthError` if the reference cannot integrate a scene."""
        ask = work.ask
        cells = [(scene, long_ways(scene, work.engines, ask)) for scene in work.scenes]
        comparisons = sum(len(selected) * (1 + scene.n) for scene, selected in cells)
        done: list[Comparison] = []
        for scene, selected in cells:
            work.progress(0, len(selected), f"{scene.name}: reference")
            long = long_scene(scene, ask.duration)
            truth, horizon = laws(long), reference(scene).horizon
            rows = [begun(Comparison, long, way, ask.step, horizon=horizon, comparisons=comparisons)
                    for way in selected]
            run_all(work, long, rows, done, functools.partial(
                compared, long=long, truth=truth, time_limit=ask.time_limit))

    def document(self, ask: ChaosAsk, meta: StudyMeta, results: list[Comparison]) -> ChaosDocument:
        """The document with all comparisons."""
        return ChaosDocument(study=self.name, meta=meta, false_alarm=FALSE_ALARM, runs=results,
                             comparisons=max((each.comparisons for each in results), default=0))
