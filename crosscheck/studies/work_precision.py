"""Work against precision: the cost of every way to integrate a scene, and the error that it gives.

A way is an engine, a method and a form. Each has a ladder of steps or tolerances. A first pass with samples gives the
errors. The times come from rounds in which all rungs of all ways take turns, with two samples and no monitor. The
frontier is the cost of each method for a given error, and the cheapest method: between neighbouring rungs of a ladder
the cost is interpolated log-log, and nothing is extrapolated beyond the ends.
"""

from __future__ import annotations

import contextlib
import dataclasses
import functools
import math
import statistics
import time
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from msgspec.structs import replace

from crosscheck.compare.errors import errors
from crosscheck.compare.sizes import natural_time
from crosscheck.document import Part, Way, extended, grouped
from crosscheck.errors import CrosscheckError, Unsupported, errors_as, said
from crosscheck.references.base import Reference, TruthError
from crosscheck.references.taylor import Taylor
from crosscheck.running.attempt import Ran, attempt
from crosscheck.running.trajectory import Trajectory
from crosscheck.scene.model import Scene
from crosscheck.scene.states import States
from crosscheck.studies.study import Ask, Progress, StudyDocument, StudyMeta, Work
from crosscheck.verification.ladder import INTERVALS, GradedWay, ladder, reference, thinned, ways
from crosscheck.verification.speed import spread, undisturbed

LEVELS = tuple(10.0**-power for power in range(2, 12))
"""The errors at which costs are compared."""

IN_HOUSE, BOUND = "lieeuler", "heyoka"
"""The engine that is compared with all others, and the one that only shows what is possible."""


class Rung(Way, frozen=True, kw_only=True):
    """One run of a way. Errors are in m and rad, the largest over the bodies. Times are of stepping alone.

    `setup_ms` is the other time of a run: building the engine's model and converting its two samples.
    """

    scene: str
    label: str
    status: str = "success"  # or "skipped", "unsupported", or how it failed
    reason: str = ""
    steps: int | None = None
    rejected_steps: int | None = None
    force_evaluations: int | None = None  # if the engine counts them
    end_position: float | None = None
    end_attitude: float | None = None
    max_position: float | None = None  # over the samples that lie on steps
    max_attitude: float | None = None
    samples: int | None = None  # number of the samples for max_position and max_attitude
    wall_ms: float | None = None  # median over the repeats
    wall_deviation_ms: float | None = None  # median absolute deviation of the repeats
    setup_ms: float | None = None
    repeats: int = 0


def rung_of(scene: Scene, way: GradedWay, value: float | None, status: str = "success", reason: str = "") -> Rung:
    """The rung of a way at `value`: a step (s), or a tolerance if the way is adaptive."""
    return extended(Rung, way, scene=scene.name, label=way.label, status=status, reason=reason, **{
        "rtol" if way.adaptive else "step": value})


@dataclasses.dataclass(frozen=True)
class Curve:
    """Errors and costs of one engine, method and form, coarse rungs first. Failed rungs are left out."""

    engine: str
    label: str
    errors: tuple[float, ...]
    costs: tuple[float, ...]  # ms of stepping, or evaluations of the forces


@dataclasses.dataclass(frozen=True)
class Front:
    """The frontier at one error. Values are None if no method of that kind reaches the error."""

    level: float
    winner: str | None  # of all but the bound
    own: str | None
    own_cost: float | None
    other: str | None
    other_cost: float | None
    factor: float | None  # other_cost / own_cost: above 1 if the in-house method is cheaper
    bound_cost: float | None
    to_bound: float | None  # own_cost / bound_cost
    costs: dict[str, float]  # of all that reach the level, by label, the cheapest first


def confirmed(errors: Sequence[float]) -> list[float]:
    """The errors of a ladder. An error smaller than that of the next finer rung is replaced by the latter.

    At some steps the end error passes through zero by coincidence. No method should win by that.
    """
    return [max(errors[k:k + 2]) for k in range(len(errors))]


