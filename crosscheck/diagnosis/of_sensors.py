"""What an engine reads itself: its sensors against those of its own states, and the mistakes that explain a difference.

Each mistake predicts the reading from the engine's own states, so that errors of the motion do not count.
"""

from __future__ import annotations

import dataclasses
import functools
import itertools
import math
from collections.abc import Iterator, Mapping
from typing import Any, NamedTuple

import numpy as np

from crosscheck.diagnosis.observe import RTOLS, Scale, Subject
from crosscheck.diagnosis.result import Evidence, Explanation
from crosscheck.scene import mechanics
from crosscheck.scene.model import GROUND, Force, Joint, Scene, Sensor, quaternion_product
from crosscheck.scene.sensors import SENSOR_TYPES, Reader, gap, read
from crosscheck.scene.states import States
from crosscheck.scene.vectors import cross

STEPS, TURN = 60, 0.03
"""Number of steps of the run that is looked at, each with an output time, and their size in units of 1 / W."""

AGREES = 1e-7
"""Difference of a reading from that of the states, over its size, that counts as none."""

EXPLAINED, FOLLOWED = 1e-3, 0.03
"""Part of a difference that a mistake may leave: one that is known exactly, or one whose formula in steps is not."""

LAGS = (1, 2, 3, -1)
"""Numbers of steps by which readings may come late."""

UNCOUNTED = "springs or drives not counted"

MENDS = {"gravity": "an accelerometer reads a - g, an acceleration a",
         "one step late": "read sensors after the step, at the state that is reported",
         "before the constraint solve": "read sensors after the constraints are solved",
         "force on the parent": "report the wrench that the parent exerts on the child",
         "lever": "read at the site, with its lever from the centre of mass"}


class Misread(NamedTuple):
    """A mistake, in words, with the readings (T, ...) that it gives."""

    cause: str
    words: str
    values: np.ndarray

    @property
    def mend(self) -> str:
        """What to change."""
        return MENDS.get(self.cause, "read the sensor as a scene defines it: point, axes, sign and what it contains")


def add(subject: Subject, scene: Scene, scale: Scale, step: float | None, answer: Explanation) -> None:
    """Look at the sensors that the engine reads itself, and add to an answer what is found."""
    interval = min(step or TURN / (scale.rate * scale.fast), scene.duration / STEPS)
    brief = scene.replace(duration=STEPS * interval, samples=STEPS + 1)
    fixed = subject.order(scene) is not None
    states = subject.run(brief, interval if fixed else None, None if fixed else RTOLS[1]).states
    for sensor in scene.sensors:
        if (given := (states.sensors or {}).get(sensor.name)) is None:
            continue
        left, after, cause = named(brief, states, sensor, given)
        if left <= AGREES:
            continue
        label = f"sensor {sensor.name!r}"
        words = f"{label}: {cause.words}" if cause else label
        if not answer.test(Evidence(cause.cause if cause else "sensor", "report", left, after, "difference of a "
                                    "reading from that of the same states, over its size", words, cause is not None),
                           cause.mend if cause else ""):
            answer.unexplained.append(f"{label} differs from the reading of its own states by {left:.2g} of its size")


def named(scene: Scene, states: States, sensor: Sensor, given: np.ndarray
          ) -> tuple[float, float | None, Misread | None]:
    """(difference of readings from those of the states over their size, what a mistake leaves of it, that mistake)."""
    bare = States(states.t, states.x, states.R, states.v, states.w)
    both = [bare] if states.a is None else [bare, dataclasses.replace(bare, a=states.a, alpha=states.alpha)]
    made = [(reader := Reader(scene, each), read(reader, sensor)) for each in both]
    reader, right = min(made, key=lambda pair: float(gap(given, pair[1])[1:].max()))
    size = 1.0 if _is_attitude(right) else max(float(np.nanmax(np.abs(right))), 1e-9)
    before = float(gap(given, right).max()) / size
    if before > AGREES:
        exact = itertools.chain(mistakes(reader, sensor, right), _followed(given, right))
        for cause, share in itertools.chain(((each, EXPLAINED) for each in exact),
                                            ((each, FOLLOWED) for each in filtered(given, right))):
            after = _left(given, cause.values) / size if cause.values.shape == given.shape else math.inf
            if after <= max(AGREES, share * before):
                return before, after, cause
    return before, None, None


