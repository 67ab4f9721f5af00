"""Third formulation of the truth: natural coordinates, Taylor series in extended precision.

A body is its centre of mass and the three columns of its attitude, q = (x, r1, r2, r3) in R^12 (J. Garcia de Jalon,
E. Bayo, Kinematic and Dynamic Simulation of Multibody Systems, Springer 1994, chapter 2). The mass matrix is constant,
diag(m, E) x I3 with E = tr(J) / 2 - J; no angular velocity and no gyroscopic term occur: six rows keep the columns
orthonormal. All rows of all joints are quadratic in q, with constant second derivatives A and G(q) = A q + B, so that

    M q'' + G^T lam = f,    G q'' = -q'^T A q'

gives the coefficients of the series order by order with one matrix, that at the start of the step. It is inverted in
double precision, and every solution is refined in `numpy.longdouble` (64 bits of mantissa on x86, other sizes
elsewhere).

A row of a joint is z^T A z / 2 + B z + c of the coordinates z = (q_i, q_j) of two bodies, q = (x, r1, r2, r3).
"""

from __future__ import annotations

import dataclasses
import itertools
import math
from collections.abc import Callable, Iterator, Sequence

import numpy as np

from crosscheck.errors import Unsupported
from crosscheck.references.base import LONGEST, ORDERS, End, Piece, TruthError
from crosscheck.references.natural_loads import LONG, OPPOSITE, JointLoad, LinearSpring, Load, Motion, TorsionalSpring
from crosscheck.scene.model import GROUND, Force, Joint, Scene
from crosscheck.scene.states import States

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
        own: np.ndarray = q.reshape(self.n + 1, 12)[self.bodies]
        return own

    def curved(self, q: np.ndarray) -> np.ndarray:
        """A z, (m, 2, 12)."""
        half: np.ndarray = np.matmul(self.A, self.local(q).reshape(-1, 24, 1)).reshape(-1, 2, 12)
        return half

    def gradient(self, q: np.ndarray) -> np.ndarray:
        """A z + B, (m, 2, 12)."""
        slope: np.ndarray = self.curved(q) + self.B.reshape(-1, 2, 12)
        return slope

    def values(self, q: np.ndarray) -> np.ndarray:
        """Phi, (m)."""
        z = self.local(q)
        phi: np.ndarray = np.einsum("mic,mic->m", 0.5 * self.curved(q) + self.B.reshape(-1, 2, 12), z) + self.c
        return phi

    def rates(self, q: np.ndarray, rate: np.ndarray) -> np.ndarray:
        """dPhi/dt, (m)."""
        phi_dot: np.ndarray = np.einsum("mic,mic->m", self.gradient(q), self.local(rate))
        return phi_dot

    def along(self, G: np.ndarray, a: np.ndarray) -> np.ndarray:
        """G a, (m), of a (n, 4, 3)."""
        product: np.ndarray = np.einsum("mic,mic->m", G, self.local(np.concatenate([a, np.zeros((1, 4, 3), LONG)])))
        return product

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
        symmetric: np.ndarray = one.T @ other + other.T @ one
        return symmetric

    def perpendicular(p: np.ndarray, b: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
        return product(_in_parent(p), np.concatenate([np.zeros((3, 12)), _vector(b)], axis=1)), np.zeros(24), 0.0

    def across(p: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
        return product(_in_parent(p), gap), np.zeros(24), 0.0

    if joint.type == "distance":
        return [(gap.T @ gap / joint.length, np.zeros(24), -0.5 * joint.length)]
    rows = [(nothing, gap[k], 0.0) for k in range(3)] if joint.type in COINCIDING else []
    if joint.type == "universal":
        return [*rows, perpendicular(joint.parent_axis, joint.child_axis)]
    if joint.type == "fixed":
        return rows + [perpendicular(np.eye(3)[k], relative[:, k - 2]) for k in range(3)]
    if joint.type == "spherical":
        return rows
    e = joint.parent_axis
    one = np.cross(e, np.eye(3)[np.argmin(np.abs(e))])
    one /= np.linalg.norm(one)
    other = np.cross(e, one)
    if joint.type in ("planar", "point_on_plane"):
        rows.append(across(e))
    elif joint.type != "revolute":
        rows += [across(one), across(other)]
    if joint.type in TURNING_ABOUT:
        rows += [perpendicular(one, joint.child_axis), perpendicular(other, joint.child_axis)]
    if joint.type == "prismatic":
        rows.append(perpendicular(one, relative @ other))
    return rows


def _in_parent(own: np.ndarray) -> np.ndarray:
    """(3, 24): a vector fixed in the parent."""
    return np.concatenate([_vector(own), np.zeros((3, 12))], axis=1)


SOURCE = "Taylor series in extended precision, natural coordinates"
ORDER = 28
WINDOW = 8  # number of last coefficients that determine the step; symmetry may make several in a row zero
REMAINDER = 1e-21  # error of a step relative to the state
SOFTENING = 1e-10  # added to the multipliers' block so that dependent rows can be solved; refinement removes its effect
SUBPOINTS = 4  # of a step at which derivatives are evaluated
REFINEMENTS, SURE = 8, 3  # most and fewest; for a zero solution the second correction is as large as the first
BLOCK = 500  # largest size of a step's matrix; with it a step takes less than a second
MOST_STEPS = 5000
OPEN = 1e-13  # largest value of a row; joints drift less as long as the matrix of a step is regular


class Natural:
    """The equations of a scene; `run` integrates them.

    Raises
    ------
    Unsupported
        The scene is too large for a dense matrix per step, or has an element that is not modelled here.
    """

    source = SOURCE

    def __init__(self, scene: Scene) -> None:
        if reason := scene.beyond(("joint_torque", "function")):
            raise Unsupported(f"{SOURCE}: {reason}")
        self.scene, self.n = scene, scene.n
        self.rows: Rows = rows_of(scene)
        size = 12 * self.n + self.rows.count
        if size > BLOCK:
            raise Unsupported(f"{SOURCE}: {scene.n} bodies and {len(scene.joints)} joints are too many")
        self.scale = float(scene.masses.mean())
        self.mass = np.zeros((self.n, 4, 4))
        for body, J in enumerate(scene.inertias):
            self.mass[body, 0, 0] = scene.masses[body] / self.scale
            self.mass[body, 1:, 1:] = (0.5 * np.trace(J) * np.eye(3) - J) / self.scale
        self.mass_long = self.mass.astype(LONG)
        self.torsions = [TorsionalSpring(force, scene) for force in scene.loads if force.type == "torsional_spring"]
        self.hinges = self._watched()
        self.springs = [LinearSpring(force) for force in scene.forces if force.type == "linear_spring"]
        self.loads: list[Load | JointLoad] = [Load(force) for force in scene.forces
                                              if force.type.startswith("constant")]
        self.loads += [JointLoad(force, scene) for force in scene.loads
                       if force.type in ("joint_torque", "joint_force", "slide_spring")]
        self.weight = np.zeros((self.n + 1, 4, 3), LONG)
        self.weight[:-1, 0] = scene.masses[:, None].astype(LONG) * scene.gravity

    def _watched(self) -> list[tuple[int, float] | None]:
        """Of every angle of `scene.hinges` the spring that counts it, which may have no stiffness, and its zero."""
        joints, places = {joint.name: joint for joint in self.scene.joints}, list[tuple[int, float] | None]()
        for name, _ in self.scene.hinges:
            joint = joints[name]
            if joint.type not in ("revolute", "cylindrical") or joint.child_axis @ joint.parent_axis < OPPOSITE - 1.0:
                places.append(None)  # nothing counts it here
                continue
            place = next((k for k, spring in enumerate(self.torsions) if spring.joint == name), len(self.torsions))
            if place == len(self.torsions):
                still = {"stiffness": 0.0, "rest_angle": 0.0, "damping": 0.0}
                self.torsions.append(TorsionalSpring(Force("torsional_spring", None, None, name, still), self.scene))
            places.append((place, joint.zero_angle))
        return places

    def _states(self, t: np.ndarray, angles: np.ndarray, *derivatives: np.ndarray) -> States:
        """States from angles of torsional springs (T, .) and q, q', q'' (T, n + 1, 4, 3), the ground last."""
        states = _states(t, *derivatives)
        columns = [np.full(len(t), np.nan) if place is None else angles[:, place[0]].astype(float) - place[1]
                   for place in self.hinges]
        states.hinges = np.array(columns).reshape(-1, len(t)).T
        return states

    def run(self, times: np.ndarray | None = None, start: tuple[np.ndarray, np.ndarray] | None = None) -> States:
        """States at `times`, by default the scene's output times, from the scene's start or from `start` = (q, q')."""
        times = self.scene.t if times is None else times
        q, rate = self._start() if start is None else start
        angles = np.array([spring.start for spring in self.torsions], LONG)
        entries, waiting = list[tuple[np.ndarray, ...]](), list(times)
        for now, h, motion in self._steps(q, rate, angles, LONG(0.0)):
            while waiting and (waiting[0] <= now + h or waiting[0] <= now):
                entries.append(motion.at(LONG(waiting.pop(0)) - now))
            if not waiting:
                break
        return self._states(times, *(np.array([entry[k] for entry in entries]) for k in (3, 0, 1, 2)))

    def _steps(self, q: np.ndarray, rate: np.ndarray, angles: np.ndarray, now: np.longdouble
               ) -> Iterator[tuple[np.longdouble, np.longdouble, Motion]]:
        """Start, length and series of one step after the other, without end."""
        stops = self.scene.knots
        for count in itertools.count():
            if count > MOST_STEPS or not np.abs(self.rows.values(q)).max(initial=0.0) <= OPEN:
                raise TruthError(f"{SOURCE}: {self.scene.name!r} at t = {float(now):.6g} s: no step leads on")
            motion = self._series(q, rate, angles, now)
            h = LONG(float(min([self._step(motion), LONG(LONGEST), *(t - now for t in stops if t > now)])))
            yield now, h, motion
            q, rate, _, angles = motion.at(h)
            now = now + h

    @property
    def begin(self) -> End:
        """The start of the scene: q, q' and the angles of torsional springs."""
        q, rate = self._start()
        return End(np.concatenate([q.ravel(), rate.ravel(), [spring.start for spring in self.torsions]]))

    def advance(self, end: End, until: float) -> tuple[list[Piece], End]:
        """The pieces from an end to `until` or beyond, which they do not depend on, and their end."""
        size, pieces = 12 * (self.n + 1), list[Piece]()
        q, rate = end.state[:2 * size].reshape(2, -1, 4, 3)
        now, state = LONG(end.time) + LONG(end.rest), end.state
        for begin, h, motion in self._steps(q, rate, end.state[2 * size:], now):
            if begin >= until:
                break
            coefficients = np.concatenate([motion.q.reshape(ORDER + 1, -1), motion.angles], axis=1).T
            pieces.append(Piece(float(begin), float(begin - LONG(float(begin))), float(h), coefficients))
            q, rate, _, angles = motion.at(h)
            now, state = begin + h, np.concatenate([q.ravel(), rate.ravel(), angles])
        return pieces, End(state, float(now), float(now - LONG(float(now))))

    def dense_states(self, t: np.ndarray, values: Callable[[int], np.ndarray], modes: np.ndarray | None = None
                     ) -> States:
        """States at times t from the values of the pieces; `values(k)` are those of the k-th derivative."""
        size = 12 * (self.n + 1)
        return self._states(t, values(0)[:, size:], *(values(k)[:, :size].reshape(len(t), -1, 4, 3) for k in range(3)))

    def derivative_maxima(self, pieces: Sequence[Piece]) -> np.ndarray:
        """Largest |d^k x/dt^k| and |d^k R/dt^k|_F over each piece and the bodies, (pieces, 2, ORDERS + 1)."""
        largest = np.zeros((len(pieces), 2, ORDERS + 1))
        for piece, sizes in zip(pieces, largest, strict=True):
            series = piece.coefficients[:12 * (self.n + 1)].T.astype(float).reshape(ORDER + 1, -1, 4, 3)[:, :-1]
            for tau in np.arange(SUBPOINTS) * piece.length / SUBPOINTS:
                for k in range(ORDERS + 1):
                    weights = np.array([math.perm(j, k) * tau ** (j - k) for j in range(k, ORDER + 1)])
                    derivative = np.tensordot(weights, series[k:], 1)
                    sizes[0, k] = max(sizes[0, k], np.linalg.norm(derivative[:, 0], axis=-1).max())
                    sizes[1, k] = max(sizes[1, k], np.linalg.norm(derivative[:, 1:], axis=(-2, -1)).max())
        return largest

    def _start(self) -> tuple[np.ndarray, np.ndarray]:
        """q and q' (n + 1, 4, 3) of the scene's start, on the constraints to extended precision."""
        scene, n = self.scene, self.n
        q, rate = np.zeros((2, n + 1, 4, 3), LONG)
        q[n, 1:] = np.eye(3)
        for body, record in enumerate(scene.bodies):
            R = _attitude(record.attitude.astype(LONG))
            w = record.angular_velocity.astype(LONG)
            q[body, 0], q[body, 1:] = record.position, R.T
            rate[body, 0], rate[body, 1:] = record.velocity, (R @ _hat(w)).T
        return self._closed(q, rate)

    def perturbed_start(self, x: np.ndarray, turn: np.ndarray, v: np.ndarray, w: np.ndarray
                     ) -> tuple[np.ndarray, np.ndarray]:
        """The start moved by x (m), turn (rad), v (m/s), w (rad/s), (n, 3) each, then back onto the constraints."""
        q, rate = (values.copy() for values in self._start())
        for body in range(self.n):
            R = q[body, 1:].T @ (np.eye(3) + _hat(turn[body].astype(LONG)))
            spin = q[body, 1:] @ rate[body, 1:].T + _hat(w[body].astype(LONG))
            q[body, 0] += x[body]
            q[body, 1:], rate[body, 1:] = R.T, (R @ spin).T
            rate[body, 0] += v[body]
        return self._closed(q, rate)

    def _closed(self, q: np.ndarray, rate: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """q and q' moved onto the constraints, to extended precision."""
        for _ in range(3):
            q[:self.n] += self._correction(q, -self.rows.values(q))
        for _ in range(2):
            rate[:self.n] += self._correction(q, -self.rows.rates(q, rate))
        return q, rate

    def _correction(self, q: np.ndarray, defect: np.ndarray) -> np.ndarray:
        """The least change of q, in the metric of M, that changes the rows by `defect`."""
        G = self.rows.gradient(q)
        inverse = self._inverse(G)
        return self._solve(inverse, G, np.zeros((self.n, 4, 3), LONG), defect)[0]

    def _inverse(self, G: np.ndarray) -> np.ndarray:
        """Inverse of [[M, G^T], [G, -softening]] in double precision; G (m, 2, 12)."""
        size, m = 12 * self.n, self.rows.count
        K = np.zeros((size + m, size + m))
        for body in range(self.n):
            K[12 * body:12 * body + 12, 12 * body:12 * body + 12] = np.kron(self.mass[body], np.eye(3))
        K[size:, :size] = self.rows.dense(G.astype(float))
        K[:size, size:] = K[size:, :size].T
        K[range(size, size + m), range(size, size + m)] = -SOFTENING
        inverse: np.ndarray = np.linalg.inv(K)
        return inverse

    def _solve(self, inverse: np.ndarray, G: np.ndarray, effort: np.ndarray,
               target: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """a (n, 4, 3) and lam (m) of M a + G^T lam = effort, G a = target."""
        n, size = self.n, 12 * self.n
        a, lam = np.zeros((n, 4, 3), LONG), np.zeros(len(target), LONG)
        last = np.inf
        for k in range(REFINEMENTS):
            left = effort - np.matmul(self.mass_long, a) - self.rows.pull(G, lam)[:n]
            off = target - self.rows.along(G, a)
            step = inverse @ np.concatenate([left.ravel(), off]).astype(float)
            change = float(np.abs(step[:size]).max())
            if k >= SURE and not change < 0.5 * last:
                break
            a, lam, last = a + step[:size].reshape(n, 4, 3), lam + step[size:], change
        return a, lam

    def _series(self, q: np.ndarray, rate: np.ndarray, angles: np.ndarray, t: np.longdouble) -> Motion:
        """Taylor coefficients of the motion from a state at time t."""
        motion = Motion(q, rate, angles, ORDER)
        rows, n = self.rows, self.n
        G = np.zeros((ORDER + 1, rows.count, 2, 12), LONG)
        bend, local_rate, local_a = (np.zeros((ORDER + 1, rows.count, 2, 12), LONG) for _ in range(3))
        lam = np.zeros((ORDER + 1, rows.count), LONG)
        G[0] = rows.gradient(q)
        inverse = self._inverse(G[0])
        for force in (*self.springs, *self.torsions, *self.loads):
            force.begin(ORDER, t)
        for k in range(ORDER - 1):
            if k:
                G[k] = rows.curved(motion.q[k])
            local_rate[k] = rows.local((k + 1) * motion.q[k + 1])
            bend[k] = rows.curved((k + 1) * motion.q[k + 1])
            effort = self._effort(motion, k)[:n] / self.scale
            target = -np.einsum("jmic,jmic->m", bend[:k + 1], local_rate[k::-1])
            if k:
                effort = effort - rows.scattered(np.einsum("jmic,jm->mic", G[1:k + 1], lam[k - 1::-1]))[:n]
                target = target - np.einsum("jmic,jmic->m", G[1:k + 1], local_a[k - 1::-1])
            a, lam[k] = self._solve(inverse, G[0], effort, target)
            motion.q[k + 2, :n] = a / LONG((k + 1) * (k + 2))
            local_a[k] = rows.local(np.concatenate([a, np.zeros((1, 4, 3), LONG)]))
        return motion

    def _effort(self, motion: Motion, k: int) -> np.ndarray:
        """k-th coefficient of the applied forces on q, (n + 1, 4, 3)."""
        effort = self.weight.copy() if k == 0 else np.zeros_like(self.weight)
        for spring in self.springs:
            spring.add(motion, k, effort)
        for load in self.loads:
            load.add(motion, k, effort)
        for index, torsion in enumerate(self.torsions):
            torsion.add(motion, index, k, effort)
        return effort

    def _step(self, motion: Motion) -> np.longdouble:
        """The step from the decay of the coefficients (A. Jorba, M. Zou, Experimental Mathematics 14, 2005)."""
        sizes = np.abs(motion.q).max(axis=(1, 2, 3))
        reference = max(1.0, float(sizes[0]))
        orders = [k for k in range(ORDER - WINDOW + 1, ORDER + 1) if sizes[k] > 0]
        radii = [float(sizes[k] / reference) ** (-1.0 / k) for k in orders]
        return LONG(min(radii, default=1e6) * REMAINDER ** (1.0 / ORDER))


def _attitude(quaternion: np.ndarray) -> np.ndarray:
    """R of a quaternion w, x, y, z of any length."""
    w, v = quaternion[0], quaternion[1:]
    square = w * w + v @ v
    R: np.ndarray = ((w * w - v @ v) * np.eye(3, dtype=LONG) + 2 * np.outer(v, v) + 2 * w * _hat(v)) / square
    return R


def _hat(w: np.ndarray) -> np.ndarray:
    zero = w[0] * 0
    return np.array([[zero, -w[2], w[1]], [w[2], zero, -w[0]], [-w[1], w[0], zero]])


def _vee(matrices: np.ndarray) -> np.ndarray:
    """Vectors of the skew parts, (..., 3)."""
    return 0.5 * np.stack([matrices[..., 2, 1] - matrices[..., 1, 2], matrices[..., 0, 2] - matrices[..., 2, 0],
                           matrices[..., 1, 0] - matrices[..., 0, 1]], axis=-1)


def _states(times: np.ndarray, *derivatives: np.ndarray) -> States:
    """States from q, q', q'' (T, n + 1, 4, 3), the ground last."""
    q, rate, second = (each[:, :-1] for each in derivatives)
    R, turning, bending = (np.swapaxes(part[:, :, 1:], -1, -2) for part in (q, rate, second))
    back = np.swapaxes(R, -1, -2)
    w = _vee(np.matmul(back, turning))
    alpha = _vee(np.matmul(back, bending))  # R^T R'' = alpha^ + w^ w^, and w^ w^ is symmetric
    parts = (q[:, :, 0], R, rate[:, :, 0], w, second[:, :, 0], alpha)
    return States(times, *(part.astype(float) for part in parts))
