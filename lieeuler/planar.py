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

import dataclasses

import numpy as np

from lieeuler import _kernel
from lieeuler.checks import normals
from lieeuler.errors import ArgumentError
from lieeuler.forces import ConstantLoad, Force, LinearSpring, SlideForce, TorsionalSpring, start_angles
from lieeuler.joint_parts import Coordinate, Dot, Drive, Rotor
from lieeuler.joints import Joint
from lieeuler.methods import Method
from lieeuler.problem import DEPENDENT, ROUNDING, Body, Problem
from lieeuler.solution import Solution
from lieeuler.types import GROUND

X, Y, Z = np.eye(3)


class NotPlanar(ArgumentError):
    """A problem cannot be integrated in a plane; the message says why."""


@dataclasses.dataclass(frozen=True)
class Plane:
    """A problem in its plane, and the way back.

    Attributes
    ----------
    full : Problem
        The problem as given.
    problem : Problem
        The problem in the plane: z = 0, fewer rows, and every body's axes along those of the plane at the start.
    normal : (3,)
        e, world axes.
    turn : (3, 3)
        Rotation from world axes to those of the plane.
    frames : (n, 3, 3)
        Rotations from body axes to body axes of `problem`.
    heights : (n,)
        Of the mass centres along e, m.
    angles : (number of forces,)
        Of torsional springs at the start, rad.
    word : "planar" | "axis"
        "axis" if every body turns about an axis fixed in the ground.
    """

    full: Problem
    problem: Problem
    normal: np.ndarray
    turn: np.ndarray
    frames: np.ndarray
    heights: np.ndarray
    angles: np.ndarray
    word: str

    def restore(self, solution: Solution, angles: np.ndarray) -> np.ndarray:
        """Turn a solution of `problem` into one of `full`, in place, and its angles of torsional springs likewise.

        `angles` (T, number of forces) are unwrapped, rad. The multipliers are not touched.
        """
        s = solution
        _kernel.leave_plane(self.turn, self.frames, self.heights, s.x, s.R, s.v, s.w, s.a, s.alpha)
        unwrapped: np.ndarray = angles + self.angles
        return unwrapped

    def entered(self, t: float, x: np.ndarray, R: np.ndarray, v: np.ndarray,
                w: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray] | None:
        """Another state of `full` at time t as one of `problem`; None unless it is in this plane with closed joints, to
        rounding. Angles of torsional springs are counted from the first start: None with such springs too."""
        full, length = self.full, self.full.kernel.length
        if any(isinstance(force, TorsionalSpring) for force in full.forces):
            return None
        opening = _kernel.constraint_levels(full.kernel, x, R, v, w, t, 0.0).max()
        turned = self.turn @ R @ np.swapaxes(self.frames, 1, 2)
        x, v, w = x @ self.turn.T, v @ self.turn.T, np.einsum("bij,bj->bi", self.frames, w)
        off = max(np.abs(x[:, 2] - self.heights).max() / length, np.abs(turned[:, 2] - Z).max(), opening)
        out = max(np.abs(v[:, 2]).max(), np.abs(w[:, :2]).max() * length)
        if not (off <= ROUNDING and out <= ROUNDING * max(np.abs(v).max(), np.abs(w).max() * length)):
            return None
        x[:, 2], v[:, 2], w[:, :2] = 0, 0, 0
        turned[:, :, 2], turned[:, 2] = Z, Z
        turned[:, :2, :2] /= np.hypot(turned[:, 0, 0], turned[:, 1, 0])[:, None, None]
        turned[:, 0, 1], turned[:, 1, 1] = -turned[:, 1, 0], turned[:, 0, 0]
        return x, turned, v, w


def plane_for(problem: Problem, method: Method, wanted: str | None) -> Plane | None:
    """The plane in which a method integrates a problem; None if there is none and none is wanted. Computed once for
    each problem.

    Raises
    ------
    NotPlanar
        The wanted reduction does not apply.
    """
    found = problem.once(_plane_or_refusal, method.name == "taylor")
    if isinstance(found, Plane) and wanted == "axis" != found.word:
        found = "its bodies do not all turn about axes fixed in the ground"
    if isinstance(found, Plane):
        return found
    if wanted is None:
        return None
    raise NotPlanar(f"reduce={wanted!r} does not apply: {found}")


