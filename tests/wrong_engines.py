"""Engines with one deliberate mistake each: a right Munthe-Kaas stepper of our own, and changes of its run.

The stepper solves the index-1 equations by dense algebra and projects; it shares nothing with lieeuler. A mistake is
made from a scene, a generator and a size, so that seeds vary where and when it shows.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable

import numpy as np
from scipy.spatial.transform import Rotation

from crosscheck.adapters.base import Engine, RawRun, steps_per_sample
from crosscheck.scene.monitor import Monitor
from crosscheck.scene.states import States
from tests.right_engines import equations, per_scene

TABLEAUX = {
    1: ([[]], [1.0]),
    2: ([[], [0.5]], [0.0, 1.0]),
    4: ([[], [0.5], [0.0, 0.5], [0.0, 0.0, 1.0]], [1 / 6, 1 / 3, 1 / 3, 1 / 6]),
}
"""Stages and weights by order."""


STEP = 1e-3
"""s, of the main runs of the suite."""


class Right(Engine):
    """Runge-Kutta-Munthe-Kaas on the index-1 system, orders 1, 2 and 4; nothing is projected."""

    name = "stepper"
    checks_sizes = True
    methods = ("RKMK1", "RKMK2", "RKMK4")

    def unsupported(self, scene, spec):
        return None

    def version(self):
        return "1"

    def documented_order(self, scene, spec):
        return int(spec.method[-1])

    def scene_at(self, scene, t):
        """The scene that is stepped at a time, s."""
        return scene

    def run(self, scene, spec):
        """Makes the steps and the report; a mistake changes either."""
        per, h = steps_per_sample(scene, spec.step)
        stages, weights = TABLEAUX[int(spec.method[-1])]
        state = [scene.x0[None], scene.R0[None], scene.v0[None], scene.w0[None]]
        kept, monitor = [state], Monitor(scene) if spec.monitor else None
        for k in range(per * (scene.samples - 1)):
            state = self.after(scene, k * h, self.step(self.scene_at(scene, k * h), state, h, stages, weights))
            if monitor is not None:
                monitor.update(*state)
            if (k + 1) % per == 0:
                kept.append(state)
        x, R, v, w = (np.concatenate(parts) for parts in zip(*kept, strict=True))
        a, alpha, lam = equations(scene)(x, R, v, w)
        states = self.reported(scene, States(scene.t, x, R, v, w, a, alpha, lam))
        return RawRun(states, 1e-6 * per * scene.samples, per * (scene.samples - 1), h,
                      maxima=None if monitor is None else monitor.maxima())

    def step(self, scene, state, h, stages, weights):
        """One step: the increments of attitudes in exponential coordinates, with the commutator of dexp^-1."""
        x, R, v, w = state
        rates: list[tuple[np.ndarray, ...]] = []
        for row in stages:
            dx, turn, dv, dw = self._sum(row, rates, h, state)
            here = (x + dx, R @ Rotation.from_rotvec(turn[0]).as_matrix()[None], v + dv, w + dw)
            a, alpha = self.accelerations(scene, *here)
            spin = here[3]
            inverse = spin + 0.5 * np.cross(turn, spin) + np.cross(turn, np.cross(turn, spin)) / 12.0
            rates.append((here[2], inverse, a, alpha))
        dx, turn, dv, dw = self._sum(weights, rates, h, state)
        return [x + dx, R @ Rotation.from_rotvec(turn[0]).as_matrix()[None], v + dv, w + dw]

    @staticmethod
    def _sum(row, rates, h, state):
        zero = [np.zeros_like(state[0])] * 4
        if not row:
            return zero
        return [h * sum(weight * rate[part] for weight, rate in zip(row, rates, strict=True)) for part in range(4)]

    def accelerations(self, scene, x, R, v, w):
        return equations(scene)(x, R, v, w)[:2]

    def after(self, scene, t, state):
        """The state from which the next step starts, after a step from t."""
        return state

    def reported(self, scene, states):
        return states


@dataclasses.dataclass(frozen=True)
class Mistake:
    name: str
    make: Callable[[np.random.Generator], Right]
    orders: tuple[int, ...] = (4,)  # at which it can be seen
    scenes: tuple[str, ...] = ("single_pendulum", "double_pendulum")  # on which


def _changed(scene, **factors):
    """The scene with gravity, masses or inertias times a factor."""
    bodies = tuple(dataclasses.replace(body, mass=body.mass * factors.get("mass", 1.0),
                                       inertia=np.asarray(body.inertia) * factors.get("inertia", 1.0))
                   for body in scene.bodies)
    return dataclasses.replace(scene, gravity=np.asarray(scene.gravity) * factors.get("gravity", 1.0), bodies=bodies)


def late(name, factor):
    """A parameter that changes at some time of the run."""
    def make(random):
        begin, changed = random.uniform(0.1, 0.8), per_scene(lambda scene: _changed(scene, **{name: factor}))

        class Late(Right):
            def scene_at(self, scene, t):
                return changed(scene) if t > begin * scene.duration else scene
        return Late()
    return make


def reporting(change):
    """A run whose report is changed: `change(states, random)` returns the fields that differ."""
    def make(random):
        class Reporting(Right):
            def reported(self, scene, states):
                return dataclasses.replace(states, **change(states, random))
        return Reporting()
    return make


def stepping(change):
    """A run whose state is changed after steps: `change(scene, t, state, at)`, `at` a random share of the run."""
    def make(random):
        at = random.uniform(0.2, 0.8)

        class Stepping(Right):
            def after(self, scene, t, state):
                return change(scene, t, state, at)
        return Stepping()
    return make


def accelerating(change):
    """Other equations: `change(scene, a, alpha, x, R, v, w)` returns a and alpha."""
    def make(random):
        class Accelerating(Right):
            def accelerations(self, scene, x, R, v, w):
                return change(scene, *super().accelerations(scene, x, R, v, w), x, R, v, w)
        return Accelerating()
    return make


def _after(scene, t, at):
    return t > at * scene.duration


def _turned(R, angle):
    return R @ Rotation.from_rotvec([0.0, 0.0, angle]).as_matrix()


def _shifted(states, share):
    """Every field late by a share of an output interval."""
    return {name: np.concatenate([part[:1], (1 - share) * part[1:] + share * part[:-1]])
            for name, part in (("x", states.x), ("v", states.v), ("w", states.w))}


HIGH, ALL = (4,), (1, 4)
BOTH = ("single_pendulum", "double_pendulum")
MISTAKES = (
    *(Mistake(f"{name} x {factor} from a random time on", late(name, factor), orders)
      for name, factors in (("gravity", ((1.3, (2, 4)), (0.9, (2, 4)), (1.05, HIGH), (1.01, ALL),
                                         (0.999, HIGH), (1.002, HIGH), (0.0, (2, 4)), (-1.0, (2, 4)))),
                            ("inertia", ((2.0, (2, 4)), (0.5, (2, 4)), (1.1, HIGH), (1.01, HIGH),
                                         (0.999, HIGH))))
      for factor, orders in factors),
    *(Mistake(f"{field} reported x {factor}", reporting(lambda s, r, f=field, k=factor: {f: k * getattr(s, f)}))
      for field in ("a", "alpha", "lam") for factor in (2.0, -1.0, 0.0, 0.7, 1.0003)),
    *(Mistake(f"{field} x 1.01 in the second half", reporting(lambda s, r, f=field: {f: _second_half(getattr(s, f))}))
      for field in ("a", "alpha", "lam")),
    Mistake("a without gravity", reporting(lambda s, r: {"a": s.a + np.array([0.0, 0.0, 9.81])}), ALL),
    Mistake("a in another frame", reporting(lambda s, r: {"a": np.einsum("tnji,tnj->tni", s.R, s.a)})),
    Mistake("alpha in world axes", reporting(lambda s, r: {"alpha": np.einsum("tnij,tnj->tni", s.R, s.alpha)})),
    Mistake("lam reported without an offset", reporting(lambda s, r: {"lam": s.lam + 3.0})),
    Mistake("a one output late", reporting(lambda s, r: {"a": np.concatenate([s.a[:1], s.a[:-1]])})),
    Mistake("w in world axes", reporting(lambda s, r: {"w": np.einsum("tnij,tnj->tni", s.R, s.w)})),
    Mistake("R x 1.00001", reporting(lambda s, r: {"R": 1.00001 * s.R}), ALL),
    Mistake("R transposed", reporting(lambda s, r: {"R": np.swapaxes(s.R, -1, -2)})),
    Mistake("v reported x 1.05", reporting(lambda s, r: {"v": 1.05 * s.v})),
    Mistake("w reported x 1.05", reporting(lambda s, r: {"w": 1.05 * s.w})),
    Mistake("x moved by 1 cm", reporting(lambda s, r: {"x": s.x + 0.01}), ALL),
    Mistake("noise of 1e-06 on x", reporting(lambda s, r: {"x": s.x + 1e-6 * r.standard_normal(s.x.shape)}), ALL,
            BOTH[:1]),
    *(Mistake(f"output {share} of an interval late", reporting(lambda s, r, k=share: _shifted(s, k)))
      for share in (1.0, 0.5)),
    Mistake("output interpolated between every second", reporting(
        lambda s, r: {"x": _every_second(s.x), "v": _every_second(s.v), "w": _every_second(s.w)})),
    *(Mistake(f"noise of {size} on {field}", reporting(
        lambda s, r, f=field, k=size: {f: getattr(s, f) + k * r.standard_normal(getattr(s, f).shape)}), HIGH, scenes)
      for field in "xvw" for size, scenes in ((1e-2, BOTH), (1e-4, BOTH), (1e-7, BOTH[:1]))),
    Mistake("float32 output", reporting(lambda s, r: {f: getattr(s, f).astype(np.float32).astype(float)
                                                      for f in "xRvw"}), HIGH, BOTH[:1]),
    Mistake("joints open by a jump", stepping(lambda scene, t, s, at: [s[0] + 0.002 * _after(scene, t, at), *s[1:]])),
    Mistake("a drift of positions", stepping(lambda scene, t, s, at: [s[0] + 1e-5 * _after(scene, t, at), *s[1:]])),
    Mistake("attitude jumps once", stepping(lambda scene, t, s, at: [
        s[0], _turned(s[1], 0.02) if _first(scene, t, at) else s[1], *s[2:]])),
    Mistake("velocity jumps once", stepping(lambda scene, t, s, at: [
        *s[:2], s[2] * (1.2 if _first(scene, t, at) else 1.0), s[3] * (1.2 if _first(scene, t, at) else 1.0)])),
    *(Mistake(f"angular velocity clamped at {limit} of its largest", stepping(
        lambda scene, t, s, at, k=limit: [*s[:3], np.clip(s[3], -k * _fastest(scene), k * _fastest(scene))]))
      for limit in (0.5, 0.8)),
    *(Mistake(f"damping {rate}/s from a random time on", stepping(
        lambda scene, t, s, at, k=rate: [*s[:2], s[2] * (1 - k * 1e-3 * _after(scene, t, at)),
                                         s[3] * (1 - k * 1e-3 * _after(scene, t, at))]), ALL if rate == 1.0 else HIGH)
      for rate in (1.0, -1.0, 0.3)),
    Mistake("energy pumped in", stepping(lambda scene, t, s, at: [*s[:2], 1.0003 * s[2], 1.0003 * s[3]])),
    Mistake("reset to the start", stepping(lambda scene, t, s, at: [
        scene.x0[None], scene.R0[None], scene.v0[None], scene.w0[None]] if _first(scene, t, at) else s)),
    Mistake("frozen from a random time on", stepping(lambda scene, t, s, at: [
        *s[:2], 0.0 * s[2], 0.0 * s[3]] if _after(scene, t, at) else s)),
    *(Mistake(f"angular accelerations x {k}", accelerating(lambda scene, a, al, *s, k=k: (a, k * al)))
      for k in (1.2, 0.9)),
    *(Mistake(f"accelerations x {k}", accelerating(lambda scene, a, al, *s, k=k: (k * a, k * al)))
      for k in (1.2, 0.9)),
    Mistake("no centripetal acceleration", accelerating(
        lambda scene, a, al, x, R, v, w: equations(scene)(x, R, v, 0.0 * w)[:2])),
    Mistake("angular drag", accelerating(lambda scene, a, al, x, R, v, w: (a, al - 0.3 * w))),
    Mistake("quadratic drag", accelerating(
        lambda scene, a, al, x, R, v, w: (a - 0.2 * v * np.linalg.norm(v, axis=-1, keepdims=True), al))),
    Mistake("Coriolis of a turning world", accelerating(
        lambda scene, a, al, x, R, v, w: (a + 0.2 * np.cross([0.0, 0.0, 1.0], v), al))),
)


def _second_half(values):
    return np.concatenate([values[:len(values) // 2], 1.01 * values[len(values) // 2:]])


def _every_second(values):
    found = values.copy()
    found[1:-1:2] = 0.5 * (values[:-2:2] + values[2::2])
    return found


def _first(scene, t, at):
    """Whether this step is the first after the share `at` of the run (steps of 1 ms)."""
    return at * scene.duration < t <= at * scene.duration + STEP * (1 + 1e-9)


def _fastest(scene):
    return max(float(np.abs(scene.w0).max()), math.sqrt(float(np.linalg.norm(scene.gravity))), 1.0)
