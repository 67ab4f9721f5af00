"""The scene: what the mechanical system is, and nothing about how it is solved.

SI units. Attitudes map body axes to world axes; quaternions are (w, x, y, z); angular velocities are in body axes,
everything else is in world axes unless a field says otherwise. Files are read by `crosscheck.scene.file`.
"""

from __future__ import annotations

import dataclasses
import functools
import hashlib
import json
import types
from collections.abc import Container, Mapping
from typing import Any, NamedTuple

import numpy as np

from crosscheck.errors import SceneError
from crosscheck.scene.functions import TimeFunction, Value, at
from crosscheck.scene.joints import JOINT_TYPES, JointType
from crosscheck.scene.laws import FORCE_TYPES, DryFriction, ForceType, Limits, Monitor, Servo, Shape
from crosscheck.scene.vectors import normal_references, shortest_rotation

GROUND = -1
"""Body index of the ground."""

SMOOTH = ("frame", "armature", "mimic", "drive", "slip", "joint_torque", "function")
"""Elements of scenes without jumps that an engine must declare if it can model them."""

ELEMENTS = (*SMOOTH, "dry_friction", "static_friction", "limits", "soft_limits", "servo", "sampled_servo",
            "effort_limit", "no_load_speed", "hold")
"""All elements that an engine must declare. A servo may need four: effort_limit and no_load_speed cut it. A further
type of `FORCE_TYPES` is an element of its own name."""

ACTS = "acts at the start: "
"""How `LeftOut.what` begins for what would act at once."""


class LeftOut(NamedTuple):
    """Something of a model that its scene lacks or has otherwise, as "dry friction of joint", "elbow", .3.

    `where` is the name of what has it, or ""; `value` is its number or numbers in the model's own units and axes, or
    more about it in words.
    """

    where: str
    what: str
    value: float | str | tuple[float | str, ...] = ""

    @property
    def sentence(self) -> str:
        """The same without numbers."""
        words = [each for each in self._values if isinstance(each, str) and each]
        return ", ".join((f"{self.what} {self.where!r}" if self.where else self.what, *words))

    @property
    def _values(self) -> tuple[float | str, ...]:
        return self.value if isinstance(self.value, tuple) else (self.value,)

    def __str__(self) -> str:
        numbers = ", ".join(f"{each:g}" for each in self._values if not isinstance(each, str))
        return f"{self.sentence}: {numbers}" if numbers else self.sentence


COORDINATE_NAMES = {"turn": "angle", "slide": "slide", "slide n1": "x", "slide n2": "y", "turn parent": "first",
                    "turn child": "second"}
"""The coordinates of joints that have several, by the words of `JointType.coordinates`."""


def _frozen(values: object, shape: tuple[int, ...]) -> np.ndarray:
    """A copy that nobody can write to. Its memory is that of a `bytes` object, so that no flag makes it writable."""
    return np.frombuffer(np.array(values, dtype=float).tobytes()).reshape(shape)


class _Record:
    """Base of the frozen records of a scene. Copies and pickles are made from the fields, which freezes them again."""

    def __reduce__(self) -> tuple[object, ...]:
        values = (getattr(self, field.name) for field in dataclasses.fields(self))  # type: ignore[arg-type]
        return type(self), tuple(dict(value) if isinstance(value, Mapping) else value for value in values)


def rotation_from_quaternion(quaternion: np.ndarray) -> np.ndarray:
    """Rotation matrices (..., 3, 3), body to world, of unit quaternions (..., 4) in the order w, x, y, z."""
    w, x, y, z = np.moveaxis(np.asarray(quaternion, dtype=float), -1, 0)
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def quaternion_from_rotation(R: np.ndarray) -> np.ndarray:
    """Unit quaternions (..., 4), w first and not negative, of rotation matrices (..., 3, 3)."""
    from scipy.spatial.transform import Rotation

    quaternion: np.ndarray = Rotation.from_matrix(R).as_quat(canonical=True, scalar_first=True)
    return quaternion


def quaternion_from_turn(turn: np.ndarray) -> np.ndarray:
    """Unit quaternions (..., 4) of rotation vectors (..., 3), rad."""
    angles = np.linalg.norm(turn, axis=-1, keepdims=True)
    return np.concatenate([np.cos(angles / 2), 0.5 * np.sinc(angles / (2 * np.pi)) * turn], axis=-1)


