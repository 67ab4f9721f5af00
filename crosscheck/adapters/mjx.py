"""MJX, MuJoCo in JAX, on the processor: MuJoCo's models, in double or in single precision.

Source: https://mujoco.readthedocs.io/en/stable/mjx.html. It needs a MuJoCo of its own version, and so an environment of
its own (`crosscheck.adapters.external.versions`). MuJoCo compiles the model there; steps, states and accelerations are
MJX's own, in its precision. One function for all steps is compiled for each model and integrator, and kept on disk.
"""

from __future__ import annotations

import contextlib
import functools
import io
import os
from typing import Any

import numpy as np

from crosscheck.adapters.base import RawRun, RunSpec
from crosscheck.adapters.mujoco.adapter import Batched
from crosscheck.files import cache_folder
from crosscheck.scene.model import Scene

ROWS = 1024
"""States that one call of a compiled function takes or returns."""


class MJX(Batched):
    """Adapter of MJX in double precision, forms `tree` and `maximal`."""

    name = "mjx"
    methods = ("Euler", "implicitfast", "RK4")
    pace = 3
    double = True
    package = "mujoco-mjx"
    timeless = "MJX calls no function for controls at its stages"
    rows = ROWS

    def run(self, scene: Scene, spec: RunSpec) -> RawRun:
        """Integrate; raises `Unsupported` with MJX's words if it lacks an element, and `EngineError` on divergence."""
        mjx = library(self.double)
        import jax

        built, observed, start = self.compiled(scene, spec)
        model, bench = self.put(mjx, (built, observed))
        data, bench_data = mjx.make_data(built), mjx.make_data(observed)
        # Both go to a device like the rest of the data, or the second call would compile once more.
        place = functools.partial(jax.device_put, device=jax.devices("cpu")[0])
        data = data.replace(qpos=place(start.qpos), qvel=place(start.qvel))
        if built.ntendon:  # MJX starts with other integers than its steps return for tendons, which no loop accepts
            kinds = jax.eval_shape(mjx.step, model, data)
            data = jax.tree.map(lambda part, kind: part.astype(kind.dtype), data, kinds)
        steps, watch = _compiled()

        def advance(count: int, stride: int) -> tuple[np.ndarray, np.ndarray]:
            nonlocal data
            rows, parts = count // stride, []
            while rows:
                data, *history = steps(model, data, min(rows, ROWS), stride)
                parts.append([np.asarray(part, dtype=float)[:min(rows, ROWS)] for part in history])
                rows -= min(rows, ROWS)
            q, v = (np.concatenate(part) for part in zip(*parts, strict=True))
            return q, v

        steps(model, data, 0, 1)  # compile before the clock runs
        return self.marched(scene, spec, built, (np.array(start.qpos), np.array(start.qvel)), advance,
                            functools.partial(watch, bench, bench_data))


class MJXSingle(MJX):
    """The same in single precision, which is MJX's own choice where nothing else is asked for."""

    name = "mjx-single"
    eps = 2.0**-23
    double = False


def library(double: bool) -> Any:
    """`mujoco.mjx`, set to one precision; compiled functions are kept in the cache folder."""
    os.environ.setdefault("JAX_PLATFORMS", "cpu")
    # XLA prints an alarm if it compiles for two minutes, as it may on an arm; what fails is raised, too.
    os.environ.setdefault("TF_CPP_MIN_LOG_LEVEL", "3")
    import jax

    jax.config.update("jax_enable_x64", double)
    jax.config.update("jax_compilation_cache_dir", str(cache_folder() / "jax"))
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.5)
    with contextlib.redirect_stdout(io.StringIO()):  # it prints that it does without warp, which is for its other half
        from mujoco import mjx
    return mjx


@functools.cache
def _compiled() -> tuple[Any, Any]:
    """Two functions that JAX compiles once for each model and integrator, whatever the step and the number of steps.

    The first makes `rows` times `stride` steps and returns the data after them and (q, v) after every stride-th, the
    second gives the sensor values of `ROWS` states.
    """
    import jax
    from jax import numpy as jnp
    from mujoco import mjx

    def steps(model: Any, data: Any, rows: int, stride: int) -> tuple[Any, Any, Any]:
        def row(index: Any, carry: Any) -> Any:
            data, q, v = carry
            data = jax.lax.fori_loop(0, stride, lambda _, each: mjx.step(model, each), data)
            return data, q.at[index].set(data.qpos), v.at[index].set(data.qvel)

        empty = (jnp.zeros((ROWS, part.size), part.dtype) for part in (data.qpos, data.qvel))
        stepped: tuple[Any, Any, Any] = jax.lax.fori_loop(0, rows, row, (data, *empty))
        return stepped

    def watch(model: Any, data: Any, q: Any, v: Any) -> Any:
        def one(q: Any, v: Any) -> Any:
            # Without constraint rows `forward` ends before the sensors of accelerations and leaves them zero.
            return mjx.sensor_acc(model, mjx.forward(model, data.replace(qpos=q, qvel=v))).sensordata

        return jax.vmap(one)(q, v)

    return jax.jit(steps), jax.jit(watch)
