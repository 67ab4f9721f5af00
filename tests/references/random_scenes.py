"""Seeded scenes on which references may fail: released at rest, level, symmetric, in equilibrium, loops, springs."""

import dataclasses

import numpy as np

from crosscheck.scene.model import GROUND, Body, Force, Joint, Scene
from tests.scene_making import JOINT_TYPES, drawn, make_scene, random_body, random_joint

KINDS = ("rest", "level", "symmetric", "equilibrium", "loop", "springs", "level chain", "moving")
BRIEF = {"duration": 1.0, "samples": 6}
X, Y, Z = np.eye(3)


def bar(rng, name, place, length, speed=0.0):
    """A bar along x from its hinge about y, as symmetric as possible."""
    mass = rng.uniform(0.5, 2.0)
    J = mass * length**2 * np.diag([0.01, 0.09, 0.09])
    return Body(name, mass, J, [1, 0, 0, 0], speed * Y, place, np.zeros(3))


def still(scene):
    """The scene with all bodies at rest."""
    return scene.replace(bodies=tuple(dataclasses.replace(body, angular_velocity=np.zeros(3), velocity=np.zeros(3))
                                      for body in scene.bodies))


def pair(rng, kind):
    """Two bodies, the second on a joint of a random type."""
    def draw():
        bodies = [random_body(rng, "first"), random_body(rng, "second")]
        return make_scene(bodies, [random_joint(rng, "spherical", GROUND, 0, "base"),
                                   random_joint(rng, kind, 0, 1)], **BRIEF)
    return drawn(draw)


def spring(rng, child, damping=0.0):
    """A spring from the ground to a body."""
    return Force("linear_spring", GROUND, child, None, {
        "parent_point": tuple(rng.uniform(1.0, 2.0, 3)), "child_point": tuple(rng.uniform(-0.3, 0.3, 3)),
        "stiffness": rng.uniform(5.0, 60.0), "free_length": rng.uniform(0.0, 0.8), "damping": damping})


def level(rng, count):
    """Bars on hinges in a row, released exactly level."""
    joints, bodies, at = [], [], 0.0
    for k in range(count):
        length = rng.uniform(0.3, 1.0)
        bodies.append(bar(rng, f"bar {k}", (at + 0.5 * length) * X, length))
        arm = 0.5 * lengths_of(bodies[k - 1]) if k else 0.0
        joints.append(Joint(f"hinge {k}", "revolute", k - 1 if k else GROUND, k, arm * X, -0.5 * length * X, Y, Y))
        at += length
    return Scene("level", tuple(bodies), tuple(joints), (), -9.81 * Z, **BRIEF)


def lengths_of(body):
    """Length of a bar of `bar`."""
    return float(np.sqrt(body.inertia[1, 1] / (0.09 * body.mass)))


def hanging(rng, upright):
    """A body at rest straight below its ball joint, or above it."""
    body = dataclasses.replace(random_body(rng, "body"), attitude=[1, 0, 0, 0], angular_velocity=np.zeros(3),
                               velocity=np.zeros(3), inertia=np.diag(rng.uniform(0.1, 0.12, 3)))
    arm = rng.uniform(0.3, 1.0) * (-Z if upright else Z)
    body = dataclasses.replace(body, position=-arm)
    return Scene("equilibrium", (body,), (Joint("ball", "spherical", GROUND, 0, np.zeros(3), arm),), (), -9.81 * Z,
                 **BRIEF)


def symmetric(rng):
    """A top of equal moments that spins exactly about its axis or precesses."""
    a, c = rng.uniform(0.1, 0.3), rng.uniform(0.05, 0.1)
    tilt = rng.uniform(0.2, 1.3)
    arm = rng.uniform(0.2, 0.6)
    body = Body("top", 1.0, np.diag([a, a, c]), [np.cos(tilt / 2), np.sin(tilt / 2), 0, 0],
                [0, 0, rng.uniform(5, 40)], arm * np.array([0, -np.sin(tilt), np.cos(tilt)]), np.zeros(3))
    return Scene("top", (body,), (Joint("ball", "spherical", GROUND, 0, np.zeros(3), -arm * Z),), (), -9.81 * Z,
                 **BRIEF)


def loop(rng):
    """Two bodies on the ground and a rod between them."""
    def draw():
        bodies = [random_body(rng, "first"), random_body(rng, "second")]
        joints = [Joint("left", "spherical", GROUND, 0, np.zeros(3), (0.0, 0.5, 0.8)),
                  Joint("right", "spherical", GROUND, 1, (1.2, 0.3, 0.0), (0.2, 0.0, 0.9)),
                  random_joint(rng, "distance", 0, 1)]
        return make_scene(bodies, joints, **BRIEF)
    return drawn(draw)


def scene_of(seed):
    """The scene of a seed; kinds take turns."""
    rng = np.random.default_rng([15, seed])
    kind = KINDS[seed % len(KINDS)]
    joint = JOINT_TYPES[(seed // len(KINDS)) % len(JOINT_TYPES)]
    if kind == "rest":
        return still(pair(rng, joint))
    if kind in ("level", "level chain"):
        return level(rng, 1 if kind == "level" else 2 + seed % 2)
    if kind == "symmetric":
        return symmetric(rng)
    if kind == "equilibrium":
        return hanging(rng, seed // len(KINDS) % 2 == 0)
    if kind == "loop":
        return loop(rng)
    made = pair(rng, joint)
    if kind == "springs":
        made = made.replace(forces=(spring(rng, 1, 0.3), spring(rng, 0)))
    return made
