"""A scene elsewhere: what an engine knows of a scene by its name, its place, its order or its clock is of no use there.

The other world is turned and shifted at random, under other names, bodies and joints in another order.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any

import numpy as np

from crosscheck.compare.apart import ROUNDED
from crosscheck.references.modes import Mode, laws_of
from crosscheck.scene.laws import Servo
from crosscheck.scene.model import GROUND, Body, Force, Joint, Scene, Site
from crosscheck.scene.spanning import spanning_tree
from crosscheck.scene.starts import restarted
from crosscheck.scene.states import Motion, States


@dataclasses.dataclass(frozen=True)
class World:
    """A scene elsewhere: turned by Q, then shifted, with bodies and joints renamed and in another order."""

    Q: np.ndarray  # (3, 3)
    shift: np.ndarray  # (3,) m
    bodies: tuple[int, ...]  # the scene's number of each body there
    joints: tuple[int, ...]

    @classmethod
    def drawn(cls, scene: Scene, length: float, turned: bool = True) -> World:
        """A world for the scene. It is not turned where joints to the ground count coordinates in the ground's axes.

        Joints that close loops keep their order: which of them a tree cuts depends on it, and so do its errors.
        """
        from scipy.spatial.transform import Rotation

        rng = np.random.default_rng([scene.n, len(scene.joints), *scene.key.encode()])
        Q = Rotation.random(random_state=rng).as_matrix() if turned and turnable(scene) else np.eye(3)
        shift = length * rng.uniform(-1.0, 1.0, scene.gravity.shape)
        joints = len(scene.joints)
        order = tuple(range(joints)) if spanning_tree(scene)[1] else _mixed(rng, joints)
        return cls(Q, shift, _mixed(rng, scene.n), order)

    def scene(self, scene: Scene) -> Scene:
        """The scene in this world."""
        place = {old: new for new, old in enumerate(self.bodies)} | {GROUND: GROUND}
        names = {joint.name: f"j{new}" for new, joint in enumerate(scene.joints[old] for old in self.joints)}
        return scene.replace(
            name="elsewhere", description="", source="", tags=(), gravity=self.Q @ scene.gravity,
            bodies=tuple(self._body(scene.bodies[old], f"b{new}") for new, old in enumerate(self.bodies)),
            joints=tuple(self._joint(scene.joints[old], place, names) for old in self.joints),
            forces=tuple(self._force(force, place, names) for force in scene.forces),
            sites=tuple(self._site(site, place) for site in scene.sites),
            sensors=tuple(dataclasses.replace(sensor, joint=names.get(sensor.joint or "", sensor.joint))
                          for sensor in scene.sensors))

    def _body(self, body: Body, name: str) -> Body:
        from scipy.spatial.transform import Rotation

        R = Rotation.from_matrix(self.Q) * Rotation.from_quat(body.attitude, scalar_first=True)
        return dataclasses.replace(body, name=name, position=self.Q @ body.position + self.shift,
                                   velocity=self.Q @ body.velocity,
                                   attitude=R.as_quat(canonical=True, scalar_first=True))

    def _joint(self, joint: Joint, place: Mapping[int, int], names: Mapping[str, str]) -> Joint:
        changes: dict[str, Any] = {"name": names[joint.name], "parent": place[joint.parent],
                                   "child": place[joint.child]}
        for end in ("parent", "child"):
            if getattr(joint, end) == GROUND:
                axis = getattr(joint, f"{end}_axis")
                changes |= {f"{end}_anchor": self.Q @ getattr(joint, f"{end}_anchor") + self.shift,
                            f"{end}_axis": None if axis is None else self.Q @ axis}
        if joint.mimic is not None:
            changes["mimic"] = dataclasses.replace(joint.mimic, joint=names[joint.mimic.joint])
        return dataclasses.replace(joint, **changes)

    def _site(self, site: Site, place: Mapping[int, int]) -> Site:
        from scipy.spatial.transform import Rotation

        if site.body != GROUND:
            return dataclasses.replace(site, body=place[site.body])
        R = Rotation.from_matrix(self.Q) * Rotation.from_quat(site.attitude, scalar_first=True)
        return dataclasses.replace(site, position=self.Q @ site.position + self.shift,
                                   attitude=R.as_quat(canonical=True, scalar_first=True))

    def _force(self, force: Force, place: Mapping[int, int], names: Mapping[str, str]) -> Force:
        given = dict(force.parameters)
        if force.parent == GROUND and "parent_point" in given:
            given["parent_point"] = tuple(self.Q @ np.array(given["parent_point"]) + self.shift)
        for key in ("force", "torque"):
            if given.get("frame") == "world":
                given[key] = tuple(self.Q @ np.array(given[key])) if key in given else None
        given = {key: value for key, value in given.items() if value is not None}
        return dataclasses.replace(force, parent=None if force.parent is None else place[force.parent],
                                   child=None if force.child is None else place[force.child],
                                   joint=names.get(force.joint, force.joint), parameters=given)

    def back(self, states: States, there: Scene) -> States:
        """States of the scene `there` in this world in that of the scene, bodies and hinges in its order."""
        order = np.argsort(self.bodies)
        x, R, v, w = (part[:, order] for part in (states.x, states.R, states.v, states.w))
        return States(states.t, (x - self.shift) @ self.Q, self.Q.T @ R, v @ self.Q, w,
                      None if states.a is None else states.a[:, order] @ self.Q,
                      None if states.alpha is None else states.alpha[:, order],
                      hinges=None if states.hinges is None else self._hinges(states.hinges, there))

    def _hinges(self, angles: np.ndarray, there: Scene) -> np.ndarray:
        """Angles of hinges in the scene's order; NaN of those to the ground in a turned world: their zero differs."""
        number = {joint.name: new for new, joint in enumerate(there.joints)}
        old = [(self.joints[number[name]], k) for name, k in there.hinges]
        moved = [GROUND in (joint.parent, joint.child) and not np.array_equal(self.Q, np.eye(3))
                 for joint in (there.joints[number[name]] for name, _ in there.hinges)]
        order = sorted(range(len(old)), key=old.__getitem__)
        return np.where(np.array(moved, bool), np.nan, angles)[:, order]


