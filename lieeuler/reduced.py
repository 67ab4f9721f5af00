"""A smaller problem with the same motion, and the way back: what welds, planes and frames without spin have in common.

A body b is carried by the body k of the smaller problem. At the time t after the start

    x_b = T^T (X_k + R_k c_b + h_b e_3),    R_b = T^T R_k P_b exp(t hat(s_b))

and the derivatives of these. The kernel restores all bodies at the samples, and solves for the multipliers there if
rows were left out.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any, Self

import numpy as np

from lieeuler import _kernel
from lieeuler.forces import ConstantLoad, Force, TorsionalSpring, start_angles
from lieeuler.joint_parts import Coordinate
from lieeuler.joints import Joint
from lieeuler.problem import Body, Problem
from lieeuler.types import GROUND


class Reduced:
    """A smaller problem, and how the bodies of the full one follow from it.

    Attributes
    ----------
    word : "welded" | "planar" | "axis" | "spin-free"
    full, problem : Problem
        As given, and the smaller one.
    body : (n,) int
        k: the body that carries each; what is not given is as if each were carried by itself.
    centre : (n, 3)
        c: centre of mass of every body from that of its carrier, axes of the carrier, m.
    turn : (n, 3, 3)
        P: rotation from the axes of every body to those of its carrier.
    spins : (n, 3)
        s, body axes, rad/s.
    world : (3, 3)
        T: rotation from world axes to those of the smaller problem.
    heights : (n,)
        h, m.
    """

    problem: Problem

    def __init__(self, word: str, full: Problem, **given: np.ndarray) -> None:
        n = full.n
        self.word, self.full = word, full
        self.body, self.centre, self.turn = np.arange(n), np.zeros((n, 3)), np.tile(np.eye(3), (n, 1, 1))
        self.spins, self.world, self.heights = np.zeros((n, 3)), np.eye(3), np.zeros(n)
        vars(self).update(given)

    def add_to(self, run: _kernel.Run) -> None:
        """Add the way back to a compiled run, after those of the problems before it."""
        angles = start_angles(self.full.forces, self.full.R) - start_angles(self.problem.forces, self.problem.R)
        run.add_reduction(self.world, self.body.tolist(), list(self.centre), self.heights.tolist(), list(self.turn),
                          list(self.spins), angles.tolist())

    # --- from the axes of the bodies into those of their carriers

    def between_carriers(self, bodies: Sequence[Body], joints: Sequence[int], x: np.ndarray, R: np.ndarray,
                         v: np.ndarray, w: np.ndarray) -> Self:
        """With the problem of these carriers and their state, these joints of the full problem, and all forces."""
        self.joints, self.R = list(joints), R
        self.problem = Problem(tuple(bodies), tuple(self.joint(k) for k in joints),
                               self.vector(GROUND, self.full.gravity), x, R, v, w,
                               tuple(self.force(force, f"force {k}") for k, force in enumerate(self.full.forces)),
                               self.full.time)
        return self

    def axes(self, body: int) -> np.ndarray:
        """(3, 3) from the axes of a body, or of the ground, to those of its carrier."""
        return self.world if body == GROUND else self.turn[body]

    def vector(self, body: int, vector: np.ndarray) -> np.ndarray:
        """A vector in axes of the carrier."""
        moved: np.ndarray = self.axes(body) @ vector
        return moved

    torque = vector

    def axis(self, body: int, vector: np.ndarray, what: str, turns: bool) -> np.ndarray:
        """An axis about which something turns, or along which it acts, in axes of the carrier."""
        return self.vector(body, vector)

    def point(self, body: int, vector: np.ndarray) -> np.ndarray:
        """A point from the carrier's centre of mass."""
        moved = self.vector(body, vector)
        return moved if body == GROUND else self.centre[body] + moved

    def relative(self, attitude: np.ndarray) -> np.ndarray:
        """The attitude of carriers to each other."""
        return attitude

    def moved(self, item: Any, parent: int, child: int, what: str, **changed: Any) -> Any:
        """An item that lies between two bodies, with its bodies, anchors, points, axes and attitude, and changes."""
        turns = isinstance(item, TorsionalSpring) or getattr(item, "turns", False)
        if getattr(item, "relative", None) is not None:
            turns = True
            changed["relative"] = self.relative(self.axes(child) @ item.relative @ self.axes(parent).T)
        for field in (field.name for field in dataclasses.fields(item)):
            side, _, kind = field.partition("_")
            at = {"parent": parent, "child": child}.get(side)
            if at is not None and kind == "":
                changed[field] = at if at == GROUND else int(self.body[at])
            elif at is not None:
                given = getattr(item, field)
                changed[field] = self.axis(at, given, what, turns) if kind == "axis" else self.point(at, given)
        return dataclasses.replace(item, **changed)

    def joint(self, k: int, **rows: Any) -> Joint:
        """A joint of the full problem, by default with all of its rows."""
        joint = self.full.joints[k]
        p, c, contact, mimic, drive = joint.parent, joint.child, joint.contact, joint.mimic, joint.drive

        def coordinate(given: Coordinate, what: str, of: Joint = joint) -> Any:
            return self.moved(given, of.parent, of.child, what)

        if not rows:
            ends = {"parent": p, "child": c, "difference": GROUND}
            rows["dots"] = tuple(dataclasses.replace(
                dot, a_axis=self.vector(ends[dot.a], dot.a_axis), b_axis=self.vector(ends[dot.b], dot.b_axis))
                for dot in joint.dots)
        if contact is not None:
            rows["contact"] = dataclasses.replace(contact, axis=self.vector(c, contact.axis))
        if mimic is not None:
            rows["mimic"] = dataclasses.replace(
                mimic, joint=self.joints.index(mimic.joint), coordinate=coordinate(mimic.coordinate, "a mimic"),
                leader=coordinate(mimic.leader, "a mimic", self.full.joints[mimic.joint]))
        if drive is not None:
            rows["drive"] = dataclasses.replace(drive, coordinate=coordinate(drive.coordinate, "a drive"))
        rotors = tuple(self.moved(rotor, p, c, "a rotor") for rotor in joint.rotors)
        made: Joint = self.moved(joint, p, c, "a joint", rotors=rotors, **rows)
        return made

    def force(self, force: Force, what: str) -> Force:
        """The force between the carriers."""
        if isinstance(force, ConstantLoad):
            place = force.child if force.frame == "body" else GROUND
            return dataclasses.replace(force, child=int(self.body[force.child]), force=self.vector(place, force.force),
                                       torque=self.torque(place, force.torque), point=self.point(force.child,
                                                                                                 force.point))
        made: Force = self.moved(force, force.parent, force.child, what)
        if isinstance(force, TorsionalSpring) and isinstance(made, TorsionalSpring):
            return made.counted_from(force.start_angle(self.full.R) - made.start_angle(self.R))
        return made
