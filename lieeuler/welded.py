"""Bodies that fixed joints weld together are integrated as one body.

The composite body has the sum of the masses, its centre of mass, and the inertia about it, in the axes of the first of
its bodies. Anchors, points and axes of the others move into these axes, (16.1) of docs/theory.md:

    point of body b:  c_b + P_b point,    P_b = R_0^T R_b,    c_b = R_0^T (x_b - X)

The rows of the welds are left out. All bodies and all multipliers are restored at the samples, where the welds are
closed to rounding.
"""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np

from lieeuler.checks import cross
from lieeuler.forces import ConstantLoad, Force, TorsionalSpring, start_angles
from lieeuler.joint_parts import Coordinate
from lieeuler.joints import Joint
from lieeuler.problem import DEPENDENT, ROUNDING, Body, Problem
from lieeuler.solution import Solution
from lieeuler.types import GROUND


@dataclasses.dataclass(frozen=True)
class Welded:
    """A problem whose welded bodies are one, and the way back.

    Attributes
    ----------
    full : Problem
        The problem as given.
    problem : Problem
        The problem of the composite bodies.
    body : (n,) int
        The composite of every body.
    centre : (n, 3)
        c: centre of mass of every body from that of its composite, axes of the composite, m.
    turn : (n, 3, 3)
        P: rotation from the axes of every body to those of its composite.
    angles : (number of forces,)
        Of torsional springs at the start, less those that `problem` counts, rad.
    """

    full: Problem
    problem: Problem
    body: np.ndarray
    centre: np.ndarray
    turn: np.ndarray
    angles: np.ndarray

    @property
    def word(self) -> str:
        """As `reduce` names it."""
        return "welded"

    def restore(self, solution: Solution, angles: np.ndarray) -> np.ndarray:
        """Turn a solution of `problem` into one of `full`, in place, and its angles of torsional springs likewise.

        `angles` (T, forces of the compiled system) are unwrapped, rad. The multipliers are not touched.
        """
        R, w, alpha, c = solution.R[:, self.body], solution.w[:, self.body], solution.alpha[:, self.body], self.centre
        swing = cross(w, c)

        def world(vectors: np.ndarray) -> np.ndarray:
            turned: np.ndarray = np.einsum("tbij,tbj->tbi", R, vectors)
            return turned

        solution.x = solution.x[:, self.body] + world(np.broadcast_to(c, w.shape))
        solution.v = solution.v[:, self.body] + world(swing)
        solution.a = solution.a[:, self.body] + world(cross(alpha, c) + cross(w, swing))
        solution.R = np.ascontiguousarray(R @ self.turn)
        for name, vectors in (("w", w), ("alpha", alpha)):
            setattr(solution, name, np.einsum("bji,tbj->tbi", self.turn, vectors))
        unwrapped = angles.copy()
        unwrapped[:, :len(self.angles)] += self.angles  # leaders' angles come last
        return unwrapped


def welded_for(problem: Problem) -> Welded | None:
    """The problem with its welded bodies as one; None if there are none, if a joint or force ties a composite to
    itself, or if joints are open at the start. Computed once for each problem."""
    return problem.once(_weld)


def _weld(problem: Problem) -> Welded | None:
    kept = {k: joint for k, joint in enumerate(problem.joints) if not _is_weld(problem, joint)}
    welds = [joint for k, joint in enumerate(problem.joints) if k not in kept]
    if not welds:
        return None
    if not problem.opening <= ROUNDING:
        return None
    first = list(range(problem.n))  # of the bodies welded to each
    for weld in welds:
        low, high = sorted((first[weld.parent], first[weld.child]))
        first = [low if b == high else b for b in first]
    bases = sorted(set(first))
    place = {base: k for k, base in enumerate(bases)}
    body = np.array([place[b] for b in first])
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
    places = _Places(problem, body, centre, turn, {old: new for new, old in enumerate(kept)})
    bodies = tuple(Body(m, J) for m, J in zip(total, inertia, strict=True))
    fewer = Problem(bodies, tuple(map(places.joint, kept.values())), problem.gravity, X, R, V, w,
                    tuple(places.force(force, R) for force in problem.forces), problem.time)
    angles = start_angles(problem.forces, problem.R) - start_angles(fewer.forces, fewer.R)
    return Welded(problem, fewer, body, centre, turn, angles)