def _left(given: np.ndarray, predicted: np.ndarray) -> float:
    """The largest difference where there is a prediction."""
    there = np.isfinite(predicted.reshape(len(predicted), -1)).any(axis=1)
    return float(gap(given, predicted)[there].max()) if there.any() else math.inf


def _is_attitude(values: np.ndarray) -> bool:
    return values.shape[1:] == (4,)


def mistakes(reader: Reader, sensor: Sensor, right: np.ndarray) -> Iterator[Misread]:
    """All mistakes that the type of the sensor can have, the plainest first."""
    for lag in LAGS:
        shifted = np.full_like(right, np.nan)
        shifted[max(lag, 0):len(right) + min(lag, 0)] = right[max(-lag, 0):len(right) - max(lag, 0)]
        yield Misread("one step late" if lag == 1 else "late" if lag > 0 else "early",
                       f"readings come {abs(lag)} step{'s' * (abs(lag) > 1)} {'late' if lag > 0 else 'early'}", shifted)
    if _is_attitude(right):
        yield from _attitudes(reader, sensor, right)
        return
    yield from _others(reader, sensor)
    if sensor.site is not None:
        yield from _of_site(reader, sensor, right)
    if sensor.joint is not None:
        joint = reader.joints[sensor.joint]
        yield from _of_joint(reader, sensor, joint, right)
    yield Misread("sign", "the reading has the other sign", -right)


def _followed(given: np.ndarray, right: np.ndarray) -> Iterator[Misread]:
    """Mistakes whose size is fitted to the reading: a factor, an offset, an order of components, a clamp, rounding."""
    if right.ndim == 2 and right.shape[1] == 3:
        for order in list(itertools.permutations(range(3)))[1:]:
            yield Misread("order of components", f"components are {', '.join('xyz'[k] for k in order)}",
                           right[:, order])
        for k in range(3):
            yield Misread("sign", f"component {'xyz'[k]} has the other sign",
                           right * np.where(np.arange(3) == k, -1.0, 1.0))
    yield Misread("zero", "the reading is always zero", 0.0 * right)
    square = float(np.nansum(right**2))
    factor = float(np.nansum(given * right)) / square if square else 1.0
    if abs(factor) > 0:
        unit = {"degrees": 180 / np.pi, "radians": np.pi / 180}
        name = next((word for word, value in unit.items() if abs(factor / value - 1) < 1e-6), "gear")
        yield Misread(name if name == "gear" else "unit", f"readings are {factor:.6g} times what they should be"
                       + (f", {name}" if name != "gear" else ""), factor * right)
    away = np.nanmean(given - right, axis=0)
    yield Misread("offset", f"readings are off by {np.array2string(away, precision=5)}", right + away)
    lower, upper = np.nanmin(given), np.nanmax(given)
    if lower > np.nanmin(right) or upper < np.nanmax(right):
        yield Misread("clamp", f"readings are cut to {lower:.4g} and {upper:.4g}", np.clip(right, lower, upper))
    turns = 2 * np.pi * np.round((given - right) / (2 * np.pi))
    yield Misread("wrapped angle", "angles jump by whole turns", right + turns)
    for digits in range(1, 7):
        yield Misread("rounded output", f"readings are rounded to {digits} decimals", np.round(right, digits))


def filtered(given: np.ndarray, right: np.ndarray) -> Iterator[Misread]:
    """Low-pass filters in the forms that loops over steps have, and means over some samples."""
    change = given[1:] - given[:-1]
    for now in (1.0, 0.0, 0.5):
        drive = now * right[1:] + (1 - now) * right[:-1]
        share = float(np.nansum(change * (drive - given[:-1])) / max(float(np.nansum((drive - given[:-1])**2)), 1e-300))
        if 0 < share < 0.999:  # one is a sample late, or none
            made = given.copy()
            for k in range(len(change)):
                made[k + 1] = made[k] + share * (drive[k] - made[k])
            yield Misread("filtered", f"a low-pass filter, each step closes {share:.3g} of the gap", made)
    for count in range(2, 11):
        made = np.full_like(right, np.nan)
        for k in range(count - 1, len(right)):
            made[k] = right[k - count + 1:k + 1].mean(axis=0)
        yield Misread("filtered", f"readings are means over {count} samples", made)


