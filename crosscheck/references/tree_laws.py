"""Force laws of joints in minimal coordinates: the Taylor series of a scene whose joints stick, stop and saturate.

In every mode the effort of a coordinate q is A + B q + C q' + P w, with w what its servo wants; a coordinate that is
held has the row q'' = 0 instead. The numbers (held, A, B, C, P) of each coordinate are parameters of the equations,
which are compiled once. With efforts f, accelerations are b + S f; where some are held and the others have the efforts
g, the multipliers of all rows follow from

    s_r s_k S_rk f_k + (1 - s_r) f_r = s_r (-b_r - sum of S_ri (1 - s_i) g_i) + (1 - s_r) g_r,    s = 1 if held, else 0.
"""

from __future__ import annotations

import dataclasses
import functools
import itertools
import math
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

import numpy as np

from crosscheck.errors import Unsupported
from crosscheck.references.base import LONGEST, End, Piece, Series, TruthError, polynomial, rounding
from crosscheck.references.generic import Matrix, Number, Vector
from crosscheck.references.joint_motion import joint_angles
from crosscheck.references.modes import AfterEvent, Law, Machine, Mode, Part, laws_of
from crosscheck.references.monitors import Monitors
from crosscheck.references.pieces import Crossing, Label, Values, first_crossing
from crosscheck.references.taylor import SOURCE, Taylor
from crosscheck.scene.functions import Value, at
from crosscheck.scene.model import Scene
from crosscheck.scene.states import States

if TYPE_CHECKING:
    import heyoka

AT_ONCE = 30
"""Most events at one instant."""
INSTANT = 2.0**-52
"""Pieces shorter than this part of the time, or of one second, are no motion: the time has no more digits."""


@dataclasses.dataclass(frozen=True)
class Change:
    """A change of modes: its time in two parts, the piece before it, mode and state before it, and what follows."""

    time: float
    rest: float
    piece: Piece
    length: float
    mode: Mode
    state: np.ndarray
    crossing: Crossing | None  # None: a function of time breaks, or a servo samples
    resumed: AfterEvent


