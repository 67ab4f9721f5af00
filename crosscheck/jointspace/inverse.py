"""Inverse dynamics: the generalized forces that a motion in joint coordinates takes."""

from __future__ import annotations

import os

import numpy as np

from crosscheck.errors import ArgumentError, Unsupported, unknown
from crosscheck.jointspace.motion import JointSpace, checked, placed
from crosscheck.jointspace.sources import mujoco_at, pinocchio_at
from crosscheck.references.base import TruthError
from crosscheck.scene import file as scene_file
from crosscheck.scene import mechanics
from crosscheck.scene.armature import rate_row
from crosscheck.scene.model import Scene

AGREED = 1e-9
"""Largest difference of two routes of truth, relative to the largest term of the sum."""


def inverse_dynamics(scene: Scene | str | os.PathLike[str], q: object, v: object, a: object,
                     engine: str = "truth") -> np.ndarray:
    """Generalized forces that drives have to supply for a motion, (T, n), or (n,) for one instant; N m and N.

    Everything else in the scene counts as it is: weight, springs, dampers, dry friction, loads, rotors. Given torques,
    forces and servos of joints do not act: their sum is the answer. Functions of time have their values at t = 0.

    Parameters
    ----------
    scene : a Scene, a built-in name or a path; a tree of joints
    q, v, a : positions, rates and their derivatives, (T, n) or (n,), in the order of `scene.coordinates`; q of a ball
        is a rotation vector from zero coordinates, v and a are in its child's axes
    engine : "truth", "pinocchio" (rnea) or "mujoco" (mj_inverse)

    Raises
    ------
    ArgumentError, SceneError
        An argument is wrong.
    Unsupported
        Joints close a loop, so that several sets of forces give the same motion, or the engine lacks something.
    TruthError
        The two routes of the truth differ.
    """
    loaded = passive(scene_file.as_scene(scene))
    if engine not in ENGINES:
        raise ArgumentError(unknown("engine", engine, ENGINES))
    count = len(loaded.coordinates)
    parts = checked(loaded, f"q, v, a: give arrays (T, {count}) of finite numbers", (q, v, a), 3, axes=2)
    single, (Q, V, A) = parts[0].ndim == 1, (np.atleast_2d(part) for part in parts)
    closing = [joint.name for joint in loaded.joints if joint.mimic is not None or joint.drive is not None]
    if closing:
        raise Unsupported(f"inverse dynamics of {loaded.name!r}: the coordinate of joint {closing[0]!r} is not free")
    if any(limits is not None for joint in loaded.joints for limits in joint.limits):
        raise Unsupported(f"inverse dynamics of {loaded.name!r}: it has limits, which push only where they are met")
    rows = [ENGINES[engine](placed(loaded, *row[:2]).lawless, row[2]) + friction(loaded, row[1])
            for row in zip(Q, V, A, strict=True)]
    return rows[0] if single else np.array(rows).reshape(len(Q), count)


def passive(scene: Scene) -> Scene:
    """The scene without what its joints are given."""
    return scene.replace(forces=tuple(force for force in scene.forces if not force.is_motor))


def friction(scene: Scene, v: np.ndarray) -> np.ndarray:
    """What drives have to supply against dry friction, (n,); none at rest, where it may be anything up to its limit."""
    force, places = np.zeros(len(v)), JointSpace(scene.lawless).of_joint
    for joint in scene.joints:
        for k, each in enumerate(joint.dry_friction, places[joint.name].start):
            if each is not None:
                force[k] = -each.force(v[k])
    return force


def exact(scene: Scene, a: np.ndarray) -> np.ndarray:
    """By the mass matrix and accelerations of the articulated formulation; checked by the balance of momentum."""
    space = JointSpace(scene)
    free = np.real(space.accelerations(space.start))
    force = space.mass @ (a - free)
    bodies = np.real(np.concatenate([space.start.a, space.start.alpha], axis=1)).ravel() + space.motions @ (a - free)
    pulls, turns = np.split(bodies.reshape(-1, 6), 2, axis=1)
    inertia = np.concatenate([scene.masses[:, None] * pulls, np.einsum("nij,nj->ni", scene.inertias, turns)],
                             axis=1).ravel()
    state = scene.x0[None], scene.R0[None], scene.v0[None], scene.w0[None]
    applied = mechanics.applied_forces(scene, *state)[0]
    other = space.motions.T @ (inertia - applied)
    for joint in scene.joints:
        for rotor, word in zip(joint.armature, joint.kind.coordinates, strict=False):
            S, drift = rate_row(joint, word, scene, *state)
            other += rotor * (S[0] @ bodies + drift[0]) * (space.motions.T @ S[0])
    size = max(1.0, *(float(np.abs(space.motions.T @ part).max()) for part in (inertia, applied)))
    if np.abs(force - other).max() > AGREED * size:
        raise TruthError(f"inverse dynamics of {scene.name!r}: two routes differ by {np.abs(force - other).max():.1e}")
    return np.asarray(other)


def by_pinocchio(scene: Scene, a: np.ndarray) -> np.ndarray:
    """`rnea`, with springs, dampers and loads as torques and wrenches from outside."""
    import pinocchio

    dynamics, q, v, (_, T) = pinocchio_at(scene)
    torque, wrenches = dynamics._applied(0.0, q, v)
    external = () if wrenches is None else (wrenches,)
    return np.asarray(T @ (pinocchio.rnea(dynamics.model.model, dynamics.data, q, v, T.T @ a, *external) - torque))


def by_mujoco(scene: Scene, a: np.ndarray) -> np.ndarray:
    """`mj_inverse` minus the loads that are actuators here."""
    import mujoco

    model, data, (_, T) = mujoco_at(scene)
    data.qacc[:] = T.T @ a
    mujoco.mj_inverse(model, data)
    return np.asarray(T @ (data.qfrc_inverse - data.qfrc_actuator))


ENGINES = {"truth": exact, "pinocchio": by_pinocchio, "mujoco": by_mujoco}
