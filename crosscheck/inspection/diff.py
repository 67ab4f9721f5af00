"""Compares two models by their trees, whatever names, order and axes of the bodies: what differs, and where.

Both are brought to one pose, that of zero coordinates or their start, where the rotation Q from the axes of a body of
the first to those of its match is known. Bodies on fixed joints are one. Joints are matched from the ground outwards by
type, place, axis, mass and what hangs on them.
"""

from __future__ import annotations

import contextlib
import dataclasses
import math
import os
import re
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from crosscheck.errors import SceneError
from crosscheck.inspection import admissible
from crosscheck.scene.coordinates import relative_pose
from crosscheck.scene.file import as_scene
from crosscheck.scene.laws import DryFriction, Shape
from crosscheck.scene.mechanics import index1
from crosscheck.scene.model import (
    GROUND,
    Force,
    Joint,
    LeftOut,
    Scene,
    quaternion_from_rotation,
    rotation_from_quaternion,
)
from crosscheck.scene.models import import_model, is_model, joint_data
from crosscheck.scene.spanning import hung
from crosscheck.scene.vectors import welded

TOLERANCE = 1e-7
"""Relative bound on a difference: formats write the same digits, and an attitude as three angles loses some."""

DIGITS, PRINTED = 6, 5e-6
"""Digits of the longest number of a file that MuJoCo, or another that prints with %g, wrote; relative bound on what
they round, which is told but not counted as a difference."""

MOVES = 1e-6
"""Relative bound on a difference of accelerations, which the mass matrix makes larger than those of the data."""

STATES, SEED = 3, 0

_PLACES = frozenset({"name", "type", "parent", "child", "parent_anchor", "child_anchor", "parent_axis", "child_axis",
                     "reference", "start", "mimic", "damping", "stiffness", "rest_position"})
"""Fields of a joint that are compared by themselves; any other is compared as it is."""

_HELD = {"dry friction of joint": "dry_friction", "limits of joint": "limits", "mimic of joint": "mimic"}
"""The field of a joint that holds what an import may have left out."""


JointData = dict[str, dict[str, tuple[float | str, ...]]]
"""By joint and name, see `crosscheck.scene.models.joint_data`."""


class Difference(NamedTuple):
    """One thing in which two models differ; where it is, by its name in the first model if that has it."""

    where: str
    what: str
    a: Any
    b: Any
    scale: float | None = None  # of its numbers; None: the largest of them

    def __str__(self) -> str:
        return f"{self.where + ': ' if self.where else ''}{self.what}: {_formatted(self.a)} and {_formatted(self.b)}"


@dataclasses.dataclass(frozen=True)
class Diff:
    """What differs between two models. `pairs` are the names of matched bodies, `joints` those of matched joints.

    `rounded`: what differs by no more than six printed digits round.
    `moves` is the largest difference of accelerations at matched random states, relative to the largest acceleration;
    None where the second model cannot take the states of the first.
    """

    a: str
    b: str
    differences: tuple[Difference, ...]
    pairs: tuple[tuple[str, str], ...]
    joints: tuple[tuple[str, str], ...]
    ambiguous: tuple[str, ...]
    moves: float | None
    rounded: tuple[Difference, ...] = ()

    @property
    def same(self) -> bool:
        """Whether both describe the same motion."""
        return not self.differences

    @property
    def lines(self) -> tuple[str, ...]:
        """The result as lines of text."""
        motion = "accelerations are not compared: the second cannot take the states of the first" if (
            self.moves is None) else (
                f"accelerations, without friction, limits and contacts, at {STATES + 1} matched states differ by "
                f"{self.moves:.1e} of the largest")
        summary = f"differences: {len(self.differences)}" if not self.same else (
            "the same motion" + f" to {DIGITS} digits" * bool(self.rounded))
        return (f"{self.a} and {self.b}: {summary}; matched bodies: {len(self.pairs)}", *map(str, self.differences),
                *([f"equal to {DIGITS} digits, to which a file is rounded: " + ", ".join(
                    f"{each.what} of {each.where}" if each.where else each.what for each in self.rounded)]
                  if self.rounded else []),
                *(f"{name} could be matched otherwise: it has a twin" for name in self.ambiguous), motion)

    def __str__(self) -> str:
        return "\n".join(self.lines)


