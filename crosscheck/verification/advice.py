"""Advice: the method and step of an engine that reach an error on a scene at the lowest cost, found by runs.

A search is the errors and times of every method of one engine on one scene at finer and finer steps, made once for all
errors. First all methods, in the default form, are run with halved steps, or with tolerances that fall by half a power
of ten. The cheapest next run always comes first. Then steps between two halvings are searched for the errors of
`SEARCHED`, and the cheapest runs take turns to measure their times. An engine gets `BUDGET` seconds on a scene, without
the time to load its package and to compute the truth. They are seconds of the processor, so that a busy machine finds
as much as an idle one, or of the clock for engines with processes of their own. Steps divide the interval between two
output times, as in `crosscheck.run`. Where a document has no search, its records say what to expect: the error and time
of a run at one step, and the observed order.
"""

from __future__ import annotations

import contextlib
import dataclasses
import heapq
import itertools
import math
import os
import shlex
import time
from collections.abc import Mapping, Sequence

import msgspec
import numpy as np
from msgspec.structs import replace

from crosscheck import adapters, references
from crosscheck.compare.errors import errors, up_to
from crosscheck.compare.sizes import sizes
from crosscheck.document import QUANTITIES, Advice, Record, SceneTruth, Way, extended, largest
from crosscheck.errors import ArgumentError, CrosscheckError, EngineDied, Unsupported, said, unknown
from crosscheck.files import digest
from crosscheck.judge.crossings import corrected_at_impacts
from crosscheck.references.base import Reference
from crosscheck.running import provenance, versions
from crosscheck.running.attempt import Outcome, Ran, attempt, lasting
from crosscheck.scene.file import as_scene, load_scene
from crosscheck.scene.model import Scene
from crosscheck.scene.states import States
from crosscheck.verification.ladder import GradedWay, ways

BUDGET = 30.0
"""Time (s) for all runs of one engine on one scene, by `_Walker._busy`."""

WALK, SEARCH = 0.6, 0.85
"""Shares of the budget after which halving ends, and the search between halvings. The rest is for measuring times."""

SEARCHED = tuple(10.0**-power for power in (2, 4, 6, 8, 10, 3, 5, 7, 9, 11, 1))
"""Errors around which steps are searched, in this order."""

RTOLS = tuple(10.0 ** (-half / 2) for half in range(2, 29))
"""Relative tolerances of adaptive methods."""

CLOSE = 1.12
"""The search ends if the accurate and the inaccurate number of steps differ by less than this factor."""

ROUND_OFF = 1e-9
"""Errors below this that fall no more are rounding."""

GAIN = 0.7
"""An error falls if a run with half the step, or a third of the tolerance, has less than this share of it."""

NEAR = 1.6
"""Methods whose cost for an error is at most this multiple of the lowest one, or at most SHORT dearer, are timed in
turns with the cheapest."""

ROUNDS = 5
"""Number of turns of each of them, of which the fastest counts."""

TRIES, SHORT = 3, 0.02
"""A turn is the fastest of at most TRIES runs. No run begins after SHORT s of stepping. On a busy machine a run may
wait that long for its processor, which makes single figures of short runs meaningless."""

LOST = 4.0
"""A method gets no finer runs if another one, of no lower order, has LOST times smaller cost and error, and its own
cost is more than SHORT."""

USELESS = 0.1
"""A run with a larger error is useless."""


class Step(Way, frozen=True, kw_only=True):
    """One run of a method, with its largest errors over bodies and samples."""

    order: int | None
    steps: int = 0
    error: float | None = None  # the largest of all quantities, each over its size; None if the run failed
    errors: dict[str, float] = msgspec.field(default_factory=dict)  # SI, by quantity
    cost: float | None = None  # s of stepping
    reason: str = ""  # of the failure
    repeats: int = 1

    @property
    def fineness(self) -> float:
        """A number that grows from coarse runs to fine ones."""
        return 1.0 / (self.step or self.rtol or math.inf)

    def reaches(self, wanted: float | Mapping[str, float]) -> bool:
        """Whether the error is at most the wanted one."""
        if isinstance(wanted, Mapping):
            return self.error is not None and all(self.errors[name] <= value for name, value in wanted.items())
        return self.error is not None and self.error <= wanted


