"""What only the data can tell: units, frames and points that names leave open, and the state at which truth starts.

Each reading of the columns is tried: the motion from its own start has to show its own rows. The nearest one is taken,
and said. Where truth starts from the recording, mistakes of the columns are tried as well, before the first row is
taken for the start: truth from a wrong start would explain nothing.
"""

from __future__ import annotations

import dataclasses
import functools
import itertools
import math
from collections.abc import Callable, Collection, Iterator
from typing import Any

import numpy as np

from crosscheck.adapters.lieeuler import motion
from crosscheck.diagnosis.fit import CLEAR
from crosscheck.diagnosis.misreadings import rolled
from crosscheck.recordings.causes import TURN
from crosscheck.recordings.comparing import differenced, first_rows, gaps, norms, part_of, restored, values_by
from crosscheck.recordings.reading import Group, Recording
from crosscheck.references.maximal import fastest
from crosscheck.scene.model import Scene
from crosscheck.scene.starts import restarted
from crosscheck.scene.states import States

ROWS = 120
"""Rows over which readings are tried."""

Change = Callable[[Group], Group]


@dataclasses.dataclass(frozen=True)
class Reading:
    """One way to read the columns: in words, and what it makes of each group."""

    said: str
    change: Callable[[list[Group]], list[Group]]


def _those(change: Change, keys: tuple[str, ...] = (), owner: str | None = None, flag: str | None = None
           ) -> Callable[[list[Group]], list[Group]]:
    """Changes the groups of these keys, of this owner, and that leave this open."""
    def changed(groups: list[Group]) -> list[Group]:
        return [change(group) if (not keys or group.key in keys) and owner in (None, group.owner) and (
            flag is None or flag in group.open) else group for group in groups]

    return changed


def _scaled(factor: float) -> Change:
    return lambda group: dataclasses.replace(group, values=group.values * factor, scale=factor,
                                             floor=group.floor * abs(factor))


def _as(**fields: Any) -> Change:
    return lambda group: dataclasses.replace(group, **fields)


def _named(groups: list[Group]) -> str:
    return ", ".join(dict.fromkeys(name for group in groups for name in group.columns))


ANGULAR = ("joint_position", "joint_velocity", "angular_velocity")
"""Quantities that may be in degrees; slides have no degrees, and their names leave no unit open."""

FRAMES = {"velocity": "body", "angular_velocity": "world"}
"""The axes in which a vector is not by its name."""


def questions(scene: Scene, groups: list[Group]) -> list[tuple[Reading, Reading]]:
    """What names leave open: for each question the reading that holds without data, and the other one."""
    origins = {body.name: tuple(np.round(body.origin, 12).tolist()) for body in scene.bodies}
    asked: tuple[tuple[str, tuple[str, ...], str, str, Change], ...] = (
        ("unit", ANGULAR, "in rad and rad/s", "in deg and deg/s", _scaled(math.pi / 180)),
        ("frame", ("velocity",), "in world axes", "in body axes", _as(frame="body")),
        ("frame", ("angular_velocity",), "in body axes", "in world axes", _as(frame="world")),
        ("point", ("position", "velocity"), "of the centre of mass", "of the origin of the model's frame",
         lambda group: dataclasses.replace(group, point=origins[group.owner])))
    made = []
    for flag, keys, usual, other, change in asked:
        left = [group for group in groups if flag in group.open and group.key in keys]
        if left:
            where = _named(left)
            point = "".join(f", point = {list(origins[owner])}" for owner in dict.fromkeys(
                group.owner for group in left)) if flag == "point" else ""
            made.append((Reading(f"{where} {usual}", list),
                         Reading(f"{where} {other}{point}", _those(change, keys, flag=flag))))
    return made


def mistakes(groups: list[Group]) -> Iterator[Reading]:
    """What may be wrong with the columns, and would make the start that of another motion."""
    for owner in dict.fromkeys(group.owner for group in groups if group.key.startswith("joint_")):
        yield Reading(f"the other sign of {owner}", _those(_scaled(-1.0), owner=owner))
    keys = tuple(dict.fromkeys(group.key for group in groups))
    for key in keys:
        named = key.replace("_", " ")
        if key == "attitude":
            for words, turned in (("x, y, z, w read as w, x, y, z", functools.partial(_rolled, by=-1)),
                                  ("w, x, y, z read as x, y, z, w", functools.partial(_rolled, by=1)),
                                  ("the inverse", _inverse)):
                yield Reading(f"attitude: {words}", _those(turned, keys=(key,)))
            continue
        yield Reading(f"the other sign of each {named}", _those(_scaled(-1.0), keys=(key,)))
        for factor, words in ((math.pi / 180, "degrees for radians"), (1e-3, "milli for whole units")):
            yield Reading(f"{named}: {words}", _those(_scaled(factor), keys=(key,)))
        if key in FRAMES:
            yield Reading(f"{named} in {FRAMES[key]} axes", _those(_as(frame=FRAMES[key]), keys=(key,)))
    yield Reading("degrees for radians", _those(_scaled(math.pi / 180), keys=ANGULAR))
    for one, other in itertools.combinations(dict.fromkeys(group.owner for group in groups), 2):
        yield Reading(f"{one} and {other} exchanged", functools.partial(_exchanged, {one: other, other: one}))


