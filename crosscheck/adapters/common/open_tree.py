"""What the optional engines share: open trees of four joints under gravity, one row of joint coordinates at a time."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from crosscheck.adapters.base import RunSpec
from crosscheck.adapters.common import tree
from crosscheck.adapters.common.links import relative_attitude
from crosscheck.adapters.common.stepping import Convert
from crosscheck.scene.model import Scene, rotation_from_quaternion
from crosscheck.scene.states import States

JOINTS = ("spherical", "revolute", "prismatic", "fixed")
"""Joint types these adapters build."""

BodyState = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]
"""x, R, v, w, a, alpha of a body: its centre of mass, all vectors in world axes."""


def unsupported(scene: Scene, spec: RunSpec) -> str | None:
    """Why an adapter of this kind cannot run a scene in the form asked for, or None where it can."""
    if spec.form not in (None, "tree"):
        return f"form {spec.form} is not built into this adapter; it has tree"
    return scene.beyond() or tree.obstacle(scene, JOINTS)


def zero_attitude(scene: Scene, link: tree.Link) -> np.ndarray:
    """(3, 3) relative attitude at zero joint coordinates; a ball's zero is where it starts, clear of any lock."""
    if link.type == "spherical":
        return rotation_from_quaternion(relative_attitude(scene, link.parent, link.body))
    return rotation_from_quaternion(link.zero)


def converter(scene: Scene, set_state: Callable[[np.ndarray, np.ndarray], None],
              body_state: Callable[[int], BodyState]) -> Convert:
    """Histories of joint coordinates to states, by the engine's own kinematics.

    Parameters
    ----------
    set_state : puts a row of joint positions and velocities into the engine
    body_state : body index to its motion in that state
    """
    def convert(t: np.ndarray, q: np.ndarray, v: np.ndarray, a: np.ndarray | None) -> States:
        vectors = np.empty((5, len(t), scene.n, 3))
        R = np.empty((len(t), scene.n, 3, 3))
        for row in range(len(t)):
            set_state(q[row], v[row])
            for body in range(scene.n):
                x, R[row, body], *rates = body_state(body)
                vectors[:, row, body] = [x, *rates]
        x, velocity, w, acceleration, alpha = vectors
        # The angular acceleration in body axes is the derivative of w in them: w x w is zero.
        states = States(t, x, R, velocity, np.einsum("tnji,tnj->tni", R, w))
        if a is not None:
            states.a, states.alpha = acceleration, np.einsum("tnji,tnj->tni", R, alpha)
        return states

    return convert


def rows(evaluate: Callable[[np.ndarray, np.ndarray], Any]) -> Callable[..., np.ndarray]:
    """A function of one row (q, v) as one of histories (t, q, v)."""
    return lambda t, q, v: np.array([evaluate(*row) for row in zip(q, v, strict=True)]).reshape(v.shape)
