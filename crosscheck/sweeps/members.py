"""The scenes of a sweep: a start for every point of the parameter grid, and perturbed members around each start."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator

import numpy as np

from crosscheck.errors import SceneError
from crosscheck.scene.assembly import projected
from crosscheck.scene.joints import JOINT_TYPES
from crosscheck.scene.model import (
    GROUND,
    Joint,
    Scene,
    quaternion_from_turn,
    quaternion_product,
    rotation_from_quaternion,
)
from crosscheck.scene.paths import changed, content_of, number_at, read
from crosscheck.scene.schema import Content, EntryError
from crosscheck.scene.starts import Configuration, bodies_at
from crosscheck.sweeps.plan import Origin, Perturbation, Plan, Value

FREEDOMS = {name: (3, 0) if kind.coordinates == ("ball",) else tuple(
    sum(word.startswith(motion) for word in kind.coordinates) for motion in ("turn", "slide"))
    for name, kind in JOINT_TYPES.items()}
"""For each type of joint, the numbers of turns and of displacements that `joint_position` and `joint_velocity` perturb.
"""


@dataclasses.dataclass(frozen=True)
class Start:
    """A scene with one combination of the parameters."""

    origin: Origin
    parameters: dict[str, Value]
    scene: Scene


def starts(plan: Plan) -> Iterator[Start]:
    """Every scene with every combination of the parameters."""
    for origin in plan.origins:
        for values in plan.grid():
            yield Start(origin, values, _changed(origin, values))


def of_start(start: Start, perturbation: Perturbation | None) -> Iterator[Scene]:
    """The members of a start. Without a perturbation this is the start itself."""
    if perturbation is None:
        yield start.scene
        return
    content = content_of(start.scene) if any("." in name for name, _ in perturbation.deviations) else {}
    sizes = _sizes(start.scene, content, perturbation)
    size = sum(sizes)
    # The same seed for all starts, so that members of different starts can be compared.
    if perturbation.sampling == "normal":  # drawn row by row, so that a larger count keeps the first members
        normals = np.random.default_rng(perturbation.seed).standard_normal((perturbation.count, size))
    else:
        from scipy.stats import norm, qmc

        hypercube = qmc.LatinHypercube(size, rng=np.random.default_rng(perturbation.seed))
        normals = np.asarray(norm.ppf(hypercube.random(perturbation.count)))
    for row in normals:
        parts = zip(perturbation.deviations, np.split(row, np.cumsum(sizes)[:-1]), strict=True)
        yield _perturbed(start.scene, content, {name: deviation * part for (name, deviation), part in parts})


def _changed(origin: Origin, values: dict[str, Value]) -> Scene:
    return changed(origin.scene, values) if values else origin.scene


def _sizes(scene: Scene, content: Content, perturbation: Perturbation) -> list[int]:
    """The number of random numbers that each perturbed quantity needs."""
    freedoms = sum(sum(FREEDOMS[joint.type]) for joint in scene.joints)
    known = {"angular_velocity": 3 * scene.n, "attitude": 3 * scene.n, "joint_position": freedoms,
             "joint_velocity": freedoms}
    return [known[name] if name in known else int(np.size(number_at(content, name)))
            for name, _ in perturbation.deviations]


def _perturbed(scene: Scene, content: Content, drawn: dict[str, np.ndarray]) -> Scene:
    """One member: change numbers of the scene file, then the state, and then project the state onto the joints."""
    changes = {}
    for name, values in drawn.items():
        if "." in name:
            now = np.array(number_at(content, name))
            relative = 1.0 + values.reshape(now.shape)
            if now.shape == (3, 3):  # an inertia stays symmetric
                relative = np.triu(relative) + np.triu(relative, 1).T
            changes[name] = (now * relative).tolist()
    if changes:
        assert scene.file is not None  # `content_of` has read it
        scene = read(content, changes, scene.file[0])
    moved = _moved(scene, drawn)
    return scene if moved is None else _closed(scene, moved)


def _closed(scene: Scene, moved: Scene) -> Scene:
    try:
        return projected(scene, moved)
    except EntryError as error:
        raise SceneError(f"{scene.name!r}: a perturbed state cannot be projected onto the joints ({error}); take a "
                         "smaller perturbation") from None


def _moved(scene: Scene, drawn: dict[str, np.ndarray]) -> Scene | None:
    """The scene with perturbed states, before the joints are closed; None if no state is perturbed."""
    x, v, w = scene.x0.copy(), scene.v0.copy(), scene.w0.copy()
    q = np.array([body.attitude for body in scene.bodies])
    R = scene.R0.copy()
    if not drawn.keys() & {"attitude", "angular_velocity", "joint_position", "joint_velocity"}:
        return None
    for name, shifts in (("joint_position", True), ("joint_velocity", False)):
        values = iter(drawn.get(name, ()))
        for joint in scene.joints if name in drawn else ():
            turn, slide = _freedom(joint, R, values)
            point = x[joint.child] + R[joint.child] @ joint.child_anchor
            for k in _beyond(scene, joint):
                if shifts:
                    x[k] = point + rotation_from_quaternion(quaternion_from_turn(turn)) @ (x[k] - point) + slide
                    q[k] = quaternion_product(quaternion_from_turn(turn), q[k])
                    R[k] = rotation_from_quaternion(q[k])
                else:
                    v[k] += np.cross(turn, x[k] - point) + slide
                    w[k] += R[k].T @ turn
    if "attitude" in drawn:
        for k, turn in enumerate(drawn["attitude"].reshape(-1, 3)):
            q[k] = quaternion_product(q[k], quaternion_from_turn(turn))
    if "angular_velocity" in drawn:
        w = w + drawn["angular_velocity"].reshape(-1, 3)
    q /= np.linalg.norm(q, axis=1, keepdims=True)
    return scene.replace(bodies=bodies_at(scene, Configuration(x, q, v, w)))


def _freedom(joint: Joint, R: np.ndarray, values: Iterator[float]) -> tuple[np.ndarray, np.ndarray]:
    """Rotation vector and displacement of a joint, in the world, from the next random numbers."""
    turns, slides = FREEDOMS[joint.type]
    angles, shifts = ([next(values) for _ in range(count)] for count in (turns, slides))
    parent = np.eye(3) if joint.parent == GROUND else R[joint.parent]
    axes = np.eye(3)
    if joint.parent_axis is not None:
        axis = parent @ joint.parent_axis
        other = np.cross(axis, np.eye(3)[np.argmin(np.abs(axis))])
        other /= np.linalg.norm(other)
        axes = np.array([axis, other, np.cross(axis, other)])
    if JOINT_TYPES[joint.type].axes == "perpendicular":
        axes = np.array([axes[0], R[joint.child] @ joint.child_axis])
    turn = sum((angle * axis for angle, axis in zip(angles, axes, strict=False)), np.zeros(3))
    along = axes[1:] if "slide n1" in JOINT_TYPES[joint.type].coordinates else axes
    return turn, sum((shift * axis for shift, axis in zip(shifts, along, strict=False)), np.zeros(3))


def _beyond(scene: Scene, joint: Joint) -> list[int]:
    """The child of a joint and all bodies connected to it by other joints, not through the ground or the parent."""
    beyond, ready = {joint.child}, [joint.child]
    while ready:
        body = ready.pop()
        for other in scene.joints:
            if other is joint or body not in (other.parent, other.child):
                continue
            end = other.child if other.parent == body else other.parent
            if end not in (GROUND, joint.parent) and end not in beyond:
                beyond.add(end)
                ready.append(end)
    return sorted(beyond)
