"""MuJoCo models of a scene: body frames at the centres of mass, reference configuration = initial position.

`tree`: joints of the scene as sequences of slides, hinges and balls on one body, loops closed by equality constraints.
`maximal`: all bodies free, every joint an equality constraint. Equality constraints are soft and act between sites.
"""

from __future__ import annotations

import dataclasses
import functools
import math
from collections.abc import Callable
from typing import Any

import numpy as np

from crosscheck.adapters.common import tree
from crosscheck.adapters.common.poses import in_body, relative_pose
from crosscheck.errors import Unsupported
from crosscheck.scene.coordinates import at_start
from crosscheck.scene.functions import at
from crosscheck.scene.laws import Limits, Servo
from crosscheck.scene.mechanics import weights
from crosscheck.scene.model import GROUND, Force, Joint, Scene, Sensor, quaternion_from_rotation
from crosscheck.scene.spanning import Branch, spanning_tree
from crosscheck.scene.vectors import slide_direction

INTEGRATORS = {
    "Euler": "mjINT_EULER",
    "implicit": "mjINT_IMPLICIT",
    "implicitfast": "mjINT_IMPLICITFAST",
    "RK4": "mjINT_RK4",
    "discrete": "mjINT_DISCRETE",
}
LAYOUT_INERTIA = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))
PREFERENCE = {"fixed": 5, "revolute": 4, "universal": 3, "spherical": 2, "distance": -1}
"""Joint types that equality constraints can hold too (points, frames, distances), the most suitable last; all others
stay in the tree if possible. A distance has no joint coordinates."""

TIGHT = 0.9999
"""The impedance of the stiffest constraints, which MuJoCo clamps there."""

SETTLING = 0.1
"""How long a stop without restitution takes to press out an impact, s: its restitution is a step over this."""

BOUNCE = 10.0
"""Steps of a stop with restitution per radian of its oscillation: an impact takes some thirty."""

SOLVER_TOLERANCE = 1e-12
"""MuJoCo's default of 1e-8 may end Newton's method before constraint forces are accurate to rounding."""


def closures(scene: Scene, form: str) -> tuple[list[Branch], list[Joint]]:
    """The branches on joint coordinates, and the joints that become equality constraints, in this form."""
    if form == "maximal":
        return [Branch(body, GROUND) for body in range(scene.n)], list(scene.joints)
    kept = {*_sprung(scene), *(name for name, _ in scene.servos.values()),
            *(joint.name for joint in scene.joints if any(joint.dry_friction) or any(joint.limits))}
    return spanning_tree(scene, lambda joint: 20 if joint.name in kept else PREFERENCE.get(joint.type, 10))


def hinges(scene: Scene, model: Any, form: str, q: np.ndarray) -> np.ndarray | None:
    """(T, h) rad: the angles of `scene.hinges` with their turns, from positions q (T, nq); None if one is no joint."""
    on = {branch.joint.name: branch for branch in closures(scene, form)[0] if branch.joint is not None}
    start, columns = at_start(scene), []
    for name, k in scene.hinges:
        if name not in on:
            return None
        branch = on[name]
        assert branch.joint is not None
        kind, outward = branch.joint.kind, branch.outward
        word = kind.coordinates[k]
        order = [*kind.motion] if outward or kind.axes == "parallel" else [*kind.motion[-1:], *kind.motion[:-1]]
        at = model.joint(f"{branch.body}.{order.index(word)}").qposadr[0]
        sign = 1.0 if outward or word == "turn" else -1.0  # a turn counts that of the child
        columns.append(start[name][0][k] + sign * (q[:, at] - model.qpos0[at]))
    return np.array(columns).reshape(-1, len(q)).T


def softened(scene: Scene, form: str) -> bool:
    """Whether the model has equality constraints."""
    return bool(closures(scene, form)[1]) or any(joint.mimic is not None for joint in scene.joints)


def of_own_law(scene: Scene) -> bool:
    """Whether the model has dry friction or limits, which MuJoCo has as soft constraints."""
    return any(any(joint.dry_friction) or any(joint.limits) for joint in scene.joints)


def without_bounces(scene: Scene) -> Scene:
    """The scene with stops that bounce out of reach: what their springs exert in an impact stands for a jump of
    velocities, and is no acceleration of the scene."""
    return scene.replace(joints=tuple(
        dataclasses.replace(joint, limits=tuple(Limits() if each and each.restitution else each
                                                for each in joint.limits)) for joint in scene.joints))


