"""Native check: compare what every engine loads from a model file by itself with the neutral scene, in words."""

from __future__ import annotations

import contextlib
import dataclasses
import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any
from xml.etree.ElementTree import Element

import numpy as np

from crosscheck import adapters
from crosscheck.adapters import built_in
from crosscheck.adapters.common.native import LAWS, TOLERANCE, Hinge, JointStates, Link, Native, solids
from crosscheck.errors import CrosscheckError, SceneError, install
from crosscheck.scene import assembly
from crosscheck.scene.armature import rotors
from crosscheck.scene.checks import Draft, Start
from crosscheck.scene.constraints import Constraints
from crosscheck.scene.coordinates import zero_attitude
from crosscheck.scene.mechanics import index1, mass_matrix
from crosscheck.scene.model import Scene, quaternion_from_rotation
from crosscheck.scene.models import apart, collisions, compiling, import_model
from crosscheck.scene.models import source as sources
from crosscheck.scene.models.words import shortened, together

DYNAMICS = ("mass matrix", "bias forces", "accelerations")
COMPARED = {"masses": ("mass", "link"), "inertias": ("inertia", "link"), "centres of mass": ("centre of mass",),
            "joints": ("joint", "type", "tree", "mimic"), "axes": ("axis",), "frames": ("frame",),
            "damping": ("damping",), "armature": ("armature",), "stiffness": ("stiffness", "rest_position"),
            "mass matrix": ("mass matrix", "armature"), "bias forces": ("bias",),
            "accelerations": ("acceleration", "damping", "friction", "mass matrix", "armature", "bias", "gravity",
                              "mimic")}
"""What is compared, in words, with the quantities of the differences in it."""


@dataclasses.dataclass(frozen=True)
class Difference:
    """One engine reads one thing differently from the neutral scene."""

    engine: str
    quantity: str  # "mass", "inertia", "damping", ...
    place: str  # of the link or joint; "" for the whole
    words: str

    def __str__(self) -> str:
        return f"{self.engine}: {self.words}"


Named = Iterator[tuple[str, str, str]]
"""Quantity, place and words of differences."""


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
    said: Mapping[str, Mapping[str, float | str]] = dataclasses.field(default_factory=dict)  # by the file
    absent: Mapping[str, str] = dataclasses.field(default_factory=dict)  # readers not installed, and what installs each
    outlined: Mapping[str, str] | None = None  # collision shapes by the file, see `solids`

    @property
    def laws(self) -> list[list[str]]:
        """Rows (quantity and joints, value in each column) where the file and the engines have other numbers.

        The columns are the file, where it is a URDF, and each of `native`; "-" is what an engine has no number for.
        """
        columns = [self.said] if self.said else []
        columns += [{name: _laws(joint) for name, joint in native.joints.items()} for native in self.native]
        joints = dict.fromkeys(name for column in columns for name in column)
        groups: dict[tuple[str, ...], list[str]] = {}
        for quantity in LAWS:
            for name in joints:
                values = [column.get(name, {}).get(quantity) for column in columns]
                if any(not _alike(values[0], each) for each in values[1:]):
                    cells = ("-" if each is None else f"{each:.6g}" if isinstance(each, float) else str(each)
                             for each in values)
                    groups.setdefault((quantity, *cells), []).append(name)
        shapes = [*([self.outlined] if self.said else []), *(native.shapes for native in self.native)]
        for link in dict.fromkeys(name for column in shapes for name in column or ()):
            drawn = ["-" if column is None else column.get(link, "none") for column in shapes]
            if len(set(drawn) - {"-"}) > 1:
                groups.setdefault(("collision shapes", *drawn), []).append(link)
        return [[f"{quantity} of {', '.join(names)}", *cells] for (quantity, *cells), names in groups.items()]

    @property
    def agree(self) -> bool:
        """Whether all engines load the file, read the same as the scene, and hold no two numbers for one thing."""
        return self.scene is not None and not self.differences and not self.refused and all(
            len(set(cells) - {"-"}) < 2 for _, *cells in self.laws)

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
        differing = {each.quantity for each in self.differences}
        names = tuple(joint.name for joint in self.scene.joints) if self.scene else ()
        whole = all(native.mass_matrix is not None and native.order == names for native in self.native)
        return tuple(words for words, quantities in COMPARED.items() if not differing.intersection(quantities)
                     and (whole or words not in DYNAMICS))

    @property
    def lines(self) -> tuple[str, ...]:
        """The result as lines of text."""
        same = any(words.removeprefix("Error: ") in self.no_scene for words in self.refused.values())
        return (*(([] if same else [self.no_scene]) if self.scene is None else
                  [f"accelerations are compared without {words}" for words in shortened(self.scene.left_out)]),
                *(f"{engine} refuses the file{self._retried(engine)}: {words}"
                  for engine, words in self.refused.items()),
                *together((str(each), each.place) for each in self.differences))


