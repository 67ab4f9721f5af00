"""Series of the motion in natural coordinates, and springs, dampers and loads, coefficient by coefficient.

A force F at a point s of a body acts on (x, r1, r2, r3) by (F, s1 F, s2 F, s3 F). A torque T does the work T . w with
w = (r1 x r1' + r2 x r2' + r3 x r3') / 2 and acts by T x rk / 2 on each column.
"""

from __future__ import annotations

import numpy as np

from crosscheck.errors import Unsupported
from crosscheck.scene.functions import TimeFunction, Value
from crosscheck.scene.model import GROUND, Force, Scene

LONG = np.longdouble


class Motion:
    """Coefficients of q, (order + 1, n + 1, 4, 3), the ground last, and of angles of torsional springs."""

    def __init__(self, q: np.ndarray, rate: np.ndarray, angles: np.ndarray, order: int) -> None:
        self.q = np.zeros((order + 1, *q.shape), LONG)
        self.q[0], self.q[1] = q, rate
        self.angles = np.zeros((order + 1, len(angles)), LONG)
        self.angles[0] = angles

    def at(self, tau: np.longdouble) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """q, q', q'' and angles at a time after the start of the step."""
        q, rate, second = np.zeros((3, *self.q.shape[1:]), LONG)
        angles = np.zeros(self.angles.shape[1], LONG)
        for k in range(len(self.q) - 1, -1, -1):
            q, angles = q * tau + self.q[k], angles * tau + self.angles[k]
            rate = rate * tau + k * self.q[k] if k else rate
            second = second * tau + k * (k - 1) * self.q[k] if k > 1 else second
        return q, rate, second, angles

    def vector(self, body: int, own: np.ndarray, k: int) -> np.ndarray:
        """k-th coefficient of a vector fixed in a body, world axes."""
        turned: np.ndarray = own @ self.q[k, body, 1:]
        return turned

    def point(self, body: int, own: np.ndarray, k: int) -> np.ndarray:
        """k-th coefficient of a point fixed in a body."""
        place: np.ndarray = self.q[k, body, 0] + own @ self.q[k, body, 1:]
        return place


def product(one: np.ndarray, other: np.ndarray, k: int) -> np.ndarray:
    """k-th coefficient of the product of a scalar series and a series of numbers or vectors."""
    weights = one[k::-1] if k else one[:1]
    coefficient: np.ndarray = np.tensordot(weights, other[:k + 1], 1)
    return coefficient


def crossed(one: np.ndarray, other: np.ndarray, k: int) -> np.ndarray:
    """k-th coefficient of the cross product of series of vectors; `other` may hold several vectors per coefficient."""
    first = one[k::-1] if k else one[:1]
    first = first.reshape(len(first), *(1,) * (other.ndim - 2), 3)
    coefficient: np.ndarray = np.cross(first, other[:k + 1]).sum(axis=0)
    return coefficient


OPPOSITE = 1e-6  # axes closer to opposite than this have no unique shortest turn between them


def _push(effort: np.ndarray, body: int, own: np.ndarray, force: np.ndarray) -> None:
    """Add a force at a point of a body."""
    effort[body, 0] += force
    effort[body, 1:] += own[:, None] * force


class LinearSpring:
    """A force P d with P = k (1 - L0 / L) + c (d . d') / L^2 between two points, d from the parent's to the child's."""

    def __init__(self, force: Force) -> None:
        p = force.parameters
        self.ends = (force.parent, force.child)
        self.points = [np.array(p[name], LONG) for name in ("parent_point", "child_point")]
        self.k, self.free, self.c = (LONG(p[name]) for name in ("stiffness", "free_length", "damping"))

    def begin(self, order: int, t: np.longdouble) -> None:
        """Clear the coefficients of the last step."""
        self.d, self.rate = np.zeros((2, order + 1, 3), LONG)
        self.square, self.length, self.over, self.over_square, self.slip, self.pull = np.zeros((6, order + 1), LONG)

    def add(self, motion: Motion, k: int, effort: np.ndarray) -> None:
        """Add the k-th coefficient to the forces on q."""
        def separation(order: int) -> np.ndarray:
            parent, child = (motion.point(end, own, order) for end, own in zip(self.ends, self.points, strict=True))
            between: np.ndarray = np.subtract(child, parent)
            return between

        self.d[k], self.rate[k] = separation(k), (k + 1) * separation(k + 1)
        self.square[k] = sum(product(self.d[:, i], self.d[:, i], k) for i in range(3))
        self.slip[k] = sum(product(self.d[:, i], self.rate[:, i], k) for i in range(3))
        if k == 0:
            if self.square[0] == 0:
                raise Unsupported("natural coordinates: a spring of no length has no direction")
            self.length[0] = np.sqrt(self.square[0])
            self.over[0], self.over_square[0] = 1 / self.length[0], 1 / self.square[0]
        else:
            inner = self.length[1:k] @ self.length[k - 1:0:-1]
            self.length[k] = (self.square[k] - inner) / (2 * self.length[0])
            self.over[k] = -self.over[0] * (self.length[1:k + 1] @ self.over[k - 1::-1])
            self.over_square[k] = -self.over_square[0] * (self.square[1:k + 1] @ self.over_square[k - 1::-1])
        self.pull[k] = (self.k if k == 0 else 0) - self.k * self.free * self.over[k]
        self.pull[k] += self.c * product(self.slip, self.over_square, k)
        force = product(self.pull, self.d, k)
        for body, own, sign in zip(self.ends, self.points, (1, -1), strict=True):
            _push(effort, body, own, sign * force)


