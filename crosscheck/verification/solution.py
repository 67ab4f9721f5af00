"""The verdict by solution verification: where an engine's answers at a few steps go, against truth, within U.

R1 the run is what the engine answers from states of that run, elsewhere; R2 its answers converge to truth; R3 it keeps
what it promises; R4 it did what was asked.
"""

from __future__ import annotations

import dataclasses
import functools
import math
from collections.abc import Mapping, Sequence

import numpy as np

from crosscheck import adapters
from crosscheck.adapters.base import RunSpec, steps_per_sample
from crosscheck.compare.apart import ROUNDED, STATE, Rows, apart, largest, scaled, spread
from crosscheck.compare.ladder import FEWEST, counts, finer
from crosscheck.compare.order import (
    MARGIN,
    SAFETY,
    Limit,
    differ,
    index,
    limit,
    observed_order,
    spread_of_tolerances,
)
from crosscheck.compare.sizes import at_rest, length_of, sizes
from crosscheck.document import Finding, Order, Record, Rung
from crosscheck.errors import Unsupported
from crosscheck.judge.rounding import EPS, grading
from crosscheck.judge.rules import RESOLVED, WHY, Check, Rule, findings, limit_check, shares, told, visible
from crosscheck.judge.segments import SEGMENTS, Segment, fill, growth, segments_of
from crosscheck.judge.system_flow import MOVED, Flowed, Jump, SystemFlow, grown, moved
from crosscheck.references import TruthError
from crosscheck.references.base import Reference
from crosscheck.references.maximal import fastest
from crosscheck.running.trajectory import Trajectory
from crosscheck.scene.assembly import closed
from crosscheck.scene.model import Scene
from crosscheck.scene.states import States
from crosscheck.verification.probe import Answer, Probe, answer_of

HALVINGS = 2
"""Finer steps that are tried before a segment fails or stays unresolved (Roache: until the order shows)."""
ASKED_AGAIN = 2
"""Segments in which the same question is asked again, and how often, for noise: the fewest that show a scatter."""
TENFOLD = 10.0
"""Factor between the tolerances that an adaptive method is asked at, as in tests of such codes (Hairer, Wanner)."""
PAIR = 3
"""Order that is assumed of an adaptive method that documents none: that of the lower formula of a pair 4(3)."""
ACCELERATIONS = ("acceleration", "angular acceleration")
OF_STATE = (*STATE, "orthogonality", "energy")
"""Rows whose order is that of the method: they are states, or follow from them alone."""


@dataclasses.dataclass
class Sequence3:
    """Answers to one segment, the finest first; refined ones are put before."""

    steps: list[float]  # s, or tolerances
    counts: list[int]  # steps of one interval between outputs; none of tolerances
    answers: list[Answer]
    far: tuple[float, Answer] | None = None  # a far smaller step, and the answer there
    orders: list[float] = dataclasses.field(default_factory=list)  # as observed, one a refinement
    promised: dict[str, float] = dataclasses.field(default_factory=dict)  # orders of accelerations less the states' own
    order: float | None = None  # what follows from these; None where the motion is not smooth, or all is rounding


@dataclasses.dataclass(frozen=True)
class Verdict:
    """What solution verification says of a run."""

    findings: list[Finding]
    checks: list[Check]
    why: str  # why not all of it is resolved
    shares: dict[str, float]  # by row: of the run's time in which it is resolved; by "" of x, R, v, w together
    visible: dict[str, float] = dataclasses.field(default_factory=dict)  # by row: a larger error would have been seen
    cost: float = 1.0  # engine steps of all answers and the run, over those of the run
    order: Order | None = None
    ladder: list[Rung] = dataclasses.field(default_factory=list)
    eps: float = EPS  # spacing of the engine's numbers, as far as it is declared and repeats show it
    iteration: float = 0.0  # m, left by its iteration, as declared

    @property
    def share(self) -> float:
        """The part of the run's time in which x, R, v, w are resolved."""
        return self.shares[""]


def unjudged(kind: str, why: str, *findings: Finding) -> Verdict:
    """The verdict on a run of which nothing is compared with truth."""
    return Verdict([Finding(f"unresolved {kind}", "unresolved", None, None, "", why), *findings], [], why, {"": 0.0})


