"""Sensors: what a user logs, read from the states of any source by one function a type.

A site is a frame fixed to a body: a point s and an attitude S in the axes of the body. The wrench of a joint is all
that the parent exerts on the child through it: constraint, springs, drive, rotor inertia. It follows from the
accelerations alone, by the balance of momentum of every body: G^T lam = f - M du/dt. Along a coordinate with dry
friction, limits or a sampled servo, what acts is one more of the unknowns lam. Where joints close a loop, lam may not
be unique. Components of a wrench that depend on which lam is taken are NaN, and `Readings.not_unique` names them.

A new sensor is a function and its entry in `SENSOR_TYPES`.
"""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable, Mapping, Sequence

import numpy as np

from crosscheck.scene import mechanics
from crosscheck.scene.armature import rate_row, rotors
from crosscheck.scene.constraints import Constraints
from crosscheck.scene.coordinates import JointHistory, histories, rates
from crosscheck.scene.model import (
    GROUND,
    Force,
    Joint,
    Scene,
    Sensor,
    Site,
    quaternion_from_rotation,
    rotation_from_quaternion,
)
from crosscheck.scene.schema import EntryError, SensorEntry, SiteEntry, check_named, listed, nearest
from crosscheck.scene.states import States
from crosscheck.scene.vectors import cross

UNIQUE = 1e-8
"""Largest part of a unit multiplier without effect on the motion that may reach a component that counts as unique."""

OWN = "the engine's own"
DERIVED = "derived from its states"


