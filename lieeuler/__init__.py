"""Lie group Euler integrators for rigid multibody systems with joints; conventions in `lieeuler.types`."""

from lieeuler.coordinates import Coordinates, from_joints, joint_coordinates
from lieeuler.ensemble import EnsembleSolution, integrate_ensemble
from lieeuler.errors import ArgumentError, LieEulerError
from lieeuler.forces import ConstantLoad, CustomForce, LinearSpring, SlideForce, TorsionalSpring
from lieeuler.functions import TimeFunction
from lieeuler.integrate import PreparedRun, integrate, prepare
from lieeuler.joint_parts import Contact, Coordinate, Dot, Drive, Mimic, Rotor
from lieeuler.joints import (
    Joint,
    cylindrical_joint,
    distance_joint,
    fixed_joint,
    knife_edge_joint,
    planar_joint,
    point_on_line_joint,
    point_on_plane_joint,
    prismatic_joint,
    revolute_joint,
    rolling_disk_joint,
    rolling_sphere_joint,
    spherical_joint,
    universal_joint,
)
from lieeuler.laws import Law, Servo, Stops

from lieeuler.methods import (  # isort: skip
    BAUMGARTE_LE, COORDINATE_MAPS, EULER_METHODS, INDEX1_LE, METHODS, RKMK4, RKMK54, RKMK853, DAE1H_LSE, DAE1L_LSE,
    DAE2H_LE, DAE2H_LSE, DAE2L_LE, DAE2L_LSE, DAE3H_LE, DAE3L_LE, GeneralizedAlpha, Method, Rattle2, Rattle4, Rattle6,
    Rattle8, Seulex, Taylor,
)
from lieeuler.problem import Accelerations, Body, Problem, accelerations, project
from lieeuler.solution import IntegrationError, Interrupted, Solution, Stats, Status

__all__ = [
    "BAUMGARTE_LE", "COORDINATE_MAPS", "DAE1H_LSE", "DAE1L_LSE", "DAE2H_LE", "DAE2H_LSE", "DAE2L_LE", "DAE2L_LSE",
    "DAE3H_LE", "DAE3L_LE", "EULER_METHODS", "INDEX1_LE", "METHODS", "RKMK4", "RKMK54", "RKMK853", "Accelerations",
    "ArgumentError", "Body", "ConstantLoad", "Contact", "Coordinate", "Coordinates", "CustomForce", "Dot", "Drive",
    "EnsembleSolution", "GeneralizedAlpha", "IntegrationError", "Interrupted", "Joint", "Law", "LieEulerError",
    "LinearSpring", "Method", "Mimic", "PreparedRun", "Problem", "Rattle2", "Rattle4", "Rattle6", "Rattle8", "Rotor",
    "Servo", "Seulex", "SlideForce", "Solution", "Stats", "Status", "Stops", "Taylor", "TimeFunction",
    "TorsionalSpring", "accelerations", "cylindrical_joint", "distance_joint", "fixed_joint", "from_joints",
    "integrate", "integrate_ensemble", "joint_coordinates", "knife_edge_joint", "planar_joint", "point_on_line_joint",
    "point_on_plane_joint", "prepare", "prismatic_joint", "project", "revolute_joint", "rolling_disk_joint",
    "rolling_sphere_joint", "spherical_joint", "universal_joint",
]  # fmt: skip


def __getattr__(name: str) -> str:
    if name != "__version__":
        raise AttributeError(f"module 'lieeuler' has no attribute {name!r}")
    from importlib.metadata import version

    return version("lieeuler-crosscheck")
