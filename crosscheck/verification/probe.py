"""The engine is started again at states of its own run, in another world, at the steps that are asked for."""

from __future__ import annotations

import dataclasses

import numpy as np

from crosscheck.document import Record
from crosscheck.judge.segments import Pulled, Segment, reactions_of, rows
from crosscheck.judge.world import World
from crosscheck.running.attempt import Ran, Refused, attempt, lasting
from crosscheck.scene import mechanics
from crosscheck.scene.assembly import closed
from crosscheck.scene.model import Scene
from crosscheck.scene.sensors import SENSOR_TYPES, readings
from crosscheck.scene.spanning import spanning_tree
from crosscheck.scene.starts import restarted
from crosscheck.scene.states import States


@dataclasses.dataclass(frozen=True)
class Answer:
    """What an engine answers to a segment, in the run's own world."""

    states: States
    pulled: Pulled | None  # sums of reactions on each body, as of `segments.reactions_of`
    own: dict[str, np.ndarray]  # (T, n, k) readings and accelerations that it made less those of its states
    steps: int
    read: dict[str, np.ndarray] = dataclasses.field(default_factory=dict)  # (T, 1, k) readings with laws of joints in
    _rows: dict[str, np.ndarray] = dataclasses.field(default_factory=dict)

    def rows(self, segment: Segment) -> dict[str, np.ndarray]:
        """It less truth by quantity, (T - 1, n, k), at the outputs after the first."""
        if not self._rows:
            self._rows.update(rows(segment, self.states, self.pulled))
            true = readings(segment.start, segment.flowed.states) if self.read and segment.flowed is not None else {}
            self._rows.update({name: (each - true[name.removeprefix("sensor ")].reshape(each.shape))[1:]
                               for name, each in self.read.items() if name.removeprefix("sensor ") in true})
        return self._rows

    def within(self, segment: Segment) -> Answer:
        """The part of an answer to the whole run that is in a segment."""
        part, count = slice(segment.first, segment.last + 1), len(self.states.t) - 1
        cut = self.states.at(part)
        return Answer(dataclasses.replace(cut, t=cut.t - cut.t[0]),
                      None if self.pulled is None else (self.pulled[0][part], self.pulled[1][part]),
                      {name: each[part] for name, each in self.own.items()}, self.steps * segment.last // count,
                      {name: each[part] for name, each in self.read.items()})


class Probe:
    """How an engine is asked; `steps` counts what all its answers took, `why` the first refusal."""

    def __init__(self, run: Record, scene: Scene, length: float) -> None:
        self.run, self.whole = run, scene
        self.worlds = [World.drawn(scene, length, turned) for turned in (True, False)]
        self.steps, self.why, self.status = 0, "", "success"
        self.refused = False  # whether all that it said is that it cannot model the scene elsewhere

    def answer(self, scene: Scene, step: float | None, rtol: float | None) -> Answer | None:
        """The engine's answer to a scene at a step (s) or a tolerance; None where it does not run there."""
        while self.worlds:
            world = self.worlds[0]
            got = self._asked(world.scene(scene), step, rtol)
            if got is not None:
                return _brought_back(world, *got)
            if self.steps or len(self.worlds) == 1:
                break
            self.worlds.pop(0)  # it cannot be turned
        return None

    def elsewhere(self, scene: Scene, step: float | None, rtol: float | None) -> Answer | None:
        """The answer in the last world, which is another one than that of `answer`; None if there is but one."""
        world = self.worlds[-1]
        got = self._asked(world.scene(scene), step, rtol) if len(self.worlds) > 1 else None
        return None if got is None else _brought_back(world, *got)

    def repeat(self, step: float | None, rtol: float | None) -> Answer | None:
        """The whole run once more, at a step or a tolerance."""
        got = self._asked(self.whole, step, rtol)
        return None if got is None else answer_of(*got)

    def _asked(self, scene: Scene, step: float | None, rtol: float | None) -> tuple[Scene, States, int] | None:
        got = lasting(attempt(scene, self.run, step=step, rtol=rtol, monitor=False, derived=False))
        if not isinstance(got, Ran):
            self.refused = isinstance(got, Refused) and (self.refused or not self.why)
            self.why = self.why or got.why
            return None
        self.steps += got.raw.steps
        if got.raw.status != "success":
            self.status = got.raw.status
        return scene, got.raw.states, got.raw.steps


def answer_of(scene: Scene, states: States, steps: int) -> Answer:
    """The answer that states of a scene are; what it holds beyond states is compared with what follows from these."""
    pulled, own, read = None, {}, {}
    if states.lam is not None and not scene.has_laws:
        pulled = reactions_of(scene, states, states.lam)
    if states.a is not None and states.alpha is not None and not scene.has_laws:
        own = _accelerated(scene, states)
    derived = readings(scene, dataclasses.replace(states, a=None, alpha=None, lam=None, sensors=None)) if (
        states.sensors) else {}
    for sensor in scene.sensors:
        if sensor.name not in (states.sensors or {}):
            continue
        given, true = states.sensors[sensor.name], derived[sensor.name]  # type: ignore[index]
        if scene.has_laws and SENSOR_TYPES[sensor.type].dynamic:  # what acts does not follow from the state alone
            read[f"sensor {sensor.name}"] = given.reshape(len(given), 1, -1)
        else:
            if true.shape[1:] == (4,):  # a quaternion and its negative are the same attitude
                given = given * np.where(np.einsum("tk,tk->t", given, true) < 0.0, -1.0, 1.0)[:, None]
            own[f"sensor {sensor.name}"] = np.nan_to_num(given - true).reshape(len(true), 1, -1)
    return Answer(states, pulled, own, steps, read)


def _accelerated(scene: Scene, states: States) -> dict[str, np.ndarray]:
    """Accelerations less those of the states, in the middle and at the end; to solve for all takes long; else 0.

    With closed loops: opened by anything, rows that depend on each other are at odds, and lock a mechanism.
    """
    rows = [len(states.t) // 2, len(states.t) - 1]
    at = states.at(rows)
    if spanning_tree(scene)[1]:
        begun = [restarted(scene, states, k, 1.0) for k in rows]
        shut = [closed(each, scene) or each for each in begun]
        x, R, v, w = (np.array([getattr(each, name) for each in shut]) for name in ("x0", "R0", "v0", "w0"))
        at = dataclasses.replace(at, x=x, R=R, v=v, w=w)
    a, alpha, _ = mechanics.index1(scene, at.x, at.R, at.v, at.w, mechanics.torsion_angles(scene, at), at.t)
    found = {"acceleration": np.zeros_like(states.x), "angular acceleration": np.zeros_like(states.x)}
    found["acceleration"][rows], found["angular acceleration"][rows] = at.a - a, at.alpha - alpha
    return found


def _brought_back(world: World, there: Scene, states: States, steps: int) -> Answer:
    found, order = answer_of(there, states, steps), np.argsort(world.bodies)
    turned = {"acceleration": world.Q, "angular acceleration": np.eye(3)}
    pulled = None if found.pulled is None else (found.pulled[0][:, order] @ world.Q, found.pulled[1][:, order])
    return Answer(world.back(states, there), pulled, {
        name: each[:, order] @ turned[name] if name in turned else each for name, each in found.own.items()}, steps, {
        f"sensor {sensor.name}": each @ world.Q if sensor.frame == "world" and each.shape[-1] == 3 else each
        for sensor in there.sensors for each in [found.read.get(f"sensor {sensor.name}")] if each is not None})
