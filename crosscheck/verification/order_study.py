"""The order study of one cell: errors at ever finer steps over the first window of the scene, in bounded time."""

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
from crosscheck.judge import tolerances
from crosscheck.judge.defects import NORMS
from crosscheck.judge.metrics import PLATEAU, errors
from crosscheck.judge.plan import RTOLS
from crosscheck.judge.richardson import judge_limit
from crosscheck.judge.substeps import judge_substeps
from crosscheck.judge.verdict import judge_orders, undecided
from crosscheck.references.base import Reference
from crosscheck.references.rates import fastest
from crosscheck.running.trajectory import Trajectory
from crosscheck.scene.model import Scene
from crosscheck.scene.spanning import spanning_tree
from crosscheck.verification.attempts import NoRun, attempt
from crosscheck.verification.task import Cell

clock = time.process_time  # s of this process, which the load of the machine does not change

REFINEMENTS = 4
"""Steps that an order study adds where an order is low. The next term of the error moves the slope by one at most where
both are alike in size, and by half of that with every halving: after four by less than the margin of an order."""

FEWEST = 3
"""Steps that it takes to speak of an order: two always lie on a line."""

HOPELESS = 10.0
"""A main run whose errors all exceed their bounds by this factor fails whatever order finer steps show."""


@dataclasses.dataclass(frozen=True)
class Study:
    """What an order study found."""

    findings: list[Finding]
    orders: dict[str, Order]
    ladder: list[Rung]
    cut: str = ""  # why it has fewer steps than planned, where the bound of its time cut it
    refused: str = ""  # why the engine does not support the scene at all
    message: str = ""  # the last error of a class that no engine is meant to raise


