"""The order study of one cell: errors at finer and finer steps over the first window of the scene, in limited time."""

from __future__ import annotations

import dataclasses
import math
import time
from collections.abc import Sequence

import numpy as np
from msgspec.structs import replace

from crosscheck import adapters
from crosscheck.adapters.base import steps_per_sample
from crosscheck.document import QUANTITIES, Finding, Order, Rung
from crosscheck.errors import EngineError
from crosscheck.judge import tolerances
from crosscheck.judge.crossings import late
from crosscheck.judge.defects import NORMS
from crosscheck.judge.metrics import PLATEAU, errors
from crosscheck.judge.plan import RTOLS, STUDY_SAMPLES
from crosscheck.judge.richardson import judge_limit
from crosscheck.judge.substeps import MORE, judge_substeps
from crosscheck.judge.verdict import judge_orders, undecided
from crosscheck.references.base import Reference
from crosscheck.references.maximal import fastest
from crosscheck.running.attempt import Ran, Refused, attempt, lasting
from crosscheck.running.trajectory import Trajectory
from crosscheck.scene.constraints import Constraints
from crosscheck.scene.model import Scene
from crosscheck.scene.spanning import spanning_tree
from crosscheck.verification.task import Cell

clock = time.process_time  # processor time (s), which does not depend on the load of the machine

REFINEMENTS = 4
"""Steps that an order study adds if an order is low. The next term of the error changes the slope by at most one, if
both terms have the same size. Every halving halves this change, so that after four it is below an order's margin."""

FEWEST = 3
"""Fewest steps for an order, because two errors always lie on a line."""

HOPELESS = 10.0
"""If all errors of a main run exceed their bounds by this factor, it fails whatever the order: no steps are added."""


@dataclasses.dataclass(frozen=True)
class Study:
    """The result of an order study."""

    findings: list[Finding]
    orders: dict[str, Order]
    ladder: list[Rung]
    cut: str = ""  # why it has fewer steps than planned, if its time limit cut it
    refused: str = ""  # why the engine does not support the scene at all
    message: str = ""  # the last error that an adapter should not raise


class _Ladder:
    """The runs of one order study. They are added one by one, coarse to fine."""

    def __init__(self, cell: Cell, order: int | None, scene: Scene, reference: Reference) -> None:
        self.cell, self.order, self.scene, self.reference = cell, order, scene, reference
        self.rungs: list[Rung] = []
        self.runs: list[tuple[float, Trajectory]] = []
        self.asked: list[int] = []  # steps wanted of each run, of a method with a fixed step
        self.cut = self.refused = self.message = ""
        self._costs: list[float] = []  # s

    def add(self, size: float) -> bool:
        """Make a run at one more step (s) or rtol. Returns False, without a run, if the time limit forbids it."""
        if not self._affordable(size):
            return False
        step, rtol = (None, size) if self.order is None else (size, None)
        began = clock()
        outcome = lasting(attempt(self.scene, self.cell.way, step=step, rtol=rtol, monitor=False))
        self._costs.append(clock() - began)
        if not isinstance(outcome, Ran):
            self.rungs.append(Rung(step=step, rtol=rtol, message=outcome.why))
            if isinstance(outcome, Refused):
                self.refused = outcome.why
            elif not isinstance(outcome.error, EngineError):
                self.message = outcome.why
            return True
        traj = outcome.trajectory
        missed = errors(self.scene, traj, self.reference.states, self.reference.horizon)
        used = traj.stats.get("step")
        if self.order is not None:
            self.asked.append(steps_per_sample(self.scene, size)[0] * (self.scene.samples - 1))
        self.runs.append((used or size, traj))
        self.rungs.append(Rung(
            step=used or step, rtol=rtol, wall_time=float(traj.wall_time), steps=int(traj.steps),
            errors={name: error.max for name, error in missed.items()},
            end={name: error.end for name, error in missed.items()}))
        return True

    def finer(self) -> float:
        """The next step (s): the last two steps and this one have equal ratios."""
        coarse, fine = (rung.step or 0.0 for rung in self.rungs[-2:])
        return fine**2 / coarse

    def _affordable(self, size: float) -> bool:
        """Whether one more run fits into the time limit, predicted from the last run. The coarsest run always does.

        If it does not, `cut` says so. The cost of adaptive methods is taken as the same at every tolerance.
        """
        most_seconds = self.cell.most_seconds
        if most_seconds is None or not self._costs:
            return True
        fixed = self.order is not None
        finer = (self.rungs[-1].step or 0.0) / size if fixed else 1.0
        if sum(self._costs) + self._costs[-1] * finer <= most_seconds:
            return True
        at = f"step of {size:.3g} s" if fixed else f"tolerance of {size:g}"
        self.cut = f"cut before a {at}, with which the study would take more than {most_seconds:g} s"
        return False

    def study(self, findings: Sequence[Finding] = (), orders: dict[str, Order] | None = None) -> Study:
        """The result, with a line of the documented slope through the coarsest rung as a guide for figures."""
        rungs = self.rungs
        if self.order is not None and len(rungs) >= (FEWEST if self.cut else 1):
            start, first = rungs[0].errors.get("position"), rungs[0].step or 1.0
            if start is not None:
                rungs = [replace(rung, guide=start * ((rung.step or 0.0) / first) ** self.order) for rung in rungs]
        return Study(list(findings), orders or {}, rungs, self.cut, self.refused, self.message)


