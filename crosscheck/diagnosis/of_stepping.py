"""Differences of the stepping: orders below the documented one, hidden sub-steps, damped constraint errors.

A limit for vanishing steps does not show them. They are found by short runs at finite steps.
"""

from __future__ import annotations

import dataclasses
import itertools
import time
from typing import Any

import numpy as np

from crosscheck.compare.order import observed_order
from crosscheck.diagnosis import fit, misreadings, of_output, of_run
from crosscheck.diagnosis.observe import (
    REACH,
    SAMPLES,
    STENCIL,
    Observation,
    Scale,
    Silent,
    Subject,
    extrapolated,
    observe,
    rates,
    true_motion,
    window,
)
from crosscheck.diagnosis.of_model import Known
from crosscheck.diagnosis.result import Evidence, Explanation, NamedCause
from crosscheck.diagnosis.variants import close
from crosscheck.scene.alterations import GONE
from crosscheck.scene.constraints import Constraints
from crosscheck.scene.model import Scene
from crosscheck.scene.starts import started

COUNTS = {1: (32, 64, 128, 256), 2: (8, 16, 32, 64), 4: (4, 8, 16, 32), 5: (3, 4, 6, 8, 12), 7: (2, 3, 4, 6, 8)}
"""Steps per 1 / W from which the order follows, by documented order, or the next lower one."""

CLEAR = 0.3
"""Largest distance of the two finest slopes above rounding from one whole number, for an order to count as observed. At
coarse steps the slopes of high orders still rise, and at rounding they fall."""

FLOOR = 1e-11
"""Error of y below which it may be rounding or the tolerance of the engine's own solver."""

REFINEMENTS, REFINED = (1, 4, 16, 64, 256), 1e-9
"""Factors by which steps are refined in turn, if runs explode or show no whole number, and the error below which this
ends. The errors of a soft joint are of the documented order and hide those of a lower one until its oscillation is
resolved. Coarse steps of stiff models seem to have a lower order, so that it has to show twice."""

EXPLODED = 1.0
"""Error of y above which a run says nothing about its order: it is larger than what is computed."""

PUSH = 1e-2
"""Part of the length by which a start violates the joints, so that stabilisation shows. Constraint accelerations are
exact for the violated state. With a smaller violation noise would hide small gains."""


@dataclasses.dataclass
class Order:
    """Observed order of a method on a scene."""

    observed: float | None  # least squares over the errors above rounding
    lower: int | None  # the order they show instead of the documented one


def diagnose(subject: Subject, first: Observation, known: Known, answer: Explanation) -> None:
    """Name what makes the stepping differ from the documented one."""
    order = subject.order(first.scene)
    if order is None:
        return
    if first.order is not None and first.order < order - CLEAR and not known.altered:
        shown = answer.ask(of_output.late, subject, first)
        answer.tried += shown is None
        if shown is not None:
            answer.test(Evidence(shown.name, "report", first.order, None, f"observed order, documented {order}",
                                 shown.magnitude, True), shown.mend)
            return
    ordered = _ordered(subject, first.scene, first.scale, order)
    answer.observed_order = None if ordered is None else ordered.observed
    low = ordered is not None and ordered.lower is not None
    if ordered is not None and low:
        answer.ask(_lower_order, subject, first, order, known, ordered, answer)
    if "acceleration" in subject.held(first.scene) and not known.soft and known.model.centripetal == 1.0:
        answer.ask(_gain, subject, first, known, answer)
    if not low:
        answer.ask(_substeps, subject, first, order, answer)


def limited(subject: Subject, first: Observation) -> NamedCause | None:
    """The cause if an engine makes no steps as small as those that are asked for: two runs are the same to the bit."""
    scene = first.scene
    if subject.order(scene) is None:
        return None
    step = scene.interval / 2
    fine, finer = (subject.run(scene, size).states for size in (step, step / 2))
    once = subject.run(scene.replace(samples=2), scene.duration).states
    alike = all(np.array_equal(getattr(fine, name), getattr(finer, name)) for name in "xRvw")
    exact = np.allclose(once.x[-1], fine.x[-1], rtol=0.0, atol=REFINED * first.scale.length)  # at any step
    if not alike or exact:
        return None
    return NamedCause("step limit", f"runs at steps of {step:.3g} and {step / 2:.3g} s are the same to the last bit",
                      "make the steps that are asked for, or refuse them")


