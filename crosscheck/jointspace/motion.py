"""The articulated formulation of the truth as a function of small changes, over complex numbers.

A complex step of 1e-30 i has no rounding of a difference: the imaginary part of the result over the step is the
derivative, to rounding. Coordinates of a change: those of the links of the spanning tree, which is a basis for loops
and rolling too; a free turn counts as a small turn in the axes of the body. `JointSpace` are the scene's own, where
every joint is one of the tree. A change of position is made at fixed rates.
"""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from crosscheck.errors import ArgumentError, Unsupported, install
from crosscheck.references import loops
from crosscheck.references.articulated import centripetal
from crosscheck.references.generic import (
    Vector,
    add,
    apply,
    cross,
    quaternion_product,
    scale,
)
from crosscheck.references.taylor import Taylor
from crosscheck.references.tree import FREE, Link
from crosscheck.references.tree_loads import angle_rate
from crosscheck.scene.coordinates import histories, rates, starting
from crosscheck.scene.functions import at
from crosscheck.scene.model import SMOOTH, Scene, quaternion_from_turn
from crosscheck.scene.starts import at_coordinates, bodies_at, started
from crosscheck.scene.states import Motion, States
from crosscheck.scene.vectors import exponential

STEP = 1e-30
"""Its square times anything in a scene is below rounding."""

NONE = 1e-9
"""Part of a scale, or rad, m and per second, below which a number counts as none."""


@dataclasses.dataclass
class Bodies:
    """x, v, a (n, 3) world, R (n, 3, 3), w, alpha (n, 3) body axes, and the values and rates of what closes loops.

    `rates` are the derivatives of the speeds of all links, in the order of the coordinates; `state` is the state vector
    of the formulation.
    """

    x: np.ndarray
    R: np.ndarray
    v: np.ndarray
    w: np.ndarray
    a: np.ndarray
    alpha: np.ndarray
    rates: np.ndarray
    values: np.ndarray
    slopes: np.ndarray
    state: np.ndarray

    @property
    def states(self) -> States:
        """Of the bodies, at one time."""
        return States(np.zeros(1), *(part[None] for part in (self.x, self.R, self.v, self.w, self.a, self.alpha)))


class _Equations(Taylor):
    """The equations without their compiled integrator."""

    def integrator(self, tolerance: float | None = None, **options: int) -> Any:
        """None; nothing is integrated here."""
        return None


def slices(links: Sequence[Link]) -> dict[int, slice]:
    """The places of the coordinates of links in this order, by their bodies."""
    ends = np.cumsum([0, *(link.turn + len(link.directions) + 3 * (link.shift == "free") for link in links)]).tolist()
    return {link.body: slice(*ends[k:k + 2]) for k, link in enumerate(links)}


