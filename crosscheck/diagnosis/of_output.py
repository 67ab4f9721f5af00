"""Differences of the output: motions that follow from the true one by a known change.

Each hypothesis predicts the whole observed motion of the scene and its copies. Only points and times are fitted.
"""

from __future__ import annotations

import dataclasses
import functools
import itertools
import math
from collections.abc import Callable, Iterator, Sequence
from typing import NamedTuple

import numpy as np

from crosscheck.diagnosis import fit
from crosscheck.diagnosis.observe import FASTEST, FINER, REACH, RTOLS, Observation, Scale, Subject, rates, true_motion
from crosscheck.diagnosis.result import Evidence, Explanation, NamedCause
from crosscheck.references.maximal import Maximal
from crosscheck.scene.alterations import FAILS, GONE
from crosscheck.scene.altered import levers
from crosscheck.scene.model import GROUND, Scene
from crosscheck.scene.starts import ALLOWED_VIOLATION
from crosscheck.scene.states import States

MOST_ORDERS = 4
"""Largest number of bodies of which all orders are tried."""

ROUGH, SIXTH = 0.05, math.sqrt(math.comb(12, 6))
"""Part of a difference from truth that has to jump from sample to sample for it to be noise, and the factor by which
sixth differences magnify independent errors. Samples of a smooth motion 0.05 rad apart leave a millionth."""

LATER = 0.1
"""Relative difference of delays that makes two of them."""

STRAIGHT = 0.01
"""Share of the true bend of a motion below which samples lie on a straight line."""

THIN = 4
"""Errors of times are estimated from one in so many samples."""

SEEN = 1e-10
"""Noise of y below which it is rounding in double precision, or the tolerance of the engine's own solver."""

GROWS = 2.5
"""Growth at steps `FINER` times as large above which the difference is an error of the step and not noise."""

SPREAD = 100.0
"""Times the noise between samples that a difference from truth may reach by noise alone, which adds up over a run."""

MOST_ROUNDINGS = 50
"""Times the relative spacing of numbers that the noise of arithmetic in these numbers may reach."""

MOST_DIGITS = 7
"""Number of decimals of a second below which rounded times are looked for."""

AT_TIMES = "report states at the output times: let steps end on them, or use dense output of the method's order"

SINGLE = float(np.finfo(np.float32).eps)


def diagnose(observations: list[Observation], answer: Explanation) -> bool:
    """Whether a hypothesis reproduces all observations. Those that do are named together."""
    named = []
    first = observations[0]
    before = float(np.abs(first.y - first.scale.flat(true_motion(first.scene))).max()) / _open(first)
    if len(observations) == 1 and before <= 1.0:
        return False  # this part of the motion is right
    for cause in hypotheses(first):
        answer.tried += 1
        after, holds = 0.0, True
        for each in observations:
            after = max(after, _left(cause, each))
            holds = after <= min(1.0, fit.CLEAR * before if each is first else 1.0)
            if not holds:
                break
        if holds or after < 1e3:
            answer.evidence.append(Evidence(f"{cause.name}: {cause.words}", "report", before, after,
                                            "motion against the one predicted, over its noise", holds=holds))
        named += [cause] if holds else []
    if named:
        answer.causes.append(NamedCause(" or ".join(sorted({each.name for each in named})),
                                        ", or equally ".join(each.words for each in named), named[0].mend))
    return bool(named)


def _open(each: Observation) -> float:
    """What noise may leave of y."""
    return max(ALLOWED_VIOLATION, fit.EXPLAINED * each.noise)


class Reported(NamedTuple):
    """A cause, in words, with the states of a scene that are then reported."""

    name: str
    words: str
    mend: str
    states: Callable[[Scene], States]


def _left(cause: Reported, each: Observation) -> float:
    """Largest difference between observation and prediction, over what noise may leave."""
    try:
        left = float(np.abs(each.y - each.scale.flat(cause.states(each.scene))).max())
    except FAILS:
        return math.inf
    return left / _open(each) if np.isfinite(left) else math.inf