# --- order ------------------------------------------------------------------------------------------------------------


def _ordered(subject: Subject, scene: Scene, scale: Scale, order: int) -> Order | None:
    """The observed order against the method's own limit; None if runs at all steps that were tried failed."""
    brief = scene.replace(duration=1.0 / scale.rate, samples=2)
    counts = COUNTS[max(key for key in COUNTS if key <= order)]
    result, before = None, None
    for finer in REFINEMENTS:
        ladder = tuple(finer * count for count in (*counts, 2 * counts[-1]))
        try:
            runs = [scale.flat(subject.run(brief, brief.duration / count).states)[1:] for count in ladder]
        except Silent:
            continue
        if np.abs(runs[0] - runs[-1]).max() > EXPLODED:
            continue
        steps = tuple(brief.duration / count for count in ladder)
        seen = observed_order(steps[:-4:-1], runs[:-4:-1])
        limit = extrapolated(runs, ladder, int(np.clip(np.round(seen), 1, order)))
        errors = [float(np.abs(run - limit).max()) for run in runs[:-1]]
        whole = _whole(steps[:-1], errors)
        if result is None or whole is not None:
            above = [k for k, error in enumerate(errors) if error > FLOOR][:-4:-1]  # the three finest
            result = Order(observed_order([steps[k] for k in above], [runs[k] for k in above])
                           if len(above) == 3 else None,
                           whole if whole is not None and whole < order else None)
        if errors[-1] < REFINED or (whole is not None and (whole >= order or whole == before)):
            break
        before = whole
    return result


def _whole(steps: tuple[float, ...], errors: list[float]) -> int | None:
    """The whole number, at least 1, that the two finest slopes above rounding clearly show; None if there is none."""
    used = [(np.log(h), np.log(e)) for h, e in zip(steps, errors, strict=True) if e > FLOOR]
    slopes = [(one[1] - two[1]) / (one[0] - two[0]) for one, two in itertools.pairwise(used)][-2:]
    if len(slopes) < 2:
        return None
    whole = round(float(slopes[-1]))
    return whole if whole >= 1 and all(abs(slope - whole) <= CLEAR for slope in slopes) else None


def planar(scene: Scene, scale: Scale, gravity: np.ndarray) -> Scene | None:
    """A copy in which all bodies turn about one direction, so that rotations commute; None if the joints forbid it.

    The plane contains the scene's gravity and the one that the engine has. The inertias are those of spheres, so that a
    mistake in their axes does not matter.
    """
    if any(not (joint.kind.is_ball or joint.kind.turns) for joint in scene.joints) or not scene.joints:
        return None
    given = [vector / np.linalg.norm(vector) for vector in (scene.gravity, gravity) if vector.any()]
    down = given[0] if given else np.array([0.0, 0.0, -1.0])
    normal = np.cross(down, given[-1]) if given else np.zeros(3)
    if np.linalg.norm(normal) < GONE:
        normal = np.cross(down, [1.0, 0.0, 0.0] if abs(down[0]) < 0.9 else [0.0, 1.0, 0.0])
    normal /= np.linalg.norm(normal)
    flat = np.eye(3) - np.outer(normal, normal)
    bodies = [dataclasses.replace(body, inertia=np.trace(body.inertia) / 3 * np.eye(3),
                                  attitude=np.array([1.0, 0.0, 0.0, 0.0]),
                                  angular_velocity=(0.5 + 0.3 * k) * scale.rate * normal)
              for k, body in enumerate(scene.bodies)]
    joints = []
    for joint in scene.joints:
        anchors: dict[str, Any] = {"parent_anchor": flat @ joint.parent_anchor,
                                   "child_anchor": flat @ joint.child_anchor}
        if np.linalg.norm(anchors["child_anchor"]) < 0.1 * scale.length:
            anchors["child_anchor"] = 0.5 * scale.length * np.cross(normal, down)
        axes: dict[str, Any] = {} if joint.kind.is_ball else {"parent_axis": normal, "child_axis": normal}
        joints.append(dataclasses.replace(joint, **anchors, **axes))
    made = misreadings.placed(scene.replace(bodies=tuple(bodies), joints=tuple(joints)).unloaded)
    return None if made is None else close(made)


