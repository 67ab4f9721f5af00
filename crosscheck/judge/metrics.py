"""Errors against truth and observed orders, without any engine or tolerance.

The error of a quantity is the norm of the difference of one body: positions (m) and velocities (m/s) in world axes,
angular velocities (rad/s) in body axes, attitudes by the angle (rad) of the rotation that takes one to the other.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping, Sequence

import numpy as np

from crosscheck.document import QUANTITIES, Errors, Order
from crosscheck.errors import ArgumentError
from crosscheck.scene import mechanics
from crosscheck.scene.model import Scene
from crosscheck.scene.states import Motion

PLATEAU = 8.0
"""Times the rounding floor below which an error has too much noise for an order fit. At 8 floors, noise moves one
error by 1/8, and so the order fitted over three halvings by at most 0.05."""

SETTLED = 0.05
"""Orders between neighbouring steps count as equal up to this difference, which noise alone may make."""


def up_to(t: np.ndarray, end: float) -> np.ndarray:
    """Which times (s) are no later than the end (s)."""
    return t <= end * (1 + 1e-12)  # both are sums, with roundings of their own


@dataclasses.dataclass(frozen=True)
class Error:
    """Error of one quantity against truth over a run, in the unit of the quantity."""

    unit: str
    times: np.ndarray  # (T,) s
    series: np.ndarray  # (T,) the largest of all bodies; NaN where there is no truth
    body: str  # the body with the largest error of all times

    @property
    def end(self) -> float:
        """The error at the last time for which there is truth."""
        return float(self.series[~np.isnan(self.series)][-1])

    @property
    def max(self) -> float:
        """The largest error."""
        return float(np.nanmax(self.series))

    @property
    def time(self) -> float:
        """Time (s) of the largest error."""
        return float(self.times[int(np.nanargmax(self.series))])

    @property
    def figures(self) -> Errors:
        """These figures as a part of the document."""
        return Errors(unit=self.unit, end=self.end, max=self.max, time=self.time, body=self.body)


def attitude_angle(R: np.ndarray, S: np.ndarray) -> np.ndarray:
    """Angle (rad, 0 to pi) of the rotation R^T S, for R and S of shape (..., 3, 3).

    It follows from sine and cosine together. An arc cosine alone loses half of the digits of small angles.
    """
    D = np.swapaxes(R, -1, -2) @ S
    twice_sine = np.sqrt((D[..., 2, 1] - D[..., 1, 2]) ** 2 + (D[..., 0, 2] - D[..., 2, 0]) ** 2
                         + (D[..., 1, 0] - D[..., 0, 1]) ** 2)
    return np.asarray(np.arctan2(twice_sine, np.trace(D, axis1=-2, axis2=-1) - 1.0))


def differences(one: Motion, other: Motion) -> dict[str, np.ndarray]:
    """Norm of the difference of two runs, (T, n) per quantity. Raises `ArgumentError` if their output times differ."""
    if one.t.shape != other.t.shape or not np.allclose(one.t, other.t, rtol=0, atol=1e-9 * max(1.0, one.t[-1])):
        raise ArgumentError(f"the runs have different output times ({len(one.t)} up to {one.t[-1]:g} s and "
                            f"{len(other.t)} up to {other.t[-1]:g} s): give both the same samples= and duration=")
    return {
        "position": np.linalg.norm(one.x - other.x, axis=-1),
        "attitude": attitude_angle(one.R, other.R),
        "velocity": np.linalg.norm(one.v - other.v, axis=-1),
        "angular velocity": np.linalg.norm(one.w - other.w, axis=-1),
    }


def errors(scene: Scene, run: Motion, truth: Motion, until: float = np.inf) -> dict[str, Error]:
    """Errors of a run against truth, per quantity, over the samples up to the time `until` (s).

    The error is infinite at times at which the run is not finite, NaN where truth is not.
    """
    keep = up_to(truth.t, until)
    times, unknown = truth.t[keep], np.isnan(truth.x[keep, 0, 0])
    result = {}
    for quantity, values in differences(run, truth).items():
        values = np.where(np.isfinite(values[keep]), values[keep], np.inf)
        values[unknown] = np.nan
        body = int(np.unravel_index(int(np.nanargmax(values)), values.shape)[1])
        result[quantity] = Error(QUANTITIES[quantity], times, values.max(axis=1), scene.bodies[body].name)
    return result


def energy_gap(scene: Scene, run: Motion, truth: Motion | None, maxima: Mapping[str, float],
               work: Callable[[], np.ndarray]) -> float:
    """The largest |E(t) - E(0) - work| of a run, J: of every step, by the `maxima` over them, if nothing does work.

    Otherwise it is that of the samples. If there is truth, the work is that of the true motion, as far as that reaches;
    else that of the run, `work`, and NaN if that is not known.
    """
    energy = mechanics.energy(scene, run)
    if scene.worked_on:
        if truth is None:
            return float(np.abs(energy - energy[0] - work()).max())
        return float(np.nanmax(np.abs(energy - mechanics.energy(scene, truth))))
    kinetic = maxima.get("kinetic_energy", float(mechanics.kinetic_energy(scene, run).max(initial=0.0)) or 1.0)
    return max(float(np.abs(energy - energy[0]).max()), maxima.get("energy_error", 0.0) * kinetic)


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