class Load:
    """A force at a point of a body, or a torque on it, constant in world or body axes, times a factor."""

    def __init__(self, force: Force) -> None:
        p = force.parameters
        self.body, self.in_body, self.turns = force.child, p["frame"] == "body", force.type == "constant_torque"
        self.vector = np.array(p["torque" if self.turns else "force"], LONG)
        self.point = np.array(p.get("child_point", (0.0, 0.0, 0.0)), LONG)
        self.factor = p.get("factor", 1.0)

    def begin(self, order: int, t: np.longdouble) -> None:
        """Expand the factor about the time t of a new step."""
        self.scale = series_of(self.factor, t, order + 1)

    def add(self, motion: Motion, k: int, effort: np.ndarray) -> None:
        """Add the k-th coefficient to the forces on q."""
        if self.in_body:
            now = product(self.scale, np.array([motion.vector(self.body, self.vector, j) for j in range(k + 1)]), k)
        else:
            now = self.scale[k] * self.vector
        if not self.turns:
            _push(effort, self.body, self.point, now)
        elif self.in_body:
            torque = np.array([product(self.scale, np.array([motion.vector(self.body, self.vector, i)
                                                             for i in range(j + 1)]), j) for j in range(k + 1)])
            effort[self.body, 1:] += 0.5 * crossed(torque, motion.q[:, self.body, 1:], k)
        else:
            torque = self.scale[:k + 1, None] * self.vector
            effort[self.body, 1:] += 0.5 * crossed(torque, motion.q[:, self.body, 1:], k)


class JointLoad:
    """A torque about a joint's axis on its child, or a force along it; the opposite on its parent.

    That of a spring and damper is -(k (a . d - rest) + c (a . d)'), with a the axis and d from anchor to anchor.
    """

    def __init__(self, force: Force, scene: Scene) -> None:
        self.joint = next(joint for joint in scene.joints if joint.name == force.joint)
        self.turns, p = force.type == "joint_torque", force.parameters
        self.k, self.c = LONG(p.get("stiffness", 0.0)), LONG(p.get("damping", 0.0))
        self.springs = force.is_spring
        self.size: Value = p["torque" if self.turns else "force"] if not self.springs else float(
            self.k * p["rest_position"])
        self.axis = self.joint.parent_axis.astype(LONG)

    def begin(self, order: int, t: np.longdouble) -> None:
        """Expand the force about the time t of a new step."""
        self.scale = series_of(self.size, t, order + 1)
        self.along, self.d = np.zeros((2, order + 2, 3), LONG)
        self.effort = np.zeros((order + 1, 3), LONG)

    def _pull(self, motion: Motion, k: int) -> None:
        """Add the k-th coefficient of spring and damper to the size."""
        joint = self.joint
        for j in ((0, 1) if k == 0 else (k + 1,)):
            self.along[j] = motion.vector(joint.parent, self.axis, j)
            self.d[j] = motion.point(joint.child, joint.child_anchor.astype(LONG), j) - motion.point(
                joint.parent, joint.parent_anchor.astype(LONG), j)
        slide, speed = (sum(product(self.along[:, i], self.d[:, i], j) for i in range(3)) for j in (k, k + 1))
        self.scale[k] -= self.k * slide + self.c * (k + 1) * speed

    def add(self, motion: Motion, k: int, effort: np.ndarray) -> None:
        """Add the k-th coefficient to the forces on q."""
        joint = self.joint
        self.along[k] = motion.vector(joint.parent, self.axis, k)
        if self.springs:
            self._pull(motion, k)
        self.effort[k] = product(self.scale, self.along, k)
        for body, anchor, sign in ((joint.child, joint.child_anchor, 1), (joint.parent, joint.parent_anchor, -1)):
            if self.turns:
                effort[body, 1:] += 0.5 * sign * crossed(self.effort, motion.q[:, body, 1:], k)
            else:
                _push(effort, body, anchor.astype(LONG), sign * self.effort[k])


