"""The engine is started again at states of its own run, in another world, at the steps that are asked for."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from crosscheck.document import Record
from crosscheck.judge.segments import Pulled, Segment, reactions_of, rows
from crosscheck.judge.world import World
from crosscheck.running.attempt import Ran, attempt, lasting
from crosscheck.scene.model import Scene, quaternion_from_rotation
from crosscheck.scene.sensors import SENSOR_TYPES, readings
from crosscheck.scene.starts import Configuration, bodies_at
from crosscheck.scene.states import States
from crosscheck.scene.vectors import exponential


@dataclasses.dataclass(frozen=True)
class Answer:
    """What an engine answers to a segment, in the run's own world."""

    states: States
    pulled: Pulled | None  # sums of reactions on each body, as of `segments.reactions_of`
    sensors: dict[str, np.ndarray]  # (T - 1, 1, k) readings that it made less those of its states
    steps: int

    def rows(self, segment: Segment) -> dict[str, np.ndarray]:
        """It less truth by quantity."""
        return rows(segment, self.states, self.pulled) | self.sensors


class Probe:
    """How an engine is asked; `steps` counts what all its answers took, `why` the first refusal."""

    def __init__(self, run: Record, scene: Scene, length: float) -> None:
        self.run = run
        self.worlds = [World.drawn(scene, length, turned) for turned in (True, False)]
        self.steps, self.why, self.status = 0, "", "success"

    def answer(self, scene: Scene, step: float | None, rtol: float | None) -> Answer | None:
        """The engine's answer to a scene at a step (s) or a tolerance; None where it does not run there."""
        while self.worlds:
            world = self.worlds[0]
            there = world.scene(scene)
            got = lasting(attempt(there, self.run, step=step, rtol=rtol, monitor=False, derived=False))
            if isinstance(got, Ran):
                self.steps += got.raw.steps
                if got.raw.status != "success":
                    self.status = got.raw.status
                return _brought_back(world, there, got.raw.states, got.raw.steps)
            self.why = self.why or got.why
            if self.steps or len(self.worlds) == 1:
                break
            self.worlds.pop(0)  # it cannot be turned
        return None


def _brought_back(world: World, there: Scene, states: States, steps: int) -> Answer:
    pulled, order = None, np.argsort(world.bodies)
    if states.lam is not None and not there.has_laws:
        force, torque = reactions_of(there, states, states.lam)
        pulled = force[:, order] @ world.Q, torque[:, order]
    own = {}
    if states.sensors:
        derived = readings(there, dataclasses.replace(states, a=None, alpha=None, lam=None, sensors=None))
        for sensor in there.sensors:
            if sensor.name in states.sensors and not (there.has_laws and SENSOR_TYPES[sensor.type].dynamic):
                gap = np.nan_to_num(states.sensors[sensor.name] - derived[sensor.name])
                own[f"sensor {sensor.name}"] = gap.reshape(len(gap), 1, -1)[1:]
    return Answer(world.back(states), pulled, own, steps)


def moved(scene: Scene, sizes: dict[str, float], eps: float, seed: int) -> Scene:
    """The scene from a start that differs by a rounding of its numbers."""
    rng = np.random.default_rng([seed, scene.n])
    x, turn, v, w = (eps * sizes[name] * rng.uniform(-1.0, 1.0, (scene.n, 3))
                     for name in ("position", "attitude", "velocity", "angular velocity"))
    return scene.replace(bodies=bodies_at(scene, Configuration(
        scene.x0 + x, quaternion_from_rotation(scene.R0 @ exponential(turn)), scene.v0 + v, scene.w0 + w)))


def answers(probe: Probe, scene: Scene, steps: Sequence[float], adaptive: bool) -> list[Answer] | None:
    """The answers at steps or tolerances; None if one of them is missing."""
    found = []
    for size in steps:
        each = probe.answer(scene, None if adaptive else size, size if adaptive else None)
        if each is None:
            return None
        found.append(each)
    return found