class Reader:
    """The states of all bodies and of the ground, which is the last, and what follows from them; T times.

    Accelerations that the source lacks come from the index-1 equations of the scene at its states.
    """

    def __init__(self, scene: Scene, states: States) -> None:
        self.scene, self.states = scene, states
        if states.a is None or states.alpha is None:
            a, alpha, _ = mechanics.index1(scene, states.x, states.R, states.v, states.w, self.angles, states.t)
            self.states = dataclasses.replace(states, a=a, alpha=alpha)
        self.x, self.v, self.w, self.a, self.alpha = (
            np.concatenate([values, np.zeros((len(states.t), 1, 3))], axis=1) for values in (
                states.x, states.v, states.w, self.states.a, self.states.alpha))
        self.R = np.concatenate([states.R, np.broadcast_to(np.eye(3), (len(states.t), 1, 3, 3))], axis=1)
        self.joints = {joint.name: joint for joint in scene.joints}
        self.sites = {site.name: site for site in scene.sites}
        self.sampled = {name for name, servo in scene.servos.values() if servo.period is not None}

    @functools.cached_property
    def angles(self) -> dict[str, np.ndarray]:
        """As from `mechanics.torsion_angles`."""
        return mechanics.torsion_angles(self.scene, self.states)

    @functools.cached_property
    def histories(self) -> dict[str, JointHistory]:
        """Joint coordinates and rates."""
        return histories(self.scene, self.states)

    def turned(self, body: int, vector: np.ndarray) -> np.ndarray:
        """A vector of body axes, (3,) or (T, 3), in world axes, (T, 3)."""
        return np.asarray(np.einsum("tij,tj->ti", self.R[:, body], np.broadcast_to(vector, self.x[:, body].shape)))

    def axes(self, site: Site) -> np.ndarray:
        """(T, 3, 3), site to world."""
        return np.asarray(self.R[:, site.body] @ rotation_from_quaternion(site.attitude))

    def place(self, site: Site) -> np.ndarray:
        """(T, 3) world, as all vectors below."""
        return np.asarray(self.x[:, site.body] + self.turned(site.body, site.position))

    def attitude(self, site: Site) -> np.ndarray:
        """(T, 4), w first, continuous in time, w not negative at the start."""
        q: np.ndarray = quaternion_from_rotation(self.axes(site))
        q[1:] *= np.cumprod(np.where(np.einsum("tk,tk->t", q[1:], q[:-1]) < 0, -1.0, 1.0))[:, None]
        return q

    def velocity(self, site: Site) -> np.ndarray:
        return np.asarray(self.v[:, site.body] + self.turned(site.body, cross(self.w[:, site.body], site.position)))

    def spin(self, site: Site) -> np.ndarray:
        return self.turned(site.body, self.w[:, site.body])

    def acceleration(self, site: Site) -> np.ndarray:
        w = self.w[:, site.body]
        lever = cross(self.alpha[:, site.body], site.position) + cross(w, cross(w, site.position))
        return np.asarray(self.a[:, site.body] + self.turned(site.body, lever))

    def angular_acceleration(self, site: Site) -> np.ndarray:
        return self.turned(site.body, self.alpha[:, site.body])

    def accelerometer(self, site: Site) -> np.ndarray:
        return np.asarray(self.acceleration(site) - self.scene.gravity)

    @functools.cached_property
    def _constraints(self) -> Constraints:
        return Constraints(self.scene)

    @functools.cached_property
    def _loose(self) -> list[tuple[Joint, np.ndarray]]:
        """Coordinates along which the state does not tell what acts, each with the row S (T, 6n) of its rate."""
        s = self.states
        return [(joint, rate_row(joint, word, self.scene, s.x, s.R, s.v, s.w)[0]) for joint in self.scene.joints
                for k, word in enumerate(joint.kind.coordinates)
                if joint.name in self.sampled or any(laws[k:k + 1] != (None,) and laws[k:k + 1] for laws in (
                    joint.dry_friction, joint.limits))]

    @functools.cached_property
    def _known(self) -> Scene:
        """The scene without what acts along those coordinates and is no function of the state."""
        return self.scene.lawless.replace(forces=tuple(
            force for force in self.scene.forces if not (force.law.has_modes and force.joint in self.sampled)))

    @functools.cached_property
    def _du(self) -> np.ndarray:
        """(T, 6n), as rows of constraints take it."""
        return np.concatenate([self.a[:, :-1], self.alpha[:, :-1]], axis=2).reshape(len(self.states.t), -1)

    @functools.cached_property
    def _multipliers(self) -> tuple[np.ndarray, np.ndarray]:
        """lam (T, m + l) of least norm, and multipliers without effect on the motion, (T, m + l, k), orthonormal.

        The last l are those of `_loose`.
        """
        scene, s, rows = self._known, self.states, self._constraints
        G = np.concatenate([rows.jacobian(s.x, s.R), *(S[:, None] for _, S in self._loose)], axis=1)
        if not G.shape[1]:
            return np.zeros((len(s.t), 0)), np.zeros((len(s.t), 0, 0))
        root = np.linalg.cholesky(mechanics.inverse_mass(scene))
        left = mechanics.applied_forces(scene, s.x, s.R, s.v, s.w, self.angles, s.t)
        left -= self._du @ mechanics.mass_matrix(scene)
        for inertia, S, bias in rotors(scene, s.x, s.R, s.v, s.w):
            left -= (inertia * (np.einsum("tk,tk->t", S, self._du) + bias))[:, None] * S
        U, sizes, V = np.linalg.svd(G @ root)
        rank = int(np.count_nonzero(sizes[0] > mechanics.RANK_TOLERANCE * sizes[0, 0]))
        along = np.einsum("trk,tk->tr", V[:, :rank], left @ root) / sizes[:, :rank]
        return np.einsum("tmr,tr->tm", U[:, :, :rank], along), U[:, :, rank:]

    @functools.cached_property
    def _borne(self) -> dict[str, np.ndarray]:
        """By joint, the force (world) and the torque (body axes) at the child's centre of mass, (T, 6), of its
        springs, dampers, motors and rotors."""
        scene, s = self._known, self.states
        borne = {name: np.zeros((len(s.t), 6)) for name in self.joints}
        for force in scene.loads:
            if force.joint is not None:
                child = self.joints[force.joint].child
                borne[force.joint] += mechanics.force_on_bodies(scene, force, s, self.angles)[:, child]
        for joint in scene.joints:
            for inertia, S, bias in rotors(scene.replace(joints=(joint,)), s.x, s.R, s.v, s.w):
                size = inertia * (np.einsum("tk,tk->t", S, self._du) + bias)
                borne[joint.name] -= size[:, None] * S.reshape(len(s.t), -1, 6)[:, joint.child]
        return borne

    def wrench(self, joint: Joint, site: Site) -> tuple[np.ndarray, np.ndarray]:
        """Force and torque of the parent on the child, about the site's point, world axes, (T, 3, 1 + k).

        The last k are those that may be added in any amount without an effect on the motion.
        """
        lam, idle = self._multipliers
        borne, place = self._borne[joint.name], self.place(site)
        anchor = self.x[:, joint.child] + self.turned(joint.child, joint.child_anchor)
        forces, torques = [], []
        for values in (lam, *np.moveaxis(idle, 2, 0)):
            m = self._constraints.m
            force, torque = self._constraints.reactions(self.states.x, self.states.R, values[:, :m])[joint.name]
            for k, (each, S) in enumerate(self._loose):
                if each is joint:
                    along = -values[:, m + k, None] * S.reshape(len(S), -1, 6)[:, joint.child]
                    force = force + along[:, :3]
                    torque = torque + self.turned(joint.child, along[:, 3:]) - cross(
                        self.turned(joint.child, joint.child_anchor), along[:, :3])
            forces.append(force)
            torques.append(torque + cross(anchor - place, force))
        torques[0] += self.turned(joint.child, borne[:, 3:]) + cross(self.x[:, joint.child] - place, borne[:, :3])
        forces[0] = forces[0] + borne[:, :3]
        return np.stack(forces, axis=2), np.stack(torques, axis=2)

    def loads(self, joint: Joint, site: Site) -> list[tuple[Force, np.ndarray, np.ndarray]]:
        """Forces that are not of joints, and the force and torque about the site, (T, 3) world, of each on the bodies
        that only this joint connects to its parent."""
        place, carried, loads = self.place(site)[:, None], self.carried(joint), []
        for load in self.scene.forces if carried else ():
            if load.joint is None:
                acts = mechanics.force_on_bodies(self.scene, load, self.states, self.angles)[:, carried]
                turns = np.einsum("tnij,tnj->tni", self.R[:, carried], acts[..., 3:])
                turns += cross(self.x[:, carried] - place, acts[..., :3])
                loads.append((load, acts[..., :3].sum(axis=1), turns.sum(axis=1)))
        return loads

    def carried(self, joint: Joint) -> list[int]:
        """The bodies that only this joint connects to its parent; none where it is part of a loop."""
        rest = [{each.parent, each.child} for each in self.scene.joints if each.name != joint.name]
        reached = {joint.child}
        for _ in rest:
            reached |= {end for ends in rest if ends & reached for end in ends}
        return [] if {GROUND, joint.parent} & reached else sorted(reached)

    def effort(self, joint: Joint) -> np.ndarray:
        """(T,) in N m or N, or (T, 1 + k) as in `wrench`."""
        total = np.zeros(len(self.states.t))
        for force in self._known.forces:
            if force.joint == joint.name and force.is_motor:
                position, rate = (values if values.ndim == 1 else values[:, 0] for values in (
                    self.histories[joint.name].position, self.histories[joint.name].velocity))
                total = total + force.law.effort(force.at(self.states.t), position, rate)
        if joint.drive is None and joint.name not in self.sampled:
            return total
        lam, idle = self._multipliers
        if joint.drive is not None:
            row = self._constraints.rows[joint.name].stop - 1
        elif any(joint.dry_friction) or any(joint.limits):  # they share the unknown with the servo
            return np.full_like(total, np.nan)
        else:
            row = self._constraints.m + next(k for k, (each, _) in enumerate(self._loose) if each is joint)
        return np.concatenate([(total - lam[:, row])[:, None], idle[:, row]], axis=1)