def cost_at(errors: Sequence[float], costs: Sequence[float], level: float) -> float | None:
    """The lowest cost for an error of at most `level`; None if no rung reaches it.

    Parameters
    ----------
    errors, costs : finite values of the rungs of one ladder, coarse to fine
    level : the wanted error
    """
    sure = confirmed(errors)
    reached = [cost for error, cost in zip(sure, costs, strict=True) if error <= level]
    for coarse, fine in zip(range(len(sure)), range(1, len(sure)), strict=False):
        if sure[coarse] > level >= sure[fine] > 0 and costs[coarse] > 0 and costs[fine] > 0:
            share = math.log(sure[coarse] / level) / math.log(sure[coarse] / sure[fine])
            reached.append(costs[coarse] ** (1 - share) * costs[fine] ** share)
    return min(reached, default=None)


def frontier(curves: Sequence[Curve], levels: Sequence[float] = LEVELS) -> list[Front]:
    """The cheapest methods at each level, and the factors between their costs."""
    fronts = []
    for level in levels:
        reached = sorted(((cost, curve) for curve in curves
                          if (cost := cost_at(curve.errors, curve.costs, level)) is not None), key=lambda pair: pair[0])
        own, own_cost = next(((curve.label, cost) for cost, curve in reached if curve.engine == IN_HOUSE), (None, None))
        other, other_cost = next(((curve.label, cost) for cost, curve in reached
                                  if curve.engine not in (IN_HOUSE, BOUND)), (None, None))
        bound = next((cost for cost, curve in reached if curve.engine == BOUND), None)
        fronts.append(Front(
            level, next((curve.label for _, curve in reached if curve.engine != BOUND), None), own, own_cost, other,
            other_cost, other_cost / own_cost if other_cost is not None and own_cost else None, bound,
            own_cost / bound if own_cost is not None and bound else None,
            {curve.label: cost for cost, curve in reached}))
    return fronts


def curves(rungs: Sequence[Rung], error: str = "end_position", cost: str = "wall_ms") -> list[Curve]:
    """The curves of these rungs, in their order. Rungs without error or cost are left out."""
    drawn = [rung for rung in rungs if getattr(rung, error) is not None and getattr(rung, cost) is not None
             and math.isfinite(getattr(rung, error))]
    return [Curve(own[0].engine, label, *(tuple(float(getattr(rung, name)) for rung in own) for name in (error, cost)))
            for label, own in grouped(drawn, lambda rung: rung.label).items()]


def with_errors(rung: Rung, scene: Scene, run: States | Trajectory, truth: Reference, intervals: int) -> Rung:
    """The rung with the errors of its run at `intervals` + 1 equally spaced times. Truth may have more samples."""
    of = errors(scene, run, thinned(truth.states, intervals))
    return replace(rung, samples=intervals + 1, end_position=of["position"].end, max_position=of["position"].max,
                   end_attitude=of["attitude"].end, max_attitude=of["attitude"].max)


FRONTIERS = {"end position": ("end_position", "m"), "end attitude": ("end_attitude", "rad"),
             "largest position": ("max_position", "m"), "largest attitude": ("max_attitude", "rad")}
"""Errors for which a frontier is drawn: field of a rung, and unit."""


def compared(scene: Scene) -> str:
    """The error, among `FRONTIERS`, by which the runs of a scene are ranked.

    Free bodies fall alike however they turn, so that any run has their positions right. Their attitudes tell.
    """
    return "end position" if scene.joints or scene.forces else "end attitude"


GOOD, LEAST_GAIN = 1e-9, 1.3
"""Below the error GOOD, a ladder ends after two rungs in a row that do not improve by this factor: it is round-off."""

MOST_TRIES, PATIENCE = 6, 0.1
"""A turn takes the fastest of at most MOST_TRIES runs, in about PATIENCE seconds. In the first run the caches hold
another engine's data, which doubles the time of runs of 50 us."""


