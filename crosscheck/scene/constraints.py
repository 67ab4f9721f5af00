"""The joints of a scene as constraints, evaluated over whole trajectories at once.

One common measure of Phi, G u and G du/dt + gamma for every engine. Conventions, for body i the parent, body j the
child, points s and axes a in body axes, d = x_j + R_j s_j - x_i - R_i s_i:

- a joint on an axis uses two reference vectors n1, n2 of the parent, unit and normal to its axis a: n1 is the
  coordinate direction in which a has its smallest component (the first of equals), made normal to a; n2 = a x n1;
- parallel axes are the two dot-1 rows (n1 . child_axis, n2 . child_axis), perpendicular where the axes coincide, so
  that no attitude is singular; offsets across an axis are the dot-2 rows of n1, then n2; a plane's is that of a;
- prismatic adds the dot-1 row n1 . b, with b fixed in the child: n2 as it lies at the start, normal to child_axis;
- fixed keeps the parent's coordinate triad e as it lies in the child at the start, as f: rows e1.f2, e2.f3, e3.f1;
- distance is (d . d - c^2) / (2 c).

Rows: joints in file order, and within a joint positions before dot-1 for spherical, universal, revolute and fixed
(3 + 0, 1, 2, 3 rows); dot-1 before dot-2 for cylindrical (2 + 2) and planar (2 + 1); prismatic is cylindrical + dot-1.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from crosscheck.scene.joints import JOINT_TYPES, Row
from crosscheck.scene.model import Joint, Scene

_ZERO = np.zeros(3)


@dataclasses.dataclass(frozen=True)
class BodyVector:
    """The vector R s of a body; every method returns world components, (T, 3)."""

    body: int
    s: np.ndarray  # (3,) body axes

    def value(self, x: np.ndarray, R: np.ndarray) -> np.ndarray:
        """The vector itself; `x` is not looked at."""
        found: np.ndarray = R[:, self.body] @ self.s
        return found

    def rate(self, R: np.ndarray, v: np.ndarray, w: np.ndarray) -> np.ndarray:
        """Its time derivative; `v` is not looked at."""
        found: np.ndarray = np.einsum("tij,tj->ti", R[:, self.body], cross(w[:, self.body], self.s))
        return found

    def centripetal(self, R: np.ndarray, w: np.ndarray) -> np.ndarray:
        """The part of its second derivative that is quadratic in w."""
        spin = w[:, self.body]
        found: np.ndarray = np.einsum("tij,tj->ti", R[:, self.body], cross(spin, cross(spin, self.s)))
        return found

    def add_rows(self, G: np.ndarray, R: np.ndarray, directions: np.ndarray) -> None:
        """Add the rows of `directions` (T, r, 3) times the Jacobian of the vector to G (T, r, n + 1, 6)."""
        # e . d(R s) = (s x R^T e) . w
        G[:, :, self.body, 3:] += cross(self.s, directions @ R[:, self.body])


@dataclasses.dataclass(frozen=True)
class Separation:
    """The vector d from the parent's point to the child's, with the methods of `BodyVector`."""

    parent: BodyVector  # from its centre of mass to its point
    child: BodyVector

    def value(self, x: np.ndarray, R: np.ndarray) -> np.ndarray:
        """d."""
        found: np.ndarray = (x[:, self.child.body] + self.child.value(x, R)
                - x[:, self.parent.body] - self.parent.value(x, R))
        return found

    def rate(self, R: np.ndarray, v: np.ndarray, w: np.ndarray) -> np.ndarray:
        """Its time derivative."""
        found: np.ndarray = (v[:, self.child.body] + self.child.rate(R, v, w)
                - v[:, self.parent.body] - self.parent.rate(R, v, w))
        return found

    def centripetal(self, R: np.ndarray, w: np.ndarray) -> np.ndarray:
        """The part of its second derivative that is quadratic in w."""
        found: np.ndarray = self.child.centripetal(R, w) - self.parent.centripetal(R, w)
        return found

    def add_rows(self, G: np.ndarray, R: np.ndarray, directions: np.ndarray) -> None:
        """As with `BodyVector`."""
        for end, signed in ((self.child, directions), (self.parent, -directions)):
            G[:, :, end.body, :3] += signed
            end.add_rows(G, R, signed)


@dataclasses.dataclass(frozen=True)
class Basic:
    """A basic constraint: (left . right - offset) / unit, or all of `right` where `left` is None.

    Equations (2.1) to (2.4) of docs/theory.md: dot-1 multiplies two axes, dot-2 an axis and a separation, distance a
    separation by itself; spherical is a separation alone. Every derivative follows from those of the factors by the
    product rule.
    """

    left: BodyVector | Separation | None
    right: BodyVector | Separation
    offset: float = 0.0
    unit: float = 1.0

    @property
    def rows(self) -> int:
        """Number of scalar equations."""
        return 3 if self.left is None else 1

    @property
    def dimensionless(self) -> bool:
        """Whether its rows are pure numbers, not metres."""
        return isinstance(self.right, BodyVector)

    def value(self, x: np.ndarray, R: np.ndarray) -> np.ndarray:
        """Its rows of Phi, (T, rows)."""
        q = self.right.value(x, R)
        return q if self.left is None else (_dot(self.left.value(x, R), q) - self.offset) / self.unit

    def rate(self, x: np.ndarray, R: np.ndarray, v: np.ndarray, w: np.ndarray) -> np.ndarray:
        """Its rows of G u, (T, rows)."""
        dq = self.right.rate(R, v, w)
        if self.left is None:
            return dq
        rows: np.ndarray = _dot(self.left.rate(R, v, w), self.right.value(x, R)) + _dot(self.left.value(x, R), dq)
        return rows / self.unit

    def gamma(self, x: np.ndarray, R: np.ndarray, v: np.ndarray, w: np.ndarray) -> np.ndarray:
        """Its rows of gamma, (T, rows)."""
        ddq = self.right.centripetal(R, w)
        if self.left is None:
            return ddq
        rows: np.ndarray = (_dot(self.left.centripetal(R, w), self.right.value(x, R))
                            + _dot(self.left.value(x, R), ddq)
                            + 2 * _dot(self.left.rate(R, v, w), self.right.rate(R, v, w)))
        return rows / self.unit

    def add_rows(self, G: np.ndarray, x: np.ndarray, R: np.ndarray) -> None:
        """Add its rows of the Jacobian to G (T, rows, n + 1, 6)."""
        if self.left is None:
            self.right.add_rows(G, R, np.broadcast_to(np.eye(3), (len(x), 3, 3)))
            return
        self.right.add_rows(G, R, self.left.value(x, R)[:, None] / self.unit)
        self.left.add_rows(G, R, self.right.value(x, R)[:, None] / self.unit)


def cross(p: np.ndarray, q: np.ndarray) -> np.ndarray:
    """p x q over the last axis, broadcasting; `numpy.cross` costs several times more on small batches."""
    p, q = np.broadcast_arrays(p, q)
    product = np.empty(p.shape)
    for k, (i, j) in enumerate(((1, 2), (2, 0), (0, 1))):
        product[..., k] = p[..., i] * q[..., j] - p[..., j] * q[..., i]
    return product


def normal_references(axis: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Two unit vectors n1, n2 with n1 x n2 = `axis` (3,), a unit vector; see the module for their choice."""
    n1 = np.zeros(3)
    n1[np.argmin(np.abs(axis))] = 1.0
    n1 -= (n1 @ axis) * axis
    n1 /= np.linalg.norm(n1)
    return n1, cross(axis, n1)


