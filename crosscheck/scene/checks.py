"""Makes a draft scene from the typed content of a scene file, with every check of values that needs no mechanics."""

from __future__ import annotations

import dataclasses
import math
import re
from collections.abc import Mapping, Sequence
from pathlib import Path

import msgspec
import numpy as np

from crosscheck.errors import brief
from crosscheck.scene import coordinates, joint_options, touching
from crosscheck.scene.functions import TimeFunction
from crosscheck.scene.joints import joint_types
from crosscheck.scene.laws import FORCE_TYPES, SIZES, Monitor, Shape
from crosscheck.scene.model import GROUND, Body, Force, Joint, LeftOut, Motor, Published, Scene
from crosscheck.scene.schema import (
    LARGEST,
    BodyEntry,
    EntryError,
    ForceEntry,
    JointEntry,
    MonitorEntry,
    PublishedEntry,
    SceneEntry,
    ServoEntry,
    ShapeEntry,
    TouchEntry,
    check_named,
    check_not_negative,
    check_positive,
    listed,
)
from crosscheck.scene.sensors import sensors_of, sites_of

IDENTITY = (1.0, 0.0, 0.0, 0.0)

INERTIA_ROUNDING = 1e-12
"""Relative. Entries written with 15 digits, or computed in double precision, are symmetric and satisfy the triangle
inequality (a thin disc: I_z = I_x + I_y) to about 1e-15; a thousand times that still catches every misprint."""

SMALLEST = 1 / LARGEST

LONGEST_NAME, LONGEST_FILE_NAME = 1000, 200
"""Characters of a name; of the scene's, which is part of the names of files."""

STIFFEST = 1e12
"""Times the inertia of all bodies that an armature may be: doubles have sixteen digits."""
"""Smallest mass, moment of inertia, rod length or duration, so that its reciprocal stays in range."""

START_TOLERANCE = 1e-8
"""How far a start may be beyond a limit or a monitor, rad or m, relative to its value above 1: that of ten digits."""

_CORNER = re.compile(rb"^\s*(?:vertex|v)\s+(\S+)\s+(\S+)\s+(\S+)", re.MULTILINE)

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


_OF_BODIES = {"position": 3, "attitude": 4, "velocity": 3, "angular_velocity": 3}
"""Published quantities of a body, and how many numbers they have."""


def _published(where: str, entry: PublishedEntry, bodies: Mapping[str, int], scene: Scene) -> Published:
    """A checked entry of [[published]]."""
    value = tuple(entry.value) if isinstance(entry.value, list) else (entry.value,)
    kind, count = entry.quantity, _OF_BODIES.get(entry.quantity, 1)
    if kind in _OF_BODIES:
        check_named(f"{where}: body", "body", entry.body, bodies)
    if kind.startswith("joint_"):
        joint = next((joint for joint in scene.joints if joint.name == entry.joint), None)
        if joint is None or not joint.kind.coordinates:
            names = [joint.name for joint in scene.joints if joint.kind.coordinates]
            raise EntryError(f"{where}: joint", f'no joint with coordinates is named "{entry.joint}"',
                             f"write one of {listed(names)}")
        ball = joint.kind.positions == 4
        count = joint.kind.positions - (ball and kind == "joint_velocity")
    if kind == "eigenvalue":
        count = len(value) if len(value) <= 2 else 2
    elif entry.time is None or not 0 <= entry.time <= scene.duration:
        raise EntryError(f"{where}: time", "missing or beyond the scene's duration", "write a time within it, s")
    if len(value) != count:
        raise EntryError(f"{where}: value", f"has {len(value)} numbers, {kind} has {count}", "write as many")
    if not entry.error >= 0:
        raise EntryError(f"{where}: error", "is below 0", "write what the printed digits allow")
    return Published(entry.source, kind, value, entry.error, bodies.get(entry.body or ""), entry.joint, entry.time)


