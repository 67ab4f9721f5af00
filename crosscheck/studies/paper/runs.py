"""The runs for figures and tables: every method with every coordinate map and weight of the correction on one scene."""

from __future__ import annotations

import dataclasses
import math
from collections import Counter
from collections.abc import Callable
from typing import Any

import numpy as np

from crosscheck import references
from crosscheck.adapters.lieeuler import IntegrationError, LieEuler
from crosscheck.document import EULER
from crosscheck.errors import CrosscheckError
from crosscheck.judge.plan import natural_time
from crosscheck.references import TruthError
from crosscheck.running.attempt import Ran, Way, attempt
from crosscheck.running.trajectory import Trajectory
from crosscheck.scene.model import Scene

SAMPLES = 1001
"""Most output times: enough for smooth curves in print."""

SHARE = 1 / 300
"""The default step as a share of the time in which the scene falls or turns by about a radian."""

ORDER_STEPS = (1.0, 0.5, 0.25)
"""Steps for the observed order, as multiples of `suitable_step`."""

ORDER_WINDOW = 3.0
"""Duration of the runs for the observed order, in natural times of the scene; short, so that errors stay small."""


@dataclasses.dataclass(frozen=True)
class Request:
    """What to show. `step` and `duration` are in s. None: a suitable step, and the duration of the scene.

    Maps and corrections are options of `lieeuler`; each method is shown in those that it has.
    """

    methods: tuple[str, ...] = EULER
    maps: tuple[str, ...] = ("exp",)
    shown: str = "DAE1L_LSE"
    step: float | None = None
    duration: float | None = None
    engine: str = "lieeuler"
    corrections: tuple[str, ...] = ("mass",)

    def variants(self, method: str) -> list[tuple[str, str]]:
        """The pairs (map, correction) in which a method is shown; "" for an option that it does not have."""
        if self.engine != "lieeuler":
            return [("", "")]
        corrections = self.corrections if method in LieEuler.correcting_methods else ("",)
        return [(coordinate_map, correction) for coordinate_map in self.maps for correction in corrections]


@dataclasses.dataclass(frozen=True)
class Line:
    """One run as a line of the tables: largest values over every step, SI units.

    `energy_by_start` is the error over |E(0)|, our reading of the "relative errors of the total energy" in [P1], whose
    formula is lost. `energy_by_kinetic` is the error over the largest kinetic energy, as in verdicts. The first
    depends on where the potential energy is zero; the second does not.
    """

    method: str
    coordinate_map: str
    correction: str
    ended: str  # "" if the run reached its end; else what ended it, and when
    energy_by_start: float | None = None
    energy_by_kinetic: float | None = None
    position: float | None = None
    velocity: float | None = None
    acceleration: float | None = None
    orthogonality: float | None = None
    unpolished: float | None = None  # orthogonality of the group update alone
    error: float | None = None  # m, the largest over bodies at the end, against truth
    order: float | None = None  # the observed order of that error


@dataclasses.dataclass(frozen=True)
class Shown:
    """All runs of one scene."""

    scene: Scene
    step: float  # s
    lines: tuple[Line, ...]
    runs: dict[str, Trajectory]  # of the first map and correction, by method
    unpolished: dict[str, np.ndarray]  # orthogonality (T,) of the group update alone, by method
    truth: str  # sources of the truth, or why there is none


def suitable_step(scene: Scene) -> float:
    """The largest step (s) of the form 1, 2 or 5 times a power of ten that is at most `SHARE` of the natural time."""
    wanted = SHARE * natural_time(scene)
    power = 10.0 ** math.floor(math.log10(wanted))
    return max(factor * power for factor in (1, 2, 5) if factor * power <= wanted)


