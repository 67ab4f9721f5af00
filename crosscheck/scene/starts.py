"""Attitudes and angular velocities from joint coordinates, from the ground outwards."""

from __future__ import annotations

import dataclasses
import graphlib
from collections.abc import Iterable, Mapping

import numpy as np

from crosscheck.scene import coordinates
from crosscheck.scene.checks import Draft, Start
from crosscheck.scene.model import GROUND, Body, Joint, Scene, quaternion_from_rotation, rotation_from_quaternion
from crosscheck.scene.schema import EntryError
from crosscheck.scene.spanning import spanning_tree
from crosscheck.scene.states import Motion, States
from crosscheck.scene.vectors import cross

ALLOWED_VIOLATION = 1e-8
"""Allowed violation relative to the largest anchor length (positions), times max(1, |w|) (velocities); absolute for
dot-1 rows. A state written with ten digits passes, a wrong one does not."""


@dataclasses.dataclass(frozen=True)
class Configuration:
    """Positions (n, 3), unit quaternions (n, 4), velocities (n, 3), angular velocities (n, 3), as in a scene."""

    x: np.ndarray
    q: np.ndarray
    v: np.ndarray
    w: np.ndarray

    @property
    def R(self) -> np.ndarray:
        return rotation_from_quaternion(self.q)


def bodies_at(scene: Scene, state: Configuration) -> tuple[Body, ...]:
    """The bodies of the scene in another configuration."""
    return tuple(dataclasses.replace(body, position=state.x[k], attitude=state.q[k], velocity=state.v[k],
                                     angular_velocity=state.w[k]) for k, body in enumerate(scene.bodies))


def started(scene: Scene, x: np.ndarray, R: np.ndarray, v: np.ndarray, w: np.ndarray) -> Scene:
    """The scene with its bodies at other positions (n, 3), attitudes (n, 3, 3), velocities and angular velocities."""
    return scene.replace(bodies=bodies_at(scene, Configuration(x, quaternion_from_rotation(R), v, w)))


def restarted(scene: Scene, motion: Motion, k: int, duration: float, samples: int = 2) -> Scene:
    """The scene started from the state of a motion at sample k, which becomes time zero.

    Hinges go on with their whole turns. What a sampled servo holds is not known here.
    """
    begun = started(scene.delayed(-float(motion.t[k])).replace(duration=duration, samples=samples),
                    motion.x[k], motion.R[k], motion.v[k], motion.w[k])
    return begun.replace(joints=tuple(
        dataclasses.replace(joint, start=_coordinates_at(scene, joint, motion, k)) if joint.start is not None
        or any(word.startswith("turn") for word in joint.kind.coordinates) else joint for joint in begun.joints))


def _coordinates_at(scene: Scene, joint: Joint, motion: Motion, k: int) -> tuple[float, ...] | None:
    """The coordinates of a joint at sample k; None, a start within half a turn, where its turns are not known."""
    if motion.hinges is not None:
        rows = slice(k, k + 1)
        motion, k = States(*(getattr(motion, name)[rows] for name in "txRvw"), hinges=motion.hinges[rows]), 0
    position = coordinates.history(scene, joint, motion).position.reshape(len(motion.t), -1)[k]
    return tuple(position.tolist()) if np.isfinite(position).all() else None


def at_coordinates(scene: Scene, given: Mapping[str, tuple[np.ndarray, np.ndarray]],
                   roots: Iterable[int] = ()) -> Configuration:
    """The state in which joints of the spanning tree, by their names, have these coordinates and rates.

    A ball has a quaternion and an angular velocity in its child's axes. Other joints keep the motion of their bodies
    relative to each other, `roots` and bodies that float their own. Joints that close loops may open.
    """
    begin = coordinates.starting(scene)
    spins = np.einsum("nij,nj->ni", scene.R0, scene.w0)
    frames = {k: (scene.x0[k], scene.R0[k], scene.v0[k], spins[k]) for k in range(scene.n)}  # w in the world
    frames[GROUND] = np.zeros(3), np.eye(3), np.zeros(3), np.zeros(3)
    for branch in spanning_tree(scene, lambda joint: int(joint.name in given), roots)[0]:
        joint = branch.joint
        if joint is None:
            continue
        now = coordinates.relative(joint, begin)
        turn, d, w, speed = now.turn[0], now.d[0], now.w[0], now.rate[0]
        if joint.name in given:
            position, rates = given[joint.name]
            pose, d = coordinates.relative_pose(joint, position)
            turn = turn if joint.kind.keeps_attitude else pose
            w, speed = coordinates.relative_rates(joint, position, rates)
        x, R, velocity, spin = frames[branch.parent]
        across = R if branch.outward else R @ turn.T  # the attitude of the joint's parent
        arm, out = across @ (joint.parent_anchor + d), (R @ turn if branch.outward else R) @ joint.child_anchor
        sign, near, far = (1, arm, out) if branch.outward else (-1, out, arm)
        other = spin + sign * across @ w
        frames[branch.body] = (x + near - far, R @ turn if branch.outward else across,
                               velocity + cross(spin, near) + sign * across @ speed - cross(other, far), other)
    x, R, velocity, spin = (np.array(part) for part in zip(*(frames[k] for k in range(scene.n)), strict=True))
    return Configuration(x, quaternion_from_rotation(R), velocity, np.einsum("nji,nj->ni", R, spin))


