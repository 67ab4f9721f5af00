"""One cell of the grid, run in a worker: the main run, the order study, the verdict."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from msgspec.structs import replace

from crosscheck import adapters
from crosscheck.adapters.base import RunSpec, steps_per_sample
from crosscheck.compare.sizes import sizes as sizes_of
from crosscheck.document import LEVELS, QUANTITIES, Finding, Level, Record, Way, extended
from crosscheck.errors import Unsupported
from crosscheck.judge import tolerances
from crosscheck.judge.accelerations import judge_accelerations
from crosscheck.judge.claim import Claim
from crosscheck.judge.continuity import judge_continuity, judge_orthogonality
from crosscheck.judge.defects import MOST_BODIES, SHARE, Defects, measured
from crosscheck.judge.flow import Answer
from crosscheck.judge.intervals import FINER, judge_between, judge_intervals, judge_noise, judge_windows, unresolved
from crosscheck.judge.intervals import Judged as Covered
from crosscheck.judge.metrics import Error, energy_gap, errors, up_to
from crosscheck.judge.overrides import override
from crosscheck.judge.repeats import judge_axes, judge_repeat, seen_eps, shown_floor
from crosscheck.judge.sensors import judge_sensors
from crosscheck.judge.substeps import MORE
from crosscheck.judge.vanishing import within
from crosscheck.judge.verdict import (
    SINGLE,
    judge_coarse,
    judge_invariants,
    judge_levels,
    judge_rest,
    judge_states,
    judge_without_truth,
    settle,
    too_coarse,
)
from crosscheck.references import TruthError, truth
from crosscheck.references.base import Reference
from crosscheck.running.attempt import Failed, Ran, Refused, attempt, lasting
from crosscheck.running.provenance import NOT_INSTALLED, engine_version
from crosscheck.running.trajectory import Trajectory
from crosscheck.scene import mechanics
from crosscheck.scene.file import load_scene
from crosscheck.scene.model import Scene
from crosscheck.verification import solution
from crosscheck.verification.again import Asked
from crosscheck.verification.curves import run_curves
from crosscheck.verification.order_study import order_study
from crosscheck.verification.task import Cell, load, windowed

ENDED = "a run has to reach its end"


def run_cell(cell: Cell, by_solution: bool = False) -> Record:
    """Run and judge one cell. A failing run gets a verdict, too.

    `by_solution`: the main run is judged by solution verification.
    """
    way, plan = cell.way, cell.plan
    version = engine_version(way.engine)
    run = extended(Record, way, scene=cell.scene, version=version)
    if version == NOT_INSTALLED:
        return replace(run, outcome="unsupported", message=NOT_INSTALLED)
    scene = load(cell.scene, plan, cell.whole)
    engine = adapters.get(way.engine)
    order = engine.documented_order(scene, RunSpec(way.method, step=plan.step(1), form=way.form))
    way = replace(way, step=None if order is None else plan.step(order), rtol=plan.rtol if order is None else None)
    spec = RunSpec(way.method, **way.arguments)
    run = replace(run, step=way.step, rtol=way.rtol, documented_order=order, command=cell.command(way))
    reason = engine.unsupported(scene, spec)
    if reason is not None:
        return replace(run, outcome="unsupported", message=reason)
    outcome = lasting(attempt(scene, way))
    if isinstance(outcome, Refused):
        return replace(run, outcome="unsupported", message=outcome.why, duration=scene.duration)
    held = engine.held_levels(scene, spec)
    if cell.no_truth:
        return _without_truth(run, cell, scene, outcome, held)
    reference, window = truth(scene), truth(windowed(scene, plan.window))
    if isinstance(outcome, Failed):
        main = _no_main_run(run, scene, outcome)
    else:
        traj = outcome.trajectory
        main = _by_solution(run, scene, traj, reference, held) if by_solution else _main_run(
            Asked(run, scene, traj), reference, window, held, plan.budgeted)
    if not cell.study:
        return settled(main.run, override(main.findings, cell.overrides, main.whole), main.message,
                       main.judged, main.why, main.whole, cell.as_planned)
    brief = windowed(load_scene(cell.scene), plan.window)  # the whole window, even if the main run is shorter
    study = order_study(cell, order, brief, truth(brief), main.findings, isinstance(outcome, Failed))
    measured = replace(main.run, orders=study.orders, ladder=study.ladder, ladder_cut=study.cut)
    if study.refused:
        return replace(measured, outcome="unsupported", message=study.refused, findings=main.findings,
                       judged_until=main.judged)
    findings = override([*main.findings, *study.findings], cell.overrides, main.whole)
    return settled(measured, findings, study.message or main.message, main.judged,
                   main.why, main.whole, cell.as_planned)


FIRST = 1.0
"""A single run is judged over this time (s) from its start if no bound reaches over its whole length."""


def settled(run: Record, findings: list[Finding], message: str = "", judged: float | None = None, why: str = "",
            whole: Mapping[str, tuple[float, str]] | None = None, planned: bool = True) -> Record:
    """`settle` with the known defects of the engine that are about this run; only if `planned` one has to show."""
    defects = adapters.get(run.engine).defects(run)
    return settle(run, findings, defects if planned else [dataclasses.replace(each, always=False) for each in defects],
                  message, judged, why, whole)


def judge_alone(name: str, traj: Trajectory, engine: str, *, step: float | None = None, rtol: float | None = None,
                **given: Any) -> Record | None:
    """The verdict on a run of a scene called `name` by itself; `given` are further arguments of `crosscheck.run`.

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
    return judge_run(asked, traj.scene, traj, adapter.held_levels(traj.scene, spec))


