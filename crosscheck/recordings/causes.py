"""Why a recording differs from truth, as far as one recording can tell.

A hypothesis turns the true motion into what the recording would then show; its magnitudes are fitted. It is named if
it leaves less than a tenth of every difference, and if no other one of equal simplicity does as well.
"""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import numpy as np

from crosscheck.adapters.lieeuler import motion
from crosscheck.diagnosis.altered import Model
from crosscheck.diagnosis.fit import gauss_newton
from crosscheck.diagnosis.hypotheses import Cause as Hypothesis
from crosscheck.diagnosis.hypotheses import Context, causes
from crosscheck.diagnosis.misreadings import placed
from crosscheck.diagnosis.physics import Physics, levers, of_scene
from crosscheck.diagnosis.variants import close
from crosscheck.errors import CrosscheckError
from crosscheck.recordings.comparing import Differences, Shown, gaps, norms, part_of
from crosscheck.references.maximal import fastest
from crosscheck.scene.constraints import Constraints
from crosscheck.scene.joints import JOINT_TYPES
from crosscheck.scene.model import Force, Scene, quaternion_from_rotation, rotation_from_quaternion
from crosscheck.scene.starts import Configuration, bodies_at
from crosscheck.scene.states import States
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

SHOWS = 0.02
"""Part of the difference that a time shift makes in the first row if it can be told from the error of a step."""

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


@dataclasses.dataclass(frozen=True)
class Cause:
    """What explains a difference."""

    name: str
    said: str
    left: float  # part of the difference that it leaves
    free: int = 0  # number of fitted magnitudes and of separate mistakes

    def __str__(self) -> str:
        return f"{self.name}: {self.said}" if self.said else self.name


class Case:
    """Some rows of a recording beside truth, and how much of their difference a hypothesis leaves."""

    def __init__(self, scene: Scene, seen: Differences, rows: np.ndarray) -> None:
        self.scene, self.truth = scene, seen.truth
        self.recording = part_of(seen.recording, rows)
        self.groups, self.t = self.recording.groups, seen.t[rows]
        self.shown = Shown(scene, self.groups)
        self.values = [value[rows] for value in seen.values]
        self.floor = [float(floor[rows].max()) for floor in seen.floor]
        self.before = [norms(gap[rows]) for gap in seen.gap]
        self.size = [max(float(np.ptp(value, axis=0).max()), float(floor), 1e-300)
                     for value, floor in zip(self.values, self.floor, strict=True)]
        rate = float(np.linalg.norm(self.truth.at(self.t).w, axis=-1).max())
        self.step = TURN / max(rate, fastest(scene), 1.0)
        worst = max(float(b.max()) / s for b, s in zip(self.before, self.size, strict=True))
        self.scale = [max(float(b.max()), 0.1 * worst * s, 3 * f) for b, s, f in
                      zip(self.before, self.size, self.floor, strict=True)]

    def at_times(self, times: np.ndarray) -> Values:
        """True values at any times, in any order."""
        grid, places = np.unique(np.maximum(times, 0.0), return_inverse=True)
        offsets = [np.round((value[0] - now) / (2 * np.pi)) * 2 * np.pi if group.angle else 0.0 for group, value, now
                   in zip(self.groups, self.values, [v[0] for v in self.shown.at(self.truth, self.t[:1])], strict=True)]
        return [value[places] + off for value, off in zip(self.shown.at(self.truth, grid), offsets, strict=True)]

    def residual(self, values: Values, rows: slice = slice(None)) -> np.ndarray:
        """All differences over their scales, in one vector."""
        parts = [(gaps(g, g.values[rows], v[rows], True) / s).ravel() for g, v, s in
                 zip(self.groups, values, self.scale, strict=True)]
        z = np.concatenate(parts)
        return np.asarray(np.where(np.isfinite(z), np.clip(z, -1e6, 1e6), 1e6))

    def left(self, values: Values, rows: slice = slice(None)) -> float:
        """The largest part of a difference that remains, beyond what printed digits leave."""
        most = 0.0
        for g, v, scale, floor, before in zip(self.groups, values, self.scale, self.floor, self.before, strict=True):
            after = norms(gaps(g, g.values[rows], v[rows]))
            if not np.isfinite(after).all():
                return np.inf
            most = max(most, max(0.0, float(after.max()) - 2 * floor) / scale,
                       2 * max(0.0, float(after[0]) - 2 * floor - 0.1 * float(before[rows][0])) / scale)
        return most