def _laws(joint: Hinge) -> dict[str, float | str]:
    ends = dict(zip(("lower limit", "upper limit"), joint.limits or (), strict=False))
    return {"damping": joint.damping, "armature": joint.armature, "mimic": joint.mimic or "none", **ends, **joint.laws}


def _alike(one: float | str | None, other: float | str | None) -> bool:
    """Whether two values of a law are the same; none is one that does nothing."""
    if not isinstance(one, str) and not isinstance(other, str) and one is not None and other is not None:
        return bool(np.isclose(one, other, rtol=TOLERANCE, atol=0.0))
    idle = [each is None or each == "none" or (not isinstance(each, str) and (each == 0 or np.isinf(each)))
            for each in (one, other)]
    return one == other or all(idle)


def _said(model: sources.Source) -> dict[str, dict[str, float | str]]:
    """What a URDF says of its moving joints, by `LAWS`."""
    places = {"friction": ("dynamics", "friction"), "damping": ("dynamics", "damping"), "effort": ("limit", "effort"),
              "velocity limit": ("limit", "velocity"), "lower limit": ("limit", "lower"),
              "upper limit": ("limit", "upper"), "mimic": ("mimic", "joint")}
    joints: dict[str, dict[str, float | str]] = {}
    for joint in model.root.findall("joint") if model.is_urdf else ():
        if joint.get("type") in ("revolute", "prismatic", "continuous"):
            mine = joints.setdefault(joint.get("name", ""), {})
            for quantity, (tag, key) in places.items():
                for word in (each.get(key) for each in joint.findall(tag)):
                    if word is not None and not (joint.get("type") == "continuous" and key in ("lower", "upper")):
                        mine[quantity] = word if quantity == "mimic" else compiling.finite(joint, word)
    return joints


def _outlined(model: sources.Source) -> dict[str, str]:
    """The collision shapes of a URDF on its moving links, each with those that are fixed to it."""
    on = {}
    for joint in model.root.findall("joint") if model.is_urdf else ():
        parent, child = joint.find("parent"), joint.find("child")
        if joint.get("type") == "fixed" and parent is not None and child is not None:
            on[child.get("link", "")] = parent.get("link", ""), compiling.pose(joint.find("origin"))
    moving = {child.get("link") for joint in model.root.findall("joint") if joint.get("type") != "fixed"
              for child in joint.findall("child")}
    shapes = []
    for shape in collisions.read(model, compiling.pose, compiling.finite)[0] if model.is_urdf else ():
        link, place = shape.link, np.append(shape.position, 1.0)
        for _ in range(len(on)):
            if link in on:
                link, X = on[link][0], on[link][1]
                place = X @ place
        sizes = shape.size if shape.kind == "sphere" else [shape.size[0], 2 * shape.size[1]] if (
            shape.kind in ("cylinder", "capsule")) else [2 * each for each in shape.size]
        shapes.append((link if link in moving else "ground", shape.kind, sizes, place[:3]))
    return solids(shapes)


