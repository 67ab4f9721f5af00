"""Accelerations of a scene with altered parameters, and with a few terms that no scene has.

The geometry does not depend on the parameters. What is expensive is computed once per set of states, and an altered
model takes one batched solve: M du/dt = f - G^T lam with G du/dt = -gamma (index 1). For soft joints G du/dt is the
observed one, which leaves the constraint forces free, whatever their law.
"""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Mapping
from typing import Any

import numpy as np

from crosscheck.scene import mechanics
from crosscheck.scene.armature import rate_row
from crosscheck.scene.constraints import Constraints
from crosscheck.scene.coordinates import history
from crosscheck.scene.functions import TimeFunction
from crosscheck.scene.model import GROUND, Force, Scene
from crosscheck.scene.states import States
from crosscheck.scene.vectors import cross

BENT = 4
"""Number of samples on either side of a kink whose nine-point differences it affects."""

SPRINGS = ("linear_spring", "torsional_spring", "slide_spring")

Still = Mapping[tuple[str, int], float]
"""Rotor inertias (kg m^2 or kg) by joint and number of its coordinate."""


@dataclasses.dataclass(frozen=True)
class Physics:
    """Parameters of a model of n bodies. E copies of a scene may have inertias of their own."""

    gravity: np.ndarray  # (3,)
    masses: np.ndarray  # (n,)
    inertias: np.ndarray  # (E, n, 3, 3)
    stiffness: np.ndarray  # per load of the scene, as the next three; zero where it is no spring
    rest: np.ndarray  # free length, rest position (m) or rest angle (rad)
    damping: np.ndarray
    load: np.ndarray  # factor of loads, of torques and forces along joints, and of rest angles that depend on time
    joint_damping: float = 0.0  # N m s/rad, on the relative angular velocity across every joint
    drag: float = 0.0  # 1/s: force - drag m v on every body
    spin_drag: float = 0.0  # 1/s: torque - spin_drag J w on every body
    quadratic: float = 0.0  # 1/m: force - quadratic m |v| v on every body
    wind: np.ndarray | float = 0.0  # (3,) m/s, of the air in which bodies are slowed
    coulomb: float = 0.0  # N m: a moment of this size against the relative angular velocity across every joint
    gyroscopic: Any = 1.0  # factor of w x J w, a number or one per body
    centripetal: float = 1.0  # factor of gamma in G du/dt + gamma = 0
    lever: np.ndarray | None = None  # per force, factor of its moments about the centres of mass; None: one
    point: tuple[int, np.ndarray] | None = None  # number of a force, and displacement (m) of its point on the child
    reframed: tuple[int, ...] = ()  # numbers of loads whose components are taken in the other axes: body or world
    absent: int | None = None  # number of a body that the model does not have
    delay: np.ndarray | None = None  # s, of the function of time of each force; None: none
    phase: np.ndarray | None = None  # rad, per force, added to every sine; None: none
    rotors: Still = dataclasses.field(default_factory=dict)
    gain: tuple[float, float] = (0.0, 0.0)  # alpha (1/s), beta^2 (1/s^2): G du/dt + gamma = -2 alpha G u - beta^2 Phi

    def replace(self, **changes: object) -> Physics:
        """A copy with some entries changed."""
        return dataclasses.replace(self, **changes)  # type: ignore[arg-type]

    @property
    def pushes(self) -> bool:
        """Whether damping, drag or friction that the scene does not have would drive its motion, as none does."""
        return min(self.joint_damping, self.drag, self.spin_drag, self.quadratic, self.coulomb) < 0.0


