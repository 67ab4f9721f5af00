"""Differences of what is reported and of the geometry: motions that a known change of the true one reproduces.

Each hypothesis predicts the whole observed motion of the scene and its copies. Nothing is fitted but times.
"""

from __future__ import annotations

import dataclasses
import itertools
import math
from collections.abc import Callable, Iterator

import numpy as np

from crosscheck.diagnosis import fit, misreadings
from crosscheck.diagnosis.observe import FASTEST, REACH, Observation, Scale, Silent, Subject, rates, true_motion
from crosscheck.diagnosis.result import Evidence, NamedCause
from crosscheck.references.base import TruthError
from crosscheck.references.maximal import Maximal
from crosscheck.scene.model import GROUND, Joint, Scene
from crosscheck.scene.states import States

AGREES = 1e-8
"""Normalised: a prediction nearer than this is right, whatever the noise: scene files keep 1e-8."""

MOST_ORDERS = 4
"""Bodies of which all orders are tried."""

ROUGH, SIXTH = 0.05, math.sqrt(math.comb(12, 6))
"""Part of a difference from truth that jumps from sample to sample, from which on it is noise; and what sixth
differences make of independent errors. Those of a smooth motion, 0.05 rad apart, leave a millionth."""

THIN = 4
"""Every so manieth sample tells by how much times are off."""

SEEN = 1e-10
"""Of y: noise below this is the rounding of double precision, or the tolerance of an engine's own solver."""

FINE, TIGHT = 4, 1e-12
"""Steps per sample, or the rtol, of the runs that are looked at for noise."""

COARSER, GROWS = 4, 2.5
"""Noise is no error of the step: it does not grow so much at steps so many times as large."""

SPREAD = 100.0
"""A difference from truth of so many times the noise from sample to sample may be noise: it adds up over a run."""

SINGLE = float(np.finfo(np.float32).eps)


@dataclasses.dataclass(frozen=True)
class Told:
    """A hypothesis: the states that an engine with this mistake shows of a scene, None where it cannot be meant."""

    name: str
    detail: str
    mend: str
    show: Callable[[Scene], States | None]
    undo: Callable[[States], States] | None = None


def diagnose(observations: list[Observation]) -> tuple[list[Told], list[Evidence]]:
    """The hypotheses that reproduce what is observed, and the evidence for each that was tried."""
    found, evidence = [], []
    exact = observations[0].scale.flat(true_motion(observations[0].scene))
    before = float(np.abs(observations[0].y - exact).max())
    for told in hypotheses(observations):
        after = 0.0
        for each in observations:
            after = max(after, _gap(told, each))
            if after > 1.0:
                break
        holds = after <= 1.0
        if holds or after < 1e3:
            evidence.append(Evidence(f"{told.name}: {told.detail}", "report", before, after,
                                     "motion against the one predicted, over its noise", holds=holds))
        found += [told] if holds else []
    return found, evidence


def _gap(told: Told, each: Observation) -> float:
    """Largest difference of what is observed from what the hypothesis predicts, over what may be left.

    Most fail at the first two samples, which cost a twentieth of all.
    """
    gap = 0.0
    for count in (2, each.scene.samples):
        scene = each.scene.replace(duration=float(each.scene.t[count - 1]), samples=count)
        try:
            states = told.show(scene)
        except (TruthError, np.linalg.LinAlgError, ValueError):
            return math.inf
        left = math.inf if states is None else float(np.abs(each.y[:count] - each.scale.flat(states)).max())
        gap = left / max(AGREES, fit.EXPLAINED * each.noise) if np.isfinite(left) else math.inf
        if gap > 1.0:
            break
    return gap


def hypotheses(observations: list[Observation]) -> Iterator[Told]:
    """All of them that make sense for a scene."""
    scene = observations[0].scene
    yield from _orders(scene)
    if any(joint.child != GROUND and np.any(joint.child_anchor) for joint in scene.joints):
        for with_speed in (False, True):
            yield _at_joint(with_speed)
    yield from _geometry(scene)
    yield from _times(observations)


def _orders(scene: Scene) -> Iterator[Told]:
    count = scene.n
    if not 1 < count <= MOST_ORDERS:
        return
    for order in itertools.islice(itertools.permutations(range(count)), 1, None):
        yield _reordered(list(order), scene)


def _reordered(order: list[int], scene: Scene) -> Told:
    back = list(np.argsort(order))
    names = ", ".join(scene.bodies[k].name for k in order)
    return Told("order of bodies", f"bodies are reported in the order {names}", "report bodies in the scene's order",
                lambda given: _picked(true_motion(given), order), lambda states: _picked(states, back))


def _picked(states: States, order: list[int]) -> States:
    return States(states.t, *(getattr(states, name)[:, order] for name in ("x", "R", "v", "w")))


def _levers(scene: Scene) -> np.ndarray:
    """(n, 3) from the centre of mass to the joint that carries the body."""
    levers = np.zeros((scene.n, 3))
    for joint in scene.joints:
        if joint.child != GROUND and not levers[joint.child].any():
            levers[joint.child] = joint.child_anchor
    return levers


