"""The basic constraints that joints are made of, evaluated over whole trajectories at once.

Equations (2.1) to (2.4) of docs/theory.md, and the coordinates of hinges and slides; conventions and the order of rows
as in `crosscheck.scene.constraints`.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Sequence
from typing import Any, ClassVar

import numpy as np

from crosscheck.scene.contacts import CONTACTS, KnifeEdge
from crosscheck.scene.coordinates import zero_attitude
from crosscheck.scene.joints import Row
from crosscheck.scene.model import Joint
from crosscheck.scene.vectors import cross, dot, normal_references


@dataclasses.dataclass(frozen=True)
class BodyVector:
    """The vectors R s of K bodies; every method returns world components, (T, K, 3)."""

    body: Any  # (K,) indices; a single index before stacking
    s: np.ndarray  # (K, 3) body axes

    def value(self, x: np.ndarray, R: np.ndarray) -> np.ndarray:
        """The vectors themselves; `x` is not used."""
        return _turned(R[:, self.body], self.s)

    def rate(self, R: np.ndarray, v: np.ndarray, w: np.ndarray) -> np.ndarray:
        """Their time derivatives; `v` is not used."""
        return _turned(R[:, self.body], cross(w[:, self.body], self.s))

    def centripetal(self, R: np.ndarray, w: np.ndarray) -> np.ndarray:
        """The part of their second derivatives that is quadratic in w."""
        spin = w[:, self.body]
        return _turned(R[:, self.body], cross(spin, cross(spin, self.s)))

    def blocks(self, R: np.ndarray, directions: np.ndarray) -> Iterator[Block]:
        """The rows of `directions` (T, K, r, 3) times the Jacobians of the vectors."""
        # e . d(R s) = (s x R^T e) . w
        yield self.body, None, cross(self.s[:, None], directions @ R[:, self.body])


@dataclasses.dataclass(frozen=True)
class Separation:
    """The vectors d from the parents' points to the children's, with the methods of `BodyVector`."""

    parent: BodyVector  # from its centre of mass to its point
    child: BodyVector

    def value(self, x: np.ndarray, R: np.ndarray) -> np.ndarray:
        """d."""
        there = x[:, self.child.body] + self.child.value(x, R)
        return np.asarray(there - x[:, self.parent.body] - self.parent.value(x, R))

    def rate(self, R: np.ndarray, v: np.ndarray, w: np.ndarray) -> np.ndarray:
        """Its time derivative."""
        there = v[:, self.child.body] + self.child.rate(R, v, w)
        return np.asarray(there - v[:, self.parent.body] - self.parent.rate(R, v, w))

    def centripetal(self, R: np.ndarray, w: np.ndarray) -> np.ndarray:
        """The part of its second derivative that is quadratic in w."""
        return np.asarray(self.child.centripetal(R, w) - self.parent.centripetal(R, w))

    def blocks(self, R: np.ndarray, directions: np.ndarray) -> Iterator[Block]:
        """As with `BodyVector`."""
        for end, signed in ((self.child, directions), (self.parent, -directions)):
            for body, _, angular in end.blocks(R, signed):
                yield body, signed, angular


@dataclasses.dataclass(frozen=True)
class Basic:
    """K basic constraints of one kind: (left . right - offset) / unit, or all of `right` if `left` is None.

    Equations (2.1) to (2.4) of docs/theory.md: dot-1 multiplies two axes, dot-2 an axis and a separation, distance a
    separation with itself; spherical is a separation alone. Derivatives follow by the product rule.
    """

    left: BodyVector | Separation | None
    right: BodyVector | Separation
    offset: Any = 0.0  # (K, 1)
    unit: Any = 1.0  # (K, 1)

    @property
    def rows(self) -> int:
        """Number of scalar equations in each constraint."""
        return 3 if self.left is None else 1

    @property
    def dimensionless(self) -> bool:
        """Whether its rows are pure numbers, not metres."""
        return isinstance(self.right, BodyVector)

    def value(self, x: np.ndarray, R: np.ndarray) -> np.ndarray:
        """Its rows of Phi, (T, K, rows)."""
        q = self.right.value(x, R)
        return q if self.left is None else np.asarray((dot(self.left.value(x, R), q) - self.offset) / self.unit)

    def rate(self, x: np.ndarray, R: np.ndarray, v: np.ndarray, w: np.ndarray) -> np.ndarray:
        """Its rows of G u, (T, K, rows)."""
        dq = self.right.rate(R, v, w)
        if self.left is None:
            return dq
        rows: np.ndarray = dot(self.left.rate(R, v, w), self.right.value(x, R)) + dot(self.left.value(x, R), dq)
        rows /= self.unit
        return rows

    def gamma(self, x: np.ndarray, R: np.ndarray, v: np.ndarray, w: np.ndarray) -> np.ndarray:
        """Its rows of gamma, (T, K, rows)."""
        ddq = self.right.centripetal(R, w)
        if self.left is None:
            return ddq
        rows: np.ndarray = (dot(self.left.centripetal(R, w), self.right.value(x, R))
                            + dot(self.left.value(x, R), ddq)
                            + 2 * dot(self.left.rate(R, v, w), self.right.rate(R, v, w)))
        rows /= self.unit
        return rows

    def blocks(self, x: np.ndarray, R: np.ndarray) -> Iterator[Block]:
        """Its rows of the Jacobian, body by body; blocks of the same body are summed."""
        if self.left is None:
            count = np.shape(self.right.child.body)[0] if isinstance(self.right, Separation) else 1
            yield from self.right.blocks(R, np.broadcast_to(np.eye(3), (len(x), count, 3, 3)))
            return
        unit = np.asarray(self.unit)[..., None]
        yield from self.right.blocks(R, self.left.value(x, R)[..., None, :] / unit)
        yield from self.left.blocks(R, self.right.value(x, R)[..., None, :] / unit)


@dataclasses.dataclass(frozen=True)
class Angle:
    """K angles of hinges whose other rows keep the axes together; it has the methods of `Basic`.

    An angle is that of `torsion_angles`, measured from the joint's zero attitude, in (-pi, pi].
    """

    parent: Any  # (K,) indices
    child: Any
    axis: np.ndarray  # (K, 3) in the parent
    own_axis: np.ndarray  # (K, 3) in the child
    normal: np.ndarray  # (K, 3) in the parent, across the axis
    pointer: np.ndarray  # (K, 3) in the child, along the normal at angle zero

    left: ClassVar[None] = None
    right: ClassVar[None] = None
    rows: ClassVar[int] = 1
    dimensionless: ClassVar[bool] = True

    def value(self, x: np.ndarray, R: np.ndarray) -> np.ndarray:
        """The angles, (T, K, 1)."""
        pointer = np.einsum("tkji,tkj->tki", R[:, self.parent], _turned(R[:, self.child], self.pointer))
        return np.asarray(np.arctan2(dot(cross(self.axis, self.normal), pointer), dot(self.normal, pointer)))

    def rate(self, x: np.ndarray, R: np.ndarray, v: np.ndarray, w: np.ndarray) -> np.ndarray:
        """Their rates, (T, K, 1)."""
        return np.asarray(dot(self.own_axis, w[:, self.child]) - dot(self.axis, w[:, self.parent]))

    def gamma(self, x: np.ndarray, R: np.ndarray, v: np.ndarray, w: np.ndarray) -> np.ndarray:
        """Zero, because the axes are fixed in both bodies."""
        return np.zeros((len(x), np.shape(self.child)[0], 1))

    def blocks(self, x: np.ndarray, R: np.ndarray) -> Iterator[Block]:
        """The rows of the Jacobian."""
        for body, axis in ((self.child, self.own_axis), (self.parent, -self.axis)):
            yield body, None, np.broadcast_to(axis[:, None], (len(x), len(axis), 1, 3))


AnyBasic = Basic | Angle | KnifeEdge
Block = tuple[Any, "np.ndarray | None", np.ndarray]
"""Bodies (K,), the derivatives (T, K, r, 3) by their velocities in the world (None: zero) and by their angular ones."""


def stacked(items: Sequence[Any]) -> Any:
    """K vectors, separations or basic constraints of one kind stacked into one object."""
    first = items[0]
    if isinstance(first, Angle | BodyVector | KnifeEdge):
        return type(first)(*(np.array([getattr(item, field.name) for item in items])
                             for field in dataclasses.fields(first)))
    if isinstance(first, Separation):
        return Separation(stacked([item.parent for item in items]), stacked([item.child for item in items]))
    left = None if first.left is None else stacked([item.left for item in items])
    offset, unit = (np.array([[getattr(item, name)] for item in items]) for name in ("offset", "unit"))
    return Basic(left, stacked([item.right for item in items]), offset, unit)


def _turned(R: np.ndarray, s: np.ndarray) -> np.ndarray:
    """R s over the last axes, with broadcasting; the order of summation is the same for one state and for many."""
    return np.asarray(R[..., 0] * s[..., :1] + R[..., 1] * s[..., 1:2] + R[..., 2] * s[..., 2:])


def row_vectors(joint: Joint, relative: np.ndarray) -> tuple[dict[str, np.ndarray], dict[str, np.ndarray]]:
    """The vectors (3,) that `Row` names: those of the parent and those of the child, each in its body's axes.

    `relative` (3, 3): R_child^T R_parent of the initial state, which prismatic and fixed joints keep.
    """
    inner = dict(zip(("e1", "e2", "e3"), np.eye(3), strict=True))
    outer = dict(zip(("f1", "f2", "f3"), relative.T, strict=True))
    if joint.parent_axis is not None:
        n1, n2 = normal_references(joint.parent_axis)
        inner |= {"axis": joint.parent_axis, "n1": n1, "n2": n2}
        if joint.child_axis is not None:
            b = relative @ n2
            b -= (b @ joint.child_axis) * joint.child_axis
            outer |= {"axis": joint.child_axis, "b": b / max(float(np.linalg.norm(b)), np.finfo(float).tiny)}
    return inner, outer


def basics(joint: Joint, parent_attitude: np.ndarray, child_attitude: np.ndarray) -> list[AnyBasic]:
    """The basic constraints of a joint in row order, not yet stacked; attitudes (3, 3), body to world, are initial."""
    d = Separation(BodyVector(joint.parent, joint.parent_anchor), BodyVector(joint.child, joint.child_anchor))
    if joint.kind.slips:
        return [CONTACTS[joint.type].of(joint)]
    inner, outer = row_vectors(joint, child_attitude.T @ parent_attitude)

    def basic(row: Row) -> Basic:
        match row.kind:
            case "point":
                return Basic(None, d)
            case "distance":
                return Basic(d, d, joint.length**2, 2 * joint.length)
            case "dot1":
                return Basic(BodyVector(joint.parent, inner[row.parent]), BodyVector(joint.child, outer[row.child]))
            case _:
                return Basic(BodyVector(joint.parent, inner[row.parent]), d)

    listed: list[AnyBasic] = [basic(row) for row in joint.kind.rows]
    if joint.drive is not None or joint.mimic is not None:
        listed.append(coordinate(joint))
    return listed


def coordinate(joint: Joint) -> Basic | Angle:
    """The angle of a revolute joint, or the slide of a prismatic one."""
    if joint.kind.slides:
        d = Separation(BodyVector(joint.parent, joint.parent_anchor), BodyVector(joint.child, joint.child_anchor))
        return Basic(BodyVector(joint.parent, joint.parent_axis), d)
    n1, _ = normal_references(joint.parent_axis)
    return Angle(joint.parent, joint.child, joint.parent_axis, joint.child_axis, n1, zero_attitude(joint).T @ n1)
