"""Advice: the method and step of an engine that reach an error on a scene at the lowest cost, found by runs.

All methods, in the default form, climb the ladder of runs: steps are halved, or tolerances fall by half a power of ten.
The cheapest next run always comes first, and a method ends where a finer run would cost more than one that reaches the
error. Then steps between two halvings are searched, and the cheapest runs take turns to measure their times. An engine
gets `BUDGET` seconds on a scene, without the time to load its package and to compute the truth. They are seconds of
the processor, so that a busy machine finds as much as an idle one. Steps divide the interval between two output times,
as in `crosscheck.run`, and runs end with the truth.
"""

from __future__ import annotations

import contextlib
import dataclasses
import functools
import heapq
import itertools
import math
import os
import shlex
from collections.abc import Mapping, Sequence

import numpy as np
from msgspec.structs import replace

from crosscheck import references
from crosscheck.adapters.base import step_text
from crosscheck.compare.errors import up_to
from crosscheck.compare.sizes import check_moves
from crosscheck.compare.timing import take_turns, undisturbed
from crosscheck.document import QUANTITIES, Advice, Way, extended
from crosscheck.errors import ArgumentError, CrosscheckError, EngineDied, Unsupported, said, unknown
from crosscheck.references.base import Reference
from crosscheck.running import provenance
from crosscheck.scene.file import as_scene, load_scene
from crosscheck.scene.model import Scene
from crosscheck.verification.ladder import STAGE, Climb, GradedWay, Ladder, Rung, key, ways
from crosscheck.verification.speed import stepping_time

Wanted = float | dict[str, float]
"""An error: of every quantity over its size, or in SI by quantity."""

BUDGET = 30.0
"""Time (s) for the runs of one engine on one scene for one error, by `Climb.busy`."""

HALVING, SEARCHED = 0.6, 0.85
"""Shares of the budget after which halving ends, and the search between halvings. The rest is for measuring times."""

RTOLS = tuple(10.0 ** (-half / 2) for half in range(2, 29))
"""Relative tolerances of adaptive methods."""

CLOSE = 1.12
"""The search ends if the accurate and the inaccurate number of steps differ by less than this factor."""

GAIN = 0.7
"""An error falls if a run with half the step, or a third of the tolerance, has less than this share of it."""

NEAR, SHORT = 1.6, 0.02
"""Runs whose cost for an error is at most this multiple of the lowest one, or at most SHORT (s) more, are timed in
turns with the cheapest. Finer runs that would cost more than that are not made."""

ROUNDS, TRIES = 5, 3
"""Number of turns of each of them, of which the fastest counts, and the most runs of a turn."""

USELESS = 0.1
"""A run with a larger error is useless."""


def climb(scene: Scene, engine: str, wanted: Sequence[Wanted], ladder: Ladder | None = None, every: bool = False
          ) -> Ladder:
    """The ladder of an engine with the cheapest run of each wanted error, as far as the budget goes.

    Parameters
    ----------
    ladder : with the runs that were made before
    every : in place of these, the largest usable step of every method is looked for

    Raises `Unsupported` if the engine cannot model the scene or nothing moves, and `TruthError` or `Unsupported` if it
    has no truth.
    """
    chosen, refused = ways(scene, [engine], default_form=True)
    if not chosen:
        raise Unsupported(f"{engine} on scene {scene.name!r}: {refused[0][1] if refused else 'it has no method'}")
    truth = references.truth(scene)
    check_moves(scene, truth.states)
    search = _Search(scene, engine, truth, ladder, every)
    search.begin(chosen[0])
    for error in (USELESS,) if every else wanted:
        search.look_for(error, chosen)
    return search.ladder


