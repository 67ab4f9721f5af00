"""Engines with one deliberate mistake each: a right Munthe-Kaas stepper of our own, and changes of its run.

A mistake is made from a generator, so that seeds vary where and when it shows.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable

import numpy as np
from scipy.spatial.transform import Rotation

from tests.engines.stepper import Turning, begun

STEP = 1e-3
"""s, of the main runs of the suite."""


def once(change):
    """A change of a scene by a factor, made once of each."""
    kept: dict = {}

    def changed(scene, factor):
        if (id(scene), factor) not in kept:
            if len(kept) > 8:
                kept.clear()
            kept[id(scene), factor] = scene, change(scene, factor)
        return kept[id(scene), factor][1]
    changed.__name__ = change.__name__
    return changed


@once
def pulled(scene, factor):
    """The scene with its gravity times a factor."""
    return scene.replace(gravity=np.asarray(scene.gravity) * factor)


@once
def fattened(scene, factor):
    """The scene with all inertias times a factor."""
    return scene.replace(bodies=tuple(dataclasses.replace(body, inertia=np.asarray(body.inertia) * factor)
                                      for body in scene.bodies))


@dataclasses.dataclass(frozen=True)
class Mistake:
    name: str
    make: Callable[[np.random.Generator], Turning]
    orders: tuple[int, ...] = (4,)  # at which it can be seen
    scenes: tuple[str, ...] = ("single_pendulum", "double_pendulum")  # on which


def turning(**methods):
    """The stepper with other methods."""
    return type("Changed", (Turning,), methods)()


def late(change, factor):
    """A parameter that changes at some time of the run."""
    def make(random):
        begin = random.uniform(0.1, 0.8)
        return turning(step=lambda self, scene, t, *rest: Turning.step(
            self, change(scene, factor) if t > begin * scene.duration else scene, t, *rest))
    return make


def reporting(change):
    """A run whose report is changed: `change(states, random)` returns the fields that differ."""
    return lambda random: turning(reported=lambda self, scene, states: dataclasses.replace(
        states, **change(states, random)))


def stepping(change):
    """A run whose state is changed after steps: `change(scene, t, state, at)`, `at` a random share of the run."""
    def make(random):
        at = random.uniform(0.2, 0.8)
        return turning(after=lambda self, scene, t, state: change(scene, t, state, at))
    return make


def accelerating(change):
    """Other equations: `change(scene, a, alpha, x, R, v, w)` returns a and alpha."""
    return lambda random: turning(accelerations=lambda self, scene, t, *state: change(
        scene, *Turning.accelerations(self, scene, t, *state), *state))


class Slack(Turning):
    """Accelerations are those of bodies that do not turn."""

    def accelerations(self, scene, t, x, R, v, w):
        return super().accelerations(scene, t, x, R, v, 0.0 * w)


def _after(scene, t, at):
    return t > at * scene.duration


def _slowed(state, factor):
    return [*state[:2], factor * state[2], factor * state[3]]


def _turned(R, angle):
    return R @ Rotation.from_rotvec([0.0, 0.0, angle]).as_matrix()


def _shifted(states, share):
    """Every field late by a share of an output interval."""
    return {name: np.concatenate([part[:1], (1 - share) * part[1:] + share * part[:-1]])
            for name, part in (("x", states.x), ("v", states.v), ("w", states.w))}


HIGH, ALL = (4,), (1, 4)
BOTH = ("single_pendulum", "double_pendulum")
MISTAKES = (
    *(Mistake(f"{name} x {factor} from a random time on", late(change, factor), orders)
      for name, change, factors in (("gravity", pulled, ((1.3, (2, 4)), (0.9, (2, 4)), (1.05, HIGH), (1.01, ALL),
                                         (0.999, HIGH), (1.002, HIGH), (0.0, (2, 4)), (-1.0, (2, 4)))),
                            ("inertia", fattened, ((2.0, (2, 4)), (0.5, (2, 4)), (1.1, HIGH), (1.01, HIGH),
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
    Mistake("velocity jumps once", stepping(lambda scene, t, s, at: _slowed(s, 1.2 if _first(scene, t, at) else 1.0))),
    *(Mistake(f"angular velocity clamped at {limit} of its largest", stepping(
        lambda scene, t, s, at, k=limit: [*s[:3], np.clip(s[3], -k * _fastest(scene), k * _fastest(scene))]))
      for limit in (0.5, 0.8)),
    *(Mistake(f"damping {rate}/s from a random time on", stepping(
        lambda scene, t, s, at, k=rate: _slowed(s, 1 - k * 1e-3 * _after(scene, t, at))), ALL if rate == 1.0 else HIGH)
      for rate in (1.0, -1.0, 0.3)),
    Mistake("energy pumped in", stepping(lambda scene, t, s, at: _slowed(s, 1.0003))),
    Mistake("reset to the start", stepping(lambda scene, t, s, at: [
        *begun(scene)] if _first(scene, t, at) else s)),
    Mistake("frozen from a random time on", stepping(lambda scene, t, s, at: _slowed(s, 1.0 - _after(scene, t, at)))),
    *(Mistake(f"angular accelerations x {k}", accelerating(lambda scene, a, al, *s, k=k: (a, k * al)))
      for k in (1.2, 0.9)),
    *(Mistake(f"accelerations x {k}", accelerating(lambda scene, a, al, *s, k=k: (k * a, k * al)))
      for k in (1.2, 0.9)),
    Mistake("no centripetal acceleration", lambda random: Slack()),
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
