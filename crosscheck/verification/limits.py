"""R2: where answers go as steps vanish, less truth; and of R3 where what they say of their own states goes."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence

import numpy as np

from crosscheck.compare.apart import STATE, Rows, scaled, spread
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
from crosscheck.document.known import Known
from crosscheck.judge.known import covers
from crosscheck.judge.rules import RESOLVED, Check, Rule, detail_of, limit_check
from crosscheck.judge.segments import Segment
from crosscheck.verification.questions import Answers
from crosscheck.verification.uncertainty import OF_STATE, Uncertainty

HALVINGS = 2
"""Finer steps that are tried before a segment fails or stays unresolved (Roache: until the order shows)."""
ACCELERATIONS = ("acceleration", "angular acceleration")


class Limits:
    """The checks of limits, by what the answers are uncertain by."""

    def __init__(self, uncertainty: Uncertainty, known: Sequence[Known] = ()) -> None:
        self.uncertainty, self.questions, self.known = uncertainty, uncertainty.questions, known
        self.p, self.sizes, self.resolving = uncertainty.p, uncertainty.sizes, True

    def checks(self, answers: Sequence[Answers], resolving: bool = True) -> list[Check]:
        """R2 in every segment, with finer steps where it fails, or is unresolved and they would mend it.

        What a known defect of this size explains is not asked again; what is unresolved is not unless `resolving`.
        """
        self.resolving, made = resolving, {asked.k: self._segment(asked) for asked in answers}
        suspects = sorted((asked for asked in answers if self._mendable(made[asked.k])),
                          key=lambda asked: max(check.severity for check in made[asked.k]), reverse=True)
        for asked in suspects:
            accused = self._fails(made[asked.k])
            for _ in range(HALVINGS):
                if not self._mendable(made[asked.k]) or not self.questions.refine(asked):
                    break
                made[asked.k] = refined(made[asked.k], self._segment(asked))
            if self._fails(check for check in made[asked.k] if check.rule == "limit") and self.questions.confirm(asked):
                made[asked.k] = refined(made[asked.k], self._segment(asked))
            if self._fails(made[asked.k]):
                break  # one is enough: the other segments stand as they were asked
            if accused:  # by a coarse answer, which the engine has to give again
                made[asked.k] += self.uncertainty.repeated(asked)
        failed = {k for k, checks in made.items() if self._fails(checks)}
        finer = {asked.k for asked in answers if asked.steps[3:]}
        return [check for k, checks in made.items() for check in checks
                if check.status != "fail" or k in finer or not failed & finer] + self._promised(answers)

    def _fails(self, checks: Iterable[Check]) -> bool:
        """Whether one fails that no known defect explains."""
        return any(check.status == "fail" and not any(covers(each, check.kind, check.value, check.size)
                                                      for each in self.known) for check in checks)

    def _mendable(self, checks: Sequence[Check]) -> bool:
        """Whether a finer step has to be tried: one fails, or is unresolved by what a step leaves."""
        return self._fails(checks) or (self.resolving and any(
            check.status == "unresolved" and check.uncertainty - check.parts.get("extrapolation", 0.0) <= (
                RESOLVED * check.size) for check in checks))

    def _segment(self, asked: Answers) -> list[Check]:
        """R2 in one segment, by the three finest answers, and by the one that a refinement replaced."""
        h, rows, smooth = asked.steps[:4], asked.rows()[:4], self.smooth(asked.segment, asked.steps)
        order, above = math.inf, False
        if smooth:
            asked.orders.append(observed_order(h[:3], [scaled(each, self.sizes) for each in rows[:3]]))
            order, *before = asked.orders[::-1]
            order = max(order, 2 * order - before[0]) if before else order
            above = any(self._differ(name, asked.segment, h, [each[name] for each in rows]) for name in STATE)
            # An order that has shown stays: still finer steps come down to what the iteration leaves.
            asked.order = max(order, -math.inf if asked.order is None else asked.order) if above else None
        far = None if asked.far is None else (asked.far[0], asked.far[1].rows(asked.segment))
        made = self.of_rows("limit", asked, h, rows, smooth, order, far)
        answers = asked.answers[:4]
        both = set.intersection(*(set(each.own) for each in answers))  # some have accelerations of every step alone
        own = [{name: part[1:] for name, part in each.own.items() if name in both} for each in answers]
        made += self.of_rows("promise", asked, h, own, smooth, order)
        for name in both & {*ACCELERATIONS} if smooth else ():
            kept = [each[name][asked.segment.kept(name, max(h))] for each in own[:3]]
            if self._differ(name, asked.segment, h, kept):
                asked.promised[name] = max(observed_order(h[:3], kept), asked.promised.get(name, -math.inf))
        return made + self._order(asked, rows)

    def _order(self, asked: Answers, rows: Sequence[Rows]) -> list[Check]:
        """The observed order. Answers far apart need not be in the range of one: U tells that of their limit."""
        if self.p is None or asked.order is None or not (asked.order >= self.p - MARGIN or all(SAFETY * spread(
                [each[name] for each in rows[:3]]) <= RESOLVED * self.sizes[name] for name in STATE)):
            return []
        apart_by = ", ".join(f"{size:.6g}" for size in asked.steps)
        return [Check("order", "", asked.k, max(0.0, self.p - asked.order), {"margin": MARGIN}, math.inf,
                      f"observed {asked.order:.3g} of {self.p} at steps {apart_by} s")]

    def smooth(self, segment: Segment, steps: Sequence[float]) -> bool:
        return self.p is not None and segment.smooth(steps[:3])

    def _differ(self, name: str, segment: Segment, h: Sequence[float], own: Sequence[np.ndarray]) -> bool:
        """Whether answers differ by more than rounding and noise."""
        uncertainty = self.uncertainty
        return differ(own[:3], uncertainty.roundings(name, segment, h[:3]), uncertainty.noise.get(name, 0.0))

    def of_rows(self, rule: Rule, asked: Answers, h: Sequence[float], rows: Sequence[Rows], smooth: bool, order: float,
                far: tuple[float, Rows] | None = None) -> list[Check]:
        """The checks of where rows go, which are answers less truth, or what else has to vanish with the step.

        `far`: a far smaller step, and the rows there.
        """
        made, segment, uncertainty = [], asked.segment, self.uncertainty
        for name in [name for name in rows[0] if all(name in each for each in rows)]:
            keep = segment.kept(name, self.questions.step_of(*h))
            own = [each[name][keep] for each in rows]
            if not keep.any():
                continue
            times = 2.0 if rule == "gap limit" else 1.0  # of two answers
            finer = None if far is None or name not in far[1] else (far[0], far[1][name][keep])
            found = self._limit(name, segment, h, own, smooth, order, times, finer)
            part = uncertainty.iterated(name, segment, h[0]) / uncertainty.roundings(name, segment, h)[0]
            more = {"rounding": (1.0 - part) * found.parts["rounding"],
                    "iteration (declared)": part * found.parts["rounding"]} if "rounding" in found.parts else {}
            if rule == "limit":
                more["truth"] = SAFETY * asked.flowed.error * self.sizes.get(name, 1.0)
            listed = [*([] if finer is None else [finer]), *zip(h, own, strict=True)]
            made.append(limit_check(rule, name, asked.k, found, more, uncertainty.size_of(name), detail_of(
                self.questions.scene, segment.t[1:][keep], listed, found, "rtol" if self.p is None else "h")))
        return made

    def _limit(self, name: str, segment: Segment, h: Sequence[float], own: list[np.ndarray], smooth: bool,
               order: float, times: float = 1.0, far: tuple[float, np.ndarray] | None = None) -> Limit:
        """Where the answers of one row go; `times`: how many roundings and noises each has; `far`: one more answer."""
        uncertainty = self.uncertainty
        rounding = [times * each for each in uncertainty.roundings(name, segment, h)]
        noise = times * uncertainty.noise.get(name, 0.0)
        if self.p is None:
            kept = times * uncertainty.believed(segment) * h[0] * self.sizes.get(name, 1.0) * segment.growth
            return spread_of_tolerances(own[:3], rounding[0], noise, kept)
        if smooth:
            if name in OF_STATE:
                return limit(h, own, self.p, rounding, noise, order, far)
            return limit(h, own, 1, rounding, noise, observed_order(h[:3], own[:3]), far)  # of no state: its own
        # A method that documents a higher order where a motion is not smooth finds the events, and others are late.
        late = self.p < 2
        jump = sum(each.rates.get(name, 0.0) for each in segment.flowed.jumps) if segment.flowed and late else 0.0
        order = 1 if late or name not in OF_STATE else self.p
        return index(h[:3], own[:3], order, rounding[0], noise, jump * h[0] * segment.growth)

    def _promised(self, answers: Sequence[Answers]) -> list[Check]:
        """R3: accelerations are those of the states, or come to them at the documented order where that is two or more.

        What Newton's iteration leaves in them has no order; those of a step before have the same lower one everywhere.
        """
        made, order = list[Check](), self.p or 1
        for name in ACCELERATIONS if order > 1 else ():
            orders = {asked.k: asked.promised[name] for asked in answers if name in asked.promised}
            if orders and min(orders.values()) >= MARGIN:
                k = max(orders, key=lambda k: orders[k])
                made.append(Check("order", name, k, max(0.0, order - orders[k]), {"margin": MARGIN}, math.inf,
                                  f"less those of the states, observed {orders[k]:.3g} of {order}"))
        return made


def refined(before: Sequence[Check], after: Sequence[Check]) -> list[Check]:
    """The checks of finer answers; where these say less of a row than coarser ones did, those stand."""
    old = {(check.rule, check.name): check for check in before}
    return [old[check.rule, check.name] if check.status == "unresolved" and (check.rule, check.name) in old
            and old[check.rule, check.name].status != "fail"
            and old[check.rule, check.name].severity < check.severity else check for check in after]
