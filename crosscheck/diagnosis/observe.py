"""Observations of an engine: the limit of its motion for vanishing steps, the error of that, and its accelerations.

States are compared as one normalised array y (T, n, 18): x / L, the nine entries of R, v / (L W), w / W, with a length
L and a rate W of the scene. Everything comes from `Engine.run`.
"""

from __future__ import annotations

import dataclasses
import itertools
from typing import Any

import numpy as np

from crosscheck.adapters.base import Engine, RawRun, RunSpec
from crosscheck.compare.order import cancelling
from crosscheck.document import Way
from crosscheck.errors import Unsupported, check_time
from crosscheck.references.maximal import Maximal
from crosscheck.running.attempt import Ran, attempt
from crosscheck.scene import mechanics
from crosscheck.scene.model import GROUND, Scene
from crosscheck.scene.states import States

SAMPLES = 21
"""Number of output times of an observation. They are 0.05 rad of the scene's rate apart, so that for a motion of three
times that rate a nine-point difference is off by 0.15^8 / 630, about 4e-10 of the derivative."""

LADDERS = {1: (1, 2, 4, 8, 16), 2: (1, 2, 4, 8), 4: (1, 2, 4)}
"""Steps per sample interval from which the limit follows, by documented order, or the next lower one."""

RTOLS = (1e-10, 1e-12)
"""Relative tolerances from which the limit of an adaptive method follows."""

ROUNDING = 1e-13
"""Rounding of y after some hundred operations on numbers of size one."""

STENCIL = (1 / 280, -4 / 105, 1 / 5, -4 / 5, 0.0, 4 / 5, -1 / 5, 4 / 105, -1 / 280)
"""Nine-point first difference (Fornberg, Math. Comp. 1988, doi:10.1090/S0025-5718-1988-0935077-0)."""
SHORTER = (0.0, -1 / 60, 3 / 20, -3 / 4, 0.0, 3 / 4, -3 / 20, 1 / 60, 0.0)
"""Seven-point first difference in nine places."""
REACH = 4
"""Number of samples on each side that the differences take."""
TRUNCATION = 0.05
"""Error of the nine-point difference over its distance from the seven-point one: (140 / 630) times the square of
(rate times interval). It is below 0.2 up to a rate of 9 W, and usually far less."""

NOISY, FINER = 1e-7, 4
"""Error of a limit above which it is computed again, and how many times finer the steps then are."""

RESOLVED, FASTEST = 1e-5, 64.0
"""Part of the rate above which the error of a derivative asks for a shorter window, and by how much at most."""

_TRUE: dict[str, States] = {}
MOST_KEPT = 64


def true_motion(scene: Scene) -> States:
    """The true states at the output times. They are kept, since many hypotheses need the same ones.

    Raises `Unsupported` for dry friction, limits and servos, beside which other causes are not told apart.
    """
    if scene.hash not in _TRUE:
        if len(_TRUE) >= MOST_KEPT:
            _TRUE.clear()
        if (system := Maximal(scene)).laws:
            raise Unsupported(f"no altered law of scene {scene.name!r} is nearer to the run than its own; other causes "
                              "are sought where no joint has dry friction, limits or a servo: crosscheck verify says "
                              "whether the run is right as it is")
        _TRUE[scene.hash] = system.run()
    return _TRUE[scene.hash]


NOISE_LEFT = 5.0
"""Times the noise of the states by which their limit may be wrong."""


class Silent(Exception):
    """The engine gave no usable run. The message has the reason."""


