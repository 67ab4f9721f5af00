"""Second formulation of the truth: maximal coordinates, DOP853 (SciPy), or Radau IIA if dampers are stiff.

Newton-Euler equations of every body, M du = f - G^T lam with u = (v, w), v in world and w in body axes, so that M is
constant. lam follows from the constraints at acceleration level (index 1), with Baumgarte damping towards the position
and velocity levels. On the constraint manifold the damping has no effect, so a wrong row still shows, by its error over
DAMPING^2. With dependent rows, the accelerations are the least-norm correction of the free ones in the metric of M,
with the rank found once at the start. Attitudes are quaternions; the angle of a torsional spring is a state. The ground
is one more body at the end of every array, without columns in the Jacobian.

Rotor inertia of a joint takes its rate as a row, with the drift in its derivative. The rate of a hinge is the
difference of the two angular velocities along its axis, which is fixed in both bodies. A slide s along e has d2s/dt2 =
e . d" + s (|w|^2 - (e . w)^2), with d" the acceleration of the child's anchor minus that of the parent's, and w the
angular velocity of the parent; the child's differs from it only along e.
"""

from __future__ import annotations

import dataclasses
import itertools
import math
from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np

from crosscheck.references.base import End, TruthError
from crosscheck.references.world import Motion, cross, rotation, turned
from crosscheck.references.world_loads import ConstantLoad, JointLoad, LinearSpring, SlideSpring, TorsionalSpring
from crosscheck.references.world_rows import Coupled, Driven, Relations, kinds
from crosscheck.scene.model import Joint, Scene
from crosscheck.scene.states import States

if TYPE_CHECKING:
    from scipy.integrate import OdeSolver

DECAY = 1000.0
"""The implicit method is used if the rate of the fastest decay (1/s) exceeds this: the stability of an explicit method
would require ten thousand evaluations a second or more."""

IMPLICIT_RTOL = 1e-12
"""Tolerance of the implicit method: a tenth of it gives the same error with twice the evaluations."""

QUIET = 100.0
"""Highest rate (1/s) at which rounding stays within the tightest tolerance. The rounding error of a position causes an
acceleration, larger by the square of the rate, and changes the velocity of one step by the rate times that error. With
a tolerance below that, noise would make the steps ever shorter."""

DIFFERENCE = 1e-6
"""Step of the central differences of the rates, relative to entries of order one."""


def eigenvalues(rates: Callable[[float, np.ndarray], np.ndarray], start: np.ndarray) -> np.ndarray:
    """Eigenvalues (1/s) of the derivative of dy/dt = rates(t, y) with respect to y at `start`."""
    columns = [rates(0.0, start + step) - rates(0.0, start - step) for step in DIFFERENCE * np.eye(len(start))]
    return np.linalg.eigvals(np.array(columns).T / (2 * DIFFERENCE))


def integrator_for(values: np.ndarray, tightest: float) -> tuple[type[OdeSolver], float]:
    """Integrator and relative tolerance for equations with these eigenvalues (1/s), whatever the duration.

    `tightest`: the relative tolerance if nothing is stiff.
    """
    from scipy.integrate import DOP853, Radau  # takes a third of the start of every command

    if -values.real.min() > DECAY:
        return Radau, IMPLICIT_RTOL
    return DOP853, tightest * max(1.0, float(np.abs(values).max()) / QUIET)


TURNS = {"revolute": (True,), "prismatic": (False,), "cylindrical": (True, False)}


@dataclasses.dataclass(frozen=True)
class Rotor:
    """One coordinate of a joint with rotor inertia, kg m^2 or kg."""

    joint: Joint
    inertia: float
    turns: bool

    def row(self, motion: Motion) -> tuple[np.ndarray, float]:
        """(row (n + 1, 6), drift) with d(rate)/dt = row . du/dt + drift; v in world, w in body axes."""
        joint, x, R = self.joint, motion.x, motion.R
        row = np.zeros((len(x), 6))
        if self.turns:
            row[joint.child, 3:] += joint.child_axis
            row[joint.parent, 3:] -= joint.parent_axis
            return row, 0.0
        e = R[joint.parent] @ joint.parent_axis
        ends = []
        for body, anchor, sign in ((joint.child, joint.child_anchor, 1.0), (joint.parent, joint.parent_anchor, -1.0)):
            row[body, :3] += sign * e
            row[body, 3:] += sign * np.cross(anchor, R[body].T @ e)
            centripetal = R[body] @ np.cross(motion.w[body], np.cross(motion.w[body], anchor))
            ends.append((x[body] + R[body] @ anchor, centripetal))
        spin = R[joint.parent] @ motion.w[joint.parent]
        slide = float(e @ (ends[0][0] - ends[1][0]))
        turning = float(spin @ spin - (e @ spin) ** 2)
        return row, float(e @ (ends[0][1] - ends[1][1])) + slide * turning