def diff(a: Scene | str | os.PathLike[str], b: Scene | str | os.PathLike[str]) -> Diff:
    """Compare two models or scenes; what a scene cannot hold of two models is compared by value.

    Raises
    ------
    SceneError, ArgumentError
        One of them cannot be read as a scene.
    """
    files = [not isinstance(each, Scene) and is_model(each) for each in (a, b)]
    one, other = (_read(each, all(files)) for each in (a, b))
    apart = ("actuator",) if all(files) else ()  # see `joint_data`
    best, second = sorted((_Comparison(_Tree(one, start), _Tree(other, start), apart) for start in (False, True)),
                          key=_Comparison.count)
    best.compare_motion()
    if best.differences and not second.differences:
        second.compare_motion()
        best = min(best, second, key=_Comparison.count)
    if not isinstance(a, Scene) and not isinstance(b, Scene) and all(files):
        best.differences += _dropped(joint_data(a), joint_data(b), best.joints)
    short = all(files) and any(not isinstance(each, Scene) and _digits(Path(each)) == DIGITS for each in (a, b))
    rounded = [each for each in best.differences if short and _alike(each.a, each.b, each.scale, PRINTED)]
    return Diff(_label(a), _label(b), tuple(each for each in best.differences if each not in rounded),
                tuple(best.names()), tuple(sorted(best.joints.items())), tuple(best.ambiguous), best.moves,
                tuple(rounded))


def _dropped(one: JointData, other: JointData, joints: dict[str, str]) -> list[Difference]:
    """What differs in the data of matched joints; some formats have no limits of velocities, and no shapes."""
    pairs = [(name, joints.get(name, name)) for name in one]
    return [Difference(name, what, one[name].get(what, ()), other[match].get(what, ()))
            for name, match in pairs if match in other for what in dict.fromkeys((*one[name], *other[match]))
            if not _alike(one[name].get(what, ()), other[match].get(what, ()))
            and (what not in ("velocity limits", "collision shapes") or (what in one[name] and what in other[match]))]


def _read(model: Scene | str | os.PathLike[str], files: bool) -> Scene:
    """The scene of a model; beside another of two `files` without what is compared by its data, else as it is."""
    if isinstance(model, Scene) or not is_model(model):
        return _merged(as_scene(model))
    if not files:
        with contextlib.suppress(SceneError):
            return _merged(import_model(model))
    return _merged(import_model(model, drop=True, limits="drop", contacts="drop"))


def _digits(file: Path) -> int:
    """Significant digits of the longest number among the attributes of a file."""
    found = re.findall(r'(?<=["\s])-?(\d*\.?\d+)(?:e[-+]?\d+)?(?=["\s])',
                       file.read_text(encoding="utf-8", errors="ignore"))
    return max((len(each.replace(".", "").lstrip("0")) for each in found), default=0)


def _label(model: Scene | str | os.PathLike[str]) -> str:
    return model.name if isinstance(model, Scene) else Path(model).name


class _Tree:
    """A scene hung from the ground: children of every body, its joint, and its pose where both scenes are compared."""

    def __init__(self, scene: Scene, start: bool) -> None:
        self.scene = scene
        order, self.loops = hung(scene, lambda joint: joint.kind.length or joint.kind.slips)
        self.joint = dict(order)
        self.children: dict[int, list[int]] = {k: [] for k in range(GROUND, scene.n)}
        for k in self.joint:
            self.children[self.parent(k)].append(k)
        self.below = {k: [k] for k in range(scene.n)}
        for k in reversed(self.joint):
            if self.parent(k) != GROUND:
                self.below[self.parent(k)] += self.below[k]
        self.x, self.R = {GROUND: np.zeros(3)}, {GROUND: np.eye(3)}
        for k in self.joint:
            self.x[k], self.R[k] = self._pose(k, start)
        self.size = max(1e-3, *(float(np.linalg.norm(each)) for joint in scene.joints
                                for each in (joint.parent_anchor, joint.child_anchor)), 1e-3)

    def parent(self, body: int) -> int:
        joint = self.joint.get(body)
        return GROUND if joint is None else joint.parent

    def _pose(self, body: int, start: bool) -> tuple[np.ndarray, np.ndarray]:
        joint, scene = self.joint.get(body), self.scene
        if joint is None or start:
            return scene.x0[body], scene.R0[body]
        inner = (np.zeros(3), np.eye(3)) if joint.parent == GROUND else (scene.x0[joint.parent], scene.R0[joint.parent])
        kind = joint.kind
        turn = inner[1].T @ scene.R0[body]
        d = inner[1].T @ (scene.x0[body] + scene.R0[body] @ joint.child_anchor - inner[0]) - joint.parent_anchor
        if kind.is_elastic:
            zero, d = relative_pose(joint, np.zeros(kind.positions))
            turn = zero if joint.reference is not None or kind.has_angle else turn
        x, R = self.x[joint.parent], self.R[joint.parent]
        return x + R @ (joint.parent_anchor + d) - R @ turn @ joint.child_anchor, R @ turn

    def springs(self, joint: Joint) -> dict[str, tuple[float, ...]]:
        """Damping, stiffness and rest position of a joint, those of torsional springs included."""
        count = joint.kind.positions
        damping, stiffness, rest = (np.array(values or (0.0,) * count) for values in (
            joint.damping, joint.stiffness, joint.rest_position))
        pull = stiffness * rest
        for force in self.scene.forces:
            if force.is_spring and force.joint == joint.name and not force.functions:
                k = joint.kind.coordinates.index("turn")
                damping[k] += force.parameters["damping"]
                stiffness[k] += force.parameters["stiffness"]
                pull[k] += force.parameters["stiffness"] * joint.rest(force)
        rest = np.divide(pull, stiffness, out=np.zeros(count), where=stiffness != 0)
        return {"damping": tuple(damping), "stiffness": tuple(stiffness), "rest_position": tuple(rest)}


