"""Known defects of MuJoCo."""

import dataclasses

import numpy as np

from crosscheck.adapters.common.known import BOUNCE, GYROSCOPIC, NAIVE, SUMMED, bounces, scene_of, summed
from crosscheck.document.known import ORDERS, Known
from crosscheck.scene.model import Sensor
from crosscheck.scene.sensors import Misreads, Reader, read

DISCRETE = ("accelerations are evaluated at the run's states, for those of discrete are changes of velocities over a "
            "step; with soft joints that integrator leaves states in which their forces are others than in its steps: "
            "10 m/s^2 on the single pendulum, alike at 1 and at 0.25 ms")


BOUNCING = BOUNCE.format("thirty", ", .484 or .510 for .5,")
DAMPED = BOUNCE.format("thirty", ", .437 to .464 for .5,") + "; discrete takes damper and spring at the end of a step"


def _closes_loops(scene: str) -> bool:
    """Whether a scene has loops, which MuJoCo closes by soft joints."""
    from crosscheck.scene.spanning import spanning_tree

    loaded = scene_of(scene)
    return loaded is not None and bool(spanning_tree(loaded)[1])


KNOWN = (
    Known(("3",), ("RK4",), summed("surely"), ("tree",), SUMMED, NAIVE),
    Known(("3",), ("RK4",), summed("maybe"), ("tree",), SUMMED, NAIVE, always=False),
    Known(("4",), ("Euler", "implicitfast", "discrete"), ("heavy_top",), None,
          {"energy": 7e8, "level velocity": 35, "level acceleration": 8.4e4}, GYROSCOPIC, practical=True),
    Known(("4",), ("discrete",), lambda engine, scene, form: form == "maximal" or _closes_loops(scene), None,
          {"acceleration": 120, "angular acceleration": 93}, DISCRETE, always=False),
    Known(("4",), ("Euler", "implicit", "implicitfast", "RK4"), bounces, None, {
        "position": 1.1, "attitude": 1.1, "interval velocity": 2.7, "interval angular velocity": 2.5}, BOUNCING,
        always=False),
    Known(("4",), ("discrete",), bounces, None, dict.fromkeys(ORDERS, 1.1) | {
        "position": 6.4, "attitude": 6.4, "velocity": 41, "angular velocity": 41, "energy": 1.9,
        "interval velocity": 26, "interval angular velocity": 26, "limit position": 26, "limit attitude": 26,
        "limit velocity": 130, "limit angular velocity": 120}, DAMPED, always=False),
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
