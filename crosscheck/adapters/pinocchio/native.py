"""Loads a model file with Pinocchio alone."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from crosscheck.adapters.common.native import Hinge, JointStates, Link, Native, moved, solids
from crosscheck.errors import EngineError
from crosscheck.scene.models.second import explained
from crosscheck.scene.models.second import links as first_links

if TYPE_CHECKING:
    import pinocchio


def _shapes(path: str, model: pinocchio.Model, names: dict[int, str]) -> dict[str, str] | None:
    """The collision shapes of a URDF, in the frames of joints; None where it cannot read one, such as a mesh."""
    import pinocchio

    if not path.endswith(".urdf"):
        return None
    try:
        made = explained(lambda: pinocchio.buildGeomFromUrdf(model, path, pinocchio.COLLISION))
    except ValueError:
        return None
    listed = []
    for solid in made.geometryObjects:
        shape, kind = solid.geometry, type(solid.geometry).__name__.lower()
        sizes = [2 * each for each in shape.halfSide] if kind == "box" else [shape.radius] if kind == "sphere" else (
            [shape.radius, 2 * shape.halfLength] if kind in ("cylinder", "capsule") else [])
        listed.append((names.get(solid.parentJoint, "ground"), kind if sizes else "mesh", sizes,
                     solid.placement.translation))
    return solids(listed)


def load(path: str, states: JointStates) -> Native:
    """The file read by Pinocchio; accelerations by `aba` without torques."""
    import pinocchio

    read = pinocchio.buildModelFromMJCF if path.endswith(".xml") else pinocchio.buildModelFromUrdf
    try:
        model = explained(lambda: read(path))
    except ValueError as error:
        raise EngineError(str(error)) from None
    data = model.createData()
    pinocchio.forwardKinematics(model, data, pinocchio.neutral(model), np.zeros(model.nv))
    moving = first_links(model)
    names = {joint: name for name, joint in moving.items()}
    if not all(np.isfinite(each.inertia).all() and np.isfinite(each.mass) for each in model.inertias):
        raise EngineError("its model has masses or inertias that are not finite")
    links = {name: Link(float(model.inertias[joint].mass), np.array(model.inertias[joint].inertia))
             for name, joint in moving.items()}
    joints, ids = {}, {}
    for joint in (joint for joint in range(1, model.njoints) if model.nvs[joint] == 1):
        parent, at, v = int(model.parents[joint]), model.jointPlacements[joint], int(model.idx_vs[joint])
        subspace = np.array(data.joints[joint].S).ravel()
        slides = np.abs(subspace[:3]).max() > 0.5
        inner = model.inertias[parent].lever if parent else np.zeros(3)
        name = model.names[joint]
        if name not in states.names and f"{names.get(joint)} joint" in states.names:  # unnamed in the file
            name = f"{names[joint]} joint"
        ids[name], at_q = joint, model.idx_qs[joint]
        joints[name] = Hinge(
            names.get(parent, "ground") if parent else "ground", names.get(joint, model.names[joint]),
            at.translation - inner, -np.array(model.inertias[joint].lever),
            subspace[:3] if slides else subspace[3:], np.array(at.rotation), "prismatic" if slides else "revolute",
            float(model.damping[v]), float(model.armature[v]), limits=None if model.nqs[joint] == 2 else (
                float(model.lowerPositionLimit[at_q]), float(model.upperPositionLimit[at_q])),
            laws={"friction": float(model.upperDryFrictionLimit[v]), "effort": float(model.upperEffortLimit[v]),
                  "velocity limit": float(model.upperVelocityLimit[v])})
    native = Native("pinocchio", links, joints, model.gravity.linear.copy(), solver="aba", frictionless=True,
                    shapes=_shapes(path, model, names))
    if len(joints) != model.nv:
        return native

    def terms(position: np.ndarray, velocity: np.ndarray) -> tuple[np.ndarray, ...]:
        q = pinocchio.neutral(model)
        for joint in ids.values():
            at, angle = model.idx_qs[joint], position[model.idx_vs[joint]]
            q[at:at + model.nqs[joint]] = [np.cos(angle), np.sin(angle)] if model.nqs[joint] == 2 else [angle]
        M = np.triu(pinocchio.crba(model, data, q))
        return (M + np.triu(M, 1).T, pinocchio.nonLinearEffects(model, data, q, velocity).copy(),
                pinocchio.aba(model, data, q, velocity, np.zeros(model.nv)).copy())

    return moved(native, states, {name: int(model.idx_vs[joint]) for name, joint in ids.items()}, "aba", terms)
