"""Truth by Taylor series (heyoka) in minimal coordinates.

Every scene is a tree of bodies with joint coordinates (`joint_motion`). Accelerations follow by elimination from the
leaves (`articulated`), under springs, dampers and loads (`tree_loads`). A joint that closes a loop adds multipliers
(`loops`); the rank of its rows is found once, at the start. The angle of a hinge that is such a joint is an additional
state; in a joint of the tree it is a coordinate.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from crosscheck.errors import Unsupported
from crosscheck.references import loops
from crosscheck.references.articulated import accelerations, centripetal
from crosscheck.references.base import LONGEST, End, Piece, Series, TruthError
from crosscheck.references.generic import ByBody, Matrix, Number, Vector, add, cross, scale
from crosscheck.references.joint_motion import ZERO, Tree, joint_angles
from crosscheck.references.tree import FREE, unfold
from crosscheck.references.tree_loads import Loads, angle_rate
from crosscheck.scene.functions import TimeFunction, Value, at
from crosscheck.scene.model import Joint, Scene, rotation_from_quaternion
from crosscheck.scene.states import States

if TYPE_CHECKING:
    import heyoka

SOURCE = "Taylor series (heyoka), minimal coordinates"
WINDOW = 8  # number of last coefficients that determine a step; symmetry, as at rest, may make several in a row zero
TOLERATED = 1.02  # relative to a safe step; the remainder grows only by its twentieth power or so
DRIFT = 1e-13  # quaternion norms stay within a few hundred rounding errors; a larger drift is a defect


class Taylor:
    """The compiled Taylor integrator of a scene; `run` may be called with any initial state.

    State vector: that of `Tree`, then the angles of hinges that close loops, and both of each cross that does.
    """

    source = SOURCE

    def __init__(self, scene: Scene) -> None:
        if scene.has_laws and type(self) is Taylor:
            raise Unsupported(f"{SOURCE}: dry friction, limits and servos are not in smooth equations")
        self.scene = scene
        links, closing = unfold(scene)
        self.tree = Tree(scene, links)
        self.cuts = loops.cuts(scene, closing)
        joints = {joint.name: joint for joint in closing}
        self.closing = [(joints[name], k) for name, k in scene.hinges if name in joints]
        self.initial = np.concatenate([self.tree.initial(), self._closing_angles(self.tree.start)])
        if not len(self.initial):  # nothing moves, but the integrator needs a state
            self.initial = np.zeros(1)
        self.driven = {link.body: link.joint.drive.derivative(2) for link in links
                       if link.joint is not None and link.joint.drive is not None and link.joint.child == link.body}
        if len(self.driven) < sum(joint.drive is not None for joint in scene.joints):
            raise Unsupported(f"{SOURCE}: a driven joint closes a loop, or leads from its child to its parent")
        self.functions = [*(function for force in scene.forces for function in force.functions),
                          *self.driven.values()]
        self.rank, self.shift = 0, 0.0
        self.ties = [self._tie(joint) for joint in scene.joints if joint.mimic is not None]
        self.law_units: list[dict[int, list[float]]] = []  # unit efforts of force laws with modes
        self._analyse_loops()

    @functools.cached_property
    def _integrator(self) -> heyoka.taylor_adaptive:
        """Compiled when it is first used: what is stored is evaluated without it.

        Unoptimised it is compiled ten times as fast, which saves more than all of its steps take.
        """
        return self.integrator(compact_mode=True, high_accuracy=True, opt_level=0)

    def integrator(self, tolerance: float | None = None, **options: int) -> heyoka.taylor_adaptive:
        """A compiled Taylor integrator at the initial state; `options` are those of `heyoka.taylor_adaptive`."""
        import heyoka

        symbols = [heyoka.make_vars(f"y{k}") for k in range(len(self.initial))]
        rates = [heyoka.expression(rate) if isinstance(rate, float | int) else rate
                 for rate in self._rates(symbols, self._expression)]
        given = {} if tolerance is None else {"tol": tolerance}
        return heyoka.taylor_adaptive(list(zip(symbols, rates, strict=True)), self.initial.tolist(), **given, **options)

    def _tie(self, joint: Joint) -> dict[int, list[float]]:
        """Factors of the coordinates, by body, whose sum a mimic keeps."""
        assert joint.mimic is not None
        factors = {joint.name: 1.0, joint.mimic.joint: -joint.mimic.ratio}
        tie = {}
        for link in self.tree.links:
            if link.joint is not None and link.joint.name in factors:
                # a slide of the parent from the child is minus that of the child from the parent
                back = link.joint.child != link.body and link.joint.type == "prismatic"
                tie[link.body] = [-factors[link.joint.name] if back else factors[link.joint.name]]
        if len(tie) < 2:
            raise Unsupported(f"{SOURCE}: joint {joint.name!r} or the one that it follows closes a loop")
        return tie

    def _analyse_loops(self) -> None:
        """Relations that stand for the loops where they are linear; else how many of their rows are independent."""
        self.rank = len(self.ties)
        if not self.cuts:
            return
        relations = None if self.driven or self.ties else loops.linear_relations(self.tree, self._gaps, self.initial)
        if relations is not None:
            self.cuts, self.rank = [], len(relations)
            self.ties = [{link.body: relation[self.tree.coordinates[link.body]].tolist() for link in self.tree.links}
                         for relation in relations]
            return
        _, S = self._loop_terms(*self._columns(self.initial.tolist(), functools.partial(at, t=0.0)))
        self.rank = loops.rank(np.array(S))
        if self.rank < len(S):
            self.shift = loops.SHIFT * float(np.trace(np.array(S))) / self.rank

    def _expression(self, value: Value) -> Number:
        """A number or a function of time as a heyoka expression; the coefficients of pieces are run parameters."""
        import heyoka

        if not isinstance(value, TimeFunction):
            return value
        first = sum(_places(function) for function in self.functions[:self.functions.index(value)])
        t, total = heyoka.time - heyoka.par[first], heyoka.expression(0.0)
        for k in reversed(range(_places(value) - 1)):
            total = heyoka.par[first + 1 + k] + t * total
        for amplitude, frequency, phase in value.terms:
            total = total + amplitude * heyoka.sin(frequency * heyoka.time + phase)
        return total

    def _set_pieces(self, t: float) -> None:
        """Set the parameters of the compiled equations for times from t on."""
        if values := self._piece_values(t):
            self._integrator.pars[:] = values

    def _piece_values(self, t: float) -> list[float]:
        """The parameters of `_expression` for times from t on."""
        values: list[float] = []
        for function in self.functions:
            piece = max(int(np.searchsorted(function.breaks, t, side="right")) - 1, 0)
            coefficients = function.pieces[piece]
            values += [function.breaks[piece], *coefficients]
            values += [0.0] * (_places(function) - 1 - len(coefficients))
        return values

    def _columns(self, state: Sequence[Number], value: Callable[[Value], Number]
                 ) -> tuple[Loads, list[loops.Row], ByBody, ByBody, ByBody]:
        """Loads, loop rows, and alpha, A and the derivatives of speeds by body and column."""
        tree = self.tree
        frames = tree.frames(state)
        placed = tree.world(frames) if self.cuts or self.closing or self.scene.loads else {}
        loads = Loads(tree, frames, placed, value)
        for force in self.scene.loads:
            if not force.law.has_modes:
                loads.add(force, self._angle(force.joint if force.law.measure == "angle" else None, state))
        rows = [loops.row(cut, loads) for cut in self.cuts]
        units = [loops.unit_wrenches(row, loads) for row in rows]
        efforts = None
        if pushes := [*self.ties, *self.law_units]:
            still = {link.body: [0.0] * link.scalars for link in tree.links}
            efforts = {body: [none] * (1 + len(units)) + [push.get(body, none) for push in pushes]
                       for body, none in still.items()}
            units += [{link.body: (ZERO, ZERO) for link in tree.links} for _ in pushes]
        wrenches = {link.body: [loads.wrenches[link.body], *(unit[link.body] for unit in units)]
                    for link in tree.links}
        driven = {body: value(function) for body, function in self.driven.items()}
        return loads, rows, *accelerations(tree, frames, wrenches, efforts, driven)

    def _loop_terms(self, loads: Loads, rows: list[loops.Row], alpha: ByBody, A: ByBody,
                    speeding: ByBody) -> tuple[Vector, Matrix]:
        """Right side and response of the multipliers' equations."""
        free = [-1.0 * (loops.acceleration(row, loads, alpha, A, 0) + row.rest) for row in rows]
        S = loops.response(rows, loads, alpha, A)
        pushes = [*self.ties, *self.law_units]
        along = [[sum((factor * rate for body, factors in push.items()
                       for factor, rate in zip(factors, speeding[body][k], strict=True)), 0.0)
                  for k in range(1 + len(rows) + len(pushes))] for push in pushes]
        across = [[line[1 + k] for line in along] for k in range(len(rows))]  # S is symmetric
        return (free + [-1.0 * line[0] for line in along],
                [[*line, *more] for line, more in zip(S, across, strict=True)] + [line[1:] for line in along])

    def _angle(self, name: str | None, state: Sequence[Number]) -> Number:
        """Angle of the joint of that name from the shortest turn of its axis; None if `name` is None."""
        if name is None:
            return None
        joint = self.scene.joint(name)
        for place, (each, _) in enumerate(self.closing):
            if each is joint:
                return state[self.tree.size + place] + joint.zero_angle
        link = next(link for link in self.tree.links if link.joint is joint)
        turned = self.tree.split(link, state, self.tree.coordinates)[0][0]
        return turned + float(joint_angles(joint, self.tree.start)[0]) + joint.zero_angle

    def _solved(self, state: Sequence[Number], value: Callable[[Value], Number]
                ) -> tuple[Loads, ByBody, ByBody, ByBody]:
        """Loads, and alpha, A and the derivatives of speeds by body, with the loops closed."""
        loads, rows, *columns = self._columns(state, value)
        factors = [1.0]
        if self.rank or self.law_units:
            factors += self._multipliers(state, value, *self._loop_terms(loads, rows, *columns))
        closed = ({body: add([0.0] * len(parts[0]), *(scale(factor, part)
                                                      for factor, part in zip(factors, parts, strict=True)))
                   for body, parts in column.items()} for column in columns)
        alpha, A, speeding = closed
        return loads, alpha, A, speeding

    def _multipliers(self, state: Sequence[Number], value: Callable[[Value], Number], rhs: Vector, S: Matrix
                     ) -> Vector:
        """Multipliers of the rows that close loops and of mimics."""
        return loops.multipliers(S, rhs, self.shift)

    def _rates(self, state: Sequence[Number], value: Callable[[Value], Number]) -> list[Number]:
        """d state / dt; `value` evaluates functions of time."""
        loads, _, _, speeding = self._solved(state, value)
        turning = [angle_rate(joint, loads.frames, loads.placed, k == 1) for joint, k in self.closing]
        rates = [*self.tree.rates(state, loads.frames, speeding), *turning]
        return rates or [0.0]

    def closure(self, state: np.ndarray) -> np.ndarray:
        """Values and rates of what closes the loops, of rank 2 `rank`."""
        change = state - self.initial
        tied = [[sum(float(np.dot(factors, change[table[body]])) for body, factors in tie.items()) for tie in self.ties]
                for table in (self.tree.coordinates, self.tree.speeds)]
        return np.concatenate([part for gaps, ties in zip(self._gaps(state), tied, strict=True)
                               for part in (gaps, ties)])

    def _gaps(self, state: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Values and rates of the rows of loops."""
        frames = self.tree.frames(state.tolist())
        loads = Loads(self.tree, frames, self.tree.world(frames))
        rows = [loops.row(cut, loads) for cut in self.cuts]
        return np.array([row.value for row in rows], float), np.array([row.rate for row in rows], float)

    def state_of(self, member: Scene) -> np.ndarray:
        """The state vector of the start of a scene of the same structure, with the whole turns of its hinges."""
        state, own = self.tree.coordinates_of(member)
        return np.concatenate([state, self._closing_angles(own.start, {joint.name: joint for joint in member.joints})])

    def _closing_angles(self, q: dict[int, list[Number]], joints: Mapping[str, Joint] | None = None) -> list[float]:
        """Angles of hinges and crosses that close loops at attitudes q; `joints`: others in their place, by name."""
        angles = [joint_angles(joints[joint.name] if joints else joint, q) for joint, _ in self.closing]
        return [float(each[min(k, len(each) - 1)]) for each, (_, k) in zip(angles, self.closing, strict=True)]

    def follow_angles(self, state: np.ndarray) -> None:
        """Set the angles of hinges that close loops to those of a configuration near the start."""
        frames = self.tree.frames(state.tolist(), moving=False)
        q = {body: frame.q for body, frame in frames.items()}
        change = np.array(self._closing_angles(q)) - self._closing_angles(self.tree.start)
        state[self.tree.size:] += change - 2 * np.pi * np.round(change / (2 * np.pi))

    @property
    def begin(self) -> End:
        """The start of the scene."""
        return End(self.initial)

    def advance(self, end: End, until: float) -> tuple[list[Piece], End]:
        """The pieces from an end to `until` or beyond, and their end.

        They do not depend on `until`: a motion that is prolonged is that of one integration.
        """
        integrator, stops, pieces = self._integrator, self.scene.knots, list[Piece]()
        integrator.dtime = end.time, end.rest
        integrator.state[:] = end.state
        self._set_pieces(end.time)
        while integrator.time < until:
            begin = integrator.dtime
            following = [t for t in stops if t > integrator.time]
            self._step(min([begin[0] + LONGEST, *following[:1]]))
            if following and integrator.time >= following[0]:
                self._set_pieces(following[0])
            pieces.append(Piece(begin[0], begin[1], integrator.last_h, integrator.tc.copy()))
        return pieces, End(integrator.state.copy(), *integrator.dtime)

    def run(self, initial: np.ndarray | None = None, times: np.ndarray | None = None) -> np.ndarray:
        """State vectors (T, dimension) at `times`, by default the scene's output times, from `initial` at the first."""
        times = self.scene.t if times is None else times
        start = self.initial if initial is None else initial
        pieces, _ = self.advance(End(start, float(times[0])), float(times[-1]))
        return Series(pieces)(times) if pieces else np.tile(start, (len(times), 1))

    def _step(self, end: float) -> None:
        """One step, at most `safe_step` long; heyoka's own choice uses only two coefficients."""
        import heyoka

        fine = heyoka.taylor_outcome.success, heyoka.taylor_outcome.time_limit
        integrator = self._integrator
        begin, state = integrator.dtime, integrator.state.copy()
        outcome, _ = integrator.step(end - begin[0] - begin[1], write_tc=True)
        longest = safe_step(integrator.tc)
        if not abs(integrator.last_h) <= TOLERATED * longest:
            integrator.dtime = begin
            integrator.state[:] = state
            outcome, _ = integrator.step(min(longest, end - begin[0] - begin[1]), write_tc=True)
        if outcome not in fine or not np.isfinite(integrator.state).all():
            raise TruthError(f"{SOURCE}: integration of {self.scene.name!r} ended with {outcome}; "
                             "a loop may pass a singular position there, or a spring of some length shrink to nothing")

    def normalised(self, states: np.ndarray) -> np.ndarray:
        """State vectors (T, dimension) with their unit vectors scaled to unit length."""
        states = states.copy()
        for unit in self._unit_vectors():
            states[:, unit] /= np.linalg.norm(states[:, unit], axis=1, keepdims=True)
        return states

    def _unit_vectors(self) -> list[slice]:
        """Slices of the quaternions in a state vector."""
        firsts = (self.tree.coordinates[link.body].start for link in self.tree.links if link.turn == FREE)
        return [slice(first, first + 4) for first in firsts]

    def _checked(self, states: np.ndarray) -> np.ndarray:
        """State vectors with their unit vectors at unit length, (T, dimension)."""
        for unit in self._unit_vectors():
            drift = np.max(np.abs(np.linalg.norm(states[:, unit], axis=1) - 1.0))
            if drift > DRIFT:
                raise TruthError(f"{SOURCE}: unit vectors of {self.scene.name!r} drift by {drift:.1e}")
        return self.normalised(states)

    def pose(self, states: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Positions (T, n, 3) and attitudes (T, n, 3, 3) of state vectors, with unit vectors normalised."""
        frames = self.tree.frames([*self._checked(states).T], moving=False)
        placed = self.tree.world(frames, moving=False)
        x, R = np.empty((len(states), self.scene.n, 3)), np.empty((len(states), self.scene.n, 3, 3))
        for body in range(self.scene.n):
            q = _stack(frames[body].q, len(x))
            R[:, body] = rotation_from_quaternion(q / np.linalg.norm(q, axis=1, keepdims=True))
            x[:, body] = _stack(placed[body][1], len(x))
            x[:, body] += np.einsum("tij,tj->ti", R[:, body], _stack(frames[body].lever, len(x)))
        return x, R

    def states(self, states: np.ndarray, t: np.ndarray | None = None) -> States:
        """States with accelerations from these equations, at times t, by default the output times."""
        t = self.scene.t if t is None else t
        x, attitudes = self.pose(states)
        loads, alpha, A, _ = self._solved([*states.T], functools.partial(at, t=t))
        placed = loads.placed or self.tree.world(loads.frames)
        v, w, a, spin = (np.empty_like(x) for _ in range(4))
        for body in range(self.scene.n):
            frame, velocity = loads.frames[body], placed[body][2]
            own = cross(frame.w, frame.lever)
            pull = add(A[body], cross(alpha[body], frame.lever), centripetal(frame.w, frame.lever))
            turned = [np.einsum("tij,tj->ti", attitudes[:, body], _stack(vector, len(x))) for vector in (own, pull)]
            v[:, body], a[:, body] = _stack(velocity, len(x)) + turned[0], turned[1]
            w[:, body], spin[:, body] = _stack(frame.w, len(x)), _stack(alpha[body], len(x))
        return States(t, x, attitudes, v, w, a, spin, hinges=self._hinges(states))

    def _hinges(self, states: np.ndarray) -> np.ndarray:
        """(T, h) rad: the angles of `scene.hinges`, with their whole turns, of state vectors (T, dimension)."""
        joints = {joint.name: joint for joint in self.scene.joints}
        links = {link.joint.name: link for link in self.tree.links if link.joint is not None}
        columns = []
        for name, k in self.scene.hinges:
            if name in links:  # an angle of the tree counts from the start
                place = self.tree.start_angles(links[name])
                column = 0 if len(place) == 1 else k if links[name].body == joints[name].child else 1 - k
                angle = place[column] + states[:, self.tree.coordinates[links[name].body].start + column]
            else:
                angle = states[:, self.tree.size + self.closing.index((joints[name], k))]
            columns.append(angle)
        return np.array(columns).reshape(-1, len(states)).T

    def dense_states(self, t: np.ndarray, y: np.ndarray, modes: np.ndarray | None = None) -> States:
        """States with accelerations at times t from state vectors (T, dimension)."""
        return self.states(y, t)


def safe_step(tc: np.ndarray) -> float:
    """The step from the last coefficients (dimension, order + 1) (Jorba and Zou, Experimental Mathematics 14, 2005).

    The radius of convergence is the least estimate from the last WINDOW coefficients that are not zero; the factor is
    that of the paper, with which the remainder of the series is below rounding.
    """
    sizes, order = np.abs(tc).max(axis=0), tc.shape[1] - 1
    last = np.arange(order - WINDOW + 1, order + 1)
    last = last[sizes[last] > 0.0]
    if not len(last):
        return math.inf
    radius = float(np.min((max(1.0, sizes[0]) / sizes[last]) ** (1.0 / last)))
    return radius * math.exp(-2.0 - 0.7 / (order - 1))


def _stack(entries: Sequence[Number], length: int) -> np.ndarray:
    """Columns of a vector whose entries are arrays over time or constants, (length, size)."""
    return np.stack([np.broadcast_to(entry, (length,)) for entry in entries], axis=-1)


def _places(function: TimeFunction) -> int:
    """Number of parameters of a function of time: a break and the coefficients of its longest piece."""
    return 1 + max(len(piece) for piece in function.pieces)
