"""The truth of a static cross-check, and how far probes are from it, relative to the size of each quantity's terms.

The truth is the scene's own constraint equations, solved with dense NumPy, without engines.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from typing import Any

import numpy as np

from crosscheck.inspection import admissible
from crosscheck.inspection.base import LOOSEST, QUANTITIES, ROUNDINGS, TOLERANCE, Deviation, Probe
from crosscheck.scene import mechanics
from crosscheck.scene.armature import rate_row, rotors
from crosscheck.scene.constraints import Constraints
from crosscheck.scene.laws import DryFriction
from crosscheck.scene.model import Scene
from crosscheck.scene.states import States

AT_REST = 1e-12
"""A scene is at rest if its kinetic energy is below this fraction of the energy that its typical speed has."""

SWEEPS, EXACT = 1000, 1e-16
"""Most sweeps over the coordinates that friction holds, and the change, as a share, at which they end."""

SOLVED = ("mass matrix", "gravity force", "applied force", "acceleration", "angular acceleration")
"""Quantities that need the solution of a linear system in the engine's coordinates, and so have looser bounds.

The first three are mapped to common coordinates here.
"""

OF_BODIES = ("mass", "inertia", "position", "attitude", "velocity", "angular velocity", "acceleration",
             "angular acceleration")


@dataclasses.dataclass(frozen=True)
class Reference:
    """The truth, and what a comparison with it needs.

    `bases` are the admissible velocities N at every state, with N^T M N = I. `scales` are the sizes of the terms of
    each quantity.
    """

    probe: Probe
    bases: tuple[np.ndarray, ...]
    scales: dict[str, float]


def reference(scene: Scene, at: States) -> Reference:
    """The truth of `scene` at the K states `at`. Each is a separate start, its hinges within half a turn of it."""
    constraints = Constraints(scene)
    count, n = len(at.t), scene.n
    mass = mechanics.mass_matrix(scene)
    weight = np.concatenate([scene.masses[:, None] * scene.gravity, np.zeros((n, 3))], axis=1).ravel()
    solved = []
    for k in range(count):  # separately, because states may differ in rank
        one = at.at(slice(k, k + 1))
        state, angles = (one.x, one.R, one.v, one.w), mechanics.torsion_angles(scene, one)
        held = _held(scene, *state)
        solved.append((*mechanics.index1(held, *state, angles), mechanics.applied_forces(held, *state, angles),
                       mechanics.potential_energy(scene, one)))
    a, alpha, lam, applied, potential = (np.concatenate(part) for part in zip(*solved, strict=True))
    identity = np.broadcast_to(np.eye(6 * n), (count, 6 * n, 6 * n))
    masses = np.broadcast_to(mass, identity.shape)
    for inertia, S, _ in rotors(scene, at.x, at.R, at.v, at.w):
        masses = masses + inertia * S[:, :, None] * S[:, None, :]
    probe = Probe(
        "truth", "maximal", scene.masses, scene.inertias, at.x, at.R, at.v, at.w,
        kinetic=mechanics.kinetic_energy(scene, at), potential=potential, jacobian=identity,
        mass_matrix=masses, gravity_force=np.broadcast_to(weight, (count, 6 * n)),
        applied_force=applied, a=a, alpha=alpha)
    constraint = np.einsum("tmk,tm->tk", constraints.jacobian(at.x, at.R), lam)
    return Reference(
        probe, tuple(admissible.basis(scene, constraints, at.x[k], at.R[k]) for k in range(count)),
        _scales(scene, at, probe, applied, constraint))


class _Holding(DryFriction):
    """Dry friction of a coordinate at rest, which gives what keeps it there: `sliding`, N m or N, of either sign."""

    def force(self, rate: Any) -> Any:
        return np.full(np.shape(rate), self.sliding)


def resting(scene: Scene, x: np.ndarray, R: np.ndarray, v: np.ndarray, w: np.ndarray
            ) -> list[tuple[int, int, float, np.ndarray, np.ndarray]]:
    """(joint, coordinate, what friction holds, S, s) of coordinates with dry friction at rest; rate = S u.

    The state is one row.
    """
    sticking = []
    for index, joint in enumerate(scene.joints):
        for k, friction in enumerate(joint.dry_friction):
            if friction is not None:
                S, s = rate_row(joint, joint.kind.coordinates[k], scene, x, R, v, w)
                if abs(float(S[0] @ np.concatenate([v[0], w[0]], axis=1).ravel())) <= AT_REST:
                    sticking.append((index, k, friction.static, S[0], s))
    return sticking


def _held(scene: Scene, *state: np.ndarray) -> Scene:
    """The scene with the friction that keeps coordinates at rest, by Gauss' principle, one row after the other."""
    rows = resting(scene, *state)
    if not rows:
        return scene
    _, _, most, S, s = zip(*rows, strict=True)
    efforts = np.zeros(len(rows))

    def holding(sizes: np.ndarray) -> Scene:
        joints = list(scene.joints)
        for (index, k, *_), size in zip(rows, sizes, strict=True):
            parts = list(joints[index].dry_friction)
            parts[k] = _Holding(size, abs(size))
            joints[index] = dataclasses.replace(joints[index], dry_friction=tuple(parts))
        return scene.replace(joints=tuple(joints))

    def rates(sizes: np.ndarray) -> np.ndarray:
        a, alpha, _ = mechanics.index1(holding(sizes), *state)
        return np.asarray(np.array(S) @ np.concatenate([a[0], alpha[0]], axis=1).ravel() + np.concatenate(s))

    free = rates(efforts)
    W = np.array([rates(unit) - free for unit in np.eye(len(rows))]).T
    for _ in range(SWEEPS):
        before = efforts.copy()
        for k in range(len(rows)):
            efforts[k] = np.clip(efforts[k] - (free[k] + W[k] @ efforts) / W[k, k], -most[k], most[k])
        if np.abs(efforts - before).max() <= EXACT * np.abs(efforts).max():
            break
    return holding(efforts)


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
    linear, moving = float(rates[:, :3].max()), float(probe.kinetic.max())
    springs = sum(0.5 * f.parameters["stiffness"] * (np.pi if f.law.measure == "angle" else L) ** 2
                  for f in scene.loads if f.is_spring)
    return {
        "position": L, "attitude": 1.0, "velocity": speed, "angular velocity": spin,
        "total mass": total, "centre of mass": L,
        "kinetic energy": moving if moving > AT_REST * total * speed**2 else total * speed**2,
        "potential energy": total * g * L + springs or total * speed**2, "mass matrix": 1.0,
        "gravity force": np.sqrt(total) * (g or speed),
        "applied force": float(np.abs(applied @ np.linalg.cholesky(inverse)).max()) or np.sqrt(total) * speed,
        "acceleration": max(linear, g, spin * speed),
        "angular acceleration": max(float(rates[:, 3:].max()), spin**2),
    }