def find(scene: Scene, seen: Differences, until: float) -> tuple[list[Cause], list[Cause]]:
    """(causes that explain and are equally simple, all others from the best on)."""
    judged = np.flatnonzero(seen.recording.t <= until)
    near = Case(scene, seen, judged[:NEIGHBOURS])
    far = Case(scene, seen, judged[np.unique(np.linspace(0, len(judged) - 1, ROWS).astype(int))])
    every = [*_reports(far), *_times(near, far), *_samples(near)]
    if not any(cause.left <= CERTAIN and not cause.free for cause in every):  # nothing is simpler than no magnitude
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
    named: dict[str, Cause] = {}
    for cause in fit:
        if cause.free == simplest:
            named.setdefault(cause.name, cause)
    return list(named.values()), every


# --- what is reported -------------------------------------------------------------------------------------------------


def _reports(case: Case) -> Iterator[Cause]:
    """Values of the right motion in a wrong convention."""
    states = case.truth.at(case.t)
    for key in dict.fromkeys(group.key for group in case.groups):
        scopes = [tuple(k for k, g in enumerate(case.groups) if g.key == key)]
        scopes += [(k,) for k in scopes[0] if len(scopes[0]) > 1]
        for scope in scopes:
            where = f"{key.replace('_', ' ')} of " + ", ".join(case.groups[k].owner for k in scope)
            yield from _scaled(case, scope, where)
            if key == "attitude":
                yield from _attitudes(case, scope, where)
            if key == "position":
                yield from _points(case, scope, where, states)
    yield from _framed(case, states)
    yield from _exchanged(case)
    yield from _turned(case)


def _with(case: Case, changed: dict[int, np.ndarray]) -> Values:
    return [changed.get(k, value) for k, value in enumerate(case.values)]


def _scaled(case: Case, scope: Sequence[int], where: str) -> Iterator[Cause]:
    if any(case.groups[k].key == "attitude" for k in scope):
        return
    given, true = (np.concatenate([part[k].ravel() for k in scope])
                   for part in ([g.values for g in case.groups], case.values))
    factor = float(given @ true / max(float(true @ true), 1e-300))
    known = next((f for f in FACTORS if abs(factor / f - 1) < 1e-3), None)
    for value in dict.fromkeys(v for v in (known, -1.0 if abs(factor + 1) < 0.05 else None, factor) if v is not None):
        left = case.left(_with(case, {k: value * case.values[k] for k in scope}))
        if value == known:
            yield Cause("units", f"{where} times {value:.6g}: {FACTORS[value]}", left)
        elif value == -1.0:
            yield Cause("sign", f"{where} with the other sign", left)
        else:
            yield Cause("scale", f"{where} times {value:.6g}", left, 1)
    for k in scope if len(scope) == 1 and case.values[scope[0]].shape[1] > 1 else ():
        for part in range(case.values[k].shape[1]):
            given, true = case.groups[k].values[:, part], case.values[k][:, part]
            one = np.where(np.arange(case.values[k].shape[1]) == part, float(given @ true / max(float(true @ true),
                                                                                             1e-300)), 1.0)
            yield Cause("scale", f"component {part} of {where} times {one[part]:.6g}",
                        case.left(_with(case, {k: case.values[k] * one})), 1)
    for k in scope:
        off = np.mean(case.groups[k].values - case.values[k], axis=0)
        if len(scope) == 1 and case.groups[k].key.startswith("joint_"):
            yield Cause("offset", f"{where} off by {_numbers(off)}", case.left(_with(case, {k: case.values[k] + off})),
                        1)
        if len(scope) == 1 and case.groups[k].angle:
            turns = 2 * np.pi * np.round((case.groups[k].values - case.values[k]) / (2 * np.pi))
            yield Cause("wrapped angle", f"{where} jumps by full turns; say wrap = true if that is meant",
                        case.left(_with(case, {k: case.values[k] + turns})))
    if all(case.groups[k].key in ("position", "velocity") and len(case.groups[k].parts) == 3 for k in scope):
        off = np.mean(np.concatenate([case.groups[k].values - case.values[k] for k in scope]), axis=0)
        name = "origin" if case.groups[scope[0]].key == "position" else "velocity of the frame"
        yield Cause(name, f"{where} off by {_numbers(off)} in world axes",
                    case.left(_with(case, {k: case.values[k] + off for k in scope})), 1)


