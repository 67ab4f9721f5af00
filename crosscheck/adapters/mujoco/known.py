"""Known defects of MuJoCo."""

import functools

from crosscheck.adapters.common.known import GYROSCOPIC, NAIVE, SUMMED, summed
from crosscheck.document.known import Known

DISCRETE = ("accelerations are evaluated at the run's states, for those of discrete are changes of velocities over a "
            "step; with soft joints that integrator leaves states in which their forces are others than in its steps: "
            "10 m/s^2 on the single pendulum, alike at 1 and at 0.25 ms")


@functools.lru_cache(maxsize=64)
def _closes_loops(scene: str) -> bool:
    """Whether a scene has loops, which MuJoCo closes by soft joints."""
    from crosscheck.errors import ArgumentError, SceneError
    from crosscheck.scene.file import as_scene
    from crosscheck.scene.spanning import spanning_tree

    try:
        return bool(spanning_tree(as_scene(scene))[1])
    except (ArgumentError, SceneError):
        return False


KNOWN = (
    Known(("3",), ("RK4",), summed("surely"), ("tree",), SUMMED, NAIVE),
    Known(("3",), ("RK4",), summed("maybe"), ("tree",), SUMMED, NAIVE, always=False),
    Known(("4",), ("Euler", "implicitfast", "discrete"), ("heavy_top",), None,
          {"energy": 7e8, "level velocity": 35, "level acceleration": 8.4e4}, GYROSCOPIC, practical=True),
    Known(("4",), ("discrete",), lambda engine, scene, form: form == "maximal" or _closes_loops(scene), None,
          {"acceleration": 120, "angular acceleration": 93}, DISCRETE, always=False),
)
