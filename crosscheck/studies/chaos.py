"""Chaotic scenes past their horizon: no trajectory can be right there, but what a body does on average can be.

A long run of every way is compared with many runs of the reference integration by the distributions over time of the
kinetic energy and of the bodies' heights: the statistic of Kolmogorov and Smirnov. Its law holds for independent
samples; those of one run follow from each other, some of them for minutes, so that a run counts as many as explain how
much the reference's runs differ among themselves (`Law`). All ways together raise a false alarm in `FALSE_ALARM` of
studies: each comparison has its share of that (Bonferroni).
"""

from __future__ import annotations

import dataclasses

import msgspec
import numpy as np

from crosscheck.scene.model import Scene
from crosscheck.scene.states import States
from crosscheck.studies.long_runs import LongRun, begun, long_run, long_ways, run_all
from crosscheck.studies.results_folder import StudyDocument, StudyMeta
from crosscheck.studies.study import Ask, Work

FALSE_ALARM = 0.01
"""Probability that a study without any difference finds one."""

FEWEST = 50
"""Effective samples without which the law of the statistic for many samples is not used."""

RUNS = 20
"""Of the reference, end to end. They tell how much one differs from the next, to a sixth of it."""

QUANTILES = np.arange(0.1, 1.0, 0.1)

SPACING = 0.25
"""s between samples: a good part of the time in which heights lose their correlation, so that little is missed."""


class Comparison(LongRun, frozen=True, kw_only=True):
    """One way on one scene, by its worst observable."""

    horizon: float  # s, until which a perturbation of 1e-15 stays below 1e-10
    comparisons: int = 1  # of the whole study, which share its false alarms
    verdict: str = ""  # "agrees", "differs" or "undecided"
    worst: str = ""  # observable of the smallest p
    distance: float | None = None  # of Kolmogorov and Smirnov: largest difference of the two distributions
    effective: float | None = None  # independent samples that the comparison is worth
    p: float | None = None  # probability of such a distance, or a larger one, by chance
    energy_error: float | None = None  # largest, over the largest kinetic energy
    momentum_error: float | None = None  # about the vertical, largest, over the largest size of its terms


class ChaosDocument(StudyDocument, frozen=True, kw_only=True):
    """chaos.json."""

    false_alarm: float  # probability that a study without any difference finds one
    comparisons: int
    runs: list[Comparison]


@dataclasses.dataclass(frozen=True)
class ChaosAsk(Ask):
    """Also the length of each run and its step. A run that would step longer than `time_limit` (s) is left out."""

    time_limit: float = 120.0
    duration: float = 2000.0  # s
    step: float = 2.0**-8  # s


def observables(scene: Scene, states: States) -> dict[str, np.ndarray]:
    """Series (T,) by name: total kinetic energy (J) and the height (m) of every body."""
    from crosscheck.scene.mechanics import kinetic_energy

    up = -scene.gravity / np.linalg.norm(scene.gravity)
    heights = {f"height of {body.name}": states.x[:, k] @ up for k, body in enumerate(scene.bodies)}
    return {"kinetic energy": kinetic_energy(scene, states), **heights}


def momentum_error(scene: Scene, states: States) -> float:
    """Largest change of the angular momentum about the vertical, over the sum of the sizes of its terms."""
    from crosscheck.scene.mechanics import momentum_vertical

    momentum = momentum_vertical(scene, states)
    orbital = scene.masses * np.linalg.norm(np.cross(states.x, states.v), axis=-1)
    spin = np.linalg.norm(np.einsum("njk,tnk->tnj", scene.inertias, states.w), axis=-1)
    return float(np.abs(momentum - momentum[0]).max() / (orbital + spin).sum(axis=1).max())


@dataclasses.dataclass(frozen=True)
class Law:
    """What an observable does over many runs of the reference, and how many independent samples one run is worth."""

    values: np.ndarray  # all of them, sorted
    effective: float

    @classmethod
    def of(cls, runs: np.ndarray) -> Law:
        """From series of equal length, (runs, T). A run counts by how the shares below a decile scatter from one to the
        next: so many independent samples would scatter as much. The decile that scatters most decides."""
        levels = np.quantile(runs, QUANTILES)
        scatter = np.array([(runs < level).mean(axis=1).var(ddof=1) for level in levels])
        scatter = np.maximum(scatter, QUANTILES * (1.0 - QUANTILES) / runs.shape[1])
        return cls(np.sort(runs, axis=None), float(np.min(QUANTILES * (1.0 - QUANTILES) / scatter)))

    def compare(self, series: np.ndarray) -> tuple[float, float, float]:
        """(distance, effective samples, p) of the series (T,) of a run as long as one of the reference's."""
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
    """What the observables of a scene do in `RUNS` runs of the reference, one beginning where the one before ends."""
    from crosscheck.references import taylor

    each = long.samples - 1
    all_runs = long.replace(duration=RUNS * long.duration, samples=RUNS * each + 1)
    integrator = taylor.Taylor(all_runs)
    series = observables(long, integrator.states(integrator.run()))
    return {name: Law.of(values[1:].reshape(RUNS, each)) for name, values in series.items()}


def compared(row: Comparison, long: Scene, truth: dict[str, Law], time_limit: float) -> Comparison:
    """The row with the figures of its run, which is compared with the reference."""
    from crosscheck.scene.mechanics import kinetic_energy

    traj = long_run(row, long, time_limit)
    states = States(traj.t, traj.x, traj.R, traj.v, traj.w)
    error = float(np.abs(traj.energy - traj.energy[0]).max() / kinetic_energy(long, states).max())
    found = msgspec.structs.replace(row, wall_time=traj.wall_time, energy_error=error,
                                    momentum_error=momentum_error(long, states))
    return judged(found, truth, observables(long, states))


class ChaosStudy:
    """Do methods and engines agree on energies and heights past the time where trajectories can?"""

    name = "chaos"

    def scenes(self) -> tuple[str, ...]:
        """Free flights of jointed bodies."""
        return "thrown_double", "thrown_triple"

    def measure(self, work: Work[ChaosAsk, Comparison]) -> None:
        """Scene after scene, kept after every run. Raises `TruthError` where the reference cannot integrate one."""
        from crosscheck.references import truth as reference

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

            def measured(start: Comparison, long: Scene = long, truth: dict[str, Law] = truth) -> Comparison:
                return compared(start, long, truth, ask.time_limit)

            done += run_all(work, rows, done, measured)

    def document(self, ask: ChaosAsk, meta: StudyMeta, results: list[Comparison]) -> ChaosDocument:
        """The comparisons, and how often chance alone makes a study differ."""
        return ChaosDocument(study=self.name, meta=meta, false_alarm=FALSE_ALARM, runs=results,
                             comparisons=max((each.comparisons for each in results), default=0))

    def rows(self, document: ChaosDocument) -> list[Comparison]:
        """A line a run."""
        return document.runs
