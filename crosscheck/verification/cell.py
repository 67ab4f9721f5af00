"""One cell of the grid, run in a worker: the main run, the order study, the verdict; and the timing of many cells."""

from __future__ import annotations

import dataclasses
import shlex
import statistics
from typing import Any

import numpy as np

from crosscheck import adapters
from crosscheck.errors import Unsupported
from crosscheck.jobs.workers import output
from crosscheck.judge import tolerances
from crosscheck.judge.continuity import judge_continuity
from crosscheck.judge.metrics import errors
from crosscheck.judge.overrides import override
from crosscheck.judge.plan import PLANS, RTOLS, STUDY_SAMPLES, ScenePlan, plan_without_truth
from crosscheck.judge.tolerances import rounding_levels
from crosscheck.judge.verdict import (
    Finding,
    Record,
    judge_invariants,
    judge_levels,
    judge_practical,
    judge_states,
    judge_without_truth,
    settle,
)
from crosscheck.references.base import Reference
from crosscheck.running.provenance import NOT_INSTALLED, engine_version
from crosscheck.scene.model import Scene
from crosscheck.verification.attempts import attempt
from crosscheck.verification.curves import run_curves, scene_curves
from crosscheck.verification.order_study import order_study


@dataclasses.dataclass(frozen=True)
class Cell:
    """One scene with one engine, method and form."""

    scene: str  # a name or a path
    engine: str
    method: str
    form: str | None
    plan: ScenePlan
    study: bool = True  # also the order study
    rungs: int | None = None  # how many of its steps; None: all
    whole: bool = True  # the main run covers the whole scene, not only its first window
    default_form: bool = True
    no_truth: str = ""  # why the scene has none; then only what needs none is judged
    practical: bool = False  # runs at the plan's practical step, far too coarse for bounds of states
    overrides: tuple[tuple[str, float, str], ...] = ()  # bounds set by the user, see `crosscheck.judge.overrides`
    most_seconds: float | None = None  # of processor time that the order study may take

    @property
    def label(self) -> str:
        """Engine, method and, where it is not the engine's default, form."""
        return f"{self.engine} {self.method}" + ("" if self.default_form or not self.form else f" ({self.form})")


def load(name: str, plan: ScenePlan, whole: bool = True) -> Scene:
    """A scene, or its first window, at the output times of its plan."""
    from crosscheck.scene.file import load_scene

    scene = load_scene(name)
    duration = min((plan.duration or scene.duration) if whole else plan.window, scene.duration)
    return scene.replace(duration=duration, samples=plan.samples)


def windowed(scene: Scene, window: float) -> Scene:
    """The first `window` seconds of a scene, at the output times of the order study."""
    return scene.replace(duration=min(window, scene.duration), samples=STUDY_SAMPLES)


def prepare_truth(task: tuple[Any, ...]) -> dict[str, Any]:
    """Compute (or find in the cache) the truths a scene's cells need, and choose its plan.

    `task`: name or path, whether main runs cover the whole scene, and how many steps they may take, see
    `crosscheck.verification.budget`. Returns what the report says about the scene, and
    the plan under the key "plan"; for a scene without truth, why under "no_truth", and whether two formulations of it
    disagreed under "disputed".
    """
    from crosscheck.references import TruthError

    try:
        return _described(*task)
    except (Unsupported, TruthError) as error:
        return _described_without_truth(task[0], task[1], error)


def _described_without_truth(name: str, whole: bool, error: Exception) -> dict[str, Any]:
    from crosscheck.scene.file import load_scene

    scene = load_scene(name)
    plan = PLANS.get(name) or plan_without_truth(scene)
    return {"name": name, "title": scene.name, "description": scene.description, "source": scene.source,
            "hash": scene.hash, "bodies": [body.name for body in scene.bodies], "duration": scene.duration,
            "plan": plan, "truth": None, "scales": {}, "curves": scene_curves(load(name, plan, whole), None),
            "no_truth": " ".join(str(error).split()), "disputed": not isinstance(error, Unsupported)}