class _Comparison:
    """The matching of two trees, and what differs between them."""

    def __init__(self, one: _Tree, other: _Tree, apart: tuple[str, ...]) -> None:
        self.one, self.other = one, other
        self.size = max(one.size, other.size)
        self.bodies: dict[int, int] = {GROUND: GROUND}
        self.Q: dict[int, np.ndarray] = {GROUND: np.eye(3)}
        self.shifts = {GROUND: np.zeros(3)}  # of mass centres, in the axes of the first
        self.joints: dict[str, str] = {}
        self.ambiguous: list[str] = []
        self.differences: list[Difference] = []
        self._compare("", "gravity", one.scene.gravity, other.scene.gravity)
        self._descend(GROUND, np.eye(3), np.zeros(3))
        self._loops()
        self._couplings()
        self._forces()
        self._rest(apart)
        self._touches(self._shapes())
        self.moves: float | None = None

    def count(self) -> int:
        """How many differences there are."""
        return len(self.differences)

    def compare_motion(self) -> None:
        """Compare accelerations; it takes longer than all before."""
        self.moves = self._accelerations()
        if self.moves is not None and self.moves > MOVES and not self.differences:
            self._add("", "accelerations", 0.0, self.moves)

    def names(self) -> Iterator[tuple[str, str]]:
        """Names of matched bodies."""
        return ((self.one.scene.bodies[k].name, self.other.scene.bodies[j].name)
                for k, j in sorted(self.bodies.items()) if k != GROUND)

    def _compare(self, where: str, what: str, a: object, b: object, scale: float | None = None) -> None:
        """Adds the difference of two values, if there is one."""
        if not _alike(a, b, scale):
            self._add(where, what, a, b, scale)

    def _add(self, where: str, what: str, a: object, b: object, scale: float | None = None) -> None:
        self.differences.append(Difference(where, what, _plain(a), _plain(b), scale))

    def _compare_by_key(self, mine: dict[Any, Any], theirs: dict[Any, Any], words: Callable[[Any], tuple[str, str]]
                        ) -> None:
        """Compare values by key; `words`: where and what a key is."""
        for key in dict.fromkeys((*mine, *theirs)):
            self._compare(*words(key), mine.get(key), theirs.get(key))

    def _descend(self, body: int, E: np.ndarray, shift: np.ndarray) -> None:
        """Match and compare the children of a matched body.

        E is the rotation, in the world, of the second tree from here on against the first, `shift` how far the mass
        centre of the body lies elsewhere, in the axes of the first.
        """
        mine, theirs = self.one.children[body], self.other.children[self.bodies[body]]
        for k, j in self._matched(body, mine, theirs, shift):
            a, b = self.one.scene.bodies[k], self.other.scene.bodies[j]
            self.bodies[k] = j
            self._note_twins(a.name, k, j, body, theirs, shift)
            home = self.other.R[j].T @ E @ self.one.R[k]
            Q = self.Q[k] = self._axes(k, j, home)
            self._compare(a.name, "mass", a.mass, b.mass)
            self._compare(a.name, "inertia", a.inertia, Q.T @ b.inertia @ Q)
            own = self.shifts[k] = self._joint(k, j, shift)
            if self.one.joint.get(k) is not None and self.other.joint.get(j) is not None and Q is not home:
                turn = Q.T @ home
                angle = math.acos(min(1.0, max(-1.0, (float(np.trace(turn)) - 1) / 2)))
                self._add(self.one.joint[k].name, "frame", 0.0, angle, 1.0)  # type: ignore[union-attr]
            self._descend(k, self.other.R[j] @ Q @ self.one.R[k].T, own)
        for k in set(mine) - self.bodies.keys():
            self._compare(self.one.scene.bodies[k].name, "body", "there", "missing")
        for j in set(theirs) - set(self.bodies.values()):
            self._compare(self.other.scene.bodies[j].name, "body", "missing", "there")

    def _matched(self, body: int, mine: list[int], theirs: list[int], shift: np.ndarray) -> list[tuple[int, int]]:
        from scipy.optimize import linear_sum_assignment

        if not mine or not theirs:
            return []
        rows, columns = linear_sum_assignment([[self._cost(body, k, j, shift) for j in theirs] for k in mine])
        return [(mine[row], theirs[column]) for row, column in zip(rows, columns, strict=True)]

    def _cost(self, body: int, k: int, j: int, shift: np.ndarray) -> float:
        """How unlike two children are; the largest weights are on what a small mistake does not change."""
        one, other = self.one.scene.bodies[k], self.other.scene.bodies[j]
        a, b = self.one.joint.get(k), self.other.joint.get(j)
        sums = [sum(tree.scene.bodies[each].mass for each in tree.below[at])
                for tree, at in ((self.one, k), (self.other, j))]
        moments = [np.linalg.eigvalsh(each.inertia) for each in (one, other)]
        cost = 2.0 * (len(self.one.below[k]) != len(self.other.below[j])) + _ratio(*sums) + _ratio(one.mass, other.mass)
        cost += _ratio(*moments) + 0.01 * (one.name != other.name)
        if a is None or b is None:
            away = float(np.abs(self.one.x[k] - self.other.x[j]).max())
            return cost + 4.0 * (a is not b) + min(1.0, away / self.size)
        Q = self.Q[body]
        cost += 4.0 * (a.type != b.type) + 0.01 * (a.name != b.name)
        cost += 2 * min(1.0, float(np.linalg.norm(Q.T @ b.parent_anchor - a.parent_anchor - shift)) / self.size)
        cost += min(1.0, abs(float(np.linalg.norm(a.child_anchor) - np.linalg.norm(b.child_anchor))) / self.size)
        if a.parent_axis is not None and b.parent_axis is not None:
            cost += 1 - float((Q @ a.parent_axis) @ b.parent_axis)
        return cost

    def _note_twins(self, name: str, k: int, j: int, body: int, theirs: list[int], shift: np.ndarray) -> None:
        own = self._cost(body, k, j, shift)
        if any(self._cost(body, k, other, shift) <= own + 0.03 for other in theirs if other != j):
            self.ambiguous.append(name)

    def _axes(self, k: int, j: int, home: np.ndarray) -> np.ndarray:
        """Q of a pair: `home`, unless another rotation makes more of the two bodies equal."""
        a, b = self.one.scene.bodies[k], self.other.scene.bodies[j]
        ja, jb = self.one.joint.get(k), self.other.joint.get(j)
        vectors = [] if ja is None or jb is None else [(ja.child_anchor / self.size, jb.child_anchor / self.size)] + (
            [] if ja.child_axis is None or jb.child_axis is None else [(ja.child_axis, jb.child_axis)])

        def wrong(Q: np.ndarray) -> int:
            return sum(not _alike(Q @ u, v, 1.0) for u, v in vectors) + (not _alike(Q @ a.inertia @ Q.T, b.inertia))

        if not wrong(home):
            return home
        choices = []
        frames = [np.linalg.eigh(each.inertia)[1] for each in (a, b)]
        frames = [each * np.sign(np.linalg.det(each)) for each in frames]
        choices += [frames[1] @ np.diag(signs) @ frames[0].T for signs in ((1, 1, 1), (1, -1, -1), (-1, 1, -1),
                                                                           (-1, -1, 1))]
        if len(vectors) == 2 and np.linalg.norm(np.cross(*(u for u, _ in vectors))) > 1e-6:
            U, _, Vt = np.linalg.svd(sum(np.outer(v, u) for u, v in vectors))
            choices.append(U @ np.diag([1.0, 1.0, float(np.linalg.det(U @ Vt))]) @ Vt)
        best = min(choices, key=wrong)
        return np.asarray(best) if wrong(best) < wrong(home) else home

    def _joint(self, k: int, j: int, shift: np.ndarray) -> np.ndarray:
        """Compare the joints on which two bodies hang; how far the second's mass centre lies elsewhere, (3,)."""
        a, b, Q, Qp = self.one.joint.get(k), self.other.joint.get(j), self.Q[k], self.Q[self.one.parent(k)]
        name = self.one.scene.bodies[k].name
        if a is None or b is None:
            if a is not b:
                self._compare(a.name if a else name, "joint type", a.type if a else "free", b.type if b else "free")
            return np.zeros(3)
        self.joints[a.name] = b.name
        if a.type != b.type:
            self._compare(a.name, "joint type", a.type, b.type)
            return np.zeros(3)
        turned = [(u, matrix.T @ v) for u, v, matrix in ((a.child_axis, b.child_axis, Q),
                                                          (a.parent_axis, b.parent_axis, Qp)) if u is not None]
        for u, v in turned[:1]:
            self._compare(a.name, "axis", u, v, 1.0)
        own = Q.T @ b.child_anchor - a.child_anchor
        at = Qp.T @ b.parent_anchor - a.parent_anchor - shift
        turn = self.one.R[a.parent].T @ self.one.R[k]
        along = turn @ own  # both anchors may lie elsewhere along the axis of a hinge, and anywhere in a slide
        if a.kind.has_angle:
            along = (along @ a.parent_axis) * a.parent_axis
        if (a.kind.is_elastic or not a.kind.motion) and _alike(at, along, self.size):
            at, own = np.zeros(3), own - turn.T @ along
        if "slide n1" in a.kind.coordinates:  # its slides count from anywhere in the plane
            at = (at @ a.parent_axis) * a.parent_axis
        self._compare(name, "centre of mass", np.zeros(3), -own, self.size)
        self._compare(a.name, "place", a.parent_anchor, a.parent_anchor + at, self.size)
        self._compare_by_key(self.one.springs(a), self.other.springs(b), lambda key: (a.name, key))
        self._keys(a, b)
        return np.asarray(own)

    def _keys(self, a: Joint, b: Joint) -> None:
        for field in dataclasses.fields(Joint):
            values = [_plain(getattr(joint, field.name)) for joint in (a, b)]
            values = [() if isinstance(value, tuple) and not any(value) else value for value in values]
            if field.name not in _PLACES:
                self._compare(a.name, field.name, *values)

    def _couplings(self) -> None:
        """Mimics, whose leaders may be named otherwise."""
        theirs = {joint.name: joint for joint in self.other.scene.joints}
        for a in self.one.scene.joints:
            b = theirs.get(self.joints.get(a.name, ""))
            if b is None or (a.mimic is None and b.mimic is None):
                continue
            mine = a.mimic and (self.joints.get(a.mimic.joint), a.mimic.ratio, a.mimic.offset)
            if not _alike(mine, b.mimic and (b.mimic.joint, b.mimic.ratio, b.mimic.offset)):
                self._add(a.name, "mimic", a.mimic, b.mimic)

    def _loops(self) -> None:
        """Joints that close loops, matched by type and bodies."""
        left = list(self.other.loops)
        for a in self.one.loops:
            ends = [(a.parent, a.parent_anchor, a.parent_axis), (a.child, a.child_anchor, a.child_axis)]
            fits = [b for b in left if b.type == a.type and {self.bodies.get(end[0]) for end in ends} == {
                b.parent, b.child}]
            gaps = [max(float(np.abs(self.Q[body].T @ (b.parent_anchor if self.bodies[body] == b.parent else
                                                       b.child_anchor) - anchor).max()) for body, anchor, _ in ends)
                    for b in fits]
            if not fits:
                self._compare(a.name, "loop joint", a.type, "missing")
                continue
            b = fits[int(np.argmin(gaps))]
            left.remove(b)
            self.joints[a.name] = b.name
            self._compare(a.name, "place", 0.0, min(gaps), self.size)
            for body, _, axis in ends:
                its = b.parent_axis if self.bodies[body] == b.parent else b.child_axis
                if axis is not None and its is not None and abs((self.Q[body] @ axis) @ its) < 1 - TOLERANCE**2:
                    self._compare(a.name, "axis", axis, self.Q[body].T @ its)
            self._keys(a, b)
        for b in left:
            self._compare(b.name, "loop joint", "missing", b.type)

    def _forces(self) -> None:
        """Loads, servos and springs between points, each matched with the most similar of its type and ends."""
        mine, theirs = ([force for force in tree.scene.forces if not (force.is_spring and force.joint)
                         or force.functions] for tree in (self.one, self.other))
        for a in mine:
            fits = [(len(wrong), index, wrong) for index, b in enumerate(theirs)
                    if (wrong := self._unlike(a, b)) is not None]
            where = a.joint or self.one.scene.bodies[a.child].name
            if not fits:
                self._compare(where, a.type, "there", "missing")
                continue
            _, index, wrong = min(fits)
            b = theirs.pop(index)
            for key in wrong:
                self._add(where, f"{key} of {a.type}", a.parameters.get(key), b.parameters.get(key))
        for b in theirs:
            self._compare(b.joint or self.other.scene.bodies[b.child].name, b.type, "missing", "there")

    def _unlike(self, a: Force, b: Force) -> list[str] | None:
        """Parameters in which two forces differ; None if they act elsewhere."""
        if a.type != b.type or (a.joint and self.joints.get(a.joint) != b.joint):
            return None
        if not a.joint and (self.bodies.get(a.child), None if a.parent is None else self.bodies.get(a.parent)) != (
                b.child, b.parent):
            return None
        wrong = []
        for key in sorted({*a.parameters, *b.parameters}):
            value, its = _plain(a.parameters.get(key)), _plain(b.parameters.get(key))
            body = a.parent if key == "parent_point" else a.child
            local = key.endswith("point") or (key in ("force", "torque") and a.parameters.get("frame") == "body")
            if local and body is not None and isinstance(its, tuple) and all(isinstance(part, float) for part in its):
                its = tuple(self.Q[body].T @ np.array(its))
            if not _alike(value, its, self.size if key.endswith("point") else None):
                wrong.append(key)
        return wrong

    def _rest(self, apart: tuple[str, ...]) -> None:
        """What ends the claim of a scene, and what an import left out, by the names of the first model.

        `apart`: how the words begin of what is compared elsewhere.
        """
        back = {b: a for a, b in [*self.joints.items(), *self.names()]}

        def key(each: LeftOut, names: dict[str, str]) -> tuple[str, ...]:
            """What it is without line numbers, and the names of what has it, in any order."""
            parts = re.sub(r" \(line \d+[^)]*\)", "", each.what).split("'")
            return tuple(sorted(names.get(part, part) for part in (*parts, *each.where.split(" - "))))

        def bounds(scene: Scene, names: dict[str, str]) -> dict[Any, Any]:
            return {(each.type, names.get(each.joint or "", each.joint)): (each.lower, each.upper)
                    for each in scene.monitors if each.joint is not None}

        self._compare_by_key(bounds(self.one.scene, {}), bounds(self.other.scene, back),
                             lambda key: (str(key[1]), f"monitored {key[0]}"))
        here, there = ({key(each, names): each for each in _contacts_apart(tree)
                        if not each.what.startswith(apart)}
                       for tree, names in ((self.one, {}), (self.other, back)))
        for each in dict.fromkeys((*here, *there)):
            a, b = (("there" if side[each].value == "" else side[each].value) if each in side else "missing"
                    for side in (here, there))
            if not _alike(a, b):
                where, what, value = here.get(each) or there[each]
                where = where if each in here else back.get(where, where)
                if not self._held(where, what, each in here, f"left out ({_formatted(_plain(value))})"):
                    self._compare(where, what.removesuffix(" of joint"), a, b)

    def _held(self, where: str, what: str, first: bool, left_out: str) -> bool:
        """Whether one scene holds what the other, the `first` or not, left out; the difference then says so."""
        for k, each in enumerate(self.differences):
            if each.where == where and each.what == _HELD.get(what):
                held = each.b if first else each.a
                pair = (left_out, held) if first else (held, left_out)
                self.differences[k] = Difference(where, what.removesuffix(" of joint"), *pair)
                return True
        return False

    def _shapes(self) -> dict[str, str]:
        """Compare the shapes of matched bodies; those of the second model by their names in the first."""
        names: dict[str, str] = {}
        for k, j in self.bodies.items():
            mine = {each.name: _outline(each, np.eye(3), np.zeros(3)) for each in self.one.scene.shapes
                    if each.body == k}
            theirs = {each.name: _outline(each, self.Q[k].T, self.shifts[k]) for each in self.other.scene.shapes
                      if each.body == j}
            for name, outline in [*mine.items()]:
                same = next((each for each, other in theirs.items()
                             if not self._outlined_otherwise(outline, other)), None)
                if same is not None:
                    names[same] = name
                    del mine[name], theirs[same]
            for name in mine.keys() & theirs.keys():
                names[name] = name
                one, other = mine.pop(name), theirs.pop(name)
                for key in self._outlined_otherwise(one, other):
                    self._compare(name, f"{key} of the shape", one.get(key), other.get(key),
                                  self.size if key in ("place", "corners") else None)
            for name in mine:
                self._compare(name, "shape", "there", "missing")
            for name in theirs:
                self._compare(name, "shape", "missing", "there")
        return names

    def _outlined_otherwise(self, one: dict[str, Any], other: dict[str, Any]) -> list[str]:
        """In which of their keys two outlines differ."""
        return [key for key in dict.fromkeys((*one, *other))
                if not _alike(one.get(key), other.get(key), self.size if key in ("place", "corners") else None)]

    def _touches(self, names: dict[str, str]) -> None:
        """Compare which shapes end the claim where they come near, and how near."""
        mine, theirs = ({frozenset(back.get(shape, shape) for shape in each.shapes): each.margin
                         for each in tree.scene.monitors if each.joint is None}
                        for tree, back in ((self.one, {}), (self.other, names)))
        self._compare_by_key(mine, theirs, lambda pair: (" and ".join(sorted(pair)), "margin of a watched touch"))

    def _accelerations(self) -> float | None:
        """The largest difference at the start of the first model and at random states, which the second takes over."""
        one, other = self.one.scene, self.other.scene
        if len(self.bodies) - 1 != one.n or one.n != other.n:
            return None
        at = admissible.states(one, STATES, SEED)
        order = [self.bodies[k] for k in range(one.n)]
        Q = np.array([self.Q[k] for k in range(one.n)])
        worst, size = 0.0, float(np.linalg.norm(one.gravity)) or 1.0
        for state in range(STATES + 1):
            x, R, v, w = (np.empty_like(part[state]) for part in (at.x, at.R, at.v, at.w))
            x[order], v[order] = at.x[state], at.v[state]
            R[order], w[order] = at.R[state] @ np.swapaxes(Q, 1, 2), np.einsum("kij,kj->ki", Q, at.w[state])
            with np.errstate(all="ignore"):
                closed = admissible.near(other, x, R, v, w)
            if closed is None:
                return None
            (a, alpha), (a2, alpha2) = (_rates(one, (at.x[state], at.R[state], at.v[state], at.w[state])), (
                part[order] for part in _rates(other, (closed.x0, closed.R0, closed.v0, closed.w0))))
            gap = np.abs(np.einsum("kij,kj->ki", Q, alpha) - alpha2).max(initial=np.abs(a - a2).max(initial=0.0))
            worst, size = max(worst, float(gap)), max(size, float(np.abs(a).max()), float(np.abs(alpha).max()))
        return worst / size


