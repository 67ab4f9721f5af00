"""Why a recording differs from truth, as far as one recording can tell.

A hypothesis turns the true motion into what the recording would then show; its magnitudes are fitted. It is named if
it leaves less than a tenth of every difference, and if no other one of equal simplicity does as well.
"""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Callable, Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np

from crosscheck.adapters.lieeuler import motion
from crosscheck.diagnosis.altered import predict
from crosscheck.diagnosis.fit import gauss_newton
from crosscheck.diagnosis.misreadings import CONJUGATE, FRAME, ORDER, placed, rolled
from crosscheck.diagnosis.of_laws import alternatives
from crosscheck.diagnosis.of_output import jumping
from crosscheck.diagnosis.of_sensors import filtered, mistakes
from crosscheck.diagnosis.variants import close
from crosscheck.errors import ArgumentError
from crosscheck.recordings.comparing import (
    POSES,
    RATES,
    Differences,
    Outputs,
    gaps,
    norms,
    part_of,
    restored,
    values_by,
)
from crosscheck.recordings.reading import Recording
from crosscheck.references.maximal import fastest
from crosscheck.scene.alterations import FAILS, Alteration, alterations
from crosscheck.scene.altered import Model, levers, of_scene
from crosscheck.scene.batch import integrate
from crosscheck.scene.constraints import Constraints
from crosscheck.scene.coordinates import histories
from crosscheck.scene.model import Scene
from crosscheck.scene.sensors import Reader, read
from crosscheck.scene.starts import started
from crosscheck.scene.touching import Touching
from crosscheck.scene.vectors import exponential

LEFT = (0.1, 0.05, 0.005)
"""Largest part of a difference that a named cause may leave, by the number of its fitted magnitudes (two and more): the
more of them, the closer a wrong one comes."""

BESIDE, MORE = 2.0, 0.003
"""Another hypothesis does as well if it leaves no more than this multiple, plus this part, of what the best leaves."""

CERTAIN = 0.02
"""Part of the difference that a hypothesis without a magnitude may leave for other motions not to be tried."""

ROWS, NEIGHBOURS = 160, 2000
"""Rows over the whole recording in which motions are compared, and rows in a row in which neighbours are."""

HOPELESS = 0.6
"""Part of the difference in the first rows that a hypothesis may leave there and still be fitted to all."""

TURN = 0.15
"""Turn (rad) of the fastest motion in one step of an altered one: with order 8 its error is some 1e-9. The step is
fixed, so that nonsensical magnitudes cost no more."""

FACTORS = {180 / np.pi: "degrees for radians", np.pi / 180: "radians for degrees", 1e3: "milli for whole units",
           1e-3: "whole for milli units", 100.0: "hundredths", 0.01: "hundreds", 9.80665: "m/s^2 for g",
           1 / 9.80665: "g for m/s^2", 60 / (2 * np.pi): "rpm for rad/s", 1 / (2 * np.pi): "turns for radians",
           1 / 0.3048: "feet for metres", 1 / 0.0254: "inches for metres"}
"""Factors between recorded and true values that are units, as what the values are."""

Values = list[np.ndarray]


class Cause(NamedTuple):
    """What explains a difference."""

    name: str
    said: str
    left: float  # part of the difference that it leaves
    free: int = 0  # number of fitted magnitudes and of separate mistakes

    def __str__(self) -> str:
        return f"{self.name}: {self.said}"


