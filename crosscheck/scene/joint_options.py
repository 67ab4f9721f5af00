"""Optional properties of a joint: coordinates at the start, springs and dampers, armature, mimic, drive."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from typing import Any

from crosscheck.scene import functions
from crosscheck.scene.joints import joint_types
from crosscheck.scene.laws import DryFriction, Limits
from crosscheck.scene.model import Mimic
from crosscheck.scene.schema import (
    DryFrictionEntry,
    EntryError,
    HoldEntry,
    JointEntry,
    LimitsEntry,
    LinearEntry,
    PolynomialEntry,
    SineEntry,
    SplineEntry,
    check_not_negative,
    listed,
    nearest,
)

Values = float | list[float] | None


def start(entry: str, joint: JointEntry, joints: Sequence[JointEntry],
          duration: float) -> tuple[tuple[float, ...] | None, tuple[float, ...] | None]:
    """The coordinates and their rates that the file gives, or the joint's drive or that of its mimic, checked."""
    if (driven := drive(entry, joint, duration)) is not None:
        return (float(driven(0.0)),), (float(driven(0.0, 1)),)
    if joint.position is None and joint.velocity is None and (follows := mimic(entry, joint, joints)) is not None:
        leader = next(each for each in joints if each.name == follows.joint)
        position, velocity = start(entry, leader, joints, duration)
        return (None if position is None else (follows.ratio * position[0] + follows.offset,),
                None if velocity is None else (follows.ratio * velocity[0],))
    given_start: list[tuple[float, ...] | None] = []
    for key, given in (("position", joint.position), ("velocity", joint.velocity)):
        if given is None:
            given_start.append(None)
            continue
        count = joint.kind.positions
        if count == 4 and key == "velocity":
            count = 3
        if count == 0:
            raise EntryError(f"{entry}: {key}", f"a {joint.type} joint has no coordinate", "remove it")
        given_start.append(_many(f"{entry}: {key}", given, count))
    position, velocity = given_start
    if position is not None and len(position) == 4 and not any(position):
        raise EntryError(f"{entry}: position", "all its numbers are zero", "write a quaternion w, x, y, z")
    return position, velocity


def _many(entry: str, given: float | list[float], count: int) -> tuple[float, ...]:
    values = tuple(given) if isinstance(given, list) else (float(given),)
    if len(values) != count:
        wanted = "one number" if count == 1 else f"{count} numbers"
        raise EntryError(entry, f"{len(values)} given", f"write {wanted}")
    return values


def elastic(entry: str, joint: JointEntry, key: str) -> tuple[float, ...]:
    """Armature, damping, stiffness or rest position per coordinate; empty if the file has none."""
    given: Values = getattr(joint, key)
    if given is None:
        return ()
    _check_elastic(f"{entry}: {key}", joint)
    values = _many(f"{entry}: {key}", given, joint.kind.positions)
    if key != "rest_position":
        check_not_negative(f"{entry}: {key}", min(values))
    return values


def _check_elastic(entry: str, joint: JointEntry) -> None:
    if not joint.kind.is_elastic:
        raise EntryError(entry, f"a {joint.type} joint cannot have it",
                         f"remove it, or use a joint of type {listed(joint_types('is_elastic'))}")


def mimic(entry: str, joint: JointEntry, joints: Sequence[JointEntry]) -> Mimic | None:
    """The joint whose coordinate this one follows."""
    if joint.mimic is None:
        return None
    one = {each.name: each.type for each in joints if each.kind.positions == 1}
    if joint.name not in one:
        raise EntryError(f"{entry}: mimic", f"a {joint.type} joint cannot have it", "use a revolute or prismatic joint")
    motor = joint.mimic.joint
    if motor not in one or motor == joint.name:
        raise EntryError(f"{entry}: mimic", f'no other revolute or prismatic joint is named "{motor}"',
                         f"{nearest(motor, one)}write one of {listed(set(one) - {joint.name}) or '(there is none)'}")
    if joint.drive is not None:
        raise EntryError(f"{entry}: mimic", "the drive of the joint says all of its motion", "remove one of the two")
    leads = {each.name: each.mimic.joint for each in joints if each.mimic is not None}
    leaders = [motor]
    while leaders[-1] in leads and len(leaders) <= len(leads):
        leaders.append(leads[leaders[-1]])
    if leaders[-1] in leads:
        ring = " follows ".join((joint.name, *leaders[:len(leads)]))
        raise EntryError(f"{entry}: mimic", f"{ring}: none of them moves by itself",
                         "remove the mimic of the one that leads")
    return Mimic(motor, joint.mimic.ratio, joint.mimic.offset)


def drive(entry: str, joint: JointEntry, duration: float) -> functions.TimeFunction | None:
    """The coordinate of a joint as a function of time."""
    if joint.drive is None:
        return None
    if not joint.kind.has_one:
        raise EntryError(f"{entry}: drive", f"a {joint.type} joint cannot have it", "use a revolute or prismatic joint")
    for key in ("position", "velocity", "mimic", "armature"):
        if getattr(joint, key) is not None:
            raise EntryError(f"{entry}: {key}", "the drive of the joint says all of its motion", "remove it")
    if isinstance(joint.drive, HoldEntry | LinearEntry):
        raise EntryError(f"{entry}: drive", "the rate of a driven joint cannot jump", "write a polynomial, sine or "
                         "spline")
    prescribed: functions.TimeFunction = function(f"{entry}: drive", joint.drive, duration)
    return prescribed


