"""Code of the optional engines: open trees of four joint types under gravity, converted row by row."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np

from crosscheck.adapters.base import Engine, RunSpec
from crosscheck.adapters.common import tree
from crosscheck.adapters.common.links import relative_attitude
from crosscheck.adapters.common.stepping import Convert
from crosscheck.scene.functions import at
from crosscheck.scene.laws import Servo
from crosscheck.scene.model import GROUND, Scene, rotation_from_quaternion
from crosscheck.scene.states import States

if TYPE_CHECKING:
    from scipy.spatial.transform import Rotation

JOINTS = ("spherical", "revolute", "prismatic", "fixed")
"""Joint types these adapters build."""

BodyState = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]
"""x, R, v, w, a, alpha of a body at its centre of mass, all vectors in world axes."""


def unsupported(scene: Scene, spec: RunSpec, laws: str | tuple[str, ...], joints: tuple[str, ...] = JOINTS,
                forces: tuple[str, ...] = (), floating: bool = False) -> str | None:
    """Why such an adapter cannot run a scene in the given form, or None if it can.

    Parameters
    ----------
    laws : the elements of force laws of joints that it has, or why it has none
    joints, forces : types that it builds
    floating : whether bodies may hang on no joint
    """
    if spec.form not in (None, "tree"):
        return f"form {spec.form} is not built into this adapter; it has tree"
    known, why = ((), laws) if isinstance(laws, str) else (laws, "")
    reason = scene.beyond(known)
    return f"{reason}: {why}" if reason and why and scene.has_laws else reason or tree.obstacle(
        scene, joints, (*forces, *(("servo",) if "servo" in known else ())), floating)


def bouncing(scene: Scene) -> str | None:
    """Why an engine whose limits give nothing back by themselves cannot run a scene, or None if it can."""
    name = next((joint.name for joint in scene.joints for each in joint.limits if each and each.restitution), None)
    return name and f"the limits of joint {name!r} have a restitution, and the engine's limits none"


def rowed(scene: Scene) -> bool:
    """Whether there are dry friction or rigid limits, which such an engine solves for once a step."""
    return any(any(joint.dry_friction) or any(each and each.rigid for each in joint.limits) for joint in scene.joints)


def springless(scene: Scene) -> str | None:
    """Why an engine whose servos are springs in joints cannot run a scene, or None if it can."""
    name = next((name for name, servo in scene.servos.values() if not servo.proportional), None)
    return name and f"the servo of joint {name!r} has no proportional gain: here servos are springs in joints"


def rest(servo: Servo, sign: float, zero: float) -> float:
    """Where the spring of a servo with a constant target rests, in a coordinate as of `tree.coordinate`."""
    ahead = at(servo.feedforward, 0.0) + servo.derivative * at(servo.target_velocity, 0.0)
    return float(sign * (at(servo.target, 0.0) + ahead / servo.proportional - zero))


def without_accelerations(convert: Convert) -> Convert:
    """For an engine whose forward dynamics leave out rows that a step solves for."""
    return lambda t, q, v, a: convert(t, q, v, None)


class OpenTree(Engine):
    """An engine of joint coordinates alone, form `tree`."""

    forms = ("tree",)
    laws: str | tuple[str, ...] = ()  # as in `unsupported`, like the next three
    joints: tuple[str, ...] = JOINTS
    forces: tuple[str, ...] = ()
    floating = False

    def held_levels(self, scene: Scene, spec: RunSpec) -> frozenset[str]:
        """All three, by joint coordinates."""
        return tree.LEVELS

    def unsupported(self, scene: Scene, spec: RunSpec) -> str | None:
        """Why the engine cannot run a scene in the given form, or None if it can."""
        return unsupported(scene, spec, self.laws, self.joints, self.forces, self.floating)


def sprung(scene: Scene, link: tree.Link) -> tuple[float, float, float]:
    """(stiffness, rest position, damping) of all springs about a hinge, in its coordinate as a link."""
    springs = [force for force in scene.loads if force.is_spring and force.joint == link.joint]
    if not springs:
        return 0.0, 0.0, 0.0
    joint = scene.joint(link.joint)
    _, sign, zero = tree.coordinate(scene, link)
    stiffness, damping = (sum(float(each.parameters[key]) for each in springs) for key in ("stiffness", "damping"))
    moment = sum(float(each.parameters["stiffness"]) * (at(joint.rest(each), 0.0) - zero) for each in springs)
    return stiffness, sign * moment / stiffness if stiffness else 0.0, damping


def relative(R: np.ndarray, link: tree.Link) -> np.ndarray:
    """(T, 3, 3) attitudes of a link from its parent's axes, R (T, n, 3, 3) being those of all bodies in the world."""
    outer: np.ndarray = R[:, link.body]
    return outer if link.parent == GROUND else np.swapaxes(R[:, link.parent], 1, 2) @ outer


