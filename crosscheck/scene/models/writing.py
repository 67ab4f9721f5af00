"""Writes scenes: their files as TOML, and as the model files MJCF and URDF, which hold trees of bodies."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from typing import Any
from xml.etree.ElementTree import Element, SubElement

import numpy as np

from crosscheck.errors import SceneError
from crosscheck.scene.coordinates import at_start, zero_attitude
from crosscheck.scene.model import GROUND, Force, Joint, Scene, quaternion_from_rotation
from crosscheck.scene.spanning import hung
from crosscheck.scene.vectors import slide_direction

SECOND_NAMES = {"slide": " slide", "slide n1": " slide 1", "slide n2": " slide 2", "turn child": " second"}
"""Suffixes for the MJCF joints of a joint with several coordinates, by words of `JointType.motion`."""

WORLD = "world"
TYPES = {"revolute": "continuous", "prismatic": "prismatic", "fixed": "fixed"}
FAR = 1e9
"""m. A prismatic joint of a URDF must have limits."""


def toml(content: Mapping[str, Any]) -> str:
    """The text of a scene file from its plain mapping."""
    groups = ("bodies", "joints", "forces", "shapes", "monitors", "sites", "sensors", "published")
    lines = [f"{key} = {_value(value)}" for key, value in content.items() if key not in groups]
    for group in groups:
        for table in content.get(group, []):
            lines += ["", f"[[{group}]]", *(f"{key} = {_value(value)}" for key, value in table.items())]
    return "\n".join(lines) + "\n"


def _value(value: object) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        return json.dumps(value, ensure_ascii=False)
    if isinstance(value, Mapping):
        return "{ " + ", ".join(f"{key} = {_value(each)}" for key, each in value.items()) + " }"
    if isinstance(value, list | tuple):
        return "[" + ", ".join(map(_value, value)) + "]"
    return repr(value)


def mjcf(scene: Scene) -> Element:
    """The root element of an MJCF; raises `SceneError` that names what it cannot hold.

    Body frames are at the centres of mass in the initial pose, the reference of all joints.
    """
    order, loops = _grown(scene, "MJCF")
    root = Element("mujoco", model=scene.name)
    SubElement(root, "compiler", angle="radian", inertiafromgeom="false")
    SubElement(root, "option", gravity=_numbers(scene.gravity))
    elements = {GROUND: SubElement(root, "worldbody")}
    start = {}
    for body, joint in order:
        if scene.frames[body]:
            if sum(each.parent == body for each in scene.joints) > 1:
                raise _refused(scene, "MJCF", f"the frame {scene.bodies[body].name!r}, which carries several bodies")
            continue
        joints = [joint]
        while joints[0] is not None and joints[0].parent != GROUND and scene.frames[joints[0].parent]:
            joints.insert(0, next(each for each in scene.joints if each.child == joints[0].parent))
        parent = GROUND if joints[0] is None else joints[0].parent
        elements[body] = _mjcf_body(scene, elements[parent], body, parent)
        ways = [_mjcf_joints(scene, elements[body], body, each) for each in joints]
        start[scene.bodies[body].name] = ([at for q, _ in ways for at in q], [rate for _, v in ways for rate in v])
    equality = Element("equality")
    names = [body.name for body in scene.bodies]
    for joint in loops:
        if joint.type != "spherical":
            raise _refused(scene, "MJCF", f"joint {joint.name!r}, which closes a loop and is of type {joint.type}")
        made = SubElement(equality, "connect", name=joint.name, body1=names[joint.child],
                          anchor=_numbers(joint.child_anchor))
        if joint.parent != GROUND:
            made.set("body2", names[joint.parent])
    for joint in scene.joints:
        if joint.drive is not None:
            raise _refused(scene, "MJCF", f"the drive of joint {joint.name!r}")
        if joint.mimic is not None:
            # of the ways from the references, which are the start
            SubElement(equality, "joint", joint1=joint.name, joint2=joint.mimic.joint, polycoef=_numbers(
                (0.0, joint.mimic.ratio, 0.0, 0.0, 0.0)))
    if len(equality):
        root.append(equality)
    for number, force in enumerate(scene.forces):
        _mjcf_force(scene, root, elements, number, force)
    walked = [start[element.get("name", "")] for element in elements[GROUND].iter("body")]  # MuJoCo's order
    SubElement(SubElement(root, "keyframe"), "key", name="start",
               qpos=_numbers(value for q, _ in walked for value in q),
               qvel=_numbers(value for _, v in walked for value in v))
    return root


def _mjcf_body(scene: Scene, parent_element: Element, body: int, parent: int) -> Element:
    x, R = (np.zeros(3), np.eye(3)) if parent == GROUND else (scene.x0[parent], scene.R0[parent])
    element = SubElement(parent_element, "body", name=scene.bodies[body].name,
                         pos=_numbers(R.T @ (scene.x0[body] - x)),
                         quat=_numbers(quaternion_from_rotation(R.T @ scene.R0[body])))
    J = scene.inertias[body]
    SubElement(element, "inertial", pos="0 0 0", mass=repr(float(scene.masses[body])), fullinertia=_numbers(
        J[entry] for entry in ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))))
    return element


def _mjcf_joints(scene: Scene, element: Element, body: int, joint: Joint | None) -> tuple[list[float], list[float]]:
    """Add the MJCF joints of a body; returns their qpos and qvel."""
    if joint is None:
        SubElement(element, "freejoint", name=f"{scene.bodies[body].name} free")
        return ([*scene.x0[body], *scene.bodies[body].attitude], [*scene.v0[body], *scene.w0[body]])
    kind = joint.kind
    if kind.motion and not kind.coordinates:
        raise _refused(scene, "MJCF", f"joint {joint.name!r} of type {joint.type}")
    if not kind.motion:
        return [], []
    q, v = at_start(scene)[joint.name]
    outer, turn, anchor = scene.R0[joint.child], np.eye(3), joint.child_anchor
    if joint.child != body:  # a frame between
        turn = scene.R0[body].T @ outer
        anchor = scene.R0[body].T @ (scene.x0[joint.child] - scene.x0[body] + outer @ joint.child_anchor)

    def add(name: str, kind: str, axis: np.ndarray | None, k: int) -> None:
        made = SubElement(element, "joint", name=name, type=kind, pos=_numbers(anchor))
        if axis is not None:
            made.set("axis", _numbers(axis))
            made.set("ref", repr(float(q[k])))
        for key in ("armature", "damping", "stiffness"):
            values = getattr(joint, key)
            if any(values):
                made.set(key, repr(float(values[k])))
        if (ends := _range(scene, "MJCF", joint, k)) is not None:
            made.set("limited", "true")
            made.set("range", _numbers(np.clip(ends, -FAR, FAR)))
        if (friction := _friction(scene, "MJCF", joint, k)) is not None:
            made.set("frictionloss", repr(friction))
        if any(joint.stiffness):
            made.set("springref", repr(float((joint.rest_position or (0.0, 0.0))[k])))

    if kind.is_ball:
        add(joint.name, "ball", None, 0)
        return [1.0, 0.0, 0.0, 0.0], list(v)
    for k, word in enumerate(kind.coordinates):
        axis = turn @ joint.child_axis
        if word == "turn parent" or word.startswith("slide n"):
            inner = np.eye(3) if joint.parent == GROUND else scene.R0[joint.parent]
            axis = scene.R0[body].T @ inner @ (joint.parent_axis if word == "turn parent" else
                                               slide_direction(word, joint.parent_axis))
        name = joint.name + (SECOND_NAMES.get(word, "") if len(kind.coordinates) > 1 else "")
        add(name, "slide" if word.startswith("slide") else "hinge", axis, k)
    return list(q), list(v)


def _mjcf_force(scene: Scene, root: Element, elements: dict[int, Element], number: int, force: Force) -> None:
    p = force.parameters
    if force.type == "linear_spring":
        tendons = root.find("tendon")
        spatial = SubElement(SubElement(root, "tendon") if tendons is None else tendons, "spatial",
                             name=f"spring {number}", stiffness=repr(float(p["stiffness"])),
                             damping=repr(float(p["damping"])), springlength=repr(float(p["free_length"])))
        for end, body, point in (("parent", force.parent, p["parent_point"]), ("child", force.child, p["child_point"])):
            name = f"spring {number} {end}"
            SubElement(elements[body], "site", name=name, pos=_numbers(point))
            SubElement(spatial, "site", site=name)
        return
    if force.type == "servo" and not force.functions and not {"period", "no_load_speed"} & p.keys():
        actuators = root.find("actuator")
        constant = (p["proportional"] * p["target"] + p["derivative"] * p.get("target_velocity", 0.0)
                    + p["feedforward"])
        made = SubElement(SubElement(root, "actuator") if actuators is None else actuators, "general",
                          name=f"servo {number}", joint=str(force.joint), biastype="affine", gainprm="0",
                          biasprm=_numbers((constant, -p["proportional"], -p["derivative"])))
        if "effort_limit" in p:
            made.set("forcelimited", "true")
            made.set("forcerange", _numbers(p["effort_limit"]))
        return
    if force.type != "torsional_spring" or force.functions:
        moving = " whose rest angle depends on time" if force.functions else ""
        raise _refused(scene, "MJCF", f"forces[{number}], a {force.type}{moving}")
    joint = next(element for element in root.iter("joint") if element.get("name") == force.joint)
    if "stiffness" in joint.attrib or "damping" in joint.attrib:
        raise _refused(scene, "MJCF", f"forces[{number}], a second spring of joint {force.joint!r}")
    rest = scene.joint(force.joint).rest(force)
    joint.set("stiffness", repr(float(p["stiffness"])))
    joint.set("damping", repr(float(p["damping"])))
    joint.set("springref", repr(rest))


def _range(scene: Scene, form: str, joint: Joint, k: int = 0) -> tuple[float, float] | None:
    """The limits of a coordinate, or the range in which a monitor watches it, as an import takes them."""
    limits = joint.limits[k] if joint.limits else None
    watched = [monitor for monitor in scene.monitors if monitor.joint == joint.name]
    for number, monitor in enumerate(scene.monitors):
        if monitor.type != "range" or (monitor in watched and (limits is not None or len(watched) > 1)):
            raise _refused(scene, form, f"monitors[{number}], a {monitor.type} of {monitor.name}")
    if limits is not None and (not limits.rigid or limits.restitution):
        raise _refused(scene, form, f"the {'restitution' if limits.rigid else 'stiffness'} of the limits of joint "
                       f"{joint.name!r}")
    held = limits if limits is not None else watched[0] if watched else None
    return None if held is None else (held.lower, held.upper)


def _friction(scene: Scene, form: str, joint: Joint, k: int = 0) -> float | None:
    friction = joint.dry_friction[k] if joint.dry_friction else None
    if friction is not None and friction.static > friction.sliding:
        raise _refused(scene, form, f"the static value of the dry friction of joint {joint.name!r}")
    return None if friction is None else friction.sliding


def urdf(scene: Scene) -> Element:
    """The root element of a URDF; raises `SceneError` that names what it cannot hold.

    The frame of a link is at its joint, with the axes of the body.
    """
    _check_urdf(scene)
    order, loops = _grown(scene, "URDF")
    if loops:
        raise _refused(scene, "URDF", f"joint {loops[0].name!r}, which closes a loop")
    root = Element("robot", name=scene.name)
    SubElement(root, "link", name=WORLD)
    origins = {GROUND: np.zeros(3)}  # of the link frames, from the centre of mass in the body's axes
    for body, joint in order:
        if joint is None:
            raise _refused(scene, "URDF", f"the free body {scene.bodies[body].name!r}")
        origins[body] = joint.child_anchor
        _urdf_link(scene, root, body, joint)
        _urdf_joint(scene, root, joint, origins)
    return root


def _check_urdf(scene: Scene) -> None:
    if np.abs(scene.gravity - [0.0, 0.0, -9.81]).max() > 0:
        raise _refused(scene, "URDF", f"gravity {scene.gravity.tolist()}, it has none of its own and engines take "
                      "(0, 0, -9.81)")
    if scene.forces:
        raise _refused(scene, "URDF", f"forces[0], a {scene.forces[0].type}")
    for joint in scene.joints:
        if joint.type not in TYPES:
            raise _refused(scene, "URDF", f"joint {joint.name!r} of type {joint.type}")
        for key, there in (("armature", any(joint.armature)), ("stiffness", any(joint.stiffness)),
                           ("drive", joint.drive is not None)):
            if there:
                raise _refused(scene, "URDF", f"the {key} of joint {joint.name!r}")
    if any(body.name == WORLD for body in scene.bodies):
        raise _refused(scene, "URDF", f'a body named "{WORLD}", which is its name for the ground')


def _urdf_link(scene: Scene, root: Element, body: int, joint: Joint) -> None:
    link = SubElement(root, "link", name=scene.bodies[body].name)
    if scene.frames[body]:
        return
    inertial = SubElement(link, "inertial")
    SubElement(inertial, "origin", xyz=_numbers(-joint.child_anchor), rpy="0 0 0")
    SubElement(inertial, "mass", value=repr(float(scene.masses[body])))
    J = scene.inertias[body]
    SubElement(inertial, "inertia", {f"i{'xyz'[i]}{'xyz'[j]}": repr(float(J[i, j]))
                                     for i in range(3) for j in range(i, 3)})


def _urdf_joint(scene: Scene, root: Element, joint: Joint, origins: dict[int, np.ndarray]) -> None:
    from scipy.spatial.transform import Rotation

    made = SubElement(root, "joint", name=joint.name, type=TYPES[joint.type])
    SubElement(made, "parent", link=WORLD if joint.parent == GROUND else scene.bodies[joint.parent].name)
    SubElement(made, "child", link=scene.bodies[joint.child].name)
    relative = zero_attitude(joint)
    if joint.type != "revolute" and joint.reference is None:  # the joint keeps the initial attitude
        inner = np.eye(3) if joint.parent == GROUND else scene.R0[joint.parent]
        relative = inner.T @ scene.R0[joint.child]
    SubElement(made, "origin", xyz=_numbers(joint.parent_anchor - origins[joint.parent]),
               rpy=_numbers(Rotation.from_matrix(relative).as_euler("xyz")))
    if joint.child_axis is not None:
        SubElement(made, "axis", xyz=_numbers(joint.child_axis))
    ends = _range(scene, "URDF", joint)
    if joint.type == "prismatic" or ends is not None:
        lower, upper = np.clip(ends or (-FAR, FAR), -FAR, FAR).tolist()
        SubElement(made, "limit", lower=repr(lower), upper=repr(upper), effort=repr(FAR), velocity=repr(FAR))
        made.set("type", joint.type)
    friction = _friction(scene, "URDF", joint)
    if any(joint.damping) or friction is not None:
        SubElement(made, "dynamics", {key: repr(float(value)) for key, value in (
            ("damping", joint.damping[0] if joint.damping else 0.0), ("friction", friction or 0.0)) if value})
    if joint.mimic is not None:
        SubElement(made, "mimic", joint=joint.mimic.joint, multiplier=repr(joint.mimic.ratio),
                   offset=repr(joint.mimic.offset))


def _numbers(values: Iterable[float]) -> str:
    """Numbers as text for an attribute, with every bit."""
    return " ".join(repr(float(value)) for value in values)


def _refused(scene: Scene, form: str, what: str) -> SceneError:
    """The error for something that a format cannot hold."""
    return SceneError(f"{scene.name}: {form} cannot hold {what}")


def _grown(scene: Scene, form: str) -> tuple[list[tuple[int, Joint | None]], list[Joint]]:
    """((body, its joint or None if it is free), parents first; the joints that close loops)."""
    order, loops = hung(scene, lambda joint: joint.kind.length)
    alone = [body for body, joint in order if joint is None]
    if circles := [joint.name for joint in loops if joint.child in alone and not joint.kind.length]:
        raise _refused(scene, form, f"the circle of the joint {circles[0]!r}")
    return order, loops
