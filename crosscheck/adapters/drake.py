"""Drake: joint coordinates of a MultibodyPlant in continuous time, stepped by its own integrators.

Source: https://drake.mit.edu, Tedrake and the Drake development team 2019. A ball joint has roll, pitch and yaw, which
are singular at a pitch of a right angle. They are therefore measured from the initial attitude, about the axes of which
a preliminary run keeps farthest from there.
"""

from __future__ import annotations

import contextlib
import dataclasses
import time
from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from crosscheck.adapters.base import RawRun, RunSpec
from crosscheck.adapters.common import open_tree, stepping, tree
from crosscheck.adapters.common.native import JointStates, Native, Part, assembled, moved
from crosscheck.errors import EngineError, errors_as
from crosscheck.scene.model import GROUND, Scene
from crosscheck.scene.models import source
from crosscheck.scene.states import States

FIXED = {"explicit_euler": 1, "semi_explicit_euler": 1, "runge_kutta2": 2}
"""Integrators without error control, and their order."""

CONTROLLED = ("runge_kutta3", "runge_kutta5", "bogacki_shampine3", "radau3", "implicit_euler")
"""Integrators with error control; rtol is Drake's target accuracy, the weighted error of the states in one step."""

LONGEST = 0.1
"""Longest step (s) of an integrator with error control, the same as in Drake's own simulations."""

SCOUT, SCOUTED = 1e-4, 501
"""Target accuracy and output times of the preliminary run that looks for singular angles of balls."""

LAWS = ("Drake has no dry friction in joints, and limits and controllers only in plants of discrete time, whose step "
        "is none of the integrators here")
"""Why there are no force laws of joints, by the documentation of MultibodyPlant and JointActuator."""


Moment = tuple[float, np.ndarray, np.ndarray]
"""Time (s), joint positions, joint velocities."""


class Drake(open_tree.OpenTree):
    """Adapter of Drake, form `tree`."""

    name = "drake"
    methods = (*FIXED, *CONTROLLED)
    adaptive_methods = CONTROLLED
    orders = MappingProxyType(FIXED | {"implicit_euler": 1})
    package = "drake"
    laws = LAWS
    joints = (*open_tree.JOINTS, "universal", "planar")
    forces = ("torsional_spring",)
    floating = True
    reads = (".urdf", ".sdf", ".world")

    def run(self, scene: Scene, spec: RunSpec) -> RawRun:
        """Integrate; raises `EngineError` with Drake's message if it fails."""
        model = Model(scene)
        raw = _stepped(scene, spec, model) if spec.method in FIXED else _controlled(scene, spec, model)
        raw.form = "tree"
        return raw

    def native(self, path: str, states: JointStates) -> Native:
        """The model that Drake makes of a model file by itself."""
        return loaded(path, states)