def keeps_plane(subject: Subject, copy: Scene, scale: Scale) -> bool:
    """Whether the engine turns every body of a planar copy about the normal of the plane only."""
    try:
        states = observe(subject, window(copy, scale), scale).states
    except Silent:
        return False
    normal = copy.w0[0] / np.linalg.norm(copy.w0[0])
    turns = states.R @ np.swapaxes(states.R[:1], -1, -2)
    return bool(np.abs(turns @ normal - normal).max() <= GONE)


def _lower_order(subject: Subject, first: Observation, order: int, known: Known, ordered: Order,
                 answer: Explanation) -> None:
    quantity = f"observed order, documented {order}"
    seen = first.scene.replace(duration=1.0 / first.scale.rate, samples=SAMPLES)
    try:
        stuck = of_run.clamped(subject.run(seen, seen.interval).states)
    except Silent:
        stuck = None
    if stuck is not None:  # its kink lowers the order of any method, and has no accelerations
        answer.unexplained.clear()
        answer.test(Evidence("clamp", "report", ordered.observed, None, quantity,
                             f"{stuck} in the first {seen.duration:.3g} s", True), of_run.UNCLAMPED)
        return
    copy = planar(first.scene, first.scale, known.model.scene.gravity)
    plane = None
    if copy is not None and subject.unsupported(copy) is None and keeps_plane(subject, copy, first.scale):
        plane = _ordered(subject, copy, first.scale, order)
    shown = f"order {ordered.observed:.2f} where the documentation says {order}"
    if plane is None:
        answer.test(Evidence("group update", "numerics", ordered.observed, None, quantity,
                             note="no copy on which rotations commute could be run"), "")
        answer.unexplained.append(f"{shown}, and no copy with commuting rotations to tell why")
        return
    commuting = plane.lower is None
    text = "at rounding" if plane.observed is None else f"{plane.observed:.2f}"
    for name, joined, holds, mend in (
            ("group update", "but", commuting, "move attitudes by a method of the group (Munthe-Kaas, "
             "Crouch-Grossman), not by summed velocities"),
            ("order of the step", "and", not commuting, "check the coefficients of the method, and what it is "
             "documented to be")):
        answer.test(Evidence(name, "numerics", ordered.observed, plane.observed, quantity,
                             f"{shown}, {joined} order {text} where all rotations commute", holds), mend)


# --- hidden sub-steps -------------------------------------------------------------------------------------------------


def _substeps(subject: Subject, first: Observation, order: int, answer: Explanation) -> None:
    """Name steps that the engine itself counts beyond those that were asked for."""
    brief, asked = first.scene.replace(duration=1.0 / first.scale.rate, samples=2), 4 if order == 4 else 16
    steps = subject.run(brief, brief.duration / asked).steps
    if steps > asked:
        answer.test(Evidence("hidden sub-steps", "numerics", float(asked), float(steps), "steps asked for and taken",
                             f"{steps / asked:g} steps for each that is asked for, by its own count", True),
                    "switch off adaptive or internal steps, or refuse the steps that are not made")


# --- stabilisation ----------------------------------------------------------------------------------------------------


def pushed(scene: Scene, scale: Scale) -> Scene:
    """The scene with every body moved a little out of its joints."""
    off = PUSH * scale.length * np.random.default_rng(3).uniform(-1, 1, scene.x0.shape)
    return started(scene, scene.x0 + off, scene.R0, scene.v0, scene.w0)


