"""Mistakes that begin later: the whole run, each interval against the true motion from the engine's own state.

The difference at the end of an interval is its defect. Earlier errors do not grow in it, so that chaos does not matter.
In a right engine it falls with the step.
"""

from __future__ import annotations

import contextlib
import dataclasses

import numpy as np

from crosscheck.diagnosis import of_output
from crosscheck.diagnosis.observe import FINER, SAMPLES, Observation, Scale, Silent, Subject, window
from crosscheck.diagnosis.result import Evidence, NamedCause
from crosscheck.references.base import TruthError
from crosscheck.scene.alterations import GONE
from crosscheck.scene.batch import integrate
from crosscheck.scene.coordinates import hinge_angles, starting
from crosscheck.scene.model import Scene
from crosscheck.scene.starts import restarted
from crosscheck.scene.states import States

INTERVALS = 25
"""Number of intervals of the whole run, each with a start of truth. They take half a second or less in most scenes."""

TURN = 0.05
"""Largest step of the whole run, in units of 1 / W."""

RTOLS = (1e-8, 1e-11)
"""Relative tolerances of the two runs of an adaptive method."""

DEFECT, ROUNDINGS = 1e-7, 1e3
"""Normalised defect, and multiple of the relative spacing of numbers, below which it may be rounding of a long run."""

COARSE = 0.1
"""Normalised defect above which a run at the step that was asked for is another motion."""

HALVINGS, SETTLED = 9, 1e-9
"""Of the steps of the true motion over an interval, and the normalised change by the last one: of order eight, what is
left is then far less."""

STUCK = 0.5
"""Least part of a defect that remains at steps `FINER` times finer, if it is no error of the step."""

ALONE = 20.0
"""Times the error of any velocity by which a pose is wrong if it jumps."""

MOST_STEPS = 12000
"""Largest number of steps of one run. A scene that needs more is looked at as far as these go."""

ONCE = 0.01
"""Part of the defect of an interval that the next one may have if what was wrong acted once."""

SHIFTED = 1e-3
"""Part of a defect that a shift of time may leave."""

CLOSER = 16
"""Factor of the samples near a defect: a number may be clamped for a short time only."""

UNCLAMPED = "leave states as large as they are"

REPEATED = 4
"""Number of samples in a row at which a clamped number is the same to the last bit."""


@dataclasses.dataclass
class Late:
    """A mistake that begins at `time` (s), with its causes if they are known."""

    time: float
    until: float  # s, the end of its first interval
    text: str
    causes: list[NamedCause]
    evidence: Evidence