def _described(name: str, whole: bool, most_steps: int) -> dict[str, Any]:
    """What the report says about a scene whose truth is known."""
    from crosscheck.references import truth
    from crosscheck.scene.file import load_scene
    from crosscheck.verification.budget import plan_within

    plan = plan_within(load_scene(name), name, most_steps)
    scene = load(name, plan, whole)
    reference = truth(scene)
    return {
        "name": name, "title": scene.name, "description": scene.description, "source": scene.source,
        "hash": scene.hash, "bodies": [body.name for body in scene.bodies], "duration": scene.duration, "plan": plan,
        "truth": {"source": reference.source, "second_source": reference.second_source,
                  "disagreement": reference.disagreement, "allowed": reference.allowed,
                  "amplification": reference.amplification, "horizon": reference.horizon},
        "scales": dataclasses.asdict(tolerances.scales(scene, reference)),
        "rounding": rounding_levels(scene, reference),
        "curves": scene_curves(scene, reference),
    }


def run_cell(cell: Cell) -> Record:
    """Run and judge one cell. Whatever happens, a record comes back."""
    from crosscheck.adapters.base import RunSpec
    from crosscheck.references import truth

    version = engine_version(cell.engine)
    if version == NOT_INSTALLED:
        record = Record(cell.scene, cell.engine, version, cell.method, cell.form, None, None, None, "")
        record.practical, record.outcome, record.message = cell.practical, "unsupported", NOT_INSTALLED
        return record
    scene = load(cell.scene, cell.plan, cell.whole)
    engine = adapters.get(cell.engine)
    order = engine.documented_order(scene, RunSpec(cell.method, step=cell.plan.step(1), form=cell.form))
    step = None if order is None else cell.plan.practical if cell.practical else cell.plan.step(order)
    rtol = cell.plan.rtol if order is None else None
    spec = RunSpec(cell.method, step=step, rtol=rtol, form=cell.form)
    record = Record(cell.scene, cell.engine, version, cell.method, cell.form, step, rtol, order,
                    command(cell, step, rtol), practical=cell.practical)
    reason = engine.unsupported(scene, spec)
    if reason is not None:
        record.outcome, record.message = "unsupported", reason
        return record
    if cell.no_truth:
        _unjudged_run(record, scene, engine.held_levels(scene, spec), cell)
        return record
    reference, window = truth(scene), truth(windowed(scene, cell.plan.window))
    _main_run(record, scene, reference, window, engine.held_levels(scene, spec), cell.plan.budgeted)
    if cell.study and record.outcome != "unsupported":
        order_study(record, cell, windowed(scene, cell.plan.window), window)
    if record.outcome == "unsupported":
        return record
    override(record, cell.overrides)
    return settle(record, adapters.turning)


def command(cell: Cell, step: float | None, rtol: float | None) -> str:
    """The shell command that repeats the main run of a cell."""
    words = ["crosscheck", "run", cell.scene, "--engine", cell.engine, "--method", cell.method]
    words += ["--step", repr(step)] if step is not None else ["--rtol", repr(rtol)]
    words += ["--form", cell.form] if cell.form else []
    if not cell.whole or cell.plan.duration:
        words += ["--duration", repr(cell.plan.duration if cell.whole else cell.plan.window)]
    return shlex.join([*words, "--samples", str(cell.plan.samples), "--csv", "run.csv"])


