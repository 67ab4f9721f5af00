"""Force laws of joints in maximal coordinates: `Maximal` across events, with forces case by case.

The rate of a joint with laws is the row of its rotor inertia, J u. What holds it is a multiplier of this row, which
then is one of the constraints. Responses are those of M and of all rows of the joints. Angles are integrated.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from crosscheck.references.base import End, TruthError, rounding
from crosscheck.references.maximal import ATOL, DAMPING, DEPENDENT, Maximal, Rotor, gyroscopic
from crosscheck.references.modes import Law, Machine, Mode, Number, Part, laws_of
from crosscheck.references.pieces import Label, Values
from crosscheck.references.world import Motion, cross
from crosscheck.scene.coordinates import angle_from, zero_attitude
from crosscheck.scene.functions import at
from crosscheck.scene.model import Scene
from crosscheck.scene.states import States

if TYPE_CHECKING:
    from scipy.integrate import OdeSolver

INSIDE = (0.25, 0.5, 0.75, 1.0)
"""Places in a step at which surfaces are looked at: steps are so short that a surface is nearly a line there."""
SAME = 1e-13
"""Relative to a step: events nearer than this are one. They are located by steps of their own, to rounding."""
SHORT = 1e-13
"""Relative to the time: intervals in which nothing happens."""
TOUCHED = 1e-11
"""Values of a surface at its own event, relative to its size on the step before: they count as zero."""


class LawfulMaximal(Maximal):
    """`Maximal` for a scene with force laws. State vector: that of `Maximal`, then the angles of laws of hinges."""

    def __init__(self, scene: Scene) -> None:
        self.laws = laws_of(scene)
        self.rows = [Rotor(law.joint, 0.0, law.turns) for law in self.laws]
        self.mode: Mode = tuple(Part() for _ in self.laws)
        self.angles = np.zeros(0)
        self.turning = [i for i, law in enumerate(self.laws) if law.turns]
        super().__init__(scene)
        self.machine = Machine(self)

    def initial(self) -> np.ndarray:
        """State vector of the scene's start."""
        return np.concatenate([super().initial(), [self._start_of(self.laws[i]) for i in self.turning]])

    def _start_of(self, law: Law) -> float:
        joint = law.joint
        frames = [self.scene.R0[body] if body >= 0 else np.eye(3) for body in (joint.parent, joint.child)]
        angle = float(angle_from(zero_attitude(joint), joint.parent_axis, frames[0].T @ frames[1]))
        turns = 0.0 if joint.start is None else np.round((joint.start[0] - angle) / (2 * np.pi))
        return angle + 2 * np.pi * float(turns)

    def motion(self, y: np.ndarray, t: float = 0.0) -> tuple[Motion, np.ndarray]:
        """As `Maximal.motion`, without the angles of laws."""
        return super().motion(y[:len(y) - len(self.turning)], t)

    def rates(self, t: float, y: np.ndarray) -> np.ndarray:
        """dy/dt in the mode."""
        self.angles = y[len(y) - len(self.turning):]
        base = super().rates(t, y)
        return np.concatenate([base, self._speeds(self.motion(y, t)[0])[self.turning]])

    def _speeds(self, motion: Motion) -> np.ndarray:
        """Rates of all coordinates, (L,)."""
        u = np.concatenate([motion.v, motion.w], axis=1)
        return np.array([float(np.sum(row.row(motion)[0] * u)) for row in self.rows])

    def _coordinates(self, motion: Motion, angles: np.ndarray) -> np.ndarray:
        values, waiting = np.zeros(len(self.laws)), iter(angles)
        for i, law in enumerate(self.laws):
            if law.turns:
                values[i] = next(waiting)
                continue
            joint = law.joint
            ends = [motion.x[body] + motion.R[body] @ anchor for body, anchor in (
                (joint.child, joint.child_anchor), (joint.parent, joint.parent_anchor))]
            values[i] = motion.R[joint.parent] @ joint.parent_axis @ (ends[0] - ends[1])
        return values

    # Equations: M u' + G^T mu = f, all rows.

    def accelerations(self, motion: Motion, angles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """As `Maximal.accelerations`, with the efforts of the mode and the rows of what it holds."""
        u, _ = self._held_accelerations(motion, angles)
        return u[:, :3], u[:, 3:]

    def _held_accelerations(self, motion: Motion, angles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Accelerations (n, 6) and the efforts that hold, (L,)."""
        effort, M, G, target, J, drift = self._system(motion, angles)
        rate = self._speeds(motion)
        effort = effort + J.T @ self.efforts(self.mode, motion.t, self._coordinates(motion, self.angles), rate)
        held = [i for i, part in enumerate(self.mode) if part.held]
        rows = np.concatenate([G, J[held]])
        u, mu = self._constrained(M, effort, rows, np.concatenate([target, (drift + 2 * DAMPING * rate)[held]]))
        holding = np.zeros(len(self.laws))
        holding[held] = -mu[len(G):]
        return u.reshape(-1, 6), holding

    def _system(self, motion: Motion, angles: np.ndarray) -> tuple[np.ndarray, ...]:
        """f without laws (6 n), M, G and its target, rows of the coordinates (L, 6 n) and their drifts."""
        n = self.scene.n
        force, torque = self._applied(motion, angles)
        torque = torque - gyroscopic(self.scene.inertias, motion.w[:-1])
        effort = np.concatenate([force, torque], axis=1).ravel()
        M = np.zeros((6 * n, 6 * n))
        for body, (mass, inertia) in enumerate(zip(self.scene.masses, self.scene.inertias, strict=True)):
            at_body = 6 * body
            M[at_body:at_body + 3, at_body:at_body + 3] = mass * np.eye(3)
            M[at_body + 3:at_body + 6, at_body + 3:at_body + 6] = inertia
        for rotor in self.rotors:
            row, drift = rotor.row(motion)
            flat = row[:-1].ravel()
            M += rotor.inertia * np.outer(flat, flat)
            effort = effort - rotor.inertia * drift * flat
        G, target = np.zeros((0, 6 * n)), np.zeros(0)
        if self.constraints:
            jacobian, target = self._constraint_terms(motion)
            G = jacobian.reshape(len(jacobian), -1)
        pairs = [row.row(motion) for row in self.rows]
        return (effort, M, G, target, np.array([row[:-1].ravel() for row, _ in pairs]),
                np.array([drift for _, drift in pairs]))

    @staticmethod
    def _constrained(M: np.ndarray, effort: np.ndarray, rows: np.ndarray, target: np.ndarray
                     ) -> tuple[np.ndarray, np.ndarray]:
        """u and mu of M u + rows^T mu = effort, rows u = -target; of least norm where rows depend on others."""
        lower = np.linalg.cholesky(M)
        free = np.linalg.solve(lower, effort)
        if not len(rows):
            return np.linalg.solve(lower.T, free), np.zeros(0)
        U, sigma, V = np.linalg.svd(np.linalg.solve(lower, rows.T), full_matrices=False)
        kept = sigma > DEPENDENT * sigma[0]
        U, sigma, V = U[:, kept], sigma[kept], V[kept]
        wanted = -(V @ target) / sigma
        along = U.T @ free
        u = np.linalg.solve(lower.T, free + U @ (wanted - along))
        return u, V.T @ ((along - wanted) / sigma)

    # What the machine of modes asks for.

    def moving(self, t: np.ndarray, Y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Coordinates and rates, (L, T)."""
        pairs = []
        for time, y in zip(t, Y, strict=True):
            motion, _ = self.motion(y, float(time))
            pairs.append((self._coordinates(motion, y[len(y) - len(self.turning):]), self._speeds(motion)))
        q, rate = (np.array(each).T for each in zip(*pairs, strict=True))
        return q, rate

    def wanted(self, i: int, t: Number, q: Number, rate: Number) -> Number:
        """What a servo would give without its limits."""
        servo = self.laws[i].servo
        errors = at(servo.target, t) - q, at(servo.target_velocity, t) - rate
        return servo.proportional * errors[0] + servo.derivative * errors[1] + at(servo.feedforward, t)

    def bound(self, i: int, part: Part, side: int, rate: Number) -> Number:
        """The limit of a servo on one side: against the motion the whole of it, with the motion what the motor has."""
        servo = self.laws[i].servo
        whole = max(servo.effort_limit) if side > 0 else min(servo.effort_limit)
        with_motion = np.sign(part.way) == side
        if servo.no_load_speed is None or not with_motion:
            return whole + 0.0 * rate
        return 0.0 * rate if abs(part.way) == 2 else whole * (servo.no_load_speed - np.abs(rate)) / servo.no_load_speed

    def push(self, i: int, side: int, q: Number, rate: Number) -> Number:
        """Size of the force of a soft stop, as if it could pull."""
        limits = self.laws[i].limits
        depth, speed = (q - limits.upper, rate) if side > 0 else (limits.lower - q, -rate)
        return limits.stiffness * depth + limits.damping * speed

    def efforts(self, mode: Mode, t: Number, q: Number, rate: Number) -> np.ndarray:
        """All efforts but those that hold, (L,)."""
        total = np.zeros(len(self.laws))
        for i, (law, part) in enumerate(zip(self.laws, mode, strict=True)):
            if law.servo is not None:
                if law.servo.period is not None:
                    total[i] += part.acting
                else:
                    total[i] += (self.bound(i, part, part.cut, rate[i]) if part.cut
                                 else self.wanted(i, t, q[i], rate[i]))
            if part.soft and part.pushing:
                total[i] -= part.soft * self.push(i, part.soft, q[i], rate[i])
            if law.friction and not part.held:
                total[i] -= law.friction.sliding * part.slip
        return total

    def holding(self, mode: Mode, t: np.ndarray, Y: np.ndarray) -> np.ndarray:
        """Efforts that hold, (L, T)."""
        self.mode, efforts = mode, []
        for time, y in zip(t, Y, strict=True):
            self.angles = y[len(y) - len(self.turning):]
            efforts.append(self._held_accelerations(*self.motion(y, float(time)))[1])
        return np.array(efforts).T

    def response(self, t: float, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """b, S: accelerations of coordinates without efforts of laws, and by unit efforts."""
        effort, M, G, target, J, drift = self._system(*self.motion(y, t))
        b = J @ self._constrained(M, effort, G, target)[0] + drift
        columns = [self._constrained(M, row, G, np.zeros(len(G)))[0] for row in J]
        return b, J @ np.array(columns).T

    def choose(self, b: np.ndarray, S: np.ndarray, lo: np.ndarray, hi: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(f, a) of the box problem: the least of its convex function, by an active-set method of SciPy."""
        if not len(b):
            return np.zeros(0), np.zeros(0)
        from scipy.optimize import lsq_linear

        half = np.linalg.cholesky(0.5 * (S + S.T)).T
        solved = lsq_linear(half, -np.linalg.solve(half.T, b), (lo, hi), method="bvls", tol=1e-15) if (lo < hi).all() \
            else lsq_linear(half, -np.linalg.solve(half.T, b), (lo - 1e-300, hi + 1e-300), method="bvls", tol=1e-15)
        f = solved.x
        size = np.abs(S) @ np.abs(f) + np.abs(b)
        a = b + S @ f
        inside = (f > lo + 1e-11 * np.abs(f)) & (f < hi - 1e-11 * np.abs(f))
        a[inside | (np.abs(a) <= 1e-12 * size)] = 0.0
        return f, a

    def kicked(self, t: float, y: np.ndarray, impulses: np.ndarray) -> np.ndarray:
        """The state after impulses on the coordinates."""
        _, M, G, _, J, _ = self._system(*self.motion(y, t))
        change = self._constrained(M, J.T @ impulses, G, np.zeros(len(G)))[0].reshape(-1, 6)
        y, n = y.copy(), self.scene.n
        y[7 * n:10 * n] += change[:, :3].ravel()
        y[10 * n:13 * n] += change[:, 3:].ravel()
        return y

    def on_surface(self, y: np.ndarray, i: int, q: float | None, rate: float | None) -> np.ndarray:
        """The state with a coordinate or a rate set to what it is but for rounding: by the least change in M."""
        _, S = self.response(0.0, y)
        motion, _ = self.motion(y)
        unit = np.eye(len(self.laws))[i] / S[i, i]
        if q is not None:
            angles, n = y[len(y) - len(self.turning):], self.scene.n
            gap = q - self._coordinates(motion, angles)[i]
            moved = self.kicked(0.0, y, gap * unit) - y
            quaternions, turn = y[3 * n:7 * n].reshape(n, 4), moved[10 * n:13 * n].reshape(n, 3)
            y = y.copy()
            y[:3 * n] += moved[7 * n:10 * n]
            y[3 * n:7 * n] += 0.5 * np.concatenate([-np.sum(turn * quaternions[:, 1:], axis=1, keepdims=True),
                                                    turn * quaternions[:, :1] - cross(turn, quaternions[:, 1:])],
                                                   axis=1).ravel()
            if i in self.turning:
                y[len(y) - len(self.turning) + self.turning.index(i)] = q
        if rate is not None:
            y = self.kicked(0.0, y, (rate - self._speeds(motion)[i]) * unit)
        return y

    # Steps.

    @property
    def begin(self) -> End:
        """The start of the scene, in its mode."""
        start = self.machine.begin(self.initial())
        return End(start.state, mode=start.mode, cause=start.cause)

    def advance(self, end: End, times: np.ndarray) -> tuple[States, End]:
        """As `Maximal.advance`, across events."""
        y, self.mode, events, step = end.state, end.mode, list(end.events), end.rest or None
        rows = [self._row(y, float(times[0]))]
        t, fresh = float(times[0]), True
        for stop in times[1:].tolist():
            while t < stop:
                scheduled = self.machine.next_time(t, self.mode)
                until = min(stop, scheduled)
                self.before = float(np.nextafter(until, 0.0))
                if until - t <= SHORT * max(1.0, t):  # too short for surfaces to show which way they go
                    reached, y, fired = until, y + (until - t) * self.rates(t, y), list[Label]()
                else:
                    reached, y, fired, step = self._smooth(t, y, until, step, fresh)
                    fresh = False
                self.before = np.inf
                if not fired and scheduled - reached <= rounding(reached):
                    reached = scheduled
                if fired or reached >= scheduled:
                    fresh = True
                    resumed = self.machine.after_event(reached, y, self.mode, fired)
                    y, self.mode = resumed.state, resumed.mode
                    events += resumed.events
                    if len(events) > 100000:
                        raise TruthError(f"{self.source}: {self.scene.name!r}: too many events")
                t = reached
            rows.append(self._row(y, stop))
        states = States(times, *(np.array(column) for column in zip(*rows, strict=True)))
        return states, End(y, float(times[-1]), step or 0.0, self.mode, tuple(events))

    def _row(self, y: np.ndarray, t: float) -> tuple[np.ndarray, ...]:
        self.angles = y[len(y) - len(self.turning):]
        return super()._row(y, t)

    def _smooth(self, t: float, y: np.ndarray, stop: float, step: float | None, fresh: bool
                ) -> tuple[float, np.ndarray, list[Label], float | None]:
        """Integrate to a stop or the first event: its time, the state there, what is reached, and a step to try."""
        kind = self.integrator[0]
        before = self._surfaces(np.array([t]), y[None])
        solver = self._solver(kind, t, y, stop, None if step is None else min(step, stop - t))
        ignored = {label for label, value in before.items()} if fresh else set()
        proposals = [step or 0.0]
        while solver.status == "running":
            last_t, last_y = solver.t, solver.y
            message = solver.step()
            if solver.status == "failed":
                raise TruthError(f"{self.source}: {self.scene.name!r} at t = {solver.t:.6g} s: {message}")
            proposals.append(solver.h_abs)
            crossed = self._crossed(solver, last_t, last_y, before, ignored)
            if crossed is not None:
                event_t, event_y, fired = crossed
                return event_t, event_y, fired, max(proposals)
            before, ignored = self._surfaces(np.array([solver.t]), solver.y[None]), set()
        return solver.t, solver.y, [], max(proposals)

    def _surfaces(self, t: np.ndarray, Y: np.ndarray) -> Values:
        return self.machine.surfaces(self.mode, np.minimum(t, self.before), Y)

    def _solver(self, kind: type[OdeSolver], t: float, y: np.ndarray, stop: float, first: float | None) -> OdeSolver:
        solver = kind(self.rates, t, y, stop, first_step=first, rtol=max(self.integrator[1], 1e-13), atol=ATOL)
        solver.rtol = self.integrator[1]
        return solver

    def _crossed(self, solver: OdeSolver, t: float, y: np.ndarray, before: Values, begun: set[Label]
                 ) -> tuple[float, np.ndarray, list[Label]] | None:
        """The first event of the last step."""
        h, dense = solver.t - t, solver.dense_output()
        places = t + h * np.array(INSIDE)
        states = np.array([*(dense(place) for place in places[:-1]), solver.y])
        values = self._surfaces(places, states)
        roots: list[tuple[float, Label]] = []
        for label, column in values.items():
            size = max(float(np.abs(column).max()), abs(float(before[label][0])), 1e-300)
            zero = label in begun and abs(float(before[label][0])) <= 1e-9 * size  # it begins on the surface
            line = np.concatenate([[size if zero else before[label][0]], column])
            below = np.flatnonzero(line <= 0.0) if not zero else np.flatnonzero(line < -TOUCHED * size)
            if len(below):
                k = max(int(below[0]), 1)
                one, other = h * (0.0, *INSIDE)[k - 1], h * (0.0, *INSIDE)[k]
                roots.append((self._located(label, t, y, one, other, zero), label))
        if not roots:
            return None
        after = min(roots, key=lambda each: each[0])[0]
        fired = [label for each, label in roots if each <= after + max(SAME * h, 1e-12)]
        return t + after, self._at(t, y, after), fired

    def _at(self, t: float, y: np.ndarray, after: float) -> np.ndarray:
        """The state some time after a state, by steps that end there."""
        if t + after <= t:
            return y
        solver = self._solver(self.integrator[0], t, y, t + after, t + after - t)
        while solver.status == "running":
            solver.step()
        state: np.ndarray = solver.y
        return state

    def _located(self, label: Label, t: float, y: np.ndarray, one: float, other: float, begun: bool) -> float:
        """Time after a state at which a surface is zero, by regula falsi (Illinois) on steps.

        `begun`: the state is on the surface.
        """
        def value(after: float) -> float:
            return float(self._surfaces(np.array([t + after]), self._at(t, y, after)[None])[label][0])

        at_one, at_other = value(one), value(other)
        for _ in range(40 if begun and one == 0.0 else 0):
            # it begins on the surface: whether it leaves it shows only a while later
            one, at_one = 0.5 * other, value(0.5 * other)
            if at_one > 0.0:
                break
            one, at_one, other, at_other = 0.0, 0.0, one, at_one
        if at_one <= 0.0:
            return one
        for _ in range(60):
            if at_other == 0.0 or abs(other - one) <= 1e-16 * max(1.0, t):
                break
            middle = other - at_other * (other - one) / (at_other - at_one)
            at_middle = value(middle)
            if at_middle * at_other < 0.0:
                one, at_one = other, at_other
            else:
                at_one *= 0.5
            done = abs(middle - other) <= 1e-16 * max(1.0, t)
            other, at_other = middle, at_middle
            if done:
                break
        return other


