"""Bodies that fixed joints weld together are integrated as one body.

The composite body has the sum of the masses, its centre of mass, and the inertia about it, in the axes of the first of
its bodies. Anchors, points and axes of the others move into these axes, (16.1) of docs/theory.md:

    point of body b:  c_b + P_b point,    P_b = R_0^T R_b,    c_b = R_0^T (x_b - X)

The rows of the welds are left out. At the samples the welds are closed to rounding.
"""

from __future__ import annotations

import numpy as np

from lieeuler.joints import Joint
from lieeuler.problem import DEPENDENT, ROUNDING, Body, Problem, once
from lieeuler.reduced import Reduced
from lieeuler.types import GROUND


@once
def welded_for(problem: Problem) -> Reduced | None:
    """The problem with its welded bodies as one; None if there are none, if a joint or force ties a composite to
    itself, or if joints are open at the start."""
    kept = {k: joint for k, joint in enumerate(problem.joints) if not _is_weld(problem, joint)}
    welds = [joint for k, joint in enumerate(problem.joints) if k not in kept]
    if not welds or not problem.opening <= ROUNDING:
        return None
    first = list(range(problem.n))  # of the bodies welded to each
    for weld in welds:
        low, high = sorted((first[weld.parent], first[weld.child]))
        first = [low if b == high else b for b in first]
    bases = sorted(set(first))
    body = np.array([bases.index(b) for b in first])
    tied = any(item.parent != GROUND and first[item.parent] == first[item.child]
               for item in (*kept.values(), *problem.forces))
    follows_weld = any(joint.mimic is not None and joint.mimic.joint not in kept for joint in kept.values())
    if len(bases) + len(welds) != problem.n or tied or follows_weld:
        return None
    mass = np.array([body.mass for body in problem.bodies])
    total = np.bincount(body, mass)
    X, V = (np.array([np.bincount(body, mass * column) for column in vectors.T]).T / total[:, None]
            for vectors in (problem.x, problem.v))
    R, w = problem.R[bases], problem.w[bases]
    turn = np.swapaxes(R[body], 1, 2) @ problem.R
    centre = np.einsum("bji,bj->bi", R[body], problem.x - X[body])
    inertia = np.zeros((len(bases), 3, 3))
    for b, part in enumerate(problem.bodies):
        moved = turn[b] @ part.inertia @ turn[b].T
        inertia[body[b]] += (moved + moved.T) / 2
        inertia[body[b]] += part.mass * (centre[b] @ centre[b] * np.eye(3) - np.outer(centre[b], centre[b]))
    bodies = [Body(m, J) for m, J in zip(total, inertia, strict=True)]
    composites = Reduced("welded", problem, body=body, centre=centre, turn=turn)
    return composites.between_carriers(bodies, list(kept), X, R, V, w)


def _is_weld(problem: Problem, joint: Joint) -> bool:
    """Whether a joint is a fixed joint between two bodies, and nothing else."""
    rows = joint.basic_rows
    return (joint.parent != GROUND and joint.spherical and joint.rows == 6 and not joint.rotors and rows is not None
            and len(rows[1]) == 3
            and int(np.linalg.matrix_rank(problem.held_turns(joint, rows[1]), tol=DEPENDENT)) == 3)