def _main_run(record: Record, scene: Scene, reference: Reference, window: Reference,
              held: frozenset[str], budgeted: bool) -> None:
    from crosscheck.scene.monitor import MAXIMA

    traj = _whole_run(record, scene)
    if traj is None:
        return
    maxima = {key: traj.stats[key] for key in MAXIMA if key in traj.stats}
    if record.practical:
        bounds, found = None, errors(scene, traj, reference.states)
        findings = [judge_practical(scene, traj, reference)]
        findings += [Finding(name, "unjudged", error.max, None, error.unit, "the step is too coarse for a bound",
                             f"body {error.body}, t = {error.time:.4g} s") for name, error in found.items()]
    else:
        findings, found, bounds = judge_states(scene, traj, reference, window, record.documented_order,
                                               traj.stats.get("step") or record.step, record.rtol, budgeted)
        findings += judge_invariants(scene, traj, reference, bounds)
        record.judged_until = bounds.until
    levels = judge_levels(scene, traj, reference, bounds, held, maxima)
    record.findings += findings + levels + judge_continuity(scene, traj, reference)
    _judge_orthogonality(record, traj, maxima)
    record.errors = {name: {"unit": error.unit, "end": error.end, "max": error.max, "time": error.time,
                            "body": error.body}
                     for name, error in found.items()}
    for finding in findings:
        if finding.kind in record.errors:
            record.errors[finding.kind] |= {"judged": finding.value, "bound": finding.bound, "why": finding.why}
    _keep_levels(record, traj, levels, held, maxima)
    _totals(record, scene, traj, reference, maxima)
    record.curves = run_curves(scene, traj, found, reference)


def _whole_run(record: Record, scene: Scene) -> Any:
    """The main run, or None where there is none; the record says why."""
    record.duration = scene.duration
    traj = attempt(scene, record, record.form, record.step, record.rtol)
    if record.outcome == "unsupported":
        return None
    if isinstance(traj, str):
        record.status, record.message = "failed", traj.splitlines()[0]
        record.findings.append(Finding("run", "fail", None, None, "", "a run has to reach its end", record.message))
        return None
    record.findings.append(Finding("run", "ok", None, None, "", "a run has to reach its end"))
    return traj


def _unjudged_run(record: Record, scene: Scene, held: frozenset[str], cell: Cell) -> None:
    """Run and judge what needs no truth: energy, held constraint levels, orthogonality."""
    from crosscheck.scene.monitor import MAXIMA

    traj = _whole_run(record, scene)
    if record.outcome == "unsupported":
        return
    if traj is not None:
        maxima = {key: traj.stats[key] for key in MAXIMA if key in traj.stats}
        levels = judge_levels(scene, traj, None, None, held, maxima)
        record.findings += [judge_without_truth(scene, traj), *levels]
        _judge_orthogonality(record, traj, maxima)
        _keep_levels(record, traj, levels, held, maxima)
        _totals(record, scene, traj, None, maxima)
        record.curves = run_curves(scene, traj, {}, None)
    override(record, cell.overrides)
    if settle(record, adapters.turning).outcome == "pass":
        record.outcome, record.message = "unjudged", f"unjudged: no truth ({cell.no_truth})"


def _judge_orthogonality(record: Record, traj: Any, maxima: dict[str, float]) -> None:
    tol = tolerances.orthogonality(adapters.on_group(record.engine), traj.steps)
    drift = max(float(traj.orthogonality.max()), maxima.get("orthogonality", 0.0))
    record.findings.append(Finding("orthogonality", "ok" if drift <= tol.value else "fail", drift, tol.value, "1",
                                   tol.why, "every step"))
    record.orthogonality = drift


def _keep_levels(record: Record, traj: Any, levels: list[Finding], held: frozenset[str],
                 maxima: dict[str, float]) -> None:
    for finding in levels:
        level = finding.kind.removeprefix("level ")
        series = getattr(traj, f"constraint_{level}")
        most = None if series is None else max(float(np.max(series)), maxima.get(f"constraint_{level}", 0.0))
        record.levels[level] = {"max": most, "held": level in held, "unit": finding.unit}