@dataclasses.dataclass(frozen=True)
class SensorType:
    """How a sensor reads.

    Attributes
    ----------
    read : its value from a `Reader` and, in the order of `needs`, a joint or a site; of a vector, in world axes.
    unit : per coordinate of a joint in rad; of a slide it has m in place of rad, and N in place of N m.
    axes : the default of `frame` for a vector; "" for what is no vector.
    size : of a reading at one time; 0 is a number, -1 what the joint's coordinates need.
    dynamic : whether it depends on accelerations or multipliers.
    """

    read: Callable[..., np.ndarray]
    unit: str
    needs: tuple[str, ...]
    axes: str = ""
    size: int = 3
    dynamic: bool = False


_SITE, _JOINT, _BOTH = ("site",), ("joint",), ("joint", "site")
SENSOR_TYPES: dict[str, SensorType] = {
    "position": SensorType(Reader.place, "m", _SITE, "world"),
    "attitude": SensorType(Reader.attitude, "1", _SITE, size=4),
    "velocity": SensorType(Reader.velocity, "m/s", _SITE, "world"),
    "angular_velocity": SensorType(Reader.spin, "rad/s", _SITE, "world"),
    "acceleration": SensorType(Reader.acceleration, "m/s^2", _SITE, "world", dynamic=True),
    "angular_acceleration": SensorType(Reader.angular_acceleration, "rad/s^2", _SITE, "world", dynamic=True),
    "accelerometer": SensorType(Reader.accelerometer, "m/s^2", _SITE, "site", dynamic=True),
    "gyroscope": SensorType(Reader.spin, "rad/s", _SITE, "site"),
    "joint_position": SensorType(lambda reader, joint: reader.histories[joint.name].position, "rad", _JOINT, size=-1),
    "joint_velocity": SensorType(lambda reader, joint: reader.histories[joint.name].velocity, "rad/s", _JOINT, size=-1),
    "joint_acceleration": SensorType(lambda reader, joint: rates(joint, reader.states, True), "rad/s^2", _JOINT,
                                     size=-1, dynamic=True),
    "joint_effort": SensorType(Reader.effort, "N m", _JOINT, size=0, dynamic=True),
    "force": SensorType(lambda reader, *at: reader.wrench(*at)[0], "N", _BOTH, "site", dynamic=True),
    "torque": SensorType(lambda reader, *at: reader.wrench(*at)[1], "N m", _BOTH, "site", dynamic=True),
}
"""The types by their names in scene files."""