def measure(scene: Scene, request: Request, progress: Callable[[str], None]) -> Shown:
    """Run every method with every map over the scene."""
    duration = request.duration or scene.duration
    steps = max(1, round(duration / (request.step or suitable_step(scene))))
    intervals = min(SAMPLES - 1, steps)
    step = duration / (intervals * math.ceil(steps / intervals))  # samples lie on steps
    scene = scene.replace(duration=duration, samples=intervals + 1)
    exact, source = _truth(scene)
    lines, runs, unpolished = [], {}, {}
    for method in request.methods:
        for variant in request.variants(method):
            progress(f"{scene.name}: {method} {' '.join(variant)}")
            traj = _attempt(scene, request.engine, method, variant, step)
            if isinstance(traj, str):
                lines.append(Line(method, *variant, traj))
                continue
            plain = (_attempt(scene, request.engine, method, variant, step, polish=False)
                     if request.engine == "lieeuler" else None)
            if method not in runs:
                runs[method] = traj
                if isinstance(plain, Trajectory):
                    unpolished[method] = plain.orthogonality
            lines.append(_line(scene, request.engine, traj, plain, variant, exact))
    return Shown(scene, step, tuple(lines), runs, unpolished, source)


def _truth(scene: Scene) -> tuple[np.ndarray | None, str]:
    """True positions (n, 3) of the bodies at the end and their sources, or None and why there is no truth."""
    try:
        reference = references.truth(scene)
    except (CrosscheckError, TruthError) as error:
        return None, f"no truth: {error}"
    return reference.states.x[-1], f"{reference.source}; {reference.second_source}"


def _attempt(scene: Scene, engine: str, method: str, variant: tuple[str, str], step: float, **options: Any
             ) -> Trajectory | str:
    """A run, or in a few words what ended it early."""
    coordinate_map, correction = (name or None for name in variant)
    way = Way.of(engine, method, step, coordinate_map=coordinate_map, correction=correction)
    outcome = attempt(scene, way, **options)
    if isinstance(outcome, Ran):
        return outcome.trajectory
    if isinstance(outcome.error, IntegrationError):
        return f"{outcome.error.status.value} at {outcome.error.solution.t_end:.4g} s"
    return outcome.why


def _line(scene: Scene, engine: str, traj: Trajectory, plain: Trajectory | str | None, variant: tuple[str, str],
          exact: np.ndarray | None) -> Line:
    largest = traj.maxima
    start = abs(float(traj.energy[0]))
    return Line(
        traj.method, *variant, "", largest["energy_error"] * largest["kinetic_energy"] / start if start else None,
        largest["energy_error"], largest["constraint_position"], largest["constraint_velocity"],
        largest.get("constraint_acceleration"), largest["orthogonality"],
        float(plain.stats["orthogonality"]) if isinstance(plain, Trajectory) else None,
        None if exact is None else _error(traj, exact), _order(scene, engine, traj.method, variant))


def _error(traj: Trajectory, exact: np.ndarray) -> float:
    return float(np.linalg.norm(traj.x[-1] - exact, axis=-1).max())


def _order(scene: Scene, engine: str, method: str, variant: tuple[str, str]) -> float | None:
    """The observed order of the end error of a brief run; None without truth, or if a run ends early."""
    brief = scene.replace(samples=2, duration=min(scene.duration, ORDER_WINDOW * natural_time(scene)))
    exact, _ = _truth(brief)
    runs = [_attempt(brief, engine, method, variant, factor * suitable_step(scene)) for factor in ORDER_STEPS]
    errors = [_error(each, exact) for each in runs if isinstance(each, Trajectory) and exact is not None]
    if len(errors) < len(runs) or min(errors) == 0:
        return None
    return float(np.polyfit(np.log(ORDER_STEPS), np.log(errors), 1)[0])


def ends(scene: Scene) -> dict[int, np.ndarray]:
    """For each body that has one joint only: the point opposite the joint, from the mass centre, in body axes."""
    joined = Counter(body for joint in scene.joints for body in (joint.parent, joint.child))
    return {joint.child: -np.asarray(joint.child_anchor) for joint in scene.joints
            if joined[joint.child] == 1 and np.any(joint.child_anchor)}
