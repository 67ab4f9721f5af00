"""The order study of one cell: errors at ever finer steps over the first window of the scene, in bounded time."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, Any

from crosscheck.judge import tolerances
from crosscheck.judge.metrics import QUANTITIES, Order, errors
from crosscheck.judge.plan import RTOLS
from crosscheck.judge.richardson import judge_limit
from crosscheck.judge.verdict import Finding, Record, judge_orders, undecided
from crosscheck.references.base import Reference
from crosscheck.scene.model import Scene
from crosscheck.verification.attempts import attempt

clock = time.process_time  # s; what others do on the machine decides nothing

if TYPE_CHECKING:
    from crosscheck.verification.cell import Cell

REFINEMENTS = 4
"""Steps that an order study adds where an order is low. The next term of the error moves the slope by one at most where
both are alike in size, and by half of that with every halving: after four by less than the margin of an order."""

FEWEST = 3
"""Steps that it takes to speak of an order: two always lie on a line."""

HOPELESS = 10.0
"""Where every error of the main run exceeds its bound so many times, no order that finer steps may show saves it."""


def order_study(record: Record, cell: Cell, scene: Scene, reference: Reference) -> None:
    """Errors at halved steps (or tightened tolerances) over the window, and the orders they show."""
    order = record.documented_order
    sizes = cell.plan.ladder(order, cell.rungs) if order is not None else RTOLS[:cell.rungs]
    runs: list[tuple[float, Any]] = []
    costs: list[float] = []  # s
    for size in sizes:
        if not _affordable(record, cell.most_seconds, size, costs):
            break
        _add_rung(record, cell, scene, reference, size, runs, costs)
        if record.status == "failed" and not runs:  # neither the main run nor the coarsest: finer ones tell no more
            break
    if order is None:
        return
    if record.ladder_cut and len(record.ladder) < FEWEST:
        _not_measured(record, record.ladder_cut)
        return
    scale = tolerances.scales(scene, reference)
    plateaus = {quantity: tolerances.plateau(scene, reference, scale.of(quantity), order) for quantity in QUANTITIES}
    findings, orders = judge_orders(order, record.ladder, plateaus)
    most = len(sizes) + (0 if _hopeless(record) else REFINEMENTS)
    while undecided(findings, orders) and len(record.ladder) < most and not record.ladder_cut:
        coarse, fine = (rung["step"] for rung in record.ladder[-2:])
        if _affordable(record, cell.most_seconds, fine**2 / coarse, costs):
            _add_rung(record, cell, scene, reference, fine**2 / coarse, runs, costs)
            findings, orders = judge_orders(order, record.ladder, plateaus, len(sizes))
    if len(record.ladder) > len(sizes):
        findings, orders = judge_orders(order, record.ladder, plateaus, len(sizes), final=True)
    _tell_cut(record, findings, orders)
    # A guide of the documented slope through the coarsest point, for the eye.
    first = record.ladder[0]
    for rung in record.ladder:
        start = first["errors"].get("position")
        rung["guide"] = None if start is None else start * (rung["step"] / first["step"]) ** order
    low = frozenset(each.kind.removeprefix("order ") for each in findings if each.status == "fail")
    record.findings += [*findings, *judge_limit(scene, runs, reference, order, orders, low)]
    record.orders = {name: {"observed": result.observed, "documented": order, "used": result.used,
                            "pairs": list(result.pairs), "note": result.note} for name, result in orders.items()}


def _not_measured(record: Record, reason: str) -> None:
    if record.documented_order is not None:
        record.findings += [Finding(f"order {quantity}", "unjudged", None, None, "1",
                                    f"documented order {record.documented_order}", f"order not measured: {reason}")
                            for quantity in QUANTITIES]


def _hopeless(record: Record) -> bool:
    judged = [finding for finding in record.findings if finding.kind in QUANTITIES and finding.bound]
    return bool(judged) and all(finding.value is not None and not finding.value <= HOPELESS * finding.bound
                                for finding in judged if finding.bound)


def _affordable(record: Record, most_seconds: float | None, size: float, costs: list[float]) -> bool:
    """Whether one more run keeps to the bound of time, by what the last one took; the coarsest is always run.

    Where it does not, the record says so. Runs of adaptive methods cost about as much at every tolerance.
    """
    if most_seconds is None or not costs:
        return True
    fixed = record.documented_order is not None
    finer = record.ladder[-1]["step"] / size if fixed else 1.0
    if sum(costs) + costs[-1] * finer <= most_seconds:
        return True
    at = f"step of {size:.3g} s" if fixed else f"tolerance of {size:g}"
    record.ladder_cut = f"cut before a {at}, with which the study would take more than {most_seconds:g} s"
    return False


def _tell_cut(record: Record, findings: list[Finding], orders: dict[str, Order]) -> None:
    """Where the bound of time cut the study, a low order that finer steps may lift is undecided."""
    if not record.ladder_cut:
        return
    for finding in findings:
        if finding.status == "fail" and finding.value is not None and not orders[
                finding.kind.removeprefix("order ")].settled:
            finding.status, finding.detail = "unjudged", f"finer steps may lift it; {record.ladder_cut}"
        elif finding.status != "ok":
            finding.detail = "; ".join(filter(None, (finding.detail, record.ladder_cut)))


def _add_rung(record: Record, cell: Cell, scene: Scene, reference: Reference, size: float,
              runs: list[tuple[float, Any]], costs: list[float]) -> None:
    """One more step (s), or rtol, of the order study: what it showed, into the record; its trajectory and its cost."""
    fixed = record.documented_order is not None
    step, rtol = (size, None) if fixed else (None, size)
    began = clock()
    traj = attempt(scene, record, cell.form, step, rtol, monitor=False)
    costs.append(clock() - began)
    rung: dict[str, Any] = {"step": step, "rtol": rtol, "errors": {}, "end": {}, "wall_time": None, "steps": None}
    if isinstance(traj, str):
        rung["message"] = traj.splitlines()[0] if traj else record.message
    else:
        found = errors(scene, traj, reference.states, reference.horizon)
        runs.append((traj.stats.get("step") or size, traj))
        rung |= {"step": traj.stats.get("step") or step, "wall_time": float(traj.wall_time),
                 "steps": int(traj.steps), "errors": {name: error.max for name, error in found.items()},
                 "end": {name: error.end for name, error in found.items()}}
    record.ladder.append(rung)