class TreeSpace:
    """A scene at its start, in the coordinates of its spanning tree.

    Attributes
    ----------
    size : number of coordinates.

    Raises
    ------
    Unsupported
        A link is a rod, whose direction has no coordinates here, or the scene has laws that jump.
    """

    def __init__(self, scene: Scene) -> None:
        if reason := scene.beyond(SMOOTH):
            raise Unsupported(f"derivatives of {scene.name!r}: {reason}")
        try:
            self.equations = _Equations(scene)
        except ModuleNotFoundError as error:
            raise Unsupported(f"derivatives of {scene.name!r} need {error.name}; {install('heyoka')}") from None
        self.scene = scene
        self.links = self.equations.tree.by_body
        rods = [link for link in self.links if link.joint is None and any(
            joint.length and link.body in (joint.parent, joint.child) for joint in scene.joints)]
        if rods:
            name = scene.bodies[rods[0].body].name
            raise Unsupported(f"derivatives of {scene.name!r}: the distance of body {name!r} has no joint coordinates")
        self.slots = slices(self.links)
        self.size = max((each.stop for each in self.slots.values()), default=0)

    @functools.cached_property
    def speeds(self) -> np.ndarray:
        """(size,) at the start."""
        tree = self.equations.tree
        return np.concatenate([self.equations.initial[tree.speeds[link.body]] for link in self.links])

    @functools.cached_property
    def start(self) -> Bodies:
        """The bodies at the start."""
        return self.bodies(np.zeros(self.size), self.speeds)

    def _springs(self, change: np.ndarray) -> list[object]:
        """Changes of the angles of hinges that close loops: their rates, with changes for speeds."""
        tree, state = self.equations.tree, [*self.equations.initial.tolist()]
        for link in self.links:
            state[tree.speeds[link.body]] = [*change[self.slots[link.body]]]
        frames = tree.frames(state)
        placed = tree.world(frames)
        return [angle_rate(joint, frames, placed, k == 1) for joint, k in self.equations.closing]

    def state(self, change: np.ndarray, speeds: np.ndarray) -> list[Any]:
        """The state vector of the formulation."""
        tree, state = self.equations.tree, [*self.equations.initial.tolist()]
        for link in self.links:
            moved, place = [*change[self.slots[link.body]]], tree.coordinates[link.body]
            before = state[place]
            if link.turn == FREE:
                turned = quaternion_product(before[:4], _turn(moved[:3]))
                state[place] = [*turned, *add(before[4:], moved[3:])]
            else:
                state[place] = add(before, moved) if moved else []
            state[tree.speeds[link.body]] = [*speeds[self.slots[link.body]]]
        if self.equations.closing:
            state[tree.size:] = add(state[tree.size:], self._springs(change))
        return state

    def bodies(self, change: np.ndarray, speeds: np.ndarray) -> Bodies:
        """What follows from a change of position and from speeds, which may be complex."""
        return self.at(self.state(change, speeds))

    def at(self, state: list[Any]) -> Bodies:
        """What follows from a state vector of the formulation."""
        equations, n = self.equations, self.scene.n
        loads, alpha, A, speeding = equations._solved(state, functools.partial(at, t=0.0))
        placed = loads.placed or equations.tree.world(loads.frames)
        moved = Bodies(*(np.zeros(shape, complex) for shape in ((n, 3), (n, 3, 3), *[(n, 3)] * 4)),
                       *np.zeros((4, 0)))
        moved.state = np.array(state)
        for body in range(n):
            frame, (R, point, velocity) = loads.frames[body], placed[body]
            pull = add(A[body], cross(alpha[body], frame.lever), centripetal(frame.w, frame.lever))
            moved.R[body], moved.w[body], moved.alpha[body] = R, frame.w, alpha[body]
            moved.x[body] = add(point, apply(R, frame.lever))
            moved.v[body] = add(velocity, apply(R, cross(frame.w, frame.lever)))
            moved.a[body] = apply(R, pull)
        moved.rates = np.array([rate for link in self.links for rate in speeding[link.body]])
        if equations.cuts:
            loads.placed = placed
            rows = [loops.row(cut, loads) for cut in equations.cuts]
            moved.values = np.array([row.value for row, cut in zip(rows, equations.cuts, strict=True) if not cut.slips])
            moved.slopes = np.array([row.rate for row in rows])
        return moved

    @functools.cached_property
    def _near(self) -> list[Bodies]:
        """The bodies a complex step away in each coordinate, then in each speed."""
        steps = STEP * 1j * np.eye(2 * self.size)
        return [self.bodies(step[:self.size], self.speeds + step[self.size:]) for step in steps]

    def derivative(self, function: Callable[[Bodies], Any]) -> tuple[np.ndarray, np.ndarray]:
        """Derivatives of a function of the bodies by coordinates and by speeds at the start, (values, size) each."""
        stacked = np.array([np.imag(np.asarray(function(near), dtype=complex)) / STEP for near in self._near]).T
        return stacked[:, :self.size], stacked[:, self.size:]


