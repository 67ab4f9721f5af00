"""An engine of one joint in NumPy alone, symplectic Euler with laws as impulses of a step, and mistakes in its lines.

It shares nothing with lieeuler, nor with the references: a hinge or a slide of the ground, in its own coordinate, as
in `tests.gate.mechanics`.
"""

from __future__ import annotations

import math

import numpy as np

from crosscheck.adapters.base import Engine, RawRun, steps_per_sample
from crosscheck.scene.coordinates import at_start
from crosscheck.scene.functions import at
from crosscheck.scene.states import States
from tests.gate.mechanics import Hinge, Slide
from tests.references.law_scenes import pendulum, servo, slide

PUSH = {"type": "sine", "terms": [[2.0, 5.0, 0.0]]}
SCENES = {
    "carriage": lambda folder: slide(folder, {"velocity": 0.6, "dry_friction": {"sliding": 0.5, "static": 0.8}},
                                     forces=[{"type": "servo", "joint": "s", "feedforward": PUSH}], duration=2.0,
                                     samples=41),
    "drop": lambda folder: slide(folder, {"position": 0.3, "dry_friction": 0.8, "limits": {
        "lower": 0.0, "restitution": 0.6}}, gravity=(-5.0, 0.0, 0.0), samples=41),
    "turns": lambda folder: pendulum(folder, {"dry_friction": 0.2}, forces=[servo(
        "h", target=4.0, effort_limit=9.0, no_load_speed=12.0)], duration=1.5, samples=61),
    "encoder": lambda folder: slide(folder, {"velocity": 1.0}, forces=[servo(
        "s", target=0.2, derivative=2.0, feedforward=0.5, period=0.02, delay=1, effort_limit=6.0)], samples=41),
    "corner": lambda folder: pendulum(folder, {"position": -0.8, "velocity": 1.0, "dry_friction": 0.3, "limits": {
        "upper": 0.2, "restitution": 0.3}}, samples=41),
}
"""Scenes that no other corpus has, by name."""

MISTAKES = {
    "friction as large as the normal force": "turns", "friction that grows with the rate": "carriage",
    "static friction that decays with the rate": "carriage", "what rests stays at rest": "carriage",
    "friction stops with the weight": "drop", "a restitution that falls with the speed": "drop",
    "friction takes part in an impact": "corner", "a stop with a margin": "corner",
    "the cut before the damping": "turns", "the motor's line against the motion": "turns",
    "the error of a target within half a turn": "turns", "the first sample acts at once": "encoder",
    "a rate from two samples": "encoder", "the feedforward is not held back": "encoder",
}
"""What is wrong, and the scene in which it shows."""


