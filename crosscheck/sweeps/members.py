"""The scenes of a sweep: a start for every point of the parameter grid, and perturbed members around each start."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator

import numpy as np

from crosscheck.errors import SceneError
from crosscheck.scene import coordinates
from crosscheck.scene.assembly import projected
from crosscheck.scene.model import Joint, Scene, quaternion_from_turn, quaternion_product
from crosscheck.scene.paths import changed, content_of, number_at, read
from crosscheck.scene.schema import Content, EntryError
from crosscheck.scene.starts import Configuration, at_coordinates, bodies_at
from crosscheck.sweeps.plan import PERTURBED, Origin, Perturbation, Plan, Value


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
    freedoms = sum(map(_freedoms, scene.joints))
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
    return scene if moved is None else _wound(scene, _closed(scene, moved))


def _closed(scene: Scene, moved: Scene) -> Scene:
    try:
        return projected(scene, moved)
    except EntryError as error:
        raise SceneError(f"{scene.name!r}: a perturbed state cannot be projected onto the joints ({error}); take a "
                         "smaller perturbation") from None


def _wound(scene: Scene, member: Scene) -> Scene:
    """The member with the whole turns that its angles have in the scene, where a perturbation goes beyond half a turn.
    """
    before, after = coordinates.at_start(scene), coordinates.at_start(member)
    beyond = [name for name, (position, _) in after.items()
              if len(position) < 4 and np.abs(position - before[name][0]).max() > np.pi]
    return member if not beyond else member.replace(joints=tuple(
        dataclasses.replace(joint, start=tuple(before[joint.name][0].tolist())) if joint.name in beyond else joint
        for joint in member.joints))


def _moved(scene: Scene, drawn: dict[str, np.ndarray]) -> Scene | None:
    """The scene with perturbed states, before the joints are closed; None if no state is perturbed."""
    if not drawn.keys() & set(PERTURBED):
        return None
    if drawn.keys() & {"joint_position", "joint_velocity"}:
        scene = scene.replace(bodies=bodies_at(scene, at_coordinates(scene, _coordinates(scene, drawn))))
    q, w = np.array([body.attitude for body in scene.bodies]), scene.w0
    if "attitude" in drawn:
        q = quaternion_product(q, quaternion_from_turn(drawn["attitude"].reshape(-1, 3)))
    if "angular_velocity" in drawn:
        w = w + drawn["angular_velocity"].reshape(-1, 3)
    q /= np.linalg.norm(q, axis=1, keepdims=True)
    return scene.replace(bodies=bodies_at(scene, Configuration(scene.x0, q, scene.v0, w)))


def _coordinates(scene: Scene, drawn: dict[str, np.ndarray]) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Coordinates and rates of every joint that has them, perturbed; a ball turns in its child's axes.

    What follows another joint or a drive has no perturbation of its own.
    """
    counts = [_freedoms(joint) for joint in scene.joints]
    changes: list[dict[str, np.ndarray]] = []
    for name in ("joint_position", "joint_velocity"):
        parts = np.split(drawn.get(name, np.zeros(sum(counts))), np.cumsum(counts)[:-1])
        changes.append({joint.name: part * (joint.drive is None)
                        for joint, part in zip(scene.joints, parts, strict=True)})
    joints = {joint.name: joint for joint in scene.joints}

    def change(joint: Joint, of: dict[str, np.ndarray]) -> np.ndarray:
        return of[joint.name] if joint.mimic is None else joint.mimic.ratio * change(joints[joint.mimic.joint], of)

    made = {}
    for name, (position, rates) in coordinates.at_start(scene).items():
        shift, push = (change(joints[name], of) for of in changes)
        ball = joints[name].kind.is_ball
        made[name] = (quaternion_product(position, quaternion_from_turn(shift)) if ball else position + shift,
                      rates + push)
    return made


def _freedoms(joint: Joint) -> int:
    """How many numbers perturb its position, and its velocity."""
    return 3 if joint.kind.is_ball else len(joint.kind.coordinates)
