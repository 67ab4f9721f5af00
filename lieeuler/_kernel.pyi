"""The compiled core, see lieeuler/_core/python/bind.cpp."""

import enum
from collections.abc import Sequence
from typing import Any

import numpy as np

from lieeuler.types import Measured

class Carrier(enum.Enum):
    difference = 0
    parent = 1
    child = 2

class ContactKind(enum.Enum):
    edge = 0
    disk = 1
    sphere = 2

class CoordinateMap(enum.Enum):
    exp = 0
    cayley = 1
    ccsk = 2

class Formulation(enum.Enum):
    lagrange = 0
    hamilton = 1

class Level(enum.Enum):
    position = 0
    velocity = 1
    stabilised = 2
    acceleration = 3

class Correction(enum.Enum):
    mass = 0
    plain = 1

class Method:
    def __init__(self, formulation: Formulation, level: Level, index1_output: bool, alpha: float, beta: float,
                 composition: Sequence[float], spectral_radius: float | None, polish: bool, correction: Correction,
                 /) -> None: ...

class TimeFunction:
    def __init__(self, breaks: Sequence[float], pieces: Sequence[Sequence[float]],
                 terms: Sequence[Sequence[float]], /) -> None: ...
    def expand(self, t: float, count: int, /) -> list[float]: ...

class System:
    def __init__(self, masses: Sequence[float], inertias: Sequence[np.ndarray], gravity: np.ndarray, /) -> None: ...
    def set_spin(self, body: int, spin: np.ndarray, /) -> None: ...
    def add_joint(self, parent: int, child: int, parent_anchor: np.ndarray, child_anchor: np.ndarray, spherical: bool,
                  carriers: Sequence[Carrier], axes: Sequence[np.ndarray], constants: Sequence[float],
                  scales: Sequence[float], /) -> None: ...
    def follow(self, coordinate: Measured, ratio: float, offset: float, /) -> None: ...
    def add_leader(self, mimic: int, joint: int, coordinate: Measured, /) -> None: ...
    def add_rotor(self, joint: int, inertia: float, coordinate: Measured, /) -> None: ...
    def add_contact(self, kind: ContactKind, normal: np.ndarray, axis: np.ndarray, radius: float,
                    across: Sequence[np.ndarray], /) -> None: ...
    def drive_joint(self, coordinate: Measured, drive: TimeFunction, /) -> None: ...
    def add_linear_spring(self, parent: int, child: int, parent_point: np.ndarray, child_point: np.ndarray,
                          stiffness: float, free_length: float, damping: float, /) -> None: ...
    def add_torsional_spring(self, parent: int, child: int, axis: np.ndarray, normal: np.ndarray,
                             second_normal: np.ndarray, pointer: np.ndarray, stiffness: float, rest_angle: float,
                             damping: float, torque: TimeFunction | None, /) -> None: ...
    def add_slide_force(self, parent: int, child: int, parent_anchor: np.ndarray, child_anchor: np.ndarray,
                        axis: np.ndarray, size: TimeFunction, stiffness: float, rest: float, damping: float, /
                        ) -> None: ...
    def add_load(self, child: int, point: np.ndarray, force: np.ndarray, torque: np.ndarray, in_world: bool,
                 factor: TimeFunction | None, /) -> None: ...

class Plan:
    """A system, and what its structure decides for all its runs."""

    def __init__(self, system: System, /) -> None: ...
    @property
    def length(self) -> float: ...
    def natural_rate(self, length: float, /) -> float: ...
    @property
    def angles(self) -> int: ...
    turns_about_pins: bool

class Tableau:
    def __init__(self, stages: Sequence[Sequence[float]], weights: Sequence[float], order: int,
                 errors: Sequence[Sequence[float]], extra: Sequence[Sequence[float]],
                 dense: Sequence[Sequence[float]], /) -> None: ...

class JointNodeKind(enum.Enum):
    hinge = 0
    slide = 1
    ball = 2

class Run:
    """A method with its steps or its tolerance, ready to run a system from a state at time `begin`."""

    begin: float
    @property
    def knows_joints(self) -> bool: ...
    def add_node(self, kind: JointNodeKind, parent: int, joint: int, last: bool, turn: np.ndarray, axis: np.ndarray,
                 armature: float, /) -> None: ...

def implicit(coordinate_map: CoordinateMap, method: Method, steps: Sequence[float], counts: Sequence[int],
             monitor: bool, /) -> Run: ...
def runge_kutta(tableau: Tableau, steps: Sequence[float], counts: Sequence[int], monitor: bool, /) -> Run: ...
def adaptive_runge_kutta(tableau: Tableau, t_eval: Sequence[float], rtol: float, monitor: bool,
                         conserve: bool, /) -> Run: ...
def seulex(t_eval: Sequence[float], rtol: float, monitor: bool, /) -> Run: ...
def taylor(t_eval: Sequence[float], rtol: float, monitor: bool, conserve: bool, /) -> Run: ...
def integrate(plan: Plan, run: Run, x: np.ndarray, R: np.ndarray, v: np.ndarray, w: np.ndarray, checks: bool,
              vectors: np.ndarray, attitudes: np.ndarray, lam: np.ndarray, angles: np.ndarray,
              /) -> tuple[str, int, float, float, tuple[int, int, int, int, int, int, int],
                          tuple[float, float, float, float, float, float], tuple[bool, bool, bool]] | None: ...
def integrate_ensemble(plans: Sequence[Plan], run: Run, x: np.ndarray, R: np.ndarray, v: np.ndarray, w: np.ndarray,
                       threads: int, /) -> dict[str, Any]: ...
def taylor_coefficients(plan: Plan, x: np.ndarray, R: np.ndarray, v: np.ndarray, w: np.ndarray,
                        order: int, /) -> dict[str, Any]: ...
def project(plan: Plan, home_x: np.ndarray, home_R: np.ndarray, x: np.ndarray, R: np.ndarray, v: np.ndarray,
            w: np.ndarray, /) -> dict[str, Any]: ...
def multipliers(plan: Plan, times: np.ndarray, x: np.ndarray, R: np.ndarray, v: np.ndarray, w: np.ndarray,
                angles: np.ndarray, /) -> tuple[np.ndarray, int, int]: ...
def leave_plane(turn: np.ndarray, frames: np.ndarray, heights: np.ndarray, x: np.ndarray, R: np.ndarray,
                v: np.ndarray, w: np.ndarray, a: np.ndarray, alpha: np.ndarray, /) -> None: ...
def constraint_levels(plan: Plan, x: np.ndarray, R: np.ndarray, v: np.ndarray, w: np.ndarray,
                      time: float, duration: float, /) -> np.ndarray: ...
def open_levels(plan: Plan, x: np.ndarray, v: np.ndarray, w: np.ndarray, a: np.ndarray, alpha: np.ndarray,
                lam: np.ndarray, position: float, velocity: float, acceleration: float, kinetic: float,
                duration: float, /) -> tuple[bool, bool, bool]: ...
def constraints(plan: Plan, x: np.ndarray, R: np.ndarray, v: np.ndarray, w: np.ndarray,
                lam: np.ndarray, /) -> dict[str, Any]: ...
def forces(plan: Plan, x: np.ndarray, R: np.ndarray, v: np.ndarray, w: np.ndarray, /) -> dict[str, Any]: ...
def map_values(coordinate_map: CoordinateMap, xi: np.ndarray, J: np.ndarray, h: float, /) -> dict[str, Any]: ...
