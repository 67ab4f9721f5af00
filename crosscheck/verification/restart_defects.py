"""R1: a run is what its engine answers from states of that run, in another world."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from crosscheck.compare.apart import ROUNDED, STATE, Rows, apart, largest, scaled
from crosscheck.compare.ladder import counts, finer
from crosscheck.compare.order import SAFETY, observed_order
from crosscheck.judge.rules import Check
from crosscheck.judge.segments import Segment, segments_of
from crosscheck.references import TruthError
from crosscheck.scene.states import States
from crosscheck.verification.limits import Limits
from crosscheck.verification.probe import Answer
from crosscheck.verification.questions import TENFOLD, Answers, start_of


class RestartDefects:
    """C, the run less what the engine answers from the run's own states."""

    def __init__(self, limits: Limits, answers: Sequence[Answers], cut: Sequence[int], closing: bool) -> None:
        self.limits, self.uncertainty, self.questions = limits, limits.uncertainty, limits.questions
        self.asked = {each.k: each for each in answers}
        self.cut, self.closing = cut, closing

    def checks(self, limits: Sequence[Check]) -> list[Check] | None:
        """R1; None if the run is so to rounding. `limits`: the checks of R2."""
        found, rounded = dict[int, Rows](), True
        for k, asked in self.asked.items():
            answer = self._own_answer(asked)
            if answer is None:
                continue
            found[k] = _defects(self.questions.states, asked.segment, answer)
            rounded &= self._is_rounding(asked.segment, found[k])
        if rounded:
            return None
        errors = [self._errors(asked) for asked in self.asked.values()]
        most = {name: max(each.get(name, 0.0) for each in errors) for each in errors for name in each}
        made = [check for k, each in found.items() for check in self._within_error(self.asked[k], each, most, limits)]
        return made + self._vanishing(found)

    def _own_answer(self, asked: Answers) -> Answer | None:
        """The answer at the run's own step, from closed joints: an opening may lock a mechanism."""
        own = self.questions.own
        place = next((j for j, size in enumerate(asked.steps) if abs(size / own - 1) < ROUNDED), None)
        return self.questions.probe.answer(asked.segment.start, *self.questions.at(own)) if place is None else (
            asked.answers[place])

    def _is_rounding(self, segment: Segment, defects: Rows) -> bool:
        """Whether the defects are no more than rounding, an iteration and noise leave in two answers."""
        own, uncertainty = self.questions.own, self.uncertainty
        return all(largest(each[segment.kept(name, self.questions.step_of(own))]) <= 2 * (
            uncertainty.roundings(name, segment, [own])[0] + SAFETY * uncertainty.noise.get(name, 0.0))
            for name, each in defects.items())

    def _errors(self, asked: Answers) -> dict[str, float]:
        """|D| by row of the answer at the run's own step."""
        step = self.questions.step_of(*asked.steps)
        return {name: largest(each[asked.segment.kept(name, step)])
                for name, each in self.questions.nearest(asked).rows(asked.segment).items()}

    def _within_error(self, asked: Answers, defects: Rows, error: dict[str, float], limits: Sequence[Check]
                      ) -> list[Check]:
        """|C| at the run's own step is at most three times the error of an answer, with its uncertainty.

        `error` is the largest of all segments: that of one depends on how coordinates lie there.
        """
        made, segment, uncertainty = list[Check](), asked.segment, self.uncertainty
        step, sizes = self.questions.step_of(*asked.steps), uncertainty.sizes
        opened = apart(start_of(segment.given), start_of(segment.start))
        limit = {check.name: check for check in limits if check.rule == "limit" and check.segment == asked.k}
        for name, each in defects.items():
            if name not in error or name not in limit:
                continue
            closing = segment.growth * max(largest(opened[q]) / sizes[q] for q in STATE) * sizes[name]
            kept = 0.0 if uncertainty.p is not None else uncertainty.tolerated(
                name, segment, self.questions.nearest(asked))
            parts = {"error": SAFETY * error[name], "U": SAFETY * limit[name].uncertainty,
                     "closing": SAFETY * closing, "tolerance": kept}
            made.append(Check("gap", name, asked.k, largest(each[segment.kept(name, step)]), parts, math.inf,
                              f"at {self.questions.own:.6g}; "
                              f"the largest error of an answer there is {error[name]:.3g}"))
        return made

    def _vanishing(self, finest: dict[int, Rows]) -> list[Check]:
        """C at three steps of whole runs goes to zero."""
        ask = self.questions
        numbers = list(counts(ask.n, ask.multiple)) if ask.p is not None else []
        sized = [ask.dt / n for n in numbers] or [ask.own * TENFOLD**k for k in (0, 1, 2)]
        found = [finest if abs(size / ask.own - 1) < ROUNDED else self._defects_at(size) for size in sized]
        made = self._limits(sized, found)
        if any(check.status == "fail" for check in made):  # coarse whole runs need not be in the range of their order
            size = ask.dt / finer(numbers[0], ask.multiple) if numbers else ask.own / TENFOLD
            sized, found = [size, *sized], [self._defects_at(size), *found]
            made = self._limits(sized, found) or made
        return made

    def _defects_at(self, size: float) -> dict[int, Rows]:
        """C in every segment of a whole run at another step or tolerance."""
        got, found = self.questions.entire(size), dict[int, Rows]()
        if got is None:
            return found
        try:
            cut = segments_of(self.questions.scene, got.states, self.uncertainty.truth, self.closing, self.cut)
        except TruthError:
            return found
        for k, segment in enumerate(cut):
            answer = self.questions.probe.answer(segment.start, *self.questions.at(size))
            if answer is not None:
                found[k] = _defects(got.states, segment, answer)
        return found

    def _limits(self, sized: list[float], found: list[dict[int, Rows]]) -> list[Check]:
        """The limit of C in every segment in which it is known at all steps."""
        made = list[Check]()
        for k in sorted(set.intersection(*(set(each) for each in found))):
            asked, each = self.asked[k], [defects[k] for defects in found]
            smooth = self.limits.smooth(asked.segment, sized)
            order = observed_order(sized[:3], [scaled(rows, self.uncertainty.sizes) for rows in each[:3]]) if (
                smooth) else math.inf
            made += self.limits.of_rows("gap limit", asked, sized, each, smooth, order)
        return made


def _defects(own: States, segment: Segment, answer: Answer) -> dict[str, np.ndarray]:
    """C: a run less an answer, by quantity, at the outputs after the first of a segment."""
    part = own.at(slice(segment.first, segment.last + 1))
    return {name: each[1:] for name, each in apart(part, answer.states).items() if name != "orthogonality"}
