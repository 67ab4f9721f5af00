"""The bound in the work-precision study: heyoka's Taylor series, compiled for one scene and one tolerance.

The equations are those of the reference in minimal coordinates (`crosscheck.references.taylor`), which are general for
trees and loops. Equations written by hand for one scene would be even faster.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import numpy as np

from crosscheck.errors import said
from crosscheck.references.base import Reference
from crosscheck.scene.model import Scene
from crosscheck.studies.frontier import BOUND
from crosscheck.studies.rung import Rung, errors_into

TOLERANCES = (1e-3, 1e-6, 1e-9, 1e-12, 1e-15)
"""Each tolerance has its own order of the series, and takes seconds to compile."""

LARGEST_UNROLLED = 14
"""Up to this number of states the series is compiled as code without loops. It is two to four times as fast, but takes
minutes to compile for larger systems."""


class Bound:
    """Taylor integrators of one scene, one for each tolerance."""

    def __init__(self, scene: Scene, truth: Reference) -> None:
        from crosscheck.references.taylor import Taylor

        self._scene, self._truth = scene, truth
        self._series = Taylor(scene)
        self._integrators: dict[float | None, Any] = {}

    def rung(self, rtol: float) -> Rung:
        """The run at a tolerance, with its errors; compiles the series."""
        rung = Rung(self._scene.name, BOUND, "taylor", None, "bound: heyoka", None, rtol)
        try:
            unrolled = len(self._series.initial) <= LARGEST_UNROLLED
            integrator = self._series.integrator(rtol, compact_mode=not unrolled, high_accuracy=False)
            self._integrators[rtol] = integrator
            integrator.time = 0.0
            integrator.state[:] = self._series.initial
            states = integrator.propagate_grid(self._scene.t)[-1]
            # At loose tolerances quaternions do not have unit length, which is not an error of the attitude.
            errors_into(rung, self._scene, self._series.states(self._series.normalised(states)), self._truth,
                        self._scene.samples - 1)
        except Exception as error:  # heyoka and LLVM raise several kinds; each is a row of the study
            rung.status, rung.reason = "error", said(error)
        return rung

    def timer(self, rung: Rung) -> Callable[[], float]:
        """A function that runs the rung and returns its stepping time, s."""
        integrator = self._integrators[rung.rtol]
        initial, end = np.array(self._series.initial), self._scene.duration

        def once() -> float:
            integrator.time = 0.0
            integrator.state[:] = initial
            start = time.perf_counter()
            steps = integrator.propagate_until(end)[3]
            wall = time.perf_counter() - start
            rung.steps = int(steps)
            return wall

        return once
