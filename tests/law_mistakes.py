"""Engines with one mistake each in a force law of a joint: lieeuler on another scene than the one that it is given.

Each scene has events, and each mistake one that a user's engine has been seen to make: a coefficient off, a law
regularised or left out, a control that comes late, a limit on the wrong side.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

from crosscheck.adapters.base import StandIn
from crosscheck.adapters.lieeuler import LieEuler
from crosscheck.scene.functions import TimeFunction
from crosscheck.scene.laws import DryFriction, Limits
from crosscheck.scene.model import Force
from tests.references.law_scenes import arm, pendulum, servo, slide

SINE = {"type": "sine", "terms": [[0.5, 6.0, 0.0]], "offset": 0.1}

SCENES = {
    "friction": lambda folder: pendulum(folder, {"position": 1.2, "dry_friction": 0.5}, duration=2.0, samples=21),
    "breakaway": lambda folder: slide(folder, {"position": 1.0, "dry_friction": {"sliding": 0.3, "static": 0.42},
                                               "stiffness": 4.0}, duration=5.0, samples=26),
    "lifted": lambda folder: pendulum(folder, {"position": 0.05, "dry_friction": {"sliding": 0.5, "static": 0.8}},
                                      forces=[{"type": "joint_torque", "joint": "h", "torque": {
                                          "type": "sine", "terms": [[1.5, 3.0, 0.0]]}}], duration=2.0, samples=21),
    "bounce": lambda folder: pendulum(folder, {"position": 1.2, "limits": {"lower": -0.5, "restitution": 0.5}},
                                      duration=2.0, samples=21),
    "stop": lambda folder: pendulum(folder, {"position": 1.2, "limits": {"lower": -0.5}}, duration=1.5, samples=21),
    "soft": lambda folder: pendulum(folder, {"position": 1.2, "limits": {"lower": -0.5, "stiffness": 60.0,
                                                                        "damping": 0.4}}, duration=1.5, samples=21),
    "saturated": lambda folder: pendulum(folder, forces=[servo("h", effort_limit=[-2.0, 3.0])], duration=1.5,
                                         samples=21),
    "motor": lambda folder: pendulum(folder, forces=[servo("h", target=2.0, effort_limit=8.0, no_load_speed=5.0)],
                                     duration=1.5, samples=21),
    "following": lambda folder: pendulum(folder, forces=[servo("h", target=SINE, feedforward=0.3)], duration=1.5,
                                         samples=21),
    "sampled": lambda folder: pendulum(folder, forces=[servo("h", derivative=1.0, period=0.025, delay=1)],
                                       duration=1.5, samples=21),
    "two": lambda folder: arm(folder, {"position": 1.0, "dry_friction": 0.3}, {"position": 0.5, "dry_friction": 0.2},
                              duration=1.0, samples=21),
}
"""Scenes of one and two joints, by name."""


@dataclasses.dataclass(frozen=True)
class Mistake:
    """What is wrong, in which scene, and the scene that such an engine integrates."""

    what: str
    scene: str
    change: Callable
    methods: tuple[str, ...] = ("rkmk4", "DAE1L_LSE")


def joint(change, k=0):
    """Changes joint k of a scene."""
    return lambda scene: scene.replace(joints=tuple(
        change(each) if i == k else each for i, each in enumerate(scene.joints)))


def friction(change, k=0):
    """Changes the dry friction of joint k."""
    return joint(lambda each: dataclasses.replace(each, dry_friction=tuple(change(f) for f in each.dry_friction)), k)


def limits(change):
    """Changes the limits of the first joint."""
    return joint(lambda each: dataclasses.replace(each, limits=tuple(change(given) for given in each.limits)))


def control(**changes):
    """Changes keys of the servo; a function gets the value before."""
    def changed(force):
        if force.type != "servo":
            return force
        given = {key: value(force.parameters.get(key)) if callable(value) and not isinstance(value, TimeFunction)
                 else value for key, value in changes.items()}
        return dataclasses.replace(force, parameters={**force.parameters, **given})

    return lambda scene: scene.replace(forces=tuple(changed(force) for force in scene.forces))


def times(factor):
    """The value before, times a factor."""
    return lambda value: factor * value


def instead(**keys):
    """A law like a servo in the place of dry friction: it pushes against the rate up to a limit."""
    def change(scene):
        bare = joint(lambda each: dataclasses.replace(each, dry_friction=()))(scene)
        return with_servo(bare, **keys)

    return change


def with_servo(scene, name="h", **keys):
    """The scene with a servo of one joint."""
    return scene.replace(forces=(*scene.forces, Force("servo", None, None, name, keys)))


def replaced(**changes):
    """Changes keys of a law's record; a function gets the value before."""
    return lambda law: dataclasses.replace(law, **{
        key: value(getattr(law, key)) if callable(value) else value for key, value in changes.items()})


