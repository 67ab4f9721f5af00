"""Engines whose model or stepping is wrong: builders of the mistakes in `tests.diagnosis.mistakes`."""

from __future__ import annotations

import dataclasses

import numpy as np
from scipy.spatial.transform import Rotation

from crosscheck import adapters
from crosscheck.diagnosis.variants import close
from tests.diagnosis import misbuilt
from tests.engines.equations import Flaws
from tests.engines.stepper import Misbuilt, Stepper


def altered(change):
    """An engine that runs another scene; `change(rng, scene)` -> (scene -> scene)."""
    return lambda rng, scene: Misbuilt(adapters.get("lieeuler"), (change(rng, scene),))


def flawed(**draw):
    """An engine whose stepper has a flaw; values may be functions of the random numbers and the scene."""
    return lambda rng, scene: Stepper(Flaws(**{name: value(rng, scene) if callable(value) else value
                                               for name, value in draw.items()}))


def claiming(**draw):
    """As `flawed`, by an engine that claims to hold all levels."""
    return lambda rng, scene: Stepper(Flaws(**draw), frozenset({"position", "velocity", "acceleration"}))


def near(low, high):
    """A factor off one by a size in these limits, to either side."""
    return lambda rng, scene=None: misbuilt.factor(rng, low, high)


def some(low, high):
    """A number between these, uniform in its logarithm."""
    return lambda rng, scene=None: float(np.exp(rng.uniform(np.log(low), np.log(high))))


def scaled(which, **powers):
    """Mass, inertia times one random factor, of one body (by index from the end) or of all (None)."""
    def change(rng, scene):
        s = misbuilt.factor(rng, 0.02, 0.4)
        chosen = range(scene.n) if which is None else (which % scene.n,)
        return lambda given: misbuilt._bodies(given, lambda k, body: dataclasses.replace(
            body, **{name: s**power * getattr(body, name) for name, power in powers.items()}) if k in chosen else body)
    return change


def exchanged(*names):
    """The named properties of the first two bodies exchanged."""
    def change(rng, scene):
        return lambda s: misbuilt._bodies(s, lambda k, body: dataclasses.replace(
            body, **{name: getattr(s.bodies[1 - k], name) for name in names}) if k < 2 else body)
    return change


def products(factor, which=None):
    """Products of inertia times a factor."""
    def change(rng, scene):
        return lambda s: misbuilt._bodies(s, lambda k, body: dataclasses.replace(
            body, inertia=body.inertia * np.where(np.eye(3, dtype=bool), 1.0, factor))
            if which is None or k == which % s.n else body)
    return change


def joints(change):
    """Anchors altered and bodies moved to where the joints then put them."""
    def made(rng, scene):
        return lambda s: misbuilt.replaced(s, tuple(change(k, joint) for k, joint in enumerate(s.joints))) or s
    return made


def shifted(side, body=-1, placed=True):
    """One anchor of the joint of a body moved; its start moved with it, or kept."""
    def change(rng, scene):
        d = rng.uniform(0.02, 0.1) * misbuilt.unit(rng)

        def changed(s):
            last = body % len(s.joints)
            joints = tuple(dataclasses.replace(joint, **{side: getattr(joint, side) + d}) if k == last else joint
                           for k, joint in enumerate(s.joints))
            return misbuilt.replaced(s, joints) if placed else s.replace(joints=joints)
        return changed
    return change


@dataclasses.dataclass
class Behind:
    """lieeuler's methods, whose functions of time come a part of a step late."""

    part: float
    elements = ("joint_torque", "function")

    def __getattr__(self, name):
        return getattr(adapters.get("lieeuler"), name)

    def run(self, scene, spec):
        """With the first force's function delayed."""
        motor = scene.forces[0]
        late = {key: value.delayed(self.part * spec.step) if value in motor.functions else value
                for key, value in motor.parameters.items()}
        return adapters.get("lieeuler").run(scene.replace(forces=(
            dataclasses.replace(motor, parameters=late), *scene.forces[1:])), spec)


def attachment(rng, scene):
    """The point of a spring on the body moved."""
    d = rng.uniform(0.02, 0.1) * misbuilt.unit(rng)

    def change(s):
        force = s.forces[0]
        point = tuple(np.asarray(force.parameters["child_point"]) + d)
        return s.replace(forces=(dataclasses.replace(force, parameters=force.parameters | {"child_point": point}),
                                 *s.forces[1:]))
    return change


def armed(scene):
    """A rotor in every joint that may have one."""
    return scene.replace(joints=tuple(dataclasses.replace(joint, armature=tuple(
        0.02 * (k + 1) for _ in joint.kind.coordinates)) if joint.kind.is_elastic else joint
        for k, joint in enumerate(scene.joints)))


def rotorless(rng, scene):
    """An engine that knows of armature and leaves it out."""
    made = Misbuilt(adapters.get("lieeuler"), (lambda s: s.replace(joints=tuple(
        dataclasses.replace(joint, armature=()) for joint in s.joints)),))
    made.elements = ("armature", "function", "joint_force", "joint_torque")
    return made


def tilted(rng, scene):
    """The axes of the last joint that has two, turned by a degree or two and seen from the start in either body."""
    Q = Rotation.from_rotvec(rng.uniform(0.02, 0.04) * misbuilt.unit(rng)).as_matrix()

    def change(s):
        k = max(k for k, joint in enumerate(s.joints) if joint.child_axis is not None)
        joint, place = s.joints[k], [np.eye(3) if body < 0 else s.R0[body] for body in (
            s.joints[k].parent, s.joints[k].child)]
        axes = [Q @ R @ axis for R, axis in zip(place, (joint.parent_axis, joint.child_axis), strict=True)]
        return close(s.replace(joints=(*s.joints[:k], dataclasses.replace(joint, **{
            name: R.T @ axis for name, R, axis in zip(("parent_axis", "child_axis"), place, axes, strict=True)}),
            *s.joints[k + 1:]))) if s.joints[k].parent_axis is not None else s
    return lambda s: change(s) if any(joint.child_axis is not None for joint in s.joints) else s


@dataclasses.dataclass
class Limited:
    """lieeuler's methods with a limit: `most` steps, after which nothing moves, or none below `least` (s)."""

    most: float = np.inf
    least: float = 0.0

    def __getattr__(self, name):
        return getattr(adapters.get("lieeuler"), name)

    def run(self, scene, spec):
        """Within the limit."""
        raw = adapters.get("lieeuler").run(scene, dataclasses.replace(spec, step=max(spec.step, self.least)))
        last = int(np.flatnonzero(scene.t <= self.most * raw.step * (1 + 1e-9))[-1])
        raw.states = dataclasses.replace(raw.states, a=None, alpha=None, lam=None, **{
            name: getattr(raw.states, name)[np.minimum(np.arange(scene.samples), last)] for name in "xRvw"})
        return raw


def gravity_scaled(rng, scene):
    """Gravity by a factor."""
    s = misbuilt.factor(rng, 0.005, 0.3)
    return misbuilt.gravity(lambda g: s * g)


def one_moment(rng, scene):
    """One moment of inertia of the first body."""
    added = rng.uniform(0.005, 0.02)
    return misbuilt.inertia(lambda given, k: given.inertias[k] + added * np.diag([1.0, 0.0, 0.0]), 0)


def turned(rng, scene):
    """Inertias given in axes turned against the body's."""
    Q = Rotation.from_rotvec(rng.uniform(0.2, 0.8) * misbuilt.unit(rng)).as_matrix()
    return misbuilt.inertia(lambda s, k: Q @ s.inertias[k] @ Q.T)