def quaternion_product(p: np.ndarray, q: np.ndarray) -> np.ndarray:
    """Products of quaternions, (..., 4), w first: the rotation q, then p."""
    scalar = p[..., :1] * q[..., :1] - np.sum(p[..., 1:] * q[..., 1:], axis=-1, keepdims=True)
    vector = p[..., :1] * q[..., 1:] + q[..., :1] * p[..., 1:] + np.cross(p[..., 1:], q[..., 1:])
    return np.concatenate([scalar, vector], axis=-1)


@dataclasses.dataclass(frozen=True)
class Mimic:
    """The coordinate of a joint follows that of another: ratio times it, plus offset (rad or m)."""

    joint: str
    ratio: float
    offset: float = 0.0


@dataclasses.dataclass(frozen=True)
class Body(_Record):
    """A rigid body in its initial state."""

    name: str
    mass: float  # kg; 0 of a frame between joints
    inertia: np.ndarray  # (3, 3) kg m^2 about the centre of mass, body axes; 0 of a frame
    attitude: np.ndarray  # (4,) unit quaternion w, x, y, z
    angular_velocity: np.ndarray  # (3,) rad/s, body axes
    position: np.ndarray  # (3,) centre of mass, world
    velocity: np.ndarray  # (3,) centre of mass, world
    origin: np.ndarray = dataclasses.field(default_factory=lambda: np.zeros(3))  # (3,) of the frame that its model file
    # gives it, from the centre of mass, body axes: the point that other programs record; not part of the hash

    def __post_init__(self) -> None:
        for field, shape in (("inertia", (3, 3)), ("attitude", (4,)), ("angular_velocity", (3,)),
                             ("position", (3,)), ("velocity", (3,)), ("origin", (3,))):
            object.__setattr__(self, field, _frozen(getattr(self, field), shape))


@dataclasses.dataclass(frozen=True)
class Joint(_Record):
    """A joint between two bodies, or a body and the ground (index -1)."""

    name: str
    type: str
    parent: int  # index of a body, -1: the ground
    child: int
    parent_anchor: np.ndarray  # (3,) m, from the parent's centre of mass in its frame; world for the ground
    child_anchor: np.ndarray  # (3,) from the child's centre of mass in its frame
    parent_axis: Any = None  # (3,) unit, parent's frame; None for types without one
    child_axis: Any = None  # (3,) unit, child's frame; None for types without one
    length: Any = None  # m, distance joints only
    radius: Any = None  # m, of a rolling disk or sphere
    reference: Any = None  # (4,) quaternion of the child in the parent at zero coordinates; None: the type's default
    start: tuple[float, ...] | None = None  # coordinates at the start; they give the full turns of angles
    armature: tuple[float, ...] = ()  # kg m^2 or kg per coordinate; adds only the energy 1/2 armature rate^2
    damping: tuple[float, ...] = ()  # per coordinate, as the next two; `springs` has them as loads
    stiffness: tuple[float, ...] = ()
    rest_position: tuple[float, ...] = ()
    mimic: Mimic | None = None
    drive: TimeFunction | None = None  # the coordinate, rad or m, of a revolute or prismatic joint
    dry_friction: tuple[DryFriction | None, ...] = ()  # per coordinate, as the next
    limits: tuple[Limits | None, ...] = ()

    @property
    def kind(self) -> JointType:
        """Its entry in the table of types."""
        return JOINT_TYPES[self.type]

    @property
    def zero_angle(self) -> float:
        """Angle of a hinge at zero coordinate, rad in (-pi, pi], from the shortest turn of its child's axis.

        That of a torsional spring is counted from there, that of the joint from its reference, if it has one.
        """
        if self.reference is None:
            return 0.0
        n1, n2 = normal_references(self.parent_axis)
        pointer = rotation_from_quaternion(self.reference) @ shortest_rotation(
            self.child_axis, self.parent_axis).T @ n1
        return float(np.arctan2(pointer @ n2, pointer @ n1))

    def rest(self, spring: Force) -> Value:
        """The coordinate at which one of its springs rests, rad or m: a number or a function of time."""
        rest: Value = spring.parameters[spring.law.rest]
        zero = self.zero_angle if spring.law.measure == "angle" else 0.0
        return rest.plus(-zero) if isinstance(rest, TimeFunction) else float(rest) - zero

    @functools.cached_property
    def springs(self) -> tuple[Force, ...]:
        """Its springs and dampers: a torsional_spring about its axis, a slide_spring along it."""
        made = []
        for k, word in enumerate(self.kind.coordinates if self.damping or self.stiffness else ()):
            stiffness, damping, rest = (values[k] if values else 0.0
                                        for values in (self.stiffness, self.damping, self.rest_position))
            kind, at_rest = (("torsional_spring", {"rest_angle": rest + self.zero_angle}) if word == "turn" else
                             ("slide_spring", {"rest_position": rest}))
            if stiffness or damping:
                made.append(Force(kind, None, None, self.name, {"stiffness": stiffness, "damping": damping} | at_rest))
        return tuple(made)

    def __post_init__(self) -> None:
        for field in ("parent_anchor", "child_anchor", "parent_axis", "child_axis"):
            if getattr(self, field) is not None:
                object.__setattr__(self, field, _frozen(getattr(self, field), (3,)))
        if self.reference is not None:
            object.__setattr__(self, "reference", _frozen(self.reference, (4,)))