def _reported(name: str, words: str, mend: str, change: Callable[[States], States]) -> Reported:
    """That of the true states, changed."""
    return Reported(name, words, mend, lambda scene: change(true_motion(scene)))


def hypotheses(first: Observation) -> Iterator[Reported]:
    """All of the output that make sense for the scene. Points, axes and times are those that the first one shows."""
    scene = first.scene
    if 1 < scene.n <= MOST_ORDERS:
        for order in list(itertools.permutations(range(scene.n)))[1:]:
            yield _reported("order of bodies", "bodies are reported in the order " + ", ".join(
                scene.bodies[k].name for k in order), "report bodies in the scene's order",
                lambda states, order=order: picked(states, order))  # type: ignore[misc]
    yield from _points(first)
    yield from _attitudes(first)
    yield from _filtered(first)
    yield from _times(first)


def picked(states: States, order: Sequence[int]) -> States:
    """States with the bodies in another order."""
    return States(states.t, *(getattr(states, name)[:, order] for name in ("x", "R", "v", "w")))


def _points(first: Observation) -> Iterator[Reported]:
    """Positions of other points of the bodies than their centres of mass, or from another origin."""
    scene, exact = first.scene, true_motion(first.scene)
    off = first.states.x - exact.x
    away, s = off.mean(axis=(0, 1)), np.einsum("tnji,tnj->ni", exact.R, off) / len(off)
    joint = np.abs(s - levers(scene)).max() <= GONE * first.scale.length
    fitted = ", ".join(_vector(each) for each in s)
    name, text = ("position of the joint", "the joint that carries the body") if joint else (
        "position of another point", f"points off by {fitted} m from the centres of mass, body axes")
    s = levers(scene) if joint else s

    def at_points(states: States, with_speed: bool) -> States:
        x = states.x + np.einsum("tnij,nj->tni", states.R, s)
        v = states.v + np.einsum("tnij,tnj->tni", states.R, np.cross(states.w, s)) if with_speed else states.v
        return States(states.t, x, states.R, v, states.w)

    for quantity, with_speed in (("positions", False), ("positions and velocities", True)):
        yield _reported(name, f"{quantity} are those of {text}", "report the centre of mass",
                        lambda states, with_speed=with_speed: at_points(states, with_speed))  # type: ignore[misc]
    grounded = any(joint.parent == GROUND for joint in scene.joints)
    yield _reported("anchors or origin of positions" if grounded else "origin of positions",
                    f"all positions are off by {_vector(away)} m", "check the origin of the world, and where joints "
                    "hold on the ground", lambda states: dataclasses.replace(states, x=states.x + away))


def _attitudes(first: Observation) -> Iterator[Reported]:
    """Attitudes that are turned by a constant in each body, or mirrored."""
    scene, exact = first.scene, true_motion(first.scene)

    def turned(name: str, detail: str, R: Callable[[np.ndarray], np.ndarray],
               w: Callable[[np.ndarray], np.ndarray]) -> Reported:
        return _reported(name, detail, "report the attitude of the body axes of the scene, in its world axes",
                         lambda states: dataclasses.replace(states, R=R(states.R), w=w(states.w)))

    U, _, V = np.linalg.svd(np.mean(np.swapaxes(exact.R, -1, -2) @ first.states.R, axis=0))
    Q = U @ V
    cosines = np.clip((np.trace(Q, axis1=1, axis2=2) - 1) / 2, -1, 1)
    angles = [f"body {body.name!r} by {np.degrees(np.arccos(cosine)):.5g} deg"
              for body, cosine in zip(scene.bodies, cosines, strict=True) if cosine < 1 - ALLOWED_VIOLATION]
    for text, spin in (("", lambda w: w), (", with its angular velocity", lambda w: np.einsum("nji,tnj->tni", Q, w))):
        if angles and np.linalg.det(Q).min() > 0:
            yield turned("turned attitude", "; ".join(angles) + text, lambda R: R @ Q, spin)
    for axis, letter in enumerate("xyz"):
        S = np.diag([-1.0 if k == axis else 1.0 for k in range(3)])
        for text, change in (("in world and body axes", lambda R, S=S: S @ R @ S),
                             ("in world axes", lambda R, S=S: S @ R), ("in body axes", lambda R, S=S: R @ S)):
            for more, spin in (("", lambda w: w), (", with angular velocities", lambda w, S=S: -w @ S)):
                yield turned("mirrored attitude", f"{letter} has the other sign {text}{more}", change, spin)