def _at_joint(with_speed: bool) -> Told:
    def show(scene: Scene) -> States:
        states, levers = true_motion(scene), _levers(scene)
        x = states.x + np.einsum("tnij,nj->tni", states.R, levers)
        v = states.v + np.einsum("tnij,tnj->tni", states.R, np.cross(states.w, levers)) if with_speed else states.v
        return States(states.t, x, states.R, v, states.w)

    what = "positions and velocities" if with_speed else "positions"
    return Told("position of the joint", f"{what} are those of the joint that carries the body",
                "report the centre of mass", show)


# --- geometry ---------------------------------------------------------------------------------------------------------


def _geometry(scene: Scene) -> Iterator[Told]:
    """Anchors exchanged, or with the other sign, of one joint or of all."""
    for text, change in (("anchors of parent and child swapped", lambda p, c: (c, p)),
                         ("the child's anchor with the other sign", lambda p, c: (p, -c)),
                         ("the parent's anchor with the other sign", lambda p, c: (-p, c)),
                         ("the child's anchor left out", lambda p, c: (p, 0.0 * c)),
                         ("the parent's anchor left out", lambda p, c: (0.0 * p, c))):
        scopes: list[tuple[str, tuple[int, ...]]] = []
        scopes += [(f"joint {joint.name!r}", (k,)) for k, joint in enumerate(scene.joints)]
        if len(scopes) > 1:
            scopes.append(("all joints", tuple(range(len(scene.joints)))))
        for where, which in scopes:
            yield _anchored(where, text, which, change)


def _anchored(where: str, text: str, which: tuple[int, ...],
              change: Callable[[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]]) -> Told:
    def show(scene: Scene) -> States | None:
        def changed(k: int, joint: Joint) -> Joint:
            if k not in which:
                return joint
            parent, child = change(joint.parent_anchor, joint.child_anchor)
            return dataclasses.replace(joint, parent_anchor=parent, child_anchor=child)

        made = replaced(scene, tuple(changed(k, joint) for k, joint in enumerate(scene.joints)))
        return None if made is None else true_motion(made)

    return Told("anchors", f"{where}: {text}", "check the anchors that the engine is given, and the frame they are in",
                show)


def replaced(scene: Scene, joints: tuple[Joint, ...]) -> Scene | None:
    """The scene with other joints, its bodies where these put them; None where that does not follow or is the same."""
    made = scene.replace(joints=joints)
    placed = misreadings.positions(made, scene.R0, scene.w0)
    if placed is None or all(np.array_equal(one.parent_anchor, other.parent_anchor)
                             and np.array_equal(one.child_anchor, other.child_anchor)
                             for one, other in zip(scene.joints, joints, strict=True)):
        return None
    x, v = placed
    return made.replace(bodies=tuple(dataclasses.replace(body, position=x[k], velocity=v[k])
                                     for k, body in enumerate(made.bodies)))


# --- times ------------------------------------------------------------------------------------------------------------


def _times(observations: list[Observation]) -> Iterator[Told]:
    """An offset of all times, and another pace of the clock."""
    first = observations[0]
    few = first.scene.replace(samples=len(first.y[::THIN]))
    delays = shifts(few, first.scale, first.y[::THIN])
    if delays is None:
        return
    offset, pace = float(np.median(delays[1:])), float(np.median(delays[1:] / few.t[1:]))
    for name, text, mend, times in (
            ("time offset", f"the motion of {offset:+.6g} s later", "start at the scene's start, and report each state "
             "at its time", lambda t: np.maximum(t + offset, 0.0)),
            ("time scale", f"times are those of a clock {1 + pace:.6g} as fast", "check the unit of time and the step "
             "that is really made", lambda t: (1.0 + pace) * t)):
        yield Told(name, text, mend, _shown_at(times))


def _shown_at(times: Callable[[np.ndarray], np.ndarray]) -> Callable[[Scene], States]:
    return lambda scene: at_times(scene, times(scene.t))


def at_times(scene: Scene, times: np.ndarray) -> States:
    """The true states at any times after the start, in any order."""
    grid, places = np.unique(np.concatenate([[0.0], times]), return_inverse=True)
    states = Maximal(scene).run(grid)
    keep = places[1:]
    return States(scene.t, *(getattr(states, name)[keep] for name in ("x", "R", "v", "w")))


def shifts(scene: Scene, scale: Scale, y: np.ndarray) -> np.ndarray | None:
    """(T,) by how much later the true motion passes nearest to each sample; None where it stands still."""
    delays = np.zeros(len(y))
    for _ in range(3):
        states = at_times(scene, np.maximum(scene.t + delays, 0.0))
        exact = scale.flat(states)
        slope = _slopes(scene, scale, states)
        square = np.einsum("tnk,tnk->t", slope, slope)
        if square.min() <= 1e-6 * scale.rate**2:
            return None
        delays = delays + np.einsum("tnk,tnk->t", y - exact, slope) / square
        delays = np.clip(delays, -scene.duration, scene.duration)
    return delays


