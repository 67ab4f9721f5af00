"""Energy error, constraint levels and orthogonality of successive states, with the same formulas for all engines."""

from __future__ import annotations

from typing import TypedDict

import numpy as np

from crosscheck.scene import mechanics
from crosscheck.scene.constraints import Constraints
from crosscheck.scene.coordinates import followed, hinge_angles, starting
from crosscheck.scene.model import Scene
from crosscheck.scene.states import States

MAXIMA = ("energy_error", "kinetic_energy", "constraint_position", "constraint_velocity", "constraint_acceleration",
          "orthogonality")
"""Keys of the maxima over every step; energy_error is |E - E(0)| over kinetic_energy, the largest one, J."""


class Monitor:
    """Running maxima of energy error, constraint levels and orthogonality over batches of successive steps.

    The energy error is measured from the initial state of the scene, relative to the largest kinetic energy so far.
    """

    def __init__(self, scene: Scene) -> None:
        self._scene = scene
        self._constraints = Constraints(scene)
        self._kinetic, self._gap = 0.0, 0.0
        self._maxima: dict[str, float] = {}
        self._energy = 0.0
        self._last = starting(scene)
        self._last.hinges = hinge_angles(scene, self._last)
        self._energy = float(self._energies(self._last)[0])

    def update(self, x: np.ndarray, R: np.ndarray, v: np.ndarray, w: np.ndarray, a: np.ndarray | None = None,
               alpha: np.ndarray | None = None, t: np.ndarray | None = None, hinges: np.ndarray | None = None
               ) -> np.ndarray:
        """Add the states (T, n, ...) after successive steps, with accelerations if the engine has them.

        Returns the angles of the hinges, (T, h), as `States` takes them: `hinges`, if the engine counts their turns, or
        followed from step to step. In a step they turn by less than half a turn, or, with the times t (T,), by less
        than that beside what the mean of the rates predicts.
        """
        states = States(np.zeros(len(x)) if t is None else t, x, R, v, w, hinges=hinges)
        if states.hinges is None:
            states.hinges = followed(self._scene, states, self._last)
        if len(x) == 0:
            return states.hinges
        self._last = states.at(slice(-1, None))
        # a diverging run overflows here, and its maxima become inf or nan
        with np.errstate(over="ignore", invalid="ignore"):
            energies = self._energies(states)
            self._gap = float(np.maximum(self._gap, np.abs(energies - self._energy).max()))
            leaders = None
            if self._constraints.followers:
                leaders = self._constraints.leaders_at(states)
            levels = level_norms(self._constraints, x, R, v, w, a, alpha, leaders=leaders)
            for key, values in (*levels.items(), ("orthogonality", mechanics.orthogonality(R))):
                if isinstance(values, np.ndarray):
                    self._maxima[key] = float(np.maximum(self._maxima.get(key, 0.0), values.max()))
        return states.hinges

    def maxima(self) -> dict[str, float]:
        """The maxima so far by the keys of MAXIMA; without `constraint_acceleration` if no accelerations were given."""
        scale = self._kinetic if self._kinetic > 0 else 1.0  # a scene that never moves has its error in J
        largest = {"energy_error": self._gap / scale, "kinetic_energy": scale, **self._maxima}
        return {key: largest[key] for key in MAXIMA if key in largest}

    def _energies(self, states: States) -> np.ndarray:
        kinetic = mechanics.kinetic_energy(self._scene, states)
        self._kinetic = float(np.maximum(self._kinetic, kinetic.max()))
        return np.asarray(kinetic + mechanics.potential_energy(self._scene, states))


class Levels(TypedDict):
    """Max-norms (T,) of the rows at each constraint level."""

    constraint_position: np.ndarray
    constraint_velocity: np.ndarray
    constraint_acceleration: np.ndarray | None


def level_norms(constraints: Constraints, x: np.ndarray, R: np.ndarray, v: np.ndarray, w: np.ndarray,
                a: np.ndarray | None, alpha: np.ndarray | None, t: np.ndarray | float = 0.0,
                leaders: np.ndarray | None = None) -> Levels:
    """Max-norms (T,) of the constraint levels at times t by their names in `Trajectory`; `leaders` as in
    `Constraints.position`."""
    def norm(rows: np.ndarray) -> np.ndarray:
        return np.asarray(np.abs(rows).max(axis=1, initial=0.0))

    acceleration = None
    if a is not None and alpha is not None:
        acceleration = norm(constraints.acceleration(x, R, v, w, a, alpha, t))
    return {"constraint_position": norm(constraints.position(x, R, t, leaders)),
            "constraint_velocity": norm(constraints.velocity(x, R, v, w, t)), "constraint_acceleration": acceleration}