def loaded(path: str, states: JointStates) -> Native:
    """The file read by Drake without its shapes, its base held; accelerations from its mass matrix and bias term."""
    from pydrake.multibody.parsing import Parser
    from pydrake.multibody.plant import MultibodyPlant
    from pydrake.multibody.tree import BodyIndex, PrismaticJoint, RevoluteJoint

    model = source.bare(Path(path), sdf=True)
    for each in model.root.findall("transmission"):  # Drake 1.51 may crash on one
        if next(each.iter("drake:rotor_inertia"), None) is None:
            model.root.remove(each)
    plant = MultibodyPlant(0.0)
    with errors_as(lambda error: EngineError(" ".join(str(error).split()))):
        if len(instances := Parser(plant).AddModelsFromString(model.text, "urdf" if model.is_urdf else "sdf")) != 1:
            raise EngineError(f"it has {len(instances)} models, one is compared")
        plant.Finalize()
    context, parts, columns = plant.CreateDefaultContext(), dict[str, Part](), dict[str, int]()
    starts: dict[str, Any] = {}
    joints = [plant.get_joint(index) for index in plant.GetJointIndices()]
    for each in joints:
        if isinstance(each, RevoluteJoint | PrismaticJoint):
            columns[each.name()], starts[each.name()] = len(columns), each
        elif each.num_velocities() not in (0, 6):
            raise EngineError(f"joint {each.name()!r} has several coordinates, which is not compared")
    q = np.zeros(plant.num_positions())
    places = {name: (joint.position_start(), joint.velocity_start()) for name, joint in starts.items()}
    floating = [plant.get_body(index) for index in plant.GetFloatingBaseBodies()]
    for body in floating:
        q[body.floating_positions_start()] = 1.0
    plant.SetPositions(context, q)
    held: dict[Any, Any] = {each.child_body().index(): each for each in joints}
    for index in map(int, plant.GetBodyIndices(instances[0])):
        body = plant.get_body(BodyIndex(index))
        joint: Any = held.get(body.index())
        pose, about = plant.EvalBodyPoseInWorld(context, body), body.CalcSpatialInertiaInBodyFrame(context)
        R = pose.rotation().matrix()
        central = about.Shift(about.get_com()).CalcRotationalInertia().CopyToFullMatrix3()
        moving = joint is not None and joint.name() in columns
        outer = plant.world_frame() if joint is None else joint.frame_on_child()
        at = outer.CalcPoseInWorld(context)
        axis = np.zeros(3) if not moving else at.rotation().matrix() @ (
            joint.revolute_axis() if isinstance(joint, RevoluteJoint) else joint.translation_axis())
        parent = "" if joint is None or joint.parent_body().index() == plant.world_body().index() else (
            joint.parent_body().name())
        parts[body.name()] = Part(parent, about.get_mass(), pose @ about.get_com(), R @ central @ R.T, R,
                                  joint.name() if moving else "", at.translation(), axis,
                                  "prismatic" if isinstance(joint, PrismaticJoint) else "revolute",
                                  float(joint.default_damping_vector()[0]) if moving else 0.0,
                                  (float(joint.position_lower_limits()[0]), float(joint.position_upper_limits()[0]))
                                  if moving else None, not model.is_urdf and body in floating)

    def terms(position: np.ndarray, velocity: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        rates, rows = np.zeros(plant.num_velocities()), [places[name][1] for name in columns]
        q[[places[name][0] for name in columns]], rates[rows] = position, velocity
        plant.SetPositions(context, q)
        plant.SetVelocities(context, rates)
        bias = plant.CalcBiasTerm(context) - plant.CalcGravityGeneralizedForces(context)
        return plant.CalcMassMatrix(context)[np.ix_(rows, rows)], bias[rows]

    return moved(assembled("drake", parts, plant.gravity_field().gravity_vector()), states, columns, "CalcBiasTerm",
                 terms)


class Model:
    """The scene's plant, and a context in which its states are evaluated."""

    def __init__(self, scene: Scene, axes: Mapping[int, np.ndarray] | None = None) -> None:
        from pydrake.multibody.plant import MultibodyPlant

        self.axes = _axes(scene) if axes is None else axes  # of balls, by body
        self.plant = MultibodyPlant(0.0)
        self.bodies = [self.plant.AddRigidBody(str(index), _inertia(body)) for index, body in enumerate(scene.bodies)]
        links = tree.links(scene)
        self.joints = [(link, self._joint(scene, link)) for link in links if link.type != "free"]
        self.floating = [link.body for link in links if link.type == "free"]
        self.plant.mutable_gravity_field().set_gravity_vector(scene.gravity)
        self.plant.Finalize()
        self.bench = self.plant.CreateDefaultContext()

    def _joint(self, scene: Scene, link: tree.Link) -> Any:
        from pydrake.math import RigidTransform, RotationMatrix
        from pydrake.multibody.tree import (
            BallRpyJoint,
            FixedOffsetFrame,
            PlanarJoint,
            PrismaticJoint,
            RevoluteJoint,
            RevoluteSpring,
            UniversalJoint,
            WeldJoint,
        )

        parent = self.plant.world_body() if link.parent == GROUND else self.bodies[link.parent]
        axes = self.axes.get(link.body, np.eye(3))
        if link.type in ("universal", "planar"):  # along the first two axes, in this order
            first, second = (part.axis for part in link.parts[:2])
            axes = np.stack([first, second, np.cross(first, second)], axis=1)
        outer = RigidTransform(RotationMatrix(open_tree.zero_attitude(scene, link) @ axes), link.parent_anchor)
        inner = RigidTransform(RotationMatrix(axes), link.child_anchor)
        frames = [self.plant.AddFrame(FixedOffsetFrame(f"{side} of {link.body}", body.body_frame(), pose))
                  for side, body, pose in (("parent", parent, outer), ("child", self.bodies[link.body], inner))]
        name = f"joint of {link.body}"
        match link.type:
            case "spherical":
                joint: Any = BallRpyJoint(name, *frames)
            case "revolute":
                stiffness, rest, damping = open_tree.sprung(scene, link)
                joint = RevoluteJoint(name, *frames, axis=link.parts[0].axis, damping=damping)
                made = self.plant.AddJoint(joint)
                if stiffness:
                    self.plant.AddForceElement(RevoluteSpring(made, rest, stiffness))
                return made
            case "universal":
                joint = UniversalJoint(name, *frames)
            case "planar":
                joint = PlanarJoint(name, *frames)
            case "prismatic":
                joint = PrismaticJoint(name, *frames, axis=link.parts[0].axis)
            case _:
                joint = WeldJoint(name, *frames, RigidTransform())
        return self.plant.AddJoint(joint)

    def start(self, scene: Scene, context: object) -> None:
        """Set the scene's initial state in a context."""
        from pydrake.math import RigidTransform, RotationMatrix
        from pydrake.multibody.math import SpatialVelocity

        for k in self.floating:
            pose = RigidTransform(RotationMatrix(scene.R0[k]), scene.x0[k])
            self.plant.SetFreeBodyPose(context, self.bodies[k], pose)
            self.plant.SetFreeBodySpatialVelocity(context, self.bodies[k],
                                                  SpatialVelocity(scene.R0[k] @ scene.w0[k], scene.v0[k]))
        for link, joint in self.joints:
            q, v = tree.initial_coordinates(scene, link)
            match link.type:
                case "spherical":
                    joint.set_angles(context, np.zeros(3))
                    joint.set_angular_velocity(context, self.axes[link.body].T @ v)
                case "revolute":
                    joint.set_angle(context, q[0]), joint.set_angular_rate(context, v[0])
                case "prismatic":
                    joint.set_translation(context, q[0]), joint.set_translation_rate(context, v[0])
                case "universal":
                    joint.set_angles(context, q), joint.set_angular_rates(context, v)
                case "planar":
                    joint.set_pose(context, q[:2], q[2])
                    joint.set_translational_velocity(context, v[:2]), joint.set_angular_velocity(context, v[2])

    def set_state(self, q: np.ndarray, v: np.ndarray) -> None:
        """Set joint positions and velocities in the evaluation context."""
        self.plant.SetPositions(self.bench, q)
        self.plant.SetVelocities(self.bench, v)

    def accelerations(self, q: np.ndarray, v: np.ndarray) -> np.ndarray:
        """Joint accelerations."""
        self.set_state(q, v)
        return np.array(self.plant.EvalTimeDerivatives(self.bench).get_generalized_velocity().CopyToVector())

    def body_state(self, index: int) -> open_tree.BodyState:
        """Motion of a body in the state set last."""
        body = self.bodies[index]
        pose = self.plant.EvalBodyPoseInWorld(self.bench, body)
        twist = self.plant.EvalBodySpatialVelocityInWorld(self.bench, body)
        rate = self.plant.EvalBodySpatialAccelerationInWorld(self.bench, body)
        return (pose.translation(), pose.rotation().matrix(), twist.translational(), twist.rotational(),
                rate.translational(), rate.rotational())


def _inertia(body: Any) -> Any:
    from pydrake.multibody.tree import RotationalInertia, SpatialInertia

    J = body.inertia
    central = RotationalInertia(J[0, 0], J[1, 1], J[2, 2], J[0, 1], J[0, 2], J[1, 2])
    return SpatialInertia.MakeFromCentralInertia(body.mass, np.zeros(3), central)


_AXES: dict[str, dict[int, np.ndarray]] = {}
"""Of scenes by their hash, because studies run the same scene many times."""


def _axes(scene: Scene) -> dict[int, np.ndarray]:
    """(3, 3) axes of roll, pitch and yaw of every ball in its body's axes, whose pitch keeps away from a right angle.

    A coarse run decides, whose pitch is about the axis with the smallest initial angular velocity.
    """
    from scipy.spatial.transform import Rotation

    if scene.hash not in _AXES:
        balls = [link for link in tree.links(scene) if link.type == "spherical"]
        axes = {link.body: np.roll(np.eye(3), 1 - int(np.argmin(np.abs(tree.initial_coordinates(scene, link)[1]))), 1)
                for link in balls}
        scouted = scene.replace(samples=SCOUTED)
        with contextlib.suppress(EngineError):  # at a right angle: the first choice stays
            R = _controlled(scouted, RunSpec("runge_kutta3", rtol=SCOUT, monitor=False), Model(scouted, axes)).states.R
            for link in balls:
                turned = open_tree.relative(R, link)
                clear = open_tree.clearances(Rotation.from_matrix(turned[0].T @ turned))
                yaw, pitch, roll = ("XYZ".index(axis) for axis in max(clear, key=clear.__getitem__))
                axes[link.body] = np.eye(3)[:, [roll, pitch, yaw]]
                axes[link.body][:, 2] *= np.linalg.det(axes[link.body])
        _AXES[scene.hash] = axes
    return _AXES[scene.hash]


def _simulator(scene: Scene, spec: RunSpec, model: Model) -> Any:
    from pydrake.systems.analysis import ResetIntegratorFromFlags, Simulator

    simulator = Simulator(model.plant)
    model.start(scene, simulator.get_mutable_context())
    ResetIntegratorFromFlags(simulator, spec.method, LONGEST)
    return simulator


def _stepped(scene: Scene, spec: RunSpec, model: Model) -> RawRun:
    plant, (_, h) = model.plant, stepping.fixed_step(scene, spec)
    simulator = _simulator(scene, spec, model)
    integrator, context = simulator.get_mutable_integrator(), simulator.get_context()
    integrator.set_maximum_step_size(h)
    if spec.method == "runge_kutta2":
        integrator.set_fixed_step_mode(True)
    simulator.Initialize()
    done = 0

    def advance(count: int, stride: int) -> tuple[np.ndarray, np.ndarray]:
        nonlocal done
        q, v = (np.empty((count // stride, size)) for size in (plant.num_positions(), plant.num_velocities()))
        for row in range(count // stride):
            done += stride
            _advance(simulator, spec.method, done * h)
            q[row], v[row] = plant.GetPositions(context), plant.GetVelocities(context)
        return q, v

    start = np.array(plant.GetPositions(context)), np.array(plant.GetVelocities(context))
    return stepping.march(scene, spec, start, advance, open_tree.converter(scene, model.set_state, model.body_state),
                          open_tree.rows(model.accelerations))


def _controlled(scene: Scene, spec: RunSpec, model: Model) -> RawRun:
    """With error control; a step ends at every output time."""
    from crosscheck.scene.monitor import Monitor

    simulator = _simulator(scene, spec, model)
    integrator, context, plant = simulator.get_mutable_integrator(), simulator.get_context(), model.plant
    integrator.set_target_accuracy(1e-9 if spec.rtol is None else spec.rtol)
    simulator.Initialize()
    passed: list[Moment] = []

    def look(now: Any) -> None:
        passed.append((now.get_time(), np.array(plant.GetPositions(now)), np.array(plant.GetVelocities(now))))

    look(context)
    samples, wall = [passed[0]], 0.0
    if spec.monitor:
        simulator.set_monitor(look)
    for t in scene.t[1:]:
        began = time.perf_counter()
        _advance(simulator, spec.method, t)
        wall += time.perf_counter() - began
        look(context)
        samples.append(passed[-1])
    convert = open_tree.converter(scene, model.set_state, model.body_state)

    def states_of(moments: list[Moment]) -> States:
        t, q, v = (np.array(column) for column in zip(*moments, strict=True))
        stepping.check_finite(spec.method, t, q, v)
        return convert(t, q, v, v)  # the last argument only asks for accelerations, which Drake computes

    states = dataclasses.replace(states_of(samples), t=scene.t)
    monitor = Monitor(scene) if spec.monitor else None
    if monitor is not None:
        stepping.watch(monitor, states_of(passed))
    return RawRun(states, wall, integrator.get_num_steps_taken(), None,
                  maxima=None if monitor is None else monitor.maxima())


def _advance(simulator: Any, method: str, t: float) -> None:
    try:
        simulator.AdvanceTo(t)
    except RuntimeError as error:
        at = simulator.get_context().get_time()
        raise EngineError(f"Drake {method} stopped at t = {at:.6g} s: {str(error).splitlines()[0]}") from error
