"""What `crosscheck verify` runs: profiles, and per scene the steps and the duration of its runs."""

from __future__ import annotations

import dataclasses
import math

import numpy as np

from crosscheck.compare.ladder import FEWEST
from crosscheck.compare.sizes import natural_time
from crosscheck.document import AS_PLANNED, Asked, Plan
from crosscheck.errors import ArgumentError
from crosscheck.judge.segments import SEGMENTS
from crosscheck.references.maximal import fastest
from crosscheck.scene.model import Scene
from crosscheck.scene.states import Motion

RESOLVE = {1: 1e-5, 2: 1e-7, 4: 1e-9, 6: 1e-9, 8: 1e-9}
"""By documented order the uncertainty that a run aims at, over the size. That of three answers is about (h W)^(p + 1),
W the fastest rate of the motion. At 1e-4 first-order methods leave parts of the default scenes unresolved; at 1e-6
one of order two does."""

AFFORDABLE = 2e5
"""Cube of the bodies times the radians of a run whose truth takes about half a minute: 64 bodies for .1 s."""

OUTPUTS = 64
"""Fewest intervals between outputs that are made longer, for steps to be grouped."""


def duration_within(scene: Scene, most_seconds: float | None = None) -> float | None:
    """Time (s) after which runs end, so that truth can be had; None: the scene's own."""
    most = AFFORDABLE * natural_time(scene) / scene.n**3
    most = min(float(f"{most:.1g}"), math.inf if most_seconds is None else most_seconds)
    return most if most < scene.duration else None


def plan_of(scene: Scene, motion: Motion | None, most_steps: int, most_seconds: float | None = None,
            asked: Asked = AS_PLANNED) -> Plan:
    """The plan of a scene, from its true motion as far as that is known, with what the user asked for.

    Runs take at most `most_steps` / sqrt(bodies) steps. The root is a compromise: the cost of a step grows with the
    number of bodies, but a part of it is fixed.
    """
    duration = asked.duration or duration_within(scene, most_seconds)
    whole = duration or scene.duration
    rate = max(1.0 / natural_time(scene), fastest(scene), 0.0 if motion is None else float(
        np.nanmax(np.linalg.norm(motion.w, axis=-1), initial=0.0)))
    samples = max(26, 251 // max(1, scene.n // 2))
    if asked.step is not None:
        samples, length = outputs(asked.step, whole, samples, asked.duration is None)
        return Plan({1: asked.step}, samples=samples, duration=duration if length == whole else length)
    interval, most = whole / (samples - 1), most_steps / math.sqrt(scene.n) / (samples - 1)
    wanted = {order: interval * rate * share ** (-1 / (order + 1)) for order, share in RESOLVE.items()}
    # Up to twice as fine where that spares the finer steps that the verdict asks for below `FEWEST`.
    steps = {order: interval / _divisor(max(count, FEWEST if 2 * count >= FEWEST else 1.0), most)
             for order, count in wanted.items()}
    return Plan(steps, samples=samples, duration=duration)


def outputs(step: float, whole: float, samples: int, shorter: bool) -> tuple[int, float]:
    """The number of samples, at most `samples`, and the duration (s), so that whole steps lead from output to output.

    If `shorter`, it may end before `whole`, by less than an interval; else the step is cut, by as little as makes whole
    ones. Both stay where there are too few steps. With fewer than `FEWEST` an interval the verdict asks for finer ones,
    which cost more.
    """
    count = round(whole / step)
    exact = abs(count * step - whole) <= 1e-9 * whole
    count -= not exact and count * step > whole
    each = max(1, math.ceil(count / (samples - 1)), min(FEWEST, count // OUTPUTS))  # steps of an interval
    most = min(2 * each, count // SEGMENTS) if shorter else count // SEGMENTS
    if exact and (found := next((k for k in range(each, most + 1) if count % k == 0), 0)):
        return count // found + 1, whole
    count = count // each if shorter else math.ceil(whole / step / each)
    if count < SEGMENTS:
        return samples, whole
    return count + 1, count * each * step if shorter else whole


def _divisor(least: float, most: float) -> int:
    """The first 2^i 5^j from `least`, or the last up to `most`: a decimal fraction over it has few digits."""
    fit = sorted(2**i * 5**j for i in range(60) for j in range(26) if (i, j) == (0, 0) or 2**i * 5**j <= most)
    return int(next((count for count in fit if count >= least), fit[-1]))


PENDING = Plan({})
"""The plan of a cell until the truth of its scene has chosen one."""


@dataclasses.dataclass(frozen=True)
class Profile:
    """How much a profile runs."""

    name: str
    forms: bool  # whether to run the forms of the model that are not an engine's default, too
    most_steps: int = 100_000  # most steps of a run of one body
    most_seconds: float | None = None  # duration (s) of runs at most; None: those of the scenes
    every_scene: bool = False  # whether to run all scenes of the library or only those with the tag "default"
    speed: int = 0  # number of processes that measure times, which compare with a calibration kernel; 0: none


PROFILES = {
    "default": Profile("default", True, speed=1),
    "smoke": Profile("smoke", False, most_seconds=1.0),
    "full": Profile("full", True, 20_000, every_scene=True, speed=3),
}


def profile(name: str) -> Profile:
    """The profile with this name. Raises `ArgumentError` if there is none."""
    if name not in PROFILES:
        raise ArgumentError(f"profile {name!r} is unknown: choose {' or '.join(PROFILES)}")
    return PROFILES[name]