def _exchanged(partner: dict[str, str], groups: list[Group]) -> list[Group]:
    values = {(group.owner, group.key, group.parts): group for group in groups}
    made = []
    for group in groups:
        other = values.get((partner.get(group.owner, group.owner), group.key, group.parts), group)
        made.append(dataclasses.replace(group, values=other.values, floor=other.floor))
    return made


def _rolled(group: Group, by: int) -> Group:
    known = np.isfinite(group.values).all(axis=(1, 2))
    made = np.full(group.values.shape, np.nan)
    made[known] = rolled(group.values[known], by)
    return dataclasses.replace(group, values=made)


def _inverse(group: Group) -> Group:
    return dataclasses.replace(group, values=np.swapaxes(group.values, -1, -2))


def start_of(scene: Scene, recording: Recording, truth: Any, without: Collection[int] = ()
             ) -> tuple[States, Recording] | None:
    """(the first recorded states, the rows that gave them); None if these do not determine the poses.

    Rates `without` use follow from the positions.
    """
    first = first_rows(recording)
    if first is None:
        return None
    used = [group for k, group in enumerate(first.groups) if k not in without]
    t = np.minimum(first.t, truth.horizon)
    states = restored(scene, dataclasses.replace(first, groups=used), truth.at(np.maximum.accumulate(t)))
    if states is None:
        return None
    return dataclasses.replace(states, t=first.t), first


def missed(scene: Scene, recording: Recording, truth: Any, recorded_start: bool, without: Collection[int] = ()
           ) -> float:
    """By how much the motion from the start that a reading gives misses its rows, over their sizes."""
    since, begun = 0.0, scene
    if recorded_start:
        start = start_of(scene, recording, truth, without)
        if start is None:
            return np.inf
        since = float(start[1].t[0])
        begun = restarted(scene, start[0], 0, max(float(recording.t[-1]) - since, 1e-9), scene.samples)
    last = int(np.searchsorted(recording.t, since + min(truth.horizon, 20 * scene.duration), side="right"))
    piece = part_of(recording, np.flatnonzero(recording.t[:min(last, ROWS)] >= since))
    if len(piece.t) < 2:
        return np.inf
    t = piece.t - since
    rate = max(float(np.linalg.norm(begun.w0, axis=-1).max()), fastest(scene), 1.0)
    moved = values_by(begun, piece.groups, t, lambda times: motion(begun, "rkmk853", TURN / rate, times))
    if moved is None:
        return np.inf
    worst = 0.0
    for group, values in zip(piece.groups, moved, strict=True):
        gap = norms(gaps(group, group.values, values, True))
        size = float(np.nanmax(norms(gaps(group, group.values, group.values[:1], True)), initial=0.0))
        seen = np.sqrt(np.nanmean(np.maximum(gap - 2 * group.floor, 0.0) ** 2))
        worst = max(worst, float(seen) / max(size, float(group.floor.max()), 1e-12))
    return worst


def decided(scene: Scene, recording: Recording, truth: Any, recorded_start: bool) -> list[Reading]:
    """The readings of what names leave open that the data prefer; each says whether the data tell it."""
    asked = questions(scene, recording.groups)
    every = {choice: missed(scene, read_as(recording, [pair[k] for k, pair in zip(choice, asked, strict=True)]), truth,
                            recorded_start) for choice in itertools.product((0, 1), repeat=len(asked)) if asked}
    usual = (0,) * len(asked)
    best = min(every, key=lambda choice: every[choice], default=usual)
    if every and every[best] > CLEAR * every[usual]:
        best = usual
    made = []
    for k, pair in enumerate(asked):
        other = tuple(1 - c if j == k else c for j, c in enumerate(best))
        sure = np.isfinite(every[best]) and every[best] <= CLEAR * every[other]
        made.append(dataclasses.replace(pair[best[k]], said=pair[best[k]].said + (
            " (the data decide)" if sure else " (the data do not tell)")))
    return made


def read_as(recording: Recording, readings: list[Reading]) -> Recording:
    """A recording in the given readings of its columns."""
    groups = recording.groups
    for reading in readings:
        groups = reading.change(groups)
    return dataclasses.replace(recording, groups=groups)


def recorded_start(scene: Scene, recording: Recording, truth: Any) -> tuple[States, Recording, str] | None:
    """The start that the recording gives, as `start_of`, and what was undone for it: a mistake of its columns, or rates
    that are differences of the positions beside them."""
    plain = start_of(scene, recording, truth)
    off = missed(scene, recording, truth, True)
    rates = differenced(recording)
    if rates and missed(scene, recording, truth, True, rates) < CLEAR * off:
        start = start_of(scene, recording, truth, rates)
        if start is not None:
            named = ", ".join(recording.groups[k].label for k in rates)
            return *start, f"{named} from the positions, of which the recorded ones are differences"
    if off > CLEAR**2:
        best, said = recording, ""
        least = CLEAR * off
        for mistake in mistakes(recording.groups):
            made = read_as(recording, [mistake])
            left = missed(scene, made, truth, True)
            if left < least:
                best, said, least = made, mistake.said, left
        if said:
            start = start_of(scene, best, truth)
            if start is not None:
                return *start, said
    return None if plain is None else (*plain, "")
