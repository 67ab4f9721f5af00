"""The ladder of runs: the ways to integrate a scene, each at steps or tolerances from coarse to fine, against truth.

A way is an engine, a method and a form. `crosscheck.advise` and the studies climb the same ladder, each as far as it
has to, and keep its rungs in the table of rows: no run is made twice. Times are measured anew where they count.
"""

from __future__ import annotations

import dataclasses
import math
import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any, TypeVar

import msgspec
import numpy as np
from msgspec.structs import replace

from crosscheck import adapters, references
from crosscheck.adapters.base import RunSpec
from crosscheck.compare.errors import errors
from crosscheck.compare.sizes import natural_time, sizes
from crosscheck.document import QUANTITIES, Record, Way, extended, largest
from crosscheck.files import digest
from crosscheck.judge.crossings import corrected_at_impacts
from crosscheck.references.base import Reference
from crosscheck.running import provenance
from crosscheck.running.attempt import Ran, attempt, lasting
from crosscheck.scene.model import Scene
from crosscheck.scene.states import States

if TYPE_CHECKING:
    from crosscheck.jobs.table import Session  # a database, which workers do not need

STAGE = "ladder"
"""Stage of the rows in the table that are ladders."""

INTERVALS = 64
"""Number of sample intervals for the largest errors: a power of two, as step counts of ladders are, up to a factor 3.
"""

RTOLS = tuple(10.0**-power for power in range(1, 15))
"""Relative tolerances of the adaptive methods."""


class GradedWay(Way, frozen=True, kw_only=True):
    """A way without step or rtol, of which there is a ladder."""

    adaptive: bool = False
    order: int | None = None  # documented


def ways(scene: Scene, engines: Sequence[str], methods: Sequence[str] | None = None,
         default_form: bool = False, options: Iterable[tuple[str, Any]] = ()
         ) -> tuple[list[GradedWay], list[tuple[GradedWay, str]]]:
    """All ways to integrate the scene, and the unsupported combinations with their reasons.

    Parameters
    ----------
    engines : names for `crosscheck.adapters.get`
    methods : only these; None: all
    default_form : only the form that the engine chooses by itself; the `form` of a way is None then
    options : names and values, for the engines that have such an option
    """
    possible, missing = [], []
    for name in engines:
        adapter = adapters.get(name)
        own = adapter.takes(options)
        forms = (None,) if default_form else adapter.forms or (None,)
        for form in forms:
            for method in adapter.methods:
                if methods is not None and method not in methods:
                    continue
                varies = method in adapter.adaptive_methods
                spec = RunSpec(method, None if varies else scene.duration / 64, RTOLS[0] if varies else None, form,
                               **own)
                reason = adapter.unsupported(scene, spec)
                way = GradedWay(name, method, form=form, adaptive=varies,
                                order=None if reason else adapter.documented_order(scene, spec)).having(own)
                if reason is None:
                    possible.append(way)
                else:
                    missing.append((way, reason))
    return possible, missing


def ladder(scene: Scene, way: GradedWay) -> Iterator[tuple[int | None, float]]:
    """(number of steps, step in s) of a fixed-step way, coarse to fine without end, or (None, rtol) of an adaptive one.

    The first step is about four natural times of the scene, and is divided by 3/2 and 4/3 in turn. For methods up to
    order 2 it is about one natural time and is halved, because errors of low order change less from step to step.
    """
    if way.adaptive:
        yield from ((None, rtol) for rtol in RTOLS)
        return
    low = way.order is not None and way.order <= 2
    natural = scene.duration / natural_time(scene) / (1 if low else 4)
    count = 2 ** max(1, math.floor(math.log2(max(natural, 1.0))))
    while True:
        yield count, scene.duration / count
        if not low:
            yield count * 3 // 2, scene.duration / (count * 3 // 2)
        count *= 2