@dataclasses.dataclass
class Search:
    """All runs of one engine on one scene."""

    scene: str
    engine: str
    until: float  # s, the last sample that counts, which is not past the horizon of truth
    seconds: float = 0.0  # of the budget that were used
    steps: list[Step] = dataclasses.field(default_factory=list)

    def of(self, method: str) -> list[Step]:
        """The runs of a method, coarse to fine."""
        return sorted((step for step in self.steps if step.method == method), key=lambda step: step.fineness)

    def useless(self, step: Step) -> bool:
        """Whether a run failed, or is wrong by more than a tenth of the size of a quantity."""
        return not step.reaches(USELESS)

    def reaching(self, error: float | Mapping[str, float]) -> list[Step]:
        """The coarsest run of each method with at most this error, the cheapest method first."""
        coarsest: dict[str, Step] = {}
        for step in self.steps:
            if step.reaches(error):
                best = coarsest.get(step.method)
                if best is None or step.fineness < best.fineness:
                    coarsest[step.method] = step
        return sorted(coarsest.values(), key=lambda step: step.cost or 0.0)


def search(scene: Scene, engine: str) -> Search:
    """The search of an engine for its steps.

    Raises `Unsupported` if the engine cannot model the scene, and `TruthError` or `Unsupported` if it has no truth.
    """
    chosen, refused = ways(scene, [engine], default_form=True)
    if not chosen:
        raise Unsupported(f"{engine} on scene {scene.name!r}: {refused[0][1] if refused else 'it has no method'}")
    return _Searcher(scene, engine, references.truth(scene)).go(chosen)


def key(scene: Scene, engine: str) -> str:
    """Digest of all that a search depends on."""
    return digest("search", provenance.code_digest([engine], []), scene.hash, BUDGET)