def _plane_or_refusal(problem: Problem, pins: bool) -> Plane | str:
    try:
        return plane_of(problem, pins)
    except NotPlanar as refusal:
        return str(refusal)


def plane_of(problem: Problem, pins: bool) -> Plane:
    """The problem in its plane.

    pins: a hinge on the ground needs no row, because the method writes the motion about the hinge's point.

    Raises
    ------
    NotPlanar
        The mechanism does not stay in a plane.
    """
    if any(joint.mimic is not None for joint in problem.joints):
        raise NotPlanar("a joint follows another one")
    view = _View(problem, _normal(problem))
    _check(problem, view.e)
    within = [_within(view, k) for k in range(len(problem.joints))]
    points = _points(problem, within, pins)
    joints = []
    for k, (joint, rows) in enumerate(zip(problem.joints, within, strict=True)):
        if k in points or rows.angle or len(rows.across) or joint.drive:
            joints.append(_joint(view, joint, rows, k in points))
        elif joint.rotors:
            raise NotPlanar("a joint without rows in the plane has a rotor")
    bodies = tuple(Body(body.mass, float(P[2] @ body.inertia @ P[2]) * np.eye(3))
                   for body, P in zip(problem.bodies, view.frames, strict=True))
    flat = Problem(bodies, tuple(joints), view.within(GROUND, problem.gravity),
                   np.array([view.within(GROUND, x) for x in problem.x]), np.array([np.eye(3)] * problem.n),
                   np.array([view.within(GROUND, v) for v in problem.v]),
                   np.array([view.along(b, w) * Z for b, w in enumerate(problem.w)]),
                   tuple(_force(view, k) for k in range(len(problem.forces))), problem.time)
    turning = [joint.child for joint, rows in zip(problem.joints, within, strict=True)
               if joint.parent == GROUND and len(rows.across) == 2 and not rows.angle]
    word = "axis" if sorted(turning) == list(range(problem.n)) and len(problem.joints) == problem.n else "planar"
    flat.kernel.turns_about_pins = word == "axis"
    return Plane(problem, flat, view.e, view.turn, view.frames, problem.x @ view.e,
                 start_angles(problem.forces, problem.R), word)


def _points(problem: Problem, within: list[_Within], pins: bool) -> set[int]:
    """The joints whose two rows are taken as those of a point, which also ties heights, as long as these form a tree.

    Joints between bodies first: rows of directions there would couple the bodies, those on the ground do not.
    """
    groups = [{b} for b in (*range(problem.n), GROUND)]  # whose heights depend on each other
    points, pinned = set(), set()
    for k, joint in sorted(enumerate(problem.joints), key=lambda item: item[1].parent == GROUND):
        parent, child, pin = groups[joint.parent], groups[joint.child], pins and joint.parent == GROUND
        if len(within[k].across) != 2 or parent is child or (pin and joint.child in pinned):
            continue
        points.add(k)
        if pin:  # no row
            pinned.add(joint.child)
            continue
        parent |= child
        for body in child:
            groups[body] = parent
    return points


class _View:
    """Components of vectors of a body, or of the ground, along the axes of the plane at the start."""

    def __init__(self, problem: Problem, e: np.ndarray) -> None:
        self.problem, self.e = problem, e
        self.turn = np.array([*normals(e), e])
        self.frames = self.turn @ problem.R

    def axes(self, body: int) -> np.ndarray:
        """(3, 3) the axes of the plane in the body's frame, as rows."""
        return self.turn if body == GROUND else self.frames[body]

    def within(self, body: int, vector: np.ndarray) -> np.ndarray:
        """(3,) the vector in axes of the plane, without its part along e."""
        kept: np.ndarray = self.axes(body) @ vector * (1.0, 1.0, 0.0)
        return kept

    def along(self, body: int, vector: np.ndarray) -> float:
        """The component along e."""
        return float(self.axes(body)[2] @ vector)

    def height(self, body: int, point: np.ndarray) -> float:
        """Height of a point of a body along e, m."""
        return self.along(body, point) + (0.0 if body == GROUND else float(self.problem.x[body] @ self.e))

    def axis(self, what: str, body: int, axis: np.ndarray) -> np.ndarray:
        """The third axis or its opposite, for an axis along e; raises for any other axis."""
        size = self.along(body, axis)
        if abs(size) < 1 - ROUNDING:
            raise NotPlanar(f"{what} turns about another direction than the joints")
        return Z if size > 0 else -Z

    def direction(self, what: str, body: int, axis: np.ndarray) -> np.ndarray:
        """A direction normal to e in axes of the plane; raises for any other direction."""
        if abs(self.along(body, axis)) > ROUNDING:
            raise NotPlanar(f"{what} acts out of the plane")
        return self.within(body, axis)


