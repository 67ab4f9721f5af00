"""Rows of the joints in the maximal formulation: their value, Jacobian and acceleration at du = 0.

A joint consists of four kinds of rows, each a record over all joints that use it: coincident points, perpendicular
directions, a separation normal to a direction of the parent, and a rod. Body i is the parent, j the child, d = x_j +
R_j s_j - x_i - R_i s_i. The ground is the last body of every array. Columns of the Jacobian belong to v in world axes
and w in body axes, so that they are exactly zero about an axis on which the anchor lies.

Contacts with a plane of the ground: the velocity of a body's point p (body axes) at the contact is v + R (w x p). Rows
are its components along directions d, in body axes too: (R d) . v + (p x d) . w.
"""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np

from crosscheck.references.world import HAT, Motion, back, centripetal, cross, dots, turned
from crosscheck.scene.coordinates import angle_from, zero_attitude
from crosscheck.scene.model import Joint, Scene

ROLLING = ("knife_edge", "rolling_disk", "rolling_sphere")


class Contacts:
    """Rows of all joints that roll or slide on a blade: height, and slip, whose values are zero."""

    def __init__(self, joints: list[Joint], n: int) -> None:
        self.joints, self.n = joints, n
        self.planes = [np.linalg.svd(joint.parent_axis[None])[2][1:] for joint in joints]

    def terms(self, motion: Motion) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Values (k), Jacobian (k, n + 1, 6), second derivatives at zero accelerations (k)."""
        values, rows, drifts = [], [], []
        for joint, plane in zip(self.joints, self.planes, strict=True):
            R, v, w = motion.R[joint.child], motion.v[joint.child], motion.w[joint.child]
            up = R.T @ joint.parent_axis  # a vector fixed in the world turns with -w in body axes
            sinking = -np.cross(w, up)
            point, moving, height = joint.child_anchor, np.zeros(3), 0.0
            if joint.type == "rolling_sphere":
                point, moving, height = point - joint.radius * up, -joint.radius * sinking, joint.radius
            elif joint.type == "rolling_disk":
                axis = joint.child_axis
                flat, change = up - (axis @ up) * axis, sinking - (axis @ sinking) * axis
                size = np.linalg.norm(flat)
                point = point - joint.radius * flat / size
                moving = -joint.radius * (change / size - flat * (flat @ change) / size**3)
                height = joint.radius * size
            along = [joint.parent_axis, *plane]
            directions = [(R.T @ direction, -np.cross(w, R.T @ direction)) for direction in along]
            if joint.type == "knife_edge":
                directions[1:] = [(np.cross(up, joint.child_axis), np.cross(sinking, joint.child_axis))]
            own = R.T @ v
            for d, turning in directions:
                row = np.zeros((self.n + 1, 6))
                row[joint.child] = [*R @ d, *np.cross(point, d)]
                rows.append(row)
                # d/dt of d . R^T v at v' = 0, and of (p x d) . w at w' = 0
                drifts.append(turning @ own - d @ np.cross(w, own)
                              + (np.cross(moving, d) + np.cross(point, turning)) @ w)
                values.append(0.0)
            centre = motion.x[joint.child] + R @ joint.child_anchor
            values[len(values) - len(directions)] = joint.parent_axis @ (centre - joint.parent_anchor) - height
        return np.array(values), np.array(rows), np.array(drifts)


@dataclasses.dataclass(frozen=True)
class Row:
    """One use of a kind by a joint; `direction` is fixed in the parent, `other` in the child."""

    joint: Joint
    direction: np.ndarray | None = None
    other: np.ndarray | None = None


class Coincidence:
    """d = 0, three rows a joint."""

    def __init__(self, uses: list[Row], n: int) -> None:
        joints, k = [use.joint for use in uses], len(uses)
        self.i = np.array([joint.parent for joint in joints])  # the ground, -1, is the last entry
        self.j = np.array([joint.child for joint in joints])
        self.both = np.concatenate([self.i, self.j])
        self.s = np.array([joint.parent_anchor for joint in joints] + [joint.child_anchor for joint in joints])
        self.template = np.zeros((3 * k, n + 1, 6))
        self.hat = (self.s @ HAT).reshape(-1, 3, 3)  # d(R s) = -R s^ along w
        joint_rows = 3 * np.arange(k)[:, None]
        for body, direction in ((self.i, -1.0), (self.j, 1.0)):
            self.template[joint_rows + np.arange(3), body[:, None], np.arange(3)] = direction
        joint_rows, rows, columns = joint_rows[:, :, None], np.arange(3)[:, None], 3 + np.arange(3)
        self.at_i = joint_rows + rows, self.i[:, None, None], columns
        self.at_j = joint_rows + rows, self.j[:, None, None], columns

    def terms(self, motion: Motion) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Gaps d (3 k), Jacobian (3 k, n + 1, 6) and second derivative of d at zero accelerations (3 k)."""
        levers = turned(motion.R[self.both], self.s)
        G = self.template.copy()
        slopes = np.matmul(motion.R[self.both], self.hat)
        G[self.at_i] = slopes[:len(self.i)]
        G[self.at_j] = -slopes[len(self.i):]
        return (self._difference(motion.x[self.both] + levers), G,
                self._difference(centripetal(motion.omega[self.both], levers)))

    def _difference(self, points: np.ndarray) -> np.ndarray:
        gap: np.ndarray = (points[len(self.i):] - points[:len(self.i)]).ravel()
        return gap


