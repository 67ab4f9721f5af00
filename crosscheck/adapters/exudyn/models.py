"""Exudyn models of a scene around rigid bodies, and the way back from Exudyn's sensors to `States`.

`maximal`: a rigid body at each centre of mass, joints as constraints. `pivot`: one body with its node at the pivot. The
third form, the kinematic tree, is in `crosscheck.adapters.exudyn.kinematic_tree`.
"""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable
from typing import Any

import numpy as np

from crosscheck.adapters.common import tree
from crosscheck.adapters.exudyn import items
from crosscheck.adapters.exudyn.independent import dropped_axes
from crosscheck.adapters.exudyn.items import Carrier
from crosscheck.scene.model import GROUND, Scene
from crosscheck.scene.spanning import spanning_tree
from crosscheck.scene.states import States

LAYOUT_INERTIA = ((0, 0), (1, 1), (2, 2), (1, 2), (0, 2), (0, 1))
BODY_OUTPUTS = ("Position", "RotationMatrix", "Velocity", "AngularVelocityLocal", "Acceleration",
                "AngularAccelerationLocal")


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


def watch(system: Any, sensor: Callable[..., Any], outputs: tuple[str, ...]) -> list[Any]:
    import exudyn

    return [system.AddSensor(sensor(writeToFile=False, storeInternal=True,
                                    outputVariableType=getattr(exudyn.OutputVariableType, output)))
            for output in outputs]


def _watch_body(system: Any, body: Any) -> list[Any]:
    """Sensors of the body's reference point, where its node is; only bodies report angular accelerations."""
    from exudyn.itemInterface import SensorBody

    return watch(system, functools.partial(SensorBody, bodyNumber=body), BODY_OUTPUTS)


def _body(system: Any, node: str, name: str, position: np.ndarray, velocity: np.ndarray, w: np.ndarray, mass: float,
          inertia: np.ndarray) -> tuple[Any, Any]:
    """(node, body): a rigid body whose node sits at `position`, axes along the world's, with `inertia` about the node.

    `node` is "lie" (coordinates: a rotation vector, updated on the group) or "euler_parameters". centerOfMass stays
    zero.
    """
    from exudyn.itemInterface import NodeRigidBodyEP, NodeRigidBodyRotVecLG, ObjectRigidBody

    item: Any
    if node == "lie":
        item = NodeRigidBodyRotVecLG(referenceCoordinates=[*position, 0.0, 0.0, 0.0], initialVelocities=[*velocity, *w])
    else:
        item = NodeRigidBodyEP(referenceCoordinates=[*position, 1.0, 0.0, 0.0, 0.0],
                               initialVelocities=[*velocity, 0.0, *(0.5 * w)])  # at the identity
    index = system.AddNode(item)
    body = system.AddObject(ObjectRigidBody(name=name, mass=mass, nodeNumber=index,
                                            inertia=[inertia[entry] for entry in LAYOUT_INERTIA]))
    return index, body


def maximal(scene: Scene, node: str = "lie", system: Any = None) -> Model:
    """All bodies free, on nodes of the kind `node`, and every joint a constraint; in `system`, or in a new one.

    Node axes are the world's at t = 0, not the body's: Exudyn finds the accelerations of the start with a constraint
    term that is right only where the node's rotation vector vanishes (4 % off on the single pendulum otherwise).
    """
    from exudyn.itemInterface import LoadMassProportional, MarkerBodyMass, ObjectGround

    container = None
    if system is None:
        container, system = new_system()
    bodies, sensors = {GROUND: system.AddObject(ObjectGround())}, []
    turn = {GROUND: np.eye(3), **dict(enumerate(scene.R0))}
    for index, body in enumerate(scene.bodies):
        _, bodies[index] = _body(system, node, body.name, scene.x0[index], scene.v0[index],
                                 turn[index] @ scene.w0[index], body.mass, turn[index] @ body.inertia @ turn[index].T)
        mass = system.AddMarker(MarkerBodyMass(bodyNumber=bodies[index]))
        system.AddLoad(LoadMassProportional(markerNumber=mass, loadVector=scene.gravity))
        sensors += _watch_body(system, bodies[index])
    carrier = Carrier(scene, system, _marks(system, bodies, turn, np.zeros(3)))
    left_free = dropped_axes(scene, spanning_tree(scene)[1])
    for joint in scene.joints:
        items.add_joint(carrier, joint, left_free.get(joint.name, ()))
    for force in scene.forces:
        items.add_force(carrier, force)
    return Model(container, system, sensors, lambda t, data: States(t, *_body_arrays(data, scene.R0)))


