"""MuJoCo: joint coordinates, stepping in its C loop.

Source: Todorov, Erez & Tassa, IROS 2012, doi:10.1109/IROS.2012.6386109.
"""

from __future__ import annotations

import contextlib
import importlib.metadata
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

from crosscheck.engines import stepping, tree
from crosscheck.engines.base import RawRun, RunSpec
from crosscheck.errors import EngineError
from crosscheck.scene import GROUND, Scene
from crosscheck.states import States

INTEGRATORS = {
    "Euler": "mjINT_EULER",
    "implicit": "mjINT_IMPLICIT",
    "implicitfast": "mjINT_IMPLICITFAST",
    "RK4": "mjINT_RK4",
    "discrete": "mjINT_DISCRETE",
}
JOINTS = {"spherical": "mjJNT_BALL", "revolute": "mjJNT_HINGE", "prismatic": "mjJNT_SLIDE"}
LAYOUT_INERTIA = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))


class MuJoCo:
    """Adapter of MuJoCo, form `tree`: a ball, hinge or slide per joint and nothing the scene does not have."""

    name = "mujoco"
    methods = tuple(INTEGRATORS)
    forms = ("tree",)
    options = frozenset({"form"})
    adaptive_methods: tuple[str, ...] = ()

    def version(self) -> str:
        """Version of MuJoCo as installed."""
        return importlib.metadata.version("mujoco")

    def documented_order(self, scene: Scene, spec: RunSpec) -> int:
        """Order 1 for the semi-implicit Euler family, 4 for RK4."""
        return 4 if spec.method == "RK4" else 1

    def held_levels(self, scene: Scene, spec: RunSpec) -> frozenset[str]:
        """All three: joint coordinates cannot leave a joint."""
        return tree.LEVELS

    def unsupported(self, scene: Scene, spec: RunSpec) -> str | None:
        """Why MuJoCo cannot run this, or None."""
        if spec.form not in (None, *self.forms):
            return f"form {spec.form} is not built into this adapter; it has {', '.join(self.forms)}"
        return tree.obstacle(scene, (*JOINTS, "fixed"))

    def run(self, scene: Scene, spec: RunSpec) -> RawRun:
        """Integrate; raises `EngineError` when MuJoCo warns or the state stops being finite."""
        import mujoco

        links = tree.links(scene)
        model = build(scene, spec.method, stepping.fixed_step(scene, spec)[1])
        data = mujoco.MjData(model)
        slots = _slots(model, links)
        set_initial_state(scene, links, slots, data)
        accelerate = _accelerations(model)

        def convert(t: np.ndarray, q: np.ndarray, v: np.ndarray, a: np.ndarray | None) -> States:
            motions = [tree.motion(link, q[:, at_q], v[:, at_v], None if a is None else a[:, at_v])
                       for link, (at_q, at_v) in zip(links, slots, strict=True)]
            return tree.forward(links, motions, t, a is not None)

        with _listening() as warnings:
            advance = _advance(model, data, warnings)
            raw = stepping.march(scene, spec, (data.qpos.copy(), data.qvel.copy()), advance, convert, accelerate)
        raw.form = "tree"
        return raw


def build(scene: Scene, method: str, step: float) -> Any:
    """The compiled `mujoco.MjModel` of an open tree: body frames at the centres of mass, joints at the anchors."""
    import mujoco

    spec = mujoco.MjSpec()
    spec.compiler.inertiafromgeom = mujoco.mjtInertiaFromGeom.mjINERTIAFROMGEOM_FALSE
    spec.option.timestep = step
    spec.option.gravity = scene.gravity
    spec.option.integrator = getattr(mujoco.mjtIntegrator, INTEGRATORS[method])
    flags = mujoco.mjtDisableBit
    spec.option.disableflags = flags.mjDSBL_CONTACT | flags.mjDSBL_AUTORESET
    bodies = {GROUND: spec.worldbody}
    for link in tree.links(scene):
        body = bodies[link.parent].add_body(name=str(link.body), quat=link.zero if link.type != "spherical" else None)
        zero = np.eye(3) if link.type == "spherical" else tree.rotation_from_quaternion(link.zero)
        body.pos = link.parent_anchor - zero @ link.child_anchor
        body.mass = scene.masses[link.body]
        body.fullinertia = [scene.inertias[link.body][entry] for entry in LAYOUT_INERTIA]
        body.ipos, body.explicitinertial = np.zeros(3), True
        if link.dofs:
            joint = body.add_joint(name=str(link.body), type=getattr(mujoco.mjtJoint, JOINTS[link.type]))
            joint.pos = link.child_anchor
            if link.type != "spherical":
                joint.axis = link.axis
        bodies[link.body] = body
    return spec.compile()


