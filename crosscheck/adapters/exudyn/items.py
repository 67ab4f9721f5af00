"""Joints, springs and loads of a scene as items of Exudyn, attached to markers on rigid bodies or tree links."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Collection
from typing import TYPE_CHECKING, Any

import numpy as np

from crosscheck.scene.coordinates import at_start
from crosscheck.scene.functions import TimeFunction
from crosscheck.scene.model import GROUND, Force, Joint, Scene
from crosscheck.scene.vectors import normal_references, shortest_rotation

if TYPE_CHECKING:
    import exudyn

Index = Any  # of a node, an object, a marker, a load or a sensor, in Exudyn's own types

FREE_AXES = {"slide n1": (0,), "slide n2": (1,), "slide": (2,), "turn parent": (3,), "turn child": (4,), "turn": (5,),
             "ball": (3, 4, 5)}
"""Axes of ObjectJointGeneric that each word of `JointType.motion` leaves free: 0 to 2 are translations, 3 to 5
rotations, in the frame of the first marker."""


@dataclasses.dataclass(frozen=True)
class Carrier:
    """A system for Exudyn's items, and a function that makes markers on bodies.

    `mark(body, point, frame)` makes a marker at a point given from the centre of mass in the body's axes (in world
    coordinates for the ground, -1), along the axes of `frame` (3, 3), also in the body's axes. Without a frame it marks
    only a position.
    """

    scene: Scene
    system: exudyn.MainSystem
    mark: Callable[[int, np.ndarray, np.ndarray | None], Index]


def add_joint(carrier: Carrier, joint: Joint, left_free: Collection[int] = ()) -> Index:
    """Add the joint as a constraint without the axes in `left_free`; returns the object's index."""
    from exudyn.itemInterface import (
        ObjectConnectorDistance,
        ObjectJointGeneric,
        ObjectJointRollingDisc,
        ObjectJointSpherical,
    )

    ends = (joint.parent, joint.parent_anchor), (joint.child, joint.child_anchor)
    if joint.type in ("spherical", "distance") and not left_free:
        markers = [carrier.mark(body, anchor, None) for body, anchor in ends]
        if joint.type == "spherical":
            return carrier.system.AddObject(ObjectJointSpherical(name=joint.name, markerNumbers=markers))
        return carrier.system.AddObject(ObjectConnectorDistance(name=joint.name, markerNumbers=markers,
                                                                distance=joint.length))
    if joint.type == "rolling_disk":
        markers = [carrier.mark(*end, np.column_stack([*normal_references(axis), axis]))
                   for end, axis in zip(ends, (joint.parent_axis, joint.child_axis), strict=True)]
        return carrier.system.AddObject(ObjectJointRollingDisc(
            name=joint.name, markerNumbers=markers, discRadius=joint.radius, discAxis=[0, 0, 1], planeNormal=[0, 0, 1]))
    markers = [carrier.mark(*end, frame) for end, frame in zip(ends, joint_frames(carrier.scene, joint), strict=True)]
    return carrier.system.AddObject(ObjectJointGeneric(
        name=joint.name, markerNumbers=markers,
        constrainedAxes=[int(axis not in {*free_axes(joint), *left_free}) for axis in range(6)]))


def free_axes(joint: Joint) -> set[int]:
    """The axes of ObjectJointGeneric that a joint leaves free, see `FREE_AXES`."""
    return {axis for word in joint.kind.motion for axis in FREE_AXES[word]}


def joint_frames(scene: Scene, joint: Joint) -> list[np.ndarray]:
    """Joint frames (3, 3) in the axes of the parent and of the child; z is the axis, for a universal joint x and y."""
    child, parent = (np.eye(3) if body == GROUND else scene.R0[body] for body in (joint.child, joint.parent))
    kind, inner = joint.kind, np.eye(3)
    if joint.parent_axis is not None:
        inner = np.column_stack([*normal_references(joint.parent_axis), joint.parent_axis])
    if kind.axes == "perpendicular":
        # the only rotational constraint is that x of the first frame is normal to y of the second
        outer = np.column_stack([*normal_references(joint.child_axis), joint.child_axis])
        return [inner[:, [2, 0, 1]], outer[:, [1, 2, 0]]]
    if kind.keeps_attitude:
        return [inner, child.T @ parent @ inner]
    if joint.child_axis is None:  # the child's attitude does not matter
        return [inner, np.eye(3)]
    return [inner, shortest_rotation(joint.child_axis, joint.parent_axis).T @ inner]


