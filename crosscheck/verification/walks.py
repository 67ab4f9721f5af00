"""Walks: the errors and times of every method of one engine on one scene at finer and finer steps.

First all methods, in the default form, are run with halved steps, or with tolerances that fall by half a power of ten.
The cheapest next run always comes first. Then steps between two halvings are searched for the errors of `LEVELS`, and
the cheapest runs take turns to measure their times. An engine gets `BUDGET` seconds on a scene, without the time to
load its package and to compute the truth. They are seconds of the processor, so that a busy machine finds as much as
an idle one, or of the clock for engines with processes of their own. Steps divide the interval between two output
times, as in `crosscheck.run`.
"""

from __future__ import annotations

import dataclasses
import heapq
import itertools
import math
import time
from collections.abc import Sequence

import numpy as np
from msgspec.structs import replace

from crosscheck import adapters, references
from crosscheck.document import Way, extended
from crosscheck.errors import Unsupported
from crosscheck.jobs.table import digest
from crosscheck.judge import tolerances
from crosscheck.references.base import Reference
from crosscheck.running import provenance
from crosscheck.running.attempt import Outcome, Ran, attempt, lasting
from crosscheck.scene.model import Scene
from crosscheck.verification.ladder import GradedWay, ways

BUDGET = 30.0
"""Time (s) for all runs of one engine on one scene, by `_Walker._busy`."""

WALK, SEARCH = 0.6, 0.85
"""Shares of the budget after which halving ends, and the search between halvings. The rest is for measuring times."""

LEVELS = tuple(10.0**-power for power in (2, 4, 6, 8, 10, 3, 5, 7, 9, 11, 1))
"""Largest position errors, m, around which steps are searched, in this order."""

RTOLS = tuple(10.0 ** (-half / 2) for half in range(2, 29))
"""Relative tolerances of adaptive methods."""

CLOSE = 1.12
"""The search ends if the accurate and the inaccurate number of steps differ by less than this factor."""

ROUND_OFF = 1e-9
"""Errors (m) below this that fall no more are rounding."""

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
"""A run whose error exceeds this share of the scene's size is useless."""


class Step(Way, frozen=True, kw_only=True):
    """One run of a method. `error` is the largest |component of x - truth| over bodies and samples."""

    order: int | None
    steps: int = 0
    error: float | None = None  # m; None if the run failed
    cost: float | None = None  # s of stepping
    reason: str = ""  # of the failure
    repeats: int = 1

    @property
    def fineness(self) -> float:
        """A number that grows from coarse runs to fine ones."""
        return 1.0 / (self.step or self.rtol or math.inf)


@dataclasses.dataclass
class Walk:
    """All runs of one engine on one scene."""

    scene: str
    engine: str
    size: float  # m, size of the scene
    until: float  # s, the last sample that counts, which is not past the horizon of truth
    seconds: float = 0.0  # of the budget that were used
    steps: list[Step] = dataclasses.field(default_factory=list)

    def of(self, method: str) -> list[Step]:
        """The runs of a method, coarse to fine."""
        return sorted((step for step in self.steps if step.method == method), key=lambda step: step.fineness)

    def reaching(self, error: float) -> list[Step]:
        """The coarsest run of each method with at most this error, the cheapest method first."""
        found: dict[str, Step] = {}
        for step in self.steps:
            if step.error is not None and step.error <= error:
                best = found.get(step.method)
                if best is None or step.fineness < best.fineness:
                    found[step.method] = step
        return sorted(found.values(), key=lambda step: step.cost or 0.0)


def walk(scene: Scene, engine: str) -> Walk:
    """The walk of an engine.

    Raises `Unsupported` if the engine cannot model the scene, and `TruthError` or `Unsupported` if it has no truth.
    """
    chosen, refused = ways(scene, [engine], default_form=True)
    if not chosen:
        raise Unsupported(f"{engine} on scene {scene.name!r}: {refused[0][1] if refused else 'it has no method'}")
    return _Walker(scene, engine, references.truth(scene)).go(chosen)


def key(scene: Scene, engine: str) -> str:
    """Digest of all that a walk depends on."""
    return digest("walk", provenance.code_digest([engine], []), scene.hash, BUDGET)