class JointSpace(TreeSpace):
    """A scene whose every joint is one of the tree, in the coordinates of `scene.coordinates`.

    Raises
    ------
    Unsupported
        A joint closes a loop, follows another one, is driven, or has no coordinates; the message names it.
    """

    def __init__(self, scene: Scene) -> None:
        super().__init__(scene)
        links = {link.joint.name: link for link in self.links if link.joint is not None}
        for joint in scene.joints:
            reason = ("closes a loop" if joint.name not in links else "follows another one" if joint.mimic is not None
                      else "is driven" if joint.drive is not None
                      else "has no coordinates" if joint.kind.motion and not joint.kind.coordinates
                      else "")
            if reason:
                raise Unsupported(f"{scene.name!r} in joint coordinates: joint {joint.name!r} {reason}")
        order = [*(link for link in self.links if link.joint is None), *(links[joint.name] for joint in scene.joints)]
        sizes = [self.slots[link.body].stop - self.slots[link.body].start for link in order]
        ends = np.cumsum([0, *sizes])
        self.own = {link.body: slice(int(a), int(b)) for link, a, b in zip(order, ends[:-1], ends[1:], strict=True)}

        self.of_joint = {link.joint.name: self.own[link.body] for link in self.links if link.joint is not None}

    @functools.cached_property
    def rates(self) -> np.ndarray:
        """(size,) of the scene's coordinates at the start."""
        return np.asarray(coordinates(self.scene)[1][0])

    def moved(self, q: np.ndarray, v: np.ndarray) -> Scene:
        """The scene with its start changed by q in position and by v in rates, in the order of its coordinates."""
        here = positions(self.scene)
        there = here + q
        for turn in turns(self.scene):
            there[turn] = (Rotation.from_rotvec(here[turn]) * Rotation.from_rotvec(q[turn])).as_rotvec()
        return placed(self.scene, there, self.rates + v)

    @functools.cached_property
    def _from_tree(self) -> np.ndarray:
        """(2 size, 2 size): changes of the tree's coordinates and speeds by those of the scene's and their rates."""
        by_change, by_speed = super().derivative(lambda bodies: of_coordinates(self.scene, bodies.states)[0])
        return np.linalg.inv(np.block([[by_speed, 0 * by_speed], [by_change, by_speed]]))

    def derivative(self, function: Callable[[Bodies], Any]) -> tuple[np.ndarray, np.ndarray]:
        """As that of the tree, but by the coordinates of the scene and their rates."""
        by_q, by_v = np.split(np.concatenate(super().derivative(function), axis=1) @ self._from_tree, 2, axis=1)
        return by_q, by_v

    def accelerations(self, bodies: Bodies) -> np.ndarray:
        """Second derivatives of the scene's coordinates, (size,)."""
        return np.asarray(of_coordinates(self.scene, bodies.states, True)[0])

    @functools.cached_property
    def motions(self) -> np.ndarray:
        """V, (6n, size): body velocities (v world, w body axes) of unit rates."""
        return self.derivative(lambda bodies: np.concatenate([bodies.v, bodies.w], 1).ravel())[1]

    @functools.cached_property
    def mass(self) -> np.ndarray:
        """M, (size, size), with rotors."""
        blocks = self.motions.reshape(self.scene.n, 6, -1)
        M = np.einsum("n,nki,nkj->ij", self.scene.masses, blocks[:, :3], blocks[:, :3])
        M += np.einsum("nki,nkl,nlj->ij", blocks[:, 3:], self.scene.inertias, blocks[:, 3:])
        for link in self.links:
            if link.joint is not None:
                first = self.own[link.body].start
                for k, inertia in enumerate(link.joint.armature):
                    M[first + k, first + k] += inertia
        return np.asarray(M)


def of_coordinates(scene: Scene, states: States, accelerated: bool = False) -> np.ndarray:
    """Rates of the coordinates of the scene, (T, n), or their derivatives, also of joints that close loops."""
    linear, angular = (states.a, states.alpha) if accelerated else (states.v, states.w)
    assert linear is not None
    assert angular is not None
    carried = {joint.child for joint in scene.joints}
    parts = [np.concatenate([linear[:, k], angular[:, k]], axis=1) for k in range(scene.n) if k not in carried]
    parts += [rates(joint, states, accelerated).reshape(len(linear), -1) for joint in scene.joints
              if joint.kind.coordinates]
    return np.asarray(np.concatenate([np.zeros((len(linear), 0)), *parts], axis=1))


def responses(scene: Scene, states: States, accelerated: bool = False) -> np.ndarray:
    """As `of_coordinates`; of a scene without any, such as one that rolls, those of its bodies, (T, 6n)."""
    if scene.coordinates:
        return of_coordinates(scene, states, accelerated)
    pair = (states.a, states.alpha) if accelerated else (states.v, states.w)
    return np.concatenate([np.asarray(part) for part in pair], axis=2).reshape(-1, 6 * scene.n)


def _turn(vector: Vector) -> Vector:
    """The quaternion of a rotation vector; of a complex one, which is small, to first order."""
    if any(isinstance(entry, complex) for entry in vector):
        return [1.0, *scale(0.5, vector)]
    made: Vector = quaternion_from_turn(np.array(vector, dtype=float)).tolist()
    return made