def obstacle(scene: Scene, form: str) -> str | None:
    """Why MuJoCo cannot model `scene` in `form`, or None."""
    in_tree = ("frame", "armature", "mimic", "joint_torque", "dry_friction", "limits", "servo", "sampled_servo",
               "effort_limit")
    if reason := scene.beyond(("function", "hold", *(in_tree if form == "tree" else ())), in_tree):
        return reason
    branches, closing = closures(scene, form)
    sprung = _sprung(scene)
    motors = {force.joint for force in scene.forces if force.is_motor}
    coupled = {name for joint in scene.joints if joint.mimic is not None for name in (joint.name, joint.mimic.joint)}
    for joint in closing:
        there = {"frame": scene.on_frame(joint), "armature": any(joint.armature),
                 "dry_friction": any(joint.dry_friction), "limits": any(joint.limits), "mimic": joint.name in coupled,
                 "motor": joint.name in motors, "spring": joint.name in sprung}
        if what := next((what for what, has in there.items() if has), None):
            return f"the {what} of joint {joint.name!r} needs a joint coordinate; equality constraints have none"
        if joint.type not in PREFERENCE:
            place = "form tree has it as joint coordinates" if form == "maximal" else "here it closes a loop"
            return (f"joint {joint.name!r}: MuJoCo's equality constraints hold points, frames and distances; none lets "
                    f"slide as type {joint.type} does, {place}")
    rods = {body: joint.name for joint in closing for body in (joint.parent, joint.child)}
    hung = next((branch.body for branch in branches if branch.joint is None and branch.body in rods), None)
    if form == "tree" and hung is not None:
        return (f"joint {rods[hung]!r}: body {scene.bodies[hung].name!r} hangs on distances only, which have no joint "
                "coordinates in MuJoCo; form maximal holds them as tendons of constant length")
    return None


def _sprung(scene: Scene) -> set[str]:
    """The joints with springs or dampers."""
    return {force.joint for force in scene.loads if force.is_spring and force.joint is not None}


EQUALITY_DATA = 12
"""Numbers that MuJoCo has for every equality constraint; one between coordinates is a polynomial of the first five."""
OBSERVED = (("POS", 3), ("QUAT", 4), ("LINVEL", 3), ("ANGVEL", 3), ("LINACC", 3), ("ANGACC", 3))
"""Sensors of a body's frame and their lengths, in world axes; their accelerations include minus gravity."""
NATIVE = {("position", "world"): "FRAMEPOS", ("attitude", ""): "FRAMEQUAT", ("velocity", "world"): "FRAMELINVEL",
          ("velocity", "site"): "VELOCIMETER", ("angular_velocity", "world"): "FRAMEANGVEL",
          ("angular_velocity", "site"): "GYRO", ("gyroscope", "site"): "GYRO", ("acceleration", "world"): "FRAMELINACC",
          ("angular_acceleration", "world"): "FRAMEANGACC", ("accelerometer", "site"): "ACCELEROMETER",
          ("force", "site"): "FORCE", ("torque", "site"): "TORQUE"}
"""MuJoCo's sensors at a site that stand for sensors of a scene, by type and frame."""


def native_sensors(scene: Scene, form: str) -> list[tuple[Sensor, str]]:
    """The sensors of a scene that MuJoCo has itself. Its force and torque are those between the body of the site and
    the one that carries it in the tree."""
    branches, _ = closures(scene, form)
    sites = {site.name: site.body for site in scene.sites}
    carried = {branch.joint.name: branch.body for branch in branches if branch.joint is not None and branch.outward}
    return [(sensor, NATIVE[sensor.type, sensor.frame]) for sensor in scene.sensors
            if (sensor.type, sensor.frame) in NATIVE
            and (sensor.joint is None or carried.get(sensor.joint) == sites[sensor.site or ""])]


