"""The rotor inertia of joints, armature I: it adds the kinetic energy 1/2 I rate^2 of a joint coordinate.

The rate is S u. For a rotation S is constant in body axes, so that I adds I S^T S to the mass matrix. For a slide S
moves with the bodies, d(rate)/dt = S du/dt + s, which adds the force -I S^T s. There is no gyroscopic part.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from crosscheck.scene.model import GROUND, Joint, Scene
from crosscheck.scene.vectors import cross

Rotor = tuple[float, np.ndarray, np.ndarray]


def rotors(scene: Scene, x: np.ndarray, R: np.ndarray, v: np.ndarray, w: np.ndarray) -> Iterator[Rotor]:
    """(I, S (T, 6n), s (T,)) of every coordinate with armature; states as in `crosscheck.scene.mechanics`."""
    for joint in scene.joints:
        for value, word in zip(joint.armature, joint.kind.coordinates, strict=False):
            if value:
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
    """S and s of slide = e . d, with e the axis in the world and d from the parent's anchor to the child's."""
    parent, child, none = joint.parent, joint.child, np.zeros((len(x), 3))
    S = np.zeros((len(x), scene.n, 6))
    arm = R[:, child] @ joint.child_anchor
    spin = np.einsum("tij,tj->ti", R[:, child], w[:, child])
    if parent == GROUND:
        e, base, move, turn = np.broadcast_to(joint.parent_axis, none.shape), none, none, none
    else:
        e, base, move = R[:, parent] @ joint.parent_axis, x[:, parent], v[:, parent]
        turn = np.einsum("tij,tj->ti", R[:, parent], w[:, parent])
    anchor = joint.parent_anchor + none if parent == GROUND else R[:, parent] @ joint.parent_anchor
    reach = x[:, child] + arm - base  # from the parent's centre of mass to the child's anchor
    d = reach - anchor
    d_rate = v[:, child] + cross(spin, arm) - move - cross(turn, anchor)
    e_rate = cross(turn, e)
    S[:, child, :3] = e
    S[:, child, 3:] = np.einsum("tji,tj->ti", R[:, child], cross(arm, e))
    if parent != GROUND:
        S[:, parent, :3] = -e
        S[:, parent, 3:] = np.einsum("tji,tj->ti", R[:, parent], cross(e, reach))
    bend = cross(spin, cross(spin, arm)) - cross(turn, cross(turn, anchor))
    s = _dot(cross(turn, e_rate), d) + 2 * _dot(e_rate, d_rate) + _dot(e, bend)
    return S.reshape(len(x), -1), s


def _dot(p: np.ndarray, q: np.ndarray) -> np.ndarray:
    return np.asarray(np.einsum("tk,tk->t", p, q))
