"""A scene as an engine may have it, and its accelerations at given states, by the index-1 equations of that scene.

What a scene can say is altered in the scene. A few terms that no scene has, or can leave out, are factors beside it.
For soft joints G du/dt is the observed one, which leaves the constraint forces free, whatever their law.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from crosscheck.scene import mechanics
from crosscheck.scene.model import GROUND, Body, Force, Joint, Scene
from crosscheck.scene.states import States

BENT = 4
"""Number of samples on either side of a kink whose nine-point differences it affects."""

NONSENSE = 1e6
"""Factor of a mass or an inertia beyond which a fit is on a wrong way."""


@dataclasses.dataclass(frozen=True)
class Model:
    """A scene with altered numbers, and with terms of its equations left out or added."""

    scene: Scene  # the springs of its joints are among its forces
    numbers: tuple[int, ...]  # of its forces among the loads of the scene that is meant
    starts: np.ndarray  # (n, 3, 3) attitudes in which the engine starts
    damped: Mapping[str, float] = dataclasses.field(default_factory=dict)
    """N m s/rad by the name of a joint, on the relative angular velocity across it."""
    drag: float = 0.0  # 1/s: force - drag m v on every body
    spin_drag: float = 0.0  # 1/s: torque - spin_drag J w on every body
    quadratic: float = 0.0  # 1/m: force - quadratic m |v| v on every body
    wind: np.ndarray | float = 0.0  # (3,) m/s, of the air in which bodies are slowed
    coulomb: float = 0.0  # N m: a moment of this size against the relative angular velocity across every joint
    gyroscopic: Any = 1.0  # factor of w x J w, a number or one per body
    centripetal: float = 1.0  # factor of gamma in G du/dt + gamma = 0
    levers: Mapping[int, float] = dataclasses.field(default_factory=dict)
    """By the number of a force, the factor of its moments about the centres of mass."""

    def replace(self, **changes: Any) -> Model:
        """A copy with some entries changed."""
        return dataclasses.replace(self, **changes)

    def altered(self, **changes: Any) -> Model:
        """A copy with some entries of its scene changed."""
        return self.replace(scene=self.scene.replace(**changes))

    def with_bodies(self, change: Callable[[int, Body], dict[str, Any]], among: tuple[int, ...] | None = None) -> Model:
        """A copy in which `change` gives other entries of some bodies, by default of all."""
        return self.altered(bodies=tuple(
            dataclasses.replace(body, **change(k, body)) if among is None or k in among else body
            for k, body in enumerate(self.scene.bodies)))

    def with_joint(self, name: str, change: Callable[[Joint], Joint]) -> Model:
        """A copy with another joint of this name, if it has one."""
        return self.altered(joints=tuple(change(joint) if joint.name == name else joint for joint in self.scene.joints))

    def with_force(self, number: int | None, change: Callable[[Force], dict[str, Any]]) -> Model:
        """A copy in which `change` gives other parameters of the force of this number, if it has it; None: of all."""
        return self.altered(forces=tuple(
            dataclasses.replace(force, parameters={**force.parameters, **change(force)})
            if number is None or here == number else force
            for here, force in zip(self.numbers, self.scene.forces, strict=True)))

    def with_more(self, *forces: Force) -> Model:
        """A copy with forces that the scene does not have."""
        return self.replace(numbers=(*self.numbers, *(-1 for _ in forces))).altered(
            forces=(*self.scene.forces, *forces))

    @property
    def as_scene(self) -> Scene | None:
        """The scene that moves so; None if none does."""
        damped = [(joint, float(size)) for joint in self.scene.joints if (size := self.damped.get(joint.name, 0.0))]
        plain = Model(self.scene, self.numbers, self.starts, {} if damped else self.damped)
        if damped and all(joint.kind.turns for joint, _ in damped):
            return self.replace(damped={}).with_more(*(Force(
                "torsional_spring", joint.parent, joint.child, joint.name, {
                    "stiffness": 0.0, "rest_angle": 0.0, "damping": size}) for joint, size in damped)).as_scene
        return self.scene if all(np.array_equal(getattr(self, field.name), getattr(plain, field.name))
                                 for field in dataclasses.fields(Model)[3:] if field.name != "wind") else None

    def physical(self, right: Model) -> bool:
        """Whether nothing that should slow a motion drives it, as nothing does, and masses make sense."""
        if min(*self.damped.values(), self.drag, self.spin_drag, self.quadratic, self.coulomb, *(
                force.parameters["damping"] for force in self.scene.forces if force.is_spring)) < 0.0:
            return False
        if self.scene.bodies is right.scene.bodies:
            return True
        own, meant, bodies = self.scene, right.scene, ~right.scene.frames
        sizes = np.concatenate([own.masses[bodies] / meant.masses[bodies], (
            np.linalg.eigvalsh(own.inertias[bodies]) / np.linalg.eigvalsh(meant.inertias[bodies])).ravel()])
        return bool(sizes.min() > 1 / NONSENSE and sizes.max() < NONSENSE)


def of_scene(scene: Scene, numbers: tuple[int, ...] | None = None, starts: np.ndarray | None = None,
             absent: int | None = None) -> Model:
    """The model that is meant, without the joints and forces of the body `absent`; `numbers`: as in `Model`."""
    numbers = tuple(range(len(scene.loads))) if numbers is None else numbers
    joints = tuple(dataclasses.replace(joint, stiffness=(), damping=(), rest_position=()) if joint.springs else joint
                   for joint in scene.joints if absent is None or absent not in (joint.parent, joint.child))
    there = {joint.name for joint in joints}
    kept = [k for k, force in enumerate(scene.loads) if absent is None or (
        force.joint in there if force.joint is not None else absent not in (force.parent, force.child))]
    return Model(scene.replace(joints=joints, forces=tuple(scene.loads[k] for k in kept)), tuple(
        numbers[k] for k in kept), scene.R0 if starts is None else starts)


def levers(scene: Scene) -> np.ndarray:
    """From the centre of mass of each body to the joint that carries it, (n, 3), m, body axes; zero without a joint."""
    arms = np.zeros((scene.n, 3))
    for joint in scene.joints:
        if joint.child != GROUND and not arms[joint.child].any():
            arms[joint.child] = joint.child_anchor
    return arms


@dataclasses.dataclass
class Points:
    """States at P instants, and the accelerations that were observed there."""

    x: np.ndarray  # (P, n, 3)
    R: np.ndarray
    v: np.ndarray
    w: np.ndarray
    rates: np.ndarray  # (P, n, 6) observed accelerations: world, body axes
    angles: dict[str, np.ndarray]  # of torsional springs, by joint
    t: np.ndarray | float = 0.0  # (P,) s


class Accelerations:
    """Those of models at a set of states. What joints and bodies give is kept as long as they are the same."""

    def __init__(self, points: Points, index1: mechanics.Index1 | None = None) -> None:
        self.points, self.index1 = points, index1
        self._of_joints: tuple[Any, ...] = None, None
        self._of_bodies: tuple[Any, ...] = None, None

    def forces(self, m: Model) -> np.ndarray:
        """The generalised forces f, (P, n, 6): N in world axes, N m in body axes."""
        p, scene = self.points, m.scene
        f = mechanics.applied_forces(scene, p.x, p.R, p.v, p.w, p.angles, p.t).reshape(*p.v.shape[:2], 6)
        v = p.v - m.wind
        if m.drag or m.quadratic:
            slowed = m.drag + m.quadratic * np.linalg.norm(v, axis=2, keepdims=True)
            f[:, :, :3] -= scene.masses[:, None] * slowed * v
        if m.spin_drag:
            f[:, :, 3:] -= m.spin_drag * (scene.inertias @ p.w[..., None])[..., 0]
        if np.any(m.gyroscopic != 1.0):
            f[:, :, 3:] += (1.0 - np.asarray(m.gyroscopic).reshape(-1, 1)) * mechanics.gyroscopic(scene.inertias, p.w)
        if m.coulomb:
            f += m.coulomb * self.friction(scene)
        if m.damped:
            f += self.friction(scene, m.damped)
        for number, factor in m.levers.items():
            force = scene.forces[m.numbers.index(number)] if number in m.numbers else None
            if force is not None and force.law.measure in ("length", "force"):
                states = States(np.broadcast_to(p.t, len(p.x)), p.x, p.R, p.v, p.w)
                f[:, :, 3:] += (factor - 1.0) * mechanics.force_on_bodies(scene, force, states, p.angles)[:, :, 3:]
        return f

    def __call__(self, m: Model, soft: bool = False) -> np.ndarray:
        """Accelerations (P, n, 6): m/s^2 in world axes, rad/s^2 in body axes. `soft`: with the observed G du/dt."""
        p, scene = self.points, m.scene
        index1 = self.index1
        if index1 is None or index1.scene.joints is not scene.joints or index1.scene.bodies is not scene.bodies:
            alike = index1 is not None and index1.scene.joints is scene.joints
            index1 = self.index1 = mechanics.Index1(scene, index1.constraints if alike and index1 else None)
        if self._of_joints[0] is not scene.joints:
            self._of_joints = (scene.joints, index1.constraints.gamma(p.x, p.R, p.v, p.w, p.t),
                               *index1.rows(p.x, p.R, p.v, p.w))
        _, gamma, G, bias = self._of_joints
        if self._of_bodies[0] is not index1:
            self._of_bodies = index1, index1.solver(G, independent=not index1.closing)
        solve = self._of_bodies[1]
        target = m.centripetal * gamma
        if soft:
            target = -(G[:, :gamma.shape[1], :6 * scene.n] @ p.rates.reshape(len(G), -1, 1))[..., 0]
        rates, _ = solve(self.forces(m).reshape(len(p.x), -1), np.concatenate([target, bias], axis=1))
        return np.asarray(rates.reshape(p.rates.shape))

    def friction(self, scene: Scene, damped: Mapping[str, float] | None = None) -> np.ndarray:
        """Generalised force (P, n, 6) of damping at joints; None: of a moment of size 1 against the turning at all."""
        R, w = self.points.R, self.points.w
        f = np.zeros((*w.shape[:2], 6))
        for joint in scene.joints if damped is None else [each for each in scene.joints if each.name in damped]:
            spin = np.einsum("pij,pj->pi", R[:, joint.child], w[:, joint.child])
            if joint.parent != GROUND:
                spin = spin - np.einsum("pij,pj->pi", R[:, joint.parent], w[:, joint.parent])
            size = np.linalg.norm(spin, axis=1, keepdims=True)
            spin = spin / np.where(size > 0.0, size, 1.0) if damped is None else damped[joint.name] * spin
            if joint.parent != GROUND:
                f[:, joint.parent, 3:] += np.einsum("pji,pj->pi", R[:, joint.parent], spin)
            f[:, joint.child, 3:] -= np.einsum("pji,pj->pi", R[:, joint.child], spin)
        return f

    def reversing(self, scene: Scene) -> np.ndarray:
        """Whether a velocity reverses near an instant, (P,), so that friction has a kink in reach of the differences.

        If nearly all instants were such, none is.
        """
        reverses = np.zeros(len(self.points.x), dtype=bool)
        for u in (self.points.v, self.friction(scene)[:, :, 3:]):
            along = np.einsum("pni,pni->pn", u[1:], u[:-1])
            sizes = np.linalg.norm(u[1:], axis=2) * np.linalg.norm(u[:-1], axis=2)
            for k in np.flatnonzero((along < 0.5 * sizes).any(axis=1)):
                reverses[max(0, k + 1 - BENT):k + 1 + BENT] = True
        return reverses if reverses.mean() <= 0.8 else np.zeros_like(reverses)