def _others(reader: Reader, sensor: Sensor) -> Iterator[Misread]:
    """The reading of another site or joint in place of the sensor's."""
    scene = reader.scene
    for site in scene.sites if sensor.site is not None else ():
        if site.name != sensor.site:
            yield Misread("another site", f"it is the reading at site {site.name!r}",
                           read(reader, dataclasses.replace(sensor, site=site.name)))
    kind = None if sensor.joint is None else reader.joints[sensor.joint].kind
    for joint in scene.joints if kind is not None else ():
        if joint.name != sensor.joint and joint.kind.coordinates == kind.coordinates:  # type: ignore[union-attr]
            yield Misread("another joint", f"it is the reading of joint {joint.name!r}",
                           read(reader, dataclasses.replace(sensor, joint=joint.name)))


def _of_site(reader: Reader, sensor: Sensor, right: np.ndarray) -> Iterator[Misread]:
    """Axes, lever, gravity and rate terms of a vector at a site."""
    scene, site = reader.scene, reader.sites[sensor.site or ""]
    world = read(reader, dataclasses.replace(sensor, frame="world"))
    in_site = sensor.frame == "site"
    turned = dataclasses.replace(sensor, frame="world" if in_site else "site")
    yield Misread("world for site axes" if in_site else "site for world axes",
                   f"the reading is in {turned.frame} axes", read(reader, turned))

    def in_axes(axes: np.ndarray, vector: np.ndarray = world) -> np.ndarray:
        return np.asarray(np.einsum("tji,tj->ti", axes, np.broadcast_to(vector, world.shape)))

    def read_as(vector: np.ndarray) -> np.ndarray:
        return in_axes(reader.axes(site), vector) if in_site else np.broadcast_to(vector, world.shape)

    yield Misread("frame of the body", "the reading is in the axes of the body, without the attitude of the site",
                   in_axes(reader.R[:, site.body]))
    if in_site:
        yield Misread("inverse rotation", "the vector is turned from the site to the world once more",
                       np.einsum("tij,tj->ti", reader.axes(site), world))
    for body in range(GROUND, scene.n):
        if body == site.body:
            continue
        name = "the ground" if body == GROUND else f"body {scene.bodies[body].name!r}"
        other = dataclasses.replace(site, body=body)
        yield Misread("frame of another body", f"the reading is in axes of {name}", in_axes(reader.R[:, body]))
        yield Misread("frame of another body", f"the reading is in the axes that the site would have on {name}",
                       in_axes(reader.axes(other)))
        if sensor.type in ("angular_velocity", "gyroscope"):
            yield Misread("relative to another body", f"the turning is that against {name}",
                           right - read_as(reader.turned(body, reader.w[:, body])))
    g, w = scene.gravity, reader.w[:, site.body]
    arm, spin = site.position, reader.turned(site.body, w)
    if sensor.type in ("acceleration", "accelerometer"):
        words = {1: "gravity is missing", -1: "gravity counts twice", 2: "gravity has the other sign"} if (
            sensor.type == "accelerometer") else {-1: "it is a - g, as an accelerometer reads", 1: "it is a + g"}
        for times, text in words.items():
            yield Misread("gravity", text, right + times * read_as(g))
        inward = reader.turned(site.body, cross(w, cross(w, arm)))
        tangent = reader.turned(site.body, cross(reader.alpha[:, site.body], arm))
        coriolis = cross(spin, reader.velocity(site))
        central = cross(spin, reader.v[:, site.body])
        for text, part in (("w x (w x s) is left out", -inward), ("w x (w x s) counts twice", inward),
                           ("w x (w x s) has the other sign", -2 * inward), ("alpha x s is left out", -tangent),
                           ("it is the derivative of the velocity in body axes, without w x v", -coriolis),
                           ("w x v counts twice", coriolis), ("w x v of the centre of mass is left out", -central),
                           ("2 w x v is added", 2 * coriolis)):
            yield Misread("Coriolis or centripetal term", text, right + read_as(part))
    for text, place in (("left out", 0.0 * arm), ("taken with the other sign", -arm)):
        yield Misread("lever", f"the lever of the site is {text}", _moved(reader, sensor, position=place))
    if SENSOR_TYPES[sensor.type].dynamic and sensor.joint is None:
        s = reader.states
        free = mechanics.applied_forces(scene, s.x, s.R, s.v, s.w, reader.angles, s.t) @ mechanics.inverse_mass(scene)
        a, alpha = np.split(free.reshape(len(s.t), scene.n, 6), 2, axis=2)
        yield Misread("before the constraint solve", "the reading is that of bodies on which no constraint acts yet",
                       read(Reader(scene, dataclasses.replace(s, a=a, alpha=alpha)), sensor))


