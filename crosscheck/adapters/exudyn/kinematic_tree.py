"""Exudyn's ObjectKinematicTree from a scene: joints of one degree of freedom each, in joint coordinates.

Slides and turns of a link become prismatic and revolute joints along an axis of their own frame; a ball becomes three
revolute joints in a Cardan order. A body welded to another shares its link; one welded to the ground has none.
"""

from __future__ import annotations

import dataclasses
import functools
from typing import Any

import numpy as np

from crosscheck.adapters.common import links, tree
from crosscheck.adapters.common.links import Link, Part
from crosscheck.adapters.exudyn import items
from crosscheck.adapters.exudyn.independent import dropped_axes
from crosscheck.adapters.exudyn.items import Carrier
from crosscheck.adapters.exudyn.models import Model, mark_frame, new_system, pose, watch
from crosscheck.scene.model import GROUND, Joint, Scene, rotation_from_quaternion
from crosscheck.scene.states import States
from crosscheck.scene.vectors import normal_references

AXES = dict(zip("XYZ", np.eye(3), strict=True))


@dataclasses.dataclass
class _Seat:
    """The joint of the tree that carries a body (-1: the ground), and the body's pose in that joint's frame."""

    joint: int
    at: np.ndarray  # (3,) centre of mass
    turn: np.ndarray  # (3, 3) body axes to the joint's frame


@dataclasses.dataclass
class _Tree:
    """The columns of ObjectKinematicTree, with one entry per joint."""

    kinds: list[str] = dataclasses.field(default_factory=list)
    parents: list[int] = dataclasses.field(default_factory=list)
    turns: list[np.ndarray] = dataclasses.field(default_factory=list)
    offsets: list[np.ndarray] = dataclasses.field(default_factory=list)
    masses: list[float] = dataclasses.field(default_factory=list)
    centres: list[np.ndarray] = dataclasses.field(default_factory=list)
    inertias: list[np.ndarray] = dataclasses.field(default_factory=list)

    def hang(self, kind: str, parent: int, offset: np.ndarray, turn: np.ndarray) -> int:
        """Add a massless joint, with its frame given in its parent's; returns its index."""
        self.kinds.append(kind)
        self.parents.append(parent)
        self.offsets.append(offset)
        self.turns.append(turn)
        self.masses.append(0.0)
        self.centres.append(np.zeros(3))
        self.inertias.append(np.zeros((3, 3)))
        return len(self.kinds) - 1

    def load(self, joint: int, mass: float, centre: np.ndarray, inertia: np.ndarray) -> None:
        """Add a rigid body to a joint; `centre` and `inertia` (about it) are in the joint's frame."""
        if joint == GROUND:
            return
        total = self.masses[joint] + mass
        middle = (self.masses[joint] * self.centres[joint] + mass * centre) / total
        both = ((self.masses[joint], self.centres[joint], self.inertias[joint]), (mass, centre, inertia))
        self.inertias[joint] = np.sum([own + part * _parallel(at - middle) for part, at, own in both], axis=0)
        self.masses[joint], self.centres[joint] = total, middle


def _parallel(arm: np.ndarray) -> np.ndarray:
    found: np.ndarray = arm @ arm * np.eye(3) - np.outer(arm, arm)
    return found


def spanned(scene: Scene) -> tuple[tuple[Link, ...], tuple[Joint, ...]]:
    """Links of the scene's tree, and the joints that are constraints between them.

    Rods are constraints: two revolute joints for a rod's direction would have singular positions.
    """
    return links.unfold(scene, always_cut=("distance",))


def balls(scene: Scene) -> list[Link]:
    """The links with a ball, for which the Cardan order matters."""
    return [link for link in spanned(scene)[0] if any(part.kind == "ball" for part in link.parts)]


def expanded(link: Link, order: str) -> Link:
    """The link with its ball, if it has one, as three turns about the axes of `order`."""
    parts: list[Part] = []
    for part in link.parts:
        parts += [Part("turn", AXES[axis]) for axis in order] if part.kind == "ball" else [part]
    return dataclasses.replace(link, parts=tuple(parts))


