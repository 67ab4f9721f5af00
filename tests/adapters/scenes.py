"""Scenes for tests of the adapters: those of the library, each read once, and some in code; distances from them."""

import functools

import numpy as np
from scipy.spatial.transform import Rotation

import crosscheck
from crosscheck.scene import mechanics
from crosscheck.scene.model import Body, Joint, Scene, rotation_from_quaternion
from crosscheck.scene.states import States

library = functools.cache(crosscheck.load_scene)


def relative(found: np.ndarray, wanted: np.ndarray) -> float:
    """The largest difference over the size of what is wanted, which counts as at least 1."""
    return float(np.abs(found - wanted).max() / max(1.0, np.abs(wanted).max()))


def off_the_start(scene: Scene, states: States) -> float:
    """How far the first sample is from the start of the scene."""
    return float(np.max([relative(getattr(states, name)[0], getattr(scene, f"{name}0")) for name in "xRvw"]))


def off_the_equations(scene: Scene, states: States, first: int = 0) -> float:
    """How far accelerations are, from sample `first` on, from those that solve the equations at the same state."""
    a, alpha, _ = mechanics.index1(scene, states.x, states.R, states.v, states.w, t=states.t)
    return float(np.max([relative(states.a[first:], a[first:]), relative(states.alpha[first:], alpha[first:])]))


def _unit(vector: list[float]) -> np.ndarray:
    return np.array(vector) / np.linalg.norm(vector)


def full_inertia() -> np.ndarray:
    """A physical inertia with no zero in it, kg m^2."""
    turn = rotation_from_quaternion(_unit([0.8, 0.3, -0.4, 0.2]))
    return turn @ np.diag([0.1, 0.2, 0.15]) @ turn.T


def mixed_tree() -> Scene:
    """Ground, ball, hinge, then side by side a slider and (written from the outer to the inner body) a ball, moving.

    States come from joint coordinates by formulas of this file, not by the code under test.
    """
    axis, anchor = _unit([1.0, 2.0, -1.0]), np.array([0.1, -0.2, 0.5])
    turn = np.eye(3)[:, [1, 2, 0]]  # its components differ in the child: its zero is not the identity
    joints = (
        Joint("ball", "spherical", -1, 0, [0.3, 0.1, 0.0], anchor),
        Joint("hinge", "revolute", 0, 1, [0.0, 0.1, -0.4], [0.2, 0.0, 0.3], axis, turn.T @ axis),
        Joint("slider", "prismatic", 1, 2, [0.0, -0.3, 0.1], [0.1, 0.1, 0.1], axis, axis),
        Joint("turned ball", "spherical", 3, 1, [0.0, 0.2, 0.4], [-0.3, 0.0, -0.2]),
    )
    quaternions = {0: _unit([0.9, 0.2, -0.1, 0.3]), 3: _unit([0.5, -0.5, 0.1, 0.7])}
    spins = {0: np.array([0.4, -0.2, 0.9]), 3: np.array([-0.6, 0.1, 0.2])}
    x, v = {0: np.array([0.3, 0.1, 0.0]) - rotation_from_quaternion(quaternions[0]) @ anchor}, {}
    v[0] = -rotation_from_quaternion(quaternions[0]) @ np.cross(spins[0], anchor)
    # the hinge stands at 0.7 rad past its zero and turns at 0.8 rad/s
    across = np.cross(joints[1].child_axis, axis)
    shortest = Rotation.from_rotvec(np.arccos(joints[1].child_axis @ axis) * across / np.linalg.norm(across))
    attitude = Rotation.from_quat(quaternions[0], scalar_first=True) * Rotation.from_rotvec(0.7 * axis) * shortest
    quaternions[1] = attitude.as_quat(scalar_first=True)
    relative = rotation_from_quaternion(quaternions[0]).T @ rotation_from_quaternion(quaternions[1])
    spins[1] = relative.T @ spins[0] + 0.8 * joints[1].child_axis
    x[1], v[1] = _hang(joints[1], x[0], quaternions[0], v[0], spins[0], quaternions[1], spins[1], 0.0, 0.0)
    # the slider stands at 0.25 m and runs at -0.4 m/s, axes along its parent's
    quaternions[2], spins[2] = quaternions[1], spins[1]
    x[2], v[2] = _hang(joints[2], x[1], quaternions[1], v[1], spins[1], quaternions[2], spins[2], 0.25, -0.4)
    outer = Joint("outer", "spherical", 1, 3, joints[3].child_anchor, joints[3].parent_anchor)
    x[3], v[3] = _hang(outer, x[1], quaternions[1], v[1], spins[1], quaternions[3], spins[3], 0.0, 0.0)
    bodies = tuple(Body(f"body {k}", 1.0 + 0.2 * k, full_inertia(), quaternions[k], spins[k], x[k], v[k])
                   for k in range(4))
    return Scene("mixed tree", bodies, joints, (), [0.5, -1.0, -9.81], 1.0, 11)


def _hang(joint: Joint, x: np.ndarray, attitude: np.ndarray, v: np.ndarray, spin: np.ndarray, child: np.ndarray,
          child_spin: np.ndarray, travel: float, rate: float) -> tuple[np.ndarray, np.ndarray]:
    """Position and velocity of the child's centre of mass from its parent's state."""
    R, C = rotation_from_quaternion(attitude), rotation_from_quaternion(child)
    along = np.zeros(3) if joint.parent_axis is None else joint.parent_axis
    arm = joint.parent_anchor + travel * along
    return (x + R @ arm - C @ joint.child_anchor,
            v + R @ (np.cross(spin, arm) + rate * along) - C @ np.cross(child_spin, joint.child_anchor))
