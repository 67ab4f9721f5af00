"""Whole-run judgement: every sample interval of a run against the true flow from the run's own state at its beginning.

The index-1 equations are integrated over all sample intervals at once, each from the state that the run has there, and
compared with the state that it has at the end. What the run did before does not count, so that an error which begins
at any time meets the bound of one interval, also past the horizon of a chaotic scene.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from crosscheck.document import QUANTITIES, Finding, Scales
from crosscheck.judge import tolerances
from crosscheck.judge.metrics import differences
from crosscheck.references.base import Reference
from crosscheck.references.rates import fastest
from crosscheck.scene import mechanics
from crosscheck.scene.model import Scene
from crosscheck.scene.states import States

MOST_BODIES = 16
"""The equations are solved by dense algebra, whose cost is cubic in the bodies."""

TURN = 0.1
"""rad that the fastest motion makes in one step of the integration, which is of order 8: an error below 1e-12."""

DOUBT = 1e-12
"""Of that integration, and of conversions of an engine's coordinates, in units of the quantity."""

NORMS = 16.0
"""Codes measure the error that they keep below a tolerance in norms of their own, which differ by so much: seulex keeps
positions to it, and its velocities miss it by ten."""

STEEPEST = 3.0
"""Largest exponent of the growth of an error within an interval for which its bound still says something."""

UNKNOWN = 2.0
"""Past the horizon another motion of the same energy is judged, whose rates may be so many times those of truth."""


def judge_defects(scene: Scene, traj: Any, truth: Reference, order: int | None, step: float | None,
                  rtol: float | None) -> list[Finding]:
    """One finding per quantity: the interval farthest beyond, or nearest to, its bound.

    Bound of an interval tau, as that of the run in `crosscheck.judge.tolerances`: exp(W tau) tau h^p max |y^(p+1)|
    times the unit of the quantity; where the run misses constraints, what leaving or closing them moves, up to what
    the bounds of states allow.
    """
    scale = tolerances.scales(scene, truth)
    tau = float(traj.t[1] - traj.t[0])
    growth = max(scale.rate, fastest(scene)) * tau
    if scene.n > MOST_BODIES or growth > STEEPEST or not np.isfinite(traj.x).all():
        why = ("the equations of so many bodies are not integrated again" if scene.n > MOST_BODIES else
               "the motion is too fast for the output times" if growth > STEEPEST else "the run is not finite")
        return [Finding(f"interval {name}", "unjudged", None, None, unit, why) for name, unit in QUANTITIES.items()]
    try:
        with np.errstate(over="ignore", invalid="ignore"):
            end = flow(scene, traj, max(2, math.ceil(growth / TURN)))
    except np.linalg.LinAlgError:
        return [Finding(f"interval {name}", "fail", math.inf, None, unit, "the equations of motion have no solution "
                        "along the true motion from the run's own states") for name, unit in QUANTITIES.items()]
    found = differences(States(traj.t[1:], traj.x[1:], traj.R[1:], traj.v[1:], traj.w[1:]), end)
    local = _local(truth, scale, tau, growth, order, step, rtol, traj.steps / max(1, len(traj.t) - 1))
    slack = _slack(scene, traj, scale, tau)
    findings = []
    for name, unit in QUANTITIES.items():
        values = np.where(np.isfinite(found[name]), found[name], np.inf).max(axis=1)
        size = scale.of(name)
        least = DOUBT + 4 * tolerances.grading(scene) * tolerances.EPS
        floor = least * max(size, scale.units[name]) * math.exp(growth)
        bounds = local * scale.units[name] + slack[name] + floor * max(1.0, traj.steps / len(values)) ** 0.6
        worst = int(np.argmax(values / bounds))
        findings.append(Finding(
            f"interval {name}", "ok" if values[worst] <= bounds[worst] else "fail", float(values[worst]),
            float(bounds[worst]), unit, "the true motion from the run's own state over one sample interval of "
            f"{tau:.3g} s: {_said(order, step, rtol)}, and what open constraints move",
            f"between t = {traj.t[worst]:.4g} and {traj.t[worst + 1]:.4g} s"))
    return findings


