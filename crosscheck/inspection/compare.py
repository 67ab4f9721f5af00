"""Deviations of probes from the truth, relative to the size of each quantity's terms."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from crosscheck.inspection.base import LOOSEST, QUANTITIES, ROUNDINGS, TOLERANCE, Deviation, Probe
from crosscheck.inspection.reference import Reference
from crosscheck.scene.model import Scene

SOLVED = ("mass matrix", "gravity force", "applied force", "acceleration", "angular acceleration", "reaction force",
          "reaction torque")
"""Quantities that need the solution of a linear system in the engine's coordinates, and so have looser bounds.

The first three are mapped to common coordinates here.
"""

OF_BODIES = ("mass", "inertia", "position", "attitude", "velocity", "angular velocity", "acceleration",
             "angular acceleration")


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
    found = []
    for quantity in (quantity for quantity in QUANTITIES if quantity in gaps):
        sizes = gaps[quantity]
        state, place = np.unravel_index(np.argmax(np.where(np.isfinite(sizes), sizes, np.inf)), sizes.shape)
        gap, scale = float(sizes[state, place]), reference.scales.get(quantity, 1.0)
        of_joints = quantity.startswith("reaction")
        name = (scene.joints if of_joints else scene.bodies)[place].name if of_joints or quantity in OF_BODIES else ""
        found.append(Deviation(probe.engine, probe.form, quantity, gap / scale, gap, scale, name, int(state),
                               solved if quantity in SOLVED else TOLERANCE))
    return tuple(found)


def _gaps(scene: Scene, reference: Reference, probe: Probe) -> Iterator[tuple[str, np.ndarray]]:
    """(quantity, gaps) with gaps of shape (K, places). Places are bodies, joints, or one for the whole system."""
    truth = reference.probe
    if probe.masses is not None:
        yield "mass", np.abs(probe.masses - scene.masses)[None] / scene.masses
    if probe.inertias is not None:
        sizes = np.abs(scene.inertias).max(axis=(1, 2))
        yield "inertia", np.abs(probe.inertias - scene.inertias).max(axis=(1, 2))[None] / sizes
    for quantity, field in (("position", "x"), ("attitude", "R"), ("velocity", "v"), ("angular velocity", "w"),
                            ("acceleration", "a"), ("angular acceleration", "alpha")):
        found, wanted = getattr(probe, field), getattr(truth, field)
        if found is not None:
            yield quantity, np.abs(found - wanted).reshape(*found.shape[:2], -1).max(axis=2)
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
    if probe.reactions is not None:
        yield from _reactions(scene, reference, probe)


def _centre(probe: Probe) -> np.ndarray | None:
    if probe.com is not None or probe.masses is None or probe.x is None:
        return probe.com
    found: np.ndarray | None = np.einsum("n,tnk->tk", probe.masses, probe.x) / probe.masses.sum()
    return found


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
        found, wanted = getattr(probe, field), getattr(reference.probe, field)
        if found is None:
            continue
        gaps = []
        for Q, N, engine, truth in zip(own, reference.bases, found, wanted, strict=True):
            seen, meant = ((Q.T @ engine @ Q, N.T @ truth @ N) if engine.ndim == 2 else (Q.T @ engine, N.T @ truth))
            gaps.append([np.abs(seen - meant).max(initial=0.0)])
        yield quantity, np.array(gaps)


def _reactions(scene: Scene, reference: Reference, probe: Probe) -> Iterator[tuple[str, np.ndarray]]:
    assert probe.reactions is not None
    assert reference.probe.reactions is not None
    if not frozenset.union(*reference.unique):
        return
    for part, quantity in enumerate(("reaction force", "reaction torque")):
        gaps = np.zeros((len(reference.bases), len(scene.joints)))
        for column, joint in enumerate(scene.joints):
            gap = np.abs(probe.reactions[joint.name][part] - reference.probe.reactions[joint.name][part]).max(axis=1)
            gaps[:, column] = np.where([joint.name in unique for unique in reference.unique], gap, 0.0)
        yield quantity, gaps