def dry_friction(entry: str, joint: JointEntry) -> tuple[DryFriction | None, ...]:
    """The dry friction of each coordinate; empty if the file has none."""
    given = _of_coordinates(entry, joint, "dry_friction")
    laws = []
    for place, each in given:
        sliding, static = (each.sliding, each.static) if isinstance(each, DryFrictionEntry) else (each, None)
        static = sliding if static is None else static
        check_not_negative(place, sliding)
        if static < sliding:
            raise EntryError(place, f"static {static:g} is below sliding {sliding:g}",
                             "write a static value that is not smaller")
        laws.append(DryFriction(sliding, static) if static else None)
    return tuple(laws) if any(laws) else ()


def limits(entry: str, joint: JointEntry) -> tuple[Limits | None, ...]:
    """The range of each coordinate; empty if the file has none."""
    laws: list[Limits | None] = []
    for place, each in _of_coordinates(entry, joint, "limits"):
        if each == LimitsEntry() and isinstance(joint.limits, list):
            laws.append(None)
            continue
        lower, upper = range_of(place, each.lower, each.upper)
        soft = each.stiffness is not None or each.damping is not None
        if soft and each.restitution is not None:
            raise EntryError(f"{place}: restitution", "a stop with a spring and damper has none",
                             "remove it, or remove stiffness and damping")
        if soft and not each.stiffness:
            raise EntryError(f"{place}: stiffness", "missing, beside damping" if each.stiffness is None else
                             "a stop of stiffness 0 holds nothing", "write a number > 0")
        for key in ("stiffness", "damping"):
            check_not_negative(f"{place}: {key}", getattr(each, key) or 0.0)
        if not 0.0 <= (each.restitution or 0.0) <= 1.0:
            raise EntryError(f"{place}: restitution", f"{each.restitution:g} is not between 0 and 1",
                             "write a number from 0 to 1")
        laws.append(Limits(lower, upper, each.restitution or 0.0, each.stiffness, each.damping or 0.0))
    return tuple(laws) if any(laws) else ()


def range_of(entry: str, lower: float | None, upper: float | None) -> tuple[float, float]:
    """The two ends of a range, of which one may be left out."""
    if lower is None and upper is None:
        raise EntryError(f"{entry}: lower", "missing, and upper too", "write at least one of the two")
    if lower is not None and upper is not None and lower >= upper:
        raise EntryError(f"{entry}: lower", f"{lower:g} is not below upper {upper:g}", "write the smaller one as lower")
    return -math.inf if lower is None else lower, math.inf if upper is None else upper


def _of_coordinates(entry: str, joint: JointEntry, key: str) -> list[tuple[str, Any]]:
    """The place in words and the value of a key for each coordinate; empty if the file does not give it."""
    given = getattr(joint, key)
    if given is None:
        return []
    entry = f"{entry}: {key}"
    _check_elastic(entry, joint)
    if joint.drive is not None:
        raise EntryError(entry, "the drive of the joint says all of its motion", "remove it")
    values, count = given if isinstance(given, list) else [given], joint.kind.positions
    if len(values) != count:
        raise EntryError(entry, f"{len(values)} given", "write one" if count == 1 else f"write a list of {count}")
    return [(entry if count == 1 else f"{entry}[{k}]", value) for k, value in enumerate(values)]


def function(entry: str, given: Any, duration: float) -> Any:
    """A function of time from its table in the file; anything else unchanged."""
    match given:
        case PolynomialEntry(coefficients):
            if not coefficients:
                raise EntryError(f"{entry}: coefficients", "is empty", "write at least one number")
            return functions.polynomial(coefficients)
        case SineEntry(terms, offset):
            return functions.sine(terms, offset)
        case HoldEntry(times, values) | LinearEntry(times, values):
            _check_table(entry, times, values, 1 if isinstance(given, HoldEntry) else 2)
            return (functions.hold if isinstance(given, HoldEntry) else functions.linear)(times, values)
        case SplineEntry(times, values):
            _check_table(entry, times, values, 2)
            if times[0] > 0 or times[-1] < duration:
                raise EntryError(f"{entry}: times", f"reach from {times[0]:g} to {times[-1]:g} s", "cover the whole "
                                 f"run, 0 to {duration:g} s")
            return functions.spline(times, values)
    return given


def _check_table(entry: str, times: Sequence[float], values: Sequence[float], least: int) -> None:
    if len(times) != len(values) or len(times) < least:
        raise EntryError(f"{entry}: values", f"{len(values)} given for {len(times)} times",
                         f"write as many values as times, at least {'one' if least == 1 else 'two'}")
    if any(b <= a for a, b in itertools.pairwise(times)):
        raise EntryError(f"{entry}: times", "do not increase", "write them in order, each once")