def add_force(carrier: Carrier, force: Force) -> Index:
    """Add a spring or load; returns the item's index."""
    from exudyn.itemInterface import (
        LoadForceVector,
        LoadTorqueVector,
        NodeGenericData,
        ObjectConnectorLinearSpringDamper,
        ObjectConnectorSpringDamper,
        ObjectConnectorTorsionalSpringDamper,
    )

    p, scene = force.parameters, carrier.scene
    if force.law.on_joint and force.is_spring:
        joint = scene.joint(force.joint)
        anchors = (joint.parent, joint.parent_anchor), (joint.child, joint.child_anchor)
        markers = [carrier.mark(*end, frame) for end, frame in zip(anchors, joint_frames(scene, joint), strict=True)]
        given = {"markerNumbers": markers, "stiffness": p["stiffness"], "damping": p["damping"]}
        if force.law.measure == "slide":
            return carrier.system.AddObject(ObjectConnectorLinearSpringDamper(
                axisMarker0=[0.0, 0.0, 1.0], offset=p[force.law.rest], **given))
        angle = at_start(scene)[joint.name][0][joint.kind.number("angle")] + joint.zero_angle
        turns = 2.0 * np.pi * np.round(angle / (2.0 * np.pi))
        # the data node stores the angle of the last step, to count full turns from the start on
        memory = carrier.system.AddNode(NodeGenericData(initialCoordinates=[angle - turns], numberOfDataCoordinates=1))
        return carrier.system.AddObject(ObjectConnectorTorsionalSpringDamper(
            nodeNumber=memory, offset=p[force.law.rest] - turns, **given))
    if force.law.on_joint:
        return _add_motor(carrier, force)
    if force.law.measure == "length":
        ends = (force.parent, p["parent_point"]), (force.child, p["child_point"])
        return carrier.system.AddObject(ObjectConnectorSpringDamper(
            markerNumbers=[carrier.mark(body, np.array(point), None) for body, point in ends],
            referenceLength=p["free_length"], stiffness=p["stiffness"], damping=p["damping"]))
    point = np.array(p.get("child_point", (0.0, 0.0, 0.0)))
    marker = carrier.mark(force.child, point, np.eye(3))
    load = LoadForceVector if force.law.measure == "force" else LoadTorqueVector
    return carrier.system.AddLoad(load(
        markerNumber=marker, loadVector=p[force.law.measure], bodyFixed=p["frame"] == "body",
        loadVectorUserFunction=_varied(p.get("factor", 0))))


@dataclasses.dataclass(frozen=True)
class Varied:
    """A user function of Exudyn that multiplies a load by a function of time."""

    function: TimeFunction

    def __call__(self, system: exudyn.MainSystem, t: float, load: list[float]) -> list[float]:
        """The load at time t."""
        now: list[float] = (np.array(load) * self.function(t)).tolist()
        return now


def _varied(value: object) -> Any:
    """The user function for a function of time, else 0, which means none."""
    return Varied(value) if isinstance(value, TimeFunction) else 0


def _add_motor(carrier: Carrier, force: Force) -> Index:
    """Add a torque or force along a joint's axis, which is fixed in both bodies, to the child, and its opposite to the
    parent. Forces act at anchors on the axis."""
    from exudyn.itemInterface import LoadForceVector, LoadTorqueVector

    joint = carrier.scene.joint(force.joint)
    load, key = (LoadTorqueVector, "torque") if force.law.measure == "angle" else (LoadForceVector, "force")
    size = force.parameters[key]
    constant = 1.0 if isinstance(size, TimeFunction) else size
    index = None
    for body, anchor, axis in ((joint.child, joint.child_anchor, joint.child_axis),
                               (joint.parent, joint.parent_anchor, -joint.parent_axis)):
        if body != GROUND:
            index = carrier.system.AddLoad(load(
                markerNumber=carrier.mark(body, anchor, np.eye(3)), loadVector=(constant * axis).tolist(),
                bodyFixed=True, loadVectorUserFunction=_varied(size)))
    return index