def judge_run(run: Record, scene: Scene, traj: Trajectory, held: frozenset[str], first: float = FIRST,
              by_solution: bool = False) -> Record:
    """The verdict on one run without an order study. If its step is too coarse for bounds, its energy is judged, too.

    `by_solution` as of `run_cell`. If no bound reaches over the whole run, the `first` seconds are judged. The engine
    is run in the same way at other steps, too.
    """
    try:
        if scene.n > MOST_BODIES:
            raise Unsupported("the truth of so many bodies takes minutes")
        reference, window = truth(scene), truth(windowed(scene, first))
    except (TruthError, Unsupported) as error:
        main = _truthless(run, scene, traj, held)
        return settled(main.run, [_no_truth(" ".join(str(error).split())), *main.findings])
    main = _by_solution(run, scene, traj, reference, held) if by_solution else _main_run(
        Asked(run, scene, traj), reference, window, held, budgeted=True)
    coarse = any(finding.kind == "step" for finding in main.findings)
    findings = [*main.findings, *([judge_coarse(scene, traj, reference)] if coarse else [])]
    return settled(main.run, findings, main.message, main.judged, main.why, main.whole)


@dataclasses.dataclass(frozen=True)
class _Main:
    """A main run: its measured values, the findings, for how long its motion was judged, and why not longer."""

    run: Record
    findings: list[Finding]
    judged: float | None = None  # s
    why: str = ""
    message: str = ""
    whole: Mapping[str, tuple[float, str]] = dataclasses.field(default_factory=dict)  # see `override`


def _no_main_run(run: Record, scene: Scene, failed: Failed) -> _Main:
    return _Main(replace(run, duration=scene.duration, status="failed"),
                 [Finding("run", "fail", None, None, "", ENDED, failed.why)], message=failed.why)


@dataclasses.dataclass(frozen=True)
class _Seen:
    """What intervals of a run and its parts show."""

    eps: float  # spacing of the engine's numbers, as far as the run shows it
    findings: list[Finding]
    runs: list[Defects]  # of the run and, at other steps, of its parts
    others: list[Answer]
    covered: Covered


@dataclasses.dataclass(frozen=True)
class _Beside:
    """Runs of one engine beside each other, the run itself first: by which of them each finding is told."""

    runs: list[Defects]  # at other steps: intervals, noise, orders of windows
    others: list[Answer]  # the answers of all `runs` but the first
    ended: list[Defects]  # instead, in intervals, of an engine that only interpolates badly
    apart: list[Defects]  # from states of the run, of an engine that prefers axes: intervals once more
    settled: list[Defects]  # from the scene's start: accelerations
    courses: list[Answer]  # the answers of all `settled` but the first
    told: list[Finding]  # by the repeat and what it says of the others