def _numbers(values: np.ndarray) -> str:
    return ", ".join(f"{value:.5g}" for value in np.ravel(values))


def _attitudes(case: Case, scope: Sequence[int], where: str) -> Iterator[Cause]:
    for name, said, change in (("quaternion order", "x, y, z, w read as w, x, y, z", lambda R: _rolled(R, 1)),
                               ("quaternion order", "w, x, y, z read as x, y, z, w", lambda R: _rolled(R, -1)),
                               ("quaternion conjugated", "the inverse: world to body",
                                lambda R: np.swapaxes(R, 1, 2))):
        yield Cause(name, f"{where}: {said}", case.left(_with(case, {k: change(case.values[k]) for k in scope})))
    if len(scope) == 1:
        k = scope[0]
        U, _, Vt = np.linalg.svd(np.mean(np.swapaxes(case.values[k], 1, 2) @ case.groups[k].values, axis=0))
        yield Cause("body axes", f"{where} of axes that are turned by a constant in the body",
                    case.left(_with(case, {k: case.values[k] @ (U @ Vt)})), 1)


def _rolled(R: np.ndarray, shift: int) -> np.ndarray:
    return rotation_from_quaternion(np.roll(quaternion_from_rotation(R), shift, axis=1))


def _points(case: Case, scope: Sequence[int], where: str, states: States) -> Iterator[Cause]:
    bodies = [case.shown.body[case.groups[k].owner] for k in scope]
    arms = levers(case.scene)
    fitted = {}
    for k, body in zip(scope, bodies, strict=True):
        if len(case.groups[k].parts) < 3 or (len(scope) > 1 and case.scene.n > 1 and len(scope) < 2):
            return
        off = case.groups[k].values - case.values[k]
        fitted[k] = np.mean(np.einsum("tji,tj->ti", states.R[:, body], off), axis=0)
    for name, said, s, free in (
            ("position of the joint", "the point of the joint that carries the body",
             {k: arms[b] for k, b in zip(scope, bodies, strict=True)}, 0),
            ("position of another point", "a point off the centre of mass by "
             + "; ".join(_numbers(each) for each in fitted.values()) + " m, body axes", fitted, len(scope))):
        if not any(np.any(each) for each in s.values()):
            continue
        changed = {k: case.values[k] + states.R[:, b] @ s[k] for k, b in zip(scope, bodies, strict=True)}
        yield Cause(name, f"{where}: {said}", case.left(_with(case, changed)), free)
        speeds = {k: case.values[k] + np.einsum("tij,tj->ti", states.R[:, b], np.cross(states.w[:, b], s[j]))
                  for k, g in enumerate(case.groups) for j, b in zip(scope, bodies, strict=True)
                  if g.key == "velocity" and g.owner == case.groups[j].owner and len(g.parts) == 3}
        if speeds:
            yield Cause(name, f"{where}, and velocity: {said}", case.left(_with(case, changed | speeds)), free)


def _framed(case: Case, states: States) -> Iterator[Cause]:
    for key, said, pattern in (("velocity", "in body axes", "tji,tj->ti"),
                               ("velocity", "turned once too often", "tij,tj->ti"),
                               ("angular_velocity", "in world axes", "tij,tj->ti"),
                               ("angular_velocity", "turned to body axes twice", "tji,tj->ti")):
        changed = {k: np.einsum(pattern, states.R[:, case.shown.body[g.owner]], case.values[k])
                   for k, g in enumerate(case.groups) if g.key == key and len(g.parts) == 3}
        for some in [changed] * bool(changed) + [{k: value} for k, value in changed.items() if len(changed) > 1]:
            where = ", ".join(case.groups[k].owner for k in some)
            yield Cause("velocity frame", f"{key.replace('_', ' ')} of {where} {said}", case.left(_with(case, some)))
    parents = {joint.child: joint.parent for joint in case.scene.joints if joint.parent >= 0}
    changed = {}
    for k, g in enumerate(case.groups):
        body = case.shown.body.get(g.owner, -1)
        if g.key == "angular_velocity" and len(g.parts) == 3 and body in parents:
            other = parents[body]
            carried = np.einsum("tji,tjk,tk->ti", states.R[:, body], states.R[:, other], states.w[:, other])
            changed[k] = case.values[k] - carried
    if changed:
        yield Cause("velocity frame", "angular velocity relative to the parent", case.left(_with(case, changed)))


