"""What an engine's model of a scene says at some states, before any step."""

from __future__ import annotations

import dataclasses

import numpy as np


@dataclasses.dataclass
class Probe:
    """An engine's model of a scene with n bodies, evaluated at K states. SI units, frames as in `States`.

    `x, R, v, w` are the states of the bodies as the engine's own kinematics compute them after it was given the states.
    The engine may use any nv velocity coordinates. `jacobian` maps them to (v, w) of one body after the other, and
    mass matrix and forces refer to them. Reactions are the force and torque on a joint's child at the child's anchor,
    in world axes.
    """

    engine: str
    form: str
    masses: np.ndarray | None = None  # (n,)
    inertias: np.ndarray | None = None  # (n, 3, 3) about the centres of mass, body axes
    x: np.ndarray | None = None  # (K, n, 3)
    R: np.ndarray | None = None  # (K, n, 3, 3)
    v: np.ndarray | None = None  # (K, n, 3)
    w: np.ndarray | None = None  # (K, n, 3)
    total_mass: float | None = None  # kg; None: the sum of `masses`
    com: np.ndarray | None = None  # (K, 3) mass centre of the whole system; None: computed from `masses` and `x`
    kinetic: np.ndarray | None = None  # (K,) J
    potential: np.ndarray | None = None  # (K,) J, gravity -m g.x and all springs
    jacobian: np.ndarray | None = None  # (K, 6n, nv)
    closing: np.ndarray | None = None  # (K, r, nv) Jacobian of the engine's own constraints, if it has any
    mass_matrix: np.ndarray | None = None  # (K, nv, nv)
    gravity_force: np.ndarray | None = None  # (K, nv)
    applied_force: np.ndarray | None = None  # (K, nv) all forces but constraints, with -w x Jw; only form maximal
    a: np.ndarray | None = None  # (K, n, 3)
    alpha: np.ndarray | None = None  # (K, n, 3)
    notes: dict[str, str] = dataclasses.field(default_factory=dict)  # by quantity: why the engine has no answer

    @property
    def label(self) -> str:
        """Engine and form."""
        return f"{self.engine} {self.form}"