def diagnose(subject: Subject, scene: Scene, scale: Scale, step: float | None) -> tuple[float, Late | None]:
    """(time (s) up to which the run was looked at, the first interval whose defect is no error of the step)."""
    order = subject.order(scene)
    sampled = scene.replace(samples=INTERVALS + 1)
    h = step if step is not None else TURN / (scale.rate * scale.fast)
    per = max(1, int(np.ceil(sampled.duration / INTERVALS / h)))
    while per * INTERVALS > MOST_STEPS and sampled.duration > 1.0 / scale.rate:
        sampled = sampled.replace(duration=0.5 * sampled.duration)
        per = max(1, int(np.ceil(sampled.duration / INTERVALS / h)))
    per = FINER * int(np.ceil(per / FINER))

    def run(finer: int, asked: Scene) -> States:
        step = None if order is None else sampled.duration / INTERVALS / (per // FINER * finer)
        states: States = subject.run(asked, step, RTOLS[finer == FINER] if order is None else None).states
        return states

    coarse: np.ndarray | None = None  # defects
    try:
        fine = run(FINER, sampled)
    except Silent as error:
        return sampled.duration, Late(0.0, 0.0, f"the whole run fails: {error}", [], Evidence(
            "whole run", "numerics", None, None, "a run over the whole scene", note=str(error)))
    before, least = 0.0, max(DEFECT, ROUNDINGS * subject.engine.eps)
    ends, gaps = _onward(sampled, scale, fine)
    for k, gap in enumerate(gaps.tolist()):
        if gap > least and k + 1 < INTERVALS and all(
                (getattr(fine, name)[k:] == getattr(fine, name)[k]).all() for name in "xRvw"):
            time, mend = float(fine.t[k]), "raise the limit of steps or time, or report such a run as failed"
            size = f"{time / (sampled.duration / INTERVALS / per):.0f} steps, " if order is not None else ""
            cause = NamedCause("step limit", f"nothing moves from t = {time:.4g} s on ({size}or less than "
                               f"{sampled.duration / INTERVALS:.2g} s later)", mend)
            return sampled.duration, Late(time, time, cause.magnitude, [cause], Evidence(
                cause.name, "report", gap, None, "defect of one interval of the whole run", cause.magnitude, True))
        if step is not None and gap > COARSE:  # whatever finer steps do
            time, mend = float(fine.t[k]), "choose a smaller step; the limit is right"
            cause = NamedCause("step too coarse", f"at steps of {step:g} s the motion from t = {time:.4g} s on is off "
                               f"by {gap:.2g} of its size within one interval", mend)
            return sampled.duration, Late(time, time, cause.magnitude, [cause], Evidence(
                cause.name, "numerics", gap, None, "defect of one interval of the whole run",
                f"from t = {time:.4g} s on, at steps of {step:g} s", True))
        if gap > least:
            try:
                coarse = _onward(sampled, scale, run(1, sampled))[1] if coarse is None else coarse
            except Silent:  # too coarse to run, so that the defect at this step counts as infinite
                coarse = np.full(INTERVALS, np.inf)
            rough = float(coarse[k])
            if gap > STUCK * rough and gap > 10 * before:
                until = min(k + 2, INTERVALS)
                closer = sampled.replace(duration=float(fine.t[until]), samples=CLOSER * until + 1)
                return sampled.duration, _described(sampled, scale, fine, k, rough, gaps, ends[k],
                                                   run(FINER, closer))
        before = max(before, gap)
    return sampled.duration, None


def _onward(scene: Scene, scale: Scale, states: States) -> tuple[np.ndarray, np.ndarray]:
    """True motions from the engine's states at the begin of each interval: y at their ends, (I, n, 18), infinite where
    there is none, and the largest differences of the engine's from it, (I,).
    """
    hinges = hinge_angles(scene, states)[:-1]
    for k in np.flatnonzero(np.isnan(hinges).any(axis=1)):  # where turns are not known, there are none
        begun = restarted(scene, states, int(k), 1.0)
        hinges[k] = hinge_angles(begun, starting(begun))[0]
    begin = States(*(getattr(states, name)[:-1] for name in "txRvw"), hinges=hinges)
    tau, later = np.diff(states.t), scale.flat(states)[1:]
    ends, last, left = np.full_like(later, np.inf), np.full_like(later, np.nan), np.arange(len(tau))
    turn = float((np.linalg.norm(begin.w, axis=-1).max(axis=1) * tau).max())
    for halvings in range(HALVINGS):
        now = np.full_like(later, np.nan)
        with np.errstate(all="ignore"), contextlib.suppress(RuntimeError, ValueError, np.linalg.LinAlgError):
            now[left] = scale.flat(integrate(scene, begin.at(left), tau[left], 2**halvings * int(turn + 2), 1)[0])
        settled = np.abs(now - last).max(axis=(1, 2)) <= SETTLED
        ends[settled], last, left = now[settled], now, np.flatnonzero(~np.isfinite(ends).all(axis=(1, 2)))
        if not len(left):
            break
    return ends, np.abs(later - ends).max(axis=(1, 2))


def _described(scene: Scene, scale: Scale, states: States, k: int, before: float, gaps: np.ndarray, end: np.ndarray,
               closer: States) -> Late:
    """The mistake that the first wrong interval shows; `closer` has `CLOSER` times as many samples near it."""
    time, after = float(states.t[k]), float(gaps[k])
    evidence = Evidence("a mistake that begins later", "report", before, after, "defect of one interval of the whole "
                        f"run, at steps {FINER} times as fine after",
                        f"between {time:.4g} s and {states.t[k + 1]:.4g} s", True)
    causes: list[NamedCause] = []
    text = f"from t = {time:.4g} s on the motion is not the scene's"
    stuck = clamped(closer, CLOSER * k)
    if stuck:
        causes.append(NamedCause("clamp", f"{stuck}, from t = {time:.4g} s on", UNCLAMPED))
    elif (delay := _delay(scene, scale, states, k)) is not None:
        name, past = ("time lost", "behind") if delay < 0 else ("time skipped", "ahead")
        causes.append(NamedCause(name, f"from t = {time:.4g} s on the motion is {abs(delay):.4g} s {past} its time",
                                 "count time and steps to the end of every interval"))
    elif np.isfinite(end).all():
        parts = np.split(np.abs(scale.flat(states)[k + 1] - end), (3, 12, 15), axis=1)
        shift, turn, speed, spin = (part.max(axis=1) for part in parts)
        body = int(np.argmax(np.maximum(turn, shift)))
        name = scene.bodies[body].name
        # Within an interval a wrong velocity changes the pose by far less. A jump changes the pose alone.
        if max(turn[body], shift[body]) > ALONE * max(spin.max(), speed.max()):
            what, size, more, mend = (
                ("attitude", turn[body], ", as it does after a wrapped angle or a lost sign of a quaternion",
                 "keep angles beyond pi and the sign of quaternions") if turn[body] > shift[body] else
                ("position", shift[body], "", "leave positions as they are"))
            causes.append(NamedCause(f"jump of {what}", f"the {what} of body {name!r} jumps by {size:.3g} at t = "
                                     f"{time:.4g} s while all velocities go on{more}", mend))
        elif k + 2 < INTERVALS and gaps[k + 1] <= ONCE * after:
            what = "angular velocity" if spin.max() > speed.max() else "velocity"
            name = scene.bodies[int(np.argmax(np.maximum(spin, speed)))].name
            causes.append(NamedCause("jump of velocity", f"the {what} of body {name!r} changes once by "
                                     f"{max(spin.max(), speed.max()):.3g} of its size between t = {time:.4g} s and "
                                     f"{states.t[k + 1]:.4g} s, and the motion goes on as it should",
                                     "look for what acts once at this time: an impact, a reset, a lost step"))
    return Late(time, float(states.t[k + 1]), text, causes, evidence)


def _delay(scene: Scene, scale: Scale, states: States, k: int) -> float | None:
    """By how much (s) the motion is ahead of its time at the end of the k-th interval, if that is all."""
    onward = restarted(scene, states, k, float(states.t[k + 1] - states.t[k]))
    y = scale.flat(States(onward.t, *(getattr(states, name)[k:k + 2] for name in "xRvw")))
    try:
        if (delays := of_output.shifts(onward, scale, y)) is None:
            return None
        right, shifted = (scale.flat(of_output.at_times(onward, np.maximum(onward.t + by, 0.0)))[1]
                          for by in (0.0, delays[1]))
    except (TruthError, np.linalg.LinAlgError, ValueError):
        return None
    return float(delays[1]) if np.abs(y[1] - shifted).max() <= SHIFTED * np.abs(y[1] - right).max() else None


def clamped(states: States, k: int = 0, rounding: float = 0.0) -> str | None:
    """In words, the number that stays the same to `rounding` after the k-th sample although it moved before.

    Without k, although it moves at all: a number that follows from smooth equations is constant always or never.
    """
    for name, what in (("w", "an angular velocity"), ("v", "a velocity"), ("x", "a position")):
        values = getattr(states, name).reshape(len(states.t), -1)
        steady = np.abs(np.diff(values[k:], axis=0)) <= rounding * np.abs(values).max()
        still = np.lib.stride_tricks.sliding_window_view(steady, REPEATED - 1, axis=0)
        same = still.all(axis=-1) & (values[:k + 1 if k else None].std(axis=0) > GONE * np.abs(values).max())
        if same.any():
            at, index = np.argwhere(same)[0]
            return f"{what} stays at {values[k + at, index]:.6g}"
    return None


def observation(subject: Subject, scene: Scene, scale: Scale, time: float) -> Observation | None:
    """The engine's limit from the time (s) on, as part of a run from the scene's start; None if that is too long."""
    brief = window(scene, scale).duration
    interval = brief / (SAMPLES - 1)
    start = int(np.ceil(time / interval)) + 1
    whole = scene.replace(duration=(start + SAMPLES - 1) * interval, samples=start + SAMPLES)
    order = subject.order(scene)
    counts = (2, 4) if (order or 4) >= 4 else (8, 16)
    if (order is not None and counts[-1] * start > MOST_STEPS) or whole.duration > scene.duration:
        return None
    sizes = [(None, rtol) for rtol in RTOLS] if order is None else [(interval / count, None) for count in counts]
    rough, fine = (scale.flat(subject.run(whole, *size).states) for size in sizes)
    gain = 0.0 if order is None else 1.0 / (2.0**order - 1.0)
    y = fine + gain * (fine - rough)
    noise = float(np.abs(fine - rough)[start:].max()) * max(gain, 0.1) + 1e-12
    begun = restarted(scene, scale.states(whole.t, y), start, brief, SAMPLES)
    return Observation(begun, scale, y[start:], noise, None)