class LawfulTaylor(Taylor):
    """`Taylor` for a scene with force laws."""

    def __init__(self, scene: Scene) -> None:
        self.laws = laws_of(scene)
        self.switches: Sequence[Sequence[Number]] = [(0.0,) * 5 for _ in self.laws]
        super().__init__(scene)
        self.places = [self.place(law) for law in self.laws]
        self.law_units = [self._unit(law, place[2]) for law, place in zip(self.laws, self.places, strict=True)]
        self.machine = Machine(self)
        self.monitors = Monitors(self) if scene.monitors else None
        self._refuse_coupled()
        self._first = sum(1 + max(len(piece) for piece in function.pieces) for function in self.functions)

    def place(self, law: Law) -> tuple[int, int, float, float]:
        """Indices of coordinate and speed in the state, the sign of both, and the coordinate of the law at zero."""
        joint = law.joint
        link = next((link for link in self.tree.links if link.joint is joint), None)
        if link is None:
            raise Unsupported(f"{SOURCE}: joint {joint.name!r} with dry friction, limits or a servo closes a loop")
        k = 0 if law.turns else link.turn
        coordinate, speed = self.tree.coordinates[link.body].start + k, self.tree.speeds[link.body].start + k
        if not law.turns:
            return coordinate, speed, 1.0 if joint.child == link.body else -1.0, 0.0
        return coordinate, speed, 1.0, float(joint_angles(joint, self.tree.start)[0])

    def _unit(self, law: Law, sign: float) -> dict[int, list[float]]:
        """A unit effort of a coordinate, by body, over the angles and displacements of its link."""
        link = next(link for link in self.tree.links if link.joint is law.joint)
        unit = [0.0] * link.scalars
        unit[0 if law.turns else link.turn] = sign
        return {link.body: unit}

    def _refuse_coupled(self) -> None:
        """Raise `Unsupported` where what holds one coordinate holds another one, too: its share would be unknown."""
        holdable = [i for i, law in enumerate(self.laws) if law.friction or law.rigid]
        if len(holdable) < 2:
            return
        S = self.response(0.0, self.initial)[1][np.ix_(holdable, holdable)]
        size = np.sqrt(np.diag(S))
        if not np.linalg.eigvalsh(S / np.outer(size, size))[0] > 1e-9:
            names = ", ".join(dict.fromkeys(repr(self.laws[i].joint.name) for i in holdable))
            raise Unsupported(f"{SOURCE}: the joints {names} have dry friction or rigid stops and depend on each other")

    # What the machine of modes asks for.

    def moving(self, t: np.ndarray, Y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Coordinates and rates, (L, T)."""
        q = np.zeros((len(self.places), len(Y)))
        rate = np.zeros_like(q)
        for i, (coordinate, speed, sign, start) in enumerate(self.places):
            q[i], rate[i] = start + sign * Y[:, coordinate], sign * Y[:, speed]
        return q, rate

    def wanted(self, i: int, t: Number, q: Number, rate: Number, value: Callable[[Value], Number] | None = None
               ) -> Number:
        """What a servo would give without its limits."""
        servo = self.laws[i].servo
        value = value or functools.partial(at, t=t)
        effort = value(servo.feedforward)
        if servo.proportional:
            effort = effort + servo.proportional * (value(servo.target) - q)
        if servo.derivative:
            effort = effort + servo.derivative * (value(servo.target_velocity) - rate)
        return effort

    def bound(self, i: int, part: Part, side: int, rate: Number) -> Number:
        """The limit of a servo on one side, the line of the motor on the side to which it moves."""
        servo = self.laws[i].servo
        limit = servo.effort_limit[1] if side > 0 else servo.effort_limit[0]
        offset, slope = _line(servo.no_load_speed, part.way, side)
        return limit * (offset + slope * rate)

    def push(self, i: int, side: int, q: Number, rate: Number) -> Number:
        """Size of the force of a soft stop, as if it could pull."""
        limits = self.laws[i].limits
        return (limits.stiffness * side * (q - (limits.upper if side > 0 else limits.lower))
                + limits.damping * side * rate)

    def table(self, mode: Mode) -> np.ndarray:
        """(L, 5) numbers (held, A, B, C, P) of a mode."""
        numbers = np.zeros((len(self.laws), 5))
        for row, law, part in zip(numbers, self.laws, mode, strict=True):
            row[0] = part.held
            servo, limits = law.servo, law.limits
            if servo is not None and servo.period is not None:
                row[1] += part.acting
            elif servo is not None and not part.cut:
                row[4] = 1.0
            elif servo is not None:
                limit = servo.effort_limit[1] if part.cut > 0 else servo.effort_limit[0]
                row[[1, 3]] += limit * np.array(_line(servo.no_load_speed, part.way, part.cut))
            if part.pushing:
                end = limits.upper if part.soft > 0 else limits.lower
                row[1:4] += limits.stiffness * end, -limits.stiffness, -limits.damping
            if part.slip:
                row[1] -= law.friction.sliding * part.slip
        return numbers

    def efforts(self, mode: Mode, t: Number, q: Number, rate: Number) -> np.ndarray:
        """All efforts but those that hold, (L,) or (L, T)."""
        values: np.ndarray = np.array([
            A + B * q[i] + C * rate[i] + (P * self.wanted(i, t, q[i], rate[i]) if P else 0.0)
            for i, (_, A, B, C, P) in enumerate(self.table(mode))])
        return values

    def holding(self, mode: Mode, t: np.ndarray, Y: np.ndarray) -> np.ndarray:
        """Efforts that hold, (L, T): what a row takes beyond the other efforts of its coordinate."""
        self.switches = self.table(mode).tolist()
        rhs, S = self._terms(t, Y)
        lam = self._multipliers([*Y.T], functools.partial(at, t=t), [*rhs], [[*row] for row in S])[-len(self.laws):]
        held: np.ndarray = np.array([np.broadcast_to(each, len(t)) for each in lam])
        held = held - self.efforts(mode, t, *self.moving(t, Y))
        return held

    @functools.cached_property
    def _compiled(self) -> heyoka.cfunc_dbl:
        """`_loop_terms` as one function of state, time and parameters: what finds events asks for them most."""
        import heyoka

        symbols = [heyoka.make_vars(f"y{k}") for k in range(len(self.initial))]
        loads, rows, *columns = self._columns(symbols, self._expression)
        rhs, S = self._loop_terms(loads, rows, *columns)
        return heyoka.cfunc([heyoka.expression(each) if isinstance(each, float | int) else each
                             for each in [*rhs, *(entry for row in S for entry in row)]],
                            symbols, compact_mode=True, opt_level=0)

    def _terms(self, t: np.ndarray, Y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Right side (n, T) and response (n, n, T) of all multipliers' equations in states (T, dimension)."""
        given = np.array([self._piece_values(float(each)) for each in t])[:, :self._compiled.nparams]
        values = self._compiled(np.ascontiguousarray(Y.T), time=t, pars=np.ascontiguousarray(given.T))
        n = math.isqrt(len(values))  # n + n^2 values
        return values[:n], values[n:].reshape(n, n, -1)

    def response(self, t: float, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """b, S: accelerations of coordinates without efforts of laws, and by unit efforts."""
        rhs, S = (each[..., 0] for each in self._terms(np.array([t]), y[None]))
        n = len(rhs) - len(self.laws)
        closing = S[n:, :n] @ np.linalg.pinv(S[:n, :n], rcond=1e-9, hermitian=True)
        return closing @ rhs[:n] - rhs[n:], S[n:, n:] - closing @ S[:n, n:]

    def choose(self, b: np.ndarray, S: np.ndarray, lo: np.ndarray, hi: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(f, a) of the box problem: the first choice of bounds whose solution has the right signs, nothing at bounds
        before everything."""
        size = max(1e-300, float(np.abs(b).max(initial=0.0)))
        for choice in sorted(itertools.product((0, -1, 1), repeat=len(b)), key=np.count_nonzero):
            sides = np.array(choice, int)
            f = np.where(sides < 0, lo, np.where(sides > 0, hi, 0.0))
            if not np.isfinite(f).all():
                continue
            inside = np.flatnonzero(sides == 0)
            f[inside] = np.linalg.solve(S[np.ix_(inside, inside)], -(b + S @ f)[inside])
            a = b + S @ f
            a[inside] = 0.0
            width = 1e-11 * np.maximum(1e-300, np.abs(f))
            if (f >= lo - width).all() and (f <= hi + width).all() and (sides * a <= 1e-12 * size).all():
                return f, a
        raise TruthError(f"{SOURCE}: {self.scene.name!r}: no mode of its joints is a solution")

    def kicked(self, t: float, y: np.ndarray, impulses: np.ndarray) -> np.ndarray:
        """The state after impulses on the coordinates; loops and mimics stay closed."""
        loads, rows, *columns = self._columns(y.tolist(), functools.partial(at, t=t))
        S, speeding = np.array(self._loop_terms(loads, rows, *columns)[1], float), columns[2]
        n = len(S) - len(self.laws)
        closing = -np.linalg.pinv(S[:n, :n], rcond=1e-9, hermitian=True) @ S[:n, n:] @ impulses
        y = y.copy()
        for k, impulse in enumerate([*closing, *impulses]):
            for link in self.tree.links:
                y[self.tree.speeds[link.body]] += impulse * np.array(speeding[link.body][1 + k], float)
        return y

    def on_surface(self, y: np.ndarray, i: int, q: float | None, rate: float | None) -> np.ndarray:
        """The state with a coordinate or a rate set to what it is but for rounding."""
        y = y.copy()
        coordinate, speed, sign, start = self.places[i]
        if q is not None:
            y[coordinate] = sign * (q - start)
        if rate is not None:
            y[speed] = sign * rate
        return y

    # Equations and steps.

    def integrator(self, tolerance: float | None = None, **options: int) -> heyoka.taylor_adaptive:
        """As `Taylor.integrator`, with the numbers of the mode as parameters."""
        import heyoka

        self.switches = [[heyoka.par[self._first + 5 * i + k] for k in range(5)] for i in range(len(self.laws))]
        return super().integrator(tolerance, **options)

    def _multipliers(self, state: Sequence[Number], value: Callable[[Value], Number], rhs: Vector, S: Matrix
                     ) -> Vector:
        """Multipliers of loops and mimics, and the efforts of all coordinates with laws."""
        n = len(rhs) - len(self.laws)
        s: list[Number] = [1.0] * n
        efforts: list[Number] = [0.0] * n
        for i, (held, A, B, C, P) in enumerate(self.switches):
            coordinate, speed, sign, start = self.places[i]
            q, rate = start + sign * state[coordinate], sign * state[speed]
            effort = A + B * q + C * rate
            if self.laws[i].servo is not None:
                effort = effort + P * self.wanted(i, None, q, rate, value)
            s.append(held)
            efforts.append(effort)
        given = [(1.0 - held) * effort for held, effort in zip(s, efforts, strict=True)]
        size = range(len(rhs))
        switched = [s[r] * (rhs[r] - sum((S[r][k] * given[k] for k in size[n:]), 0.0)) + given[r] for r in size]
        matrix = [[s[r] * s[k] * S[r][k] + ((1.0 - s[r]) if r == k else 0.0) for k in size] for r in size]
        return super()._multipliers(state, value, switched, matrix)

    def _set_pieces(self, t: float) -> None:
        values = [*self._piece_values(t), *np.ravel(self.numbers)]
        self._integrator.pars[:] = values[:len(self._integrator.pars)]  # the last ones may not be used

    @functools.cached_property
    def begin(self) -> End:
        """The start of the scene, in its mode."""
        return self.begun(self.initial)

    def begun(self, initial: np.ndarray, t: float = 0.0, before: Mode | None = None) -> End:
        """A start at time t (s); `before` as of `Machine.begin`."""
        start = self.machine.begin(initial, t, before)
        return End(start.state, t, mode=start.mode, horizon=t if start.cause else math.inf, cause=start.cause)

    def kept(self, initial: np.ndarray, start: End) -> np.ndarray:
        """An initial state near that of a start in which what friction or a stop finds at rest is at rest, too.

        Rounding moves nothing that is at rest, and with static friction such a motion would go on.
        """
        rate = self.moving(np.zeros(1), start.state[None])[1][:, 0]
        for i, part in enumerate(start.mode):
            if part.held or (self.laws[i].friction and rate[i] == 0.0):
                limits = self.laws[i].limits
                end = None if not part.side else limits.lower if part.side < 0 else limits.upper
                initial = self.on_surface(initial, i, end, 0.0)
        return initial

    def advance(self, end: End, until: float, changes: list[Change] | None = None, watched: bool = True
                ) -> tuple[list[Piece], End]:
        """The pieces from an end on, cut at events, and their end; monitors count if `watched` and without `changes`.

        The last piece ends after `until`, so that what is due there has happened. With `changes`, to which those of
        modes are added, it ends at `until`, and what is due there has not happened then.
        """
        exactly = changes is not None
        due = until - rounding(until) if exactly else math.inf
        integrator, pieces = self._integrator, list[Piece]()
        time, mode, events = (end.time, end.rest), end.mode, list(end.events)
        state, horizon, cause, fresh, stalled = end.state, end.horizon, end.cause, True, 0
        longest, last = LONGEST, max([event[0] for event in events], default=0.0)
        while time[0] < until or (not exactly and time[0] <= until + rounding(until)):
            instant = INSTANT * max(1.0, time[0])
            self.numbers = self.table(mode)
            self._set_pieces(time[0])
            integrator.dtime = time
            integrator.state[:] = state
            scheduled = self.machine.next_time(time[0], mode)
            scheduled = math.inf if scheduled >= due else scheduled
            self._step(min(time[0] + longest, scheduled, until if exactly else math.inf))
            length, series = integrator.last_h, integrator.tc.copy()
            surfaces = functools.partial(self._on_step, mode, time, series, np.nextafter(scheduled, 0.0))
            crossing = first_crossing(surfaces, length, instant if fresh else 0.0) if self.laws else None
            if crossing is not None and crossing.graze:
                if time[0] + crossing.after < horizon:
                    horizon, cause = time[0] + crossing.after, self._grazed(crossing.labels[0])
                crossing = None
            resumed, before = None, mode
            if exactly and integrator.dtime[0] >= due:
                integrator.dtime = until, 0.0
            if crossing is not None:
                length = crossing.after
                state = polynomial(series, np.array([length]))[0]
                piece = Piece(*time, length, series, self.numbers.ravel())
                time = _sum(time, length)
                resumed = self.machine.after_event(time[0], state, mode, crossing.labels)
            else:
                piece = Piece(*time, length, series, self.numbers.ravel())
                state, time = integrator.state.copy(), integrator.dtime
                if time[0] >= scheduled:
                    resumed = self.machine.after_event(time[0], state, mode, ())
            if watched and not exactly and self.monitors is not None and piece.start < horizon and piece.length > 0.0:
                fired = self.monitors.first(before, length, functools.partial(polynomial, series),
                                            functools.partial(np.add, piece.start), 0.0 if pieces else instant)
                if fired is not None and piece.start + fired.after < horizon:
                    horizon = piece.start + fired.after
                    cause = f"{fired.what} at {horizon:.4f} s".replace(" 0.", " .")
                    events += [(horizon, fired.name, "touches")] if fired.touches else []
            stalled = 0 if piece.length > instant else stalled + 1
            if stalled > AT_ONCE:
                raise TruthError(f"{SOURCE}: {self.scene.name!r} at t = {time[0]:.6g} s: its modes have no end")
            if piece.length > 0.0:
                pieces.append(piece)
            fresh, longest = resumed is not None, LONGEST
            if resumed is not None:
                longest = min(LONGEST, 2.0 * (time[0] - last) or LONGEST)  # the next event may be as near as the last
                last = time[0]
                if changes is not None:
                    changes.append(Change(*time, piece, length, mode, state, crossing, resumed))
                state, mode = resumed.state, resumed.mode
                events += resumed.events
                if resumed.cause and time[0] < horizon:
                    horizon, cause = time[0], resumed.cause
        return pieces, End(state, *time, mode, tuple(events), horizon, cause)

    def _on_step(self, mode: Mode, time: tuple[float, float], series: np.ndarray, before: float, tau: np.ndarray
                 ) -> Values:
        """Surfaces on a step, all of which is before what is scheduled: a function of time may jump there."""
        return self.machine.surfaces(mode, np.minimum(time[0] + tau, before), polynomial(series, tau))

    def _grazed(self, label: Label) -> str:
        return f"joint {self.laws[label[0]].joint.name!r} grazes a change of its mode"

    def run(self, initial: np.ndarray | None = None, times: np.ndarray | None = None) -> np.ndarray:
        """State vectors (T, dimension) at `times`, by default the scene's output times, from `initial` at t = 0."""
        times = self.scene.t if times is None else times
        start = self.begin if initial is None else self.begun(self.kept(initial, self.begin))
        pieces, _ = self.advance(start, float(times[-1]), watched=False)
        return Series(pieces)(times)

    def dense_states(self, t: np.ndarray, y: np.ndarray, modes: np.ndarray | None = None) -> States:
        """As `Taylor.dense_states`, in the modes (T, 5 L) of these times."""
        assert modes is not None
        self.switches = modes.T.reshape(len(self.laws), 5, len(t))  # type: ignore[assignment]
        return self.states(y, t)


def _line(no_load_speed: float | None, way: int, side: int) -> tuple[float, float]:
    """(offset, slope) over the rate of the share of a limit on one side that a motor has."""
    if no_load_speed is None or way * side < 0:
        return 1.0, 0.0
    return (0.0, 0.0) if abs(way) == 2 else (1.0, -side / no_load_speed)


def _sum(time: tuple[float, float], length: float) -> tuple[float, float]:
    """Time in two parts after a step."""
    total = time[0] + length
    back = total - time[0]
    rest = (time[0] - (total - back)) + (length - back) + time[1]
    return total + rest, rest - ((total + rest) - total)
