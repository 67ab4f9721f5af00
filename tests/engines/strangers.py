"""Engines that nobody here has met: one honest integrator, asked interval by interval, and a table of what is wrong.

The honest one is lieeuler on a scene; a wrong one alters the scene in some intervals, what it reports, or what it says
of itself. It shares nothing with the mends of the judge. Kinds are those of `KINDS`.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any

import numpy as np

from crosscheck.adapters.base import Engine, RawRun, steps_per_sample
from crosscheck.references import truth
from crosscheck.scene import mechanics
from crosscheck.scene.states import States
from tests.engines.mistakes import fattened, once, pulled
from tests.engines.right import Adaptive, Floats, Rotations
from tests.engines.stepper import Honest

KINDS = ("late", "claims", "name", "truth", "clock", "samples", "frame", "places", "outputs", "float32", "history")


@once
def heavier(scene, factor):
    """The scene with the inertia of its last body times a factor."""
    return scene.replace(bodies=(*scene.bodies[:-1], fattened(scene, factor).bodies[-1]))


@once
def blown(scene, factor):
    """The scene with wind: an acceleration of (factor - 1) g along x."""
    return scene.replace(gravity=scene.gravity + np.array([9.81 * (factor - 1.0), 0.0, 0.0]))


@dataclasses.dataclass(frozen=True)
class Wrong:
    """A wrong engine: its kind, how it is made, the methods in which it shows, and the scenes."""

    kind: str
    name: str
    make: Callable[[], Engine]
    methods: tuple[str, ...] = ("first", "second", "fourth")
    scenes: tuple[str, ...] = ("double_pendulum",)


def engine(base: Callable[[], Engine] = Honest, **changes) -> type[Engine]:
    """The honest engine, or another one, with other methods and attributes."""
    return type("Changed", (base,), changes)


def when(place: Callable[..., bool], change: Callable[[Any, float], Any] = pulled, factor: float = 1.001
         ) -> Callable[[], Engine]:
    """An engine whose physics is changed in intervals where `place(self, scene, states, k)`."""
    return engine(physics=lambda self, scene, states, k: change(scene, factor) if place(self, scene, states, k)
                  else scene)


def reporting(change: Callable[..., dict]) -> Callable[[], Engine]:
    """An engine whose report differs: `change(self, scene, states)` gives other fields."""
    return engine(same=True, told=lambda self, scene, raw: dataclasses.replace(
        raw, states=dataclasses.replace(raw.states, **change(self, scene, raw.states))))


def saying(base: Callable[[], Engine] = Honest, declared: dict | None = None, **claims) -> Callable[[], Engine]:
    """An engine that says something else of itself: fields of the answer, and `declared` attributes."""
    def told(self, scene, raw):
        given = {name: value(getattr(raw, name)) if callable(value) else value for name, value in claims.items()}
        return dataclasses.replace(base.told(self, scene, raw), **given)
    return engine(base, told=told, **declared or {})


def from_truth(known: Callable[..., bool]) -> Callable[[], Engine]:
    """An engine that answers by heart where it knows the question, and is wrong by a thousandth elsewhere."""
    def run(self, scene, spec):
        raw = when(lambda *_: True)().run(scene, spec)
        if known(scene):
            exact = truth(scene).states
            raw.states = States(scene.t, exact.x, exact.R, exact.v, exact.w)
        return raw
    return engine(run=run)


def _after(share):
    return lambda self, scene, states, k: states.t[k] >= share * 4.0


def _path(states, k):
    """How far the last body has come so far, m."""
    return float(np.linalg.norm(np.diff(states.x[:k + 1, -1], axis=0), axis=-1).sum())


def _counting(self):
    self.count = getattr(self, "count", 0) + 1
    return self.count


def _started(scene):
    return bool(np.abs(scene.bodies[0].angular_velocity).max() == np.abs([0.5, 0.3, 1.0]).max())


class Stepped(Rotations):
    """A Runge-Kutta method of ours, whose steps go wrong."""

    methods = ("RK4",)

    def run(self, scene, spec):
        """Counts its steps."""
        self.count, self.scene = 0, scene
        return super().run(scene, spec)

    def step(self, scene, t, state, h, tableau):
        self.count += 1
        return super().step(*self.changed(scene, t, state, h), tableau)

    def changed(self, scene, t, state, h):
        """What the step is made of."""
        return scene, t, state, h


class EverySeventh(Stepped):
    """Steps whose number is no multiple of seven are right."""

    def changed(self, scene, t, state, h):
        return pulled(scene, 1.01) if self.count % 7 == 0 else scene, t, state, h


class Overflowing(Stepped):
    """From step 700 of a run on its counter has another sign."""

    def changed(self, scene, t, state, h):
        return pulled(scene, 1.002) if self.count > 700 else scene, t, state, h


class SlowClock(Stepped):
    """Steps of another length than it tells."""

    def changed(self, scene, t, state, h):
        return scene, t, state, h * (1.0 - 2e-6)


class Halves(Stepped):
    """Mistakes in the first half of every output interval are undone in the second."""

    def changed(self, scene, t, state, h):
        first = (t / (scene.duration / (scene.samples - 1)) + 1e-9) % 1.0 < 0.5
        return pulled(scene, 1.005 if first else 0.995), t, state, h


class Injected(Stepped):
    """The energy is projected after every step, to one that grows by a ten-thousandth a second."""

    def after(self, scene, t, state):
        here = States(np.zeros(1), *(part[None] for part in super().after(scene, t, state)))
        energy, moving = mechanics.energy(scene, here)[0], mechanics.kinetic_energy(scene, here)[0]
        factor = np.sqrt(1.0 + 1e-4 * abs(energy) * scene.duration / (moving * 1000.0))
        return [here.x[0], here.R[0], factor * here.v[0], factor * here.w[0]]


class Coupled(Stepped):
    """The last joint pulls its bodies unlike: of the force on the inner one a ten-thousandth is lost."""

    def accelerations(self, scene, t, *state):
        a, alpha = super().accelerations(scene, t, *state)
        a[-2] += 1e-4 * scene.masses[-1] * (a[-1] - scene.gravity) / scene.masses[-2]
        return a, alpha


class Rounded(Stepped):
    """Angular velocities pass through 32 bits in every hundredth step, undeclared."""

    def after(self, scene, t, state):
        x, R, v, w = super().after(scene, t, state)
        return [x, R, v, w.astype(np.float32).astype(float) if self.count % 100 == 0 else w]


class Careless(Adaptive):
    """Works at a tolerance a million times the one asked for, and tells many steps."""

    def run(self, scene, spec):
        found = super().run(scene, dataclasses.replace(spec, rtol=1e6 * spec.rtol))
        return dataclasses.replace(found, steps=10**9)


class Looser(Adaptive):
    """Works at a tolerance a thousand times the one asked for."""

    def run(self, scene, spec):
        return super().run(scene, dataclasses.replace(spec, rtol=1e3 * spec.rtol))


class Hiding(Floats):
    """Declares numbers of 32 bits, which it has, and hides a gravity that is a little wrong behind them."""

    methods, factor = ("RK4",), 1.002

    def taken(self, scene):
        return pulled(scene, self.factor)


class Stale(Honest):
    """Keeps what it has computed for the first scene that it saw."""

    def physics(self, scene, states, k):
        self.first = getattr(self, "first", scene)
        return fattened(scene, 1.02) if scene.name != self.first.name else scene


def interpolated(change: Callable[..., dict]) -> Callable[[], Engine]:
    """An engine that knows the motion, in any world and from any start, and answers with a change of it."""
    def run(self, scene, spec):
        per, h = steps_per_sample(scene, spec.step)
        exact = truth(scene).states
        found = States(scene.t, *(getattr(exact, name).copy() for name in "xRvw"))
        return RawRun(dataclasses.replace(found, **change(found, h)), 1e-3, per * (scene.samples - 1), h)
    return engine(run=run)


def _noisy(s, h):
    return {"x": s.x + 1e-6 * np.random.default_rng(len(s.t)).standard_normal(s.x.shape)}


class Drifting(Honest):
    """Gravity grows with the time."""

    def physics(self, scene, states, k):
        return pulled(scene, 1.0 + 2.5e-4 * states.t[k])


class Leaning(Honest):
    """The inertia of the last body grows as it leans."""

    def physics(self, scene, states, k):
        return heavier(scene, 1.0 + 0.02 * (1.0 - states.R[k, -1, 2, 2]))


class Sleepy(Stepped):
    """A slow motion is slowed further."""

    def changed(self, scene, t, state, h):
        factor = 1.0 - 1e-6 * bool(np.abs(state[3]).max() < 2.0)
        return scene, t, [*state[:2], factor * state[2], factor * state[3]], h


FOURTH = ("fourth",)
SLIP = np.array([0.0, 0.0, 1e-4])
LATE = when(_after(0.75))
TABLE = (
    *(Wrong("late", f"{change.__name__} x {factor} after {share} of the run", when(_after(share), change, factor))
      for share, change, factor in ((0.75, pulled, 1.001), (0.5, pulled, 0.999), (0.9, pulled, 1.01),
                                    (0.75, heavier, 1.01), (0.6, heavier, 0.98), (0.8, blown, 1.001))),
    Wrong("claims", "newton_left 1e9", saying(LATE, stats=lambda _: {"newton_left": 1e9})),
    Wrong("claims", "eps 1e-4", saying(LATE, {"eps": 1e-4})),
    Wrong("claims", "eps 1", saying(LATE, {"eps": 1.0})),
    *(Wrong("claims", f"status {status}", saying(status=status), FOURTH)
      for status in ("max_iterations", "diverged", "failed")),
    Wrong("claims", "half of the steps", saying(steps=lambda n: n // 2), FOURTH),
    Wrong("claims", "one step", saying(steps=1), FOURTH),
    Wrong("claims", "another step", saying(step=lambda h: 3 * h), FOURTH),
    Wrong("claims", "steps and step of a coarser run", saying(steps=lambda n: n // 4, step=lambda h: 4 * h), FOURTH),
    Wrong("claims", "a wide step for a late mistake", saying(LATE, step=lambda h: 100 * h)),
    *(Wrong("name", f"right for the scene's name, {change.__name__} x {factor} for others",
            when(lambda self, scene, *_: scene.name != "double_pendulum", change, factor))
      for change, factor in ((pulled, 1.01), (heavier, 1.05), (blown, 1.01))),
    Wrong("name", "right for the names of its bodies",
          when(lambda self, scene, *_: scene.bodies[0].name.startswith("b0"), pulled, 1.01)),
    Wrong("name", "right for the order of its bodies",
          when(lambda self, scene, *_: scene.joints[0].parent >= 0, pulled, 1.01)),
    Wrong("name", "by heart by its name", from_truth(lambda scene: scene.name == "double_pendulum")),
    Wrong("truth", "by heart by its start", from_truth(lambda scene: _started(scene))),
    Wrong("truth", "by heart by its description", from_truth(lambda scene: bool(scene.description))),
    Wrong("truth", "by heart by its gravity", from_truth(
        lambda scene: scene.gravity[0] == 0 == scene.gravity[1] and _started(scene))),
    *(Wrong("clock", f"x {factor} from call {calls} on", when(
        lambda self, scene, states, k, n=calls: _counting(self) >= n, pulled, factor))
      for calls, factor in ((60, 1.01), (80, 0.99), (90, 1.005))),
    Wrong("clock", "every tenth call", when(lambda self, *_: _counting(self) % 10 == 0, pulled, 1.01)),
    Wrong("clock", "after 3 s of its own time", when(lambda self, scene, states, k: states.t[k] >= 3.0, pulled, 1.01)),
    Wrong("clock", "before .3 s of its own time", when(lambda self, scene, states, k: states.t[k] < 0.3, pulled, 1.01)),
    *(Wrong("samples", f"right for {name}", when(place, pulled, 1.01)) for name, place in (
        ("101 samples", lambda self, scene, *_: scene.samples != 101),
        ("a run of 4 s", lambda self, scene, *_: scene.duration != 4.0),
        ("many samples", lambda self, scene, *_: scene.samples < 50),
        ("even samples", lambda self, scene, states, k: k % 2 == 1))),
    Wrong("samples", "states of the time before, in the last tenth", reporting(lambda self, scene, s: {
        name: np.concatenate([getattr(s, name)[:90], getattr(s, name)[89:-1]])[:len(s.t)] for name in "xRvw"})),
    *(Wrong("frame", f"{name}", when(place, change, factor)) for name, place, change, factor in (
        ("gravity along z alone", lambda self, scene, *_: bool(np.abs(scene.gravity[:2]).max() > 0), pulled, 1.01),
        ("far from the origin", lambda self, scene, states, k: abs(states.x[k, -1, 0]) > 1.0, pulled, 1.01),
        ("east of the origin", lambda self, scene, states, k: states.x[k, 0, 1] > 0.0, pulled, 1.01),
        ("moving up", lambda self, scene, states, k: states.v[k, -1, 2] > 0.0, pulled, 1.002),
        ("wind", lambda *_: True, blown, 1.001))),
    *(Wrong("places", f"{name}", when(place, change, factor)) for name, place, change, factor in (
        ("fast", lambda self, scene, s, k: np.abs(s.w[k]).max() > 4.0, pulled, 1.01),
        ("slow", lambda self, scene, s, k: np.abs(s.w[k]).max() < 2.0, pulled, 1.01),
        ("leaning", lambda self, scene, s, k: s.R[k, 0, 2, 2] < 0.7, heavier, 1.05),
        ("stretched", lambda self, scene, s, k: np.linalg.norm(s.x[k, -1]) > 2.97, pulled, 1.005),
        ("bent", lambda self, scene, s, k: np.linalg.norm(s.x[k, -1]) < 2.7, pulled, 1.01),
        ("spinning one way", lambda self, scene, s, k: s.w[k, 0, 2] > 1.2, heavier, 1.05))),
    *(Wrong("outputs", f"{name}", reporting(change), ("fourth",)) for name, change in (
        ("x of the last body off by 0.1 mm", lambda self, scene, s: {"x": s.x + SLIP}),
        ("v x 1.0001", lambda self, scene, s: {"v": 1.0001 * s.v}),
        ("w x 1.0001", lambda self, scene, s: {"w": 1.0001 * s.w}),
        ("w filtered", lambda self, scene, s: {"w": np.concatenate([s.w[:1], 0.9 * s.w[1:] + 0.1 * s.w[:-1]])}),
        ("v of the second half a sample late", lambda self, scene, s: {
            "v": np.concatenate([s.v[:50], s.v[49:-1]])[:len(s.t)]}),
        ("attitudes of the second body turned by 1e-4", lambda self, scene, s: {
            "R": np.concatenate([s.R[:, :-1], s.R[:, -1:] @ [[1, -1e-4, 0], [1e-4, 1, 0], [0, 0, 1]]], axis=1)}),
        ("noise of 1e-6", lambda self, scene, s: {
            "x": s.x + 1e-6 * np.random.default_rng(1).standard_normal(s.x.shape)}))),
    *(Wrong("float32", f"{'all' if len(fields) > 1 else fields} rounded, undeclared", reporting(
        lambda self, scene, s, fields=fields: {name: getattr(s, name).astype(np.float32).astype(float)
                                               for name in fields}), ("fourth",), ("single_pendulum",))
      for fields in ("x", "v", "w", "R", "xRvw")),
    *(Wrong("history", f"{name}", when(place, pulled, factor)) for name, place, factor in (
        ("after a path of 4 m", lambda self, scene, s, k: _path(s, k) > 4.0, 1.01),
        ("after a path of 8 m", lambda self, scene, s, k: _path(s, k) > 8.0, 1.005),
        ("once it was fast", lambda self, scene, s, k: np.abs(s.w[:k + 1]).max() > 4.0, 1.01),
        ("since it came back", lambda self, scene, s, k: k > 30 and s.v[k - 20, -1, 2] > 0, 1.01),
        ("while it had a past", lambda self, scene, s, k: k >= 20, 1.01))),
    # Kinds that share nothing with the mends of the judge.
    Wrong("late", "gravity drifts by 2.5e-4 a second", Drifting, ("first", "fourth")),
    Wrong("places", "inertia grows with the angle", Leaning, ("second", "fourth")),
    Wrong("places", "slowed where it is slow", Sleepy, ("RK4",)),
    Wrong("clock", "every seventh step", EverySeventh, ("RK4",)),
    Wrong("clock", "steps a little shorter than told", SlowClock, ("RK4",)),
    Wrong("history", "after 700 steps of a run", Overflowing, ("RK4",)),
    Wrong("history", "what the first scene left behind", Stale, FOURTH),
    Wrong("samples", "undone in the second half of every interval", Halves, ("RK4",)),
    Wrong("places", "energy injected by a projection", Injected, ("RK4",)),
    Wrong("places", "a coupling that loses force", Coupled, ("RK4",)),
    Wrong("float32", "within, now and then", Rounded, ("RK4",), ("single_pendulum",)),
    Wrong("claims", "a tolerance that is not kept", Careless, ("DP5",)),
    Wrong("claims", "a tolerance a thousand times too large", Looser, ("DP5",), ("single_pendulum", "double_pendulum")),
    Wrong("float32", "declared, and gravity 2e-3 off", Hiding, ("RK4",)),
    Wrong("truth", "interpolated, with noise of 1e-6", interpolated(_noisy), FOURTH),
    Wrong("truth", "interpolated, with a wave of 1e-5", interpolated(lambda s, h: {
        "x": s.x + 1e-5 * np.sin(3.0 * s.t)[:, None, None], "v": s.v + 3e-5 * np.cos(3.0 * s.t)[:, None, None]}),
          FOURTH),
    Wrong("outputs", "v off by 1e-6 m/s, x right", reporting(lambda self, scene, s: {"v": s.v + SLIP / 100}), FOURTH),
)