def _contacts_apart(tree: _Tree) -> list[LeftOut]:
    """What an import left out; contacts by the bodies that move, a link that is fused to the world being the ground.

    Those of a body with the ground that it hangs on are left out: MuJoCo looks for them, whoever reads a URDF does not.
    """
    names = {body.name: k for k, body in enumerate(tree.scene.bodies)}
    made = []
    for each in tree.scene.left_out:
        pair = [names.get(name, GROUND) for name in each.where.split(" - ")]
        if len(pair) != 2 or not each.what.startswith("contacts of"):
            made.append(each)
        elif GROUND not in pair or max(pair) not in tree.joint or tree.parent(max(pair)) != GROUND:
            made.append(each._replace(where=" - ".join(
                "ground" if k == GROUND else tree.scene.bodies[k].name for k in pair)))
    return made


def _rates(scene: Scene, state: tuple[np.ndarray, ...]) -> tuple[np.ndarray, np.ndarray]:
    x, R, v, w = (part[None] for part in state)
    a, alpha, _ = index1(scene, x, R, v, w)
    return a[0], alpha[0]


def _merged(scene: Scene) -> Scene:
    """The scene with every body that a fixed joint holds made one with the body, or the ground, that it is held to."""
    hung = {joint.child: joint for joint in reversed(scene.joints)}
    held = {k: joint for k, joint in hung.items() if not joint.kind.motion}

    def root(body: int) -> int:
        for _ in range(scene.n):
            body = held[body].parent if body in held else body
        return body

    if not held or any(root(k) in held for k in range(scene.n)):
        return scene
    roots = [*map(root, range(scene.n)), GROUND]  # the last of these and of the following arrays is the ground
    kept = [k for k in range(scene.n) if roots[k] == k]
    index = {GROUND: GROUND} | {k: number for number, k in enumerate(kept)}
    x, R = np.vstack([scene.x0, np.zeros(3)]), np.concatenate([scene.R0, np.eye(3)[None]])
    centres, bodies = np.zeros_like(x), []
    turns = [R[k].T @ each for k, each in zip(roots, R, strict=True)]  # to the axes of the root
    for k in kept:
        members = [each for each in range(scene.n) if roots[each] == k]
        mass, centres[k], J = welded([scene.masses[each] for each in members], [x[each] for each in members],
                                     [R[each] @ scene.inertias[each] @ R[each].T for each in members])
        speed = scene.v0[k] + R[k] @ np.cross(scene.w0[k], R[k].T @ (centres[k] - x[k]))
        bodies.append(dataclasses.replace(scene.bodies[k], mass=mass, inertia=R[k].T @ J @ R[k], position=centres[k],
                                          velocity=speed))

    def turned(body: int, vector: object) -> Any:
        """A direction in the axes of a body, in those of its root."""
        return None if vector is None else turns[body] @ np.asarray(vector)

    def moved(body: int, point: object) -> Any:
        return turned(body, point) + R[roots[body]].T @ (x[body] - centres[roots[body]])

    joints = []
    for joint in scene.joints:
        p, c = joint.parent, joint.child
        if joint is held.get(c):
            continue
        reference = None if joint.reference is None else quaternion_from_rotation(
            turns[p] @ rotation_from_quaternion(joint.reference) @ turns[c].T)
        joints.append(dataclasses.replace(
            joint, parent=index[roots[p]], child=index[roots[c]], parent_anchor=moved(p, joint.parent_anchor),
            child_anchor=moved(c, joint.child_anchor), parent_axis=turned(p, joint.parent_axis),
            child_axis=turned(c, joint.child_axis), reference=reference))
    forces = []
    for force in scene.forces:
        parameters = dict(force.parameters)
        for key, body in (("parent_point", force.parent), ("child_point", force.child)):
            if key in parameters:
                parameters[key] = tuple(moved(body, parameters[key]))
        for key in ("force", "torque"):
            if parameters.get("frame") == "body" and key in parameters:
                parameters[key] = tuple(turned(force.child, parameters[key]))
        parent, child = (None if body is None else index[roots[body]] for body in (force.parent, force.child))
        forces.append(dataclasses.replace(force, parameters=parameters, parent=parent, child=child))
    shapes = tuple(dataclasses.replace(
        each, body=index[roots[each.body]], position=tuple(moved(each.body, each.position)),
        attitude=tuple(quaternion_from_rotation(turned(each.body, rotation_from_quaternion(np.array(each.attitude))))))
        for each in scene.shapes)
    return scene.replace(bodies=tuple(bodies), joints=tuple(joints), forces=tuple(forces), shapes=shapes, sites=(),
                         sensors=())