class Perpendicular:
    """p . b = 0 of a direction p of the parent and b of the child, one row a use."""

    def __init__(self, uses: list[Row], n: int) -> None:
        self.i = np.array([use.joint.parent for use in uses])
        self.j = np.array([use.joint.child for use in uses])
        self.p, self.b = (np.array([getattr(use, name) for use in uses]) for name in ("direction", "other"))
        self.shape = len(uses), n + 1, 6

    def terms(self, motion: Motion) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Values (k), Jacobian (k, n + 1, 6), second derivatives at zero accelerations (k)."""
        p, b = turned(motion.R[self.i], self.p), turned(motion.R[self.j], self.b)
        omega_i, omega_j = motion.omega[self.i], motion.omega[self.j]
        G, rows = np.zeros(self.shape), np.arange(len(p))
        G[rows, self.i, 3:] = cross(self.p, back(motion.R[self.i], b))
        G[rows, self.j, 3:] = cross(self.b, back(motion.R[self.j], p))
        drift = (dots(centripetal(omega_i, p), b) + dots(p, centripetal(omega_j, b))
                 + 2 * dots(cross(omega_i, p), cross(omega_j, b)))
        return dots(p, b), G, drift


class _Separation:
    """Base of rows with d: d and its derivatives."""

    def __init__(self, uses: list[Row], n: int) -> None:
        joints = [use.joint for use in uses]
        self.i, self.j = np.array([joint.parent for joint in joints]), np.array([joint.child for joint in joints])
        self.s_i = np.array([joint.parent_anchor for joint in joints])
        self.s_j = np.array([joint.child_anchor for joint in joints])
        self.n, self.shape = np.array([use.direction for use in uses]), (len(uses), n + 1, 6)
        self.length = np.array([joint.length for joint in joints], dtype=float)

    def separation(self, motion: Motion) -> tuple[np.ndarray, ...]:
        """d, its rate, and its second derivative at zero accelerations, (k, 3) each."""
        i, j = self.i, self.j
        l_i, l_j = turned(motion.R[i], self.s_i), turned(motion.R[j], self.s_j)
        rate = motion.v[j] - motion.v[i] + cross(motion.omega[j], l_j) - cross(motion.omega[i], l_i)
        bend = centripetal(motion.omega[j], l_j) - centripetal(motion.omega[i], l_i)
        return motion.x[j] + l_j - motion.x[i] - l_i, rate, bend


class Across(_Separation):
    """n . d = 0 of a direction n of the parent, one row a use."""

    def terms(self, motion: Motion) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Values (k), Jacobian (k, n + 1, 6), second derivatives at zero accelerations (k)."""
        d, rate, bend = self.separation(motion)
        n, omega = turned(motion.R[self.i], self.n), motion.omega[self.i]
        G, rows = np.zeros(self.shape), np.arange(len(d))
        G[rows, self.i, :3], G[rows, self.j, :3] = -n, n
        G[rows, self.i, 3:] = cross(self.n, back(motion.R[self.i], d) + self.s_i)
        G[rows, self.j, 3:] = cross(self.s_j, back(motion.R[self.j], n))
        drift = dots(centripetal(omega, n), d) + 2 * dots(cross(omega, n), rate) + dots(n, bend)
        return dots(n, d), G, drift