class Rung(Way, frozen=True, kw_only=True):
    """One run of a way. Errors are the largest over the bodies, in SI. Times are of stepping alone.

    `setup_ms` is the other time of a run: building the engine's model and converting its two samples.
    """

    scene: str
    label: str
    order: int | None = None  # documented
    status: str = "success"  # or "skipped", "unsupported", or how it failed
    reason: str = ""
    steps: int | None = None
    rejected_steps: int | None = None
    force_evaluations: int | None = None  # if the engine counts them
    error: float | None = None  # the largest of all quantities and times, each over its size; None if the run failed
    end_position: float | None = None
    end_attitude: float | None = None
    max_position: float | None = None  # over the samples that lie on steps, as all that follow
    max_attitude: float | None = None
    max_velocity: float | None = None
    max_angular_velocity: float | None = None
    samples: int | None = None  # number of these
    wall_ms: float | None = None  # median over the repeats
    wall_deviation_ms: float | None = None  # median absolute deviation of the repeats
    setup_ms: float | None = None
    repeats: int = 0

    @property
    def errors(self) -> dict[str, float]:
        """The largest errors by quantity."""
        named = {name: getattr(self, f"max_{name.replace(' ', '_')}") for name in QUANTITIES}
        return {name: value for name, value in named.items() if value is not None}

    @property
    def cost(self) -> float:
        """Stepping time, s; 0 of a run that failed."""
        return 1e-3 * (self.wall_ms or 0.0)

    def missed(self, wanted: float | Mapping[str, float]) -> float:
        """The error over the wanted one: over the sizes of quantities, or in SI of those that are named."""
        if self.error is None:
            return math.inf
        return max(self.errors[name] / value for name, value in wanted.items()) if isinstance(
            wanted, Mapping) else self.error / wanted


def rung_of(scene: Scene, way: GradedWay, value: float | None, status: str = "success", reason: str = "") -> Rung:
    """The rung of a way at `value`: a step (s), or a tolerance if the way is adaptive."""
    return extended(Rung, way, scene=scene.name, label=way.label, order=way.order, status=status, reason=reason, **{
        "rtol" if way.adaptive else "step": value})


Run = TypeVar("Run", Rung, Record)


def reaching(runs: Iterable[Run], wanted: Any) -> list[Run]:
    """The coarsest run of each way with at most the wanted error, the cheapest first: whatever recommends asks this.

    wanted : over the sizes of quantities; of rungs also in SI, by quantity
    """
    coarsest: dict[str, Run] = {}
    for run in sorted(runs, key=lambda run: run.fineness):
        if run.missed(wanted) <= 1.0:
            coarsest.setdefault(run.label, run)
    return sorted(coarsest.values(), key=lambda run: run.cost)


class Ladder(msgspec.Struct, kw_only=True):
    """All runs of an engine on a scene that were made."""

    scene: str
    engine: str
    until: float  # s, the last sample that counts, which is not past the horizon of truth
    interval: float  # s, between two outputs
    ended: str = ""  # why truth ends before the scene
    rungs: dict[str, Rung] = {}  # by method, options, and step or tolerance
    climbed: list[float | dict[str, float]] = []  # the errors for which the cheapest run was looked for
    every: bool = False  # whether the largest usable step of every method was looked for
    stalled: bool = False  # whether errors fell no more

    @classmethod
    def kept(cls, scene: Scene, engine: str, until: float, session: Session | None) -> Ladder:
        """The one from the table, of any session, or one without rungs."""
        found: Ladder | None = None if session is None else session.get(STAGE, key(scene, engine), ever=True)
        return found or cls(scene=scene.name, engine=engine, until=until, interval=scene.interval)

    def of(self, label: str) -> list[Rung]:
        """The runs of a way, coarse to fine."""
        return sorted((rung for rung in self.rungs.values() if rung.label == label), key=lambda rung: rung.fineness)

    def reaching(self, wanted: float | Mapping[str, float]) -> list[Rung]:
        """As `reaching`, of the runs of this ladder."""
        return reaching(self.rungs.values(), wanted)