class Impulses(Engine):
    """Symplectic Euler of order 1 with friction, stops and servos, without or with one of `MISTAKES`."""

    name = "fake"
    methods = ("Plain",)
    forms = ("tree",)

    def __init__(self, wrong=""):
        self.wrong = wrong

    def version(self):
        return "1"

    def documented_order(self, scene, spec):
        return 1

    def held_levels(self, scene, spec):
        return frozenset(("position", "velocity", "acceleration"))

    def unsupported(self, scene, spec):
        return None

    def run(self, scene, spec):
        """All steps of one joint, then the states of its body."""
        per, h = steps_per_sample(scene, spec.step)
        q, u = (float(part[0]) for part in at_start(scene)[scene.joints[0].name])
        self.begin(scene, q)
        rows = [(q, u)]
        for step in range(per * (scene.samples - 1)):
            q, u = self.advance(step, h, q, u)
            if (step + 1) % per == 0:
                rows.append((q, u))
        states = self.model.report(np.array(rows) - [self.turns, 0.0])
        return RawRun(States(scene.t, *(states[name] for name in "xRvw")), 1e-6, step + 1, h, form="tree")

    def begin(self, scene, q):
        """What a run from the coordinate q needs of a scene."""
        joint = scene.joints[0]
        self.model = (Hinge if joint.type == "revolute" else Slide)(scene.replace(forces=()))
        self.mass = self.model.J if joint.type == "revolute" else self.model.m
        self.turns = q - self.model.start[0]  # the model counts none
        self.friction = joint.dry_friction[0] if joint.dry_friction else None
        self.limits = joint.limits[0] if joint.limits else None
        self.servos = [law for _, law in scene.servos.values()]
        self.waiting = [list(law.held) or [0.0] * (law.delay + 1) for law in self.servos]
        self.seen, self.fresh = None, self.servos and not self.servos[0].held

    def advance(self, step, h, q, u):
        """One step: forces, then friction as an impulse that stops at most, then the stop."""
        load = self.mass * self.model.rate(0.0, (q - self.turns, u))[1]
        load += sum(self.effort(k, law, step, h, q, u) for k, law in enumerate(self.servos))
        moved = u + h * load / self.mass
        if self.friction is not None:
            moved = self.rubbed(h, q, u, moved, load)
        q, before = q + h * moved, moved
        if self.limits is not None:
            for side, end in ((-1, self.limits.lower), (1, self.limits.upper)):
                if self.wrong == "a stop with a margin":
                    end -= 0.01 * side
                if side * (q - end) > 0 and side * before > 0:
                    e = self.limits.restitution
                    if self.wrong == "a restitution that falls with the speed":
                        e -= 0.05 * abs(before)
                    q, moved = end, -e * before
                    if self.wrong == "friction takes part in an impact":
                        moved -= math.copysign(min(abs(moved), 0.5 * self.friction.sliding), moved)
        return q, moved

    def rubbed(self, h, q, u, moved, load):
        """The rate after friction."""
        c, static = self.friction.sliding, self.friction.static
        if self.wrong == "friction as large as the normal force":
            c = static = c * abs(math.cos(q))
        if self.wrong == "friction that grows with the rate":
            c += 0.05 * abs(u)
        if self.wrong == "static friction that decays with the rate":
            c += (static - c) * math.exp(-abs(u) / 0.1)
        if self.wrong == "friction stops with the weight":
            c = static = 0.0 if u > 0 else c
        if u == 0.0 and (abs(load) <= static or self.wrong == "what rests stays at rest"):
            return 0.0
        return math.copysign(max(abs(moved) - h * c / self.mass, 0.0), moved) if u * moved >= 0 else (
            0.0 if abs(load) <= static else moved + math.copysign(h * c / self.mass, u))

    def effort(self, k, law, step, h, q, u):
        """What a servo gives in this step."""
        if law.period is None:
            return self.wanted(law, step * h, q, u)
        every, first = round(law.period / h), round(law.phase / h)
        if (step - first) % every == 0 and step >= first:
            rate = u
            if self.wrong == "a rate from two samples":
                rate, self.seen = 0.0 if self.seen is None else (q - self.seen) / law.period, q
            given, pipe = self.wanted(law, step * h, q, rate), self.waiting[k]
            pipe.append(given)
            del pipe[0]
            if self.wrong == "the first sample acts at once" and self.fresh:
                pipe[:] = [given] * len(pipe)
            self.fresh = False
        late = self.waiting[k][0]
        return late + at(law.feedforward, 0.0) * (
            self.wrong == "the feedforward is not held back" and step * h < law.delay * law.period)

    def wanted(self, law, t, q, u):
        """The law of a servo, cut."""
        low, high = law.effort_limit or (-math.inf, math.inf)
        if law.no_load_speed is not None:
            left = max(0.0, 1.0 - abs(u) / law.no_load_speed)
            both = self.wrong == "the motor's line against the motion"
            low, high = low * (left if u < 0 or both else 1.0), high * (left if u > 0 or both else 1.0)
        error = at(law.target, t) - q
        if self.wrong == "the error of a target within half a turn":
            error = math.remainder(error, 2 * math.pi)
        pull = law.proportional * error + at(law.feedforward, t)
        damping = law.derivative * (at(law.target_velocity, t) - u)
        if self.wrong == "the cut before the damping":
            return min(max(pull, low), high) + damping
        return min(max(pull + damping, low), high)
