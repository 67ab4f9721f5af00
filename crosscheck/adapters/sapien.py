"""SAPIEN: PhysX on the processor in single precision, as an articulation or as rigid bodies under D6 joints.

Source: https://sapien.ucsd.edu and NVIDIA's PhysX 5 SDK guide. Form `tree` is an articulation in joint coordinates by
Featherstone's algorithm, form `maximal` moves bodies whose ball joints an iterative solver holds; both are stepped by
semi-implicit Euler, with the temporal or the projected Gauss-Seidel solver. PhysX's dampings, sleeping and clamps of
velocities, which are on by default, are off here.
"""

from __future__ import annotations

import dataclasses
import warnings
from typing import Any

import numpy as np

from crosscheck.adapters.base import Engine, RawRun, RunSpec
from crosscheck.adapters.common import open_tree, stepping, tree
from crosscheck.files import aside
from crosscheck.scene.model import GROUND, Scene, quaternion_from_rotation
from crosscheck.scene.vectors import shortest_rotation

FASTEST = 1e9
"""Where velocities are clamped, SI; by default angular ones at 50 or 100 rad/s."""

JOINTS = {"tree": ("revolute", "prismatic", "fixed"), "maximal": ("spherical",)}
"""Joint types by form: SAPIEN's articulations have no ball, and its D6 joint leaves swings free that it is to lock."""

LAWS = "this adapter builds no force laws of joints in PhysX"

ITERATIONS = {"tree": (1, 1), "maximal": (8, 4)}
"""Iterations of a step for positions and velocities, by form. Joint coordinates leave nothing to iterate, but the
temporal solver moves them so many times a step, and loses what is below half a unit of the last place: with 8 a hinge
near 1.5 rad that turns at 1 mrad/s stands still at 0.25 ms. With SAPIEN's 10 and 1 the velocities of a chain of free
bodies show no order."""

class Sapien(Engine):
    """Adapter of SAPIEN, forms `tree` and `maximal`."""

    name = "sapien"
    methods = ("TGS", "PGS")
    forms = ("tree", "maximal")
    package = "sapien"
    eps = 2.0**-23

    def held_levels(self, scene: Scene, spec: RunSpec) -> frozenset[str]:
        """All three by joint coordinates, none by free bodies."""
        return tree.LEVELS if self._form(scene, spec) == "tree" else frozenset()

    def unsupported(self, scene: Scene, spec: RunSpec) -> str | None:
        """Why PhysX cannot run this here, or None."""
        form = self._form(scene, spec)
        if form not in self.forms:
            return f"form {form} is not built into this adapter; it has {', '.join(self.forms)}"
        reason = open_tree.unsupported(scene, dataclasses.replace(spec, form=None), LAWS)
        return reason or tree.obstacle(scene, JOINTS[form])

    def run(self, scene: Scene, spec: RunSpec) -> RawRun:
        """Integrate; raises `EngineError` if the state becomes infinite or NaN."""
        with aside(1, 2), warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of a machine without a graphics card
            import sapien
        physx, form = sapien.physx, self._form(scene, spec)
        physx.set_scene_config(gravity=scene.gravity, enable_tgs=spec.method == "TGS")
        position, velocity = ITERATIONS[form]
        physx.set_body_config(solver_position_iterations=position, solver_velocity_iterations=velocity,
                              sleep_threshold=0.0)
        world = sapien.Scene([physx.PhysxCpuSystem()])
        world.set_timestep(stepping.fixed_step(scene, spec)[1])
        bodies = (articulated if form == "tree" else jointed)(sapien, scene, world)

        def state() -> tuple[np.ndarray, np.ndarray]:
            poses = [body.entity_pose for body in bodies]
            return (np.array([(*pose.p, *pose.q[[1, 2, 3, 0]]) for pose in poses], dtype=float).ravel(),
                    np.array([(*body.linear_velocity, *body.angular_velocity) for body in bodies], dtype=float).ravel())

        raw = stepping.march(scene, spec, state(), stepping.one_by_one(world.step, state), open_tree.of_poses(scene),
                             lambda t, q, v: v)
        raw.form = form
        return raw

    def _form(self, scene: Scene, spec: RunSpec) -> str:
        """The requested form, else the first that has the joints of the scene."""
        return spec.form or ("maximal" if any(joint.type == "spherical" for joint in scene.joints) else "tree")