def _gain(subject: Subject, first: Observation, known: Known, answer: Explanation) -> None:
    """Fit G du/dt + gamma = -2 alpha G u - beta^2 Phi to the motion after a small violation of the joints."""
    scene, scale = first.scene, first.scale
    there = [joint for joint in scene.joints if known.absent not in (joint.parent, joint.child)]
    if not there or any(joint.kind.keeps_attitude for joint in there):
        return
    seen = observe(subject, pushed(scene, scale), scale)
    states, constraints = seen.states if known.undo is None else known.undo(seen.states), Constraints(scene)
    inner = slice(REACH, len(states.t) - REACH)
    x, R, v, w = (getattr(states, name)[inner] for name in ("x", "R", "v", "w"))
    rows = constraints.rows_without(known.absent)
    gaps = constraints.position(x, R)[:, rows] / scale.length
    if float(np.abs(gaps).max()) < 0.01 * PUSH:
        return  # joint coordinates and projections close the joints at once
    interval = scene.interval
    slopes, error = rates(scale.flat(states)[:, :, 12:], interval)
    a, alpha = slopes[:, :, :3] * scale.length * scale.rate, slopes[:, :, 3:] * scale.rate
    left = constraints.acceleration(x, R, v, w, a, alpha)[:, rows] / (scale.length * scale.rate**2)
    speeds = constraints.velocity(x, R, v, w)[:, rows] / (scale.length * scale.rate)
    noise = (error + np.abs(STENCIL).sum() * seen.noise / interval) / scale.rate * 10
    before = float(np.abs(left).max()) / noise
    design = np.column_stack([-2 * speeds.ravel(), -gaps.ravel()])
    (damping, stiffness), *_ = np.linalg.lstsq(design, left.ravel(), rcond=None)
    after = float(np.abs(left.ravel() - design @ [damping, stiffness]).max()) / noise
    if before <= fit.SEEN:
        return
    holds = after <= fit.EXPLAINED
    if not holds and "position" in subject.held(scene):
        return  # joint coordinates may take the anchors from the start, violated or not
    gains = f"alpha = {damping * scale.rate:.4g} 1/s, beta^2 = {stiffness * scale.rate**2:.4g} 1/s^2"
    if not answer.test(Evidence("stabilisation gain", "constraint", before, after, "constraint acceleration after a "
                                "small violation, over its noise", gains, holds), "the method is documented to enforce "
                       "accelerations exactly: set the gains to zero, or document them"):
        answer.unexplained.append("constraint errors change by no law of constant gains")


# --- rounding that adds up --------------------------------------------------------------------------------------------


# Rounding to nearest, either side alike, grows as the root of the number of steps, in another direction in every run.
# Where each step rounds to the same side, errors grow with that number.

DOUBLINGS = (64, 128, 256, 512, 1024, 2048)
"""Steps per sample interval. The errors of three in a row have to double."""

LEAST_RATIO, MOST_RATIO = 1.6, 2.7
"""Ratio of the errors at half a step and at the step. It is 2 if every step adds alike; what quaternions round differs
from run to run. Random rounding has 1.4, and what a wrong model leaves 1."""

ALONG = 0.95
"""Least cosine between the errors of two runs. Those of noise are at right angles to each other."""

PATIENCE = 5.0
"""Time (s) of one run beyond which no finer step is tried."""

ADDS_UP = "rounding that adds up"
MEND_ROUNDING = ("find what every step rounds to the same side, such as velocities that are turned there and back by "
                 "quaternions that are not quite of length one, and leave it out or compute it in double precision")


def adds_up(subject: Subject, scene: Scene, scale: Scale, answer: Explanation) -> bool:
    """Whether errors double with the number of steps and keep their direction, which is named.

    `scene` has the duration and output times of an observation. The subject has fixed steps.
    """
    exact = scale.flat(true_motion(scene))
    interval, gaps, text = scene.interval, list[np.ndarray](), ""
    for count in DOUBLINGS:
        began = time.perf_counter()
        try:
            gaps.append(scale.flat(subject.run(scene, interval / count).states) - exact)
        except Silent:
            break
        if len(gaps) >= 3 and all(_doubles(*pair) for pair in zip(gaps[-3:-1], gaps[-2:], strict=True)):
            steps = count * (scene.samples - 1)
            size, left = float(np.abs(gaps[-1]).max()), float(np.abs(gaps[-1] - 2 * gaps[-2]).max())
            text = (f"{size / steps:.1e} a step in {steps} steps, errors double with their number; any other "
                    f"difference is below {left:.1e}")
            break
        if time.perf_counter() - began > PATIENCE:
            break
    return answer.test(Evidence(ADDS_UP, "numerics", None, None, "errors at a step and at half of it", text or
                                "errors do not double with the number of steps", bool(text)), MEND_ROUNDING)


def _doubles(coarse: np.ndarray, fine: np.ndarray) -> bool:
    """Whether the error of a run (T, n, 18) is about twice that of another one, in the same direction."""
    one, two = float(np.linalg.norm(coarse)), float(np.linalg.norm(fine))
    return one > 0.0 and LEAST_RATIO <= two / one <= MOST_RATIO and float(np.vdot(coarse, fine)) >= ALONG * one * two