def draft(entry: SceneEntry, folder: Path = Path()) -> Draft:
    """Check values and names of a decoded scene file; raises `EntryError` for the first error found.

    `folder` is where it looks for mesh files.
    """
    _check_run(entry)
    for group, tables in (("bodies", entry.bodies), ("joints", entry.joints), ("shapes", entry.shapes),
                          ("sites", entry.sites), ("sensors", entry.sensors)):
        _check_names(group, [table.name for table in tables])
    bodies = {body.name: index for index, body in enumerate(entry.bodies)}
    scene = Scene(
        name=entry.name, description=entry.description, source=entry.source, tags=tuple(entry.tags),
        gravity=np.array(entry.gravity), duration=entry.duration, samples=entry.samples,
        bodies=tuple(_body(f'bodies[{i}] "{body.name}"', body) for i, body in enumerate(entry.bodies)),
        joints=tuple(_joint(entry, bodies, i, joint) for i, joint in enumerate(entry.joints)),
        forces=tuple(made for i, force in enumerate(entry.forces)
                     for made in (_servo(entry, i, force) if isinstance(force, ServoEntry) else
                                  _forces(bodies, entry, i, force))),
        left_out=tuple(LeftOut(*each) for each in entry.left_out), motors=tuple(Motor(*each) for each in entry.motors),
        shapes=tuple(_shape(bodies, f'shapes[{i}] "{shape.name}"', shape, folder)
                     for i, shape in enumerate(entry.shapes)),
        monitors=tuple(_monitor(entry, i, monitor) for i, monitor in enumerate(entry.monitors)),
        sites=sites_of(entry.sites, bodies),
    )
    _check_frames(scene)
    _check_armature(scene)
    scene = scene.replace(sensors=sensors_of(entry.sensors, scene), published=tuple(
        _published(f"published[{k}]", figure, bodies, scene) for k, figure in enumerate(entry.published)))
    starts = (Start(i, *joint_options.start(f'joints[{i}] "{joint.name}"', joint, entry.joints, entry.duration))
              for i, joint in enumerate(entry.joints))
    held = {i for i, joint in enumerate(entry.joints)
            if joint.reference_attitude is not None and joint.kind.keeps_attitude}
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
    if len(entry.name) > LONGEST_FILE_NAME:
        raise EntryError("name", f"has {len(entry.name)} characters, and reports make names of files from it",
                         f"write at most {LONGEST_FILE_NAME}")
    check_positive("duration", entry.duration, "s", SMALLEST)
    if entry.samples < 2:
        raise EntryError("samples", f"{entry.samples} is too few, start and end are two", "write a whole number >= 2")
    if entry.samples > MOST_SAMPLES:
        raise EntryError("samples", f"{entry.samples} is too many", f"write a whole number <= {MOST_SAMPLES}")
    if not entry.bodies:
        raise EntryError("bodies", "the scene has none", "add at least one [[bodies]] table")


def _check_names(group: str, names: Sequence[str]) -> None:
    first: dict[str, int] = {}
    for index, name in enumerate(names):
        if len(name) > LONGEST_NAME or not name.isprintable():
            raise EntryError(f"{group}[{index}]: name", f"{brief(repr(name), 60)} is too long or cannot be printed",
                             f"write at most {LONGEST_NAME} characters, none of them a control character")
        entry = f'{group}[{index}] "{name}": name'
        if not name.strip():
            raise EntryError(f"{group}[{index}]: name", "is empty", "give it a name of its own")
        if group == "bodies" and name == "ground":
            raise EntryError(entry, '"ground" is the fixed world', "give the body another name")
        if first.setdefault(name, index) != index:
            raise EntryError(entry, f"{group}[{first[name]}] has the same name", "give each its own name")


def _check_frames(scene: Scene) -> None:
    """A body without mass and inertia has to move as the bodies that joints tie it to."""
    for k in np.flatnonzero(scene.frames).tolist():
        inner = sum(joint.child == k for joint in scene.joints)
        outer = sum(joint.parent == k for joint in scene.joints)
        if inner != 1 or not outer:
            raise EntryError(f'bodies[{k}] "{scene.bodies[k].name}": mass', "is 0, as of a frame between joints, but "
                             f"it is the child of {inner} joints and the parent of {outer}", "give it a mass and an "
                             "inertia, or make it the child of one joint and the parent of others")


