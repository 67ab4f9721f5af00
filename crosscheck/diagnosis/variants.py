"""Copies of a scene that show more of an engine's model than the scene's own motion.

The bodies begin in other consistent states. Ball joints take the place of hinges: a body on a hinge shows one number,
a free one its mass, its inertia and the gravity. Some copies have more springs.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from crosscheck.diagnosis.observe import Scale
from crosscheck.scene import assembly
from crosscheck.scene.model import GROUND, Force, Scene
from crosscheck.scene.starts import started
from crosscheck.scene.vectors import exponential

SEED = 20
TURNS = (0.8, 0.5, 0.2)
"""Angles (rad) by which attitudes are turned; the next one is taken if the joints cannot be closed."""


def moved(scene: Scene, scale: Scale, seed: int) -> Scene | None:
    """The scene from another start with closed joints: turned, and with other speeds. None if they cannot be closed."""
    for turn in TURNS:
        rng = np.random.default_rng([SEED, seed])
        drawn = [(rng.normal(size=3), rng.uniform(-1, 1, 3)) for _ in scene.bodies]
        turns, speeds = (np.array(part) for part in zip(*drawn, strict=True))
        turns *= turn / np.linalg.norm(turns, axis=1, keepdims=True)
        closed = close(started(scene, scene.x0, scene.R0 @ exponential(turns), scene.v0,
                               scene.w0 + 0.5 * scale.rate * speeds))
        if closed is not None:
            return closed
    return None


def close(scene: Scene) -> Scene | None:
    """The scene with its joints closed by the least change of its state; None if that fails."""
    if any(joint.kind.keeps_attitude for joint in scene.joints):
        return None  # their relative attitude is that of the start, so that another start would be another scene
    return assembly.closed(scene)


def on_balls(scene: Scene) -> tuple[Scene, tuple[int, ...]] | None:
    """The scene with ball joints in place of hinges, and the numbers of the loads that stay; None without hinges."""
    if not any(joint.kind.turns for joint in scene.joints):
        return None
    hinged = {joint.name for joint in scene.joints if joint.kind.turns}
    joints = tuple(
        dataclasses.replace(joint, type="spherical", parent_axis=None, child_axis=None, drive=None, mimic=None,
                            start=None, armature=(), damping=(), stiffness=(), rest_position=(), dry_friction=(),
                            limits=())
        if joint.name in hinged else dataclasses.replace(joint, mimic=None) for joint in scene.joints)
    kept = tuple(k for k, force in enumerate(scene.loads) if force.joint not in hinged)
    return scene.replace(joints=joints, forces=tuple(each for each in scene.forces if each.joint not in hinged)), kept


def sprung(scene: Scene, scale: Scale) -> Scene | None:
    """The scene with one more spring from the ground to every body; None if it has no spring.

    A spring that is too soft and a body that is too heavy make the same motion unless another spring pulls.
    """
    if not any(force.is_spring for force in scene.loads):
        return None
    rng = np.random.default_rng([SEED, 99])
    forces = []
    for k, body in enumerate(scene.bodies):
        forces.append(Force("linear_spring", GROUND, k, None, {
            "parent_point": tuple(body.position + scale.length * rng.uniform(-1, 1, 3)),
            "child_point": tuple(0.3 * scale.length * rng.uniform(-1, 1, 3)),
            "stiffness": float(0.3 * body.mass * scale.rate**2), "free_length": 0.0, "damping": 0.0}))
    return scene.replace(forces=(*scene.forces, *forces))