def inspect(path: str | os.PathLike[str], engines: Sequence[str] | None = None, count: int = 3, seed: int = 0
            ) -> NativeInspection:
    """Let every engine load the file itself, and compare each with the scene that `import_model` makes of it.

    Joints with one coordinate are compared at their reference and at `count` random states. Raises `SceneError` if
    neither crosscheck nor an engine can read the file.
    """
    source = Path(path)
    usd = source.suffix.lower().startswith(".usd")
    model = sources.Source(source, Element("usd"), source.parent) if usd else sources.read(source, sdf=True)
    outside = [name for _, name, target in sources.files(model) if target is None]
    scene, no_scene = None, None
    try:
        # says that it reads no USD and no SDF
        scene = import_model(path, drop=True, limits="drop", contacts="drop")
    except SceneError as error:
        no_scene = error
    sdf = model.root.tag == "sdf"
    alone = sdf or usd  # read by engines only
    starts = {joint.name: (joint.start or (0.0,))[0] for joint in (scene.joints if scene else ())
              if joint.kind.positions == 1}
    if sdf:
        starts = {joint.get("name", ""): 0.0 for joint in model.root.iter("joint")
                  if joint.get("type") in ("revolute", "prismatic", "continuous")}
    rng = np.random.default_rng(seed)
    size = (1 + count, len(starts))
    states = JointStates(tuple(starts), rng.uniform(-0.6, 0.6, size), rng.uniform(-1.0, 1.0, size))
    states.position[0], states.velocity[0] = list(starts.values()), 0.0
    natives, refused = [], {}
    ending = source.suffix.lower()
    # as in studies, engines apart are asked where they are named, or where no other reads the file
    readers = [name for name in adapters.names() if ending in adapters.get(name).reads
               and (alone or not adapters.has_own_environment(name))]
    for name in readers if engines is None else engines:
        try:
            adapters.get(name)  # raises if there is none
            if outside and name.startswith("mujoco"):  # MuJoCo would read files outside the model's folder
                raise sources.outside(source, outside[0])
            heard = apart(_native, (os.getcwd(), name, str(source), states), str(source))
            natives.append(dataclasses.replace(heard, engine=f"{name} without meshes" if heard.refusal else name))
            if heard.refusal:
                refused[name] = heard.refusal
        except ImportError as error:
            refused[name] = f"it cannot be imported: {error}"
        except CrosscheckError as error:
            refused[name] = str(error)
    if not readers and engines is None:
        raise SceneError(f"{source}: no engine that reads it is installed; " + " or ".join(
            f"{name}: {install(name)}" for name in _absent(ending)))
    if no_scene is not None and not natives:
        raise SceneError(f"{source}: no engine reads it: " + "; ".join(
            f"{name}: {words}" for name, words in refused.items())) if alone and refused else no_scene
    neutral = _neutral(scene, states) if scene else natives[0]
    invented = frozenset(link.get("name", "") for link in model.root.findall("link")
                         if link.find("inertial") is None and link.find("collision") is not None)
    frames = _frames(scene)
    differences = [Difference(native.engine, *each) for native in natives if native is not neutral
                   for each in _differences(neutral, _named_alike(neutral, native), invented)
                   if native.engine.startswith("mujoco") or each[1] not in frames]
    whole = sum(float(mass.get("value", "0")) for mass in model.root.findall("link/inertial/mass"))
    still = whole - sum(link.mass for link in neutral.links.values())  # on the root
    differences += [Difference(native.engine, "root", "", f"the root is fused to the world: {still:g} kg do not move")
             for native in natives if native.engine.startswith("mujoco") and still > TOLERANCE * whole]
    absent, outlined = {} if engines is not None else {name: install(name) for name in _absent(ending)}, None
    with contextlib.suppress(ValueError):  # of a shape that is none; the import says where
        outlined = _outlined(model)
    return NativeInspection(source, scene, tuple(natives), tuple(differences), refused, str(no_scene or ""),
                            _said(model), absent, outlined)


def _absent(ending: str) -> list[str]:
    """Engines that read such files and are not installed."""
    return [name for name, entry in built_in.ENTRIES.items()
            if name not in adapters.names() and ending in entry.make().reads]


def _frames(scene: Scene | None) -> set[str]:
    """Names of frames and the joints on them, which are several joints on one body in other engines."""
    if scene is None:
        return set()
    names = ["", *(body.name for body in scene.bodies)]
    frames = {body.name for body in scene.bodies if not body.mass}
    return frames | {joint.name for joint in scene.joints if frames & {names[joint.parent + 1], names[joint.child + 1]}}