def articulated(sapien: Any, scene: Scene, world: Any) -> list[Any]:
    """The links of an articulation in its initial state, in the order of the scene's bodies."""
    component, tree_links = sapien.physx.PhysxArticulationLinkComponent, tree.links(scene)
    made, starts = {GROUND: component()}, {}
    entities = [_entity(sapien, made[GROUND])]
    for link in tree_links:
        part = made[link.body] = component(made[link.parent])
        entities.append(_heavy(sapien, scene, link.body, part))
        joint, joint.name = part.joint, str(link.body)
        joint.type = "revolute_unwrapped" if link.type == "revolute" else link.type
        # the axis of a joint is x of its frames
        turn = shortest_rotation(np.eye(3)[0], link.parts[0].axis) if link.dofs else np.eye(3)
        outer, own = quaternion_from_rotation(np.array([open_tree.zero_attitude(scene, link) @ turn, turn]))
        joint.pose_in_parent, joint.pose_in_child = (sapien.Pose(link.parent_anchor, outer),
                                                     sapien.Pose(link.child_anchor, own))
        if link.dofs:
            joint.limits = [[-np.inf, np.inf]]
            joint.friction, joint.max_velocity = 0.0, FASTEST
            starts[joint.name] = tree.initial_coordinates(scene, link)
    made[GROUND].joint.type = "fixed"
    for entity in entities:
        world.add_entity(entity)
    whole = made[GROUND].articulation
    whole.qpos, whole.qvel = (np.concatenate([starts[joint.name][k] for joint in whole.active_joints]) for k in (0, 1))
    return [made[body] for body in range(scene.n)]


def jointed(sapien: Any, scene: Scene, world: Any) -> list[Any]:
    """Rigid bodies in their initial state, under ball joints."""
    bodies = [sapien.physx.PhysxRigidDynamicComponent() for _ in range(scene.n)]
    for index, body in enumerate(bodies):
        entity = _heavy(sapien, scene, index, body)
        body.entity_pose = sapien.Pose(scene.x0[index], scene.bodies[index].attitude)
        body.linear_velocity, body.angular_velocity = scene.v0[index], scene.R0[index] @ scene.w0[index]
        world.add_entity(entity)
    for link in tree.links(scene):
        joint = sapien.physx.PhysxDriveComponent(bodies[link.body])
        joint.parent = None if link.parent == GROUND else bodies[link.parent]
        joint.pose_in_parent = sapien.Pose(link.parent_anchor)
        joint.pose_in_child = sapien.Pose(link.child_anchor)
        for hold in (joint.set_limit_x, joint.set_limit_y, joint.set_limit_z):
            hold(0.0, 0.0)
        bodies[link.body].entity.add_component(joint)
    return bodies


def _heavy(sapien: Any, scene: Scene, index: int, part: Any) -> Any:
    """The entity of a body's component, which gets its mass and no damping; its frame is that of the scene."""
    entity = _entity(sapien, part)
    moments, axes = np.linalg.eigh(scene.inertias[index])
    part.mass, part.inertia = scene.masses[index], moments
    part.cmass_local_pose = sapien.Pose(q=quaternion_from_rotation(axes * np.sign(np.linalg.det(axes))))
    part.linear_damping = part.angular_damping = 0.0
    part.max_linear_velocity = part.max_angular_velocity = FASTEST
    return entity


def _entity(sapien: Any, component: Any) -> Any:
    entity = sapien.Entity()
    entity.add_component(component)
    return entity
