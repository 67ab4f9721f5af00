"""MuJoCo: joint coordinates or free bodies under soft constraints, stepping in its C loop.

Source: Todorov, Erez & Tassa, IROS 2012, doi:10.1109/IROS.2012.6386109. The integrator `discrete` is a semi-implicit
Euler step in the metric M + h D + h^2 K, with D the damping and K the stiffness of joints and tendons. Constraints are
solved in that metric, with their springs evaluated at the end of the step. Without all of these it equals `Euler`.
"""

from __future__ import annotations

import contextlib
import dataclasses
from collections.abc import Callable, Iterable, Iterator
from typing import TYPE_CHECKING, Any

import numpy as np

from crosscheck.adapters.base import Engine, RawRun, RunSpec
from crosscheck.adapters.common import open_tree, stepping, tree
from crosscheck.adapters.common.held import Held, highest_order
from crosscheck.adapters.common.native import JointStates, Native
from crosscheck.adapters.common.own_law import OwnLaw
from crosscheck.adapters.mujoco import models, own_law
from crosscheck.adapters.mujoco.models import INTEGRATORS, OBSERVED, build, set_initial_state
from crosscheck.errors import EngineError, Unsupported
from crosscheck.scene.model import Scene, rotation_from_quaternion
from crosscheck.scene.models.compiling import listening
from crosscheck.scene.states import States

if TYPE_CHECKING:
    import mujoco

__all__ = ["INTEGRATORS", "MuJoCo", "build", "set_initial_state"]


class Forms(Engine):
    """What the forms `tree` and `maximal` hold, and with what order: of MuJoCo and of MJX, which take the same models.
    """

    forms = ("tree", "maximal")
    options = frozenset({"form", "softness"})

    def form(self, scene: Scene, spec: RunSpec) -> str:
        """The form used: the requested one, else tree, or maximal if only that can model the scene."""
        if spec.form is not None:
            return spec.form
        only_maximal = models.obstacle(scene, "tree") and not models.obstacle(scene, "maximal")
        return "maximal" if only_maximal else "tree"

    def documented_order(self, scene: Scene, spec: RunSpec) -> int:
        """Order 1 for the semi-implicit Euler family, 4 for RK4.

        RK4 has order 1 under tight equality constraints, whose time constant of two steps its stages do not resolve:
        velocities are of order 1, positions of order 2. With the default softness the order is that of convergence to
        the motion of the softened system.
        """
        if spec.method != "RK4":
            return 1
        if (order := highest_order(scene)) is not None:
            return order
        return 1 if models.softened(scene, self.form(scene, spec)) and spec.softness != "default" else 4

    def held_levels(self, scene: Scene, spec: RunSpec) -> frozenset[str]:
        """All three if there are only joint coordinates; equality constraints are soft and hold none."""
        return frozenset() if models.softened(scene, self.form(scene, spec)) else tree.LEVELS

    def unsupported(self, scene: Scene, spec: RunSpec) -> str | None:
        """Why MuJoCo cannot run this, or None."""
        form = self.form(scene, spec)
        if form not in self.forms:
            return f"form {form} is not built into this adapter; it has {', '.join(self.forms)}"
        return models.obstacle(scene, form)

    def own_law(self, scene: Scene, spec: RunSpec) -> States | None:
        """That of its friction and limits at their default softness; the tight ones depend on the step."""
        own = models.of_own_law(scene) and spec.softness == "default"
        return OwnLaw(scene, own_law.default, self.name).states() if own else None

    def nearest_law(self, scene: Scene, spec: RunSpec) -> RunSpec | None:
        """Friction and limits as stiff as the step allows."""
        own = models.of_own_law(scene) and spec.softness == "default"
        return dataclasses.replace(spec, softness="tight") if own else None

    def own_words(self, spec: RunSpec) -> str:
        """Attributes of a joint in MJCF, of the tight setting."""
        return "" if spec.softness == "default" or spec.step is None else (
            f'solreffriction="{2 * spec.step:g} 1" solimpfriction="{models.TIGHT} {models.TIGHT}", limits alike')

    def turning(self, scene: Scene, form: str | None) -> list[int]:
        """Bodies on a ball joint, and free bodies."""
        branches, _ = models.closures(scene, form or "tree")
        return [branch.body for branch in branches
                if branch.joint is None or "ball" in branch.joint.kind.motion]


