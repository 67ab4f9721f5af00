"""Writes a scene as MJCF: body frames at the centres of mass in the initial pose, the reference of all joints."""

from __future__ import annotations

from xml.etree.ElementTree import Element, SubElement

import numpy as np

from crosscheck.scene.coordinates import at_start
from crosscheck.scene.joints import JOINT_TYPES
from crosscheck.scene.mechanics import torsion_angles
from crosscheck.scene.model import GROUND, Force, Joint, Scene, quaternion_from_rotation
from crosscheck.scene.models.trees import grown, numbers, refused
from crosscheck.scene.vectors import slide_direction

SECOND_NAMES = {"slide": " slide", "slide n1": " slide 1", "slide n2": " slide 2", "turn child": " second"}
"""Suffixes for the MJCF joints of a joint with several coordinates, by words of `JointType.motion`."""


def mjcf(scene: Scene) -> Element:
    """The root element; raises `SceneError` that names what MJCF cannot hold."""
    order, loops = grown(scene, "MJCF")
    root = Element("mujoco", model=scene.name)
    SubElement(root, "compiler", angle="radian", inertiafromgeom="false")
    SubElement(root, "option", gravity=numbers(scene.gravity))
    elements = {GROUND: SubElement(root, "worldbody")}
    start = {}
    for body, joint in order:
        parent = GROUND if joint is None else joint.parent
        elements[body] = _body(scene, elements[parent], body, parent)
        start[scene.bodies[body].name] = _joints(scene, elements[body], body, joint)
    equality = Element("equality")
    names = [body.name for body in scene.bodies]
    for joint in loops:
        if joint.type != "spherical":
            raise refused(scene, "MJCF", f"joint {joint.name!r}, which closes a loop and is of type {joint.type}")
        made = SubElement(equality, "connect", name=joint.name, body1=names[joint.child],
                          anchor=numbers(joint.child_anchor))
        if joint.parent != GROUND:
            made.set("body2", names[joint.parent])
    for joint in scene.joints:
        if joint.drive is not None:
            raise refused(scene, "MJCF", f"the drive of joint {joint.name!r}")
        if joint.mimic is not None:
            # of the ways from the references, which are the start
            SubElement(equality, "joint", joint1=joint.name, joint2=joint.mimic.joint, polycoef=numbers(
                (0.0, joint.mimic.ratio, 0.0, 0.0, 0.0)))
    if len(equality):
        root.append(equality)
    for number, force in enumerate(scene.forces):
        _force(scene, root, elements, number, force)
    walked = [start[element.get("name", "")] for element in elements[GROUND].iter("body")]  # MuJoCo's order
    SubElement(SubElement(root, "keyframe"), "key", name="start", qpos=numbers(value for q, _ in walked for value in q),
               qvel=numbers(value for _, v in walked for value in v))
    return root


def _body(scene: Scene, parent_element: Element, body: int, parent: int) -> Element:
    x, R = (np.zeros(3), np.eye(3)) if parent == GROUND else (scene.x0[parent], scene.R0[parent])
    element = SubElement(parent_element, "body", name=scene.bodies[body].name,
                         pos=numbers(R.T @ (scene.x0[body] - x)),
                         quat=numbers(quaternion_from_rotation(R.T @ scene.R0[body])))
    J = scene.inertias[body]
    SubElement(element, "inertial", pos="0 0 0", mass=repr(float(scene.masses[body])), fullinertia=numbers(
        J[entry] for entry in ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))))
    return element


def _joints(scene: Scene, element: Element, body: int, joint: Joint | None) -> tuple[list[float], list[float]]:
    """Add the MJCF joints of a body; returns their qpos and qvel."""
    if joint is None:
        SubElement(element, "freejoint", name=f"{scene.bodies[body].name} free")
        return ([*scene.x0[body], *scene.bodies[body].attitude], [*scene.v0[body], *scene.w0[body]])
    kind = JOINT_TYPES[joint.type]
    if kind.motion and not kind.coordinates:
        raise refused(scene, "MJCF", f"joint {joint.name!r} of type {joint.type}")
    if not kind.motion:
        return [], []
    q, v = at_start(scene)[joint.name]

    def add(name: str, kind: str, axis: np.ndarray | None, k: int) -> None:
        made = SubElement(element, "joint", name=name, type=kind, pos=numbers(joint.child_anchor))
        if axis is not None:
            made.set("axis", numbers(axis))
            made.set("ref", repr(float(q[k])))
        for key in ("armature", "damping", "stiffness"):
            values = getattr(joint, key)
            if any(values):
                made.set(key, repr(float(values[k])))
        if any(joint.stiffness):
            made.set("springref", repr(float((joint.rest_position or (0.0, 0.0))[k])))

    if kind.coordinates == ("ball",):
        add(joint.name, "ball", None, 0)
        return [1.0, 0.0, 0.0, 0.0], list(v)
    for k, word in enumerate(kind.coordinates):
        axis = joint.child_axis
        if word == "turn parent" or word.startswith("slide n"):
            inner = np.eye(3) if joint.parent == GROUND else scene.R0[joint.parent]
            axis = scene.R0[body].T @ inner @ (joint.parent_axis if word == "turn parent" else
                                               slide_direction(word, joint.parent_axis))
        name = joint.name + (SECOND_NAMES.get(word, "") if len(kind.coordinates) > 1 else "")
        add(name, "slide" if word.startswith("slide") else "hinge", axis, k)
    return list(q), list(v)


def _force(scene: Scene, root: Element, elements: dict[int, Element], number: int, force: Force) -> None:
    if force.of_joint:
        return
    p = force.parameters
    if force.type == "linear_spring":
        tendons = root.find("tendon")
        spatial = SubElement(SubElement(root, "tendon") if tendons is None else tendons, "spatial",
                             name=f"spring {number}", stiffness=repr(float(p["stiffness"])),
                             damping=repr(float(p["damping"])), springlength=repr(float(p["free_length"])))
        for end, body, point in (("parent", force.parent, p["parent_point"]), ("child", force.child, p["child_point"])):
            name = f"spring {number} {end}"
            SubElement(elements[body], "site", name=name, pos=numbers(point))
            SubElement(spatial, "site", site=name)
        return
    if force.type != "torsional_spring" or force.functions:
        moving = " whose rest angle depends on time" if force.functions else ""
        raise refused(scene, "MJCF", f"forces[{number}], a {force.type}{moving}")
    joint = next(element for element in root.iter("joint") if element.get("name") == force.joint)
    if "stiffness" in joint.attrib or "damping" in joint.attrib:
        raise refused(scene, "MJCF", f"forces[{number}], a second spring of joint {force.joint!r}")
    angle = float(torsion_angles(scene, scene.R0[None])[force.joint][0])
    joint.set("stiffness", repr(float(p["stiffness"])))
    joint.set("damping", repr(float(p["damping"])))
    joint.set("springref", repr(float(joint.get("ref", "0")) + p["rest_angle"] - angle))
