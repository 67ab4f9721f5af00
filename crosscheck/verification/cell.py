"""One cell of the grid, run in a worker: the main run, the order study, the verdict."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from msgspec.structs import replace

from crosscheck import adapters
from crosscheck.adapters.base import RunSpec
from crosscheck.document import LEVELS, Finding, Judged, Level, Measured, Run, extended
from crosscheck.errors import Unsupported
from crosscheck.judge import tolerances
from crosscheck.judge.accelerations import judge_accelerations
from crosscheck.judge.claim import Claim
from crosscheck.judge.continuity import judge_continuity, judge_orthogonality
from crosscheck.judge.defects import MOST_BODIES, Defects, measured
from crosscheck.judge.intervals import judge_intervals, judge_noise, judge_windows, unjudged
from crosscheck.judge.metrics import Error, errors
from crosscheck.judge.overrides import override
from crosscheck.judge.verdict import (
    judge_invariants,
    judge_levels,
    judge_practical,
    judge_states,
    judge_without_truth,
    settle,
)
from crosscheck.references import TruthError, truth
from crosscheck.references.base import Reference
from crosscheck.running.attempt import Failed, Ran, Refused, attempt, lasting
from crosscheck.running.provenance import NOT_INSTALLED, engine_version
from crosscheck.running.trajectory import Trajectory
from crosscheck.scene import mechanics
from crosscheck.scene.file import load_scene
from crosscheck.scene.model import Scene
from crosscheck.verification.curves import run_curves
from crosscheck.verification.order_study import order_study
from crosscheck.verification.task import Cell, load, windowed

ENDED = "a run has to reach its end"


def run_cell(cell: Cell) -> Judged:
    """Run and judge one cell. A failing run gets a verdict, too."""
    version = engine_version(cell.engine)
    run = Run(scene=cell.scene, engine=cell.engine, version=version, method=cell.method, form=cell.form,
              practical=cell.practical)
    if version == NOT_INSTALLED:
        return _refused(run, NOT_INSTALLED)
    scene = load(cell.scene, cell.plan, cell.whole)
    engine = adapters.get(cell.engine)
    order = engine.documented_order(scene, RunSpec(cell.method, step=cell.plan.step(1), form=cell.form))
    step = None if order is None else cell.plan.practical if cell.practical else cell.plan.step(order)
    rtol = cell.plan.rtol if order is None else None
    spec = RunSpec(cell.method, step=step, rtol=rtol, form=cell.form, coordinate_map=cell.coordinate_map)
    run = replace(run, step=step, rtol=rtol, documented_order=order, coordinate_map=cell.coordinate_map,
                  command=cell.command(step, rtol))
    reason = engine.unsupported(scene, spec)
    if reason is not None:
        return _refused(run, reason)
    outcome = lasting(attempt(scene, run.engine, run.method, run.step, run.rtol, form=run.form,
                      coordinate_map=run.coordinate_map))
    if isinstance(outcome, Refused):
        return replace(_refused(run, outcome.why), duration=scene.duration)
    held = engine.held_levels(scene, spec)
    if cell.no_truth:
        return _without_truth(run, cell, scene, outcome, held)
    reference, window = truth(scene), truth(windowed(scene, cell.plan.window))
    if isinstance(outcome, Failed):
        main = _no_main_run(run, scene, outcome)
    else:
        traj = outcome.trajectory
        more = companions(run, scene, traj, {"coordinate_map": run.coordinate_map})
        main = _main_run(run, scene, [traj, *more], reference, window, held, cell.plan.budgeted)
    if not cell.study:
        return settled(main.run, override(main.findings, cell.overrides), main.message, main.until)
    brief = windowed(load_scene(cell.scene), cell.plan.window)  # the whole window, even if the main run is shorter
    study = order_study(cell, order, brief, truth(brief), main.findings, isinstance(outcome, Failed))
    measured = replace(main.run, orders=study.orders, ladder=study.ladder, ladder_cut=study.cut)
    if study.refused:
        return extended(Judged, measured, outcome="unsupported", message=study.refused, findings=main.findings,
                        judged_until=main.until)
    findings = override([*main.findings, *study.findings], cell.overrides)
    return settled(measured, findings, study.message or main.message, main.until)


FIRST = 1.0
"""A single run is judged over this time (s) from its start if no bound reaches over its whole length."""


def settled(run: Measured, findings: list[Finding], message: str = "", until: float | None = None) -> Judged:
    """`settle` with the known defects of the engine that are about this run."""
    return settle(run, findings, adapters.get(run.engine).defects(run), message, until)


def judge_run(run: Run, scene: Scene, traj: Trajectory, held: frozenset[str], first: float = FIRST,
              **options: Any) -> Judged:
    """The verdict on one run without an order study. If its step is too coarse for bounds, its energy is judged, too.

    If no bound reaches over the whole run, the `first` seconds are judged. `options` are those of the run: the engine
    is run with them at other steps, too.
    """
    try:
        if scene.n > MOST_BODIES:
            raise Unsupported("the truth of so many bodies takes minutes")
        reference, window = truth(scene), truth(windowed(scene, first))
    except (TruthError, Unsupported) as error:
        maxima = traj.maxima
        findings = [judge_without_truth(scene, traj), *judge_levels(scene, traj, None, None, held, maxima,
                                                                         adapters.get(run.engine).eps),
                    _orthogonality(run, [traj])]
        judged = settled(_measured(run, scene, traj, None, {}, held, maxima), findings)
        return judged if judged.outcome != "pass" else replace(
            judged, outcome="unjudged", message=f"no truth: {' '.join(str(error).split())}")
    main = _main_run(run, scene, [traj, *companions(run, scene, traj, options)], reference, window, held,
                     budgeted=True)
    coarse = any(finding.kind == "step" for finding in main.findings)
    findings = [*main.findings, *([judge_practical(scene, traj, reference)] if coarse else [])]
    return settled(main.run, findings, main.message, main.until)


@dataclasses.dataclass(frozen=True)
class _Main:
    """A main run: its measured values, the findings, and the end of the judged time."""

    run: Measured
    findings: list[Finding]
    until: float | None = None  # s
    message: str = ""


def _refused(run: Run, reason: str) -> Judged:
    return extended(Judged, run, outcome="unsupported", message=reason)


def _no_main_run(run: Run, scene: Scene, failed: Failed) -> _Main:
    return _Main(extended(Measured, run, duration=scene.duration, status="failed"),
                 [Finding("run", "fail", None, None, "", ENDED, failed.why)], message=failed.why)


def companions(run: Run, scene: Scene, traj: Trajectory, options: Mapping[str, Any]) -> list[Trajectory]:
    """The same run at other steps, from which its error at vanishing steps is extrapolated. Coarser steps are cheaper.

    For order 1 there are two such runs, because the states of first-order runs differ so much that it affects their
    defects.
    """
    step, order = traj.stats.get("step"), run.documented_order
    if order is None or not step or run.practical or not np.isfinite(traj.x).all():
        return []
    count = round(float(traj.t[1] - traj.t[0]) / step)
    counts = [count // 2, count // 4] if count >= 4 else [2 * count, 4 * count]
    outcomes = (lasting(attempt(scene, run.engine, run.method, float(traj.t[1] - traj.t[0]) / each, form=run.form,
                        monitor=False, **options)) for each in counts[:2 if order == 1 else 1])
    return [each.trajectory for each in outcomes if isinstance(each, Ran)]


def _main_run(run: Run, scene: Scene, trajectories: Sequence[Trajectory], reference: Reference, window: Reference,
              held: frozenset[str], budgeted: bool) -> _Main:
    """Judge the first trajectory. The others are the same run at other steps."""
    traj = trajectories[0]
    maxima, runs = traj.maxima, list[Defects]()
    if run.practical:
        bounds, found = None, errors(scene, traj, reference.states)
        findings = [judge_practical(scene, traj, reference)]
        findings += [Finding(name, "unjudged", error.max, None, error.unit, "the step is too coarse for a bound",
                             f"body {error.body}, t = {error.time:.4g} s") for name, error in found.items()]
    else:
        left = tolerances.newton_left(scene, reference, traj.stats.get("newton_left", 0.0))
        claim = Claim(run.documented_order, traj.stats.get("step") or run.step, run.rtol, adapters.get(run.engine).eps,
                      newton=left)
        findings, found, bounds = judge_states(scene, traj, reference, window, claim, budgeted)
        findings += judge_invariants(scene, traj, reference, bounds)
        if not np.isfinite(traj.x).all():
            findings += unjudged("the run is not finite")
        else:
            try:
                runs = measured(scene, traj, trajectories[1:], reference, claim)
                findings += [*judge_intervals(scene, traj, runs), *judge_noise(runs), *judge_windows(runs)]
                findings += judge_accelerations(scene, trajectories, runs)
            except np.linalg.LinAlgError:
                findings.append(Finding("interval velocity", "fail", np.inf, None, "m/s", "the equations of motion "
                                        "have no solution along the true motion from the run's own states"))
    levels = judge_levels(scene, traj, reference, bounds, held, maxima, adapters.get(run.engine).eps,
                          runs[0] if runs else None)
    return _Main(_measured(run, scene, traj, reference, found, held, maxima),
                 [Finding("run", "ok", None, None, "", ENDED), *findings, *levels,
                  *judge_continuity(scene, traj, reference, adapters.get(run.engine).eps),
                  _orthogonality(run, trajectories)],
                 None if bounds is None else bounds.until)


def _without_truth(run: Run, cell: Cell, scene: Scene, outcome: Ran | Failed,
                   held: frozenset[str]) -> Judged:
    """Judge what needs no truth: energy, held constraint levels, orthogonality."""
    if isinstance(outcome, Failed):
        main = _no_main_run(run, scene, outcome)
    else:
        traj, maxima = outcome.trajectory, outcome.trajectory.maxima
        main = _Main(_measured(run, scene, traj, None, {}, held, maxima),
                     [Finding("run", "ok", None, None, "", ENDED), judge_without_truth(scene, traj),
                      *judge_levels(scene, traj, None, None, held, maxima, adapters.get(run.engine).eps),
                      _orthogonality(run, [traj])])
    judged = settled(main.run, override(main.findings, cell.overrides), main.message)
    if judged.outcome != "pass":
        return judged
    return replace(judged, outcome="unjudged", message=f"unjudged: no truth ({cell.no_truth})")


def _orthogonality(run: Run, trajectories: Sequence[Trajectory]) -> Finding:
    engine = adapters.get(run.engine)
    return judge_orthogonality(trajectories, engine.on_group, engine.eps, run.documented_order)


def _most(series: np.ndarray, every_step: float | None) -> float:
    return max(float(series.max()), every_step or 0.0)


def _energy_error(scene: Scene, traj: Trajectory, reference: Reference | None, size: float,
                  maxima: Mapping[str, float]) -> float:
    """The largest |E(t) - E(0) - work| over `size`: over every step if nothing does work, else at the samples.

    If there is truth, the work is that of the true motion.
    """
    if not scene.worked_on:
        return max(float(np.abs(traj.energy - traj.energy[0]).max() / size), maxima.get("energy_error", 0.0))
    expected = traj.energy[0] + traj.work if reference is None else mechanics.energy(scene, reference.states)
    return float(np.abs(traj.energy - expected).max() / size)


def _measured(run: Run, scene: Scene, traj: Trajectory, reference: Reference | None, found: Mapping[str, Error],
              held: frozenset[str], maxima: Mapping[str, float]) -> Measured:
    """The measured values of a run."""
    size = (float(mechanics.kinetic_energy(scene, traj).max()) or 1.0 if reference is None else
            tolerances.scales(scene, reference).kinetic)
    levels = {}
    for level, unit in LEVELS.items():
        series = getattr(traj, f"constraint_{level}")
        most = None if series is None else _most(series, maxima.get(f"constraint_{level}"))
        levels[level] = Level(max=most, held=level in held, unit=unit)
    momentum = None if reference is None else float(np.abs(
        traj.momentum_vertical - mechanics.momentum_vertical(scene, reference.states)).max())
    energy_error, start = _energy_error(scene, traj, reference, size, maxima), abs(float(traj.energy[0]))
    # The maximum over every step is relative to the run's own kinetic energy.
    gap = energy_error * size if scene.worked_on else max(float(np.abs(traj.energy - traj.energy[0]).max()),
                                                          maxima.get("energy_error", 0.0) * traj.kinetic_energy.max())
    return extended(
        Measured, replace(run, form=traj.form or run.form), status=traj.status, duration=scene.duration,
        errors={name: error.figures for name, error in found.items()}, levels=levels,
        energy_error=energy_error, energy_error_by_start=float(gap / start) if start else None,
        momentum_error=momentum, orthogonality=_most(traj.orthogonality, maxima.get("orthogonality")),
        steps=int(traj.steps), wall_time=float(traj.wall_time), us_per_step=1e6 * traj.wall_time / max(1, traj.steps),
        seconds_per_second=traj.wall_time / scene.duration, curves=run_curves(scene, traj, found, reference))