def of_scene(scene: Scene, copies: int = 1) -> Physics:
    """The parameters of a scene, for so many copies."""
    given = [force.parameters for force in scene.loads]
    rest = [next((p[key] for key in ("free_length", "rest_angle", "rest_position") if key in p), 0.0) for p in given]
    return Physics(scene.gravity, scene.masses, np.broadcast_to(scene.inertias, (copies, scene.n, 3, 3)),
                   np.array([p.get("stiffness", 0.0) for p in given]),
                   np.array([0.0 if isinstance(value, TimeFunction) else value for value in rest]),
                   np.array([p.get("damping", 0.0) for p in given]), np.ones(len(given)),
                   rotors={(joint.name, k): value for joint in scene.joints for k, value in enumerate(joint.armature)})


def levers(scene: Scene) -> np.ndarray:
    """From the centre of mass of each body to the joint that carries it, (n, 3), m, body axes; zero without a joint."""
    arms = np.zeros((scene.n, 3))
    for joint in scene.joints:
        if joint.child != GROUND and not arms[joint.child].any():
            arms[joint.child] = joint.child_anchor
    return arms


@dataclasses.dataclass
class Points:
    """States at P instants of copies with one joint structure, and the accelerations that were observed there."""

    x: np.ndarray  # (P, n, 3)
    R: np.ndarray
    v: np.ndarray
    w: np.ndarray
    rates: np.ndarray  # (P, n, 6) observed accelerations: world, body axes
    copy: np.ndarray  # (P,) number of the copy of the scene
    angles: dict[str, np.ndarray]  # of torsional springs, by joint
    t: np.ndarray | float = 0.0  # (P,) s


