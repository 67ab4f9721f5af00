"""Mechanisms that move in a plane are integrated without the constraint rows that keep them in it.

If joints connect every body to the ground, and each joint turns about one common direction e, slides normal to e, or is
rigid, no point leaves its plane normal to e. Only the rows of a joint within the plane are kept: two of a hinge, one
and the relative angle of a slide, and none of a hinge on the ground if the method writes the motion about its point.
Forces and torques that the other rows would carry are left out, and so are the heights along e, (16.2) of
docs/theory.md:

    m x'' = f - (f . e) e - ...,    (e . J e) theta'' = e . torque - ...

World and body axes are turned so that e is the third axis of all of them. Components that are zero then stay zero in
every method, and the motion is that of the whole system. Heights, attitudes and all multipliers are restored at the
samples.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from lieeuler import _kernel
from lieeuler.checks import normals
from lieeuler.forces import Force, LinearSpring, TorsionalSpring
from lieeuler.joint_parts import Dot
from lieeuler.joints import Joint
from lieeuler.problem import DEPENDENT, ROUNDING, Body, Problem, once
from lieeuler.reduced import Reduced
from lieeuler.types import GROUND, State

X, Y, Z = np.eye(3)
FLAT = np.array([1.0, 1.0, 0.0])


class NotPlanar(Exception):
    """A problem cannot be integrated in a plane; the message says why."""


@once
def plane_of(problem: Problem, pins: bool) -> Plane | str:
    """The problem in its plane, or why the mechanism does not stay in a plane.

    Its word is "axis" if every body turns about an axis fixed in the ground: `taylor` then has series of angles, which
    take 0.4 to 0.7 of the time.

    pins: a hinge on the ground needs no row, because the method writes the motion about the hinge's point.
    """
    try:
        return Plane(problem, pins)
    except NotPlanar as refusal:
        return str(refusal)


class Plane(Reduced):
    """Bodies without what leaves the plane, with z = 0 and their axes along those of the plane at the start.

    Raises `NotPlanar`.
    """

    def __init__(self, problem: Problem, pins: bool) -> None:
        if any(joint.mimic is not None for joint in problem.joints):
            raise NotPlanar("a joint follows another one")
        self.e = _normal(problem)
        world = np.array([*normals(self.e), self.e])
        super().__init__("planar", problem, turn=world @ problem.R, world=world, heights=problem.x @ self.e)
        self._check()
        self.within = [self._within(k) for k in range(len(problem.joints))]
        self.points = self._points(pins)
        kept = [k for k, (across, angle) in enumerate(self.within)
                if k in self.points or angle or len(across) or problem.joints[k].drive]
        if any(joint.rotors for k, joint in enumerate(problem.joints) if k not in kept):
            raise NotPlanar("a joint without rows in the plane has a rotor")
        bodies = [Body(body.mass, float(P[2] @ body.inertia @ P[2]) * np.eye(3))
                  for body, P in zip(problem.bodies, self.turn, strict=True)]
        x, v = (np.array([self.vector(GROUND, each) for each in vectors]) for vectors in (problem.x, problem.v))
        w = np.array([self.torque(b, each) for b, each in enumerate(problem.w)])
        self.between_carriers(bodies, kept, x, np.tile(np.eye(3), (problem.n, 1, 1)), v, w)
        turning = [joint.child for joint, (across, angle) in zip(problem.joints, self.within, strict=True)
                   if joint.parent == GROUND and len(across) == 2 and not angle]
        if sorted(turning) == list(range(problem.n)) and len(problem.joints) == problem.n:
            self.word, self.problem.kernel.turns_about_pins = "axis", True

    def _check(self) -> None:
        """Raise unless the start moves in the plane with closed joints, and joints connect every body to the ground."""
        full, length = self.full, self.full.kernel.length
        speed = max(np.abs(full.v).max(), np.abs(full.w).max() * length)
        spins = np.cross(np.einsum("bij,bj->bi", full.R, full.w), self.e)
        if max(np.abs(full.v @ self.e).max(), np.abs(spins).max() * length) > ROUNDING * speed:
            raise NotPlanar("the start moves out of the plane")
        if not full.opening <= ROUNDING:
            raise NotPlanar(f"the start leaves joints open by {full.opening:.1g} of the system's size, more than "
                            "rounding")
        hung, before = {GROUND}, 0
        while len(hung) > before:
            before = len(hung)
            for joint in full.joints:
                if joint.parent in hung or joint.child in hung:
                    hung |= {joint.parent, joint.child}
        if len(hung) <= full.n:
            raise NotPlanar("a body is not held in the plane by joints")

    def _within(self, index: int) -> tuple[np.ndarray, bool]:
        """The constraints of a joint in the plane: the directions of its parent (k, 3) along which the anchors do not
        move apart, and whether the angle between its bodies is fixed; raises if the joint alone does not keep its
        bodies in their planes."""
        across, turns = _held(self.full, self.full.joints[index])
        flat = np.vstack([across - np.outer(across @ self.e, self.e), np.zeros((3, 3))])
        k, angle = _rank(flat), _rank(turns) == 3
        about_e = _rank(turns) == 2 and np.abs(turns @ self.e).max() < ROUNDING
        if _rank(across) != k + 1 or not (angle or about_e):
            raise NotPlanar(f"joint {index} does not keep its bodies in planes normal to one direction")
        kept = np.linalg.svd(flat)[2][:k] @ self.world.T * FLAT  # at the start all body axes are the world's
        return (np.eye(3)[:2] if k == 2 else kept), angle

    def _points(self, pins: bool) -> set[int]:
        """The joints whose two rows are taken as those of a point, which also ties heights, as long as these form a
        tree.

        Joints between bodies first: rows of directions there would couple the bodies, those on the ground do not.
        """
        groups = [{b} for b in (*range(self.full.n), GROUND)]  # whose heights depend on each other
        points, pinned = set(), set()
        for k, joint in sorted(enumerate(self.full.joints), key=lambda item: item[1].parent == GROUND):
            parent, child, pin = groups[joint.parent], groups[joint.child], pins and joint.parent == GROUND
            if len(self.within[k][0]) != 2 or parent is child or (pin and joint.child in pinned):
                continue
            points.add(k)
            if pin:  # no row
                pinned.add(joint.child)
                continue
            parent |= child
            for body in child:
                groups[body] = parent
        return points

    def joint(self, k: int, **rows: Any) -> Joint:
        """With its rows in the plane."""
        across, angle = self.within[k]
        dots = [] if k in self.points else [Dot("parent", "difference", direction) for direction in across]
        if angle:
            dots.append(Dot("parent", "child", X, Y))
        return super().joint(k, spherical=k in self.points, dots=tuple(dots), **rows)

    def vector(self, body: int, vector: np.ndarray) -> np.ndarray:
        """Without its part along e."""
        return np.asarray(super().vector(body, vector) * FLAT)

    def along(self, body: int, vector: np.ndarray) -> float:
        """The component along e."""
        return float(self.axes(body)[2] @ vector)

    def torque(self, body: int, vector: np.ndarray) -> np.ndarray:
        """Its part along e."""
        return self.along(body, vector) * Z

    def axis(self, body: int, vector: np.ndarray, what: str, turns: bool) -> np.ndarray:
        """The third axis or its opposite for what turns, a direction normal to e for what does not; raises for any
        other."""
        size = self.along(body, vector)
        if turns and abs(size) < 1 - ROUNDING:
            raise NotPlanar(f"{what} turns about another direction than the joints")
        if not turns and abs(size) > ROUNDING:
            raise NotPlanar(f"{what} acts out of the plane")
        return (Z if size > 0 else -Z) if turns else self.vector(body, vector)

    def relative(self, attitude: np.ndarray) -> np.ndarray:
        """Turned about e alone."""
        return _about_z(attitude)

    def force(self, force: Force, what: str) -> Force:
        """Joints carry its part out of the plane; a spring must not depend on heights."""
        if isinstance(force, LinearSpring):
            above = [self.along(body, point) + (0.0 if body == GROUND else float(self.full.x[body] @ self.e))
                     for body, point in ((force.parent, force.parent_point), (force.child, force.child_point))]
            if abs(above[1] - above[0]) > ROUNDING * self.full.kernel.length:
                raise NotPlanar(f"{what} pulls out of the plane")
        return super().force(force, what)

    def entered(self, t: float, x: np.ndarray, R: np.ndarray, v: np.ndarray, w: np.ndarray) -> State | None:
        """Another state of `full` at time t as one of `problem`; None unless it is in this plane with closed joints, to
        rounding. Angles of torsional springs are counted from the first start: None with such springs too."""
        full, length = self.full, self.full.kernel.length
        if any(isinstance(force, TorsionalSpring) for force in full.forces):
            return None
        opening = _kernel.constraint_levels(full.kernel, x, R, v, w, t, 0.0).max()
        turned = self.world @ R @ np.swapaxes(self.turn, 1, 2)
        x, v, w = x @ self.world.T, v @ self.world.T, np.einsum("bij,bj->bi", self.turn, w)
        off = max(np.abs(x[:, 2] - self.heights).max() / length, np.abs(turned[:, 2] - Z).max(), opening)
        out = max(np.abs(v[:, 2]).max(), np.abs(w[:, :2]).max() * length)
        if not (off <= ROUNDING and out <= ROUNDING * max(np.abs(v).max(), np.abs(w).max() * length)):
            return None
        x[:, 2], v[:, 2], w[:, :2] = 0, 0, 0
        return x, _about_z(turned), v, w


def _about_z(R: np.ndarray) -> np.ndarray:
    """Rotations (..., 3, 3) about the third axis alone, by their first columns."""
    x, y = R[..., 0, 0], R[..., 1, 0]
    turned = np.zeros_like(R)
    turned[..., 0, 0], turned[..., 0, 1], turned[..., 1, 0], turned[..., 1, 1] = x, -y, y, x
    turned[..., :2, :2] /= np.hypot(x, y)[..., None, None]
    turned[..., 2, 2] = 1
    return turned


def _normal(problem: Problem) -> np.ndarray:
    """The axis of the first joint that turns about one axis; made exactly a coordinate direction if close to one."""
    for joint in problem.joints:
        turns = _held(problem, joint)[1]
        if _rank(turns) == 2:
            free: np.ndarray = np.linalg.svd(turns)[2][2]
            largest = np.argmax(np.abs(free))
            free *= np.sign(free[largest])
            nearest: np.ndarray = np.eye(3)[largest]
            return nearest if np.abs(free - nearest).max() < ROUNDING else free
    raise NotPlanar("no joint turns about one direction")


def _held(problem: Problem, joint: Joint) -> tuple[np.ndarray, np.ndarray]:
    """World directions (k, 3) along which a joint's anchors do not move apart, and about which its bodies do not turn
    relative to each other, at the start; the drive is left out."""
    if joint.contact is not None:
        raise NotPlanar("a body rolls")
    if (rows := joint.basic_rows) is None:
        raise NotPlanar("a joint holds a distance")
    across = [problem.attitude(joint.parent) @ axis for axis in rows[0]]
    return np.reshape(across, (-1, 3)), problem.held_turns(joint, rows[1])


def _rank(rows: np.ndarray) -> int:
    return int(np.linalg.matrix_rank(rows, tol=DEPENDENT)) if len(rows) else 0