@dataclasses.dataclass(frozen=True)
class Scale:
    """Units in which the states of a scene are numbers of size one."""

    length: float  # m
    rate: float  # rad/s
    fast: float = 1.0  # how many times faster than the scene an engine was seen to move

    def flat(self, states: Any) -> np.ndarray:
        """y, (T, n, 18), of states."""
        R = states.R.reshape(*states.x.shape[:2], 9)
        return np.concatenate([states.x / self.length, R, states.v / (self.length * self.rate), states.w / self.rate],
                              axis=2)

    def states(self, t: np.ndarray, y: np.ndarray) -> States:
        """The states of y at the times t. Their attitudes are as orthogonal as those of y."""
        R = y[:, :, 3:12].reshape(*y.shape[:2], 3, 3)
        return States(t, y[:, :, :3] * self.length, R, y[:, :, 12:15] * (self.length * self.rate),
                      y[:, :, 15:] * self.rate)


def scale_of(scene: Scene) -> Scale:
    """The longest lever, and the fastest of initial rotation, fall and oscillation on a spring; no run is made."""
    levers = [float(np.linalg.norm(joint.child_anchor)) for joint in scene.joints if joint.child != GROUND]
    levers += [float(np.linalg.norm(joint.parent_anchor)) for joint in scene.joints if joint.parent != GROUND]
    masses, inertias = mechanics.weights(scene)
    gyration = np.sqrt(np.trace(inertias, axis1=1, axis2=2) / (2 * masses))
    length = float(max([*levers, 0.0]) or gyration.max())
    gravity = float(np.linalg.norm(scene.gravity))
    rates = [float(np.linalg.norm(scene.w0, axis=1).max()), float(np.sqrt(gravity / length))]
    smallest = np.linalg.eigvalsh(inertias)[:, 0]
    for joint in scene.joints:
        lever = float(np.linalg.norm(joint.child_anchor))
        mass = masses[joint.child]
        rates.append(float(np.sqrt(mass * gravity * lever / (smallest[joint.child] + mass * lever**2))))
    for force in scene.loads:
        stiffness = force.parameters.get("stiffness", 0.0)
        inertia = smallest.min() if force.law.measure == "angle" else masses.min()
        rates.append(float(np.sqrt(stiffness / inertia)))
    return Scale(length, max(rates) or 1.0)


@dataclasses.dataclass
class Observation:
    """An engine's limit on one scene."""

    scene: Scene  # with the duration and samples of the observation
    scale: Scale
    y: np.ndarray  # (T, n, 18)
    noise: float  # of y: the difference of two estimates of the limit, and rounding
    order: float | None  # of the engine's convergence to its own limit at the finest steps; None: unknown

    @property
    def states(self) -> States:
        """The limit as states."""
        return self.scale.states(self.scene.t, self.y)


@dataclasses.dataclass(frozen=True)
class Subject:
    """The engine to be explained, and the way in which it runs, without step and tolerance."""

    engine: Engine
    way: Way
    paces: list[float] = dataclasses.field(default_factory=list)  # s per step, of the runs so far

    def spec(self, step: float | None = 1e-3, rtol: float | None = None) -> RunSpec:
        """The request for one run."""
        return RunSpec(self.way.method, step, rtol, monitor=False, **self.way.arguments)

    def order(self, scene: Scene) -> int | None:
        """Documented order; None for adaptive methods."""
        return self.engine.documented_order(scene, self.spec())

    def held(self, scene: Scene) -> frozenset[str]:
        """Constraint levels that it claims to enforce."""
        return self.engine.held_levels(scene, self.spec())

    def unsupported(self, scene: Scene, step: float | None = 1e-3) -> str | None:
        """Why it cannot run this scene; None if it can."""
        return self.engine.unsupported(scene, self.spec(step, 1e-9 if step is None else None))

    def run(self, scene: Scene, step: float | None = None, rtol: float | None = None) -> RawRun:
        """A raw run. Raises `Silent` with the reason if there is none, and `OutOfTime`."""
        check_time(0.0 if step is None else min(self.paces, default=0.0) * scene.duration / step)
        with np.errstate(all="ignore"):  # steps that are too coarse overflow, which is an outcome
            outcome = attempt(scene, self.way, self.engine, step=step, rtol=rtol, monitor=False)
        if not isinstance(outcome, Ran):
            raise Silent(outcome.why) from outcome.error
        self.paces.append(outcome.raw.wall_time / outcome.raw.steps)
        return outcome.raw


