"""The verdict by solution verification: where an engine's answers at a few steps go, against truth, within U.

R1 the run is what the engine answers from states of that run, elsewhere; R2 its answers converge to truth; R3 it keeps
what it promises; R4 it did what was asked.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence

import numpy as np

from crosscheck import adapters
from crosscheck.adapters.base import steps_per_sample
from crosscheck.compare.apart import STATE, apart, largest, scaled, spread
from crosscheck.compare.ladder import counts, finer
from crosscheck.compare.order import (
    MARGIN,
    SAFETY,
    Limit,
    differ,
    index_of_order_one,
    limit,
    observed_order,
    spread_of_tolerances,
)
from crosscheck.compare.sizes import at_rest, length_of, sizes
from crosscheck.document import Finding, Record
from crosscheck.errors import Unsupported
from crosscheck.judge import tolerances
from crosscheck.judge.rules import Check, findings, limit_check, shares, told, visible
from crosscheck.judge.segments import Segment, fill, segments_of
from crosscheck.judge.system_flow import SystemFlow
from crosscheck.references import TruthError
from crosscheck.references.base import Reference
from crosscheck.references.maximal import fastest
from crosscheck.running.attempt import Ran, attempt, lasting
from crosscheck.running.trajectory import Trajectory
from crosscheck.scene.model import Scene
from crosscheck.scene.states import Motion, States
from crosscheck.verification.probe import Answer, Probe, answers, moved

EPS = 2.0**-52
Rung = tuple[float | None, float | None, dict[str, float]]
"""Step (s) or relative tolerance, and the largest errors there by row."""

HALVINGS = 2
"""Finer steps that are tried before a segment fails or stays unresolved (Roache: until the order shows)."""
ASKED_AGAIN = 2
"""Segments in which the same question is asked again, and how often, for noise: the fewest that show a scatter."""
OF_STATE = (*STATE, "orthogonality", "energy")
"""Rows whose order is that of the method: they are states, or follow from them alone."""


@dataclasses.dataclass
class Sequence3:
    """Answers to one segment, the finest first; refined ones are put before."""

    steps: list[float]  # s, or tolerances
    counts: list[int]  # steps of one interval between outputs; none of tolerances
    answers: list[Answer]
    orders: list[float] = dataclasses.field(default_factory=list)  # as observed, one a refinement
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
    orders: dict[str, float] | None = None  # "documented", "lowest" and "median" observed, and in how many "segments"
    ladder: list[Rung] = dataclasses.field(default_factory=list)

    @property
    def share(self) -> float:
        """The part of the run's time in which x, R, v, w are resolved."""
        return self.shares[""]


def unjudged(kind: str, why: str, *findings: Finding) -> Verdict:
    """The verdict on a run of which nothing is compared with truth."""
    return Verdict([Finding(f"unresolved {kind}", "unresolved", None, None, "", why), *findings], [], why, {"": 0.0})