def measure(scene: Scene, chosen: Sequence[GradedWay], truth: Reference, repeats: int, time_limit: float,
            progress: Progress, keep: Callable[[list[Rung]], None], bound: bool = True) -> list[Rung]:
    """Measure the errors of all rungs of all ways, then their times in interleaved rounds.

    Parameters
    ----------
    truth : with `INTERVALS` intervals over the scene
    repeats : number of rounds, of which the medians are taken
    time_limit : s of stepping; a rung that would take longer is skipped, and its row says so
    keep : called with all rungs after each round
    bound : whether to measure the Taylor series of heyoka, too
    """
    rungs: list[_Timed] = []
    total = len(chosen) + (len(TOLERANCES) if bound else 0)
    for done, way in enumerate(chosen):
        progress(done, total, f"{scene.name}: errors of {way.label}")
        rungs += [_Timed(rung, _timer(scene, rung)) for rung in _graded(scene, way, truth, time_limit)]
    if bound:
        series = Bound(scene, truth)
        for done, rtol in enumerate(TOLERANCES):
            progress(len(chosen) + done, total, f"{scene.name}: building the Taylor series of heyoka")
            rungs.append(_Timed(series.rung(rtol), series.timer(rtol)))
    keep([each.rung for each in rungs])
    runs = [each for each in rungs if each.rung.status == "success"]
    for turn in range(repeats):
        for done, each in enumerate(runs):
            progress(turn * len(runs) + done, repeats * len(runs), f"{scene.name}: time of {each.rung.label}")
            each.take()
        keep([each.rung for each in rungs])
    return [each.rung for each in rungs]


def _graded(scene: Scene, way: GradedWay, truth: Reference, time_limit: float) -> list[Rung]:
    """Errors of the rungs of a way from coarse to fine, until round-off dominates or a rung would take too long."""
    rungs: list[Rung] = []
    last, pace = None, 0.0  # the last successful rung, and its prediction for the next: s per step, or s of the run
    best, stale = math.inf, 0  # smallest error, and number of rungs in a row without improvement
    for count, value in ladder(scene, way):
        rung = rung_of(scene, way, value)
        rungs.append(rung)
        if last and pace * (count or 1) > time_limit:
            # Time it again, because the machine may have been busy. If this run fails, the timed rounds will report it.
            with contextlib.suppress(CrosscheckError):
                once = functools.partial(_timer(scene, last), {})
                pace = min(pace, undisturbed(once, MOST_TRIES, PATIENCE)[0] * _share(last))
            if pace * (count or 1) > time_limit:
                reason = f"it would take longer than the limit of {time_limit:g} s"
                rungs[-1] = replace(rung, status="skipped", reason=reason)
                break
        rung, wall = _explore(scene, rung, count, truth)
        rungs[-1] = rung
        if rung.status != "success":
            if count is not None and count > MOST_FAILING * scene.duration / natural_time(scene):
                break
            continue
        last, pace = rung, wall * _share(rung)
        error = getattr(rung, FRONTIERS[compared(scene)][0]) or 0.0
        stale = stale + 1 if error < GOOD and error * LEAST_GAIN > best else 0
        best = min(best, error)
        if stale >= 2:
            break
    return rungs


def _share(rung: Rung) -> float:
    """The factor from a rung's time to the time of one step, or to that of a run at the next tolerance."""
    return GROWTH if rung.step is None else 1.0 / (rung.steps or 1)


MOST_FAILING = 1000.0
"""A ladder ends if a rung fails that has more than this number of steps per natural time of the scene."""

GROWTH = 1.5
"""An adaptive run at a tenth of the tolerance takes at least about this many times as long."""