class _Search:
    """Climbs the ladder of one engine on one scene for one error after the other."""

    def __init__(self, scene: Scene, engine: str, truth: Reference, ladder: Ladder | None, every: bool) -> None:
        last = max(1, int(np.count_nonzero(up_to(truth.t, truth.horizon))) - 1)
        until = float(truth.t[last])
        self._interval, self._every = scene.interval, every
        self.ladder = ladder or Ladder(scene=scene.name, engine=engine, until=until, interval=scene.interval,
                                       ended=truth.horizon_cause)
        self._climb = Climb(scene.replace(duration=until, samples=last + 1), dataclasses.replace(
            truth, states=truth.states.at(slice(0, last + 1))), self.ladder)
        self._began = math.inf

    def begin(self, way: GradedWay) -> None:
        """One run, which imports the engine and fills caches, before the budget begins."""
        self._climb.run(way, 1e-1 if way.adaptive else self._interval)
        self._began = self._climb.busy()

    def look_for(self, wanted: Wanted, chosen: Sequence[GradedWay]) -> None:
        """Run with halved steps, search between them, and measure the times of the cheapest runs."""
        if not self._every and wanted in self.ladder.climbed:
            return
        self._halve(chosen, wanted)
        for way in chosen:
            if not way.adaptive:
                self._between(way, wanted)
        if self._every:
            self.ladder.every = True
            return
        self._time(wanted)
        self.ladder.climbed.append(wanted)

    def _left(self, share: float = 1.0) -> float:
        return share * BUDGET - (self._climb.busy() - self._began)

    def _most(self, wanted: Wanted) -> float:
        """The cost (s) above which no run is a rival of the cheapest one."""
        reaching = self.ladder.reaching(wanted)
        least = math.inf if self._every or not reaching else reaching[0].cost
        return max(NEAR * least, least + SHORT)

    def _halve(self, chosen: Sequence[GradedWay], wanted: Wanted) -> None:
        """Run all ways at halved steps or at tolerances, always the one with the cheapest next run."""
        order = itertools.count()
        heap = [(0.0, next(order), way, iter(RTOLS if way.adaptive else [
            self._interval / 2**power for power in range(31)]), list[Rung]()) for way in chosen]
        self.ladder.stalled = True
        while heap:
            expected, _, way, sizes, made = heapq.heappop(heap)
            grown = 1.5 if way.adaptive else 2.0
            if made and grown * made[-1].cost > self._most(wanted):
                continue
            if expected >= self._left(HALVING):
                self.ladder.stalled = False
                continue
            if (size := next(sizes, None)) is None:
                continue
            start = self._climb.busy()
            made.append(self._climb.run(way, size))
            if not self._ends(made, wanted):
                heapq.heappush(heap, (grown * (self._climb.busy() - start), next(order), way, sizes, made))

    def _ends(self, made: Sequence[Rung], wanted: Wanted) -> bool:
        """Whether finer runs of a way are useless: it reaches the error, or errors fall no more in two halvings."""
        last = [rung.missed(wanted) for rung in made[-3:]]
        if last[-1] <= 1.0:
            return not self._every or (len(last) == 3 and max(last) <= 1.0)
        return len(last) == 3 and not any(_useless(rung) for rung in made[-3:]) and (
            last[1] > GAIN * last[0] and last[2] > GAIN * last[1])

    def _between(self, way: GradedWay, wanted: Wanted) -> None:
        """Search for the largest step between one that misses the error and one that reaches it, by their order."""
        while True:
            rungs = self.ladder.of(way.label)
            good = next((k for k, rung in enumerate(rungs) if rung.missed(wanted) <= 1.0), None)
            if not good:  # no run reaches the error, or even the coarsest one does
                return
            coarse, fine = (max(1, round(self._interval / (rung.step or self._interval))) for rung in
                            rungs[good - 1:good + 1])
            over, under = (rung.missed(wanted) for rung in rungs[good - 1:good + 1])
            share = math.log(over) / math.log(over / under) if math.isfinite(over) and under > 0 else 0.5
            expected = math.ceil(coarse * (fine / coarse) ** share)
            middle = min(max(expected, int(CLOSE * coarse)), math.ceil(fine / CLOSE), fine - 1)
            pace = rungs[good].cost / fine
            if (not coarse < middle < fine or fine < CLOSE * coarse or coarse * pace > self._most(wanted)
                    or 2 * middle * pace > self._left(SEARCHED)):
                return
            self._climb.run(way, self._interval / middle)

    def _time(self, wanted: Wanted) -> None:
        """Measure the times of the cheapest runs in turns."""
        most = self._most(wanted)
        names = {id(rung): name for name, rung in self.ladder.rungs.items()}
        rivals = {names[id(rung)]: rung for rung in self.ladder.reaching(wanted)
                  if rung.cost <= most and TRIES * ROUNDS * rung.cost < self._left()}
        times: dict[str, list[float]] = {name: [] for name in rivals}
        for name, time in take_turns({name: functools.partial(undisturbed, functools.partial(
                stepping_time, self._climb.scene, rung), TRIES, SHORT) for name, rung in rivals.items()}, ROUNDS):
            if not isinstance(time, CrosscheckError):  # a failure leaves the time that is known
                times[name].append(time[0])
        for name, own in times.items():
            if own:
                self.ladder.rungs[name] = replace(rivals[name], wall_ms=1e3 * min(own), repeats=len(own))


def _useless(rung: Rung) -> bool:
    """Whether a run failed, or is wrong by more than a tenth of the size of a quantity."""
    return rung.missed(USELESS) > 1.0


LEVELS = tuple(10.0**-power for power in range(2, 12))
"""Errors for which a document has advice."""