class Case:
    """Some rows of a recording beside truth, and how much of their difference a hypothesis leaves."""

    def __init__(self, scene: Scene, diff: Differences, rows: np.ndarray) -> None:
        self.scene, self.truth = scene, diff.truth
        self.values = [value[rows] for value in diff.values]
        self.known = [np.isfinite(size[rows]) for size in diff.sizes]
        piece = part_of(diff.recording, rows)  # a missing value is taken for the true one: it tells nothing
        self.recording = dataclasses.replace(piece, groups=[
            dataclasses.replace(group, values=np.where(known.reshape(-1, *(1,) * (true.ndim - 1)), group.values, true))
            for group, known, true in zip(piece.groups, self.known, self.values, strict=True)])
        self.groups, self.t = self.recording.groups, diff.t[rows]
        self.outputs = Outputs(scene, self.groups)
        self.floor = [float(floor[rows].max()) for floor in diff.floor]
        self.before = [np.nan_to_num(norms(gap[rows])) for gap in diff.gap]
        moved: dict[tuple[str, str], float] = {}  # of a quantity, since a joint that rests has no size of its own
        for group, value, floor in zip(self.groups, self.values, self.floor, strict=True):
            kind = group.key, group.unit
            moved[kind] = max(moved.get(kind, 1e-300), float(np.ptp(value, axis=0).max()), floor)
        self.size = [moved[group.key, group.unit] for group in self.groups]
        self.states = self.truth.at(self.t)
        self.step = TURN / max(float(np.linalg.norm(self.states.w, axis=-1).max()), fastest(scene), 1.0)
        worst = max(float(b.max()) / s for b, s in zip(self.before, self.size, strict=True))
        self.scale = [max(float(b.max()), 0.1 * worst * s, 3 * f) for b, s, f in
                      zip(self.before, self.size, self.floor, strict=True)]

    def whole(self, values: Values, begin: Values) -> Values:
        """Values whose angles begin within half a turn of the true ones, as `begin` does."""
        return [v + 2 * np.pi * np.round((true[0] - b[0]) / (2 * np.pi)) if g.angle else v
                for g, v, b, true in zip(self.groups, values, begin, self.values, strict=True)]

    def at_times(self, times: np.ndarray) -> Values:
        """True values at any times, in any order; after the horizon of truth its last ones."""
        grid, places = np.unique(np.maximum(times, 0.0), return_inverse=True)
        self.truth.at(grid[-1:])  # prolonged, so that its horizon is known
        values = [value[places] for value in self.outputs.of(self.truth.at(np.minimum(grid, self.truth.horizon)))]
        return self.whole(values, self.outputs.of(self.truth.at(self.t[:1])))

    def flat(self, values: Values) -> np.ndarray:
        """All values side by side, over their sizes, (T, k)."""
        return np.concatenate([v.reshape(len(v), -1) / s for v, s in zip(values, self.size, strict=True)], axis=1)

    def shaped(self, flat: np.ndarray) -> Values:
        """The values of `flat`; what was averaged are no rotations, and the nearest ones are taken."""
        parts = np.split(flat, np.cumsum([value[0].size for value in self.values])[:-1], axis=1)
        values = [part.reshape(v.shape) * s for part, v, s in zip(parts, self.values, self.size, strict=True)]
        svd = [np.linalg.svd(value) if value.ndim > 2 else None for value in values]
        return [value if usv is None else np.asarray(usv[0] @ usv[2]) for value, usv in zip(values, svd, strict=True)]

    def residual(self, values: Values, rows: slice = slice(None)) -> np.ndarray:
        """All differences over their scales, in one vector."""
        parts = [(gaps(g, g.values[rows], v[rows], True)[known[rows]] / s).ravel() for g, v, s, known in
                 zip(self.groups, values, self.scale, self.known, strict=True)]
        z = np.concatenate(parts)
        return np.asarray(np.where(np.isfinite(z), np.clip(z, -1e6, 1e6), 1e6))

    def left(self, values: Values) -> float:
        """The largest part of a difference that remains, beyond what printed digits leave."""
        most = 0.0
        for g, v, scale, floor, before, known in zip(self.groups, values, self.scale, self.floor, self.before,
                                                     self.known, strict=True):
            after = np.where(known, norms(gaps(g, g.values, v)), 0.0)
            if not np.isfinite(after).all():
                return np.inf
            most = max(most, max(0.0, float(after.max()) - 2 * floor) / scale,
                       2 * max(0.0, float(after[0]) - 2 * floor - 0.1 * float(before[0])) / scale)
        return most

    def cause(self, name: str, said: str, changed: Values | dict[int, np.ndarray], free: int = 0) -> Cause:
        """A cause that shows these values; a dict changes some of the true ones."""
        values = changed if isinstance(changed, list) else [changed.get(k, v) for k, v in enumerate(self.values)]
        return Cause(name, said, self.left(values), free)


def find(scene: Scene, diff: Differences, until: float, jumps: bool) -> tuple[list[Cause], list[Cause]]:
    """(causes that explain and are equally simple, all others from the best on); `jumps`: as no model of it makes."""
    judged = _unhindered(scene, diff, np.flatnonzero(diff.recording.t <= until))
    near = Case(scene, diff, judged[:NEIGHBOURS])
    far = Case(scene, diff, judged[np.unique(np.linspace(0, len(judged) - 1, ROWS).astype(int))])
    every = [*_reports(far), *_times(near, far), *_samples(near), *_euler(near)]
    certain = any(cause.left <= CERTAIN and not cause.free for cause in every)  # nothing is simpler than no magnitude
    if not certain and not jumps:
        with np.errstate(all="ignore"):
            every += [*_started(far), *_models(far, False)]
            if min(cause.left for cause in every) > LEFT[2]:
                every += _models(far, True)
    every = sorted(every, key=lambda cause: cause.left)
    fit = [cause for cause in every if cause.left <= LEFT[min(cause.free, 2)]]
    if not fit:
        return [], every
    fit = [cause for cause in fit if cause.left <= BESIDE * fit[0].left + MORE]
    simplest = min(cause.free for cause in fit)
    named = {cause.name: cause for cause in reversed(fit) if cause.free == simplest}
    return sorted(named.values(), key=lambda cause: cause.left), every