def _native(task: tuple[str, str, str, JointStates]) -> Native:
    """What an engine makes of a file, for (working folder, engine, path, states)."""
    folder, name, path, states = task
    os.chdir(folder)
    made: Native = adapters.get(name).native(path, states)
    return made


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
    model = Native("scene", links, joints, scene.gravity)
    if len(scene.joints) != scene.n or len(joints) != scene.n:  # dynamics are compared for open trees only
        return model
    values = [_at(_posed(scene, states, k)) for k in range(len(states.position))]
    mass, bias, acceleration = (np.array(each) for each in zip(*values, strict=True))
    return dataclasses.replace(model, order=states.names, mass_matrix=mass, bias=bias, acceleration=acceleration)


def _posed(scene: Scene, states: JointStates, k: int) -> Scene:
    """The scene with its joints in the k-th state, without mimics."""
    never = (False,) * scene.n
    starts = tuple(Start(index, (float(states.position[k, index]),), (float(states.velocity[k, index]),))
                   for index in range(len(scene.joints)))
    joints = tuple(dataclasses.replace(joint, reference=quaternion_from_rotation(zero_attitude(joint)), mimic=None)
                   for joint in scene.joints)
    return assembly.completed(Draft(scene.replace(joints=joints), never, never, False, starts, never, never))


def _at(scene: Scene) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(mass matrix, bias forces, accelerations) of the joint coordinates in the scene's state."""
    state = scene.x0[None], scene.R0[None], scene.v0[None], scene.w0[None]
    unit = scene.replace(joints=tuple(dataclasses.replace(joint, armature=(1.0,)) for joint in scene.joints))
    rates = list(rotors(unit, *state))  # rate = S u of every joint
    S, s = np.array([each[1][0] for each in rates]), np.array([each[2][0] for each in rates])
    G = Constraints(scene).jacobian(*state[:2])[0]
    J = np.linalg.lstsq(np.concatenate([G, S]), np.concatenate([np.zeros((len(G), len(S))), np.eye(len(S))]),
                        rcond=None)[0]
    armature = [(joint.armature or (0.0,))[0] for joint in scene.joints]
    M = J.T @ mass_matrix(scene) @ J + np.diag(armature)

    def coordinates(one: Scene) -> np.ndarray:
        a, alpha, _ = index1(one, *state)
        return np.asarray(S @ np.concatenate([a[0], alpha[0]], axis=1).ravel() + s)

    return M, -M @ coordinates(scene.unloaded), coordinates(scene)


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


def _named_alike(neutral: Native, native: Native) -> Native:
    """`native` with the scene's names for bodies without a name in the file. They are matched by their joints."""
    ours = {theirs.child: joint.child for name, joint in neutral.joints.items() if (theirs := native.joints.get(name))
            and joint.child.startswith("body ") and theirs.child not in neutral.links}
    if not ours:
        return native
    joints = {name: dataclasses.replace(joint, parent=ours.get(joint.parent, joint.parent),
                                        child=ours.get(joint.child, joint.child))
              for name, joint in native.joints.items()}
    return dataclasses.replace(native, joints=joints,
                               links={ours.get(name, name): link for name, link in native.links.items()})


def _differences(neutral: Native, native: Native, invented: frozenset[str]) -> Named:
    """All differences. `invented` are links without inertial data, which an engine may make from collision shapes."""
    most = native.tolerance
    if not _close(neutral.gravity, native.gravity, 10.0, most):
        yield ("gravity", "", f"gravity is {native.gravity.tolist()}, the scene has {neutral.gravity.tolist()}")
    ratios = [native.links[name].mass / link.mass for name, link in neutral.links.items()
              if name in native.links and link.mass]
    alike = len(ratios) > 1 and ratios[0] > 0 and _close(np.array(ratios), np.full(len(ratios), ratios[0]), 1.0, most)
    factor = ratios[0] if alike else 1.0
    if abs(factor - 1) > most:
        yield ("mass", "", f"masses of all links times {factor:.6g}")
    for name, link in neutral.links.items():
        link = Link(factor * link.mass, factor * link.inertia)
        other = native.links.get(name)
        if other is None:
            yield ("link", name, f"link {name} is not in its model")
            continue
        yield from _link(name, link, other, invented, most)
    for name in native.links.keys() - neutral.links.keys():
        origin = "from collision geometry" if invented else "otherwise"
        yield ("link", name, f"link {name} is a body of its own, {native.links[name].mass:g} kg, made {origin}")
    off = _shifted_centres(neutral, native, most)
    for name, gap in off.items():
        yield ("centre of mass", name, f"centre of mass of link {name} is shifted by {_digits(gap)} m")
    for name, joint in neutral.joints.items():
        theirs = native.joints.get(name)
        if theirs is None:
            yield ("joint", name, f"joint {name} is not in its model")
        else:
            yield from _joint(name, joint, theirs, off, most)
    yield from _dynamics(neutral, native)


