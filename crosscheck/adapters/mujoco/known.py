"""Known defects of MuJoCo."""

import dataclasses

import numpy as np

from crosscheck.adapters.base import Engine
from crosscheck.adapters.common import open_tree
from crosscheck.adapters.common.known import NAIVE, SUMMED, scene_of, summed
from crosscheck.document.known import ORDERS, Known
from crosscheck.scene.model import Sensor
from crosscheck.scene.sensors import Misreads, Reader, read

DISCRETE = ("accelerations are evaluated at the run's states, for those of discrete are changes of velocities over a "
            "step; with soft joints that integrator leaves states in which their forces are others than in its steps: "
            "10 m/s^2 on the single pendulum, alike at 1 and at 0.25 ms")

BOUNCE = ("a stop with restitution is a spring and damper, which an impact takes thirty steps to pass, so that an "
          "output time may lie within one; where in a step contact begins and ends moves the restitution, .485 to .517 "
          "for .5, at any step")


def _bounces(_: Engine, scene: str, form: str | None) -> bool:
    loaded = scene_of(scene)
    return loaded is not None and open_tree.bouncing(loaded) is not None


def _closes_loops(scene: str) -> bool:
    """Whether a scene has loops, which MuJoCo closes by soft joints."""
    from crosscheck.scene.spanning import spanning_tree

    loaded = scene_of(scene)
    return loaded is not None and bool(spanning_tree(loaded)[1])


KNOWN = (
    Known(("3",), ("RK4",), summed("surely"), ("tree",), SUMMED, NAIVE),
    Known(("3",), ("RK4",), summed("maybe"), ("tree",), SUMMED, NAIVE, always=False),
    Known(("4",), ("discrete",), lambda engine, scene, form: form == "maximal" or _closes_loops(scene), None,
          {"acceleration": 120, "angular acceleration": 93}, DISCRETE, always=False),
    Known(("3", "4"), ("Euler", "implicit", "implicitfast", "RK4", "discrete"), _bounces, None, {
        "position": 2.0, "attitude": 2.0, "velocity": 1.7, "angular velocity": 1.7, "interval position": 25,
        "interval attitude": 25, "interval velocity": 240, "interval angular velocity": 240}, BOUNCE, always=False,
        margin=1.5),
    Known(("4",), ("discrete",), _bounces, None, dict.fromkeys(ORDERS, 0.4) | {
        "limit position": 4.4, "limit attitude": 4.4, "limit velocity": 22, "limit angular velocity": 22}, BOUNCE,
        always=False, margin=1.5),
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
