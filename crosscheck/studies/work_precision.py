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

from msgspec.structs import replace

from crosscheck.compare.sizes import check_moves, natural_time, sizes
from crosscheck.compare.timing import take_turns, undisturbed
from crosscheck.document import Part, grouped
from crosscheck.errors import CrosscheckError, EngineDied, Unsupported, errors_as, said
from crosscheck.jobs.table import Session
from crosscheck.references.base import Reference, TruthError
from crosscheck.references.taylor import Taylor
from crosscheck.scene.model import Scene
from crosscheck.studies.study import Ask, Progress, StudyDocument, StudyMeta, Work
from crosscheck.verification.ladder import STAGE as LADDER
from crosscheck.verification.ladder import (
    Climb,
    GradedWay,
    Ladder,
    Rung,
    key,
    ladder,
    reference,
    rung_of,
    ways,
    with_errors,
)
from crosscheck.verification.speed import spread, stepping_time

LEVELS = tuple(10.0**-power for power in range(2, 12))
"""The errors at which costs are compared."""

IN_HOUSE, BOUND = "lieeuler", "heyoka"
"""The engine that is compared with all others, and the one that only shows what is possible."""


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
            progress: Progress, keep: Callable[[list[Rung]], None], bound: bool = True,
            session: Session | None = None) -> list[Rung]:
    """Measure the errors of all rungs of all ways, then their times in interleaved rounds.

    Parameters
    ----------
    truth : with `INTERVALS` intervals over the scene
    repeats : number of rounds, of which the medians are taken
    time_limit : s of stepping; a rung that would take longer is skipped, and its row says so
    keep : called with all rungs after each round
    bound : whether to measure the Taylor series of heyoka, too
    session : rungs are kept in its table, and those that are there are not run
    """
    rungs, bound = list[Rung](), bound and not scene.has_laws  # one series bounds no motion of several pieces
    total, timers = len(chosen) + (len(TOLERANCES) if bound else 0), dict[int, Callable[[], float]]()  # by place
    for engine, own in grouped(chosen, lambda way: way.engine).items():
        ladder = Ladder.kept(scene, engine, scene.duration, session)
        for way in own:
            progress(chosen.index(way), total, f"{scene.name}: errors of {way.label}")
            rungs += _graded(Climb(scene, truth, ladder), way, time_limit)
            if session is not None:
                session.put(LADDER, key(scene, engine), ladder)
    timers |= {place: functools.partial(stepping_time, scene, rung, samples=2) for place, rung in enumerate(rungs)}
    if bound:
        import heyoka  # noqa: F401, where it is missing the study says so before it runs anything

        series = Taylor(scene)
        for done, rtol in enumerate(TOLERANCES):
            progress(len(chosen) + done, total, f"{scene.name}: building the Taylor series of heyoka")
            rung, timer = bounds(scene, truth, rtol, series)
            timers |= {} if timer is None else {len(rungs): timer}
            rungs.append(rung)
    keep(rungs)
    times: dict[int, list[tuple[float, float]]] = {
        place: [] for place, rung in enumerate(rungs) if rung.status == "success"}
    turns, before = take_turns({place: functools.partial(undisturbed, timers[place], MOST_TRIES, PATIENCE)
                                for place in times}, repeats), -1
    for done, (place, result) in enumerate(turns):
        progress(done + 1, repeats * len(times), f"{scene.name}: time of {rungs[place].label}")
        if place <= before:
            keep(rungs)
        before = place
        if isinstance(result, CrosscheckError):  # it ran in the first pass, but fails now
            rungs[place] = replace(rungs[place], status="failed", reason=f"when timed: {said(result)}")
            continue
        times[place].append(result)
        walls, setups = (list(each) for each in zip(*times[place], strict=True))
        rungs[place] = replace(rungs[place], repeats=len(walls), wall_ms=1e3 * statistics.median(walls),
                               wall_deviation_ms=1e3 * spread(walls), setup_ms=1e3 * statistics.median(setups))
    keep(rungs)
    return rungs