def _check_armature(scene: Scene) -> None:
    levers = [anchor for joint in scene.joints for anchor in (joint.parent_anchor, joint.child_anchor)]
    length = max(1.0, max((float(np.linalg.norm(lever)) for lever in levers), default=0.0))
    most = STIFFEST * (float(scene.masses.sum()) * length**2 + float(np.abs(scene.inertias).sum()))
    for i, joint in enumerate(scene.joints):
        if max(joint.armature, default=0.0) > most:
            raise EntryError(f'joints[{i}] "{joint.name}": armature', f"{max(joint.armature):g} is so large beside the "
                             "bodies' inertia that the joint never moves", f"write a number below {most:.2g}")


def _body(entry: str, body: BodyEntry) -> Body:
    if body.mass or np.any(body.inertia):
        check_positive(f"{entry}: mass", body.mass, "kg", SMALLEST)
        inertia = _inertia(f"{entry}: inertia", np.array(body.inertia))
    else:
        inertia = np.zeros((3, 3))
    attitude = _unit(f"{entry}: attitude", body.attitude or IDENTITY,
                     "write a quaternion w, x, y, z, say [1.0, 0.0, 0.0, 0.0]")
    return Body(body.name, body.mass, inertia, attitude, np.array(body.angular_velocity or (0.0, 0.0, 0.0)),
                np.array(body.position or (0.0, 0.0, 0.0)), np.array(body.velocity or (0.0, 0.0, 0.0)),
                np.array(body.origin or (0.0, 0.0, 0.0)))


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
    listed = ", ".join(f"{moment:.6g}" for moment in moments)
    if moments[0] <= INERTIA_ROUNDING * size:
        raise EntryError(entry, f"not positive definite, principal moments {listed} kg m^2",
                         "write an inertia about the COM whose principal moments are all > 0")
    if moments[0] < SMALLEST:
        raise EntryError(entry, f"principal moments {listed} kg m^2 are out of range",
                         f"write an inertia whose principal moments are above {SMALLEST:g}")
    if moments[2] > moments[0] + moments[1] + INERTIA_ROUNDING * size:
        raise EntryError(entry, f"principal moments {listed} kg m^2 break the triangle inequality: no body has them",
                         "make the largest at most the sum of the other two")
    return np.asarray(symmetric)


def _unit(entry: str, vector: Sequence[float], mend: str) -> np.ndarray:
    largest = max(abs(component) for component in vector)
    if largest == 0:
        raise EntryError(entry, "all its numbers are zero", mend)
    scaled = np.array(vector) / largest  # squares of very large or small numbers would leave the range of floats
    return scaled / math.sqrt(float(scaled @ scaled))


def _body_index(entry: str, bodies: Mapping[str, int], name: str, ground: bool) -> int:
    if name == "ground" and not ground:
        raise EntryError(entry, "the ground cannot be the child", f"swap parent and child, or name a body: "
                         f"{listed(bodies)}")
    check_named(entry, "body", name, ["ground", *bodies] if ground else list(bodies))
    return bodies.get(name, GROUND)


