"""Exudyn models of a scene in the three forms, and the way back from Exudyn's sensors to `States`.

`maximal`: a rigid body on a Lie-group node at each centre of mass, joints as constraints. `pivot`: one body on a
Lie-group node at the pivot. `tree`: ObjectKinematicTree, whose joints have one degree of freedom: a ball is three
revolutes in a Cardan order.
"""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable
from typing import Any

import numpy as np

from crosscheck.engines import tree
from crosscheck.scene import GROUND, Scene
from crosscheck.states import States

LAYOUT_INERTIA = ((0, 0), (1, 1), (2, 2), (1, 2), (0, 2), (0, 1))
BODY_OUTPUTS = ("Position", "RotationMatrix", "Velocity", "AngularVelocityLocal", "Acceleration",
                "AngularAccelerationLocal")
AXES = dict(zip("XYZ", np.eye(3), strict=True))


@dataclasses.dataclass
class Model:
    """A main system ready to run: its sensors, in the order in which `convert` takes their data, (T, columns) each."""

    container: Any  # owns the system and has to outlive it
    system: Any
    sensors: list[int]
    convert: Callable[[np.ndarray, list[np.ndarray]], States]


def new_system() -> tuple[Any, Any]:
    """An empty main system and the container that owns it."""
    import exudyn

    container = exudyn.SystemContainer()
    return container, container.AddSystem()


def _watch(system: Any, sensor: Callable[..., Any], outputs: tuple[str, ...]) -> list[Any]:
    import exudyn

    return [system.AddSensor(sensor(writeToFile=False, storeInternal=True,
                                    outputVariableType=getattr(exudyn.OutputVariableType, output)))
            for output in outputs]


def _watch_body(system: Any, body: Any) -> list[Any]:
    """Sensors of the body's reference point, where its node is; only bodies report angular accelerations."""
    from exudyn.itemInterface import SensorBody

    return _watch(system, functools.partial(SensorBody, bodyNumber=body), BODY_OUTPUTS)


def _body(system: Any, position: np.ndarray, velocity: np.ndarray, w: np.ndarray, mass: float,
          inertia: np.ndarray) -> tuple[Any, Any]:
    """(node, body): a rigid body whose node sits at `position`, axes along the world's, with `inertia` about the node.

    `centerOfMass` stays zero.
    """
    from exudyn.itemInterface import NodeRigidBodyRotVecLG, ObjectRigidBody

    node = system.AddNode(NodeRigidBodyRotVecLG(referenceCoordinates=[*position, 0.0, 0.0, 0.0],
                                                initialVelocities=[*velocity, *w]))
    body = system.AddObject(ObjectRigidBody(mass=mass, inertia=[inertia[entry] for entry in LAYOUT_INERTIA],
                                            nodeNumber=node))
    return node, body


def maximal(scene: Scene) -> Model:
    """All bodies free on Lie-group nodes, a spherical joint as three constraints.

    Node axes are the world's at t = 0, not the body's: Exudyn finds the accelerations of the start with a constraint
    term that is right only where the node's rotation vector vanishes (4 % off on the single pendulum otherwise).
    """
    from exudyn.itemInterface import (
        LoadMassProportional,
        MarkerBodyMass,
        MarkerBodyPosition,
        ObjectGround,
        ObjectJointSpherical,
    )

    container, system = new_system()
    bodies, sensors = {GROUND: system.AddObject(ObjectGround())}, []
    turn = {GROUND: np.eye(3), **dict(enumerate(scene.R0))}
    for index, body in enumerate(scene.bodies):
        _, bodies[index] = _body(system, scene.x0[index], scene.v0[index], turn[index] @ scene.w0[index], body.mass,
                                 turn[index] @ body.inertia @ turn[index].T)
        mass = system.AddMarker(MarkerBodyMass(bodyNumber=bodies[index]))
        system.AddLoad(LoadMassProportional(markerNumber=mass, loadVector=scene.gravity))
        sensors += _watch_body(system, bodies[index])
    for joint in scene.joints:
        ends = ((joint.parent, joint.parent_anchor), (joint.child, joint.child_anchor))
        markers = [system.AddMarker(MarkerBodyPosition(bodyNumber=bodies[body], localPosition=turn[body] @ anchor))
                   for body, anchor in ends]
        system.AddObject(ObjectJointSpherical(markerNumbers=markers))
    return Model(container, system, sensors, lambda t, data: States(t, *_body_arrays(data, scene.R0)))


def _body_arrays(data: list[np.ndarray], R0: np.ndarray) -> tuple[np.ndarray, ...]:
    """x, R, v, w, a, alpha of the bodies' reference points, (T, n, ...), body axes again: `R0` are those at t = 0."""
    x, R, v, w, a, alpha = (np.stack(data[k::len(BODY_OUTPUTS)], axis=1) for k in range(len(BODY_OUTPUTS)))
    w, alpha = (np.einsum("nji,tnj->tni", R0, vector) for vector in (w, alpha))
    return x, R.reshape(*x.shape[:2], 3, 3) @ R0, v, w, a, alpha