class Terms:
    """What does not depend on the parameters at a set of states.

    `forces` are the numbers of its loads in the scene to which the parameters belong.
    """

    def __init__(self, scene: Scene, points: Points, forces: tuple[int, ...],
                 constraints: Constraints | None = None, rank: int | None = None) -> None:
        self.scene, self.points, self.index = scene, points, forces
        x, R, v, w = points.x, points.R, points.v, points.w
        self.constraints = constraints = constraints or Constraints(scene)
        self.G = constraints.jacobian(x, R).reshape(len(x), constraints.m, scene.n, 6)
        self.gamma = constraints.gamma(x, R, v, w, points.t)
        self.springs = [_spring(scene, force, points) for force in scene.loads]
        self.friction, self.rubbing = _joint_friction(scene, R, w), _joint_friction(scene, R, w, unit=True)
        self._spinning: tuple[np.ndarray, np.ndarray, np.ndarray] | None = None
        self._kept: tuple[tuple[object, ...], tuple[np.ndarray, ...]] | None = None
        self.rank = _rank(self.G[0], scene.masses, scene.inertias) if rank is None else rank

    @functools.cached_property
    def reversing(self) -> np.ndarray:
        """Whether a velocity reverses near an instant, (P,), so that friction has a kink in reach of the differences.

        If nearly all instants were such, none is.
        """
        reverses = np.zeros(len(self.points.x), dtype=bool)
        again = self.points.copy[1:] == self.points.copy[:-1]
        for u in (self.points.v, self.rubbing[:, :, 3:]):
            along = np.einsum("pni,pni->pn", u[1:], u[:-1])
            sizes = np.linalg.norm(u[1:], axis=2) * np.linalg.norm(u[:-1], axis=2)
            for k in np.flatnonzero(again & (along < 0.5 * sizes).any(axis=1)):
                near = slice(max(0, k + 1 - BENT), k + 1 + BENT)
                reverses[near] |= self.points.copy[near] == self.points.copy[k]
        return reverses if reverses.mean() <= 0.8 else np.zeros_like(reverses)

    def forces(self, p: Physics) -> np.ndarray:
        """The generalised forces f, (P, n, 6): N in world axes, N m in body axes."""
        v, spin, turning = self.points.v, *self._spins(p)
        f = np.empty((*v.shape[:2], 6))
        v = v - p.wind
        slowed = p.drag + p.quadratic * np.linalg.norm(v, axis=2, keepdims=True)
        f[:, :, :3] = p.masses[:, None] * (p.gravity - slowed * v)
        f[:, :, 3:] = -np.asarray(p.gyroscopic).reshape(-1, 1) * turning - p.spin_drag * spin
        for here, force, spring in zip(self.index, self.scene.loads, self.springs, strict=True):
            if p.point is not None and p.point[0] == here:
                spring = _spring(self.scene, force, self.points, p.point[1])
            if here in p.reframed:
                other = "world" if force.parameters["frame"] == "body" else "body"
                turned = dataclasses.replace(force, parameters={**force.parameters, "frame": other})
                spring = _spring(self.scene, turned, self.points)
            kind, unit, length, rate, ends = spring
            if p.absent is not None and p.absent in ends:
                continue
            varied = self._varied(p, here, force)
            if kind in SPRINGS:
                rest = p.load[here] * varied if force.functions else p.rest[here]
                size = p.stiffness[here] * (length - rest) + p.damping[here] * rate
                pull = size[:, None, None] * unit
            else:
                pull = np.reshape(p.load[here] * varied, (-1, 1, 1)) * unit
            f += pull
            if p.lever is not None and kind in ("linear_spring", "constant_force"):
                f[:, :, 3:] += (p.lever[here] - 1.0) * pull[:, :, 3:]
        if p.coulomb:
            f += p.coulomb * self.rubbing
        return f + p.joint_damping * self.friction if p.joint_damping else f

    def rates(self, p: Physics, soft: bool = False) -> np.ndarray:
        """Accelerations (P, n, 6): m/s^2 in world axes, rad/s^2 in body axes. `soft`: with the observed G du/dt."""
        keep, flat = self._weights(p)[1:3]
        target = p.centripetal * self.gamma[:, keep]
        if soft:
            target = -(flat @ self.points.rates.reshape(len(flat), -1, 1))[..., 0]
        if any(p.gain):
            x, R, v, w = (getattr(self.points, name) for name in "xRvw")
            target = target + (2 * p.gain[0] * self.constraints.velocity(x, R, v, w, self.points.t)
                               + p.gain[1] * self.constraints.position(x, R, self.points.t))[:, keep]
        return self._turning(p, self._bound(p, self.forces(p), target))

    def _bound(self, p: Physics, f: np.ndarray, target: np.ndarray) -> np.ndarray:
        """Accelerations (P, n, 6) under the forces f (P, n, 6) that satisfy G du/dt + target = 0."""
        inverse, _, flat, weighted, solve = self._weights(p)
        free = np.concatenate([f[:, :, :3] / p.masses[:, None], (inverse @ f[:, :, 3:, None])[..., 0]], axis=2)
        if flat.shape[1] == 0:
            return free
        lam = solve @ (flat @ free.reshape(len(f), -1, 1) + target[..., None])
        return np.asarray(free - (np.swapaxes(weighted, 1, 2) @ lam).reshape(free.shape))

    def _turning(self, p: Physics, rates: np.ndarray) -> np.ndarray:
        """The accelerations when rotors turn along: each adds -inertia (S du/dt + s) along its coordinate."""
        moving = [(p.rotors[key], *row) for key, row in self._rotors.items() if p.rotors.get(key)]
        if not moving:
            return rates
        inertias, rows, biases = (np.array(part) for part in zip(*moving, strict=True))
        none = np.zeros((len(rates), self._weights(p)[2].shape[1]))
        columns = np.stack([inertia * self._bound(p, row.reshape(rates.shape), none).reshape(len(rates), -1)
                            for inertia, row in zip(inertias, rows, strict=True)], axis=2)
        S = np.swapaxes(rows, 0, 1)
        along = np.linalg.solve(np.eye(len(inertias)) + S @ columns, S @ rates.reshape(len(rates), -1, 1)
                                + biases.T[..., None])
        return np.asarray(rates - (columns @ along).reshape(rates.shape))

    @functools.cached_property
    def _rotors(self) -> dict[tuple[str, int], tuple[np.ndarray, np.ndarray]]:
        """S (P, 6n) and s (P,) of every coordinate of a joint that has a rate."""
        q = self.points
        return {(joint.name, k): rate_row(joint, word, self.scene, q.x, q.R, q.v, q.w)
                for joint in self.scene.joints if joint.kind.is_elastic
                for k, word in enumerate(joint.kind.coordinates)}

    def _varied(self, p: Physics, here: int, force: Force) -> Any:
        """The function of time of a force at the instants; 1 if it has none."""
        if not force.functions:
            return 1.0
        function = force.functions[0]
        if p.phase is not None:
            shifted = tuple((a, w, phase + p.phase[here]) for a, w, phase in function.terms)
            function = dataclasses.replace(function, terms=shifted)
        return function(self.points.t - (0.0 if p.delay is None else p.delay[here]))

    def _spins(self, p: Physics) -> tuple[np.ndarray, np.ndarray]:
        """J w and w x J w. Like the weights below, they are kept as long as the parameters are the same arrays."""
        if self._spinning is None or self._spinning[0] is not p.inertias:
            inertias, w = p.inertias[self.points.copy], self.points.w
            self._spinning = p.inertias, (inertias @ w[..., None])[..., 0], mechanics.gyroscopic(inertias, w)
        return self._spinning[1], self._spinning[2]

    def _weights(self, p: Physics) -> tuple[np.ndarray, ...]:
        """J^-1, the rows without those of an absent body, G, G M^-1 and the inverse of G M^-1 G^T."""
        key = (p.masses, p.inertias, p.absent)
        if self._kept is None or any(one is not other for one, other in zip(self._kept[0], key, strict=True)):
            keep = self.constraints.rows_without(p.absent)
            G, inverse = self.G[:, keep], np.linalg.inv(p.inertias[self.points.copy])
            W = np.concatenate([G[..., :3] / p.masses[:, None], (G[..., None, 3:] @ inverse[:, None])[..., 0, :]], 3)
            flat, weighted = G.reshape(*G.shape[:2], 6 * G.shape[2]), W.reshape(*G.shape[:2], 6 * G.shape[2])
            S = weighted @ np.swapaxes(flat, 1, 2)
            solve = np.linalg.inv(S) if self.rank == self.constraints.m else self._least_norm(S, p)
            self._kept = key, (inverse, keep, flat, weighted, solve)
        return self._kept[1]

    def _least_norm(self, S: np.ndarray, p: Physics) -> np.ndarray:
        """Pseudo-inverse of G M^-1 G^T with the rank of the start."""
        values, vectors = np.linalg.eigh(S)
        if p.absent is None:
            rank = self.rank
        else:
            rank = int(np.count_nonzero(values[0] > mechanics.RANK_TOLERANCE**2 * values[0].max(initial=0.0)))
        values, vectors = values[:, S.shape[1] - rank:], vectors[:, :, S.shape[1] - rank:]
        inverse: np.ndarray = (vectors / values[:, None]) @ np.swapaxes(vectors, 1, 2)
        return inverse


