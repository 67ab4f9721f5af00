"""MuJoCo: joint coordinates or free bodies under soft constraints, stepping in its C loop.

Source: Todorov, Erez & Tassa, IROS 2012, doi:10.1109/IROS.2012.6386109. The integrator `discrete` is a semi-implicit
Euler step in the metric M + h D + h^2 K, D damping and K stiffness of joints and tendons, with the constraint solve in
that metric and the springs of constraints taken at the end of the step; without all of these it is `Euler`.
"""

from __future__ import annotations

import contextlib
import copy
import importlib.metadata
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

from crosscheck.adapters.base import RawRun, RunSpec
from crosscheck.adapters.common import stepping, tree
from crosscheck.adapters.common.native import JointStates, Native
from crosscheck.adapters.mujoco import models
from crosscheck.adapters.mujoco.models import INTEGRATORS, build, set_initial_state
from crosscheck.errors import EngineError
from crosscheck.scene.joints import JOINT_TYPES
from crosscheck.scene.model import Scene
from crosscheck.scene.models.compiling import listening
from crosscheck.scene.states import States

__all__ = ["INTEGRATORS", "MuJoCo", "build", "set_initial_state"]


class MuJoCo:
    """Adapter of MuJoCo, forms `tree` and `maximal`."""

    name = "mujoco"
    methods = tuple(INTEGRATORS)
    forms = ("tree", "maximal")
    options = frozenset({"form", "softness"})
    dash, marker = "--", "s"
    adaptive_methods: tuple[str, ...] = ()

    def version(self) -> str:
        """Version of MuJoCo as installed."""
        return importlib.metadata.version("mujoco")

    def form(self, scene: Scene, spec: RunSpec) -> str:
        """The form that runs: the one asked for, else tree, or maximal where only that can model the scene."""
        if spec.form is not None:
            return spec.form
        only_maximal = models.obstacle(scene, "tree") and not models.obstacle(scene, "maximal")
        return "maximal" if only_maximal else "tree"

    def documented_order(self, scene: Scene, spec: RunSpec) -> int:
        """Order 1 for the semi-implicit Euler family, 4 for RK4.

        RK4 falls to 1 under tight equality constraints, whose time constant of two steps its stages do not resolve:
        velocities are of order 1, positions of order 2. With the default softness the order is that towards the motion
        of the softened system.
        """
        if spec.method != "RK4":
            return 1
        _, closing = models.closures(scene, self.form(scene, spec))
        return 1 if closing and spec.softness != "default" else 4

    def held_levels(self, scene: Scene, spec: RunSpec) -> frozenset[str]:
        """All three where joint coordinates do it; equality constraints are soft and hold none."""
        _, closing = models.closures(scene, self.form(scene, spec))
        return frozenset() if closing else tree.LEVELS

    def unsupported(self, scene: Scene, spec: RunSpec) -> str | None:
        """Why MuJoCo cannot run this, or None."""
        form = self.form(scene, spec)
        if form not in self.forms:
            return f"form {form} is not built into this adapter; it has {', '.join(self.forms)}"
        return models.obstacle(scene, form)

    def turning(self, scene: Scene, form: str | None) -> list[int]:
        """Bodies on a ball or free."""
        branches, _ = models.closures(scene, form or "tree")
        return [branch.body for branch in branches
                if branch.joint is None or "ball" in JOINT_TYPES[branch.joint.type].motion]

    def native(self, path: str, states: JointStates) -> Native:
        """What the engine makes of a model file by itself."""
        from crosscheck.adapters.mujoco.native import load

        return load(path, states)

    def run(self, scene: Scene, spec: RunSpec) -> RawRun:
        """Integrate; raises `EngineError` when MuJoCo warns or the state stops being finite."""
        import mujoco

        form, softness = self.form(scene, spec), spec.softness or "tight"
        model = build(scene, spec.method, stepping.fixed_step(scene, spec)[1], form, softness)
        data = mujoco.MjData(model)
        set_initial_state(scene, model, data)
        accelerate, convert = _evaluation(scene, model)
        with listening() as warnings, _controlled(models.controls(scene)):
            advance = _advance(model, data, warnings, scene.timed)
            raw = stepping.march(scene, spec, (data.qpos.copy(), data.qvel.copy()), advance, convert, accelerate)
        raw.form = form
        if model.neq:
            raw.stats["softness"] = softness
        return raw


