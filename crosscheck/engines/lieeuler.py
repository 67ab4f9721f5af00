"""Adapter of the in-house integrators; to crosscheck just another engine."""

from __future__ import annotations

import dataclasses

import numpy as np

import lieeuler
from crosscheck.engines.base import RawRun, RunSpec
from crosscheck.scene import Scene
from crosscheck.states import States

JOINTS = ("spherical",)


def build_problem(scene: Scene) -> lieeuler.Problem:
    """The scene as a `lieeuler.Problem`; joints in file order, so that rows of lam are those of the scene."""
    bodies = tuple(lieeuler.Body(body.mass, body.inertia) for body in scene.bodies)
    joints = tuple(lieeuler.spherical_joint(joint.parent, joint.child, joint.parent_anchor, joint.child_anchor)
                   for joint in scene.joints)
    return lieeuler.Problem(bodies, joints, scene.gravity, scene.x0, scene.R0, scene.v0, scene.w0)


class LieEuler:
    """The Lie group Euler methods of `lieeuler.METHODS`, in maximal coordinates with multipliers."""

    name = "lieeuler"
    methods = tuple(lieeuler.METHODS)
    forms = ("maximal",)
    adaptive_methods: tuple[str, ...] = ()
    options = frozenset({"coordinate_map", "alpha", "beta"})

    def version(self) -> str:
        """Version of the installed package."""
        from importlib.metadata import version

        return version("lieeuler-crosscheck")

    def documented_order(self, scene: Scene, spec: RunSpec) -> int | None:
        """Order of the method's record."""
        return lieeuler.METHODS[spec.method].order

    def held_levels(self, scene: Scene, spec: RunSpec) -> frozenset[str]:
        """Levels of the method's record."""
        return frozenset(lieeuler.METHODS[spec.method].held)

    def unsupported(self, scene: Scene, spec: RunSpec) -> str | None:
        """Joints other than spherical ones, springs and loads are not built yet; all methods take a fixed step."""
        for joint in scene.joints:
            if joint.type not in JOINTS:
                return f"lieeuler has no {joint.type} joint yet (joint {joint.name!r})"
        if scene.forces:
            return f"lieeuler has no {scene.forces[0].type} yet"
        if spec.form not in (None, *self.forms):
            return f"lieeuler works in maximal coordinates, form={spec.form!r} does not exist"
        if spec.rtol is not None:
            return f"{spec.method} takes a fixed step, not rtol"
        return None

    def run(self, scene: Scene, spec: RunSpec) -> RawRun:
        """Integrate with a fixed step (s); maxima over every step come from the kernel.

        Raises
        ------
        lieeuler.IntegrationError
            The run ended early.
        """
        assert spec.step is not None  # every method here takes a fixed step: `crosscheck.run` has seen to it
        solution = lieeuler.integrate(
            build_problem(scene), spec.method, spec.step, scene.t, coordinate_map=spec.coordinate_map or "exp",
            alpha=spec.alpha, beta=spec.beta, monitor=spec.monitor)
        fields = [field.name for field in dataclasses.fields(States)]
        stats = solution.stats
        counters = {name: getattr(stats, name) for name in ("newton_iterations", "factorizations", "most_iterations")}
        maxima = {key: value for key, value in stats.maxima.items() if key != "kinetic"}
        return RawRun(
            states=States(**{field: np.asarray(getattr(solution, field)) for field in fields}),
            wall_time=stats.wall_time, steps=stats.steps, step=stats.step, status=solution.status.value,
            stats=counters, maxima=maxima or None, form="maximal")
