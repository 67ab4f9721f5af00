"""Known defects that several engines share: their reasons, sizes and the rule of where they show."""

from __future__ import annotations

import functools
from collections.abc import Callable

import numpy as np

from crosscheck.adapters.base import Engine
from crosscheck.document.known import ORDERS
from crosscheck.scene.model import Scene

NAIVE = ("summing the joint velocities of the stages and integrating once is second order where a joint turns on "
         "SO(3): velocities at different attitudes do not add there; order 4 is what such code is written for")
SINGULAR = ("nothing holds the positions, and where all bars lie on one line the constraints lose a rank: close to it "
            "a drift e of a joint is a displacement e / angle and a velocity e w / angle^2, which no step resolves; on "
            "the parallelogram at 2 ms the first passage turns 1e-11 m into 2e-6 m and the second into 0.05 m. In "
            "joint coordinates only the loop drifts: on the parallelogram RKMK8 leaves it open by 6e-10 m at 1 ms, by "
            "1e-4 m at 2 ms")
CONTRADICTORY = ("the linkage moves only because its redundant rows repeat the others where the positions are exact; "
                 "this method holds no positions, and off them the rows contradict each other: no velocity or "
                 "acceleration satisfies them all, and their least squares leave what is seen")
SUMMED = dict.fromkeys(ORDERS, 1.9) | {
    "position": 34, "attitude": 140, "velocity": 67, "angular velocity": 94, "interval position": 430,
    "interval attitude": 690, "interval velocity": 110, "interval angular velocity": 130, "energy": 42, "momentum": 9.3}
"""Of summed joint velocities, on all scenes of the library; the largest on thrown_double at 10 ms."""

CONING = 0.1
"""Size of w x dw/dt over the largest |w| |dw/dt| of a body above which an axis of rotation moves for sure."""


@functools.lru_cache(maxsize=64)
def scene_of(name: str) -> Scene | None:
    """The scene of a name or path; None where there is none, so that nothing is known about it."""
    from crosscheck.errors import ArgumentError, SceneError
    from crosscheck.scene.file import as_scene

    try:
        return as_scene(name)
    except (ArgumentError, SceneError):
        return None


def with_balls(engine: Engine, scene: str, form: str | None) -> bool:
    """Whether a scene has spherical joints."""
    loaded = scene_of(scene)
    return loaded is not None and any(joint.type == "spherical" for joint in loaded.joints)


@functools.lru_cache(maxsize=64)
def naive(engine: Engine, scene: str, form: str | None) -> str:
    """Whether summed joint velocities show on a scene.

    "no": no joint of the model turns on SO(3); "surely": the axis of rotation of such a body moves from the start;
    "maybe": turns about one axis add up.
    """
    from crosscheck.scene import mechanics

    loaded = scene_of(scene)
    if loaded is None:
        return "no"
    turning = list(engine.turning(loaded, form))
    if not turning:
        return "no"
    _, alpha, _ = mechanics.index1(loaded, loaded.x0[None], loaded.R0[None], loaded.v0[None], loaded.w0[None])
    w, alpha = loaded.w0[turning], alpha[0, turning]
    speeds = np.linalg.norm(w, axis=1)
    sizes = speeds * np.linalg.norm(alpha, axis=1)
    # The direction of what rests, or does not accelerate, is rounding.
    least = max(CONING * sizes.max(), 1e-9 * speeds.max() ** 3)
    return "surely" if np.linalg.norm(np.cross(w, alpha), axis=1).max() > least else "maybe"


def summed(word: str) -> Callable[[Engine, str, str | None], bool]:
    """The rule for scenes of which `naive` says this word."""
    return lambda engine, scene, form: naive(engine, scene, form) == word