class _Searcher:
    """Makes one search."""

    def __init__(self, scene: Scene, engine: str, truth: Reference) -> None:
        self._scene, self._engine, self._truth = scene, engine, truth
        self._last = max(1, int(np.count_nonzero(up_to(truth.t, truth.horizon))) - 1)
        self._interval = scene.duration / (scene.samples - 1)
        self._sizes = sizes(scene, truth.states)
        self._search = Search(scene.name, engine, float(truth.t[self._last]))
        # Of engines in processes of their own, this process sees only the clock.
        apart = adapters.is_own(engine) or adapters.has_own_environment(engine)
        self._busy = time.perf_counter if apart else time.process_time
        self._began = math.inf  # set after the first run, which imports the engine and fills caches

    def go(self, chosen: Sequence[GradedWay]) -> Search:
        """Run with halved steps, search between them, and measure times."""
        self._run(chosen[0], 1e-1 if chosen[0].adaptive else self._interval)
        self._began = self._busy()
        self._halve(chosen)
        for level in SEARCHED:
            if self._search.reaching(level):
                for way in chosen:
                    if not way.adaptive:
                        self._bisect(way, level)
        self._turns()
        self._search.seconds = self._busy() - self._began
        return self._search

    def _left(self, share: float = 1.0) -> float:
        return share * BUDGET - (self._busy() - self._began)

    def _run(self, way: GradedWay, value: float) -> tuple[Step, float]:
        """One run, and what it takes of the budget (s). If it fails, `reason` says why."""
        step = replace(extended(Step, way), **{"rtol" if way.adaptive else "step": value})
        start = self._busy()
        outcome, cost = self._timed(step)
        taken = self._busy() - start
        if not isinstance(outcome, Ran):
            return replace(step, reason=outcome.why), taken
        raw, used = outcome.raw, outcome.raw.step if step.rtol is None else None
        found = self._errors(raw.states, used or 0.0)
        error = largest(found, self._sizes)
        return replace(step, form=raw.form, steps=raw.steps, step=used, cost=cost, errors=found,
                       error=error if error is not None and math.isfinite(error) else None), taken

    def _errors(self, states: States, step: float) -> dict[str, float]:
        """The largest errors by quantity; velocities count where no impact is within a step (s)."""
        found = errors(self._scene, states, self._truth.states, self._search.until)
        off = found["position"].max
        if self._truth.events and math.isfinite(off):
            own = corrected_at_impacts(self._scene, states, self._truth, step, off)
            found = errors(self._scene, own, self._truth.states, self._search.until)
        return {name: each.max for name, each in found.items()}

    def _timed(self, step: Step) -> tuple[Outcome, float]:
        """The outcome of a run at this step or tolerance and its stepping time (s), for a short run the least of a few.

        Stepping takes no longer than the processor was busy with the whole run: on a busy machine the clock also counts
        the time in which others had it.
        """
        costs: list[float] = []
        while True:
            began = self._busy()
            outcome = lasting(attempt(self._scene, step, monitor=False, derived=False))
            if not isinstance(outcome, Ran):
                return outcome, math.inf
            costs.append(min(outcome.raw.wall_time, self._busy() - began))
            if len(costs) == TRIES or sum(costs) > SHORT:
                return outcome, min(costs)

    def _halve(self, chosen: Sequence[GradedWay]) -> None:
        """Run all ways at halved steps or at tolerances, always the one with the cheapest next run."""
        order = itertools.count()
        heap = [(0.0, next(order), way, iter(
            RTOLS if way.adaptive else [self._interval / 2**power for power in range(31)]), 0.0) for way in chosen]
        while heap:
            expected, _, way, values, last = heapq.heappop(heap)
            if expected >= self._left(WALK):
                continue
            value = next(values, None)
            if value is None:
                continue
            step, taken = self._run(way, value)
            self._search.steps.append(step)
            if not self._done(way, step):
                grown = 1.5 if way.adaptive else 2.0
                heapq.heappush(heap, (grown * max(taken, 0.5 * last), next(order), way, values, taken))

    def _done(self, way: GradedWay, step: Step) -> bool:
        """Whether finer runs of this way are useless, because of rounding or because another way is much better."""
        own = [each.error for each in self._search.of(way.method) if each.error is not None]
        if len(own) > 1 and own[-2] < ROUND_OFF and own[-1] > GAIN * own[-2]:
            return True
        if step.error is None or step.cost is None:
            return False
        rank = math.inf if way.adaptive else way.order or 0
        return any(other.method != way.method and other.error is not None and other.cost is not None
                   and (math.inf if other.rtol else other.order or 0) >= rank
                   and max(LOST * other.cost, SHORT) < step.cost and other.error < step.error / LOST
                   for other in self._search.steps)

    def _bisect(self, way: GradedWay, level: float) -> None:
        while True:
            steps = self._search.of(way.method)
            good = next((k for k, step in enumerate(steps) if step.error is not None and step.error <= level), None)
            if not good:  # no run reaches the level, or even the coarsest one does
                return
            coarse, fine = (max(1, round(self._interval / (step.step or self._interval))) for step in
                            (steps[good - 1], steps[good]))
            middle = round(math.sqrt(coarse * fine))
            pace = (steps[good].cost or 0.0) / fine
            least = self._search.reaching(level)[0].cost or 0.0
            if (middle in (coarse, fine) or fine < CLOSE * coarse or coarse * pace > least
                    or 2 * middle * pace > self._left(SEARCH)):
                return
            self._search.steps.append(self._run(way, self._interval / middle)[0])

    def _turns(self) -> None:
        """Measure the times of the cheapest runs in turns."""
        times: dict[int, list[float]] = {}  # by the place among the steps
        steps = self._search.steps
        places = {id(step): place for place, step in enumerate(steps)}
        for level in SEARCHED:
            rivals = self._search.reaching(level)
            least = rivals[0].cost or 0.0 if rivals else 0.0
            times |= {places[id(step)]: [] for step in rivals[:6]
                      if (step.cost or 0.0) <= max(NEAR * least, least + SHORT)}
        for _ in range(ROUNDS):
            for place, own in times.items():
                if TRIES * (steps[place].cost or 0.0) < self._left():
                    own.append(self._timed(steps[place])[1])
        for place, own in times.items():
            if any(map(math.isfinite, own)):  # a failure leaves the time that is known
                steps[place] = replace(steps[place], cost=min(own), repeats=len(own))