class Rod(_Separation):
    """(d . d - c^2) / (2 c) = 0, one row a joint."""

    def terms(self, motion: Motion) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Values (k), Jacobian (k, n + 1, 6), second derivatives at zero accelerations (k)."""
        d, rate, bend = self.separation(motion)
        e = d / self.length[:, None]
        G, rows = np.zeros(self.shape), np.arange(len(d))
        G[rows, self.i, :3], G[rows, self.j, :3] = -e, e
        G[rows, self.i, 3:] = cross(back(motion.R[self.i], e), self.s_i)
        G[rows, self.j, 3:] = cross(self.s_j, back(motion.R[self.j], e))
        return (dots(d, d) - self.length**2) / (2 * self.length), G, dots(rate, rate) / self.length + dots(e, bend)


class Relations:
    """C angles = 0 for angles of hinges from the start, as in a parallelogram, also through its flat position."""

    def __init__(self, scene: Scene, coefficients: np.ndarray) -> None:
        joints = scene.joints
        self.i, self.j = np.array([joint.parent for joint in joints]), np.array([joint.child for joint in joints])
        self.axis, self.C, self.n = np.array([joint.parent_axis for joint in joints]), coefficients, scene.n
        R = np.concatenate([scene.R0, np.eye(3)[None]])
        self.normal = np.array([np.linalg.svd(axis[None])[2][1] for axis in self.axis])
        self.mark = np.matmul(R[self.j].transpose(0, 2, 1), turned(R[self.i], self.normal)[:, :, None])[:, :, 0]

    def jacobian(self, motion: Motion) -> np.ndarray:
        """d rates / d u, (hinges, n + 1, 6)."""
        G, rows = np.zeros((len(self.i), self.n + 1, 6)), np.arange(len(self.i))
        G[rows, self.j, 3:] = back(motion.R[self.j], turned(motion.R[self.i], self.axis))
        G[rows, self.i, 3:] = -self.axis
        return G

    def rates(self, motion: Motion) -> np.ndarray:
        """Rates of the hinges' angles (hinges)."""
        return dots(turned(motion.R[self.i], self.axis), motion.omega[self.j] - motion.omega[self.i])

    def angles(self, motion: Motion) -> np.ndarray:
        """Angles from the attitudes, with the full turns of the integrated ones (hinges)."""
        normal, mark = turned(motion.R[self.i], self.normal), turned(motion.R[self.j], self.mark)
        across = cross(turned(motion.R[self.i], self.axis), normal)
        change = np.arctan2(dots(across, mark), dots(normal, mark)) - motion.hinges
        continued: np.ndarray = motion.hinges + change - 2 * np.pi * np.round(change / (2 * np.pi))
        return continued

    def terms(self, motion: Motion) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Values (k), Jacobian (k, n + 1, 6), second derivatives at zero accelerations (k)."""
        axis = turned(motion.R[self.i], self.axis)
        drift = dots(cross(motion.omega[self.i], axis), motion.omega[self.j])
        return self.C @ self.angles(motion), np.tensordot(self.C, self.jacobian(motion), 1), self.C @ drift


class Coordinates:
    """Angles of hinges, in (-pi, pi], then slides n . d, one row each; `joints` are in this order."""

    def __init__(self, joints: list[Joint], n: int) -> None:
        self.turns = [joint for joint in joints if joint.type == "revolute"]
        self.slides = [joint for joint in joints if joint.type == "prismatic"]
        self.across = Across([Row(joint, joint.parent_axis) for joint in self.slides], n) if self.slides else None
        self.shape = len(self.turns), n + 1, 6
        self.zeros = [zero_attitude(joint) for joint in self.turns]
        self.joints = [*self.turns, *self.slides]

    def values(self, motion: Motion) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Values (k), Jacobian (k, n + 1, 6), second derivatives at zero accelerations (k)."""
        values, drifts, G = [], [], np.zeros(self.shape)
        for row, (joint, zero) in enumerate(zip(self.turns, self.zeros, strict=True)):
            parent, child = motion.R[joint.parent], motion.R[joint.child]
            axis = parent @ joint.parent_axis
            values.append(angle_from(zero, joint.parent_axis, parent.T @ child))
            G[row, joint.child, 3:], G[row, joint.parent, 3:] = child.T @ axis, -joint.parent_axis
            drifts.append(np.cross(motion.omega[joint.parent], axis) @ motion.omega[joint.child])
        if self.across is not None:
            value, jacobian, drift = self.across.terms(motion)
            values, drifts, G = [*values, *value], [*drifts, *drift], np.concatenate([G, jacobian])
        return np.array(values), G, np.array(drifts)


