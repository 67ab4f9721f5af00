"""Makes a draft scene from the typed content of a scene file, with every check of values that needs no mechanics."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping, Sequence

import msgspec
import numpy as np

from crosscheck.scene import joint_options
from crosscheck.scene.functions import TimeFunction
from crosscheck.scene.joints import JOINT_TYPES
from crosscheck.scene.model import GROUND, Body, Force, Joint, Scene
from crosscheck.scene.schema import (
    LARGEST,
    BodyEntry,
    EntryError,
    ForceEntry,
    JointEntry,
    JointForceEntry,
    JointTorqueEntry,
    SceneEntry,
    TorsionalSpringEntry,
    listed,
    nearest,
)

IDENTITY = (1.0, 0.0, 0.0, 0.0)

INERTIA_ROUNDING = 1e-12
"""Relative. Entries written with 15 digits, or computed in double precision, are symmetric and satisfy the triangle
inequality (a thin disc: I_z = I_x + I_y) to about 1e-15; a thousand times that still catches every misprint."""

SMALLEST = 1 / LARGEST
"""Smallest mass, moment of inertia, rod length or duration, so that its reciprocal stays in range."""

MOST_SAMPLES = 10**7
"""Largest number of output times; the states of one body then take a gigabyte and a half."""


@dataclasses.dataclass(frozen=True)
class Start:
    """Coordinates of one joint at the start, which determine the state of its child."""

    joint: int
    position: tuple[float, ...] | None
    velocity: tuple[float, ...] | None


@dataclasses.dataclass(frozen=True)
class Draft:
    """A checked scene in which positions and velocities may still be open."""

    scene: Scene  # zeros stand where a position or velocity is open
    given_positions: tuple[bool, ...]
    given_velocities: tuple[bool, ...]
    assemble: bool
    starts: tuple[Start, ...] = ()
    given_attitudes: tuple[bool, ...] | None = None  # None: all
    given_spins: tuple[bool, ...] | None = None


def draft(entry: SceneEntry) -> Draft:
    """Check values and names of a decoded scene file; raises `EntryError` for the first error found."""
    _check_run(entry)
    _check_names("bodies", [body.name for body in entry.bodies])
    _check_names("joints", [joint.name for joint in entry.joints])
    bodies = {body.name: index for index, body in enumerate(entry.bodies)}
    types = {joint.name: joint.type for joint in entry.joints}
    scene = Scene(
        name=entry.name, description=entry.description, source=entry.source, tags=tuple(entry.tags),
        gravity=np.array(entry.gravity), duration=entry.duration, samples=entry.samples,
        bodies=tuple(_body(f'bodies[{i}] "{body.name}"', body) for i, body in enumerate(entry.bodies)),
        joints=tuple(_joint(entry, bodies, i, joint) for i, joint in enumerate(entry.joints)),
        forces=tuple(made for i, force in enumerate(entry.forces)
                     for made in _forces(bodies, types, i, force, entry.duration)),
        left_out=tuple(entry.left_out),
    )
    starts = (Start(i, *joint_options.start(f'joints[{i}] "{joint.name}"', joint, entry.joints, entry.duration))
              for i, joint in enumerate(entry.joints))
    held = {i for i, joint in enumerate(entry.joints)
            if joint.reference_attitude is not None and JOINT_TYPES[joint.type].keeps_attitude}
    given = {key: tuple(getattr(body, key) is not None for body in entry.bodies)
             for key in ("position", "velocity", "attitude", "angular_velocity")}
    return Draft(scene, given["position"], given["velocity"], entry.assemble,
                 tuple(each for each in starts if each.position or each.velocity or each.joint in held),
                 given["attitude"], given["angular_velocity"])


def _check_run(entry: SceneEntry) -> None:
    if not entry.name.strip():
        raise EntryError("name", "is empty", "give the scene a name")
    if set(entry.name) & set("/\\") or not entry.name.isprintable() or not entry.name.strip("."):
        raise EntryError("name", f"{entry.name!r} cannot be part of a file's name, as reports need it",
                         "leave out slashes, backslashes and control characters, and add a letter")
    if entry.duration <= 0:
        raise EntryError("duration", f"{entry.duration:g} s is not positive", "write a number of seconds > 0")
    if entry.duration < SMALLEST:
        raise EntryError("duration", f"{entry.duration:g} s is out of range", f"write a number above {SMALLEST:g}")
    if entry.samples < 2:
        raise EntryError("samples", f"{entry.samples} is too few, start and end are two", "write a whole number >= 2")
    if entry.samples > MOST_SAMPLES:
        raise EntryError("samples", f"{entry.samples} is too many", f"write a whole number <= {MOST_SAMPLES}")
    if not entry.bodies:
        raise EntryError("bodies", "the scene has none", "add at least one [[bodies]] table")


def _check_names(group: str, names: Sequence[str]) -> None:
    first: dict[str, int] = {}
    for index, name in enumerate(names):
        entry = f'{group}[{index}] "{name}": name'
        if not name.strip():
            raise EntryError(f"{group}[{index}]: name", "is empty", "give it a name of its own")
        if group == "bodies" and name == "ground":
            raise EntryError(entry, '"ground" is the fixed world', "give the body another name")
        if first.setdefault(name, index) != index:
            raise EntryError(entry, f"{group}[{first[name]}] has the same name", "give each its own name")


def _body(entry: str, body: BodyEntry) -> Body:
    if body.mass <= 0:
        raise EntryError(f"{entry}: mass", f"{body.mass:g} kg is not positive", "write a number of kg > 0")
    if body.mass < SMALLEST:
        raise EntryError(f"{entry}: mass", f"{body.mass:g} kg is out of range", f"write a number above {SMALLEST:g}")
    inertia = _inertia(f"{entry}: inertia", np.array(body.inertia))
    attitude = _unit(f"{entry}: attitude", body.attitude or IDENTITY,
                     "write a quaternion w, x, y, z, say [1.0, 0.0, 0.0, 0.0]")
    return Body(body.name, body.mass, inertia, attitude, np.array(body.angular_velocity or (0.0, 0.0, 0.0)),
                np.array(body.position or (0.0, 0.0, 0.0)), np.array(body.velocity or (0.0, 0.0, 0.0)))


def _inertia(entry: str, inertia: np.ndarray) -> np.ndarray:
    """The inertia, made exactly symmetric; raises if it is not physical."""
    size = np.abs(inertia).max()
    gaps = np.abs(inertia - inertia.T)
    if gaps.max() > INERTIA_ROUNDING * size:
        i, j = np.unravel_index(gaps.argmax(), (3, 3))
        raise EntryError(entry, f"not symmetric, entry [{i}][{j}] is {inertia[i, j]:g} and entry [{j}][{i}] is "
                         f"{inertia[j, i]:g}", "write the same number in both")
    symmetric = (inertia + inertia.T) / 2
    moments = np.linalg.eigvalsh(symmetric)
    shown = ", ".join(f"{moment:.6g}" for moment in moments)
    if moments[0] <= INERTIA_ROUNDING * size:
        raise EntryError(entry, f"not positive definite, principal moments {shown} kg m^2",
                         "write an inertia about the COM whose principal moments are all > 0")
    if moments[0] < SMALLEST:
        raise EntryError(entry, f"principal moments {shown} kg m^2 are out of range",
                         f"write an inertia whose principal moments are above {SMALLEST:g}")
    if moments[2] > moments[0] + moments[1] + INERTIA_ROUNDING * size:
        raise EntryError(entry, f"principal moments {shown} kg m^2 break the triangle inequality: no body has them",
                         "make the largest at most the sum of the other two")
    found: np.ndarray = symmetric
    return found


def _unit(entry: str, vector: Sequence[float], mend: str) -> np.ndarray:
    largest = max(abs(component) for component in vector)
    if largest == 0:
        raise EntryError(entry, "all its numbers are zero", mend)
    scaled = np.array(vector) / largest  # squares of very large or small numbers would leave the range of floats
    return scaled / math.sqrt(float(scaled @ scaled))


def _body_index(entry: str, bodies: Mapping[str, int], name: str, ground: bool) -> int:
    if name == "ground" and ground:
        return GROUND
    if name not in bodies:
        known = ["ground", *bodies] if ground else list(bodies)
        if name == "ground":
            raise EntryError(entry, "the ground cannot be the child", f"swap parent and child, or name a body: "
                             f"{listed(bodies)}")
        raise EntryError(entry, f'no body is named "{name}"', f"{nearest(name, known)}write one of {listed(known)}")
    return bodies[name]


def _joint(scene: SceneEntry, bodies: Mapping[str, int], index: int, joint: JointEntry) -> Joint:
    entry = f'joints[{index}] "{joint.name}"'
    parent = _body_index(f"{entry}: parent", bodies, joint.parent, ground=True)
    child = _body_index(f"{entry}: child", bodies, joint.child, ground=False)
    if parent == child:
        raise EntryError(f"{entry}: child", f'joins the body "{joint.child}" to itself', "name two different bodies")
    for key, needed in JOINT_TYPES[joint.type].needs.items():
        value = getattr(joint, key)
        example = "1.0 (m)" if key in ("length", "radius") else "[0.0, 0.0, 1.0]"
        if needed and value is None:
            raise EntryError(f"{entry}: {key}", f"missing, a {joint.type} joint needs it", f"add {key} = {example}")
        if not needed and value is not None:
            raise EntryError(f"{entry}: {key}", f"a {joint.type} joint has none", "remove it, or change the type")
    for key, instead in (("length", ", or use a spherical joint"), ("radius", "")):
        size = getattr(joint, key)
        if size is not None and size <= 0:
            raise EntryError(f"{entry}: {key}", f"{size:g} m is not positive", f"write a number of m > 0{instead}")
        if size is not None and size < SMALLEST:
            raise EntryError(f"{entry}: {key}", f"{size:g} m is out of range", f"write a number above {SMALLEST:g}")
    if JOINT_TYPES[joint.type].slips and parent != GROUND:
        raise EntryError(f"{entry}: parent", f'the plane of a {joint.type} lies in the ground, not in "{joint.parent}"',
                         'write parent = "ground"')
    parent_axis, child_axis = (None if axis is None else _unit(f"{entry}: {key}", axis, "write the axis's direction")
                               for key, axis in (("parent_axis", joint.parent_axis), ("child_axis", joint.child_axis)))
    joint_options.check_types(entry, joint)
    reference = None
    if joint.reference_attitude is not None:
        reference = _unit(f"{entry}: reference_attitude", joint.reference_attitude, "write a quaternion w, x, y, z")
    elastic = {key: joint_options.elastic(entry, joint, key)
               for key in ("armature", "damping", "stiffness", "rest_position")}
    return Joint(joint.name, joint.type, parent, child, np.array(joint.parent_anchor), np.array(joint.child_anchor),
                 parent_axis, child_axis, joint.length, joint.radius, reference,
                 joint_options.start(entry, joint, scene.joints, scene.duration)[0],
                 mimic=joint_options.mimic(entry, joint, scene.joints), **elastic,
                 drive=joint_options.drive(entry, joint, scene.duration))


def _forces(bodies: Mapping[str, int], types: Mapping[str, str], index: int, force: ForceEntry,
            duration: float) -> list[Force]:
    """The forces for one entry of the file: one for each component that depends on time, and one for the rest."""
    values = msgspec.structs.asdict(force)
    kind = str(force.__struct_config__.tag)
    entry = f"forces[{index}] ({kind})"
    for key in ("stiffness", "damping", "free_length"):
        if values.get(key, 0.0) < 0:
            raise EntryError(f"{entry}: {key}", f"{values[key]:g} is negative", "write a number >= 0")
    parent = child = joint = None
    if isinstance(force, TorsionalSpringEntry | JointTorqueEntry | JointForceEntry):
        joint = _axial_joint(f"{entry}: joint", types, values.pop("joint"), isinstance(force, JointForceEntry))
    else:
        child = _body_index(f"{entry}: child", bodies, values.pop("child"), ground=False)
    if "parent" in values:
        parent = _body_index(f"{entry}: parent", bodies, values.pop("parent"), ground=True)
        if parent == child:
            raise EntryError(f"{entry}: child", "joins a body to itself", "name two different bodies")
    vector = next((key for key in ("force", "torque") if isinstance(values.get(key), tuple)), None)
    if vector is None:
        values = {key: joint_options.function(f"{entry}: {key}", value, duration) for key, value in values.items()}
        return [Force(kind, parent, child, joint, values)]
    components = [joint_options.function(f"{entry}: {vector}[{k}]", value, duration)
                  for k, value in enumerate(values[vector])]
    constant = tuple(0.0 if isinstance(value, TimeFunction) else value for value in components)
    timed = [(axis, value) for axis, value in zip(np.eye(3).tolist(), components, strict=True)
             if isinstance(value, TimeFunction)]
    found = [] if timed and not any(constant) else [Force(kind, parent, child, joint, values | {vector: constant})]
    return found + [Force(kind, parent, child, joint, values | {vector: tuple(axis), "factor": value})
                    for axis, value in timed]


def _axial_joint(entry: str, types: Mapping[str, str], name: str, slides: bool) -> str:
    """The name, checked to be that of a joint with an angle, or of a slide."""
    if name not in types:
        raise EntryError(entry, f'no joint is named "{name}"',
                         f"{nearest(name, types)}write one of {listed(types) or '(the scene has no joints)'}")
    fitting = [kind for kind, known in JOINT_TYPES.items()
               if (known.coordinates == ("slide",) if slides else known.has_angle)]
    if types[name] not in fitting:
        raise EntryError(entry, f'"{name}" is a {types[name]} joint, it has no {"slide" if slides else "angle"}',
                         f"name a joint of type {listed(fitting)}")
    return name
