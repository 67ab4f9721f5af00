"""Native check: compare what every engine loads from a model file by itself with the neutral scene, in words."""

from __future__ import annotations

import dataclasses
import os
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any
from xml.etree.ElementTree import Element

import numpy as np

from crosscheck.adapters.common.native import Hinge, JointStates, Link, Native
from crosscheck.errors import CrosscheckError, SceneError
from crosscheck.inspection.native_differences import Difference, differences, named_alike
from crosscheck.scene.armature import rotors
from crosscheck.scene.coordinates import zero_attitude
from crosscheck.scene.joints import JOINT_TYPES
from crosscheck.scene.mechanics import index1
from crosscheck.scene.model import Scene, quaternion_from_rotation
from crosscheck.scene.models.words import quoted, together

DYNAMICS = ("mass matrix", "bias forces", "accelerations")
COMPARED = {"masses": ("mass", "link"), "inertias": ("inertia", "link"), "centres of mass": ("centre of mass",),
            "joints": ("joint", "type", "tree", "mimic"), "axes": ("axis",), "frames": ("frame",),
            "damping": ("damping",), "armature": ("armature",), "stiffness": ("stiffness", "rest_position"),
            "mass matrix": ("mass matrix", "armature"), "bias forces": ("bias",),
            "accelerations": ("acceleration", "damping", "mass matrix", "armature", "bias", "gravity", "mimic")}
"""What is compared, in words, with the quantities of the differences in it."""


@dataclasses.dataclass(frozen=True)
class NativeInspection:
    """The result of a native check. `refused` says for an engine that does not load the file what it said instead.

    If the file cannot be made a scene, `scene` is None, `no_scene` says why, and engines are compared with the first.
    """

    path: Path
    scene: Scene | None
    native: tuple[Native, ...]
    differences: tuple[Difference, ...]
    refused: dict[str, str]
    no_scene: str = ""

    @property
    def agree(self) -> bool:
        """Whether all engines load the file and read the same as the scene."""
        return self.scene is not None and not self.differences and not self.refused

    def of(self, engine: str) -> tuple[Difference, ...]:
        """The differences between one engine and the scene."""
        return tuple(each for each in self.differences if each.engine == engine)

    def _retried(self, engine: str) -> str:
        """What was done about a refusal, in words."""
        bare = f"{engine} without meshes"
        return f", and is shown below as {bare!r}" if any(native.engine == bare for native in self.native) else ""

    @property
    def same(self) -> tuple[str, ...]:
        """What was compared and is the same in all engines, in words."""
        told = {each.quantity for each in self.differences}
        names = tuple(joint.name for joint in self.scene.joints) if self.scene else ()
        whole = all(native.mass_matrix is not None and native.order == names for native in self.native)
        return tuple(words for words, quantities in COMPARED.items() if not told.intersection(quantities)
                     and (whole or words not in DYNAMICS))

    @property
    def lines(self) -> tuple[str, ...]:
        """The result as lines of text."""
        same = any(words.removeprefix("Error: ") in self.no_scene for words in self.refused.values())
        return (*(([] if same else [self.no_scene]) if self.scene is None else
                  [f"left out of the scene: {words}" for words in together(map(quoted, self.scene.left_out))]),
                *(f"{engine} refuses the file{self._retried(engine)}: {words}"
                  for engine, words in self.refused.items()),
                *together((str(each), each.place) for each in self.differences))