def _unhindered(scene: Scene, diff: Differences, rows: np.ndarray) -> np.ndarray:
    """The rows before the recorded motion itself touches or leaves a range, after which more acts than the scene has.

    That is sought in `ROWS` rows, where the recording determines the poses.
    """
    complete = rows[diff.recording.complete[rows]]
    if not scene.monitors or len(complete) < 2:
        return rows
    looked = complete[np.unique(np.linspace(0, len(complete) - 1, ROWS).astype(int))]
    states = restored(scene, part_of(diff.recording, looked), diff.truth.at(diff.t[looked]))
    if states is None:
        return rows
    joints = histories(scene, states)
    room = [np.minimum(q - each.lower, each.upper - q) for each in scene.monitors if each.type == "range" and each.joint
            for q in (joints[each.joint].position,)]
    if any(each.joint is None for each in scene.monitors):
        touching = Touching(scene)
        room.append(np.array([touching.gaps(*pose).min() for pose in zip(states.x, states.R, strict=True)]))
    acts = np.flatnonzero(np.min(room, axis=0) <= 0.0) if room else np.zeros(0, int)
    return rows[rows < looked[acts[0]]] if len(acts) and acts[0] > 1 else rows


# --- what is reported -------------------------------------------------------------------------------------------------


@dataclasses.dataclass(frozen=True)
class Lot:
    """A group at T times: recorded and true values, and the true motion of its body, which joints and sensors lack."""

    given: np.ndarray  # (T, k), or (T, 3, 3)
    true: np.ndarray
    R: Any = None  # (T, 3, 3)
    carried: Any = None  # (T, 3) angular velocity of the parent, in body axes
    arm: Any = None  # (3,) from the centre of mass to the joint that carries the body, body axes


def _out(R: np.ndarray, vectors: np.ndarray) -> np.ndarray:
    return np.asarray(R @ vectors[..., None])[..., 0]


def _back(R: np.ndarray, vectors: np.ndarray) -> np.ndarray:
    return _out(np.swapaxes(R, -1, -2), vectors)


def _axes(m: Lot) -> np.ndarray:
    U, _, Vt = np.linalg.svd(np.mean(np.swapaxes(m.true, -1, -2) @ m.given, axis=0))
    return np.asarray(U @ Vt)


def _mean(m: Lot) -> np.ndarray:
    return np.asarray(np.mean(m.given - m.true, axis=0))


def _point(m: Lot) -> np.ndarray:
    return np.asarray(np.mean(_back(m.R, m.given - m.true), axis=0))


POINT = "position of another point"
MISREPORTS: tuple[tuple[str, str, str, Callable[[Lot], np.ndarray] | None, Callable[[Lot, Any], np.ndarray]], ...] = (
    ("attitude", ORDER, "x, y, z, w read as w, x, y, z", None, lambda m, _: rolled(m.true, 1)),
    ("attitude", ORDER, "w, x, y, z read as x, y, z, w", None, lambda m, _: rolled(m.true, -1)),
    ("attitude", CONJUGATE, "the inverse: world to body", None, lambda m, _: np.swapaxes(m.true, -1, -2)),
    ("attitude", "body axes", "axes turned by a constant in the body", _axes, lambda m, Q: m.true @ Q),
    ("velocity", FRAME, "in body axes", None, lambda m, _: _back(m.R, m.true)),
    ("velocity", FRAME, "turned once too often", None, lambda m, _: _out(m.R, m.true)),
    ("angular_velocity", FRAME, "in world axes", None, lambda m, _: _out(m.R, m.true)),
    ("angular_velocity", FRAME, "turned to body axes twice", None, lambda m, _: _back(m.R, m.true)),
    ("angular_velocity", FRAME, "relative to the parent", None, lambda m, _: m.true - m.carried),
    ("position", "origin", "off by {} in world axes", _mean, lambda m, off: m.true + off),
    ("velocity", "velocity of the frame", "off by {} in world axes", _mean, lambda m, off: m.true + off),
    ("position", "position of the joint", "the point of the joint that carries the body", None,
     lambda m, _: m.true + _out(m.R, m.arm)),
    ("position", POINT, "a point off the centre of mass by {} m, body axes", _point,
     lambda m, s: m.true + _out(m.R, s)),
    ("joint_position", "offset", "off by {}", _mean, lambda m, off: m.true + off),
    ("joint_velocity", "offset", "off by {}", _mean, lambda m, off: m.true + off),
    ("joint_position", "wrapped angle", "jumps by full turns; say wrap = true if that is meant", None,
     lambda m, _: m.true + 2 * np.pi * np.round((m.given - m.true) / (2 * np.pi))),
)
"""Values of the right motion in a wrong convention: quantity, name and words of a mistake; the magnitude that is fitted
to what is given, the mean of all groups in `_mean`; the values that it makes."""