LEVELS = tuple(10.0**-power for power in range(2, 12))
"""Errors for which a document has advice."""

MARGIN = 1.5
"""What an estimated error keeps from the wanted one: on the default scenes estimates were off by up to 1.25."""


def advise(scene: Scene | str | os.PathLike[str], *, engine: str,
           error: float | Mapping[str, float]) -> Advice:
    """The cheapest method of an engine whose error on a scene is at most `error`, with its largest step.

    The first call for a scene and engine runs every method at many steps, for at most half a minute of processor time,
    and stores the results. Later calls, for any error, read them.

    Parameters
    ----------
    scene : Scene, str or path
        A scene from `crosscheck.load_scene`, the name of a bundled scene, or the path of a scene file.
    engine : str
        As in `crosscheck.run`.
    error : float or dict
        The largest allowed error over all bodies and output times: of position, attitude, velocity and angular
        velocity, each over its size in the scene (length, 1, largest speed and rate). A dict is in SI, by quantity,
        as {"position": 1e-4}, and then these quantities alone count.

    Raises
    ------
    ArgumentError, SceneError
        As in `crosscheck.run`.
    Unsupported
        The engine cannot model the scene, or the scene has no truth.
    TruthError
        The two formulations of the truth disagree.
    """
    wanted: float | dict[str, float]
    if isinstance(error, Mapping):
        if not error or (strange := next((name for name in error if name not in QUANTITIES), None)) is not None:
            raise ArgumentError(unknown("quantity of error", strange, tuple(QUANTITIES)) if error else
                                "error: no quantity is given; write {'position': 1e-4}")
        wanted = {name: _positive(value) for name, value in error.items()}
    else:
        wanted = _positive(error)
    loaded = as_scene(scene)
    versions.need([engine])
    name = scene.name if isinstance(scene, Scene) else os.fspath(scene)
    return choose(stored_search(loaded, engine), wanted, name)


def _positive(error: object) -> float:
    try:
        wanted = float(error)  # type: ignore[arg-type]  # what is no number is refused here
    except (TypeError, ValueError):
        wanted = math.nan
    if isinstance(error, bool) or not (math.isfinite(wanted) and wanted > 0):
        raise ArgumentError(f"error: a positive number is wanted, or one by quantity as {{'position': 1e-4}}, not "
                            f"{error!r}")
    return wanted


def stored_search(scene: Scene, engine: str) -> Search:
    """The search of an engine from the table, where it is put if it is new; errors as `search`."""
    from crosscheck.jobs.table import Table  # a database, which workers do not need

    name = key(scene, engine)
    with contextlib.closing(Table.opened()) as table, table.session(
            name, f"advise {scene.name} {engine}", {"search": Search}) as session:
        kept: Search | None = session.get("search", name)
        return kept or session.put("search", name, search(scene, engine))


def choose(search: Search, wanted: float | dict[str, float], scene: str) -> Advice:
    """The advice for an error from all runs of an engine. `scene` is the name or path for the command."""
    known = [step.error for step in search.steps if step.error is not None]
    reaching = search.reaching(wanted)
    advice = Advice(scene=search.scene, engine=search.engine, wanted=wanted, until=search.until,
                    least=min(known, default=None),
                    tried=f"within the budget of {BUDGET:g} s; {_finest(search.steps)}")
    if not reaching:
        return advice
    best = reaching[0]
    size = f"--step {best.step!r}" if best.step else f"--rtol {best.rtol!r}"
    words = f"crosscheck run {shlex.quote(scene)} --engine {shlex.quote(search.engine)} --method {best.method} {size}"
    return replace(
        advice, method=best.method, form=best.form, step=best.step, rtol=best.rtol, error=best.error,
        errors=best.errors, cost=best.cost, breaks_at=breaks_at(search, best), command=words)


def breaks_at(search: Search, best: Step) -> float | None:
    """Step (s) or rtol of the finest of the useless runs that are coarser than `best`. None if no run is useless."""
    broken = [step for step in search.of(best.method) if step.fineness < best.fineness and search.useless(step)]
    return (broken[-1].step or broken[-1].rtol) if broken else None


