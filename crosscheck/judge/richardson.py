"""Judge the limit of runs for vanishing steps against truth. This separates a wrong model from a coarse step."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from crosscheck.compare.errors import errors
from crosscheck.compare.order import cancelling
from crosscheck.document import QUANTITIES, Finding, Order
from crosscheck.judge import known, tolerances
from crosscheck.judge.claim import Trace
from crosscheck.judge.crossings import late
from crosscheck.judge.tolerances import Tol
from crosscheck.references.base import Reference
from crosscheck.scene.model import Scene
from crosscheck.scene.states import States

LEAST = 0.75
"""Errors that fall more slowly than this power of the step count as not falling, and are not used to extrapolate."""


def extrapolated(coarse: States, fine: States, ratio: float, order: int) -> States:
    """fine + (fine - coarse) / (ratio^order - 1), where ratio is the coarser step over the finer one.

    Attitudes are extrapolated entry by entry, which leaves them as orthogonal as the extrapolation is exact.
    """
    one, other = cancelling(np.array([1.0, ratio]), order)
    parts = [one * getattr(fine, name) + other * getattr(coarse, name) for name in "xRvw"]
    return States(fine.t, *parts)


def extrapolation_order(documented: int, observed: Order, failed: bool) -> int:
    """The order for extrapolation: the documented one, or a lower observed one if the documented one failed."""
    if not failed or observed.observed is None or observed.observed < LEAST:
        return documented
    return min(documented, max(1, round(observed.observed)))


def judge_limit(scene: Scene, runs: Sequence[tuple[float, Trace]], truth: Reference, order: int,
                orders: Mapping[str, Order], failing: frozenset[str], eps: float = tolerances.EPS) -> list[Finding]:
    """Judge the limit of the two finest runs against truth, for each quantity.

    Parameters
    ----------
    runs : (step (s), trajectory) at the output times of `truth`
    order : the documented order
    orders : the observed orders, which are used for the quantities in `failing`
    """
    finest = sorted(dict(runs).items(), key=lambda run: run[0])[:2]
    if len(finest) < 2:
        return [Finding(f"limit {name}", "unresolved", None, None, unit, "a limit needs runs at two steps that reach "
                        "their end")
                for name, unit in QUANTITIES.items()]
    (fine_step, fine), (coarse_step, coarse) = finest
    findings, scale = [], tolerances.scales(scene, truth)
    by_events = late(scene, truth, coarse_step) if order == 1 else {}
    for name, unit in QUANTITIES.items():
        used = extrapolation_order(order, orders[name], name in failing)
        limit = extrapolated(coarse, fine, coarse_step / fine_step, used)
        error = errors(scene, limit, truth.states, truth.horizon)[name]
        tol = tolerances.limit(scene, truth, used, coarse_step, eps)[name]
        if rounding := orders[name].rounding:  # errors on the rounding plateau, which fall no more
            tol = Tol(tol.value + 2 * rounding, f"{tol.why}; rounding of both runs, {rounding:.1e}")
        if name in by_events:
            tol = Tol(tol.value + 2 * by_events[name], f"{tol.why}; events met late in both, {by_events[name]:.1e}")
        where = f"body {error.body}, t = {error.time:.4g} s, extrapolated with order {used}"
        if tol.value > scale.of(name) and np.isfinite(error.max):
            findings.append(Finding(f"limit {name}", "unresolved", error.max, None, unit, "at these steps the bound, "
                                    f"{tol.value:.2g}, exceeds the size of the quantity itself", where))
            continue
        good = error.max <= tol.value
        slope = orders[name].observed
        text = "" if good else f"; {known.RISES}" if slope is not None and slope <= known.RISING else (
            "; no step makes it smaller: the model differs, or its order is not what it seems")
        findings.append(Finding(f"limit {name}", "ok" if good else "fail", error.max, tol.value, unit, tol.why,
                                where + text))
    return findings
