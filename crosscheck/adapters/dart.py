"""DART: joint coordinates of a Skeleton, balls as rotations, stepped by its semi-implicit Euler method.

Source: Lee et al. 2018, doi:10.21105/joss.00500.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from crosscheck.adapters.base import RawRun, RunSpec
from crosscheck.adapters.common import open_tree, stepping, tree
from crosscheck.scene.model import GROUND, Scene

INSTANT = 1e-9
"""Time step (s) of accelerations: forward dynamics of DART take springs and dampers at the end of a step."""


class Dart(open_tree.OpenTree):
    """Adapter of DART, form `tree`."""

    name = "dart"
    methods = ("SemiImplicitEuler",)
    package = "dartpy"
    laws = ("dry_friction", "limits", "servo")
    joints = (*open_tree.JOINTS, "universal", "planar")
    forces = ("torsional_spring",)
    floating = True

    def unsupported(self, scene: Scene, spec: RunSpec) -> str | None:
        """Why DART cannot run this here, or None."""
        return open_tree.bouncing(scene) or open_tree.springless(scene) or super().unsupported(scene, spec)

    def run(self, scene: Scene, spec: RunSpec) -> RawRun:
        """Integrate; raises `EngineError` if the state becomes infinite or NaN."""
        import dartpy

        model, bench = Model(scene), Model(scene)
        world = dartpy.simulation.World()
        world.setGravity(scene.gravity)
        world.setTimeStep(stepping.fixed_step(scene, spec)[1])
        world.addSkeleton(model.skeleton)

        def state() -> tuple[np.ndarray, np.ndarray]:
            return np.array(model.skeleton.getPositions()), np.array(model.skeleton.getVelocities())

        bench.skeleton.setTimeStep(INSTANT)
        whole = open_tree.converter(scene, bench.set_state, bench.body_state)
        convert = open_tree.without_accelerations(whole) if open_tree.rowed(scene) else whole
        raw = stepping.march(scene, spec, state(), stepping.one_by_one(world.step, state), convert,
                             open_tree.rows(bench.accelerations))
        raw.form = "tree"
        return raw


class Model:
    """The scene's skeleton in its initial state."""

    def __init__(self, scene: Scene) -> None:
        import dartpy

        self.skeleton = dartpy.dynamics.Skeleton()
        self.skeleton.setGravity(scene.gravity)
        self.bodies: dict[int, Any] = {}
        for link in tree.links(scene):
            joint, body = self._pair(link)
            spec = scene.bodies[link.body]
            body.setInertia(dartpy.dynamics.Inertia(spec.mass, np.zeros(3), spec.inertia))
            joint.setTransformFromParentBodyNode(_pose(open_tree.zero_attitude(scene, link), link.parent_anchor))
            joint.setTransformFromChildBodyNode(_pose(np.eye(3), link.child_anchor))
            q, v = tree.initial_coordinates(scene, link)
            if link.type in ("revolute", "prismatic"):
                joint.setAxis(link.parts[0].axis)
            elif link.type == "universal":
                joint.setAxis1(link.parts[0].axis), joint.setAxis2(link.parts[1].axis)
            elif link.type == "planar":
                joint.setArbitraryPlane(link.parts[0].axis, link.parts[1].axis)
            if link.type in ("revolute", "prismatic", "universal", "planar"):
                joint.setPositions(q)
            if link.type == "free":  # its coordinates are zero at the start, its velocities in the axes of the body
                joint.setTransformFromParentBodyNode(_pose(scene.R0[link.body], scene.x0[link.body]))
                v = np.concatenate([scene.w0[link.body], scene.R0[link.body].T @ scene.v0[link.body]])
            if link.dofs:
                joint.setVelocities(v)  # those of a ball in the outer body's axes; its rotation starts at zero
            self.bodies[link.body] = body
            if link.type in ("revolute", "prismatic"):
                _give_laws(scene, link, joint)

    def _pair(self, link: tree.Link) -> tuple[Any, Any]:
        create = {"spherical": self.skeleton.createBallJointAndBodyNodePair,
                  "revolute": self.skeleton.createRevoluteJointAndBodyNodePair,
                  "prismatic": self.skeleton.createPrismaticJointAndBodyNodePair,
                  "universal": self.skeleton.createUniversalJointAndBodyNodePair,
                  "planar": self.skeleton.createPlanarJointAndBodyNodePair,
                  "free": self.skeleton.createFreeJointAndBodyNodePair,
                  "fixed": self.skeleton.createWeldJointAndBodyNodePair}[link.type]
        joint, body = create() if link.parent == GROUND else create(self.bodies[link.parent])
        return joint, body

    def set_state(self, q: np.ndarray, v: np.ndarray) -> None:
        """Set joint positions and velocities and compute the accelerations."""
        self.skeleton.setPositions(q)
        self.skeleton.setVelocities(v)
        self.skeleton.computeForwardDynamics()

    def accelerations(self, q: np.ndarray, v: np.ndarray) -> np.ndarray:
        """Joint accelerations."""
        self.set_state(q, v)
        return np.array(self.skeleton.getAccelerations())

    def body_state(self, index: int) -> open_tree.BodyState:
        """Motion of a body in the state set last."""
        body = self.bodies[index]
        pose = body.getWorldTransform()
        return (pose.translation(), pose.rotation(), body.getCOMLinearVelocity(), body.getAngularVelocity(),
                body.getCOMLinearAcceleration(), body.getAngularAcceleration())


def _give_laws(scene: Scene, link: tree.Link, joint: Any) -> None:
    """Dry friction and limits, which are rows of DART's steps, and springs and servos as springs in joints."""
    if link.type == "revolute":
        stiffness, rest, damping = open_tree.sprung(scene, link)
        joint.setSpringStiffness(0, stiffness), joint.setRestPosition(0, rest), joint.setDampingCoefficient(0, damping)
    _, sign, zero = tree.coordinate(scene, link)
    law = scene.joint(link.joint)
    for friction in filter(None, law.dry_friction):
        joint.setCoulombFriction(0, friction.sliding)
    for limits in filter(None, law.limits):
        ends = tree.ends(limits, sign, zero)
        joint.setPositionLowerLimit(0, ends[0]), joint.setPositionUpperLimit(0, ends[1])
        joint.setLimitEnforcement(True)
    for servo in (servo for name, servo in scene.servos.values() if name == link.joint):
        joint.setSpringStiffness(0, servo.proportional), joint.setDampingCoefficient(0, servo.derivative)
        joint.setRestPosition(0, open_tree.rest(servo, sign, zero))


def _pose(attitude: np.ndarray, point: np.ndarray) -> Any:
    import dartpy

    pose = dartpy.math.Isometry3()
    pose.set_rotation(attitude)
    pose.set_translation(point)
    return pose