def series_of(value: Value, t: np.longdouble, count: int) -> np.ndarray:
    """Taylor coefficients about t of a number or a function of time, (count,), in extended precision.

    Those of a sine are a w^k sin(w t + phase + k pi/2) / k!; those of a polynomial follow by Horner's rule.
    """
    coefficients = np.zeros(count, LONG)
    if not isinstance(value, TimeFunction):
        coefficients[0] = value
        return coefficients
    piece = max(int(np.searchsorted(np.array(value.breaks, LONG), t, side="right")) - 1, 0)
    moved = np.array(value.pieces[piece], LONG)
    shift = t - LONG(value.breaks[piece])
    for first in range(len(moved)):
        for k in range(len(moved) - 2, first - 1, -1):
            moved[k] += shift * moved[k + 1]
    coefficients[:min(count, len(moved))] = moved[:count]
    for amplitude, frequency, phase in value.terms:
        angle = LONG(frequency) * t + LONG(phase)
        turns = (np.sin(angle), np.cos(angle), -np.sin(angle), -np.cos(angle))
        factor = LONG(amplitude)
        for k in range(count):
            coefficients[k] += factor * turns[k % 4]
            factor *= LONG(frequency) / (k + 1)
    return coefficients


class TorsionalSpring:
    """Torque -(k (angle - rest) + c angle') about a joint's axis on its child, the opposite on the parent.

    With p across the axis and g = axis x p in the parent, and b in the child along p at the start, the angle from the
    start has the cosine C = p . b and the sine S = g . b, hence the rate C S' - S C'.
    """

    def __init__(self, force: Force, scene: Scene) -> None:
        values = force.parameters
        joint = next(joint for joint in scene.joints if joint.name == force.joint)
        self.joint, self.parent, self.child = joint.name, joint.parent, joint.child
        self.k, self.c = LONG(values["stiffness"]), LONG(values["damping"])
        self.rest_angle: Value = values["rest_angle"]
        self.axis = joint.parent_axis.astype(LONG)
        frames = [np.eye(3) if body == GROUND else scene.R0[body] for body in (joint.parent, joint.child)]
        p = np.cross(joint.parent_axis, np.eye(3)[np.argmin(np.abs(joint.parent_axis))])
        p /= np.linalg.norm(p)
        self.p, self.g = p.astype(LONG), np.cross(joint.parent_axis, p).astype(LONG)
        self.b = (frames[1].T @ frames[0] @ p).astype(LONG)
        self.start = _angle(frames[0].T @ frames[1], joint.parent_axis, joint.child_axis)
        if joint.start is not None:
            turns = np.round((joint.start[0] + joint.zero_angle - float(self.start)) / (2 * np.pi))
            self.start += 2 * LONG(turns) * np.arctan2(LONG(0.0), LONG(-1.0))

    def begin(self, order: int, t: np.longdouble) -> None:
        """Expand the rest angle about the time t of a new step."""
        self.rest = series_of(self.rest_angle, t, order + 1)
        self.cosine, self.sine, self.rate, self.torque = np.zeros((4, order + 2), LONG)
        self.p_now, self.g_now, self.b_now, self.along, self.twist = np.zeros((5, order + 2, 3), LONG)
        self.known = 0

    def _extend(self, motion: Motion, k: int) -> None:
        """Cosine and sine up to order k."""
        for j in range(self.known, k + 1):
            self.p_now[j], self.g_now[j] = (motion.vector(self.parent, own, j) for own in (self.p, self.g))
            self.b_now[j] = motion.vector(self.child, self.b, j)
            self.cosine[j] = sum(product(self.p_now[:, i], self.b_now[:, i], j) for i in range(3))
            self.sine[j] = sum(product(self.g_now[:, i], self.b_now[:, i], j) for i in range(3))
        self.known = max(self.known, k + 1)

    def add(self, motion: Motion, index: int, k: int, effort: np.ndarray) -> None:
        """Add the k-th coefficient to the forces on q, and compute the next one of the angle."""
        self._extend(motion, k + 1)
        orders = np.arange(1, k + 2)
        cosine_rate, sine_rate = orders * self.cosine[1:k + 2], orders * self.sine[1:k + 2]
        self.rate[k] = product(self.cosine, sine_rate, k) - product(self.sine, cosine_rate, k)
        motion.angles[k + 1, index] = self.rate[k] / (k + 1)
        self.torque[k] = -(self.k * (motion.angles[k, index] - self.rest[k]) + self.c * self.rate[k])
        self.along[k] = motion.vector(self.parent, self.axis, k)
        self.twist[k] = product(self.torque, self.along, k)
        for body, sign in ((self.child, 0.5), (self.parent, -0.5)):
            effort[body, 1:] += sign * crossed(self.twist, motion.q[:, body, 1:], k)


def _angle(relative: np.ndarray, parent_axis: np.ndarray, child_axis: np.ndarray) -> np.longdouble:
    """theta of relative = exp(theta hat(parent axis)) Q0, with Q0 the shortest turn from child to parent axis."""
    cosine = 1.0 + float(child_axis @ parent_axis)
    if cosine < OPPOSITE:
        raise Unsupported("natural coordinates: a torsional spring about axes that are opposite at angle zero")
    across = np.cross(child_axis, parent_axis)
    hat = np.array([[0, -across[2], across[1]], [across[2], 0, -across[0]], [-across[1], across[0], 0]])
    turn = relative @ (np.eye(3) + hat + hat @ hat / cosine).T
    skew = 0.5 * np.array([turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]])
    return LONG(np.arctan2(skew @ parent_axis, 0.5 * (np.trace(turn) - 1.0)))
