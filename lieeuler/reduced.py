"""A smaller problem with the same motion, and the way back: what welds, planes and frames without spin have in common.

A body b is carried by the body k of the smaller problem. At the time t after the start

    x_b = T^T (X_k + R_k c_b + h_b e_3),    R_b = T^T R_k P_b exp(t hat(s_b))

and the derivatives of these. The kernel restores all bodies at the samples, and solves for the multipliers there if
rows were left out.
"""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np

from lieeuler import _kernel
from lieeuler.forces import ConstantLoad, Force, TorsionalSpring, start_angles
from lieeuler.joint_parts import Coordinate
from lieeuler.joints import Joint
from lieeuler.problem import ROUNDING, Problem
from lieeuler.types import GROUND, State

Z = np.array([0.0, 0.0, 1.0])


@dataclasses.dataclass(frozen=True)
class Reduced:
    """A smaller problem, and how the bodies of the full one follow from it.

    Attributes
    ----------
    word : "welded" | "planar" | "axis" | "spin-free"
    full, problem : Problem
        As given, and the smaller one.
    body : (n,) int
        k: the body that carries each.
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

    word: str
    full: Problem
    problem: Problem
    body: np.ndarray
    centre: np.ndarray
    turn: np.ndarray
    spins: np.ndarray
    world: np.ndarray
    heights: np.ndarray

    @classmethod
    def of(cls, word: str, full: Problem, problem: Problem, **changes: np.ndarray) -> Reduced:
        """With what changes; everything else is carried by itself."""
        n, none = full.n, np.zeros((full.n, 3))
        same = {"body": np.arange(n), "centre": none, "turn": np.tile(np.eye(3), (n, 1, 1)), "spins": none,
                "world": np.eye(3), "heights": np.zeros(n)}
        return cls(word, full, problem, **{**same, **changes})

    def add_to(self, run: _kernel.Run) -> None:
        """Add the way back to a compiled run, after those of the problems before it."""
        angles = start_angles(self.full.forces, self.full.R) - start_angles(self.problem.forces, self.problem.R)
        run.add_reduction(self.world, self.body.tolist(), list(self.centre), self.heights.tolist(), list(self.turn),
                          list(self.spins), angles.tolist())

    def entered(self, t: float, x: np.ndarray, R: np.ndarray, v: np.ndarray, w: np.ndarray) -> State | None:
        """Of a plane: another state of `full` at time t as one of `problem`; None unless it is in this plane with
        closed joints, to rounding. Angles of torsional springs are counted from the first start: None with such springs
        too."""
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
        turned[:, :, 2], turned[:, 2] = Z, Z
        turned[:, :2, :2] /= np.hypot(turned[:, 0, 0], turned[:, 1, 0])[:, None, None]
        turned[:, 0, 1], turned[:, 1, 1] = -turned[:, 1, 0], turned[:, 0, 0]
        return x, turned, v, w


class Carriers:
    """Moves joints and forces from the axes of a problem's bodies into those of their carriers.

    Parameters
    ----------
    problem : Problem
    body, centre, turn, world
        As in `Reduced`.
    R : (carriers, 3, 3)
        Attitudes of the carriers at the start.
    """

    def __init__(self, problem: Problem, body: np.ndarray, centre: np.ndarray, turn: np.ndarray, world: np.ndarray,
                 R: np.ndarray) -> None:
        self.problem, self.body, self.centre, self.turn, self.world, self.R = problem, body, centre, turn, world, R

    def axes(self, body: int) -> np.ndarray:
        """(3, 3) from the axes of a body, or of the ground, to those of its carrier."""
        return self.world if body == GROUND else self.turn[body]

    def vector(self, body: int, vector: np.ndarray) -> np.ndarray:
        """A vector in axes of the carrier."""
        moved: np.ndarray = self.axes(body) @ vector
        return moved

    def torque(self, body: int, vector: np.ndarray) -> np.ndarray:
        """A torque in axes of the carrier."""
        return self.vector(body, vector)

    def axis(self, body: int, vector: np.ndarray, what: str, turns: bool) -> np.ndarray:
        """An axis about which something turns, or along which it acts, in axes of the carrier."""
        return self.vector(body, vector)

    def point(self, body: int, vector: np.ndarray) -> np.ndarray:
        """A point from the carrier's centre of mass."""
        moved = self.vector(body, vector)
        return moved if body == GROUND else self.centre[body] + moved

    def between(self, item: Any, parent: int, child: int, what: str) -> dict[str, Any]:
        """Fields of an item that lies between two bodies: the bodies, anchors, points and axes."""
        turns = isinstance(item, TorsionalSpring) or getattr(item, "relative", None) is not None or getattr(
            item, "turns", False)
        moved: dict[str, Any] = {}
        for field in (field.name for field in dataclasses.fields(item)):
            side, _, kind = field.partition("_")
            at = {"parent": parent, "child": child}.get(side)
            if at is not None and kind == "":
                moved[field] = at if at == GROUND else int(self.body[at])
            elif at is not None:
                given = getattr(item, field)
                moved[field] = self.axis(at, given, what, turns) if kind == "axis" else self.point(at, given)
        return moved

    def joint(self, joint: Joint, **changed: Any) -> Joint:
        """The joint with its drive and rotors, and with changed rows."""
        p, c = joint.parent, joint.child
        rotors = (dataclasses.replace(rotor, **self.between(rotor, p, c, "a rotor")) for rotor in joint.rotors)
        drive = joint.drive and dataclasses.replace(joint.drive, coordinate=self.coordinate(
            joint.drive.coordinate, p, c, "a drive"))
        return dataclasses.replace(joint, **self.between(joint, p, c, "a joint"), rotors=tuple(rotors), drive=drive,
                                   **changed)

    def coordinate(self, coordinate: Coordinate, parent: int, child: int, what: str) -> Coordinate:
        """A coordinate of a joint between two bodies."""
        changed = self.between(coordinate, parent, child, what)
        if coordinate.relative is not None:
            changed["relative"] = self.relative(self.axes(child) @ coordinate.relative @ self.axes(parent).T)
        return dataclasses.replace(coordinate, **changed)

    def relative(self, attitude: np.ndarray) -> np.ndarray:
        """The attitude of carriers to each other."""
        return attitude

    def force(self, force: Force, what: str) -> Force:
        """The force between the carriers."""
        changed = self.between(force, force.parent, force.child, what)
        if isinstance(force, ConstantLoad):
            place = force.child if force.frame == "body" else GROUND
            return dataclasses.replace(force, **changed, force=self.vector(place, force.force), torque=self.torque(
                place, force.torque), point=self.point(force.child, force.point))
        moved = dataclasses.replace(force, **changed)
        if isinstance(force, TorsionalSpring) and isinstance(moved, TorsionalSpring):
            return moved.counted_from(force.start_angle(self.problem.R) - moved.start_angle(self.R))
        return moved