def _outline(shape: Shape, turn: np.ndarray, shift: np.ndarray) -> dict[str, Any]:
    """What is seen of a shape in other axes, as numbers that do not depend on how its own axes are written."""
    axes = turn @ rotation_from_quaternion(np.array(shape.attitude))
    place = turn @ np.array(shape.position) - shift
    if shape.type == "plane":
        return {"type": shape.type, "turn": axes[:, 2], "place": axes[:, 2] @ place}
    if shape.type == "mesh":
        return {"type": shape.type, "corners": np.array(shape.points) @ axes.T + place}
    if shape.type == "sphere":
        return {"type": shape.type, "size": shape.size, "place": place}
    if len(shape.size) == 2:
        return {"type": shape.type, "size": shape.size, "place": place, "turn": np.outer(axes[:, 2], axes[:, 2])}
    return {"type": shape.type, "size": sorted(shape.size), "place": place,
            "turn": axes * np.array(shape.size) ** 2 @ axes.T}


def _plain(value: object) -> Any:
    """Arrays and records as tuples of numbers; friction with one value as that value."""
    if isinstance(value, DryFriction) and value.static == value.sliding:
        return float(value.sliding)
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        value = dataclasses.astuple(value)
    if isinstance(value, Iterable) and not isinstance(value, str):
        return tuple(_plain(part) for part in value)
    return float(value) if isinstance(value, int | float | np.floating) and not isinstance(value, bool) else value