class Batched(Forms):
    """MuJoCo's models in a library of its own, which steps one state and observes many at once."""

    timeless: str  # why it has no functions of time
    rows: int  # states that one call observes

    def unsupported(self, scene: Scene, spec: RunSpec) -> str | None:
        """Why the library cannot run this, or None."""
        if scene.timed:
            return f"functions of time are not built into this adapter: {self.timeless}"
        return open_tree.bouncing(scene) or super().unsupported(scene, spec)

    def compiled(self, scene: Scene, spec: RunSpec) -> tuple[mujoco.MjModel, mujoco.MjModel, mujoco.MjData]:
        """The model that is stepped, the one with the sensors `OBSERVED`, and the start."""
        import mujoco

        h, form, softness = stepping.fixed_step(scene, spec)[1], self.form(scene, spec), spec.softness or "tight"
        unwatched = scene.replace(sensors=())  # such libraries lack some of MuJoCo's sensors
        built, observed = build(unwatched, spec.method, h, form, softness), build(
            unwatched, "Euler", h, form, softness, True)
        start = mujoco.MjData(built)
        set_initial_state(scene, built, start)
        return built, observed, start

    def put(self, library: Any, models: Iterable[mujoco.MjModel]) -> list[Any]:
        """The models in the library; raises `Unsupported` with its words if it lacks an element."""
        try:
            return [library.put_model(each) for each in models]
        except NotImplementedError as error:
            raise Unsupported(f"{self.name} {self.version()} does not have what this scene needs: {error}") from None

    def marched(self, scene: Scene, spec: RunSpec, model: mujoco.MjModel, start: tuple[np.ndarray, np.ndarray],
                advance: stepping.Advance, watch: Callable[[np.ndarray, np.ndarray], Any]) -> RawRun:
        """The run; `watch` gives the values of the sensors `OBSERVED` of `rows` states (q, v)."""
        form = self.form(scene, spec)

        def observe(t: np.ndarray, q: np.ndarray, v: np.ndarray) -> np.ndarray:
            parts = []
            for first in range(0, len(t), self.rows):
                some = (np.resize(part[first:first + self.rows], (self.rows, part.shape[1])) for part in (q, v))
                parts.append(np.asarray(watch(*some), dtype=float)[:len(t) - first])
            return np.concatenate(parts)

        def convert(t: np.ndarray, q: np.ndarray, v: np.ndarray, a: np.ndarray | None) -> States:
            return sensed(scene.replace(sensors=()), t, observe(t, q, v) if a is None else a, form)

        raw = stepping.march(scene, spec, start, advance, convert, observe)
        raw.form = form
        if model.neq:
            raw.stats["softness"] = spec.softness or "tight"
        return raw


class MuJoCo(Forms):
    """Adapter of MuJoCo, forms `tree` and `maximal`."""

    name = "mujoco"
    methods = tuple(INTEGRATORS)
    package = "mujoco"
    on_group = True
    reads = (".urdf", ".xml", ".mjcf")

    def native(self, path: str, states: JointStates) -> Native:
        """The model that MuJoCo makes of a model file by itself."""
        from crosscheck.adapters.mujoco.native import load

        return load(path, states)

    def run(self, scene: Scene, spec: RunSpec) -> RawRun:
        """Integrate; raises `EngineError` if MuJoCo warns or the state becomes infinite or NaN."""
        import mujoco

        form, softness = self.form(scene, spec), spec.softness or "tight"
        model = build(scene, spec.method, stepping.fixed_step(scene, spec)[1], form, softness)
        data = mujoco.MjData(model)
        set_initial_state(scene, model, data)
        kind = "discrete" if spec.method == "discrete" else "Euler"
        bench = build(models.without_bounces(scene), kind, model.opt.timestep, form, softness, True)
        held = Held(scene, model.opt.timestep)
        accelerate, convert = _evaluation(scene, bench, held, form)
        with listening() as warnings, _controlled(models.controls(scene)):
            advance = _advance(scene, model, data, warnings, held)
            raw = stepping.march(scene, spec, (data.qpos.copy(), data.qvel.copy()), advance, convert, accelerate)
        raw.form = form
        if model.neq or models.of_own_law(scene):
            raw.stats["softness"] = softness
        return raw


