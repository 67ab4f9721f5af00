"""What a scene would have shown in place of a recording, and by how much the recording differs.

Truth is turned into the recorded quantities, never the recording into states: a subset of columns loses nothing.
States that restart an interval come the other way: the least change of the true state that shows what was recorded.
"""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable, Iterator, Sequence
from typing import Any, cast

import numpy as np
from scipy.interpolate import CubicSpline

from crosscheck.compare.apart import turn
from crosscheck.judge.crossings import Crossed, across
from crosscheck.recordings.reading import Group, Recording
from crosscheck.scene import mechanics
from crosscheck.scene.alterations import FAILS
from crosscheck.scene.batch import TURN, integrate
from crosscheck.scene.constraints import Constraints
from crosscheck.scene.coordinates import hinge_angles, histories
from crosscheck.scene.model import Scene
from crosscheck.scene.monitor import level_norms
from crosscheck.scene.sensors import readings
from crosscheck.scene.starts import anchor_length
from crosscheck.scene.states import Motion, States
from crosscheck.scene.vectors import cross, exponential

CHUNK = 50_000
"""Instants of truth that are in memory at a time."""

MOST_INTERVALS, MOST_OF_LAWS = 2000, 500
"""Intervals whose defects are measured; of a longer recording, so many over its whole length. In scenes with friction,
stops or servos, which remember the interval before, they follow each other, and are longer."""

MOST_FIGURES = 20_000
"""Rows of which energy, momentum and levels are computed."""

FIRST = 5
"""Rows from which a recorded start is read."""

STEP = 1e-6
"""Of central differences of recorded quantities by states (rad, m)."""

UNITS = {"position": "m", "attitude": "rad", "velocity": "m/s", "angular_velocity": "rad/s"}
POSES = ("position", "attitude", "joint_position")
RATES = ("velocity", "angular_velocity", "joint_velocity")


class Outputs:
    """The recorded quantities as another motion of the scene shows them."""

    def __init__(self, scene: Scene, groups: Sequence[Group]) -> None:
        self.scene, self.groups = scene, groups
        self.body = {body.name: k for k, body in enumerate(scene.bodies)}

    def of(self, states: Motion) -> list[np.ndarray]:
        """The values of every group, in its shape."""
        joints = histories(self.scene, states) if any(g.key.startswith("joint_") for g in self.groups) else {}
        return [self._one(group, states, joints) for group in self.groups]

    def _one(self, group: Group, states: Motion, joints: Any) -> np.ndarray:
        if group.key.startswith("joint_"):
            history = joints[group.owner]
            values = history.position if group.key == "joint_position" else history.velocity
            return np.asarray(values.reshape(len(states.t), -1)[:, list(group.parts)])
        if group.key == "energy":
            return mechanics.energy(self.scene, states)[:, None]
        if group.key not in UNITS:
            given = readings(self.scene, cast(States, states))[group.owner]
            return np.asarray(given.reshape(len(states.t), -1)[:, list(group.parts)])
        k = self.body[group.owner]
        R = states.R[:, k]
        if group.key == "attitude":
            return R
        values = {"position": states.x, "velocity": states.v, "angular_velocity": states.w}[group.key][:, k]
        if group.point is not None and group.key == "position":
            values = values + R @ group.point
        if group.point is not None and group.key == "velocity":
            values = values + np.einsum("tij,tj->ti", R, cross(states.w[:, k], np.array(group.point)))
        if group.frame and (group.frame == "body") != (group.key == "angular_velocity"):
            values = np.einsum("tij,tj->ti" if group.key == "angular_velocity" else "tji,tj->ti", R, values)
        return np.asarray(values[:, list(group.parts)])


def gaps(group: Group, recorded: np.ndarray, true: np.ndarray, modulo: bool = False) -> np.ndarray:
    """Recorded minus true, (T, k); of attitudes the rotation vector between them. `modulo`: angles up to full turns.
    """
    if group.key == "attitude":
        return turn(true, recorded)
    if len(group.parts) == 4:  # a quaternion and its negative are the same attitude
        same = np.einsum("tk,tk->t", recorded, true)
        return np.asarray(recorded * np.where(same < 0, -1.0, 1.0)[:, None] - true)
    difference = recorded - true
    if group.angle and (group.wrap or modulo):
        difference = difference - 2 * np.pi * np.round(difference / (2 * np.pi))
    return np.asarray(difference)


