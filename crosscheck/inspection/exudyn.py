"""What Exudyn says about a scene: the mass matrix and right-hand side that its solvers assemble.

In joint coordinates (forms `tree` and `pivot`) one linear solve with these gives the accelerations. With constraints
it does not: Exudyn computes their velocity-dependent part by one-sided differences, with errors of 1e-7 of the terms.
"""

from __future__ import annotations

import dataclasses
import itertools
from typing import Any

import numpy as np

from crosscheck.adapters.exudyn import kinematic_tree, models, solving
from crosscheck.inspection.admissible import posed
from crosscheck.inspection.base import Probe, stacked
from crosscheck.inspection.reference import resting
from crosscheck.scene.model import Scene
from crosscheck.scene.states import States

LINKS = "links of a kinematic tree are no bodies: some have no mass, and bodies fixed to each other are one"
PIVOT = "in form pivot the position is held by constraints that the solver eliminates"
BRISTLES = "its friction at rest is a spring that holds a joint once it has moved, by a part of the step"
DIFFERENCES = "Exudyn's constraints take their velocity-dependent part from one-sided differences, 1e-7 of the terms"


def probe(scene: Scene, states: States, form: str | None = None) -> Probe:
    """Probe the Exudyn model in form "maximal" (Lie-group nodes), "tree" or "pivot"."""
    chosen = form or "maximal"
    at = {"maximal": _maximal, "pivot": _pivot, "tree": _tree}[chosen]
    probe = stacked([at(posed(scene, states, k)) for k in range(len(states.t))])
    probe.notes = {"potential energy": "Exudyn sums up no potential energy"}
    if probe.masses is None:
        probe.notes |= dict.fromkeys(("mass", "inertia", "centre of mass"), LINKS if chosen == "tree" else PIVOT)
    if chosen == "pivot":
        probe.notes |= dict.fromkeys(("total mass", "kinetic energy", "mass matrix", "gravity force"), PIVOT)
    if any(resting(scene, *(getattr(states, name)[k:k + 1] for name in "xRvw")) for k in range(len(states.t))):
        probe.a = probe.alpha = None
        probe.notes |= dict.fromkeys(("acceleration", "angular acceleration"), BRISTLES)
    elif probe.a is None:
        probe.notes |= dict.fromkeys(("acceleration", "angular acceleration"), DIFFERENCES)
    return probe


def _pivot(scene: Scene) -> Probe:
    model = models.pivot(scene)
    matrix, right, _ = _assembled(model.system, "RK44")
    rate = np.linalg.solve(matrix[3:, 3:], right[3:])  # the node's position is held by coordinate constraints
    data = [np.array([model.system.GetSensorValues(sensor)]) for sensor in model.sensors]
    data[-1] = rate[None]
    return _moving("pivot", model.convert(np.zeros(1), data))


def _maximal(scene: Scene) -> Probe:
    from scipy.linalg import block_diag

    model = models.maximal(scene)
    matrix, right, speeds = _assembled(model.system, "GeneralizedAlpha")
    data = [np.array([model.system.GetSensorValues(sensor)]) for sensor in model.sensors]
    probe = _moving("maximal", model.convert(np.zeros(1), data))
    probe.a = probe.alpha = None
    if not scene.joints:
        rates = np.linalg.solve(matrix, right).reshape(-1, 6)
        probe.a, probe.alpha = rates[None, :, :3], np.einsum("nji,nj->ni", scene.R0, rates[:, 3:])[None]
    items = [model.system.GetObject(k) for k in range(model.system.systemData.NumberOfObjects())]
    bodies = [item for item in items if item["objectType"] == "RigidBody"]
    turned = np.array([_inertia(item["inertia"]) for item in bodies])  # node axes are the world's at the start
    size = 6 * scene.n
    jacobian = block_diag(*(part for R in scene.R0 for part in (np.eye(3), R.T)))
    return dataclasses.replace(
        probe, masses=np.array([item["mass"] for item in bodies]),
        inertias=np.einsum("nji,njk,nkl->nil", scene.R0, turned, scene.R0), jacobian=jacobian[None],
        mass_matrix=matrix[None, :size, :size], applied_force=right[None, :size],
        gravity_force=_weight(scene, models.maximal, "GeneralizedAlpha")[None, :size],
        kinetic=np.array([0.5 * speeds @ matrix @ speeds]))


def _tree(scene: Scene) -> Probe:
    closed = bool(kinematic_tree.spanned(scene)[1]) or any(joint.mimic is not None for joint in scene.joints)
    method = "GeneralizedAlpha" if closed else "RK44"  # explicit solvers refuse constraints

    def made(order: str) -> tuple[str, Any, np.ndarray, np.ndarray, np.ndarray]:
        model = kinematic_tree.kinematic_tree(scene, order)
        return order, model, *_assembled(model.system, method)

    # The order of Cardan angles does not change the system. The one farthest from gimbal lock has the least rounding.
    orders = ["".join(order) for order in itertools.permutations("XYZ")] if kinematic_tree.balls(scene) else ["XYZ"]
    order, model, matrix, right, speeds = min((made(order) for order in orders),
                                              key=lambda probe: np.linalg.cond(probe[2]))
    size = len(matrix)
    q = np.atleast_1d(model.system.GetSensorValues(model.sensors[0]))
    probe = _moving("tree", model.convert(np.zeros(1), [q[None], speeds[None], np.linalg.solve(matrix, right)[None]]))
    if closed:  # the solve above leaves the constraints out
        probe.a = probe.alpha = None
    unit = model.convert(np.zeros(size), [np.tile(q, (size, 1)), np.eye(size), np.zeros((size, size))])
    jacobian = np.concatenate([unit.v, unit.w], axis=2).reshape(size, -1).T  # velocities are linear in the rates
    items = [model.system.GetObject(k) for k in range(model.system.systemData.NumberOfObjects())]
    tree = next(item for item in items if item["objectType"] == "KinematicTree")
    return dataclasses.replace(
        probe, kinetic=np.array([0.5 * speeds @ matrix @ speeds]), total_mass=float(sum(tree["linkMasses"])),
        jacobian=jacobian[None], mass_matrix=matrix[None],
        gravity_force=_weight(scene, lambda bare: kinematic_tree.kinematic_tree(bare, order), method)[None])


def _moving(form: str, states: States) -> Probe:
    return Probe("exudyn", form, x=states.x, R=states.R, v=states.v, w=states.w, a=states.a, alpha=states.alpha)


def _inertia(entries: Any) -> np.ndarray:
    xx, yy, zz, yz, xz, xy = entries
    return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])


def _weight(scene: Scene, build: Any, method: str) -> np.ndarray:
    """The gravity force: the right-hand side of the scene at rest without other forces."""
    rest = tuple(dataclasses.replace(body, velocity=np.zeros(3), angular_velocity=np.zeros(3)) for body in scene.bodies)
    return _assembled(build(scene.replace(bodies=rest).unloaded).system, method)[1]


def _assembled(system: Any, method: str) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(mass matrix, right-hand side, velocities) of the second-order coordinates at the initial state."""
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