def build(scene: Scene, method: str, step: float, form: str = "tree", softness: str = "tight",
          observed: bool = False) -> Any:
    """The compiled `mujoco.MjModel`; body k of the scene is called str(k).

    Parameters
    ----------
    method : of `INTEGRATORS`.
    step : s.
    form : "tree" or "maximal".
    softness : of equality constraints; "tight": the stiffest that MuJoCo allows, solref 2 step and solimp 0.9999;
        "default": MuJoCo's default, solref 0.02 s and solimp 0.9 to 0.95.
    observed : add the sensors `OBSERVED` of every body, which take time in every step, then those of `NATIVE`.
    """
    import mujoco

    if not hasattr(mujoco.mjtIntegrator, INTEGRATORS[method]):  # another version of the engine
        raise Unsupported(f"MuJoCo {mujoco.__version__} has no integrator {method}")
    spec = mujoco.MjSpec()
    spec.compiler.inertiafromgeom = mujoco.mjtInertiaFromGeom.mjINERTIAFROMGEOM_FALSE
    spec.compiler.degree = False
    spec.option.timestep, spec.option.gravity, spec.option.tolerance = step, scene.gravity, SOLVER_TOLERANCE
    spec.option.integrator = getattr(mujoco.mjtIntegrator, INTEGRATORS[method])
    spec.option.disableflags = mujoco.mjtDisableBit.mjDSBL_CONTACT | mujoco.mjtDisableBit.mjDSBL_AUTORESET
    frames = {GROUND: spec.worldbody}
    branches, closing = closures(scene, form)
    solref = [] if softness == "default" else [2 * step, 1.0]
    for branch in branches:
        frames[branch.body] = _add_body(scene, branch, frames[branch.parent], solref, method)
    builder = _Constraints(scene, spec, frames, solref)
    for joint in closing:
        builder.close(joint)
    on = {branch.joint.name: branch for branch in branches if branch.joint is not None}
    for joint in scene.joints:
        if joint.mimic is not None:
            follower, leader = (_coordinate_of(scene, on[name]) for name in (joint.name, joint.mimic.joint))
            builder.follow(joint.name, follower, leader, joint.mimic.ratio)
    for index, force in enumerate(scene.forces):
        if force.joint is None:
            _add_force(spec, frames, index, force)
        elif not force.is_spring or force.functions:  # other springs are in their hinges
            branch = next(branch for branch in branches
                          if branch.joint is not None and branch.joint.name == force.joint)
            assert branch.joint is not None
            words = branch.joint.kind.coordinates
            name, direction = _coordinate_of(scene, branch, words[branch.joint.kind.number(force.law.measure)])
            _add_actuator(spec, index, force, trntype=mujoco.mjtTrn.mjTRN_JOINT, target=name,
                          gear=[direction, 0.0, 0.0, 0.0, 0.0, 0.0])
    for k in range(scene.n if observed else 0):
        for quantity, _ in OBSERVED:
            spec.add_sensor(type=getattr(mujoco.mjtSensor, f"mjSENS_FRAME{quantity}"),
                            objtype=mujoco.mjtObj.mjOBJ_XBODY, objname=str(k))
    for site in scene.sites if observed else ():
        frames[site.body].add_site(name=f"site {site.name}", pos=site.position, quat=site.attitude)
    for sensor, kind in native_sensors(scene, form) if observed else ():
        spec.add_sensor(type=getattr(mujoco.mjtSensor, f"mjSENS_{kind}"), objtype=mujoco.mjtObj.mjOBJ_SITE,
                        objname=f"site {sensor.site}")
    model = spec.compile()
    if scene.frames.any():  # MuJoCo compiles bodies with mass alone, and computes with any
        for k in np.flatnonzero(scene.frames).tolist():
            model.body(str(k)).mass[:], model.body(str(k)).inertia[:] = 0.0, 0.0
        mujoco.mj_setConst(model, mujoco.MjData(model))
    return model


def _add_body(scene: Scene, branch: Branch, frame: Any, solref: list[float], method: str) -> Any:
    """A body on its joints, in the frame of its parent; `solref` of friction and limits, empty for the default."""
    import mujoco

    k, joint = branch.body, branch.joint
    body = frame.add_body(name=str(k))
    body.pos, attitude = relative_pose(scene, branch.parent, k)
    body.quat = quaternion_from_rotation(attitude)
    masses, inertias = weights(scene)
    body.mass = masses[k]
    body.fullinertia = [inertias[k][entry] for entry in LAYOUT_INERTIA]
    body.ipos, body.explicitinertial = np.zeros(3), True
    if joint is None:
        body.add_freejoint(name=str(k))
        return body
    for number, (kind, point, axis) in enumerate(_coordinates(scene, branch)):
        coordinate = body.add_joint(name=f"{k}.{number}", type=getattr(mujoco.mjtJoint, kind), pos=point, axis=axis)
        if joint.armature:
            coordinate.armature = joint.armature[0 if kind == "mjJNT_HINGE" or len(joint.armature) == 1 else 1]
        if joint.kind.is_elastic:
            _give_laws(scene, branch, coordinate, kind, solref, method)
    return body