def order_study(cell: Cell, order: int | None, scene: Scene, reference: Reference, judged: Sequence[Finding],
                failed: bool) -> Study:
    """Measure errors at finer and finer steps (or tolerances) over the window, and judge the orders that they show.

    Parameters
    ----------
    order : the documented one; None for an adaptive method
    judged : findings of the main run
    failed : whether the main run did not reach its end
    """
    rtols = RTOLS if cell.rungs is None else RTOLS[::2][:cell.rungs]
    sizes = rtols if order is None else cell.plan.ladder(order, cell.rungs)
    ladder = _Ladder(cell, order, scene, reference)
    for size in sizes:
        # If neither the main run nor the coarsest run reach their end, stop.
        if not ladder.add(size) or (failed and not ladder.runs):
            break
    if order is None:
        scale = tolerances.scales(scene, reference)
        floor = tolerances.plateau(scene, reference, scale.of("position"), 1, adapters.get(cell.way.engine).eps).floor
        documented = adapters.get(cell.way.engine).orders.get(cell.way.method)
        return ladder.study([*judge_tolerances(ladder.rungs, floor, documented),
                             *judge_promise(scene, reference, ladder.rungs, adapters.get(cell.way.engine).eps)])
    if ladder.cut and len(ladder.rungs) < FEWEST:
        return ladder.study([Finding(f"order {quantity}", "unresolved", None, None, "1", f"documented order {order}",
                                     f"order not measured: {ladder.cut}") for quantity in QUANTITIES])
    parts = [told * asked for (_, traj), asked in zip(ladder.runs, ladder.asked, strict=True)
             if (told := traj.stats.get("step"))]
    if parts and max(parts) > MORE * min(parts):
        why = "largest over smallest part of the step asked for that runs of a study say they took: no order"
        return ladder.study([Finding("steps", "fail", max(parts) / min(parts), MORE, "1", why)])
    scale = tolerances.scales(scene, reference)
    eps = adapters.get(cell.way.engine).eps
    # In single precision velocities have the rounding of positions over the step, where joints are held by positions.
    rates = tolerances.differenced(scale.of("position"), eps)
    plateaus = {quantity: dataclasses.replace(tolerances.plateau(scene, reference, scale.of(quantity), order, eps),
                                              rate=rates.get(quantity, 0.0))
                for quantity in QUANTITIES}
    findings, orders = judge_orders(order, ladder.rungs, plateaus)
    hopeless = [finding.value is not None and not finding.value <= HOPELESS * finding.bound
                for finding in judged if finding.kind in QUANTITIES and finding.bound]
    most = len(sizes) + (0 if hopeless and all(hopeless) else REFINEMENTS)
    while undecided(findings, orders) and len(ladder.rungs) < most and ladder.add(ladder.finer()):
        findings, orders = judge_orders(order, ladder.rungs, plateaus, len(sizes))
    if len(ladder.rungs) > len(sizes):
        findings, orders = judge_orders(order, ladder.rungs, plateaus, len(sizes), final=True)
    findings = _tell_cut(ladder.cut, findings, orders)
    if order == 1:
        findings = _by_events(findings, ladder)
    low = frozenset(each.kind.removeprefix("order ") for each in findings if each.status == "fail")
    limits = judge_limit(scene, ladder.runs, reference, order, orders, low, eps)
    # Hidden sub-steps show in the coarsest run, if none failed.
    whole = ladder.runs and len(ladder.runs) == len(ladder.rungs)
    substeps = judge_substeps(scene, ladder.runs[0][1], reference, order, ladder.asked[0],
                              (ladder.runs[-1][1], ladder.asked[-1])) if whole else []
    return ladder.study([*findings, *limits, *substeps], orders)


def _by_events(findings: list[Finding], ladder: _Ladder) -> list[Finding]:
    """The findings, in which a low order is undecided if events met up to two steps late explain errors of this size.

    The limit is judged all the same.
    """
    low = {finding.kind.removeprefix("order ") for finding in findings if finding.status == "fail"}
    if not low or not all(rung.errors and rung.step for rung in ladder.rungs):
        return findings
    most = [late(ladder.scene, ladder.reference, rung.step or 0.0) for rung in ladder.rungs]
    excused = {name for name in low if all(name in each and (rung.errors[name] or 0.0) <= each[name]
                                           for rung, each in zip(ladder.rungs, most, strict=True))}
    return [replace(finding, status="unresolved", detail="events met up to two steps late explain errors of this size, "
                    "which depend on where steps meet them") if finding.kind.removeprefix("order ") in excused
            else finding for finding in findings]