def window(scene: Scene, scale: Scale) -> Scene:
    """The beginning of a scene, at the output times of an observation."""
    return scene.replace(duration=min(1.0 / (scale.rate * scale.fast), scene.duration), samples=SAMPLES)


def first_look(subject: Subject, scene: Scene, scale: Scale, noise: float) -> Observation:
    """The limit over the beginning of a scene, which is short enough to resolve the engine's motion.

    A soft joint oscillates far faster than the scene turns. `noise` is that of the states, which does not count as such
    a motion. Raises `Silent` if a run fails.
    """
    while True:
        seen = observe(subject, window(scene, scale), scale)
        interval = seen.scene.duration / (SAMPLES - 1)
        _, error = rates(seen.y, interval)
        seen.noise = max(seen.noise, NOISE_LEFT * noise)
        if error <= max(RESOLVED * scale.rate * scale.fast, seen.noise / interval) or scale.fast >= FASTEST:
            return seen
        scale = dataclasses.replace(scale, fast=FINER * scale.fast)


def observe(subject: Subject, scene: Scene, scale: Scale) -> Observation:
    """The limit of an engine for vanishing steps, on the output times of `scene`.

    Raises
    ------
    Silent
        A run failed.
    """
    order = subject.order(scene)
    if order is None:
        loose, tight = (scale.flat(subject.run(scene, rtol=rtol).states) for rtol in RTOLS)
        return Observation(scene, scale, tight, float(np.abs(tight - loose).max()) + ROUNDING, None)
    best: Observation | None = None
    failure: Silent | None = None
    counts = LADDERS[max(key for key in LADDERS if key <= order)]
    for finer in (1, FINER, FINER**2):  # a stiff model, such as soft constraints, may run at fine steps only
        interval = scene.interval / finer
        try:
            runs = [scale.flat(subject.run(scene, interval / count).states) for count in counts]
        except Silent as error:
            failure = error
            continue
        observed = convergence(runs)
        first = order if observed is None else int(np.clip(round(observed), 1, order))
        fine, rough = (extrapolated(runs[skip:], counts[skip:], first) for skip in (0, 1))
        seen = Observation(scene, scale, fine, float(np.abs(fine - rough).max()) + ROUNDING, observed)
        best = seen if best is None or seen.noise < best.noise else best
        if best.noise <= NOISY or finer > 1:
            return best
    if best is None:
        raise failure or Silent("no run")
    return best


def convergence(runs: list[np.ndarray]) -> float | None:
    """Order at which runs at halved steps converge; None if their differences are rounding."""
    gaps = [float(np.abs(finer - coarser).max()) for coarser, finer in itertools.pairwise(runs)]
    seen = [gap for gap in gaps if gap > 30 * ROUNDING]
    return None if len(seen) < 2 else float(np.log2(seen[-2] / seen[-1]))


def extrapolated(runs: list[np.ndarray], counts: tuple[int, ...], first: int) -> np.ndarray:
    """The value at step zero of the polynomial 1, h^first, h^(first+1), ... through runs at steps 1 / count."""
    return np.asarray(np.einsum("k,k...->...", cancelling(1.0 / np.array(counts, dtype=float), first), np.array(runs)))


def rates(y: np.ndarray, interval: float) -> tuple[np.ndarray, float]:
    """dy/dt (1/s) at the inner times, (T - 8, n, 18), and an estimate of its error."""
    def apply(stencil: tuple[float, ...]) -> np.ndarray:
        neighbours = np.lib.stride_tricks.sliding_window_view(y, len(stencil), axis=0)
        slopes: np.ndarray = neighbours @ np.array(stencil) / interval
        return slopes

    fine, rough = apply(STENCIL), apply(SHORTER)
    return fine, TRUNCATION * float(np.abs(fine - rough).max())