def _give_laws(scene: Scene, branch: Branch, coordinate: Any, kind: str, solref: list[float], method: str) -> None:
    """Count a hinge or slide from the scene's zero, and set its springs and dampers, its dry friction and its range."""
    joint = branch.joint
    assert joint is not None
    measure = "slide" if kind == "mjJNT_SLIDE" else "angle"
    k = joint.kind.number(measure)
    direction = _coordinate_of(scene, branch, joint.kind.coordinates[k])[1]
    coordinate.ref = direction * at_start(scene)[joint.name][0][k]
    springs = [force for force in scene.loads
               if force.joint == joint.name and force.is_spring and force.law.measure == measure]
    if springs:
        stiffness, damping = (sum(force.parameters[key] for force in springs) for key in ("stiffness", "damping"))
        moment = sum(force.parameters["stiffness"] * (  # an actuator moves one whose rest angle is a function
            -joint.zero_angle if force.functions else joint.rest(force)) for force in springs)
        coordinate.springref = direction * moment / stiffness if stiffness else 0.0
        _make_elastic(coordinate, stiffness, damping)
    friction = joint.dry_friction[k] if joint.dry_friction else None
    limits = joint.limits[k] if joint.limits else None
    if friction is not None:
        coordinate.frictionloss = friction.sliding
        if solref:
            coordinate.solref_friction, coordinate.solimp_friction[:2] = solref, TIGHT
    if limits is not None:
        coordinate.limited, coordinate.range = True, tree.ends(limits, direction, 0.0, 1e9)
        if solref:
            coordinate.solimp_limit[:2] = TIGHT
            coordinate.solref_limit = stop(limits.restitution, solref[0] / 2, method)


def stop(restitution: float, step: float, method: str = "RK4") -> list[float]:
    """The time constant and damping ratio of a soft stop that converges to one with this restitution as the step falls.

    A unilateral spring and damper of damping ratio z, of which the force ends before the spring is free, has the
    restitution exp(-2 z / sqrt(1 - z^2) acos(z)), .135 at z = 1 and 1 / (4 z^2) far above. A stop without restitution
    has one that falls with the step, so that the depth of an impact is gone after SETTLING. One with restitution takes
    BOUNCE steps a radian; `discrete` takes spring and damper at the end of a step, which damps by half a step's turn.
    """
    if restitution == 0:
        return [2.0 * step, max(1.0, 0.5 * math.sqrt(SETTLING / step))]
    from scipy.optimize import brentq

    def gap(z: float) -> float:
        root = math.sqrt(abs(1.0 - z * z))
        turn = 1.0 if root == 0 else math.acos(z) / root if z < 1.0 else math.acosh(z) / root
        return math.exp(-2.0 * z * turn) - restitution

    ratio, turn = 1e-6 if gap(1e-6) <= 0 else float(brentq(gap, 1e-6, 1e3)), 1.0 / BOUNCE
    if method == "discrete":
        turn = min(turn, max(ratio, 0.2 / BOUNCE))
        ratio = max(ratio - 0.5 * turn, 1e-6)
    return [step / (turn * ratio), ratio]  # its frequency is 1 / (time constant times ratio)


def _coordinates(scene: Scene, branch: Branch) -> list[tuple[str, np.ndarray, np.ndarray]]:
    """(type, anchor, axis) of the MuJoCo joints of a branch, innermost first, in the outer body's frame at t = 0.

    An axis or line that is fixed in the inner body comes before the rotation, one fixed in the outer body after it.
    """
    joint, body = branch.joint, branch.body
    assert joint is not None
    kind = joint.kind
    anchors = {joint.parent: joint.parent_anchor, joint.child: joint.child_anchor}
    point = anchors[body]
    if not branch.outward and kind.axes == "parent":  # the ball comes first, about the inner body's point
        at, attitude = relative_pose(scene, branch.parent, body)
        point = attitude.T @ (anchors[branch.parent] - at)
    parts = []
    for word in kind.motion:
        if word == "ball":
            parts.append(("mjJNT_BALL", point, np.zeros(3)))
        elif word.startswith("slide"):
            along = in_body(scene, joint.parent, body, slide_direction(word, joint.parent_axis))
            parts.append(("mjJNT_SLIDE", point, along))
        else:
            ends = (joint.child, joint.child_axis) if word == "turn child" else (joint.parent, joint.parent_axis)
            axis = in_body(scene, ends[0], body, ends[1])
            # the angle of the scene is that of the child relative to the parent
            parts.append(("mjJNT_HINGE", point, -axis if word == "turn" and not branch.outward else axis))
    return parts if branch.outward or kind.axes == "parallel" else [*parts[-1:], *parts[:-1]]


