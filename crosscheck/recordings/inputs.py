"""A tree of hinges and slides under recorded inputs: its flow from many states, with many alterations, at once.

The equations are those of the truth in minimal coordinates, compiled once as a function of arrays whose parameters are
what may be altered. Inputs are no part of what is compiled. Dry friction acts over a step as the force that keeps a
joint at rest, up to its bound.
"""

from __future__ import annotations

import copy
import dataclasses
import functools
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from crosscheck.errors import ArgumentError, Unsupported, install
from crosscheck.recordings.columns import EFFORTS, TARGETS
from crosscheck.recordings.reading import Group
from crosscheck.references.taylor import Taylor
from crosscheck.scene import functions
from crosscheck.scene.alterations import QUANTITIES
from crosscheck.scene.coordinates import at_start
from crosscheck.scene.functions import TimeFunction, at
from crosscheck.scene.model import Force, Scene
from crosscheck.scene.starts import at_coordinates, bodies_at
from crosscheck.scene.vectors import exponential

FAR = 10.0
"""s before its first and after its last value, as long as these hold on."""

SWEEPS, TURNS = 20, 6
"""Of the joints, for the friction of those that rest: each one's depends on the others'; parts of a step, at most."""

COLUMNS, EVERY = 20000, slice(None)
"""States that are advanced at once; all of them."""


@dataclasses.dataclass(frozen=True)
class Signal:
    """One recorded input: its value from each time on, straight lines between the values, or a spline through them."""

    t: np.ndarray
    values: np.ndarray
    between: str = "hold"  # "": held, as far as is known

    @classmethod
    def of(cls, group: Group, t: np.ndarray) -> Signal:
        """That of a group of a recording with these times; a missing value keeps the one before."""
        given = group.values[:, 0]
        times = t if group.t is None else group.t
        known = np.isfinite(given) & np.isfinite(times)
        if (np.diff(times[known]) <= 0).any():
            raise ArgumentError(f"column {group.columns[0]!r}: the times of its clock have to increase")
        return cls(times[known], given[known] * (group.row.gear if group.key in EFFORTS else 1.0), group.row.between)

    @functools.cached_property
    def _integral(self) -> Callable[[np.ndarray], np.ndarray]:
        from scipy.interpolate import CubicSpline, PPoly

        if self.between == "spline":
            return CubicSpline(self.t, self.values).antiderivative()  # type: ignore[no-any-return]
        slopes = np.diff(self.values) / np.diff(self.t) * (self.between == "linear")
        pieces = np.array([[0.0, *slopes, 0.0], [self.values[0], *self.values]])
        return PPoly(pieces, [self.t[0] - FAR, *self.t, self.t[-1] + FAR]).antiderivative()  # type: ignore[no-any-return]

    @functools.cached_property
    def other(self) -> Signal:
        """The values by straight lines, where it is not known whether they are held."""
        return self if self.between else Signal(self.t, self.values, "linear")

    def means(self, edges: np.ndarray) -> np.ndarray:
        """The means between rows of times (T, ...)."""
        return np.asarray(np.diff(self._integral(edges), axis=0) / np.diff(edges, axis=0))

    def within(self, begin: float, end: float) -> TimeFunction:
        """The function of time, as known around an interval."""
        low = max(int(np.searchsorted(self.t, begin, side="right")) - 3, 0)
        part = slice(low, max(int(np.searchsorted(self.t, end)) + 3, low + 4))
        made = getattr(functions, self.between or "hold")
        return made(self.t[part].tolist(), self.values[part].tolist())  # type: ignore[no-any-return]


OF_BODIES, OF_JOINTS, OF_ALL = ([each for each in QUANTITIES if each.of == of] for of in ("body", "joint", ""))


def _with(record: Any, **fields: Any) -> Any:
    """A record with other fields, which may be symbols."""
    made = copy.copy(record)
    vars(made).update(fields)
    return made


