"""What Exudyn says of a scene: the mass matrix and right-hand side its solvers assemble, on the adapter's models.

Joint coordinates (forms `tree` and `pivot`) give accelerations by one solve with these. With constraints they do not:
Exudyn takes the velocity-dependent part of the constraints from one-sided differences, 1e-7 of the terms.
"""

from __future__ import annotations

import dataclasses
import itertools
from typing import Any

import numpy as np

from crosscheck.inspection.admissible import posed
from crosscheck.inspection.base import Probe
from crosscheck.scene.model import Scene
from crosscheck.scene.states import States

NOTES = {
    "potential energy": "Exudyn sums up no potential energy",
    "reaction force": "Exudyn knows reactions after a step only", "reaction torque": "",
}
LINKS = "links of a kinematic tree are no bodies: some have no mass, and bodies fixed to each other are one"
PIVOT = "in form pivot the position is held by constraints that the solver eliminates"
DIFFERENCES = "Exudyn's constraints take their velocity-dependent part from one-sided differences, 1e-7 of the terms"


def probe(scene: Scene, states: States, form: str | None = None) -> Probe:
    """The Exudyn model in form "maximal" (Lie-group nodes), "tree" or "pivot"."""
    chosen = form or "maximal"
    found = [_at(posed(scene, states, k), chosen) for k in range(len(states.t))]
    values: dict[str, Any] = {key: np.array([one[key] for one in found]) for key in found[0]
                              if all(one[key] is not None for one in found)}
    for key in ("masses", "inertias"):
        if key in values:
            values[key] = values[key][0]
    if "total_mass" in values:
        values["total_mass"] = float(values["total_mass"][0])
    notes = {**NOTES, "reaction torque": NOTES["reaction force"]}
    if "masses" not in values:
        notes |= dict.fromkeys(("mass", "inertia", "centre of mass"), LINKS if chosen == "tree" else PIVOT)
    if chosen == "pivot":
        notes |= dict.fromkeys(("total mass", "kinetic energy", "mass matrix", "gravity force"), PIVOT)
    if "a" not in values:
        notes |= dict.fromkeys(("acceleration", "angular acceleration"), DIFFERENCES)
    return Probe("exudyn", chosen, notes=notes, **values)


def _at(scene: Scene, form: str) -> dict[str, Any]:
    """Everything at the initial state of `scene`."""
    from crosscheck.adapters.exudyn import models

    if form == "maximal":
        return _maximal(scene)
    if form == "pivot":
        model = models.pivot(scene)
        matrix, right, _ = _assembled(model.system, "RK44")
        rate = np.linalg.solve(matrix[3:, 3:], right[3:])  # the node's position is held by coordinate constraints
        data = [np.array([model.system.GetSensorValues(sensor)]) for sensor in model.sensors]
        data[-1] = rate[None]
        return {**_states(model.convert(np.zeros(1), data)), "kinetic": None, "total_mass": None}
    return _tree(scene)


def _maximal(scene: Scene) -> dict[str, Any]:
    from crosscheck.adapters.exudyn import models

    model = models.maximal(scene)
    matrix, right, speeds = _assembled(model.system, "GeneralizedAlpha")
    data = [np.array([model.system.GetSensorValues(sensor)]) for sensor in model.sensors]
    found = _states(model.convert(np.zeros(1), data))
    free = not scene.joints
    items = [model.system.GetObject(k) for k in range(model.system.systemData.NumberOfObjects())]
    bodies = [item for item in items if item["objectType"] == "RigidBody"]
    turned = np.array([_inertia(item["inertia"]) for item in bodies])  # node axes are the world's at the start
    jacobian = np.zeros((6 * scene.n, 6 * scene.n))
    for k in range(scene.n):
        jacobian[6 * k:6 * k + 3, 6 * k:6 * k + 3] = np.eye(3)
        jacobian[6 * k + 3:6 * k + 6, 6 * k + 3:6 * k + 6] = scene.R0[k].T
    size = 6 * scene.n
    return {**found, "a": np.linalg.solve(matrix, right).reshape(-1, 6)[:, :3] if free else None,
            "alpha": _free_spin(scene, matrix, right) if free else None,
            "masses": np.array([item["mass"] for item in bodies]),
            "inertias": np.einsum("nji,njk,nkl->nil", scene.R0, turned, scene.R0),
            "jacobian": jacobian, "mass_matrix": matrix[:size, :size], "applied_force": right[:size],
            "gravity_force": _weight(scene, models.maximal, "GeneralizedAlpha")[:size],
            "kinetic": 0.5 * float(speeds @ matrix @ speeds), "total_mass": None}


