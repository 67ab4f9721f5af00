"""Random scenes and the motions of their bodies, shared by tests; seeded, so that a failing example repeats."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.spatial.transform import Rotation

from crosscheck.scene import assembly
from crosscheck.scene.checks import Draft
from crosscheck.scene.model import GROUND, Body, Force, Joint, Scene
from crosscheck.scene.schema import EntryError

JOINT_TYPES = ("spherical", "universal", "revolute", "cylindrical", "prismatic", "planar", "fixed", "distance",
               "point_on_line", "point_on_plane")
TWO_AXES = ("universal", "revolute", "cylindrical", "prismatic", "planar")
ROWS = dict(zip(JOINT_TYPES, (3, 4, 5, 4, 5, 3, 6, 1, 2, 1), strict=True))

ARM = """
schema = 3
name = "arm"
description = "an arm on a hinge"
source = "own"
gravity = [0.0, 0.0, -9.81]
duration = 1.0
samples = 11
[[bodies]]
name = "arm"
mass = 1.0
inertia = [[0.1, 0.0, 0.0], [0.0, 0.1, 0.0], [0.0, 0.0, 0.1]]
[[joints]]
name = "elbow"
type = "revolute"
parent = "ground"
child = "arm"
parent_anchor = [0.0, 0.0, 0.0]
child_anchor = [0.0, 0.0, 0.5]
parent_axis = [0.0, 1.0, 0.0]
child_axis = [0.0, 1.0, 0.0]
"""
"""A scene file: an arm on a hinge, whose table comes last."""


def unit(rng: np.random.Generator) -> np.ndarray:
    """A random direction (3,)."""
    vector = rng.normal(size=3)
    return vector / np.linalg.norm(vector)


def random_body(rng: np.random.Generator, name: str) -> Body:
    """A body of random physical inertia in a random state."""
    rods = rng.uniform(0.1, 1.0, size=3)  # second moments of mass: any positive ones give a physical inertia
    turn = Rotation.from_quat(rng.normal(size=4)).as_matrix()
    inertia = turn @ np.diag(rods.sum() - rods) @ turn.T
    attitude = rng.normal(size=4)
    return Body(name, rng.uniform(0.5, 3.0), (inertia + inertia.T) / 2, attitude / np.linalg.norm(attitude),
                rng.uniform(-2, 2, size=3), rng.uniform(-1, 1, size=3), rng.uniform(-1, 1, size=3))


def random_joint(rng: np.random.Generator, kind: str, parent: int, child: int, name: str = "joint") -> Joint:
    """A joint of the given type with random anchors and axes."""
    return Joint(name, kind, parent, child, rng.uniform(-1, 1, size=3), rng.uniform(-1, 1, size=3),
                 unit(rng) if kind in TWO_AXES or kind.startswith("point_on") else None,
                 unit(rng) if kind in TWO_AXES else None, 0.7 if kind == "distance" else None)


def make_scene(bodies: list[Body], joints: list[Joint], forces: list[Force] | None = None, **changes) -> Scene:
    """A scene under gravity for one second."""
    content = {"gravity": np.array([0.0, 0.0, -9.81]), "duration": 1.0, "samples": 11, **changes}
    return Scene(name="made", bodies=tuple(bodies), joints=tuple(joints), forces=tuple(forces or ()), **content)


def jointed_pair(rng: np.random.Generator, kind: str, forces: list[Force] | None = None) -> Scene:
    """A body on a random point of the ground and a second one, joined by `kind`; the joints are not closed."""
    bodies = [random_body(rng, "first"), random_body(rng, "second")]
    joints = [random_joint(rng, "spherical", GROUND, 0, "base"), random_joint(rng, kind, 0, 1)]
    return make_scene(bodies, joints, forces)


def closed(scene: Scene) -> Scene:
    """The scene with its joints closed by the least change of its state."""
    given = (True,) * scene.n
    return assembly.completed(Draft(scene, given, given, assemble=True))


def drawn(draw: Callable[[], Scene]) -> Scene:
    """The first scene of `draw()` that closes; from some states a joint closes with opposite axes: no scene."""
    while True:
        try:
            return closed(draw())
        except EntryError as error:
            if "opposite" not in error.problem:
                raise


def moved(x: np.ndarray, R: np.ndarray, step: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """x + dx, R exp(hat(dtheta)) for a step (n, 6) of one state x (n, 3), R (n, 3, 3)."""
    return x + step[:, :3], R @ Rotation.from_rotvec(step[:, 3:]).as_matrix()


def derivative(function, h: float = 1e-3):
    """Derivative of function(e) at e = 0 by the five-point difference, error h^4/30 times the fifth derivative."""
    return (8 * (function(h) - function(-h)) - (function(2 * h) - function(-2 * h))) / (12 * h)


DIFFERENCE = 1e-9
"""Relative bound on `derivative` at h = 1e-3 for motions of rate up to about 10/s: truncation 1e-12/30 times 10^5 and
rounding 1e-16/1e-3 are both below it, while a missing or wrong term is of order one."""