def _rank(G: np.ndarray, masses: np.ndarray, inertias: np.ndarray) -> int:
    """Number of independent rows of G (m, n, 6), in the metric of the mass matrix."""
    if not len(G):
        return 0
    root = np.linalg.cholesky(np.linalg.inv(inertias))
    scaled = np.concatenate([G[..., :3] / np.sqrt(masses)[:, None], (G[..., None, 3:] @ root)[..., 0, :]], axis=2)
    singular = np.linalg.svd(scaled.reshape(len(G), -1), compute_uv=False)
    return int(np.count_nonzero(singular > mechanics.RANK_TOLERANCE * singular[0]))


def _spring(scene: Scene, force: Force, points: Points,
            off: object = 0.0) -> tuple[str, np.ndarray, np.ndarray, np.ndarray, tuple[Any, ...]]:
    """(type, generalised force of a unit pull or of the load (P, n, 6), length or angle, its rate, bodies).

    `off` is a displacement (m) of the point on the child, in body axes.
    """
    x, R, p = points.x, points.R, force.parameters
    unit = np.zeros((len(x), scene.n, 6))
    none = np.zeros(len(x))
    if force.type == "linear_spring":
        ends = ((force.parent, np.array(p["parent_point"])), (force.child, np.array(p["child_point"]) + off))
        here, there = (np.broadcast_to(s, (len(x), 3)) if body == GROUND else x[:, body] + R[:, body] @ s
                       for body, s in ends)
        length = np.linalg.norm(there - here, axis=1)
        pull = (there - here) / np.where(length > 0, length, 1.0)[:, None]
        for (body, s), along in zip(ends, (pull, -pull), strict=True):
            _push(unit, R, body, s, along)
        bodies: tuple[Any, ...] = (force.parent, force.child)
    elif force.joint is not None:
        joint = next(joint for joint in scene.joints if joint.name == force.joint)
        spring, slides = force.is_spring, force.type in ("joint_force", "slide_spring")
        size = -1.0 if spring else next((value for value in p.values() if not isinstance(value, TimeFunction)), 1.0)
        axis = joint.parent_axis if joint.parent == GROUND else R[:, joint.parent] @ joint.parent_axis
        axis = np.broadcast_to(size * axis, (len(x), 3))
        for body, anchor, along in ((joint.parent, joint.parent_anchor, -axis),
                                    (joint.child, joint.child_anchor, axis)):
            if slides:
                _push(unit, R, body, anchor, along)
            elif body != GROUND:
                unit[:, body, 3:] += np.einsum("pji,pj->pi", R[:, body], along)
        bodies = (joint.parent, joint.child)
        if not spring:
            return force.type, unit, none, none, bodies
        if slides:
            moved = history(scene, joint, States(none, x, R, points.v, points.w)).position
            length = moved if moved.ndim == 1 else moved[:, joint.kind.coordinates.index("slide")]
        else:
            length = points.angles[joint.name]
    else:
        given = np.array(p["force"] if force.type == "constant_force" else p["torque"])
        load = R[:, force.child] @ given if p["frame"] == "body" else np.broadcast_to(given, (len(x), 3))
        if force.type == "constant_force":
            _push(unit, R, force.child, np.array(p["child_point"]) + off, load)
        else:
            unit[:, force.child, 3:] = np.einsum("pji,pj->pi", R[:, force.child], load)
        return force.type, unit, none, none, (force.child,)
    moving = np.concatenate([points.v, points.w], axis=2)
    # The power of a unit pull is minus the rate of the length.
    return force.type, unit, length, -np.einsum("pni,pni->p", moving, unit), bodies