def _slopes(scene: Scene, scale: Scale, states: States) -> np.ndarray:
    """dy/dt of positions and attitudes, zero for velocities, (T, n, 18)."""
    turning = np.cross(states.R, states.w[:, :, None, :]).reshape(*states.x.shape[:2], 9)
    return np.concatenate([states.v / scale.length, turning, np.zeros((*states.x.shape[:2], 6))], axis=2)


def late(subject: Subject, first: Observation) -> NamedCause | None:
    """The cause where a run's error at a finite step is that of its times, or of lines between its states."""
    scene, scale = first.scene, first.scale
    step = scene.duration / (scene.samples - 1)
    mend = "report states at the output times: let steps end on them, or use dense output of the method's order"
    try:
        raw = subject.run(scene, step)
    except Silent:
        return None
    y = scale.flat(raw.states)
    exact = scale.flat(true_motion(scene))
    error = float(np.abs(y - exact)[1:].max())
    delays = shifts(scene, scale, y)
    if delays is None or error < AGREES:
        return None
    delays[0] = 0.0
    there = scale.flat(at_times(scene, np.maximum(scene.t + delays, 0.0)))
    mean = float(np.median(delays[1:]))
    if float(np.abs(y - there)[1:].max()) <= 0.1 * error:
        steps = mean / step
        if np.abs(delays[1:] - mean).max() <= 0.1 * abs(mean):
            return NamedCause("late output" if mean < 0 else "early output", f"each sample shows the motion "
                              f"{abs(steps):.3g} steps {'before' if mean < 0 else 'after'} its time", mend)
        return NamedCause("output times", f"samples are up to {np.abs(delays).max():.3g} s from their times", mend)
    bend, _ = rates(y, scene.duration / (scene.samples - 1))
    inner = slice(2 * REACH, len(y) - 2 * REACH)
    curvature, _ = rates(bend, scene.duration / (scene.samples - 1))
    left = (y - exact)[inner]
    size = np.einsum("tnk,tnk->t", left, curvature) / np.einsum("tnk,tnk->t", curvature, curvature)
    after = float(np.abs(left - size[:, None, None] * curvature).max())
    if np.all(size >= 0) and after <= 0.2 * float(np.abs(left).max()) and np.ptp(size) > 0.2 * np.abs(size).max():
        return NamedCause("interpolated output", "errors are those of straight lines between the states of other times",
                          mend)
    return None


# --- noise ------------------------------------------------------------------------------------------------------------


@dataclasses.dataclass(frozen=True)
class Noise:
    """What jumps from sample to sample in an engine's states."""

    cause: NamedCause
    size: float  # normalised


def floor(subject: Subject, scene: Scene, scale: Scale) -> Noise | None:
    """What noise an engine's states hold at a fine step, beyond the rounding of double precision; None: no more.

    Looked at over so short a time that even the fastest motion, that of a soft joint, is smooth from sample to sample.
    """
    scene = scene.replace(duration=scene.duration / FASTEST)
    finest = scene.duration / (scene.samples - 1) / FINE
    asked = ((finest, None), (finest, None), (COARSER * finest, None)) if subject.order(scene) is not None else (
        (None, TIGHT), (None, TIGHT), (None, COARSER**2 * TIGHT))
    try:
        one, two, coarse = (subject.run(scene, *each).states for each in asked)
    except Silent:
        return None
    y, exact = scale.flat(one), scale.flat(true_motion(scene))
    size = rough(y - exact)
    again = float(np.abs(y - scale.flat(two)).max())
    mend = "compute and report in double precision, to the last digit"
    if again > SEEN:
        return Noise(NamedCause("noise", f"two equal runs differ by {again:.1e}", "make runs repeatable: no random "
                                "numbers, no race between threads"), max(size, again))
    if size <= SEEN or rough(scale.flat(coarse) - exact) > GROWS * size:
        return None
    parts = np.concatenate([getattr(one, name).ravel() for name in ("x", "R", "v", "w")])
    if np.array_equal(parts, parts.astype(np.float32).astype(float)):
        return Noise(NamedCause("precision floor", "states are numbers of single precision", mend), size)
    digits = next((k for k in range(2, 12) if np.abs(np.round(parts, k) - parts).max() <= 1e-15 * np.abs(parts).max()),
                  None)
    if digits is not None:
        return Noise(NamedCause("rounded output", f"states are rounded to {digits} decimals", mend), size)
    if 0.02 * SINGLE <= size <= 50 * SINGLE:
        return Noise(NamedCause("precision floor", f"noise of {size:.1e} from sample to sample, as single precision "
                                "leaves (float32)", mend), size)
    return Noise(NamedCause("noise", f"{size:.1e} from sample to sample", mend), size)


def rough(difference: np.ndarray) -> float:
    """Size of what jumps from sample to sample in a difference (T, n, 18); 0 where most of it is smooth."""
    sixth = np.diff(difference[1:], n=6, axis=0)
    size = float(np.sqrt(np.mean(sixth**2))) / SIXTH
    whole = float(np.sqrt(np.mean(difference**2)))
    return size if size > ROUGH * whole else 0.0
