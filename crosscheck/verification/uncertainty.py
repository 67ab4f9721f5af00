"""What rounding, an iteration, a tolerance and noise leave in answers: the parts of U beside that of extrapolation."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence

import numpy as np

from crosscheck.adapters.base import RunSpec
from crosscheck.compare.apart import STATE, Rows, largest, spread
from crosscheck.compare.order import SAFETY
from crosscheck.judge.rounding import EPS, grading
from crosscheck.judge.rules import Check
from crosscheck.judge.segments import Segment, fill
from crosscheck.judge.system_flow import SystemFlow, moved
from crosscheck.references.base import Reference
from crosscheck.verification.probe import Answer
from crosscheck.verification.questions import Answers, Questions

ASKED_AGAIN = 2
"""Segments in which the same question is asked again, and how often, for noise: the fewest that show a scatter."""
PAIR = 3
"""Order that is assumed of an adaptive method that documents none: that of the lower formula of a pair 4(3)."""
OF_STATE = (*STATE, "orthogonality", "energy")
"""Rows whose order is that of the method: they are states, or follow from them alone."""


class Uncertainty:
    """What answers are uncertain by; `eps` and `noise` are as declared and as `measure_noise` finds them."""

    def __init__(self, questions: Questions, truth: Reference | None, flow: SystemFlow | None) -> None:
        self.questions, self.truth, self.flow = questions, truth, flow
        scene, run, self.engine = questions.scene, questions.run, questions.engine
        self.sizes, self.p, self.length = questions.sizes, questions.p, questions.length
        self.reach = float(np.abs(questions.traj.x).max(initial=0.0))
        self.grading, self.eps, self.spacing, self.noise = grading(scene), EPS, EPS, dict[str, float]()
        self.left = self.engine.iteration(scene, RunSpec(run.method, step=run.step, rtol=run.rtol, form=run.form))

    def unit(self, name: str) -> float:
        """The size of a row where positions are off by the scene's length, times a rate to the power of `rates`."""
        mass = float(self.questions.scene.masses.sum())
        return {"attitude": 1.0, "angular velocity": 1.0, "angular acceleration": 1.0, "orthogonality": 1.0,
                "reaction force": mass * self.length, "reaction torque": mass * self.length**2,
                "energy": mass * self.length * self.sizes["velocity"]}.get(name, self.length)

    def size_of(self, name: str) -> float:
        """The size of a row; of a sensor that of what is measured."""
        if name in self.sizes:
            return self.sizes[name]
        return max(1.0, self.sizes["acceleration"]) if name.startswith("sensor ") else 1.0

    def extent(self, name: str) -> float:
        """The size of a row; of positions no less than how far they are from the origin, where they round."""
        size = self.sizes.get(name, 1.0)
        return max(size, self.reach) if name == "position" else size

    def count(self, segment: Segment, size: float) -> float:
        """Steps from where an answer began to the end of a segment."""
        return segment.intervals * self.questions.dt / size if self.p is not None else self.believed(segment)

    def rounding(self, name: str, segment: Segment, size: float) -> float:
        """u_round of a row at a step or tolerance `size`: every step rounds, and what it rounds grows as errors do."""
        least = self.grading * self.eps * max(1.0, self.count(segment, size)) * self.extent(name) * segment.growth
        if name not in OF_STATE and self.p is not None:  # what holds positions, softly or not, divides by h^2
            reach = self.unit(name) * (max(1.0, self.reach / self.length) if name == "acceleration" else 1.0)
            least += self.grading * self.eps * reach / size**2
        return least

    def iterated(self, name: str, segment: Segment, size: float) -> float:
        """u_iter: what a step's iteration is declared to leave in positions, over the step for rates, grown."""
        if not self.left or self.p is None:
            return 0.0
        power = 0 if name in ("position", "attitude", "orthogonality") else 1 if name in OF_STATE else 2
        return self.left / self.length * self.unit(name) / size**power * self.count(segment, size) * segment.growth

    def roundings(self, name: str, segment: Segment, h: Sequence[float]) -> list[float]:
        """u_round and u_iter at each step: what two answers at one step may differ by."""
        return [self.rounding(name, segment, size) + self.iterated(name, segment, size) for size in h]

    def believed(self, segment: Segment, answer: Answer | None = None) -> float:
        """Steps that an adaptive method is believed to make up to the end of a segment: no more than it states."""
        run, traj, times = self.questions.run, self.questions.traj, segment.intervals
        order = self.engine.orders.get(run.method, PAIR)
        most = times + self.questions.rate * times * self.questions.dt * math.pow(run.rtol or 1.0, -1.0 / (order + 1))
        return min(traj.steps * times / (len(traj.t) - 1) if answer is None else answer.steps, most)

    def tolerated(self, name: str, segment: Segment, answer: Answer) -> float:
        """What an adaptive method may miss by at its own tolerance: each step keeps it, and errors grow; between steps
        outputs may miss by what the engine declares.
        """
        growth = 1.0 if segment.flowed is None else segment.flowed.worst
        times = self.believed(segment, answer) + self.engine.interpolation
        return times * self.questions.own * self.sizes.get(name, 1.0) * growth

    def measure_noise(self, answers: Sequence[Answers]) -> list[Check]:
        """Asks the same question again from starts that differ by a rounding, for noise and the spacing of numbers.

        Returns
        -------
        list of Check
            Of the same question, asked twice.
        """
        given, ratios, scatter = max(EPS, self.engine.eps), list[float](), dict[str, list[tuple[float, float]]]()
        spacings, pairs, own = list[float](), list[tuple[Answers, list[Rows]]](), self.questions.own
        step = self.questions.step_of(own)
        for asked in answers[::max(1, len(answers) // ASKED_AGAIN)][:ASKED_AGAIN]:
            segment = asked.segment
            repeat = [self._repeated(segment, given, j) for j in range(1 + ASKED_AGAIN)]
            rows = [each for each in repeat if each is not None]
            if len(rows) < len(repeat):
                continue
            gaps = {name: spread([each[name][segment.kept(name, step)] for each in rows]) for name in rows[0]}
            for name, gap in gaps.items():
                scatter.setdefault(name, []).append((gap, self.rounding(name, segment, own) / self.eps))
            ratios.append(max(gaps[name] / self.rounding(name, segment, own) for name in STATE))
            other = self.questions.probe.elsewhere(segment.start, *self.questions.at(own)) if given > EPS else None
            if other is not None:  # coarse numbers are others in every world
                last = other.rows(segment)
                spacings.append(max(largest((rows[0][name] - last[name])[segment.kept(name, step)]) / self.extent(name)
                                    for name in STATE))
            pairs.append((asked, [rows[0], self.questions.nearest(asked).rows(segment)]))  # others may go other ways
        if given > EPS:  # a rounding of a number of the state is in no sum over steps
            measured = max(EPS, SAFETY * float(np.median(ratios)) * EPS) if ratios else EPS
            self.eps = given if answers and answers[0].segment.whole else min(given, measured)
            self.spacing = min(given, max(EPS, SAFETY * float(np.median(spacings)))) if spacings else given
        self.noise = {name: max(max(0.0, gap - 2 * least * self.eps) for gap, least in each)
                      for name, each in scatter.items()}
        return [check for asked, pair in pairs
                for check in self.noisy(asked, pair, own, max(1.0, given / self.eps))]

    def noisy(self, asked: Answers, pair: Sequence[Rows], size: float, more: float = 1.0) -> list[Check]:
        """R3: two answers to one question at a step or tolerance differ by no more than their error or rounding."""
        made, segment = list[Check](), asked.segment
        for name in STATE:
            kept = [each[name][segment.kept(name, self.questions.step_of(size))] for each in pair]
            missed, rounded = min(map(largest, kept)), 2 * more * self.roundings(name, segment, [size])[0]
            parts = {"error": missed} if missed > rounded else {"declared": rounded}
            made.append(Check("noise", name, asked.k, spread(kept), parts, math.inf))
        return made

    def repeated(self, asked: Answers) -> list[Check]:
        """The three coarsest answers are asked again."""
        made, segment = list[Check](), asked.segment
        for size, first in list(zip(asked.steps, asked.answers, strict=True))[-3:] if not segment.whole else ():
            repeat = self.questions.ask(segment, size)
            made += [] if repeat is None else self.noisy(asked, [first.rows(segment), repeat.rows(segment)], size)
        return made

    def _repeated(self, segment: Segment, eps: float, k: int) -> Rows | None:
        """The answer to a segment once more less truth, from a start that is moved by a rounding `eps` if k is not 0.

        A move by coarse numbers moves the truth as well, or what is declared would show itself.
        """
        probe, at = self.questions.probe, self.questions.at(self.questions.own)
        if segment.whole:
            got = probe.repeat(*at)
            return None if got is None else got.within(segment).rows(segment)
        coarse = eps > EPS
        start = moved(segment.start, self.sizes, eps, k, closing=coarse) if k else segment.start
        if start is None:
            return None
        if k and coarse and self.flow is not None and self.truth is not None:
            segment = dataclasses.replace(segment, start=start, flowed=None, reactions=None)
            fill([segment], self.flow, self.questions.states, self.truth)
        got = probe.answer(start, *at) if segment.flowed is not None else None
        return None if got is None else got.rows(segment)
