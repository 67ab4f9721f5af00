"""What `crosscheck verify` runs: profiles, and per scene the steps and the duration of its runs."""

from __future__ import annotations

import dataclasses
import math

import numpy as np

from crosscheck.compare.sizes import natural_time
from crosscheck.document import AS_PLANNED, Asked, Plan
from crosscheck.errors import ArgumentError
from crosscheck.references.maximal import fastest
from crosscheck.scene.model import Scene
from crosscheck.scene.states import Motion

RESOLVE = {1: 1e-5, 2: 1e-7, 4: 1e-9, 6: 1e-9, 8: 1e-9}
"""By documented order the uncertainty that a run aims at, over the size. That of three answers is about (h W)^(p + 1),
W the fastest rate of the motion. At 1e-4 first-order methods leave parts of the default scenes unresolved; at 1e-6
one of order two does."""

AFFORDABLE = 2e5
"""Cube of the bodies times the radians of a run whose truth takes about half a minute: 64 bodies for .1 s."""

RTOLS = (1e-4, 1e-5, 1e-6, 1e-7, 1e-8, 1e-9, 1e-10)
"""Relative tolerances at which time is shown against error."""


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
    shortest = _readable(whole * math.sqrt(scene.n) / most_steps, up=True)
    samples = max(26, 251 // max(1, scene.n // 2))
    if asked.step is not None:
        samples, length = _outputs(asked.step, whole, samples, asked.duration is None)
        return Plan({1: asked.step}, samples=samples, duration=duration if length == whole else length)
    steps = {order: max(_readable(min(share ** (1 / (order + 1)) / rate, whole / (samples - 1))), shortest)
             for order, share in RESOLVE.items()}
    return Plan(steps, samples=samples, duration=duration)


FEWEST = 8
"""Fewest intervals between outputs: the segments of the verdict."""


def _outputs(step: float, whole: float, samples: int, shorter: bool) -> tuple[int, float]:
    """The number of samples, at most `samples`, and the duration (s), so that whole steps lead from output to output.

    If `shorter`, it may end before `whole`, by less than an interval. Where there is no such number both stay, and the
    step is cut.
    """
    count = round(whole / step)
    exact = abs(count * step - whole) <= 1e-9 * whole
    count -= not exact and count * step > whole
    each = max(1, math.ceil(count / (samples - 1)))  # steps of an interval
    most = min(2 * each, count // FEWEST) if shorter else count // FEWEST
    if exact and (found := next((k for k in range(each, most + 1) if count % k == 0), 0)):
        return count // found + 1, whole
    return (count // each + 1, count // each * each * step) if shorter and count // each >= FEWEST else (samples, whole)


def _readable(step: float, up: bool = False) -> float:
    """The nearest of 1, 2, 5 times a power of ten that is no larger than `step`, or no smaller."""
    power = 10.0 ** math.floor(math.log10(step))
    digits = [digit * power for digit in (1, 2, 5, 10)]
    return min(each for each in digits if each >= step * (1 - 1e-12)) if up else max(
        each for each in digits if each <= step * (1 + 1e-12))


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
    points: bool = False  # whether to show time against error at coarser steps, too


PROFILES = {
    "default": Profile("default", True, speed=1, points=True),
    "smoke": Profile("smoke", False, most_seconds=1.0),
    "full": Profile("full", True, 20_000, every_scene=True, speed=3),
}


def profile(name: str) -> Profile:
    """The profile with this name. Raises `ArgumentError` if there is none."""
    if name not in PROFILES:
        raise ArgumentError(f"profile {name!r} is unknown: choose {' or '.join(PROFILES)}")
    return PROFILES[name]