def _marks(system: Any, bodies: dict[int, Any], turn: dict[int, np.ndarray],
           centre: np.ndarray) -> Callable[[int, np.ndarray, np.ndarray | None], Any]:
    """`Carrier.mark` on rigid bodies whose centres of mass lie at `centre`, (3,), node axes; `turn` leads to these."""
    from exudyn.itemInterface import MarkerBodyPosition

    def mark(body: int, point: np.ndarray, frame: np.ndarray | None) -> Any:
        at = point if body == GROUND else centre + turn[body] @ point
        if frame is None:
            return system.AddMarker(MarkerBodyPosition(bodyNumber=bodies[body], localPosition=at))
        return mark_frame(system, bodies[body], at, turn[body] @ frame)

    return mark


def mark_frame(system: Any, body: Any, at: np.ndarray, frame: np.ndarray) -> Any:
    """A marker of position and attitude on a body of Exudyn's."""
    from exudyn.itemInterface import MarkerBodyRigid

    return system.AddMarker(MarkerBodyRigid(bodyNumber=body, localHT=pose(at, frame)))


def pose(at: np.ndarray, frame: np.ndarray) -> Any:
    """Exudyn's homogeneous transformation to a frame (3, 3) at a point (3,)."""
    import exudyn

    transformation: Any = exudyn.HT  # Exudyn's stubs know it only without arguments
    return transformation(rotation=frame, translation=at)


def _body_arrays(data: list[np.ndarray], R0: np.ndarray) -> tuple[np.ndarray, ...]:
    """x, R, v, w, a, alpha of the bodies' reference points, (T, n, ...), body axes again: `R0` are those at t = 0."""
    x, R, v, w, a, alpha = (np.stack(data[k::len(BODY_OUTPUTS)], axis=1) for k in range(len(BODY_OUTPUTS)))
    w, alpha = (np.einsum("nji,tnj->tni", R0, vector) for vector in (w, alpha))
    return x, R.reshape(*x.shape[:2], 3, 3) @ R0, v, w, a, alpha


def pivot(scene: Scene, node: str = "lie") -> Model:
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
        ObjectGround,
    )

    (link,) = tree.links(scene)
    (container, system), R0, mass = new_system(), scene.R0[0], scene.masses[0]
    arm = -R0 @ link.child_anchor  # pivot to centre of mass, node axes
    about_pivot = R0 @ scene.inertias[0] @ R0.T + mass * (arm @ arm * np.eye(3) - np.outer(arm, arm))
    index, body = _body(system, node, scene.bodies[0].name, link.parent_anchor, np.zeros(3), R0 @ scene.w0[0], mass,
                        about_pivot)
    ground = system.AddMarker(MarkerNodeCoordinate(nodeNumber=system.AddNode(NodePointGround()), coordinate=0))
    for axis in range(3):
        moving = system.AddMarker(MarkerNodeCoordinate(nodeNumber=index, coordinate=axis))
        system.AddObject(CoordinateConstraint(markerNumbers=[ground, moving]))
    centre = system.AddMarker(MarkerBodyPosition(bodyNumber=body, localPosition=arm))
    system.AddLoad(LoadForceVector(markerNumber=centre, loadVector=mass * scene.gravity))
    if scene.forces:
        bodies, turn = {GROUND: system.AddObject(ObjectGround()), 0: body}, {GROUND: np.eye(3), 0: R0}
        carrier = Carrier(scene, system, _marks(system, bodies, turn, arm))
        for force in scene.forces:
            items.add_force(carrier, force)

    def convert(t: np.ndarray, data: list[np.ndarray]) -> States:
        _, R, _, w, _, alpha = _body_arrays(data, scene.R0)
        return tree.forward([link], [tree.Motion(R[:, 0], w[:, 0], alpha[:, 0])], t, accelerations=True)

    return Model(container, system, _watch_body(system, body), convert)
