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

import numpy as np

from lieeuler.checks import normals
from lieeuler.forces import Force, LinearSpring
from lieeuler.joint_parts import Dot
from lieeuler.joints import Joint
from lieeuler.problem import DEPENDENT, ROUNDING, Body, Problem, once
from lieeuler.reduced import Carriers, Reduced, Z
from lieeuler.types import GROUND

X, Y = np.eye(3)[:2]


class NotPlanar(Exception):
    """A problem cannot be integrated in a plane; the message says why."""


@once
def plane_of(problem: Problem, pins: bool) -> Reduced | str:
    """The problem in its plane, with z = 0 and every body's axes along those of the plane at the start; or why the
    mechanism does not stay in a plane.

    Its word is "axis" if every body turns about an axis fixed in the ground.

    pins: a hinge on the ground needs no row, because the method writes the motion about the hinge's point.
    """
    try:
        return _plane(problem, pins)
    except NotPlanar as refusal:
        return str(refusal)


def _plane(problem: Problem, pins: bool) -> Reduced:
    if any(joint.mimic is not None for joint in problem.joints):
        raise NotPlanar("a joint follows another one")
    view = _View(problem, _normal(problem))
    _check(problem, view.e)
    within = [_within(view, k) for k in range(len(problem.joints))]
    points = _points(problem, [len(across) == 2 for across, _ in within], pins)
    joints = []
    for k, (joint, (across, angle)) in enumerate(zip(problem.joints, within, strict=True)):
        if k in points or angle or len(across) or joint.drive:
            dots = () if k in points else tuple(Dot("parent", "difference", direction) for direction in across)
            dots += (Dot("parent", "child", X, Y),) if angle else ()
            joints.append(view.joint(joint, spherical=k in points, dots=dots))
        elif joint.rotors:
            raise NotPlanar("a joint without rows in the plane has a rotor")
    bodies = tuple(Body(body.mass, float(P[2] @ body.inertia @ P[2]) * np.eye(3))
                   for body, P in zip(problem.bodies, view.turn, strict=True))
    flat = Problem(bodies, tuple(joints), view.vector(GROUND, problem.gravity),
                   np.array([view.vector(GROUND, x) for x in problem.x]), view.R,
                   np.array([view.vector(GROUND, v) for v in problem.v]),
                   np.array([view.torque(b, w) for b, w in enumerate(problem.w)]),
                   tuple(view.force(force, f"force {k}") for k, force in enumerate(problem.forces)), problem.time)
    turning = [joint.child for joint, (across, angle) in zip(problem.joints, within, strict=True)
               if joint.parent == GROUND and len(across) == 2 and not angle]
    word = "axis" if sorted(turning) == list(range(problem.n)) and len(problem.joints) == problem.n else "planar"
    flat.kernel.turns_about_pins = word == "axis"
    return Reduced.of(word, problem, flat, turn=view.turn, world=view.world, heights=problem.x @ view.e)


def _points(problem: Problem, held: list[bool], pins: bool) -> set[int]:
    """The joints whose two rows are taken as those of a point, which also ties heights, as long as these form a tree.

    Joints between bodies first: rows of directions there would couple the bodies, those on the ground do not.
    """
    groups = [{b} for b in (*range(problem.n), GROUND)]  # whose heights depend on each other
    points, pinned = set(), set()
    for k, joint in sorted(enumerate(problem.joints), key=lambda item: item[1].parent == GROUND):
        parent, child, pin = groups[joint.parent], groups[joint.child], pins and joint.parent == GROUND
        if not held[k] or parent is child or (pin and joint.child in pinned):
            continue
        points.add(k)
        if pin:  # no row
            pinned.add(joint.child)
            continue
        parent |= child
        for body in child:
            groups[body] = parent
    return points


class _View(Carriers):
    """Bodies without what leaves the plane, in axes of the plane at the start."""

    def __init__(self, problem: Problem, e: np.ndarray) -> None:
        world = np.array([*normals(e), e])
        super().__init__(problem, np.arange(problem.n), np.zeros((problem.n, 3)), world @ problem.R, world,
                         np.array([np.eye(3)] * problem.n))
        self.e = e

    def vector(self, body: int, vector: np.ndarray) -> np.ndarray:
        """Without its part along e."""
        return super().vector(body, vector) * (1.0, 1.0, 0.0)

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
        x, y, _ = attitude[:, 0]
        turned = np.array([[x, -y, 0.0], [y, x, 0.0], Z])
        turned[:2] /= np.hypot(x, y)
        return turned

    def force(self, force: Force, what: str) -> Force:
        """Joints carry its part out of the plane; a spring must not depend on heights."""
        if isinstance(force, LinearSpring):
            above = [self.along(body, point) + (0.0 if body == GROUND else float(self.problem.x[body] @ self.e))
                     for body, point in ((force.parent, force.parent_point), (force.child, force.child_point))]
            if abs(above[1] - above[0]) > ROUNDING * self.problem.kernel.length:
                raise NotPlanar(f"{what} pulls out of the plane")
        return super().force(force, what)


