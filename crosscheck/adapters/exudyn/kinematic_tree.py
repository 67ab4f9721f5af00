"""Exudyn's ObjectKinematicTree from a scene: joints of one degree of freedom each, in joint coordinates.

Slides and turns of a link become prismatic and revolute joints along an axis of their own frame; a ball becomes three
revolute joints in a Cardan order. A body welded to another shares its link; one welded to the ground has none.
"""

from __future__ import annotations

import dataclasses
import functools
from typing import TYPE_CHECKING, Any

import numpy as np

from crosscheck.adapters.common import links, tree
from crosscheck.adapters.common.links import Link, Part
from crosscheck.adapters.exudyn import items, laws
from crosscheck.adapters.exudyn.independent import dropped_axes
from crosscheck.adapters.exudyn.items import Carrier, Index
from crosscheck.adapters.exudyn.models import Model, mark_frame, new_system, pose, watch
from crosscheck.scene.functions import at as value_at
from crosscheck.scene.model import GROUND, Joint, Scene, rotation_from_quaternion
from crosscheck.scene.states import States
from crosscheck.scene.vectors import normal_references, welded

if TYPE_CHECKING:
    import exudyn

AXES = dict(zip("XYZ", np.eye(3), strict=True))


@dataclasses.dataclass
class _Seat:
    """The joint of the tree that carries a body (-1: the ground), and the body's pose in that joint's frame."""

    joint: int
    at: np.ndarray  # (3,) centre of mass
    turn: np.ndarray  # (3, 3) body axes to the joint's frame


@dataclasses.dataclass
class _Joint:
    """A joint of ObjectKinematicTree, its frame in that of its parent, and the rigid body on it, in its own frame."""

    kind: str
    parent: int
    offset: np.ndarray
    turn: np.ndarray
    mass: float = 0.0
    centre: np.ndarray = dataclasses.field(default_factory=lambda: np.zeros(3))
    inertia: np.ndarray = dataclasses.field(default_factory=lambda: np.zeros((3, 3)))

    def load(self, mass: float, centre: np.ndarray, inertia: np.ndarray) -> None:
        """Add a rigid body; `inertia` is about its centre."""
        self.mass, self.centre, self.inertia = welded((self.mass, mass), (self.centre, centre), (self.inertia, inertia))


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


def kinematic_tree(scene: Scene, order: str, h: float = 1e-3) -> Model:
    """The model of the scene's tree with balls in Cardan `order`; loop joints are constraints between links.

    Rigid stops and sticking joints are as stiff as steps h, s, resolve.
    """
    import exudyn
    from exudyn.itemInterface import NodeGenericODE2, ObjectKinematicTree, SensorNode

    carried, closing = spanned(scene)
    tree_links = [expanded(link, order) for link in carried]
    container, system = new_system()
    joints, seats = _assembled(scene, tree_links)
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
    at = laws.places(scene, carried)
    springs: Any = _springs(scene, at, len(q))
    body = system.AddObject(ObjectKinematicTree(
        nodeNumber=node, jointTypes=[getattr(exudyn.JointType, joint.kind) for joint in joints],
        linkParents=[joint.parent for joint in joints], gravity=scene.gravity,
        linkMasses=[joint.mass for joint in joints], jointTransformations=matrices([joint.turn for joint in joints]),
        jointOffsets=vectors([joint.offset for joint in joints]), linkCOMs=vectors([joint.centre for joint in joints]),
        linkInertiasCOM=matrices([joint.inertia for joint in joints]), **springs))
    _couple(scene, system, node, at, q)
    _attach(scene, system, body, seats, closing)
    if scene.has_laws:
        laws.add(scene, system, node, at, h)
    slots = np.cumsum([0, *(link.dofs for link in tree_links)])

    def convert(t: np.ndarray, data: list[np.ndarray]) -> States:
        motions = [tree.motion(link, *(part[:, first:last] for part in data))
                   for link, first, last in zip(tree_links, slots[:-1], slots[1:], strict=True)]
        states = tree.forward(tree_links, motions, t, accelerations=True)
        states.hinges = tree.hinges(scene, carried, slots[:-1].tolist(), data[0])
        return states

    outputs = ("Coordinates", "Coordinates_t", "Coordinates_tt")
    return Model(container, system, watch(system, functools.partial(SensorNode, nodeNumber=node), outputs), convert)