class _Ladder:
    """The runs of one order study as they are made, coarse to fine."""

    def __init__(self, cell: Cell, order: int | None, scene: Scene, reference: Reference) -> None:
        self.cell, self.order, self.scene, self.reference = cell, order, scene, reference
        self.rungs: list[Rung] = []
        self.runs: list[tuple[float, Trajectory]] = []
        self.cut = self.refused = self.message = ""
        self._costs: list[float] = []  # s

    def add(self, size: float) -> bool:
        """One more step (s), or rtol; False where the bound of time forbids it."""
        if not self._affordable(size):
            return False
        step, rtol = (None, size) if self.order is None else (size, None)
        began = clock()
        cell = self.cell
        traj = attempt(self.scene, cell.engine, cell.method, cell.form, step, rtol, monitor=False,
                       coordinate_map=cell.coordinate_map)
        self._costs.append(clock() - began)
        if isinstance(traj, NoRun):
            self.rungs.append(Rung(step=step, rtol=rtol, message=traj.reason.partition("\n")[0]))
            self.refused = traj.reason if traj.unsupported else self.refused
            self.message = traj.reason if traj.unforeseen else self.message
            return True
        found = errors(self.scene, traj, self.reference.states, self.reference.horizon)
        used = traj.stats.get("step")
        self.runs.append((used or size, traj))
        self.rungs.append(Rung(
            step=used or step, rtol=rtol, wall_time=float(traj.wall_time), steps=int(traj.steps),
            errors={name: error.max for name, error in found.items()},
            end={name: error.end for name, error in found.items()}))
        return True

    def finer(self) -> float:
        """The next step (s), in the ratio of the last two."""
        coarse, fine = (rung.step or 0.0 for rung in self.rungs[-2:])
        return fine**2 / coarse

    def _affordable(self, size: float) -> bool:
        """Whether one more run keeps to the bound of time, by what the last one took; the coarsest is always run.

        Where it does not, `cut` says so. Runs of adaptive methods cost about as much at every tolerance.
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
        """What was found, with the documented slope through the coarsest rung as a guide in figures."""
        rungs = self.rungs
        if self.order is not None and len(rungs) >= (FEWEST if self.cut else 1):
            start, first = rungs[0].errors.get("position"), rungs[0].step or 1.0
            if start is not None:
                rungs = [replace(rung, guide=start * ((rung.step or 0.0) / first) ** self.order) for rung in rungs]
        return Study(list(findings), orders or {}, rungs, self.cut, self.refused, self.message)


def order_study(cell: Cell, order: int | None, scene: Scene, reference: Reference, judged: Sequence[Finding],
                failed: bool) -> Study:
    """Errors at halved steps (or tightened tolerances) over the window, and the orders they show.

    Parameters
    ----------
    order : the documented one; None for an adaptive method
    judged : findings of the main run
    failed : the main run did not reach its end
    """
    rtols = RTOLS if cell.rungs is None else RTOLS[::2][:cell.rungs]
    sizes = rtols if order is None else cell.plan.ladder(order, cell.rungs)
    ladder = _Ladder(cell, order, scene, reference)
    for size in sizes:
        # Where neither the main run nor the coarsest reach their end, finer ones tell no more.
        if not ladder.add(size) or (failed and not ladder.runs):
            break
    if order is None:
        scale = tolerances.scales(scene, reference)
        floor = tolerances.plateau(scene, reference, scale.of("position"), 1, adapters.eps(cell.engine)).floor
        return ladder.study([*judge_tolerances(ladder.rungs, floor),
                             *judge_promise(scene, reference, ladder.rungs, adapters.eps(cell.engine))])
    if ladder.cut and len(ladder.rungs) < FEWEST:
        return ladder.study([Finding(f"order {quantity}", "unjudged", None, None, "1", f"documented order {order}",
                                     f"order not measured: {ladder.cut}") for quantity in QUANTITIES])
    scale = tolerances.scales(scene, reference)
    eps = adapters.eps(cell.engine)
    plateaus = {quantity: tolerances.plateau(scene, reference, scale.of(quantity), order, eps)
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
    low = frozenset(each.kind.removeprefix("order ") for each in findings if each.status == "fail")
    limits = judge_limit(scene, ladder.runs, reference, order, orders, low, eps)
    return ladder.study([*findings, *limits, *_substeps(ladder, sizes, order)], orders)


def _substeps(ladder: _Ladder, sizes: Sequence[float], order: int) -> list[Finding]:
    """Of the coarsest run that reached its end."""
    scene, runs = ladder.scene, [(size, run) for size, (_, run) in zip(sizes, ladder.runs, strict=False)]
    if not runs or len(ladder.runs) < len(ladder.rungs):
        return []
    size, traj = runs[0]
    return judge_substeps(scene, traj, ladder.reference, order, steps_per_sample(scene, size)[0] * (scene.samples - 1))


SMALL = 1e-6
"""Growth beyond one below which it is none."""

LEAST_SLOPE = 0.5
"""Of errors over tolerances: codes come to 0.75 to 1.2, and one that does not follow its tolerance to 0."""


def judge_tolerances(rungs: Sequence[Rung], floor: float) -> list[Finding]:
    """Whether the position error falls with the tolerance, over those at which it is above rounding (m)."""
    seen = [(rung.rtol, error) for rung in rungs
            if rung.rtol and (error := rung.errors.get("position")) is not None and PLATEAU * floor < error]
    why = "errors fall as the tolerance does: least squares in the logarithms over the ladder of tolerances"
    if len(seen) < FEWEST or len({rung.steps for rung in rungs}) < FEWEST:
        return [Finding("order rtol", "unjudged", None, LEAST_SLOPE, "1", why, "too few tolerances above rounding")]
    tolerances, errors = np.log(np.array(seen)).T
    slope = float(np.polyfit(tolerances, errors, 1)[0])
    return [Finding("order rtol", "ok" if slope >= LEAST_SLOPE else "fail", slope, LEAST_SLOPE, "1", why,
                    f"{len(seen)} tolerances from {seen[0][0]:.0e} to {seen[-1][0]:.0e}")]


FEWEST_COUNTED = 10
"""Steps of a run whose engine tells of fewer: some do not count theirs, and outputs are interpolated in long ones."""


def judge_promise(scene: Scene, reference: Reference, rungs: Sequence[Rung], eps: float) -> list[Finding]:
    """Whether errors are as small as every tolerance of the ladder says: each step below it, and what they grow to.

    A perturbation of the start grows by A over the window; those of steps on the way, where it does so at an even pace,
    by (A - 1) / ln A on average. Over a brief window this is far closer than A at every step, so that an engine whose
    tolerance is a hundred times that asked for does not hide in the growth; one whose steps are so much better than
    their estimates may. With stiff springs and closed loops codes differ by their norms, see `NORMS`.
    """
    most = reference.amplification
    growth = (most - 1.0) / math.log(most) if most > 1.0 + SMALL else 1.0
    hard = bool(spanning_tree(scene)[1]) or fastest(scene) > tolerances.scales(scene, reference).rate
    norm, found = NORMS if hard else 1.0, []
    for rung in rungs:
        if rung.rtol is None or not rung.errors:
            continue
        bounds = tolerances.adaptive(scene, reference, norm * rung.rtol, max(rung.steps or 0, FEWEST_COUNTED), growth,
                                     eps)
        found += [(error / bounds[quantity].value, f"{quantity} at rtol {rung.rtol:.0e}")
                  for quantity, error in rung.errors.items() if error is not None]
    if not found:
        return []
    value, where = max(found)
    reach = f"; steps {1.0 / value:.2g} times less exact would keep it" if 0.0 < value <= 1.0 else ""
    return [Finding("rtol", "ok" if value <= 1.0 else "fail", value, 1.0, "1", "errors over what the tolerance allows, "
                    f"the largest of the ladder: {norm:g} n rtol times the size, n steps, grown by {growth:.3g} on "
                    "average", where + reach)]


def _tell_cut(cut: str, findings: list[Finding], orders: dict[str, Order]) -> list[Finding]:
    """Where the time limit cut the study, a low order that finer steps may lift is undecided."""
    if not cut:
        return findings
    told = []
    for finding in findings:
        if finding.status == "fail" and finding.value is not None and not orders[
                finding.kind.removeprefix("order ")].settled:
            finding = replace(finding, status="unjudged", detail=f"finer steps may lift it; {cut}")
        elif finding.status != "ok":
            finding = replace(finding, detail="; ".join(filter(None, (finding.detail, cut))))
        told.append(finding)
    return told
