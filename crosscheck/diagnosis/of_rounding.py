"""Rounding that adds up: each step rounds to the same side, so that errors grow with the number of steps.

Rounding to nearest, either side alike, grows as the root of that number, and in another direction in every run.
"""

from __future__ import annotations

import time

import numpy as np

from crosscheck.diagnosis.observe import Scale, Silent, Subject, true_motion
from crosscheck.diagnosis.result import Evidence, NamedCause
from crosscheck.scene.model import Scene

COUNTS = (64, 128, 256, 512, 1024, 2048)
"""Steps per sample interval. The errors of three in a row have to double."""

LEAST, MOST = 1.6, 2.7
"""Ratio of the errors at half a step and at the step. It is 2 if every step adds alike; what quaternions round differs
from run to run. Random rounding has 1.4, and what a wrong model leaves 1."""

ALIKE = 0.95
"""Least cosine between the errors of two runs. Those of noise are at right angles to each other."""

PATIENCE = 5.0
"""Time (s) of one run beyond which no finer step is tried."""

NAME = "rounding that adds up"
MEND = ("find what every step rounds to the same side, such as velocities that are turned there and back by "
        "quaternions that are not quite of length one, and leave it out or compute it in double precision")


def diagnose(subject: Subject, scene: Scene, scale: Scale) -> tuple[NamedCause | None, Evidence]:
    """The cause if errors double with the number of steps and keep their direction, and the evidence in any case.

    `scene` has the duration and output times of an observation. The subject has fixed steps.
    """
    exact = scale.flat(true_motion(scene))
    interval, gaps = scene.duration / (scene.samples - 1), list[np.ndarray]()
    for count in COUNTS:
        began = time.perf_counter()
        try:
            gaps.append(scale.flat(subject.run(scene, interval / count).states) - exact)
        except Silent:
            break
        if len(gaps) >= 3 and all(_doubles(*pair) for pair in zip(gaps[-3:-1], gaps[-2:], strict=True)):
            steps = count * (scene.samples - 1)
            size, left = float(np.abs(gaps[-1]).max()), float(np.abs(gaps[-1] - 2 * gaps[-2]).max())
            text = (f"{size / steps:.1e} a step in {steps} steps, errors double with their number; any other "
                    f"difference is below {left:.1e}")
            return NamedCause(NAME, text, MEND), _evidence(text, True)
        if time.perf_counter() - began > PATIENCE:
            break
    return None, _evidence("errors do not double with the number of steps", False)


def _doubles(coarse: np.ndarray, fine: np.ndarray) -> bool:
    """Whether the error of a run (T, n, 18) is about twice that of another one, in the same direction."""
    one, two = float(np.linalg.norm(coarse)), float(np.linalg.norm(fine))
    return one > 0.0 and LEAST <= two / one <= MOST and float(np.vdot(coarse, fine)) >= ALIKE * one * two


def _evidence(text: str, holds: bool) -> Evidence:
    return Evidence(NAME, "numerics", None, None, "errors at a step and at half of it", text, holds)