def _filtered(first: Observation) -> Iterator[Reported]:
    """Velocities that lag by a time tau behind the motion: v - tau a."""
    true = true_motion(first.scene)
    for names, text in ((("v", "w"), "all velocities"), (("v",), "velocities"), (("w",), "angular velocities")):
        def filtered(tau: float, states: States, names: tuple[str, ...] = names) -> States:
            rates = {"v": states.a, "w": states.alpha}
            return dataclasses.replace(states, **{
                name: getattr(states, name) - tau * np.asarray(rates[name]) for name in names})

        exact, late, given = (np.concatenate([getattr(each, name).ravel() for name in names]) for each in (
            true, filtered(1.0, true), first.states))
        slopes = late - exact
        tau = float(slopes @ (given - exact) / max(float(slopes @ slopes), 1e-300))
        if abs(tau) * first.scale.rate > ALLOWED_VIOLATION:
            yield _reported("filtered velocity", f"{text} are those of v - tau dv/dt, tau = {tau:.5g} s", "report the "
                            "velocities of the state, not of a filter or of a difference of positions",
                            functools.partial(filtered, tau))


def _vector(values: np.ndarray) -> str:
    return f"({', '.join(f'{value:.5g}' for value in values)})"


# --- times ------------------------------------------------------------------------------------------------------------


def _times(first: Observation) -> Iterator[Reported]:
    """An offset of all times, and a clock that runs at another pace."""
    few = first.scene.replace(samples=len(first.y[::THIN]))
    delays = shifts(few, first.scale, first.y[::THIN])
    if delays is None:
        return
    middle, last, pace = *(float(each) for each in (np.median(delays[1:]), delays[-1])), float(np.median(
        delays[1:] / few.t[1:]))
    # A motion that starts late, and rests in half of the samples, has the delay of the last one.
    for offset in (middle, last) if abs(last - middle) > LATER * abs(last) else (middle,):
        words = (f"it stands still in the first {-offset:.6g} s, at least" if offset <= (GONE - 1.0) * few.duration else
                 f"the motion of {offset:+.6g} s later")
        yield Reported("time offset", words, "start at the scene's start, and report each state at its time",
                       lambda scene, by=offset: at_times(scene, np.maximum(scene.t + by, 0.0)))  # type: ignore[misc]
    if pace > GONE - 1.0:
        yield Reported("time scale", f"times are those of a clock {1 + pace:.6g} as fast", "check the unit of time and "
                       "the step that is really made", lambda scene: at_times(scene, (1.0 + pace) * scene.t))


def at_times(scene: Scene, times: np.ndarray) -> States:
    """The true states at these times (s), in any order."""
    grid, places = np.unique(np.concatenate([[0.0], times]), return_inverse=True)
    states = Maximal(scene).run(grid)
    keep = places[1:]
    return States(scene.t, *(getattr(states, name)[keep] for name in ("x", "R", "v", "w")))


def shifts(scene: Scene, scale: Scale, y: np.ndarray) -> np.ndarray | None:
    """Delays (s), (T,), after which the true motion comes nearest to each sample; None if it stands still."""
    delays = np.zeros(len(y))
    for _ in range(3):
        states = at_times(scene, np.maximum(scene.t + delays, 0.0))
        exact = scale.flat(states)
        turning = np.cross(states.R, states.w[:, :, None, :]).reshape(*states.x.shape[:2], 9)
        slope = np.concatenate([states.v / scale.length, turning, 0.0 * exact[:, :, 12:]], axis=2)  # none of velocities
        square = np.einsum("tnk,tnk->t", slope, slope)
        if square.min() <= 1e-6 * scale.rate**2:
            return None
        delays = delays + np.einsum("tnk,tnk->t", y - exact, slope) / square
        delays = np.clip(delays, -scene.duration, scene.duration)
    return delays