class System:
    """A scene and its recorded inputs, in the coordinates of its n joints; alterations are vectors (K,), zero for none.

    Attributes
    ----------
    efforts, targets, target_velocities : of each joint its signal, None where there is none
    measured : (n,) whether an effort is measured, so that its noise is no part of the motion
    names : (what, owner) of each of the K alterations
    least : (K,) the smallest that make sense: no mass, damping, friction or armature is below zero

    Raises
    ------
    Unsupported
        The scene is no tree of hinges and slides, or depends on time by itself.
    """

    def __init__(self, scene: Scene, inputs: Sequence[Group], t: np.ndarray) -> None:
        for joint in scene.joints:
            if not joint.kind.has_one or joint.mimic is not None or joint.drive is not None:
                raise Unsupported(f"joint {joint.name!r}: recorded inputs are for trees of hinges and slides alone")
        if scene.functions:
            raise Unsupported(f"scene {scene.name!r} has functions of time of its own; recorded inputs stand for them")
        signals = {(g.key if g.key not in EFFORTS else "effort", g.owner): Signal.of(g, t) for g in inputs}
        self.efforts, self.targets, self.target_velocities = (
            [signals.get((key, joint.name)) for joint in scene.joints] for key in ("effort", *TARGETS))
        acting = {g.owner for g in inputs if g.key in EFFORTS}  # what its servo gives is among it
        for name, servo in scene.servos.values():
            if servo.period is not None and name not in acting:
                raise Unsupported(f"the servo of joint {name!r} samples every {servo.period:g} s, and a log does not "
                                  "say when; record the effort that it gives")
        self.measured = np.array([("effort_measured", joint.name) in {(g.key, g.owner) for g in inputs}
                                  for joint in scene.joints])
        behind = {g.owner for g in inputs if g.row.side == "link"}  # its friction has acted, and acts no second time
        self.scene = scene.replace(joints=tuple(dataclasses.replace(
            joint, damping=(), dry_friction=(), armature=()) if joint.name in behind else joint
            for joint in scene.joints), sensors=(), forces=tuple(
                force for force in scene.forces if force.type != "servo" or force.joint not in acting))
        self.n = len(scene.joints)
        altered = [(each, owner.name) for owners, every in ((scene.bodies, OF_BODIES), (scene.joints, OF_JOINTS))
                   for owner in owners for each in every] + [(each, "") for each in OF_ALL]
        slides = {joint.name for joint in scene.joints if joint.kind.slides}
        self.names = [(each.what, owner) for each, owner in altered]
        self.units = [each.unit_along(owner in slides) for each, owner in altered]
        self._bodies = len(OF_BODIES) * scene.n
        self._delay = self._bodies + len(OF_JOINTS) * self.n
        self._peaks = np.array([0.0 if each is None else np.abs(each.values).max() for each in self.efforts])
        own = [joint.dry_friction[0] if joint.dry_friction else None for joint in self.scene.joints]
        self._friction = np.array([[0.0 if each is None else each.sliding for each in own],
                                   [0.0 if each is None else max(each.sliding, each.static) for each in own]])
        given = {joint.name: {"damping": sum(joint.damping), "friction": self._friction[0, k], "armature": sum(
            joint.armature)} for k, joint in enumerate(self.scene.joints)}
        self.least = np.array([-1.0 if each.positive else -given.get(owner, {}).get(each.what, np.inf)
                               for each, owner in altered])
        self._compile()

    def _compile(self) -> None:
        """Accelerations as functions of coordinates, rates, efforts; alterations of bodies are parameters."""
        try:
            import heyoka
        except ModuleNotFoundError as error:
            raise Unsupported(f"recorded inputs need {error.name}; {install('heyoka')}") from None
        plain = self.scene.lawless
        forces = tuple(Force(f"joint_{word}", joint.parent, joint.child, joint.name, {word: TimeFunction()})
                       for joint in self.scene.joints for word in [_word(joint)])
        equations, par = Taylor(plain.replace(forces=(*plain.forces, *forces))), heyoka.par
        tree = equations.tree
        links = {link.joint.name: link for link in tree.links if link.joint is not None}
        if len(links) < self.n or len(tree.links) > self.n:
            raise Unsupported(f"scene {self.scene.name!r} has a loop or a body without a joint; recorded inputs are "
                              "for trees of hinges and slides alone")
        own = [links[joint.name] for joint in plain.joints]
        self._signs = np.array([-1.0 if link.body != joint.child and joint.kind.slides else 1.0
                                for link, joint in zip(own, plain.joints, strict=True)])  # see `Taylor._tie`
        self._first = {link.body: 5 * link.body for link in own}
        zero = {-1: [0.0] * 3} | {body: [par[k + 2], par[k + 3], par[k + 4]] for body, k in self._first.items()}
        armature = 5 * self.scene.n
        gravity = armature + self.n

        joints = {joint.name: _with(joint, armature=(sum(joint.armature) + par[armature + k],))
                  for k, joint in enumerate(plain.joints)}

        def altered(link: Any) -> Any:
            first = self._first[link.body]
            return _with(link, mass=link.mass * (1.0 + par[first]),
                         inertia=[[entry * (1.0 + par[first + 1]) for entry in row] for row in link.inertia],
                         inner_anchor=[a - c for a, c in zip(link.inner_anchor, zero[link.parent], strict=True)],
                         outer_anchor=[a - c for a, c in zip(link.outer_anchor, zero[link.body], strict=True)],
                         joint=joints[link.joint.name])

        tree.links = tuple(altered(link) for link in tree.links)
        equations.scene = tree.scene = _with(tree.scene, joints=tuple(joints.values()), gravity=np.array(
            [par[gravity + k] for k in range(3)], dtype=object))
        symbols, pushes = ([heyoka.make_vars(f"{name}{k}") for k in range(size)]
                           for name, size in (("y", len(equations.initial)), ("u", self.n)))
        given = {id(force.parameters[word]): pushes[k] for k, force in enumerate(forces)
                 for word in force.parameters}
        rates = equations._rates(symbols, lambda value: given.get(id(value), value))
        places = [np.concatenate([np.arange(len(symbols))[table[link.body]] for link in own])
                  for table in (tree.coordinates, tree.speeds)]
        begin = at_start(plain)
        self._start = np.array([float(begin[joint.name][0][0]) for joint in plain.joints])
        self._places, self._initial = places, equations.initial
        self._function = heyoka.cfunc([heyoka.expression(0.0) + rates[int(k)] for k in places[1]],
                                      vars=[*symbols, *pushes], compact_mode=True, opt_level=1)

    def parameters(self, altered: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Alterations of joints (N, n, 9), and the parameters of the compiled function."""
        joints = altered[:, self._bodies:self._delay].reshape(-1, self.n, len(OF_JOINTS))
        # The base turns, so that gravity turns the other way in its axes.
        turned = exponential(np.pad(-altered[:, self._delay + 1:self._delay + 3], ((0, 0), (0, 1))))
        gravity = np.einsum("nij,j->ni", turned, self.scene.gravity)
        gravity *= 1.0 + altered[:, self._delay + 3:self._delay + 4]
        bodies = altered[:, :self._bodies].reshape(len(altered), -1, len(OF_BODIES))
        five = np.concatenate([bodies[..., :2] + bodies[..., 5:], bodies[..., 2:5]], axis=2).reshape(len(altered), -1)
        return joints, np.concatenate([five, joints[..., 2], gravity], 1).T.copy()

    def _accelerations(self, q: np.ndarray, v: np.ndarray, u: np.ndarray, joints: np.ndarray, pars: np.ndarray
                       ) -> np.ndarray:
        """(N, n) from coordinates, rates and efforts (N, n), and what `parameters` returns; without laws."""
        state = np.empty((len(self._initial) + self.n, len(q)))
        state[:len(self._initial)] = self._initial[:, None]
        state[self._places[0]] += (self._signs * (q - joints[..., 5] - self._start)).T
        state[self._places[1]] = (self._signs * v).T
        state[len(self._initial):] = (u - joints[..., 0] * v).T
        pars = pars[:self._function.nparams]  # of a balanced wheel on an upright axis gravity is none of them
        return np.asarray(self._signs * self._function(state, pars=np.ascontiguousarray(pars)).T)

    def inputs(self, begin: np.ndarray, edges: np.ndarray, other: bool = False) -> np.ndarray:
        """(T - 1, 3, N, n) mean efforts, set points and their rates between edges (T,) after times (N,), as recorded;
        NaN where a servo has its own. `other`: by straight lines where it is not known whether they are held."""
        made = np.full((len(edges) - 1, 3, len(begin), self.n), np.nan)
        for row, signals in enumerate((self.efforts, self.targets, self.target_velocities)):
            for k, signal in enumerate(signals):
                if signal is not None:
                    made[:, row, :, k] = (signal.other if other else signal).means(begin + edges[:, None])
        made[:, 0] = np.nan_to_num(made[:, 0])
        return made

    @property
    def unsure(self) -> bool:
        """Whether it is not known of an input that it is held from one value to the next."""
        return any(each is not None and not each.between for signals in (
            self.efforts, self.targets, self.target_velocities) for each in signals)

    def pushes(self, t: np.ndarray, q: np.ndarray, v: np.ndarray, given: np.ndarray, joints: np.ndarray) -> np.ndarray:
        """(N, n) what inputs (3, N, n) and servos give, with alterations of joints (N, n, 9)."""
        u = given[0].copy()
        names = [joint.name for joint in self.scene.joints]
        for name, servo in self.scene.servos.values():
            k = names.index(name)
            target, rate = (np.where(np.isnan(row[:, k]), at(own, t), row[:, k])
                            for row, own in zip(given[1:], (servo.target, servo.target_velocity), strict=True))
            stiff, slow = (1.0 + joints[:, k, 6:8]).T * [[servo.proportional], [servo.derivative]]
            wanted = stiff * (target - q[:, k]) + slow * (rate - v[:, k])
            u[:, k] += np.clip(wanted + at(servo.feedforward, t), *servo.bounds(v[:, k]))
        return np.asarray(u)

    def response(self, q: np.ndarray, v: np.ndarray, u: np.ndarray, joints: np.ndarray, pars: np.ndarray
                 ) -> tuple[np.ndarray, np.ndarray]:
        """(accelerations (N, n), their derivatives by efforts (N, n, n)), with what `parameters` returns."""
        a = self._accelerations(q, v, u, joints, pars)
        return a, np.stack([self._accelerations(q, v, u + unit, joints, pars) - a for unit in np.eye(self.n)], 2)

    def flow(self, begin: np.ndarray, start: np.ndarray, span: float, step: float, altered: np.ndarray | None = None,
             halves: np.ndarray | None = None) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """From states (N, 2n) at times (N,): s since then (T,), to `span`, q and v (T, N, n), and the inputs over
        halves of steps (2T - 2, 3, N, n), which are those given if any are; `altered` (N, K)."""
        altered = np.zeros((len(start), len(self.names))) if altered is None else altered
        q, v = np.split(start, 2, axis=1)
        rows, count = [(q, v)], max(1, int(np.ceil(span / step * (1 - 1e-9))))
        halves = self._halves(begin, 0.5 * step * np.arange(2 * count + 1), altered) if halves is None else halves
        of = self._constants(altered)
        for k in range(count):
            q, v = self._advanced(begin + k * step, q, v, halves[2 * k:2 * k + 2], step, of)
            rows.append((q, v))
        return step * np.arange(count + 1), np.stack([q for q, _ in rows]), np.stack([v for _, v in rows]), halves

    def slopes(self, begin: np.ndarray, q: np.ndarray, v: np.ndarray, halves: np.ndarray, step: float,
               altered: np.ndarray, by_start: np.ndarray, which: Sequence[int], sizes: np.ndarray) -> np.ndarray:
        """Derivatives (T, N, 2n, 2n + L) of states and inputs of `flow` by the first state and by L alterations.

        Each step is taken again from states that differ by `by_start` (2n,), and with alterations that differ by
        `sizes` (L,): products of these derivatives hold across the times at which a joint stops or turns around.
        """
        count, N, n, many = len(q) - 1, len(begin), self.n, 2 * self.n + len(which)
        given = np.tile(altered, (many + 1, 1, 1))
        for row, (k, size) in enumerate(zip(which, sizes, strict=True)):
            given[1 + 2 * n + row, :, k] += size
        moved = [(row, self._halves(begin, 0.5 * step * np.arange(2 * count + 1), given[row])) for row in range(
            2 * n + 1, many + 1) if self.names[which[row - 2 * n - 1]][0] in ("delay", "between")]
        shift = np.concatenate([np.zeros((1, 2 * n)), np.diag(by_start), np.zeros((len(which), 2 * n))])
        made, units = [np.concatenate([np.tile(np.eye(2 * n), (N, 1, 1)), np.zeros((N, 2 * n, len(which)))], -1)], (
            np.concatenate([by_start, sizes]))
        chunk = max(1, COLUMNS // (N * (many + 1)))
        for low in range(0, count, chunk):
            steps = np.arange(low, min(low + chunk, count))
            every = (many + 1, len(steps), N)
            x = np.concatenate([q[steps], v[steps]], axis=-1) + shift[:, None, None]
            pushed = np.repeat(np.stack([halves[2 * steps], halves[2 * steps + 1]])[:, None], many + 1, axis=1)
            for row, other in moved:
                pushed[:, row] = np.stack([other[2 * steps], other[2 * steps + 1]])
            pushed = np.moveaxis(pushed, 3, 1).reshape(2, 3, -1, n)
            t = np.broadcast_to(begin + step * steps[:, None], every).ravel()
            of = self._constants(np.repeat(given[:, None], len(steps), axis=1).reshape(-1, given.shape[-1]))
            now = x.reshape(-1, 2 * n)
            after = np.concatenate(self._advanced(t, now[:, :n], now[:, n:], pushed, step, of), 1)
            by = np.moveaxis(after.reshape(*every, 2 * n), 0, -1)
            by = (by[..., 1:] - by[..., :1]) / units
            for each in by:
                last = each[..., :2 * n] @ made[-1]
                last[..., 2 * n:] += each[..., 2 * n:]
                made.append(last)
        return np.stack(made)

    def _halves(self, begin: np.ndarray, edges: np.ndarray, altered: np.ndarray) -> np.ndarray:
        """(T - 1, 3, N, n) as `inputs`, late and by straight lines as altered (N, K)."""
        since, own = np.unique(begin - altered[:, self._delay], return_inverse=True)
        halves, between = self.inputs(since, edges)[:, :, own], altered[:, -1]
        if between.any():
            halves += between[:, None] * (self.inputs(since, edges, True)[:, :, own] - halves)
        return halves

    def _constants(self, altered: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Of alterations (N, K) those of joints, the parameters of the compiled function, and bounds of dry friction
        (2, N, n) in motion and at rest."""
        joints, parameters = self.parameters(altered)
        return joints, parameters, np.maximum(self._friction[:, None] + joints[..., 1], 0.0)

    def _advanced(self, t: np.ndarray, q: np.ndarray, v: np.ndarray, halves: np.ndarray, h: float,
                  of: tuple[np.ndarray, np.ndarray, np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
        """q and v (N, n) one step of h later.

        By Runge and Kutta's method of order 4, over which an input is the straight line with the means of both
        `halves` (2, 3, N, n). A step ends where a joint stops, which its dry friction then holds or turns around, and
        where it breaks away.
        """
        joints, parameters, bounds = of
        if joints[..., 8].any():  # what acts is cut off
            most = np.maximum(1.0 + joints[..., 8], 0.0) * self._peaks
            halves = np.concatenate([np.clip(halves[:, :1], -most, most), halves[:, 1:]], axis=1)
        mean, tilt = 0.5 * (halves[0] + halves[1]), 1.5 * (halves[1] - halves[0])
        mean[0] = (1.0 + joints[..., 3]) * mean[0] + joints[..., 4]
        tilt[0] *= 1.0 + joints[..., 3]
        if not bounds.any():
            free = self._pushed(t, np.zeros(len(q)), h, mean, tilt, joints, parameters)
            q, v, _, _ = _runge_kutta(free, np.full((len(q), 1), h), q, v)
            return q, v
        q, v, bounds, past = q.copy(), v.copy(), bounds.copy(), np.zeros(len(q))
        rows = np.arange(len(q))
        for turn in range(TURNS):
            part = self._pushed(t[rows], past[rows], h, mean[:, rows], tilt[:, rows], joints[rows], parameters[:, rows])
            left, sliding, static = (h - past[rows])[:, None], *bounds[:, rows]
            begun, rub, S = v[rows], -np.sign(v[rows]) * sliding, np.zeros((len(rows), self.n, self.n))
            rests = (begun == 0.0) & (static != 0.0)
            still = np.flatnonzero(rests.any(axis=1))
            stuck = np.zeros(rests.shape, bool)
            if len(still):
                a, S[still] = part(0.0, q[rows[still]], begun[still], still, rub=rub[still], wanted=True)
                rub[still], stuck[still] = _held(a, S[still], rests[still], rub[still], sliding[still], static[still])
            way = np.where(stuck, 0.0, -np.sign(rub))
            rate = functools.partial(part, rub=rub, S=S, stuck=stuck)
            after_q, after_v, first, last = _runge_kutta(rate, left, q[rows], begun)
            after_v[stuck] = 0.0
            until, which = np.ones(len(rows)), np.zeros(len(rows), int)
            for k in range(self.n):
                turned = np.flatnonzero(after_v[:, k] * way[:, k] < 0.0)
                if not len(turned):
                    continue
                found = _zero(begun[turned, k], after_v[turned, k], left[turned, 0] * first[turned, k],
                              left[turned, 0] * last[turned, k])
                sooner = found < until[turned]
                until[turned[sooner]], which[turned[sooner]] = found[sooner], k
            if len(still):
                a = part(1.0, after_q[still], after_v[still], still, rub=rub[still])
                held = rub[still] + _kept(a, S[still], stuck[still])[1]
                grown = np.abs(held) - static[still]
                room = static[still] - np.abs(rub[still])
                breaks = np.where(stuck[still] & (grown > 0.0), room / np.maximum(room + grown, 1e-300), 1.0)
                sooner = breaks.min(axis=1) < until[still]
                until[still[sooner]], which[still[sooner]] = breaks.min(axis=1)[sooner], self.n + breaks.argmin(
                    axis=1)[sooner]
            short = np.flatnonzero(until < 1.0) if turn < TURNS - 1 else np.zeros(0, int)
            if len(short):
                less = (left * until[:, None])[short]
                rate = functools.partial(part, rows=short, until=until[short], rub=rub[short], S=S[short],
                                         stuck=stuck[short])
                after_q[short], after_v[short], _, _ = _runge_kutta(rate, less, q[rows[short]], begun[short])
                after_v[short] = np.where(stuck[short], 0.0, after_v[short])
                stops, loose = (short[(which[short] >= self.n) == far] for far in (False, True))
                after_v[stops, which[stops]] = 0.0
                bounds[1, rows[loose], which[loose] - self.n] = -1.0  # nothing holds it
                past[rows[short]] += less[:, 0]
            q[rows], v[rows] = after_q, after_v
            rows = rows[short]
            if not len(rows):
                break
        return q, v

    def _pushed(self, t: np.ndarray, past: np.ndarray, h: float, mean: np.ndarray, tilt: np.ndarray,
                joints: np.ndarray, parameters: np.ndarray) -> Callable[..., Any]:
        """Accelerations of rows, where a share of what is left of their steps, or of its part `until`, is over, by
        coordinates, rates and dry friction, which keeps what is stuck at rest; with derivatives by efforts if wanted.
        """
        def rate(share: float, q: np.ndarray, v: np.ndarray, rows: Any = EVERY, until: np.ndarray | float = 1.0,
                 rub: np.ndarray | float = 0.0, S: np.ndarray | None = None, stuck: np.ndarray | None = None,
                 wanted: bool = False) -> Any:
            s = past[rows] + share * until * (h - past[rows])
            given = mean[:, rows] + (s / h - 0.5)[:, None] * tilt[:, rows]
            u, own, pars = self.pushes(t[rows] + s, q, v, given, joints[rows]) + rub, joints[rows], parameters[:, rows]
            if wanted:
                return self.response(q, v, u, own, pars)
            a = self._accelerations(q, v, u, own, pars)
            if S is not None and stuck is not None and (still := stuck.any(axis=1)).any():
                a[still] = _kept(a[still], S[still], stuck[still])[0]
            return a

        return rate

    def at_start(self, q: np.ndarray, v: np.ndarray, begin: float, span: float) -> Scene:
        """A scene of its own from one state, under the inputs as functions of time, for truth."""
        given = {joint.name: (q[k:k + 1], v[k:k + 1]) for k, joint in enumerate(self.scene.joints)}
        made = self.scene.replace(bodies=bodies_at(self.scene, at_coordinates(self.scene, given)), joints=tuple(
            dataclasses.replace(joint, start=(float(q[k]),)) for k, joint in enumerate(self.scene.joints)))
        forces = []
        within = {(key, joint.name): signal.within(begin, begin + span).delayed(-begin) for key, signals in (
            ("feedforward", self.efforts), ("target", self.targets), ("target_velocity", self.target_velocities))
            for joint, signal in zip(made.joints, signals, strict=True) if signal is not None}
        for force in made.forces:
            targets = {key: function for (key, name), function in within.items()
                       if force.type == "servo" and name == force.joint and key != "feedforward"}
            forces.append(dataclasses.replace(force, parameters={**force.parameters, **targets}))
        forces += [Force(f"joint_{_word(joint)}", joint.parent, joint.child, joint.name, {
            _word(joint): within["feedforward", joint.name]})
            for joint in made.joints if ("feedforward", joint.name) in within]
        return made.replace(duration=span, samples=2, monitors=(), forces=tuple(forces))

    def positions(self, moved: np.ndarray, start: np.ndarray) -> np.ndarray:
        """(T, n) coordinates from the change of states (T, dimension) of the series of `at_start` since its start."""
        return np.asarray(start + self._signs * moved[:, self._places[0]])


def _word(joint: Any) -> str:
    return "torque" if "turn" in joint.kind.coordinates else "force"


Rate = Callable[..., np.ndarray]


def _runge_kutta(rate: Rate, h: np.ndarray, q: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, ...]:
    """(q, v a step of h (N, 1) later, accelerations at its begin and at its end) of order 4."""
    a1 = rate(0.0, q, v)
    a2 = rate(0.5, q + 0.5 * h * v, v + 0.5 * h * a1)
    a3 = rate(0.5, q + 0.5 * h * v + 0.25 * h * h * a1, v + 0.5 * h * a2)
    a4 = rate(1.0, q + h * v + 0.5 * h * h * a2, v + h * a3)
    return q + h * v + h * h / 6 * (a1 + a2 + a3), v + h / 6 * (a1 + 2 * a2 + 2 * a3 + a4), a1, a4


def _held(a: np.ndarray, S: np.ndarray, rests: np.ndarray, rub: np.ndarray, sliding: np.ndarray, static: np.ndarray
          ) -> tuple[np.ndarray, np.ndarray]:
    """(friction (N, n), which joints it holds) of joints of which some rest, from accelerations without theirs."""
    part, stuck = rub.copy(), rests.copy()
    own = np.einsum("nii->ni", S)
    for _ in range(SWEEPS if rests.shape[1] > 1 else 1):
        last = part.copy()
        for k in range(rests.shape[1]):
            hold = part[:, k] - (a[:, k] + np.einsum("ni,ni->n", S[:, k], part - rub)) / own[:, k]
            stuck[:, k] = rests[:, k] & (np.abs(hold) <= static[:, k])
            part[:, k] = np.where(stuck[:, k], hold, np.where(rests[:, k], np.sign(hold) * sliding[:, k], part[:, k]))
        if np.array_equal(part, last):
            break
    return part, stuck


def _kept(a: np.ndarray, S: np.ndarray, stuck: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(accelerations (N, n) with joints that stay at rest, the friction that this takes)."""
    both = stuck[:, :, None] & stuck[:, None]
    more = np.linalg.solve(np.where(both, S, np.eye(S.shape[1])), np.where(stuck, -a, 0.0)[..., None])
    return np.where(stuck, 0.0, a + (S @ more)[..., 0]), more[..., 0]


def _zero(begin: np.ndarray, end: np.ndarray, first: np.ndarray, last: np.ndarray) -> np.ndarray:
    """Where in a step a rate that changes its sign in it is zero, by a cubic through rates and accelerations."""
    low, high = np.zeros(len(begin)), np.ones(len(begin))
    third, second = 2 * (begin - end) + first + last, 3 * (end - begin) - 2 * first - last
    for _ in range(30):
        s = 0.5 * (low + high)
        here = begin + s * (first + s * (second + s * third))
        after = here * end > 0.0
        low, high = np.where(after, low, s), np.where(after, s, high)
    return high
