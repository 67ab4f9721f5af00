"""One cell of the grid, run in a worker: the run, and its verdict by solution verification."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from msgspec.structs import replace

from crosscheck import adapters
from crosscheck.adapters.base import RunSpec, steps_per_sample
from crosscheck.adapters.common.known import defects
from crosscheck.compare.errors import Error, energy_gap, errors, of_sensors
from crosscheck.compare.sizes import sizes as sizes_of
from crosscheck.document import LEVELS, Finding, Level, Record, Way, extended
from crosscheck.errors import Unsupported, said
from crosscheck.judge.crossings import corrected_at_impacts
from crosscheck.judge.overrides import Overrides, tolerated
from crosscheck.judge.verdict import covered, with_outcome, worded
from crosscheck.references import TruthError, truth
from crosscheck.references.base import Reference, ending
from crosscheck.running.attempt import Failed, Refused, attempt, lasting
from crosscheck.running.provenance import NOT_INSTALLED, engine_version
from crosscheck.running.trajectory import Trajectory
from crosscheck.scene import mechanics
from crosscheck.scene.model import Scene
from crosscheck.scene.states import Motion
from crosscheck.verification import solution
from crosscheck.verification.curves import run_curves
from crosscheck.verification.promises import judge_asked, judge_promises
from crosscheck.verification.questions import own_states
from crosscheck.verification.task import Cell, load

MANY = 16
"""Most bodies of a single run that is judged by itself: the truth of more takes minutes."""


def run_cell(cell: Cell) -> Record:
    """Run and judge one cell. A failing run gets a verdict, too."""
    way, plan = cell.way, cell.plan
    version = engine_version(way.engine)
    run = extended(Record, way, scene=cell.scene, version=version)
    if version == NOT_INSTALLED:
        return replace(run, outcome="unsupported", message=NOT_INSTALLED)
    scene = load(cell.scene, plan)
    engine = adapters.get(way.engine)
    order = engine.documented_order(scene, RunSpec(way.method, step=plan.step(1), form=way.form))
    way = replace(way, step=None if order is None else plan.step(order), rtol=plan.rtol if order is None else None)
    spec = RunSpec(way.method, **way.arguments)
    run = replace(run, step=way.step, rtol=way.rtol, documented_order=order, duration=scene.duration,
                  command=cell.command(way, scene.interval))
    reason = engine.unsupported(scene, spec)
    if reason is not None:
        return replace(run, outcome="unsupported", message=reason)
    outcome = lasting(attempt(scene, way))
    if isinstance(outcome, Refused):
        return replace(run, outcome="unsupported", message=outcome.why)
    if isinstance(outcome, Failed):
        return with_outcome(replace(run, status="failed"), [Finding.ended_early(outcome.why)],
                      defects(engine, run), outcome.why, cell.as_planned)
    reference = None if cell.no_truth else truth(scene)
    made = judged(run, scene, outcome.trajectory, engine.held_levels(scene, spec), reference, cell.no_truth,
                  cell.overrides, cell.as_planned)
    return made if plan.ends is None or made.share is None else covered(
        made, plan.covered, plan.ends[0], ending(*plan.ends))


def judge_alone(name: str, traj: Trajectory, engine: str, *, step: float | None = None, rtol: float | None = None,
                need: float = 1.0, **given: Any) -> Record | None:
    """The verdict on a run of a scene called `name` by itself; `given` are further arguments of `crosscheck.run`.

    `need` is the share of its time over which the motion has to be judged for it to pass.

    None if there is neither a step (s) nor a relative tolerance by which to judge.
    """
    adapter, used = adapters.get(engine), step or traj.stats.get("step")
    spec = RunSpec(traj.method, step=used if rtol is None else None, rtol=rtol, form=given.get("form"))
    order = adapter.documented_order(traj.scene, spec)
    if rtol is None and (order is None or used is None):
        return None
    more = {key: value for key, value in given.items() if key not in ("samples", "duration")}
    way = Way.of(engine, traj.method, used if rtol is None else None, rtol, **(more | {"form": traj.form}))
    asked = extended(Record, way, scene=name, version=engine_version(engine),
                     documented_order=order if rtol is None else None)
    return worded(judge_run(asked, traj.scene, traj, adapter.held_levels(traj.scene, spec)), need)


def judge_run(run: Record, scene: Scene, traj: Trajectory, held: frozenset[str]) -> Record:
    """The verdict on one run of a scene that need not be in a file. The engine is run in the same way again."""
    try:
        if scene.n > MANY:
            raise Unsupported("the truth of so many bodies takes minutes")
        return judged(run, scene, traj, held, truth(scene), planned=False)
    except (TruthError, Unsupported) as error:
        return judged(run, scene, traj, held, None, said(error), planned=False)


def judged(run: Record, scene: Scene, traj: Trajectory, held: frozenset[str], reference: Reference | None,
           no_truth: str = "", overrides: Overrides = (), planned: bool = True) -> Record:
    """The record of a run with its measured values and its verdict.

    Parameters
    ----------
    held : constraint levels that the method satisfies by construction
    reference : truth, or None because of `no_truth`
    overrides : tolerances of the user
    planned : whether it was run as the library plans it, so that known defects have to show
    """
    engine = adapters.get(run.engine)
    known = defects(engine, run)
    found = solution.judge(run, scene, traj, reference, no_truth, known)
    per, step = (0, 0.0) if run.step is None else steps_per_sample(scene, run.step)
    own = traj if reference is None else corrected_at_impacts(scene, traj, reference, step)
    missed = {} if reference is None else errors(scene, own, reference.states, reference.horizon) | of_sensors(
        scene, traj.sensors, reference.states, reference.horizon)
    size = sizes_of(scene, own_states(traj) if reference is None else reference.states)
    findings = [*judge_asked(run, scene, traj, per, step), *found.findings, *judge_promises(
        scene, traj, held, size, found.eps, max(found.iteration, traj.stats.get("newton_left", 0.0)), engine.on_group)]
    shares = {name: each for name, each in found.shares.items() if name}
    made = replace(
        _measured(run, scene, traj, own, reference, missed, held, size), step=step or None, share=found.share,
        shares=shares, resolution=found.visible, asked_steps=found.cost, ladder=found.ladder, not_judged=found.why,
        order=found.order)
    asked, more = tolerated(overrides, made, None if reference is None else reference.horizon)
    made = replace(made, shares=shares | more)
    if reference is not None and reference.horizon < scene.duration * (1 - 1e-12):
        made = replace(made, truth_ends=reference.horizon)
        if min(more.values(), default=1.0) < 1.0:
            why = ending(reference.horizon, reference.horizon_cause)
            made = replace(made, not_judged=found.why or why)
            asked.append(Finding.truth_ends(reference.horizon, why))
    return with_outcome(made, findings + asked, known, planned=planned)


def _measured(run: Record, scene: Scene, traj: Trajectory, own: Motion, reference: Reference | None,
              missed: Mapping[str, Error], held: frozenset[str], sizes: Mapping[str, float]) -> Record:
    """The measured values of a run; `own`: its states as they are compared with truth; `sizes` of its quantities."""
    exact, maxima = None if reference is None else reference.states.until(reference.horizon), traj.maxima
    gap = energy_gap(scene, own, exact, maxima, lambda: traj.work)
    kinetic = float(np.nanmax(mechanics.kinetic_energy(scene, traj if exact is None else exact), initial=0.0)) or 1.0
    levels = {}
    for level, unit in LEVELS.items():
        series = getattr(traj, f"constraint_{level}")
        most = None if series is None else _most(series, maxima.get(f"constraint_{level}"))
        levels[level] = Level(max=most, held=level in held, unit=unit)
    momentum = None if exact is None else float(np.nanmax(np.abs(
        traj.momentum_vertical - mechanics.momentum_vertical(scene, exact))))
    start, softness = abs(float(traj.energy[0])), traj.stats.get("softness", "default")
    return replace(
        run, form=traj.form or run.form, status=traj.status, duration=scene.duration,
        assumed=f"softness={softness}" if softness not in ("default", run.arguments.get("softness")) else "",
        errors={name: replace(error.figures, size=sizes.get(name)) for name, error in missed.items()},
        levels=levels,
        energy_error=None if math.isnan(gap) else gap / kinetic,
        energy_error_by_start=float(gap / start) if start and not math.isnan(gap) else None,
        momentum_error=momentum, orthogonality=_most(traj.orthogonality, maxima.get("orthogonality")),
        steps=int(traj.steps), wall_time=float(traj.wall_time), us_per_step=1e6 * traj.wall_time / max(1, traj.steps),
        seconds_per_second=traj.wall_time / scene.duration, curves=run_curves(scene, traj, missed, reference))


def _most(series: np.ndarray, every_step: float | None) -> float:
    return max(float(np.nanmax(series, initial=0.0)), every_step or 0.0)
