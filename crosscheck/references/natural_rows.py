"""Rows of the joints in natural coordinates: quadratic forms with constant coefficients.

A row is z^T A z / 2 + B z + c of the coordinates z = (q_i, q_j) of two bodies, q = (x, r1, r2, r3).
"""

from __future__ import annotations

import dataclasses

import numpy as np

from crosscheck.references.natural_series import LONG
from crosscheck.scene.model import GROUND, Joint, Scene

COINCIDING = ("spherical", "universal", "revolute", "fixed")
TURNING_ABOUT = ("revolute", "cylindrical", "prismatic", "planar")  # joints that keep the child's axis on the parent's


@dataclasses.dataclass
class Rows:
    """All rows of a scene: coefficients (m, 24, 24), (m, 24), (m), and the two bodies of each, (m, 2)."""

    A: np.ndarray
    B: np.ndarray
    c: np.ndarray
    bodies: np.ndarray
    n: int

    @property
    def count(self) -> int:
        """Number of rows m."""
        return len(self.c)

    def local(self, q: np.ndarray) -> np.ndarray:
        """Coordinates of the two bodies of each row, (m, 2, 12)."""
        found: np.ndarray = q.reshape(self.n + 1, 12)[self.bodies]
        return found

    def curved(self, q: np.ndarray) -> np.ndarray:
        """A z, (m, 2, 12)."""
        found: np.ndarray = np.matmul(self.A, self.local(q).reshape(-1, 24, 1)).reshape(-1, 2, 12)
        return found

    def gradient(self, q: np.ndarray) -> np.ndarray:
        """A z + B, (m, 2, 12)."""
        found: np.ndarray = self.curved(q) + self.B.reshape(-1, 2, 12)
        return found

    def values(self, q: np.ndarray) -> np.ndarray:
        """Phi, (m)."""
        z = self.local(q)
        found: np.ndarray = np.einsum("mic,mic->m", 0.5 * self.curved(q) + self.B.reshape(-1, 2, 12), z) + self.c
        return found

    def rates(self, q: np.ndarray, rate: np.ndarray) -> np.ndarray:
        """dPhi/dt, (m)."""
        found: np.ndarray = np.einsum("mic,mic->m", self.gradient(q), self.local(rate))
        return found

    def along(self, G: np.ndarray, a: np.ndarray) -> np.ndarray:
        """G a, (m), of a (n, 4, 3)."""
        found: np.ndarray = np.einsum("mic,mic->m", G, self.local(np.concatenate([a, np.zeros((1, 4, 3), LONG)])))
        return found

    def pull(self, G: np.ndarray, lam: np.ndarray) -> np.ndarray:
        """G^T lam, (n + 1, 4, 3)."""
        return self.scattered(lam[:, None, None] * G)

    def scattered(self, local: np.ndarray) -> np.ndarray:
        """Sums of local values (m, 2, 12) by body, (n + 1, 4, 3)."""
        total = np.zeros((self.n + 1, 12), LONG)
        np.add.at(total, self.bodies, local)
        return total.reshape(-1, 4, 3)

    def dense(self, G: np.ndarray) -> np.ndarray:
        """G as a matrix (m, 12 n)."""
        matrix = np.zeros((self.count, self.n + 1, 12))
        rows = np.arange(self.count)
        for end in (0, 1):
            matrix[rows, self.bodies[:, end]] += G[:, end]
        return matrix[:, :-1].reshape(self.count, -1)


def rows_of(scene: Scene) -> Rows:
    """The rows that keep attitudes orthonormal and those of all joints."""
    terms: list[tuple[np.ndarray, np.ndarray, float, int, int]] = []
    for body in range(scene.n):
        for a in range(3):
            for b in range(a, 3):
                form = np.zeros((24, 24))
                half = _vector(np.eye(3)[a]).T @ _vector(np.eye(3)[b])
                form[:12, :12] = half if a == b else half + half.T  # r_a . r_b, with a factor 1/2 for a = b
                terms.append((form, np.zeros(24), -0.5 if a == b else 0.0, body, GROUND))
    for joint in scene.joints:
        terms += [(*term, joint.parent, joint.child) for term in _of_joint(joint, scene)]
    A, B, c, first, second = zip(*terms, strict=True)
    return Rows(np.array(A).astype(LONG), np.array(B).astype(LONG), np.array(c, LONG),
                np.array([first, second]).T % (scene.n + 1), scene.n)


def _vector(own: np.ndarray) -> np.ndarray:
    """(3, 12): a vector fixed in a body, from its coordinates."""
    return np.kron(np.concatenate([[0.0], own]), np.eye(3))


def _point(own: np.ndarray) -> np.ndarray:
    """(3, 12): a point fixed in a body."""
    return np.kron(np.concatenate([[1.0], own]), np.eye(3))


def _of_joint(joint: Joint, scene: Scene) -> list[tuple[np.ndarray, np.ndarray, float]]:
    """(A, B, c) of the rows of a joint."""
    nothing = np.zeros((24, 24))
    gap = np.concatenate([-_point(joint.parent_anchor), _point(joint.child_anchor)], axis=1)  # (3, 24)
    frames = [np.eye(3) if body == GROUND else scene.R0[body] for body in (joint.parent, joint.child)]
    relative = frames[1].T @ frames[0]

    def product(one: np.ndarray, other: np.ndarray) -> np.ndarray:
        found: np.ndarray = one.T @ other + other.T @ one
        return found

    def perpendicular(p: np.ndarray, b: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
        return product(_in_parent(p), np.concatenate([np.zeros((3, 12)), _vector(b)], axis=1)), np.zeros(24), 0.0

    def across(p: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
        return product(_in_parent(p), gap), np.zeros(24), 0.0

    if joint.type == "distance":
        return [(gap.T @ gap / joint.length, np.zeros(24), -0.5 * joint.length)]
    found = [(nothing, gap[k], 0.0) for k in range(3)] if joint.type in COINCIDING else []
    if joint.type == "universal":
        return [*found, perpendicular(joint.parent_axis, joint.child_axis)]
    if joint.type == "fixed":
        return found + [perpendicular(np.eye(3)[k], relative[:, k - 2]) for k in range(3)]
    if joint.type == "spherical":
        return found
    e = joint.parent_axis
    one = np.cross(e, np.eye(3)[np.argmin(np.abs(e))])
    one /= np.linalg.norm(one)
    other = np.cross(e, one)
    if joint.type in ("planar", "point_on_plane"):
        found.append(across(e))
    elif joint.type != "revolute":
        found += [across(one), across(other)]
    if joint.type in TURNING_ABOUT:
        found += [perpendicular(one, joint.child_axis), perpendicular(other, joint.child_axis)]
    if joint.type == "prismatic":
        found.append(perpendicular(one, relative @ other))
    return found


def _in_parent(own: np.ndarray) -> np.ndarray:
    """(3, 24): a vector fixed in the parent."""
    return np.concatenate([_vector(own), np.zeros((3, 12))], axis=1)