def _of_joint(reader: Reader, sensor: Sensor, joint: Joint, right: np.ndarray) -> Iterator[Misread]:
    """Parts of a wrench or of an effort."""
    scene = reader.scene
    if sensor.type == "joint_effort":
        for force in scene.loads:
            if force.joint == joint.name and not force.is_spring:
                rest = scene.replace(forces=tuple(each for each in scene.forces if each is not force))
                yield Misread(UNCOUNTED, f"the {force.type} is left out", read(Reader(rest, reader.states), sensor))
            elif force.joint == joint.name:
                on_child = mechanics.force_on_bodies(scene, force, reader.states, reader.angles)[:, joint.child]
                along = on_child[:, :3] if force.law.measure == "slide" else reader.turned(joint.child, on_child[:, 3:])
                yield Misread(UNCOUNTED, "the spring and damper of the joint count as a drive", right + np.einsum(
                            "tk,tk->t", along, reader.turned(joint.child, joint.child_axis)))
    if sensor.type not in ("force", "torque"):
        return
    yield Misread("force on the parent", "it is what the child exerts on the parent", -right)
    for name, text, *pair in _parts(reader, sensor, joint):
        part = pair[sensor.type == "torque"]
        if sensor.frame == "site":
            part = np.einsum("tji,tj->ti", reader.axes(reader.sites[sensor.site or ""]), part)
        yield Misread(name, text, right + part)
    for text, borne in _borne(reader, joint):
        lighter = Reader(scene, reader.states)
        lighter.__dict__["_borne"] = {**reader._borne, joint.name: borne}
        yield Misread(UNCOUNTED, text, read(lighter, sensor))


def _parts(reader: Reader, sensor: Sensor, joint: Joint) -> Iterator[tuple[str, str, np.ndarray, np.ndarray]]:
    """What is added to force and torque about the site, (T, 3) world, by each mistake."""
    scene, site = reader.scene, reader.sites[sensor.site or ""]
    place, anchor = reader.place(site), reader.x[:, joint.child] + reader.turned(joint.child, joint.child_anchor)
    force, torque = (values[:, :, 0] for values in reader.wrench(joint, site))
    for text, point in (("the anchor of the joint", anchor), ("the child's centre of mass", reader.x[:, joint.child]),
                        ("the parent's centre of mass", reader.x[:, joint.parent]), ("the origin", 0.0 * anchor)):
        yield "lever", f"the torque is that about {text}", 0.0 * force, cross(place - point, force)
    if reader._borne[joint.name].any():
        bare = Reader(scene, reader.states)
        bare.__dict__["_borne"] = {name: 0.0 * borne for name, borne in reader._borne.items()}
        by_rows = [values[:, :, 0] for values in bare.wrench(joint, site)]
        yield "before the constraint solve", "springs and motors count alone", -by_rows[0], -by_rows[1]
    else:
        yield "before the constraint solve", "the constraint does not count", -force, -torque
    if joint.kind.has_one:
        effort = reader.effort(joint)
        along = reader.turned(joint.child, joint.child_axis) * (effort if effort.ndim == 1 else effort[:, 0])[:, None]
        pair = (along, cross(anchor - place, along)) if joint.kind.slides else (0.0 * along, along)
        yield UNCOUNTED, "what the drive supplies is left out", -pair[0], -pair[1]
    loads, carried = reader.loads(joint, site), reader.carried(joint)
    for load, pull, turn in loads:
        yield "loads not counted", f"the {load.type} is left out", pull, turn
    yield ("loads not counted", "the loads are left out", sum((each[1] for each in loads), 0.0 * force),
           sum((each[2] for each in loads), 0.0 * force))
    arms, w = reader.x[:, carried] - place[:, None], reader.w[:, carried]
    weight = np.broadcast_to(scene.masses[carried, None] * scene.gravity, arms.shape)
    for sign, text in ((1, "weights are left out"), (-1, "weights count twice")):
        yield "gravity", text, sign * weight.sum(axis=1), sign * cross(arms, weight).sum(axis=1)
    momentum = np.einsum("kij,tkj->tki", scene.inertias[carried], w)
    spin = np.einsum("tkij,tkj->ti", reader.R[:, carried], cross(w, momentum))
    yield "Coriolis or centripetal term", "w x J w is left out", 0.0 * force, -spin


