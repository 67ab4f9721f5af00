"""Adapter of the in-house integrators; to crosscheck just another engine."""

from __future__ import annotations

import dataclasses

import numpy as np

import lieeuler
from crosscheck.adapters.base import RawRun, RunSpec
from crosscheck.scene.model import GROUND, Force, Joint, Scene
from crosscheck.scene.states import States


def build_problem(scene: Scene) -> lieeuler.Problem:
    """The scene as a `lieeuler.Problem`; joints in file order, so that rows of lam are those of the scene."""
    bodies = tuple(lieeuler.Body(body.mass, body.inertia) for body in scene.bodies)
    joints = tuple(_joint(scene, joint) for joint in scene.joints)
    forces = tuple(_force(scene, force) for force in scene.forces)
    return lieeuler.Problem(bodies, joints, scene.gravity, scene.x0, scene.R0, scene.v0, scene.w0, forces)


def _joint(scene: Scene, joint: Joint) -> lieeuler.Joint:
    ends = joint.parent, joint.child, joint.parent_anchor, joint.child_anchor
    axes = joint.parent_axis, joint.child_axis
    match joint.type:
        case "spherical":
            return lieeuler.spherical_joint(*ends)
        case "distance":
            return lieeuler.distance_joint(*ends, joint.length)
        case "point_on_line":
            return lieeuler.point_on_line_joint(*ends, joint.parent_axis)
        case "point_on_plane":
            return lieeuler.point_on_plane_joint(*ends, joint.parent_axis)
        case "universal":
            return lieeuler.universal_joint(*ends, *axes)
        case "revolute":
            return lieeuler.revolute_joint(*ends, *axes)
        case "cylindrical":
            return lieeuler.cylindrical_joint(*ends, *axes)
        case "planar":
            return lieeuler.planar_joint(*ends, *axes)
    parent_attitude = np.eye(3) if joint.parent == GROUND else scene.R0[joint.parent]
    relative = scene.R0[joint.child].T @ parent_attitude
    if joint.type == "prismatic":
        return lieeuler.prismatic_joint(*ends, *axes, relative)
    return lieeuler.fixed_joint(*ends, relative)


def _force(scene: Scene, force: Force) -> lieeuler.forces.Force:
    p = force.parameters
    if force.type == "linear_spring":
        return lieeuler.LinearSpring(force.parent, force.child, p["parent_point"], p["child_point"], p["stiffness"],
                                     p["free_length"], p["damping"])
    if force.type == "torsional_spring":
        joint = next(joint for joint in scene.joints if joint.name == force.joint)
        return lieeuler.TorsionalSpring(joint.parent, joint.child, joint.parent_axis, joint.child_axis, p["stiffness"],
                                        p["rest_angle"], p["damping"])
    if force.type == "constant_force":
        return lieeuler.ConstantLoad(force.child, force=p["force"], point=p["child_point"], frame=p["frame"])
    return lieeuler.ConstantLoad(force.child, torque=p["torque"], frame=p["frame"])


class LieEuler:
    """The methods of `lieeuler.METHODS`, in maximal coordinates with multipliers."""

    name = "lieeuler"
    methods = tuple(lieeuler.METHODS)
    forms = ("maximal",)
    adaptive_methods = tuple(name for name, method in lieeuler.METHODS.items() if "rtol" in method.controls)
    fixed_step_methods = tuple(name for name, method in lieeuler.METHODS.items() if "step" in method.controls)
    options = frozenset({"form", "coordinate_map", "spin_free", "alpha", "beta"})

    def version(self) -> str:
        """Version of the installed package."""
        from importlib.metadata import version

        return version("lieeuler-crosscheck")

    def documented_order(self, scene: Scene, spec: RunSpec) -> int | None:
        """Order of the method's record; None for a run whose steps follow rtol."""
        return None if spec.step is None else lieeuler.METHODS[spec.method].order

    def held_levels(self, scene: Scene, spec: RunSpec) -> frozenset[str]:
        """Levels of the method's record."""
        return frozenset(lieeuler.METHODS[spec.method].held)

    def unsupported(self, scene: Scene, spec: RunSpec) -> str | None:
        """All joints and forces are modelled, redundant constraints included."""
        if spec.form not in (None, *self.forms):
            return f"lieeuler works in maximal coordinates, form={spec.form!r} does not exist"
        controls = lieeuler.METHODS[spec.method].controls
        if spec.rtol is not None and "rtol" not in controls:
            return f"{spec.method} takes a fixed step, not rtol"
        if spec.step is not None and "step" not in controls:
            return f"{spec.method} chooses its steps by rtol, it takes no step"
        return None

    def run(self, scene: Scene, spec: RunSpec) -> RawRun:
        """Integrate with a fixed step (s) or a relative tolerance; maxima over every step come from the kernel.

        Raises
        ------
        lieeuler.IntegrationError
            The run ended early.
        """
        solution = lieeuler.integrate(
            build_problem(scene), spec.method, spec.step, scene.t, rtol=spec.rtol,
            coordinate_map=spec.coordinate_map or "exp", alpha=spec.alpha, beta=spec.beta, spin_free=spec.spin_free,
            monitor=spec.monitor)
        fields = [field.name for field in dataclasses.fields(States)]
        stats = solution.stats
        counters = {name: getattr(stats, name) for name in ("rejected_steps", "force_evaluations", "newton_iterations",
                                                           "factorizations", "most_iterations", "redundant_rows")}
        counters["spin_free"] = tuple(scene.bodies[body].name for body in stats.spin_free)
        maxima = {key: value for key, value in stats.maxima.items() if key != "kinetic"}
        return RawRun(
            states=States(**{field: np.asarray(getattr(solution, field)) for field in fields}),
            wall_time=stats.wall_time, steps=stats.steps, step=stats.step, status=solution.status.value,
            stats=counters, maxima=maxima or None, form="maximal")
