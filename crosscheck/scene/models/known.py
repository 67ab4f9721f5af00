"""Every element and attribute of model files that the reader knows; what is not on this list is named, never ignored.

An attribute on the list is in the numbers that MuJoCo compiles and the reader takes over, or it is checked there by
`crosscheck.scene.models.features`, or it says nothing about the motion. A tag with None has only such attributes.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from xml.etree.ElementTree import Element

from crosscheck.scene.model import LeftOut
from crosscheck.scene.models.source import Source, label

PLACE = "pos quat axisangle euler xyaxes zaxis"
_SOFT = "solimp solref solimpfriction solimplimit solreffriction solreflimit margin group user class name"
_TENDON = f"{_SOFT} limited range frictionloss actuatorfrclimited actuatorfrcrange stiffness damping armature " \
          "springlength material rgba width"

MJCF: Mapping[str, str | None] = {
    "mujoco": "model", "include": "file", "default": "class", "worldbody": f"{PLACE} name childclass", "asset": "",
    "compiler": "alignfree angle coordinate assetdir autolimits balanceinertia boundinertia boundmass conflict "
                "discardvisual eulerseq fitaabb fusestatic inertiafromgeom inertiagrouprange meshdir saveinertial "
                "settotalmass "
                "savecanonical savecompiled strippath texturedir usethread",
    "option": "timestep integrator cone jacobian solver iterations tolerance ls_iterations ls_tolerance impratio "
              "noslip_iterations noslip_tolerance ccd_iterations ccd_tolerance sdf_iterations sdf_initpoints o_margin "
              "o_solref o_solimp o_friction gravity wind magnetic density viscosity actuatorgroupdisable "
              "sleep_tolerance",
    "flag": "actuation autoreset clampctrl constraint contact damper energy equality eulerdamp filterparent "
            "frictionloss fwdinv gravity invdiscrete island limit midphase multiccd nativeccd override refsafe sensor "
            "spring warmstart diagexact ipc speculative passive",
    "body": f"{PLACE} name childclass mocap gravcomp user", "frame": f"{PLACE} name childclass",
    "inertial": f"{PLACE} mass diaginertia fullinertia",
    "joint": f"{_SOFT} type {PLACE} axis springdamper limited range actuatorfrclimited actuatorfrcrange ref springref "
             "actuatorgravcomp stiffness damping armature frictionloss",
    "freejoint": "name group align", "tendon": "", "default tendon": _TENDON, "spatial": _TENDON, "fixed": _TENDON,
    **dict.fromkeys(("geom", "site", "mesh", "hfield", "model", "plugin", "config", "extension", "instance", "contact",
                     "pair", "exclude", "pulley", "equality", "connect", "weld", "distance", "flexvert", "flexstrain",
                     "replicate", "attach", "composite")),
    "fixed joint": None, "equality joint": None, "equality tendon": None, "equality flex": None,
    "keyframe": "", "key": "act ctrl mpos mquat name qpos qvel time"}
"""Of MJCF, by tag, or by parent and tag."""

URDF: Mapping[str, str | None] = {
    "robot": "name version", "link": "name type", "inertial": "", "origin": "xyz rpy", "mass": "value",
    "inertia": "ixx iyy izz ixy ixz iyz", "joint": "name type dont_collapse", "parent": "link", "child": "link",
    "axis": "xyz", "dynamics": "damping friction",
    "limit": "lower upper effort velocity acceleration deceleration jerk drake:acceleration drake:jerk current "
             "command_effort gear_velocity",
    "mimic": "joint multiplier offset", "gazebo": "reference", "mujoco": "", "size": None, "option": MJCF["option"],
    "flag": MJCF["flag"],
    "compiler": "angle assetdir meshdir texturedir strippath discardvisual fusestatic usethread balanceinertia "
                "autolimits fitaabb"}
"""Of URDF, and of the element <mujoco> in it."""

WHOLE: Mapping[str, frozenset[str]] = {
    "mujoco": frozenset(("visual", "statistic", "size", "custom", "sensor", "texture", "material", "skin", "light",
                         "camera", "lengthrange", "actuator", "deformable", "flexcomp", "general", "motor", "position",
                         "velocity", "intvelocity", "orientation", "pid", "damper", "cylinder", "muscle", "adhesion",
                         "dcmotor")),
    "robot": frozenset(("visual", "collision", "contact", "material", "calibration", "safety_controller",
                        "transmission", "frame", "drake:collision_filter_group", "self_collision_checking",
                        "collision_checking", "self_filter", "ros2_control", "sensor"))}
"""Elements known with all that is in them: pictures and sensors, frames, what filters contacts, what the compiled model
names by itself, and the transmissions of a URDF, whose motors have no control: the import states them as such."""

GAZEBO = frozenset(("material", "mu1", "mu2", "kp", "kd", "minDepth", "min_depth", "maxVel", "max_vel", "maxContacts",
                    "selfCollide", "self_collide", "fdir1", "laserRetro", "sensor", "plugin", "visual", "collision",
                    "provideFeedback", "stopCfm", "stopErp", "implicitSpringDamper", "disableFixedJointLumping",
                    "preserveFixedJoint", "sensor:camera", "sensor:contact", "sensor:ray"))
"""Children of <gazebo>, from looks, sensors, contacts and how it integrates, that do not change the motion."""


def unread(each: LeftOut) -> bool:
    """Whether this one of `unknown` is an attribute that no reader of URDF takes, such as K of <dynamics>."""
    return re.match(r"the attribute [^:]+ of <(dynamics|limit|joint|link|mimic)>", each.what) is not None


def unknown(model: Source) -> Iterator[LeftOut]:
    """What the file says and the reader does not know."""
    table, whole = (URDF if model.is_urdf else MJCF), WHOLE[model.root.tag]

    def unread(element: Element, parent: str) -> Iterator[LeftOut]:
        if element.tag in whole:
            return
        key = f"{parent} {element.tag}" if f"{parent} {element.tag}" in table else element.tag
        if key not in table:
            yield LeftOut("", f"the element {label(element)}")
            return
        known = table[key]
        for attribute, value in element.items() if known is not None else ():
            if attribute not in str(known).split() and not attribute.startswith("xmlns") and _says(value) and not (
                    element.tag == "inertia" and value == element.get(f"i{attribute[:0:-1]}")):  # the other half
                yield LeftOut("", f"the attribute {attribute} of {label(element)}", _numbers(value))
        for child in element:
            if element.tag == "gazebo":
                rest = {"gravity": ("1", "true"), "turnGravityOff": ("0", "false")}.get(child.tag, ())
                if child.tag not in GAZEBO and (child.text or "").strip().lower() not in rest:
                    yield LeftOut("", f"the element {child.tag} of {label(element)}")
            else:
                yield from unread(child, element.tag)

    yield from dict.fromkeys(unread(model.root, ""))


def _numbers(text: str) -> str | tuple[float, ...]:
    """The numbers of an attribute, or its text."""
    try:
        return tuple(map(float, text.split()))
    except ValueError:
        return text


def _says(value: str) -> bool:
    """Whether an attribute says anything: not where all its values are zero or off."""
    return any(word not in ("0", "0.0", "0.", "false", "disable", "none", "auto") for word in value.split())