def _joint(scene: SceneEntry, bodies: Mapping[str, int], index: int, joint: JointEntry) -> Joint:
    entry = f'joints[{index}] "{joint.name}"'
    parent = _body_index(f"{entry}: parent", bodies, joint.parent, ground=True)
    child = _body_index(f"{entry}: child", bodies, joint.child, ground=False)
    if parent == child:
        raise EntryError(f"{entry}: child", f'joins the body "{joint.child}" to itself', "name two different bodies")
    for key, needed in joint.kind.needs.items():
        value = getattr(joint, key)
        example = "1.0 (m)" if key in ("length", "radius") else "[0.0, 0.0, 1.0]"
        if needed and value is None:
            raise EntryError(f"{entry}: {key}", f"missing, a {joint.type} joint needs it", f"add {key} = {example}")
        if not needed and value is not None:
            raise EntryError(f"{entry}: {key}", f"a {joint.type} joint has none", "remove it, or change the type")
    for key, instead in (("length", ", or use a spherical joint"), ("radius", "")):
        if (size := getattr(joint, key)) is not None:
            check_positive(f"{entry}: {key}", size, "m", SMALLEST, instead)
    if joint.kind.slips and parent != GROUND:
        raise EntryError(f"{entry}: parent", f'the plane of a {joint.type} lies in the ground, not in "{joint.parent}"',
                         'write parent = "ground"')
    parent_axis, child_axis = (None if axis is None else _unit(f"{entry}: {key}", axis, "write the axis's direction")
                               for key, axis in (("parent_axis", joint.parent_axis), ("child_axis", joint.child_axis)))
    reference = None
    if joint.reference_attitude is not None:
        if not (joint.kind.coordinates or joint.kind.keeps_attitude):
            raise EntryError(f"{entry}: reference_attitude", f"a {joint.type} joint has none", "remove it")
        reference = _unit(f"{entry}: reference_attitude", joint.reference_attitude, "write a quaternion w, x, y, z")
    elastic = {key: joint_options.elastic(entry, joint, key)
               for key in ("armature", "damping", "stiffness", "rest_position")}
    return Joint(joint.name, joint.type, parent, child, np.array(joint.parent_anchor), np.array(joint.child_anchor),
                 parent_axis, child_axis, joint.length, joint.radius, reference,
                 joint_options.start(entry, joint, scene.joints, scene.duration)[0],
                 mimic=joint_options.mimic(entry, joint, scene.joints), **elastic,
                 drive=joint_options.drive(entry, joint, scene.duration),
                 dry_friction=joint_options.dry_friction(entry, joint), limits=joint_options.limits(entry, joint))


def _forces(bodies: Mapping[str, int], scene: SceneEntry, index: int, force: ForceEntry) -> list[Force]:
    """The forces for one entry of the file: one for each component that depends on time, and one for the rest."""
    values = msgspec.structs.asdict(force)
    kind = str(force.__struct_config__.tag)
    entry = f"forces[{index}] ({kind})"
    for key in ("stiffness", "damping", "free_length"):
        check_not_negative(f"{entry}: {key}", values.get(key, 0.0))
    parent, child, joint, law = None, None, None, FORCE_TYPES[kind]
    if law.on_joint:
        joint = _joint_of(f"{entry}: joint", scene, values.pop("joint"), {
            "slide": "slides", "angle": "has_angle"}.get(law.measure, "has_one"), f"it has no {law.measure}").name
    else:
        child = _body_index(f"{entry}: child", bodies, values.pop("child"), ground=False)
    if "parent" in values:
        parent = _body_index(f"{entry}: parent", bodies, values.pop("parent"), ground=True)
        if parent == child:
            raise EntryError(f"{entry}: child", "joins a body to itself", "name two different bodies")
    if law.effort is not None:
        return [Force(kind, parent, child, joint, {key: joint_options.function(f"{entry}: {key}", value, scene.duration)
                                                   for key, value in values.items()})]
    vector = law.measure
    components = [joint_options.function(f"{entry}: {vector}[{k}]", value, scene.duration)
                  for k, value in enumerate(values[vector])]
    constant = tuple(0.0 if isinstance(value, TimeFunction) else value for value in components)
    timed = [(axis, value) for axis, value in zip(np.eye(3).tolist(), components, strict=True)
             if isinstance(value, TimeFunction)]
    steady = [] if timed and not any(constant) else [Force(kind, parent, child, joint, values | {vector: constant})]
    return steady + [Force(kind, parent, child, joint, values | {vector: tuple(axis), "factor": value})
                    for axis, value in timed]


