"""Exudyn: implicit Lie-group solvers in maximal coordinates, explicit ones at a pivot or on a kinematic tree.

Source: Gerstmayr, Multibody System Dynamics 2023, doi:10.1007/s11044-023-09937-1. With `monitor` on, sensors record
every step inside the timed part: speed figures want it off, and then explicit methods return no accelerations.
"""

from __future__ import annotations

import contextlib
import dataclasses
import functools
import importlib.metadata
import io
import itertools
import sys
import time
from collections.abc import Callable
from typing import Any

import numpy as np

from crosscheck.engines import exudyn_models, stepping, tree
from crosscheck.engines.base import RawRun, RunSpec
from crosscheck.errors import EngineError
from crosscheck.scene import GROUND, Scene
from crosscheck.states import States

ORDERS = {"GeneralizedAlpha": 2, "TrapezoidalIndex2": 2, "RK44": 4, "RK67": 6, "DOPRI5": 5}
IMPLICIT = ("GeneralizedAlpha", "TrapezoidalIndex2")
SPECTRAL_RADIUS = 0.6
"""Exudyn's own 0.9 fails on the pendulums and the top at coarse steps with Lie-group nodes."""

NEWTON_TOLERANCES = (1e-13, 1e-11, 1e-9)
"""Exudyn's own 1e-8 leaves 3e-11 m in the joints of the double pendulum; the first reaches rounding at little cost.
From rest the residual begins near its rounding floor, of some eps x / h^2, and only a later one can be met."""

PREFERRED_ORDER = "XYZ"
CLEARANCE = 0.25
"""|cos| of the middle Cardan angle below which another order is taken; the equations stiffen as its inverse square."""

SCOUT_STEPS = 2000
"""Steps of the run that looks for a gimbal lock ahead."""


