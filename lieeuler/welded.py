"""Bodies that fixed joints weld together are integrated as one body.

The composite body has the sum of the masses, its centre of mass, and the inertia about it, in the axes of the first of
its bodies. Anchors, points and axes of the others move into these axes, (16.1) of docs/theory.md:

    point of body b:  c_b + P_b point,    P_b = R_0^T R_b,    c_b = R_0^T (x_b - X)

The rows of the welds are left out. At the samples the welds are closed to rounding.
"""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np

from lieeuler.joints import Joint
from lieeuler.problem import DEPENDENT, ROUNDING, Body, Problem, once
from lieeuler.reduced import Carriers, Reduced
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
    composites = _Composites(problem, body, centre, turn, np.eye(3), R)
    fewer = Problem(tuple(Body(m, J) for m, J in zip(total, inertia, strict=True)),
                    tuple(composites.whole(joint, list(kept)) for joint in kept.values()), problem.gravity, X, R, V, w,
                    tuple(composites.force(force, "a force") for force in problem.forces), problem.time)
    return Reduced.of("welded", problem, fewer, body=body, centre=centre, turn=turn)


def _is_weld(problem: Problem, joint: Joint) -> bool:
    """Whether a joint is a fixed joint between two bodies, and nothing else."""
    if (joint.parent == GROUND or not joint.spherical or len(joint.dots) != 3 or joint.rows != 6 or joint.rotors
            or any((dot.a, dot.b, dot.constant) != ("parent", "child", 0.0) for dot in joint.dots)):
        return False
    turns = [dot.scale * np.cross(problem.R[joint.child] @ dot.b_axis, problem.R[joint.parent] @ dot.a_axis)
             for dot in joint.dots]
    return bool(np.linalg.matrix_rank(turns, tol=DEPENDENT) == 3)


class _Composites(Carriers):
    """All rows of joints move with their bodies."""

    def whole(self, joint: Joint, kept: list[int]) -> Joint:
        """The joint with all of its rows; `kept` are the joints that are left, by their old index."""
        ends, changed = {"parent": joint.parent, "child": joint.child, "difference": GROUND}, dict[str, Any]()
        changed["dots"] = tuple(dataclasses.replace(
            dot, a_axis=self.vector(ends[dot.a], dot.a_axis), b_axis=self.vector(ends[dot.b], dot.b_axis))
            for dot in joint.dots)
        if (contact := joint.contact) is not None:
            changed["contact"] = dataclasses.replace(contact, axis=self.vector(joint.child, contact.axis))
        if (mimic := joint.mimic) is not None:
            leader = self.problem.joints[mimic.joint]
            changed["mimic"] = dataclasses.replace(
                mimic, joint=kept.index(mimic.joint),
                coordinate=self.coordinate(mimic.coordinate, joint.parent, joint.child, "a mimic"),
                leader=self.coordinate(mimic.leader, leader.parent, leader.child, "a mimic"))
        return self.joint(joint, **changed)
