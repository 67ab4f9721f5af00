"""The verdict by solution verification: where an engine's answers at a few steps go, against truth, within U.

R1 the run is what the engine answers from states of that run, elsewhere; R2 its answers converge to truth; R3 it keeps
what it promises; R4 it did what was asked.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence

import numpy as np

from crosscheck.compare.apart import ROUNDED, STATE, apart, largest
from crosscheck.compare.order import SAFETY
from crosscheck.compare.sizes import at_rest, sizes
from crosscheck.document import Finding, Order, Record, Rung
from crosscheck.document.known import Known
from crosscheck.errors import Unsupported
from crosscheck.judge.rounding import EPS
from crosscheck.judge.rules import WHY, Check, findings, shares, visible
from crosscheck.judge.segments import SEGMENTS, Segment, end_of_truth, fill, growth, segments_of
from crosscheck.judge.system_flow import MOVED, Flowed, Jump, SystemFlow, grown, moved
from crosscheck.references import TruthError
from crosscheck.references.base import Reference, ending
from crosscheck.running.trajectory import Trajectory
from crosscheck.scene.assembly import closed
from crosscheck.scene.model import ACTS, Scene
from crosscheck.verification.limits import Limits
from crosscheck.verification.questions import Answers, Questions, own_states, start_of
from crosscheck.verification.restart_defects import RestartDefects
from crosscheck.verification.uncertainty import Uncertainty


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


_whole: dict[tuple[object, ...], list[Segment]] = {}
"""Segments of the true motion of the last scene, by what they follow from: all its runs share them."""


def unjudged(kind: str, why: str, *findings: Finding) -> Verdict:
    """The verdict on a run of which nothing is compared with truth."""
    return Verdict([_open(kind, why), *findings], [], why, {"": 0.0})


def _open(kind: str, why: str) -> Finding:
    return Finding(f"unresolved {kind}", "unresolved", None, None, "", why)


class Solution:
    """The rules on one run; `truth` is None where there is none, for the reason `why`."""

    def __init__(self, run: Record, scene: Scene, traj: Trajectory, truth: Reference | None,
                 why: str = "", known: Sequence[Known] = ()) -> None:
        self.scene, self.traj, self.truth = scene, traj, truth
        self.sizes = sizes(scene, own_states(traj) if truth is None else truth.states)
        self.flow, self.why = None, why
        if truth is not None:
            try:
                self.flow = SystemFlow(scene, self.sizes, truth)
            except (TruthError, Unsupported) as error:
                self.why = f"no truth: {error}"
        self.questions = Questions(run, scene, traj, self.sizes)
        self.probe, self.p = self.questions.probe, self.questions.p
        self.uncertainty = Uncertainty(self.questions, truth, self.flow)
        self.limits = Limits(self.uncertainty, known)
        self.segments: list[Segment] = []
        self.checks: list[Check] = []
        opened = max(float(np.max(traj.constraint_position)) / self.sizes["position"],
                     float(np.max(traj.constraint_velocity)) / self.sizes["velocity"])
        self.open = opened > self.uncertainty.grading * max(EPS, self.questions.engine.eps) * max(
            1.0, traj.steps / SEGMENTS)

    @property
    def _untrue(self) -> str:
        """What there is no truth for: "dropped", something that acts at the start and was left out, or "truth"."""
        return "dropped" if any(each.what.startswith(ACTS) for each in self.scene.left_out) else "truth"

    def verdict(self) -> Verdict:
        """All rules."""
        if at_rest(self.scene, self.questions.states if self.truth is None else self.truth.states):
            return unjudged("rest", "nothing moves but rounding: give a start that moves")
        self.checks += self._started()
        if self.flow is None and self.scene.has_laws:  # what acts between its states is not known
            return unjudged(self._untrue, self.why, *findings(self.checks, [(0.0, float(self.traj.t[-1]))]))
        self.segments = segments_of(self.scene, self.questions.states, self.truth, self.open)
        cut = [*(segment.first for segment in self.segments), self.segments[-1].last]
        if self.truth is not None and self.flow is not None:
            fill(self.segments, self.flow, self.questions.states, self.truth)
        got, alone = self.questions.answers(self.segments), ""
        broken = not any(got) and not self.probe.refused  # where it is started again, so that a right run shows nothing
        if not any(got):
            alone = f"not started elsewhere: {self.probe.why}"
            self.segments = self._whole(cut) or self.segments
            got = self.questions.answers(self.segments) if self.segments[0].whole else got
        asked = [each for each in got if each is not None]
        for each in asked if self.flow is None else ():
            self._stand_in(each)
        asked = [each for each in asked if each.segment.flowed is not None]
        self.checks += self.uncertainty.measure_noise(asked)
        limits = self.limits.checks(asked)
        defects = None if alone else RestartDefects(self.limits, asked, cut, self.open).checks(limits)
        self.checks += limits
        if defects is not None:
            self.checks += defects + self._limits_of_whole_runs(cut)
        self.checks += self._tolerance(asked)
        return self._summed(asked, alone, broken)

    # Whole runs

    def _whole(self, cut: Sequence[int]) -> list[Segment]:
        """Segments of the true motion from the scene's start, with all its growth since then; none without a truth."""
        if self.truth is None or self.flow is None:
            return []
        of = self.scene.hash, tuple(cut), self.truth.states.x.tobytes(), self.truth.error
        if of in _whole:
            return _whole[of]
        until = int(np.searchsorted(self.traj.t, self.truth.horizon * (1 + ROUNDED), side="right")) - 1
        motion, kept = self.truth.states.at(slice(0, until + 1)), [k for k in cut if k < until]
        made = segments_of(self.scene, motion, self.truth, False, [*kept, until])
        fill(made, self.flow, motion, self.truth)
        grown_to = np.exp(growth(self.scene, self.truth, motion.t))
        for each in made:
            each.whole, most = True, float(grown_to[each.last])
            if each.flowed is not None:
                each.flowed = dataclasses.replace(each.flowed, error=self.truth.error, worst=most,
                                                  growth=max(most, each.flowed.growth))
        _whole.clear()
        _whole[of] = made
        return made

    def _limits_of_whole_runs(self, cut: Sequence[int]) -> list[Check]:
        """R2 of a run that is not what its engine answers from its states: the run itself has to come to the truth.

        What growth since the start leaves unresolved the segments resolve: in the limit the run is their answers. So
        finer whole runs are made where one fails alone.
        """
        whole = self._whole(cut)
        asked = [each for each in self.questions.answers(whole) if each is not None and each.segment.flowed is not None]
        return [dataclasses.replace(check, detail=f"of whole runs; {check.detail}", segment=next(
            k for k, each in enumerate(self.segments) if each.last >= whole[check.segment].last))
            for check in self.limits.checks(asked, resolving=False) if check.status == "fail"]

    def _stand_in(self, asked: Answers) -> None:
        """Without a truth the finest answer stands for it: differences have an order, and U has no end.

        Growth is that of the engine's own motion.
        """
        segment, own, size = asked.segment, asked.answers[0].states, MOVED[0]
        start = moved(segment.start, self.sizes, size)
        perturbed = None if start is None else self.probe.answer(start, *self.questions.at(asked.steps[0]))
        if perturbed is not None:
            most = grown(perturbed.states, own, self.sizes, size, np.ones(len(own.t), bool))
            due = tuple(Jump(t, True, {}) for t in segment.start.knots if 0.0 < t < own.t[-1])
            segment.flowed = Flowed(own, due, math.inf, most, most * math.sqrt(len(STATE) * self.scene.x0.size), True)
        segment.why = self.why

    # R3 and R4

    def _tolerance(self, answers: Sequence[Answers]) -> list[Check]:
        """R3: the error of an adaptive method at its own tolerance."""
        made, declared = list[Check](), self.questions.engine.interpolation
        said = f"interpolation between steps, declared: {declared:g} rtol" if declared else ""
        for asked in answers if self.p is None else ():
            own = self.questions.nearest(asked)
            for name, each in own.rows(asked.segment).items():
                keep = asked.segment.kept(name, 0.0)
                if name in STATE and keep.any():
                    parts = {"tolerance": self.uncertainty.tolerated(name, asked.segment, own),
                             "rounding": self.uncertainty.rounding(name, asked.segment, self.questions.own)}
                    made.append(Check("promise", name, asked.k, largest(each[keep]), parts, math.inf, said))
        return made

    def _started(self) -> list[Check]:
        """R4: the run begins in the state that was asked for, or in the nearest one with closed joints."""
        made, eps = list[Check](), max(EPS, self.questions.engine.eps)
        gaps = apart(self.questions.states.at(slice(0, 1)), start_of(self.scene))
        for name in STATE:
            value = largest(gaps[name])
            # It rounds on the way into an engine's coordinates, and on the way back.
            parts = {"rounding": 2 * self.uncertainty.grading * eps * self.uncertainty.extent(name)}
            near = closed(self.scene) if value > parts["rounding"] else None
            if near is not None:
                parts["closing"] = SAFETY * largest(apart(start_of(near), start_of(self.scene))[name])
            made.append(Check("asked start", name, 0, value, parts, math.inf))
        return made

    # The verdict

    def _summed(self, answers: Sequence[Answers], alone: str, broken: bool) -> Verdict:
        """What all checks say together.

        Parameters
        ----------
        alone : why the engine was not started elsewhere
        broken : whether it fails wherever it is started again
        """
        spans = [(float(self.traj.t[each.first]), float(self.traj.t[each.last])) for each in self.segments]
        blind = sorted({*range(len(spans))} - {each.k for each in answers})
        if spans[-1][1] < self.traj.t[-1]:
            blind.append(len(spans))
            spans.append((spans[-1][1], float(self.traj.t[-1])))
        reached, listed = shares(self.checks, spans, blind), findings(self.checks, spans)
        if broken:
            reached = dict.fromkeys(reached, 0.0)
        if alone:
            listed.append(Finding("gap", "ok", None, None, "", WHY["gap"], f"{alone}; whole runs alone are judged"))
            if not min(reached.values()):
                listed.append(_open("elsewhere", alone))
        if self.truth is not None and math.isfinite(ends := end_of_truth(self.truth)):
            listed.append(Finding.truth_ends(ends, ending(ends, self.truth.horizon_cause)))
        if self.flow is None:
            listed.append(_open(self._untrue, self.why))
        if self.probe.status != "success":
            listed.insert(0, Finding.ended_early(f"it says: {self.probe.status}"))
        cost = 1.0 + self.probe.steps / max(1, self.traj.steps)
        return Verdict(listed, self.checks, self.why or alone or self._reason(blind, min(reached.values())), reached,
                       visible(self.checks), cost, self._order(answers), self._ladder(answers),
                       self.uncertainty.spacing, self.uncertainty.left)

    def _order(self, answers: Sequence[Answers]) -> Order | None:
        """The documented order and those that smooth segments show; None if none does."""
        orders = [each.order for each in answers if each.order is not None]
        return None if self.p is None or not orders else Order(
            documented=self.p, observed=min(orders), median=float(np.median(orders)), segments=len(orders))

    def _ladder(self, answers: Sequence[Answers]) -> list[Rung]:
        """The largest |D| by row over all segments at the steps or tolerances of all, the coarsest first."""
        made = []
        for k in (0, 1, 2) if answers and self.flow is not None else ():
            most, size = dict[str, float](), answers[0].steps[-1 - k]
            for asked in answers:
                for name, each in asked.rows()[-1 - k].items():
                    kept = each[asked.segment.kept(name, self.questions.step_of(size))]
                    most[name] = max(most.get(name, 0.0), largest(kept))
            step, rtol = self.questions.at(size)
            whole = answers[0].segment.whole  # each answer then begins at the start
            steps = (max if whole else sum)(asked.answers[-1 - k].steps for asked in answers)
            made.append(Rung(step=step, rtol=rtol, errors=dict(most), steps=steps))
        return made

    def _reason(self, blind: list[int], reached: float) -> str:
        """Why not all is resolved."""
        if reached >= 1.0:
            return ""
        if blind:
            known = self.segments[blind[0]].why if blind[0] < len(self.segments) else self.truth and ending(
                self.truth.horizon, self.truth.horizon_cause)
            return known or f"not started elsewhere: {self.probe.why}"
        open_ = [check for check in self.checks if check.status == "unresolved"]
        if not open_ or self.flow is None:
            return self.why
        worst = max(open_, key=lambda check: check.uncertainty / max(check.size, np.finfo(float).tiny))
        part = max(worst.parts, key=lambda name: worst.parts[name])
        return (f"{worst.name} is not resolved: U = {worst.uncertainty:.3g} of a size of {worst.size:.3g}, by {part}; "
                f"ask for a smaller {'step' if self.p is not None else 'tolerance'}")


def judge(run: Record, scene: Scene, traj: Trajectory, truth: Reference | None, why: str = "",
          known: Sequence[Known] = ()) -> Verdict:
    """The verdict on one run; without a truth, for the reason `why`, it is unresolved unless something fails.

    `known`: defects of the engine; what they explain is not asked at finer steps.
    """
    return Solution(run, scene, traj, truth, why and f"no truth: {why}", known).verdict()