def _finest(runs: Sequence[Way]) -> str:
    """The finest of the steps, or tolerances, of runs, in words."""
    steps, rtols = ([value for run in runs if (value := getattr(run, name))] for name in ("step", "rtol"))
    return "; ".join([*([f"finest step tried {min(steps):.2g} s"] if steps else ()),
                      *([f"finest rtol tried {min(rtols):.2g}"] if rtols else ())]) or "no run was made"


def of_searches(scenes: Sequence[str], searches: Sequence[object]) -> list[Advice]:
    """The advice for all `LEVELS` from the searches on scenes (names or paths) that could be made."""
    return [choose(search, level, name) for name, search in zip(scenes, searches, strict=True)
            if isinstance(search, Search) for level in LEVELS]


def from_records(scenes: Sequence[SceneTruth], records: Sequence[Record], known: Sequence[Advice]) -> list[Advice]:
    """The advice for all `LEVELS` that records allow, for scenes and engines for which none is known."""
    searched = {(each.scene, each.engine) for each in known}
    return [_estimate(scene, [record for record in records if (record.scene, record.engine) == (scene.name, engine)],
                      level)
            for scene in scenes if scene.truth is not None and scene.plan is not None
            for engine in dict.fromkeys(record.engine for record in records if record.scene == scene.name
                                        and record.outcome != "unsupported")
            if (scene.name, engine) not in searched for level in LEVELS]


def _estimate(scene: SceneTruth, records: Sequence[Record], wanted: float) -> Advice:
    """The cheapest of the passing runs of an engine, each at the largest step that its order promises the error for.

    No step is longer than the coarsest one at which the order was observed, and none shorter than a hundredth of the
    step of the run: beyond them the order is not known to hold.
    """
    passing = [record for record in records if record.within
               and math.isfinite(record.error) and record.wall_time]
    advice = Advice(scene=scene.name, engine=records[0].engine, wanted=wanted, until=scene.duration,
                    least=min((record.error for record in passing), default=None),
                    tried=f"among the runs of this report and the steps that their orders let expect; "
                          f"{_finest(passing)}")
    expected = [each for record in passing if (each := _expected(scene, record, advice)) is not None]
    return min(expected, key=lambda each: each.cost or 0.0, default=advice)


def _expected(scene: SceneTruth, record: Record, asked: Advice) -> Advice | None:
    """The run at the step that a record lets expect for an error; None if the record promises no such step."""
    wanted = asked.wanted
    assert isinstance(wanted, float)
    error, step = record.error, record.step
    assert scene.plan is not None
    assert record.wall_time is not None
    estimated = f"the run at rtol {record.rtol:g}" if step is None else f"the run at {step:g} s"
    stretch = 1.0
    if step is not None and record.order is not None and error > 0.0:
        order = min(record.order.observed, float(record.order.documented))
        coarsest = max((rung.step for rung in record.ladder if rung.step), default=step)
        interval = (record.duration or scene.duration) / (scene.plan.samples - 1)
        longest = min(step * (wanted / MARGIN / error) ** (1 / order), max(coarsest, step), interval)
        if longest < step / 100:
            return None
        stretch = interval / math.ceil(interval / longest * (1 - 1e-9)) / step
        error *= stretch**order
        estimated += f" and its observed order {record.order.observed:.2f}"
    if error > wanted * (1 + 1e-9):
        return None
    command = record.command.removesuffix(" --csv run.csv")
    if step is not None:
        command = command.replace(f"--step {step!r}", f"--step {step * stretch!r}")
    return replace(asked, until=scene.duration, method=record.method, form=record.form,
                   step=None if step is None else step * stretch, rtol=record.rtol, error=error,
                   cost=record.wall_time / stretch, command=command, estimated=estimated)


def prepare(task: tuple[str, str]) -> Search | str:
    """The search of an engine on a scene, or why it cannot be made."""
    scene, engine = task
    try:
        return search(load_scene(scene), engine)
    except EngineDied:
        raise
    except (CrosscheckError, ImportError) as error:
        return said(error)
