"""Observed orders, without any engine or tolerance."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from crosscheck.compare.errors import Error as Error
from crosscheck.compare.errors import energy_gap as energy_gap
from crosscheck.compare.errors import errors as errors
from crosscheck.compare.errors import up_to as up_to
from crosscheck.document import Order

PLATEAU = 8.0
"""Times the rounding floor below which an error has too much noise for an order fit. At 8 floors, noise moves one
error by 1/8, and so the order fitted over three halvings by at most 0.05."""

SETTLED = 0.05
"""Orders between neighbouring steps count as equal up to this difference, which noise alone may make."""


STALLED = 0.75
"""Slope below which errors are rounding, and above which a method converges. Rounding of the states grows with the
number of steps (slope -1), that of accelerations falls as a random walk times the step (slope 1/2); the lowest order
is 1."""

SHORT = 1.0
"""If a slope is lower than the documented order by more than this, rounding may set in there."""


@dataclasses.dataclass(frozen=True)
class Plateau:
    """How large rounding may be in errors at ever finer steps."""

    floor: float  # errors below `PLATEAU` floors are rounding
    ceiling: float = 0.0  # errors below it are rounding if they stop falling, see `_stalled`
    order: int = 0  # the documented order
    rate: float = 0.0  # as floor, of errors that rounding makes at a step h: rate / h


EXACT = Plateau(0.0)
"""No rounding at all."""


def observed_order(steps: Sequence[float], values: Sequence[float], plateau: Plateau = EXACT,
                   finest: int | None = None) -> Order:
    """Order p of errors ~ h^p: least squares of the logarithms over the steps above the rounding plateau.

    Parameters
    ----------
    steps : step sizes (s) in any sequence
    values : the error against truth at each step
    plateau : how large rounding may be; errors at the first step that is rounding, and at finer ones, are left out
    finest : the largest number of steps that take part, the finest ones above the plateau; None: all

    Returns
    -------
    Order
        With `observed=None` and a note if fewer than three steps take part.
    """
    pairs = sorted(zip(steps, values, strict=True), reverse=True)
    h = np.array([step for step, _ in pairs])
    e = np.array([value for _, value in pairs])
    with np.errstate(divide="ignore", invalid="ignore"):
        slopes = np.diff(np.log(e)) / np.diff(np.log(h)) if len(h) > 1 else np.empty(0)
    neighbours = tuple(float(slope) for slope in slopes)
    good = np.isfinite(e) & (e > PLATEAU * np.maximum(plateau.floor, plateau.rate / h)) & (e > 0)
    first = int(np.argmax(good)) if good.any() else 0
    last = first
    while last < len(h) and good[last]:
        last += 1
    stalled = _stalled(h, e, slopes, plateau)
    rounding = float(e[stalled:].max(initial=0.0))
    last = min(last, stalled)
    recent = slopes[first:last - 1][-3:]
    settled, exhausted = len(recent) == 3 and bool(np.ptp(recent) <= SETTLED), last < len(h)
    first = max(first, last - (finest or last))
    used = max(0, last - first) if good.any() else 0
    if used < 3:
        return Order(observed=None, documented=plateau.order, used=used, pairs=neighbours, settled=settled,
                     note=f"only {used} of {len(h)} steps lie above the rounding plateau", exhausted=exhausted,
                     rounding=rounding)
    slope = _slope(h[first:last], e[first:last])
    if (slope < plateau.order - SHORT / 2 and plateau.floor < rounding and 0 < stalled < len(h)
            and slopes[stalled - 1] < plateau.order / 3):  # the error next to such rounding has a part of it
        return observed_order(steps, values, dataclasses.replace(plateau, floor=rounding), finest)
    if (slope < plateau.order - SHORT / 2 and exhausted and used == 3
            and recent[-1] - recent[-2] > SETTLED):
        return Order(observed=None, documented=plateau.order, used=used, pairs=neighbours, settled=settled,
                     note="the order still rises where rounding sets in", exhausted=exhausted, rounding=rounding)
    rising = len(recent) == 3 and bool((np.diff(recent) > 0).all())
    return Order(observed=slope, documented=plateau.order, used=used, pairs=neighbours,
                 settled=settled, exhausted=exhausted, finest=float(recent[-1]) if rising else None, rounding=rounding)


def _slope(h: np.ndarray, e: np.ndarray) -> float:
    return float(np.polyfit(np.log(h), np.log(e), 1)[0])


def _stalled(h: np.ndarray, e: np.ndarray, slopes: np.ndarray, plateau: Plateau) -> int:
    """Index of the first error, from coarse to fine, after which they stop falling; their number if all fall.

    It takes three errors that stop falling, or two, or a last one, if the errors before them have shown the order. They
    may rise as 1 / h from there, as the rounding of positions does in velocities.
    """
    for index in range(len(h)):
        tail = e[index:]
        rounding = np.isfinite(tail) & (tail > 0) & (tail < plateau.ceiling * h[index] / h[index:])
        if not rounding.all() or (index and slopes[index - 1] >= plateau.order - SHORT):
            continue
        if len(tail) >= 3:
            stalls = _slope(h[index:], tail) < STALLED
        else:
            before = e[:index]
            shown = (index >= 2 and bool((np.isfinite(before) & (before > 0)).all())
                     and _slope(h[:index], before) >= plateau.order - SHORT)
            stalls = shown and (slopes[-1] < STALLED if len(tail) == 2 else index >= 3)
        if stalls:
            return index
    return len(h)