def _borne(reader: Reader, joint: Joint) -> Iterator[tuple[str, np.ndarray]]:
    """What springs, dampers, motors and rotors of a joint exert, with parts of it left out."""
    scene, s, whole = reader.scene, reader.states, reader._borne[joint.name]
    if not whole.any():
        return
    yield "only the constraint counts", 0.0 * whole
    for force in scene.loads:
        if force.joint == joint.name:
            parts: Mapping[str, Force] = {f"the {force.type}": force} | {
                f"the {key}": dataclasses.replace(force, parameters={
                    **force.parameters, **{other: 0.0 for other in ("stiffness", "damping") if other != key}})
                for key in ("stiffness", "damping") if force.parameters.get(key)}
            for text, part in parts.items():
                on_child = mechanics.force_on_bodies(scene, part, s, reader.angles)[:, joint.child]
                yield f"{text} is left out", whole - on_child
    if any(joint.armature):
        bare = scene.replace(joints=tuple(dataclasses.replace(each, armature=()) for each in scene.joints))
        yield "the rotor is left out", Reader(bare, s)._borne[joint.name]


def _moved(reader: Reader, sensor: Sensor, **changes: Any) -> np.ndarray:
    """The reading of a sensor whose site is another one."""
    site = dataclasses.replace(reader.sites[sensor.site or ""], **changes)
    sites = tuple(site if each.name == site.name else each for each in reader.scene.sites)
    return read(Reader(reader.scene.replace(sites=sites), reader.states), sensor)


def _attitudes(reader: Reader, sensor: Sensor, right: np.ndarray) -> Iterator[Misread]:
    """Conventions of quaternions, and attitudes of other frames."""
    yield Misread("inverse rotation", "it is the attitude of the world in the site", right * [1.0, -1.0, -1.0, -1.0])
    yield Misread("order of components", "the scalar comes last", right[:, [1, 2, 3, 0]])
    yield Misread("order of components", "the scalar is taken as the last", right[:, [3, 0, 1, 2]])
    if sensor.site is None:
        return
    scene, site = reader.scene, reader.sites[sensor.site]

    at = functools.partial(_moved, reader, sensor)
    yield Misread("frame of the body", "it is the attitude of the body", at(attitude=np.array([1.0, 0.0, 0.0, 0.0])))
    for body in range(scene.n):
        if body != site.body:
            name = f"body {scene.bodies[body].name!r}"
            yield Misread("frame of another body", f"it is the attitude that the site would have on {name}",
                           at(body=body))
            its = at(body=body, attitude=np.array([1.0, 0.0, 0.0, 0.0])) * [1.0, -1.0, -1.0, -1.0]
            yield Misread("relative to another body", f"it is the attitude in {name}", quaternion_product(its, right))
    swapped = site.attitude * np.array([1.0, -1.0, -1.0, -1.0])
    yield Misread("inverse rotation", "the attitude of the site is taken the other way", at(attitude=swapped))