def deviations(scene: Scene, reference: Reference, probe: Probe) -> tuple[Deviation, ...]:
    """One deviation for each quantity in the probe, in the order of `QUANTITIES`."""
    gaps = dict(_gaps(scene, reference, probe))
    solved = TOLERANCE  # the bound of the quantities in SOLVED
    if probe.jacobian is not None and probe.mass_matrix is not None and probe.mass_matrix.size:
        sizes = np.sqrt(np.abs(np.diag(probe.mass_matrix[0])))
        scaled = probe.mass_matrix[0] / np.outer(sizes, sizes)
        if np.isfinite(scaled).all():
            rounding = ROUNDINGS * np.finfo(float).eps * np.linalg.cond(scaled)
            solved = float(np.clip(rounding, TOLERANCE, LOOSEST))
    listed = []
    for quantity in (quantity for quantity in QUANTITIES if quantity in gaps):
        sizes = gaps[quantity]
        state, place = np.unravel_index(np.argmax(np.where(np.isfinite(sizes), sizes, np.inf)), sizes.shape)
        gap, scale = float(sizes[state, place]), reference.scales.get(quantity, 1.0)
        name = scene.bodies[place].name if quantity in OF_BODIES else ""
        listed.append(Deviation(probe.engine, probe.form, quantity, gap / scale, gap, scale, name, int(state),
                               solved if quantity in SOLVED else TOLERANCE))
    return tuple(listed)


