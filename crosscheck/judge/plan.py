"""What `crosscheck verify` runs: profiles, and per scene the steps at which each order of method is judged."""

from __future__ import annotations

import dataclasses
import math

from crosscheck.compare.sizes import natural_time
from crosscheck.document import Plan
from crosscheck.errors import ArgumentError
from crosscheck.judge import tolerances
from crosscheck.references.base import Reference
from crosscheck.scene.model import Scene


def halved(coarsest: float, rungs: int = 4) -> tuple[float, ...]:
    """A ladder of steps (s), each half the one before."""
    return tuple(coarsest / 2**rung for rung in range(rungs))


def parts(interval: float, *counts: int) -> tuple[float, ...]:
    """A ladder of steps (s) that divide the interval between two output times of the order study."""
    return tuple(interval / count for count in counts)


EULER_LADDER = halved(4e-3)
"""The steps the project's order tests prescribe for first and second order on the pendulums."""

STUDY_SAMPLES = 6
"""Number of output times of the order study. Every step of a ladder has to divide the time between two of them."""

# The steps are so small that the bounds of `crosscheck.judge.tolerances`, which follow from each scene's truth, judge.
# A ladder starts where the method is in its asymptotic range and ends above the rounding plateau. High orders pass
# through that gap so fast that they need steps closer than halves. Methods of one order differ a thousandfold in their
# errors (on the top, symmetric compositions of RATTLE and Runge-Kutta steps of order 6), and the ladder has to end
# above the plateau for the best of them. The top turns at 150 rad/s, so that its steps are shorter and its order study
# covers two turns. The first-order steps are so small that an error of 1e-3 of gravity, mass or inertia exceeds what
# the runs at one, two and four steps have in common, also if it begins at half the time.
PLANS = {
    "single_pendulum": Plan(1.0, {1: 1e-4, 2: 1e-3}, {
        1: EULER_LADDER, 4: halved(2e-2), 5: halved(4e-2), 6: parts(0.2, 4, 6, 8, 10), 8: parts(0.2, 1, 2, 3, 4)}),
    "double_pendulum": Plan(1.0, {1: 3.5e-5, 2: 1e-3}, {
        1: EULER_LADDER, 4: halved(5e-3), 5: parts(0.2, 10, 15, 20, 30), 8: parts(0.2, 10, 12, 14, 16)}),
    "triple_pendulum": Plan(2.0, {1: 1e-4, 2: 1e-3}, {
        1: EULER_LADDER, 4: halved(2e-2), 5: halved(1e-2), 6: parts(0.4, 12, 16, 20, 24),
        8: parts(0.4, 16, 20, 24, 28)}),
    "heavy_top": Plan(0.1, {1: 5e-6, 2: 2e-5, 4: 1e-4, 8: 5e-4}, {
        1: halved(4e-5), 2: halved(2e-4), 4: halved(4e-3), 6: parts(0.02, 5, 6, 8, 10), 8: parts(0.02, 4, 6, 8, 10)}),
}

ORDERS = (1, 2, 4, 6, 8)
"""Orders with steps of their own; a method of another takes those of the next lower."""

FEWEST = 20
"""Steps of a run at least, so that what a method does in one of them is not the whole motion."""

SHARE = 0.01
"""Bound of the error, as a share of the scene's size, at a step that is chosen by rule."""


def plan_from_truth(scene: Scene, truth: Reference) -> Plan:
    """Steps small enough for the bounds to judge, for a scene without a plan; `truth` is that of its first seconds."""
    window = float(truth.t[-1])
    scale = tolerances.scales(scene, truth)
    steps = {}
    for order in ORDERS:
        size = truth.amplification * window * tolerances.derivative(truth, order + 1, scale)
        step = (SHARE / max(size, tolerances.EPS)) ** (1 / order)
        steps[order] = _readable(min(step, window / FEWEST))
    return Plan(window, steps, {order: halved(4 * step) for order, step in steps.items()})


def plan_without_truth(scene: Scene) -> Plan:
    """Steps for a scene without truth: shares of the time in which it falls or turns by about a radian."""
    unit = natural_time(scene)
    steps = {order: _readable(min(share * unit, scene.duration / FEWEST)) for order, share in ((1, 1e-3), (2, 1e-2))}
    return Plan(min(1.0, scene.duration), steps, {})


def _readable(step: float) -> float:
    """The largest of 1, 2, 5 times a power of ten that is no larger than `step`."""
    power = 10.0 ** math.floor(math.log10(step))
    return max(digit for digit in (1, 2, 5) if digit * power <= step * (1 + 1e-12)) * power


PENDING = Plan(0.0, {}, {})
"""The plan of a cell until the truth of its scene has chosen one."""

RTOLS = (1e-4, 1e-5, 1e-6, 1e-7, 1e-8, 1e-9, 1e-10)
"""Relative tolerances of the accuracy study of adaptive methods; short profiles take every second one."""


@dataclasses.dataclass(frozen=True)
class Profile:
    """How much of the plan a profile runs."""

    name: str
    rungs: int | None  # steps of the order study; None: all
    whole: bool  # whether main runs cover the whole scene or only its first window
    forms: bool  # whether to run the forms of the model that are not an engine's default, too
    timing: int  # number of repeats of the timing study; 0: none
    most_steps: int = 20_000  # most steps of a main run of one body, on scenes without a plan of their own
    every_scene: bool = False  # whether to run all scenes of the library or only those with a plan
    most_seconds: float | None = None  # limit of processor time (s) of one order study; None: none
    speed: int = 0  # number of rounds of the speed study, which compares with a calibration kernel; 0: none


PROFILES = {
    "default": Profile("default", None, True, True, 3),
    "smoke": Profile("smoke", 3, False, False, 0),
    "full": Profile("full", None, True, True, 0, every_scene=True, most_seconds=20.0, speed=3),
}


def profile(name: str) -> Profile:
    """The profile with this name. Raises `ArgumentError` if there is none."""
    if name not in PROFILES:
        raise ArgumentError(f"profile {name!r} is unknown: choose {' or '.join(PROFILES)}")
    return PROFILES[name]