@dataclasses.dataclass(frozen=True)
class _Within:
    """The constraints of a joint in the plane: the directions of its parent (k, 3) along which the anchors do not move
    apart, and whether the angle between its bodies is fixed."""

    across: np.ndarray
    angle: bool


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


def _within(view: _View, index: int) -> _Within:
    """The constraints of a joint in the plane; raises if the joint alone does not keep its bodies in their planes."""
    joint = view.problem.joints[index]
    across, turns = _refused(view.problem, joint)
    flat = np.vstack([across - np.outer(across @ view.e, view.e), np.zeros((3, 3))])
    k, angle = _rank(flat), _rank(turns) == 3
    about_e = _rank(turns) == 2 and np.abs(turns @ view.e).max() < ROUNDING
    if _rank(across) != k + 1 or not (angle or about_e):
        raise NotPlanar(f"joint {index} does not keep its bodies in planes normal to one direction")
    kept = np.linalg.svd(flat)[2][:k] @ view.turn.T * (1.0, 1.0, 0.0)  # at the start all body axes are the world's
    return _Within(np.eye(3)[:2] if k == 2 else kept, angle)


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


def _joint(view: _View, joint: Joint, rows: _Within, point: bool) -> Joint:
    """The joint in the plane; point: its anchors coincide, by rows along the three world axes."""
    dots = () if point else tuple(Dot("parent", "difference", direction) for direction in rows.across)
    if rows.angle:
        dots += (Dot("parent", "child", X, Y),)
    rotors = []
    for rotor in joint.rotors:
        along = view.axis if rotor.turns else view.direction
        rotors.append(Rotor(rotor.inertia, along("a rotor", joint.parent, rotor.parent_axis),
                            along("a rotor", joint.child, rotor.child_axis), rotor.turns))
    return Joint(joint.parent, joint.child, view.within(joint.parent, joint.parent_anchor),
                 view.within(joint.child, joint.child_anchor), point, dots,
                 None if joint.drive is None else _drive(view, joint, joint.drive), tuple(rotors))


def _drive(view: _View, joint: Joint, drive: Drive) -> Drive:
    given = drive.coordinate
    turn = view.axis if given.relative is not None else view.direction
    parent_axis = turn("a drive", joint.parent, given.parent_axis)
    child_axis = turn("a drive", joint.child, given.child_axis)
    relative = None
    if given.relative is not None:
        x, y, _ = view.axes(joint.child) @ given.relative @ view.axes(joint.parent)[0]
        relative = np.array([[x, -y, 0.0], [y, x, 0.0], Z])
        relative[:2] /= np.hypot(x, y)
    return Drive(drive.function, Coordinate(parent_axis, child_axis, relative))


def _force(view: _View, index: int) -> Force:
    """A force in the plane. Joints carry its part out of the plane; a spring must not depend on heights."""
    force, what = view.problem.forces[index], f"force {index}"
    p, c = force.parent, force.child
    if isinstance(force, ConstantLoad):
        place = c if force.frame == "body" else GROUND
        return dataclasses.replace(force, force=view.within(place, force.force), point=view.within(c, force.point),
                                   torque=view.along(place, force.torque) * Z)
    if isinstance(force, SlideForce):
        return dataclasses.replace(force, parent_anchor=view.within(p, force.parent_anchor),
                                   child_anchor=view.within(c, force.child_anchor),
                                   parent_axis=view.direction(what, p, force.parent_axis))
    if isinstance(force, LinearSpring):
        rise = view.height(c, force.child_point) - view.height(p, force.parent_point)
        if abs(rise) > ROUNDING * view.problem.kernel.length:
            raise NotPlanar(f"{what} pulls out of the plane")
        return dataclasses.replace(force, parent_point=view.within(p, force.parent_point),
                                   child_point=view.within(c, force.child_point))
    return dataclasses.replace(
        force.counted_from(force.start_angle(view.problem.R)), parent_axis=view.axis(what, p, force.parent_axis),
        child_axis=view.axis(what, c, force.child_axis))