class _Walker:
    """Makes one walk."""

    def __init__(self, scene: Scene, engine: str, truth: Reference) -> None:
        self._scene, self._engine, self._truth = scene, engine, truth
        self._last = max(1, int(np.count_nonzero(truth.t <= truth.horizon * (1 + 1e-12))) - 1)
        self._interval = scene.duration / (scene.samples - 1)
        size = tolerances.scales(scene, truth).of("position")
        self._found = Walk(scene.name, engine, size, float(truth.t[self._last]))
        # Of engines in processes of their own, this process sees only the clock.
        apart = adapters.is_own(engine) or adapters.has_own_environment(engine)
        self._busy = time.perf_counter if apart else time.process_time
        self._began = math.inf  # set after the first run, which imports the engine and fills caches

    def go(self, chosen: Sequence[GradedWay]) -> Walk:
        """Run with halved steps, search between them, and measure times."""
        self._run(chosen[0], 1e-1 if chosen[0].adaptive else self._interval)
        self._began = self._busy()
        self._walk(chosen)
        for level in LEVELS:
            if self._found.reaching(level):
                for way in chosen:
                    if not way.adaptive:
                        self._bisect(way, level)
        self._turns()
        self._found.seconds = self._busy() - self._began
        return self._found

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
        traj, until = outcome.trajectory, self._last + 1
        error = float(np.abs(traj.x[:until] - self._truth.states.x[:until]).max())
        used = traj.stats.get("step", step.step) if step.rtol is None else None
        return replace(step, form=traj.form, steps=traj.steps, step=used, cost=cost,
                       error=error if math.isfinite(error) else None), taken

    def _timed(self, step: Step) -> tuple[Outcome, float]:
        """The outcome of a run at this step or tolerance and its stepping time (s), for a short run the least of a few.

        Stepping takes no longer than the processor was busy with the whole run: on a busy machine the clock also counts
        the time in which others had it.
        """
        costs: list[float] = []
        while True:
            began = self._busy()
            outcome = lasting(attempt(self._scene, step, monitor=False))
            if not isinstance(outcome, Ran):
                return outcome, math.inf
            costs.append(min(outcome.trajectory.wall_time, self._busy() - began))
            if len(costs) == TRIES or sum(costs) > SHORT:
                return outcome, min(costs)

    def _walk(self, chosen: Sequence[GradedWay]) -> None:
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
            self._found.steps.append(step)
            if not self._done(way, step):
                grown = 1.5 if way.adaptive else 2.0
                heapq.heappush(heap, (grown * max(taken, 0.5 * last), next(order), way, values, taken))

    def _done(self, way: GradedWay, step: Step) -> bool:
        """Whether finer runs of this way are useless, because of rounding or because another way is much better."""
        own = [each.error for each in self._found.of(way.method) if each.error is not None]
        if len(own) > 1 and own[-2] < ROUND_OFF and own[-1] > GAIN * own[-2]:
            return True
        if step.error is None or step.cost is None:
            return False
        rank = math.inf if way.adaptive else way.order or 0
        return any(other.method != way.method and other.error is not None and other.cost is not None
                   and (math.inf if other.rtol else other.order or 0) >= rank
                   and max(LOST * other.cost, SHORT) < step.cost and other.error < step.error / LOST
                   for other in self._found.steps)

    def _bisect(self, way: GradedWay, level: float) -> None:
        while True:
            steps = self._found.of(way.method)
            good = next((k for k, step in enumerate(steps) if step.error is not None and step.error <= level), None)
            if not good:  # no run reaches the level, or even the coarsest one does
                return
            coarse, fine = (max(1, round(self._interval / (step.step or self._interval))) for step in
                            (steps[good - 1], steps[good]))
            middle = round(math.sqrt(coarse * fine))
            pace = (steps[good].cost or 0.0) / fine
            least = self._found.reaching(level)[0].cost or 0.0
            if (middle in (coarse, fine) or fine < CLOSE * coarse or coarse * pace > least
                    or 2 * middle * pace > self._left(SEARCH)):
                return
            self._found.steps.append(self._run(way, self._interval / middle)[0])

    def _turns(self) -> None:
        """Measure the times of the cheapest runs in turns."""
        times: dict[int, list[float]] = {}  # by the place among the steps
        steps = self._found.steps
        places = {id(step): place for place, step in enumerate(steps)}
        for level in LEVELS:
            rivals = self._found.reaching(level)
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