def _link(name: str, ours: Link, theirs: Link, invented: frozenset[str], most: float) -> Named:
    if abs(theirs.mass - ours.mass) > most * ours.mass:
        why = " made from collision geometry" if invented else f" times {theirs.mass / ours.mass:.6g}"
        yield ("mass", name, f"mass of link {name}{why}: {theirs.mass:g} kg in place of {ours.mass:g} kg")
    if not _close(ours.inertia, theirs.inertia, float(np.abs(ours.inertia).max()), most):
        moments = np.linalg.eigvalsh(ours.inertia), np.linalg.eigvalsh(theirs.inertia)
        if _close(*moments, float(moments[0].max()), most):
            yield ("inertia", name, f"inertial rotation of {name} lost or turned: the principal moments are right, "
                       "their axes are not")
        else:
            yield ("inertia", name, f"inertia of link {name}: principal moments {_digits(moments[1])} in place of "
                       f"{_digits(moments[0])} kg m^2")


def _shifted_centres(neutral: Native, native: Native, most: float) -> dict[str, np.ndarray]:
    """Shifts (m) of mass centres. A link has one if all anchors on it shift alike, and those of its neighbours do not.
    """
    gaps: dict[str, list[np.ndarray]] = {}
    for name, ours in neutral.joints.items():
        theirs = native.joints.get(name)
        if theirs is None or (ours.parent, ours.child) != (theirs.parent, theirs.child):
            return {}
        ends = {ours.parent: theirs.parent_anchor - ours.parent_anchor,
                ours.child: theirs.child_anchor - ours.child_anchor}
        alone = sum(np.abs(gap).max() > most for gap in ends.values()) == 1
        for link, gap in ends.items():
            gaps.setdefault(link, []).append(gap if alone else np.full(3, np.nan))
    return {link: -each[0] for link, each in gaps.items() if link in neutral.links
            and np.abs(each[0]).max() > most and _close(np.array([each[0]] * len(each)), np.array(each), 1.0, most)}


def _joint(name: str, ours: Hinge, theirs: Hinge, off: Mapping[str, np.ndarray], most: float) -> Named:
    if ours.kind != theirs.kind:
        yield ("type", name, f"joint {name} is {theirs.kind} in place of {ours.kind}")
    if ours.parent != theirs.parent or ours.child != theirs.child:
        yield ("tree", name, f"joint {name} joins {theirs.parent} and {theirs.child} in place of {ours.parent} and "
                   f"{ours.child}")
        return
    cosine = float(ours.axis @ theirs.axis)
    if cosine < -1 + most:
        yield ("axis", name, f"axis of joint {name} is flipped")
    elif cosine < 1 - most:
        yield ("axis", name, f"axis of joint {name} is turned by {np.degrees(np.arccos(cosine)):.4g} deg")
    turn = theirs.attitude.T @ ours.attitude
    angle = float(np.arccos(np.clip((np.trace(turn) - 1) / 2, -1.0, 1.0)))
    if np.abs(turn - np.eye(3)).max() > most:
        yield ("frame", name, f"frame of joint {name} is turned by {np.degrees(angle):.4g} deg"
                   + _degrees(ours.attitude, theirs.attitude))
    for end in ("parent", "child"):
        gap, link = getattr(theirs, f"{end}_anchor") - getattr(ours, f"{end}_anchor"), getattr(ours, end)
        if link not in off and np.abs(gap).max() > most * max(1.0, float(np.abs(ours.parent_anchor).max())):
            yield ("frame", name, f"frame of joint {name} is shifted by {_digits(gap)} m against the "
                       + ("ground" if link == "ground" else f"centre of mass of {link}"))
    sprung = ("rest_position",) if ours.stiffness and theirs.stiffness else ()
    if ours.mimic != theirs.mimic:
        yield ("mimic", name, f"joint {name} follows " + (
            f"{theirs.mimic or 'no other joint'} in place of {ours.mimic or 'none'}"))
    for key in ("damping", "armature", "stiffness", *sprung):
        value, goal = getattr(theirs, key), getattr(ours, key)
        if abs(value - goal) > most * max(abs(goal), abs(value)):
            wrong = "missing" if value == 0 else f"is {value:g}, not {goal:g}"
            yield (key, name, f"{key.replace('_', ' ')} of joint {name} {wrong}")