def _explore(scene: Scene, rung: Rung, count: int | None, truth: Reference) -> tuple[Rung, float]:
    """Run a rung: it with its errors or its failure, and its stepping time (s)."""
    intervals = INTERVALS if count is None else min(INTERVALS, count & -count)
    outcome = attempt(scene, rung, samples=intervals + 1, monitor=False)
    if not isinstance(outcome, Ran):
        return replace(rung, status=outcome.status, reason=said(outcome.error)), 0.0
    traj = outcome.trajectory
    return with_errors(replace(rung, steps=traj.steps), scene, traj, truth, intervals), float(traj.wall_time)


Counters = dict[str, int | None]
"""Counters of the last run of a rung, by its fields."""


def _timer(scene: Scene, rung: Rung) -> Callable[[Counters], float]:
    """A function that runs the rung with two samples, sets the counters and returns the stepping time (s)."""

    def once(counters: Counters) -> float:
        outcome = attempt(scene, rung, samples=2, monitor=False)
        if not isinstance(outcome, Ran):
            raise outcome.error
        traj = outcome.trajectory
        counters["steps"] = traj.steps
        counters["rejected_steps"] = traj.stats.get("rejected_steps")
        counters["force_evaluations"] = traj.stats.get("force_evaluations")
        return float(traj.wall_time)

    return once


@dataclasses.dataclass
class _Timed:
    """A rung, the function that runs it once more, and (stepping, set-up) in s of all turns so far."""

    rung: Rung
    once: Callable[[Counters], float]
    times: list[tuple[float, float]] = dataclasses.field(default_factory=list)

    def take(self) -> None:
        """Time it once, unless a turn has failed; the rung gets the medians."""
        if self.rung.status != "success":
            return
        counters: Counters = {}
        try:
            self.times.append(undisturbed(functools.partial(self.once, counters), MOST_TRIES, PATIENCE))
        except CrosscheckError as error:  # it ran in the first pass, but fails now
            self.rung = replace(self.rung, status="failed", reason=f"when timed: {said(error)}")
            return
        walls = [wall for wall, _ in self.times]
        self.rung = replace(
            self.rung, repeats=len(walls), wall_ms=1e3 * statistics.median(walls), **counters,
            wall_deviation_ms=1e3 * spread(walls), setup_ms=1e3 * statistics.median(setup for _, setup in self.times))


@dataclasses.dataclass(frozen=True)
class WorkPrecisionAsk(Ask):
    """Also the number of rounds, and whether heyoka is measured as a bound."""

    repeats: int = 5
    bound: bool = True
    duration: float | None = None  # s; None: the scene's


class Known(Part, frozen=True, kw_only=True):
    """The source of a scene's truth, and its accuracy."""

    source: str
    disagreement: float
    amplification: float


class SceneLadders(Part, frozen=True, kw_only=True):
    """The results of one scene: its truth or why there is none, all rungs, and a frontier for each kind of error.

    compared: the error by which runs are ranked.
    """

    name: str
    description: str
    duration: float  # s
    failure: str | None = None
    truth: Known | None = None
    compared: str = "end position"
    rungs: list[Rung]
    frontier: dict[str, list[Front]]


class WorkPrecisionDocument(StudyDocument, frozen=True, kw_only=True):
    """work-precision.json."""

    scenes: list[SceneLadders]


