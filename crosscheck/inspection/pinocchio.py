"""What Pinocchio says of a scene: crba, rnea, computeTotalMass and the adapter's dynamics on its model."""

from __future__ import annotations

from typing import Any

import numpy as np

from crosscheck.inspection.admissible import posed
from crosscheck.inspection.base import Probe
from crosscheck.scene.model import GROUND, Scene
from crosscheck.scene.states import States

SPRINGS = "Pinocchio has no springs: the adapter applies them as forces, and nobody stores their energy"


def probe(scene: Scene, states: States, form: str | None = None) -> Probe:
    """The Pinocchio model in form "tree" or "maximal"."""
    from crosscheck.adapters.pinocchio import models
    from crosscheck.adapters.pinocchio.dynamics import Dynamics

    chosen = form or "tree"
    dynamics = Dynamics(models.build(scene, chosen))
    found = [_at(dynamics, posed(scene, states, k)) for k in range(len(states.t))]
    values: dict[str, Any] = {key: np.array([one[key] for one in found]) for key in found[0] if key != "reactions"}
    notes = {}
    values["total_mass"] = float(values["total_mass"][0])
    if any(not link.parts for link in dynamics.model.links):
        values["masses"] = values["inertias"] = None
        notes = dict.fromkeys(("mass", "inertia"), "Pinocchio keeps one inertia for bodies fixed to each other")
    else:
        values["masses"], values["inertias"] = values["masses"][0], values["inertias"][0]
    values["reactions"] = {joint.name: tuple(np.array(part) for part in zip(
        *(one["reactions"][joint.name] for one in found), strict=True)) for joint in scene.joints}
    if any(joint == 0 for body, (joint, _) in dynamics.model.frames.items() if body != GROUND):
        left_out = ("total mass", "centre of mass", "potential energy")
        values |= dict.fromkeys(("total_mass", "com", "potential"))
        notes |= dict.fromkeys(left_out, "Pinocchio leaves bodies fixed to the ground out of its sums")
    if any(force.type.endswith("spring") for force in scene.forces):
        values["potential"], notes["potential energy"] = None, SPRINGS
    return Probe("pinocchio", chosen, notes=notes, **values)


def _at(dynamics: Any, scene: Scene) -> dict[str, Any]:
    """Everything at the initial state of `scene`, a pose of the scene the model was built from."""
    import pinocchio

    model, data, own = dynamics.model.model, dynamics.data, dynamics.model
    q, v = dynamics.model.initial_state(scene)
    a = dynamics(q, v)
    reactions = dynamics.reactions(q, v)
    applied = dynamics.applied(q, v)
    pinocchio.computeAllTerms(model, data, q, v)
    pinocchio.forwardKinematics(model, data, q, v, a)
    kinetic = float(pinocchio.computeKineticEnergy(model, data, q, v))
    potential = float(pinocchio.computePotentialEnergy(model, data, q))
    lower = np.triu(pinocchio.crba(model, data, q))
    gravity = -pinocchio.computeGeneralizedGravity(model, data, q).copy()
    pinocchio.computeJointJacobians(model, data, q)
    pinocchio.forwardKinematics(model, data, q, v, a)
    bodies = [_body(model, data, own.frames[k]) for k in range(scene.n)]
    for part, body in own.parts.items():  # a body cut in two
        share = _body(model, data, own.frames[part])
        for key in ("masses", "inertias"):
            bodies[body][key] = bodies[body][key] + share[key]
    columns = {key: np.array([body[key] for body in bodies]) for key in bodies[0]}
    if dynamics.closure is not None:
        closure = dynamics.closure
        columns["closing"] = pinocchio.getConstraintsJacobian(model, data, closure.models, closure.workspaces).copy()
    columns["jacobian"] = columns["jacobian"].reshape(6 * scene.n, model.nv)
    if all(link.type == "free" for link in own.links):
        columns["applied_force"] = applied
    return {**columns, "kinetic": kinetic, "potential": potential, "mass_matrix": lower + np.triu(lower, 1).T,
            "gravity_force": gravity, "reactions": reactions, "total_mass": pinocchio.computeTotalMass(model),
            "com": pinocchio.centerOfMass(model, data, q).copy()}


def _body(model: Any, data: Any, carrier: tuple[int, Any]) -> dict[str, Any]:
    """Of a body in a frame on a joint: its mass and inertia there, its state, accelerations and Jacobian."""
    import pinocchio

    joint, frame = carrier
    placement = data.oMi[joint] * frame
    R, still = placement.rotation.copy(), pinocchio.Motion.Zero()
    twist, rate = (frame.actInv(data.v[joint]), frame.actInv(data.a[joint])) if joint else (still, still)
    jacobian = np.zeros((6, model.nv))
    if joint:
        local = pinocchio.getJointJacobian(model, data, joint, pinocchio.ReferenceFrame.LOCAL)
        jacobian = frame.toActionMatrixInverse() @ local
        jacobian[:3] = R @ jacobian[:3]
    inertia = frame.actInv(model.inertias[joint])
    return {"masses": inertia.mass, "inertias": inertia.inertia.copy(), "x": placement.translation.copy(), "R": R,
            "v": R @ twist.linear, "w": twist.angular.copy(), "alpha": rate.angular.copy(),
            "a": R @ (rate.linear + np.cross(twist.angular, twist.linear)), "jacobian": jacobian}
