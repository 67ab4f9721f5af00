"""Initial poses of the bodies of a scene, absolute and relative."""

from __future__ import annotations

import numpy as np

from crosscheck.scene.model import GROUND, Scene


def pose(scene: Scene, body: int) -> tuple[np.ndarray, np.ndarray]:
    """Initial position (3,) and attitude (3, 3) of a body or the ground, world axes."""
    return (np.zeros(3), np.eye(3)) if body == GROUND else (scene.x0[body], scene.R0[body])


def relative_pose(scene: Scene, parent: int, body: int) -> tuple[np.ndarray, np.ndarray]:
    """Initial position (3,) and attitude (3, 3) of `body` in the frame of `parent`."""
    (x, R), (at, turn) = pose(scene, parent), pose(scene, body)
    return R.T @ (at - x), R.T @ turn


def in_body(scene: Scene, start: int, end: int, vector: np.ndarray) -> np.ndarray:
    """Components at t = 0 in the frame of `end` of a vector given in the frame of `start`."""
    turned: np.ndarray = pose(scene, end)[1].T @ pose(scene, start)[1] @ vector
    return turned