def late(subject: Subject, first: Observation) -> NamedCause | None:
    """The cause if the error at a finite step is one of times: of the outputs, or of functions of time."""
    scene, scale = first.scene, first.scale
    y, exact = (scale.flat(each) for each in (subject.run(scene, scene.interval).states, true_motion(scene)))
    return _late_output(scene, scale, y, exact) or (_late_drive(scene, scale, y, exact) if scene.timed else None)


def _late_output(scene: Scene, scale: Scale, y: np.ndarray, exact: np.ndarray) -> NamedCause | None:
    """States at other times, or interpolated between states."""
    error = float(np.abs(y - exact)[1:].max())
    delays = shifts(scene, scale, y)
    if delays is None or error < ALLOWED_VIOLATION:
        return None
    delays[0] = 0.0
    there = scale.flat(at_times(scene, np.maximum(scene.t + delays, 0.0)))
    mean = float(np.median(delays[1:]))
    if float(np.abs(y - there)[1:].max()) <= 0.1 * error:
        steps = mean / scene.interval
        if np.abs(delays[1:] - mean).max() <= 0.1 * abs(mean):
            return NamedCause("late output" if mean < 0 else "early output", f"each sample shows the motion "
                              f"{abs(steps):.3g} steps {'before' if mean < 0 else 'after'} its time", AT_TIMES)
        return NamedCause("output times", f"samples are up to {np.abs(delays).max():.3g} s from their times", AT_TIMES)
    bend, _ = rates(y, scene.interval)
    inner = slice(2 * REACH, len(y) - 2 * REACH)
    curvature, _ = rates(bend, scene.interval)
    left = (y - exact)[inner]
    size = np.einsum("tnk,tnk->t", left, curvature) / np.einsum("tnk,tnk->t", curvature, curvature)
    after = float(np.abs(left - size[:, None, None] * curvature).max())
    if np.all(size >= 0) and after <= fit.CLEAR * float(np.abs(left).max()) and np.ptp(size) > 0.2 * np.abs(size).max():
        return NamedCause("interpolated output", "errors are those of straight lines between the states of other times",
                          AT_TIMES)
    return None


def _late_drive(scene: Scene, scale: Scale, y: np.ndarray, exact: np.ndarray) -> NamedCause | None:
    """Functions of time which come late by a part of the step."""
    for which in (None, *(k for k, force in enumerate(scene.forces) if force.functions)):
        def delayed(part: float, which: int | None = which) -> np.ndarray:
            given = scene.delayed(part * scene.interval)
            if which is not None:
                given = scene.replace(forces=(*scene.forces[:which], given.forces[which], *scene.forces[which + 1:]))
            return scale.flat(true_motion(given))

        part = 1.0
        for _ in range(3):  # the change is nearly linear in the delay
            change = delayed(part) - exact
            part *= float(np.sum(change * (y - exact)) / max(float(np.sum(change**2)), 1e-300))
        if np.abs(y - delayed(part)).max() <= 0.1 * np.abs(y - exact).max():
            where = "functions of time come" if which is None else f"the function of time of forces[{which}] comes"
            return NamedCause("delay of a drive", f"{where} {part:.3g} steps late", "evaluate what depends on time at "
                              "the times of the stages, not at the start of a step or of the one before")
    return None


# --- noise ------------------------------------------------------------------------------------------------------------


@dataclasses.dataclass(frozen=True)
class Noise:
    """Noise from sample to sample in an engine's states."""

    cause: NamedCause | None  # None: the engine declares numbers of this precision
    size: float  # normalised