def norms(gap: np.ndarray) -> np.ndarray:
    """(T,)"""
    return np.asarray(np.linalg.norm(gap, axis=1))


@dataclasses.dataclass
class Differences:
    """A recording beside truth: per group the difference at every sample, NaN where it has none, and what its digits
    leave open."""

    outputs: Outputs
    recording: Recording
    truth: Any
    t: np.ndarray  # (T,) s of truth
    values: list[np.ndarray]  # of truth
    gap: list[np.ndarray]
    floor: list[np.ndarray]  # (T,)

    @functools.cached_property
    def sizes(self) -> list[np.ndarray]:
        """(T,) per group."""
        return [norms(gap) for gap in self.gap]

    @property
    def errors(self) -> dict[str, float]:
        """The largest difference per quantity."""
        return {key: max(float(np.nanmax(sizes)) for group, sizes in zip(self.recording.groups, self.sizes, strict=True)
                         if group.key == key) for key in self.recording.keys}

    def worst(self, key: str) -> tuple[int, int]:
        """(group, row) of the largest difference beyond the floor of one quantity."""
        beyond = {k: self.sizes[k] - self.floor[k] for k, group in enumerate(self.recording.groups) if group.key == key}
        which = max(beyond, key=lambda k: float(np.nanmax(beyond[k])))
        return which, int(np.nanargmax(beyond[which]))


def values_by(scene: Scene, groups: Sequence[Group], t: np.ndarray, move: Callable[[np.ndarray], Motion]
          ) -> list[np.ndarray] | None:
    """The values of groups at times t by a motion of the scene, of which `move` gives the states at times from 0 on;
    None where that fails."""
    try:
        states = move(np.unique(np.concatenate([[0.0], t])))
    except FAILS:
        return None
    return [value[-len(t):] for value in Outputs(scene, groups).of(states)] if len(states.t) >= len(t) else None


def part_of(recording: Recording, index: Any) -> Recording:
    """Some rows of a recording."""
    groups = [dataclasses.replace(group, values=group.values[index], floor=group.floor[index])
              for group in recording.groups]
    return dataclasses.replace(recording, t=recording.t[index], groups=groups)


def first_rows(recording: Recording) -> Recording | None:
    """The first rows that have all quantities; where topics come at different times, between the rows of each."""
    rows = np.flatnonzero(recording.complete)
    if len(rows):
        return part_of(recording, rows[:FIRST])
    known = [np.flatnonzero(np.isfinite(g.values.reshape(len(recording.t), -1)).all(axis=1)) for g in recording.groups]
    least = min(known, key=len)
    t = recording.t[least]
    t = t[(t >= max(recording.t[each[0]] for each in known)) & (t <= min(recording.t[each[-1]] for each in known))]
    if not len(t) or len(least) < 4:
        return None
    groups = []
    for group, rows in zip(recording.groups, known, strict=True):
        values = CubicSpline(recording.t[rows], group.values[rows])(t[:FIRST])
        if group.key == "attitude":
            U, _, Vt = np.linalg.svd(values)
            values = U @ Vt
        groups.append(dataclasses.replace(group, values=values, floor=np.full(len(values), group.floor[rows].max())))
    return dataclasses.replace(recording, t=t[:FIRST], groups=groups)