class Solution:
    """The rules on one run."""

    def __init__(self, run: Record, scene: Scene, traj: Trajectory, held: frozenset[str], truth: Reference) -> None:
        self.run, self.scene, self.traj, self.truth, self.held = run, scene, traj, truth, held
        self.engine, self.p = adapters.get(run.engine), run.documented_order
        self.sizes = sizes(scene, truth.states)
        self.reach = float(np.abs(traj.x).max(initial=0.0))
        self.grading, self.eps, self.noise = tolerances.grading(scene), EPS, dict[str, float]()
        self.dt = float(traj.t[1] - traj.t[0])
        self.n = 0 if run.step is None else steps_per_sample(scene, run.step)[0]
        self.multiple = 1 if run.step is None else steps_per_sample(scene, self.dt)[0]
        self.length = length_of(scene)
        self.probe = Probe(run, scene, self.length)
        self.segments: list[Segment] = []
        self.checks: list[Check] = []
        self.notes: list[str] = []
        opened = max(float(np.max(traj.constraint_position)) / self.sizes["position"],
                     float(np.max(traj.constraint_velocity)) / self.sizes["velocity"])
        self.open = opened > self.grading * max(EPS, min(self.engine.eps, 1e-6)) * max(1, traj.steps)

    # What rounding leaves

    def rounding(self, name: str, segment: Segment, size: float) -> float:
        """u_round of a row at a step or tolerance `size`: every step rounds, and what it rounds grows as errors do."""
        times = segment.last - segment.first
        steps = times * self.dt / size if self.p is not None else self.believed(segment)
        growth = 1.0 if segment.flowed is None else segment.flowed.growth
        unit = self.sizes.get(name, 1.0)
        if name == "position":
            unit = max(unit, self.reach)
        least = self.grading * self.eps * max(1.0, steps) * unit * growth
        if name not in OF_STATE and self.p is not None:  # what holds positions, softly or not, divides by h^2
            reach = {"acceleration": max(self.length, self.reach), "angular acceleration": 1.0,
                     "reaction force": float(self.scene.masses.sum()) * self.length}.get(name, self.length)
            least += self.grading * self.eps * reach / size**2
        return least

    def believed(self, segment: Segment, answer: Answer | None = None) -> float:
        """Steps that an adaptive method is believed to make in a segment: no more than an answer or the run states."""
        times = segment.last - segment.first
        rate = max(self.sizes["angular velocity"], fastest(self.scene))
        order = self.engine.orders.get(self.run.method, 3)
        most = times + rate * times * self.dt * math.pow(self.run.rtol or 1.0, -1.0 / (order + 1))
        return min(self.traj.steps * times / (len(self.traj.t) - 1) if answer is None else answer.steps, most)

    def tolerated(self, name: str, segment: Segment, answer: Answer) -> float:
        """What an adaptive method may miss by at its own tolerance: each step keeps it, and errors grow."""
        growth = 1.0 if segment.flowed is None else segment.flowed.worst
        return self.believed(segment, answer) * self.own * self.sizes.get(name, 1.0) * growth

    def measure_noise(self) -> None:
        """Asks the same question again from starts that differ by a rounding, for noise and the spacing of numbers."""
        given, ratios, scatter = max(EPS, self.engine.eps), list[float](), dict[str, list[tuple[float, float]]]()
        chosen = [segment for segment in self.segments if segment.flowed is not None]
        for segment in chosen[::max(1, len(chosen) // ASKED_AGAIN)][:ASKED_AGAIN]:
            size = self.own
            again = [self.probe.answer(moved(segment.start, self.sizes, given if k else 0.0, k) if k else segment.start,
                                       *self.at(size)) for k in range(1 + ASKED_AGAIN)]
            if any(each is None for each in again):
                continue
            rows = [each.rows(segment) for each in again if each is not None]
            worst = 0.0
            for name in rows[0]:
                keep = segment.kept(name, size if self.p is not None else 0.0)
                gap, least = spread([each[name][keep] for each in rows]), self.rounding(name, segment, size)
                worst = max(worst, gap / least) if name in STATE else worst
                scatter.setdefault(name, []).append((gap, least / self.eps))
            ratios.append(worst)
        if given > EPS and ratios:
            self.eps = min(given, max(EPS, SAFETY * float(np.median(ratios)) * EPS))
        self.noise = {name: max(max(0.0, gap - 2 * least * self.eps) for gap, least in each)
                      for name, each in scatter.items()}

    # Asking

    @property
    def own(self) -> float:
        """The run's own step (s) or tolerance."""
        return self.dt / self.n if self.p is not None else float(self.run.rtol or 1e-9)

    def at(self, size: float) -> tuple[float | None, float | None]:
        """Step and tolerance of an answer."""
        return (size, None) if self.p is not None else (None, size)

    def sequence(self, segment: Segment, fine: bool = False) -> Sequence3 | None:
        """Answers to a segment at three steps or tolerances; None if one is missing."""
        numbers = list(counts(self.n, self.multiple, fine)) if self.p is not None else []
        sized = [self.dt / n for n in numbers] or [self.own * 10.0**(k - 2 * fine) for k in range(3)]
        got = answers(self.probe, segment.start, sized, self.p is None)
        return None if got is None else Sequence3(sized, numbers, got)

    def refine(self, segment: Segment, seq: Sequence3) -> bool:
        """Puts an answer at a finer step before the others; whether there is one."""
        number = finer(seq.counts[0], self.multiple) if seq.counts else 0
        size = self.dt / number if number else seq.steps[0] / 10.0
        if self.p is None and size < 10 * EPS:
            return False
        got = self.probe.answer(segment.start, *self.at(size))
        if got is None:
            return False
        seq.steps.insert(0, size)
        seq.counts[:0] = [number] if number else []
        seq.answers.insert(0, got)
        return True

    # R2

    def judge_segment(self, k: int, segment: Segment, seq: Sequence3) -> list[Check]:
        """R2 in one segment, by the three finest answers, and by the one that a refinement replaced."""
        h = seq.steps[:4]
        rows = [each.rows(segment) for each in seq.answers[:4]]
        smooth = self.p is not None and segment.smooth(h[:3])
        order, above = math.inf, False
        if smooth and self.p is not None:
            seq.orders.append(observed_order(h[:3], [scaled(each, self.sizes) for each in rows[:3]]))
            order, *before = seq.orders[::-1]
            order = max(order, 2 * order - before[0]) if before else order
            above = any(differ([each[name] for each in rows[:3]], self.roundings(name, segment, h[:3]),
                               self.noise.get(name, 0.0)) for name in STATE)
        made = []
        for name in rows[0]:
            if not all(name in each for each in rows):
                continue
            keep = segment.kept(name, max(h) if self.p is not None else 0.0)
            own = [each[name][keep] for each in rows]
            if keep.any():
                found = self.limit_of(name, segment, h, own, smooth, order)
                made.append(limit_check("limit", name, k, found, self.of_truth(name, segment), self.size_of(name, seq),
                                        told(self.scene, segment.t[1:][keep], h, own, found, "rtol" if self.p is None
                                             else "h")))
        seq.order = order if above else None
        if above and self.p is not None:
            lack = max(0.0, self.p - order)
            apart_by = ", ".join(f"{size:.6g}" for size in h[:3])
            made.append(Check("order", "", k, lack, {"margin": MARGIN}, math.inf,
                              f"observed {order:.3g} of {self.p} at steps {apart_by} s"))
        return made

    def limit_of(self, name: str, segment: Segment, h: Sequence[float], own: list[np.ndarray], smooth: bool,
                 order: float, times: float = 1.0) -> Limit:
        """Where the answers of one row go; `times`: how many roundings and noises each has."""
        rounding = [times * each for each in self.roundings(name, segment, h)]
        noise = times * self.noise.get(name, 0.0)
        if self.p is None:
            return spread_of_tolerances(own[:3], rounding[0], noise)
        if smooth:
            p = self.p if name in OF_STATE else 1
            return limit(h, own, p, rounding, noise, order if name in OF_STATE else math.inf)
        growth = 1.0 if segment.flowed is None else segment.flowed.growth
        jump = sum(each.rates.get(name, 0.0) for each in segment.flowed.jumps) if segment.flowed and self.p < 2 else 0.0
        return index_of_order_one(h[:3], own[:3], rounding[0], noise, jump * h[0] * growth)

    def roundings(self, name: str, segment: Segment, h: Sequence[float]) -> list[float]:
        """u_round at each step."""
        return [self.rounding(name, segment, size) for size in h]

    def of_truth(self, name: str, segment: Segment) -> dict[str, float]:
        """What truth, and the engine's iteration, add to U."""
        error = 0.0 if segment.flowed is None else segment.flowed.error
        return {"truth": SAFETY * error * self.sizes.get(name, 1.0)}

    def size_of(self, name: str, seq: Sequence3) -> float:
        """The size of a row; of a sensor that of what is measured."""
        if name in self.sizes:
            return self.sizes[name]
        return max(1.0, self.sizes["acceleration"]) if name.startswith("sensor ") else 1.0

    def limits(self, sequences: list[Sequence3 | None]) -> None:
        """R2 in every segment, with finer steps where it fails or stays unresolved."""
        made = {k: self.judge_segment(k, segment, seq) for k, (segment, seq) in enumerate(
            zip(self.segments, sequences, strict=True)) if seq is not None and segment.flowed is not None}
        suspects = sorted((k for k, each in made.items() if any(check.status != "ok" for check in each)),
                          key=lambda k: max(check.severity for check in made[k]), reverse=True)
        for k in suspects:
            seq = sequences[k]
            assert seq is not None
            for _ in range(HALVINGS):
                if all(check.status == "ok" for check in made[k]) or not self.refine(self.segments[k], seq):
                    break
                made[k] = self.judge_segment(k, self.segments[k], seq)
            if any(check.status == "fail" for check in made[k]):
                break  # one is enough: the other segments stand as they were asked
        failed = {k for k in made if any(check.status == "fail" for check in made[k])}
        refined = {k for k in made if sequences[k] is not None and len(sequences[k].steps) > 3}  # type: ignore[union-attr]
        self.checks += [check for k, each in made.items() for check in each
                        if check.status != "fail" or k in refined or not failed & refined]

    # R1

    def slice_of(self, motion: Motion, segment: Segment) -> States:
        """The run in a segment."""
        cut = slice(segment.first, segment.last + 1)
        a, alpha = getattr(motion, "a", None), getattr(motion, "alpha", None)
        return States(motion.t[cut], motion.x[cut], motion.R[cut], motion.v[cut], motion.w[cut],
                      None if a is None else a[cut], None if alpha is None else alpha[cut])

    def gaps(self, traj: Trajectory, segment: Segment, answer: Answer) -> dict[str, np.ndarray]:
        """C: a run less an answer, by quantity, at the outputs after the first of a segment."""
        found = {name: each[1:] for name, each in apart(self.slice_of(traj, segment), answer.states).items()
                 if name != "orthogonality"}
        return found

    def judge_run(self, sequences: list[Sequence3 | None]) -> None:
        """R1: the run is what the engine does from states of the run."""
        sized, defects = self.own, dict[int, dict[str, np.ndarray]]()
        rounded, answered = True, dict[int, Answer]()
        for k, (segment, seq) in enumerate(zip(self.segments, sequences, strict=True)):
            if seq is None:
                continue
            place = next((j for j, size in enumerate(seq.steps) if abs(size / sized - 1) < 1e-9), None)
            answer = self.probe.answer(segment.given, *self.at(sized)) if self.open or place is None else (
                seq.answers[place])
            if answer is None:
                continue
            answered[k], defects[k] = answer, self.gaps(self.traj, segment, answer)
            for name, each in defects[k].items():
                keep = segment.kept(name, sized if self.p is not None else 0.0)
                least = self.rounding(name, segment, sized) + SAFETY * self.noise.get(name, 0.0)
                rounded &= largest(each[keep]) <= 2 * least
        if rounded:
            return
        self.notes.append("the run is not, to rounding, what the engine answers from states of it")
        errors = [self.error_of(segment, seq) for segment, seq in zip(self.segments, sequences, strict=True)]
        largest_error = {name: max(each.get(name, 0.0) for each in errors) for each in errors for name in each}
        for k, gaps in defects.items():
            self.within_error(k, sequences[k], gaps, largest_error)
        self.vanishing(defects)

    def error_of(self, segment: Segment, seq: Sequence3 | None) -> dict[str, float]:
        """|D| by row of the answer at the run's own step."""
        if seq is None or segment.flowed is None:
            return {}
        own = min(range(len(seq.steps)), key=lambda j: abs(seq.steps[j] - self.own))
        return {name: largest(each[segment.kept(name, max(seq.steps) if self.p is not None else 0.0)])
                for name, each in seq.answers[own].rows(segment).items()}

    def within_error(self, k: int, seq: Sequence3 | None, gaps: dict[str, np.ndarray], error: dict[str, float]) -> None:
        """|C| at the run's own step is at most three times the error of an answer, with its uncertainty.

        `error` is the largest of all segments: that of one depends on how coordinates lie there.
        """
        segment = self.segments[k]
        if seq is None or segment.flowed is None:
            return
        own = min(range(len(seq.steps)), key=lambda j: abs(seq.steps[j] - self.own))
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
        sized = [self.dt / n for n in numbers] or [self.own * 10.0**k for k in range(3)]
        found = [finest if abs(size / self.own - 1) < 1e-9 else self.defects_at(size) for size in sized]
        made = self.vanishing_checks(sized, found)
        if any(check.status == "fail" for check in made):  # coarse whole runs need not be in the range of their order
            size = self.dt / finer(numbers[0], self.multiple) if numbers else self.own / 10.0
            sized, found = [size, *sized], [self.defects_at(size), *found]
            made = self.vanishing_checks(sized, found) or made
        self.checks += made

    def defects_at(self, size: float) -> dict[int, dict[str, np.ndarray]]:
        """C in every segment of a whole run at another step or tolerance."""
        step, rtol = self.at(size)
        got = lasting(attempt(self.scene, self.run, step=step, rtol=rtol, monitor=False))
        if not isinstance(got, Ran):
            return {}
        self.probe.steps += got.raw.steps
        try:
            cut = segments_of(self.scene, got.trajectory, self.truth, self.open, [
                *(segment.first for segment in self.segments), self.segments[-1].last])
        except TruthError:
            return {}
        found = {}
        for k, segment in enumerate(cut):
            answer = self.probe.answer(segment.given, step, rtol)
            if answer is not None:
                found[k] = self.gaps(got.trajectory, segment, answer)
        return found

    def vanishing_checks(self, sized: list[float], found: list[dict[int, dict[str, np.ndarray]]]) -> list[Check]:
        """The limit of C in every segment in which it is known at all steps."""
        made = []
        for k in sorted(set.intersection(*(set(each) for each in found))):
            segment, each = self.segments[k], [gaps[k] for gaps in found]
            smooth = self.p is not None and segment.smooth(sized[:3])
            order = observed_order(sized[:3], [scaled(gaps, self.sizes) for gaps in each[:3]]) if smooth else math.inf
            for name in each[0]:
                keep = segment.kept(name, max(sized) if self.p is not None else 0.0)
                rows = [gaps[name][keep] for gaps in each]
                if keep.any():
                    limited = self.limit_of(name, segment, sized, rows, smooth, order, 2.0)  # of two answers
                    made.append(limit_check("gap limit", name, k, limited, {}, self.sizes[name], told(
                        self.scene, segment.t[1:][keep], sized, rows, limited, "rtol" if self.p is None else "h")))
        return made

    # R3 and R4

    def tolerance(self, sequences: list[Sequence3 | None]) -> None:
        """R3: the error of an adaptive method at its own tolerance."""
        for k, (segment, seq) in enumerate(zip(self.segments, sequences, strict=True)):
            if self.p is not None or seq is None or segment.flowed is None:
                continue
            own = min(range(len(seq.steps)), key=lambda j: abs(seq.steps[j] - self.own))
            for name, each in seq.answers[own].rows(segment).items():
                if name in STATE:
                    parts = {"tolerance": self.tolerated(name, segment, seq.answers[own]),
                             "rounding": self.rounding(name, segment, self.own)}
                    self.checks.append(Check("promise", name, k, largest(each), parts, math.inf))

    def verdict(self) -> Verdict:
        """All rules."""
        if at_rest(self.scene, self.truth.states):
            return unjudged("rest", "nothing moves but rounding: give a start that moves")
        self.segments = segments_of(self.scene, self.traj, self.truth, self.open)
        fill(self.segments, SystemFlow(self.scene, self.sizes, self.truth), self.traj, self.truth)
        sequences = self.all_sequences()
        spans = [(float(self.traj.t[each.first]), float(self.traj.t[each.last])) for each in self.segments]
        self.measure_noise()
        self.limits(sequences)
        self.judge_run(sequences)
        self.tolerance(sequences)
        blind = [k for k, (segment, seq) in enumerate(zip(self.segments, sequences, strict=True))
                 if seq is None or segment.flowed is None]
        reached = shares(self.checks, spans, blind)
        cost = 1.0 + self.probe.steps / max(1, self.traj.steps)
        more = [] if self.probe.status == "success" else [
            Finding("asked end", "fail", None, None, "", "a run has to reach its end", f"it says: {self.probe.status}")]
        return Verdict([*more, *findings(self.checks, spans)], self.checks, self.reason(blind, reached[""]), reached,
                       visible(self.checks), cost, self.orders(sequences), self.ladder(sequences))

    def orders(self, sequences: list[Sequence3 | None]) -> dict[str, float] | None:
        """The documented order and those that smooth segments show; None if none does."""
        shown = [each.order for each in sequences if each is not None and each.order is not None]
        return None if self.p is None or not shown else {
            "documented": self.p, "lowest": min(shown), "median": float(np.median(shown)), "segments": len(shown)}

    def ladder(self, sequences: list[Sequence3 | None]) -> list[Rung]:
        """The largest |D| by row over all segments at the steps or tolerances of all, the coarsest first."""
        asked = [(segment, seq) for segment, seq in zip(self.segments, sequences, strict=True)
                 if seq is not None and segment.flowed is not None]
        made = []
        for k in (-1, -2, -3) if asked else ():
            most, size = dict[str, float](), asked[0][1].steps[k]
            for segment, seq in asked:
                for name, each in seq.answers[k].rows(segment).items():
                    kept = each[segment.kept(name, size if self.p is not None else 0.0)]
                    most[name] = max(most.get(name, 0.0), largest(kept))
            made.append((*self.at(size), most))
        return made

    def all_sequences(self) -> list[Sequence3 | None]:
        """Answers to every segment, at coarser steps where the engine has them in all."""
        sequences: list[Sequence3 | None] = []
        for fine in (False, True):
            sequences = [self.sequence(segment, fine) for segment in self.segments]
            if all(each is not None for each in sequences) or (self.p is not None and self.n < 6):
                break
        return sequences

    def reason(self, blind: list[int], reached: float) -> str:
        """Why not all is resolved."""
        if reached >= 1.0:
            return ""
        if blind:
            return self.segments[blind[0]].why or f"not started elsewhere: {self.probe.why}"
        open_ = [check for check in self.checks if check.status == "unresolved"]
        if not open_:
            return ""
        worst = max(open_, key=lambda check: check.uncertainty / max(check.size, 1e-300))
        part = max(worst.parts, key=lambda name: worst.parts[name])
        return (f"{worst.name}: U = {worst.uncertainty:.3g} of a size of {worst.size:.3g}, by {part}; "
                f"ask for a smaller step")


def _start(scene: Scene) -> States:
    return States(np.zeros(1), scene.x0[None], scene.R0[None], scene.v0[None], scene.w0[None])


def judge(run: Record, scene: Scene, traj: Trajectory, held: frozenset[str], truth: Reference) -> Verdict:
    """The verdict on one run; a scene whose flow cannot be started anywhere is unresolved."""
    try:
        return Solution(run, scene, traj, held, truth).verdict()
    except (TruthError, Unsupported) as error:
        return unjudged("truth", f"no truth: {error}")