def _normal(problem: Problem) -> np.ndarray:
    """The axis of the first joint that turns about one axis; made exactly a coordinate direction if close to one."""
    for joint in problem.joints:
        turns = _refused(problem, joint)[1]
        if _rank(turns) == 2:
            free: np.ndarray = np.linalg.svd(turns)[2][2]
            largest = np.argmax(np.abs(free))
            free *= np.sign(free[largest])
            nearest: np.ndarray = np.eye(3)[largest]
            return nearest if np.abs(free - nearest).max() < ROUNDING else free
    raise NotPlanar("no joint turns about one direction")


def _refused(problem: Problem, joint: Joint) -> tuple[np.ndarray, np.ndarray]:
    """World directions (k, 3) along which a joint's anchors do not move apart, and about which its bodies do not turn
    relative to each other, at the start; the drive is left out."""
    R = {"child": problem.R[joint.child], "parent": np.eye(3) if joint.parent == GROUND else problem.R[joint.parent]}
    if joint.contact is not None:
        raise NotPlanar("a body rolls")
    across, turns = list(np.eye(3)) if joint.spherical else [], []
    for dot in joint.dots:
        if (dot.a, dot.b) == ("parent", "difference") and dot.constant == 0:
            across.append(R["parent"] @ dot.a_axis)
        elif (dot.a, dot.b) == ("parent", "child"):
            turns.append(np.cross(R["child"] @ dot.b_axis, R["parent"] @ dot.a_axis))
        else:
            raise NotPlanar("a joint holds a distance")
    return np.reshape(across, (-1, 3)), np.reshape(turns, (-1, 3))


def _rank(rows: np.ndarray) -> int:
    return int(np.linalg.matrix_rank(rows, tol=DEPENDENT)) if len(rows) else 0


def _within(view: _View, index: int) -> tuple[np.ndarray, bool]:
    """The constraints of a joint in the plane: the directions of its parent (k, 3) along which the anchors do not move
    apart, and whether the angle between its bodies is fixed; raises if the joint alone does not keep its bodies in
    their planes."""
    joint = view.problem.joints[index]
    across, turns = _refused(view.problem, joint)
    flat = np.vstack([across - np.outer(across @ view.e, view.e), np.zeros((3, 3))])
    k, angle = _rank(flat), _rank(turns) == 3
    about_e = _rank(turns) == 2 and np.abs(turns @ view.e).max() < ROUNDING
    if _rank(across) != k + 1 or not (angle or about_e):
        raise NotPlanar(f"joint {index} does not keep its bodies in planes normal to one direction")
    kept = np.linalg.svd(flat)[2][:k] @ view.world.T * (1.0, 1.0, 0.0)  # at the start all body axes are the world's
    return (np.eye(3)[:2] if k == 2 else kept), angle


def _check(problem: Problem, e: np.ndarray) -> None:
    """Raise unless the start moves in the plane with closed joints, and joints connect every body to the ground."""
    length = problem.kernel.length
    speed = max(np.abs(problem.v).max(), np.abs(problem.w).max() * length)
    spins = np.cross(np.einsum("bij,bj->bi", problem.R, problem.w), e)
    if max(np.abs(problem.v @ e).max(), np.abs(spins).max() * length) > ROUNDING * speed:
        raise NotPlanar("the start moves out of the plane")
    if not problem.opening <= ROUNDING:
        raise NotPlanar(f"the start leaves joints open by {problem.opening:.1g} of the system's size, more than "
                        "rounding")
    neighbours: dict[int, set[int]] = {}
    for joint in problem.joints:
        neighbours.setdefault(joint.parent, set()).add(joint.child)
        neighbours.setdefault(joint.child, set()).add(joint.parent)
    hung, new = {GROUND}, {GROUND}
    while new:
        new = {other for body in new for other in neighbours.get(body, ())} - hung
        hung |= new
    if len(hung) <= problem.n:
        raise NotPlanar("a body is not held in the plane by joints")
