"""Bodies that touch a plane of the ground at one point: a knife edge, a rolling disk, a rolling sphere.

With c from the centre of mass to the point of contact and n the normal of the plane, a row is t . (v + w x c) = 0, all
in world axes. The first row is that of the height: t = n, the derivative of Phi. The other rows are those of slip,
which constrain velocities alone and are zero in Phi: t is n x child_axis, across the blade, or one of the two
references of n.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from typing import Any, ClassVar

import numpy as np

from crosscheck.scene.model import Joint
from crosscheck.scene.vectors import cross, dot, normal_references


@dataclasses.dataclass(frozen=True)
class KnifeEdge:
    """K blades, with the methods of `crosscheck.scene.constraints.Basic`."""

    child: Any  # (K,) indices
    s: np.ndarray  # (K, 3) the blade's point or the centre, from the centre of mass, body axes
    plane: np.ndarray  # (K, 3) a point of the plane, world
    normal: np.ndarray  # (K, 3) world
    axis: np.ndarray  # (K, 3) body axes
    radius: np.ndarray  # (K, 1) m

    left: ClassVar[None] = None
    right: ClassVar[None] = None
    rows: ClassVar[int] = 2
    dimensionless: ClassVar[bool] = False

    @classmethod
    def of(cls, joint: Joint) -> KnifeEdge:
        """The contact of one joint, not yet stacked; a sphere has no axis, so that any one serves."""
        axis = joint.parent_axis if joint.child_axis is None else joint.child_axis
        return cls(joint.child, joint.child_anchor, joint.parent_anchor, joint.parent_axis, axis,
                   np.array([joint.radius or 0.0]))

    def _share(self, R: np.ndarray) -> np.ndarray:
        """Height of the blade's point or the centre, in radii, (T, K, 1)."""
        return np.ones((len(R), len(self.child), 1))

    def _lever(self, a: np.ndarray, rate: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """From the blade's point or the centre to the point of contact, and how fast it changes, (T, K, 3)."""
        return np.zeros_like(a), np.zeros_like(a)

    def _directions(self, a: np.ndarray) -> np.ndarray:
        """Directions t of all rows, (T, K, rows, 3); they are affine in the axis `a`."""
        return np.stack([np.broadcast_to(self.normal, a.shape), cross(self.normal, a)], axis=2)

    def _contact(self, R: np.ndarray, w: np.ndarray | None = None) -> tuple[np.ndarray, ...]:
        """c, its rate, the axis, its rate and the angular velocity, world."""
        R = R[:, self.child]
        spin = np.zeros((len(R), len(self.child), 3)) if w is None else np.einsum("tkij,tkj->tki", R, w[:, self.child])
        arm, a = (np.einsum("tkij,kj->tki", R, vector) for vector in (self.s, self.axis))
        lever, turned = self._lever(a, cross(spin, a))
        return arm + lever, cross(spin, arm) + turned, a, cross(spin, a), spin

    def value(self, x: np.ndarray, R: np.ndarray) -> np.ndarray:
        """Its rows of Phi, (T, K, rows)."""
        values = np.zeros((len(x), len(self.child), self.rows))
        centre = x[:, self.child] + np.einsum("tkij,kj->tki", R[:, self.child], self.s)
        values[..., :1] = dot(self.normal, centre - self.plane) - self.radius * self._share(R)
        return values

    def rate(self, x: np.ndarray, R: np.ndarray, v: np.ndarray, w: np.ndarray) -> np.ndarray:
        """Its rows of G u, (T, K, rows)."""
        c, _, a, _, spin = self._contact(R, w)
        return np.asarray(np.einsum("tkri,tki->tkr", self._directions(a), v[:, self.child] + cross(spin, c)))

    def gamma(self, x: np.ndarray, R: np.ndarray, v: np.ndarray, w: np.ndarray) -> np.ndarray:
        """Its rows of gamma, (T, K, rows)."""
        c, moving, a, turning, spin = self._contact(R, w)
        change = self._directions(a + turning) - self._directions(a)
        bias: np.ndarray = (np.einsum("tkri,tki->tkr", change, v[:, self.child] + cross(spin, c))
                             + np.einsum("tkri,tki->tkr", self._directions(a), cross(spin, moving)))
        return bias

    def blocks(self, x: np.ndarray, R: np.ndarray) -> Iterator[tuple[Any, np.ndarray, np.ndarray]]:
        """Its rows of the Jacobian."""
        c, _, a, _, _ = self._contact(R)
        directions = self._directions(a)
        yield self.child, directions, cross(c[:, :, None], directions) @ R[:, self.child]


@dataclasses.dataclass(frozen=True)
class RollingSphere(KnifeEdge):
    """K spheres."""

    rows: ClassVar[int] = 3

    def _lever(self, a: np.ndarray, rate: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return np.broadcast_to(-self.radius * self.normal, a.shape), np.zeros_like(a)

    def _directions(self, a: np.ndarray) -> np.ndarray:
        triads = np.array([[normal, *normal_references(normal)] for normal in self.normal])
        return np.broadcast_to(triads, (len(a), *triads.shape))


@dataclasses.dataclass(frozen=True)
class RollingDisk(RollingSphere):
    """K disks."""

    def _share(self, R: np.ndarray) -> np.ndarray:
        a = np.einsum("tkij,kj->tki", R[:, self.child], self.axis)
        return _sine(dot(self.normal, a))

    def _lever(self, a: np.ndarray, rate: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        u, du = dot(self.normal, a), dot(self.normal, rate)
        up, rise = self.normal - u * a, -du * a - u * rate
        height = _sine(u)
        return -self.radius * up / height, -self.radius * (rise / height + up * u * du / height**3)


def _sine(cosine: np.ndarray) -> np.ndarray:
    """Of an angle that is not zero, as a flat disk has no lowest point; rounding may take the cosine past 1."""
    return np.asarray(np.sqrt(np.maximum(1 - cosine**2, np.finfo(float).eps)))


CONTACTS = {"knife_edge": KnifeEdge, "rolling_disk": RollingDisk, "rolling_sphere": RollingSphere}
"""By the joint types that scene files use."""