def _said(order: int | None, step: float | None, rtol: float | None) -> str:
    return f"A tau h^{order} max|y^({(order or 0) + 1})| with h = {step:.3g} s" if order is not None and step else (
        f"{NORMS:g} A n rtol with rtol = {rtol:.1e}")


def _local(truth: Reference, scale: Scales, tau: float, growth: float, order: int | None, step: float | None,
           rtol: float | None, steps: float) -> np.ndarray:
    """Bound of the error of the state y in each interval, (T - 1,)."""
    later = truth.t[1:] > truth.horizon * (1 + 1e-12)
    if order is not None and step is not None:
        most = min(order + 1, len(truth.position_derivatives) - 2)
        largest = tolerances.derivative(truth, most, scale)
        bound = math.exp(growth) * tau * step**order * largest
        return np.where(later, UNKNOWN ** (order + 1), 1.0) * bound
    bound = NORMS * math.exp(growth) * (steps + 1.0) * (rtol or 0.0)
    return np.full(len(later), bound)


def _slack(scene: Scene, traj: Any, scale: Scales, tau: float) -> dict[str, np.ndarray]:
    """What leaving or closing open constraints may move in each interval, per quantity.

    An interval's own openings count only up to `SHARE` of the scene: a joint that comes apart explains nothing.
    """
    def both(series: np.ndarray, most: float) -> np.ndarray:
        return np.asarray(np.minimum(np.maximum(series[1:], series[:-1]), most))

    x = both(traj.constraint_position, SHARE * scale.length)
    v = both(traj.constraint_velocity, SHARE * scale.length * scale.rate)
    moved, rate = 2 * x + tau * v, 2 * v + 2 * scale.rate * x
    return {"position": moved, "attitude": moved / scale.length, "velocity": rate,
            "angular velocity": rate / scale.length}


SHARE = 1e-3
"""Openings of constraints up to this share of the scene's size are errors of a method; larger ones are open joints."""


def flow(scene: Scene, traj: Any, count: int) -> States:
    """The states at t[1:] that the index-1 equations give from those at t[:-1], all intervals at once.

    Dormand and Prince's method of order 8 in `count` steps; attitudes as matrices, whose rows it leaves orthogonal as
    far as it is exact. Source: E. Hairer, S. P. Norsett, G. Wanner, Solving Ordinary Differential Equations I, II.5.
    """
    from scipy.integrate import DOP853

    A, B, C, stages = DOP853.A, DOP853.B, DOP853.C, DOP853.n_stages
    t, h = traj.t[:-1], (traj.t[1:] - traj.t[:-1]) / count
    state = [np.array(part[:-1]) for part in (traj.x, traj.R, traj.v, traj.w)]

    def shifted(weights: np.ndarray, rates: list[list[np.ndarray]]) -> list[np.ndarray]:
        moved = []
        for index, part in enumerate(state):
            shape = (-1,) + (1,) * (part.ndim - 1)
            total = sum((weight * rate[index] for weight, rate in zip(weights, rates, strict=True) if weight),
                        np.zeros_like(part))
            moved.append(part + h.reshape(shape) * total)
        return moved

    for turn in range(count):
        rates: list[list[np.ndarray]] = []
        for stage in range(stages):
            here = shifted(A[stage, :stage], rates) if stage else state
            rates.append(_rates(scene, t + (turn + C[stage]) * h, *here))
        state = shifted(B, rates)
    return States(traj.t[1:], *state)


def _rates(scene: Scene, t: np.ndarray, x: np.ndarray, R: np.ndarray, v: np.ndarray, w: np.ndarray
           ) -> list[np.ndarray]:
    a, alpha, _ = mechanics.index1(scene, x, R, v, w, mechanics.torsion_angles(scene, R, w, t), t)
    hat = np.zeros_like(R)
    hat[..., 0, 1], hat[..., 0, 2], hat[..., 1, 2] = -w[..., 2], w[..., 1], -w[..., 0]
    return [v, R @ (hat - np.swapaxes(hat, -1, -2)), a, alpha]