def rotors(scene: Scene) -> list[Rotor]:
    """All coordinates of a scene with rotor inertia."""
    return [Rotor(joint, value, turns) for joint in scene.joints
            for value, turns in zip(joint.armature, TURNS.get(joint.type, ()), strict=False) if value]


RTOL = 3e-15  # a thousand such steps stay near 1e-12; looser ones take 15 % less time and have several times the error
# Loops with dependent rows pass flat positions fast and dead points slowly: an energy error made in the former grows in
# the latter, by more than any perturbation of the start does.
RTOL_DEPENDENT = 1e-15
ATOL = 1e-15  # components that pass through zero are O(1) elsewhere
DAMPING = 5.0  # Baumgarte, 1/s: far slower than a step, far faster than the growth of drift from rounding
GRADED = 1e3
"""Ratio of the largest mass to the smallest beyond which accelerations and multipliers are solved for together:
G M^-1 G^T adds terms of light and heavy bodies and loses as many digits as this ratio has. With three digits lost, the
error of a step of 1e-2 is still below one rounding of its result."""
DEPENDENT = 1e-9  # singular values below this part of the largest belong to dependent rows


def gyroscopic(inertia: np.ndarray, w: np.ndarray) -> np.ndarray:
    """w x J w, body axes; inertia (n, 3, 3).

    Computed as w x (J - s) w, with s the middle entry on the diagonal: equal moments would cancel with a rounding error
    that spins up a needle.
    """
    middle = np.sort(np.diagonal(inertia, axis1=1, axis2=2), axis=1)[:, 1]
    return cross(w, turned(inertia - middle[:, None, None] * np.eye(3), w))


def weight(masses: np.ndarray, gravity: np.ndarray) -> np.ndarray:
    """Weights (n, 3)."""
    weights: np.ndarray = masses[:, None] * gravity
    return weights