def clearances(attitudes: Rotation) -> dict[str, float]:
    """The least |cos| of the middle angle on the way through some attitudes, by the order of three turns about axes."""
    return {order: float(np.abs(np.cos(attitudes.as_euler(order, suppress_warnings=True)[:, 1])).min())
            for order in map("".join, itertools.permutations("XYZ"))}


def zero_attitude(scene: Scene, link: tree.Link) -> np.ndarray:
    """(3, 3) relative attitude at zero joint coordinates; for a ball the initial one, away from singular angles."""
    if link.type == "spherical":
        return rotation_from_quaternion(relative_attitude(scene, link.parent, link.body))
    return rotation_from_quaternion(link.zero)


def converter(scene: Scene, set_state: Callable[[np.ndarray, np.ndarray], None],
              body_state: Callable[[int], BodyState]) -> Convert:
    """A function from histories of joint coordinates to states, by the engine's own kinematics.

    Parameters
    ----------
    set_state : sets a row of joint positions and velocities in the engine
    body_state : gives the motion of a body, by its index, in that state
    """
    def convert(t: np.ndarray, q: np.ndarray, v: np.ndarray, a: np.ndarray | None) -> States:
        vectors = np.empty((5, len(t), scene.n, 3))
        R = np.empty((len(t), scene.n, 3, 3))
        for row in range(len(t)):
            set_state(q[row], v[row])
            for body in range(scene.n):
                x, R[row, body], *rates = body_state(body)
                vectors[:, row, body] = [x, *rates]
        x, velocity, w, acceleration, alpha = vectors
        # The angular acceleration in body axes is the derivative of the components of w, because w x w is zero.
        states = States(t, x, R, velocity, np.einsum("tnji,tnj->tni", R, w))
        if a is not None:
            states.a, states.alpha = acceleration, np.einsum("tnji,tnj->tni", R, alpha)
        return states

    return convert


def of_poses(scene: Scene, axes: np.ndarray | None = None) -> Convert:
    """A function from poses, 7 n of position and quaternion x, y, z, w, and velocities, 6 n in world axes, to states.

    The quaternions turn the axes of the bodies, or other `axes`, (n, 3, 3) in these.
    """
    def convert(t: np.ndarray, q: np.ndarray, v: np.ndarray, a: np.ndarray | None) -> States:
        pose, twist = q.reshape(len(t), scene.n, 7), v.reshape(len(t), scene.n, 6)
        turned = pose[..., [6, 3, 4, 5]]
        R = rotation_from_quaternion(turned / np.linalg.norm(turned, axis=-1, keepdims=True))
        if axes is not None:
            R = R @ np.swapaxes(axes, 1, 2)
        return States(t, pose[..., :3], R, twist[..., :3], np.einsum("tnji,tnj->tni", R, twist[..., 3:]))

    return convert


def rows(evaluate: Callable[[np.ndarray, np.ndarray], Any]) -> Callable[..., np.ndarray]:
    """Turns a function of one row (q, v) into one of histories (t, q, v)."""
    return lambda t, q, v: np.array([evaluate(*row) for row in zip(q, v, strict=True)]).reshape(v.shape)