def _intervals(asked: Asked, traj: Trajectory, reference: Reference) -> _Seen:
    """Judge the intervals of a run, and what the engine does when it is started again at states of its own."""
    run, scene, scale = asked.run, asked.scene, tolerances.scales(asked.scene, reference)
    nothing = Covered(np.zeros(len(traj.t) - 1, bool))
    engine = adapters.get(run.engine)
    if not np.isfinite(traj.x).all():
        return _Seen(tolerances.EPS, unresolved("the run is not finite"), [], [], nothing)
    again = asked.repeat(scale.length)
    soft = engine.soft_laws and any(any(joint.dry_friction) or any(joint.limits) for joint in scene.joints)
    eps = max(tolerances.EPS, min(engine.eps, SINGLE))
    if eps > tolerances.EPS and not isinstance(again, str):
        eps = seen_eps(traj, again, {name: scale.of(name) for name in QUANTITIES}, engine.eps, SINGLE)
    try:
        beside = _beside(asked, traj, reference, again, eps, soft)
        intervals, covered = judge_intervals(scene, traj, beside.ended or beside.runs, beside.apart)
        left = tolerances.newton_left(scene, reference, traj.stats.get("newton_left", 0.0))
        findings = [*intervals, *judge_noise(beside.runs, left), *judge_windows(beside.runs)]
        findings += judge_accelerations(scene, [traj, *(each.traj for each in beside.courses)], beside.settled, soft)
        return _Seen(eps, [*findings, *beside.told], beside.runs, beside.others, covered)
    except np.linalg.LinAlgError:
        return _Seen(eps, [Finding("interval velocity", "fail", np.inf, None, "m/s", "the equations of motion have no "
                                   "solution along the true motion from the run's own states")], [], [], nothing)


def _beside(asked: Asked, traj: Trajectory, reference: Reference, again: Answer | str, eps: float, soft: bool
            ) -> _Beside:
    """The runs beside the one that is judged, from what it answers `again` elsewhere."""
    scene, engine = asked.scene, adapters.get(asked.run.engine)
    claim = Claim(asked.run.documented_order, _asked_step(asked.run, scene), asked.run.rtol, eps)
    # A part that begins with open joints, or with guessed memories, is not nearer to the motion at a finer step.
    whole = (isinstance(again, str) or again.closed or asked.guessed or engine.prefers_axes(scene, traj.form)
             or float(traj.constraint_position.max()) > SHARE * tolerances.scales(scene, reference).length)
    others = asked.companions(whole)
    runs = measured(scene, traj, others, reference, claim)
    ended, between, off = _ended_everywhere(asked, runs[0], reference)
    if isinstance(again, str):
        why = f"the engine could not be started at states of its own run: {again}"
        kind = "repeat" if eps <= tolerances.EPS else "precision"
        return _Beside(runs, others, ended, [], runs, others,
                       [Finding(kind, "unresolved", None, None, "", why), *between])
    (told, forgets), share = judge_repeat(traj, again, runs[0], soft, off), shown_floor(traj, again, runs[0])
    own, *rest = runs = [dataclasses.replace(each, forgets=forgets, floor={
        name: share * part for name, part in each.floor.items()}) for each in runs]
    if whole or forgets:
        return _Beside(runs, others, ended, [], runs, others, [*told, *between])
    # Accelerations of its own have not settled after a part, if the engine remembers more than the state.
    courses = asked.companions(True)
    settled = [own, *measured(scene, traj, courses, reference, claim, own)]
    axes = _axes(asked, again, own)
    if not axes:
        return _Beside(runs, others, ended, [], settled, courses, [*told, *between])
    # Parts have other errors, since their axes are others: each is compared with parts at the run's step.
    same = asked.parts(claim.step) if claim.step else ""
    apart = [] if isinstance(same, str) else [*measured(scene, traj, [same], reference, claim, own), *rest]
    return _Beside(settled, courses, ended, apart, settled, courses, [*told, *axes, *between])


def _ended_everywhere(asked: Asked, own: Defects, reference: Reference
                      ) -> tuple[list[Defects], list[Finding], float]:
    """Of an adaptive run that errs between its steps only: what it misses where it ends at every sample, the finding on
    that, and the largest error between them, in y; nothing, nothing and 0 of any other run."""
    rtol, scene = own.claim.rtol, asked.scene
    if own.claim.fixed is not None or rtol is None or len(own.flow.index) < len(asked.traj.t) - 1 or within(own).all():
        return [], [], 0.0
    ended, finer = asked.parts(None, ends=True), asked.whole(None, rtol / FINER)
    if isinstance(ended, str) or isinstance(finer, str):
        return [], [], 0.0
    claims = own.claim, dataclasses.replace(own.claim, rtol=rtol / FINER)
    between = [measured(scene, asked.traj, [each], reference, claim, own)[0]
               for each, claim in zip((ended, finer), claims, strict=True)]
    findings, off = judge_between(own, *between)
    return between[:1] if findings else [], findings, off