def _mixed(rng: np.random.Generator, n: int) -> tuple[int, ...]:
    """The numbers below n in an order in which none is at its own place, if there are two."""
    order = rng.permutation(n)
    place = np.empty(n, int)
    place[order] = np.roll(order, 1)
    return tuple(place.tolist())


def turnable(scene: Scene) -> bool:
    """Whether nothing but gravity, points and axes of the ground depends on how the world is turned."""
    on_ground = {joint.name for joint in scene.joints if GROUND in (joint.parent, joint.child)}
    return not any(
        joint.mimic is not None or joint.drive is not None
        or (joint.name in on_ground and (joint.reference is not None or any(joint.limits)))
        for joint in scene.joints) and not any(
        (force.joint in on_ground and not (force.is_spring and force.law.measure == "slide")) or force.law.has_modes
        or force.functions
        for force in scene.loads)


def begun(scene: Scene, traj: Motion, first: int, last: int, memory: Mode | None = None) -> Scene:
    """The scene from the run's own state at sample `first` to the time of sample `last`.

    `memory`: what that state lacks of a scene with laws of joints.
    """
    made = restarted(scene, traj, first, float(traj.t[last] - traj.t[first]), last - first + 1)
    if memory is not None:
        made = made.replace(forces=tuple(_remembering(scene, force, memory, float(traj.t[first]))
                                         for force in made.forces))
    return made


def _remembering(scene: Scene, force: Force, memory: Mode, t: float) -> Force:
    """A force of a scene that begins at time t (s) of this one; a sampled servo with what it holds."""
    servo = Servo(**force.parameters) if force.law.has_modes else None
    if servo is None or servo.period is None:
        return force
    part = next(part for law, part in zip(laws_of(scene), memory, strict=True)
                if law.servo is not None and law.joint.name == force.joint)
    first = next(servo.phase for name, servo in scene.servos.values() if name == force.joint)
    left = first + part.sample * servo.period - t
    return dataclasses.replace(force, parameters={
        **force.parameters,
        "phase": left if left > ROUNDED * servo.period else 0.0, "held": (part.acting, *part.waiting)})
