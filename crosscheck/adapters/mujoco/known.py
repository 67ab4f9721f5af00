"""Known defects of MuJoCo."""

import dataclasses
import functools

import numpy as np

from crosscheck.adapters.common.known import GYROSCOPIC, NAIVE, SUMMED, summed
from crosscheck.document.known import Known
from crosscheck.scene.model import Sensor
from crosscheck.scene.sensors import Misreads, Reader, read

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


def _minus_gravity(reader: Reader, sensor: Sensor) -> np.ndarray:
    return read(reader, dataclasses.replace(sensor, type="accelerometer"))


def _without_loads(reader: Reader, sensor: Sensor) -> np.ndarray:
    loads = reader.loads(reader.joints[sensor.joint or ""], site := reader.sites[sensor.site or ""])
    missing = sum((pair[sensor.type == "torque"] for _, *pair in loads), 0.0 * reader.place(site))
    return np.asarray(read(reader, sensor) + np.einsum("tji,tj->ti", reader.axes(site), missing))


LOADS = ("MuJoCo's force and torque sensors leave out what actuators at sites and tendons exert on the bodies: they "
         "sum inertial forces, xfrc_applied and constraints (mj_rnePostConstraint)")
MISREADS: Misreads = {
    ("acceleration", "world"): (_minus_gravity, "MuJoCo's framelinacc is a - g, as an accelerometer reads, not the "
                                "acceleration of the site (mujoco#1216, mujoco#1327)"),
    ("force", "site"): (_without_loads, LOADS), ("torque", "site"): (_without_loads, LOADS)}