class WorkPrecision:
    """What does an error cost with every engine, form and method?"""

    name = "work-precision"
    row_type = SceneLadders

    scenes = ("single_pendulum", "double_pendulum", "heavy_top")

    def measure(self, work: Work[WorkPrecisionAsk, SceneLadders]) -> None:
        """Measure scene by scene. Runs of one scene take turns, so that their times can be compared."""
        results: list[SceneLadders] = []
        for scene in work.scenes:
            self._measure(work, scene.lasting(work.ask.duration or scene.duration), results)

    def _measure(self, work: Work[WorkPrecisionAsk, SceneLadders], scene: Scene, results: list[SceneLadders]) -> None:
        """Add the ladders of a scene to the results."""
        ask = work.ask
        ladders = SceneLadders(name=scene.name, description=scene.description, duration=scene.duration,
                               compared=compared(scene), rungs=[], frontier={})
        results.append(ladders)
        try:
            work.progress(0, None, f"{scene.name}: truth")
            sampled, truth = reference(scene)
        except (Unsupported, TruthError) as error:
            results[-1] = replace(ladders, failure=said(error))
            work.keep(results)
            return
        ladders = replace(ladders, duration=sampled.duration, truth=Known(
            source=truth.source, disagreement=truth.disagreement, amplification=truth.amplification))
        chosen, refused = ways(sampled, work.engines, ask.methods, asked_map=ask.coordinate_map)
        missing = [rung_of(sampled, way, None, "unsupported", reason) for way, reason in refused]

        def kept(rungs: list[Rung]) -> None:
            results[-1] = replace(ladders, rungs=[*rungs, *missing], frontier={
                name: frontier(curves(rungs, column)) for name, (column, _) in FRONTIERS.items()})
            work.keep(results)

        def measured() -> SceneLadders:
            measure(sampled, chosen, truth, ask.repeats, ask.time_limit, work.progress, kept, ask.bound)
            return results[-1]

        results[-1] = work.once(sampled, None, dataclasses.asdict(ask), measured)
        work.keep(results)

    def document(self, ask: WorkPrecisionAsk, meta: StudyMeta, results: list[SceneLadders]) -> WorkPrecisionDocument:
        """Per scene its rungs and frontiers."""
        return WorkPrecisionDocument(study=self.name, meta=replace(meta, repeats=ask.repeats), scenes=results)

    def rows(self, document: WorkPrecisionDocument) -> list[Rung]:
        """A line a rung."""
        return [rung for scene in document.scenes for rung in scene.rungs]


TOLERANCES = (1e-3, 1e-6, 1e-9, 1e-12, 1e-15)
"""Each tolerance has its own order of the series, and takes seconds to compile."""

LARGEST_UNROLLED = 14
"""Up to this number of states the series is compiled as code without loops. It is two to four times as fast, but takes
minutes to compile for larger systems."""


class Bound:
    """Taylor integrators of one scene, one for each tolerance."""

    def __init__(self, scene: Scene, truth: Reference) -> None:
        import heyoka  # noqa: F401, where it is missing the study says so before it runs anything

        self._scene, self._truth = scene, truth
        self._series = Taylor(scene)
        self._integrators: dict[float, Any] = {}

    def rung(self, rtol: float) -> Rung:
        """The run at a tolerance, with its errors; compiles the series."""
        rung = Rung(engine=BOUND, method="taylor", rtol=rtol, scene=self._scene.name, label="bound: heyoka")
        try:
            return self._measured(rung, rtol)
        except CrosscheckError as error:
            return replace(rung, status="failed", reason=said(error))

    def _measured(self, rung: Rung, rtol: float) -> Rung:
        with errors_as(lambda error: CrosscheckError(said(error))):  # heyoka and LLVM raise several kinds
            unrolled = len(self._series.initial) <= LARGEST_UNROLLED
            integrator = self._series.integrator(rtol, compact_mode=not unrolled, high_accuracy=False)
            self._integrators[rtol] = integrator
            integrator.time = 0.0
            integrator.state[:] = self._series.initial
            states = integrator.propagate_grid(self._scene.t)[-1]
            # At loose tolerances quaternions do not have unit length, which is not an error of the attitude.
            return with_errors(rung, self._scene, self._series.states(self._series.normalised(states)), self._truth,
                               self._scene.samples - 1)

    def timer(self, rtol: float) -> Callable[[Counters], float]:
        """A function that runs the rung of a tolerance, sets its counter and returns its stepping time, s."""
        initial, end = np.array(self._series.initial), self._scene.duration

        def once(counters: Counters) -> float:
            integrator = self._integrators[rtol]
            integrator.time = 0.0
            integrator.state[:] = initial
            start = time.perf_counter()
            steps = integrator.propagate_until(end)[3]
            wall = time.perf_counter() - start
            counters["steps"] = int(steps)
            return wall

        return once