class _Constraints:
    """Adds equality constraints to a MuJoCo specification; an empty `solref` keeps MuJoCo's default softness."""

    def __init__(self, scene: Scene, spec: Any, frames: dict[int, Any], solref: list[float]) -> None:
        self._scene, self._spec, self._frames, self._solref = scene, spec, frames, solref

    def close(self, joint: Joint) -> None:
        """Add a joint of a type in `PREFERENCE`."""
        ends = [(joint.parent, joint.parent_anchor), (joint.child, joint.child_anchor)]
        # any length works; with one of the scene's order softness has the same effect on points and axes
        arm = max(np.linalg.norm(anchor) for _, anchor in ends) or 1.0
        if joint.type == "distance":
            self._hold_distance(joint.name, ends)
        elif joint.type == "fixed":
            _, attitude = relative_pose(self._scene, joint.parent, joint.child)
            self._hold("mjEQ_WELD", joint.name, ends, [attitude, np.eye(3)])
        else:
            self._hold("mjEQ_CONNECT", joint.name, ends)
        if joint.type in ("revolute", "universal"):
            axes = joint.parent_axis, joint.child_axis
            tips = [(body, anchor + arm * axis) for (body, anchor), axis in zip(ends, axes, strict=True)]
            if joint.type == "revolute":
                self._hold("mjEQ_CONNECT", f"{joint.name}, axis", tips)
            else:  # perpendicular axes through one point: the distance of their tips is constant
                self._hold_distance(f"{joint.name}, axes", tips)

    def follow(self, name: str, follower: tuple[str, float], leader: tuple[str, float], ratio: float) -> None:
        """One coordinate, with its sign, follows another one, both by the way from their references at the start."""
        import mujoco

        self._add(name=f"{name}, mimic", type=mujoco.mjtEq.mjEQ_JOINT, name1=follower[0], name2=leader[0],
                  data=np.pad([0.0, ratio * follower[1] * leader[1]], (0, EQUALITY_DATA - 2)))

    def _sites(self, name: str, ends: list[tuple[int, np.ndarray]], attitudes: Any = None) -> list[str]:
        sites = []
        for number, (body, point) in enumerate(ends):
            site = self._frames[body].add_site(name=f"{name}.{number}", pos=point)
            if attitudes is not None:
                site.quat = quaternion_from_rotation(attitudes[number])
            sites.append(site.name)
        return sites

    def _hold(self, kind: str, name: str, ends: list[tuple[int, np.ndarray]], attitudes: Any = None) -> None:
        import mujoco

        sites = self._sites(name, ends, attitudes)
        self._add(type=getattr(mujoco.mjtEq, kind), objtype=mujoco.mjtObj.mjOBJ_SITE, name1=sites[0], name2=sites[1])

    def _hold_distance(self, name: str, ends: list[tuple[int, np.ndarray]]) -> None:
        import mujoco

        tendon = self._spec.add_tendon(name=name)
        for site in self._sites(name, ends):
            tendon.wrap_site(site)
        self._add(type=mujoco.mjtEq.mjEQ_TENDON, objtype=mujoco.mjtObj.mjOBJ_TENDON, name1=name)

    def _add(self, **options: Any) -> None:
        equality = self._spec.add_equality(**options)
        if self._solref:
            equality.solref = self._solref
            equality.solimp[:2] = TIGHT


def _make_elastic(item: Any, stiffness: float, damping: float) -> None:
    """Set linear stiffness and damping of a joint or tendon; polynomials in MuJoCo 4, numbers in older versions."""
    for name, value in (("stiffness", stiffness), ("damping", damping)):
        setattr(item, name, [value, 0.0, 0.0] if np.ndim(getattr(item, name)) else value)