def key(scene: Scene, engine: str) -> str:
    """Digest of all that a ladder depends on: the code, the engine and its version, the scene and its times."""
    return digest(STAGE, provenance.code_digest([engine], []), scene.hash)


COARSE = 0.1
"""Processor time (s) below which that of another process says nothing of a run."""


class Climb:
    """Makes the runs of a ladder that it does not have yet; `busy` is the clock (s) of what a run takes."""

    def __init__(self, scene: Scene, truth: Reference, ladder: Ladder) -> None:
        self.scene, self.truth, self.ladder = scene, truth, ladder
        self._sizes = sizes(scene, truth.states)
        self.busy = adapters.clock(ladder.engine)

    @staticmethod
    def name(way: Way, size: float) -> str:
        """The name of a run among those of a ladder."""
        return f"{way.label} {size!r}"

    def run(self, way: GradedWay, size: float) -> Rung:
        """The run of a way at a step (s) or tolerance, with its errors, or why it fails.

        Raises `EngineDied` where the process of the engine has died, so that the run may succeed another time.
        """
        name = self.name(way, size)
        if name not in self.ladder.rungs:
            self.ladder.rungs[name] = self._run(rung_of(self.scene, way, size))
        return self.ladder.rungs[name]

    def _run(self, rung: Rung) -> Rung:
        intervals, start = self.scene.samples - 1, self.busy()
        if rung.step is not None:  # outputs that lie on steps
            intervals = math.gcd(intervals, round(self.scene.duration / rung.step))
        outcome = lasting(attempt(self.scene, rung, samples=intervals + 1, monitor=False, derived=False))
        if not isinstance(outcome, Ran):
            return replace(rung, status=outcome.status, reason=outcome.why)
        raw, counted = outcome.raw, outcome.raw.stats
        # On a busy machine the clock also counts the time in which others had the processor. That of other processes is
        # known to hundredths of a second, which may be more than the run takes.
        wall = min(raw.wall_time, max(self.busy() - start, 0.0 if self.busy is time.process_time else COARSE))
        rung = replace(rung, form=raw.form or rung.form, step=None if rung.step is None else raw.step, steps=raw.steps,
                       rejected_steps=counted.get("rejected_steps"), wall_ms=1e3 * wall, repeats=1,
                       force_evaluations=counted.get("force_evaluations"))
        return with_errors(rung, self.scene, raw.states, self.truth, intervals, self._sizes)


def with_errors(rung: Rung, scene: Scene, states: States, truth: Reference, intervals: int,
                over: Mapping[str, float]) -> Rung:
    """The rung with the errors of its run at `intervals` + 1 equally spaced times. Truth may have more samples.

    Velocities count where no impact is within a step. `over`: the sizes of quantities.
    """
    exact = truth.states.at(slice(None, None, (len(truth.t) - 1) // intervals))
    found = errors(scene, states, exact)
    off = found["position"].max
    if truth.events and math.isfinite(off):
        own = corrected_at_impacts(scene, states, dataclasses.replace(truth, states=exact), rung.step or 0.0, off)
        found = errors(scene, own, exact)
    most = {name: each.max for name, each in found.items()}
    error = float(largest(most, over) or 0.0)
    return replace(rung, samples=intervals + 1, error=error if math.isfinite(error) else None,
                   end_position=found["position"].end, end_attitude=found["attitude"].end,
                   **{f"max_{name.replace(' ', '_')}": value for name, value in most.items()})


def reference(scene: Scene) -> tuple[Scene, Reference]:
    """The scene, shortened to the horizon of its truth if necessary, and its truth at `INTERVALS` + 1 times.

    Raises `crosscheck.references.TruthError` or `Unsupported` for a scene without truth.
    """
    sampled = scene.replace(samples=INTERVALS + 1)
    truth = references.truth(sampled)
    if truth.horizon < scene.duration * (1 - 1e-12):
        sampled = sampled.replace(duration=float(np.floor(10 * truth.horizon) / 10) or truth.horizon)
        truth = references.truth(sampled)
    return sampled, truth