def _exchanged(case: Case) -> Iterator[Cause]:
    owners = list(dict.fromkeys(group.owner for group in case.groups))
    for joint in {group.owner for group in case.groups if group.key.startswith("joint_")}:
        yield Cause("sign", f"coordinate and rate of {joint} with the other sign", case.left(_with(case, {
            k: -case.values[k] for k, group in enumerate(case.groups) if group.owner == joint})))
    index = {(g.owner, g.key, g.parts): k for k, g in enumerate(case.groups)}
    for one, other in itertools.combinations(owners, 2):
        changed = {}
        for (owner, key, parts), k in index.items():
            partner = other if owner == one else one if owner == other else None
            if partner is not None and (partner, key, parts) in index:
                changed[k] = case.values[index[partner, key, parts]]
        if changed:
            yield Cause("exchanged", f"{one} and {other} in each other's columns", case.left(_with(case, changed)))


def _turned(case: Case) -> Iterator[Cause]:
    """World axes of another name or direction."""
    vectors = {k for k, g in enumerate(case.groups) if g.key in ("position", "velocity") and len(g.parts) == 3}
    if not vectors:
        return
    for order in itertools.permutations(range(3)):
        for signs in itertools.product((1.0, -1.0), repeat=3):
            Q = np.eye(3)[list(order)] * np.array(signs)[:, None]
            if np.linalg.det(Q) < 0 or np.array_equal(Q, np.eye(3)):
                continue
            changed = {k: value @ Q.T if k in vectors else Q @ value for k, value in enumerate(case.values)
                       if k in vectors or case.groups[k].key == "attitude"}
            names = ", ".join(f"{'-' if s < 0 else ''}{'xyz'[k]}" for k, s in zip(order, signs, strict=True))
            yield Cause("axes", f"world axes x, y, z are {names} of the scene", case.left(_with(case, changed)))


# --- when it is reported ----------------------------------------------------------------------------------------------


def _delays(case: Case) -> np.ndarray:
    """(T,) s after which the true motion comes nearest to each sample; NaN where it stands still."""
    delays, width = np.zeros(len(case.t)), 1e-5 * max(float(case.t[-1]), 1e-3)
    for _ in range(4):
        here = case.at_times(case.t + delays)
        ahead, behind = case.at_times(case.t + delays + width), case.at_times(case.t + delays - width)
        top, below = np.zeros(len(case.t)), np.zeros(len(case.t))
        for g, a, b, h, s in zip(case.groups, ahead, behind, here, case.size, strict=True):
            slope = gaps(g, a, b, True) / (2 * width * s)
            top += np.einsum("tk,tk->t", gaps(g, g.values, h, True) / s, slope)
            below += np.einsum("tk,tk->t", slope, slope)
        still = below < 1e-4 * below.max()
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
    for late in dict.fromkeys((round(float(np.median(d)) / interval) * interval, float(np.median(d)))):
        left, count = far.left(far.at_times(far.t + late)), late / interval
        if late and abs(count - round(count)) < 1e-9:
            yield Cause("late sample" if late < 0 else "early sample", f"each sample shows the motion "
                        f"{abs(count):.0f} sample interval{'s' * (abs(count) > 1.5)} "
                        f"{'before' if late < 0 else 'after'} its time", left)
        elif late:
            first = far.residual(far.at_times(far.t + late), slice(0, 1)) - far.residual(far.values, slice(0, 1))
            if np.abs(first).max() > SHOWS:  # otherwise a method of order one looks the same
                yield Cause("time shift", f"the motion of {late:+.6g} s", left, 1)
            else:
                yield Cause("time shift or large step", f"the motion of {late:+.6g} s, as semi-implicit Euler shows it "
                            f"with steps of {2 * abs(late):.4g} s", left, 1)
    moving = t > 0.05 * t[-1]
    pace = float(np.median(d[moving] / t[moving]))
    for rate in dict.fromkeys((next((f - 1 for f in FACTORS if abs((1 + pace) / f - 1) < 1e-3), pace), pace)):
        if rate > -1:
            yield Cause("time scale", f"a clock {1 + rate:.6g} times as fast",
                        far.left(far.at_times(far.t * (1 + rate))), int(rate == pace))
    whole = np.round(d / interval)
    steps = np.flatnonzero(np.diff(whole) != 0)
    if 0 < len(steps) <= 4 and abs(whole[0]) < 1:
        levels, at = np.zeros(len(far.t)), 0.0
        said = []
        for k in steps:  # between two rows of the thinned recording: the exact row by the neighbours there
            at = float(t[k + 1])
            levels[far.t >= at] = whole[k + 1] * interval
            said.append(f"t = {t[k]:.4g} s")
        lost = whole[steps[-1] + 1] > 0
        yield Cause("dropped sample" if lost else "repeated sample", f"from {', '.join(said)} on, samples show the "
                    f"motion {abs(whole[steps[-1] + 1]):.0f} sample intervals {'after' if lost else 'before'} their "
                    "time", far.left(far.at_times(far.t + levels)), 1)