def _servo(scene: SceneEntry, index: int, force: ServoEntry) -> list[Force]:
    """A servo, with those of its keys that the file gives."""
    entry = f"forces[{index}] (servo)"
    joint = _joint_of(f"{entry}: joint", scene, force.joint)
    for key in ("mimic", "drive"):
        if getattr(joint, key) is not None:
            raise EntryError(f"{entry}: joint", f'"{joint.name}" has a {key}, which says all of its motion',
                             "name a joint that moves by itself" + (", or the one that it follows"
                                                                    if key == "mimic" else ""))
    values = {key: joint_options.function(f"{entry}: {key}", value, scene.duration)
              for key, value in msgspec.structs.asdict(force).items() if key != "joint" and value is not None}
    for key in ("proportional", "derivative", "delay"):
        check_not_negative(f"{entry}: {key}", values[key], number="a whole number" if key == "delay" else "a number")
    for key in ("period", "no_load_speed"):
        check_positive(f"{entry}: {key}", values.get(key, 1.0))
    if force.delay and force.period is None:
        raise EntryError(f"{entry}: delay", "counts periods, and there is no period", "add period, a number of s > 0")
    if force.no_load_speed is not None and force.effort_limit is None:
        raise EntryError(f"{entry}: no_load_speed", "there is no limit that falls to 0 there", "add effort_limit")
    if force.target_velocity is None and isinstance(values["target"], TimeFunction):
        values["target_velocity"] = values["target"].derivative(1)
    if isinstance(limit := force.effort_limit, float):
        check_positive(f"{entry}: effort_limit", limit)
        values["effort_limit"] = (-limit, limit)
    elif limit is not None and limit[0] >= limit[1]:
        raise EntryError(f"{entry}: effort_limit", f"lower {limit[0]:g} is not below upper {limit[1]:g}",
                         "write [lower, upper]")
    return [Force("servo", None, None, joint.name, values)]


def _shape(bodies: Mapping[str, int], entry: str, shape: ShapeEntry, folder: Path) -> Shape:
    words = SIZES[shape.type]
    if len(shape.size) != len(words):
        raise EntryError(f"{entry}: size", f"{len(shape.size)} given, a {shape.type} has {len(words)}",
                         f"write [{', '.join(words)}] in m" if words else "remove it")
    check_positive(f"{entry}: size", min(shape.size, default=1.0), "m")
    points = np.array(shape.points).reshape(-1, 3)
    for key, given in (("file", shape.file is not None), ("points", bool(shape.points))):
        if given and shape.type != "mesh":
            raise EntryError(f"{entry}: {key}", f"a {shape.type} has none", "remove it")
    if shape.type == "mesh":
        if (shape.file is None) == (not shape.points):
            raise EntryError(f"{entry}: file", "a mesh has a file or points, one of the two",
                             'write file = "foot.stl", or points')
        if shape.file is not None:
            points = _corners(f"{entry}: file", folder / shape.file)
        if np.linalg.matrix_rank(points - points.mean(axis=0)) < 3:
            raise EntryError(f"{entry}: {'points' if shape.file is None else 'file'}", "its points lie in a plane",
                             "give points that enclose a volume")
    body = _body_index(f"{entry}: body", bodies, shape.body, ground=True)
    attitude = _unit(f"{entry}: attitude", shape.attitude, "write a quaternion w, x, y, z")
    return Shape(shape.name, body, shape.type, tuple(shape.size), tuple(shape.position), tuple(attitude.tolist()),
                 tuple(tuple(point) for point in points.tolist()))


def _corners(entry: str, path: Path) -> np.ndarray:
    """The corners (N, 3) of a mesh, each once; raises `EntryError` that names the entry if there are none."""
    mend = "give an STL or OBJ file"
    try:
        content = path.read_bytes()
    except OSError as error:
        raise EntryError(entry, f"{path} cannot be read, {(error.strerror or str(error)).lower()}", mend) from None
    count = int.from_bytes(content[80:84], "little")
    if path.suffix.lower() == ".stl" and len(content) == 84 + 50 * count:  # binary: normal, three corners, two bytes
        rows = np.frombuffer(content, np.uint8, offset=84).reshape(count, 50)[:, 12:48].tobytes()
        points = np.frombuffer(rows, "<f4").astype(float).reshape(-1, 3)
    else:
        try:
            points = np.array([list(map(float, corner)) for corner in _CORNER.findall(content)]).reshape(-1, 3)
        except ValueError:
            points = np.empty((0, 3))
    if not len(points) or not np.isfinite(points).all():
        raise EntryError(entry, f"{path} has no corners of a mesh", mend)
    return np.unique(points, axis=0)