def coordinates(scene: Scene, states: Motion | None = None) -> tuple[np.ndarray, np.ndarray]:
    """q and v, (T, n) each, in the order of `scene.coordinates`, as `placed` takes them. Default: one time, the start.
    """
    states = states or starting(scene)
    carried, count = {joint.child for joint in scene.joints}, len(states.t)
    q, v = [np.zeros((count, 0))], [np.zeros((count, 0))]
    for k in sorted(set(range(scene.n)) - carried):
        q += [states.x[:, k], Rotation.from_matrix(states.R[:, k]).as_rotvec()]
        v += [states.v[:, k], states.w[:, k]]
    for each in histories(scene, states).values():
        ball = each.position.shape[1:] == (4,)
        position = Rotation.from_quat(each.position, scalar_first=True).as_rotvec() if ball else each.position
        q.append(position.reshape(count, -1))
        v.append(each.velocity.reshape(count, -1))
    return np.concatenate(q, axis=1), np.concatenate(v, axis=1)


def checked(scene: Scene, wanted: str, given: Any, number: int, axes: int = 1) -> list[np.ndarray]:
    """So many arrays of finite numbers, all of one shape, the last of up to `axes` axes in the scene's coordinates."""
    try:
        made = [np.array(part, dtype=float) for part in given]
        shape = made[0].shape
        if len(made) != number or any(part.shape != shape or not np.isfinite(part).all() for part in made) or (
                not 1 <= len(shape) <= axes or shape[-1] != len(scene.coordinates)):
            raise ValueError
    except (TypeError, ValueError, IndexError):
        raise ArgumentError(f"{wanted}, in the order of scene.coordinates: {', '.join(scene.coordinates)}") from None
    return made


def positions(scene: Scene) -> np.ndarray:
    """q (n,) at the start; see `placed`."""
    return np.asarray(coordinates(scene)[0][0])


def turns(scene: Scene) -> list[slice]:
    """The places of small turns, of balls and free bodies, among the coordinates."""
    names = scene.coordinates
    return [slice(k, k + 3) for k, name in enumerate(names) if name.endswith(".rx") and names[k + 1:k + 3] == (
        f"{name[:-2]}ry", f"{name[:-2]}rz")]


def angles(scene: Scene) -> np.ndarray:
    """(n,) whether each coordinate is the angle of a joint."""
    free = 6 * (scene.n - len({joint.child for joint in scene.joints}))
    words = (word for joint in scene.joints for word in ("",) * 3 * (joint.kind.is_ball) or
             joint.kind.coordinates)
    return np.array([*[False] * free, *(word.startswith("turn") for word in words)], bool)


def between(scene: Scene, p: np.ndarray, q: np.ndarray) -> np.ndarray:
    """The change from positions p to q, (n,): of balls and free bodies the small turn in their own axes."""
    change = q - p
    for turn in turns(scene):
        first, last = (Rotation.from_rotvec(each[turn]) for each in (p, q))
        change[turn] = (first.inv() * last).as_rotvec()
    return np.asarray(change)


def placed(scene: Scene, q: np.ndarray, v: np.ndarray) -> Scene:
    """The scene with its start at joint coordinates q and rates v, (n,) each, in the order of `scene.coordinates`.

    Of a ball q is a rotation vector: the child is turned by it, in its own axes, from the attitude at zero coordinates.
    Of a free body it is the position, and such a vector for the attitude.
    """
    space = JointSpace(scene.lawless)
    free = [(link.body, space.own[link.body]) for link in space.links if link.joint is None]
    bodies, given = list(scene.bodies), {}
    for k, own in free:
        bodies[k] = dataclasses.replace(bodies[k], position=q[own][:3], attitude=quaternion_from_turn(q[own][3:]),
                                        velocity=v[own][:3], angular_velocity=v[own][3:])
    for joint in scene.joints:
        position = q[space.of_joint[joint.name]]
        ball = joint.kind.is_ball
        given[joint.name] = quaternion_from_turn(position) if ball else position, v[space.of_joint[joint.name]]
    begun = scene.replace(bodies=tuple(bodies))
    return begun.replace(bodies=bodies_at(scene, at_coordinates(begun, given, [k for k, _ in free])), joints=tuple(
        dataclasses.replace(joint, start=tuple(q[space.of_joint[joint.name]].tolist()))
        if joint.kind.coordinates and not joint.kind.is_ball else joint for joint in scene.joints))


def shifted(scene: Scene, change: np.ndarray) -> Scene:
    """The scene with its start moved by (12n,), see `crosscheck.jointspace.derivatives.linearised`; joints may open."""
    pose, speed = change.reshape(2, scene.n, 6)
    return started(scene, scene.x0 + pose[:, :3], scene.R0 @ exponential(pose[:, 3:]), scene.v0 + speed[:, :3],
                   scene.w0 + speed[:, 3:])