def _slots(model: Any, links: tuple[tree.Link, ...]) -> list[tuple[slice, slice]]:
    """Where each link's coordinates sit in qpos and qvel: MuJoCo orders bodies depth first, whatever the scene does."""
    slots = []
    for link in links:
        if not link.dofs:
            slots.append((slice(0, 0), slice(0, 0)))
            continue
        joint = model.joint(str(link.body))
        q, v = joint.qposadr[0], joint.dofadr[0]
        slots.append((slice(q, q + link.dofs + (link.type == "spherical")), slice(v, v + link.dofs)))
    return slots


def set_initial_state(scene: Scene, links: tuple[tree.Link, ...], slots: list[tuple[slice, slice]], data: Any) -> None:
    """Write the scene's initial state into `data`."""
    for link, (at_q, at_v) in zip(links, slots, strict=True):
        data.qpos[at_q], data.qvel[at_v] = tree.initial_coordinates(scene, link)


@contextlib.contextmanager
def _listening() -> Iterator[list[str]]:
    """MuJoCo's warnings in a list; by itself it appends them to MUJOCO_LOG.TXT in the working folder."""
    import mujoco

    warnings: list[str] = []
    before = mujoco.get_mju_user_warning()
    mujoco.set_mju_user_warning(warnings.append)
    try:
        yield warnings
    finally:
        mujoco.set_mju_user_warning(before)


def _accelerations(model: Any) -> Callable[[np.ndarray, np.ndarray], np.ndarray]:
    """(q, v) -> qacc, row by row. After a step qacc belongs to the start of that step: hence a fresh evaluation."""
    import mujoco

    bench = mujoco.MjData(model)  # a second one, so that the run does not notice
    forward, at_q, at_v, found = mujoco.mj_forward, bench.qpos, bench.qvel, bench.qacc

    def accelerate(q: np.ndarray, v: np.ndarray) -> np.ndarray:
        a = np.empty_like(v)
        for row in range(len(v)):
            at_q[:], at_v[:] = q[row], v[row]
            forward(model, bench)
            a[row] = found
        return a

    return accelerate


def _advance(model: Any, data: Any, warnings: list[str]) -> stepping.Advance:
    import mujoco
    import mujoco.rollout

    kind = mujoco.mjtState.mjSTATE_FULLPHYSICS
    size = mujoco.mj_stateSize(model, kind)

    def advance(steps: int, stride: int) -> tuple[np.ndarray, np.ndarray]:
        if stride == 1:
            state = np.empty(size)
            mujoco.mj_getState(model, data, state, kind)
            history = mujoco.rollout.rollout(model, data, state[None], nstep=steps)[0][0]
            q, v = history[:, 1:1 + model.nq], history[:, 1 + model.nq:1 + model.nq + model.nv]
        else:
            q, v = np.empty((steps // stride, model.nq)), np.empty((steps // stride, model.nv))
            for sample in range(len(q)):
                mujoco.mj_step(model, data, nstep=stride)
                q[sample], v[sample] = data.qpos, data.qvel
        if warnings:  # without autoreset the diverged state would come back as if nothing had happened
            raise EngineError(f"MuJoCo warned: {warnings[0].strip()} Try a smaller step.")
        return q, v

    return advance