def _reports(case: Case) -> Iterator[Cause]:
    for key in dict.fromkeys(group.key for group in case.groups):
        every = tuple(k for k, g in enumerate(case.groups) if g.key == key)
        for scope in (every, *((k,) for k in every if len(every) > 1)):
            where = f"{key.replace('_', ' ')} of {', '.join(case.groups[k].owner for k in scope)}"
            yield from _misreported(case, key, scope, where)
            if key != "attitude":
                yield from _scaled(case, scope, where)
    turning = [k for k, g in enumerate(case.groups) if g.key.startswith("joint_") and g.unit.startswith("rad")]
    if len({case.groups[k].key for k in turning}) > 1:
        for factor in (180 / np.pi, np.pi / 180):
            yield case.cause("units", f"angles and rates of joints times {factor:.6g}: {FACTORS[factor]}",
                             {k: factor * case.values[k] for k in turning})
    for joint in {g.owner: 0 for g in case.groups if g.key.startswith("joint_")}:
        yield case.cause("sign", f"coordinate and rate of {joint} with the other sign",
                         {k: -case.values[k] for k, other in enumerate(case.groups) if other.owner == joint})
    yield from _exchanged(case)
    yield from _turned(case)
    yield from _sensed(case)


def _lot(case: Case, k: int) -> Lot:
    group, states, b = case.groups[k], case.states, case.outputs.body.get(case.groups[k].owner)
    if b is None:
        return Lot(group.values, case.values[k])
    R, parent = states.R[:, b], next((joint.parent for joint in case.scene.joints if joint.child == b), -1)
    spin = _out(states.R[:, parent], states.w[:, parent]) if parent >= 0 else np.zeros((len(case.t), 3))
    return Lot(group.values, case.values[k], R, _back(R, spin), levers(case.scene)[b])


def _misreported(case: Case, key: str, scope: Sequence[int], where: str) -> Iterator[Cause]:
    groups, lots = [case.groups[k] for k in scope], [_lot(case, k) for k in scope]
    if len({g.parts for g in groups}) > 1 or not (
            key.startswith("joint_") or key == "attitude" or len(groups[0].parts) == 3):
        return
    for quantity, name, said, fit, change in MISREPORTS:
        if quantity != key or (name == "wrapped angle" and not groups[0].angle):
            continue
        theta = [None if fit is None else fit(m) for m in lots]
        if fit is _mean:
            theta = [np.mean(theta, axis=0)] * len(theta)  # type: ignore[arg-type]
        changed = {k: change(m, each) for k, m, each in zip(scope, lots, theta, strict=True)}
        told = np.array(theta if fit is _point else theta[0])
        text = f"{where}: {said if fit is None else said.format(_numbers(told))}"
        free = 0 if fit is None else 1 if fit is _mean else len(scope)
        yield case.cause(name, text, changed, free)
        if name.startswith("position of"):
            arms = {g.owner: m.arm if each is None else each for g, m, each in zip(groups, lots, theta, strict=True)}
            for k, g in enumerate(case.groups):
                if g.key == "velocity" and g.owner in arms and len(g.parts) == 3:
                    R, w = (part[:, case.outputs.body[g.owner]] for part in (case.states.R, case.states.w))
                    changed[k] = case.values[k] + _out(R, np.cross(w, arms[g.owner]))
            yield case.cause(name, f"{text}, and velocities", changed, free)


def _scaled(case: Case, scope: Sequence[int], where: str) -> Iterator[Cause]:
    """The other sign, another unit, and another scale of all or of one component."""
    yield case.cause("sign", f"{where} with the other sign", {k: -case.values[k] for k in scope})
    count = case.values[scope[0]].shape[1]
    for part in (slice(None), *(range(count) if len(scope) == 1 and count > 1 else ())):
        true, given = (np.concatenate([values[k][:, part].ravel() for k in scope])
                       for values in (case.values, [g.values for g in case.groups]))
        fitted = float(given @ true / max(float(true @ true), 1e-300))
        unit = next((f for f in FACTORS if abs(fitted / f - 1) < 1e-3), None)
        for factor in {fitted} | ({unit} if unit else set()):
            changed = {k: case.values[k].copy() for k in scope}
            for values in changed.values():
                values[:, part] *= factor
            which = where if isinstance(part, slice) else f"component {part} of {where}"
            yield case.cause("units" if factor == unit else "scale", f"{which} times {factor:.6g}" + (
                f": {FACTORS[factor]}" if factor == unit else ""), changed, int(factor != unit))