SMALL = 1e-6
"""An amplification of less than 1 + SMALL counts as no growth."""

LEAST_SLOPE = 0.5
"""Least slope of log error over log tolerance. Codes have 0.75 to 1.2; one that ignores its tolerance has 0."""

LUCKY = 0.5
"""Share of the error at a finer tolerance below which an error is no measure of its own tolerance."""


def judge_tolerances(rungs: Sequence[Rung], floor: float, order: int | None = None) -> list[Finding]:
    """Judge whether the position error falls with the tolerance. Errors (m) near rounding, `floor`, do not count.

    A method of order p whose steps have errors h^(p + 1) of the size of the tolerance is off by its power p / (p + 1)
    in the end. With p = 1 that is less than other codes have. A run less than half as far off as one at a finer
    tolerance was better than it was asked to be, as where steps end at outputs: it tells nothing.
    """
    least = LEAST_SLOPE if order is None else min(LEAST_SLOPE, (order - tolerances.order_margin(order)) / (order + 1))
    seen = [(rung.rtol, error) for rung in rungs
            if rung.rtol and (error := rung.errors.get("position")) is not None and PLATEAU * floor < error]
    seen = [(rtol, error) for k, (rtol, error) in enumerate(seen)
            if error >= LUCKY * max(finer for _, finer in seen[k:])]
    why = "errors fall as the tolerance does: least squares in the logarithms over the ladder of tolerances"
    counts = {rung.steps or 0 for rung in rungs}
    if len(seen) < FEWEST or len(counts) < FEWEST:
        return [Finding("order rtol", "unresolved", None, least, "1", why, "too few tolerances above rounding")]
    if min(counts) <= STUDY_SAMPLES and max(counts) < FEWEST_COUNTED * STUDY_SAMPLES:
        return [Finding("order rtol", "unresolved", None, least, "1", why, "output times set most of the few steps")]
    asked, errors = np.log(np.array(seen)).T
    slope = float(np.polyfit(asked, errors, 1)[0])
    return [Finding("order rtol", "ok" if slope >= least else "fail", slope, least, "1", why,
                    f"{len(seen)} tolerances from {seen[0][0]:.0e} to {seen[-1][0]:.0e}")]


FEWEST_COUNTED = 10
"""Fewest steps that are assumed for a run. Some engines do not count theirs; outputs in long steps are interpolated."""


def judge_promise(scene: Scene, reference: Reference, rungs: Sequence[Rung], eps: float) -> list[Finding]:
    """Judge whether errors are as small as every tolerance says, if each step has an error of that size which grows.

    A perturbation of the start grows by A over the window. If growth is even, the errors of all steps grow by
    (A - 1) / ln A on average. Over a brief window this is much less than A. So an engine is noticed whose tolerance is
    a hundred times the wanted one, unless its steps are a hundred times better than their estimates. Codes bound the
    error of each of m joint coordinates, or their root mean square; that of a body is sqrt(m) times as large. With
    stiff springs and closed loops the norms of codes differ by more, see `NORMS`.
    """
    most = reference.amplification
    growth = (most - 1.0) / math.log(most) if most > 1.0 + SMALL else 1.0
    hard = bool(spanning_tree(scene)[1]) or fastest(scene) > tolerances.scales(scene, reference).rate
    norm, shares = NORMS if hard else min(NORMS, math.sqrt(max(1, 6 * scene.n - Constraints(scene).m))), []
    for rung in rungs:
        if rung.rtol is None or not rung.errors:
            continue
        bounds = tolerances.adaptive(scene, reference, norm * rung.rtol, max(rung.steps or 0, FEWEST_COUNTED), growth,
                                     eps)
        shares += [(error / bounds[quantity].value, f"{quantity} at rtol {rung.rtol:.0e}")
                  for quantity, error in rung.errors.items() if error is not None]
    if not shares:
        return []
    value, where = max(shares)
    reach = f"; steps {1.0 / value:.2g} times less exact would keep it" if 0.0 < value <= 1.0 else ""
    return [Finding("rtol", "ok" if value <= 1.0 else "fail", value, 1.0, "1", "errors over what the tolerance allows, "
                    f"the largest of the ladder: {norm:g} n rtol times the size, n steps, grown by {growth:.3g} on "
                    "average", where + reach)]


def _tell_cut(cut: str, findings: list[Finding], orders: dict[str, Order]) -> list[Finding]:
    """The findings, in which a low order is undecided if the time limit cut the study and finer steps may raise it."""
    if not cut:
        return findings
    told = []
    for finding in findings:
        if finding.status == "fail" and finding.value is not None and not orders[
                finding.kind.removeprefix("order ")].settled:
            finding = replace(finding, status="unresolved", detail=f"finer steps may lift it; {cut}")
        elif finding.status != "ok":
            finding = replace(finding, detail="; ".join(filter(None, (finding.detail, cut))))
        told.append(finding)
    return told