class Readings(dict[str, np.ndarray]):
    """Readings by the names of sensors, (T, 3), (T, 4) or (T,).

    `source` says for each whether it is the engine's own or derived from its states; `not_unique` has those of which
    NaN components depend on how redundant joints share a load.
    """

    def __init__(self) -> None:
        super().__init__()
        self.source: dict[str, str] = {}
        self.not_unique: tuple[str, ...] = ()


def readings(scene: Scene, states: States, own: Mapping[str, np.ndarray] | None = None) -> Readings:
    """The readings of all sensors of a scene at some states; `own` are those that an engine made itself."""
    answer = Readings()
    if not scene.sensors:
        return answer
    reader = Reader(scene, states)
    derived = DERIVED if states.a is not None else f"{DERIVED}, accelerations by the scene's equations"
    loose = []
    for sensor in scene.sensors:
        values = read(reader, sensor)
        if np.isnan(values).any() and np.isfinite(states.x).all():
            loose.append(sensor.name)
        given = None if own is None else own.get(sensor.name)
        answer[sensor.name] = values if given is None else np.asarray(given, dtype=float)
        answer.source[sensor.name] = derived if given is None else OWN
    answer.not_unique = tuple(loose)
    return answer


def read(reader: Reader, sensor: Sensor) -> np.ndarray:
    """The reading of one sensor, in its axes; components that are not unique are NaN."""
    kind = SENSOR_TYPES[sensor.type]
    where = {"joint": reader.joints.get(sensor.joint or ""), "site": reader.sites.get(sensor.site or "")}
    values = kind.read(reader, *(where[key] for key in kind.needs))
    if sensor.frame == "site":
        values = np.einsum("tji,tj...->ti...", reader.axes(reader.sites[sensor.site or ""]), values)
    if "joint" in kind.needs and values.ndim > (2 if kind.axes else 1) and kind.size >= 0:
        values = values[..., 0] + np.where(np.abs(values[..., 1:]).max(axis=-1, initial=0.0) > UNIQUE, np.nan, 0.0)
    return values


