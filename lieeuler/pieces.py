"""Integration of problems with laws (`lieeuler.laws`): piece by piece, each by the method as it is.

Within a piece every law is a spring, a damper and a torque on its coordinate, or a row that holds the coordinate still.
A piece ends where a surface is crossed. Methods of higher order solve for that time with the method itself, so
they keep their order. What comes next is the mode that agrees with its own accelerations (Gauss' principle: for dry
friction there is one). Impulses of stops follow from the accelerations that a torque on the coordinate adds. These are
(20.1) and (20.2) of docs/theory.md.
"""

from __future__ import annotations

import dataclasses
import math
import time
from collections.abc import Callable, Iterable, Iterator
from typing import Any

import numpy as np

from lieeuler import _kernel
from lieeuler.checks import normals
from lieeuler.errors import ArgumentError
from lieeuler.forces import Force, SlideForce, TorsionalSpring
from lieeuler.functions import TimeFunction
from lieeuler.joint_parts import Dot
from lieeuler.laws import Law, Servo, Stops, measured
from lieeuler.problem import Problem, raise_own
from lieeuler.solution import IntegrationError, Solution, Stats, Status
from lieeuler.types import GROUND

Solve = Callable[[Problem, np.ndarray], Solution]
"""Integrates a problem without laws over these times, the first of which is that of its state."""
Key = tuple[str, int, int]
"""A surface: its kind, the law, and the servo or the side."""
Surface = tuple[Key, np.ndarray, np.ndarray | None]
"""What stays at or above 0 within a piece, (T,), and its slope where that is known."""

NO_STEPS = Stats(0, 0, 0, 0, 0, 0, 0, None, 0.0, {})
FINE = 8
"""Points of an interval between output times at which surfaces are looked at, for methods that choose their steps; and
of the time in which the fastest body turns by a radian as it does at the start."""
AHEAD = 64
"""Most intervals that are integrated before surfaces are looked at: an event makes the rest in vain."""
NEAR = 1e-12
"""Times this near, as a part of the larger one of 1 and themselves, are one."""
SHORT = 1e-6
"""s of a run of which only the start counts."""
SETTLED = 1e-12
"""A rate this small, as a part of the larger one of 1 and the rate before, is none."""
LOWEST = 1e-15
"""A bounce whose height is below this, as a part of the larger one of 1 and the coordinate, is none."""
PUSH = 1e4
"""The torque whose accelerations give those of an impulse, over the weights and one: so large that rounding of what the
other forces do is small beside it."""
AGAIN = 3
"""Times that a coordinate may come to rest at one time, since others change there as well; then it stays for a step:
the method and the accelerations of the index-1 system, which differ by a part of the step, disagree on what follows."""
CHATTER = 100
"""More changes than this at one time end the run: no mode agrees with its own accelerations."""
COUPLED = 1e-9
"""What an impulse along one coordinate changes of the rate of another one is rounding below this part of their own."""


@dataclasses.dataclass
class Mode:
    """What one law does in a piece. `cut` and `region` have an entry for each servo, as `acting` and `waiting`."""

    held: bool = False  # by friction or at a rigid stop
    sign: int = 0  # of the rate where friction acts
    stop: int = 0  # 1 at the upper stop or beyond it, -1 at the lower one
    pushes: bool = False  # a soft stop
    cut: list[int] = dataclasses.field(default_factory=list)  # 1 at the upper bound, -1 at the lower one
    region: list[int] = dataclasses.field(default_factory=list)  # of the rate: its sign, doubled beyond no_load_speed
    waiting: list[list[float]] = dataclasses.field(default_factory=list)  # of sampled servos, the newest last


@dataclasses.dataclass
class State:
    """A time, the states of the bodies, and the coordinates and rates of the laws."""

    t: float
    x: np.ndarray
    R: np.ndarray
    v: np.ndarray
    w: np.ndarray
    q: np.ndarray
    rate: np.ndarray


@dataclasses.dataclass(frozen=True)
class Kick:
    """What a unit impulse along a coordinate changes: v and w of the bodies, (n, 3), and the rates of the laws."""

    v: np.ndarray
    w: np.ndarray
    rates: np.ndarray

    def given(self, state: State, size: float) -> State:
        """The state after an impulse of this size, N s or N m s."""
        return dataclasses.replace(state, v=state.v + size * self.v, w=state.w + size * self.w,
                                   rate=state.rate + size * self.rates)


@dataclasses.dataclass
class Stretch:
    """A run within a piece, its first row that of the start: coordinates, rates, accelerations and holding forces."""

    solution: Solution
    q: np.ndarray  # (T, laws)
    rate: np.ndarray
    acceleration: np.ndarray
    holding: np.ndarray  # NaN where nothing holds

    def state(self, row: int) -> State:
        """The state at one time."""
        s = self.solution
        return State(float(s.t[row]), s.x[row], s.R[row], s.v[row], s.w[row], self.q[row].copy(), self.rate[row].copy())


