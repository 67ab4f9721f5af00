"""Runs an Exudyn model: solvers, settings, and recorded sensor data."""

from __future__ import annotations

import contextlib
import dataclasses
import io
import sys
import time
from collections.abc import Callable
from types import ModuleType
from typing import TYPE_CHECKING, Any

import numpy as np

from crosscheck.adapters.common import stepping
from crosscheck.adapters.exudyn.models import Model
from crosscheck.errors import EngineError

if TYPE_CHECKING:
    import exudyn

IMPLICIT = ("GeneralizedAlpha", "TrapezoidalIndex2")
SPECTRAL_RADIUS = 0.6
"""Exudyn's default of 0.9 fails on the pendulums and the top at coarse steps with Lie group nodes."""

NEWTON_TOLERANCES = (1e-13, 1e-11, 1e-9, 1e-7)
"""Exudyn's default of 1e-8 leaves gaps of 3e-11 m in the joints of the double pendulum; the first value here reaches
rounding at little cost. At rest the residual starts near its rounding level, some eps x / h^2, and only a later value
can be reached; the squeezer, whose bodies weigh grams, needs the last."""

SPARSE_FROM = 8
"""Number of bodies from which the sparse solver is faster."""


def load() -> ModuleType:
    """The module exudyn, imported as its fast build, without output on the console."""
    sys.exudynFast = True  # type: ignore[attr-defined]
    with contextlib.redirect_stdout(io.StringIO()):
        import exudyn

    exudyn.config.printToConsole = False
    return exudyn


def settings(method: str, duration: float, steps: int, every: int, tolerance: float, linear: str | None = None) -> Any:
    """Simulation settings of a fixed-step run that records every `every`-th step and writes no file.

    `tolerance` is Newton's, of the residual, absolute and relative; `linear` as in `solve`.
    """
    exudyn = load()
    result = exudyn.SimulationSettings()
    integration = result.timeIntegration
    integration.solverType = getattr(exudyn.DynamicSolverType, method)
    integration.endTime, integration.numberOfSteps = duration, steps
    integration.adaptiveStep = integration.automaticStepSize = False
    integration.verboseMode = integration.verboseModeFile = 0
    integration.newton.relativeTolerance = integration.newton.absoluteTolerance = tolerance
    # DOPRI5 rejects steps by its error estimate even if the step is fixed
    integration.relativeTolerance = integration.absoluteTolerance = 1e100
    integration.generalizedAlpha.spectralRadius = SPECTRAL_RADIUS
    if method == "TrapezoidalIndex2":
        integration.generalizedAlpha.useNewmark = True
        integration.generalizedAlpha.useIndex2Constraints = True
    if linear is not None:
        result.linearSolver.solverType = getattr(exudyn.LinearSolverType, linear)
    # a second evaluation after each step takes up to half of the time; do it only if every step is recorded
    integration.explicit.computeEndOfStepAccelerations = every == 1
    result.solution.file.write = False
    result.solution.sensors.writePeriod = duration / steps * every
    return result


@dataclasses.dataclass
class Solved:
    """A finished run: the times of the start and of every recorded step, and the sensor data (T, columns)."""

    model: Model
    t: np.ndarray
    data: list[np.ndarray]
    wall_time: float  # s, stepping only
    solver: exudyn.MainSolverImplicitSecondOrder
    tolerance: float


def solve(build: Callable[[], Model], method: str, duration: float, steps: int, every: int,
          linear: str | None = None) -> Solved:
    """Run a new model with the tightest of `NEWTON_TOLERANCES` that converges; explicit methods run only once.

    `linear` is the linear solver, None for Exudyn's default.
    """
    *tighter, last = NEWTON_TOLERANCES
    if method in IMPLICIT:
        for tolerance in tighter:
            with contextlib.suppress(EngineError):  # the attempt with the last tolerance raises
                return _attempt(build(), method, duration, steps, every, tolerance, linear)
    return _attempt(build(), method, duration, steps, every, last, linear)


def _attempt(model: Model, method: str, duration: float, steps: int, every: int,
             tolerance: float, linear: str | None) -> Solved:
    exudyn = load()
    options = settings(method, duration, steps, every, tolerance, linear)
    solver = exudyn.MainSolverImplicitSecondOrder() if method in IMPLICIT else exudyn.MainSolverExplicit()
    try:
        model.system.Assemble()
        ready = solver.InitializeSolver(model.system, options)
        start = time.perf_counter()
        solved = ready and solver.SolveSteps(model.system, options)
        wall = time.perf_counter() - start
        solver.FinalizeSolver(model.system, options)
    except exudyn.ExudynError as error:
        words = str(error).split(" [Python file")[0]  # Exudyn appends the path of this module
        raise EngineError(f"Exudyn {method}: {words}") from error
    if not solved:
        raise EngineError(f"Exudyn {method} stopped at t = {solver.it.currentTime:.6g} s: "
                          f"{solver.GetErrorString().strip() or 'no reason given'}; try a smaller step")
    t = np.linspace(0.0, duration, steps // every + 1)
    recorded = [np.asarray(model.system.GetSensorStoredData(sensor)) for sensor in model.sensors]
    odd = [data for data in recorded if len(data) != len(t) or np.abs(data[:, 0] - t).max() > 1e-6 * t[1]]
    if odd:
        raise EngineError(f"Exudyn {method}: {len(odd[0])} records where {len(t)} evenly spaced ones were asked for")
    data = [part[:, 1:] for part in recorded]  # without the column of times
    stepping.check_finite(method, t, *data)
    return Solved(model, t, data, wall, solver, tolerance)
