"""MuJoCo Warp, MuJoCo's models in Warp kernels, on the processor in single precision.

Source: https://github.com/google-deepmind/mujoco_warp. It needs the MuJoCo of its own version, and is given an
environment of its own (`crosscheck.adapters.external.versions`). MuJoCo compiles the model there; steps, states and
accelerations are those of Warp.
"""

from __future__ import annotations

import functools

import numpy as np

from crosscheck.adapters.base import RawRun, RunSpec
from crosscheck.adapters.common import stepping
from crosscheck.adapters.mujoco.adapter import Batched
from crosscheck.adapters.newton import recorded, silent_warp
from crosscheck.scene.model import Scene

ROWS = 256
"""Worlds in which as many states are evaluated at once."""


class Warp(Batched):
    """Adapter of MuJoCo Warp, forms `tree` and `maximal`."""

    name = "warp"
    methods = ("Euler", "implicitfast", "RK4")
    package = "mujoco-warp"
    eps = 2.0**-23
    pace = 4
    timeless = "a recorded step calls no function for controls"
    rows = ROWS

    def run(self, scene: Scene, spec: RunSpec) -> RawRun:
        """Integrate; raises `Unsupported` with Warp's words if it lacks an element, and `EngineError` on divergence."""
        warp = silent_warp()
        with warp.ScopedDevice("cpu"):
            import mujoco
            import mujoco_warp

            built, observed, start = self.compiled(scene, spec)
            for each in (built, observed):  # Warp resets nothing by itself, and does not know the flag
                each.opt.disableflags &= ~int(mujoco.mjtDisableBit.mjDSBL_AUTORESET)
            model, bench = self.put(mujoco_warp, (built, observed))
            for each in (model, bench):  # how far constraints are from closed is measured, and not read from the screen
                limits = mujoco_warp.OverflowType
                each.opt.warn_overflow &= ~(limits.ITERATIONS | limits.LS_ITERATIONS)
            rows = 6 * built.neq + 2 * built.njnt + built.nv  # by default those of the start alone
            data = mujoco_warp.put_data(built, start, njmax=rows)
            bench_data = mujoco_warp.put_data(observed, mujoco.MjData(observed), nworld=ROWS, njmax=rows)
            mujoco_warp.step(model, mujoco_warp.put_data(built, start, njmax=rows))  # compile before the clock runs
            step = recorded(warp, functools.partial(mujoco_warp.step, model, data))

            def watch(q: np.ndarray, v: np.ndarray) -> np.ndarray:
                bench_data.qpos.assign(q.astype(np.float32))
                bench_data.qvel.assign(v.astype(np.float32))
                mujoco_warp.forward(bench, bench_data)
                return np.asarray(bench_data.sensordata.numpy())

            def state() -> tuple[np.ndarray, np.ndarray]:
                return data.qpos.numpy()[0].astype(float), data.qvel.numpy()[0].astype(float)

            return self.marched(scene, spec, built, state(), stepping.one_by_one(step, state), watch)