def _evaluation(scene: Scene, model: Any) -> tuple[Callable[..., np.ndarray], stepping.Convert]:
    """(t, q, v) -> qacc and (t, q, v, qacc) -> states, row by row, by MuJoCo's own dynamics and kinematics.

    After a step qacc belongs to the start of that step, hence a fresh evaluation; it is done as for Euler, because for
    discrete qacc is the change of the velocity over a step and no derivative.
    """
    import mujoco

    continuous = copy.copy(model)
    continuous.opt.integrator = mujoco.mjtIntegrator.mjINT_EULER
    bench = mujoco.MjData(continuous)  # a second one: the data of the run stay as they are
    bodies = np.array([model.body(str(k)).id for k in range(scene.n)])
    roots = model.body_rootid[bodies]

    def accelerate(t: np.ndarray, q: np.ndarray, v: np.ndarray) -> np.ndarray:
        a = np.empty_like(v)
        for row in range(len(v)):
            bench.time, bench.qpos[:], bench.qvel[:] = t[row], q[row], v[row]
            mujoco.mj_forward(continuous, bench)
            a[row] = bench.qacc
        return a

    def convert(t: np.ndarray, q: np.ndarray, v: np.ndarray, a: np.ndarray | None) -> States:
        x, R, centres = np.empty((len(t), scene.n, 3)), np.empty((len(t), scene.n, 9)), np.empty((len(t), scene.n, 3))
        twists, rates = np.empty((2, len(t), scene.n, 6))
        for row in range(len(t)):
            bench.qpos[:], bench.qvel[:] = q[row], v[row]
            mujoco.mj_kinematics(continuous, bench)
            mujoco.mj_comPos(continuous, bench)
            mujoco.mj_comVel(continuous, bench)
            if a is not None:
                bench.qacc[:] = a[row]
                mujoco.mj_rnePostConstraint(continuous, bench)
            x[row], R[row], centres[row] = bench.xpos[bodies], bench.xmat[bodies], bench.subtree_com[roots]
            twists[row], rates[row] = bench.cvel[bodies], bench.cacc[bodies]
        return _states(scene, t, x, R.reshape(*x.shape, 3), x - centres, twists, rates if a is not None else None)

    return accelerate, convert


def _states(scene: Scene, t: np.ndarray, x: np.ndarray, R: np.ndarray, arms: np.ndarray, twists: np.ndarray,
            rates: np.ndarray | None) -> States:
    """States from MuJoCo's spatial velocities and accelerations, (T, n, 6), rotation first, world axes.

    They belong to the body's point in the centre of mass of its tree, from which `arms` (T, n, 3) lead to its own; the
    accelerations carry minus the gravity.
    """
    spin, v = twists[..., :3], twists[..., 3:] + np.cross(twists[..., :3], arms)
    states = States(t, x, R, v, np.einsum("tnji,tnj->tni", R, spin))
    if rates is not None:
        turn, shift = rates[..., :3], rates[..., 3:]
        states.a = shift + np.cross(turn, arms) + np.cross(spin, v) + scene.gravity
        states.alpha = np.einsum("tnji,tnj->tni", R, turn)
    return states


@contextlib.contextmanager
def _controlled(control: Callable[[Any, Any], None] | None) -> Iterator[None]:
    """While this lasts, MuJoCo asks `control` for controls at every stage; it knows one for all models."""
    import mujoco

    if control is not None:
        mujoco.set_mjcb_control(control)
    try:
        yield
    finally:
        if control is not None:
            mujoco.set_mjcb_control(None)


def _advance(model: Any, data: Any, warnings: list[str], timed: bool) -> stepping.Advance:
    import mujoco
    import mujoco.rollout

    kind = mujoco.mjtState.mjSTATE_FULLPHYSICS
    size = mujoco.mj_stateSize(model, kind)

    def advance(steps: int, stride: int) -> tuple[np.ndarray, np.ndarray]:
        if stride == 1 and not timed:
            state = np.empty(size)
            mujoco.mj_getState(model, data, state, kind)
            history = mujoco.rollout.rollout(model, data, state[None], nstep=steps)[0][0]
            q, v = history[:, 1:1 + model.nq], history[:, 1 + model.nq:1 + model.nq + model.nv]
        else:
            q, v = np.empty((steps // stride, model.nq)), np.empty((steps // stride, model.nv))
            for sample in range(len(q)):
                mujoco.mj_step(model, data, nstep=stride)
                q[sample], v[sample] = data.qpos, data.qvel
        if warnings:  # autoreset is off: a diverged state would be returned like any other
            raise EngineError(f"MuJoCo warned: {warnings[0].strip()} Try a smaller step.")
        return q, v

    return advance