def _graded(climb: Climb, way: GradedWay, time_limit: float) -> list[Rung]:
    """Errors of the rungs of a way from coarse to fine, until round-off dominates or a rung would take too long."""
    scene, rungs = climb.scene, list[Rung]()
    last, pace = None, 0.0  # the last successful rung, and its prediction for the next: s per step, or s of the run
    best, stale = math.inf, 0  # smallest error, and number of rungs in a row without improvement
    for count, value in ladder(scene, way):
        if last and pace * (count or 1) > time_limit:
            # Time it again, because the machine may have been busy. If this run fails, the timed rounds will report it.
            with contextlib.suppress(CrosscheckError):
                once = functools.partial(stepping_time, scene, last, samples=2)
                pace = min(pace, undisturbed(once, MOST_TRIES, PATIENCE)[0] * _share(last))
            if pace * (count or 1) > time_limit:
                rungs.append(rung_of(scene, way, value, "skipped",
                                     f"it would take longer than the limit of {time_limit:g} s"))
                break
        try:
            rung = climb.run(way, value)
        except EngineDied as died:
            rung = rung_of(scene, way, value, "failed", said(died))
        rungs.append(rung)
        if rung.status != "success":
            if count is not None and count > MOST_FAILING * scene.duration / natural_time(scene):
                break
            continue
        last, pace = rung, 1e-3 * (rung.wall_ms or 0.0) * _share(rung)
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
            check_moves(sampled, truth.states)
        except (Unsupported, TruthError) as error:
            results[-1] = replace(ladders, failure=said(error))
            work.keep(results)
            return
        ladders = replace(ladders, duration=sampled.duration, truth=Known(
            source=truth.source, disagreement=truth.disagreement, amplification=truth.amplification))
        chosen, refused = ways(sampled, work.engines, ask.methods, options=ask.options)
        missing = [rung_of(sampled, way, None, "unsupported", reason) for way, reason in refused]

        def kept(rungs: list[Rung]) -> None:
            results[-1] = replace(ladders, rungs=[*rungs, *missing], frontier={
                name: frontier(curves(rungs, column)) for name, (column, _) in FRONTIERS.items()})
            work.keep(results)

        def measured() -> SceneLadders:
            measure(sampled, chosen, truth, ask.repeats, ask.time_limit, work.progress, kept, ask.bound,
                    work.session)
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


def bounds(scene: Scene, truth: Reference, rtol: float, series: Taylor) -> tuple[Rung, Callable[[], float] | None]:
    """The run of the series of a scene at a tolerance with its errors, and a function that returns its time (s)."""
    rung = Rung(engine=BOUND, method="taylor", rtol=rtol, scene=scene.name, label="bound: heyoka")
    try:
        with errors_as(lambda error: CrosscheckError(said(error))):  # heyoka and LLVM raise several kinds
            unrolled = len(series.initial) <= LARGEST_UNROLLED
            integrator = series.integrator(rtol, compact_mode=not unrolled, high_accuracy=False)
            _restart(integrator, series)
            *_, steps, _, states = integrator.propagate_grid(scene.t)
            # At loose tolerances quaternions do not have unit length, which is not an error of the attitude.
            rung = with_errors(replace(rung, steps=int(steps)), scene, series.states(series.normalised(states)), truth,
                               scene.samples - 1, sizes(scene, truth.states))
    except CrosscheckError as error:
        return replace(rung, status="failed", reason=said(error)), None

    def once() -> float:
        _restart(integrator, series)
        start = time.perf_counter()
        integrator.propagate_until(scene.duration)
        return time.perf_counter() - start

    return rung, once


def _restart(integrator: Any, series: Taylor) -> None:
    integrator.time, integrator.state[:] = 0.0, series.initial