def pivot(scene: Scene) -> Model:
    """One body about a pivot fixed in the ground: node at the pivot, inertia about it, weight as a force at the COM.

    The node's position is held by three coordinate constraints, the only ones Exudyn's explicit solvers eliminate.
    A nonzero centerOfMass in their place is silently wrong.
    """
    from exudyn.itemInterface import (
        CoordinateConstraint,
        LoadForceVector,
        MarkerBodyPosition,
        MarkerNodeCoordinate,
        NodePointGround,
    )

    (link,) = tree.links(scene)
    (container, system), R0, mass = new_system(), scene.R0[0], scene.masses[0]
    arm = -R0 @ link.child_anchor  # pivot to centre of mass, node axes
    about_pivot = R0 @ scene.inertias[0] @ R0.T + mass * (arm @ arm * np.eye(3) - np.outer(arm, arm))
    node, body = _body(system, link.parent_anchor, np.zeros(3), R0 @ scene.w0[0], mass, about_pivot)
    ground = system.AddMarker(MarkerNodeCoordinate(nodeNumber=system.AddNode(NodePointGround()), coordinate=0))
    for axis in range(3):
        moving = system.AddMarker(MarkerNodeCoordinate(nodeNumber=node, coordinate=axis))
        system.AddObject(CoordinateConstraint(markerNumbers=[ground, moving]))
    centre = system.AddMarker(MarkerBodyPosition(bodyNumber=body, localPosition=arm))
    system.AddLoad(LoadForceVector(markerNumber=centre, loadVector=mass * scene.gravity))

    def convert(t: np.ndarray, data: list[np.ndarray]) -> States:
        _, R, _, w, _, alpha = _body_arrays(data, scene.R0)
        return tree.forward([link], [tree.Motion(R[:, 0], w[:, 0], alpha[:, 0])], t, accelerations=True)

    return Model(container, system, _watch_body(system, body), convert)


def kinematic_tree(scene: Scene, order: str) -> Model:
    """An open tree of balls, each three revolutes in Cardan `order`, all angles zero at relative attitude identity."""
    import exudyn
    from exudyn.itemInterface import NodeGenericODE2, ObjectKinematicTree, SensorNode

    links = tree.links(scene)
    (container, system), size = new_system(), 3 * len(links)
    last, anchors = {GROUND: -1}, {GROUND: np.zeros(3)}  # last revolute of a body; its pivot, from its COM
    parents, offsets, masses, centres, inertias, angles, rates = ([] for _ in range(7))  # type: ignore[var-annotated]
    for link in links:
        first, still = len(parents), np.zeros(3)
        parents += [last[link.parent], first, first + 1]
        offsets += [link.parent_anchor - anchors[link.parent], still, still]
        masses += [0.0, 0.0, scene.masses[link.body]]
        centres += [still, still, -link.child_anchor]
        inertias += [np.zeros((3, 3)), np.zeros((3, 3)), scene.inertias[link.body]]
        last[link.body], anchors[link.body] = first + 2, link.child_anchor
        angle, rate = cardan_coordinates(*tree.initial_coordinates(scene, link), order)
        angles, rates = [*angles, *angle], [*rates, *rate]
    node = system.AddNode(NodeGenericODE2(referenceCoordinates=[0.0] * size, initialCoordinates=angles,
                                          initialCoordinates_t=rates, numberOfODE2Coordinates=size))
    joint_types = [getattr(exudyn.JointType, f"Revolute{axis}") for axis in order] * len(links)
    vectors: Any = exudyn.Vector3DList  # Exudyn's stubs know these two only without arguments
    matrices: Any = exudyn.Matrix3DList
    system.AddObject(ObjectKinematicTree(
        nodeNumber=node, jointTypes=joint_types, linkParents=parents, gravity=scene.gravity, linkMasses=masses,
        jointTransformations=matrices([np.eye(3)] * size), jointOffsets=vectors(offsets), linkCOMs=vectors(centres),
        linkInertiasCOM=matrices(inertias)))

    def convert(t: np.ndarray, data: list[np.ndarray]) -> States:
        motions = [_ball(order, *(part[:, 3 * k:3 * k + 3] for part in data)) for k in range(len(links))]
        return tree.forward(links, motions, t, accelerations=True)

    outputs = ("Coordinates", "Coordinates_t", "Coordinates_tt")
    return Model(container, system, _watch(system, functools.partial(SensorNode, nodeNumber=node), outputs), convert)


def _ball(order: str, q: np.ndarray, v: np.ndarray, a: np.ndarray) -> tree.Motion:
    """Relative motion of three revolutes about the axes of `order`, each in the frame the one before has turned."""
    first, second, third = (tree.turning(AXES[axis], q[:, k], v[:, k], a[:, k]) for k, axis in enumerate(order))
    return tree.compose(tree.compose(first, second), third)


def cardan_coordinates(attitude: np.ndarray, w: np.ndarray, order: str) -> tuple[np.ndarray, np.ndarray]:
    """Angles (rad) and rates of three revolutes in `order` for a relative quaternion and angular velocity."""
    from scipy.spatial.transform import Rotation

    angles = Rotation.from_quat(attitude, scalar_first=True).as_euler(order)
    still = np.zeros((1, 3))
    unit_rates = [_ball(order, angles[None], rate[None], still).w[0] for rate in np.eye(3)]
    return angles, np.linalg.solve(np.transpose(unit_rates), w)