def compare(scene: Scene, recording: Recording, truth: Any, since: float = 0.0) -> Differences:
    """The differences from a truth whose time zero is `since` (s) of the recording."""
    outputs = Outputs(scene, recording.groups)
    t = recording.t - since
    pieces = [outputs.of(truth.at(t[begin:begin + CHUNK])) for begin in range(0, len(t), CHUNK)]
    joined = [np.concatenate(parts) for parts in zip(*pieces, strict=True)]
    gap = [gaps(group, group.values, value) for group, value in zip(recording.groups, joined, strict=True)]
    floor = [group.floor + truth.error + recording.blur * _speed(group, value, t)
             for group, value in zip(recording.groups, joined, strict=True)]
    for k, (pose, opens) in differenced(recording).items():
        if norms(gap[pose]).max() < opens * float(np.median(np.diff(t))):  # and not those of a method of order one
            floor[k] = floor[k] + opens
    return Differences(outputs, recording, truth, t, joined, gap, floor)


def rated(recording: Recording) -> Iterator[tuple[int, int]]:
    """The numbers of the groups of poses, and of all their rates in the same parts and the usual axes."""
    places = {(group.key, group.owner): k for k, group in enumerate(recording.groups)}
    for (key, owner), k in places.items():
        other = places.get((RATES[POSES.index(key)], owner)) if key in POSES else None
        if other is not None:
            pose, rate = recording.groups[k], recording.groups[other]
            alike = len(rate.parts) == 3 if key == "attitude" else pose.parts == rate.parts
            if alike and not pose.frame and not rate.frame:
                yield k, other


def differenced(recording: Recording) -> dict[int, tuple[int, float]]:
    """Recorded rates that are differences of the positions beside them: by group, that of the positions, and the error.

    A difference over one row is the rate half a row away, one over two rows the rate but for its curvature.
    """
    made: dict[int, tuple[int, float]] = {}
    t = recording.t
    for k, rate in rated(recording):
        q, v = recording.groups[k], recording.groups[rate]
        if len(t) < 5 or q.key == "attitude" or q.point != v.point or not (
                np.isfinite(q.values).all() and np.isfinite(v.values).all()):
            continue
        moved, change = np.diff(q.values, axis=0) / np.diff(t)[:, None], np.abs(np.diff(v.values, axis=0)).max(axis=1)
        digits = 4 * (q.floor.max() / np.diff(t).min() + v.floor.max()) + 1e-12 * np.abs(v.values).max()
        central = (q.values[2:] - q.values[:-2]) / (t[2:] - t[:-2])[:, None]
        for rows, values, opens in ((slice(1, None), moved, change.max()), (slice(None, -1), moved, change.max()),
                                    (slice(1, -1), central, np.abs(np.diff(v.values, 2, axis=0)).max())):
            if np.abs(v.values[rows] - values).max() <= digits < 0.1 * opens:
                made[rate] = k, float(opens)
                break
    return made


def _speed(group: Group, values: np.ndarray, t: np.ndarray) -> np.ndarray:
    """The rate of change of values, (T,)."""
    if len(t) < 2:
        return np.zeros(len(t))
    rates = np.gradient(values.reshape(len(t), -1), t, axis=0)
    return np.asarray(np.linalg.norm(rates, axis=1) / (np.sqrt(2.0) if group.key == "attitude" else 1.0))


def _step(outputs: Outputs, states: States, what: str, off: np.ndarray, width: float) -> tuple[np.ndarray, np.ndarray]:
    """(least change (T, 6 n) after which all groups show what is recorded and joints are closed, slopes of all).

    `what`: "pose" or "rate"; `off` (T, m) is what the joints lack, `width` that of difference quotients.
    """
    count, size, groups = len(states.t), 6 * outputs.scene.n, outputs.groups

    def apart(one: Sequence[np.ndarray], other: Sequence[np.ndarray]) -> np.ndarray:
        parts = [gaps(g, a, b, True) for g, a, b in zip(groups, one, other, strict=True)]
        return np.concatenate([np.zeros((count, 0)), *parts], axis=1)

    columns = []
    for unit in np.eye(size) * width:
        ahead, behind = (outputs.of(moved(states, what, np.tile(sign * unit, (count, 1)).reshape(count, -1, 6)))
                         for sign in (1, -1))
        columns.append(apart(ahead, behind) / (2 * width))
    G = Constraints(outputs.scene).jacobian(states.x, states.R)
    A = np.concatenate([np.stack(columns, axis=2), G], axis=1)
    left = apart([g.values for g in groups], outputs.of(states))
    return (np.linalg.pinv(A, rcond=1e-7) @ np.concatenate([left, -off], axis=1)[..., None])[..., 0], A