def _free_spin(scene: Scene, matrix: np.ndarray, right: np.ndarray) -> np.ndarray:
    found: np.ndarray = np.einsum("nji,nj->ni", scene.R0, np.linalg.solve(matrix, right).reshape(-1, 6)[:, 3:])
    return found


def _tree(scene: Scene) -> dict[str, Any]:
    from crosscheck.adapters.exudyn import kinematic_tree

    closed = bool(kinematic_tree.spanned(scene)[1])
    method = "GeneralizedAlpha" if closed else "RK44"  # explicit solvers refuse constraints

    def made(order: str) -> tuple[str, Any, np.ndarray, np.ndarray, np.ndarray]:
        model = kinematic_tree.kinematic_tree(scene, order)
        return order, model, *_assembled(model.system, method)

    # every order of Cardan angles is the same system; the one farthest from its gimbal lock has the fewest roundings
    orders = ["".join(order) for order in itertools.permutations("XYZ")] if kinematic_tree.balls(scene) else ["XYZ"]
    order, model, matrix, right, speeds = min((made(order) for order in orders),
                                              key=lambda found: np.linalg.cond(found[2]))
    size = len(matrix)
    q = np.atleast_1d(model.system.GetSensorValues(model.sensors[0]))
    found = _states(model.convert(np.zeros(1), [q[None], speeds[None], np.linalg.solve(matrix, right)[None]]))
    if closed:  # the constraints are not in it
        found["a"] = found["alpha"] = None
    unit = model.convert(np.zeros(size), [np.tile(q, (size, 1)), np.eye(size), np.zeros((size, size))])
    jacobian = np.concatenate([unit.v, unit.w], axis=2).reshape(size, -1).T  # velocities are linear in the rates
    items = [model.system.GetObject(k) for k in range(model.system.systemData.NumberOfObjects())]
    tree = next(item for item in items if item["objectType"] == "KinematicTree")
    return {**found, "kinetic": 0.5 * float(speeds @ matrix @ speeds), "total_mass": float(sum(tree["linkMasses"])),
            "jacobian": jacobian, "mass_matrix": matrix,
            "gravity_force": _weight(scene, lambda bare: kinematic_tree.kinematic_tree(bare, order), method)}


def _states(states: States) -> dict[str, Any]:
    """One time of `states` by the names of a probe."""
    return {key: None if getattr(states, key) is None else getattr(states, key)[0]
            for key in ("x", "R", "v", "w", "a", "alpha")}


def _inertia(entries: Any) -> np.ndarray:
    xx, yy, zz, yz, xz, xy = entries
    return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])


def _weight(scene: Scene, build: Any, method: str) -> np.ndarray:
    """Right-hand side of the scene at rest and without forces: its gravity."""
    rest = tuple(dataclasses.replace(body, velocity=np.zeros(3), angular_velocity=np.zeros(3)) for body in scene.bodies)
    bare = scene.replace(bodies=rest, forces=())
    return _assembled(build(bare).system, method)[1]


def _assembled(system: Any, method: str) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(mass matrix, right-hand side, velocities) of the second-order coordinates at the initial state."""
    from crosscheck.adapters.exudyn import solving

    exudyn = solving.load()
    implicit = method in solving.IMPLICIT
    solver = exudyn.MainSolverImplicitSecondOrder() if implicit else exudyn.MainSolverExplicit()
    options = solving.settings(method, 1e-3, 1, 1, 1e-9)
    system.Assemble()
    solver.InitializeSolver(system, options)
    solver.ComputeMassMatrix(system)
    matrix = np.array(solver.GetSystemMassMatrix())
    solver.ComputeODE2RHS(system)
    right = np.array(solver.GetSystemResidual())[:len(matrix)]
    speeds = np.array(system.systemData.GetODE2Coordinates_t())
    solver.FinalizeSolver(system, options)
    return matrix, right, speeds