def anchor_length(scene: Scene) -> float:
    """The largest anchor length, m; 1 m if all anchors are zero."""
    anchors = np.array([(joint.parent_anchor, joint.child_anchor) for joint in scene.joints]).reshape(-1, 3)
    return float(np.linalg.norm(anchors, axis=1).max(initial=0.0)) or 1.0


def _outwards(draft: Draft, starts: Iterable[Start]) -> list[Start]:
    """Joints with given coordinates, each after those that move its parent."""
    joints, given = draft.scene.joints, {start.joint: start for start in starts}
    movers: dict[int, list[int]] = {}
    for index in given:
        movers.setdefault(joints[index].child, []).append(index)
    order = graphlib.TopologicalSorter({index: movers.get(joints[index].parent, ()) for index in given})
    try:
        return [given[index] for index in order.static_order()]
    except graphlib.CycleError as error:
        first = min(error.args[1])
        raise EntryError(f'joints[{first}] "{joints[first].name}": position', "the joints with positions form a loop",
                         "leave position and velocity out of the joint that closes it") from None


def attitudes(draft: Draft, state: Configuration) -> tuple[Configuration, dict[str, np.ndarray]]:
    """Attitudes from joint coordinates, and for each joint the distance between its anchors (parent's axes, m)."""
    scene, q, shifts = draft.scene, state.q.copy(), {}
    R = np.concatenate([state.R, np.eye(3)[None]])
    for start in _outwards(draft, (each for each in draft.starts
                                   if each.position or scene.joints[each.joint].reference is not None)):
        joint = scene.joints[start.joint]
        if start.position is None and not joint.kind.keeps_attitude:
            continue
        relative, shift = coordinates.relative_pose(joint, np.array(start.position or (0.0,)))
        attitude = R[joint.parent] @ relative
        given = draft.given_attitudes is None or draft.given_attitudes[joint.child]
        gap = float(np.abs(attitude - R[joint.child]).max())
        if given and gap > ALLOWED_VIOLATION and not draft.assemble:
            raise _contradiction(draft, start, "attitude", gap, "")
        R[joint.child], q[joint.child] = attitude, quaternion_from_rotation(attitude)
        if start.position is not None:
            shifts[joint.name] = shift
    return dataclasses.replace(state, q=q), shifts


def spins(draft: Draft, state: Configuration) -> tuple[Configuration, dict[str, np.ndarray]]:
    """Angular velocities from joint coordinates, and for each joint the rate of that distance (parent's axes, m/s)."""
    if not draft.starts:
        return state, {}
    scene, w, speeds = draft.scene, state.w.copy(), {}
    R = np.concatenate([state.R, np.eye(3)[None]])
    now = coordinates.at_start(scene.replace(bodies=bodies_at(scene, state)))
    for start in _outwards(draft, (each for each in draft.starts if each.position or each.velocity)):
        joint = scene.joints[start.joint]
        given = draft.given_spins is None or draft.given_spins[joint.child]
        if start.velocity is None and given:
            continue
        position = now[joint.name][0] if start.position is None else np.array(start.position)
        rates = np.zeros(3) if start.velocity is None else np.array(start.velocity)
        turn, speed = coordinates.relative_rates(joint, position, rates)
        inner = np.zeros(3) if joint.parent == GROUND else w[joint.parent]
        spin = R[joint.child].T @ R[joint.parent] @ (inner + turn)
        gap = float(np.abs(spin - w[joint.child]).max())
        if given and gap > ALLOWED_VIOLATION * max(1.0, float(np.abs(spin).max())) and not draft.assemble:
            raise _contradiction(draft, start, "angular_velocity", gap, " rad/s")
        w[joint.child] = spin
        speeds[joint.name] = speed
    return dataclasses.replace(state, w=w), speeds


def _contradiction(draft: Draft, start: Start, key: str, gap: float, unit: str) -> EntryError:
    joint = draft.scene.joints[start.joint]
    child = draft.scene.bodies[joint.child].name
    return EntryError(f'joints[{start.joint}] "{joint.name}"', f'its coordinates and the {key} of "{child}" differ by '
                      f"{gap:.3g}{unit} (allowed {ALLOWED_VIOLATION:g})", "leave one of the two out, or correct it")


def check(draft: Draft, scene: Scene) -> None:
    """Raise if a body's given position or velocity contradicts the given coordinates of its joint."""
    if not draft.starts:
        return
    started = coordinates.at_start(scene)
    L = anchor_length(scene)
    for start in draft.starts:
        joint = scene.joints[start.joint]
        for k, (key, given, unit) in enumerate((("position", start.position, ""), ("velocity", start.velocity, "/s"))):
            if given is None or joint.kind.positions == 4:  # its attitude has been compared already
                continue
            gap = float(np.abs(started[joint.name][k] - np.array(given)).max())
            if gap > ALLOWED_VIOLATION * max(1.0, L, *(abs(value) for value in given)):
                raise _contradiction(draft, start, key, gap, f" rad{unit} or m{unit}")
