"""The truth of a static cross-check: the scene's own constraint equations, solved with dense NumPy, without engines."""

from __future__ import annotations

import dataclasses

import numpy as np

from crosscheck.inspection import admissible
from crosscheck.inspection.base import Probe
from crosscheck.scene import mechanics
from crosscheck.scene.armature import rotors
from crosscheck.scene.constraints import Constraints
from crosscheck.scene.model import Scene
from crosscheck.scene.states import States

AT_REST = 1e-12
"""A scene is at rest if its kinetic energy is below this fraction of the energy that its typical speed has."""


@dataclasses.dataclass(frozen=True)
class Reference:
    """The truth, and what a comparison with it needs.

    `bases` are the admissible velocities N at every state, with N^T M N = I. `unique` names the joints whose reactions
    are uniquely determined at each state: with redundant constraints some are not. `scales` are the sizes of the terms
    of each quantity.
    """

    probe: Probe
    bases: tuple[np.ndarray, ...]
    unique: tuple[frozenset[str], ...]
    scales: dict[str, float]


def reference(scene: Scene, at: States) -> Reference:
    """The truth of `scene` at the K states `at`. Each is a separate start, with torsion angles in (-pi, pi]."""
    constraints = Constraints(scene)
    count, n = len(at.t), scene.n
    mass = np.linalg.inv(mechanics.inverse_mass(scene))
    weight = np.concatenate([scene.masses[:, None] * scene.gravity, np.zeros((n, 3))], axis=1).ravel()
    rows = [slice(k, k + 1) for k in range(count)]
    angles = [mechanics.torsion_angles(scene, at.R[k]) for k in rows]
    found = [mechanics.index1(scene, at.x[k], at.R[k], at.v[k], at.w[k], angle)
             for k, angle in zip(rows, angles, strict=True)]  # separately, because states may differ in rank
    a, alpha, lam = (np.concatenate(part) for part in zip(*found, strict=True))
    potential = [mechanics.potential_energy(scene, at.x[k], at.R[k], angle)[0]
                 for k, angle in zip(rows, angles, strict=True)]
    identity = np.broadcast_to(np.eye(6 * n), (count, 6 * n, 6 * n))
    masses = np.broadcast_to(mass, identity.shape)
    for inertia, S, _ in rotors(scene, at.x, at.R, at.v, at.w):
        masses = masses + inertia * S[:, :, None] * S[:, None, :]
    applied = np.concatenate([mechanics.applied_forces(scene, at.x[k], at.R[k], at.v[k], at.w[k], angle)
                              for k, angle in zip(rows, angles, strict=True)])
    probe = Probe(
        "truth", "maximal", scene.masses, scene.inertias, at.x, at.R, at.v, at.w,
        kinetic=mechanics.kinetic_energy(scene, at), potential=np.array(potential), jacobian=identity,
        mass_matrix=masses, gravity_force=np.broadcast_to(weight, (count, 6 * n)),
        applied_force=applied, a=a, alpha=alpha, reactions=constraints.reactions(at.x, at.R, lam))
    constraint = np.einsum("tmk,tm->tk", constraints.jacobian(at.x, at.R), lam)
    return Reference(
        probe, tuple(admissible.basis(scene, constraints, at.x[k], at.R[k]) for k in range(count)),
        tuple(_unique(constraints, at.x[k], at.R[k]) for k in rows), _scales(scene, at, probe, applied, constraint))


def _unique(constraints: Constraints, x: np.ndarray, R: np.ndarray) -> frozenset[str]:
    """Joints whose wrench is the same for all multipliers that give the same motion."""
    if constraints.m == 0:
        return frozenset()
    G = constraints.jacobian(x, R)[0]
    U, sigma, _ = np.linalg.svd(G)
    rank = int(np.count_nonzero(sigma > mechanics.RANK_TOLERANCE * sigma[0]))
    free = U[:, rank:]  # sets of multipliers that together exert no force on any body
    bent = {joint.name: G[constraints.rows[joint.name]][:, 6 * joint.child:6 * joint.child + 6].T
            @ free[constraints.rows[joint.name]] for joint in constraints.scene.joints}
    return frozenset(name for name, wrench in bent.items()
                     if np.abs(wrench).max(initial=0.0) < mechanics.RANK_TOLERANCE * sigma[0])


def _scales(scene: Scene, at: States, probe: Probe, applied: np.ndarray, constraint: np.ndarray) -> dict[str, float]:
    """Size of the terms of each quantity. If it has none (no gravity, at rest), its size in a motion of about 1 rad/s.
    """
    assert probe.kinetic is not None
    L = max(admissible.length(scene), float(np.abs(at.x).max()))
    total, g = float(scene.masses.sum()), float(np.linalg.norm(scene.gravity))
    spin = max(float(np.abs(at.w).max()), 1.0)
    speed = max(float(np.abs(at.v).max()), spin * L)
    inverse = mechanics.inverse_mass(scene)
    rates = np.abs(np.stack([applied @ inverse, constraint @ inverse])).reshape(-1, 6)
    forces = np.abs(np.stack([applied, constraint])).reshape(-1, 6)
    linear, force = float(rates[:, :3].max()), float(forces[:, :3].max()) or total * speed
    moving = float(probe.kinetic.max())
    springs = sum(0.5 * f.parameters["stiffness"] * (L if f.type == "linear_spring" else np.pi) ** 2
                  for f in scene.forces if "stiffness" in f.parameters)
    return {
        "position": L, "attitude": 1.0, "velocity": speed, "angular velocity": spin,
        "total mass": total, "centre of mass": L,
        "kinetic energy": moving if moving > AT_REST * total * speed**2 else total * speed**2,
        "potential energy": total * g * L + springs or total * speed**2, "mass matrix": 1.0,
        "gravity force": np.sqrt(total) * (g or speed),
        "applied force": float(np.abs(applied @ np.linalg.cholesky(inverse)).max()) or np.sqrt(total) * speed,
        "acceleration": max(linear, g, spin * speed),
        "angular acceleration": max(float(rates[:, 3:].max()), spin**2),
        "reaction force": force, "reaction torque": max(force * L, float(forces[:, 3:].max())),
    }