def _push(f: np.ndarray, R: np.ndarray, body: int, s: np.ndarray, force: np.ndarray) -> None:
    """Add a force (P, 3), in world axes, at the point s of a body."""
    if body != GROUND:
        f[:, body, :3] += force
        f[:, body, 3:] += cross(s, np.einsum("pji,pj->pi", R[:, body], force))


def _joint_friction(scene: Scene, R: np.ndarray, w: np.ndarray, unit: bool = False) -> np.ndarray:
    """Generalised force (P, n, 6) of damping at every joint: minus the relative angular velocity.

    `unit`: of a moment of size 1 in that direction.
    """
    f = np.zeros((*w.shape[:2], 6))
    for joint in scene.joints:
        spin = np.einsum("pij,pj->pi", R[:, joint.child], w[:, joint.child])
        if joint.parent != GROUND:
            spin = spin - np.einsum("pij,pj->pi", R[:, joint.parent], w[:, joint.parent])
        if unit:
            size = np.linalg.norm(spin, axis=1, keepdims=True)
            spin = spin / np.where(size > 0.0, size, 1.0)
        if joint.parent != GROUND:
            f[:, joint.parent, 3:] += np.einsum("pji,pj->pi", R[:, joint.parent], spin)
        f[:, joint.child, 3:] -= np.einsum("pji,pj->pi", R[:, joint.child], spin)
    return f