def _samples(case: Case) -> Iterator[Cause]:
    """Samples held, interpolated, filtered, clamped, or rough."""
    given, t = [g.values.reshape(len(case.t), -1) for g in case.groups], case.t
    if len(t) < 12:
        return
    flat = np.concatenate([g / s for g, s in zip(given, case.size, strict=True)], axis=1)
    true = np.concatenate([v.reshape(len(t), -1) / s for v, s in zip(case.values, case.size, strict=True)], axis=1)
    floor = max(f / s for f, s in zip(case.floor, case.size, strict=True)) + 1e-13
    still, moving = (np.abs(np.diff(part, axis=0)).max(axis=1) for part in (flat, true))
    same = (still <= 1e-15) & (moving > 4 * floor)
    if 0.3 < same.mean() < 1.0:
        firsts = np.concatenate([[0], np.flatnonzero(~same) + 1])
        source = firsts[np.searchsorted(firsts, np.arange(len(t)), side="right") - 1]
        yield Cause("held sample", f"{len(t) / len(firsts):.3g} samples in a row are the same",
                    case.left([v[source] for v in case.values]))
    step = np.diff(t)
    if np.allclose(step, step[0], rtol=1e-6):
        bend, right = (np.abs(np.diff(part, 2, axis=0)).max(axis=1) for part in (flat, true))
        straight = (bend <= 4 * floor) & (right > 20 * floor)
        if straight.mean() > 0.4:
            knots = np.concatenate([[0], np.flatnonzero(~straight) + 1, [len(t) - 1]])
            yield Cause("interpolated output", f"straight lines over {len(t) / len(knots):.3g} samples",
                        case.left([_between(t, knots, value) for value in case.values]))
        for m in (2, 3, 4, 5, 7, 9, 10, 15, 20, 25, 50):
            for back in {0, m // 2}:
                yield Cause("filtered", f"the mean of {m} samples", case.left(
                    [_mean(v, m, back) for v in case.values]), 1)
        yield _low_pass(case, float(step[0]))
    yield from _clamped(case)
    yield from _rough(case, flat - true, given)


def _rotations(values: np.ndarray) -> np.ndarray:
    """The nearest rotations of matrices; other values as they are."""
    if values.ndim < 3:
        return values
    U, _, Vt = np.linalg.svd(values)
    return np.asarray(U @ Vt)


def _between(t: np.ndarray, knots: np.ndarray, values: np.ndarray) -> np.ndarray:
    flat = values.reshape(len(t), -1)
    lines = np.stack([np.interp(t, t[knots], column[knots]) for column in flat.T], axis=1)
    return _rotations(lines.reshape(values.shape))


def _mean(values: np.ndarray, count: int, back: int) -> np.ndarray:
    """Means of `count` samples that end `back` samples later; at the ends of those that there are."""
    flat = values.reshape(len(values), -1)
    sums = np.concatenate([np.zeros((1, flat.shape[1])), np.cumsum(flat, axis=0)])
    end = np.minimum(np.arange(len(flat)) + back + 1, len(flat))
    begin = np.maximum(np.arange(len(flat)) + back + 1 - count, 0)
    return _rotations(((sums[end] - sums[begin]) / (end - begin)[:, None]).reshape(values.shape))


def _low_pass(case: Case, interval: float) -> Cause:
    from scipy.optimize import minimize_scalar

    flat = np.concatenate([value.reshape(len(value), -1) for value in case.values], axis=1)
    ends = np.cumsum([value[0].size for value in case.values])[:-1]

    def filtered(log_tau: float) -> Values:
        keep = float(np.exp(-interval / np.exp(log_tau)))
        out = flat.copy()
        for k in range(1, len(out)):
            out[k] += keep * (out[k - 1] - out[k])
        parts = np.split(out, ends, axis=1)
        return [_rotations(part.reshape(value.shape)) for part, value in zip(parts, case.values, strict=True)]

    grid = np.log(interval) + np.linspace(-1.5, 5.0, 14)
    best = min(grid, key=lambda value: float(np.sum(case.residual(filtered(value)) ** 2)))
    fitted = minimize_scalar(lambda value: float(np.sum(case.residual(filtered(value)) ** 2)),
                             bounds=(best - 0.5, best + 0.5), method="bounded", options={"xatol": 1e-6}).x
    return Cause("filtered", f"a first-order low pass of {np.exp(fitted):.5g} s", case.left(filtered(float(fitted))), 1)


def _clamped(case: Case) -> Iterator[Cause]:
    changed, said = {}, []
    for k, group in enumerate(case.groups):
        low, high = group.values.min(axis=0), group.values.max(axis=0)
        at = [(np.abs(group.values - edge) <= 1e-14 * np.abs(edge)).sum(axis=0).max() for edge in (low, high)]
        if group.key != "attitude" and max(at) > 2:
            changed[k] = np.clip(case.values[k], low, high)
            said.append(f"{group.label} stays within {_numbers(low)} and {_numbers(high)}")
    if changed:
        yield Cause("clamp", "; ".join(said), case.left(_with(case, changed)), 1)


def _rough(case: Case, difference: np.ndarray, given: Sequence[np.ndarray]) -> Iterator[Cause]:
    """Differences from sample to sample that no motion makes."""
    sixth = np.diff(difference, 6, axis=0) / np.sqrt(924.0)
    noise, whole = (float(np.sqrt(np.mean(part**2))) for part in (sixth, difference))
    if noise < 0.7 * whole:
        return
    single = all(np.array_equal(part, part.astype(np.float32)) for part in given)
    spikes = np.abs(difference).max(axis=1)
    if np.median(spikes) < 1e-3 * spikes.max():
        yield Cause("outliers", f"{int((spikes > 0.1 * spikes.max()).sum())} samples are off, the first at t = "
                    f"{case.t[int(np.argmax(spikes > 0.1 * spikes.max()))]:.6g} s", 0.0, 1)
    else:
        yield Cause("low precision" if single or noise < 1e-6 else "noise", f"{noise:.1e} of the motion's size from "
                    "sample to sample", max(0.0, 1 - noise / whole) / 3, 1)


# --- another motion ---------------------------------------------------------------------------------------------------


def _run(case: Case, scene: Scene | Physics, rows: int | None = None) -> Values | None:
    """The values of an altered scene, by lieeuler, or of terms that no scene has; None where it cannot run."""
    times = np.unique(np.concatenate([[0.0], case.t[:rows]]))
    if isinstance(scene, Physics):
        states = _stepped(case, scene, times)
        return None if states is None else _shown(case, states, rows)
    try:
        return _shown(case, motion(scene, "rkmk853", case.step, times), rows)
    except (CrosscheckError, np.linalg.LinAlgError):
        return None


def _stepped(case: Case, physics: Physics, times: np.ndarray) -> States | None:
    """States at `times` by the Runge-Kutta method of order four, in Python: slow, for small scenes."""
    scene, n = case.scene, case.scene.n
    model = Model(scene, physics)

    def rates(t: float, y: np.ndarray) -> np.ndarray:
        x, R, v, w = (y[:, :3], y[:, 3:12].reshape(n, 3, 3), y[:, 12:15], y[:, 15:])
        return np.concatenate([v, np.cross(R, w[:, None, :]).reshape(n, 9), model.rates(x, R, v, w, t)], axis=1)

    y = np.concatenate([scene.x0, scene.R0.reshape(n, 9), scene.v0, scene.w0], axis=1)
    rows = [y]
    try:
        for begin, end in itertools.pairwise(times):
            count = int(np.ceil((end - begin) / (0.7 * case.step)))
            h = (end - begin) / count
            for k in range(count):
                t = begin + k * h
                a = rates(t, y)
                b = rates(t + h / 2, y + h / 2 * a)
                c = rates(t + h / 2, y + h / 2 * b)
                y = y + h / 6 * (a + 2 * b + 2 * c + rates(t + h, y + h * c))
            rows.append(y)
    except np.linalg.LinAlgError:
        return None
    parts = np.array(rows)
    return States(times, parts[..., :3], parts[..., 3:12].reshape(-1, n, 3, 3), parts[..., 12:15], parts[..., 15:])


def _shown(case: Case, states: States, rows: int | None) -> Values:
    values = [value[len(states.t) - len(case.t[:rows]):] for value in case.shown.of(states)]
    return [v + 2 * np.pi * np.round((true[0] - v[0]) / (2 * np.pi)) if g.angle else v
            for g, v, true in zip(case.groups, values, case.values, strict=True)]


def _fitted(case: Case, build: Callable[[np.ndarray], Scene | Physics | None], start: Sequence[float]
            ) -> tuple[np.ndarray, float]:
    """(magnitudes, part of the difference that is left) of a hypothesis, over growing parts of the recording."""
    theta = np.array(start, dtype=float)
    rows = len(case.t)
    bad = np.full(len(case.residual(case.values)), 1e6)

    def values(theta: np.ndarray, part: int | None = None) -> Values | None:
        scene = build(theta)
        return None if scene is None else _run(case, scene, part)

    for part in (max(8, rows // 6), rows // 2, rows) if len(theta) else ():
        window = slice(0, part)

        def residual(theta: np.ndarray, window: slice = window) -> np.ndarray:
            made = values(theta, window.stop)
            full = case.residual(case.values, window)
            return bad[:len(full)] if made is None else case.residual(made, window)

        try:
            theta = gauss_newton(residual, theta)
        except np.linalg.LinAlgError:
            return theta, np.inf
        z, before = residual(theta), case.residual(case.values, window)
        if part < rows and np.linalg.norm(z) > HOPELESS * np.linalg.norm(before) + 1e-12:
            return theta, np.inf
    made = values(theta)
    return theta, np.inf if made is None else case.left(made)


def _started(case: Case) -> Iterator[Cause]:
    """Another state at the start."""
    scene = case.scene
    if any(joint.type in ("prismatic", "fixed") for joint in scene.joints):
        return
    G = Constraints(scene).jacobian(scene.x0[None], scene.R0[None])[0]
    free = np.linalg.svd(G)[2][np.linalg.matrix_rank(G, tol=1e-9):].T if len(G) else np.eye(6 * scene.n)
    count = free.shape[1]
    if count > 8:
        return

    def build(theta: np.ndarray) -> Scene | None:
        pose, rate = ((free @ part).reshape(scene.n, 6) for part in np.split(theta, 2))
        R = scene.R0 @ exponential(pose[:, 3:])
        state = Configuration(scene.x0 + pose[:, :3], quaternion_from_rotation(R), scene.v0 + rate[:, :3],
                              scene.w0 + rate[:, 3:])
        return close(scene.replace(bodies=bodies_at(scene, state)))

    theta, left = _fitted(case, build, (0.0,) * (2 * count))
    made = build(theta)
    if made is not None:
        turn, speed = (float(np.abs(part).max()) for part in np.split(theta, 2))
        yield Cause("start", f"poses differ by up to {turn:.4g} and velocities by {speed:.4g} (m, rad, s); --start "
                    "recorded takes the recorded one", left, 3)


def _models(case: Case, stepped: bool) -> Iterator[Cause]:
    """Altered parameters: the hypotheses of `crosscheck explain` that a scene can express, or the others (`stepped`).
    """
    scene, right = case.scene, of_scene(case.scene)
    for cause in [*causes(Context(scene, (scene.R0[None],), right)), *_anchors(scene)]:
        sample = _altered(scene, right, cause, np.array(cause.starts[0]) + 1e-3)
        if cause.last or sample is None or isinstance(sample, Physics) is not stepped:
            continue
        best: tuple[np.ndarray, float] | None = None
        for start in cause.starts:
            theta, left = _fitted(case, lambda t, c=cause: _altered(scene, right, c, t), start)  # type: ignore[misc]
            if best is None or left < best[1]:
                best = theta, left
        if best is None or not np.isfinite(best[1]):
            continue
        theta, left = best
        free = len(theta)
        for special in cause.special(theta):
            made = _altered(scene, right, cause, np.array(special))
            values = None if made is None else _run(case, made)
            if values is not None and (rest := case.left(values)) <= max(CERTAIN, 2 * left):
                fixed = any(np.array_equal(special, other) for other in cause.special(1.01 * theta + 0.01))
                theta, left, free = np.array(special), rest, 0 if fixed else free
                break
        yield Cause(cause.name(theta), cause.say(theta), left, free + cause.mistakes(theta) - 1)


STEPPED = ("drag", "spin_drag", "quadratic", "gyroscopic", "centripetal", "coulomb")
"""Parameters that no scene has, for which Python steps."""

MOST_STEPPED = 1
"""Bodies of a scene for which it does."""

SUPPORTED = ("gravity", "masses", "inertias", "stiffness", "rest", "damping", "load", "joint_damping", "point")


def _altered(scene: Scene, right: Physics, cause: Any, theta: np.ndarray) -> Scene | Physics | None:
    """The scene with a hypothesis' parameters; the parameters where a scene cannot have them; None: neither."""
    if isinstance(cause, Anchor):
        return cause.build(scene, theta)
    p = cause.apply(right, np.asarray(theta, dtype=float))
    for field in dataclasses.fields(Physics):
        one, other = getattr(p, field.name), getattr(right, field.name)
        if field.name not in SUPPORTED and one is not other and not np.array_equal(one, other):
            return p if field.name in STEPPED and scene.n <= MOST_STEPPED else None
    if np.any(p.masses <= 0) or np.any(np.linalg.eigvalsh(p.inertias[0]) <= 0):
        return None
    bodies = tuple(dataclasses.replace(body, mass=float(p.masses[k]), inertia=p.inertias[0, k])
                   for k, body in enumerate(scene.bodies))
    forces = []
    for k, force in enumerate(scene.forces):
        given = dict(force.parameters)
        for key, values in (("stiffness", p.stiffness), ("damping", p.damping), ("free_length", p.rest),
                            ("rest_angle", p.rest)):
            if key in given and isinstance(given[key], int | float):
                given[key] = float(values[k])
        for key in ("force", "torque"):
            if key in given and p.load[k] != 1.0:
                if force.functions or (isinstance(given[key], int | float) is False and force.joint is not None):
                    return None
                given[key] = (p.load[k] * given[key] if isinstance(given[key], int | float)
                              else tuple(float(p.load[k] * value) for value in given[key]))
        if p.point is not None and p.point[0] == k:
            given["child_point"] = tuple(np.array(given["child_point"]) + p.point[1])
        if p.damping[k] < 0:
            return None
        forces.append(dataclasses.replace(force, parameters=given))
    if p.joint_damping:
        if any(joint.type != "revolute" for joint in scene.joints):
            return p if scene.n <= MOST_STEPPED else None
        if p.joint_damping < 0:
            return None
        forces += [Force("torsional_spring", joint.parent, joint.child, joint.name, {
            "stiffness": 0.0, "rest_angle": 0.0, "damping": float(p.joint_damping)}) for joint in scene.joints]
    return scene.replace(gravity=p.gravity, bodies=bodies, forces=tuple(forces))


class Anchor(Hypothesis):
    """A hypothesis about where a joint holds, which no `Physics` expresses."""

    def build(self, scene: Scene, theta: np.ndarray) -> Scene | None:
        """The altered scene, its bodies where the joints then put them."""
        return self.apply(scene, theta)  # type: ignore[arg-type, return-value]


def _anchors(scene: Scene) -> Iterator[Hypothesis]:
    if not all(joint.type in ("spherical", "universal", "revolute") for joint in scene.joints):
        return
    for k, joint in enumerate(scene.joints):
        for field in ("parent_anchor", "child_anchor"):
            def moved(given: Any, theta: np.ndarray, k: int = k, field: str = field) -> Any:
                joints = list(given.joints)
                joints[k] = dataclasses.replace(joints[k], **{field: getattr(joints[k], field) + theta})
                return placed(given.replace(joints=tuple(joints)))

            yield Anchor("anchors", moved, ((0.0, 0.0, 0.0),), lambda t, j=joint, f=field:  # type: ignore[misc]
                         f"{f.replace('_', ' ')} of joint {j.name!r} off by {_numbers(t)} m", "check the anchors",
                         target=joint.name)
        if JOINT_TYPES[joint.type].axes == "parallel" and joint.parent == -1:
            def turned(given: Any, theta: np.ndarray, k: int = k) -> Any:
                Q = exponential(theta[None])[0]
                joints = list(given.joints)
                joints[k] = dataclasses.replace(joints[k], parent_axis=Q @ joints[k].parent_axis)
                return placed(given.replace(joints=tuple(joints)))

            yield Anchor("joint axis", turned, ((0.0, 0.0, 0.0),), lambda t, j=joint:  # type: ignore[misc]
                         f"axis of joint {j.name!r} turned by {_numbers(np.degrees(t))} deg", "check the axes",
                         target=joint.name)
