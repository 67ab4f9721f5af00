"""What Pinocchio says about a scene: its algorithms (crba, centerOfMass, ...) and the adapter's dynamics."""

from __future__ import annotations

from typing import Any

import numpy as np

from crosscheck.adapters.common import open_tree
from crosscheck.adapters.pinocchio import models
from crosscheck.adapters.pinocchio.dynamics import Dynamics
from crosscheck.inspection.admissible import posed
from crosscheck.inspection.base import Probe, stacked
from crosscheck.scene.model import GROUND, Scene
from crosscheck.scene.states import States

SPRINGS = "Pinocchio has no springs: the adapter applies them as forces, so that Pinocchio does not know their energy"

ROWS = "dry friction and rigid limits are rows of a step, which its forward dynamics leave out"


def probe(scene: Scene, states: States, form: str | None = None) -> Probe:
    """Probe the Pinocchio model in form "tree" or "maximal"."""
    chosen = form or "tree"
    dynamics = Dynamics(models.build(scene, chosen))
    probe = stacked([_at(dynamics, chosen, posed(scene, states, k)) for k in range(len(states.t))])
    if any(not link.parts for link in dynamics.model.links):
        probe.masses = probe.inertias = None
        probe.notes |= dict.fromkeys(("mass", "inertia"), "Pinocchio keeps one inertia for bodies fixed to each other")
    if any(joint == 0 for body, (joint, _) in dynamics.model.frames.items() if body != GROUND):
        probe.total_mass = probe.com = probe.potential = None
        probe.notes |= dict.fromkeys(("total mass", "centre of mass", "potential energy"),
                                     "Pinocchio leaves bodies fixed to the ground out of its sums")
    if np.any(dynamics.model.model.armature):
        probe.kinetic, probe.notes["kinetic energy"] = None, "Pinocchio leaves rotors out of its kinetic energy"
    if dynamics.model.mimics is not None:
        probe.notes |= dict.fromkeys(("kinetic energy", "potential energy"),
                                     "Pinocchio does not compute energies of models with mimic joints")
    if open_tree.rowed(scene):
        probe.a = probe.alpha = None
        probe.notes |= dict.fromkeys(("acceleration", "angular acceleration"), ROWS)
    if any(force.is_spring for force in scene.loads):
        probe.potential, probe.notes["potential energy"] = None, SPRINGS
    return probe


def _at(dynamics: Dynamics, form: str, scene: Scene) -> Probe:
    """Probe the model at the initial state of `scene`, which differs from the model's scene in its state only."""
    import pinocchio

    model, data, own = dynamics.model.model, dynamics.data, dynamics.model
    q, v = own.initial_state(scene)
    a = dynamics(q, v)
    applied = dynamics.applied(q, v)
    pinocchio.forwardKinematics(model, data, q, v, a)
    kinetic, potential = (None, None) if own.mimics else (
        np.array([pinocchio.computeKineticEnergy(model, data, q, v)]),
        np.array([pinocchio.computePotentialEnergy(model, data, q)]))
    mass_matrix = dynamics.mass_matrix(q)
    gravity = -pinocchio.computeGeneralizedGravity(model, data, q).copy()
    pinocchio.computeJointJacobians(model, data, q)
    pinocchio.forwardKinematics(model, data, q, v, a)
    masses, inertias, *motion, jacobian = (np.array(column) for column in zip(
        *(_body(model, data, *own.frames[k]) for k in range(scene.n)), strict=True))
    for part, body in own.parts.items():  # a body that the adapter has cut in two
        mass, inertia, *_ = _body(model, data, *own.frames[part])
        masses[body] += mass
        inertias[body] += inertia
    x, R, velocity, w, acceleration, alpha = (values[None] for values in motion)
    probe = Probe(
        "pinocchio", form, masses, inertias, x, R, velocity, w, float(pinocchio.computeTotalMass(model)),
        pinocchio.centerOfMass(model, data, q)[None].copy(), kinetic, potential,
        jacobian.reshape(1, 6 * scene.n, model.nv), mass_matrix=mass_matrix[None],
        gravity_force=gravity[None], a=acceleration, alpha=alpha)
    if (closure := dynamics.closure) is not None:
        probe.closing = pinocchio.getConstraintsJacobian(model, data, closure.models, closure.workspaces)[None].copy()
    if all(link.type == "free" for link in own.links):
        probe.applied_force = applied[None]
    return probe


def _body(model: Any, data: Any, joint: int, frame: Any) -> tuple[float, np.ndarray, *tuple[np.ndarray, ...]]:
    """Mass, inertia, x, R, v, w, a, alpha and Jacobian (6, nv) of a body, which has this frame on this joint."""
    import pinocchio

    placement = data.oMi[joint] * frame
    R, still = placement.rotation.copy(), pinocchio.Motion.Zero()
    twist, rate = (frame.actInv(data.v[joint]), frame.actInv(data.a[joint])) if joint else (still, still)
    jacobian = np.zeros((6, model.nv))
    if joint:
        local = pinocchio.getJointJacobian(model, data, joint, pinocchio.ReferenceFrame.LOCAL)
        jacobian = frame.toActionMatrixInverse() @ local
        jacobian[:3] = R @ jacobian[:3]
    inertia = frame.actInv(model.inertias[joint])
    return (inertia.mass, inertia.inertia.copy(), placement.translation.copy(), R, R @ twist.linear,
            twist.angular.copy(), R @ (rate.linear + np.cross(twist.angular, twist.linear)), rate.angular.copy(),
            jacobian)
