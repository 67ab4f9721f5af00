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
from crosscheck.scene.coordinates import at_start
from crosscheck.scene.functions import TimeFunction, at
from crosscheck.scene.model import Force, Scene
from crosscheck.scene.starts import at_coordinates, bodies_at
from crosscheck.scene.vectors import exponential

FAR = 10.0
"""s before its first and after its last value, as long as these hold on."""

SWEEPS = 20
"""Of the joints, for the friction that acts in a step: each one's depends on the others'."""


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


OF_BODIES = ("mass", "inertia", "centre of mass x", "centre of mass y", "centre of mass z")
OF_JOINTS = ("damping", "friction", "armature", "torque gain", "torque offset", "zero")
OF_ALL = ("delay", "tilt x", "tilt y", "between")
"""What may be altered: mass and inertia relative, the centre of mass in m, body axes; of joints in SI, the gain
relative, the zero of the encoder; the delay of all inputs in s; turns of gravity in rad about axes of the world; and
the part of straight lines in inputs that the log does not tell from held ones."""


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
        self.names = [(what, body.name) for body in scene.bodies for what in OF_BODIES] + [
            (what, joint.name) for joint in scene.joints for what in OF_JOINTS] + [(what, "") for what in OF_ALL]
        self._bodies, joints = 5 * scene.n, 6 * self.n
        self._delay = self._bodies + joints
        own = [joint.dry_friction[0] if joint.dry_friction else None for joint in self.scene.joints]
        self._friction = np.array([[0.0 if each is None else each.sliding for each in own],
                                   [0.0 if each is None else max(each.sliding, each.static) for each in own]])
        given = {joint.name: {"damping": sum(joint.damping), "friction": self._friction[0, k], "armature": sum(
            joint.armature)} for k, joint in enumerate(self.scene.joints)}
        self.least = np.array([-1.0 if what in ("mass", "inertia") else -given.get(owner, {}).get(what, np.inf)
                               for what, owner in self.names])
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

    def accelerations(self, q: np.ndarray, v: np.ndarray, u: np.ndarray, altered: np.ndarray) -> np.ndarray:
        """(N, n) from coordinates, rates and efforts (N, n) of the joints and alterations (N, K); without laws."""
        return self._accelerations(q, v, u, *self._parameters(altered))

    def _parameters(self, altered: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Alterations of joints (N, n, 6), and the parameters of the compiled function."""
        joints = altered[:, self._bodies:self._delay].reshape(-1, self.n, len(OF_JOINTS))
        turned = exponential(np.pad(altered[:, self._delay + 1:self._delay + 3], ((0, 0), (0, 1))))
        gravity = np.einsum("nij,j->ni", turned, self.scene.gravity)
        return joints, np.concatenate([altered[:, :self._bodies], joints[..., 2], gravity], 1).T.copy()

    def _accelerations(self, q: np.ndarray, v: np.ndarray, u: np.ndarray, joints: np.ndarray, pars: np.ndarray
                       ) -> np.ndarray:
        state = np.empty((len(self._initial) + self.n, len(q)))
        state[:len(self._initial)] = self._initial[:, None]
        state[self._places[0]] += (self._signs * (q - joints[..., 5] - self._start)).T
        state[self._places[1]] = (self._signs * v).T
        state[len(self._initial):] = (u - joints[..., 0] * v).T
        pars = pars[:self._function.nparams]  # of a balanced wheel on an upright axis gravity is none of them
        return np.asarray(self._signs * self._function(state, pars=pars).T)

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

    def pushes(self, t: np.ndarray, q: np.ndarray, v: np.ndarray, given: np.ndarray) -> np.ndarray:
        """(N, n) what inputs (3, N, n) and servos give."""
        u = given[0].copy()
        names = [joint.name for joint in self.scene.joints]
        for name, servo in self.scene.servos.values():
            k = names.index(name)
            target, rate = (np.where(np.isnan(row[:, k]), at(own, t), row[:, k])
                            for row, own in zip(given[1:], (servo.target, servo.target_velocity), strict=True))
            wanted = servo.proportional * (target - q[:, k]) + servo.derivative * (rate - v[:, k])
            u[:, k] += np.clip(wanted + at(servo.feedforward, t), *servo.bounds(v[:, k]))
        return np.asarray(u)

    def response(self, q: np.ndarray, v: np.ndarray, u: np.ndarray, altered: np.ndarray
                 ) -> tuple[np.ndarray, np.ndarray]:
        """(accelerations (N, n), their derivatives by efforts (N, n, n))."""
        n, count = self.n, len(q)
        pushed = np.concatenate([u[None], u[None] + np.eye(n)[:, None]]).reshape(-1, n)
        q, v, altered = (np.tile(each, (n + 1, 1)) for each in (q, v, altered))
        made = self.accelerations(q, v, pushed, altered).reshape(n + 1, count, n)
        return made[0], np.moveaxis(made[1:] - made[0], 0, 2)

    def rubbed(self, q: np.ndarray, v: np.ndarray, u: np.ndarray, h: float, altered: np.ndarray) -> np.ndarray:
        """(N, n) the friction that acts in a step of h: what would stop a joint, up to its bound."""
        more = altered[:, self._bodies:self._delay].reshape(-1, self.n, len(OF_JOINTS))[..., 1]
        sliding, static = (np.maximum(each + more, 0.0) for each in self._friction)
        made = np.zeros(q.shape)
        rows = np.flatnonzero(static.any(axis=1))
        if not len(rows):
            return made
        a, S = self.response(q[rows], v[rows], u[rows], altered[rows])
        part, rate, most, least = made[rows], v[rows] / h, static[rows], sliding[rows]
        for _ in range(SWEEPS if self.n > 1 else 1):
            last = part.copy()
            for k in range(self.n):
                own = S[:, k, k]
                free = a[:, k] + np.einsum("ni,ni->n", S[:, k], part) - own * part[:, k]
                stop, hold = -(rate[:, k] + free) / own, -free / own
                before, after = -np.sign(rate[:, k]), -np.sign(free)
                slows = free + own * before * least[:, k]
                until = np.clip(-rate[:, k] / np.where(slows == 0.0, np.inf, slows), 0.0, 1.0)  # it turns around there
                turns = least[:, k] * (until * before + (1.0 - until) * after)
                part[:, k] = np.where(np.abs(stop) > most[:, k], np.sign(stop) * least[:, k],
                                      np.where(np.abs(hold) <= most[:, k], stop, turns))
            if np.array_equal(part, last):
                break
        made[rows] = part
        return made

    def flow(self, begin: np.ndarray, start: np.ndarray, span: float, step: float, altered: np.ndarray | None = None
             ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """From states (N, 2n) at times (N,): s since then (T,), to `span`, q and v (T, N, n); `altered` (N, K).

        Steps of Runge and Kutta's method of order 4, over each of which an input is the straight line with the means of
        both halves.
        """
        altered = np.zeros((len(start), len(self.names))) if altered is None else altered
        q, v = np.split(start, 2, axis=1)
        joints, parameters = self._parameters(altered)
        count, h = max(1, int(np.ceil(span / step * (1 - 1e-9)))), step
        rows = [(q, v)]
        since, own = np.unique(begin - altered[:, self._delay], return_inverse=True)
        which = own
        edges, between = 0.5 * h * np.arange(2 * count + 1), altered[:, -1]
        halves = self.inputs(since, edges)
        if between.any():
            halves, which = halves[:, :, own], np.arange(len(start))
            halves += between[:, None] * (self.inputs(since, edges, True)[:, :, own] - halves)
        means, tilts = 0.5 * (halves[::2] + halves[1::2]), 1.5 * (halves[1::2] - halves[::2])
        gain, offset = 1.0 + joints[..., 3], joints[..., 4]
        for k in range(count):
            t, mean, tilt = begin + k * h, means[k][:, which], tilts[k][:, which]
            mean[0] = gain * mean[0] + offset
            tilt[0] *= gain
            rub = self.rubbed(q, v, self.pushes(t, q, v, mean), h, altered)

            def rate(share: float, q: np.ndarray, v: np.ndarray, t: np.ndarray = t, mean: np.ndarray = mean,
                     tilt: np.ndarray = tilt, rub: np.ndarray = rub) -> np.ndarray:
                given = mean + (share - 0.5) * tilt
                return self._accelerations(q, v, self.pushes(t + share * h, q, v, given) + rub, joints, parameters)

            a1 = rate(0.0, q, v)
            a2 = rate(0.5, q + 0.5 * h * v, v + 0.5 * h * a1)
            a3 = rate(0.5, q + 0.5 * h * v + 0.25 * h * h * a1, v + 0.5 * h * a2)
            a4 = rate(1.0, q + h * v + 0.5 * h * h * a2, v + h * a3)
            q, v = q + h * v + h * h / 6 * (a1 + a2 + a3), v + h / 6 * (a1 + 2 * a2 + 2 * a3 + a4)
            rows.append((q, v))
        return h * np.arange(count + 1), np.stack([q for q, _ in rows]), np.stack([v for _, v in rows])

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


    @property
    def friction(self) -> np.ndarray:
        """(2, n) dry friction of the joints in motion and at rest."""
        return self._friction

    def positions(self, moved: np.ndarray, start: np.ndarray) -> np.ndarray:
        """(T, n) coordinates from the change of states (T, dimension) of the series of `at_start` since its start."""
        return np.asarray(start + self._signs * moved[:, self._places[0]])


def _word(joint: Any) -> str:
    return "torque" if "turn" in joint.kind.coordinates else "force"