def _degrees(ours: np.ndarray, theirs: np.ndarray) -> str:
    """A hint if the turn comes from degrees read as radians, or radians as degrees; else ""."""
    from scipy.spatial.transform import Rotation

    for factor, words in ((180 / np.pi, "radians written as degrees"), (np.pi / 180, "degrees read from radians")):
        for axes in ("xyz", "XYZ"):
            angles = Rotation.from_matrix(ours).as_euler(axes) * factor
            if np.abs(Rotation.from_euler(axes, angles).as_matrix() - theirs).max() < 1e-6:
                return f", as by {words}: degree for radian"
    return ""


def _dynamics(neutral: Native, native: Native) -> Named:
    """Differences of mass matrix, bias forces and accelerations."""
    if neutral.mass_matrix is None or native.mass_matrix is None or not neutral.order == native.order != ():
        return
    assert neutral.bias is not None
    assert native.bias is not None
    assert neutral.acceleration is not None
    assert native.acceleration is not None
    gap, most = native.mass_matrix - neutral.mass_matrix, native.tolerance
    if not _close(native.mass_matrix, neutral.mass_matrix, float(np.abs(neutral.mass_matrix).max()), most):
        armature = np.array([neutral.joints[name].armature for name in neutral.order])
        if armature.any() and np.allclose(gap, -np.diag(armature), atol=1e-9 * float(armature.max())):
            for name in np.array(neutral.order)[armature > 0]:
                yield ("armature", str(name), f"armature of joint {name} missing in the mass matrix")
        else:
            name = neutral.order[int(np.unravel_index(int(np.abs(gap).argmax()), gap.shape)[1])]
            yield ("mass matrix", name, f"mass matrix of joint {name} is off by {np.abs(gap).max():.3g}")
    scale = max(1e-9, float(np.abs(neutral.bias).max()))
    if not _close(native.bias, neutral.bias, scale, most):
        worst = int(np.abs(native.bias - neutral.bias).max(axis=0).argmax())
        yield ("bias", neutral.order[worst], f"bias force of joint {neutral.order[worst]} is off by "
                   f"{np.abs(native.bias - neutral.bias).max():.3g}")
    # The efforts of springs and dampers. Errors of mass matrix and bias, which are reported above, drop out of them.
    ours = np.einsum("kij,kj->ki", neutral.mass_matrix, neutral.acceleration) + neutral.bias
    theirs = np.einsum("kij,kj->ki", native.mass_matrix, native.acceleration) + native.bias
    scale = max(scale, float(np.abs(ours).max()))
    geared = {each for one in (neutral, native) for name, joint in one.joints.items() if joint.mimic
              for each in (name, joint.mimic)}  # their efforts contain the constraint force
    for name in native.order if native.frictionless else ():
        if native.joints[name].laws.get("friction"):
            yield ("friction", name, f"friction of joint {name} is stored but not applied by {native.solver}")
    for index in np.flatnonzero(np.abs(theirs - ours).max(axis=0) > 10 * most * scale):
        name = neutral.order[int(index)]
        gap = float(np.abs(theirs - ours)[:, index].max())
        if native.joints[name].damping and np.abs(theirs[:, index]).max() <= 10 * most * scale:
            yield ("damping", name, f"damping of joint {name} is stored but not applied by {native.solver}")
        elif name not in geared:
            yield ("acceleration", name, f"acceleration of joint {name} by {native.solver} differs by an effort of "
                       f"{gap:.3g}")


def _close(one: np.ndarray, other: np.ndarray, scale: float, most: float) -> bool:
    return one.shape == other.shape and bool(np.abs(one - other).max(initial=0.0) <= most * max(scale, 1e-12))


def _digits(values: np.ndarray) -> str:
    values = np.where(np.abs(values) > TOLERANCE * np.abs(values).max(), values, 0.0)
    return "(" + ", ".join(f"{value:.6g}" for value in values) + ")"
