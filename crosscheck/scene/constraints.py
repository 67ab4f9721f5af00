"""The joints of a scene as constraints, evaluated over whole trajectories at once.

This gives Phi, G u and G du/dt + gamma the same measure for every engine. Conventions, with i the parent, j the child,
points s and axes a in body axes, d = x_j + R_j s_j - x_i - R_i s_i:

- a joint with an axis uses two unit vectors n1, n2 of the parent normal to its axis a: n1 is the coordinate direction
  along which a has its smallest component (the first of equal ones), made normal to a; n2 = a x n1;
- parallel axes are the two dot-1 rows n1 . child_axis, n2 . child_axis, which are never singular where the axes
  coincide; offsets across an axis are the dot-2 rows of n1, then n2; the offset from a plane is the dot-2 row of a;
- prismatic adds the dot-1 row n1 . b, with b fixed in the child: n2 at the start, made normal to child_axis;
- fixed takes f, fixed in the child, as the parent's coordinate axes e at the start: rows e1.f2, e2.f3, e3.f1;
- distance is (d . d - c^2) / (2 c);
- a drive adds coordinate - function of time, last: the angle of a hinge, or axis . d of a slide;
- contacts with a plane, whose rows of slip hold velocities alone, are those of `crosscheck.scene.contacts`.

Rows: joints in file order, and within a joint positions before dot-1 for spherical, universal, revolute and fixed
(3 + 0, 1, 2, 3 rows); dot-1 before dot-2 for cylindrical (2 + 2) and planar (2 + 1); prismatic is cylindrical + dot-1.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from crosscheck.scene.contacts import CONTACTS, KnifeEdge
from crosscheck.scene.joints import JOINT_TYPES, Row
from crosscheck.scene.model import Joint, Scene, rotation_from_quaternion
from crosscheck.scene.vectors import cross, dot, normal_references, shortest_rotation

if TYPE_CHECKING:
    from scipy.sparse import csr_array

_ZERO = np.zeros(3)
_AT_ONCE = 200_000
"""Rows times states evaluated at once; more would need more memory without being faster."""


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
        found: np.ndarray = np.arctan2(dot(cross(self.axis, self.normal), pointer), dot(self.normal, pointer))
        return found

    def rate(self, x: np.ndarray, R: np.ndarray, v: np.ndarray, w: np.ndarray) -> np.ndarray:
        """Their rates, (T, K, 1)."""
        found: np.ndarray = dot(self.own_axis, w[:, self.child]) - dot(self.axis, w[:, self.parent])
        return found

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


def _stacked(items: Sequence[Any]) -> Any:
    """K vectors, separations or basic constraints of one kind stacked into one object."""
    first = items[0]
    if isinstance(first, Angle | BodyVector | KnifeEdge):
        return type(first)(*(np.array([getattr(item, field.name) for item in items])
                             for field in dataclasses.fields(first)))
    if isinstance(first, Separation):
        return Separation(_stacked([item.parent for item in items]), _stacked([item.child for item in items]))
    left = None if first.left is None else _stacked([item.left for item in items])
    offset, unit = (np.array([[getattr(item, name)] for item in items]) for name in ("offset", "unit"))
    return Basic(left, _stacked([item.right for item in items]), offset, unit)


def _turned(R: np.ndarray, s: np.ndarray) -> np.ndarray:
    """R s over the last axes, with broadcasting; the order of summation is the same for one state and for many."""
    found: np.ndarray = R[..., 0] * s[..., :1] + R[..., 1] * s[..., 1:2] + R[..., 2] * s[..., 2:]
    return found


def basics(joint: Joint, parent_attitude: np.ndarray, child_attitude: np.ndarray) -> list[AnyBasic]:
    """The basic constraints of a joint in row order, not yet stacked.

    `parent_attitude` and `child_attitude` (3, 3), body to world, are the initial ones: prismatic and fixed joints
    keep this relative attitude.
    """
    d = Separation(BodyVector(joint.parent, joint.parent_anchor), BodyVector(joint.child, joint.child_anchor))
    relative = child_attitude.T @ parent_attitude

    if JOINT_TYPES[joint.type].slips:
        return [CONTACTS[joint.type].of(joint)]
    inner = dict(zip(("e1", "e2", "e3"), np.eye(3), strict=True))
    outer = dict(zip(("f1", "f2", "f3"), relative.T, strict=True))
    if joint.parent_axis is not None:
        n1, n2 = normal_references(joint.parent_axis)
        inner |= {"axis": joint.parent_axis, "n1": n1, "n2": n2}
        if joint.child_axis is not None:
            b = relative @ n2
            b -= (b @ joint.child_axis) * joint.child_axis
            outer |= {"axis": joint.child_axis, "b": b / max(float(np.linalg.norm(b)), np.finfo(float).tiny)}

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

    found: list[AnyBasic] = [basic(row) for row in JOINT_TYPES[joint.type].rows]
    if joint.drive is not None:
        if joint.type == "prismatic":
            found.append(Basic(BodyVector(joint.parent, joint.parent_axis), d))
        else:
            n1 = inner["n1"]
            zero = (shortest_rotation(joint.child_axis, joint.parent_axis) if joint.reference is None
                    else rotation_from_quaternion(joint.reference))
            found.append(Angle(joint.parent, joint.child, joint.parent_axis, joint.child_axis, n1, zero.T @ n1))
    return found


class Constraints:
    """The constraint equations of a scene.

    All methods take arrays with a leading time axis: x, v, a (T, n, 3) world, R (T, n, 3, 3) body to world, w and
    alpha (T, n, 3) body axes, lam (T, m). Rows have the unit metre, or none for dot-1 rows.

    Attributes
    ----------
    m : number of rows.
    rows : the rows of each joint, by its name.
    dimensionless : (m,) true for the dot-1 rows.
    slips : (m,) true for the rows that hold velocities and no positions.
    drives : (row, function of time, whether it is an angle) of each prescribed coordinate.
    """

    def __init__(self, scene: Scene) -> None:
        self.scene = scene
        attitudes = np.concatenate([scene.R0, np.eye(3)[None]])  # the ground is index -1, the last
        self.rows: dict[str, slice] = {}
        self.m = 0
        kinds: dict[Any, tuple[list[AnyBasic], list[int]]] = {}
        for joint in scene.joints:
            first = self.m
            for basic in basics(joint, attitudes[joint.parent], attitudes[joint.child]):
                alike, starts = kinds.setdefault((type(basic), type(basic.left), type(basic.right)), ([], []))
                alike.append(basic)
                starts.append(self.m)
                self.m += basic.rows
            self.rows[joint.name] = slice(first, self.m)
        self.drives = [(rows.stop - 1, joint.drive, joint.type == "revolute") for joint, rows in
                        zip(scene.joints, self.rows.values(), strict=True) if joint.drive is not None]
        self._basics: list[tuple[np.ndarray, AnyBasic]] = [  # rows (K, rows of each)
            (np.array(starts)[:, None] + np.arange(alike[0].rows), _stacked(alike)) for alike, starts in kinds.values()]
        self.dimensionless, self.slips = np.zeros((2, self.m), dtype=bool)
        for rows, basic in self._basics:
            self.dimensionless[rows] = basic.dimensionless
            self.slips[rows[:, 1:]] = isinstance(basic, KnifeEdge)

    def rows_without(self, body: int | None) -> np.ndarray:
        """Indices of the rows of all joints except those at one body."""
        there = [np.arange(self.m)[self.rows[joint.name]] for joint in self.scene.joints
                 if body not in (joint.parent, joint.child)]
        return np.concatenate([*there, np.empty(0, dtype=int)])

    def position(self, x: np.ndarray, R: np.ndarray, t: np.ndarray | float = 0.0) -> np.ndarray:
        """Phi at times t, (T, m)."""
        values = self._driven(self._evaluated("value", x, R), 0, t)
        for row, _, turns in self.drives:
            if turns:
                values[:, row] = np.remainder(values[:, row] + np.pi, 2 * np.pi) - np.pi
        return values

    def velocity(self, x: np.ndarray, R: np.ndarray, v: np.ndarray, w: np.ndarray,
                 t: np.ndarray | float = 0.0) -> np.ndarray:
        """dPhi/dt at times t, (T, m): G u minus the rates of drives."""
        return self._driven(self._evaluated("rate", x, R, v, w), 1, t)

    def gamma(self, x: np.ndarray, R: np.ndarray, v: np.ndarray, w: np.ndarray,
              t: np.ndarray | float = 0.0) -> np.ndarray:
        """gamma = d2Phi/dt2 - G du/dt at times t, (T, m)."""
        return self._driven(self._evaluated("gamma", x, R, v, w), 2, t)

    def _driven(self, values: np.ndarray, derivative: int, t: np.ndarray | float) -> np.ndarray:
        """Subtract the drives, or their derivatives, from the rows, in place."""
        for row, drive, _ in self.drives:
            values[:, row] -= drive(t, derivative)
        return values

    def _evaluated(self, quantity: str, *state: np.ndarray) -> np.ndarray:
        values = np.empty((len(state[0]), self.m))
        for part in self._parts(len(values)):
            x, R, *rates = (each[part] for each in state)
            full = _with_ground(x), _with_ground(R, np.eye(3)), *(_with_ground(rate) for rate in rates)
            for rows, basic in self._basics:
                values[part, rows] = getattr(basic, quantity)(*full)
        return values

    def _parts(self, times: int) -> list[slice]:
        length = max(1, _AT_ONCE // max(1, self.m))
        return [slice(first, first + length) for first in range(0, times, length)]

    def acceleration(self, x: np.ndarray, R: np.ndarray, v: np.ndarray, w: np.ndarray, a: np.ndarray,
                     alpha: np.ndarray, t: np.ndarray | float = 0.0) -> np.ndarray:
        """G du/dt + gamma at times t, (T, m), with du/dt = (a world, alpha body axes)."""
        return np.asarray(self._evaluated("rate", x, R, a, alpha) + self.gamma(x, R, v, w, t))

    def jacobian(self, x: np.ndarray, R: np.ndarray) -> np.ndarray:
        """G, (T, m, 6n): per body in order three columns for v (world) and three for w (body axes)."""
        n = self.scene.n
        G = np.zeros((len(x), self.m, n + 1, 6))
        for part in self._parts(len(x)):
            for rows, body, linear, angular in self._blocks(x[part], R[part]):
                at = part, rows, body[:, None]
                if linear is not None:
                    G[(*at, slice(3))] += linear
                G[(*at, slice(3, 6))] += angular
        return G[:, :, :n].reshape(len(x), self.m, 6 * n)

    def sparse_jacobian(self, x: np.ndarray, R: np.ndarray) -> csr_array:
        """G (m, 6n) of a single state, x (n, 3) and R (n, 3, 3), as a `scipy.sparse.csr_array`."""
        from scipy.sparse import coo_array

        entries: list[tuple[np.ndarray, ...]] = [(np.empty(0), np.empty(0, int), np.empty(0, int))]
        for rows, body, linear, angular in self._blocks(x[None], R[None]):
            for first, values in ((0, linear), (3, angular)):
                if values is not None:
                    columns = 6 * body[:, None, None] + first + np.arange(3)
                    there = np.broadcast_to(columns >= 0, values[0].shape)
                    entries.append((values[0][there], np.broadcast_to(rows[:, :, None], values[0].shape)[there],
                                    np.broadcast_to(columns, values[0].shape)[there]))
        data, row, column = (np.concatenate(each) for each in zip(*entries, strict=True))
        return coo_array((data, (row, column)), shape=(self.m, 6 * self.scene.n)).tocsr()

    def _blocks(self, x: np.ndarray, R: np.ndarray) -> Iterator[tuple[np.ndarray, np.ndarray, Any, np.ndarray]]:
        """(rows (K, r), bodies (K,), the two parts of a `Block`) of all joints."""
        x, R = _with_ground(x), _with_ground(R, np.eye(3))
        for rows, basic in self._basics:
            for body, linear, angular in basic.blocks(x, R):
                yield rows, body, linear, angular

    def reactions(self, x: np.ndarray, R: np.ndarray, lam: np.ndarray) -> dict[str, tuple[np.ndarray, np.ndarray]]:
        """Force (T, 3) in N and torque (T, 3) in N m of each joint on its child, world axes, at the child's anchor."""
        G = self.jacobian(x, R).reshape(len(x), self.m, self.scene.n, 6)
        result = {}
        for joint in self.scene.joints:
            rows = self.rows[joint.name]
            wrench = -np.einsum("trk,tr->tk", G[:, rows, joint.child], lam[:, rows])
            force = wrench[:, :3]
            attitude = R[:, joint.child]
            about_com = np.einsum("tij,tj->ti", attitude, wrench[:, 3:])
            result[joint.name] = force, about_com - cross(attitude @ joint.child_anchor, force)
        return result


def _with_ground(values: np.ndarray, ground: np.ndarray = _ZERO) -> np.ndarray:
    """`values` with the ground as one more body at the end, where its index -1 finds it."""
    return np.concatenate([values, np.broadcast_to(ground, (len(values), 1, *ground.shape))], axis=1)
