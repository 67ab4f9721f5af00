"""The rotor inertia of joints, armature I: it adds the kinetic energy 1/2 I rate^2 of a joint coordinate.

The rate is S u. For a rotation S is constant in body axes, so that I adds I S^T S to the mass matrix. For a slide S
moves with the bodies, d(rate)/dt = S du/dt + s, which adds the force -I S^T s. There is no gyroscopic part.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from crosscheck.scene.coordinates import rates
from crosscheck.scene.model import GROUND, Joint, Scene
from crosscheck.scene.states import States

Rotor = tuple[float, np.ndarray, np.ndarray]


def rotors(scene: Scene, x: np.ndarray, R: np.ndarray, v: np.ndarray, w: np.ndarray) -> Iterator[Rotor]:
    """(I, S (T, 6n), s (T,)) of every coordinate with armature; states as in `crosscheck.scene.mechanics`."""
    for joint in scene.joints:
        for value, word in zip(joint.armature, joint.kind.coordinates, strict=False):
            if value and word in ("turn", "slide"):
                yield value, *rate_row(joint, word, scene, x, R, v, w)


def rate_row(joint: Joint, word: str, scene: Scene, x: np.ndarray, R: np.ndarray, v: np.ndarray,
             w: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """S (T, 6n) and s (T,) of a coordinate, "turn" or "slide"."""
    return _turn(joint, scene, x) if word == "turn" else _slide(joint, scene, x, R, v, w)


def _turn(joint: Joint, scene: Scene, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    S = np.zeros((len(x), scene.n, 6))
    S[:, joint.child, 3:] = joint.child_axis
    if joint.parent != GROUND:
        S[:, joint.parent, 3:] = -joint.parent_axis
    return S.reshape(len(x), -1), np.zeros(len(x))


def _slide(joint: Joint, scene: Scene, x: np.ndarray, R: np.ndarray, v: np.ndarray,
           w: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """S by unit velocities of the two bodies, and s by the velocities that they have, without accelerations."""
    def slid(v: np.ndarray, w: np.ndarray, *still: np.ndarray) -> np.ndarray:
        given = rates(joint, States(np.zeros(len(x)), x, R, v, w, *still), bool(still))
        return given.reshape(len(x), -1)[:, joint.kind.coordinates.index("slide")]

    S = np.zeros((len(x), scene.n, 6))
    for body in {joint.parent, joint.child} - {GROUND}:
        for k in range(6):
            unit = np.zeros((2, *v.shape))
            unit[k // 3, :, body, k % 3] = 1.0
            S[:, body, k] = slid(*unit)
    return S.reshape(len(x), -1), slid(v, w, 0 * v, 0 * w)
