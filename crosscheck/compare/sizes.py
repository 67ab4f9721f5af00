"""The size of each quantity along a motion, which its errors are relative to."""

from __future__ import annotations

import numpy as np

from crosscheck.errors import Unsupported
from crosscheck.scene import mechanics
from crosscheck.scene.model import GROUND, Scene
from crosscheck.scene.states import Motion, States

AT_REST = 1e-20
"""Share of the kinetic energy of a fall through the scene's length below which a motion is rounding: (100 eps)^2 of
speeds is 5e-28; what a start given with ten digits leaves is 1e-20."""


SHORTEST = 0.1
"""Lever (m) of a fall where no body hangs on a joint, or a shorter one: a tool or a toy in a hand."""


def length_of(scene: Scene) -> float:
    """The longest lever from a centre of mass to a joint, m; of a free body its radius of gyration."""
    levers = [float(np.linalg.norm(joint.child_anchor)) for joint in scene.joints if joint.child != GROUND]
    levers += [float(np.linalg.norm(joint.parent_anchor)) for joint in scene.joints if joint.parent != GROUND]
    masses, inertias = mechanics.weights(scene)
    gyration = np.sqrt(np.trace(inertias, axis1=1, axis2=2) / (2.0 * masses))
    return float(max([*levers, 0.0]) or gyration.max())


def natural_time(scene: Scene) -> float:
    """Time (s) in which the scene falls or turns by about a radian, at most its duration."""
    levers = [float(np.linalg.norm(joint.child_anchor)) for joint in scene.joints if joint.child != GROUND]
    fall = float(np.sqrt(np.linalg.norm(scene.gravity) / max([*levers, SHORTEST])))
    return 1.0 / max(fall, float(np.linalg.norm(scene.w0, axis=-1).max()), 1.0 / scene.duration)


def sizes(scene: Scene, motion: States) -> dict[str, float]:
    """By quantity, SI: the largest along the motion, NaN left out, and no less than a fall through the length gives.

    A position counts from the start, never from the origin. Reactions, as forces and torques of all joints on a body,
    have the size of the weight carried, or of what accelerates the bodies.
    """
    length = length_of(scene)

    def most(values: np.ndarray) -> float:
        return float(np.nanmax(np.linalg.norm(values, axis=-1), initial=0.0))

    gravity, spin = float(np.linalg.norm(scene.gravity)), most(motion.w)
    rate = max(spin, np.sqrt(gravity / length)) or most(motion.v) / length or 1.0
    length_moved = max(length, most(motion.x - motion.x[:1]))
    speed = max(most(motion.v), length * rate)
    found = {"position": length_moved, "attitude": 1.0, "velocity": speed, "angular velocity": rate,
             "orthogonality": 1.0, "energy": max(float(np.nanmax(mechanics.kinetic_energy(scene, motion), initial=0.0)),
                                                 mechanics.weights(scene)[0].min() * speed**2 / 2)}
    pull = max(gravity, length * rate**2, 0.0 if motion.a is None else most(motion.a))
    turned = max(rate**2, 0.0 if motion.alpha is None else most(motion.alpha))
    weight = float(scene.masses.sum()) * pull
    inertia = float(np.linalg.norm(scene.inertias, ord=2, axis=(1, 2)).sum())
    return found | {"acceleration": pull, "angular acceleration": turned, "reaction force": weight,
                    "reaction torque": weight * length + inertia * turned}


def at_rest(scene: Scene, motion: Motion) -> bool:
    """Whether nothing moves but rounding, so that an engine that does nothing is right."""
    falling = float(np.linalg.norm(scene.gravity)) * length_of(scene) or length_of(scene) ** 2
    kinetic = float(np.nanmax(mechanics.kinetic_energy(scene, motion), initial=0.0))
    return kinetic <= AT_REST * float(scene.masses.sum()) * falling


def check_moves(scene: Scene, motion: Motion) -> None:
    """Raises `Unsupported` where nothing moves but rounding, so that every method at every step is right."""
    if at_rest(scene, motion):
        raise Unsupported(f"{scene.name!r}: nothing moves but rounding, so that every step is right; give a start that "
                          "moves, of a model file by --qpos, --qvel or --keyframe")