def _totals(record: Record, scene: Scene, traj: Any, reference: Reference | None, maxima: dict[str, float]) -> None:
    from crosscheck.scene import mechanics

    record.status, record.steps, record.wall_time = traj.status, int(traj.steps), float(traj.wall_time)
    record.form = traj.form or record.form
    record.us_per_step = 1e6 * traj.wall_time / max(1, traj.steps)
    record.seconds_per_second = traj.wall_time / scene.duration
    size = float(mechanics.kinetic_energy(scene, traj if reference is None else reference.states).max())
    record.energy_error = max(float(np.abs(traj.energy - traj.energy[0]).max() / size), maxima.get("energy_error", 0.0))
    if reference is None:
        return
    exact = mechanics.momentum_vertical(scene, reference.states)
    record.momentum_error = float(np.abs(traj.momentum_vertical - exact).max())


@dataclasses.dataclass(frozen=True)
class Timing:
    """The cells of one scene that a timing study compares, and how often at most."""

    cells: tuple[Cell, ...]
    orders: tuple[int | None, ...]
    repeats: int
    main: tuple[float, ...] = ()  # step (s) or rtol of each cell's main run, timed like the others


ENOUGH = 0.1
"""Stepping time (s) of two runs after which there is no third: they average over what is short."""

MAIN_STEPS = 2000
"""Steps of the runs that time the step of the main run: enough for the time per step, which is all they are for."""


def time_cells(timing: Timing) -> list[list[dict[str, Any]]]:
    """Stepping time against end error of every cell, all in this one process, serially and interleaved.

    Two samples only, so that no engine pays for output; medians over the repeats. A run that fails gives no point.
    The last point of a cell, "main", is at the step of its main run and stops after `MAIN_STEPS`; it has no error.
    """
    from crosscheck.references import truth

    first = timing.cells[0]
    scene = load(first.scene, first.plan)
    brief = windowed(scene, first.plan.window).replace(samples=2)
    exact = truth(windowed(scene, first.plan.window)).states
    end = dataclasses.replace(exact, **{name: getattr(exact, name)[[0, -1]] for name in ("t", "x", "R", "v", "w")},
                              a=None, alpha=None, lam=None)
    points: list[dict[tuple[int, float], list[Any]]] = [{} for _ in timing.cells]
    for _ in range(timing.repeats):
        for index, (cell, order) in enumerate(zip(timing.cells, timing.orders, strict=True)):
            output.at(str(index))
            record = Record(cell.scene, cell.engine, "", cell.method, cell.form, None, None, order, "")
            sizes = cell.plan.ladder(order) if order is not None else RTOLS
            for rung, size in enumerate((*sizes, *timing.main[index:index + 1])):
                before = points[index].get((rung, size), [])
                main = rung == len(sizes)
                if not main and len(before) > 1 and sum(traj.wall_time for traj in before) > ENOUGH:
                    continue
                step, rtol = (size, None) if order is not None else (None, size)
                timed = brief
                if main and step is not None:
                    timed = brief.replace(duration=min(brief.duration, MAIN_STEPS * step))
                traj = attempt(timed, record, cell.form, step, rtol, monitor=False)
                if not isinstance(traj, str):
                    points[index].setdefault((rung, size), []).append(traj)
    result = []
    for cell, each, order in zip(timing.cells, points, timing.orders, strict=True):
        rungs = len(cell.plan.ladder(order) if order is not None else RTOLS)
        result.append([_timed(brief, size, order, trajs, None if rung == rungs else end) | {"main": rung == rungs}
                       for (rung, size), trajs in sorted(each.items())])
    return result


def _timed(scene: Scene, size: float, order: int | None, trajs: list[Any], end: Any) -> dict[str, Any]:
    """One point; its error is None where there is no truth `end` for the time at which the runs stop."""
    walls = [traj.wall_time for traj in trajs]
    wall, simulated = statistics.median(walls), float(trajs[0].t[-1])
    return {"step": size if order is not None else None, "rtol": size if order is None else None,
            "wall_time": wall, "steps": int(trajs[0].steps), "us_per_step": 1e6 * wall / max(1, trajs[0].steps),
            "seconds_per_second": wall / simulated,
            "seconds_deviation": statistics.median(abs(each - wall) for each in walls) / simulated,
            "error": None if end is None else errors(scene, trajs[0], end)["position"].end}
