"""What happens to joints with friction, limits and servos, and to watched shapes, in successive states of any engine.

An engine does not say when a joint turns or reaches a stop. The states before and after do, to the accuracy of a cubic
through the coordinate and its rate at both.
"""

from __future__ import annotations

import numpy as np

from crosscheck.scene import touching
from crosscheck.scene.coordinates import histories
from crosscheck.scene.laws import Limits, Servo
from crosscheck.scene.model import Scene
from crosscheck.scene.states import Motion

Event = tuple[float, str, str]
"""Time (s), joint or monitor, and what: sticks slips reverses hits_lower hits_upper leaves_lower leaves_upper saturates
unsaturates touches."""

AT_REST = 1e-12
"""Rates below this, rad/s or m/s, are rest; soft friction creeps faster."""


def events(scene: Scene, states: Motion, shapes: bool = True) -> tuple[Event, ...]:
    """The events between the states at their times, in order; t = 0 counts as none. `shapes`: touches are among them.
    """
    if not scene.has_laws and not scene.monitors:
        return ()
    listed: list[Event] = []
    t, coordinates = states.t, histories(scene, states)
    for joint in scene.joints:
        if joint.name not in coordinates:
            continue
        count = len(joint.kind.coordinates)
        position, rate = (values.reshape(len(t), -1) for values in (coordinates[joint.name].position,
                                                                     coordinates[joint.name].velocity))
        for k in range(count if joint.dry_friction or joint.limits else 0):
            q, v = position[:, k], rate[:, k]
            if joint.dry_friction and joint.dry_friction[k] is not None:
                listed += [(when, joint.name, what) for when, what in _friction(t, q, v)]
            limits = joint.limits[k] if joint.limits else None
            if limits is not None:
                listed += [(when, joint.name, what) for when, what in _limits(t, q, v, limits)]
        for name, servo in scene.servos.values():
            if name == joint.name and servo.effort_limit is not None:
                listed += [(when, name, what) for when, what in _saturation(t, position[:, 0], rate[:, 0], servo)]
    if shapes:
        listed += _touches(scene, states)
    return tuple(sorted(listed))


def _friction(t: np.ndarray, q: np.ndarray, v: np.ndarray) -> list[tuple[float, str]]:
    """Turns, and rest where the rate is exactly zero."""
    changes = []
    rest = abs(v) < AT_REST
    for k in np.flatnonzero(rest[1:] != rest[:-1]).tolist():
        when = float(t[k + 1] if rest[k + 1] else t[k])
        if when > 0:
            changes.append((when, "sticks" if rest[k + 1] else "slips"))
    for k in np.flatnonzero((v[:-1] * v[1:] < 0) & ~rest[:-1] & ~rest[1:]).tolist():
        changes.append((_crossing(t, q, v, k, rate=True), "reverses"))
    return changes


def _limits(t: np.ndarray, q: np.ndarray, v: np.ndarray, limits: Limits) -> list[tuple[float, str]]:
    changes = []
    for side, end, gap in (("lower", limits.lower, q - limits.lower), ("upper", limits.upper, limits.upper - q)):
        if not np.isfinite(end):
            continue
        beyond = gap < 0
        for k in np.flatnonzero(beyond[1:] != beyond[:-1]).tolist():
            changes.append((_crossing(t, q - end, v, k), f"{'hits' if beyond[k + 1] else 'leaves'}_{side}"))
    return changes


def _saturation(t: np.ndarray, q: np.ndarray, v: np.ndarray, servo: Servo) -> list[tuple[float, str]]:
    """Where the cut begins and ends; of a sampled servo at its sample times, as far as there are states at them."""
    if servo.period is not None:
        at = servo.samples(t)
        t, q, v = t[at], q[at], v[at]
    free = Servo(servo.target, servo.target_velocity, servo.feedforward, servo.proportional, servo.derivative)
    lower, upper = (np.broadcast_to(bound, t.shape) for bound in servo.bounds(v))
    wanted = free.effort(t, q, v)
    margin = np.minimum(wanted - lower, upper - wanted)  # negative where it is cut
    changes = []
    for k in np.flatnonzero((margin[1:] < 0) != (margin[:-1] < 0)):
        way = margin[k] / (margin[k] - margin[k + 1])
        when = t[k + 1] if servo.period is not None else t[k] + way * (t[k + 1] - t[k])
        changes.append((float(when), "saturates" if margin[k + 1] < 0 else "unsaturates"))
    return changes


def _touches(scene: Scene, states: Motion) -> list[Event]:
    if not any(monitor.joint is None for monitor in scene.monitors) or not touching.available():
        return []
    watched = touching.Touching(scene)
    gaps = np.array([watched.gaps(x, R) for x, R in zip(states.x, states.R, strict=True)])
    listed = []
    for row, index in enumerate(watched.monitors):
        gap = gaps[:, row]
        for k in np.flatnonzero((gap[1:] < 0) & (gap[:-1] >= 0)):
            when = states.t[k] + gap[k] / (gap[k] - gap[k + 1]) * (states.t[k + 1] - states.t[k])
            listed.append((float(when), scene.monitors[index].name, "touches"))
    return listed


def _crossing(t: np.ndarray, q: np.ndarray, v: np.ndarray, k: int, rate: bool = False) -> float:
    """When the cubic through both ends of interval k, or its rate, first crosses zero; it has two signs at them."""
    from scipy.interpolate import CubicHermiteSpline

    cubic = CubicHermiteSpline(t[k:k + 2], q[k:k + 2], v[k:k + 2])
    roots = (cubic.derivative() if rate else cubic).roots(extrapolate=False)
    return float(roots[0] if len(roots) else t[k + 1])