def kinematic_tree(scene: Scene, order: str) -> Model:
    """The model of the scene's tree with balls in Cardan `order`; loop joints are constraints between links."""
    import exudyn
    from exudyn.itemInterface import NodeGenericODE2, ObjectKinematicTree, SensorNode

    carried, closing = spanned(scene)
    chain = [expanded(link, order) for link in carried]
    container, system = new_system()
    joints, seats = _assembled(scene, chain)
    angles, rates = [np.zeros(0)], [np.zeros(0)]
    for link in carried:
        own, own_rates = tree.initial_coordinates(scene, link)
        for part in link.parts:
            angle, rate = own[:part.coordinates], own_rates[:part.dofs]
            own, own_rates = own[part.coordinates:], own_rates[part.dofs:]
            if part.kind == "ball":
                angle, rate = cardan_coordinates(angle, rate, order)
            angles.append(angle)
            rates.append(rate)
    q, v = np.concatenate(angles), np.concatenate(rates)
    node = system.AddNode(NodeGenericODE2(referenceCoordinates=[0.0] * len(q), initialCoordinates=q,
                                          initialCoordinates_t=v, numberOfODE2Coordinates=len(q)))
    vectors: Any = exudyn.Vector3DList  # Exudyn's type stubs declare these two without arguments
    matrices: Any = exudyn.Matrix3DList
    springs: Any = _springs(scene, chain)
    body = system.AddObject(ObjectKinematicTree(
        nodeNumber=node, jointTypes=[getattr(exudyn.JointType, kind) for kind in joints.kinds],
        linkParents=joints.parents, gravity=scene.gravity, linkMasses=joints.masses,
        jointTransformations=matrices(joints.turns), jointOffsets=vectors(joints.offsets),
        linkCOMs=vectors(joints.centres), linkInertiasCOM=matrices(joints.inertias), **springs))
    _couple(scene, system, node, carried, q)
    _attach(scene, system, body, seats, closing)
    slots = np.cumsum([0, *(link.dofs for link in chain)])

    def convert(t: np.ndarray, data: list[np.ndarray]) -> States:
        motions = [tree.motion(link, *(part[:, first:last] for part in data))
                   for link, first, last in zip(chain, slots[:-1], slots[1:], strict=True)]
        return tree.forward(chain, motions, t, accelerations=True)

    outputs = ("Coordinates", "Coordinates_t", "Coordinates_tt")
    return Model(container, system, watch(system, functools.partial(SensorNode, nodeNumber=node), outputs), convert)


def _couple(scene: Scene, system: Any, node: Any, carried: tuple[Link, ...], q: np.ndarray) -> None:
    """Armature as a further mass matrix on the node, mimics as constraints between its coordinates."""
    from exudyn.itemInterface import CoordinateConstraint, MarkerNodeCoordinate, ObjectGenericODE2

    joints = {joint.name: joint for joint in scene.joints}
    first = np.cumsum([0, *(link.dofs for link in carried)])
    inertia, places = np.zeros(len(q)), {}
    for link, at in zip(carried, first, strict=False):
        if not link.joint:  # a free body
            continue
        values = joints[link.joint].armature
        if values:  # a cylindrical joint is a slide and then a turn
            inertia[at:at + link.dofs] = values[::-1] if len(values) == 2 else values
        places[link.joint] = int(at), 1.0 if link.outward else -1.0
    if inertia.any():
        system.AddObject(ObjectGenericODE2(nodeNumbers=[node], massMatrix=np.diag(inertia)))
    for joint in scene.joints:
        if joint.mimic is None:
            continue
        (follower, sign), (leader, other) = places[joint.name], places[joint.mimic.joint]
        ratio = joint.mimic.ratio * sign * other
        markers = [system.AddMarker(MarkerNodeCoordinate(nodeNumber=node, coordinate=at)) for at in (follower, leader)]
        system.AddObject(CoordinateConstraint(markerNumbers=markers, factor1=ratio,
                                              offset=ratio * q[leader] - q[follower]))


def middle_angles(scene: Scene) -> list[int]:
    """Indices of the coordinates that are the second Cardan angle of a ball."""
    columns, first = [], 0
    for link in spanned(scene)[0]:
        for part in link.parts:
            columns += [first + 1] if part.kind == "ball" else []
            first += part.dofs
    return columns