def _monitor(scene: SceneEntry, index: int, monitor: MonitorEntry) -> Monitor:
    kind = str(monitor.__struct_config__.tag)
    entry = f"monitors[{index}] ({kind})"
    if not isinstance(monitor, TouchEntry):
        joint = _joint_of(f"{entry}: joint", scene, monitor.joint)
        laws = {each.__struct_config__.tag for each in scene.forces if getattr(each, "joint", None) == joint.name}
        motors = [name for name, law in FORCE_TYPES.items() if law.is_motor]
        if kind == "effort" and not laws.intersection(motors):
            raise EntryError(f"{entry}: joint", f'"{joint.name}" has no {", ".join(motors[:-1])} or {motors[-1]}',
                             "name a joint with an actuator")
        lower, upper = joint_options.range_of(entry, monitor.lower, monitor.upper)
        return Monitor(kind, joint=joint.name, lower=lower, upper=upper)
    shapes = {shape.name: shape for shape in scene.shapes}
    for name in monitor.shapes:
        check_named(f"{entry}: shapes", "shape", name, shapes)
    check_not_negative(f"{entry}: margin", monitor.margin, "m")
    first, second = (shapes[name] for name in monitor.shapes)
    if first.body == second.body:
        raise EntryError(f"{entry}: shapes", f'both are of "{first.body}" and never move against each other',
                         "name shapes of two bodies")
    if first.type == second.type == "plane":
        raise EntryError(f"{entry}: shapes", "both are planes, which have no end and no distance", "name another shape")
    return Monitor(kind, monitor.shapes, monitor.margin)


def _joint_of(entry: str, scene: SceneEntry, name: str, has: str = "has_one",
              lacks: str = "not one with a single angle or slide") -> JointEntry:
    """The joint with this name, checked to be of a type that `has` it."""
    joints = {joint.name: joint for joint in scene.joints}
    check_named(entry, "joint", name, joints)
    if joints[name].type not in (fitting := joint_types(has)):
        raise EntryError(entry, f'"{name}" is a {joints[name].type} joint, {lacks}',
                         f"name a joint of type {listed(fitting)}")
    return joints[name]


def check_start(scene: Scene) -> None:
    """Raise if the complete initial state is beyond a limit or a monitor."""
    now = {}
    if scene.monitors or any(joint.limits for joint in scene.joints):
        now = coordinates.at_start(scene)
    for index, joint in enumerate(scene.joints):
        for limits, q in zip(joint.limits, now.get(joint.name, ((),))[0], strict=False):
            if limits is not None and abs(limits.depth(q)) > START_TOLERANCE * max(1.0, abs(q)):
                raise EntryError(f'joints[{index}] "{joint.name}": limits', f"the start, {q:.6g}, is beyond "
                                 f"[{limits.lower:g}, {limits.upper:g}]", "start inside, or correct the limits")
    for index, monitor in enumerate(scene.monitors):
        if monitor.joint is None:
            continue
        q, rate = (float(value[0]) for value in now[monitor.joint])
        value = {"range": q, "speed": rate, "effort": scene.effort_at_start(monitor.joint, q, rate)}[monitor.type]
        if max(monitor.lower - value, value - monitor.upper) > START_TOLERANCE * max(1.0, abs(value)):
            raise EntryError(f"monitors[{index}] ({monitor.type})", f'"{monitor.joint}" starts with {value:.6g}, '
                             f"beyond [{monitor.lower:g}, {monitor.upper:g}]", "start inside, or correct the monitor")


def check_touching(scene: Scene) -> None:
    """Raise if two watched shapes touch at the start; nothing is known without the library of the distances."""
    if not any(monitor.joint is None for monitor in scene.monitors) or not touching.available():
        return
    watched = touching.Touching(scene)
    for index, gap in zip(watched.monitors, watched.gaps(scene.x0, scene.R0), strict=True):
        if gap < 0:
            monitor = scene.monitors[index]
            raise EntryError(f"monitors[{index}] (touch)", f"at the start {monitor.name} are "
                             f"{gap + monitor.margin:.3g} m apart, with a margin of {monitor.margin:g} m",
                             "start with them apart, or remove it")