def basics(joint: Joint, parent_attitude: np.ndarray, child_attitude: np.ndarray) -> list[Basic]:
    """The basic constraints of a joint, in row order.

    `parent_attitude` and `child_attitude` (3, 3), body to world, are the initial ones: prismatic and fixed joints
    keep the relative attitude they find there.
    """
    d = Separation(BodyVector(joint.parent, joint.parent_anchor), BodyVector(joint.child, joint.child_anchor))
    relative = child_attitude.T @ parent_attitude

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
            case "dot2":
                return Basic(BodyVector(joint.parent, inner[row.parent]), d)

    return [basic(row) for row in JOINT_TYPES[joint.type].rows]


class Constraints:
    """The constraint equations of a scene.

    All methods take arrays with a leading time axis: x, v, a (T, n, 3) world, R (T, n, 3, 3) body to world, w and
    alpha (T, n, 3) body axes, lam (T, m). Rows have the unit metre, or none for dot-1 rows.

    Attributes
    ----------
    m : number of rows.
    rows : the rows of each joint, by its name.
    dimensionless : (m,) true for the dot-1 rows.
    """

    def __init__(self, scene: Scene) -> None:
        self.scene = scene
        attitudes = np.concatenate([scene.R0, np.eye(3)[None]])  # the ground is index -1, the last
        self.rows: dict[str, slice] = {}
        self._basics: list[tuple[slice, Basic]] = []
        self.m = 0
        for joint in scene.joints:
            first = self.m
            for basic in basics(joint, attitudes[joint.parent], attitudes[joint.child]):
                self._basics.append((slice(self.m, self.m + basic.rows), basic))
                self.m += basic.rows
            self.rows[joint.name] = slice(first, self.m)
        self.dimensionless = np.array([basic.dimensionless for _, basic in self._basics for _ in range(basic.rows)],
                                      dtype=bool)

    def rows_without(self, body: int | None) -> np.ndarray:
        """Indices of the rows of all joints but those of one body."""
        there = [np.arange(self.m)[self.rows[joint.name]] for joint in self.scene.joints
                 if body not in (joint.parent, joint.child)]
        return np.concatenate([*there, np.empty(0, dtype=int)])

    def position(self, x: np.ndarray, R: np.ndarray) -> np.ndarray:
        """Phi, (T, m)."""
        x, R = _with_ground(x), _with_ground(R, np.eye(3))
        phi = np.empty((len(x), self.m))
        for rows, basic in self._basics:
            phi[:, rows] = basic.value(x, R)
        return phi

    def velocity(self, x: np.ndarray, R: np.ndarray, v: np.ndarray, w: np.ndarray) -> np.ndarray:
        """G u, (T, m)."""
        x, R, v, w = _with_ground(x), _with_ground(R, np.eye(3)), _with_ground(v), _with_ground(w)
        rate = np.empty((len(x), self.m))
        for rows, basic in self._basics:
            rate[:, rows] = basic.rate(x, R, v, w)
        return rate

    def gamma(self, x: np.ndarray, R: np.ndarray, v: np.ndarray, w: np.ndarray) -> np.ndarray:
        """gamma = d2Phi/dt2 - G du/dt, (T, m)."""
        x, R, v, w = _with_ground(x), _with_ground(R, np.eye(3)), _with_ground(v), _with_ground(w)
        gamma = np.empty((len(x), self.m))
        for rows, basic in self._basics:
            gamma[:, rows] = basic.gamma(x, R, v, w)
        return gamma

    def acceleration(self, x: np.ndarray, R: np.ndarray, v: np.ndarray, w: np.ndarray, a: np.ndarray,
                     alpha: np.ndarray) -> np.ndarray:
        """G du/dt + gamma, (T, m), with du/dt = (a world, alpha body axes)."""
        found: np.ndarray = self.velocity(x, R, a, alpha) + self.gamma(x, R, v, w)
        return found

    def jacobian(self, x: np.ndarray, R: np.ndarray) -> np.ndarray:
        """G, (T, m, 6n): per body in order three columns for v (world) and three for w (body axes)."""
        n = self.scene.n
        x, R = _with_ground(x), _with_ground(R, np.eye(3))
        G = np.zeros((len(x), self.m, n + 1, 6))
        for rows, basic in self._basics:
            basic.add_rows(G[:, rows], x, R)
        return G[:, :, :n].reshape(len(x), self.m, 6 * n)

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
    """The ground as one more body, the last: its index -1 finds it."""
    return np.concatenate([values, np.broadcast_to(ground, (len(values), 1, *ground.shape))], axis=1)


def _dot(p: np.ndarray, q: np.ndarray) -> np.ndarray:
    found: np.ndarray = np.einsum("tk,tk->t", p, q)[:, None]
    return found