def restored(scene: Scene, recording: Recording, base: Motion) -> States | None:
    """The states that show what was recorded and satisfy the joints, next to `base`; None if they are not determined.

    Hinges have the turns that were recorded, or those of `base` where no angle was. Velocities that are not recorded
    are those of `base` plus the rate at which the poses leave it.
    """
    constraints = Constraints(scene)
    poses, rates = ([g for g in recording.groups if g.key in keys] for keys in (POSES, RATES))
    shown, states = Outputs(scene, poses), States(base.t, base.x, base.R, base.v, base.w,
                                                hinges=_turned(scene, recording, base))
    total = np.zeros((len(base.t), 6 * scene.n))
    for _ in range(5):
        change, A = _step(shown, states, "pose",
                          constraints.position(states.x, states.R, states.t), STEP)
        if not poses or np.linalg.matrix_rank(A[0], tol=1e-6) < total.shape[1]:
            return None
        states, total = moved(states, "pose", change.reshape(-1, scene.n, 6)), total + change
        if np.abs(change).max(initial=0.0) < 1e-12:
            break
    u = np.concatenate([base.v, base.w], axis=2).reshape(total.shape)
    if not rates and len(total) > 3:
        u = u + CubicSpline(base.t, total).derivative()(base.t)
    both = u.reshape(len(total), -1, 6)
    now = dataclasses.replace(states, v=both[..., :3], w=both[..., 3:])
    change, _ = _step(Outputs(scene, rates), now, "rate", constraints.velocity(now.x, now.R, now.v, now.w, now.t), 1.0)
    return moved(now, "rate", change.reshape(both.shape))


def moved(at: States, what: str, change: np.ndarray) -> States:
    """The states with all poses, or rates, changed, (T, n, 6)."""
    if what == "pose":
        return dataclasses.replace(at, x=at.x + change[..., :3], R=at.R @ exponential(change[..., 3:]))
    return dataclasses.replace(at, v=at.v + change[..., :3], w=at.w + change[..., 3:])


def _turned(scene: Scene, recording: Recording, base: Motion) -> np.ndarray:
    """(T, h) rad: the angles of hinges that were recorded, those of `base` where none was or full turns were left out.
    """
    angles = hinge_angles(scene, base).copy()
    for group in recording.groups:
        if group.key == "joint_position" and group.angle and not group.wrap:
            for column, part in enumerate(group.parts):
                if (group.owner, part) in scene.hinges:
                    angles[:, scene.hinges.index((group.owner, part))] = group.values[:, column]
    return angles


@dataclasses.dataclass
class Defect:
    """What a quantity misses in every interval, started from the recorded state."""

    sizes: np.ndarray  # (I,)
    floor: np.ndarray  # (I,) what printed digits leave open
    step: float  # the largest change of the quantity over one interval