class Exudyn:
    """Adapter of Exudyn, forms `maximal`, `pivot` and `tree`."""

    name = "exudyn"
    methods = tuple(ORDERS)
    forms = ("maximal", "pivot", "tree")
    options = frozenset({"form"})
    adaptive_methods: tuple[str, ...] = ()

    def version(self) -> str:
        """Version of Exudyn as installed."""
        return importlib.metadata.version("exudyn")

    def documented_order(self, scene: Scene, spec: RunSpec) -> int:
        """The order in Exudyn's documentation."""
        return ORDERS[spec.method]

    def held_levels(self, scene: Scene, spec: RunSpec) -> frozenset[str]:
        """Maximal: what the index imposes; pivot and tree cannot leave a joint."""
        if self.form(scene, spec) != "maximal":
            return tree.LEVELS
        return frozenset({"velocity" if spec.method == "TrapezoidalIndex2" else "position"})

    def form(self, scene: Scene, spec: RunSpec) -> str:
        """The form that runs: the one asked for, else maximal for implicit methods, pivot for one body, tree."""
        if spec.form is not None:
            return spec.form
        if spec.method in IMPLICIT:
            return "maximal"
        return "pivot" if _turns_about_ground(scene) else "tree"

    def unsupported(self, scene: Scene, spec: RunSpec) -> str | None:
        """Why Exudyn cannot run this, or None."""
        form = self.form(scene, spec)
        implicit = spec.method in IMPLICIT
        if implicit != (form == "maximal"):
            solver = "implicit, built for form maximal" if implicit else "explicit and eliminates no joint constraints"
            return f"{spec.method} is {solver}; form {form} does not go with it"
        if form == "pivot" and not _turns_about_ground(scene):
            return "form pivot is for one body on one spherical joint to the ground"
        if form != "maximal":
            return tree.obstacle(scene, ("spherical",))
        if scene.forces:
            return f"forces of type {scene.forces[0].type} are not built into this adapter; only gravity is"
        odd = next((joint for joint in scene.joints if joint.type != "spherical"), None)
        return None if odd is None else f"joint {odd.name!r}: type {odd.type} is not built; this form has spherical"

    def run(self, scene: Scene, spec: RunSpec) -> RawRun:
        """Integrate; raises `EngineError` with Exudyn's words when it fails."""
        load()
        form = self.form(scene, spec)
        per, h = stepping.fixed_step(scene, spec)
        stats: dict[str, Any] = {}
        build = {"maximal": exudyn_models.maximal, "pivot": exudyn_models.pivot}.get(form)
        if build is None:
            stats["cardan_order"] = order = cardan_order(scene)
            build = functools.partial(exudyn_models.kinematic_tree, order=order)
        every = 1 if spec.monitor else per
        found = solve(functools.partial(build, scene), spec.method, scene.duration, per * (scene.samples - 1), every)
        model, t, data = found.model, found.t, found.data
        if form == "tree":
            stats["gimbal_clearance"] = float(np.abs(np.cos(data[0][:, 1::3])).min())
        if spec.method in IMPLICIT:
            stats["newton_tolerance"] = found.tolerance
            stats["newton_iterations"] = int(found.solver.it.newtonStepsCount)
            stats["factorizations"] = int(found.solver.it.newtonJacobiCount)
        picked = slice(None, None, per // every)
        states = model.convert(scene.t, [part[picked] for part in data])
        if spec.method not in IMPLICIT:
            _drop_unknown_accelerations(states, every)
        maxima = _maxima(scene, model, t, data) if spec.monitor else None
        return RawRun(states, found.wall_time, per * (scene.samples - 1), h, stats=stats, maxima=maxima, form=form)


def _drop_unknown_accelerations(states: States, every: int) -> None:
    """Explicit solvers know no acceleration at t = 0, and later ones only where every step is recorded."""
    if every > 1:
        states.a = states.alpha = None
        return
    for values in (states.a, states.alpha):
        if values is not None:
            values[0] = np.nan


def _maxima(scene: Scene, model: exudyn_models.Model, t: np.ndarray, data: list[np.ndarray]) -> dict[str, float]:
    """Maxima over all steps; the start has no accelerations of its own (see `_drop_unknown_accelerations`)."""
    from crosscheck.trajectory import Monitor

    monitor = Monitor(scene)
    monitor.update(scene.x0[None], scene.R0[None], scene.v0[None], scene.w0[None])
    for start in range(1, len(t), stepping.CHUNK):
        part = slice(start, start + stepping.CHUNK)
        states = model.convert(t[part], [values[part] for values in data])
        monitor.update(states.x, states.R, states.v, states.w, states.a, states.alpha)
    return monitor.maxima()


def _turns_about_ground(scene: Scene) -> bool:
    return (scene.n, len(scene.joints)) == (1, 1) and (
        scene.joints[0].type == "spherical" and GROUND in (scene.joints[0].parent, scene.joints[0].child))


def load() -> Any:
    """Exudyn, imported as its fast build and without a word on the console."""
    sys.exudynFast = True  # type: ignore[attr-defined]
    with contextlib.redirect_stdout(io.StringIO()):
        import exudyn

    exudyn.config.printToConsole = False
    return exudyn


def settings(method: str, duration: float, steps: int, every: int, tolerance: float) -> Any:
    """Simulation settings of a fixed-step run that records every `every`-th step and writes no file.

    `tolerance` is Newton's, of the residual, absolute and relative.
    """
    exudyn = load()
    result = exudyn.SimulationSettings()
    integration = result.timeIntegration
    integration.solverType = getattr(exudyn.DynamicSolverType, method)
    integration.endTime, integration.numberOfSteps = duration, steps
    integration.adaptiveStep = integration.automaticStepSize = False
    integration.verboseMode = integration.verboseModeFile = 0
    integration.newton.relativeTolerance = integration.newton.absoluteTolerance = tolerance
    # DOPRI5 refuses a step by its error estimate even where the step is fixed
    integration.relativeTolerance = integration.absoluteTolerance = 1e100
    integration.generalizedAlpha.spectralRadius = SPECTRAL_RADIUS
    if method == "TrapezoidalIndex2":
        integration.generalizedAlpha.useNewmark = True
        integration.generalizedAlpha.useIndex2Constraints = True
    # a second evaluation after each step, up to half of the cost: only where every step is looked at
    integration.explicit.computeEndOfStepAccelerations = every == 1
    result.solution.file.write = False
    result.solution.sensors.writePeriod = duration / steps * every
    return result


@dataclasses.dataclass
class Solved:
    """A finished run: times at the start and after every recorded step, and the sensors' data there, (T, columns)."""

    model: exudyn_models.Model
    t: np.ndarray
    data: list[np.ndarray]
    wall_time: float  # s, stepping only
    solver: Any
    tolerance: float


def solve(build: Callable[[], exudyn_models.Model], method: str, duration: float, steps: int, every: int) -> Solved:
    """Run a fresh model with the tightest of `NEWTON_TOLERANCES` that converges; explicit methods have one try."""
    *tighter, last = NEWTON_TOLERANCES
    if method in IMPLICIT:
        for tolerance in tighter:
            with contextlib.suppress(EngineError):  # the last tolerance tells what went wrong
                return _attempt(build(), method, duration, steps, every, tolerance)
    return _attempt(build(), method, duration, steps, every, last)


def _attempt(model: exudyn_models.Model, method: str, duration: float, steps: int, every: int,
             tolerance: float) -> Solved:
    exudyn = load()
    options = settings(method, duration, steps, every, tolerance)
    solver = exudyn.MainSolverImplicitSecondOrder() if method in IMPLICIT else exudyn.MainSolverExplicit()
    try:
        model.system.Assemble()
        ready = solver.InitializeSolver(model.system, options)
        start = time.perf_counter()
        solved = ready and solver.SolveSteps(model.system, options)
        wall = time.perf_counter() - start
        solver.FinalizeSolver(model.system, options)
    except exudyn.ExudynError as error:
        words = str(error).split(" [Python file")[0]  # Exudyn appends the path of this very module
        raise EngineError(f"Exudyn {method}: {words}") from error
    if not solved:
        raise EngineError(f"Exudyn {method} stopped at t = {solver.it.currentTime:.6g} s: "
                          f"{solver.GetErrorString().strip() or 'no reason given'}; try a smaller step")
    t = np.linspace(0.0, duration, steps // every + 1)
    return Solved(model, t, _recorded(model, method, t), wall, solver, tolerance)


def _recorded(model: exudyn_models.Model, method: str, t: np.ndarray) -> list[np.ndarray]:
    """What the sensors stored, without the column of times, which has to be `t`."""
    recorded = [np.asarray(model.system.GetSensorStoredData(sensor)) for sensor in model.sensors]
    odd = [data for data in recorded if len(data) != len(t) or np.abs(data[:, 0] - t).max() > 1e-6 * t[1]]
    if odd:
        raise EngineError(f"Exudyn {method}: {len(odd[0])} records where {len(t)} evenly spaced ones were asked for")
    data = [part[:, 1:] for part in recorded]
    stepping.check_finite(method, t, *data)
    return data


def cardan_order(scene: Scene) -> str:
    """A Cardan order whose middle angle stays clear of a quarter turn on this scene.

    Watched on a run in the maximal form, which has no gimbal lock: XYZ where |cos| of every middle angle stays above
    `CLEARANCE`, else the order with the largest clearance.
    """
    from scipy.spatial.transform import Rotation

    build = functools.partial(exudyn_models.maximal, scene)
    try:
        scout = solve(build, "GeneralizedAlpha", scene.duration, SCOUT_STEPS, 1)
    except EngineError:  # too coarse for this scene: nothing learnt, and the run itself will show its clearance
        return PREFERRED_ORDER
    states = scout.model.convert(scout.t, scout.data)
    relative = [states.R[:, link.body] if link.parent == GROUND
                else np.swapaxes(states.R[:, link.parent], 1, 2) @ states.R[:, link.body] for link in tree.links(scene)]
    attitudes = Rotation.from_matrix(np.concatenate(relative))
    orders = ["".join(order) for order in itertools.permutations(PREFERRED_ORDER)]
    clearance = {order: np.abs(np.cos(attitudes.as_euler(order, suppress_warnings=True)[:, 1])).min()
                 for order in orders}
    if clearance[PREFERRED_ORDER] > CLEARANCE:
        return PREFERRED_ORDER
    return max(orders, key=clearance.__getitem__)