def _numbers(values: np.ndarray) -> str:
    return ", ".join(f"{value:.5g}" for value in np.ravel(values))


def _exchanged(case: Case) -> Iterator[Cause]:
    index = {(g.owner, g.key, g.parts): k for k, g in enumerate(case.groups)}
    for one, other in itertools.combinations(dict.fromkeys(group.owner for group in case.groups), 2):
        partner = {one: other, other: one}
        changed = {k: case.values[index[partner[owner], key, parts]] for (owner, key, parts), k in index.items()
                   if owner in partner and (partner[owner], key, parts) in index}
        if changed:
            yield case.cause("exchanged", f"{one} and {other} in each other's columns", changed)


def _turned(case: Case) -> Iterator[Cause]:
    """World axes of another name or direction."""
    vectors = {k for k, g in enumerate(case.groups) if g.key in ("position", "velocity") and len(g.parts) == 3}
    for order, signs in itertools.product(itertools.permutations(range(3)), itertools.product((1, -1), repeat=3)):
        Q = np.eye(3)[list(order)] * np.array(signs)[:, None]
        if vectors and np.linalg.det(Q) > 0 and not np.array_equal(Q, np.eye(3)):
            names = ", ".join(f"{'-' if s < 0 else ''}{'xyz'[k]}" for k, s in zip(order, signs, strict=True))
            yield case.cause("axes", f"world axes x, y, z are {names} of the scene", {
                k: value @ Q.T if k in vectors else Q @ value for k, value in enumerate(case.values)
                if k in vectors or case.groups[k].key == "attitude"})


def _sensed(case: Case) -> Iterator[Cause]:
    """Mistakes of single sensors."""
    sensors = {sensor.name: sensor for sensor in case.scene.sensors}
    for k, group in enumerate(case.groups):
        if group.key == group.owner:
            reader, sensor = Reader(case.scene, case.states), sensors[group.owner]
            right = read(reader, sensor)
            for each in mistakes(reader, sensor, right):
                flat = each.values.reshape(len(right), -1)
                if flat.shape[1] > max(group.parts):
                    yield case.cause(each.cause, f"sensor {group.owner!r}: {each.words}",
                                     {k: flat[:, list(group.parts)]})


# --- when it is reported ----------------------------------------------------------------------------------------------


def _delays(case: Case) -> np.ndarray:
    """(T,) s after which the true motion comes nearest to each sample; NaN where it stands still."""
    delays, width = np.zeros(len(case.t)), 1e-5 * max(float(case.t[-1]), 1e-3)
    for _ in range(4):
        here, ahead, behind = (case.at_times(case.t + delays + by) for by in (0.0, width, -width))
        top, below = np.zeros(len(case.t)), np.zeros(len(case.t))
        for g, a, b, h, s, known in zip(case.groups, ahead, behind, here, case.size, case.known, strict=True):
            slope = np.where(known[:, None], gaps(g, a, b, True) / (2 * width * s), 0.0)
            top += np.einsum("tk,tk->t", gaps(g, g.values, h, True) / s, slope)
            below += np.einsum("tk,tk->t", slope, slope)
        still = below <= 1e-4 * below.max()
        delays = delays + np.where(still, 0.0, top / np.where(still, 1.0, below))
        delays = np.clip(delays, -case.t[-1], case.t[-1])
    return np.where(still, np.nan, delays)


def _times(near: Case, far: Case) -> Iterator[Cause]:
    """Samples of other times: all late, at another pace, or later from some time on."""
    delays = _delays(far)
    good = np.isfinite(delays)
    if good.sum() < 4:
        return
    d, t, interval = delays[good], far.t[good], float(np.median(np.diff(near.t)))
    for late in {round(float(np.median(d)) / interval) * interval, float(np.median(d))} - {0.0}:
        values, count = far.at_times(far.t + late), late / interval
        side = "before" if late < 0 else "after"
        if abs(count - round(count)) < 1e-9:
            yield far.cause("late sample" if late < 0 else "early sample", f"each sample shows the motion "
                            f"{abs(count):.0f} sample interval{'s' * (abs(count) > 1.5)} {side} its time", values)
            continue
        first = far.residual(values, slice(0, 1)) - far.residual(far.values, slice(0, 1))
        alone = np.abs(first).max() > CERTAIN  # otherwise a method of order one looks the same
        yield far.cause(*(("time shift", f"the motion of {late:+.6g} s") if alone else (
            "time shift or large step", f"the motion of {late:+.6g} s, as semi-implicit Euler shows it with steps of "
            f"{2 * abs(late):.4g} s")), values, 1)
    moving = t > 0.05 * t[-1]
    pace = 1 + float(np.median(d[moving] / t[moving]))
    for rate in {pace, next((f for f in FACTORS if abs(pace / f - 1) < 1e-3), pace)}:
        if rate > 0:
            yield far.cause("time scale", f"a clock {rate:.6g} times as fast", far.at_times(far.t * rate),
                            int(rate == pace))
    whole = np.round(d / interval)
    steps = np.flatnonzero(np.diff(whole) != 0)
    if 0 < len(steps) <= 4 and abs(whole[0]) < 1:
        by = np.concatenate([[0.0], whole[steps + 1]])  # constant between two rows of the thinned recording
        name, side = ("dropped sample", "after") if by[-1] > 0 else ("repeated sample", "before")
        since = ", ".join(f"t = {t[k]:.4g} s" for k in steps)
        yield far.cause(name, f"from {since} on, samples show the motion {abs(by[-1]):.0f} sample intervals {side} "
                        "their time", far.at_times(far.t + interval * by[np.searchsorted(t[steps + 1], far.t, "right")]
                                                   ), 1)