@dataclasses.dataclass(frozen=True)
class Force(_Record):
    """A spring-damper, a load or the drive of a joint; `parameters` holds the keys of its type, arrays as tuples.

    A constant_force or constant_torque may have a `factor`, a function of time that multiplies it; rest_angle and the
    torque or force of a joint may be functions themselves. A slide_spring (stiffness, damping, rest_position) is in no
    file: joints with a slide have it.
    """

    type: str
    parent: Any  # body index, -1 for the ground; None for types without one
    child: Any  # body index; None for types without one
    joint: Any  # joint name, for what acts about or along a joint's axis
    parameters: Mapping[str, Any]

    def __post_init__(self) -> None:
        object.__setattr__(self, "parameters", types.MappingProxyType(dict(self.parameters)))

    @property
    def law(self) -> ForceType:
        """Its entry in the table of types."""
        return FORCE_TYPES[self.type]

    @property
    def is_spring(self) -> bool:
        """Whether it is a spring-damper: between two points, or about or along the axis of a joint."""
        return self.law.stores

    @property
    def is_motor(self) -> bool:
        """Whether it drives a coordinate of a joint."""
        return self.law.is_motor

    def at(self, t: object) -> dict[str, Any]:
        """The parameters at times t, of which any have the shape of t."""
        return {key: at(value, t) for key, value in self.parameters.items()}

    @property
    def functions(self) -> tuple[TimeFunction, ...]:
        """The functions of time among the parameters."""
        return tuple(value for value in self.parameters.values() if isinstance(value, TimeFunction))


@dataclasses.dataclass(frozen=True)
class Site(_Record):
    """A frame fixed to a body, or to the ground (index -1)."""

    name: str
    body: int
    position: np.ndarray  # (3,) from the body's centre of mass, its axes; world for the ground
    attitude: np.ndarray  # (4,) unit quaternion w, x, y, z of the site in the body

    def __post_init__(self) -> None:
        object.__setattr__(self, "position", _frozen(self.position, (3,)))
        object.__setattr__(self, "attitude", _frozen(self.attitude, (4,)))


@dataclasses.dataclass(frozen=True)
class Sensor:
    """Something that is measured; its types are those of `crosscheck.scene.sensors`."""

    name: str
    type: str
    site: str | None = None
    joint: str | None = None
    frame: str = ""  # "site" or "world"; "" for types without axes


@dataclasses.dataclass(frozen=True)
class Published(_Record):
    """A figure that somebody else printed for this scene. It is compared with truth, and never used as truth."""

    source: str
    quantity: str  # "position" ... "joint_velocity", "energy", "eigenvalue"
    value: tuple[float, ...]
    error: float  # what its printed digits allow
    body: int | None = None
    joint: str | None = None
    time: float | None = None  # s


class Motor(NamedTuple):
    """An actuator of an imported model: what its control is to a joint, "effort", "target" or "target_velocity"."""

    name: str
    joint: str
    control: str
    factor: float  # of the control, in SI: gain and gear