def _add_force(spec: Any, frames: dict[int, Any], index: int, force: Force) -> None:
    """Add a spring as a tendon, or a load as an actuator of constant bias 1 with the load as its gear.

    An actuator is evaluated at every stage of a step. Its wrench is along the axes of its site or, with a reference
    site in the world, along the world axes.
    """
    import mujoco

    p = force.parameters
    if force.law.measure == "length":
        tendon = spec.add_tendon(name=f"spring {index}")
        for body, point in ((force.parent, p["parent_point"]), (force.child, p["child_point"])):
            tendon.wrap_site(frames[body].add_site(name=f"spring {index}.{body}", pos=point).name)
        tendon.springlength = [p["free_length"]] * 2
        _make_elastic(tendon, p["stiffness"], p["damping"])
        return
    load = [*p.get("force", np.zeros(3)), *p.get("torque", np.zeros(3))]
    name = f"load {index}"
    frames[force.child].add_site(name=name, pos=p.get("child_point", (0.0, 0.0, 0.0)))
    actuator = _add_actuator(spec, index, force, trntype=mujoco.mjtTrn.mjTRN_SITE, target=name, gear=load)
    if p["frame"] == "world":
        spec.worldbody.add_site(name=f"{name}, axes")
        actuator.refsite = f"{name}, axes"


def _add_actuator(spec: Any, index: int, force: Force, **options: Any) -> Any:
    """An actuator of constant bias, or with a control that `controls` sets at every stage of a step."""
    import mujoco

    timed = bool(force.functions)
    actuator = spec.add_actuator(name=f"load {index}", biastype=mujoco.mjtBias.mjBIAS_AFFINE, **options)
    if force.law.has_modes:
        servo = Servo(**force.parameters)
        if servo.period is None:  # its control is what it wants at zero position and rate
            actuator.biasprm[1:3] = -servo.proportional, -servo.derivative
            actuator.biasprm[0] = 0.0 if timed else uncut(servo, 0.0)
            if servo.effort_limit is not None:
                actuator.forcelimited, actuator.forcerange = True, servo.effort_limit
        actuator.gainprm[0] = float(timed or servo.period is not None)
        return actuator
    size = 1.0 if force.joint is None else force.parameters.get("torque", force.parameters.get("force", 0.0))
    actuator.gainprm[0], actuator.biasprm[0] = float(timed), 0.0 if timed else size
    return actuator


def uncut(servo: Servo, t: float) -> float:
    """What a servo wants at position and rate zero: the control of an actuator with its gains."""
    effort: float = (servo.proportional * at(servo.target, t) + servo.derivative * at(servo.target_velocity, t)
                    + at(servo.feedforward, t))
    return effort


def controls(scene: Scene) -> Callable[[Any, Any], None] | None:
    """A function that sets the controls of time-dependent actuators at each stage; None if there are none."""
    timed: list[tuple[str, Callable[[float], float]]] = [
        (f"load {index}", force.functions[0].times(force.parameters.get("stiffness", 1.0)))
        for index, force in enumerate(scene.forces) if force.functions and index not in scene.servos]
    timed += [(f"load {index}", functools.partial(uncut, servo)) for index, (_, servo) in scene.servos.items()
              if servo.period is None and scene.forces[index].functions]
    if not timed:
        return None

    def control(model: Any, data: Any) -> None:
        for name, function in timed:
            data.ctrl[model.actuator(name).id] = function(data.time)

    return control


def _coordinate_of(scene: Scene, branch: Branch, word: str = "") -> tuple[str, float]:
    """The coordinate along the joint of a branch, by default its first one, and 1 or, for opposite signs, -1."""
    joint = branch.joint
    assert joint is not None
    wanted = "mjJNT_SLIDE" if (word or joint.kind.coordinates[0]) == "slide" else "mjJNT_HINGE"
    own = joint.child_axis if branch.body == joint.child else -joint.parent_axis
    return next((f"{branch.body}.{number}", 1.0 if axis @ own > 0 else -1.0)
                for number, (kind, _, axis) in enumerate(_coordinates(scene, branch)) if kind == wanted)


def set_initial_state(scene: Scene, model: Any, data: Any) -> None:
    """Set `data` to the scene's initial state, whose positions are the model's reference configuration.

    Joint velocities follow from those of the bodies by MuJoCo's own Jacobians.
    """
    import mujoco

    data.qpos[:] = model.qpos0
    mujoco.mj_kinematics(model, data)
    mujoco.mj_comPos(model, data)
    jacobian = np.zeros((2 * scene.n, 3, model.nv))
    for k in range(scene.n):
        mujoco.mj_jacBodyCom(model, data, jacobian[2 * k], jacobian[2 * k + 1], model.body(str(k)).id)
    wanted = np.stack([scene.v0, np.einsum("nij,nj->ni", scene.R0, scene.w0)], axis=1)
    if model.nv:
        data.qvel[:] = np.linalg.lstsq(jacobian.reshape(-1, model.nv), wanted.ravel(), rcond=None)[0]