def _couple(scene: Scene, system: exudyn.MainSystem, node: Index, at: dict[tuple[str, int], laws.Place], q: np.ndarray
            ) -> None:
    """Armature as a further mass matrix on the node, mimics as constraints between its coordinates."""
    from exudyn.itemInterface import CoordinateConstraint, MarkerNodeCoordinate, ObjectGenericODE2

    inertia = np.zeros(len(q))
    for joint in scene.joints:
        for k, value in enumerate(joint.armature):
            inertia[at[joint.name, k].column] = value
    if inertia.any():
        system.AddObject(ObjectGenericODE2(nodeNumbers=[node], massMatrix=np.diag(inertia)))
    for joint in scene.joints:
        if joint.mimic is None:
            continue
        ends = at[joint.name, 0], at[joint.mimic.joint, 0]
        ratio = joint.mimic.ratio * ends[0].sign * ends[1].sign
        markers = [system.AddMarker(MarkerNodeCoordinate(nodeNumber=node, coordinate=end.column)) for end in ends]
        system.AddObject(CoordinateConstraint(markerNumbers=markers, factor1=ratio,
                                              offset=ratio * q[ends[1].column] - q[ends[0].column]))


def middle_angles(scene: Scene) -> list[int]:
    """Indices of the coordinates that are the second Cardan angle of a ball."""
    columns, first = [], 0
    for link in spanned(scene)[0]:
        for part in link.parts:
            columns += [first + 1] if part.kind == "ball" else []
            first += part.dofs
    return columns


def _assembled(scene: Scene, tree_links: list[Link]) -> tuple[list[_Joint], dict[int, _Seat]]:
    joints, seats = list[_Joint](), {GROUND: _Seat(GROUND, np.zeros(3), np.eye(3))}
    for link in tree_links:
        inner = seats[link.parent]
        at, turn = inner.at + inner.turn @ link.parent_anchor, inner.turn @ rotation_from_quaternion(link.zero)
        joint = inner.joint
        for part in link.parts:
            # the name of the frame axis along the part's axis, and that frame in the axes reached so far
            name = next((name for name, axis in AXES.items() if np.array_equal(part.axis, axis)), None)
            frame = np.eye(3) if name else np.column_stack([*normal_references(part.axis), part.axis])
            kind = "Revolute" if part.kind == "turn" else "Prismatic"
            joints.append(_Joint(kind + (name or "Z"), joint, at + turn @ part.offset, turn @ frame))
            joint = len(joints) - 1
            at, turn = np.zeros(3), frame.T
        seats[link.body] = seat = _Seat(joint, at - turn @ link.child_anchor, turn)
        if joint != GROUND:
            joints[joint].load(scene.masses[link.body], seat.at, turn @ scene.inertias[link.body] @ turn.T)
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


def _springs(scene: Scene, at: dict[tuple[str, int], laws.Place], size: int) -> dict[str, list[float]]:
    """Springs and dampers of joints as proportional-derivative control of these."""
    stiffness, damping, moment = np.zeros((3, size))
    for force in scene.loads:
        if force.is_spring and force.joint is not None:
            joint, p = scene.joint(force.joint), force.parameters
            place = at.get((joint.name, joint.kind.number(force.law.measure)))
            if place is not None:
                stiffness[place.column] += p["stiffness"]
                damping[place.column] += p["damping"]
                moment[place.column] += p["stiffness"] * place.sign * (value_at(joint.rest(force), 0.0) - place.zero)
    if not (stiffness.any() or damping.any()):
        return {}
    rest = np.divide(moment, stiffness, out=np.zeros(size), where=stiffness != 0)
    return {"jointPControlVector": stiffness.tolist(), "jointDControlVector": damping.tolist(),
            "jointPositionOffsetVector": rest.tolist(), "jointVelocityOffsetVector": [0.0] * size}


def _attach(scene: Scene, system: exudyn.MainSystem, tree_object: Index, seats: dict[int, _Seat],
            closing: tuple[Joint, ...]) -> None:
    """Add loop joints, their springs, linear springs and loads to markers on the tree's links."""
    from exudyn.itemInterface import MarkerKinematicTreeRigid, ObjectGround

    closed = {joint.name for joint in closing}
    forces = [force for force in scene.loads if not force.law.has_modes
              and (not force.is_spring or force.joint is None or force.joint in closed)]
    if not forces and not closing:
        return
    ground = system.AddObject(ObjectGround())

    def mark(body: int, point: np.ndarray, frame: np.ndarray | None) -> Index:
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