class Driven(Coordinates):
    """coordinate = function of time, one row a driven joint."""

    def __init__(self, joints: list[Joint], n: int) -> None:
        super().__init__(joints, n)
        self.drives = [joint.drive for joint in self.joints if joint.drive is not None]

    def speeds(self, t: float) -> np.ndarray:
        """Rates of the functions."""
        return np.array([drive(t, 1) for drive in self.drives])

    def terms(self, motion: Motion) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Values (k), Jacobian (k, n + 1, 6), second derivatives at zero accelerations (k)."""
        gaps, G, drifts = self.values(motion)
        gaps = gaps - [drive(motion.t) for drive in self.drives]
        gaps[:len(self.turns)] -= 2 * np.pi * np.round(gaps[:len(self.turns)] / (2 * np.pi))
        return gaps, G, drifts - [drive(motion.t, 2) for drive in self.drives]


class Coupled(Coordinates):
    """coordinate - ratio (coordinate of another joint) stays what it is at the start, one row a mimic.

    Angles are on the turn of the integrated ones, `motion.hinges`.
    """

    def __init__(self, scene: Scene) -> None:
        named = {joint.name: joint for joint in scene.joints}
        pairs = [(joint, named[joint.mimic.joint], joint.mimic.ratio) for joint in scene.joints
                 if joint.mimic is not None]
        super().__init__([joint for joint in scene.joints
                          if any(joint in (follower, leader) for follower, leader, _ in pairs)], scene.n)
        place = {joint.name: k for k, joint in enumerate(self.joints)}
        self.C = np.zeros((len(pairs), len(self.joints)))
        for row, (follower, leader, ratio) in enumerate(pairs):
            self.C[row, place[follower.name]], self.C[row, place[leader.name]] = 1.0, -ratio
        self.begun = np.zeros(len(self.joints))

    def rates(self, motion: Motion) -> list[float]:
        """Of the angles."""
        return [float(joint.child_axis @ motion.w[joint.child] - joint.parent_axis @ motion.w[joint.parent])
                for joint in self.turns]

    def terms(self, motion: Motion) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Values (k), Jacobian (k, n + 1, 6), second derivatives at zero accelerations (k)."""
        values, G, drifts = self.values(motion)
        turns = slice(len(self.turns))
        values[turns] -= 2 * np.pi * np.round((values[turns] - motion.hinges) / (2 * np.pi))
        return self.C @ (values - self.begun), np.tensordot(self.C, G, 1), self.C @ drifts


KINDS = (Coincidence, Perpendicular, Across, Rod)
POINTED = ("spherical", "universal", "revolute", "fixed")  # joints whose anchors coincide


def kinds(scene: Scene) -> list[Any]:
    """The rows of all joints of a scene, one record a kind that occurs."""
    uses: dict[type, list[Row]] = {kind: [] for kind in KINDS}
    rolling = [joint for joint in scene.joints if joint.type in ROLLING]
    for joint in scene.joints:
        if joint in rolling:
            continue
        relative = np.eye(3) if joint.child < 0 else scene.R0[joint.child].T
        _add(joint, relative @ scene.R0[joint.parent] if joint.parent >= 0 else relative, uses)
    driven = [joint for joint in scene.joints if joint.drive is not None]
    rows: list[Any] = [kind(uses[kind], scene.n) for kind in KINDS if uses[kind]]
    rows += [Driven(driven, scene.n)] if driven else []
    return rows + ([Contacts(rolling, scene.n)] if rolling else [])


def _add(joint: Joint, relative: np.ndarray, uses: dict[type, list[Row]]) -> None:
    """Sort the rows of a joint by kind; `relative` takes parent axes to child axes at the start."""
    def perpendicular(p: np.ndarray, b: np.ndarray) -> None:
        uses[Perpendicular].append(Row(joint, p, b))

    if joint.type in POINTED:
        uses[Coincidence].append(Row(joint))
    if joint.type == "distance":
        uses[Rod].append(Row(joint))
    elif joint.type == "fixed":
        for k in range(3):  # each direction with the next one in the child: no row then has a zero slope at the start
            perpendicular(np.eye(3)[k], relative[:, (k + 1) % 3])
    elif joint.type == "universal":
        perpendicular(joint.parent_axis, joint.child_axis)
    if joint.type in ("spherical", "universal", "fixed", "distance"):
        return
    axis = joint.parent_axis
    normals = np.linalg.svd(axis[None])[2][1:]  # two directions across the axis; which ones does not matter
    if joint.type in ("planar", "point_on_plane"):
        uses[Across].append(Row(joint, axis))
    elif joint.type != "revolute":
        uses[Across] += [Row(joint, normal) for normal in normals]
    if not joint.type.startswith("point_on"):
        for normal in normals:
            perpendicular(normal, joint.child_axis)
    if joint.type == "prismatic":
        perpendicular(normals[0], relative @ normals[1])
