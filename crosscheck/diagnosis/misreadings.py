"""Misread initial states and misreported states: conventions of quaternions, and frames of velocities.

Misreadings have no magnitude: one of them reproduces the engine's output to rounding, or none does. Attitudes are
misread either as the scene has them or relative to the parent, as in joint coordinates.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import numpy as np

from crosscheck.diagnosis.observe import Observation
from crosscheck.scene.model import GROUND, Joint, Scene, quaternion_from_rotation, rotation_from_quaternion
from crosscheck.scene.starts import started
from crosscheck.scene.states import States

TURNING = ("spherical",)
"""Types of joints with an attitude of their own, which can be misread. A hinge has an angle."""

Pose = tuple[np.ndarray, np.ndarray]
"""Attitudes (n, 3, 3) and body angular velocities (n, 3)."""


def rolled(R: np.ndarray, shift: int) -> np.ndarray:
    """The rotations (..., 3, 3) that follow if the four numbers of the quaternions of R are read `shift` places on."""
    return rotation_from_quaternion(np.roll(quaternion_from_rotation(R), shift, axis=-1))


@dataclasses.dataclass(frozen=True)
class Misreading:
    """One way to misread the attitudes or the angular velocities of a scene."""

    cause: str
    detail: str
    attitude: Callable[[np.ndarray], np.ndarray] | None = None  # of one attitude or relative attitude
    relative: bool = False  # whether it acts on attitudes relative to the parent
    spin: Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray] | None = None
    """(w, R, w of the parent in the child's axes) -> w, body axes."""


ORDER, CONJUGATE, FRAME = "quaternion order", "quaternion conjugated", "velocity frame"

ATTITUDES = tuple(
    Misreading(cause, f"{text} {'relative to the parent' if relative else 'of the bodies'}", read, relative)
    for relative in (False, True)
    for cause, text, read in (
        (ORDER, "x, y, z, w read as w, x, y, z, in attitudes", lambda R: rolled(R, 1)),
        (ORDER, "w, x, y, z read as x, y, z, w, in attitudes", lambda R: rolled(R, -1)),
        (CONJUGATE, "the inverse of attitudes", lambda R: R.T)))

SPINS = (
    Misreading(FRAME, "angular velocities in body axes read as in world axes", spin=lambda w, R, p: R.T @ w),
    Misreading(FRAME, "angular velocities in body axes turned to world axes and read as in body axes",
               spin=lambda w, R, p: R @ w),
    Misreading(FRAME, "angular velocities read as relative to the parent", spin=lambda w, R, p: w + p),
    Misreading(FRAME, "the parent's angular velocity subtracted once too often", spin=lambda w, R, p: w - p),
)


MODES = ("bodies", "joints", "before", "joints before", "joints after")
"""What stays right when attitudes are misread: angular velocities of the bodies, or those across the joints. "before":
velocities are converted by the right attitudes; "after": by the misread ones, which have changed them already."""


def misread(scene: Scene, attitude: Misreading | None, spin: Misreading | None, mode: str = "bodies") -> Pose:
    """Attitudes and angular velocities after misreadings, computed from parents to children; `mode` is one of `MODES`.

    A body on a hinge keeps its angle and its rate, since joint coordinates have no quaternion there.
    """
    if mode == "joints before":
        R, w = misread(scene, None, spin)
        return misread(started(scene, scene.x0, R, scene.v0, w), attitude, None, "joints")
    if mode == "joints after":
        R, w = misread(scene, attitude, None, "joints")
        return misread(started(scene, scene.x0, R, scene.v0, w), None, spin)
    joints = {joint.child: joint for joint in scene.joints}
    R, w = scene.R0.copy(), scene.w0.copy()
    for body in parents_first(scene):
        joint = joints.get(body)
        parent = GROUND if joint is None else joint.parent
        before = np.eye(3) if parent == GROUND else scene.R0[parent]
        after = np.eye(3) if parent == GROUND else R[parent]
        between = before.T @ scene.R0[body]
        own = scene.w0[body] - (0.0 if parent == GROUND else between.T @ scene.w0[parent])
        if joint is not None and joint.type not in TURNING:
            R[body] = after @ between
            w[body] = own + (0.0 if parent == GROUND else between.T @ w[parent])
            continue
        if attitude is not None and attitude.attitude is not None:
            R[body] = after @ attitude.attitude(between) if attitude.relative else attitude.attitude(scene.R0[body])
        if mode == "joints" and parent != GROUND:
            w[body] = own + R[body].T @ after @ w[parent]
        if spin is not None and spin.spin is not None:
            frame, base = (scene.R0[body], before) if mode == "before" else (R[body], after)
            carried = np.zeros(3) if parent == GROUND else frame.T @ base @ scene.w0[parent]
            w[body] = spin.spin(scene.w0[body], frame, carried)
    return R, w


def parents_first(scene: Scene) -> list[int]:
    """The numbers of the bodies, each after those that carry it."""
    parent = {joint.child: joint.parent for joint in scene.joints}
    def depth(body: int) -> int:
        steps = 0
        while body in parent and parent[body] != GROUND and steps <= scene.n:
            body, steps = parent[body], steps + 1
        return steps
    return sorted(range(scene.n), key=depth)


def positions(scene: Scene, R: np.ndarray, w: np.ndarray) -> tuple[np.ndarray, np.ndarray] | None:
    """Positions and velocities (m, m/s, each (n, 3)) that follow from attitudes and angular velocities.

    None if the scene has joints whose anchors do not coincide.
    """
    joints: dict[int, Joint] = {joint.child: joint for joint in scene.joints}
    if any(not joint.kind.anchors_coincide or joint.child == GROUND for joint in scene.joints):
        return None
    x, v = scene.x0.copy(), scene.v0.copy()
    for body in parents_first(scene):
        joint = joints.get(body)
        if joint is None:
            continue
        point, speed = joint.parent_anchor, np.zeros(3)
        if joint.parent != GROUND:
            point = x[joint.parent] + R[joint.parent] @ joint.parent_anchor
            speed = v[joint.parent] + R[joint.parent] @ np.cross(w[joint.parent], joint.parent_anchor)
        x[body] = point - R[body] @ joint.child_anchor
        v[body] = speed - R[body] @ np.cross(w[body], joint.child_anchor)
    return x, v


def placed(scene: Scene) -> Scene | None:
    """The scene with its bodies where its joints put them; None if `positions` gives none."""
    moved = positions(scene, scene.R0, scene.w0)
    return None if moved is None else started(scene, moved[0], scene.R0, moved[1], scene.w0)


def gap(observation: Observation, R: np.ndarray, w: np.ndarray, absent: int | None = None) -> float:
    """Largest normalised difference between the start of an engine and this one, without the body `absent`."""
    scene, scale = observation.scene, observation.scale
    start = observation.y[0]
    closed = positions(scene, R, w)
    x, v = closed if closed is not None else (scene.x0, scene.v0)
    wanted = scale.flat(States(np.zeros(1), x[None], R[None], v[None], w[None]))[0]
    used = slice(0, 18) if closed is not None or np.allclose(R, scene.R0) else slice(3, 12)
    difference = np.abs(start - wanted)[:, used]
    if absent is not None:
        difference = np.delete(difference, absent, axis=0)
    return float(difference.max(initial=0.0))


@dataclasses.dataclass(frozen=True)
class Report:
    """One way to misreport states; `undo` restores the right ones."""

    cause: str
    detail: str
    undo: Callable[[States], States]


REPORTS = (
    Report(FRAME, "angular velocities are reported in world axes",
           lambda s: dataclasses.replace(s, w=np.einsum("tnji,tnj->tni", s.R, s.w))),
    Report(CONJUGATE, "attitudes are reported inverted (world to body)",
           lambda s: dataclasses.replace(s, R=np.swapaxes(s.R, -1, -2))),
    Report(FRAME, "velocities are reported in body axes",
           lambda s: dataclasses.replace(s, v=np.einsum("tnij,tnj->tni", s.R, s.v))),
)