def _axes(asked: Asked, again: Answer | str, own: Defects) -> list[Finding]:
    """The finding on an engine that prefers axes of the world; none where that does not show."""
    if isinstance(again, str) or not again.turned or len(own.flow.index) < len(asked.traj.t) - 1:
        return []
    plain = asked.repeat(own.scale.length, turned=False)
    return [] if isinstance(plain, str) else judge_axes(again, plain, own)


def _main_run(asked: Asked, reference: Reference, window: Reference, held: frozenset[str], budgeted: bool) -> _Main:
    """Judge a run by what the engine answers about it."""
    run, scene, traj = asked.run, asked.scene, asked.traj
    if run.rtol is not None:
        steps = tolerances.most_steps(scene, reference, run.rtol, len(traj.t), traj.steps,
                                      adapters.get(run.engine).orders.get(run.method))
        traj = dataclasses.replace(traj, steps=steps)
    seen = _intervals(asked, traj, reference)
    claim = Claim(run.documented_order, _asked_step(run, scene), run.rtol, seen.eps)
    findings, missed, bounds = judge_states(scene, traj, reference, window, claim)
    findings += [*judge_invariants(scene, traj, reference, bounds), *seen.findings]
    read, by_sensor = judge_sensors(
        scene, traj, reference, bounds.until, bounds.states, claim, bool(bounds.empty & set(QUANTITIES)),
        seen.runs[0] if seen.runs else None, adapters.get(run.engine).misreads)
    findings, missed = findings + read, missed | by_sensor
    judged = scene.duration * seen.covered.over(traj.t, bounds.reach)
    findings += [] if judged else [too_coarse(claim, budgeted)]
    levels = judge_levels(scene, traj, reference, bounds, held, traj.maxima, seen.eps,
                          seen.runs[0] if seen.runs else None)
    return _Main(_measured(run, scene, asked.traj, reference, missed, held, traj.maxima),
                 [_ended(traj), *judge_rest(scene, reference), *_steps(run, scene, traj), *findings, *levels,
                  *judge_continuity(scene, traj, reference, seen.eps),
                  _orthogonality(run, traj, seen.eps, seen.others)], judged, seen.covered.why,
                 whole=_over_truth(scene, traj, reference, missed))


def _by_solution(run: Record, scene: Scene, traj: Trajectory, reference: Reference, held: frozenset[str]) -> _Main:
    """Judge a run by solution verification, and by what it promises and was asked."""
    found = solution.judge(run, scene, traj, held, reference)
    eps = max(tolerances.EPS, min(adapters.get(run.engine).eps, SINGLE))
    missed = errors(scene, traj, reference.states, reference.horizon)
    levels = judge_levels(scene, traj, None, None, held, traj.maxima, eps)
    return _Main(_measured(run, scene, traj, reference, missed, held, traj.maxima),
                 [_ended(traj), *_steps(run, scene, traj), *found.findings, *levels, _orthogonality(run, traj, eps)],
                 found.share * scene.duration, found.why, whole=_over_truth(scene, traj, reference, missed))


def _over_truth(scene: Scene, traj: Trajectory, reference: Reference, sensors: Mapping[str, Error]
                ) -> dict[str, tuple[float, str]]:
    """The largest errors over all of the time for which there is truth, and where they are."""
    until = f"up to {min(reference.horizon, scene.duration):g} s, as far as truth reaches"
    largest = {name: (error.max, f"body {error.body}, t = {error.time:.4g} s, {until}")
               for name, error in errors(scene, traj, reference.states, reference.horizon).items()}
    keep = up_to(reference.t, reference.horizon)
    largest |= {kind: (float(error.series[keep].max()), f"{error.body}, {until}") for kind, error in sensors.items()
                if kind.startswith("sensor ")}
    for name, own, true, size in (
            ("energy", traj.energy, mechanics.energy(scene, reference.states),
             tolerances.scales(scene, reference).kinetic),
            ("momentum", traj.momentum_vertical, mechanics.momentum_vertical(scene, reference.states), 1.0)):
        largest[name] = float(np.abs(own - true)[keep].max() / size), until
    return largest


