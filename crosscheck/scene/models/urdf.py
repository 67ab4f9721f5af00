"""Writes a scene as URDF: the frame of a link is at its joint, with the axes of the body."""

from __future__ import annotations

from xml.etree.ElementTree import Element, SubElement

import numpy as np

from crosscheck.scene.coordinates import zero_attitude
from crosscheck.scene.model import GROUND, Joint, Scene
from crosscheck.scene.models.trees import grown, numbers, refused

WORLD = "world"
TYPES = {"revolute": "continuous", "prismatic": "prismatic", "fixed": "fixed"}
FAR = 1e9
"""m. A prismatic joint of a URDF must have limits."""


def urdf(scene: Scene) -> Element:
    """The root element; raises `SceneError` that names what a URDF cannot hold."""
    _check(scene)
    order, loops = grown(scene, "URDF")
    if loops:
        raise refused(scene, "URDF", f"joint {loops[0].name!r}, which closes a loop")
    root = Element("robot", name=scene.name)
    SubElement(root, "link", name=WORLD)
    origins = {GROUND: np.zeros(3)}  # of the link frames, from the centre of mass in the body's axes
    for body, joint in order:
        if joint is None:
            raise refused(scene, "URDF", f"the free body {scene.bodies[body].name!r}")
        origins[body] = joint.child_anchor
        _link(scene, root, body, joint)
        _joint(scene, root, joint, origins)
    return root


def _check(scene: Scene) -> None:
    if np.abs(scene.gravity - [0.0, 0.0, -9.81]).max() > 0:
        raise refused(scene, "URDF", f"gravity {scene.gravity.tolist()}, it has none of its own and engines take "
                      "(0, 0, -9.81)")
    for number, force in enumerate(scene.forces):
        if not force.of_joint:
            raise refused(scene, "URDF", f"forces[{number}], a {force.type}")
    for joint in scene.joints:
        if joint.type not in TYPES:
            raise refused(scene, "URDF", f"joint {joint.name!r} of type {joint.type}")
        for key, there in (("armature", any(joint.armature)), ("stiffness", any(joint.stiffness)),
                           ("drive", joint.drive is not None)):
            if there:
                raise refused(scene, "URDF", f"the {key} of joint {joint.name!r}")
    if any(body.name == WORLD for body in scene.bodies):
        raise refused(scene, "URDF", f'a body named "{WORLD}", which is its name for the ground')


def _link(scene: Scene, root: Element, body: int, joint: Joint) -> None:
    inertial = SubElement(SubElement(root, "link", name=scene.bodies[body].name), "inertial")
    SubElement(inertial, "origin", xyz=numbers(-joint.child_anchor), rpy="0 0 0")
    SubElement(inertial, "mass", value=repr(float(scene.masses[body])))
    J = scene.inertias[body]
    SubElement(inertial, "inertia", {f"i{'xyz'[i]}{'xyz'[j]}": repr(float(J[i, j]))
                                     for i in range(3) for j in range(i, 3)})


def _joint(scene: Scene, root: Element, joint: Joint, origins: dict[int, np.ndarray]) -> None:
    from scipy.spatial.transform import Rotation

    made = SubElement(root, "joint", name=joint.name, type=TYPES[joint.type])
    SubElement(made, "parent", link=WORLD if joint.parent == GROUND else scene.bodies[joint.parent].name)
    SubElement(made, "child", link=scene.bodies[joint.child].name)
    relative = zero_attitude(joint)
    if joint.type != "revolute" and joint.reference is None:  # the joint keeps the initial attitude
        inner = np.eye(3) if joint.parent == GROUND else scene.R0[joint.parent]
        relative = inner.T @ scene.R0[joint.child]
    SubElement(made, "origin", xyz=numbers(joint.parent_anchor - origins[joint.parent]),
               rpy=numbers(Rotation.from_matrix(relative).as_euler("xyz")))
    if joint.child_axis is not None:
        SubElement(made, "axis", xyz=numbers(joint.child_axis))
    if joint.type == "prismatic":
        SubElement(made, "limit", lower=repr(-FAR), upper=repr(FAR), effort=repr(FAR), velocity=repr(FAR))
    if any(joint.damping):
        SubElement(made, "dynamics", damping=repr(float(joint.damping[0])))
    if joint.mimic is not None:
        SubElement(made, "mimic", joint=joint.mimic.joint, multiplier=repr(joint.mimic.ratio),
                   offset=repr(joint.mimic.offset))
