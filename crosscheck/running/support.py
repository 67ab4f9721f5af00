"""What each engine can model in each form: joints, forces and loops. The adapters are asked about minimal scenes.

    for entry in matrix(["mujoco"]):
        print(entry.form, entry.item, entry.methods, entry.reason)
"""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Iterable

import numpy as np

from crosscheck import adapters
from crosscheck.adapters.base import Engine, RunSpec
from crosscheck.scene import assembly
from crosscheck.scene.checks import Draft
from crosscheck.scene.file import load_scene
from crosscheck.scene.joints import JOINT_TYPES
from crosscheck.scene.model import GROUND, Body, Force, Joint, Scene, rotation_from_quaternion

JOINTS = tuple(JOINT_TYPES)
FORCES = ("linear_spring", "torsional_spring", "constant_force", "constant_torque", "joint_torque", "joint_force")
NEEDS = {"torsional_spring": "revolute", "joint_torque": "revolute", "joint_force": "prismatic"}
"""The type of joint that a force needs to act in."""
DURATION = 1e-3  # s: long enough for a few steps, short enough that accelerations hardly change
STEPS = 4


@dataclasses.dataclass(frozen=True)
class Minimal:
    """A minimal scene that needs one joint, force or kind of system."""

    kind: str  # "joint to the ground" | "joint between bodies" | "force" | "system"
    item: str
    scene: Scene


@dataclasses.dataclass(frozen=True)
class Support:
    """Which methods of an engine can model an item in one form, and why the others cannot."""

    engine: str
    form: str | None
    kind: str
    item: str
    methods: tuple[str, ...]
    reason: str | None  # why one of the other methods cannot; None if all methods can


def matrix(names: Iterable[str] | None = None) -> tuple[Support, ...]:
    """One entry per engine, form and minimal scene. Raises `ArgumentError` for an unknown engine."""
    entries = []
    for name in adapters.names() if names is None else names:
        adapter = adapters.get(name)
        for form in adapter.forms or (None,):
            entries += [_support(adapter, form, minimal) for minimal in minimal_scenes()]
    return tuple(entries)


def spec(adapter: Engine, method: str, form: str | None) -> RunSpec:
    """A request that suits the method: with a tolerance if the method is adaptive, else with a fixed step."""
    if method in adapter.adaptive_methods:
        return RunSpec(method, rtol=1e-6, form=form)
    return RunSpec(method, step=DURATION / STEPS, form=form)


def _support(adapter: Engine, form: str | None, minimal: Minimal) -> Support:
    reasons = {method: adapter.unsupported(minimal.scene, spec(adapter, method, form)) for method in adapter.methods}
    able = tuple(method for method, reason in reasons.items() if reason is None)
    against = [reason for reason in reasons.values() if reason is not None]
    return Support(adapter.name, form, minimal.kind, minimal.item, able, against[-1] if against else None)


@functools.cache
def minimal_scenes() -> tuple[Minimal, ...]:
    """One scene for every joint on the ground and between bodies, every force, free bodies and closed loops.

    All bodies move, have full inertia matrices and turned attitudes, and are under gravity.
    """
    scenes = [Minimal("joint to the ground", kind, _closed([_joint(kind, GROUND, 0, "joint")])) for kind in JOINTS]
    scenes += [Minimal("joint between bodies", kind, _closed([_joint("spherical", GROUND, 0, "base"),
                                                             _joint(kind, 0, 1, "joint")]))
              for kind in JOINTS if not JOINT_TYPES[kind].slips]
    scenes += [Minimal("force", kind, _closed(
        [_joint(NEEDS.get(kind, "spherical"), GROUND, 0, "joint")], [_force(kind)])) for kind in FORCES]
    scenes += [Minimal("force", f"{kind} between bodies", _closed(
        [_joint("spherical", GROUND, 0, "base"), _joint(NEEDS.get(kind, "revolute"), 0, 1, "joint")],
        [_force(kind, 0, 1)])) for kind in ("linear_spring", *NEEDS)]
    triangle = [_joint("spherical", GROUND, 0, "first"), _joint("spherical", 0, 1, "second"),
                dataclasses.replace(_joint("spherical", GROUND, 1, "third"), parent_anchor=np.array([0.6, 0.1, 0.1]),
                                    child_anchor=np.array([-0.3, 0.2, 0.4]))]
    return (*scenes, Minimal("system", "free bodies", _closed([], count=2)),
            Minimal("system", "loop of spherical joints", _closed(triangle)),
            Minimal("system", "loop with redundant rows",
                    load_scene("four_bar").replace(name="minimal", duration=DURATION, samples=2)))


def _body(k: int) -> Body:
    turn, axes = np.array([[0.8, 0.3, -0.4, 0.2], [0.5, -0.6, 0.1, 0.6]])[k], np.eye(3) - 2 / 3
    attitude = turn / np.linalg.norm(turn)
    inertia = axes @ np.diag([0.1, 0.2, 0.15]) @ axes.T  # a mirror image: any orthogonal matrix makes a full inertia
    return Body(f"body {k}", 1.0 + k, inertia, attitude, np.array([0.4, -0.3, 0.7]) * (1 - 2 * k),
                np.array([0.2 - k, 0.5, -0.4]), np.array([0.1, 0.3, -0.2]))


def _joint(kind: str, parent: int, child: int, name: str) -> Joint:
    """A joint whose axes coincide (universal, blade, disk: are perpendicular) in the attitudes of its bodies."""
    axis, other, needs = np.array([0.6, 0.0, 0.8]), None, JOINT_TYPES[kind].needs
    if needs["child_axis"]:
        inner, outer = (np.eye(3) if k == GROUND else rotation_from_quaternion(_body(k).attitude)
                        for k in (parent, child))
        other = outer.T @ inner @ (axis if JOINT_TYPES[kind].axes == "parallel" else np.array([-0.8, 0.0, 0.6]))
    return Joint(name, kind, parent, child, np.array([0.2, -0.1, 0.3]), np.array([0.1, 0.2, 0.5]),
                 axis if needs["parent_axis"] else None, other, 0.7 if needs["length"] else None,
                 0.7 if needs["radius"] else None)


def _force(kind: str, parent: int = GROUND, child: int = 0) -> Force:
    content: dict[str, dict[str, object]] = {
        "linear_spring": {"parent_point": (0.6, 0.3, -1.2), "child_point": (0.1, 0.0, -0.3), "stiffness": 40.0,
                          "free_length": 0.5, "damping": 2.0},
        "torsional_spring": {"stiffness": 5.0, "rest_angle": 0.4, "damping": 0.3},
        "constant_force": {"child_point": (0.1, 0.2, -0.3), "frame": "body", "force": (1.0, -2.0, 3.0)},
        "constant_torque": {"frame": "world", "torque": (0.5, 1.0, -0.5)},
        "joint_torque": {"torque": 0.7},
        "joint_force": {"force": -1.5},
    }
    if kind == "linear_spring":
        return Force(kind, parent, child, None, content[kind])
    if kind in NEEDS:
        return Force(kind, None, None, "joint", content[kind])
    return Force(kind, None, child, None, content[kind])


def _closed(joints: list[Joint], forces: list[Force] | None = None, count: int | None = None) -> Scene:
    """The scene with these joints. Its state is corrected by the smallest change that closes them."""
    bodies = tuple(_body(k) for k in range(count or 1 + max(joint.child for joint in joints)))
    given = (True,) * len(bodies)
    return assembly.completed(Draft(Scene("minimal", bodies, tuple(joints), tuple(forces or ()), np.array(
        [0.3, -0.5, -9.81]), DURATION, 2), given, given, assemble=True))