def intervals(scene: Scene, diff: Differences, since: float) -> tuple[np.ndarray, dict[str, Defect]] | None:
    """(times at which intervals begin, defects by quantity); None where the recording does not determine the state."""
    groups = [k for k, group in enumerate(diff.recording.groups) if group.key in POSES + RATES]
    recording = dataclasses.replace(diff.recording, groups=[diff.recording.groups[k] for k in groups])
    if not groups:
        return None
    rows, laws = np.flatnonzero(recording.complete), scene.has_laws
    sampled = any(servo.period is not None for _, servo in scene.servos.values())
    if len(rows) < 4 or (sampled and diff.t[0] > 0.0):  # what such a servo holds is known from the start only
        return None
    if laws:  # the memory of laws goes from one interval to the next
        rows = rows[np.unique(np.linspace(0, len(rows) - 1, MOST_OF_LAWS + 1).astype(int))]
    elif len(rows) > MOST_INTERVALS + 1:  # pieces of neighbours, evenly over the recording
        firsts = np.linspace(0, len(rows) - 9, MOST_INTERVALS // 8).astype(int)
        rows = rows[np.unique((firsts[:, None] + np.arange(9)).ravel())]
    piece = part_of(recording, rows)
    states = restored(scene, piece, diff.truth.at(piece.t - since))
    if states is None:
        return None
    keep = np.flatnonzero(np.ones(len(rows) - 1) if laws else np.diff(rows) == 1)
    tau = np.diff(states.t)[keep]
    rate = max(float(np.linalg.norm(states.w, axis=-1).max(initial=0.0)), 1.0)
    floors = [np.maximum(each[rows][keep], each[rows][keep + 1]) for each in (diff.floor[k] for k in groups)]
    known = any(group.key in RATES for group in recording.groups)
    noise = np.max([each if group.key in RATES else each * (rate if known else 1.0) / (1.0 if known else tau)
                    for group, each in zip(recording.groups, floors, strict=True)], axis=0)
    pose = np.max([each for group, each in zip(recording.groups, floors, strict=True) if group.key in POSES], axis=0)
    begin, grown = states.at(keep), np.zeros((2, len(keep)))
    if laws:
        crossed = Crossed(scene, states, keep, anchor_length(scene))
        after = crossed.end
        for k, interval in enumerate(crossed.intervals):
            grown[:, k] = across(interval.events, pose[k], noise[k], tau[k], interval.acceleration)
    else:
        with np.errstate(over="ignore", invalid="ignore"):
            after = integrate(scene, begin, tau, int(min(200, max(2, np.ceil(rate * tau.max() / TURN)))))[0]
    defects: dict[str, Defect] = {}
    for group, value, floor in zip(piece.groups, Outputs(scene, recording.groups).of(after), floors, strict=True):
        gap = norms(gaps(group, group.values[keep + 1], value, True))
        change = norms(gaps(group, group.values[keep + 1], group.values[keep], True))
        is_rate = group.key in RATES
        allowed = 2 * floor + 4 * (grown[int(is_rate)] + noise * (
            1.0 if is_rate else np.maximum(tau, 1 / rate if known else 0.0)))
        other = defects.get(group.key, Defect(gap, allowed, 0.0))
        defects[group.key] = Defect(np.maximum(other.sizes, gap), np.maximum(other.floor, allowed),
                                    max(other.step, float(change.max())))
    return piece.t[keep], defects


def invariants(scene: Scene, recording: Recording, truth: Any, since: float) -> dict[str, float] | None:
    """Largest errors of energy, over the largest kinetic energy, and of the momentum about the vertical, and levels.

    None if the states of all bodies are not recorded.
    """
    rows = np.flatnonzero(recording.complete)
    if not len(rows):
        return None
    piece = part_of(recording, rows[np.unique(np.linspace(0, len(rows) - 1, MOST_FIGURES).astype(int))])
    by, parts = {(group.key, group.owner): group for group in piece.groups}, []
    for key in UNITS:
        groups = [by.get((key, body.name)) for body in scene.bodies]
        if any(g is None or (key != "attitude" and len(g.parts) < 3) or g.frame or g.point is not None for g in groups):
            return None
        parts.append(np.stack([g.values for g in groups if g is not None], axis=1))
    exact = truth.at(piece.t - since)
    states = States(exact.t, *parts, hinges=_turned(scene, piece, exact))
    kinetic = float(mechanics.kinetic_energy(scene, exact).max()) or 1.0
    levels = level_norms(Constraints(scene), states.x, states.R, states.v, states.w, None, None, states.t)
    return {"energy": float(np.abs(mechanics.energy(scene, states) - mechanics.energy(scene, exact)).max()) / kinetic,
            "momentum": float(np.abs(mechanics.momentum_vertical(scene, states)
                                     - mechanics.momentum_vertical(scene, exact)).max())} | {
        name.replace("constraint_", "level "): float(np.max(series)) for name, series in levels.items()
        if isinstance(series, np.ndarray) and scene.joints}