def inspect(path: str | os.PathLike[str], engines: Sequence[str] | None = None, count: int = 3, seed: int = 0,
            against: str | os.PathLike[str] | None = None) -> NativeInspection:
    """Let every engine load the file itself, and compare each with the scene of the file `against`, by default `path`.

    Joints with one coordinate are compared at their reference and at `count` random states. Raises `SceneError` if
    neither crosscheck nor an engine can read the file.
    """
    from crosscheck import adapters
    from crosscheck.adapters import built_in
    from crosscheck.scene.models import import_model
    from crosscheck.scene.models import source as sources

    source = Path(path)
    model = sources.read(source)
    outside = [name for _, name, target in sources.files(model) if target is None]
    scene, no_scene = None, None
    try:
        scene = import_model(against or path, drop=True)
    except SceneError as error:
        no_scene = error
    joints = [joint for joint in (scene.joints if scene else ()) if JOINT_TYPES[joint.type].positions == 1]
    rng = np.random.default_rng(seed)
    size = (1 + count, len(joints))
    states = JointStates(tuple(joint.name for joint in joints), rng.uniform(-0.6, 0.6, size),
                         rng.uniform(-1.0, 1.0, size))
    states.position[0], states.velocity[0] = [(joint.start or (0.0,))[0] for joint in joints], 0.0
    natives, refused = [], {}
    readers = [name for name in built_in.ENTRIES if adapters.get(name).reads_models]
    for name in readers if engines is None else engines:
        try:
            engine = adapters.get(name)
            if outside and name.startswith("mujoco"):  # MuJoCo would read files outside the model's folder
                raise sources.outside(source, outside[0])
            found = engine.native(str(source), states)
            natives.append(dataclasses.replace(found, engine=f"{name} without meshes" if found.refusal else name))
            if found.refusal:
                refused[name] = found.refusal
        except ImportError as error:
            refused[name] = f"it cannot be imported: {error}"
        except CrosscheckError as error:
            refused[name] = str(error)
    if no_scene is not None and not natives:
        raise no_scene
    neutral = _neutral(scene, states) if scene else natives[0]
    invented = frozenset(link.get("name", "") for link in model.root.findall("link")
                         if link.find("inertial") is None and link.find("collision") is not None)
    told = [each for native in natives if native is not neutral
            for each in differences(neutral, named_alike(neutral, native), invented)]
    told += [Difference(native.engine, "root", "", f"the root is fused to the world: {still:g} kg do not move")
             for native in natives if native.engine.startswith("mujoco") and (still := _rooted(model.root))]
    if against is not None and scene is not None:
        told += _otherwise_left_out(source, scene)
    return NativeInspection(source, scene, tuple(natives), tuple(told), refused,
                            str(no_scene or ""))


def _rooted(root: Element) -> float:
    """Total mass (kg) of the links of a URDF that are fixed to its root."""
    held = {each.get("link", ""): joint for joint in root.findall("joint") for each in joint.findall("child")}

    def still(link: str) -> bool:
        for _ in held:  # so that a circle of joints ends, too
            if link not in held or held[link].get("type") != "fixed":
                break
            parent = held[link].find("parent")
            link = "" if parent is None else parent.get("link", "")
        return link not in held

    return sum(float(mass.get("value", "0")) for link in root.findall("link") if still(link.get("name", ""))
               for mass in link.findall("inertial/mass"))


def _otherwise_left_out(path: Path, scene: Scene) -> Iterator[Difference]:
    """Contents that a scene cannot hold and that only one of the file and `scene` has left out."""
    from crosscheck.scene.models import import_model

    try:
        here = import_model(path, drop=True).left_out
    except CrosscheckError:  # the engines' own errors tell more
        return
    for words in dict.fromkeys((*here, *scene.left_out)):
        if (words in here) != (words in scene.left_out):
            yield Difference("the file", "left out", "", f"{'has' if words in here else 'lacks'} {words}")


def _neutral(scene: Scene, states: JointStates) -> Native:
    names = ["ground" if k < 0 else scene.bodies[k].name for k in range(-1, scene.n)]
    links = {body.name: Link(body.mass, body.inertia) for body in scene.bodies}
    joints = {}
    for joint in scene.joints:
        if joint.name in states.names:
            damping, armature, stiffness, rest = ((values or (0.0,))[0] for values in (
                joint.damping, joint.armature, joint.stiffness, joint.rest_position))
            joints[joint.name] = Hinge(
                names[joint.parent + 1], names[joint.child + 1], joint.parent_anchor, joint.child_anchor,
                joint.child_axis, zero_attitude(joint), joint.type, damping, armature, stiffness, rest,
                joint.mimic.joint if joint.mimic else "")
    found = Native("scene", links, joints, scene.gravity)
    if len(scene.joints) != scene.n or len(joints) != scene.n:  # dynamics are compared for open trees only
        return found
    values = [_at(_posed(scene, states, k)) for k in range(len(states.position))]
    mass, bias, acceleration = (np.array(each) for each in zip(*values, strict=True))
    return dataclasses.replace(found, order=states.names, mass_matrix=mass, bias=bias, acceleration=acceleration)