def gap(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    """(T,) how far readings are from others: the angle between attitudes, rad, or the norm of the difference.

    Components that are NaN in one of them, since they are not unique, are left out.
    """
    if one.shape[1:] == (4,):  # |q - p| = 2 sin(angle / 4) for the nearer of p and -p
        near = np.minimum(np.linalg.norm(one - other, axis=1), np.linalg.norm(one + other, axis=1))
        return np.asarray(4 * np.arcsin(np.minimum(near / 2, 1.0)))
    return np.asarray(np.sqrt(np.nansum((one - other).reshape(len(one), -1) ** 2, axis=1)))


def shape(scene: Scene, sensor: Sensor, times: int) -> tuple[int, ...]:
    """Shape of the readings of a sensor over some times."""
    size = SENSOR_TYPES[sensor.type].size
    if size < 0:
        kind = scene.joint(sensor.joint).kind
        turns = kind.is_ball and sensor.type != "joint_position"
        size = 3 if turns else kind.positions if kind.positions > 1 else 0
    return (times, size) if size else (times,)


def unit(scene: Scene, sensor: Sensor) -> str:
    """Its unit; "SI" where the coordinates of a joint have several."""
    text = SENSOR_TYPES[sensor.type].unit
    if SENSOR_TYPES[sensor.type].needs != _JOINT:
        return text
    words = scene.joint(sensor.joint).kind.coordinates
    slides = [word.startswith("slide") for word in words]
    if any(slides) and not all(slides):
        return "SI"
    return text.replace("rad", "m").replace("N m", "N") if any(slides) else text


def columns(readings: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """The readings as one series (T,) a number: "NAME", or "NAME.x" ...; "NAME.w" first of four."""
    series = {}
    for name, values in readings.items():
        if values.ndim == 1:
            series[name] = values
        else:
            parts = {3: "xyz", 4: "wxyz"}.get(values.shape[1], "123456")
            series |= {f"{name}.{part}": values[:, k] for k, part in enumerate(parts[:values.shape[1]])}
    return series


def sites_of(entries: Sequence[SiteEntry], bodies: Mapping[str, int]) -> tuple[Site, ...]:
    """The checked sites of a scene file."""
    made = []
    for index, entry in enumerate(entries):
        where = f'sites[{index}] "{entry.name}"'
        check_named(f"{where}: body", "body", entry.body, ["ground", *bodies])
        size = float(np.linalg.norm(entry.attitude))
        if not size > 0:
            raise EntryError(f"{where}: attitude", "all its numbers are zero", "write a quaternion w, x, y, z")
        made.append(Site(entry.name, bodies.get(entry.body, GROUND), np.array(entry.position),
                         np.array(entry.attitude) / size))
    return tuple(made)


def sensors_of(entries: Sequence[SensorEntry], scene: Scene) -> tuple[Sensor, ...]:
    """The checked sensors of a scene file; `scene` has its joints and sites."""
    return tuple(_sensor(f'sensors[{index}] "{entry.name}"', entry, scene) for index, entry in enumerate(entries))


def _sensor(where: str, entry: SensorEntry, scene: Scene) -> Sensor:
    if entry.type not in SENSOR_TYPES:
        raise EntryError(f"{where}: type", f'unknown type "{entry.type}"',
                         f"{nearest(entry.type, SENSOR_TYPES)}write one of {listed(SENSOR_TYPES)}")
    kind = SENSOR_TYPES[entry.type]
    joints = {joint.name: joint for joint in scene.joints}
    for key, name, names in (("site", entry.site, [site.name for site in scene.sites]),
                             ("joint", entry.joint, list(joints))):
        if key in kind.needs and name is None:
            raise EntryError(f"{where}: {key}", f"missing, the type {entry.type} needs it",
                             f"write one of {listed(names) or f'[[{key}s]], of which the scene has none'}")
        if key not in kind.needs and name is not None:
            raise EntryError(f"{where}: {key}", f"the type {entry.type} has none", "remove it, or change the type")
        if name is not None:
            check_named(f"{where}: {key}", key, name, names)
    if entry.frame is not None and not kind.axes:
        raise EntryError(f"{where}: frame", f"the type {entry.type} has no axes", "remove it")
    joint = joints.get(entry.joint or "")
    if joint is not None and kind.needs == _JOINT:
        count = len(joint.kind.coordinates)
        if not count or (kind.size == 0 and not joint.kind.is_elastic):
            raise EntryError(f"{where}: joint", f'"{joint.name}" is a {joint.type} joint, which has no '
                             f"{'drive' if count else 'coordinates'}", "name another joint")
    return Sensor(entry.name, entry.type, entry.site, entry.joint, entry.frame or kind.axes)