def _evaluation(scene: Scene, model: mujoco.MjModel, held: Held, form: str
                ) -> tuple[Callable[..., np.ndarray], stepping.Convert]:
    """Two functions: (t, q, v) -> values of the `OBSERVED` sensors, row by row, and these -> states.

    After a step MuJoCo's accelerations are those of its start, so they are evaluated again here, by `model`, which has
    the sensors. Those of `discrete` are the changes of velocities over the next step, as MuJoCo's own: what its soft
    constraints give follows from the end of the step, and at the state itself it would be twice as much in a joint that
    friction holds. The sensor values of one step from a state are those of that state.
    """
    import mujoco
    import mujoco.rollout

    bench = mujoco.MjData(model)  # separate from the data of the run
    holds = {index: model.actuator(f"load {index}").id for index in held.efforts}
    kind = mujoco.mjtState.mjSTATE_FULLPHYSICS
    empty = np.empty(mujoco.mj_stateSize(model, kind))
    mujoco.mj_getState(model, bench, empty, kind)

    def observe(t: np.ndarray, q: np.ndarray, v: np.ndarray) -> np.ndarray:
        if not scene.timed:
            starts = np.tile(empty, (len(t), 1))
            starts[:, :1 + model.nq + model.nv] = np.concatenate([t[:, None], q, v], axis=1)
            return np.asarray(mujoco.rollout.rollout(model, bench, starts, nstep=1)[1][:, 0])
        readings = np.empty((len(t), model.nsensordata))
        for row in range(len(t)):  # `rollout` does not call the Python function for controls
            bench.time, bench.qpos[:], bench.qvel[:] = t[row], q[row], v[row]
            for index, effort in held.at(t[row]).items():
                bench.ctrl[holds[index]] = effort
            mujoco.mj_forward(model, bench)
            readings[row] = bench.sensordata
        return readings

    def convert(t: np.ndarray, q: np.ndarray, v: np.ndarray, readings: np.ndarray | None) -> States:
        states = sensed(scene, t, observe(t, q, v) if readings is None else readings, form)
        states.hinges = models.hinges(scene, model, form, q)
        return states

    return observe, convert


def sensed(scene: Scene, t: np.ndarray, readings: np.ndarray, form: str) -> States:
    """The states at the times t, (T,), of which the sensors `OBSERVED` and `NATIVE` read the rows of `readings`."""
    *ends, length = np.cumsum([length for _, length in OBSERVED])
    frames, rest = readings[:, :length * scene.n], readings[:, length * scene.n:]
    x, turned, v, spin, a, alpha = np.split(frames.reshape(len(t), scene.n, -1), ends, axis=-1)
    R = rotation_from_quaternion(turned)
    own = {}
    for sensor, _ in models.native_sensors(scene, form):
        own[sensor.name], rest = np.split(rest, [4 if sensor.type == "attitude" else 3], axis=1)
    return States(t, x, R, v, np.einsum("tnji,tnj->tni", R, spin), a + scene.gravity,
                  np.einsum("tnji,tnj->tni", R, alpha), sensors=own or None)


@contextlib.contextmanager
def _controlled(control: Callable[[mujoco.MjModel, mujoco.MjData], None] | None) -> Iterator[None]:
    """Within the context MuJoCo calls `control` for controls at every stage; the callback is global for all models."""
    import mujoco

    if control is not None:
        mujoco.set_mjcb_control(control)
    try:
        yield
    finally:
        if control is not None:
            mujoco.set_mjcb_control(None)


def _advance(scene: Scene, model: mujoco.MjModel, data: mujoco.MjData, warnings: list[str], held: Held
             ) -> stepping.Advance:
    import mujoco
    import mujoco.rollout

    holds = {index: model.actuator(f"load {index}").id for index in held.efforts}
    done = 0

    def measure(joint: str) -> tuple[float, float]:
        force = next(index for index in holds if scene.forces[index].joint == joint)
        actuator = model.actuator(f"load {force}")  # its gear turns the coordinate the scene's way
        sign, at = actuator.gear[0], actuator.trnid[0]
        return (float(sign * data.qpos[model.jnt_qposadr[at]]), float(sign * data.qvel[model.jnt_dofadr[at]]))

    def to_control() -> None:
        held.update(done, measure)
        for index, effort in held.efforts.items():
            data.ctrl[holds[index]] = effort

    kind = mujoco.mjtState.mjSTATE_FULLPHYSICS
    size = mujoco.mj_stateSize(model, kind)

    if held:
        to_control()

    def advance(steps: int, stride: int) -> tuple[np.ndarray, np.ndarray]:
        nonlocal done
        if stride == 1 and not scene.timed:
            state = np.empty(size)
            mujoco.mj_getState(model, data, state, kind)
            history = mujoco.rollout.rollout(model, data, state[None], nstep=steps)[0][0]
            q, v = history[:, 1:1 + model.nq], history[:, 1 + model.nq:1 + model.nq + model.nv]
        else:
            q, v = np.empty((steps // stride, model.nq)), np.empty((steps // stride, model.nv))
            for sample in range(len(q)):
                end = done + stride
                while done < end:
                    count = min(end, held.next_due(done)) - done
                    mujoco.mj_step(model, data, nstep=count)
                    done += count
                    if held:
                        to_control()
                q[sample], v[sample] = data.qpos, data.qvel
        if warnings:  # with autoreset off a diverged state is returned like any other
            raise EngineError(f"MuJoCo warned: {warnings[0].strip()} Try a smaller step.")
        return q, v

    return advance