def advise(scene: Scene | str | os.PathLike[str], *, engine: str,
           error: float | Mapping[str, float]) -> Advice:
    """The cheapest method of an engine whose error on a scene is at most `error`, with its largest step.

    It runs the methods at finer and finer steps, for at most half a minute of processor time, and keeps the results.
    What was run before, for any error, is not run again.

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
        The engine cannot model the scene, or the scene has no truth or does not move.
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
    provenance.need([engine])
    name = scene.name if isinstance(scene, Scene) else os.fspath(scene)
    made = choose(_kept(loaded, engine, wanted), wanted, name)
    if made.command is None or made.until >= loaded.duration * (1 - 1e-9):
        return made
    samples = 1 + round(made.until / loaded.interval)  # the same times of output; beyond the last there is no truth
    return replace(made, command=f"{made.command} --duration {made.until!r} --samples {samples}")


def _positive(error: object) -> float:
    try:
        wanted = float(error)  # type: ignore[arg-type]  # what is no number is refused here
    except (TypeError, ValueError):
        wanted = math.nan
    if isinstance(error, bool) or not (math.isfinite(wanted) and wanted > 0):
        raise ArgumentError(f"error: a positive number is wanted, or one by quantity as {{'position': 1e-4}}, not "
                            f"{error!r}")
    return wanted


def _kept(scene: Scene, engine: str, wanted: Wanted) -> Ladder:
    """The ladder of an engine from the table, climbed for an error and put there; errors as `climb`."""
    from crosscheck.jobs.table import Table  # a database, which workers do not need

    name = key(scene, engine)
    with contextlib.closing(Table.opened()) as table, table.session(
            name, f"advise {scene.name} {engine}", {STAGE: Ladder}) as session:
        known: Ladder | None = session.get(STAGE, name)
        if known is not None and wanted in known.climbed:
            return known
        ladder: Ladder = session.put(STAGE, name, climb(scene, engine, [wanted], known))
        return ladder


def choose(ladder: Ladder, wanted: Wanted, scene: str) -> Advice:
    """The advice for an error from all runs of an engine. `scene` is the name or path for the command."""
    known = [rung.error for rung in ladder.rungs.values() if rung.error is not None]
    reaching = ladder.reaching(wanted)
    ended = "down to steps at which errors fall no more" if ladder.stalled else f"within the budget of {BUDGET:g} s"
    advice = Advice(scene=ladder.scene, engine=ladder.engine, wanted=wanted, until=ladder.until, ended=ladder.ended,
                    least=min(known, default=None), tried=f"{ended}; {_finest(list(ladder.rungs.values()))}")
    if not reaching:
        return advice
    best = reaching[0]
    size = f"--step {step_text(ladder.interval, best.step)}" if best.step else f"--rtol {best.rtol!r}"
    words = f"crosscheck run {shlex.quote(scene)} --engine {shlex.quote(ladder.engine)} --method {best.method} {size}"
    if best.label != extended(Way, best, form=None).label:  # not as the engine chooses by itself
        words += f" --form {best.form}"
    broken = [rung for rung in ladder.of(best.label) if rung.fineness < best.fineness and _useless(rung)]
    return replace(
        advice, method=best.method, form=best.form, step=best.step, rtol=best.rtol, error=best.error,
        errors=best.errors, cost=best.cost, command=words,
        breaks_at=(broken[-1].step or broken[-1].rtol) if broken else None)


def _finest(runs: Sequence[Way]) -> str:
    """The finest of the steps, or tolerances, of runs, in words."""
    steps, rtols = ([value for run in runs if (value := getattr(run, name))] for name in ("step", "rtol"))
    return "; ".join([*([f"finest step tried {min(steps):.2g} s"] if steps else ()),
                      *([f"finest rtol tried {min(rtols):.2g}"] if rtols else ())]) or "no run was made"


def of_ladders(scenes: Sequence[str], ladders: Sequence[object]) -> list[Advice]:
    """The advice for those of `LEVELS` that ladders on scenes (names or paths) were climbed for."""
    return [choose(ladder, level, name) for name, ladder in zip(scenes, ladders, strict=True)
            if isinstance(ladder, Ladder) for level in LEVELS if level in ladder.climbed]


def prepare(task: tuple[str, str, Ladder | None], wanted: Sequence[Wanted] = LEVELS, every: bool = False
            ) -> Ladder | str:
    """The ladder of an engine on a scene, with the runs that are known, or why it cannot be climbed."""
    scene, engine, ladder = task
    try:
        return climb(load_scene(scene), engine, wanted, ladder, every)
    except EngineDied:
        raise
    except (CrosscheckError, ImportError) as error:
        return said(error)