@dataclasses.dataclass(frozen=True)
class Scene(_Record):
    """An engine-neutral mechanical system with its complete initial state, duration and output times."""

    name: str
    bodies: tuple[Body, ...]
    joints: tuple[Joint, ...]
    forces: tuple[Force, ...]
    gravity: np.ndarray  # (3,) world
    duration: float  # s
    samples: int  # number of output times, from 0 to the duration
    description: str = ""
    source: str = ""
    tags: tuple[str, ...] = ()
    left_out: tuple[LeftOut, ...] = ()  # what an import dropped or read otherwise; not part of the hash
    motors: tuple[Motor, ...] = ()  # by which columns of a log are known; not part of the hash
    shapes: tuple[Shape, ...] = ()
    monitors: tuple[Monitor, ...] = ()  # the scene describes the motion until the first of these
    sites: tuple[Site, ...] = ()
    sensors: tuple[Sensor, ...] = ()
    published: tuple[Published, ...] = ()  # not part of the hash
    file: tuple[str, str] | None = dataclasses.field(default=None, repr=False)
    """Path and content (JSON) of the file it was read from, to which paths of numbers refer; not part of the hash."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "gravity", _frozen(self.gravity, (3,)))

    def joint(self, name: object) -> Joint:
        """The joint of this name."""
        return next(joint for joint in self.joints if joint.name == name)

    def __repr__(self) -> str:
        return (f"Scene({self.name}: {len(self.bodies)} bodies, {len(self.joints)} joints, {len(self.forces)} forces, "
                f"{self.duration:g} s, {self.samples} samples)")

    @property
    def interval(self) -> float:
        """Time between two outputs, s."""
        return self.duration / (self.samples - 1)

    @property
    def n(self) -> int:
        """Number of bodies."""
        return len(self.bodies)

    @property
    def t(self) -> np.ndarray:
        """Output times, (samples,), from 0 to `duration`."""
        return np.linspace(0.0, self.duration, self.samples)

    @functools.cached_property
    def loads(self) -> tuple[Force, ...]:
        """All that acts: the springs and dampers of joints, and after them the forces."""
        return (*(spring for joint in self.joints for spring in joint.springs), *self.forces)

    @functools.cached_property
    def masses(self) -> np.ndarray:
        """(n,) masses, kg."""
        return _frozen([body.mass for body in self.bodies], (-1,))

    @functools.cached_property
    def inertias(self) -> np.ndarray:
        """(n, 3, 3) inertias about the centres of mass, body axes, kg m^2."""
        return _frozen([body.inertia for body in self.bodies], (-1, 3, 3))

    @functools.cached_property
    def frames(self) -> np.ndarray:
        """(n,) which bodies are frames between joints: they have no mass and no inertia."""
        return np.asarray(self.masses == 0.0)

    def on_frame(self, joint: Joint) -> bool:
        """Whether one of the two bodies of a joint is a frame, which cannot end a branch of a tree."""
        return any(body != GROUND and self.frames[body] for body in (joint.parent, joint.child))

    @functools.cached_property
    def x0(self) -> np.ndarray:
        """(n, 3) centres of mass, world."""
        return _frozen([body.position for body in self.bodies], (-1, 3))

    @functools.cached_property
    def R0(self) -> np.ndarray:
        """(n, 3, 3) attitudes, body to world."""
        attitudes = np.array([body.attitude for body in self.bodies]).reshape(-1, 4)
        return _frozen(rotation_from_quaternion(attitudes), (-1, 3, 3))

    @functools.cached_property
    def v0(self) -> np.ndarray:
        """(n, 3) velocities of the centres of mass, world."""
        return _frozen([body.velocity for body in self.bodies], (-1, 3))

    @functools.cached_property
    def w0(self) -> np.ndarray:
        """(n, 3) angular velocities, body axes."""
        return _frozen([body.angular_velocity for body in self.bodies], (-1, 3))

    def beyond(self, known: Container[str] = (), tree: Container[str] = ()) -> str | None:
        """Why an engine that knows only `known` of ELEMENTS cannot model the scene, or None if it can.

        `tree`: those that it has in form tree.
        """
        def why(element: str) -> str:
            return "needs a joint coordinate: form tree has them" if element in tree else "is not built here"

        if self.frames.any() and "frame" not in known:
            name = self.bodies[int(self.frames.argmax())].name
            return f"body {name!r} is a frame without mass, which {why('frame')}"
        for joint in self.joints:
            for element, there, what in (
                    ("armature", any(joint.armature), "the key armature"),
                    ("mimic", joint.mimic is not None, "the key mimic"),
                    ("drive", joint.drive is not None, "the key drive"),
                    ("dry_friction", any(joint.dry_friction), "the key dry_friction"),
                    ("static_friction", any(each and each.static > each.sliding for each in joint.dry_friction),
                     "dry_friction with a static value above the sliding one"),
                    ("limits", any(each and each.rigid for each in joint.limits), "limits with rigid stops"),
                    ("soft_limits", any(each and not each.rigid for each in joint.limits),
                     "limits with stiffness and damping")):
                if there and element not in known:
                    return f"joint {joint.name!r} has {what}, which {why(element)}"
            if joint.kind.slips and "slip" not in known:
                return (f"joint {joint.name!r} is a {joint.type}, whose rows against slip hold velocities alone; "
                        "such rows are not built here")
        for index, force in enumerate(self.forces):
            element = force.type if force.law.element is None else force.law.element
            if element and element not in known and index not in self.servos:
                return f"forces[{index}] is a {force.type}, a type that {why(element)}"
            if index in self.servos:
                for element, key in (("servo", "proportional"), ("sampled_servo", "period"),
                                     ("effort_limit", "effort_limit"), ("no_load_speed", "no_load_speed")):
                    if key in force.parameters and element not in known:
                        what = "a type" if element == "servo" else f"its {key}"
                        return f"forces[{index}] is a servo of joint {force.joint!r}, {what} that {why(element)}"
            if force.functions and "function" not in known:
                return f"forces[{index}] ({force.type}) depends on time, which is not built here"
            if "hold" not in known and any(function.jumps for function in force.functions):
                return f"forces[{index}] ({force.type}) has a function of time that jumps, which is not built here"
        return None

    @functools.cached_property
    def servos(self) -> Mapping[int, tuple[str, Servo]]:
        """The servos with the names of their joints, by their indices among the forces."""
        return {index: (force.joint, Servo(**force.parameters)) for index, force in enumerate(self.forces)
                if force.law.has_modes}

    def effort_at_start(self, joint: str, q: float, rate: float) -> float:
        """What the actuators of a joint give at t = 0, where its coordinate and rate are these."""
        given = (force for index, force in enumerate(self.forces)
                 if force.joint == joint and force.is_motor and index not in self.servos)
        servos = (servo for name, servo in self.servos.values() if name == joint)
        return float(sum(force.law.effort(force.at(0.0), q, rate) for force in given)
                     + sum(0.0 if servo.delay else servo.effort(0.0, q, rate) for servo in servos))

    @functools.cached_property
    def coordinates(self) -> tuple[str, ...]:
        """Names of the coordinates: of free bodies, whose joints only lead on, then in the order of the joints.

        A joint with one coordinate gives it its name. A ball's are the rotation vector of a small turn in child axes, a
        free body's its position in the world and such a turn in its own axes.
        """
        carried = {joint.child for joint in self.joints}
        names = [f"{body.name}.{part}" for k, body in enumerate(self.bodies) if k not in carried
                 for part in ("x", "y", "z", "rx", "ry", "rz")]
        for joint in self.joints:
            words = joint.kind.coordinates
            parts = ("rx", "ry", "rz") if words == ("ball",) else tuple(COORDINATE_NAMES[word] for word in words)
            names += [joint.name] if len(parts) == 1 else [f"{joint.name}.{part}" for part in parts]
        return tuple(names)

    @functools.cached_property
    def hinges(self) -> tuple[tuple[str, int], ...]:
        """The coordinates that are angles, in the order of the joints: the joint's name, and the number in it."""
        return tuple((joint.name, k) for joint in self.joints for k, word in enumerate(joint.kind.coordinates)
                     if word.startswith("turn"))

    @property
    def has_laws(self) -> bool:
        """Whether a joint has dry friction, limits or a servo, so that forces or rates may jump with the state."""
        return bool(self.servos) or any(joint.dry_friction or joint.limits for joint in self.joints)

    @property
    def unloaded(self) -> Scene:
        """The scene without forces, and without the springs and dampers of its joints."""
        return self.replace(forces=(), joints=tuple(
            dataclasses.replace(joint, stiffness=(), damping=()) for joint in self.joints))

    @property
    def lawless(self) -> Scene:
        """The scene without servos, dry friction, limits and monitors."""
        joints = tuple(dataclasses.replace(joint, dry_friction=(), limits=()) for joint in self.joints)
        forces = tuple(force for force in self.forces if not force.law.has_modes)
        return self.replace(joints=joints, forces=forces, monitors=())

    @property
    def timed(self) -> bool:
        """Whether anything depends on time."""
        return bool(self.functions) or any(servo.period is not None for _, servo in self.servos.values())

    @property
    def functions(self) -> tuple[TimeFunction, ...]:
        """All functions of time: of forces, then of drives."""
        return (*(function for force in self.forces for function in force.functions),
                *(joint.drive for joint in self.joints if joint.drive is not None))

    @property
    def worked_on(self) -> bool:
        """Whether loads, dampers or functions of time may do work, so that the energy is not conserved."""
        return self.timed or self.has_laws or any(
            not force.is_spring or force.parameters["damping"] > 0 for force in self.loads)

    def delayed(self, by: float) -> Scene:
        """The scene with its functions of time delayed by this many seconds."""
        if not self.timed:
            return self
        forces = (dataclasses.replace(force, parameters={
            key: value.delayed(by) if isinstance(value, TimeFunction) else value
            for key, value in force.parameters.items()} | (
                {"phase": (force.parameters.get("phase", 0.0) + by) % force.parameters["period"]}
                if force.parameters.get("period") else {})) for force in self.forces)
        joints = (joint if joint.drive is None else dataclasses.replace(joint, drive=joint.drive.delayed(by))
                  for joint in self.joints)
        return self.replace(forces=tuple(forces), joints=tuple(joints))

    @property
    def breaks(self) -> tuple[float, ...]:
        """Those of `knots` that are inside the run."""
        return tuple(t for t in self.knots if t < self.duration)

    @property
    def knots(self) -> tuple[float, ...]:
        """Times (s) after 0 at which a derivative of a function of time jumps, also beyond the duration, in order."""
        return tuple(sorted({t for function in self.functions for t in function.inner_breaks if t > 0.0}))

    def lasting(self, duration: float) -> Scene:
        """The scene with another duration (s); raises `SceneError` if a spline is not known so long."""
        end = min((function.end for function in self.functions), default=np.inf)
        if duration > end * (1 + 1e-12):
            raise SceneError(f"duration: the table of a spline of scene {self.name!r} ends at {end:g} s, before "
                             f"{duration:g} s; give it a longer table, or a shorter duration")
        return self.replace(duration=float(duration))

    def replace(self, **changes: Any) -> Scene:
        """A copy with some fields changed, such as `duration` or `samples`."""
        return dataclasses.replace(self, **changes)

    @property
    def key(self) -> str:
        """SHA-256 of the system: of all that determines its motion, without its times.

        It is computed from the values at each call, so that no altered scene keeps the key of an honest one. The name
        of the scene and the texts about it do not count; the names of bodies and joints do, because results have them.
        """
        return _digest(self._content())

    @property
    def hash(self) -> str:
        """SHA-256 of the system with its output times and sensors."""
        watched = {key: [_plain(record) for record in records]
                   for key, records in (("sites", self.sites), ("sensors", self.sensors)) if records}
        return _digest(self._content() | {"duration": self.duration, "samples": self.samples} | watched)

    def json(self) -> str:
        """The system with its start and its output times as JSON, in SI, for programs in other languages.

        The keys are those of `Body`, `Joint` and `Force`; a joint names its bodies by their indices, the ground is -1.
        The output times are `samples` instants from 0 to `duration` (s), evenly spaced.
        """
        return json.dumps({"name": self.name, "duration": self.duration, "samples": self.samples} | self._content())

    def _content(self) -> dict[str, object]:
        return {"gravity": self.gravity.tolist(), "bodies": [_plain(body) for body in self.bodies],
                "joints": [_plain(joint) for joint in self.joints],
                "forces": [_plain(force) for force in self.forces]} | {
                    group: [dataclasses.astuple(each) for each in given]
                    for group, given in (("shapes", self.shapes), ("monitors", self.monitors)) if given}


_OPTIONAL = frozenset({"armature", "damping", "stiffness", "rest_position", "mimic", "drive", "radius", "reference",
                       "start", "dry_friction", "limits"})
"""Fields that count only where they are given: scenes without them keep the hash that older releases stored."""


def _digest(content: dict[str, object]) -> str:
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()


def _plain(record: Any) -> dict[str, object]:
    """A dataclass as JSON values; floats keep every bit."""
    fields = {field.name: getattr(record, field.name) for field in dataclasses.fields(record)}
    return {name: _value(value) for name, value in fields.items() if name != "origin"  # it changes no motion
            and not (name in _OPTIONAL and (value is None or (isinstance(value, tuple) and not value)))}


def _value(value: object) -> Any:
    if isinstance(value, np.ndarray):
        return value.tolist()
    if isinstance(value, Mapping):
        return {key: _value(each) for key, each in value.items()}
    if isinstance(value, tuple) and any(isinstance(each, DryFriction | Limits) for each in value):
        return [None if each is None else dataclasses.astuple(each) for each in value]
    if isinstance(value, TimeFunction):  # what is known of it does not change the motion
        return value.breaks, value.pieces, value.terms
    return dataclasses.astuple(value) if isinstance(value, Mimic) else value