def _samples(case: Case) -> Iterator[Cause]:
    """Samples held, interpolated, filtered, clamped, or rough."""
    t, given, true = case.t, case.flat([g.values for g in case.groups]), case.flat(case.values)
    if len(t) < 12 or not all(known.all() for known in case.known):
        return
    floor = max(f / s for f, s in zip(case.floor, case.size, strict=True)) + 1e-13
    still, moving = (np.abs(np.diff(part, axis=0)).max(axis=1) for part in (given, true))
    same = (still <= 1e-15) & (moving > 4 * floor)
    if 0.3 < same.mean() < 1.0:
        firsts = np.concatenate([[0], np.flatnonzero(~same) + 1])
        source = firsts[np.searchsorted(firsts, np.arange(len(t)), side="right") - 1]
        yield case.cause("held sample", f"{len(t) / len(firsts):.3g} samples in a row are the same",
                         [v[source] for v in case.values])
    if np.allclose(np.diff(t), t[1] - t[0], rtol=1e-6):
        bend, right = (np.abs(np.diff(part, 2, axis=0)).max(axis=1) for part in (given, true))
        straight = (bend <= 4 * floor) & (right > 20 * floor)
        if straight.mean() > 0.4:
            knots = np.concatenate([[0], np.flatnonzero(~straight) + 1, [len(t) - 1]])
            yield case.cause("interpolated output", f"straight lines over {len(t) / len(knots):.3g} samples",
                             case.shaped(np.stack([np.interp(t, t[knots], part[knots]) for part in true.T], axis=1)))
        for each in filtered(given, true):
            yield case.cause(each.cause, each.words, case.shaped(np.where(np.isnan(each.values), given, each.values)),
                             1)
    clamped, said = {}, []
    for k, group in enumerate(case.groups):
        low, high = group.values.min(axis=0), group.values.max(axis=0)
        at = [(np.abs(group.values - edge) <= 1e-14 * np.abs(edge)).sum(axis=0).max() for edge in (low, high)]
        if group.key != "attitude" and max(at) > 2:
            clamped[k] = np.clip(case.values[k], low, high)
            said.append(f"{group.label} stays within {_numbers(low)} and {_numbers(high)}")
    if clamped:
        yield case.cause("clamp", "; ".join(said), clamped, 1)
    yield from _rough(case, given - true)


def _rough(case: Case, difference: np.ndarray) -> Iterator[Cause]:
    """Differences from sample to sample that no motion makes."""
    sixth, noise, whole = jumping(difference)
    spikes, rows = (np.abs(part).max(axis=1) for part in (difference, sixth))
    off = spikes > 0.1 * spikes.max()
    if noise < 0.7 * whole:
        return
    if np.median(spikes) < 1e-3 * spikes.max():
        yield Cause("outliers", f"{int(off.sum())} samples are off, the first at t = {case.t[int(np.argmax(off))]:.6g} "
                    "s", 0.0, 1)
    elif np.median(rows) > 0.05 * rows.max():  # not what jumps at an impact
        single = all(np.array_equal(g.values, g.values.astype(np.float32)) for g in case.groups)
        yield Cause("low precision" if single or noise < 1e-6 else "noise", f"{noise:.1e} of the motion's size from "
                    "sample to sample", max(0.0, 1 - noise / whole) / 3, 1)


# --- steps of a method of order one -----------------------------------------------------------------------------------

EULER = {"explicit Euler": (0, 0), "semi-implicit Euler": (1, 0), "implicit Euler": (1, 1)}
"""Methods whose step is a row: q' = q + h v at row 0 or 1 of an interval, v' = v + h a at row 0 or 1."""