def _without_truth(run: Record, cell: Cell, scene: Scene, outcome: Ran | Failed, held: frozenset[str]) -> Record:
    """Judge what needs no truth: energy, held constraint levels, orthogonality."""
    if isinstance(outcome, Failed):
        main = _no_main_run(run, scene, outcome)
    else:
        main = _truthless(run, scene, outcome.trajectory, held)
        main.findings[:0] = [_ended(outcome.trajectory), *_steps(run, scene, outcome.trajectory)]
    main.findings.insert(0, _no_truth(cell.no_truth))
    return settled(main.run, override(main.findings, cell.overrides), main.message)


def _truthless(run: Record, scene: Scene, traj: Trajectory, held: frozenset[str]) -> _Main:
    eps = adapters.get(run.engine).eps
    return _Main(_measured(run, scene, traj, None, {}, held, traj.maxima), [
        judge_without_truth(scene, traj), *judge_levels(scene, traj, None, None, held, traj.maxima, eps),
        _orthogonality(run, traj, eps)])


def _no_truth(why: str) -> Finding:
    return Finding("truth", "unresolved", None, None, "", f"no truth: {why}")


def _orthogonality(run: Record, traj: Trajectory, eps: float, others: Sequence[Answer] = ()) -> Finding:
    return judge_orthogonality([traj, *(each.traj for each in others)], adapters.get(run.engine).on_group, eps,
                               run.documented_order, others[0].marks[:-1].tolist() if others else (0,))


def _asked_step(run: Record, scene: Scene) -> float | None:
    """The step (s) that was asked for, which divides the sample interval; None for an adaptive method."""
    return None if run.step is None else steps_per_sample(scene, run.step)[1]


def _ended(traj: Trajectory) -> Finding:
    """Whether the run says that it came to its end."""
    good = traj.status == "success"
    return Finding("run", "ok" if good else "fail", None, None, "", ENDED,
                   "" if good else f"it says of itself: {traj.status}")


def _steps(run: Record, scene: Scene, traj: Trajectory) -> list[Finding]:
    """The finding on what a run with a fixed step says of its steps; none for an adaptive method."""
    if run.step is None:
        return []
    per, step = steps_per_sample(scene, run.step)
    wanted, told = per * (len(traj.t) - 1), traj.stats.get("step") or step
    value = max(wanted / max(1, traj.steps), told / step)
    return [Finding("steps", "ok" if value <= MORE else "fail", float(value), MORE, "1", "steps asked for over those "
                    "that the run says it made, or its step over the one asked for: speeds and errors are compared at "
                    "one step", f"{wanted} steps of {step:.6g} s asked for, {traj.steps} of {told:.6g} s told")]


def _most(series: np.ndarray, every_step: float | None) -> float:
    return max(float(series.max()), every_step or 0.0)


def _measured(run: Record, scene: Scene, traj: Trajectory, reference: Reference | None, missed: Mapping[str, Error],
              held: frozenset[str], maxima: Mapping[str, float]) -> Record:
    """The measured values of a run."""
    exact = None if reference is None else reference.states.until(reference.horizon)
    size, gap = tolerances.energy_size(scene, traj, exact), energy_gap(scene, traj, exact, maxima, lambda: traj.work)
    levels = {}
    for level, unit in LEVELS.items():
        series = getattr(traj, f"constraint_{level}")
        most = None if series is None else _most(series, maxima.get(f"constraint_{level}"))
        levels[level] = Level(max=most, held=level in held, unit=unit)
    momentum = None if reference is None else float(np.nanmax(np.abs(
        traj.momentum_vertical - mechanics.momentum_vertical(scene, reference.states.until(reference.horizon)))))
    start = abs(float(traj.energy[0]))
    sizes = {} if reference is None else sizes_of(scene, reference.states)
    return replace(
        run, form=traj.form or run.form, status=traj.status, duration=scene.duration,
        errors={name: replace(error.figures, size=sizes.get(name)) for name, error in missed.items()},
        levels=levels,
        energy_error=None if math.isnan(gap) else gap / size,
        energy_error_by_start=float(gap / start) if start and not math.isnan(gap) else None,
        momentum_error=momentum, orthogonality=_most(traj.orthogonality, maxima.get("orthogonality")),
        steps=int(traj.steps), wall_time=float(traj.wall_time), us_per_step=1e6 * traj.wall_time / max(1, traj.steps),
        seconds_per_second=traj.wall_time / scene.duration, curves=run_curves(scene, traj, missed, reference))
