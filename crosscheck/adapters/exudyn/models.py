"""Exudyn models of a scene with rigid bodies, and the conversion of sensor data to `States`.

`maximal`: a rigid body at each centre of mass, with joints as constraints. `pivot`: one body with its node at the
pivot. The third form, the kinematic tree, is in `crosscheck.adapters.exudyn.kinematic_tree`.
"""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np

from crosscheck.adapters.common import tree
from crosscheck.adapters.exudyn import items
from crosscheck.adapters.exudyn.independent import dropped_axes
from crosscheck.adapters.exudyn.items import Carrier, Index
from crosscheck.scene.model import GROUND, Scene
from crosscheck.scene.spanning import spanning_tree
from crosscheck.scene.states import States

if TYPE_CHECKING:
    import exudyn

LAYOUT_INERTIA = ((0, 0), (1, 1), (2, 2), (1, 2), (0, 2), (0, 1))
BODY_OUTPUTS = ("Position", "RotationMatrix", "Velocity", "AngularVelocityLocal", "Acceleration",
                "AngularAccelerationLocal")


@dataclasses.dataclass
class Model:
    """A main system ready to run, its sensors, and the conversion of their data, (T, columns) each, in this order."""

    container: exudyn.SystemContainer | None  # owns the system and must outlive it
    system: exudyn.MainSystem
    sensors: list[int]
    convert: Callable[[np.ndarray, list[np.ndarray]], States]


def new_system() -> tuple[exudyn.SystemContainer, exudyn.MainSystem]:
    """An empty main system and the container that owns it."""
    import exudyn

    container = exudyn.SystemContainer()
    return container, container.AddSystem()


def watch(system: exudyn.MainSystem, sensor: Callable[..., Any], outputs: tuple[str, ...]) -> list[Index]:
    import exudyn

    return [system.AddSensor(sensor(writeToFile=False, storeInternal=True,
                                    outputVariableType=getattr(exudyn.OutputVariableType, output)))
            for output in outputs]


def _watch_body(system: exudyn.MainSystem, body: Index) -> list[Index]:
    """Add sensors at the body's reference point, its node; only sensors of bodies have angular accelerations."""
    from exudyn.itemInterface import SensorBody

    return watch(system, functools.partial(SensorBody, bodyNumber=body), BODY_OUTPUTS)


def _body(system: exudyn.MainSystem, node: str, name: str, position: np.ndarray, velocity: np.ndarray, w: np.ndarray,
          mass: float, inertia: np.ndarray) -> tuple[Index, Index]:
    """Add a rigid body with its node at `position`, axes along the world's; returns (node, body).

    `inertia` is about the node; centerOfMass stays zero. `node` is "lie" (a rotation vector, updated on the group) or
    "euler_parameters".
    """
    from exudyn.itemInterface import NodeRigidBodyEP, NodeRigidBodyRotVecLG, ObjectRigidBody

    item: NodeRigidBodyRotVecLG | NodeRigidBodyEP
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
    """The model with free bodies on nodes of the kind `node` and every joint a constraint, in `system` or a new one.

    Node axes at t = 0 are the world's, not the body's: the constraint term in Exudyn's initial accelerations is correct
    only if the node's rotation vector is zero (otherwise it has an error of 4 % on the single pendulum).
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
    for force in scene.loads:
        if not force.law.has_modes:  # of which a scout for angle orders knows nothing; a run of this form has none
            items.add_force(carrier, force)
    return Model(container, system, sensors, lambda t, data: States(t, *_body_arrays(data, scene.R0)))


def _marks(system: exudyn.MainSystem, bodies: dict[int, Index], turn: dict[int, np.ndarray],
           centre: np.ndarray) -> Callable[[int, np.ndarray, np.ndarray | None], Index]:
    """`Carrier.mark` for rigid bodies; `centre` (3,): centre of mass, node axes; `turn`: from body to node axes."""
    from exudyn.itemInterface import MarkerBodyPosition

    def mark(body: int, point: np.ndarray, frame: np.ndarray | None) -> Index:
        at = point if body == GROUND else centre + turn[body] @ point
        if frame is None:
            return system.AddMarker(MarkerBodyPosition(bodyNumber=bodies[body], localPosition=at))
        return mark_frame(system, bodies[body], at, turn[body] @ frame)

    return mark


def mark_frame(system: exudyn.MainSystem, body: Index, at: np.ndarray, frame: np.ndarray) -> Index:
    """Add a marker with position and attitude to a body of Exudyn."""
    from exudyn.itemInterface import MarkerBodyRigid

    return system.AddMarker(MarkerBodyRigid(bodyNumber=body, localHT=pose(at, frame)))


def pose(at: np.ndarray, frame: np.ndarray) -> Any:
    """Exudyn's homogeneous transformation to a frame (3, 3) at a point (3,)."""
    import exudyn

    transformation: Any = exudyn.HT  # Exudyn's type stubs declare it without arguments
    return transformation(rotation=frame, translation=at)


def _body_arrays(data: list[np.ndarray], R0: np.ndarray) -> tuple[np.ndarray, ...]:
    """x, R, v, w, a, alpha of the bodies' reference points, (T, n, ...), in body axes; `R0`: attitudes at t = 0."""
    x, R, v, w, a, alpha = (np.stack(data[k::len(BODY_OUTPUTS)], axis=1) for k in range(len(BODY_OUTPUTS)))
    w, alpha = (np.einsum("nji,tnj->tni", R0, vector) for vector in (w, alpha))
    return x, R.reshape(*x.shape[:2], 3, 3) @ R0, v, w, a, alpha


def pivot(scene: Scene, node: str = "lie") -> Model:
    """The model of one body about a pivot fixed in the ground: node and inertia at the pivot, weight as a force.

    Three coordinate constraints hold the node's position; they are the only constraints that Exudyn's explicit solvers
    eliminate. A body with a nonzero centerOfMass instead gives silently wrong results.
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