INSTANT = 1e-4
"""s over which a velocity is followed to tell its acceleration, at most a tenth of an interval."""


def _euler(case: Case) -> Iterator[Cause]:
    """Rows that are steps of Euler's methods: what they make of each row, beside the next one.

    Rows of the true motion miss such a step by its truncation error. A method explains rows that miss less than these.
    """
    rows = np.flatnonzero(np.all(case.known, axis=0))[:ROWS]
    places = {(g.key, g.owner, g.parts): k for k, g in enumerate(case.groups)}
    pairs = [(k, places.get((RATES[POSES.index(key)], owner, parts))) for (key, owner, parts), k in places.items()
             if key in POSES and key != "attitude"]
    if case.scene.has_laws or not pairs or len(rows) < 12 or np.any(np.diff(rows) != 1):
        return
    piece = part_of(case.recording, rows)
    true = dataclasses.replace(piece, groups=[
        dataclasses.replace(g, values=value[rows]) for g, value in zip(piece.groups, case.values, strict=True)])
    h = float(np.median(np.diff(case.t[rows])))
    for name, (of_pose, of_rate) in EULER.items():
        missed, usual = (_steps_missed(case, each, pairs, case.t[rows], of_pose, of_rate) for each in (piece, true))
        if missed is not None and usual is not None:
            left = max(float(a / max(b, 1e-300)) if a else 0.0 for a, b in zip(missed, usual, strict=True))
            yield Cause(name, f"every row is a step of {h:.6g} s of it", left)


def _steps_missed(case: Case, piece: Recording, pairs: list[tuple[int, int | None]], t: np.ndarray, of_pose: int,
                  of_rate: int) -> list[float] | None:
    """By how much rows miss a step of one of `EULER` from the row before: of each pair of position and rate, the
    position (0 where the rate follows from it) and the rate; None where the rows determine no states."""
    h, groups, rates, missed = np.diff(t)[:, None], list(piece.groups), [], []
    for k, other in pairs:
        q = piece.groups[k]
        moved = np.diff(q.values, axis=0) / h
        v = piece.groups[other].values if other is not None else np.concatenate(
            [moved[:1], moved] if of_pose else [moved, moved[-1:]])
        missed.append(float(np.abs(moved - v[of_pose:len(t) - 1 + of_pose]).max()))
        rate = dataclasses.replace(q, key=RATES[POSES.index(q.key)], values=v, angle=False)
        rates.append((len(groups), rate) if other is None else (other, rate))
        groups += [rate] if other is None else []
    states = restored(case.scene, dataclasses.replace(piece, groups=groups), case.truth.at(t))
    if states is None:
        return None
    shown, tau = Outputs(case.scene, groups), np.full(len(t), min(INSTANT, 0.1 * float(h.min())))
    ahead, behind = (shown.of(integrate(case.scene, states, sign * tau, 1)[0]) for sign in (1, -1))
    for k, rate in rates:
        a = ((ahead[k] - behind[k]) / (2 * tau[:, None]))[of_rate:len(t) - 1 + of_rate]
        missed.append(float(np.linalg.norm((np.diff(rate.values, axis=0) - h * a)[1:-1])))
    return missed


# --- another motion ---------------------------------------------------------------------------------------------------


def _run(case: Case, made: Scene | Model | None, rows: int | None = None) -> Values | None:
    """The values of an altered scene, by lieeuler, or of terms that no scene has, in Python; None if it cannot run."""
    if made is None:
        return None
    scene = made.scene if isinstance(made, Model) else made
    values = values_by(scene, case.groups, case.t[:rows], lambda times: predict(made, times, step=2 * case.step) if (
        isinstance(made, Model)) else motion(made, "rkmk853", case.step, times))
    return None if values is None else case.whole(values, values)