class Pieces:
    """One run of a problem with laws.

    Parameters
    ----------
    problem : Problem
    solve : Solve
        The method.
    t : (T,) output times, s
    step : s, of methods with a fixed step; None for others
    located : whether crossings are solved for; otherwise they are taken at ends of steps (those of stops always are)
    """

    def __init__(self, problem: Problem, solve: Solve, t: np.ndarray, step: float | None, located: bool) -> None:
        self.begun = time.perf_counter()
        self.problem, self.solve, self.located = problem, solve, located
        self.laws, self.t = problem.laws, t
        self.events: list[tuple[float, int, str]] = []
        self.freed: dict[int, float] = {}  # by law, when it was let go last
        self.rested: dict[int, tuple[float, int]] = {}  # when it came to rest last, and how often at that time
        self.stays: dict[int, float] = {}  # and when it was found to be at rest all the same
        for law in self.laws:
            if not 0 <= law.joint < len(problem.joints):
                raise ArgumentError(f"there is no joint {law.joint} for a law")
            if problem.joints[law.joint].drive is not None or problem.joints[law.joint].mimic is not None:
                raise ArgumentError(f"joint {law.joint} is driven or follows another: no law can act there")
        self.springs = {k: force for k, force in enumerate(problem.forces) if isinstance(force, TorsionalSpring)}
        self.angles = {k: float(spring.start_angle(problem.R)) for k, spring in self.springs.items()}
        self.modes = [Mode(cut=[0] * len(law.servos), region=[0] * len(law.servos),
                           waiting=[list(s.earlier) or [0.0] * (s.delay + 1) for s in law.servos]) for law in self.laws]
        self.grid, self.ticks = self._knots(step)
        self.stats: list[Stats] = []
        self.rows: list[tuple[Solution, int]] = []
        weight = sum(body.mass for body in problem.bodies) * float(np.linalg.norm(problem.gravity))
        self.push = PUSH * (1.0 + weight)

    # --- times

    def _knots(self, step: float | None) -> tuple[list[np.ndarray], dict[float, list[tuple[int, int]]]]:
        """Points of the intervals between output times, samples of servos and breaks of functions; ticks."""
        first, last = float(self.t[0]), float(self.t[-1])
        ticks: dict[float, list[tuple[int, int]]] = {}
        for i, law in enumerate(self.laws):
            for k, servo in enumerate(law.servos):
                if servo.period is not None:
                    number = math.ceil((first - servo.phase) / servo.period - 1e-9)
                    while (when := servo.phase + number * servo.period) <= last:
                        ticks.setdefault(self._near(when, self.t), []).append((i, k))
                        number += 1
        breaks = {b for function in _functions(self.problem) for b in function.breaks if first < b < last}
        knots = np.array(sorted({*self.t.tolist(), *ticks, *(self._near(b, self.t) for b in breaks)}))
        turns = float(np.linalg.norm(self.problem.w, axis=-1).max(initial=0.0)) * np.diff(knots)
        counts = (np.ceil(FINE * np.maximum(1.0, turns)) if step is None else
                  np.maximum(1, np.ceil(np.diff(knots) / step * (1 - 1e-12)))).astype(int)
        grid = [np.linspace(a, b, count + 1)[1:] for a, b, count in zip(knots[:-1], knots[1:], counts, strict=True)]
        return grid, ticks

    @staticmethod
    def _near(when: float, times: np.ndarray) -> float:
        """The output time that this time is but for rounding, or the time itself."""
        nearest = float(times[np.abs(times - when).argmin()])
        return nearest if abs(nearest - when) <= NEAR * max(1.0, abs(when)) else when

    # --- a piece as a problem

    def _piece(self, state: State, pushed: tuple[int, float] = (0, 0.0)) -> tuple[Problem, list[int]]:
        """The problem of the present modes from a state on, and the multipliers of its laws that hold (else -1).

        pushed: a law, and a further torque along its coordinate.
        """
        joints, forces = list(self.problem.joints), list(self.problem.forces)
        for k, spring in self.springs.items():  # an angle starts anew in (-pi, pi]: the turns go into its rest
            forces[k] = spring.counted_from(self.angles[k] - spring.start_angle(state.R))
        slots = []
        for i, (law, mode) in enumerate(zip(self.laws, self.modes, strict=True)):
            slots.append(3 * joints[law.joint].spherical + len(joints[law.joint].dots) if mode.held else -1)
            if mode.held:
                joint = joints[law.joint]
                joints[law.joint] = dataclasses.replace(joint, dots=(*joint.dots, self._hold(i, state)))
            forces += self._forces(i, state, pushed[1] if pushed[0] == i else 0.0)
        before = np.cumsum([0, *(joint.rows for joint in joints)])
        rows = [-1 if slot < 0 else int(before[law.joint]) + slot for law, slot in zip(self.laws, slots, strict=True)]
        piece = Problem.unchecked(self.problem, joints=tuple(joints), forces=tuple(forces), laws=(), x=state.x,
                                  R=state.R, v=state.v, w=state.w, time=state.t)
        return piece, rows

    def _hold(self, i: int, state: State) -> Dot:
        """The row that keeps a coordinate where it is: its multiplier is the force along an angle, or minus it."""
        coordinate, joint = self.laws[i].coordinate, self.problem.joints[self.laws[i].joint]
        if coordinate.relative is None:
            return Dot("parent", "difference", coordinate.parent_axis, constant=float(state.q[i]))
        n1, n2 = normals(coordinate.parent_axis)
        direction = state.R[joint.child].T @ (n2 if joint.parent == GROUND else state.R[joint.parent] @ n2)
        direction = direction - (direction @ coordinate.child_axis) * coordinate.child_axis
        return Dot("parent", "child", n1, direction / np.linalg.norm(direction))

    def _forces(self, i: int, state: State, torque: float) -> list[Force]:
        """The forces of a law and a further torque: one with all that is linear or constant, and one for each function
        of time."""
        law, mode, stiffness, damping = self.laws[i], self.modes[i], 0.0, 0.0
        given: list[tuple[float | TimeFunction, float]] = []  # with their factors
        if not mode.held and law.sliding:
            given.append((-law.sliding, float(mode.sign)))
        if law.stops is not None and law.stops.stiffness is not None and mode.pushes:
            stiffness, damping = law.stops.stiffness, law.stops.damping
            given.append((law.stops.edge(mode.stop), law.stops.stiffness))
        for servo, cut, region, waiting in zip(law.servos, mode.cut, mode.region, mode.waiting, strict=True):
            bound = servo.upper if cut > 0 else servo.lower
            if servo.period is not None:
                given.append((waiting[-1 - servo.delay], 1.0))
            elif not cut:
                stiffness, damping = stiffness + servo.proportional, damping + servo.derivative
                given += [(servo.target, servo.proportional), (servo.target_velocity, servo.derivative),
                          (servo.feedforward, 1.0)]
            elif servo.no_load_speed is None or region * cut < 0:
                given.append((bound, 1.0))
            elif abs(region) < 2:
                damping += abs(bound) / servo.no_load_speed
                given.append((bound, 1.0))
        moving = [each.scaled(factor) for each, factor in given if isinstance(each, TimeFunction)]
        for each, factor in given:
            if not isinstance(each, TimeFunction):
                torque += factor * each
        joint, axis, child_axis = self.problem.joints[law.joint], law.coordinate.parent_axis, law.coordinate.child_axis
        bodies = joint.parent, joint.child
        if law.coordinate.relative is None:
            ends = *bodies, joint.parent_anchor, joint.child_anchor, axis
            return [SlideForce(*ends, torque, stiffness, 0.0, damping), *(SlideForce(*ends, each) for each in moving)]
        spring = TorsionalSpring(*bodies, axis, child_axis, stiffness, 0.0, damping, torque)
        spring = spring.counted_from(float(state.q[i]) - spring.start_angle(state.R))
        return [spring, *(TorsionalSpring(*bodies, axis, child_axis, 0.0, 0.0, 0.0, each) for each in moving)]

    def _stretch(self, solution: Solution, state: State, rows: list[int]) -> Stretch:
        """The coordinates along a run from a state on."""
        if not len(solution.t):  # not even the accelerations of its start are known
            raise IntegrationError(solution.status, solution.status.advice, solution)
        arrays = tuple(getattr(solution, name) for name in ("x", "R", "v", "w", "a", "alpha"))
        q, rate, acceleration, holding = np.empty((4, len(solution.t), len(self.laws)))
        for i, (law, row) in enumerate(zip(self.laws, rows, strict=True)):
            turns = law.coordinate.relative is not None
            holding[:, i] = np.nan if row < 0 else (1.0 if turns else -1.0) * solution.lam[:, row]
            if row >= 0:
                q[:, i], rate[:, i], acceleration[:, i] = state.q[i], 0.0, 0.0
                continue
            q[:, i], rate[:, i], acceleration[:, i] = measured(law, self.problem.joints[law.joint], *arrays)
            if turns:
                q[:, i] = _continued(q[:, i], float(state.q[i]))
        return Stretch(solution, q, rate, acceleration, holding)

    def _run(self, state: State, times: np.ndarray) -> Stretch:
        """Integrate the present piece from a state over further times."""
        problem, rows = self._piece(state)
        solution = self.solve(problem, np.concatenate([[state.t], times]))
        self.stats.append(solution.stats)
        stretch = self._stretch(solution, state, rows)
        keep = np.setdiff1d(np.arange(solution.lam.shape[1]), rows)
        solution.lam = solution.lam[:, keep]
        return stretch

    def _index1(self, state: State, pushed: tuple[int, float] = (0, 0.0)) -> Stretch:
        """Accelerations and holding forces of the present modes in one state."""
        problem, rows = self._piece(state, pushed)
        t, angles = np.array([state.t]), np.zeros((1, problem.kernel.angles))
        a, alpha, lam, *_, end = _kernel.index1(problem.kernel, t, state.x, state.R, state.v, state.w, angles)
        raise_own(problem)
        solution = Solution(t[:end], state.x[None], state.R[None], state.v[None], state.w[None], a, alpha, lam,
                            Status.SUCCESS if end else Status.SINGULAR_MATRIX, NO_STEPS, "index1", state.t)
        return self._stretch(solution, state, rows)

    # --- surfaces

    def _surfaces(self, s: Stretch) -> Iterator[Surface]:
        for i, (law, mode) in enumerate(zip(self.laws, self.modes, strict=True)):
            q, rate, acceleration = s.q[:, i], s.rate[:, i], s.acceleration[:, i]
            if mode.held:
                lower, upper = held_range(law, mode)
                yield ("held", i, -1), upper - s.holding[:, i], None
                yield ("held", i, 1), s.holding[:, i] - lower, None
            elif law.static and mode.sign:
                yield ("rest", i, 0), mode.sign * rate, mode.sign * acceleration
            if law.stops is not None and not mode.held:
                yield from self._stop_surfaces(i, law.stops, mode, q, rate)
            for k, servo in enumerate(law.servos):
                if servo.period is None:
                    yield from self._servo_surfaces((i, k), servo, mode, s.solution.t, q, rate)

    @staticmethod
    def _stop_surfaces(i: int, stops: Stops, mode: Mode, q: np.ndarray, rate: np.ndarray) -> Iterator[Surface]:
        if mode.stop == 0:
            for side in (-1, 1):
                if math.isfinite(stops.edge(side)):
                    yield ("hits", i, side), side * (stops.edge(side) - q), -side * rate
            return
        if stops.stiffness is not None:
            depth = mode.stop * (q - stops.edge(mode.stop))
            yield ("leaves", i, mode.stop), depth, mode.stop * rate
            force = stops.stiffness * depth + stops.damping * mode.stop * rate
            yield ("pushes", i, mode.stop), force if mode.pushes else -force, None

    @staticmethod
    def _servo_surfaces(who: tuple[int, int], servo: Servo, mode: Mode, t: np.ndarray, q: np.ndarray,
                        rate: np.ndarray) -> Iterator[Surface]:
        k = who[1]
        wanted, (lower, upper) = servo.wanted(t, q, rate), servo.bounds(rate)
        if mode.cut[k] == 0:
            for side, room in ((1, upper - wanted), (-1, wanted - lower)):
                if np.isfinite(room).all():
                    yield (f"cut {side}", *who), room, None
            return
        yield ("cut 0", *who), (wanted - upper if mode.cut[k] > 0 else lower - wanted), None
        if servo.no_load_speed is not None and not mode.held:
            sign = 1 if mode.region[k] > 0 else -1
            over = sign * rate - servo.no_load_speed
            yield ("region", *who), over if abs(mode.region[k]) > 1 else np.minimum(sign * rate, -over), None

    def _first(self, s: Stretch) -> tuple[int, Key] | None:
        """The first row at which a surface is crossed, and the surface; also where it may be crossed twice before."""
        first: tuple[int, Key] | None = None
        for key, value, slope in self._surfaces(s):
            below = self._below(s, key, value)
            if slope is not None:
                below |= _dips(s.solution.t, value, slope)
            if below.any() and (first is None or int(below.argmax()) + 1 < first[0]):
                first = int(below.argmax()) + 1, key
        return first

    def _below(self, s: Stretch, key: Key, value: np.ndarray) -> np.ndarray:
        """(T - 1,) whether a surface is crossed at the rows after the first."""
        below: np.ndarray = value[1:] < -1e-13 * max(1.0, float(np.abs(value).max(initial=0.0)))
        if key[0] == "held" and self.stays.get(key[1]) == float(s.solution.t[0]):
            below[0] = False
        return below

    def _values(self, s: Stretch, key: Key) -> list[float]:
        """The values of one surface along a stretch."""
        return next(value.tolist() for each, value, _ in self._surfaces(s) if each == key)

    def _crossing(self, state: State, until: float, key: Key) -> tuple[State, Key]:
        """Where a surface is first crossed between a state and a later time, by the rule of false position (Illinois).

        Another surface may come before the one that is given.
        """
        whole = self._run(state, np.linspace(state.t, until, FINE + 1)[1:])
        tried = [whole]
        row, key = self._first(whole) or (FINE, key)
        values = self._values(whole, key)
        before, after = ((float(whole.solution.t[k]), values[k], (whole, k)) for k in (row - 1, row))
        (ta, fa, _), (tb, fb, _), kept = before, after, 0
        while fa > 0.0 > fb and tb - ta > 4e-16 * max(1.0, abs(tb)):
            middle = tb - fb * (tb - ta) / (fb - fa)
            if not ta < middle < tb:
                break
            reached = self._run(state, np.array([middle]))
            tried.append(reached)
            f = self._values(reached, key)[-1]
            other = next((each for each, value, _ in self._surfaces(reached)
                          if each != key and self._below(reached, each, value)[-1]), None)
            if f >= 0 and other is not None:
                key, kept = other, 0
                before = ta, fa, _ = ta, self._values(before[2][0], key)[before[2][1]], before[2]
                after = tb, fb, _ = middle, self._values(reached, key)[-1], (reached, 1)
            elif f >= 0:
                before = ta, fa, _ = middle, f, (reached, 1)
                fb, kept = fb / 2 if kept > 0 else fb, 1
            else:
                after = tb, fb, _ = middle, f, (reached, 1)
                fa, kept = fa / 2 if kept < 0 else fa, -1
        best = (after if -after[1] < before[1] else before)[2]
        for each in tried:
            _took(each, best[1] if each is best[0] else 0)
        self._turn(*best)
        times = best[0].solution.t
        times[best[1]] = self._near(float(times[best[1]]), self.t)  # an output as near as this is at the event
        there = best[0].state(best[1])
        if there.t > state.t:
            self._keep(*best)
        return there, key

    # --- changes

    def _record(self, t: float, i: int, what: str, side: int = 0) -> None:
        self.events.append((t, self.laws[i].joint, what + ("", "_upper", "_lower")[side]))

    def _change(self, state: State, key: Key) -> State:
        """The state after a surface was crossed; the modes change."""
        kind, i, which = key
        law, mode = self.laws[i], self.modes[i]
        if kind == "rest":
            was, mode.sign, mode.held = mode.sign, 0, True
            last, count = self.rested.get(i, (state.t, 0))
            self.rested[i] = state.t, count + 1 if last == state.t else 1
            state = self._still(state, i)
            if (count := self.rested[i][1]) <= AGAIN:
                self._choose_modes(state, {i})
            if mode.held and (count > AGAIN or self.freed.get(i) == state.t):  # as good as at rest: it stays for a step
                self.stays[i] = state.t
                self.events = [event for event in self.events if event[:2] != (state.t, law.joint) or event[2] not in (
                    "slips", "reverses")]
            elif mode.held:
                self._record(state.t, i, "sticks")
            elif mode.sign != was:
                self._record(state.t, i, "reverses")
        elif kind == "held":
            self.freed[i] = state.t
            self._release(state, i, which)
            self._choose_modes(state, set(), i)
        elif kind == "hits":
            self._record(state.t, i, "hits", which)
            mode.stop = which
            assert law.stops is not None
            if law.stops.stiffness is None:
                state = self._impact(state, i, which)
            else:
                mode.pushes = True
        elif kind == "leaves":
            self._record(state.t, i, "leaves", which)
            mode.stop, mode.pushes = 0, False
        elif kind == "pushes":
            mode.pushes = not mode.pushes
        elif kind.startswith("cut"):
            mode.cut[which] = int(kind.split()[1])
            mode.region[which] = self._region(law.servos[which], state.rate[i], mode)
            self._record(state.t, i, "saturates" if mode.cut[which] else "unsaturates")
        else:
            speed = law.servos[which].no_load_speed or math.inf
            sign = 1 if mode.region[which] > 0 else -1
            if abs(mode.region[which]) > 1:
                mode.region[which] = sign
            else:
                mode.region[which] = 2 * sign if abs(state.rate[i]) > 0.5 * speed else -sign
        return state

    def _release(self, state: State, i: int, sign: int) -> None:
        """Let a held coordinate go in the direction of `sign`."""
        law, mode = self.laws[i], self.modes[i]
        mode.held, mode.sign = False, sign
        if mode.stop:
            self._record(state.t, i, "leaves", mode.stop)
            mode.stop = 0
        elif law.static:
            self._record(state.t, i, "slips")

    def _still(self, state: State, i: int) -> State:
        """The state with a coordinate at rest, by the least impulse along it."""
        if abs(state.rate[i]) == 0.0:
            return state
        was, self.modes[i].held = self.modes[i].held, False
        kick = self._responses(state, i)[1][i]
        self.modes[i].held = was
        return kick.given(state, -state.rate[i] / kick.rates[i])

    def _responses(self, state: State, i: int, others: Iterable[int] = ()) -> tuple[Stretch, dict[int, Kick]]:
        """The accelerations of the present modes, and what unit impulses along coordinates that can move change."""
        still, kicks = self._index1(state), {}
        for k in (i, *others):
            pushed = self._index1(state, (k, self.push))
            v, w = ((getattr(pushed.solution, name)[0] - getattr(still.solution, name)[0]) / self.push
                    for name in ("a", "alpha"))
            kick = Kick(v, w, (pushed.acceleration[0] - still.acceleration[0]) / self.push)
            if kick.rates[k] > 0.0:
                kicks[k] = kick
        if i not in kicks:
            raise ArgumentError(f"an impulse along joint {self.laws[i].joint} moves nothing: its loop holds it")
        return still, kicks

    def _at_stops(self, state: State) -> dict[int, int]:
        """The coordinates that rest at rigid stops or reach them now, and the sides."""
        found = {}
        for i, (law, mode) in enumerate(zip(self.laws, self.modes, strict=True)):
            if law.stops is None or law.stops.stiffness is not None:
                continue
            if mode.held and mode.stop:
                found[i] = mode.stop
                continue
            for side in (-1, 1):
                left, speed = side * (law.stops.edge(side) - state.q[i]), side * state.rate[i]
                room = 1e-13 * max(1.0, abs(state.q[i])) + NEAR * max(1.0, abs(state.t)) * speed
                if speed > 0.0 and left <= room:
                    found[i] = side
        return found

    def _impact(self, state: State, i: int, side: int) -> State:
        """The state after the impact at a rigid stop. Friction gives no impulse: what it held may be kicked loose.

        Stops that act on each other share an impact: those that are reached now, and those at which others rest.
        """
        sides = {**self._at_stops(state), i: side}
        closed = {k for k in sides if self.modes[k].held}
        loose = [k for k, mode in enumerate(self.modes) if mode.held and not mode.stop]
        for k in (*loose, *sides):
            self.modes[k].held = False
        still, kicks = self._responses(state, i, sides.keys() - {i})
        group = _acting_on(i, {k: kick.rates for k, kick in kicks.items()})
        before = state.rate
        state = self._rebound(state, {k: sides[k] for k in group}, kicks, side * float(still.acceleration[0, i]))
        rest = {k for k in loose if abs(state.rate[k]) <= SETTLED * max(1.0, abs(before[i]))}
        for k in rest | (closed - set(group)):
            self.modes[k].held, state.rate[k] = True, 0.0
        for k, (law, mode) in enumerate(zip(self.laws, self.modes, strict=True)):
            if law.static and not mode.held and k not in group:
                if k in loose:
                    self._record(state.t, k, "slips")
                mode.sign = 1 if state.rate[k] > 0 else -1
        for k in group:
            mode, sign = self.modes[k], (1 if state.rate[k] > 0 else -1) if self.laws[k].static else 0
            if k not in closed and k != i:
                self._record(state.t, k, "hits", sides[k])
                state.q[k] = self.laws[k].stops.edge(sides[k])  # type: ignore[union-attr]
            if state.rate[k] == 0.0:
                mode.held, mode.stop, mode.sign = True, sides[k], 0
            elif k in closed:
                self._release(state, k, sign)
            else:
                mode.stop, mode.sign = 0, sign
        if fresh := {k for k in group if self.modes[k].held} - closed:
            self._choose_modes(state, fresh | rest)
        self._cuts(state, recorded=True)
        return state

    def _rebound(self, state: State, sides: dict[int, int], kicks: dict[int, Kick], pressing: float) -> State:
        """The state after the impulses of stops that share an impact; what comes to rest has the rate zero.

        pressing: the acceleration into a stop that is alone, without which a low bounce goes on.
        """
        group = list(sides)
        stops = [self.laws[k].stops for k in group]
        bouncing = [k for k, each in zip(group, stops, strict=True) if each is not None and each.restitution > 0.0]
        if len(group) > 1 and bouncing:
            names = " and ".join(str(self.laws[k].joint) for k in group)
            self._fail(Status.NOT_UNIQUE, f"at {state.t:.6g} s stops of the joints {names} act on each other, and that "
                       f"of joint {self.laws[bouncing[0]].joint} bounces; end the run there")
        away = -np.array([sides[k] for k in group])
        S = np.array([kicks[k].rates[group] for k in group]).T
        if len(group) > 1:
            impulses = away * _pushes(away[:, None] * S * away, away * state.rate[group])
            after = np.where(impulses, 0.0, state.rate[group] + S @ impulses)
        else:
            (i,), (each,) = group, stops
            after = -(0.0 if each is None else each.restitution) * state.rate[group]
            if after[0] ** 2 <= LOWEST * max(0.0, pressing) * max(1.0, abs(state.q[i])):
                after[:] = 0.0
            impulses = (after - state.rate[group]) / S[0]
        for k, size in zip(group, impulses, strict=True):
            state = kicks[k].given(state, float(size))
        scale = SETTLED * max(1.0, float(np.abs(state.rate).max()))
        state.rate[group] = np.where(np.abs(after) <= scale, 0.0, after) if len(group) > 1 else after
        return state

    def _choose_modes(self, state: State, fresh: set[int], freed: int = -1) -> None:
        """Choose, among the coordinates at rest, those that stay: Gauss' principle by single changes.

        fresh: held since just now, so that letting them go is no event. freed: let go just now. Its acceleration is as
        good as zero, of either sign, but what drives it grows: it may only be held again when another one changes.
        """
        resting = {i for i, mode in enumerate(self.modes) if mode.held} | {
            i for i, mode in enumerate(self.modes) if mode.sign and state.rate[i] == 0.0}
        sides = {i: self.modes[i].stop for i in resting}
        was = {i: self.modes[i].held and i not in fresh for i in resting}
        for _ in range(CHATTER):
            s = self._index1(state)
            worst, change = 0.0, None
            for i in resting:
                mode = self.modes[i]
                if mode.held:
                    lower, upper = held_range(self.laws[i], mode)
                    holding = float(s.holding[0, i])
                    room = 1e-12 * max(1.0, abs(holding))
                    if (over := max(holding - upper, lower - holding) - room) > worst:
                        worst, change = over, (i, -1 if holding > upper else 1)
                elif i != freed and (back := -mode.sign * float(s.acceleration[0, i])) > worst:
                    worst, change = back, (i, 0)
            if change is None:
                break
            (i, sign), freed = change, -1
            self.modes[i].held, self.modes[i].sign = sign == 0, sign
            self.modes[i].stop = sides[i] if sign == 0 else 0
        for i in resting:
            mode = self.modes[i]
            if was[i] and not mode.held:
                stop, mode.stop = mode.stop, sides[i]
                self._release(state, i, mode.sign)
                mode.stop = stop

    @staticmethod
    def _region(servo: Servo, rate: float, mode: Mode) -> int:
        if servo.no_load_speed is None:
            return 0
        sign = (1 if rate > 0 else -1) if rate else (mode.sign or 1)
        return sign * (2 if abs(rate) > servo.no_load_speed else 1)

    def _cut(self, state: State, i: int, k: int, recorded: bool) -> float:
        """The force of a servo, after noting whether it is cut."""
        servo, mode = self.laws[i].servos[k], self.modes[i]
        wanted, (lower, upper) = servo.wanted(state.t, state.q[i], state.rate[i]), servo.bounds(state.rate[i])
        cut = int(wanted > upper) - int(wanted < lower)
        if recorded and cut != mode.cut[k]:
            self._record(state.t, i, "saturates" if cut else "unsaturates")
        mode.cut[k] = cut
        return float(np.clip(wanted, lower, upper))

    def _cuts(self, state: State, recorded: bool) -> None:
        """The cuts of all continuous servos, from the state: at the start, and after a jump of the rates."""
        for i, (law, mode) in enumerate(zip(self.laws, self.modes, strict=True)):
            for k, servo in enumerate(law.servos):
                if servo.period is None:
                    self._cut(state, i, k, recorded)
                    mode.region[k] = self._region(servo, float(state.rate[i]), mode)

    def _tick(self, state: State, recorded: bool) -> None:
        """Evaluate the sampled servos that are due."""
        for i, k in self.ticks.get(state.t, ()):
            waiting = self.modes[i].waiting
            waiting[k] = [*waiting[k], self._cut(state, i, k, recorded)][-2 - self.laws[i].servos[k].delay:]

    # --- the loop

    def _begin(self) -> State:
        """The initial state with its modes."""
        p, q, still = self.problem, np.array([law.start for law in self.laws]), np.zeros((1, self.problem.n, 3))
        row = Solution(self.t[:1], p.x[None], p.R[None], p.v[None], p.w[None], still, still, np.zeros((1, 0)),
                       Status.SUCCESS, NO_STEPS, "", 0.0)
        state = self._stretch(row, State(float(self.t[0]), p.x, p.R, p.v, p.w, q, q), [-1] * len(q)).state(0)
        for i, (law, mode) in enumerate(zip(self.laws, self.modes, strict=True)):
            self._begin_law(state, i, law, mode)
        self._tick(state, recorded=False)
        self._cuts(state, recorded=False)
        if any(mode.held for mode in self.modes):
            self._choose_modes(state, set(range(len(self.laws))))
        return state

    @staticmethod
    def _begin_law(state: State, i: int, law: Law, mode: Mode) -> None:
        rate = 0.0 if abs(state.rate[i]) <= SETTLED else float(state.rate[i])
        if law.stops is not None:
            for side in (-1, 1):
                gap = side * (law.stops.edge(side) - state.q[i])
                near = 1e-10 * max(1.0, abs(state.q[i]))
                if law.stops.stiffness is not None and gap < 0:
                    force = -law.stops.stiffness * gap + law.stops.damping * side * rate
                    mode.stop, mode.pushes = side, bool(force > 0)
                elif law.stops.stiffness is None and gap < -near:
                    raise ArgumentError(f"joint {law.joint} starts beyond its stop at {law.stops.edge(side):g}")
                elif law.stops.stiffness is None and gap <= near and side * rate >= 0:
                    mode.stop, mode.held = side, rate == 0.0
        if law.static and rate == 0.0:
            mode.held = True
        elif law.static:
            mode.sign = 1 if rate > 0 else -1

    def integrate(self) -> Solution:
        """Integrate over all output times.

        Raises
        ------
        IntegrationError
            The method failed within a piece, or the laws chatter; it holds the trajectory so far.
        """
        state, here, ahead, changes = self._begin(), 0, 4, 0
        for i, mode in enumerate(self.modes):  # a rate that leads into a stop at the start
            if mode.stop and not mode.held and self.laws[i].stops.stiffness is None:  # type: ignore[union-attr]
                state = self._change(state, ("hits", i, mode.stop))
        self.events.clear()  # the start is no event
        while here < len(self.grid):
            chosen = self._ahead(here, ahead)
            times = np.concatenate(self.grid[here:here + chosen])
            times = times[times > state.t + NEAR * max(1.0, abs(state.t))]
            s = self._run(state, times)
            crossed = self._first(s)
            last = len(s.solution.t) - 1 if crossed is None else crossed[0] - 1
            self._keep(s, *range(last + 1))
            _took(s, last)
            if crossed is None and s.solution.status not in (Status.SUCCESS, Status.CONSTRAINTS_OPEN):
                self._fail(s.solution.status)
            before, state = state, s.state(last)
            self._turn(s, last)
            if crossed is None:
                ahead = min(2 * ahead, AHEAD)
            else:
                ahead = max(1, ahead // 2)
                changes = 1 if state.t > before.t + NEAR * max(1.0, abs(before.t)) else changes + 1
                state = self._cross(state, float(s.solution.t[crossed[0]]), crossed[1])
            while here < len(self.grid) and self.grid[here][-1] <= state.t:
                here += 1
            if state.t > before.t:
                self._tick(state, recorded=True)
            if changes > CHATTER:
                self._fail(Status.STEP_TOO_SMALL, "changes of friction and stops follow each other without end: "
                           "the motion has no unique continuation from here on")
        if len(self.rows) < len(self.t):  # the last output is at a sample
            s = self._run(state, np.array([state.t + SHORT * max(1.0, abs(state.t))]))
            self._keep(s, 0)
            _took(s, 0)
        return self._whole(Status.SUCCESS)

    def _ahead(self, here: int, most: int) -> int:
        """Number of intervals to the next sample of a servo, at most `most`."""
        for count in range(1, most):
            if here + count >= len(self.grid) or float(self.grid[here + count - 1][-1]) in self.ticks:
                return count
        return min(most, len(self.grid) - here)

    def _cross(self, state: State, until: float, key: Key) -> State:
        """The state after the change at a crossing between a state and a later time."""
        if self.located or key[0] in ("hits", "leaves"):
            state, key = self._crossing(state, until, key)
            if key[0] == "hits" and (stops := self.laws[key[1]].stops) is not None:
                state.q[key[1]] = stops.edge(key[2])
        return self._change(state, key)

    def _turn(self, s: Stretch, row: int) -> None:
        """Carry the angles of the problem's own springs on, over whole turns."""
        for k, spring in self.springs.items():
            self.angles[k] = float(_continued(spring.start_angle(s.solution.R[:row + 1]), self.angles[k])[-1])

    def _keep(self, s: Stretch, *rows: int) -> None:
        """Remember the rows of a stretch that are asked for; at a sample of a servo that from which its value acts."""
        for row in rows:
            t = float(s.solution.t[row])
            if t in self.t[len(self.rows):len(self.rows) + 1] and (row == 0 or t not in self.ticks):
                self.rows.append((s.solution, row))

    def _whole(self, status: Status) -> Solution:
        """The solution at the output times that were reached."""
        last, stats = self.rows[-1][0], _together(self.stats)
        stats.wall_time = time.perf_counter() - self.begun
        arrays: dict[str, Any] = {name: np.array([getattr(s, name)[row] for s, row in self.rows])
                                  for name in ("t", "x", "R", "v", "w", "a", "alpha", "lam")}
        return Solution(**arrays, status=status, stats=stats, method=last.method, t_end=float(arrays["t"][-1]),
                        events=tuple(self.events))

    def _fail(self, status: Status, why: str = "") -> None:
        raise IntegrationError(status, why or status.advice, self._whole(status))


def _continued(angles: np.ndarray, first: float) -> np.ndarray:
    """Angles over whole turns, of which the first is nearest to this one."""
    path = np.unwrap(angles)
    return np.asarray(path + 2 * np.pi * round((first - path[0]) / (2 * np.pi)))


def held_range(law: Law, mode: Mode) -> tuple[float, float]:
    """The forces along a coordinate that may hold it: friction either way, and a stop that pushes back."""
    return (-math.inf if mode.stop > 0 else -law.static), (math.inf if mode.stop < 0 else law.static)


def _acting_on(i: int, rates: dict[int, np.ndarray]) -> list[int]:
    """The coordinates that impulses along coordinate i move, directly or over each other, of those whose are given."""
    group = [i]
    for k in group:
        group += [j for j in rates if j not in group
                  and abs(rates[k][j]) > COUPLED * math.sqrt(rates[k][k] * rates[j][j])]
    return group


def _pushes(S: np.ndarray, speeds: np.ndarray) -> np.ndarray:
    """Impulses n >= 0 that leave no speed S n + speeds below zero, each zero or its speed: by K. G. Murty's rule of the
    least index, Opsearch 11 (1974) 123."""
    acting, tiny = speeds < 0.0, 1e-12 * float(np.abs(speeds).max())
    while True:
        n = np.zeros(len(speeds))
        n[acting] = np.linalg.lstsq(S[np.ix_(acting, acting)], -speeds[acting], rcond=None)[0]
        wrong = np.where(acting, n < 0.0, S @ n + speeds < -tiny)
        if not wrong.any():
            return n
        acting[wrong.argmax()] ^= True


def _took(s: Stretch, last: int) -> None:
    """Count the steps of a stretch after row `last` as rejected: they were taken in vain."""
    t, stats = s.solution.t, s.solution.stats
    kept = round(stats.steps * float((t[last] - t[0]) / (t[-1] - t[0]))) if last else 0
    stats.rejected_steps += stats.steps - kept
    stats.steps = kept


def _together(runs: list[Stats]) -> Stats:
    """The counters of several runs together, and the largest of their maxima; laws do work, so energy is left out."""
    counts = ("steps", "rejected_steps", "force_evaluations", "newton_iterations", "factorizations")
    return dataclasses.replace(
        runs[0], **{name: sum(getattr(run, name) for run in runs) for name in counts},
        most_iterations=max(run.most_iterations for run in runs),
        step=max((run.step for run in runs if run.step is not None), default=None),
        maxima={key: max(run.maxima[key] for run in runs) for key in runs[0].maxima if key != "energy_error"})


def _functions(problem: Problem) -> Iterator[TimeFunction]:
    """All functions of time of a problem."""
    drives = [joint.drive for joint in problem.joints if joint.drive is not None]
    for item in (*problem.forces, *drives, *(servo for law in problem.laws for servo in law.servos)):
        yield from (each for each in vars(item).values() if isinstance(each, TimeFunction))


def _dips(t: np.ndarray, value: np.ndarray, slope: np.ndarray) -> np.ndarray:
    """(T - 1,) whether a cubic through values and slopes falls below 0 between two times with values above."""
    h, f0, f1, d0, d1 = np.diff(t), value[:-1], value[1:], slope[:-1], slope[1:]
    turning = (f0 > 0) & (f1 > 0) & (d0 < 0) & (d1 > 0)
    if not turning.any():
        return turning
    z = np.linspace(0.0, 1.0, 33)[1:-1, None]
    cubic = ((1 + 2 * z) * (1 - z) ** 2 * f0 + z * (1 - z) ** 2 * h * d0 + z ** 2 * (3 - 2 * z) * f1
             - z ** 2 * (1 - z) * h * d1)
    dips: np.ndarray = turning & (cubic.min(axis=0) < 0)
    return dips