def _is_weld(problem: Problem, joint: Joint) -> bool:
    """Whether a joint is a fixed joint between two bodies, and nothing else."""
    if (joint.parent == GROUND or not joint.spherical or len(joint.dots) != 3 or joint.rows != 6 or joint.rotors
            or any((dot.a, dot.b, dot.constant) != ("parent", "child", 0.0) for dot in joint.dots)):
        return False
    turns = [dot.scale * np.cross(problem.R[joint.child] @ dot.b_axis, problem.R[joint.parent] @ dot.a_axis)
             for dot in joint.dots]
    return bool(np.linalg.matrix_rank(turns, tol=DEPENDENT) == 3)


@dataclasses.dataclass(frozen=True)
class _Places:
    """Moves joints and forces from the axes of their bodies into those of the composites.

    number: the joints that are kept, by their old index.
    """

    problem: Problem
    body: np.ndarray
    centre: np.ndarray
    turn: np.ndarray
    number: dict[int, int]

    def axis(self, body: int, vector: np.ndarray) -> np.ndarray:
        moved: np.ndarray = vector if body == GROUND else self.turn[body] @ vector
        return moved

    def point(self, body: int, vector: np.ndarray) -> np.ndarray:
        moved: np.ndarray = vector if body == GROUND else self.centre[body] + self.turn[body] @ vector
        return moved

    def between(self, item: Any, parent: int, child: int) -> dict[str, Any]:
        """Fields of an item that lies between two bodies: the bodies, anchors, points and axes."""
        moved: dict[str, Any] = {}
        for field in (field.name for field in dataclasses.fields(item)):
            side, _, kind = field.partition("_")
            at = {"parent": parent, "child": child}.get(side)
            if at is None:
                continue
            if kind == "":
                moved[field] = at if at == GROUND else int(self.body[at])
            else:
                moved[field] = (self.axis if kind == "axis" else self.point)(at, getattr(item, field))
        return moved

    def joint(self, joint: Joint) -> Joint:
        p, c = joint.parent, joint.child
        ends = {"parent": p, "child": c, "difference": GROUND}
        changed = self.between(joint, p, c)
        changed["dots"] = tuple(dataclasses.replace(dot, a_axis=self.axis(ends[dot.a], dot.a_axis),
                                                    b_axis=self.axis(ends[dot.b], dot.b_axis)) for dot in joint.dots)
        changed["rotors"] = tuple(dataclasses.replace(rotor, **self.between(rotor, p, c)) for rotor in joint.rotors)
        if (drive := joint.drive) is not None:
            changed["drive"] = dataclasses.replace(drive, coordinate=self.coordinate(drive.coordinate, p, c))
        if (contact := joint.contact) is not None:
            changed["contact"] = dataclasses.replace(contact, axis=self.axis(c, contact.axis))
        if (mimic := joint.mimic) is not None:
            leader = self.problem.joints[mimic.joint]
            changed["mimic"] = dataclasses.replace(
                mimic, joint=self.number[mimic.joint], coordinate=self.coordinate(mimic.coordinate, p, c),
                leader=self.coordinate(mimic.leader, leader.parent, leader.child))
        return dataclasses.replace(joint, **changed)

    def coordinate(self, coordinate: Coordinate, parent: int, child: int) -> Coordinate:
        changed = self.between(coordinate, parent, child)
        if coordinate.relative is not None:
            changed["relative"] = (self.axis(child, np.eye(3)) @ coordinate.relative
                                   @ self.axis(parent, np.eye(3)).T)
        return dataclasses.replace(coordinate, **changed)

    def force(self, force: Force, R: np.ndarray) -> Force:
        """The force between the composites, whose attitudes are R."""
        moved = dataclasses.replace(force, **self.between(force, force.parent, force.child))
        if isinstance(force, ConstantLoad) and isinstance(moved, ConstantLoad):
            place = force.child if force.frame == "body" else GROUND
            return dataclasses.replace(moved, force=self.axis(place, force.force),
                                       torque=self.axis(place, force.torque),
                                       point=self.point(force.child, force.point))
        if isinstance(force, TorsionalSpring) and isinstance(moved, TorsionalSpring):
            return moved.counted_from(force.start_angle(self.problem.R) - moved.start_angle(R))
        return moved
