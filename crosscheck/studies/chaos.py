"""Chaotic scenes past their horizon: no trajectory can be right there, but what a body does on average can be.

A long run of every way is compared with the reference integration by the distributions over time of the kinetic energy
and of the bodies' heights: the two-sample test of Kolmogorov and Smirnov. Its p-value holds for independent samples;
those of one run follow from each other, so that each series counts as many as its correlation leaves (`effective`). All
ways together raise a false alarm in `FALSE_ALARM` of studies: each comparison has its share of that (Bonferroni).
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from crosscheck.scene import Scene
from crosscheck.states import States
from crosscheck.studies.work_precision import Progress, Way

FALSE_ALARM = 0.01
"""Probability that a study without any difference finds one."""

FEWEST = 50
"""Effective samples without which the law of the statistic for many samples is not used."""

WINDOW = 5.0
"""Correlations are summed up to so many times their sum (A. D. Sokal, doi:10.1007/978-1-4899-0319-8_6, section 3):
beyond it they are noise."""

QUANTILES = np.arange(0.1, 1.0, 0.1)

SPACING = 0.25
"""s between samples: a good part of the time in which heights lose their correlation, so that little is missed."""


@dataclasses.dataclass
class Comparison:
    """One way on one scene, by its worst observable."""

    scene: str
    engine: str
    method: str
    label: str
    step: float  # s
    duration: float  # s
    horizon: float  # s, until which a perturbation of 1e-15 stays below 1e-10
    status: str = "success"  # or "error", "skipped"
    reason: str = ""
    verdict: str = ""  # "agrees", "differs" or "undecided"
    worst: str = ""  # observable of the smallest p
    distance: float | None = None  # of Kolmogorov and Smirnov: largest difference of the two distributions
    effective: float | None = None  # samples that count, of both series together: 1 / (1 / n1 + 1 / n2)
    p: float | None = None  # probability of such a distance, or a larger one, by chance
    energy_error: float | None = None  # largest, over the largest kinetic energy
    momentum_error: float | None = None  # about the vertical, over its size or the largest of a body's
    wall_time: float | None = None  # s


def observables(scene: Scene, states: States) -> dict[str, np.ndarray]:
    """Series (T,) by name: total kinetic energy (J) and the height (m) of every body."""
    from crosscheck.mechanics import kinetic_energy

    up = -scene.gravity / np.linalg.norm(scene.gravity)
    heights = {f"height of {body.name}": states.x[:, k] @ up for k, body in enumerate(scene.bodies)}
    return {"kinetic energy": kinetic_energy(scene, states), **heights}


def inefficiency(series: np.ndarray) -> float:
    """How many samples (T,) count as one independent one for a mean: the sum of the correlations over all lags."""
    moved = series - series.mean()
    transform = np.fft.rfft(moved, 2 * len(moved))
    covariance = np.fft.irfft(transform * transform.conj())[:len(moved)]
    if covariance[0] <= 0:
        return 1.0
    sums = 2.0 * np.cumsum(covariance / covariance[0]) - 1.0
    enough = np.arange(len(sums)) >= WINDOW * sums
    return max(1.0, float(sums[np.argmax(enough)] if enough.any() else sums.max()))


def effective(series: np.ndarray) -> float:
    """How many independent samples (T,) is worth, for its distribution: the fewest for any of its deciles."""
    return len(series) / max(inefficiency((series < level).astype(float)) for level in np.quantile(series, QUANTILES))


def compare(one: np.ndarray, other: np.ndarray) -> tuple[float, float, float]:
    """(distance, effective samples, p) of two series (T,), (S,) that may each be correlated."""
    from scipy.special import kolmogorov
    from scipy.stats import ks_2samp

    distance = float(ks_2samp(one, other, method="asymp").statistic)
    count = 1.0 / (1.0 / effective(one) + 1.0 / effective(other))
    return distance, count, float(kolmogorov(np.sqrt(count) * distance))


def judge(found: Comparison, truth: dict[str, np.ndarray], shown: dict[str, np.ndarray], comparisons: int) -> None:
    """Fill in the worst observable; `comparisons` is how many the study makes in all."""
    results = {name: compare(truth[name], shown[name]) for name in truth}
    found.worst = min(results, key=lambda name: results[name][2])
    found.distance, found.effective, found.p = results[found.worst]
    if found.p < FALSE_ALARM / comparisons:
        found.verdict = "differs"
    else:
        found.verdict = "agrees" if min(count for _, count, _ in results.values()) >= FEWEST else "undecided"


def long_scene(scene: Scene, duration: float) -> Scene:
    """The scene over a duration (s), with samples `SPACING` apart."""
    intervals = max(1, round(duration / SPACING))
    return scene.replace(duration=intervals * SPACING, samples=intervals + 1)


def measure(scene: Scene, selected: Sequence[Way], duration: float, step: float, time_limit: float, progress: Progress,
            keep: Callable[[list[Comparison]], None]) -> list[Comparison]:
    """Compare every way with the reference over a duration (s); `keep` is called after each with all so far.

    Raises `TruthError` where the reference cannot integrate the scene.
    """
    from crosscheck.references import taylor
    from crosscheck.references import truth as reference

    progress(0, len(selected), f"{scene.name}: reference")
    long = long_scene(scene, duration)
    integrator = taylor.Taylor(long)
    truth = observables(long, integrator.states(integrator.run()))
    horizon = reference(scene).horizon
    done: list[Comparison] = []
    for index, way in enumerate(selected):
        progress(index, len(selected), f"{scene.name}: {way.label}")
        found = Comparison(scene.name, way.engine, way.method, way.label, step, long.duration, horizon)
        done.append(found)
        try:
            _run_into(found, way, long, time_limit, truth, len(selected) * len(truth))
        except Exception as error:  # whatever an engine raises is a row of the study
            found.status, found.reason = "error", " ".join(str(error).split()) or type(error).__name__
        keep(done)
    return done


def _run_into(found: Comparison, way: Way, long: Scene, time_limit: float, truth: dict[str, np.ndarray],
              comparisons: int) -> None:
    from crosscheck.mechanics import kinetic_energy
    from crosscheck.running import run
    from crosscheck.studies.drift import too_long

    reason = too_long(long, way, found.step, round(long.duration / found.step), time_limit)
    if reason:
        found.status, found.reason = "skipped", reason
        return
    traj = run(long, way.engine, way.method, step=found.step, form=way.form, monitor=False)
    states = States(traj.t, traj.x, traj.R, traj.v, traj.w)
    found.wall_time = traj.wall_time
    found.energy_error = float(np.abs(traj.energy - traj.energy[0]).max() / kinetic_energy(long, states).max())
    momentum = traj.momentum_vertical
    found.momentum_error = float(np.abs(momentum - momentum[0]).max() / (np.abs(momentum).max() or 1.0))
    judge(found, truth, observables(long, states), comparisons)


@dataclasses.dataclass(frozen=True)
class Settings:
    """How long each run is, its step, and the stepping time (s) beyond which it is left out."""

    duration: float = 2000.0  # s
    step: float = 2.0**-8  # s
    time_limit: float = 120.0


def study(scenes: Sequence[str], engines: Sequence[str] | None, methods: Sequence[str] | None, settings: Settings,
          out: Any, progress: Progress) -> dict[str, Any]:
    """Measure, write chaos.json and chaos.csv into `out` after every run, and return the document.

    Raises `ArgumentError` for wrong names or a folder that must not be replaced; a failed run is a row.
    """
    from crosscheck import engines as all_engines
    from crosscheck import provenance
    from crosscheck.scene_file import load_scene
    from crosscheck.studies import results_folder
    from crosscheck.studies.drift import chosen
    from crosscheck.studies.work_precision import check_names

    names = tuple(engines or all_engines.names())
    check_names(names, tuple(methods) if methods else None)
    loaded = [load_scene(name) for name in scenes]
    results_folder.check(out, "chaos")
    document: dict[str, Any] = {"study": "chaos", "meta": provenance.describe(names), "false_alarm": FALSE_ALARM,
                                "runs": []}
    for scene in loaded:
        before = list(document["runs"])

        def keep(found: list[Comparison], before: list[dict[str, Any]] = before) -> None:
            document["runs"] = [*before, *(dataclasses.asdict(each) for each in found)]
            results_folder.write(out, document, document["runs"])

        measure(scene, chosen(scene, names, methods), settings.duration, settings.step, settings.time_limit, progress,
                keep)
    return document
