"""MuJoCo Warp, MuJoCo's models in Warp kernels, on the processor in single precision.

Source: https://github.com/google-deepmind/mujoco_warp. It needs the MuJoCo of its own version, and is given an
environment of its own (`crosscheck.adapters.external.versions`). MuJoCo compiles the model there; steps, states and
accelerations are those of Warp.
"""

from __future__ import annotations

import functools

import numpy as np

from crosscheck.adapters.base import RawRun, RunSpec
from crosscheck.adapters.common import open_tree, stepping
from crosscheck.adapters.mujoco.adapter import Forms, sensed
from crosscheck.adapters.mujoco.models import build, set_initial_state
from crosscheck.adapters.newton import recorded, silent_warp
from crosscheck.errors import Unsupported
from crosscheck.scene.model import Scene
from crosscheck.scene.states import States

ROWS = 256
"""Worlds in which as many states are evaluated at once."""


class Warp(Forms):
    """Adapter of MuJoCo Warp, forms `tree` and `maximal`."""

    name = "warp"
    methods = ("Euler", "implicitfast", "RK4")
    package = "mujoco-warp"
    eps = 2.0**-23
    pace = 4

    def unsupported(self, scene: Scene, spec: RunSpec) -> str | None:
        """Why MuJoCo Warp cannot run this, or None."""
        if scene.timed:
            return "functions of time are not built into this adapter: a recorded step calls no function for controls"
        return open_tree.bouncing(scene) or super().unsupported(scene, spec)

    def run(self, scene: Scene, spec: RunSpec) -> RawRun:
        """Integrate; raises `Unsupported` with Warp's words if it lacks an element, and `EngineError` on divergence."""
        warp = silent_warp()
        form, softness = self.form(scene, spec), spec.softness or "tight"
        h = stepping.fixed_step(scene, spec)[1]
        with warp.ScopedDevice("cpu"):
            import mujoco
            import mujoco_warp

            unwatched = scene.replace(sensors=())
            built, observed = build(unwatched, spec.method, h, form, softness), build(
                unwatched, "Euler", h, form, softness, True)
            for each in (built, observed):  # Warp resets nothing by itself, and does not know the flag
                each.opt.disableflags &= ~int(mujoco.mjtDisableBit.mjDSBL_AUTORESET)
            start = mujoco.MjData(built)
            set_initial_state(scene, built, start)
            try:
                model, bench = mujoco_warp.put_model(built), mujoco_warp.put_model(observed)
            except NotImplementedError as error:
                raise Unsupported(f"MuJoCo Warp {self.version()} does not have what this scene needs: {error}"
                                  ) from None
            for each in (model, bench):  # how far constraints are from closed is measured, and not read from the screen
                limits = mujoco_warp.OverflowType
                each.opt.warn_overflow &= ~(limits.ITERATIONS | limits.LS_ITERATIONS)
            rows = 6 * built.neq + 2 * built.njnt + built.nv  # by default those of the start alone
            data = mujoco_warp.put_data(built, start, njmax=rows)
            bench_data = mujoco_warp.put_data(observed, mujoco.MjData(observed), nworld=ROWS, njmax=rows)
            mujoco_warp.step(model, mujoco_warp.put_data(built, start, njmax=rows))  # compile before the clock runs
            step = recorded(warp, functools.partial(mujoco_warp.step, model, data))

            def observe(t: np.ndarray, q: np.ndarray, v: np.ndarray) -> np.ndarray:
                parts = []
                for first in range(0, len(t), ROWS):
                    for target, part in ((bench_data.qpos, q), (bench_data.qvel, v)):
                        target.assign(np.resize(part[first:first + ROWS], (ROWS, part.shape[1])).astype(np.float32))
                    mujoco_warp.forward(bench, bench_data)
                    parts.append(bench_data.sensordata.numpy()[:len(t) - first].astype(float))
                return np.concatenate(parts)

            def convert(t: np.ndarray, q: np.ndarray, v: np.ndarray, a: np.ndarray | None) -> States:
                return sensed(unwatched, t, observe(t, q, v) if a is None else a, form)

            def state() -> tuple[np.ndarray, np.ndarray]:
                return data.qpos.numpy()[0].astype(float), data.qvel.numpy()[0].astype(float)

            raw = stepping.march(scene, spec, state(), stepping.one_by_one(step, state), convert, observe)
        raw.form = form
        if built.neq:
            raw.stats["softness"] = softness
        return raw