MISTAKES = (
    Mistake("friction 5 % high", "friction", friction(replaced(sliding=times(1.05), static=times(1.05)))),
    Mistake("friction 5 % low", "friction", friction(replaced(sliding=times(0.95), static=times(0.95)))),
    Mistake("friction 1 % high", "friction", friction(replaced(sliding=times(1.01), static=times(1.01)))),
    Mistake("no friction", "friction", joint(lambda each: dataclasses.replace(each, dry_friction=()))),
    Mistake("a damper instead of friction", "friction", instead(derivative=0.5)),
    Mistake("friction regularised at .1 rad/s", "friction", instead(derivative=5.0, effort_limit=(-0.5, 0.5))),
    Mistake("friction regularised at .01 rad/s", "friction", instead(derivative=50.0, effort_limit=(-0.5, 0.5))),
    Mistake("more friction on the way back", "friction", lambda scene: with_servo(
        scene, derivative=100.0, effort_limit=(-0.025, 0.0))),
    Mistake("more friction on the way there", "friction", lambda scene: with_servo(
        scene, derivative=100.0, effort_limit=(0.0, 0.025))),
    Mistake("friction as a constant torque", "friction", instead(feedforward=0.5)),
    Mistake("static friction is ignored", "lifted", friction(replaced(static=0.5))),
    Mistake("static friction is doubled", "lifted", friction(replaced(static=times(2.0)))),
    Mistake("sliding friction is static friction", "lifted", friction(replaced(sliding=0.8))),
    Mistake("static friction is sliding friction", "breakaway", friction(replaced(sliding=0.42))),
    Mistake("friction on the wrong joints", "two", lambda scene: scene.replace(joints=tuple(
        dataclasses.replace(each, dry_friction=other.dry_friction)
        for each, other in zip(scene.joints, scene.joints[::-1], strict=True)))),
    Mistake("friction on one of two joints", "two", joint(lambda each: dataclasses.replace(each, dry_friction=()), 1)),
    Mistake("the same friction on both joints", "two", friction(lambda _: DryFriction(0.3, 0.3), 1)),
    Mistake("restitution 0 instead of .5", "bounce", limits(replaced(restitution=0.0))),
    Mistake("restitution 1 instead of .5", "bounce", limits(replaced(restitution=1.0))),
    Mistake("restitution .51 instead of .5", "bounce", limits(replaced(restitution=0.51)), ("rkmk4",)),
    Mistake("restitution .6 instead of .5", "bounce", limits(replaced(restitution=0.6))),
    Mistake("a limit on the wrong side", "bounce", limits(lambda _: Limits(upper=1.3, restitution=0.5))),
    Mistake("a limit is ignored", "bounce", joint(lambda each: dataclasses.replace(each, limits=()))),
    Mistake("a limit 1 % off", "bounce", limits(replaced(lower=times(1.01))), ("rkmk4",)),
    Mistake("a limit 5 % off", "bounce", limits(replaced(lower=times(1.05)))),
    Mistake("a limit in half the angle", "stop", limits(replaced(lower=times(0.5)))),
    Mistake("it bounces off a stop without restitution", "stop", limits(replaced(restitution=0.2))),
    Mistake("a spring for a stop", "stop", limits(replaced(stiffness=1300.0, damping=25.0))),
    Mistake("the stop sticks", "stop", joint(lambda each: dataclasses.replace(
        each, dry_friction=(DryFriction(0.02, 3.0),)))),
    Mistake("a stop 5 % softer", "soft", limits(replaced(stiffness=times(0.95)))),
    Mistake("a soft stop without damping", "soft", limits(replaced(damping=0.0))),
    Mistake("a soft stop is rigid", "soft", limits(replaced(stiffness=None, damping=0.0))),
    Mistake("saturation is ignored", "saturated", control(effort_limit=None)),
    Mistake("the limit of the other side", "saturated", control(effort_limit=(-2.0, 2.0))),
    Mistake("gear twice", "saturated", control(proportional=times(4.0), derivative=times(4.0))),
    Mistake("gain 2 % low", "saturated", control(proportional=times(0.98))),
    Mistake("no damping in the servo", "saturated", control(derivative=0.0)),
    Mistake("target off by .02 rad", "saturated", control(target=1.02)),
    Mistake("the motor's line is ignored", "motor", control(no_load_speed=None)),
    Mistake("no-load speed 5 % high", "motor", control(no_load_speed=times(1.05))),
    Mistake("target velocity is ignored", "following", control(target_velocity=0.0)),
    Mistake("feedforward is ignored", "following", control(feedforward=0.0)),
    Mistake("the sign of feedforward", "following", control(feedforward=times(-1.0))),
    Mistake("sampled instead of continuous", "following", control(period=0.025)),
    Mistake("continuous instead of sampled", "sampled", control(period=None, delay=0)),
    Mistake("delay is ignored", "sampled", lambda scene: control(delay=0, held=lambda held: (held or ())[:1])(scene)),
    Mistake("half the period", "sampled", control(period=0.0125)),
)
"""Forty and more."""


class Wrong(StandIn):
    """lieeuler with a mistake."""

    name = "fake"

    def __init__(self, mistake):
        super().__init__(LieEuler())
        self.mistake = mistake

    def run(self, scene, spec):
        """The run of the other scene, at the output times of this one."""
        return self._engine.run(self.mistake.change(scene), spec)
