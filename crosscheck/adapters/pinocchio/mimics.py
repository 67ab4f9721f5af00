"""Pinocchio's mimic joints: among joints that follow each other only one has coordinates of its own.

Pinocchio wants this one to be the first of them in its tree. `aba`, its Cholesky factorization and its constraints do
not take mimic joints; `crba` and `rnea` do.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from crosscheck.adapters.common.links import Link
from crosscheck.scene.model import Scene

if TYPE_CHECKING:
    import pinocchio


@dataclasses.dataclass(frozen=True)
class Mimics:
    """Coordinates of all joints from the independent ones: q = Q q_independent + offset, v = V v_independent."""

    Q: np.ndarray
    offset: np.ndarray
    V: np.ndarray
    kept: tuple[np.ndarray, np.ndarray]  # indices of the independent ones in q and v


def unsupported(scene: Scene, closed: bool) -> str | None:
    """Why Pinocchio cannot model the mimics of a scene, or None."""
    for joint in scene.joints:
        if joint.mimic is None:
            continue
        if closed:
            return (f"the mimic of joint {joint.name!r}: loops are closed by constraintDynamics, which takes no mimic "
                    "joints")
        if joint.mimic.ratio == 0:
            return f"the mimic of joint {joint.name!r} has the ratio 0: Pinocchio would lose its coordinate"
    return None


def groups(scene: Scene) -> list[dict[str, float]]:
    """Joints that move together, each with the rate of its coordinate when that of their leader is 1."""
    followed = {joint.name: joint.mimic for joint in scene.joints if joint.mimic is not None}
    led: dict[str, dict[str, float]] = {}
    for name in followed:
        leader, ratio = name, 1.0
        while leader in followed:
            leader, ratio = followed[leader].joint, ratio * followed[leader].ratio
        led.setdefault(leader, {leader: 1.0})[name] = ratio
    return list(led.values())


def coupled(scene: Scene, model: pinocchio.Model, links: Sequence[Link], slots: Sequence[tuple[slice, slice]],
            start: np.ndarray) -> tuple[pinocchio.Model, Mimics]:
    """The model with mimic joints, and how its coordinates give all those of `model`, whose q at t = 0 is `start`."""
    import pinocchio

    Q, offset, V = np.eye(model.nq), np.zeros(model.nq), np.eye(model.nv)
    dependent: tuple[list[int], list[int]] = [], []
    mimicking = model
    for rates in groups(scene):
        along = [(at_q.start, at_v.start, model.getJointId(str(link.body)),
                  rates[link.joint] if link.outward else -rates[link.joint])
                 for link, (at_q, at_v) in zip(links, slots, strict=True) if link.joint in rates]
        (first_q, first_v, first, unit), *others = sorted(along, key=lambda each: each[2])
        for q, v, joint, rate in others:
            ratio = rate / unit
            Q[q, q] = V[v, v] = 0.0
            Q[q, first_q] = V[v, first_v] = ratio
            offset[q] = start[q] - ratio * start[first_q]
            mimicking = pinocchio.transformJointIntoMimic(mimicking, first, joint, ratio, offset[q])
            dependent[0].append(q)
            dependent[1].append(v)
    kept = tuple(np.delete(np.arange(len(each)), lost) for each, lost in zip((Q, V), dependent, strict=True))
    Q, V = Q[:, kept[0]], V[:, kept[1]]
    mimicking.armature = np.einsum("ij,i,ij->j", V, model.armature, V)
    return mimicking, Mimics(Q, offset, V, (kept[0], kept[1]))