class Maximal:
    """The equations of a scene; `run` integrates them."""

    def __init__(self, scene: Scene) -> None:
        self.scene = scene
        self.constraints = kinds(scene)
        self.springs: list[LinearSpring | SlideSpring] = [
            LinearSpring(force) for force in scene.forces if force.type == "linear_spring"]
        self.springs += [SlideSpring(force, scene) for force in scene.loads if force.type == "slide_spring"]
        self.torsions = [TorsionalSpring(force, scene) for force in scene.loads if force.type == "torsional_spring"]
        self.loads: list[ConstantLoad | JointLoad] = [
            ConstantLoad(force) for force in scene.forces if force.type.startswith("constant")]
        self.loads += [JointLoad(force, scene) for force in scene.forces if force.type.startswith("joint_")]
        self.rotors = rotors(scene)
        self.before = np.inf  # the end of an interval is before what happens there: a function of time may jump
        self.inverse_inertia = np.linalg.inv(scene.inertias)
        self.root = np.linalg.cholesky(self.inverse_inertia)  # J^-1 = root root^T
        self.force = weight(scene.masses, scene.gravity)
        self.relations: Relations | None = None
        self.coupled: Coupled | None = None
        if any(joint.mimic is not None for joint in scene.joints):
            self._couple()
        self.rank: int | None = None  # of the rows where some depend on others; None is quicker
        if self.constraints:
            self._find_rank()
        self.graded = self._graded()
        stiff = eigenvalues(self.rates, self.initial()) if self.springs or self.torsions else np.zeros(1)
        self.integrator = integrator_for(stiff, RTOL if self.rank is None else RTOL_DEPENDENT)
        self.source = f"{self.integrator[0].__name__} (SciPy), maximal coordinates"

    def _couple(self) -> None:
        """Rows of mimics, from where the scene starts."""
        coupled = Coupled(self.scene)
        coupled.begun = coupled.values(self.motion(self.initial())[0])[0]
        self.coupled = coupled
        self.constraints.append(coupled)

    def _graded(self) -> np.ndarray | None:
        """Matrix of `_together`, with M over the largest mass, if masses differ too much for a faster solve."""
        masses, n = self.scene.masses, self.scene.n
        if not self.constraints or masses.max() <= GRADED * masses.min():
            return None
        size = 6 * n + len(self._constraint_terms(self.motion(self.initial())[0])[0])
        matrix = np.zeros((size, size))
        for body, inertia in enumerate(self.scene.inertias):
            at = slice(6 * body + 3, 6 * body + 6)
            matrix[range(6 * body, at.start), range(6 * body, at.start)] = masses[body] / masses.max()
            matrix[at, at] = inertia / masses.max()
        return matrix

    def _find_rank(self) -> None:
        """Find the number of independent rows at the start, and relations of hinges that hold in every position."""
        motion, _ = self.motion(self.initial())
        scaled = self._scaled(self._constraint_terms(motion)[0])
        _, singular, V = np.linalg.svd(scaled)
        rank = int(np.count_nonzero(singular > DEPENDENT * singular[0]))
        if rank == len(scaled):
            return
        self.rank = rank
        if rank < scaled.shape[1] and all(
                joint.type == "revolute" and joint.mimic is None for joint in self.scene.joints):
            self._relate_hinges(motion, V[rank:])

    def _relate_hinges(self, motion: Motion, free: np.ndarray) -> None:
        """Add relations between the rates of hinges that hold in every motion.

        If the rates of a mechanism's hinges keep fixed ratios, these relations keep their rank in positions where the
        other rows lose theirs. The ratios at the start are those of the free motions (rows, scaled as G is); they are
        fixed if the accelerations of each of these motions keep them too.
        """
        n, count = self.scene.n, len(self.scene.joints)
        rates = self._scaled(Relations(self.scene, np.eye(count)).jacobian(motion)[:, :-1]) @ free.T
        U, sigma, _ = np.linalg.svd(rates)
        kept = int(np.count_nonzero(sigma > DEPENDENT * sigma[0]))
        relations = Relations(self.scene, U[:, kept:].T)
        for direction in (*free, *(one + other for one, other in itertools.combinations(free, 2))):
            step = direction.reshape(n, 6)
            v, w = np.zeros((2, n + 1, 3))
            v[:n] = step[:, :3] / np.sqrt(self.scene.masses)[:, None]
            w[:n] = turned(self.root, step[:, 3:])
            moving = Motion(motion.x, motion.R, v, w, np.zeros(count))
            terms = [kind.terms(moving) for kind in (*self.constraints, relations)]
            G = self._scaled(np.concatenate([G[:, :-1] for _, G, _ in terms]))
            drift = np.concatenate([drift for _, _, drift in terms])
            left = drift - G @ (np.linalg.pinv(G, rcond=DEPENDENT) @ drift)
            if np.max(np.abs(left)) > DEPENDENT * np.max(np.abs(drift), initial=1.0):
                return
        self.constraints.append(relations)
        self.relations = relations

    def _scaled(self, G: np.ndarray) -> np.ndarray:
        """G M^-1/2, (m, 6 n)."""
        scaled = G / np.sqrt(self.scene.masses)[:, None]
        scaled[:, :, 3:] = np.matmul(G[:, :, 3:].transpose(1, 0, 2), self.root).transpose(1, 0, 2)
        flat: np.ndarray = scaled.reshape(len(G), -1)
        return flat

    def motion(self, y: np.ndarray, t: float = 0.0) -> tuple[Motion, np.ndarray]:
        """Unpack x (n, 3), q (n, 4), v (n, 3), w (n, 3), and angles of torsional springs and of hinges."""
        n = self.scene.n
        x, v, w = (np.zeros((n + 1, 3)) for _ in range(3))
        R = np.empty((n + 1, 3, 3))
        x[:n], v[:n], w[:n] = (y[k * n:(k + 3) * n].reshape(n, 3) for k in (0, 7, 10))
        q = y[3 * n:7 * n].reshape(n, 4)
        R[:n] = rotation(q)
        R[n] = np.eye(3)
        end = 13 * n + len(self.torsions)
        return Motion(x, R, v, w, y[end:], t), y[13 * n:end]

    def _applied(self, motion: Motion, angles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Applied forces (world) and torques about the centres of mass (body axes), (n, 3) each."""
        if not (self.springs or self.torsions or self.loads):
            return self.force, np.zeros_like(self.force)
        force, torque = np.zeros((2, self.scene.n + 1, 3))
        force[:-1] = self.force
        for between in self.springs:
            between.add(motion, force, torque)
        for load in self.loads:
            load.add(motion, force, torque)
        for spring, angle in zip(self.torsions, angles, strict=True):
            spring.add(motion, angle, torque)
        return force[:-1], torque[:-1]

    def accelerations(self, motion: Motion, angles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Accelerations of the centres of mass (world) and angular accelerations (body axes), (n, 3) each."""
        n = self.scene.n
        force, torque = self._applied(motion, angles)
        torque = torque - gyroscopic(self.scene.inertias, motion.w[:-1])
        free = np.empty((n, 6))
        free[:, :3] = force / self.scene.masses[:, None]
        free[:, 3:] = turned(self.inverse_inertia, torque)
        if not self.constraints:
            return free[:, :3], free[:, 3:]
        if self.rotors:
            return self._with_rotors(motion, np.concatenate([force, torque], axis=1).ravel())
        G, target = self._constraint_terms(motion)
        flat = G.reshape(len(G), -1)
        if self.rank is not None:
            return self._least_norm(free, self._scaled(G), flat @ free.ravel() + target)
        if self.graded is not None:
            return self._together(flat, np.concatenate([force, torque], axis=1).ravel(), target)
        W = np.empty_like(G)  # G M^-1, by the two blocks of M
        W[:, :, :3] = G[:, :, :3] / self.scene.masses[:, None]
        W[:, :, 3:] = np.matmul(G[:, :, 3:].transpose(1, 0, 2), self.inverse_inertia).transpose(1, 0, 2)
        W = W.reshape(len(G), -1)
        lam = np.linalg.solve(W @ flat.T, flat @ free.ravel() + target)
        free -= (W.T @ lam).reshape(n, 6)
        return free[:, :3], free[:, 3:]

    def _with_rotors(self, motion: Motion, effort: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The accelerations with the rotor inertia of joints in M, solved together with the multipliers."""
        G, target = self._constraint_terms(motion)
        size, rows = len(effort), G.reshape(len(G), -1)
        matrix = np.zeros((size + len(G), size + len(G)))
        for body, (mass, inertia) in enumerate(zip(self.scene.masses, self.scene.inertias, strict=True)):
            at = 6 * body
            matrix[at:at + 3, at:at + 3], matrix[at + 3:at + 6, at + 3:at + 6] = mass * np.eye(3), inertia
        for rotor in self.rotors:
            row, drift = rotor.row(motion)
            row = row[:-1].ravel()
            matrix[:size, :size] += rotor.inertia * np.outer(row, row)
            effort = effort - rotor.inertia * drift * row
        if self.rank is not None:  # y = L^T u with M = L L^T: the least change of y that meets the rows
            lower = np.linalg.cholesky(matrix[:size, :size])
            U, sigma, V = np.linalg.svd(np.linalg.solve(lower, rows.T), full_matrices=False)
            U, sigma, V = U[:, :self.rank], sigma[:self.rank], V[:self.rank]
            y = np.linalg.solve(lower, effort)
            y -= U @ (U.T @ y + V @ target / sigma)
            u = np.linalg.solve(lower.T, y).reshape(-1, 6)
            return u[:, :3], u[:, 3:]
        matrix[size:, :size] = rows
        matrix[:size, size:] = rows.T
        u = np.linalg.solve(matrix, np.concatenate([effort, -target]))[:size].reshape(-1, 6)
        return u[:, :3], u[:, 3:]

    def _together(self, G: np.ndarray, effort: np.ndarray, target: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Accelerations and multipliers solved together with pivoting.

        Both sides are divided by the largest mass: the pivots of light bodies then come from G.
        """
        assert self.graded is not None
        size = len(effort)
        self.graded[:size, size:], self.graded[size:, :size] = G.T, G
        heaviest = self.scene.masses.max()
        u = np.linalg.solve(self.graded, np.concatenate([effort / heaviest, -target]))[:size].reshape(-1, 6)
        return u[:, :3], u[:, 3:]

    def _least_norm(self, free: np.ndarray, scaled: np.ndarray,
                    defect: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The accelerations nearest to the free ones, in the metric of M, that remove the defect; with fixed rank."""
        U, sigma, V = np.linalg.svd(scaled, full_matrices=False)
        r = self.rank
        change = V[:r].T @ (U[:, :r].T @ defect / sigma[:r])
        change += V[:r].T @ (U[:, :r].T @ (defect - scaled @ change) / sigma[:r])  # removes its rounding error
        change = change.reshape(len(free), 6)
        a = free[:, :3] - change[:, :3] / np.sqrt(self.scene.masses)[:, None]
        return a, free[:, 3:] - turned(self.root, change[:, 3:])

    def _constraint_terms(self, motion: Motion) -> tuple[np.ndarray, np.ndarray]:
        """Jacobian (m, n, 6) and drift plus Baumgarte terms (m)."""
        u = np.concatenate([motion.v, motion.w], axis=1).ravel()
        jacobians, targets = [], []
        for kind in self.constraints:
            gap, G, drift = kind.terms(motion)
            jacobians.append(G[:, :-1])
            rate = G.reshape(len(G), -1) @ u
            if isinstance(kind, Driven):
                rate -= kind.speeds(motion.t)
            targets.append(drift + 2.0 * DAMPING * rate + DAMPING**2 * gap)
        return np.concatenate(jacobians), np.concatenate(targets)

    def rates(self, t: float, y: np.ndarray) -> np.ndarray:
        """dy/dt"""
        n = self.scene.n
        motion, angles = self.motion(y, min(t, self.before))
        a, alpha = self.accelerations(motion, angles)
        q, w = y[3 * n:7 * n].reshape(n, 4), motion.w[:-1]
        rate = np.empty((n, 4))  # dq/dt = q (0, w) / 2
        rate[:, 0] = -0.5 * np.sum(w * q[:, 1:], axis=1)
        rate[:, 1:] = 0.5 * (w * q[:, :1] - cross(w, q[:, 1:]))
        turning = [spring.rate(motion) for spring in self.torsions]
        if self.relations is not None:
            turning.extend(self.relations.rates(motion))
        if self.coupled is not None:
            turning.extend(self.coupled.rates(motion))
        return np.concatenate([y[7 * n:10 * n], rate.ravel(), a.ravel(), alpha.ravel(), turning])

    def initial(self) -> np.ndarray:
        """State vector of the scene's start."""
        bodies, scene = self.scene.bodies, self.scene
        q = np.array([body.attitude / np.linalg.norm(body.attitude) for body in bodies])
        angles = [spring.start for spring in self.torsions]
        if self.relations is not None:
            angles += [0.0] * len(scene.joints)
        if self.coupled is not None:
            angles += self.coupled.begun[:len(self.coupled.turns)].tolist()
        return np.concatenate([scene.x0.ravel(), q.ravel(), scene.v0.ravel(), scene.w0.ravel(), angles])

    @property
    def begin(self) -> End:
        """The start of the scene."""
        return End(self.initial())

    def run(self, times: np.ndarray | None = None) -> States:
        """States at `times`, by default the scene's output times, from the scene's start, which is the first of them.

        Steps end at these times, because dense output is less accurate than a step.
        """
        return self.advance(self.begin, self.scene.t if times is None else times)[0]

    def advance(self, end: End, times: np.ndarray) -> tuple[States, End]:
        """States at `times`, from an end that is at the first of them, and their end; its `rest` is a step to try."""
        y, rows, step = end.state, [], end.rest or None
        stops = np.union1d(times, [t for t in self.scene.knots if times[0] < t < times[-1]])
        for start, stop in itertools.pairwise(stops.tolist()):
            if start in times:
                rows.append(self._row(y, start))
            first = None if step is None else min(step, stop - start)
            kind, rtol = self.integrator
            self.before = math.nextafter(stop, 0.0)
            solver = kind(self.rates, start, y, stop, first_step=first, rtol=max(rtol, 1e-13), atol=ATOL)
            solver.rtol = rtol  # the constructor refuses so small a tolerance, but the error estimate resolves it
            proposals = []
            while solver.status == "running":
                message = solver.step()
                if solver.status == "failed":
                    raise TruthError(f"{self.source}: {self.scene.name!r} at t = {solver.t:.6g} s: {message}")
                proposals.append(solver.h_abs)
            y, step = solver.y, max(proposals)  # the last step was shortened to the end of the interval
        self.before = np.inf
        rows.append(self._row(y, times[-1]))
        states = States(times, *(np.array(column) for column in zip(*rows, strict=True)))
        return states, End(y, float(times[-1]), step or 0.0)

    def _row(self, y: np.ndarray, t: float) -> tuple[np.ndarray, ...]:
        """x, R, v, w, a, alpha at one instant, in the common convention."""
        motion, angles = self.motion(y, t)
        a, alpha = self.accelerations(motion, angles)
        return motion.x[:-1], motion.R[:-1], motion.v[:-1], motion.w[:-1], a, alpha


def fastest(scene: Scene) -> float:
    """Rate (1/s) of the fastest decay or oscillation of a scene with springs, at its start; 0 without springs."""
    if not any(force.type.endswith("spring") for force in scene.loads):
        return 0.0
    equations = Maximal(scene)
    return float(max(abs(eigenvalues(equations.rates, equations.initial()))))