def _posed(scene: Scene, states: JointStates, k: int) -> Scene:
    """The scene with its joints in the k-th state, without springs in joints and without mimics."""
    from crosscheck.scene import assembly
    from crosscheck.scene.checks import Draft, Start

    never = (False,) * scene.n
    starts = tuple(Start(index, (float(states.position[k, index]),), (float(states.velocity[k, index]),))
                   for index in range(len(scene.joints)))
    joints = tuple(dataclasses.replace(joint, reference=quaternion_from_rotation(zero_attitude(joint)), mimic=None)
                   for joint in scene.joints)
    bare = scene.replace(joints=joints, forces=tuple(force for force in scene.forces if not force.of_joint))
    return assembly.completed(Draft(bare, never, never, False, starts, never, never))


def _at(scene: Scene) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(mass matrix, bias forces, accelerations) of the joint coordinates in the scene's state."""
    from crosscheck.scene.constraints import Constraints

    state = scene.x0[None], scene.R0[None], scene.v0[None], scene.w0[None]
    unit = scene.replace(joints=tuple(dataclasses.replace(joint, armature=(1.0,)) for joint in scene.joints))
    rates = list(rotors(unit, *state))  # rate = S u of every joint
    S, s = np.array([each[1][0] for each in rates]), np.array([each[2][0] for each in rates])
    G = Constraints(scene).jacobian(*state[:2])[0]
    J = np.linalg.lstsq(np.concatenate([G, S]), np.concatenate([np.zeros((len(G), len(S))), np.eye(len(S))]),
                        rcond=None)[0]
    blocks = np.zeros((6 * scene.n, 6 * scene.n))
    for k, body in enumerate(scene.bodies):
        blocks[6 * k:6 * k + 3, 6 * k:6 * k + 3] = body.mass * np.eye(3)
        blocks[6 * k + 3:6 * k + 6, 6 * k + 3:6 * k + 6] = body.inertia
    M = J.T @ blocks @ J + np.diag([(joint.armature or (0.0,))[0] for joint in scene.joints])

    def coordinates(one: Scene) -> np.ndarray:
        a, alpha, _ = index1(one, *state)
        found: np.ndarray = S @ np.concatenate([a[0], alpha[0]], axis=1).ravel() + s
        return found

    return M, -M @ coordinates(scene.replace(forces=())), coordinates(scene)


def printed(found: NativeInspection, echo: Callable[[str], Any]) -> None:
    """Print the result through `echo`."""
    silent = found.scene is not None and any(native.mass_matrix is None for native in found.native)
    read = ", ".join(native.engine for native in found.native) or "no engine"
    if found.scene is not None:
        echo(f"{found.path}: {found.scene.n} moving bodies, {len(found.scene.joints)} joints; loaded by {read}")
    for native in found.native if found.scene is None else ():
        echo(f"{found.path}: {native.engine} reads {len(native.links)} moving bodies, {len(native.joints)} joints with "
             f"one coordinate, {sum(link.mass for link in native.links.values()):g} kg")
    for words in found.lines:
        echo(words)
    if silent:
        echo("not compared: mass matrix, bias forces and accelerations, which need an open tree of joints with one "
             "coordinate each")
    if found.agree:
        echo("no engine reads anything differently")
    elif found.scene is not None and found.native and found.same:
        echo(f"the same in all that loaded it: {', '.join(found.same)}")
