"""What lieeuler's kernel says about a scene: the accelerations at the start of a run."""

from __future__ import annotations

import numpy as np

from crosscheck.adapters.lieeuler import build_problem, start
from crosscheck.inspection.admissible import posed
from crosscheck.inspection.base import Probe
from crosscheck.scene.model import Scene
from crosscheck.scene.states import States


def probe(scene: Scene, states: States, form: str | None = None) -> Probe:
    """Probe the kernel's `Problem` in maximal coordinates. Each state is the start of a run of one step."""
    from scipy.linalg import block_diag

    count, problem = len(states.t), build_problem(scene)
    starts = [start(build_problem(posed(scene, states, k))) for k in range(count)]
    x, R, v, w, a, alpha = (np.array([getattr(each, field)[0] for each in starts])
                            for field in ("x", "R", "v", "w", "a", "alpha"))
    masses = np.array([body.mass for body in problem.bodies])
    inertias = np.array([body.inertia for body in problem.bodies])
    matrix = block_diag(*(part for m, J in zip(masses, inertias, strict=True) for part in (m * np.eye(3), J)))
    weight = np.concatenate([masses[:, None] * problem.gravity, np.zeros((scene.n, 3))], axis=1).ravel()
    notes = dict.fromkeys(("kinetic energy", "potential energy"), "the kernel reports no energies")
    geared = any(joint.rotors for joint in problem.joints)
    if geared:
        notes["mass matrix"] = "the kernel has extra rows for rotors"
    return Probe("lieeuler", "maximal", masses, inertias, x, R, v, w,
                 jacobian=np.broadcast_to(np.eye(6 * scene.n), (count, *matrix.shape)),
                 mass_matrix=None if geared else np.broadcast_to(matrix, (count, *matrix.shape)),
                 gravity_force=np.broadcast_to(weight, (count, 6 * scene.n)), a=a, alpha=alpha,
                 notes=notes)