def _fitted(case: Case, build: Callable[[np.ndarray], Scene | Model | None], start: Sequence[float]
            ) -> tuple[np.ndarray, float]:
    """(magnitudes, part of the difference that is left) of a hypothesis, over growing parts of the recording."""
    theta = np.array(start, dtype=float)
    rows, whole = len(case.t), float(np.linalg.norm(case.residual(case.values)))
    for part in (max(8, rows // 6), rows // 2, rows) if len(theta) else ():
        before = case.residual(case.values, slice(0, part))

        def residual(theta: np.ndarray, part: int = part, size: int = len(before)) -> np.ndarray:
            made = _run(case, build(theta), part)
            return np.full(size, 1e6) if made is None else case.residual(made, slice(0, part))

        try:
            theta = gauss_newton(residual, theta)
        except FAILS:
            return theta, np.inf
        if part < rows and np.linalg.norm(before) > CERTAIN * whole and (  # what acts later shows nothing yet
                np.linalg.norm(residual(theta)) > HOPELESS * np.linalg.norm(before)):
            return theta, np.inf
    values = _run(case, build(theta))
    return theta, np.inf if values is None else case.left(values)


def _started(case: Case) -> Iterator[Cause]:
    """Another state at the start."""
    scene = case.scene
    G = Constraints(scene).jacobian(scene.x0[None], scene.R0[None])[0]
    free = np.linalg.svd(G)[2][np.linalg.matrix_rank(G, tol=1e-9):].T if len(G) else np.eye(6 * scene.n)
    count = free.shape[1]
    if count > 8 or any(joint.kind.keeps_attitude for joint in scene.joints):
        return

    def build(theta: np.ndarray) -> Scene | None:
        pose, rate = ((free @ part).reshape(scene.n, 6) for part in np.split(theta, 2))
        return close(started(scene, scene.x0 + pose[:, :3], scene.R0 @ exponential(pose[:, 3:]),
                             scene.v0 + rate[:, :3], scene.w0 + rate[:, 3:]))

    theta, left = _fitted(case, build, (0.0,) * (2 * count))
    turn, speed = (float(np.abs(part).max()) for part in np.split(theta, 2))
    yield Cause("start", f"poses differ by up to {turn:.4g} and velocities by {speed:.4g} (m, rad, s); --start "
                "recorded takes the recorded one", left, 3)


def _models(case: Case, stepped: bool) -> Iterator[Cause]:
    """Alterations of a model that a scene can express, or the others (`stepped`), of one body without laws."""
    scene, right = case.scene, of_scene(case.scene)
    for cause in [*alterations(scene), *_anchors(scene), *alternatives(scene)]:
        def build(theta: object, cause: Alteration = cause) -> Scene | Model | None:
            return _altered(right, cause, np.array(theta, dtype=float))

        sample = build(np.array(cause.starts[0]) + 1e-3)
        doubled = cause.cause == "armature" and cause.alone  # one that is added moves a hinge as its inertia does
        if cause.last or doubled or sample is None or isinstance(sample, Model) is not stepped:
            continue
        starts = cause.starts
        if scene.has_laws and len(starts) > 1:  # runs across events take twenty times as long
            starts = (min(starts, key=lambda start: _off(case, build(start))),)
        theta, left = min((_fitted(case, build, start) for start in starts), key=lambda pair: pair[1])
        free = len(theta)
        for special in cause.special(theta) if np.isfinite(left) else ():
            values = _run(case, build(special))
            if values is not None and (rest := case.left(values)) <= max(CERTAIN, 2 * left):
                fixed = any(np.array_equal(special, other) for other in cause.special(1.01 * theta + 0.01))
                theta, left, free = np.array(special), rest, 0 if fixed else free
                break
        if np.isfinite(left):
            yield Cause(cause.name(theta), cause.words(theta), left, free + cause.mistakes(theta) - 1)


def _off(case: Case, made: Scene | Model | None) -> float:
    values = _run(case, made)
    return np.inf if values is None else float(np.linalg.norm(case.residual(values)))


def _altered(right: Model, cause: Alteration, theta: np.ndarray) -> Scene | Model | None:
    """The scene that moves as the altered model; the model where none does and it can be stepped; None: neither."""
    try:
        model = cause.apply(right, theta)
    except FAILS:
        return None
    if not model.physical(right):
        return None
    return model.as_scene or (model if model.scene.n == 1 and not model.scene.has_laws else None)


def _anchors(scene: Scene) -> Iterator[Alteration]:
    for joint in scene.joints:
        has_axis = joint.kind.axes == "parallel" and joint.parent == -1
        for field in ("parent_anchor", "child_anchor", *(["parent_axis"] if has_axis else [])):
            turned, where = field == "parent_axis", f"{field.replace('_', ' ')} of joint {joint.name!r}"

            def moved(m: Model, theta: np.ndarray, name: str = joint.name, field: str = field, turned: bool = turned
                      ) -> Model:
                other = m.with_joint(name, lambda each: dataclasses.replace(each, **{
                    field: exponential(theta[None])[0] @ getattr(each, field) if turned else
                    getattr(each, field) + theta}))
                closed = placed(other.scene)
                if closed is None:
                    raise ArgumentError(f"joint {name!r} does not say where its bodies are")
                return other.replace(scene=closed)

            def say(theta: np.ndarray, where: str = where, turned: bool = turned) -> str:
                return f"{where} turned by {_numbers(np.degrees(theta))} deg" if turned else (
                    f"{where} off by {_numbers(theta)} m")

            yield Alteration("joint axis" if turned else "anchors", moved, ((0.0, 0.0, 0.0),), say,
                             "check where the joint holds", target=joint.name)