def _assembled(scene: Scene, chain: list[Link]) -> tuple[_Tree, dict[int, _Seat]]:
    joints, seats = _Tree(), {GROUND: _Seat(GROUND, np.zeros(3), np.eye(3))}
    for link in chain:
        inner = seats[link.parent]
        at, turn = inner.at + inner.turn @ link.parent_anchor, inner.turn @ rotation_from_quaternion(link.zero)
        joint = inner.joint
        for part in link.parts:
            # the name of the frame axis along the part's axis, and that frame in the axes reached so far
            name = next((name for name, axis in AXES.items() if np.array_equal(part.axis, axis)), None)
            frame = np.eye(3) if name else np.column_stack([*normal_references(part.axis), part.axis])
            kind = "Revolute" if part.kind == "turn" else "Prismatic"
            joint = joints.hang(kind + (name or "Z"), joint, at + turn @ part.offset, turn @ frame)
            at, turn = np.zeros(3), frame.T
        seats[link.body] = seat = _Seat(joint, at - turn @ link.child_anchor, turn)
        joints.load(joint, scene.masses[link.body], seat.at, turn @ scene.inertias[link.body] @ turn.T)
    return joints, seats


def cardan_coordinates(attitude: np.ndarray, w: np.ndarray, order: str) -> tuple[np.ndarray, np.ndarray]:
    """Angles (rad) and rates of three revolutes in `order` for a relative quaternion and angular velocity."""
    from scipy.spatial.transform import Rotation

    angles = Rotation.from_quat(attitude, scalar_first=True).as_euler(order)
    still = np.zeros(1)
    unit_rates = []
    for unit in np.eye(3):
        first, second, third = (tree.turning(AXES[axis], angles[None, k], unit[None, k], still)
                                for k, axis in enumerate(order))
        unit_rates.append(tree.compose(tree.compose(first, second), third).w[0])
    return angles, np.linalg.solve(np.transpose(unit_rates), w)


def _springs(scene: Scene, chain: list[Link]) -> dict[str, list[float]]:
    """Torsional spring-dampers as proportional-derivative control of their joints."""
    springs = {force.joint: force.parameters for force in scene.forces if force.type == "torsional_spring"}
    if not springs:
        return {}
    stiffness, damping, rest = [], [], []
    for link in chain:
        for part in link.parts:
            spring = springs.get(link.joint) if part.kind == "turn" else None
            stiffness.append(spring["stiffness"] if spring else 0.0)
            damping.append(spring["damping"] if spring else 0.0)
            # the angle of an inward link is that of the scene's parent relative to its child
            rest.append((spring["rest_angle"] if link.outward else -spring["rest_angle"]) if spring else 0.0)
    return {"jointPControlVector": stiffness, "jointDControlVector": damping, "jointPositionOffsetVector": rest,
            "jointVelocityOffsetVector": [0.0] * len(rest)}


def _attach(scene: Scene, system: Any, tree_object: Any, seats: dict[int, _Seat], closing: tuple[Joint, ...]) -> None:
    """Add loop joints, springs on them, linear springs and loads to markers on the tree's links."""
    from exudyn.itemInterface import MarkerKinematicTreeRigid, ObjectGround

    closed = {joint.name for joint in closing}
    forces = [force for force in scene.forces if force.type != "torsional_spring" or force.joint in closed]
    if not forces and not closing:
        return
    ground = system.AddObject(ObjectGround())

    def mark(body: int, point: np.ndarray, frame: np.ndarray | None) -> Any:
        seat = seats[body]
        at, turn = seat.at + seat.turn @ point, seat.turn @ (np.eye(3) if frame is None else frame)
        if seat.joint == GROUND:
            return mark_frame(system, ground, at, turn)
        return system.AddMarker(MarkerKinematicTreeRigid(objectNumber=tree_object, linkNumber=seat.joint,
                                                         localHT=pose(at, turn)))

    carrier = Carrier(scene, system, mark)
    left_free = dropped_axes(scene, closing)
    for joint in closing:
        items.add_joint(carrier, joint, left_free.get(joint.name, ()))
    for force in forces:
        items.add_force(carrier, force)