class Solution:
    """The rules on one run; `truth` is None where there is none, for the reason `why`."""

    def __init__(self, run: Record, scene: Scene, traj: Trajectory, truth: Reference | None,
                 why: str = "") -> None:
        self.run, self.scene, self.traj, self.truth = run, scene, traj, truth
        self.engine, self.p = adapters.get(run.engine), run.documented_order
        self.own_states = States(traj.t, traj.x, traj.R, traj.v, traj.w, traj.a, traj.alpha, traj.lam,
                                 sensors=traj.own_sensors, hinges=traj.hinges)
        self.sizes = sizes(scene, self.own_states if truth is None else truth.states)
        self.flow, self.why = None, why
        if truth is not None:
            try:
                self.flow = SystemFlow(scene, self.sizes, truth)
            except (TruthError, Unsupported) as error:
                self.why = f"no truth: {error}"
        self.reach, self.length = float(np.abs(traj.x).max(initial=0.0)), length_of(scene)
        self.grading, self.eps, self.noise = grading(scene), EPS, dict[str, float]()
        self.spacing, self.broken = EPS, False
        self.left = self.engine.iteration(scene, RunSpec(run.method, step=run.step, rtol=run.rtol, form=run.form))
        self.dt = float(traj.t[1] - traj.t[0])
        self.n = 0 if run.step is None else steps_per_sample(scene, run.step)[0]
        self.multiple = 1 if run.step is None else steps_per_sample(scene, self.dt)[0]
        self.fine = False  # whether the engine has no coarser steps
        self.probe, self.runs = Probe(run, scene, self.length), dict[float, Answer | None]()
        self.segments: list[Segment] = []
        self.checks: list[Check] = []
        opened = max(float(np.max(traj.constraint_position)) / self.sizes["position"],
                     float(np.max(traj.constraint_velocity)) / self.sizes["velocity"])
        self.open = opened > self.grading * max(EPS, self.engine.eps) * max(1.0, traj.steps / SEGMENTS)

    # What rounding and iterations leave

    def unit(self, name: str) -> float:
        """The size of a row where positions are off by the scene's length, times a rate to the power of `rates`."""
        mass = float(self.scene.masses.sum())
        return {"attitude": 1.0, "angular velocity": 1.0, "angular acceleration": 1.0, "orthogonality": 1.0,
                "reaction force": mass * self.length, "reaction torque": mass * self.length**2,
                "energy": mass * self.length * self.sizes["velocity"]}.get(name, self.length)

    def extent(self, name: str) -> float:
        """The size of a row; of positions no less than how far they are from the origin, where they round."""
        size = self.sizes.get(name, 1.0)
        return max(size, self.reach) if name == "position" else size

    def count(self, segment: Segment, size: float) -> float:
        """Steps from where an answer began to the end of a segment."""
        times = segment.last - (0 if segment.whole else segment.first)
        return times * self.dt / size if self.p is not None else self.believed(segment)

    def rounding(self, name: str, segment: Segment, size: float) -> float:
        """u_round of a row at a step or tolerance `size`: every step rounds, and what it rounds grows as errors do."""
        least = self.grading * self.eps * max(1.0, self.count(segment, size)) * self.extent(name) * _growth(segment)
        if name not in OF_STATE and self.p is not None:  # what holds positions, softly or not, divides by h^2
            reach = self.unit(name) * (max(1.0, self.reach / self.length) if name == "acceleration" else 1.0)
            least += self.grading * self.eps * reach / size**2
        return least

    def iterated(self, name: str, segment: Segment, size: float) -> float:
        """u_iter: what a step's iteration is declared to leave in positions, over the step for rates, grown."""
        if not self.left or self.p is None:
            return 0.0
        power = 0 if name in ("position", "attitude", "orthogonality") else 1 if name in OF_STATE else 2
        return self.left / self.length * self.unit(name) / size**power * self.count(segment, size) * _growth(segment)

    @functools.cached_property
    def rate(self) -> float:
        """What an adaptive method has to follow, rad/s."""
        return max(self.sizes["angular velocity"], fastest(self.scene))

    def believed(self, segment: Segment, answer: Answer | None = None) -> float:
        """Steps that an adaptive method is believed to make up to the end of a segment: no more than it states."""
        times = segment.last - (0 if segment.whole else segment.first)
        order = self.engine.orders.get(self.run.method, PAIR)
        most = times + self.rate * times * self.dt * math.pow(self.run.rtol or 1.0, -1.0 / (order + 1))
        return min(self.traj.steps * times / (len(self.traj.t) - 1) if answer is None else answer.steps, most)

    def tolerated(self, name: str, segment: Segment, answer: Answer) -> float:
        """What an adaptive method may miss by at its own tolerance: each step keeps it, and errors grow; between steps
        outputs may miss by what the engine declares.
        """
        growth = 1.0 if segment.flowed is None else segment.flowed.worst
        times = self.believed(segment, answer) + self.engine.interpolation
        return times * self.own * self.sizes.get(name, 1.0) * growth

    def measure_noise(self, sequences: Sequence[Sequence3 | None]) -> None:
        """Asks the same question again from starts that differ by a rounding, for noise and the spacing of numbers."""
        given, ratios, scatter = max(EPS, self.engine.eps), list[float](), dict[str, list[tuple[float, float]]]()
        spacings = list[float]()
        told, step = list[tuple[int, list[Rows]]](), self.own if self.p is not None else 0.0
        chosen = [(k, segment, seq) for k, (segment, seq) in enumerate(zip(self.segments, sequences, strict=True))
                  if segment.flowed is not None and seq is not None]
        for k, segment, seq in chosen[::max(1, len(chosen) // ASKED_AGAIN)][:ASKED_AGAIN]:
            again = [self.repeated(segment, given, j) for j in range(1 + ASKED_AGAIN)]
            rows = [each for each in again if each is not None]
            if len(rows) < len(again):
                continue
            gaps = {name: spread([each[name][segment.kept(name, step)] for each in rows]) for name in rows[0]}
            for name, gap in gaps.items():
                scatter.setdefault(name, []).append((gap, self.rounding(name, segment, self.own) / self.eps))
            ratios.append(max(gaps[name] / self.rounding(name, segment, self.own) for name in STATE))
            other = self.probe.elsewhere(segment.start, *self.at(self.own)) if given > EPS else None
            if other is not None:  # coarse numbers are others in every world
                last = other.rows(segment)
                spacings.append(max(largest((rows[0][name] - last[name])[segment.kept(name, step)]) / self.extent(name)
                                     for name in STATE))
            told.append((k, [rows[0], seq.answers[self.nearest(seq)].rows(segment)]))  # moved starts may go other ways
        if given > EPS:  # a rounding of a number of the state is in no sum over steps
            shown = max(EPS, SAFETY * float(np.median(ratios)) * EPS) if ratios else EPS
            self.eps = given if self.segments[0].whole else min(given, shown)
            self.spacing = min(given, max(EPS, SAFETY * float(np.median(spacings)))) if spacings else given
        self.noise = {name: max(max(0.0, gap - 2 * least * self.eps) for gap, least in each)
                      for name, each in scatter.items()}
        for k, pair in told:
            self.checks += self.noisy(k, pair, self.own, max(1.0, given / self.eps))

    def noisy(self, k: int, pair: Sequence[Rows], size: float, more: float = 1.0) -> list[Check]:
        """R3: two answers to one question at a step or tolerance differ by no more than their error or rounding."""
        made, segment, step = list[Check](), self.segments[k], size if self.p is not None else 0.0
        for name in STATE:
            kept = [each[name][segment.kept(name, step)] for each in pair]
            missed, rounded = min(map(largest, kept)), 2 * more * self.roundings(name, segment, [size])[0]
            parts = {"error": missed} if missed > rounded else {"declared": rounded}
            made.append(Check("noise", name, k, spread(kept), parts, math.inf))
        return made

    def given_again(self, k: int, segment: Segment, seq: Sequence3) -> list[Check]:
        """The three coarsest answers are asked again."""
        made = list[Check]()
        for size, first in list(zip(seq.steps, seq.answers, strict=True))[-3:] if not segment.whole else ():
            again = self.ask(segment, size)
            made += [] if again is None else self.noisy(k, [first.rows(segment), again.rows(segment)], size)
        return made

    def repeated(self, segment: Segment, eps: float, k: int) -> Rows | None:
        """The answer to a segment once more less truth, from a start that is moved by a rounding `eps` if k is not 0.

        A move by coarse numbers moves the truth as well, or what is declared would show itself.
        """
        if segment.whole:
            got = self.probe.again(*self.at(self.own))
            return None if got is None else got.within(segment).rows(segment)
        coarse = eps > EPS
        start = moved(segment.start, self.sizes, eps, k, closing=coarse) if k else segment.start
        if start is None:
            return None
        if k and coarse and self.flow is not None and self.truth is not None:
            segment = dataclasses.replace(segment, start=start, flowed=None, reactions=None)
            fill([segment], self.flow, self.own_states, self.truth)
        got = self.probe.answer(start, *self.at(self.own)) if segment.flowed is not None else None
        return None if got is None else got.rows(segment)

    # Asking

    @property
    def own(self) -> float:
        """The run's own step (s) or tolerance."""
        return self.dt / self.n if self.p is not None else float(self.run.rtol or 1.0)

    def at(self, size: float) -> tuple[float | None, float | None]:
        """Step and tolerance of an answer."""
        return (size, None) if self.p is not None else (None, size)

    def ask(self, segment: Segment, size: float) -> Answer | None:
        """The answer to a segment at a step or tolerance; None where there is none."""
        if not segment.whole:
            return self.probe.answer(segment.start, *self.at(size))
        whole = self.entire(size)
        return None if whole is None else whole.within(segment)

    def entire(self, size: float) -> Answer | None:
        """The whole run at a step or tolerance, in its own world."""
        if size not in self.runs:
            self.runs[size] = self.probe.again(*self.at(size)) if abs(size / self.own - 1) > ROUNDED else answer_of(
                self.scene, self.own_states, self.traj.steps)
        return self.runs[size]

    def sequence(self, segment: Segment) -> Sequence3 | None:
        """Answers to a segment at three steps or tolerances; None if one is missing."""
        numbers = list(counts(self.n, self.multiple, self.fine)) if self.p is not None else []
        sized, got = [self.dt / n for n in numbers] or [
            self.own * TENFOLD**(k - 2 * self.fine) for k in (0, 1, 2)], []
        for size in sized:
            answer = self.ask(segment, size)
            if answer is None:
                return None
            got.append(answer)
        return Sequence3(sized, numbers, got)

    def refine(self, segment: Segment, seq: Sequence3) -> bool:
        """Puts an answer at a finer step before the others; whether there is one."""
        number = finer(seq.counts[0], self.multiple) if seq.counts else 0
        size = self.dt / number if number else seq.steps[0] / TENFOLD
        got = None if self.p is None and size < TENFOLD * EPS else self.ask(segment, size)
        if got is None:
            return False
        seq.steps.insert(0, size)
        seq.counts[:0] = [number] if number else []
        seq.answers.insert(0, got)
        return True

    def confirm(self, segment: Segment, seq: Sequence3) -> bool:
        """Asks at a far smaller step, which confirms a limit before it fails; whether there is an answer.

        At least a tenth of the finest, and so small that the fastest oscillation is not damped away in the segment.
        """
        if self.p is None:
            return False
        span, h = float(segment.t[-1]), seq.steps[0]
        followed = math.pow(SAFETY * max(1.0, self.rate * span), -1.0 / self.p) / max(self.rate, 1.0 / span)
        number = math.ceil(self.dt / max(h / TENFOLD**2, min(h / TENFOLD, followed)) / self.multiple) * self.multiple
        got = self.ask(segment, self.dt / number) if segment.smooth([self.dt / number, *seq.steps[:3]]) else None
        seq.far = None if got is None else (self.dt / number, got)
        return got is not None

    # R2, and of R3 what each answer says of its own states

    def judge_segment(self, k: int, segment: Segment, seq: Sequence3) -> list[Check]:
        """R2 in one segment, by the three finest answers, and by the one that a refinement replaced."""
        h, answers = seq.steps[:4], seq.answers[:4]
        rows = [each.rows(segment) for each in answers]
        smooth = self.p is not None and segment.smooth(h[:3])
        order, above = math.inf, False
        if smooth and self.p is not None:
            seq.orders.append(observed_order(h[:3], [scaled(each, self.sizes) for each in rows[:3]]))
            order, *before = seq.orders[::-1]
            order = max(order, 2 * order - before[0]) if before else order
            above = any(differ([each[name] for each in rows[:3]], self.roundings(name, segment, h[:3]),
                               self.noise.get(name, 0.0)) for name in STATE)
            # An order that has shown stays: still finer steps come down to what the iteration leaves.
            seq.order = max(order, -math.inf if seq.order is None else seq.order) if above else None
        far = None if seq.far is None else (seq.far[0], seq.far[1].rows(segment))
        made = self.limits_of("limit", k, h, rows, smooth, order, far)
        both = set.intersection(*(set(each.own) for each in answers))  # some have accelerations of every step alone
        own = [{name: part[1:] for name, part in each.own.items() if name in both} for each in answers]
        made += self.limits_of("promise", k, h, own, smooth, order)
        if smooth:
            for name in both & {*ACCELERATIONS}:
                kept = [each[name][segment.kept(name, max(h))] for each in own[:3]]
                if differ(kept, self.roundings(name, segment, h[:3]), self.noise.get(name, 0.0)):
                    seq.promised[name] = max(observed_order(h[:3], kept), seq.promised.get(name, -math.inf))
        if self.p is not None and seq.order is not None and (seq.order >= self.p - MARGIN or all(SAFETY * spread(
                [each[name] for each in rows[:3]]) <= RESOLVED * self.sizes[name] for name in STATE)):
            # Answers that are this far apart need not be in the range of an order: U tells that of their limit.
            apart_by = ", ".join(f"{size:.6g}" for size in seq.steps)
            made.append(Check("order", "", k, max(0.0, self.p - seq.order), {"margin": MARGIN}, math.inf,
                              f"observed {seq.order:.3g} of {self.p} at steps {apart_by} s"))
        return made

    def limits_of(self, rule: Rule, k: int, h: Sequence[float], rows: Sequence[Rows], smooth: bool, order: float,
                  far: tuple[float, Rows] | None = None) -> list[Check]:
        """The checks of where rows go, which are answers less truth, or what else has to vanish with the step.

        `far`: a far smaller step, and the rows there.
        """
        made, segment, step = [], self.segments[k], max(h) if self.p is not None else 0.0
        for name in [name for name in rows[0] if all(name in each for each in rows)]:
            keep = segment.kept(name, step)
            own = [each[name][keep] for each in rows]
            if not keep.any():
                continue
            times = 2.0 if rule == "gap limit" else 1.0  # of two answers
            finer = None if far is None or name not in far[1] else (far[0], far[1][name][keep])
            found = self.limit_of(name, segment, h, own, smooth, order, times, finer)
            part = self.iterated(name, segment, h[0]) / self.roundings(name, segment, h)[0]
            more = {"rounding": (1.0 - part) * found.parts["rounding"],
                    "iteration (declared)": part * found.parts["rounding"]} if "rounding" in found.parts else {}
            if rule == "limit" and segment.flowed is not None:
                more["truth"] = SAFETY * segment.flowed.error * self.sizes.get(name, 1.0)
            shown = [*([] if finer is None else [finer]), *zip(h, own, strict=True)]
            made.append(limit_check(rule, name, k, found, more, self.size_of(name), told(
                self.scene, segment.t[1:][keep], shown, found, "rtol" if self.p is None else "h")))
        return made

    def limit_of(self, name: str, segment: Segment, h: Sequence[float], own: list[np.ndarray], smooth: bool,
                 order: float, times: float = 1.0, far: tuple[float, np.ndarray] | None = None) -> Limit:
        """Where the answers of one row go; `times`: how many roundings and noises each has; `far`: one more answer."""
        rounding = [times * each for each in self.roundings(name, segment, h)]
        noise = times * self.noise.get(name, 0.0)
        if self.p is None:
            kept = times * self.believed(segment) * h[0] * self.sizes.get(name, 1.0) * _growth(segment)
            return spread_of_tolerances(own[:3], rounding[0], noise, kept)
        if smooth:
            if name in OF_STATE:
                return limit(h, own, self.p, rounding, noise, order, far)
            return limit(h, own, 1, rounding, noise, observed_order(h[:3], own[:3]), far)  # of no state: its own
        # A method that documents a higher order where a motion is not smooth finds the events, and others are late.
        late = self.p < 2
        jump = sum(each.rates.get(name, 0.0) for each in segment.flowed.jumps) if segment.flowed and late else 0.0
        order = 1 if late or name not in OF_STATE else self.p
        return index(h[:3], own[:3], order, rounding[0], noise, jump * h[0] * _growth(segment))

    def roundings(self, name: str, segment: Segment, h: Sequence[float]) -> list[float]:
        """u_round and u_iter at each step: what two answers at one step may differ by."""
        return [self.rounding(name, segment, size) + self.iterated(name, segment, size) for size in h]

    def size_of(self, name: str) -> float:
        """The size of a row; of a sensor that of what is measured."""
        if name in self.sizes:
            return self.sizes[name]
        return max(1.0, self.sizes["acceleration"]) if name.startswith("sensor ") else 1.0

    def limits(self, sequences: Sequence[Sequence3 | None]) -> list[Check]:
        """R2 in every segment, with finer steps where it fails, or is unresolved and they would mend it."""
        asked = {k: (segment, seq) for k, (segment, seq) in enumerate(zip(self.segments, sequences, strict=True))
                 if seq is not None and segment.flowed is not None}
        made = {k: self.judge_segment(k, *each) for k, each in asked.items()}
        suspects = sorted((k for k in made if _mendable(made[k])),
                          key=lambda k: max(check.severity for check in made[k]), reverse=True)
        for k in suspects:
            accused = any(check.status == "fail" for check in made[k])
            for _ in range(HALVINGS):
                if not _mendable(made[k]) or not self.refine(*asked[k]):
                    break
                made[k] = _refined(made[k], self.judge_segment(k, *asked[k]))
            if any(check.rule == "limit" and check.status == "fail" for check in made[k]) and self.confirm(*asked[k]):
                made[k] = _refined(made[k], self.judge_segment(k, *asked[k]))
            if any(check.status == "fail" for check in made[k]):
                break  # one is enough: the other segments stand as they were asked
            if accused:  # by a coarse answer, which the engine has to give again
                made[k] += self.given_again(k, *asked[k])
        failed = {k for k in made if any(check.status == "fail" for check in made[k])}
        refined = {k for k, (_, seq) in asked.items() if seq.steps[3:]}
        return [check for k, each in made.items() for check in each
                if check.status != "fail" or k in refined or not failed & refined] + self.promised(
                    {k: seq for k, (_, seq) in asked.items()})

    def promised(self, sequences: Mapping[int, Sequence3]) -> list[Check]:
        """R3: accelerations are those of the states, or come to them at the documented order where that is two or more.

        What Newton's iteration leaves in them has no order; those of a step before have the same lower one everywhere.
        """
        made, order = list[Check](), self.p or 1
        for name in ACCELERATIONS if order > 1 else ():
            shown = {k: seq.promised[name] for k, seq in sequences.items() if name in seq.promised}
            if shown and min(shown.values()) >= MARGIN:
                k = max(shown, key=lambda k: shown[k])
                made.append(Check("order", name, k, max(0.0, order - shown[k]), {"margin": MARGIN}, math.inf,
                                  f"less those of the states, observed {shown[k]:.3g} of {order}"))
        return made

    # R1

    def gaps(self, own: States, segment: Segment, answer: Answer) -> dict[str, np.ndarray]:
        """C: a run less an answer, by quantity, at the outputs after the first of a segment."""
        part = own.at(slice(segment.first, segment.last + 1))
        return {name: each[1:] for name, each in apart(part, answer.states).items() if name != "orthogonality"}

    def judge_run(self, sequences: Sequence[Sequence3 | None]) -> bool:
        """R1: the run is what the engine does from states of the run; whether it is so to rounding."""
        defects, rounded = dict[int, dict[str, np.ndarray]](), True
        for k, (segment, seq) in enumerate(zip(self.segments, sequences, strict=True)):
            if seq is None or segment.flowed is None:
                continue
            place = next((j for j, size in enumerate(seq.steps) if abs(size / self.own - 1) < ROUNDED), None)
            # With closed joints, as an opening may lock a mechanism; what closing changes is allowed.
            answer = self.probe.answer(segment.start, *self.at(self.own)) if place is None else seq.answers[place]
            if answer is None:
                continue
            defects[k] = self.gaps(self.own_states, segment, answer)
            for name, each in defects[k].items():
                keep = segment.kept(name, self.own if self.p is not None else 0.0)
                least, = self.roundings(name, segment, [self.own])
                rounded &= largest(each[keep]) <= 2 * (least + SAFETY * self.noise.get(name, 0.0))
        if rounded:
            return True
        errors = [self.error_of(segment, seq) for segment, seq in zip(self.segments, sequences, strict=True)]
        largest_error = {name: max(each.get(name, 0.0) for each in errors) for each in errors for name in each}
        for k, gaps in defects.items():
            self.within_error(k, sequences[k], gaps, largest_error)
        self.vanishing(defects)
        return False

    def nearest(self, seq: Sequence3) -> int:
        """Which answer is that at the run's own step or tolerance."""
        return min(range(len(seq.steps)), key=lambda j: abs(seq.steps[j] - self.own))

    def error_of(self, segment: Segment, seq: Sequence3 | None) -> dict[str, float]:
        """|D| by row of the answer at the run's own step."""
        if seq is None or segment.flowed is None:
            return {}
        own = self.nearest(seq)
        return {name: largest(each[segment.kept(name, max(seq.steps) if self.p is not None else 0.0)])
                for name, each in seq.answers[own].rows(segment).items()}

    def within_error(self, k: int, seq: Sequence3 | None, gaps: dict[str, np.ndarray], error: dict[str, float]) -> None:
        """|C| at the run's own step is at most three times the error of an answer, with its uncertainty.

        `error` is the largest of all segments: that of one depends on how coordinates lie there.
        """
        segment = self.segments[k]
        if seq is None or segment.flowed is None:
            return
        own = self.nearest(seq)
        opened = apart(_start(segment.given), _start(segment.start))
        limits = {check.name: check for check in self.checks if check.rule == "limit" and check.segment == k}
        for name, each in gaps.items():
            if name not in error or name not in limits:
                continue
            keep = segment.kept(name, max(seq.steps) if self.p is not None else 0.0)
            closing = segment.flowed.growth * max(largest(opened[q]) / self.sizes[q] for q in STATE) * self.sizes[name]
            kept = 0.0 if self.p is not None else self.tolerated(name, segment, seq.answers[own])
            parts = {"error": SAFETY * error[name], "U": SAFETY * limits[name].uncertainty,
                     "closing": SAFETY * closing, "tolerance": kept}
            self.checks.append(Check("gap", name, k, largest(each[keep]), parts, math.inf, f"at {self.own:.6g}; "
                                     f"the largest error of an answer there is {error[name]:.3g}"))

    def vanishing(self, finest: dict[int, dict[str, np.ndarray]]) -> None:
        """C at three steps of whole runs goes to zero."""
        numbers = list(counts(self.n, self.multiple)) if self.p is not None else []
        sized = [self.dt / n for n in numbers] or [self.own * TENFOLD**k for k in (0, 1, 2)]
        found = [finest if abs(size / self.own - 1) < ROUNDED else self.defects_at(size) for size in sized]
        made = self.vanishing_checks(sized, found)
        if any(check.status == "fail" for check in made):  # coarse whole runs need not be in the range of their order
            size = self.dt / finer(numbers[0], self.multiple) if numbers else self.own / TENFOLD
            sized, found = [size, *sized], [self.defects_at(size), *found]
            made = self.vanishing_checks(sized, found) or made
        self.checks += made

    def defects_at(self, size: float) -> dict[int, dict[str, np.ndarray]]:
        """C in every segment of a whole run at another step or tolerance."""
        got, found = self.entire(size), dict[int, dict[str, np.ndarray]]()
        if got is None:
            return found
        try:
            cut = segments_of(self.scene, got.states, self.truth, self.open, self.cut)
        except TruthError:
            return found
        for k, segment in enumerate(cut):
            answer = self.probe.answer(segment.start, *self.at(size))
            if answer is not None:
                found[k] = self.gaps(got.states, segment, answer)
        return found

    def vanishing_checks(self, sized: list[float], found: list[dict[int, dict[str, np.ndarray]]]) -> list[Check]:
        """The limit of C in every segment in which it is known at all steps."""
        made = []
        for k in sorted(set.intersection(*(set(each) for each in found))):
            segment, each = self.segments[k], [gaps[k] for gaps in found]
            smooth = self.p is not None and segment.smooth(sized[:3])
            order = observed_order(sized[:3], [scaled(gaps, self.sizes) for gaps in each[:3]]) if smooth else math.inf
            made += self.limits_of("gap limit", k, sized, each, smooth, order)
        return made

    # Whole runs

    def whole(self) -> list[Segment]:
        """Segments of the true motion from the scene's start, with all its growth since then; none without a truth."""
        if self.truth is None or self.flow is None:
            return []
        until = int(np.searchsorted(self.traj.t, self.truth.horizon * (1 + ROUNDED), side="right")) - 1
        motion, cut = self.truth.states.at(slice(0, until + 1)), [k for k in self.cut if k < until]
        made = segments_of(self.scene, motion, self.truth, False, [*cut, until])
        fill(made, self.flow, motion, self.truth)
        grown_to = np.exp(growth(self.scene, self.truth, motion.t))
        for each in made:
            each.whole, most = True, float(grown_to[each.last])
            if each.flowed is not None:
                each.flowed = dataclasses.replace(each.flowed, error=self.truth.error, worst=most,
                                                  growth=max(most, each.flowed.growth))
        return made

    def judge_whole(self) -> None:
        """R2 of a run that is not what its engine answers from its states: the run itself has to come to the truth.

        What growth since the start leaves unresolved the segments resolve: in the limit the run is their answers.
        """
        kept, self.segments = self.segments, self.whole()
        self.checks += [dataclasses.replace(check, detail=f"of whole runs; {check.detail}", segment=next(
            k for k, each in enumerate(kept) if each.last >= self.segments[check.segment].last))
            for check in self.limits([self.sequence(each) for each in self.segments]) if check.status == "fail"]
        self.segments = kept

    def stand_in(self, segment: Segment, seq: Sequence3) -> None:
        """Without a truth the finest answer stands for it: differences have an order, and U has no end.

        Growth is that of the engine's own motion.
        """
        own, size = seq.answers[0].states, MOVED[0]
        start = moved(segment.start, self.sizes, size)
        beside = None if start is None else self.probe.answer(start, *self.at(seq.steps[0]))
        if beside is not None:
            most = grown(beside.states, own, self.sizes, size, np.ones(len(own.t), bool))
            due = tuple(Jump(t, True, {}) for t in segment.start.knots if 0.0 < t < own.t[-1])
            segment.flowed = Flowed(own, due, math.inf, most, most * math.sqrt(len(STATE) * self.scene.x0.size), True)
        segment.why = self.why

    # R3 and R4

    def tolerance(self, sequences: Sequence[Sequence3 | None]) -> None:
        """R3: the error of an adaptive method at its own tolerance."""
        for k, (segment, seq) in enumerate(zip(self.segments, sequences, strict=True)):
            if self.p is not None or seq is None or segment.flowed is None:
                continue
            own = self.nearest(seq)
            for name, each in seq.answers[own].rows(segment).items():
                keep = segment.kept(name, 0.0)
                if name in STATE and keep.any():
                    parts = {"tolerance": self.tolerated(name, segment, seq.answers[own]),
                             "rounding": self.rounding(name, segment, self.own)}
                    declared = self.engine.interpolation
                    said = f"interpolation between steps, declared: {declared:g} rtol" if declared else ""
                    self.checks.append(Check("promise", name, k, largest(each[keep]), parts, math.inf, said))

    def started(self) -> None:
        """R4: the run begins in the state that was asked for, or in the nearest one with closed joints."""
        asked, eps = _start(self.scene), max(EPS, self.engine.eps)
        gaps = apart(self.own_states.at(slice(0, 1)), asked)
        for name in STATE:
            parts, value = {"rounding": self.grading * eps * self.extent(name)}, largest(gaps[name])
            near = closed(self.scene) if value > parts["rounding"] else None
            if near is not None:
                parts["closing"] = SAFETY * largest(apart(_start(near), asked)[name])
            self.checks.append(Check("asked start", name, 0, value, parts, math.inf))

    def verdict(self) -> Verdict:
        """All rules."""
        if at_rest(self.scene, self.own_states if self.truth is None else self.truth.states):
            return unjudged("rest", "nothing moves but rounding: give a start that moves")
        self.started()
        if self.flow is None and self.scene.has_laws:  # what acts between its states is not known
            return unjudged("truth", self.why, *findings(self.checks, [(0.0, float(self.traj.t[-1]))]))
        self.segments = segments_of(self.scene, self.own_states, self.truth, self.open)
        self.cut = [*(segment.first for segment in self.segments), self.segments[-1].last]
        if self.truth is not None and self.flow is not None:
            fill(self.segments, self.flow, self.own_states, self.truth)
        sequences, alone = self.all_sequences(), ""
        self.broken = not any(sequences) and not self.probe.refused
        if not any(sequences):
            alone = f"not started elsewhere: {self.probe.why}"
            self.segments = self.whole() or self.segments
            sequences = self.all_sequences() if self.segments[0].whole else sequences
        for segment, seq in zip(self.segments, sequences, strict=True):
            if seq is not None and self.flow is None:
                self.stand_in(segment, seq)
        self.measure_noise(sequences)
        self.checks += self.limits(sequences)
        if not alone and not self.judge_run(sequences):
            self.judge_whole()
        self.tolerance(sequences)
        return self.summed(sequences, alone)

    def summed(self, sequences: list[Sequence3 | None], alone: str) -> Verdict:
        """What all checks say together; `alone`: why the engine was not started elsewhere."""
        spans = [(float(self.traj.t[each.first]), float(self.traj.t[each.last])) for each in self.segments]
        blind = [k for k, (segment, seq) in enumerate(zip(self.segments, sequences, strict=True))
                 if seq is None or segment.flowed is None]
        if spans[-1][1] < self.traj.t[-1]:
            blind.append(len(spans))
            spans.append((spans[-1][1], float(self.traj.t[-1])))
        reached, told = shares(self.checks, spans, blind), findings(self.checks, spans)
        if self.broken:  # it fails where it is started again, so that a right run shows nothing
            reached = dict.fromkeys(reached, 0.0)
        if alone:
            told.append(Finding("gap", "ok", None, None, "", WHY["gap"], f"{alone}; whole runs alone are judged"))
        if self.probe.status != "success":
            told.insert(0, Finding.ended_early(f"it says: {self.probe.status}"))
        cost = 1.0 + self.probe.steps / max(1, self.traj.steps)
        return Verdict(told, self.checks, self.why or alone or self.reason(blind, min(reached.values())), reached,
                       visible(self.checks), cost, self.order(sequences), self.ladder(sequences), self.spacing,
                       self.left)

    def order(self, sequences: Sequence[Sequence3 | None]) -> Order | None:
        """The documented order and those that smooth segments show; None if none does."""
        shown = [each.order for each in sequences if each is not None and each.order is not None]
        return None if self.p is None or not shown else Order(
            documented=self.p, observed=min(shown), median=float(np.median(shown)), segments=len(shown))

    def ladder(self, sequences: Sequence[Sequence3 | None]) -> list[Rung]:
        """The largest |D| by row over all segments at the steps or tolerances of all, the coarsest first."""
        asked = [(segment, seq) for segment, seq in zip(self.segments, sequences, strict=True)
                 if seq is not None and segment.flowed is not None and self.flow is not None]
        made = []
        for k in (0, 1, 2) if asked else ():
            most, size = dict[str, float](), asked[0][1].steps[-1 - k]
            for segment, seq in asked:
                for name, each in seq.answers[-1 - k].rows(segment).items():
                    kept = each[segment.kept(name, size if self.p is not None else 0.0)]
                    most[name] = max(most.get(name, 0.0), largest(kept))
            step, rtol = self.at(size)
            made.append(Rung(step=step, rtol=rtol, errors=dict(most)))
        return made

    def all_sequences(self) -> list[Sequence3 | None]:
        """Answers to every segment, at coarser steps where the engine has them in all."""
        sequences: list[Sequence3 | None] = []
        for self.fine in (False, True):
            sequences = [self.sequence(segment) for segment in self.segments]
            if all(each is not None for each in sequences) or (self.p is not None and self.n < FEWEST):
                break
        return sequences

    def reason(self, blind: list[int], reached: float) -> str:
        """Why not all is resolved."""
        if reached >= 1.0:
            return ""
        if blind:
            known = self.segments[blind[0]].why if blind[0] < len(self.segments) else self.truth and (
                f"truth ends at {self.truth.horizon:g} s: {self.truth.horizon_cause}")
            return known or f"not started elsewhere: {self.probe.why}"
        open_ = [check for check in self.checks if check.status == "unresolved"]
        if not open_ or self.flow is None:
            return self.why
        worst = max(open_, key=lambda check: check.uncertainty / max(check.size, np.finfo(float).tiny))
        part = max(worst.parts, key=lambda name: worst.parts[name])
        return (f"{worst.name} is not resolved: U = {worst.uncertainty:.3g} of a size of {worst.size:.3g}, by {part}; "
                f"ask for a smaller {'step' if self.p is not None else 'tolerance'}")


def _growth(segment: Segment) -> float:
    return 1.0 if segment.flowed is None else segment.flowed.growth


def _mendable(checks: Sequence[Check]) -> bool:
    """Whether a finer step has to be tried: one fails, or is unresolved by what a step leaves."""
    return any(check.status == "fail" or (check.status == "unresolved" and check.uncertainty - check.parts.get(
        "extrapolation", 0.0) <= RESOLVED * check.size) for check in checks)


def _refined(before: Sequence[Check], after: Sequence[Check]) -> list[Check]:
    """The checks of finer answers; where these say less of a row than coarser ones did, those stand."""
    old = {(check.rule, check.name): check for check in before}
    return [old[check.rule, check.name] if check.status == "unresolved" and (check.rule, check.name) in old
            and old[check.rule, check.name].status != "fail"
            and old[check.rule, check.name].severity < check.severity else check for check in after]


def _start(scene: Scene) -> States:
    return States(np.zeros(1), scene.x0[None], scene.R0[None], scene.v0[None], scene.w0[None])


def judge(run: Record, scene: Scene, traj: Trajectory, truth: Reference | None, why: str = "") -> Verdict:
    """The verdict on one run; without a truth, for the reason `why`, it is unresolved unless something fails."""
    return Solution(run, scene, traj, truth, why and f"no truth: {why}").verdict()