def floor(subject: Subject, scene: Scene, scale: Scale) -> Noise | None:
    """The noise of an engine's states at a fine step; None if it is no more than rounding in double precision.

    The time is so short that even the fastest motion, that of a soft joint, is smooth from sample to sample.
    """
    scene = scene.replace(duration=scene.duration / FASTEST)
    finest = scene.interval / FINER
    asked = ((finest, None), (finest, None), (FINER * finest, None)) if subject.order(scene) is not None else (
        (None, RTOLS[1]), (None, RTOLS[1]), (None, FINER**2 * RTOLS[1]))
    one, two, coarse = (subject.run(scene, *each).states for each in asked)
    y, exact = scale.flat(one), scale.flat(true_motion(scene))
    size = rough(y - exact)
    again = float(np.abs(y - scale.flat(two)).max())
    declared = subject.engine.eps
    if max(size, again) <= MOST_ROUNDINGS * declared and declared > SEEN:
        return Noise(None, max(size, again, declared))
    if again > SEEN:
        return Noise(NamedCause("noise", f"two equal runs differ by {again:.1e}", "make runs repeatable: no random "
                                "numbers, no race between threads"), max(size, again))
    if size <= SEEN or rough(scale.flat(coarse) - exact) > GROWS * size:
        return None
    return Noise(between_samples(y, exact) or _rounded_times(scene, scale, y, size) or _rounded(one, size), size)


def _rounded_times(scene: Scene, scale: Scale, y: np.ndarray, size: float) -> NamedCause | None:
    """States of times with few decimals."""
    ways = ("rounded", np.round), ("cut off", lambda times, digits: np.floor(times * 10.0**digits) / 10.0**digits)
    for digits, (text, cut) in itertools.product(range(1, MOST_DIGITS), ways):
        if np.abs(y - scale.flat(at_times(scene, cut(scene.t, digits)))).max() <= 0.01 * size:
            return NamedCause("rounded times", f"states are those of times {text} to {digits} decimals of a second",
                              "report each state at its time")
    return None


def _rounded(states: States, size: float) -> NamedCause:
    """What makes noise of this size in states."""
    parts = np.concatenate([getattr(states, name).ravel() for name in "xRvw"])
    digits = next((k for k in range(2, 12) if np.abs(np.round(parts, k) - parts).max() <= 1e-15 * np.abs(parts).max()),
                  None)
    name, words = "noise", f"{size:.1e} from sample to sample"
    if np.array_equal(parts, parts.astype(np.float32).astype(float)):
        name, words = "precision floor", "states are numbers of single precision"
    elif digits is not None:
        name, words = "rounded output", f"states are rounded to {digits} decimals"
    elif 0.02 * SINGLE <= size <= MOST_ROUNDINGS * SINGLE:
        name, words = "precision floor", f"noise of {words}, as single precision leaves (float32)"
    return NamedCause(name, words, "compute and report in double precision, to the last digit")


def between_samples(y: np.ndarray, exact: np.ndarray) -> NamedCause | None:
    """The cause if samples repeat the one before, or lie on straight lines between a few others."""
    repeated = np.all(np.diff(y, axis=0) == 0.0, axis=(1, 2))
    if repeated.any() and np.abs(y - exact)[1:][~repeated].max() <= STRAIGHT * np.abs(y - exact)[1:][repeated].max():
        return NamedCause("dropped sample", f"{np.count_nonzero(repeated)} of {len(repeated)} samples repeat the one "
                          "before, all others are right", "report the state of every output time")
    bends, true = (np.abs(np.diff(each, 2, axis=0)).max(axis=(1, 2)) for each in (y, exact))
    straight = bends <= STRAIGHT * true
    if 2 * np.count_nonzero(straight) > len(true) and np.abs(y - exact)[1:-1][~straight].max(initial=0.0) <= (
            0.1 * np.abs(y - exact).max()):
        return NamedCause("interpolated output", "most samples lie on straight lines between others", AT_TIMES)
    return None


def rough(difference: np.ndarray) -> float:
    """Size of the noise in a difference (T, n, 18); 0 if most of the difference is smooth."""
    size, whole = jumping(difference[1:])[1], float(np.sqrt(np.mean(difference**2)))
    return size if size > ROUGH * whole else 0.0


def jumping(difference: np.ndarray) -> tuple[np.ndarray, float, float]:
    """(the part of a difference (T, ...) that jumps from sample to sample, its root mean square, that of the whole)."""
    sixth = np.diff(difference, n=6, axis=0) / SIXTH
    return sixth, float(np.sqrt(np.mean(sixth**2))), float(np.sqrt(np.mean(difference**2)))