def _gaps(scene: Scene, reference: Reference, probe: Probe) -> Iterator[tuple[str, np.ndarray]]:
    """(quantity, gaps) with gaps of shape (K, places). Places are bodies, joints, or one for the whole system."""
    truth, (masses, inertias) = reference.probe, mechanics.weights(scene)
    if probe.masses is not None:
        yield "mass", np.abs(probe.masses - scene.masses)[None] / masses
    if probe.inertias is not None:
        sizes = np.abs(inertias).max(axis=(1, 2))
        yield "inertia", np.abs(probe.inertias - scene.inertias).max(axis=(1, 2))[None] / sizes
    for quantity, field in (("position", "x"), ("attitude", "R"), ("velocity", "v"), ("angular velocity", "w"),
                            ("acceleration", "a"), ("angular acceleration", "alpha")):
        values, wanted = getattr(probe, field), getattr(truth, field)
        if values is not None:
            yield quantity, np.abs(values - wanted).reshape(*values.shape[:2], -1).max(axis=2)
    total = probe.total_mass
    if total is None and probe.masses is not None:
        total = float(probe.masses.sum())
    if total is not None:
        yield "total mass", np.abs([[total - scene.masses.sum()]])
    if (centre := _centre(probe)) is not None:
        yield "centre of mass", np.abs(centre - _centre(truth)).max(axis=1)[:, None]
    for quantity, field in (("kinetic energy", "kinetic"), ("potential energy", "potential")):
        if getattr(probe, field) is not None:
            yield quantity, np.abs(getattr(probe, field) - getattr(truth, field))[:, None]
    yield from _projected(reference, probe)


def _centre(probe: Probe) -> np.ndarray | None:
    if probe.com is not None or probe.masses is None or probe.x is None:
        return probe.com
    centre: np.ndarray | None = np.einsum("n,tnk->tk", probe.masses, probe.x) / probe.masses.sum()
    return centre


def _projected(reference: Reference, probe: Probe) -> Iterator[tuple[str, np.ndarray]]:
    """Mass matrix and forces, mapped by the engine's Jacobian to the common basis of admissible velocities."""
    if probe.jacobian is None:
        return
    own = []  # per state the engine's velocities (nv, d) that move the bodies as the columns of N do
    for k, N in enumerate(reference.bases):
        rows, wanted = probe.jacobian[k], N
        if not N.size or not rows.size:
            own.append(np.zeros((rows.shape[1], N.shape[1])))
            continue
        if probe.closing is not None:  # velocities that move no body must satisfy the engine's own constraints
            rows = np.concatenate([rows, probe.closing[k]])
            wanted = np.concatenate([N, np.zeros((len(probe.closing[k]), N.shape[1]))])
        own.append(np.linalg.lstsq(rows, wanted, rcond=None)[0])
    for quantity, field in (("mass matrix", "mass_matrix"), ("gravity force", "gravity_force"),
                            ("applied force", "applied_force")):
        values, wanted = getattr(probe, field), getattr(reference.probe, field)
        if values is None:
            continue
        gaps = []
        for Q, N, engine, truth in zip(own, reference.bases, values, wanted, strict=True):
            actual, meant = ((Q.T @ engine @ Q, N.T @ truth @ N) if engine.ndim == 2 else (Q.T @ engine, N.T @ truth))
            gaps.append([np.abs(actual - meant).max(initial=0.0)])
        yield quantity, np.array(gaps)
