"""Pinocchio: joint coordinates and the articulated-body algorithm; the integrators are ours, in Python.

Source: Carpentier et al., SII 2019, doi:10.1109/SII.2019.8700380. `wall_time` therefore includes the interpreter:
it says nothing about Pinocchio in C++.
"""

from __future__ import annotations

import importlib.metadata
from typing import Any

import numpy as np

from crosscheck.engines import lie_steppers, stepping, tree
from crosscheck.engines.base import RawRun, RunSpec
from crosscheck.scene import GROUND, Scene, rotation_from_quaternion
from crosscheck.states import States

ORDERS = {"SymplecticEuler": 1, "RK4naive": 4, "RKMK4": 4, "RKMK8": 8}


class Pinocchio:
    """Adapter of Pinocchio, form `tree`: aba (Convention.LOCAL) under integrators on the configuration space."""

    name = "pinocchio"
    methods = tuple(ORDERS)
    forms = ("tree",)
    options = frozenset({"form"})
    adaptive_methods: tuple[str, ...] = ()

    def version(self) -> str:
        """Version of the package `pin` as installed."""
        return importlib.metadata.version("pin")

    def documented_order(self, scene: Scene, spec: RunSpec) -> int:
        """The tableau's order; for RK4naive what its many authors claim, see `crosscheck.known` for what it has."""
        return ORDERS[spec.method]

    def held_levels(self, scene: Scene, spec: RunSpec) -> frozenset[str]:
        """All three: joint coordinates cannot leave a joint."""
        return tree.LEVELS

    def unsupported(self, scene: Scene, spec: RunSpec) -> str | None:
        """Why Pinocchio cannot run this, or None."""
        if spec.form not in (None, *self.forms):
            return f"form {spec.form} is not built into this adapter; it has {', '.join(self.forms)}"
        return tree.obstacle(scene, ("spherical", "revolute", "prismatic"))

    def run(self, scene: Scene, spec: RunSpec) -> RawRun:
        """Integrate; raises `EngineError` when the state stops being finite."""
        import pinocchio

        links = tree.links(scene)
        model = build(scene)
        data = model.createData()
        torque = np.zeros(model.nv)

        def dynamics(q: np.ndarray, v: np.ndarray) -> np.ndarray:
            return pinocchio.aba(model, data, q, v, torque).copy()  # a view of data.ddq, overwritten by the next call

        def integrate(q: np.ndarray, tangent: np.ndarray) -> np.ndarray:
            return pinocchio.integrate(model, q, tangent)

        slots = _slots(model, links)
        balls = [at_v for link, (_, at_v) in zip(links, slots, strict=True) if link.type == "spherical"]
        step = _stepper(spec.method, stepping.fixed_step(scene, spec)[1], integrate, dynamics, balls)
        start = initial_state(scene, links)
        state = [*start]

        def advance(steps: int, stride: int) -> tuple[np.ndarray, np.ndarray]:
            q, v = state
            positions, velocities = np.empty((steps // stride, model.nq)), np.empty((steps // stride, model.nv))
            for sample in range(len(positions)):
                for _ in range(stride):
                    q, v = step(q, v)
                positions[sample], velocities[sample] = q, v
            state[:] = q, v
            return positions, velocities

        def convert(t: np.ndarray, q: np.ndarray, v: np.ndarray, a: np.ndarray | None) -> States:
            motions = [tree.motion(link, _scalar_first(link, q[:, at_q]), v[:, at_v], None if a is None else a[:, at_v])
                       for link, (at_q, at_v) in zip(links, slots, strict=True)]
            return tree.forward(links, motions, t, a is not None)

        def accelerate(q: np.ndarray, v: np.ndarray) -> np.ndarray:
            a = np.empty_like(v)
            for row in range(len(v)):
                a[row] = pinocchio.aba(model, data, q[row], v[row], torque)
            return a

        raw = stepping.march(scene, spec, start, advance, convert, accelerate)
        raw.form = "tree"
        return raw


def build(scene: Scene) -> Any:
    """The `pinocchio.Model` of an open tree: joint frames at the child anchors, axes along the bodies'."""
    import pinocchio

    model = pinocchio.Model()
    model.gravity.linear = np.array(scene.gravity)
    joints, hooks = {GROUND: 0}, {GROUND: np.zeros(3)}  # hook: joint frame to centre of mass
    for link in tree.links(scene):
        zero = np.eye(3) if link.type == "spherical" else rotation_from_quaternion(link.zero)
        kind = {
            "spherical": lambda axis: pinocchio.JointModelSpherical(),
            "revolute": lambda axis: pinocchio.JointModelRevoluteUnaligned(axis),
            "prismatic": lambda axis: pinocchio.JointModelPrismaticUnaligned(axis),
        }[link.type](link.axis)
        placement = pinocchio.SE3(zero, hooks[link.parent] + link.parent_anchor)
        joint = model.addJoint(joints[link.parent], kind, placement, str(link.body))
        inertia = pinocchio.Inertia(scene.masses[link.body], -link.child_anchor, scene.inertias[link.body])
        model.appendBodyToJoint(joint, inertia, pinocchio.SE3.Identity())
        joints[link.body], hooks[link.body] = joint, -link.child_anchor
    return model


def initial_state(scene: Scene, links: tuple[tree.Link, ...]) -> tuple[np.ndarray, np.ndarray]:
    """(q, v) of the scene at t = 0; quaternions x, y, z, w."""
    q, v = zip(*(tree.initial_coordinates(scene, link) for link in links), strict=True)
    return np.concatenate([np.roll(part, -1) if len(part) == 4 else part for part in q]), np.concatenate(v)


def _scalar_first(link: tree.Link, q: np.ndarray) -> np.ndarray:
    return np.roll(q, 1, axis=1) if link.type == "spherical" else q


def _slots(model: Any, links: tuple[tree.Link, ...]) -> list[tuple[slice, slice]]:
    """Where each link's coordinates sit in q and v."""
    slots = []
    for link in links:
        joint = model.getJointId(str(link.body))
        q, v = model.idx_qs[joint], model.idx_vs[joint]
        slots.append((slice(q, q + model.nqs[joint]), slice(v, v + model.nvs[joint])))
    return slots


def _stepper(method: str, h: float, integrate: lie_steppers.Integrate, dynamics: lie_steppers.Dynamics,
             balls: list[slice]) -> lie_steppers.Step:
    if method == "SymplecticEuler":
        return lie_steppers.symplectic_euler(h, integrate, dynamics)
    if method == "RK4naive":
        return lie_steppers.naive_rk4(h, integrate, dynamics)
    tableau = lie_steppers.CLASSIC_4 if method == "RKMK4" else lie_steppers.dop853()
    return lie_steppers.munthe_kaas(h, integrate, dynamics, balls, tableau)