def _alike(a: object, b: object, scale: float | None = None, tolerance: float = TOLERANCE) -> bool:
    """Whether two values, or tuples of them, agree; numbers within a tolerance of the largest, or of `scale`."""
    a, b = _plain(a), _plain(b)
    if isinstance(a, float) and isinstance(b, float):
        return a == b or abs(a - b) <= tolerance * (max(abs(a), abs(b)) if scale is None else scale)
    if isinstance(a, tuple) and isinstance(b, tuple):
        if scale is None:
            scale = max((abs(each) for each in (*_numbers(a), *_numbers(b)) if math.isfinite(each)), default=0.0)
        return len(a) == len(b) and all(_alike(*pair, scale, tolerance) for pair in zip(a, b, strict=True))
    return bool(a == b)


def _numbers(value: object) -> Iterator[float]:
    if isinstance(value, tuple):
        for part in value:
            yield from _numbers(part)
    elif isinstance(value, float):
        yield value


def _ratio(a: Any, b: Any) -> float:
    """Distance of positive numbers, from 0 for equal ones to 1."""
    return float(np.max(np.abs(np.subtract(a, b)) / np.maximum(np.maximum(np.abs(a), np.abs(b)), 1e-300)))


def _formatted(value: object) -> str:
    if isinstance(value, float):
        return f"{value:.7g}"
    if isinstance(value, tuple):
        return _formatted(value[0]) if len(value) == 1 else "(" + ", ".join(map(_formatted, value)) + ")"
    return str(value) if value not in ("", None) else "nothing"
